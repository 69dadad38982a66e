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

"""Video of one topic: its packets for all pages that take them, published or encoded."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any

from opencv_tools.base.text import printable
from opencv_tools.cv_bridge import CvBridgeError
from opencv_tools.image.errors import ImageError, VideoError
from opencv_tools.topics.rate_meter import RateMeter
from opencv_tools.video.parameter_sets import webcodecs_name
from opencv_tools.video.settings import VideoSettings
from opencv_tools.video.stream import VideoStream
from opencv_tools.viewer.errors import MAX_MESSAGE
from opencv_tools.viewer.protocol import ViewRequest
from opencv_tools.viewer.region import region_within
from opencv_tools.viewer.streams.encoding import Picture
from opencv_tools.viewer.streams.feed import NewFrame
from opencv_tools.viewer.streams.packets import PacketFeed, ViewedPacket
from opencv_tools.viewer.streams.pixels import Pixels, read_pixels
from opencv_tools.viewer.streams.rate_limit import EvenRate
from opencv_tools.viewer.streams.stream import Stream

#: Bits per second of the video for a slow link.
SLOW_BIT_RATE = 1_000_000

# A page that falls behind twice within this time has a slow link.
_WINDOW_SECONDS = 10.0
# Seconds until the video of the topic is tried again, and their maximum after failures.
_FIRST_TRIAL, _LAST_TRIAL = 30.0, 600.0


class VideoLink:
    """The link of a page, which is slow while the page falls behind with the video of a topic."""

    def __init__(self, clock: Callable[[], float]) -> None:
        """
        Begin with a link that is not slow.

        :param clock: monotonic clock in seconds.
        """
        #: Monotonic clock in seconds.
        self.clock = clock
        self._behind_at: float | None = None
        self._trial_seconds = _FIRST_TRIAL
        self._slow_until: float | None = None  # None before the first failure

    @property
    def is_slow(self) -> bool:
        """Whether the page gets a video of ``SLOW_BIT_RATE``."""
        return self._slow_until is not None and self.clock() < self._slow_until

    def fell_behind(self) -> None:
        """Use that the page has not answered in time."""
        now, before = self.clock(), self._behind_at
        self._behind_at = now
        if self.is_slow or before is None or now - before > _WINDOW_SECONDS:
            return
        if self._slow_until is not None and now - self._slow_until < self._trial_seconds:
            self._trial_seconds = min(2 * self._trial_seconds, _LAST_TRIAL)
        else:
            self._trial_seconds = _FIRST_TRIAL
        self._slow_until = now + self._trial_seconds
        self._behind_at = None


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
        self._unanswered: dict[int, tuple[float, int, object]] = {}
        #: The message of the picture that the page shows; None before the first one.
        self.drawn: object = None
        self._sent = RateMeter(self._clock)
        self._last: ViewedPacket | None = None
        self._skipped = 0
        self._needs_key = True
        self._is_refused = False
        self.stream.acquire()
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
        self.stream.release()

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
        self._unanswered[self._send(viewed)] = self._clock(), len(packet.data), viewed.message
        self._sent.add()
        self._last = viewed

    def answered(self, sequence: int, _busy: float = 0.0) -> bool:
        """Use an answer of the page; return whether it belongs to this channel."""
        if sequence not in self._unanswered:
            return False
        *_, self.drawn = self._unanswered[sequence]
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
        sent_at, *_ = next(iter(self._unanswered.values()))
        return (self._clock() - sent_at > _LATE_SECONDS
                or len(self._unanswered) >= _MAX_UNANSWERED
                or sum(size for _, size, _ in self._unanswered.values())
                > _MAX_UNANSWERED_BYTES)

    def _is_drained(self) -> bool:
        """Return whether the page has answered all packets, except those that it holds back."""
        if not self._unanswered:
            return True
        sent_at, *_ = next(reversed(self._unanswered.values()))
        return self._clock() - sent_at > _HELD_SECONDS


# Packets since the last key frame that a page gets at once when it comes, and their bytes.
_MAX_GROUP, _MAX_GROUP_BYTES = 100, 2 * 2 ** 20
# Seconds between two requests of key frames; repeated requests are served less often.
_FIRST_PAUSE, _LAST_PAUSE = 1.0, 8.0


class PacketSource:
    """Pass packets on to the channels of all pages; used in the loop of the server."""

    def __init__(self, stream: Stream, demand_key: Callable[[], object],
                 clock: Callable[[], float]) -> None:
        """
        Create a source without channels.

        :param demand_key: called for a key frame.
        :param clock: monotonic clock in seconds.
        """
        self.stream = stream
        self.channels: set[VideoChannel] = set()
        self._demand_key = demand_key
        self._clock = clock
        self._group: list[ViewedPacket] = []  # since the last key frame
        self._last_number = -1  # of the packets that pages can decode
        self._requested_at = clock()  # a new source begins with a key frame
        self._pause = _FIRST_PAUSE

    def add(self, channel: VideoChannel) -> None:
        """Send the packets since the last key frame to a page, and all later ones."""
        self.channels.add(channel)
        for packet in self._group:
            channel.packet_arrived(packet)
        if not self._group:
            self.request_key()

    def remove(self, channel: VideoChannel) -> None:
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

    def take(self, feed: PacketFeed) -> None:
        """Pass the packets on that a feed has received."""
        while feed.waiting:
            self.publish(feed.waiting.popleft())

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


class EncodedVideo(PacketSource):
    """Encode the newest frame while a page is ready, once for all pages."""

    def __init__(self, stream: Stream, rate: float, loop: asyncio.AbstractEventLoop,
                 settings: VideoSettings) -> None:
        """
        Create a source that encodes nothing until a page comes.

        :param rate: highest rate in Hz.
        """
        super().__init__(stream, self._encode_key, loop.time)
        self._settings = settings
        self._rate = rate
        self._encoder = VideoStream(settings)
        self._number = self._frame_number = 0
        self._limit = EvenRate(loop, self._frame_arrived)
        self._is_encoding = False
        self._task: asyncio.Task[None] | None = None
        self._refusal = ''

    def add(self, channel: VideoChannel) -> None:
        """Send video to a page, or the reason why there is none."""
        if self._refusal:
            channel.refuse(self._refusal)
            return
        super().add(channel)
        self.stream.watchers.add(self._frame_arrived)
        self._frame_arrived()

    def remove(self, channel: VideoChannel) -> None:
        """Send nothing more to a page; the encoder ends with the last one."""
        super().remove(channel)
        if not self.channels:
            self.stream.watchers.discard(self._frame_arrived)
            self._encoder, self._group = VideoStream(self._settings), []
            self._frame_number = 0  # another page begins with this frame

    def _encode_key(self) -> None:
        self._encoder.requests += 1
        self._frame_number = 0  # the camera may have no newer frame
        self._frame_arrived()

    def _frame_arrived(self) -> None:
        frame = self.stream.feed.newest
        if (frame is None or frame.number == self._frame_number or self._is_encoding
                or not any(channel.is_ready for channel in self.channels)):
            return
        if not self._limit.allows(self._rate, self.stream.feed.rate):
            return
        self._is_encoding = True
        self._frame_number = frame.number
        self._task = asyncio.ensure_future(self._encode(frame, self._encoder))

    async def _encode(self, frame: NewFrame, encoder: VideoStream) -> None:
        """Encode a frame in a thread. The next frame follows, if it has arrived meanwhile."""
        stream = self.stream
        stream.encodings += 1
        try:
            pixels = await stream.in_pool(read_pixels, frame.message)
            viewed = await stream.in_pool(_encode, encoder, pixels, frame.stamp_ns)
        except VideoError as err:
            self._refuse(printable(err, MAX_MESSAGE))
            return
        except (CvBridgeError, ImageError) as err:
            stream.record(frame.number, printable(err, MAX_MESSAGE))
        else:
            if encoder is self._encoder:
                self._number += 1
                self.publish(replace(viewed, number=self._number, message=frame.message))
        finally:
            self._is_encoding = False
        self._frame_arrived()

    def _refuse(self, reason: str) -> None:
        """Send all pages the reason why there is no video."""
        self._refusal = reason
        for channel in tuple(self.channels):
            channel.refuse(reason)


def video_source(stream: Stream, rate: float, subscribe_again: Callable[[], object],
                 is_slow: bool) -> PacketSource:
    """
    Create the source of the video of a stream.

    :param stream: stream of packets or of images.
    :param rate: highest rate at which images are encoded, in Hz.
    :param subscribe_again: called for a key frame of a video topic.
    :param is_slow: whether images are encoded for a slow link.
    """
    loop = asyncio.get_running_loop()
    if isinstance(stream.feed, PacketFeed):
        source = PacketSource(stream, subscribe_again, loop.time)
        stream.watchers.add(partial(source.take, stream.feed))
        return source
    return EncodedVideo(
        stream, rate, loop, VideoSettings(bit_rate=SLOW_BIT_RATE if is_slow else 0))


def _encode(encoder: VideoStream, pixels: Pixels, stamp_ns: int) -> ViewedPacket:
    """Return the packet of an image, without its number."""
    packet = encoder.encode(pixels.image, pixels.encoding.name, stamp_ns)
    name = webcodecs_name(packet.codec, packet.data) if packet.is_key else ''
    return ViewedPacket(number=0, stamp_ns=stamp_ns, packet=packet, name=name or '')
