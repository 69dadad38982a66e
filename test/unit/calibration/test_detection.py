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

"""Search for boards in rendered images, and words for what is wrong with an image."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
from opencv_tools.calibration.boards import Board, parse_board
from opencv_tools.calibration.detection import BoardFinder, Detection, NO_BOARD
import pytest
from rendered_boards import Camera, facing, needs_markers, Pose, small_camera

CHARUCO = parse_board('charuco:7x6:30mm:22mm:4x4_50')
CHESSBOARD = parse_board('chessboard:7x6:30mm')
APRILGRID = parse_board('aprilgrid:4x4:30mm:9mm:36h11')
CAMERA = small_camera()

BOARDS = [pytest.param(CHARUCO, marks=needs_markers), CHESSBOARD,
          pytest.param(APRILGRID, marks=needs_markers)]


def errors(found: Detection, board: Board, pose: Pose, camera: Camera = CAMERA) -> float:
    """Return the largest error of the corners in pixels."""
    true = camera.project(board, pose)[found.ids]
    np.testing.assert_allclose(found.points, board.corners()[found.ids])
    return float(np.linalg.norm(found.corners - true, axis=1).max())


@pytest.mark.parametrize('board', BOARDS)
@pytest.mark.parametrize('turn', [0.0, 0.6])
def test_all_corners_of_a_whole_board(board: Board, turn: float) -> None:
    pose = facing(board, CAMERA, turn=turn)
    found = BoardFinder(board).find(CAMERA.see(board, pose))
    assert (found.problem, found.is_variant, found.size) == ('', False, (480, 360))
    assert len(found.ids) >= 0.95 * len(board.corners())
    assert found.corners.dtype == np.float32 and (np.diff(found.ids) > 0).all()
    assert errors(found, board, pose) < 0.2


@pytest.mark.thorough
@pytest.mark.parametrize('board', BOARDS)
def test_fast_search_in_a_smaller_copy(board: Board) -> None:
    camera = Camera((1200, 900), CAMERA.k * [[2.5], [2.5], [1]], CAMERA.d)
    pose = facing(board, camera)
    found = BoardFinder(board).find(camera.see(board, pose), is_fast=True)
    assert found.size == (1200, 900)
    assert len(found.ids) > 0.8 * len(board.corners())
    assert errors(found, board, pose, camera) < 0.5


@needs_markers
@pytest.mark.parametrize('board', [CHARUCO, APRILGRID])
def test_board_partly_outside(board: Board) -> None:
    pose = facing(board, CAMERA, part=0.9, x=0.45)
    true = CAMERA.project(board, pose)
    inside = ((true > 3) & (true < np.array(CAMERA.size) - 4)).all(axis=1)
    found = BoardFinder(board).find(CAMERA.see(board, pose))
    assert 0.3 < inside.mean() < 0.8
    assert len(found.ids) > 0.85 * inside.sum()
    assert errors(found, board, pose) < 0.3


@needs_markers
def test_covered_part_of_a_board() -> None:
    pose = facing(CHARUCO, CAMERA)
    image = CAMERA.see(CHARUCO, pose)
    image[:, 180:260] = 90  # a hand
    found = BoardFinder(CHARUCO).find(image)
    assert 10 <= len(found.ids) < 30 and errors(found, CHARUCO, pose) < 0.3
    assert not ((found.corners[:, 0] > 181) & (found.corners[:, 0] < 258)).any()


@needs_markers
def test_mistaken_marker_is_left_out() -> None:
    pose = facing(CHARUCO, CAMERA)
    image = CAMERA.see(CHARUCO, pose)
    x, y = CAMERA.project(CHARUCO, pose)[[0, 7]].mean(axis=0)  # the middle of a black square
    lone = cv2.aruco.generateImageMarker(CHARUCO.open_dictionary(), 17, 24)
    image[5:45, 5:45] = 255
    image[13:37, 13:37] = lone  # the marker 17 a second time, at another place
    found = BoardFinder(CHARUCO).find(image)
    assert len(found.ids) == 30 and errors(found, CHARUCO, pose) < 0.2
    assert x > 45 and y > 45


@pytest.mark.thorough
@needs_markers
@pytest.mark.parametrize('board', [CHARUCO, APRILGRID])
def test_other_layout(board: Board) -> None:
    other = board.variant
    assert other
    pose = facing(board, CAMERA)
    finder = BoardFinder(board)
    found = finder.find(CAMERA.see(other, pose))
    assert found.is_variant and not found.problem and finder.board == other
    assert len(found.ids) >= 0.95 * len(board.corners()) and errors(found, board, pose) < 0.2
    assert not finder.find(CAMERA.see(board, pose)).is_variant


@needs_markers
@pytest.mark.parametrize('board', [CHARUCO, APRILGRID])
def test_mirrored_image(board: Board) -> None:
    image = CAMERA.see(board, facing(board, CAMERA))
    found = BoardFinder(board).find(np.ascontiguousarray(image[:, ::-1]))
    assert not found.is_found
    assert found.problem == 'the image is mirrored: switch the mirroring of the camera off'


@needs_markers
def test_larger_board_than_given() -> None:
    large = parse_board('charuco:8x9:30mm:22mm:4x4_50')
    found = BoardFinder(CHARUCO).find(CAMERA.see(large, facing(large, CAMERA, 0.6)))
    assert not found.is_found
    assert found.problem.startswith('markers up to the number 35 are in the image, but charuco:7')


@needs_markers
def test_smaller_board_than_given() -> None:
    small = parse_board('charuco:5x6:30mm:22mm:4x4_50')
    found = BoardFinder(CHARUCO).find(CAMERA.see(small, facing(small, CAMERA, 0.6)))
    assert not found.is_found
    assert found.problem.endswith('give the columns and rows of the board in the image')


@pytest.mark.parametrize('given', ['9x6', '6x5', '10x7', '5x4'])
def test_chessboard_counted_in_squares(given: str) -> None:
    asked = parse_board(f'chessboard:{given}:25mm')
    true = replace(asked, columns=asked.columns - 1, rows=asked.rows - 1)
    image = CAMERA.see(true, facing(true, CAMERA, 0.7))
    finder = BoardFinder(asked)
    found = finder.find(image)
    assert not found.is_found
    assert found.problem == (
        f'{true.columns}x{true.rows} inner corners are in the image, as on a board of {given} '
        f'squares: give {true} if it has no more')
    assert BoardFinder(true).find(image).is_found
    # Of a board that was found, a part may be hidden.
    assert finder.find(CAMERA.see(asked, facing(asked, CAMERA, 0.7))).is_found
    assert finder.find(image).problem == NO_BOARD


@needs_markers
@pytest.mark.parametrize('text', [
    'charuco:7x6:30mm:22mm:4x4_50', 'charuco:5x9:30mm:22mm:5x5_250',
    'aprilgrid:6x5:30mm:9mm:36h11', 'aprilgrid:3x7:30mm:9mm:36h11'])
def test_columns_and_rows_exchanged(text: str) -> None:
    true = parse_board(text)
    asked = replace(true, columns=true.rows, rows=true.columns)
    found = BoardFinder(asked).find(CAMERA.see(true, facing(true, CAMERA, 0.8)))
    assert not found.is_found
    assert found.problem == (
        f'the board in the image is {true}, not {asked}: exchange columns and rows')


@pytest.mark.parametrize('board', BOARDS[:2])
def test_two_boards(board: Board) -> None:
    image = CAMERA.mix([(board, facing(board, CAMERA, 0.4, x=place)) for place in (-0.25, 0.25)])
    found = BoardFinder(board).find(image)
    assert not found.is_found
    assert found.problem == 'two boards are in the image: show only one'


@pytest.mark.quick_cases(1)
@pytest.mark.parametrize('board', BOARDS)
def test_blurred_image(board: Board) -> None:
    pose = facing(board, CAMERA, 0.9)
    sharp, soft = (BoardFinder(board).find(CAMERA.see(board, pose, blur=blur))
                   for blur in (0.6, 1.2))
    assert 1.5 < sharp.edge_width < soft.edge_width < 5
    blurred = cv2.blur(CAMERA.see(board, pose), (9, 1))  # motion to the side
    found = BoardFinder(board).find(blurred)
    if found.is_found:
        assert found.problem.startswith('the image is blurred: its edges are ')
    else:
        assert found.problem == NO_BOARD


@pytest.mark.parametrize('board', BOARDS)
@pytest.mark.parametrize('image', [
    np.zeros((360, 480), np.uint8), np.full((1, 1), 255, np.uint8), np.zeros((3, 2000), np.uint8),
    np.random.default_rng(1).integers(0, 256, (200, 300), np.uint8),
    np.zeros((40, 30, 3), np.uint8)])
def test_image_without_board(board: Board, image: np.ndarray) -> None:
    for is_fast in (True, False):
        found = BoardFinder(board).find(image, is_fast)
        assert not found.is_found and found.problem == NO_BOARD
        assert found.corners.shape == (0, 2) and found.points.shape == (0, 3)


def test_color_image_is_not_changed() -> None:
    pose = facing(CHESSBOARD, CAMERA)
    image = np.repeat(CAMERA.see(CHESSBOARD, pose)[..., None], 3, axis=2)
    image.flags.writeable = False
    assert errors(BoardFinder(CHESSBOARD).find(image), CHESSBOARD, pose) < 0.2


@pytest.mark.thorough
def test_rows_of_a_chessboard_begin_at_its_black_square() -> None:
    for turn in (0.0, 1.5, 3.0, 4.6):
        pose = facing(CHESSBOARD, CAMERA, 0.6, turn=turn)
        found = BoardFinder(CHESSBOARD).find(CAMERA.see(CHESSBOARD, pose))
        assert errors(found, CHESSBOARD, pose) < 0.2
