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

"""Views of a board in the images of one source, or of two cameras."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from contextlib import closing
from dataclasses import dataclass

from opencv_tools.base.logs import Log
from opencv_tools.base.progress import open_progress
from opencv_tools.calibration.boards import Board
from opencv_tools.calibration.detection import BoardFinder, Detection
from opencv_tools.calibration.source_images import check_pairs, Image, open_files, read_images
from opencv_tools.calibration.views import ViewSelection

#: Largest difference of the times of two images of a pair.
PAIR_SECONDS = 0.01
_NOVELTY_OF_FILES = 0.03  # image files were selected by a person


@dataclass(frozen=True)
class FoundViews:
    """
    The views in one source, or in two.

    :param views: boards in the images that were taken, for each source.
    :param searched: number of images that were searched.
    :param reasons: number of images that were not taken, by reason in words.
    :param is_variant: whether the other layout of the board fitted.
    """

    views: tuple[list[Detection], ...]
    searched: int
    reasons: Counter[str]
    is_variant: bool


def search_sources(board: Board, sources: Sequence[tuple[str, str]], log: Log) -> FoundViews:
    """
    Search one source, or those of the left and the right camera, and show the progress.

    :param sources: text as for ``open_source`` and topic of each source.
    :raises CaptureError: a source cannot be opened, or has failed.
    :raises CalibrationError: this OpenCV finds no board of this kind.
    :raises ValueError: the sources are not usable.
    """
    opened = [open_files(*one) for one in sources]
    check_pairs(opened)
    log, progress = open_progress(log, 'Searching image', opened[0].count)
    readers = [read_images(source, log.warning) for source in opened]
    images: Iterable[tuple[Image, ...]] = zip(readers[0])
    if len(readers) > 1:
        images = pair_images(readers[0], readers[1])
    search = ViewSearch(board)
    with closing(progress):
        for one in images:
            search.add(one)
            progress.tick(f'{one[0].name}, views: {len(search.selection.views)}',
                          **{'left out': search.reasons.total()})
    return search.found


def pair_images(
    left: Iterator[Image], right: Iterator[Image], apart: float = PAIR_SECONDS,
) -> Iterator[tuple[Image, ...]]:
    """
    Yield pairs of images: of the same number, or of the same time if they have times.

    :param apart: largest difference of the times in seconds.
    """
    first, second = next(left, None), next(right, None)
    while first and second:
        late = (first.seconds or 0.0) - (second.seconds or 0.0)
        if abs(late) <= apart:
            yield first, second
        if late <= apart:
            first = next(left, None)
        if late >= -apart:
            second = next(right, None)


class ViewSearch:
    """
    Search of images for views of a board, which are selected in the first camera.

    The images are searched in order, each alone, or those of two cameras at the same time. The
    board must be in each.
    """

    def __init__(self, board: Board) -> None:
        """
        Start without a view.

        :raises CalibrationError: this OpenCV finds no board of this kind.
        """
        self.selection = ViewSelection()
        #: Number of images that were not taken, by reason in words.
        self.reasons = Counter[str]()
        self._board, self._searched = board, 0
        self._finders = [BoardFinder(board)]
        self._others: list[list[Detection]] = []

    def add(self, images: Sequence[Image]) -> str:
        """
        Search an image, or those of two cameras.

        :returns: '' if the view was taken, otherwise the reason in words.
        """
        first, *more = images
        if not self._searched and first.seconds is None:
            self.selection = ViewSelection(novelty=_NOVELTY_OF_FILES)
        self._searched += 1
        self._finders += [BoardFinder(self._board) for _ in images[len(self._finders):]]
        finder, *others = self._finders
        reason = '' if first.seconds is None else self.selection.check(
            finder.find(first.pixels, is_fast=True), first.seconds)
        found: list[Detection] = []
        for other, image in zip(others, more):
            if not reason:
                found.append(other.find(image.pixels))
                reason = found[-1].problem and f'in the right image: {found[-1].problem}'
        reason = reason or self.selection.take(finder.find(first.pixels), first.name)
        if reason:
            self.reasons[reason] += 1
        else:
            self._others.append(found)
        return reason

    @property
    def found(self) -> FoundViews:
        """Return what was found until now."""
        columns = [self.selection.detections, *([list(one) for one in zip(*self._others)])]
        return FoundViews(tuple(columns), self._searched, self.reasons,
                          self._finders[0].board != self._board)
