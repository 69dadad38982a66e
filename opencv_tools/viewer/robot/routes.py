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

"""Addresses below ``/robot/``: the page of robot_view, its document and its meshes."""

from __future__ import annotations

from collections.abc import Mapping
import hashlib
from typing import Any

from opencv_tools.robot.view.single_file import INDEX, page_policy, read_page
from opencv_tools.viewer.page_files import PageFile
from opencv_tools.viewer.robot.live import LiveRobots
from opencv_tools.viewer.robot.robot_socket import RobotSocket
from opencv_tools.viewer.web import FileHandler, IndexHandler, Site, SiteHandler
from tornado.web import HTTPError

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
