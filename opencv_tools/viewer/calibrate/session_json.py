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

"""The state of a calibration as the page gets it."""

from __future__ import annotations

from typing import Any

import numpy as np
from opencv_tools.calibration.boards import CHARUCO
from opencv_tools.calibration.views import ENOUGH_CELLS, ENOUGH_VIEWS
from opencv_tools.image.text import printable
from opencv_tools.viewer.calibrate.session import Result, Session, Sighting
from opencv_tools.viewer.errors import MAX_MESSAGE

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
