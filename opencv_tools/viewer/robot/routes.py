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

"""Addresses below ``/robot/``: the page of robot_view, its WebSocket, document and meshes."""

from __future__ import annotations

import asyncio
from collections.abc import Mapping
import hashlib
from typing import Any

from opencv_tools.robot.view.single_file import INDEX, page_policy, read_page
from opencv_tools.viewer.errors import RequestError
from opencv_tools.viewer.protocol import LARGEST, valid_number
from opencv_tools.viewer.robot.live import LiveRobots
from opencv_tools.viewer.web.page_files import PageFile
from opencv_tools.viewer.web.web import FileHandler, IndexHandler, Site, SiteHandler, SocketHandler
from tornado.web import HTTPError

_WINDOW = 3  # messages with positions that the page has not answered


class RobotSocket(SocketHandler):
    """Send the newest positions to a page, as fast as the page answers."""

    def initialize(self, site: Site) -> None:
        """Store the site."""
        super().initialize(site)
        self._robots: LiveRobots = self.settings['robots']
        self._is_watching = False
        self._unread = 0
        self._state: dict[str, Any] = {}
        self._moved: dict[int, list[float]] = {}
        self._version = -1  # of the robot whose positions are waiting
        self._is_writing = False

    def open(self, *_args: str, **_options: str) -> None:  # noqa: A003
        """Count the page; the robot follows when somebody sees it."""
        self.set_nodelay(True)
        try:
            self.site.hub.add_connection(self)
        except RequestError as err:
            self.try_again(err)
            return
        self._post({'hello': {}})

    def on_close(self) -> None:
        """Leave the robot."""
        self._watch(False)
        super().on_close()

    async def answer(self, wanted: dict[str, Any]) -> None:
        """Use a message of the page."""
        if 'got' in wanted:
            valid_number(wanted['got'], 'got', 0, LARGEST)
            self._unread = max(0, self._unread - 1)
            self._flush()
        elif 'watch' in wanted:
            self._watch(wanted['watch'] is True)
        else:
            raise RequestError('the message has no known key, such as watch or got')

    def _watch(self, is_watching: bool) -> None:
        """Follow the robot, or leave it."""
        if is_watching == self._is_watching:
            return
        self._is_watching = is_watching
        self._state, self._moved, self._version = {}, {}, -1
        if is_watching:
            self._robots.join(self)
        else:
            self._robots.leave(self)

    def show(self, state: dict[str, Any]) -> None:
        """Send the state; a later one replaces it. Positions of another robot are forgotten."""
        if state['version'] != self._version:
            self._version, self._moved = state['version'], dict(self._robots.positions.values)
        self._state = state
        self._flush()

    def move(self, positions: dict[int, list[float]]) -> None:
        """Send positions of joints; later ones replace those of the same joint."""
        self._moved.update(positions)
        self._flush()

    def _flush(self) -> None:
        """Send what is waiting, unless the page has not read enough."""
        if self._is_writing:
            return
        if self._state:
            self._post({'state': self._state})
            self._state = {}
        elif self._moved and self._unread < _WINDOW:
            self._unread += 1
            self._post({'version': self._version, 'positions': [*self._moved.items()]})
            self._moved = {}

    def _post(self, message: dict[str, Any]) -> None:
        self._is_writing = True
        self._task = asyncio.ensure_future(self._write(message))

    async def _write(self, message: dict[str, Any]) -> None:
        await self.send_json(message)
        self._is_writing = False
        if self.ws_connection:
            self._flush()


_FOLDER = 'robot/page/'
_ROBOT = 'robot/'  # name of the page
_SHARED = 'connection.js'  # a file of both pages
_POLICY = page_policy(own="'self'", sockets=' ws://{host} wss://{host}', forms="'self'"
                      ) + "; frame-ancestors 'self'"


def with_robot_page(page: Mapping[str, PageFile]) -> dict[str, PageFile]:
    """Return the files of the page by name, and those of the page of the robot."""
    files = {_FOLDER + name: PageFile(
        content, kind, f'"{hashlib.sha256(content).hexdigest()[:16]}"')
        for name, (content, kind) in read_page().items()}
    shared = {_FOLDER + _SHARED: page[_SHARED]}
    return {_ROBOT: files.pop(_FOLDER + INDEX), **page, **files, **shared}


def robot_routes(site: Site) -> list[Any]:
    """Return the routes of an application with the setting ``robots``."""
    keywords = {'site': site}
    return [
        ('/robot/', RobotHandler, keywords),
        (f'/({_FOLDER}[a-z.]{{1,40}})', FileHandler, keywords),
        ('/robot/robot.json', DocumentHandler, keywords),
        ('/robot/mesh/([0-9]{1,6})', MeshHandler, keywords),
        ('/robot/ws', RobotSocket, keywords),
    ]


class RobotHandler(IndexHandler):
    """The page, which a page of this server may have in a frame."""

    page_name = _ROBOT
    policy = _POLICY


class DocumentHandler(SiteHandler):
    """The robot as JSON."""

    async def get(self) -> None:
        """Write the document, or that there is none yet."""
        robots: LiveRobots = self.settings['robots']
        found = robots.descriptions
        body = found.robot.body if found.robot else b'{}'
        self.set_header('Content-Type', 'application/json; charset=utf-8')
        await self.send(f'{{"live":true,"version":{found.version}'.encode(),
                        b',' * (body != b'{}'), memoryview(body)[1:])


class MeshHandler(SiteHandler):
    """A mesh of the robot by its number; a request cannot name a file."""

    async def get(self, number: str) -> None:
        """Write the file."""
        robots: LiveRobots = self.settings['robots']
        robot = robots.descriptions.robot
        meshes = robot.meshes if robot else ()
        found = meshes[int(number)] if int(number) < len(meshes) else None
        if found is None:
            raise HTTPError(404)
        path, size, kind = found
        self.set_header('Content-Type', kind)
        await self.send_file(path, size)
