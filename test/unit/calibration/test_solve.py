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

"""Calibrations from views with a known lens."""

from __future__ import annotations

from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from multiprocessing import get_context
import pickle

import cv2
import numpy as np
from opencv_tools.calibration.boards import CalibrationError, parse_board
from opencv_tools.calibration.detection import BoardFinder, Detection
from opencv_tools.calibration.least_squares import EQUIDISTANT, PLUMB_BOB, RATIONAL
from opencv_tools.calibration.solve import Calibration, projection, solve
from opencv_tools.calibration.verdict import judge
from opencv_tools.calibration.views import cell_grid
import pytest
from rendered_boards import (
    Camera, facing, fisheye_camera, needs_markers, noisy_view, poses, small_camera)
from waiting import LONGEST_SECONDS

BOARD = parse_board('chessboard:9x6:25mm')
CAMERA = small_camera()
FISHEYE = fisheye_camera(480, 360)
RATIONAL_CAMERA = Camera(
    (480, 360), CAMERA.k, [0.2, -0.05, 0.0004, 0.0003, 0.01, 0.45, 0.03, 0.02])


def views(camera: Camera, count: int, noise: float = 0.05, seed: int = 1,
          bend: float = 0.0) -> list[Detection]:
    return [noisy_view(BOARD, camera, pose, noise, seed * 100 + number, bend)
            for number, pose in enumerate(poses(BOARD, camera, count, seed))]


def errors_of_model(result: Calibration, camera: Camera) -> np.ndarray:
    """Return the errors of the model in pixels for rays over the image."""
    width, height = camera.size
    grid = np.stack(np.meshgrid(np.linspace(0, width, 17), np.linspace(0, height, 13)), axis=2)
    pixels = grid.reshape(-1, 2)
    flat = camera.rays(pixels)
    seen = np.linalg.norm(flat, axis=1) < 4  # a board cannot be seen farther from the axis
    rays, pixels = np.insert(flat[seen], 2, 1.0, axis=1)[:, None], pixels[seen]
    project = cv2.fisheye.projectPoints if camera.is_fisheye else cv2.projectPoints
    found = project(rays, np.zeros(3), np.zeros(3), result.k, result.d)[0][:, 0]
    return np.linalg.norm(found - pixels, axis=1)


@pytest.mark.parametrize(('model', 'camera', 'count'), [
    (PLUMB_BOB, CAMERA, 5), (RATIONAL, RATIONAL_CAMERA, 8), (EQUIDISTANT, FISHEYE, 4)])
def test_lens_without_noise(model: str, camera: Camera, count: int) -> None:
    result = solve(views(camera, 10, 0.0), model)
    assert (result.model, result.size, result.d.shape) == (model, camera.size, (count,))
    assert result.rms < 1e-3 and result.held_out < 1e-3
    assert errors_of_model(result, camera).mean() < 0.01
    np.testing.assert_allclose(result.k, camera.k, atol=0.02)
    assert result.p.shape == (3, 4) and not result.p[:, 3].any()


@pytest.mark.thorough
@pytest.mark.parametrize(('model', 'camera'), [(PLUMB_BOB, CAMERA), (EQUIDISTANT, FISHEYE)])
def test_standard_deviations_cover_the_truth(model: str, camera: Camera) -> None:
    truth = [camera.k[0, 0], camera.k[1, 1], camera.k[0, 2], camera.k[1, 2], *camera.d]
    scores = []
    for seed in range(12):
        result = solve(views(camera, 10, 0.2, seed), model)
        found = [result.k[0, 0], result.k[1, 1], result.k[0, 2], result.k[1, 2], *result.d]
        scores.append((np.array(found) - truth) / result.deviations)
    assert np.abs(scores).max() < 4
    assert 0.6 < np.sqrt(np.mean(np.square(scores))) < 1.5


def test_same_result_as_opencv() -> None:
    seen = views(CAMERA, 6)
    result = solve(seen)
    rms, k, d, *_ = cv2.calibrateCamera(
        [view.points for view in seen], [view.corners for view in seen], CAMERA.size, None, None)
    assert result.rms == pytest.approx(rms, rel=1e-4)
    np.testing.assert_allclose(result.k, k, atol=0.01)
    np.testing.assert_allclose(result.d, d.reshape(-1)[:5], atol=1e-3)


def test_errors_of_views_and_cells() -> None:
    seen = views(CAMERA, 8)
    noise = np.random.default_rng(1).normal(0, 0.5, seen[3].corners.shape)
    seen[3] = replace(seen[3], corners=(seen[3].corners + noise).astype(np.float32))
    result = solve(seen)
    assert result.view_errors.shape == (8,) and np.argmax(result.view_errors) == 3
    assert result.cell_errors.shape == cell_grid(CAMERA.size) == (6, 8)
    assert 0.03 < np.nanmedian(result.cell_errors) < 0.2
    assert 5 < np.nanmax(result.view_tilts) < 80


def test_wrong_view_is_dropped() -> None:
    seen = views(CAMERA, 12)
    mixed = np.random.default_rng(1).permutation(len(seen[5].corners))
    seen[5] = replace(seen[5], corners=seen[5].corners[mixed])
    result = solve(seen)
    assert np.flatnonzero(np.isnan(result.view_errors)).tolist() == [5]
    assert errors_of_model(result, CAMERA).mean() < 1.0


