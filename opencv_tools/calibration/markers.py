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

"""Markers of a board in an image, without those that do not fit the board."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from opencv_tools.calibration.boards import Board

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
        return _none(self._problem(gray, ids, is_fast))

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

    def _problem(self, gray: NDArray[np.uint8], ids: NDArray[np.int64], is_fast: bool) -> str:
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
