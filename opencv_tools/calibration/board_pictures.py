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

"""Pictures of calibration boards: SVG and PDF in true millimetres for a printer, and pixels."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from opencv_tools.base.regular_files import read_regular, replace_file
from opencv_tools.calibration.boards import APRILGRID, Board, CHARUCO, CHESSBOARD

_EDGE = 12.0  # white around the board in mm
_FOOT = 26.0  # below the board in mm, with the ruler and the text
_POINTS = 72 / 25.4  # of PDF per mm
_PIXELS = 1 << 26
_MAX_BYTES = 1 << 26
_MARK = 'The ruler is'  # in each picture; other files are not replaced


@dataclass(frozen=True)
class Rectangle:
    """A black or white rectangle in millimetres from the upper left; later ones cover others."""

    x: float
    y: float
    width: float
    height: float
    is_black: bool = True


def board_rectangles(board: Board) -> list[Rectangle]:
    """
    Return the rectangles of a board, from its upper left.

    :raises CalibrationError: this OpenCV has no dictionaries of markers.
    """
    side, pitch = board.square * 1000, board.pitch * 1000
    columns, rows = board.columns, board.rows
    if board.kind != CHARUCO:
        columns, rows = columns + 1, rows + 1
    # A chessboard of 9x6 corners has 10x7 squares. An AprilGrid has a square at each corner.
    # The layout of OpenCV before 4.6 begins with a white square if the rows are even.
    shift = int(board.kind == CHARUCO and board.is_variant and board.rows % 2 == 0)
    found = [Rectangle(x * pitch, y * pitch, side, side) for y in range(rows)
             for x in range(columns) if board.kind == APRILGRID or (x + y + shift) % 2 == 0]
    if board.kind != CHESSBOARD:
        dictionary = board.open_dictionary()
        for number, corners in enumerate(board.markers() * 1000):
            found += _marker(board, dictionary, number, corners.min(axis=0))
    return found


def _marker(
    board: Board, dictionary: Any, number: int, place: NDArray[np.float64],
) -> list[Rectangle]:
    """Return a black square and the white cells in it, those side by side as one rectangle."""
    x, y, side = float(place[0]), float(place[1]), board.marker * 1000
    count = dictionary.markerSize + 2 * board.border_cells
    cells = cv2.aruco.generateImageMarker(
        dictionary, number, count, borderBits=board.border_cells) > 0
    if board.kind == APRILGRID:  # AprilTag's upper side is OpenCV's lower side
        cells = cells[::-1, ::-1]
    found, cell = [Rectangle(x, y, side, side)], side / count
    for row, values in enumerate(cells):
        edges = np.flatnonzero(np.diff(values.astype(int), prepend=0, append=0))
        found += [Rectangle(x + first * cell, y + row * cell, (last - first) * cell, cell, False)
                  for first, last in edges.reshape(-1, 2).tolist()]
    return found


def board_pixels(board: Board, scale: float, edge: float = _EDGE) -> NDArray[np.uint8]:
    """
    Draw a board as a picture.

    :param scale: pixels per millimetre; choose one that puts all edges between pixels.
    :returns: (h, w) uint8 array, 0 and 255.
    :raises ValueError: the picture is too large.
    """
    width, height = (round((length * 1000 + 2 * edge) * scale) for length in board.size)
    if not 0 < width * height <= _PIXELS:
        raise ValueError(f'a picture of {board} has {width}x{height} pixels at the scale '
                         f'{scale:g}: give a smaller scale')
    picture = np.full((height, width), 255, np.uint8)
    for one in board_rectangles(board):
        left, right, top, bottom = (round((place + edge) * scale) for place in (
            one.x, one.x + one.width, one.y, one.y + one.height))
        picture[top:bottom, left:right] = 0 if one.is_black else 255
    return picture


def board_svg(board: Board) -> bytes:
    """Return a board with a ruler as an SVG file in true millimetres."""
    width, height, shapes = _page(board)
    lines = [f'<svg xmlns="http://www.w3.org/2000/svg" width="{width:.6g}mm" '
             f'height="{height:.6g}mm" viewBox="0 0 {width:.6g} {height:.6g}">',
             f'<rect width="{width:.6g}" height="{height:.6g}" fill="#fff"/>']
    lines += [f'<rect x="{one.x:.6g}" y="{one.y:.6g}" width="{one.width:.6g}" '
              f'height="{one.height:.6g}" fill="#{"000" if one.is_black else "fff"}" '
              'shape-rendering="crispEdges"/>' for one in shapes]
    lines += [f'<text x="{_EDGE:g}" y="{y:.6g}" font-family="sans-serif" font-size="4">{text}'
              '</text>' for y, text in _texts(board, height)]
    return '\n'.join((*lines, '</svg>\n')).encode()


def board_pdf(board: Board) -> bytes:
    """Return a board with a ruler as a PDF file of one page, which has the size of the board."""
    width, height, shapes = _page(board)
    marks = [f'{_POINTS:.8f} 0 0 {-_POINTS:.8f} 0 {height * _POINTS:.4f} cm']
    marks += [f'{0 if one.is_black else 1} g {one.x:.4f} {one.y:.4f} {one.width:.4f} '
              f'{one.height:.4f} re f' for one in shapes]
    marks += [f'BT 0 g /F 4 Tf 1 0 0 -1 {_EDGE:g} {y:.4f} Tm ({text}) Tj ET'
              for y, text in _texts(board, height)]
    content = '\n'.join(marks).encode()
    bodies = [
        b'<< /Type /Catalog /Pages 2 0 R >>', b'<< /Type /Pages /Kids [3 0 R] /Count 1 >>',
        f'<< /Type /Page /Parent 2 0 R /MediaBox [0 0 {width * _POINTS:.4f} '
        f'{height * _POINTS:.4f}] /Contents 4 0 R /Resources << /Font << /F 5 0 R >> >> >>'
        .encode(),
        b'<< /Length %d >>\nstream\n%s\nendstream' % (len(content), content),
        b'<< /Type /Font /Subtype /Type1 /BaseFont /Helvetica >>']
    file, places = b'%PDF-1.4\n', []
    for number, body in enumerate(bodies, 1):
        places.append(len(file))
        file += b'%d 0 obj\n%s\nendobj\n' % (number, body)
    table = b''.join(b'%010d 00000 n \n' % place for place in places)
    return file + (b'xref\n0 %d\n0000000000 65535 f \n%strailer\n<< /Size %d /Root 1 0 R >>\n'
                   b'startxref\n%d\n%%%%EOF\n' % (
                       len(bodies) + 1, table, len(bodies) + 1, len(file)))


def _page(board: Board) -> tuple[float, float, list[Rectangle]]:
    """Return width and height of the page in mm, and the board and its ruler on it."""
    board_width, board_height = (length * 1000 for length in board.size)
    length = _ruler(board)
    top = board_height + 2 * _EDGE
    shapes = [Rectangle(one.x + _EDGE, one.y + _EDGE, one.width, one.height, one.is_black)
              for one in board_rectangles(board)]
    shapes += [Rectangle(_EDGE + mark - 0.1, top, 0.2, 5 if mark % 10 == 0 else 3)
               for mark in range(0, length + 1, 5)]
    return board_width + 2 * _EDGE, top + _FOOT, [*shapes, Rectangle(_EDGE, top, length, 0.2)]


def _ruler(board: Board) -> int:
    """Return the length of the ruler in mm, in whole centimetres if the board is long enough."""
    width = int(board.size[0] * 1000)
    return min(200, width // 10 * 10) or width


def _texts(board: Board, height: float) -> list[tuple[float, str]]:
    """Return the lines of text and their places below the ruler in mm."""
    return [(height - 14, f'{_MARK} {_ruler(board)} mm long. If it is not, print at 100 %.'),
            (height - 8, str(board))]


def print_board(board: Board, path: Path) -> None:
    """
    Write the picture of a board for a printer.

    :raises ValueError: the file has another extension, or cannot be written.
    """
    picture = {'.pdf': board_pdf, '.svg': board_svg}.get(path.suffix.lower())
    if picture is None:
        raise ValueError(f'--board-pdf is {path.name!r:.80}: give a name that ends with .pdf or '
                         '.svg')
    try:
        if path.exists() and _MARK.encode() not in read_regular(
                path, _MAX_BYTES, follow=False):
            raise ValueError(f'{path} is another file, which is not replaced: give another path')
        replace_file(path, picture(board))
    except OSError as err:
        raise ValueError(f'{path} cannot be written: {err.strerror}; give another path') from err
