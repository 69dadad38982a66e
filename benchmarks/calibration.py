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

"""Precision of calibrations from rendered boards, against the way of camera_calibration."""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from pathlib import Path
import sys
import time

import cv2
from figures import add_json_option, Figure, print_figures
import numpy as np
from numpy.typing import NDArray
from opencv_tools.calibration.boards import Board, parse_board
from opencv_tools.calibration.detection import BoardFinder, Detection
from opencv_tools.calibration.least_squares import EQUIDISTANT, PLUMB_BOB
from opencv_tools.calibration.solve import solve
from opencv_tools.calibration.stereo import solve_stereo

ROOT = Path(__file__).resolve().parent.parent
sys.path.append(str(ROOT / 'test' / 'support'))
from rendered_boards import Camera, fisheye_camera, noisy_view  # noqa: E402, I100
from rendered_boards import Pose, poses, wide_camera  # noqa: E402

VIEWS = 40
SEEDS = 100
# A board with the same squares, so that both ways see the same corners.
BOARDS = {'ChArUco': 'charuco:11x8:30mm:22mm:5x5_250', 'AprilGrid': 'aprilgrid:6x6:30mm:9mm:36h11',
          'chessboard': 'chessboard:10x7:30mm'}

Floats = NDArray[np.float64]


def model_errors(camera: Camera, k: Floats, d: Floats) -> Floats:
    """Return the errors of a lens in pixels, at places all over the image."""
    width, height = camera.size
    places = np.stack(np.meshgrid(np.linspace(0, width - 1, 33), np.linspace(0, height - 1, 19)),
                      axis=2).reshape(-1, 2)
    rays = camera.rays(places)
    near = np.linalg.norm(rays, axis=1) < 4  # no board is seen farther from the axis
    points = np.insert(rays[near], 2, 1.0, axis=1)[:, None]
    project = cv2.fisheye.projectPoints if camera.is_fisheye else cv2.projectPoints
    found = project(points, np.zeros(3), np.zeros(3), k, d)[0][:, 0]
    return np.linalg.norm(found - places[near], axis=1)


def classic_view(image: NDArray[np.uint8], board: Board) -> Floats | None:
    """Return the corners of a chessboard as camera_calibration finds them; None without."""
    size = (board.columns, board.rows)
    found, corners = cv2.findChessboardCorners(
        image, size, flags=cv2.CALIB_CB_ADAPTIVE_THRESH | cv2.CALIB_CB_NORMALIZE_IMAGE
        | cv2.CALIB_CB_FAST_CHECK)
    if not found:
        return None
    grid = corners.reshape(board.rows, board.columns, 2)
    least = min(float(np.linalg.norm(np.diff(grid, axis=axis), axis=2).min()) for axis in (0, 1))
    radius = int(np.ceil(least * 0.5))
    return cv2.cornerSubPix(image, corners, (radius, radius), (-1, -1),
                            (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_MAX_ITER, 30, 0.1))


def classic_errors(images: list[NDArray[np.uint8]], board: Board, camera: Camera) -> Floats:
    """Return the errors of the lens that camera_calibration finds."""
    found = [one for one in (classic_view(image, board) for image in images) if one is not None]
    points = [board.corners()] * len(found)
    _, k, d, *_ = cv2.calibrateCamera(points, found, camera.size, None, None)
    return model_errors(camera, k, d)


def views_of(board: Board, camera: Camera, count: int, seed: int,
             is_whole: bool = False) -> tuple[list[NDArray[np.uint8]], list[Detection], float]:
    """Return rendered images, the boards in them, and the seconds of the search of an image."""
    finder = BoardFinder(board)
    images = [camera.see(board, pose, seed=seed * 1000 + number)
              for number, pose in enumerate(poses(board, camera, count, seed, is_whole))]
    began = time.perf_counter()
    found = [finder.find(image) for image in images]
    seconds = (time.perf_counter() - began) / count
    return images, [one for one in found if one.is_found], seconds


def lens_figures(name: str, camera: Camera, kind: str, model: str) -> Iterator[Figure]:
    """Measure the views that are found, and the errors of the lens over the image."""
    board = parse_board(BOARDS[kind])
    _, found, seconds = views_of(board, camera, VIEWS, seed=1, is_whole=kind == 'chessboard')
    result = solve(found, model)
    errors = model_errors(camera, result.k, result.d)
    title = f'{kind}, {name} lens'
    yield figure(f'{title}: views that are found of {VIEWS}', len(found), '', VIEWS, above=True)
    yield Figure('calibration', f'{title}: search of an image', seconds * 1000, 'ms')
    yield figure(f'{title}: mean error of the lens', errors.mean(), 'px', 0.1)
    yield figure(f'{title}: largest error of the lens', errors.max(), 'px', 1.0)


