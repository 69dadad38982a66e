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

"""Checks of existing calibrations with new views."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from opencv_tools.calibration.boards import CalibrationError, parse_board
from opencv_tools.calibration.camera_file import StoredCamera
from opencv_tools.calibration.check import check_camera, stored_lens
from opencv_tools.calibration.detection import Detection
import pytest
from rendered_boards import noisy_view, poses, small_camera

BOARD = parse_board('chessboard:9x6:25mm')
CAMERA = small_camera()
STORED = StoredCamera(
    width=480, height=360, distortion_model='plumb_bob', d=tuple(CAMERA.d.tolist()),
    k=tuple(CAMERA.k.ravel().tolist()), r=(1.0, 0, 0, 0, 1.0, 0, 0, 0, 1.0),
    p=(420.0, 0, 243.0, 0, 0, 421.0, 176.0, 0, 0, 0, 1.0, 0))


def views(count: int = 10, noise: float = 0.1) -> list[Detection]:
    return [noisy_view(BOARD, CAMERA, pose, noise, number)
            for number, pose in enumerate(poses(BOARD, CAMERA, count, 5))]


@pytest.mark.parametrize('count', [1, 2, 10])
def test_good_calibration(count: int) -> None:
    result = check_camera(STORED, views(count))
    assert (result.word, result.reason) == ('good', '')
    assert 0.05 < result.best <= result.rms < 0.2
    assert result.view_errors.shape == (count,) and result.cell_errors.shape == (6, 8)


@pytest.mark.parametrize(('field', 'index', 'change'), [
    ('k', 0, 25.0), ('k', 2, 20.0), ('d', 0, 0.1), ('d', 2, 0.02)])
def test_degraded_calibration(field: str, index: int, change: float) -> None:
    values = [*getattr(STORED, field)]
    values[index] += change
    result = check_camera(replace(STORED, **{field: tuple(values)}), views())
    assert result.word == 'degraded' and result.rms > 1.5 * result.best
    assert result.reason.startswith(f'the error is {result.rms:.2f} pixels, that of a new ')
    assert 'it is largest in the ' in result.reason
    assert result.reason.endswith(f'{np.nanmax(result.cell_errors):.2f} pixels: '
                                  'calibrate the camera again')


def test_other_size() -> None:
    with pytest.raises(CalibrationError, match=r'have 480x360 pixels, but .* for 640x480: give'):
        check_camera(replace(STORED, width=640, height=480), views(1))
    with pytest.raises(CalibrationError, match='views with the board: 0; give 1 to 100'):
        check_camera(STORED, [])


@pytest.mark.parametrize('fields', [
    {'distortion_model': 'mei'}, {'d': (0.0,) * 8}, {'k': (0.0,) * 9}])
def test_unknown_lens(fields: dict[str, object]) -> None:
    with pytest.raises(CalibrationError, match='give plumb_bob with 5, rational_polynomial with'):
        stored_lens(replace(STORED, **fields))


def test_short_distortion() -> None:
    lens = stored_lens(replace(STORED, d=(-0.1, 0.02)))
    assert lens.d.tolist() == [-0.1, 0.02, 0, 0, 0]
