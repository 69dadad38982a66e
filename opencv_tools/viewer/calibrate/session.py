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

"""A calibration in progress: board, views and result. It knows no server and no thread."""

from __future__ import annotations

from dataclasses import dataclass, field

from opencv_tools.calibration.boards import CalibrationError, parse_board
from opencv_tools.calibration.detection import BoardFinder, Detection, NO_BOARD, no_board
from opencv_tools.calibration.solve import Calibration, LEAST_VIEWS
from opencv_tools.calibration.verdict import Verdict
from opencv_tools.calibration.views import ENOUGH_VIEWS, ViewSelection

_NEW_SIZE = 5  # successive images of another size that start anew
MAX_BOARD = 80  # characters of the description of a board


@dataclass(frozen=True)
class Result:
    """
    A calibration that was solved.

    :param numbers: numbers of the views, in the order of ``calibration.view_errors``.
    """

    calibration: Calibration
    verdict: Verdict
    numbers: tuple[int, ...]
    number: int = 1


@dataclass(frozen=True)
class Sighting:
    """
    The newest image of the session.

    :param detection: the board in the image, or why there is none.
    :param capture: whether the view was taken, or why not, in words.
    """

    detection: Detection
    capture: str


@dataclass
class Session:
    """
    The state of a calibration. It is used by one thread at a time.

    An image is searched fast first. If ``look`` wants the image, it is searched thoroughly, and
    ``take`` gets this detection.

    :param text: description of the board as it was chosen; '' before that.
    :param finder: search for the board; None before it was chosen.
    :param selection: views that were taken.
    :param size: width and height of the images; None before the first one.
    :param sighting: newest image; None before the first one.
    :param result: newest result; None before the first one.
    :param notice: outcome of the last action in words; '' if there is none.
    :param is_paused: whether no views are taken, because a solution was begun.
    :param is_asked: whether the next image of the board is taken, also if the board moves.
    """

    text: str = ''
    finder: BoardFinder | None = None
    selection: ViewSelection = field(default_factory=ViewSelection)
    size: tuple[int, int] | None = None
    sighting: Sighting | None = None
    result: Result | None = None
    notice: str = ''
    is_paused: bool = False
    is_asked: bool = False
    # Size and number of the successive images of another size.
    _others: tuple[tuple[int, int], int] = ((0, 0), 0)

    @property
    def hint(self) -> str:
        """Next step in words; '' if no view is missing."""
        if self.finder is None:
            return 'choose the board'
        problem = self.sighting.detection.problem if self.sighting else ''
        return problem if problem not in ('', NO_BOARD) else self.selection.hint

    @property
    def numbers(self) -> tuple[int, ...]:
        """Numbers of the views."""
        return tuple(view.number for view in self.selection.views)

    def choose(self, text: object) -> None:
        """
        Choose the board, and start anew.

        :param text: description as ``parse_board`` reads it.
        :raises CalibrationError: the description is wrong, or OpenCV finds no such board.
        """
        if not isinstance(text, str) or len(text) > MAX_BOARD:
            raise CalibrationError(
                f'the description of the board is no text of at most {MAX_BOARD} characters')
        self.finder = BoardFinder(parse_board(text))
        self.text = text.strip().lower()
        self.discard()

    def discard(self, notice: str = '') -> None:
        """Remove all views and the result."""
        self.selection = ViewSelection()
        self.size = self.sighting = self.result = None
        self.notice = notice
        self.is_paused = self.is_asked = False

    def look(self, detection: Detection, seconds: float) -> bool:
        """
        Use a detection; return whether its image is searched thoroughly for ``take``.

        :param detection: the board, from a fast search.
        :param seconds: time of the image in seconds.
        """
        if self.size and detection.size != self.size and not self._has_changed(detection.size):
            return False
        self.size, self._others = detection.size, ((0, 0), 0)
        reason = (detection.problem or 'no more views are taken' if self.is_paused
                  else self.selection.check(detection, seconds))
        if self.is_asked:
            reason = detection.problem
        self.sighting = Sighting(detection, reason or 'a view is being taken')
        return not reason

    def _has_changed(self, size: tuple[int, int]) -> bool:
        """Start anew if there were several images of another size; return whether."""
        last, count = self._others
        self._others = size, count + 1 if size == last else 1
        sizes = (*(self.size or size), *size)
        if self._others[1] < _NEW_SIZE:
            self.sighting = Sighting(no_board(size, NO_BOARD), (
                'the calibration is for images of {}x{}: an image of {}x{} was '
                'ignored').format(*sizes))
            return False
        self.discard('the size of the image has changed from {}x{} to {}x{}: the calibration '
                     'starts anew'.format(*sizes))
        return True

    def take(self, detection: Detection) -> None:
        """Take a view, given the board from a thorough search."""
        reason = self.selection.take(detection, is_asked=self.is_asked)
        self.is_asked = False
        self.sighting = Sighting(
            detection, reason or f'view {len(self.selection.views)} was taken')

    def ask(self) -> None:
        """
        Take the next image of the board, also if the board moves or the view is like another one.

        :raises CalibrationError: no views are taken.
        """
        if self.finder is None or self.is_paused:
            raise CalibrationError('no views are taken now: choose the board, or take more views')
        self.is_asked = True

    def delete(self, number: object) -> None:
        """
        Remove a view.

        :raises CalibrationError: there is no such view.
        """
        if not isinstance(number, int) or isinstance(number, bool) or number not in self.numbers:
            raise CalibrationError('there is no such view: it may have been deleted already')
        self.notice = f'view {self.numbers.index(number) + 1} was deleted'
        self.selection.delete(number)

    def begin_solution(self) -> None:
        """
        Take no more views, if there are enough for a solution.

        :raises CalibrationError: there are not.
        """
        count = len(self.selection.views)
        if count < LEAST_VIEWS:
            raise CalibrationError(
                f'{count} of {LEAST_VIEWS} views are there: take more, better {ENOUGH_VIEWS}')
        self.is_paused, self.is_asked = True, False

    def resume(self) -> None:
        """Take views again, after a solution."""
        self.is_paused = False
