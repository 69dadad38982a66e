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

"""Solution of a calibration in a process, and files of results."""

from __future__ import annotations

import asyncio
from pathlib import Path

import numpy as np
from opencv_tools.calibration.boards import CalibrationError, parse_board
from opencv_tools.calibration.camera_file import read_camera
from opencv_tools.calibration.detection import Detection
from opencv_tools.calibration.least_squares import PLUMB_BOB
from opencv_tools.calibration.solve import solve
from opencv_tools.viewer.calibrate.routes import camera_file
from opencv_tools.viewer.calibrate.solver import Solver
import pytest
from rendered_boards import noisy_view, poses, wide_camera
from waiting import pause_loop

BOARD = parse_board('charuco:9x6:40mm:30mm:4x4_50')


@pytest.fixture(scope='module')
def views() -> list[Detection]:
    """Return boards at different places."""
    camera = wide_camera(640, 360)
    return [noisy_view(BOARD, camera, pose, noise=0.05, seed=seed) for seed, pose in enumerate(
        poses(BOARD, camera, 6, seed=4, is_whole=True))]


@pytest.mark.thorough
@pytest.mark.process
def test_solution_of_a_process(views: list[Detection]) -> None:
    found, verdict = asyncio.run(Solver().solve(views, PLUMB_BOB))
    expected = solve(views)
    np.testing.assert_allclose(found.k, expected.k)
    assert verdict.word in ('good', 'usable', 'bad')


@pytest.mark.process
def test_refusal_of_a_process(views: list[Detection]) -> None:
    with pytest.raises(CalibrationError, match='the model is'):
        asyncio.run(Solver().solve(views, 'nothing'))


@pytest.mark.process
def test_solution_that_is_ended(views: list[Detection]) -> None:
    async def act() -> None:
        solver = Solver()
        task = asyncio.ensure_future(solver.solve(views, PLUMB_BOB))
        while not solver.is_running:
            await pause_loop()
        solver.close()
        with pytest.raises(CalibrationError, match='the solution was ended'):
            await task

    asyncio.run(act())


def test_file_of_a_result(views: list[Detection], tmp_path: Path) -> None:
    found = solve(views)
    path = tmp_path / 'camera.yaml'
    path.write_bytes(camera_file(found, 'front'))
    stored = read_camera(path)
    assert (stored.width, stored.height, stored.distortion_model) == (640, 360, PLUMB_BOB)
    assert stored.k == tuple(found.k.ravel()) and stored.d == tuple(found.d)