def test_wrong_corners_are_left_out() -> None:
    seen = views(CAMERA, 8)
    wrong = seen[5].corners.copy()
    wrong[3:6] += 12
    seen[5] = replace(seen[5], corners=wrong)
    result = solve(seen)
    assert np.isfinite(result.view_errors).all() and result.rms < 0.1


@pytest.mark.thorough
def test_bent_board() -> None:
    flat = solve(views(CAMERA, 20))
    bent = solve(views(CAMERA, 20, bend=0.25))
    assert flat.bend == 0
    assert 0.001 < bent.bend < 0.002  # 0.25 / m x (0.1 m)², less its mean
    assert bent.rms == pytest.approx(flat.rms, rel=0.05)
    assert errors_of_model(solve(views(CAMERA, 20, 0.0, bend=0.25)), CAMERA).max() < 0.05
    verdict = judge(bent)
    assert verdict.word == 'usable' and 'the board is not flat' in ' '.join(verdict.reasons)


def test_good_verdict() -> None:
    assert judge(solve(views(CAMERA, 12, 0.03))).reasons == ()


def test_verdicts_with_reasons() -> None:
    few = judge(solve(views(CAMERA, 6)))
    assert few.word == 'usable' and any('only 6 views' in reason for reason in few.reasons)
    noisy = judge(solve(views(CAMERA, 12, 2.0)))
    assert noisy.word == 'bad' and any('the error is 2.' in reason for reason in noisy.reasons)
    alike = [noisy_view(BOARD, CAMERA, facing(BOARD, CAMERA, x=0.01 * number), 0.05, number)
             for number in range(12)]
    verdict = judge(solve(alike))
    assert verdict.word != 'good'
    assert any('all views are alike' in reason for reason in verdict.reasons)
    assert any('no view has corners in ' in reason for reason in verdict.reasons)


@pytest.mark.parametrize(('count', 'model', 'reason'), [
    (3, PLUMB_BOB, 'views with the board: 3; give 4 to 100'),
    (0, PLUMB_BOB, 'views with the board: 0'),
    (101, PLUMB_BOB, 'views with the board: 101'),
    (8, 'mei', "the model is 'mei': give one of plumb_bob")])
def test_refused_views_and_models(count: int, model: str, reason: str) -> None:
    seen = views(CAMERA, 4) * 26
    with pytest.raises(CalibrationError, match=reason):
        solve(seen[:count], model)


def test_images_of_different_sizes() -> None:
    seen = views(CAMERA, 6)
    seen[2] = replace(seen[2], size=(640, 480))
    with pytest.raises(CalibrationError, match='different sizes: 480x360, 640x480; give images'):
        solve(seen)


@pytest.mark.parametrize('kind', ['same', 'random', 'far'])
def test_views_without_information(kind: str) -> None:
    seen = views(CAMERA, 4)
    if kind == 'same':
        seen = seen[:1] * 4
    if kind == 'random':
        random = np.random.default_rng(2)
        seen = [replace(view, corners=random.uniform(0, 300, view.corners.shape).astype(
            np.float32)) for view in seen]
    if kind == 'far':
        seen = [replace(view, corners=(view.corners * 1e-4 + 100).astype(np.float32))
                for view in seen]
    try:
        verdict = judge(solve(seen))
    except CalibrationError as err:
        assert 'give' in str(err)
    else:
        assert verdict.word != 'good' and verdict.reasons


@pytest.mark.process
def test_solution_in_another_process() -> None:
    seen = pickle.loads(pickle.dumps(views(CAMERA, 4)))
    with ProcessPoolExecutor(1, mp_context=get_context('spawn')) as pool:
        result = pool.submit(solve, seen, PLUMB_BOB).result(timeout=LONGEST_SECONDS)
    np.testing.assert_allclose(result.k, solve(seen).k)


@pytest.mark.parametrize(('model', 'camera'), [(PLUMB_BOB, CAMERA), (EQUIDISTANT, FISHEYE)])
def test_rectified_image_has_no_border(model: str, camera: Camera) -> None:
    p = projection(camera.k, camera.d, model, camera.size)
    width, height = camera.size
    edge = np.array([(x, y) for x in (0, width / 2, width - 1) for y in (0, height / 2, height - 1)
                     if (x, y) != (width / 2, height / 2)])
    rays = np.insert((edge - p[:2, 2]) / np.diag(p[:, :3])[:2], 2, 1.0, axis=1)[:, None]
    project = cv2.fisheye.projectPoints if model == EQUIDISTANT else cv2.projectPoints
    seen = project(rays, np.zeros(3), np.zeros(3), camera.k, camera.d)[0][:, 0]
    assert (seen > -2).all() and (seen < np.array(camera.size) + 1).all()


@pytest.mark.thorough
@needs_markers
def test_lens_of_rendered_images() -> None:
    board = parse_board('charuco:7x6:30mm:22mm:4x4_50')
    finder = BoardFinder(board)
    seen = [finder.find(CAMERA.see(board, pose, seed=number))
            for number, pose in enumerate(poses(board, CAMERA, 12, 3))]
    assert all(view.is_found for view in seen)
    result = solve(seen)
    errors = errors_of_model(result, CAMERA)
    assert result.rms < 0.06 and errors.mean() < 0.2 and errors.max() < 1.0
