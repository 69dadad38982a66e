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

"""Selection of the views of a board by the cells of the image that they cover."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from opencv_tools.calibration.detection import Detection

#: The most views of a calibration.
MOST_VIEWS = 100
_CELLS = 8  # along the longer side
_ROWS = ('upper', '', 'lower')
_COLUMNS = ('left', '', 'right')


def cell_grid(size: tuple[int, int]) -> tuple[int, int]:
    """Return the rows and columns of the cells of an image of a width and a height."""
    columns, rows = (max(3, round(_CELLS * side / max(size))) for side in size)
    return rows, columns


def cells_of(
    positions: NDArray[Any], size: tuple[int, int],
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the rows and columns of the cells of (n, 2) positions in pixels."""
    grid = np.array(cell_grid(size)[::-1])
    cells = np.clip(((positions + 0.5) * grid / np.array(size)).astype(np.int64), 0, grid - 1)
    return cells[:, 1], cells[:, 0]


def place_in_words(row: Any, column: Any, shape: tuple[int, ...]) -> str:
    """Return the place of a cell in words: ``upper left``, ``left`` or ``middle``."""
    words = [names[int((place + 0.5) / count * 3)]
             for names, place, count in zip((_ROWS, _COLUMNS), (row, column), shape)]
    return ' '.join(filter(None, words)) or 'middle'


def most_common_place(cells: NDArray[np.bool_]) -> str:
    """Return the part of the image with most of the selected cells, in words; '' for none."""
    places = [place_in_words(row, column, cells.shape) for row, column in zip(*np.nonzero(cells))]
    return max(dict.fromkeys(places), key=places.count, default='')


#: Part of the cells of the image from which the coverage is enough.
ENOUGH_CELLS = 0.8
#: Number of views from which a calibration is good.
ENOUGH_VIEWS = 20

_NOVELTY = 0.2
_FOCAL = 0.8  # assumed focal length, as a part of the width of the image
_TILT_UNIT = 0.7  # sine of an angle that counts as much as the width of the image
_TILTED = 0.26  # sine of the angle from which a board is tilted: 15 degrees
_TILTED_VIEWS = 2
# A board is still if its corners move at most by this part of the image's width in a second.
_STILL = 0.03
_STILL_SECONDS = 0.5
# Widest edges, as a multiple of the least width so far; pixels of sharp edges.
_SHARP, _SHARPEST = 1.5, 3.0
_TILTS = {
    'left': (0, -1), 'right': (0, 1), 'top': (1, -1), 'bottom': (1, 1)}


@dataclass(frozen=True, kw_only=True)
class View:
    """
    A view that was taken.

    :param number: number of the view, which no other view gets.
    :param name: name of its image; '' if it has none.
    :param place: middle of the board in the image, each part from 0.0 to 1.0.
    :param extent: root of the part of the image that the board covers.
    :param tilt: sines of the tilts: the side that is nearer to the camera is the right one for
        positive x, and the lower one for positive y.
    """

    number: int
    name: str
    detection: Detection
    place: tuple[float, float]
    extent: float
    tilt: tuple[float, float]

    def difference(self, other: View) -> float:
        """Return how much another view differs in place, extent and tilt."""
        mine, others = (np.array((*one.place, one.extent, one.tilt[0] / _TILT_UNIT,
                                  one.tilt[1] / _TILT_UNIT)) for one in (self, other))
        return float(np.abs(mine - others).sum())


