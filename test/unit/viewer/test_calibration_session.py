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

"""A calibration in progress, without a server and mostly without pictures."""

from __future__ import annotations

from collections.abc import Iterator
from copy import deepcopy
from functools import cache
import json

import numpy as np
from opencv_tools.calibration.boards import CalibrationError, parse_board
from opencv_tools.calibration.detection import Detection, MIRRORED, NO_BOARD, no_board
from opencv_tools.calibration.solve import Calibration, solve
from opencv_tools.calibration.verdict import judge
from opencv_tools.viewer.calibrate.live import session_json, sighting_json
from opencv_tools.viewer.calibrate.session import Result, Session
import pytest
from rendered_boards import needs_markers, noisy_view, poses, wide_camera

pytestmark = needs_markers

CHARUCO = 'charuco:9x6:40mm:30mm:4x4_50'
SIZE = (640, 360)


@cache
def detections(size: tuple[int, int] = SIZE) -> list[Detection]:
    """Return boards at different places, as exact as those that are found in pictures."""
    board, camera = parse_board(CHARUCO), wide_camera(*size)
    return [noisy_view(board, camera, pose, noise=0.05, seed=seed)
            for seed, pose in enumerate(poses(board, camera, 12, seed=4, is_whole=True))]


@pytest.fixture
def session() -> Iterator[Session]:
    """Create a session with a board."""
    created = Session()
    created.choose(CHARUCO)
    yield created


def hold(session: Session, detection: Detection, seconds: float) -> bool:
    """Show a still board in two images; return whether a view was taken."""
    session.look(detection, seconds)
    wanted = session.look(detection, seconds + 0.1)
    if wanted:
        session.take(detection)
    return wanted


def fill(session: Session) -> None:
    """Take a view of each picture that is not like another one."""
    for number, detection in enumerate(detections()):
        hold(session, detection, 10.0 * number)
    assert len(session.numbers) >= 10


@cache
def calibration() -> Calibration:
    """Return the calibration of all views that `fill` takes."""
    session = Session()
    session.choose(CHARUCO)
    fill(session)
    return solve(session.selection.detections)


def solved(session: Session) -> None:
    session.result = Result(calibration(), judge(calibration()), session.numbers)


def test_session_without_board() -> None:
    session = Session()
    assert session.hint == 'choose the board'
    assert json.loads(json.dumps(session_json(session), allow_nan=False))['views'] == []


def test_still_board_is_taken_once(session: Session) -> None:
    first = detections()[0]
    assert not session.look(first, 1.0)
    assert session.look(first, 1.1)
    session.take(first)
    assert session.numbers == (0,)
    assert session.sighting and session.sighting.capture == 'view 1 was taken'
    assert not session.look(first, 1.2)
    assert 'like another one' in session.sighting.capture


def test_moving_board_is_not_taken(session: Session) -> None:
    for number, detection in enumerate(detections()):
        assert not session.look(detection, number / 10)
    assert session.sighting and 'hold it still' in session.sighting.capture
    assert session.numbers == ()


def test_view_that_is_taken_by_hand(session: Session) -> None:
    first, second, *_ = detections()
    hold(session, first, 0.0)
    session.ask()
    assert not session.look(no_board(SIZE, NO_BOARD), 1.0)
    assert session.look(second, 1.1)  # the board moves
    session.take(second)
    session.ask()
    assert hold(session, second, 5.0) and session.numbers == (0, 1, 2)  # it is like another view
    assert not hold(session, second, 10.0)


def test_view_by_hand_needs_a_capture(session: Session) -> None:
    with pytest.raises(CalibrationError, match='choose the board'):
        Session().ask()
    fill(session)
    session.ask()
    session.begin_solution()
    with pytest.raises(CalibrationError, match='take more views'):
        session.ask()
    session.resume()
    assert not session.look(detections()[0], 900.0)


def test_blurred_picture_is_not_taken(session: Session) -> None:
    assert hold(session, detections()[0], 0.0)
    second = detections()[1]
    session.take(Detection(size=second.size, corners=second.corners, points=second.points,
                           ids=second.ids, edge_width=20.0))
    assert session.numbers == (0,)
    assert session.sighting and 'less sharp' in session.sighting.capture


def test_whole_calibration(session: Session) -> None:
    fill(session)
    solved(session)
    found = session_json(session)
    assert json.loads(json.dumps(found, allow_nan=False)) == {
        **found, 'size': list(SIZE)}
    assert len(found['views']) == len(session.numbers)
    assert all(view['error'] < 0.5 and not view['dropped'] for view in found['views'])
    truth = wide_camera(*SIZE).k
    fx = found['result']['lens'][0]
    assert fx['name'] == 'fx' and abs(fx['value'] - truth[0, 0]) < 3
    assert np.shape(found['cells']) == np.shape(found['result']['cells'])
    assert not found['stale']
    session.delete(session.numbers[-1])
    assert session_json(session)['stale']


