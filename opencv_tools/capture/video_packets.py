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

"""Packets of a video whose pictures are decoded or passed over."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
import heapq
from typing import Any

# Containers and codecs whose packets are one picture each, with its time.
_PLAIN = ('mov,mp4', 'matroska')
_PLAIN_CODECS = ('h264', 'hevc', 'av1', 'vp9', 'mpeg4', 'mjpeg')
_REORDERED = 16  # most pictures that follow one in a file and are shown before it
# Packets and bytes that wait until a picture is decoded; more of them are decoded at once.
_MOST_KEPT, _MOST_KEPT_BYTES = 600, 32 << 20


class VideoPackets(Iterator[Any]):
    """
    Packets of ``av``, with the times of the pictures in the order in which they are shown.

    A picture that is passed over is not decoded. Its packet is kept, because a later picture may
    need it, until a key frame is passed over.
    """

    def __init__(self, packets: Iterable[Any], container: Any, codec: str) -> None:
        """
        Read from an iterator.

        :param codec: name of the codec in FFmpeg, such as ``'hevc'``.
        """
        self._packets = iter(packets)
        self._has_times = (codec in _PLAIN_CODECS
                           and container.format.name.startswith(_PLAIN))
        self._kept: list[Any] = []
        self._times: list[int] = []  # heap of pictures that are not shown
        #: Time in ticks of the last picture that was passed over; none is earlier.
        self.passed = -1 << 63

    def __next__(self) -> Any:
        return self._kept.pop(0) if self._kept else self._demux()

    def show(self, ticks: int | None) -> None:
        """Remove the time of a decoded picture, and earlier ones, from those to come."""
        while self._times and ticks is not None and self._times[0] <= ticks:
            heapq.heappop(self._times)

    def pass_over(self) -> int | None:
        """
        Pass over the next picture.

        :returns: its time in ticks; None if it has to be decoded, and at the end.
        """
        while self._has_times and len(self._times) <= _REORDERED:
            try:
                self._kept.append(self._demux())
            except StopIteration:
                break
        if not self._has_times or not self._times or len(self._kept) > _MOST_KEPT or (
                sum(packet.size for packet in self._kept) > _MOST_KEPT_BYTES):
            return None
        self.passed = heapq.heappop(self._times)
        key = max((place for place, packet in enumerate(self._kept) if packet.is_keyframe
                   and packet.pts <= self.passed), default=0)
        if key:  # no later picture needs the packets before
            del self._kept[:key]
        return self.passed

    def _demux(self) -> Any:
        packet = next(self._packets)
        if packet.size:  # the last one has no data
            self._has_times = self._has_times and packet.pts is not None
            if self._has_times and not getattr(packet, 'is_discard', False):
                heapq.heappush(self._times, packet.pts)
        return packet
