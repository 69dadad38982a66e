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

"""The camera model in a camera_info: pixels of raw and of rectified images."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from opencv_tools.base.text import printable
from opencv_tools.image.errors import RectificationError
from opencv_tools.opencv import cv2

# Numbers of coefficients that each distortion model may have.
_POLYNOMIAL = (0, 4, 5, 8, 12, 14)
_MODELS = {'plumb_bob': _POLYNOMIAL, 'rational_polynomial': _POLYNOMIAL, 'equidistant': (0, 4)}
_FISHEYE = 'equidistant'
# OpenCV has 16 bits for a coordinate of a pixel.
_MAX_SIDE = 32_766
_MAX_NAME = 64
_NO_RAY = 1e5  # OpenCV returns a million for points that a fisheye does not have

#: Maps of ``cv2.remap``.
Maps = tuple[Any, Any]


@dataclass(frozen=True, kw_only=True)
class CameraModel:
    """
    A calibration in pixels of the images, after binning and without the rows outside of the ROI.

    :param matrix: (3, 3) matrix of the raw images.
    :param distortion: coefficients of the distortion; empty if there is none.
    :param rotation: (3, 3) rotation from the raw to the rectified camera.
    :param projection: (3, 3) matrix of the rectified images.
    :param is_fisheye: whether the model of the distortion is equidistant.
    """

    matrix: NDArray[np.float64]
    distortion: NDArray[np.float64]
    rotation: NDArray[np.float64]
    projection: NDArray[np.float64]
    is_fisheye: bool

    @property
    def is_rectified(self) -> bool:
        """Whether rectified images equal the raw ones."""
        with np.errstate(over='ignore', invalid='ignore'):  # of numbers near the largest one
            return not self.distortion.size and np.allclose(
                self.projection @ self.rotation, self.matrix, rtol=1e-9, atol=1e-9)

    def maps(self, width: int, height: int, *, is_nearest: bool) -> Maps:
        """Return the maps of ``cv2.remap`` for images of a size."""
        size = width, height
        # Maps of floats are made first, because those of 16 bits wrap coordinates far outside of
        # the image, and OpenCV does not round them to the nearest pixel.
        if self.is_fisheye:
            floats = cv2.fisheye.initUndistortRectifyMap(
                self.matrix, self.distortion, self.rotation, self.projection, size,
                cv2.CV_32FC1)
        else:
            floats = cv2.initUndistortRectifyMap(
                self.matrix, self.distortion if self.distortion.size else None, self.rotation,
                self.projection, size, cv2.CV_32FC1)
        pixels, fractions = cv2.convertMaps(*floats, cv2.CV_16SC2, nninterpolation=is_nearest)
        return pixels, None if is_nearest else fractions

    def raw_points(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the points of the raw image that (n, 2) points of the rectified one show."""
        rays = np.column_stack((points, np.ones(len(points))))
        rays = rays @ np.linalg.inv(self.projection @ self.rotation).T
        if self.is_fisheye:  # whose maps have nothing behind the camera
            rays[rays[:, 2] <= 0] = np.nan
        project = cv2.fisheye.projectPoints if self.is_fisheye else cv2.projectPoints
        found, _ = project(rays[:, np.newaxis], np.zeros(3), np.zeros(3), self.matrix,
                           self.distortion if self.distortion.size else np.zeros(4))
        return np.asarray(found, np.float64).reshape(-1, 2)

    def rays(self, width: int, height: int) -> NDArray[np.float64]:
        """
        Return the directions of the pixels of the raw image.

        :returns: (h, w, 2) array with x and y for z = 1, in the optical frame of the camera; NaN
            where the camera model has none.
        """
        points = np.stack(np.meshgrid(np.arange(width, dtype=np.float64),
                                      np.arange(height, dtype=np.float64)), axis=-1)
        flat = points.reshape(-1, 1, 2)
        criteria = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 100, 1e-10)
        if self.is_fisheye:
            found = cv2.fisheye.undistortPoints(flat, self.matrix, self.distortion)
            found[np.abs(found).max(axis=2) > _NO_RAY] = np.nan
        elif self.distortion.size:
            undistort = getattr(cv2, 'undistortPointsIter', cv2.undistortPoints)
            found = undistort(flat, self.matrix, self.distortion, R=np.eye(3), P=np.eye(3),
                              criteria=criteria)
        else:
            found = (flat - self.matrix[:2, 2]) / self.matrix.diagonal()[:2]
        return np.asarray(found, np.float64).reshape(height, width, 2)


@dataclass(frozen=True, kw_only=True)
class RawView:
    """
    Places in the raw images of a camera, and in its rectified ones.

    Points are columns and rows. The first pixel has its middle at 0, 0.

    :param border: (n, 2) points around the part of the raw images that the rectified ones show,
        NaN for those that the camera model does not have; empty if both images are equal.
    """

    center: tuple[float, float]
    rectified_center: tuple[float, float]
    border: NDArray[np.float64]


