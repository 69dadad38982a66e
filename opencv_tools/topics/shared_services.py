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

from opencv_tools.transport.shared_frames.announcement import (
    AnnouncementError, read_announcement)

MAX_PUBLISHERS = 64
# Bytes of an identifier that are the same for all publishers of a process.
_PREFIX_BYTES = 12


class SharedServices:
    """Services by publisher, of at most ``MAX_PUBLISHERS`` publishers."""

    def __init__(self) -> None:
        self._services: dict[bytes, str] = {}
        self._reasons: dict[bytes, str] = {}  # why those of other publishers cannot be reached
        self._broken: dict[str, str] = {}  # reasons by service
        self._numbers: dict[bytes, tuple[int, int]] = {}  # of messages and frames

    def add(self, text: str, sender: bytes) -> None:
        """
        Read an announcement; it replaces the last one of its publisher.

        :param text: message of unknown origin.
        :param sender: identifier of the publisher of the message, from the middleware.
        :raises AnnouncementError: it is malformed, or another process speaks of the publisher.
        """
        announcement = read_announcement(text)
        publisher = bytes.fromhex(announcement.publisher)
        if publisher[:_PREFIX_BYTES] != sender[:_PREFIX_BYTES]:
            raise AnnouncementError('the announcement is of another process than its publisher')
        self._services.pop(publisher, None)
        self._reasons.pop(publisher, None)
        service = announcement.service
        if not service:
            self._reasons[publisher] = 'its /dev/shm has too little room'
        elif not announcement.is_reachable:
            self._reasons[publisher] = (
                'it runs on another machine, in another container or as another user')
        elif service in self._broken:
            self._reasons[publisher] = self._broken[service]
        else:
            self._services[publisher] = service
        if announcement.frames:
            self._numbers[publisher] = announcement.messages, announcement.frames
        for known in (self._services, self._reasons, self._numbers):
            while len(known) > MAX_PUBLISHERS:
                del known[next(iter(known))]

    def pop_numbers(self, publishers: Set[bytes]) -> list[tuple[bytes, int, int]]:
        """Return the last announced numbers of publishers, of messages and of frames, once."""
        return [(publisher, *self._numbers.pop(publisher))
                for publisher in publishers & self._numbers.keys()]

    def remove(self, publisher: bytes, service: str, reason: str) -> None:
        """Remove a service that failed, until its publisher announces another one."""
        if self._services.get(publisher) == service:
            del self._services[publisher]
            self._reasons[publisher] = reason
        self._broken[service] = reason
        while len(self._broken) > MAX_PUBLISHERS:
            del self._broken[next(iter(self._broken))]

    def include(self, publishers: Set[bytes]) -> bool:
        """Return whether all publishers have a service."""
        return publishers <= self._services.keys()

    def explain(self, publishers: Set[bytes]) -> str:
        """Return why a publisher does not share its frames with this process, or ''."""
        return next((self._reasons.get(
            publisher, 'it has no frames yet, or is not of opencv_tools with iceoryx2')
            for publisher in publishers - self._services.keys()), '')

    def of(self, publisher: bytes) -> str:
        """Return the service of a publisher, '' if it has none."""
        return self._services.get(publisher, '')
