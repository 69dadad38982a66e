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

"""Files of a calibration: a board for a printer, and the result."""

from __future__ import annotations

from pathlib import Path
from tempfile import TemporaryDirectory

from opencv_tools.calibration.board_pictures import board_pdf, board_svg
from opencv_tools.calibration.boards import CalibrationError, parse_board
from opencv_tools.calibration.camera_file import write_camera
from opencv_tools.calibration.check import stored_camera
from opencv_tools.calibration.solve import Calibration
from opencv_tools.viewer.calibrate.session import MAX_BOARD
from opencv_tools.viewer.errors import RequestError

_FORMATS = {'pdf': (board_pdf, 'application/pdf'), 'svg': (board_svg, 'image/svg+xml')}


def board_file(text: str, kind: str) -> tuple[bytes, str]:
    """
    Return a board for a printer.

    :param text: description of the board.
    :param kind: ``pdf`` or ``svg``.
    :returns: the content, and its type for HTTP.
    :raises RequestError: there is no such board or format.
    """
    if kind not in _FORMATS:
        raise RequestError(f'format is {kind!r:.20}: give ' + ' or '.join(_FORMATS))
    draw, content_type = _FORMATS[kind]
    try:
        return draw(parse_board(text[:MAX_BOARD])), content_type
    except CalibrationError as err:
        raise RequestError(str(err)) from err


def camera_file(calibration: Calibration, name: str) -> bytes:
    """
    Return the content of a calibration file.

    :param name: name of the camera.
    """
    with TemporaryDirectory() as folder:
        path = Path(folder, 'camera.yaml')
        write_camera(path, stored_camera(calibration), name)
        return path.read_bytes()
