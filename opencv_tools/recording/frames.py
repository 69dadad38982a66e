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

"""What is recorded: frames as they come, raw or compressed."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
import time
from typing import Any

from numpy.typing import NDArray
from opencv_tools.image.compressed import stored_encoding
from opencv_tools.image.picture_size import MAX_PIXELS
from opencv_tools.pictures import decode_picture
from opencv_tools.recording.naming import Labels


@dataclass(frozen=True)
class ReceivedFrame(Labels):
    """
    What frames of both kinds have.

    :param receive_ns: when the message came, in nanoseconds of the system's clock.
    :param arrival_ns: the same in nanoseconds of a clock that nobody sets, CLOCK_MONOTONIC.
    """

    receive_ns: int
    arrival_ns: int = field(default_factory=time.monotonic_ns, kw_only=True)

    @property
    def time_ns(self) -> int:
        """Give the time of the frame in nanoseconds: its stamp, or when it came without one."""
        return self.stamp_ns or self.receive_ns


@dataclass(frozen=True)
class RawFrame(ReceivedFrame):
    """
    A frame as pixels.

    :param image: (h, w) or (h, w, c) array of the frame's encoding, that nobody writes to any
        more; chroma in rows of its own stands below the luma.
    """

    image: NDArray[Any]

    def decode(self) -> RawFrame:
        """Give the frame as pixels."""
        return self


@dataclass(frozen=True)
class CompressedFrame(ReceivedFrame):
    """
    A frame as the content of a picture file; its encoding is the format of the message.

    :param data: a buffer of bytes that nobody writes to any more.
    :param max_pixels: more than so many are not decoded.
    """

    data: Any
    max_pixels: int = MAX_PIXELS

    def decode(self) -> RawFrame:
        """
        Give the frame as pixels.

        :raises ImageError: the data are no picture that can be read.
        """
        image = decode_picture(self.data, max_pixels=self.max_pixels)
        encoding = stored_encoding(image, self.encoding)
        return RawFrame(self.stamp_ns, self.frame_id, encoding.name, self.topic, self.receive_ns,
                        image, arrival_ns=self.arrival_ns)


class Arrivals:
    """Convert times of the system's clock, which may be set at any moment, to arrivals."""

    def __init__(
        self, monotonic: Callable[[], int] = time.monotonic_ns,
        wall: Callable[[], int] = time.time_ns,
    ) -> None:
        """
        Begin now.

        :param monotonic: returns nanoseconds of a clock that only goes on.
        :param wall: returns nanoseconds of the system's clock.
        """
        self._monotonic = monotonic
        self._wall = wall
        self._last = monotonic()

    def arrival_ns(self, receive_ns: int) -> int:
        """
        Return when a message came, by the monotonic clock; never before the last one, nor later.

        :param receive_ns: nanoseconds of the system's clock, a moment ago.
        """
        now = self._monotonic()
        self._last = max(self._last, now - max(0, self._wall() - receive_ns))
        return self._last


#: What is recorded.
Frame = RawFrame | CompressedFrame
