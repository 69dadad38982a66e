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

"""Addresses below ``/calibrate``: the page, its WebSocket, boards and results."""

from __future__ import annotations

import asyncio
from pathlib import Path
import re
import socket
from tempfile import TemporaryDirectory
import time
from typing import Any

from opencv_tools.calibration.board_pictures import board_pdf, board_svg
from opencv_tools.calibration.boards import CalibrationError, FORMS, parse_board
from opencv_tools.calibration.camera_file import write_camera
from opencv_tools.calibration.check import stored_camera
from opencv_tools.calibration.least_squares import MODELS
from opencv_tools.calibration.solve import Calibration
from opencv_tools.viewer.calibrate.camera_info import check_raw
from opencv_tools.viewer.calibrate.live import LiveCalibration
from opencv_tools.viewer.calibrate.session import MAX_BOARD
from opencv_tools.viewer.calibrate.sessions import Calibrations
from opencv_tools.viewer.errors import RequestError
from opencv_tools.viewer.protocol import base_name, topic_of
from opencv_tools.viewer.web.page_files import CALIBRATE
from opencv_tools.viewer.web.web import IndexHandler, Site, SiteHandler, SocketHandler

_PER_SECOND, _MOST = 10.0, 100.0  # messages of a page


class MessageBudget:
    """Messages that a page may send: 100 at once, and 10 each second."""

    def __init__(self) -> None:
        self._left = _MOST
        self._seconds = 0.0

    def spend(self, seconds: float) -> bool:
        """
        Count a message.

        :param seconds: time of the message, of a monotonic clock.
        :returns: whether the page may send it.
        """
        earned = (seconds - self._seconds) * _PER_SECOND
        self._left, self._seconds = min(_MOST, self._left + earned), seconds
        if self._left < 1.0:
            return False
        self._left -= 1.0
        return True


class CalibrationSocket(SocketHandler):
    """Send the state of a calibration to a page, and read what the page wants."""

    most_bad_messages = 20

    def initialize(self, site: Site) -> None:
        """Store the site."""
        super().initialize(site)
        self._calibrations: Calibrations = self.settings['calibrations']
        self._live: LiveCalibration | None = None
        self._budget = MessageBudget()
        self._unsent: dict[str, Any] = {}
        self._writing: asyncio.Task[None] | None = None

    async def prepare(self) -> None:
        """Refuse a page without the token, and all pages without control."""
        await super().prepare()
        check_control(self.site)

    async def open(self, *_args: str, **_options: str) -> None:  # noqa: A003
        """Join the session of the topic, and send its state."""
        self.set_nodelay(True)
        try:
            self.site.hub.add_connection(self)
            name = topic_of(self.get_query_argument('topic', None))
            live = await self._calibrations.join(name, self.show)
        except RequestError as err:
            self.try_again(err)
            return
        if self.ws_connection is None:  # the page was closed meanwhile
            live.leave(self.show)
            return
        self._live = live
        self.show({'hello': {'host': socket.gethostname(), 'topic': name, 'models': [*MODELS],
                             'boards': [*FORMS.values()]}})
        self.show(live.state())

    def on_close(self) -> None:
        """Leave the session."""
        super().on_close()
        if self._live:
            self._live.leave(self.show)
            self._live = None

    async def on_message(self, message: str | bytes) -> None:
        """Answer a message, unless the page sends too many."""
        if self._budget.spend(time.monotonic()):
            await super().on_message(message)
        else:
            await self.refuse(RequestError('the page sends too many messages: wait a second'))

    async def answer(self, wanted: dict[str, Any]) -> dict[str, Any] | None:
        """Do what the page wants; return why it is not possible."""
        if self._live is None:
            raise RequestError('the session has not begun: wait for its state')
        try:
            self._live.act(wanted)
        except CalibrationError as err:
            return {'error': str(err)}
        return None

    def show(self, message: dict[str, Any]) -> None:
        """Send a message; a later one of the same kind replaces it if the page is slow."""
        kind = next(iter(message))
        self._unsent.pop(kind, None)
        self._unsent[kind] = message
        if self._writing is None or self._writing.done():
            self._writing = asyncio.ensure_future(self._write())

    async def _write(self) -> None:
        while self._unsent:
            await self.send_json(self._unsent.pop(next(iter(self._unsent))))


def check_control(site: Site) -> None:
    """
    Check that the node was started with control.

    :raises RequestError: it was not.
    """
    if not site.hub.settings.control:
        raise RequestError(
            'calibration needs control: start the node with control:=true', 403)


_FORMATS = {'pdf': (board_pdf, 'application/pdf'), 'svg': (board_svg, 'image/svg+xml')}


def board_file(text: str, kind: str) -> tuple[bytes, str]:
    """
    Return a board for a printer.

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
    """Return the content of a calibration file."""
    with TemporaryDirectory() as folder:
        path = Path(folder, 'camera.yaml')
        write_camera(path, stored_camera(calibration), name)
        return path.read_bytes()


def calibration_routes(site: Site) -> list[Any]:
    """Return the routes of an application with the setting ``calibrations``."""
    keywords = {'site': site}
    return [
        ('/calibrate', CalibrateHandler, keywords),
        ('/calibrate/ws', CalibrationSocket, keywords),
        ('/calibrate/board', BoardHandler, keywords),
        ('/calibrate/camera.yaml', CalibrationFileHandler, keywords),
    ]


class CalibrateHandler(IndexHandler):
    """The page."""

    page_name = CALIBRATE

    async def prepare(self) -> None:
        """Refuse all requests without control, and rectified images."""
        await super().prepare()
        check_control(self.site)
        check_raw(base_name(self.get_query_argument('topic', '')))


class BoardHandler(SiteHandler):
    """A board for a printer."""

    async def get(self) -> None:
        """Write the file."""
        check_control(self.site)
        text = self.get_query_argument('board', '')
        kind = self.get_query_argument('format', 'pdf')
        content, content_type = await asyncio.to_thread(board_file, text, kind)
        self.set_header('Content-Type', content_type)
        self.set_header('Content-Disposition', f'attachment; filename="board.{kind}"')
        await self.finish(content)


class CalibrationFileHandler(SiteHandler):
    """The result as a file of camera_info_manager."""

    async def get(self) -> None:
        """Write the file."""
        check_control(self.site)
        topic = topic_of(self.get_query_argument('topic', None))
        calibrations: Calibrations = self.settings['calibrations']
        result = calibrations.find(topic).session.result
        if result is None or self.get_query_argument('result', '') != str(result.number):
            raise RequestError('there is no such result: solve first, or look at the new one', 404)
        name = re.sub('[^A-Za-z0-9_]+', '_', topic.rpartition('/')[0].strip('/'))[:64] or 'camera'
        self.set_header('Content-Type', 'application/yaml')
        self.set_header('Content-Disposition', f'attachment; filename="{name}.yaml"')
        await self.finish(camera_file(result.calibration, name))
