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

"""Search for a calibration board and its markers in an image."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from opencv_tools.calibration.boards import Board, CHESSBOARD, LEAST_COUNT
from opencv_tools.calibration.corners import corners_near, fit_local_map, follow_corners

# Largest difference between the expected and the real place of a neighbour, as a part of its
# distance. It contains perspective and the errors of the corners of small markers.
_DIFFERENCE = 0.4
_NEAR = 1.6  # largest distance of a neighbour: pitches between tags, and 1.6 squares
_LEAST_MARKERS = 2
_LEAST_TWICE = 3

TWO_BOARDS = 'two boards are in the image: show only one'
MIRRORED = 'the image is mirrored: switch the mirroring of the camera off'


@dataclass(frozen=True)
class Markers:
    """
    The markers that fit a board.

    :param ids: (n,) ids.
    :param quads: (n, 4, 2) corners in pixels, as OpenCV orders them.
    :param misfits: whether other markers do not fit, or none is found, as for another layout.
    :param problem: reason for too few markers, in words; '' if there is none.
    """

    ids: NDArray[np.int64]
    quads: NDArray[np.float64]
    misfits: bool
    problem: str = ''


class MarkerFinder:
    """A search for the markers of a board. It keeps the settings of OpenCV's detector."""

    def __init__(self, board: Board) -> None:
        """
        Prepare the search.

        :raises CalibrationError: this OpenCV is too old.
        """
        self._board = board
        self._places = board.markers()
        dictionary = board.open_dictionary()
        parameters = cv2.aruco.DetectorParameters()
        parameters.markerBorderBits = board.border_cells
        own = cv2.aruco.Dictionary(dictionary.bytesList[:len(self._places)],
                                   dictionary.markerSize, dictionary.maxCorrectionBits)
        # A search takes most of its time to compare with each marker of a dictionary. The whole
        # one is needed only for the reason why the own markers are not found.
        self._own, self._all = (cv2.aruco.ArucoDetector(one, parameters)
                                for one in (own, dictionary))

    def find(self, gray: NDArray[np.uint8], is_fast: bool = False) -> Markers:
        """
        Return the markers of the board in an (h, w) image.

        :param is_fast: whether the reason for too few markers is not looked for.
        """
        for detector in (self._own, self._all):
            ids, quads = _detect(detector, gray)
            is_known = ids < len(self._places)
            numbers, counts = np.unique(ids[is_known], return_counts=True)
            if np.count_nonzero(counts > 1) >= _LEAST_TWICE:
                return _none(TWO_BOARDS)
            once = is_known & np.isin(ids, numbers[counts == 1])
            fits = self._fit(ids[once], quads[once])
            if fits.sum() >= max(_LEAST_MARKERS, len(ids) / 2):
                return Markers(ids[once][fits], quads[once][fits], not fits.all())
        return _none(self._problem(gray, ids, quads, is_fast))

    def _fits_best(self, ids: NDArray[np.int64], quads: NDArray[np.float64]) -> bool:
        """Return whether most markers, whose ids are on the board, are where they should be."""
        is_known = ids < len(self._places)
        return bool(self._fit(ids[is_known], quads[is_known]).sum() >= max(
            _LEAST_MARKERS, len(ids) / 2))

    def _fit(self, ids: NDArray[np.int64], quads: NDArray[np.float64]) -> NDArray[np.bool_]:
        """Return which markers are where most of their neighbours expect them."""
        if not len(ids):
            return np.zeros(0, bool)
        board, middles = self._places[ids], quads.mean(axis=1)
        flat = board - board.mean(axis=1, keepdims=True)
        # Each marker has an affine map; (n, 2, 2) pixels per metre.
        maps = (quads - middles[:, None]).transpose(0, 2, 1) @ flat / (
            self._board.marker ** 2)
        ways = board.mean(axis=1)[None] - board.mean(axis=1)[:, None]
        expected = np.einsum('nij,nmj->nmi', maps, ways)
        real = middles[None] - middles[:, None]
        size = np.maximum(np.linalg.norm(expected, axis=2), 1e-9)
        agrees = np.linalg.norm(real - expected, axis=2) / size < _DIFFERENCE
        distances = np.linalg.norm(ways, axis=2) / self._board.pitch
        is_near = (distances > 0) & (distances < _NEAR)
        agreeing = (agrees & agrees.T & is_near).sum(axis=0)
        return (agreeing > 0) & (2 * agreeing > is_near.sum(axis=0))

    def _problem(
        self, gray: NDArray[np.uint8], ids: NDArray[np.int64], quads: NDArray[np.float64],
        is_fast: bool,
    ) -> str:
        """Return why the markers of an image are too few or do not fit, in words."""
        known = np.count_nonzero(ids < len(self._places))
        if not is_fast:
            mirrored, _ = _detect(self._own, np.ascontiguousarray(gray[:, ::-1]))
            if len(mirrored) > max(2 * known, _LEAST_MARKERS):
                return MIRRORED
        if len(ids) - known > max(_LEAST_MARKERS, known // 8):
            return (f'markers up to the number {ids.max()} are in the image, but {self._board} '
                    f'has only those from 0 to {len(self._places) - 1}: give the size of the '
                    'board in the image')
        if known > 2 * _LEAST_MARKERS:
            turned = replace(self._board, columns=self._board.rows, rows=self._board.columns)
            if not is_fast and MarkerFinder(turned)._fits_best(ids, quads):
                return (f'the board in the image is {turned}, not {self._board}: exchange columns '
                        'and rows')
            return (f'{known} markers of {self._board.dictionary} are in the image, but not as '
                    f'on {self._board}: give the columns and rows of the board in the image')
        return ''


def _detect(
    detector: Any, gray: NDArray[np.uint8],
) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    quads, ids, _ = detector.detectMarkers(gray)
    count = 0 if ids is None else len(ids)
    return (np.asarray(ids if count else [], np.int64).reshape(-1),
            np.asarray(quads if count else [], float).reshape(-1, 4, 2))


def _none(problem: str) -> Markers:
    return Markers(np.zeros(0, np.int64), np.zeros((0, 4, 2)), True, problem)


#: Problem of an image without a board.
NO_BOARD = 'no board is in the image'

_LEAST_SIDE = 32  # pixels
_FAST_PIXELS = 800  # largest side of the image for a fast search
# Larger images are searched at a half or a quarter of their size. OpenCV's search for a chessboard
# takes a second in noise of this size, but five minutes in noise of 8K.
_MOST_PIXELS, _MOST_CHESSBOARD = 1 << 24, 1 << 22
# Edges wider than this, in pixels and as a part of the width of the image, are blurred.
_BLURRED_PIXELS = 5.0
_BLURRED_PART = 0.004


@dataclass(frozen=True, kw_only=True)
class Detection:
    """
    A board in an image, or the reason why there is none.

    :param size: width and height of the image in pixels.
    :param corners: (n, 2) float32 positions in pixels; 0 is the centre of the first pixel.
    :param points: (n, 3) float32 places on the board in metres.
    :param ids: (n,) ids of the corners on the board, ascending.
    :param edge_width: width of the edges in pixels from black to white.
    :param problem: what is wrong, in words; '' if nothing is. A blurred board has corners.
    :param is_variant: whether the other layout of the board fitted, see ``Board.variant``.
    """

    size: tuple[int, int]
    corners: NDArray[np.float32]
    points: NDArray[np.float32]
    ids: NDArray[np.int64]
    edge_width: float = 0.0
    problem: str = ''
    is_variant: bool = False

    @property
    def is_found(self) -> bool:
        """Whether the board was found, blurred or not."""
        return len(self.ids) > 0


class BoardFinder:
    """A search for one board, with the settings of OpenCV's detectors."""

    def __init__(self, board: Board) -> None:
        """
        Prepare the search.

        :raises CalibrationError: this OpenCV finds no board of this kind.
        """
        #: The board in the layout that fitted last.
        self.board = board
        self._asked = board
        self._has_found = False
        self._markers = {} if board.kind == CHESSBOARD else {
            one: MarkerFinder(one) for one in (board, board.variant) if one}

    def find(self, image: NDArray[Any], is_fast: bool = False) -> Detection:
        """
        Find the board in an image.

        :param image: (h, w) or (h, w, 3) uint8 image, gray or BGR. It is not changed.
        :param is_fast: whether a small copy of the image is searched, for live images. Corners
            are then as precise as in the small copy.
        :returns: the board, or why there is none.
        """
        gray: Any = image if image.ndim == 2 else cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)
        size = (gray.shape[1], gray.shape[0])
        if min(size) < _LEAST_SIDE:
            return no_board(size, NO_BOARD)
        factor = 1
        most = _MOST_CHESSBOARD if self._asked.kind == CHESSBOARD else _MOST_PIXELS
        while min(size) >= 2 * factor * _LEAST_SIDE and (
                gray.size > most * factor ** 2 or (is_fast and max(size) > factor * _FAST_PIXELS)):
            factor *= 2
        small: Any = gray if factor == 1 else cv2.resize(
            gray, (size[0] // factor, size[1] // factor), interpolation=cv2.INTER_AREA)
        search = self._find_chessboard if self._asked.kind == CHESSBOARD else self._find_markers
        ids, rough, problem = search(small, is_fast)
        if not len(ids):
            return no_board(size, problem or NO_BOARD)
        return self._refine(small, ids, rough, size, is_fast)

    def _find_markers(
        self, gray: NDArray[np.uint8], is_fast: bool,
    ) -> tuple[NDArray[np.int64], NDArray[np.float64], str]:
        """Return ids and rough positions of the corners, and the problem if they are few."""
        found, other = self._markers[self.board].find(gray, is_fast), self.board.variant
        if found.misfits and other:
            second = self._markers[other].find(gray, is_fast=True)
            if len(second.ids) > len(found.ids):
                self.board, found = other, second
        if not len(found.ids):
            return found.ids, found.quads, found.problem
        places = self.board.markers()[found.ids].reshape(-1, 2)
        corners = self.board.corners()[:, :2].astype(float)
        ids = corners_near(corners, places, self.board.pitch)
        return ids, fit_local_map(places, found.quads.reshape(-1, 2), corners[ids],
                                  self.board.pitch).positions, ''

    def _find_chessboard(
        self, gray: NDArray[np.uint8], is_fast: bool,
    ) -> tuple[NDArray[np.int64], NDArray[np.float64], str]:
        """Return ids and rough positions of the corners, and the problem if there are none."""
        board = self._asked
        found = _chessboard(gray, (board.columns, board.rows), is_fast)
        if found is None:
            return np.zeros(0, np.int64), np.zeros((0, 2)), (
                '' if is_fast or self._has_found else _miscounted(gray, board))
        self._has_found = True
        if not is_fast:
            hidden = gray.copy()
            cv2.fillConvexPoly(hidden, cv2.convexHull(found.astype(np.int32)), 128)
            if _chessboard(hidden, (board.columns, board.rows), is_fast=True) is not None:
                return np.zeros(0, np.int64), np.zeros((0, 2)), TWO_BOARDS
        return np.arange(len(found)), _ordered(found, board, gray), ''

    def _refine(
        self, gray: NDArray[np.uint8], ids: NDArray[np.int64], rough: NDArray[np.float64],
        size: tuple[int, int], is_fast: bool,
    ) -> Detection:
        """Return the detection with refined corners, also those that no marker is beside of."""
        board, factor = self.board, np.array(size) / gray.shape[::-1]
        found = follow_corners(gray, board, ids, rough, is_fast)
        if not len(found.ids):
            return no_board(size, NO_BOARD)
        width = float(np.median(found.edge_width)) * factor[0]
        limit = max(_BLURRED_PIXELS * factor[0], _BLURRED_PART * size[0])
        return Detection(
            size=size, ids=found.ids, points=board.corners()[found.ids],
            corners=((found.positions + 0.5) * factor - 0.5).astype(np.float32),
            edge_width=width, is_variant=board != self._asked,
            problem=f'the image is blurred: its edges are {width:.1f} pixels wide; hold '
                    'the board still, focus, or add light' if width > limit else '')


def no_board(size: tuple[int, int], problem: str) -> Detection:
    """Return that an image has no board, and why, in words."""
    return Detection(size=size, problem=problem, ids=np.zeros(0, np.int64),
                     corners=np.zeros((0, 2), np.float32), points=np.zeros((0, 3), np.float32))


def _chessboard(
    gray: NDArray[np.uint8], counts: tuple[int, int], is_fast: bool,
) -> NDArray[np.float64] | None:
    flags = cv2.CALIB_CB_ADAPTIVE_THRESH | cv2.CALIB_CB_NORMALIZE_IMAGE
    found, corners = cv2.findChessboardCorners(gray, counts, flags=flags | cv2.CALIB_CB_FAST_CHECK)
    if not found and not is_fast:
        flags = cv2.CALIB_CB_EXHAUSTIVE | cv2.CALIB_CB_NORMALIZE_IMAGE
        found, corners = cv2.findChessboardCornersSB(gray, counts, flags=flags)
    return np.asarray(corners, float).reshape(-1, 2) if found else None


def _miscounted(gray: NDArray[np.uint8], board: Board) -> str:
    """Return that the squares of a chessboard were counted, not its inner corners, or ''."""
    other = replace(board, columns=board.columns - 1, rows=board.rows - 1)
    counts = other.columns, other.rows
    factor = -(-max(gray.shape) // _FAST_PIXELS)
    small: Any = cv2.resize(gray, None, fx=1 / factor, fy=1 / factor, interpolation=cv2.INTER_AREA)
    if min(counts) < LEAST_COUNT or _chessboard(small, counts, is_fast=False) is None:
        return ''
    return (f'{other.columns}x{other.rows} inner corners are in the image, as on a board of '
            f'{board.columns}x{board.rows} squares: give {other} if it has no more')


def _ordered(
    corners: NDArray[np.float64], board: Board, gray: NDArray[np.uint8],
) -> NDArray[np.float64]:
    """Return the corners of a chessboard with rows to the right, from the black square."""
    grid = corners.reshape(board.rows, board.columns, 2)
    right, down = grid[0, -1] - grid[0, 0], grid[-1, 0] - grid[0, 0]
    if right[0] * down[1] - right[1] * down[0] < 0:
        grid = grid[:, ::-1]
    if (board.columns + board.rows) % 2:
        # Turned by 180 degrees, the squares of these boards change their colour.
        first, second = (np.rint(grid[:2, column:column + 2].mean(axis=(0, 1))).astype(int)
                         for column in (0, 1))
        if gray[first[1], first[0]] > gray[second[1], second[0]]:
            grid = grid[::-1, ::-1]
    return grid.reshape(-1, 2)
