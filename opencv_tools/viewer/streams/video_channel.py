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

"""Packets of video of one topic for one page."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from opencv_tools.topics.rate_meter import RateMeter
from opencv_tools.viewer.protocol import ViewRequest
from opencv_tools.viewer.streams.packets import ViewedPacket
from opencv_tools.viewer.streams.video_link import VideoLink
from opencv_tools.viewer.streams.video_source import PacketSource

# Seconds after which an answer is late, and after which a decoder is said to hold its pictures.
_LATE_SECONDS, _HELD_SECONDS = 0.5, 2.0
# Unanswered packets and bytes above which a page has fallen behind as well.
_MAX_UNANSWERED, _MAX_UNANSWERED_BYTES = 128, 4 * 2 ** 20


class VideoChannel:
    """
    Send each packet of a source, while the page answers in time.

    A page that falls behind gets nothing until it has answered. Then the next key frame follows.
    """

    #: Largest number of packets that the page has not read.
    window = _MAX_UNANSWERED

    def __init__(
        self, source: PacketSource, options: ViewRequest, codecs: frozenset[str], *,
        link: VideoLink, send: Callable[[ViewedPacket], int], refuse: Callable[[str], object],
    ) -> None:
        """
        Create a channel and send the packets since the last key frame.

        :param codecs: codecs that the page decodes.
        :param link: link to the page.
        :param refuse: called with the reason why there is no video, after which nothing is sent.
        """
        self.stream = source.stream
        self.options = options
        self._source = source
        self._codecs = codecs
        #: Link to the page.
        self.link = link
        self._send = send
        self._refuse = refuse
        self._clock = link.clock
        self._unanswered: dict[int, tuple[float, int]] = {}
        self._sent = RateMeter(self._clock)
        self._last: ViewedPacket | None = None
        self._skipped = 0
        self._needs_key = True
        self._is_refused = False
        source.add(self)

    @property
    def is_ready(self) -> bool:
        """Whether the next packet would be sent."""
        if self._is_refused:
            return False
        return self._is_drained() if self._needs_key else not self._is_late()

    def set_options(self, options: ViewRequest) -> None:
        """Keep what the viewer requests, which does not change packets."""
        self.options = options

    def close(self) -> None:
        """Send nothing any more."""
        self._is_refused = True
        self._source.remove(self)

    def refuse(self, reason: str) -> None:
        """Report to the page once that there is no video."""
        if not self._is_refused:
            self._is_refused = True
            self._refuse(reason)

    def request_key(self) -> None:
        """Send nothing before a key frame, and request one, because the page has lost a packet."""
        self._needs_key = True
        self._source.request_key()

    def packet_arrived(self, viewed: ViewedPacket) -> None:
        """Send a packet, or skip it if the page is behind."""
        packet = viewed.packet
        if self._is_refused:
            return
        if packet.codec not in self._codecs:
            self.refuse(f'this browser cannot decode {packet.codec}')
            return
        if not self.is_ready or (self._needs_key and not packet.is_key):
            if not self._needs_key:
                self.link.fell_behind()
            self._needs_key = True
            self._skipped += 1
            return
        if self._needs_key:
            self._needs_key = False
            self._unanswered.clear()
        self._unanswered[self._send(viewed)] = self._clock(), len(packet.data)
        self._sent.add()
        self._last = viewed

    def answered(self, sequence: int) -> bool:
        """Use an answer of the page; return whether it belongs to this channel."""
        if sequence not in self._unanswered:
            return False
        for earlier in [one for one in self._unanswered if one <= sequence]:
            del self._unanswered[earlier]
        return True

    def status(self) -> dict[str, Any]:
        """Return the state of this channel for its page."""
        sent = None
        if self._last:
            packet = self._last.packet
            sent = {'width': packet.width, 'height': packet.height, 'video': packet.codec,
                    'rate': round(self._sent.rate, 1), 'bytes': len(packet.data),
                    'skipped': self._skipped, 'slow': self.options.slow}
        return {'sent': sent, 'link': None}

    def _is_late(self) -> bool:
        """Return whether the page has fallen behind."""
        if not self._unanswered:
            return False
        sent_at, _ = next(iter(self._unanswered.values()))
        return (self._clock() - sent_at > _LATE_SECONDS
                or len(self._unanswered) >= _MAX_UNANSWERED
                or sum(size for _, size in self._unanswered.values()) > _MAX_UNANSWERED_BYTES)

    def _is_drained(self) -> bool:
        """Return whether the page has answered all packets, except those that it holds back."""
        if not self._unanswered:
            return True
        sent_at, _ = next(reversed(self._unanswered.values()))
        return self._clock() - sent_at > _HELD_SECONDS