def raw_view(camera_info: Any, width: int, height: int, steps: int = 64) -> RawView:
    """
    Return where the rectified images of a camera lie in its raw images.

    :param camera_info: sensor_msgs/CameraInfo of the raw images.
    :param width: width of the images in pixels.
    :param height: height of the images in pixels.
    :param steps: points of each side of the border.
    :raises RectificationError: the calibration cannot be used, or is not that of the images.
    """
    camera = read_camera_model(camera_info, width, height)
    part = np.linspace(0, 1, steps, endpoint=False)
    zero, one = np.zeros(steps), np.ones(steps)
    border = np.column_stack((np.concatenate((part, one, 1 - part, zero)),
                              np.concatenate((zero, part, one, 1 - part))))
    with np.errstate(all='ignore'):
        points = camera.raw_points(border * (width, height) - 0.5)
    return RawView(
        center=(camera.matrix[0, 2].item(), camera.matrix[1, 2].item()),
        rectified_center=(camera.projection[0, 2].item(), camera.projection[1, 2].item()),
        border=points[:0] if camera.is_rectified else points)


def read_camera_model(info: Any, width: int, height: int) -> CameraModel:
    """
    Check a calibration, and convert it to the pixels of its images.

    Binning and ROI change the pixels as in ``PinholeCameraModel`` of image_geometry.

    :raises RectificationError: the calibration cannot be used, or is not that of such images.
    """
    offset, scale = _check_size(info, width, height)
    matrix, rotation = (np.array(field, np.float64).reshape(3, 3) for field in (info.k, info.r))
    projection = np.array(info.p, np.float64).reshape(3, 4)[:, :3]
    if not matrix.any():
        raise RectificationError('the camera_info has no calibration, because its K is zero: '
                                 'calibrate the camera, for example with img_calibrate')
    distortion = _read_distortion(info)
    for name, values in (('K', matrix), ('R', rotation), ('P', projection), ('D', distortion)):
        if not np.isfinite(values).all():
            raise RectificationError(f'{name} of the camera_info has the value '
                                     f'{values[~np.isfinite(values)][0]}: give finite numbers')
    if not rotation.any():  # not set, as in many simulators
        rotation = np.eye(3)
    if not (projection.any() or distortion.size):
        projection = matrix.copy()
    for name, values in (('K', matrix), ('P', projection)):
        if min(values[0, 0], values[1, 1]) <= 0:
            raise RectificationError(
                f'{name} of the camera_info has the focal lengths {values[0, 0]:g} and '
                f'{values[1, 1]:g}: give numbers above 0')
        values[:2, 2] -= offset
        values[:2] *= scale[:, np.newaxis]
    if not _is_invertible(projection, rotation):
        raise RectificationError('P and R of the camera_info cannot be inverted: give a rotation '
                                 'as R, for example the identity, and 0 0 1 0 as last row of P')
    return CameraModel(matrix=matrix, distortion=distortion, rotation=rotation,
                       projection=projection, is_fisheye=info.distortion_model == _FISHEYE)


def _check_size(
    info: Any, width: int, height: int,
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the offset of an image in pixels of the sensor, and the scale that follows."""
    roi = info.roi
    binning = max(1, info.binning_x), max(1, info.binning_y)
    is_whole = not (roi.x_offset or roi.y_offset or roi.width or roi.height)
    sides = (info.width, info.height) if is_whole else (roi.width, roi.height)
    expected = [side // step for side, step in zip(sides, binning, strict=True)]
    rounded_up = [-(-side // step) for side, step in zip(sides, binning, strict=True)]
    described = f'{expected[0]}x{expected[1]} pixels'
    if not is_whole:
        described += f', its ROI in {info.width}x{info.height}'
    if max(binning) > 1:
        described += f', with a binning of {binning[0]}x{binning[1]}'
    if width not in (expected[0], rounded_up[0]) or height not in (expected[1], rounded_up[1]):
        raise RectificationError(f'the image has {width}x{height} pixels, but its camera_info is '
                                 f'for {described}: publish the calibration of this size')
    if not 1 <= min(width, height) <= max(width, height) <= _MAX_SIDE:
        raise RectificationError(f'the image has {width}x{height} pixels: an image with 1 to '
                                 f'{_MAX_SIDE} pixels a side can be rectified')
    return np.array([roi.x_offset, roi.y_offset], np.float64), 1 / np.array(binning, np.float64)


def _read_distortion(info: Any) -> NDArray[np.float64]:
    """Return the coefficients of the distortion, none if there is no distortion."""
    coefficients = np.array(info.d, np.float64)
    model = info.distortion_model
    is_zero = not coefficients.any()
    if model not in _MODELS:
        if is_zero:
            return coefficients[:0]
        raise RectificationError(
            f"the distortion model '{printable(model, _MAX_NAME)}' of the camera_info is unknown: "
            f'give {", ".join(_MODELS)}')
    while coefficients.size not in _MODELS[model] and not coefficients[-1:].any() and (
            coefficients.size):
        coefficients = coefficients[:-1]
    if len(coefficients) not in _MODELS[model]:
        raise RectificationError(
            f'D of the camera_info has {len(coefficients)} coefficients: give '
            f'{", ".join(map(str, _MODELS[model]))} for {model}')
    if model == _FISHEYE:  # which is no pinhole camera, even if all are zero
        return coefficients if coefficients.size else np.zeros(4)
    return coefficients[:0] if is_zero else coefficients


def _is_invertible(projection: NDArray[np.float64], rotation: NDArray[np.float64]) -> bool:
    with np.errstate(all='ignore'):
        try:
            product = projection @ rotation
            return bool(np.isfinite([product, np.linalg.inv(product)]).all())
        except np.linalg.LinAlgError:
            return False
