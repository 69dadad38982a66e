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

"""Pose and rectification of two cameras."""

from __future__ import annotations

from dataclasses import replace
import itertools

import cv2
import numpy as np
from opencv_tools.calibration.boards import CalibrationError, parse_board
from opencv_tools.calibration.detection import Detection
from opencv_tools.calibration.least_squares import EQUIDISTANT, PLUMB_BOB
from opencv_tools.calibration.solve import Calibration, solve
from opencv_tools.calibration.stereo import solve_stereo
import pytest
from rendered_boards import Camera, fisheye_camera, noisy_view, Pose, poses, small_camera

BOARD = parse_board('chessboard:9x6:25mm')
CAMERA = small_camera()
FISHEYE = fisheye_camera(480, 360)
ROTATION = np.array([0.01, -0.04, 0.02])
PLACE = np.array([-0.1, 0.003, 0.002])

Pairs = list[tuple[Detection, Detection]]


def pairs_of(camera: Camera, place: np.ndarray = PLACE, noise: float = 0.05) -> Pairs:
    """Return views of a left and a right camera of the same kind."""
    rotation = cv2.Rodrigues(ROTATION)[0]
    found = []
    for number, pose in enumerate(poses(BOARD, camera, 14, 7)):
        turned = cv2.Rodrigues(rotation @ cv2.Rodrigues(pose.rotation)[0])[0][:, 0]
        other = Pose(turned, rotation @ pose.translation + place)
        found.append((noisy_view(BOARD, camera, pose, noise, number),
                      noisy_view(BOARD, camera, other, noise, number + 100)))
    return [pair for pair in found if min(len(one.ids) for one in pair) > 8]


def lenses(pairs: Pairs, model: str) -> list[Calibration]:
    return [solve(views, model) for views in zip(*pairs)]


@pytest.mark.parametrize(('model', 'camera'), [(PLUMB_BOB, CAMERA), (EQUIDISTANT, FISHEYE)])
def test_pose_and_rectification(model: str, camera: Camera) -> None:
    pairs = pairs_of(camera)
    result = solve_stereo(pairs, *lenses(pairs, model))
    baseline = float(np.linalg.norm(PLACE))
    assert result.baseline == pytest.approx(baseline, rel=0.005)
    assert result.rms < 0.2 and result.pairs >= 10
    np.testing.assert_allclose(result.translation, PLACE, atol=0.001)
    np.testing.assert_allclose(result.rotation, cv2.Rodrigues(ROTATION)[0], atol=0.005)
    left, right = result.left, result.right
    assert left.p[0, 3] == 0
    assert right.p[0, 3] == pytest.approx(-right.p[0, 0] * result.baseline, rel=1e-6)
    np.testing.assert_allclose(left.p[:, :3], right.p[:, :3])
    # The same point is in the same row of both rectified images.
    points = np.random.default_rng(1).uniform((-0.3, -0.2, 0.6), (0.3, 0.2, 1.5), (50, 3))
    first = points @ left.r.T @ left.p[:, :3].T
    second = (points @ cv2.Rodrigues(ROTATION)[0].T + PLACE) @ right.r.T @ right.p[:, :3].T
    rows = [one[:, 1] / one[:, 2] for one in (first, second)]
    np.testing.assert_allclose(rows[0], rows[1], atol=0.6)


@pytest.mark.thorough
def test_wrong_pair_is_left_out() -> None:
    pairs = pairs_of(CAMERA)
    found = lenses(pairs, PLUMB_BOB)
    wrong = [*pairs[1:], (pairs[0][0], pairs[1][1])]  # the right image is of another time
    result = solve_stereo(wrong, found[0], found[1])
    assert result.pairs == len(pairs) - 1
    assert result.baseline == pytest.approx(float(np.linalg.norm(PLACE)), rel=0.01)


@pytest.mark.quick_cases(1)
@pytest.mark.parametrize(('place', 'reason'), [
    ((0.1, 0.0, 0.0), 'the left camera is at the right: swap the two sources'),
    ((0.0, -0.1, 0.0), 'one camera is above the other one: turn the images')])
def test_refused_places(place: tuple[float, float, float], reason: str) -> None:
    pairs = pairs_of(CAMERA, np.array(place))
    with pytest.raises(CalibrationError, match=reason):
        solve_stereo(pairs, *lenses(pairs[:5], PLUMB_BOB))


@pytest.mark.thorough
def test_pairs_of_different_times() -> None:
    pairs = pairs_of(CAMERA)
    found = lenses(pairs, PLUMB_BOB)
    late = [(left, right) for (left, _), (_, right) in itertools.pairwise(pairs)]
    with pytest.raises(CalibrationError, match='the pairs do not fit each other, with an error'):
        solve_stereo(late, *found)
    with pytest.raises(CalibrationError, match='mm apart: give the images of two cameras at two'):
        solve_stereo([(left, left) for left, _ in pairs], found[0], found[0])


def test_refused_pairs() -> None:
    pairs = pairs_of(CAMERA)
    left, right = lenses(pairs[:5], PLUMB_BOB)
    with pytest.raises(CalibrationError, match='3 pairs of images show the same corners'):
        solve_stereo(pairs[:3], left, right)
    apart = [(replace(one, ids=one.ids + 1000), other) for one, other in pairs]
    with pytest.raises(CalibrationError, match='0 pairs of images'):
        solve_stereo(apart, left, right)
    with pytest.raises(CalibrationError, match='right one plumb_bob with 640x480: give'):
        solve_stereo(pairs, left, replace(right, size=(640, 480)))
