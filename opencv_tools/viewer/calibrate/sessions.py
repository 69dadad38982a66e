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

"""All calibrations of the server, one for each topic."""

from __future__ import annotations

import asyncio
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any

from opencv_tools.logs import Log
from opencv_tools.viewer.calibrate.camera_info import (
    camera_info_of, check_raw, info_topic, set_camera_info)
from opencv_tools.viewer.calibrate.former import Former, read_former
from opencv_tools.viewer.calibrate.live import CalibrationPage, LiveCalibration
from opencv_tools.viewer.calibrate.session import Result
from opencv_tools.viewer.control import Control
from opencv_tools.viewer.errors import NoAnswerError, RequestError
from opencv_tools.viewer.hub import Hub
from sensor_msgs.msg import CameraInfo

_MAX_SESSIONS = 4
# Time after the last page until a session ends, for a reload of the page.
_UNUSED_SECONDS = 30.0


class NodeCamera:
    """The node that publishes a topic. It implements ``Camera``."""

    def __init__(self, hub: Hub, topic: str) -> None:
        """Create an object; no node is called yet."""
        self._hub = hub
        self._topic = topic
        self._former: Former | None = None  # None before a calibration was saved

    @property
    def can_restore(self) -> bool:
        """Whether there is a former calibration."""
        return self._former is not None and self._former.info is not None

    async def save(self, result: Result) -> str:
        """Set the calibration, and keep the one before the first that was saved."""
        former = self._former or await self._read()
        try:
            answer = await self._set(camera_info_of(result.calibration))
        except NoAnswerError as err:
            self._former = former  # the calibration may be set late
            raise RequestError(f'{err}: the calibration may be saved later; save again, or undo '
                               'the saving') from err
        self._former = former
        undo = '' if former.info else f'; it has no undo: {former.problem}'
        return f'saved: {answer}{undo}'

    async def restore(self) -> str:
        """Set the former calibration."""
        if self._former is None:
            raise RequestError('there is no former calibration: it was not saved from here')
        if self._former.info is None:
            raise RequestError(f'there is no former calibration: {self._former.problem}')
        answer = await self._set(self._former.info)
        self._former = None
        return f'the former calibration is back: {answer}'

    async def _read(self) -> Former:
        nodes = await self._nodes()

        async def read(control: Control) -> dict[str, Any]:
            return {'former': await read_former(control, info_topic(self._topic), nodes)}

        found: Former = (await self._hub.control(read))['former']
        return found

    async def _set(self, info: CameraInfo) -> str:
        nodes = await self._nodes()
        answer = await self._hub.control(
            lambda control: set_camera_info(control, self._topic, nodes, info))
        return ': '.join(filter(None, (answer['service'], answer['message'])))

    async def _nodes(self) -> Sequence[str]:
        topic = (await self._hub.refresh()).topics.get(self._topic)
        return topic.nodes if topic else ()


class Calibrations:
    """
    Create a session for the first page of a topic, and end it after the last one.

    All methods run in the loop of the server.
    """

    def __init__(self, hub: Hub, log: Log) -> None:
        """Create an object without sessions."""
        self._hub = hub
        self._log = log
        self._loop = asyncio.get_running_loop()
        self._searcher = ThreadPoolExecutor(1, 'searcher')
        self._sessions: dict[str, LiveCalibration] = {}

    def close(self) -> None:
        """End all sessions."""
        for live in tuple(self._sessions.values()):
            self._end(live)
        self._searcher.shutdown(cancel_futures=True)

    def find(self, name: str) -> LiveCalibration:
        """
        Return the session of a topic.

        :raises RequestError: there is none.
        """
        if name not in self._sessions:
            raise RequestError('there is no calibration of this topic: open its page', 404)
        return self._sessions[name]

    async def join(self, name: str, page: CalibrationPage) -> LiveCalibration:
        """
        Add a page to the session of a topic.

        :raises RequestError: there is no such topic, its images are rectified, or there are too
            many sessions.
        """
        check_raw(name)
        if name not in self._sessions:
            stream = await self._hub.acquire(name, original=True)
            if name in self._sessions or len(self._sessions) >= _MAX_SESSIONS:
                self._hub.release(stream)
            else:
                self._sessions[name] = LiveCalibration(
                    stream, self._searcher, NodeCamera(self._hub, name), self._log)
        if name not in self._sessions:
            raise RequestError(f'{_MAX_SESSIONS} calibrations are open already: close their '
                               'pages, and wait half a minute', 503)
        live = self._sessions[name]
        live.pages.add(page)
        return live

    def leave(self, live: LiveCalibration, page: CalibrationPage) -> None:
        """Remove a page; the session ends half a minute after its last one."""
        live.pages.discard(page)
        if not live.pages:
            self._loop.call_later(_UNUSED_SECONDS, self._end_unused, live)

    def _end_unused(self, live: LiveCalibration) -> None:
        if not live.pages and self._sessions.get(live.stream.name) is live:
            self._end(live)

    def _end(self, live: LiveCalibration) -> None:
        del self._sessions[live.stream.name]
        live.close()
        self._hub.release(live.stream)
