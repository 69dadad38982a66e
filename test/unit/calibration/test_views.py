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

"""Selection of views: sharp, still and new ones, coverage, and the next hint."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from opencv_tools.calibration.boards import parse_board
from opencv_tools.calibration.detection import Detection
from opencv_tools.calibration.views import ViewSelection
import pytest
from rendered_boards import facing, Pose, poses, small_camera

BOARD = parse_board('chessboard:9x6:25mm')
CAMERA = small_camera()


def seen(pose: Pose, **fields: object) -> Detection:
    """Return the true corners inside of the image."""
    corners = CAMERA.project(BOARD, pose)
    ids = np.flatnonzero(((corners > 0) & (corners < np.array(CAMERA.size) - 1)).all(axis=1))
    return replace(Detection(
        size=CAMERA.size, corners=corners[ids].astype(np.float32), points=BOARD.corners()[ids],
        ids=ids, edge_width=3.0), **fields)


def test_new_views_only() -> None:
    selection = ViewSelection()
    assert selection.take(seen(facing(BOARD, CAMERA)), 'a.png') == ''
    reason = selection.take(seen(facing(BOARD, CAMERA, x=0.02)))
    assert reason == 'the view is like another one: move or tilt the board'
    assert selection.take(seen(facing(BOARD, CAMERA, x=0.25))) == ''
    assert selection.take(seen(facing(BOARD, CAMERA, 0.4))) == ''
    assert [(view.number, view.name) for view in selection.views] == [
        (0, 'a.png'), (1, ''), (2, '')]


def test_refused_views() -> None:
    selection = ViewSelection()
    first = seen(facing(BOARD, CAMERA))
    assert selection.take(replace(first, problem='no board is in the image')) == (
        'no board is in the image')
    assert selection.take(first) == ''
    other = seen(facing(BOARD, CAMERA, x=0.25))
    assert selection.take(replace(other, size=(640, 480))).startswith(
        'the size of the image is 640x480, but that of the first one is 480x360')
    assert selection.take(replace(other, edge_width=4.6)).startswith('the image is less sharp')
    assert selection.take(replace(other, edge_width=4.4)) == ''
    assert ViewSelection(most=0).take(first) == 'there are 0 views, which are enough'


def test_still_board() -> None:
    selection = ViewSelection()
    moves = [(0.0, 0.0), (0.05, 0.1), (0.1, 0.1001), (0.15, 0.1001), (0.9, 0.1001), (0.95, 0.1001)]
    results = [selection.check(seen(facing(BOARD, CAMERA, x=x)), seconds) for seconds, x in moves]
    moving = 'the board moves: hold it still'
    assert results == [moving, moving, '', '', moving, '']
    assert selection.views == ()


def test_deletion() -> None:
    selection = ViewSelection()
    for x in (-0.25, 0.0, 0.25):
        selection.take(seen(facing(BOARD, CAMERA, 0.4, x=x)))
    selection.delete(1)
    assert [view.number for view in selection.views] == [0, 2]
    with pytest.raises(KeyError):
        selection.delete(1)
    selection.delete(2)
    assert [view.number for view in selection.views] == [0]
    assert selection.take(seen(facing(BOARD, CAMERA, 0.4))) == ''
    assert selection.views[-1].number == 3 and len(selection.detections) == 2


@pytest.mark.parametrize(('rotation', 'side'), [
    ((0.0, 0.5, 0.0), 'right'), ((0.0, -0.5, 0.0), 'left'), ((0.5, 0.0, 0.0), 'top'),
    ((-0.5, 0.0, 0.0), 'bottom')])
def test_nearer_side(rotation: tuple[float, float, float], side: str) -> None:
    selection = ViewSelection()
    pose = Pose(np.array(rotation), np.array([0.0, 0.0, 0.45]))
    selection.take(seen(pose))
    ends = {'left': (-1, 0), 'right': (1, 0), 'top': (0, -1), 'bottom': (0, 1)}
    assert selection.tilts == {name: int(name == side) for name in ends}


def test_coverage_and_hints() -> None:
    selection = ViewSelection()
    assert selection.hint == 'show the whole board to the camera'
    assert selection.progress == 0 and selection.cells.shape == (0, 0)
    hints, progress = [], [0.0]
    for x in (-0.3, -0.1, 0.1, 0.3):
        selection.take(seen(facing(BOARD, CAMERA, 0.3, x=x, y=-0.25)))
        hints.append(selection.hint)
        progress.append(selection.progress)
    assert hints[0].startswith(('tilt the board, with its ', 'move the board to the '))
    assert selection.cells.shape == (6, 8)
    assert (selection.cells[:2] > 0).any() and not selection.cells[4:].any()
    assert progress == sorted(progress)
    for pose in poses(BOARD, CAMERA, 60, seed=4):
        hints.append(selection.hint)
        selection.take(seen(pose))
    for hint in hints:  # the progress of live topics fits on a terminal of 80 columns
        assert len(f'Image 100000, {hint}') < 80
    assert selection.hint == '' and selection.progress == 1.0
    assert min(selection.tilts.values()) >= 2
