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

"""Packets of one topic for all pages that take video."""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

from opencv_tools.viewer.region import region_within
from opencv_tools.viewer.streams.encoding import Picture
from opencv_tools.viewer.streams.packets import PacketFeed, ViewedPacket
from opencv_tools.viewer.streams.stream import Stream

# Packets since the last key frame that a page gets at once when it comes, and their bytes.
_MAX_GROUP, _MAX_GROUP_BYTES = 100, 2 * 2 ** 20
# Seconds between two requests of key frames; repeated requests are served less often.
_FIRST_PAUSE, _LAST_PAUSE = 1.0, 8.0


class PacketReceiver(Protocol):
    """The channel of a page."""

    @property
    def is_ready(self) -> bool:
        """Whether the next packet would be sent."""

    def packet_arrived(self, packet: ViewedPacket) -> None:
        """Send a packet, or skip it."""

    def refuse(self, reason: str) -> None:
        """Report to the page that there is no video."""


class PacketSource:
    """
    Pass packets on to the channels of all pages; used in the loop of the server.

    A subclass gets the packets and requests key frames.
    """

    def __init__(self, stream: Stream, clock: Callable[[], float]) -> None:
        """
        Create a source without channels.

        :param clock: monotonic clock in seconds.
        """
        self.stream = stream
        self.channels: set[PacketReceiver] = set()
        self._clock = clock
        self._group: list[ViewedPacket] = []  # since the last key frame
        self._last_number = -1  # of the packets that pages can decode
        self._requested_at = clock()  # a new source begins with a key frame
        self._pause = _FIRST_PAUSE

    def add(self, channel: PacketReceiver) -> None:
        """Send the packets since the last key frame to a page, and all later ones."""
        self.channels.add(channel)
        for packet in self._group:
            channel.packet_arrived(packet)
        if not self._group:
            self.request_key()

    def remove(self, channel: PacketReceiver) -> None:
        """Send nothing more to a page."""
        self.channels.discard(channel)

    def request_key(self) -> None:
        """Request a key frame, at most once a second."""
        now = self._clock()
        elapsed = now - self._requested_at
        if elapsed < self._pause:
            return
        self._pause = (_FIRST_PAUSE if elapsed > 2 * _LAST_PAUSE
                       else min(2 * self._pause, _LAST_PAUSE))
        self._requested_at = now
        self._demand_key()

    def publish(self, viewed: ViewedPacket) -> None:
        """Pass a packet on, unless an earlier one is missing that it needs."""
        packet = viewed.packet
        if packet.is_key:
            self._group = []
        elif viewed.number != self._last_number + 1:
            self._group, self._last_number = [], -1
            self.request_key()
            return
        self._last_number = viewed.number
        self._keep(viewed)
        size = packet.width, packet.height
        self.stream.record(viewed.number, Picture(  # for the state of the topic
            data=b'', width=size[0], height=size[1], source_size=size, encoding=packet.codec,
            region=region_within(None, *size)))
        for channel in tuple(self.channels):
            channel.packet_arrived(viewed)

    def _keep(self, viewed: ViewedPacket) -> None:
        """Keep a packet for pages that come later, unless there are too many."""
        if not (self._group or viewed.packet.is_key):
            return
        self._group.append(viewed)
        if len(self._group) > _MAX_GROUP or sum(
                len(one.packet.data) for one in self._group) > _MAX_GROUP_BYTES:
            self._group = []

    def _demand_key(self) -> None:
        raise NotImplementedError


class PublishedVideo(PacketSource):
    """Pass on the packets of a video topic."""

    def __init__(self, stream: Stream, feed: PacketFeed, subscribe_again: Callable[[], object],
                 clock: Callable[[], float]) -> None:
        """
        Begin to pass packets on.

        :param subscribe_again: called for a key frame, which publishers send to new subscribers.
        :param clock: monotonic clock in seconds.
        """
        super().__init__(stream, clock)
        self._feed = feed
        self._demand = subscribe_again
        stream.watchers.add(self._take)

    def _take(self) -> None:
        while self._feed.waiting:
            self.publish(self._feed.waiting.popleft())

    def _demand_key(self) -> None:
        self._demand()
