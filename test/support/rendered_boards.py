# Copyright 2026 opencv_tools maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License");
# you may not use this file except in compliance with the License.
# You may obtain a copy of the License at
#
#     http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software
# distributed under the License is distributed on an "AS IS" BASIS,
# WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied.
# See the License for the specific language governing permissions and
# limitations under the License.

"""Pictures of a calibration board as a camera with a known lens sees it."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache, cached_property
import math

import cv2
import numpy as np
from numpy.typing import NDArray
from opencv_tools.calibration.board_pictures import board_pixels
from opencv_tools.calibration.boards import Board
from opencv_tools.calibration.detection import Detection
import pytest

_EDGE = 15.0  # white around the board in mm
_SAMPLES = 4  # along each side of a pixel
_CORRECTIONS = 40  # of the inverse of the distortion, which has no formula
_EXACT = 1e-12  # change of a ray after which no more corrections follow
_COARSE = 8  # samples between those that tell where a board is

#: For tests of boards with markers, which OpenCV finds since 4.7.
needs_markers = pytest.mark.skipif(
    not hasattr(getattr(cv2, 'aruco', None), 'ArucoDetector'), reason='OpenCV is older than 4.7')


@dataclass(frozen=True)
class Pose:
    """
    Place of the middle of the board.

    :param rotation: (3,) rotation vector from board to camera.
    :param translation: (3,) middle of the board in metres of the camera.
    """

    rotation: NDArray[np.float64]
    translation: NDArray[np.float64]


class Camera:
    """
    A camera with a known lens.

    :param size: width and height of its images in pixels.
    :param k: (3, 3) camera matrix.
    :param d: distortion coefficients; 4 of the equidistant model if ``is_fisheye``.
    """

    def __init__(self, size: tuple[int, int], k: object, d: object,
                 is_fisheye: bool = False) -> None:
        self.size, self.is_fisheye = size, is_fisheye
        self.k, self.d = np.asarray(k, float), np.asarray(d, float)
        self._pictures: dict[Board, NDArray[np.uint8]] = {}

    @cached_property
    def _samples(self) -> NDArray[np.float32]:
        """Rays of all samples of an image, which only a drawn board needs."""
        # Rays of every second pixel, and between them a linear interpolation (0.001 pixels).
        axes = [np.arange(-2, count + 4, 2.0) for count in self.size]
        grid = np.stack(np.meshgrid(*axes), axis=2)
        rays = self.rays(grid.reshape(-1, 2)).reshape(grid.shape).astype(np.float32)
        for axis, count in enumerate(self.size):  # cv2.remap would round the places
            places = ((np.arange(count * _SAMPLES) + 0.5) / _SAMPLES + 1.5) / 2
            left = places.astype(int)
            part = (places - left).astype(np.float32)[:, None, None]
            rays = np.moveaxis(rays, 1 - axis, 0)
            rays = np.moveaxis(rays[left] * (1 - part) + rays[left + 1] * part, 0, 1 - axis)
        return np.ascontiguousarray(rays)

    def rays(self, pixels: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return x and y of the rays of pixels at the depth 1, (n, 2) arrays."""
        target = (pixels - self.k[:2, 2]) / np.diag(self.k)[:2]
        rays = target.copy()
        if self.is_fisheye:
            bent = np.maximum(np.linalg.norm(target, axis=1), 1e-9)
            angle = bent.copy()
            for _ in range(_CORRECTIONS):
                before, angle = angle, bent / (1 + self._powers(angle))
                if np.abs(angle - before).max() < _EXACT:
                    break
            return target * (np.tan(np.minimum(angle, 1.55)) / bent)[:, None]
        for _ in range(_CORRECTIONS):
            change = self._distort(rays) - target
            rays -= change
            if np.abs(change).max() < _EXACT:
                break
        return rays

    def _distort(self, rays: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the rays after the lens, (n, 2) arrays; the formulas of CameraInfo's models."""
        x, y = rays.T
        r2 = x * x + y * y
        if self.is_fisheye:
            r = np.sqrt(np.maximum(r2, 1e-18))
            angle = np.arctan(r)
            return rays * (angle * (1 + self._powers(angle)) / r)[:, None]
        k1, k2, p1, p2, k3, k4, k5, k6 = np.pad(self.d, (0, 8 - len(self.d)))
        radial = (1 + r2 * (k1 + r2 * (k2 + r2 * k3))) / (1 + r2 * (k4 + r2 * (k5 + r2 * k6)))
        return np.stack((x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x),
                         y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y), axis=1)

    def _powers(self, angle: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.sum([k * angle ** (2 * number) for number, k in enumerate(self.d, 1)], axis=0)

    def project(self, board: Board, pose: Pose,
                heights: NDArray[np.float64] | float = 0.0) -> NDArray[np.float64]:
        """Return the true positions of all corners in the image; heights are in metres."""
        points = board.corners().astype(float) - np.array([*board.size, 0]) / 2
        points[:, 2] += heights
        points = points @ cv2.Rodrigues(pose.rotation)[0].T + pose.translation
        return self._distort(points[:, :2] / points[:, 2:]) @ self.k[:2, :2].T + self.k[:2, 2]

    def see(self, board: Board, pose: Pose, blur: float = 0.7, noise: float = 3.0,
            seed: int = 0) -> NDArray[np.uint8]:
        """
        Draw the board.

        :param blur: standard deviation of the blur of the lens in pixels.
        :param noise: standard deviation of the noise.
        :returns: (h, w) image; the background is gray.
        """
        return self.mix([(board, pose)], blur, noise, seed)

    def mix(self, boards: list[tuple[Board, Pose]], blur: float = 0.7, noise: float = 3.0,
            seed: int = 0) -> NDArray[np.uint8]:
        """Draw several boards."""
        samples = self._samples
        large = np.full(samples.shape[:2], 110, np.uint8)
        for board, pose in boards:
            scale = round(8 * board.square * 1000) / (board.square * 1000)
            if board not in self._pictures:
                self._pictures[board] = board_pixels(board, scale, _EDGE)
            picture = self._pictures[board]
            rotation = cv2.Rodrigues(pose.rotation)[0]
            # Board to rays: the columns of the rotation, and the upper left of the board.
            corner = pose.translation - rotation @ np.array([*board.size, 0]) / 2
            plane = np.linalg.inv(np.column_stack((rotation[:, :2], corner))).astype(np.float32)
            part = _surroundings(_places(
                samples[::_COARSE, ::_COARSE], plane, scale, picture.shape)[1])
            places, inside = _places(samples[part], plane, scale, picture.shape)
            seen = cv2.remap(picture, *(np.nan_to_num(place, nan=-1e4).astype(np.float32)
                                        for place in places), cv2.INTER_LINEAR,
                             borderMode=cv2.BORDER_CONSTANT, borderValue=110)
            large[part][inside] = seen[inside]
        # Black ink is not 0, and white paper is not 255.
        image = cv2.resize(large, self.size, interpolation=cv2.INTER_AREA).astype(np.float32)
        image = cv2.GaussianBlur(image * 0.7 + 30, (0, 0), blur) if blur else image * 0.7 + 30
        noises = np.random.default_rng(seed).normal(0, noise, image.shape)
        return np.clip(np.rint(image + noises), 0, 255).astype(np.uint8)


def _places(rays: NDArray[np.float32], plane: NDArray[np.float32], scale: float,
            shape: tuple[int, ...]) -> tuple[list[NDArray[np.float32]], NDArray[np.bool_]]:
    """Return where rays meet the picture of a board, and whether they meet it at all."""
    x, y, z = (rays[..., 0] * row[0] + rays[..., 1] * row[1] + row[2] for row in plane)
    z = np.where(z > 1e-6, z, np.nan)
    places = [(value / z * 1000 + _EDGE) * scale - 0.5 for value in (x, y)]
    inside = (z > 0) & (np.abs(places[0] / shape[1] - 0.5) < 0.5) & (
        np.abs(places[1] / shape[0] - 0.5) < 0.5)
    return places, inside


def _surroundings(coarse: NDArray[np.bool_]) -> tuple[slice, slice]:
    """Return the part of all samples that contains a board, by every ``_COARSE``-th sample."""
    found = (np.flatnonzero(coarse.any(axis=axis)) for axis in (1, 0))
    rows, columns = (slice(max(0, one[0] - 3) * _COARSE, (one[-1] + 4) * _COARSE)
                     if len(one) else slice(0, None) for one in found)
    return rows, columns


@cache
def wide_camera(width: int = 1280, height: int = 720) -> Camera:
    """Return a camera with the distortion of a usual webcam with a wide lens."""
    f = 905 / 1280 * width
    k = [[f, 0, width * 0.506], [0, f * 1.003, height * 0.488], [0, 0, 1]]
    return Camera((width, height), k, [-0.31, 0.11, 0.0007, -0.0005, -0.02])


@cache
def fisheye_camera(width: int = 1280, height: int = 960) -> Camera:
    """Return a camera with a fisheye lens of about 130 degrees."""
    f = 0.42 * width
    k = [[f, 0, width * 0.497], [0, f * 1.002, height * 0.508], [0, 0, 1]]
    return Camera((width, height), k, [-0.02, 0.006, -0.004, 0.0006], is_fisheye=True)


def poses(board: Board, camera: Camera, count: int, seed: int = 0,
          is_whole: bool = False) -> list[Pose]:
    """
    Return poses that cover the image, as a person moves the board before the camera.

    :param is_whole: whether all corners are inside of the image.
    """
    random, found = np.random.default_rng(seed), []
    width, height = camera.size
    while len(found) < count:
        tilt = np.radians(random.uniform(-40, 40, 2))
        turn = math.radians(random.uniform(-20, 20))
        part = random.uniform(0.35, 0.75)
        place = camera.rays(np.array([[random.uniform(0.15, 0.85) * width,
                                       random.uniform(0.15, 0.85) * height]]))[0]
        distance = camera.k[0, 0] * max(board.size) / (width * part)
        ray = np.append(place, 1.0) / math.hypot(*place, 1.0)
        # The board faces the camera, then it is tilted and turned.
        facing = np.cross([0, 0, 1], ray)
        facing *= math.acos(ray[2]) / max(float(np.linalg.norm(facing)), 1e-9)
        rotation = np.linalg.multi_dot([cv2.Rodrigues(one)[0] for one in (
            facing, np.array([*tilt, 0.0]), np.array([0, 0, turn]))])
        rotation = cv2.Rodrigues(rotation)[0][:, 0]
        pose = Pose(rotation, ray * distance)
        inside = camera.project(board, pose)
        if not is_whole or ((inside > 8) & (inside < np.array(camera.size) - 9)).all():
            found.append(pose)
    return found


@cache
def small_camera() -> Camera:
    """Return a camera with small images and little distortion, for fast tests."""
    return Camera((480, 360), [[420.0, 0, 243.0], [0, 421.0, 176.0], [0, 0, 1]],
                  [-0.12, 0.05, 0.0005, -0.0003, 0.0])


def facing(board: Board, camera: Camera, part: float = 0.7, x: float = 0.0, y: float = 0.0,
           turn: float = 0.0) -> Pose:
    """
    Return the pose of a board that faces the camera, a little tilted.

    :param part: width of the board as a part of that of the image.
    :param x: place of the middle of the board, as a part of the width of the image.
    :param turn: angle about the axis in radians.
    """
    depth = camera.k[0, 0] * board.size[0] / (camera.size[0] * part)
    unit = camera.size[0] / camera.k[0, 0] * depth
    rotation = cv2.Rodrigues(cv2.Rodrigues(np.array([0.2, -0.15, 0.0]))[0]
                             @ cv2.Rodrigues(np.array([0.0, 0.0, turn]))[0])[0][:, 0]
    return Pose(rotation, np.array([x * unit, y * unit, depth]))


def noisy_view(board: Board, camera: Camera, pose: Pose, noise: float = 0.0, seed: int = 0,
               bend: float = 0.0) -> Detection:
    """
    Return the true corners inside of the image with noise, without an image.

    :param noise: standard deviation of each coordinate in pixels.
    :param bend: height of the board in 1 / metre times the square of x.
    """
    heights = bend * (board.corners()[:, 0].astype(float) - board.size[0] / 2) ** 2
    true = camera.project(board, pose, heights)
    ids = np.flatnonzero(((true > 0) & (true < np.array(camera.size) - 1)).all(axis=1))
    corners = true[ids] + np.random.default_rng(seed).normal(0, noise, (len(ids), 2))
    return Detection(size=camera.size, corners=corners.astype(np.float32), ids=ids,
                     points=board.corners()[ids], edge_width=3.0)
