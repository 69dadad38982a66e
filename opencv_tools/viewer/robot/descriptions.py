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

"""Descriptions of the live robot, read one after the other."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Sequence
import hashlib

from opencv_tools.viewer.errors import RequestError
from opencv_tools.viewer.robot.reader import LiveRobot, read_description
from opencv_tools.viewer.robot.topics import DESCRIPTION, Inbox
from rclpy.serialization import deserialize_message
from std_msgs.msg import String

_READ_SECONDS = 1.0  # between the begins of two readings


class Descriptions:
    """
    The newest robot, at most one reading each second; an error leaves the robot as it is.

    All methods run in the loop of the server.
    """

    def __init__(self, on_change: Callable[[bool], object]) -> None:
        """
        Create an object without a robot.

        :param on_change: called before and after a reading; its argument is whether there is a
            new robot.
        """
        self.robot: LiveRobot | None = None
        self.version = 0
        #: Reason why the newest description cannot be read; '' else.
        self.error = ''
        #: Whether a description is being read.
        self.is_reading = False
        self._on_change = on_change
        self._digest = b''
        self._task: asyncio.Task[None] | None = None

    def close(self) -> None:
        """End the reading."""
        if self._task:
            self._task.cancel()

    def refuse(self, reason: str) -> None:
        """Show why a description cannot be read, or does not arrive."""
        self.error = reason
        self._on_change(False)

    def read(self, inbox: Inbox, topic: str) -> None:
        """Read the newest description of an inbox, unless an older one is being read."""
        if self._task is None and (found := inbox.take(DESCRIPTION)):
            self._task = asyncio.ensure_future(self._read_all(inbox, found, topic))

    async def _read_all(self, inbox: Inbox, found: Sequence[bytes], topic: str) -> None:
        try:
            while found:
                await asyncio.gather(self._read(found[-1], topic), asyncio.sleep(_READ_SECONDS))
                found = inbox.take(DESCRIPTION)
        finally:
            self._task = None

    async def _read(self, message: bytes, topic: str) -> None:
        try:
            data = deserialize_message(message, String).data.encode(errors='replace')
            digest = hashlib.sha256(data).digest()
            if digest == self._digest:
                return
            self._digest, self.is_reading = digest, True
            self._on_change(False)
            robot = await read_description(data, topic)
        except (OSError, RequestError, RuntimeError) as err:  # rclpy's RMWError is private
            self.is_reading = False
            self.refuse(str(err))
            return
        self.is_reading = False
        self.robot, self.version, self.error = robot, self.version + 1, ''
        self._on_change(True)