def figure(name: str, value: float, unit: str, goal: float, above: bool = False) -> Figure:
    """Return a figure with a goal that is a limit."""
    met = value >= goal if above else value <= goal
    return Figure('calibration', name, float(value), unit,
                  f'at {"least" if above else "most"} {goal:g}', bool(met))


def comparison() -> Iterator[Figure]:
    """Compare the errors of the lens with those of camera_calibration from the same images."""
    board, camera = parse_board(BOARDS['chessboard']), wide_camera()
    ratios = []
    for seed in range(2, 5):
        images, found, _ = views_of(board, camera, VIEWS, seed, is_whole=True)
        result = solve(found)
        ratios.append(model_errors(camera, result.k, result.d).mean()
                      / classic_errors(images, board, camera).mean())
    yield figure('chessboard: mean error of the lens against camera_calibration',
                 float(np.median(ratios)), 'x', 0.5)


def deviations() -> Iterator[Figure]:
    """Measure how far the truth is from the result, in standard deviations."""
    board = parse_board(BOARDS['chessboard'])
    for camera, model in ((wide_camera(), PLUMB_BOB), (fisheye_camera(), EQUIDISTANT)):
        truth = np.array([camera.k[0, 0], camera.k[1, 1], camera.k[0, 2], camera.k[1, 2],
                          *camera.d])
        scores = []
        for seed in range(SEEDS):
            seen = [noisy_view(board, camera, pose, 0.1, seed * 100 + number)
                    for number, pose in enumerate(poses(board, camera, 15, seed))]
            result = solve([one for one in seen if len(one.ids) > 8], model)
            values = [*result.k[(0, 1, 0, 1), (0, 1, 2, 2)], *result.d]
            scores.append((values - truth) / result.deviations)
        yield figure(f'{model}: largest distance of the truth in standard deviations, '
                     f'{SEEDS} seeds', np.abs(scores).max(), '', 4.0)
        yield Figure('calibration', f'{model}: root mean square of these distances',
                     float(np.sqrt(np.mean(np.square(scores)))), '')


def stereo() -> Iterator[Figure]:
    """Measure the error of the baseline of two cameras."""
    board, camera = parse_board(BOARDS['ChArUco']), wide_camera()
    turn, place = cv2.Rodrigues(np.array([0.01, -0.03, 0.005]))[0], np.array([-0.12, 0.002, 0.001])
    finder, pairs = BoardFinder(board), []
    for number, pose in enumerate(poses(board, camera, 20, 5)):
        other = Pose(cv2.Rodrigues(turn @ cv2.Rodrigues(pose.rotation)[0])[0][:, 0],
                     turn @ pose.translation + place)
        pair = [finder.find(camera.see(board, one, seed=number * 2 + side))
                for side, one in enumerate((pose, other))]
        if all(one.is_found for one in pair):
            pairs.append((pair[0], pair[1]))
    left, right = (solve(views) for views in zip(*pairs))
    result = solve_stereo(pairs, left, right)
    error = abs(result.baseline / float(np.linalg.norm(place)) - 1) * 100
    yield figure('ChArUco: error of the baseline of two cameras', error, '%', 0.5)


def figures() -> Iterator[Figure]:
    """Measure everything."""
    yield from lens_figures('wide', wide_camera(), 'ChArUco', PLUMB_BOB)
    yield from lens_figures('wide', wide_camera(), 'AprilGrid', PLUMB_BOB)
    yield from lens_figures('wide', wide_camera(), 'chessboard', PLUMB_BOB)
    yield from lens_figures('fisheye', fisheye_camera(), 'ChArUco', EQUIDISTANT)
    yield from comparison()
    yield from deviations()
    yield from stereo()


def main() -> int:
    """Print the figures; the exit status is 1 when a goal is missed."""
    parser = argparse.ArgumentParser(description=__doc__)
    add_json_option(parser)
    found = print_figures(figures(), parser.parse_args().json)
    return int(any(one.met is False for one in found))


if __name__ == '__main__':
    sys.exit(main())