class ViewSelection:
    """
    The views of a calibration.

    A view is taken if its board is found, sharp, still and new. The object holds no image. It is
    not for several threads at once.
    """

    def __init__(self, novelty: float = _NOVELTY, most: int = MOST_VIEWS) -> None:
        """
        Start without a view.

        :param novelty: least difference from each view that was taken, see ``View.difference``.
        """
        self.views: tuple[View, ...] = ()
        self._novelty, self._most = novelty, most
        self._count = 0
        self._last: tuple[Detection, float] | None = None

    def check(self, detection: Detection, seconds: float | None = None) -> str:
        """
        Return why a view is not usable, in words; '' if it is.

        It may come from a fast search, before the image is searched again for ``take``.

        :param seconds: time of the image; None for an image that is not part of a sequence, which
            is not checked for motion.
        """
        last, self._last = self._last, None if seconds is None else (detection, seconds)
        reason = self._reason(detection)
        if not reason and seconds is not None and not _is_still(detection, seconds, last):
            return 'the board moves: hold it still'
        return reason

    def take(self, detection: Detection, name: str = '', *, is_asked: bool = False) -> str:
        """
        Take a view if it is usable and sharp.

        :param detection: the board in an image, not from a fast search.
        :param is_asked: whether the view may be like another one.
        :returns: '' if the view was taken, otherwise the reason in words.
        """
        reason = self._reason(detection, is_asked)
        sharpest = min((view.detection.edge_width for view in self.views), default=np.inf)
        if not reason and detection.edge_width > _SHARP * max(sharpest, _SHARPEST):
            reason = 'the image is less sharp than others: hold the board still'
        if not reason:
            self.views += (_view(detection, self._count, name),)
            self._count += 1
        return reason

    def _reason(self, detection: Detection, is_asked: bool = False) -> str:
        if detection.problem:
            return detection.problem
        size = self.views[0].detection.size if self.views else detection.size
        if detection.size != size:
            return (f'the size of the image is {detection.size[0]}x{detection.size[1]}, but that '
                    f'of the first one is {size[0]}x{size[1]}: give images of one size')
        if self.is_full:
            return f'there are {self._most} views, which are enough'
        view = _view(detection, self._count, '')
        if not is_asked and any(view.difference(one) < self._novelty for one in self.views):
            return 'the view is like another one: move or tilt the board'
        return ''

    def delete(self, number: int) -> None:
        """
        Remove a view.

        :raises KeyError: there is no view of this number.
        """
        if number not in {view.number for view in self.views}:
            raise KeyError(number)
        self.views = tuple(view for view in self.views if view.number != number)

    @property
    def is_full(self) -> bool:
        """Whether no more views are taken."""
        return len(self.views) >= self._most

    @property
    def detections(self) -> list[Detection]:
        """Boards of the views, as for ``solve``."""
        return [view.detection for view in self.views]

    @property
    def cells(self) -> NDArray[np.int64]:
        """Corners in each cell of the image, (rows, columns); (0, 0) without views."""
        if not self.views:
            return np.zeros((0, 0), np.int64)
        counts = np.zeros(cell_grid(self.views[0].detection.size), np.int64)
        for view in self.views:
            np.add.at(counts, cells_of(view.detection.corners, view.detection.size), 1)
        return counts

    @property
    def tilts(self) -> dict[str, int]:
        """How many views have each side of the board nearer to the camera."""
        return {side: sum(sign * view.tilt[axis] > _TILTED for view in self.views)
                for side, (axis, sign) in _TILTS.items()}

    @property
    def progress(self) -> float:
        """Part of the views, cells and tilts that are there, 0.0 to 1.0."""
        if not self.views:
            return 0.0
        tilts = sum(min(count, _TILTED_VIEWS) for count in self.tilts.values())
        parts = (len(self.views) / ENOUGH_VIEWS, float((self.cells > 0).mean()) / ENOUGH_CELLS,
                 tilts / (len(_TILTS) * _TILTED_VIEWS))
        return sum(min(1.0, part) for part in parts) / len(parts)

    @property
    def hint(self) -> str:
        """Words for the most useful next view; '' if nothing is missing."""
        if not self.views:
            return 'show the whole board to the camera'
        cells, tilts = self.cells, self.tilts
        side = min(tilts, key=lambda one: tilts[one])
        if tilts[side] < _TILTED_VIEWS and len(self.views) > 2 * sum(
                min(count, _TILTED_VIEWS) for count in tilts.values()):
            return f'tilt the board, with its {side} side nearer to the camera'
        if (cells > 0).mean() < ENOUGH_CELLS:
            return f'move the board to the {most_common_place(cells == 0)} of the image'
        if tilts[side] < _TILTED_VIEWS:
            return f'tilt the board, with its {side} side nearer to the camera'
        if max(view.extent for view in self.views) < 0.5:
            return 'bring the board nearer to the camera'
        if len(self.views) < ENOUGH_VIEWS:
            return 'move the board to other places, and tilt it'
        return ''


def _is_still(detection: Detection, seconds: float, last: tuple[Detection, float] | None) -> bool:
    """Return whether the board was at the same place in the last image."""
    if last is None or not 0 < seconds - last[1] <= _STILL_SECONDS:
        return False
    ids, mine, before = np.intersect1d(detection.ids, last[0].ids, return_indices=True)
    if not len(ids) or detection.size != last[0].size:
        return False
    moved = np.linalg.norm(detection.corners[mine] - last[0].corners[before], axis=1)
    speed = float(np.median(moved)) / (seconds - last[1])
    return speed <= max(_STILL * detection.size[0], 1.0 / (seconds - last[1]))


def _view(detection: Detection, number: int, name: str) -> View:
    """Return a view, whose tilt is estimated with an assumed focal length."""
    size = np.array(detection.size, float)
    corners = detection.corners.astype(float)
    area = cv2.contourArea(cv2.convexHull(detection.corners))
    focal = _FOCAL * size[0]
    rays = (corners - (size - 1) / 2) / focal
    tilt = np.zeros(2)
    found, rotation, _ = cv2.solvePnP(detection.points.astype(float), rays, np.eye(3), None,
                                      flags=cv2.SOLVEPNP_IPPE)
    if found:
        matrix = cv2.Rodrigues(rotation)[0]
        # The axis of the board that is nearest to that of the image, so that turns do not count.
        normal = matrix[:, 2] * np.sign(matrix[2, 2])
        tilt = normal[:2]
    x, y = corners.mean(axis=0) / size
    return View(number=number, name=name, detection=detection, place=(float(x), float(y)),
                extent=float(np.sqrt(area / size.prod())), tilt=(float(tilt[0]), float(tilt[1])))
