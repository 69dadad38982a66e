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

"""Boards and their description as text."""

from __future__ import annotations

import cv2
import numpy as np
from opencv_tools.calibration.boards import (
    Board, CalibrationError, CHARUCO, CHESSBOARD, DICTIONARIES, parse_board)
import pytest
from rendered_boards import needs_markers


@pytest.mark.parametrize(('text', 'count', 'size'), [
    ('charuco:11x8:30mm:22mm:5x5_250', 70, (0.33, 0.24)),
    ('chessboard:9x6:25mm', 54, (0.25, 0.175)),
    ('aprilgrid:6x6:30mm:9mm:36h11', 144, (0.243, 0.243)),
    ('charuco:3x4:12.5mm:7mm:4x4_50', 6, (0.0375, 0.05))])
def test_board_of_a_text(text: str, count: int, size: tuple[float, float]) -> None:
    board = parse_board(text)
    assert board.size == pytest.approx(size)
    corners = board.corners()
    assert corners.shape == (count, 3) and corners.dtype == np.float32
    assert len(np.unique(corners, axis=0)) == count
    assert (corners[:, :2] > 0).all() and (corners[:, :2] < size).all()
    assert str(board) == text and parse_board(str(board)) == board


@pytest.mark.parametrize(('text', 'same'), [
    ('chessboard:9x6:2.5cm', 'chessboard:9x6:25mm'),
    ('Chessboard:9x6:0.025m', 'chessboard:9x6:25mm')])
def test_units(text: str, same: str) -> None:
    assert parse_board(text) == parse_board(same)


@pytest.mark.parametrize(('text', 'reason'), [
    ('', "the board is '': give charuco:"), ('circles:4x5:1mm', 'give charuco:'),
    ('chessboard', 'give chessboard:COLUMNSxROWS:SQUARE'),
    ('chessboard:9x6', 'give chessboard:'), ('chessboard:9x6:25', "length '25' of the board"),
    ('chessboard:9x6:0mm', "length '0mm'"), ('chessboard:9x6:-1mm', "length '-1mm'"),
    ('chessboard:9x6:25in', 'such as 30mm'), ('chessboard:9x6:1e3mm', "length '1e3mm'"),
    ('chessboard:9:25mm', "has the size '9'"), ('chessboard:2x6:25mm', 'each from 3 to 50'),
    ('chessboard:999x999:1mm', 'each from 3 to 50'), ('chessboard:50x50:1m', 'at most 5 m'),
    ('charuco:11x8:22mm:30mm:5x5_250', 'is not smaller than its square'),
    ('charuco:11x8:30mm:22mm:9x9_50', "dictionary is '9x9_50': give one of 4x4_50"),
    ('charuco:11x10:30mm:22mm:5x5_50', 'needs 55 markers, but 5x5_50 has 50'),
    ('aprilgrid:7x6:30mm:9mm:25h9', 'needs 42 markers, but 25h9 has 35'),
    ('chessboard:' + '9' * 5000, "board is 'chess")])
def test_refused_texts(text: str, reason: str) -> None:
    with pytest.raises(CalibrationError) as caught:
        parse_board(text)
    assert reason in str(caught.value) and len(str(caught.value)) < 500


@needs_markers
@pytest.mark.parametrize('rows', [7, 8])
@pytest.mark.parametrize('is_variant', [False, True])
def test_layout_of_charuco_is_that_of_opencv(rows: int, is_variant: bool) -> None:
    board = Board(kind=CHARUCO, columns=11, rows=rows, square=0.03, marker=0.022,
                  dictionary='5x5_250', is_variant=is_variant)
    theirs = cv2.aruco.CharucoBoard((11, rows), 0.03, 0.022, board.open_dictionary())
    theirs.setLegacyPattern(is_variant)
    np.testing.assert_allclose(np.array(theirs.getObjPoints())[..., :2], board.markers(),
                               atol=1e-7)
    np.testing.assert_allclose(theirs.getChessboardCorners(), board.corners(), atol=1e-7)
    assert (board.variant is None) == (rows == 7)


def test_tags_of_an_aprilgrid_begin_at_the_lower_left() -> None:
    board = parse_board('aprilgrid:3x4:30mm:9mm:36h11')
    middles = board.markers().mean(axis=1)
    np.testing.assert_allclose(middles[0], (0.024, 4 * 0.039 - 0.015))
    np.testing.assert_allclose(middles[1] - middles[0], (0.039, 0), atol=1e-12)
    np.testing.assert_allclose(middles[3] - middles[0], (0, -0.039), atol=1e-12)
    # The first corner of OpenCV is at the lower right of an upright AprilTag.
    np.testing.assert_allclose(board.markers()[0, 0] - middles[0], (0.015, 0.015))


def test_symmetry() -> None:
    assert parse_board('chessboard:8x6:25mm').is_symmetric
    assert parse_board('chessboard:7x7:25mm').is_symmetric
    assert not parse_board('chessboard:9x6:25mm').is_symmetric
    assert not parse_board('charuco:8x6:30mm:22mm:5x5_250').is_symmetric


@needs_markers
@pytest.mark.parametrize('name', DICTIONARIES)
def test_dictionaries_of_opencv(name: str) -> None:
    board = Board(kind=CHARUCO, columns=5, rows=4, square=0.03, marker=0.02, dictionary=name)
    dictionary = board.open_dictionary()
    assert (len(dictionary.bytesList), dictionary.markerSize) == DICTIONARIES[name][1:]


def test_old_opencv(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delattr(cv2, 'aruco', raising=False)
    board = parse_board('charuco:11x8:30mm:22mm:5x5_250')
    with pytest.raises(CalibrationError, match='finds no board with markers, which needs'):
        board.open_dictionary()
    assert parse_board('chessboard:9x6:25mm').kind == CHESSBOARD
