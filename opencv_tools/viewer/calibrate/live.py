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

"""A calibration of a topic while its images arrive, and its state for the page."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Coroutine
from concurrent.futures import Executor
import itertools
from typing import Any, Protocol

import numpy as np
from opencv_tools.base.logs import Log
from opencv_tools.base.text import printable
from opencv_tools.calibration.boards import CalibrationError, CHARUCO
from opencv_tools.calibration.views import ENOUGH_CELLS, ENOUGH_VIEWS
from opencv_tools.viewer.calibrate.board_search import BoardSearch, Seen
from opencv_tools.viewer.calibrate.session import Result, Session, Sighting
from opencv_tools.viewer.calibrate.solver import check_model, Solver
from opencv_tools.viewer.errors import MAX_MESSAGE, RequestError
from opencv_tools.viewer.streams.stream import Stream
from opencv_tools.viewer.watched import Watched

_LENS = ('fx', 'fy', 'cx', 'cy')


def session_json(session: Session) -> dict[str, Any]:
    """Return board, views, coverage and result."""
    selection = session.selection
    errors = _errors(session.result)
    return {
        'board': session.text, 'note': _board_note(session), 'size': session.size,
        'hint': printable(session.hint, MAX_MESSAGE), 'notice': session.notice,
        'progress': round(selection.progress, 3),
        'wanted': {'views': ENOUGH_VIEWS, 'cells': ENOUGH_CELLS},
        'views': [{'number': view.number, 'place': _rounded(view.place, 3),
                   'extent': round(view.extent, 2), **errors.get(view.number, {})}
                  for view in selection.views],
        'cells': selection.cells.tolist(), 'tilts': selection.tilts,
        'result': session.result and _result_json(session.result),
        'stale': session.result is not None and session.result.numbers != session.numbers,
        'paused': session.is_paused}


def sighting_json(sighting: Sighting) -> dict[str, Any]:
    """Return the corners in the newest image, as parts of its width and height."""
    detection = sighting.detection
    corners = (detection.corners + 0.5) / np.array(detection.size, np.float32)
    return {'corners': np.round(corners, 4).astype(float).round(4).tolist(),
            'capture': printable(sighting.capture, MAX_MESSAGE)}


def seen_json(seen: Sighting | Exception) -> dict[str, Any]:
    """Return the newest image, or why it cannot be read."""
    if isinstance(seen, Sighting):
        return sighting_json(seen)
    return {'corners': [], 'capture': printable(seen, MAX_MESSAGE)}


def _board_note(session: Session) -> str:
    """Return what is special about the board in the images, in words; '' if nothing is."""
    if session.finder is None or not session.finder.board.is_variant:
        return ''
    if session.finder.board.kind == CHARUCO:
        return ('the board has the layout of OpenCV before 4.6, in which the first square is '
                'white: its corners are used so')
    return 'the tags of the board have a black border of one cell: its corners are used so'


def _errors(result: Result | None) -> dict[int, dict[str, Any]]:
    """Return error and tilt of each view that was solved, by its number."""
    if result is None:
        return {}
    calibration = result.calibration
    return {number: {'error': _number(error), 'tilt': _number(tilt, 0),
                     'dropped': not np.isfinite(error)}
            for number, error, tilt in zip(
                result.numbers, calibration.view_errors, calibration.view_tilts)}


def _result_json(result: Result) -> dict[str, Any]:
    found = result.calibration
    values = (found.k[0, 0], found.k[1, 1], found.k[0, 2], found.k[1, 2])
    return {
        'number': result.number, 'model': found.model, 'views': len(result.numbers),
        'rms': _number(found.rms),
        'held_out': _number(found.held_out), 'bend_mm': _number(found.bend * 1000),
        'lens': [{'name': name, 'value': _number(value, 2), 'deviation': _number(deviation)}
                 for name, value, deviation in zip(_LENS, values, found.deviations)],
        'distortion': _rounded(found.d, 5),
        'cells': [[_number(error) for error in row] for row in found.cell_errors],
        'verdict': result.verdict.word, 'reasons': list(result.verdict.reasons)}


def _number(value: float, digits: int = 3) -> float | None:
    """Return a rounded number that JSON can hold."""
    return round(float(value), digits) if np.isfinite(value) else None


def _rounded(values: Any, digits: int) -> list[float | None]:
    return [_number(value, digits) for value in values]


#: Shows a part of the state on a page; a later one of the same kind replaces it.
Show = Callable[[dict[str, Any]], object]


class CameraNode(Protocol):
    """The node of the camera, which has the calibration that is published."""

    @property
    def can_restore(self) -> bool:
        """Whether ``restore`` is possible."""

    async def save(self, result: Result) -> str:
        """Set the calibration; return what was done, in words."""

    async def restore(self) -> str:
        """Set the calibration before the first ``save``; return what was done, in words."""


class LiveCalibration(Watched[Show]):
    """
    A session, its searches, and the pages that show it.

    All methods run in the loop of the server.
    """

    unused_seconds = 30.0

    def __init__(self, stream: Stream, searcher: Executor, camera: CameraNode, log: Log) -> None:
        """
        Start a session without a board.

        :param searcher: the thread that searches.
        """
        super().__init__()
        stream.acquire()
        self.stream = stream
        self.session = Session()
        self._camera = camera
        self._log = log
        self._solver = Solver()
        self._numbers = itertools.count(1)  # of the results
        self._work: asyncio.Task[None] | None = None
        self._busy = ''
        self._shown: tuple[object, ...] = ()
        self._search = BoardSearch(
            stream, self.session, searcher, lambda: bool(self.watchers), self._show_seen)

    def close(self) -> None:
        """End the searches and the solution."""
        self.stream.release()
        self._search.close()
        if self._work:
            self._work.cancel()
        self._solver.close()

    def state(self) -> dict[str, Any]:
        """Return the state of the session for a page."""
        return {'state': {
            **session_json(self.session), 'topic': self.stream.name, 'busy': self._busy,
            'restorable': self._camera.can_restore}}

    def act(self, message: dict[str, Any]) -> None:
        """
        Do what a page wants.

        :raises CalibrationError: it is not possible now.
        :raises RequestError: the message has no known key.
        """
        word = next((word for word in _ACTIONS if word in message), None)
        if word is None:
            raise RequestError('the message has no known key, such as board or solve')
        _ACTIONS[word](self, message[word])
        self._show(self.state())

    def solve(self, model: Any) -> None:
        """
        Begin to solve.

        :raises CalibrationError: there is no such model, or there are too few views.
        """
        def begin() -> Coroutine[Any, Any, str]:
            check_model(model)
            self.session.begin_solution()
            return self._solved(model)

        self._start('solving', begin)

    def save(self, number: Any) -> None:
        """
        Begin to set the calibration of the camera.

        :param number: number of the result, which must be the present one.
        :raises CalibrationError: there is none, or another one has replaced it.
        """
        result = self.session.result
        if result is None:
            raise CalibrationError('there is no result to save: solve first')
        if type(number) is not int or number != result.number:
            raise CalibrationError('another result has replaced the one that was shown: look at '
                                   'it, then save')
        self._start('saving', lambda: self._camera.save(result))

    def restore(self) -> None:
        """
        Begin to set the former calibration of the camera.

        :raises CalibrationError: the session is busy.
        """
        self._start('restoring', self._camera.restore)

    async def _solved(self, model: str) -> str:
        selection, numbers = self.session.selection, self.session.numbers
        calibration, verdict = await self._solver.solve(selection.detections, model)
        if selection is not self.session.selection:
            return 'the views were removed: there is no result'
        self.session.result = Result(calibration, verdict, numbers, next(self._numbers))
        return f'solved: the calibration is {verdict.word}'

    def _start(self, busy: str, begin: Callable[[], Coroutine[Any, Any, str]]) -> None:
        """Begin work that takes time; only one at a time."""
        if self._busy:
            raise CalibrationError(f'the session is {self._busy}: wait')
        self._work = asyncio.ensure_future(self._do(begin()))
        self._busy = busy

    async def _do(self, work: Coroutine[Any, Any, str]) -> None:
        """Wait for work that takes time, and show its outcome."""
        try:
            self.session.notice = await work
        except (CalibrationError, RequestError) as err:
            self.session.notice = str(err)[:MAX_MESSAGE]
        except Exception as err:  # noqa: B902 (the page must not wait for ever)
            self.session.notice = f'it has failed: {str(err)[:MAX_MESSAGE]}'
            self._log.error(f'the calibration of {self.stream.name} has failed while '
                            f'{self._busy}: {type(err).__name__}: {err}')
        finally:
            self._busy = ''
        self._show(self.state())

    def _show_seen(self, frame: str, seen: Seen) -> None:
        """Show what was found in a frame, and the state if it has changed."""
        self._show({'seen': {'frame': frame, **seen_json(seen)}})
        session = self.session
        present = session.hint, session.numbers, session.size, session.notice
        if present != self._shown:
            self._shown = present
            self._show(self.state())

    def _show(self, message: dict[str, Any]) -> None:
        for show in tuple(self.watchers):
            show(message)


# What each word of a page does, given its value.
_ACTIONS: dict[str, Callable[[LiveCalibration, Any], None]] = {
    'board': lambda live, text: live.session.choose(text),
    'delete': lambda live, number: live.session.delete(number),
    'take': lambda live, _: live.session.ask(),
    'discard': lambda live, _: live.session.discard('all views were removed'),
    'resume': lambda live, _: live.session.resume(),
    'solve': lambda live, model: live.solve(model),
    'save': lambda live, number: live.save(number),
    'restore': lambda live, _: live.restore(),
}
