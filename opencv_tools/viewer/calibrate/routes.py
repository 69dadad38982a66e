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

"""Addresses below ``/calibrate``: the page, printable boards and the calibration file."""

from __future__ import annotations

import asyncio
import re
from typing import Any

from opencv_tools.viewer.calibrate.calibration_socket import CalibrationSocket, check_control
from opencv_tools.viewer.calibrate.camera_info import check_raw
from opencv_tools.viewer.calibrate.files import board_file, camera_file
from opencv_tools.viewer.calibrate.sessions import Calibrations
from opencv_tools.viewer.errors import RequestError
from opencv_tools.viewer.page_files import CALIBRATE
from opencv_tools.viewer.protocol import base_name, topic_of
from opencv_tools.viewer.web import IndexHandler, Refusal, Site, SiteHandler


def calibration_routes(site: Site) -> list[Any]:
    """Return the routes of an application with the setting ``calibrations``."""
    keywords = {'site': site}
    return [
        ('/calibrate', CalibrateHandler, keywords),
        ('/calibrate/ws', CalibrationSocket, keywords),
        ('/calibrate/board', BoardHandler, keywords),
        ('/calibrate/camera.yaml', FileHandler, keywords),
    ]


class CalibrateHandler(IndexHandler):
    """The page."""

    page_name = CALIBRATE

    async def prepare(self) -> None:
        """Refuse all requests without control, and rectified images."""
        await super().prepare()
        check_control(self.site)
        try:
            check_raw(base_name(self.get_query_argument('topic', '')))
        except RequestError as err:
            raise Refusal(err) from err


class BoardHandler(SiteHandler):
    """A board for a printer."""

    async def get(self) -> None:
        """Write the file."""
        check_control(self.site)
        text = self.get_query_argument('board', '')
        kind = self.get_query_argument('format', 'pdf')
        try:
            content, content_type = await asyncio.to_thread(board_file, text, kind)
        except RequestError as err:
            raise Refusal(err) from err
        self.set_header('Content-Type', content_type)
        self.set_header('Content-Disposition', f'attachment; filename="board.{kind}"')
        await self.finish(content)


class FileHandler(SiteHandler):
    """The result as a file of camera_info_manager."""

    async def get(self) -> None:
        """Write the file."""
        check_control(self.site)
        try:
            topic = topic_of(self.get_query_argument('topic', None))
            calibrations: Calibrations = self.settings['calibrations']
            result = calibrations.find(topic).session.result
            if result is None or self.get_query_argument('result', '') != str(result.number):
                raise RequestError('there is no such result: solve first, or look at the new one',
                                   404)
        except RequestError as err:
            raise Refusal(err) from err
        name = re.sub('[^A-Za-z0-9_]+', '_', topic.rpartition('/')[0].strip('/'))[:64] or 'camera'
        self.set_header('Content-Type', 'application/yaml')
        self.set_header('Content-Disposition', f'attachment; filename="{name}.yaml"')
        await self.finish(camera_file(result.calibration, name))