def test_view_that_was_dropped_has_no_error(session: Session) -> None:
    fill(session)
    changed = deepcopy(calibration())
    changed.view_errors[0] = changed.cell_errors[0, 0] = np.nan
    session.result = Result(changed, judge(changed), session.numbers)
    found = json.loads(json.dumps(session_json(session), allow_nan=False))
    assert (found['views'][0]['error'], found['views'][0]['dropped']) == (None, True)
    assert found['result']['cells'][0][0] is None


def test_other_size_starts_anew(session: Session) -> None:
    fill(session)
    solved(session)
    for seconds in range(1000, 1005):
        assert session.numbers
        assert not session.look(detections(size=(480, 270))[0], seconds)
    assert (session.numbers, session.result, session.size) == ((), None, (480, 270))
    assert session.notice == ('the size of the image has changed from 640x360 to 480x270: the '
                              'calibration starts anew')


def test_single_images_of_other_sizes_are_ignored(session: Session) -> None:
    fill(session)
    solved(session)
    session.notice = 'saved: /set_camera_info'
    before = session.numbers, session.result, session.size, session.notice, session.hint
    own, *others = (detections(size=size)[0] for size in (SIZE, (480, 270), (320, 180)))
    for number in range(20):
        assert not session.look(others[number % 2], 1000.0 + number)
    assert (session.numbers, session.result, session.size, session.notice,
            session.hint) == before
    assert session.sighting and session.sighting.capture == (
        'the calibration is for images of 640x360: an image of 320x180 was ignored')
    for number in range(20):
        session.look(own if number % 5 == 4 else others[0], 2000.0 + number)
    assert (session.numbers, session.size) == (before[0], SIZE)


def test_other_board_starts_anew(session: Session) -> None:
    fill(session)
    session.choose(' Chessboard:9x6:25mm ')
    assert (session.text, session.numbers) == ('chessboard:9x6:25mm', ())


def test_deleted_views(session: Session) -> None:
    fill(session)
    _, second, *_, last = session.numbers
    session.delete(second)
    assert session.notice == 'view 2 was deleted'
    session.delete(last)
    assert {second, last} & {*session.numbers} == set()
    session.discard()
    assert session.numbers == ()
    with pytest.raises(CalibrationError, match='there is no such view'):
        session.delete(last)


def test_view_that_does_not_exist(session: Session) -> None:
    hold(session, detections()[0], 0.0)
    hold(session, detections()[1], 10.0)
    numbers: list[object] = [-1, 99, True, None, '0', [0], 0.0, {}]
    for number in numbers:
        with pytest.raises(CalibrationError, match='there is no such view'):
            session.delete(number)
    assert session.numbers == (0, 1)


def test_wrong_board(session: Session) -> None:
    hold(session, detections()[0], 0.0)
    texts: list[object] = [
        None, 5, ['charuco'], '', 'charuco', 'x' * 81, 'charuco:99x99:30mm:22mm:5x5_250',
        'charuco:50x50:1mm:0.5mm:4x4_50', 'chessboard:9x6:1e9mm', 'chessboard:9x6:25mm:\0']
    for text in texts:
        with pytest.raises(CalibrationError):
            session.choose(text)
        assert (session.text, session.numbers) == (CHARUCO, (0,)), text


def test_few_views_have_no_solution(session: Session) -> None:
    hold(session, detections()[0], 0.0)
    with pytest.raises(CalibrationError, match='1 of 4 views are there: take more, better 20'):
        session.begin_solution()
    assert not session.is_paused


def test_solution_ends_the_capture(session: Session) -> None:
    for number, detection in enumerate(detections()[:6]):
        hold(session, detection, 10.0 * number)
    session.begin_solution()
    count = len(session.numbers)
    for detection in detections()[6:]:
        assert not hold(session, detection, 500.0)
    assert session.sighting and session.sighting.capture == 'no more views are taken'
    session.resume()
    for number, detection in enumerate(detections()[6:], 90):
        hold(session, detection, 10.0 * number)
    assert len(session.numbers) > count


@pytest.mark.thorough
def test_thorough_search_says_why(session: Session) -> None:
    finder = session.finder
    assert finder
    board, camera = parse_board(CHARUCO), wide_camera(*SIZE)
    picture = camera.see(board, poses(board, camera, 1, seed=4, is_whole=True)[0])
    mirrored = np.ascontiguousarray(picture[:, ::-1])
    assert not session.look(finder.find(mirrored), 5.2)
    assert session.hint == MIRRORED


def test_older_layout_of_a_board(session: Session) -> None:
    board = parse_board(CHARUCO).variant
    assert board and session.finder
    camera = wide_camera(*SIZE)
    picture = camera.see(board, poses(board, camera, 1, seed=4, is_whole=True)[0])
    found = session.finder.find(picture)
    session.look(found, 1.0)
    assert found.is_variant
    assert session_json(session)['note'].startswith('the board has the layout of')


def test_corners_are_parts_of_the_picture(session: Session) -> None:
    session.look(detections()[0], 1.0)
    assert session.sighting
    found = sighting_json(session.sighting)
    corners = np.array(found['corners'])
    assert corners.shape == (len(detections()[0].ids), 2)
    assert (corners > 0).all() and (corners < 1).all()
    np.testing.assert_allclose(
        corners * SIZE - 0.5, detections()[0].corners, atol=0.0001 * SIZE[0])
