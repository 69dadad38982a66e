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

"""Calibration boards: their description as text, their corners and their markers."""

from __future__ import annotations

from dataclasses import dataclass, replace
import re
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from opencv_tools.base.remedies import installation

CHARUCO, CHESSBOARD, APRILGRID = 'charuco', 'chessboard', 'aprilgrid'

#: Form of each kind of board in text.
FORMS = {
    CHARUCO: 'charuco:COLUMNSxROWS:SQUARE:MARKER:DICTIONARY, such as '
             'charuco:11x8:30mm:22mm:5x5_250',
    CHESSBOARD: 'chessboard:COLUMNSxROWS:SQUARE with the number of inner corners, such as '
                'chessboard:9x6:25mm',
    APRILGRID: 'aprilgrid:COLUMNSxROWS:TAG:GAP:FAMILY, such as aprilgrid:6x6:30mm:9mm:36h11',
}

#: Name in OpenCV, number of markers, and cells along a side without the black border.
DICTIONARIES = {
    **{f'{side}x{side}_{count}': (f'DICT_{side}X{side}_{count}', count, side)
       for side in (4, 5, 6, 7) for count in (50, 100, 250, 1000)},
    'aruco_original': ('DICT_ARUCO_ORIGINAL', 1024, 5), '16h5': ('DICT_APRILTAG_16h5', 30, 4),
    '25h9': ('DICT_APRILTAG_25h9', 35, 5), '36h10': ('DICT_APRILTAG_36h10', 2320, 6),
    '36h11': ('DICT_APRILTAG_36h11', 587, 6)}
_METRES = {'mm': 0.001, 'cm': 0.01, 'm': 1.0}
_LENGTH = re.compile('([0-9]{1,6}(?:[.][0-9]{1,6})?)(mm|cm|m)')
#: Smallest number of columns or rows.
LEAST_COUNT = 3
_MOST = 50
_LARGEST = 5.0  # metres; a PDF page is not larger
_CORNERS = np.array([(0, 0), (1, 0), (1, 1), (0, 1)], float)  # clockwise from the upper left


class CalibrationError(ValueError):
    """A calibration is not possible; the message has the problem and the remedy."""


@dataclass(frozen=True, kw_only=True)
class Board:
    """
    A flat calibration board. Its x axis points right and its y axis down, from its upper left.

    :param kind: ``CHARUCO``, ``CHESSBOARD`` or ``APRILGRID``.
    :param columns: number of squares or tags in a row; of inner corners for a chessboard.
    :param square: side of a square in metres; for an AprilGrid the gap, which is the side of the
        black squares in the gaps.
    :param marker: side of a marker or tag in metres; 0.0 for a chessboard.
    :param dictionary: name in ``DICTIONARIES``; '' for a chessboard.
    :param is_variant: whether a ChArUco board has the layout of OpenCV before 4.6, or the tags of
        an AprilGrid have a black border of one cell instead of two.
    """

    kind: str
    columns: int
    rows: int
    square: float
    marker: float = 0.0
    dictionary: str = ''
    is_variant: bool = False

    @property
    def pitch(self) -> float:
        """Distance of neighbouring corners, or of neighbouring tags, in metres."""
        return self.square + self.marker if self.kind == APRILGRID else self.square

    @property
    def size(self) -> tuple[float, float]:
        """Width and height of the printed squares in metres."""
        extra = {CHARUCO: 0.0, CHESSBOARD: self.square, APRILGRID: self.square}[self.kind]
        return self.columns * self.pitch + extra, self.rows * self.pitch + extra

    @property
    def border_cells(self) -> int:
        """Black border of a marker in cells."""
        return 2 if self.kind == APRILGRID and not self.is_variant else 1

    @property
    def variant(self) -> Board | None:
        """Another layout of the same board that is in use; None if there is none."""
        if self.kind == APRILGRID or (self.kind == CHARUCO and self.rows % 2 == 0):
            return replace(self, is_variant=not self.is_variant)
        return None

    @property
    def is_symmetric(self) -> bool:
        """Whether the board looks the same after half a turn, as some chessboards do."""
        return self.kind == CHESSBOARD and (self.columns + self.rows) % 2 == 0

    @property
    def reach(self) -> float:
        """Length of the edges around a corner that determine its position, in metres."""
        return self.square * (0.8 if self.kind == APRILGRID else 0.45)

    @property
    def margin(self) -> float:
        """Distance from these edges up to which there is no other edge, in metres."""
        if self.kind == APRILGRID:
            cells = DICTIONARIES[self.dictionary][2] + 2 * self.border_cells
            return min(self.reach, self.marker * self.border_cells / cells)
        return (self.square - self.marker) / 2 if self.kind == CHARUCO else self.reach

    def corners(self) -> NDArray[np.float32]:
        """Return the corners in metres, an (n, 3) array; the index of a row is the id."""
        if self.kind == APRILGRID:
            flat = self.markers().reshape(-1, 2)
        else:
            count = (self.columns - 1, self.rows - 1) if self.kind == CHARUCO else (
                self.columns, self.rows)
            flat = (np.mgrid[:count[1], :count[0]][::-1].reshape(2, -1).T + 1) * self.square
        return np.column_stack((flat, np.zeros(len(flat)))).astype(np.float32)

    def markers(self) -> NDArray[np.float64]:
        """
        Return the corners of the markers in metres, an (n, 4, 2) array; the index is the id.

        The corners are in the order in which OpenCV detects them. The tags of an AprilGrid are
        turned by 180 degrees, because the first corner of AprilTag is not that of OpenCV.
        """
        if self.kind == CHESSBOARD:
            return np.empty((0, 4, 2))
        if self.kind == APRILGRID:
            cells = [(x, y) for y in range(self.rows)[::-1] for x in range(self.columns)]
            places = np.array(cells) * self.pitch + self.square
            return places[:, None] + self.marker * np.roll(_CORNERS, 2, axis=0)
        shift = int(self.is_variant and self.rows % 2 == 0)
        cells = [(x, y) for y in range(self.rows) for x in range(self.columns)
                 if (x + y + shift) % 2]
        places = np.array(cells) * self.square + self.margin
        return places[:, None] + self.marker * _CORNERS

    def open_dictionary(self) -> Any:
        """
        Return the dictionary of the markers in OpenCV.

        :raises CalibrationError: this OpenCV is too old for boards with markers.
        """
        aruco: Any = getattr(cv2, 'aruco', None)
        if not hasattr(aruco, 'ArucoDetector'):
            raise CalibrationError(
                f'OpenCV {cv2.__version__} finds no board with markers, which needs OpenCV 4.7: '
                f'use a chessboard, or {installation("opencv-python-headless")}')
        return aruco.getPredefinedDictionary(getattr(aruco, DICTIONARIES[self.dictionary][0]))

    def __str__(self) -> str:
        """Return the description of the board as text, which ``parse_board`` reads."""
        first, second = self.square, self.marker
        if self.kind == APRILGRID:
            first, second = second, first
        lengths = [f'{length * 1000:.9g}mm' for length in (first, second) if length]
        return ':'.join((self.kind, f'{self.columns}x{self.rows}', *lengths,
                         *filter(None, (self.dictionary,))))


