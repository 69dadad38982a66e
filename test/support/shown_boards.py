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

"""Pictures of a board that is held still at different places before a camera with a known lens."""

from __future__ import annotations

import os
from pathlib import Path

import cv2
import numpy as np
from opencv_tools.calibration.boards import parse_board
from opencv_tools.calibration.camera_file import StoredCamera, write_camera
from opencv_tools.calibration.detection import Detection
from rendered_boards import Camera, noisy_view, poses, wide_camera

BOARD = 'charuco:9x6:40mm:30mm:4x4_50'
RATE = 12.0  # Hz
_STILL = 8  # pictures of each place
_SEED = 4


def held_board(folder: Path, count: int, size: tuple[int, int] = (640, 360),
               suffix: str = '.png') -> Camera:
    """
    Write pictures of the board into a folder, for a publisher of ``RATE``.

    :param folder: folder to create.
    :param count: number of places.
    :param size: width and height of the pictures.
    :param suffix: suffix of the files, which is their format.
    :returns: the camera.
    """
    folder.mkdir()
    camera, board = wide_camera(*size), parse_board(BOARD)
    for place, pose in enumerate(poses(board, camera, count, _SEED)):
        first = folder / f'{place * _STILL:05d}{suffix}'
        cv2.imwrite(str(first), camera.see(board, pose, seed=place))
        for number in range(place * _STILL + 1, (place + 1) * _STILL):
            os.link(first, folder / f'{number:05d}{suffix}')
    return camera


def bend(found: Detection) -> float:
    """Return the largest distance of a corner from the line of its row or column in pixels."""
    largest = 0.0
    for axis in (0, 1):
        for place in np.unique(found.points[:, axis]):
            corners = found.corners[found.points[:, axis] == place].astype(float)
            away = corners - corners.mean(axis=0)
            largest = max(largest, float(np.abs(away @ np.linalg.svd(away)[2][1]).max()))
    return largest


def known_bend(camera: Camera, count: int) -> float:
    """Return the largest bend in the pictures of ``held_board``, by the lens of the camera."""
    board = parse_board(BOARD)
    return max(bend(noisy_view(board, camera, pose))
               for pose in poses(board, camera, count, _SEED))


def write_former(path: Path, focal_length: float, size: tuple[int, int] = (640, 360)) -> str:
    """Write the calibration that a camera has before another one, and return its URL."""
    width, height = size
    row, last = (focal_length, 0.0, width / 2), (0.0, 0.0, 1.0)
    k = (*row, 0.0, focal_length, height / 2, *last)
    write_camera(path, StoredCamera(
        width=width, height=height, distortion_model='plumb_bob', d=(0.0,) * 5, k=k,
        r=(1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0),
        p=(*k[:3], 0.0, *k[3:6], 0.0, *last, 0.0)), 'former')
    return f'file://{path}'
