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

"""The announced services of publishers that this process can reach."""

from __future__ import annotations

from collections.abc import Set

from opencv_tools.logs import Log
from opencv_tools.ros.shared_frames.announcement import AnnouncementError, read_announcement
from opencv_tools.ros.shared_frames.pages import SharedMemoryError

MAX_PUBLISHERS = 64


class SharedServices:
    """Services by publisher, of at most ``MAX_PUBLISHERS`` publishers."""

    def __init__(self, log: Log) -> None:
        """
        Create an empty table.

        :param log: log for the reasons why frames are not shared.
        """
        self._log = log
        self._services: dict[bytes, str] = {}
        self._reasons: dict[bytes, str] = {}  # why those of other publishers cannot be reached
        self._broken: set[str] = set()

    def add(self, text: str) -> None:
        """Read an announcement of unknown origin; it replaces the last one of its publisher."""
        try:
            announcement = read_announcement(text)
        except AnnouncementError as err:
            self._log.debug(str(err))
            return
        publisher = bytes.fromhex(announcement.publisher)
        self._services.pop(publisher, None)
        self._reasons.pop(publisher, None)
        if not announcement.service:
            self._reasons[publisher] = 'its /dev/shm has too little room'
        elif not announcement.is_reachable:
            self._reasons[publisher] = (
                'it runs on another machine, in another container or as another user')
        elif announcement.service not in self._broken:
            self._services[publisher] = announcement.service
        for texts in (self._services, self._reasons):
            while len(texts) > MAX_PUBLISHERS:
                del texts[next(iter(texts))]

    def remove(self, publisher: bytes, service: str, reason: SharedMemoryError) -> None:
        """Remove a service that failed, until its publisher announces another one."""
        self._log.debug(f'frames are not shared: {reason}')
        if self._services.get(publisher) == service:
            del self._services[publisher]
            self._reasons[publisher] = str(reason)
        if len(self._broken) >= MAX_PUBLISHERS:
            self._broken.clear()
        self._broken.add(service)

    def include(self, publishers: Set[bytes]) -> bool:
        """Return whether all publishers have a service."""
        return publishers <= self._services.keys()

    def explain(self, publishers: Set[bytes]) -> str:
        """Return why a publisher does not share its frames with this process, or ''."""
        return next((self._reasons.get(
            publisher, 'it has no frames yet, reads a file, or is not of opencv_tools with '
            'iceoryx2') for publisher in publishers - self._services.keys()), '')

    def of(self, publisher: bytes) -> str:
        """Return the service of a publisher that has one."""
        return self._services[publisher]