def parse_board(text: str) -> Board:
    """
    Return the board of a description.

    :param text: one of ``FORMS``; lengths have the unit mm, cm or m.
    :returns: the board.
    :raises CalibrationError: the description is wrong.
    """
    kind, *fields = text.strip().lower().split(':')
    if kind not in FORMS:
        raise CalibrationError(f'the board is {text!r:.80}: give ' + '; '.join(FORMS.values()))
    if len(fields) != (2 if kind == CHESSBOARD else 4):
        raise CalibrationError(f'the board is {text!r:.80}: give {FORMS[kind]}')
    counts = re.fullmatch('([0-9]{1,3})x([0-9]{1,3})', fields[0])
    columns, rows = map(int, counts.groups()) if counts else (0, 0)
    if not all(LEAST_COUNT <= count <= _MOST for count in (columns, rows)):
        raise CalibrationError(f'the board {text!r:.80} has the size {fields[0]!r:.20}: give '
                               f'COLUMNSxROWS, each from {LEAST_COUNT} to {_MOST}')
    if kind == CHESSBOARD:
        return _check(Board(kind=kind, columns=columns, rows=rows, square=_length(fields[1])))
    first, second = _length(fields[1]), _length(fields[2])
    square, marker = (second, first) if kind == APRILGRID else (first, second)
    return _check(Board(kind=kind, columns=columns, rows=rows, square=square, marker=marker,
                        dictionary=fields[3]))


def _length(text: str) -> float:
    match = _LENGTH.fullmatch(text)
    length = float(match[1]) * _METRES[match[2]] if match else 0.0
    if not 0 < length <= _LARGEST:
        raise CalibrationError(f'the length {text!r:.40} of the board is wrong: give a number '
                               'above 0 with its unit, such as 30mm, 3cm or 0.03m')
    return length


def _check(board: Board) -> Board:
    """Check the fields of a board against each other; return it."""
    if max(board.size) > _LARGEST:
        raise CalibrationError(f'the board {board} is {max(board.size):.1f} m long: '
                               f'give a board of at most {_LARGEST:g} m')
    if board.kind == CHESSBOARD:
        return board
    if board.dictionary not in DICTIONARIES:
        raise CalibrationError(f'the dictionary is {board.dictionary!r:.40}: give one of '
                               + ', '.join(DICTIONARIES))
    count, available = len(board.markers()), DICTIONARIES[board.dictionary][1]
    if count > available:
        raise CalibrationError(f'the board {board} needs {count} markers, but {board.dictionary} '
                               f'has {available}: give a larger dictionary or a smaller board')
    if board.kind == CHARUCO and board.marker >= board.square:
        raise CalibrationError(f'the marker of {board} is not smaller than its square: give the '
                               'side of the square first, then the side of the marker')
    return board
