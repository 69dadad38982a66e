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

"""Images as video, for pages that take it."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from dataclasses import replace

from opencv_tools.base.text import printable
from opencv_tools.cv_bridge import CvBridgeError
from opencv_tools.image.errors import ImageError, VideoError
from opencv_tools.video.parameter_sets import webcodecs_name
from opencv_tools.video.settings import VideoSettings
from opencv_tools.video.stream import VideoStream
from opencv_tools.viewer.errors import MAX_MESSAGE
from opencv_tools.viewer.streams.feed import NewFrame
from opencv_tools.viewer.streams.packets import PacketFeed, ViewedPacket
from opencv_tools.viewer.streams.pixels import Pixels, read_pixels
from opencv_tools.viewer.streams.rate_limit import EvenRate
from opencv_tools.viewer.streams.stream import Stream
from opencv_tools.viewer.streams.video_link import SLOW_BIT_RATE
from opencv_tools.viewer.streams.video_source import PacketReceiver, PacketSource, PublishedVideo


class EncodedVideo(PacketSource):
    """Encode the newest frame while a page is ready, once for all pages."""

    def __init__(self, stream: Stream, rate: float, loop: asyncio.AbstractEventLoop,
                 settings: VideoSettings) -> None:
        """
        Create a source that encodes nothing until a page comes.

        :param rate: highest rate in Hz.
        """
        super().__init__(stream, loop.time)
        self._settings = settings
        self._rate = rate
        self._encoder = VideoStream(settings)
        self._number = self._frame_number = 0
        self._limit = EvenRate(loop, self._frame_arrived)
        self._is_encoding = False
        self._task: asyncio.Task[None] | None = None
        self._refusal = ''

    def add(self, channel: PacketReceiver) -> None:
        """Send video to a page, or the reason why there is none."""
        if self._refusal:
            channel.refuse(self._refusal)
            return
        super().add(channel)
        self.stream.watchers.add(self._frame_arrived)
        self._frame_arrived()

    def remove(self, channel: PacketReceiver) -> None:
        """Send nothing more to a page; the encoder ends with the last one."""
        super().remove(channel)
        if not self.channels:
            self.stream.watchers.discard(self._frame_arrived)
            self._encoder, self._group = VideoStream(self._settings), []
            self._frame_number = 0  # another page begins with this frame

    def _demand_key(self) -> None:
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
                self.publish(replace(viewed, number=self._number))
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
        return PublishedVideo(stream, stream.feed, subscribe_again, loop.time)
    return EncodedVideo(
        stream, rate, loop, VideoSettings(bit_rate=SLOW_BIT_RATE if is_slow else 0))


def _encode(encoder: VideoStream, pixels: Pixels, stamp_ns: int) -> ViewedPacket:
    """Return the packet of an image, without its number."""
    packet = encoder.encode(pixels.image, pixels.encoding.name, stamp_ns)
    name = webcodecs_name(packet.codec, packet.data) if packet.is_key else ''
    return ViewedPacket(number=0, stamp_ns=stamp_ns, packet=packet, name=name or '')
