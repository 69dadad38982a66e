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

"""What every source of frames yields, and how it fails."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol

from numpy.typing import NDArray

MAX_RATE = 1000.0  # frames per second; what claims to be faster is wrong

#  CaptureError          the source cannot be opened, or has broken for good
#  └─ BrokenFrameError   one frame is unreadable; the next may be fine


class CaptureError(Exception):
    """A source that cannot be used; the message names it and the remedy."""


class BrokenFrameError(CaptureError):
    """One frame that cannot be read, in a source that goes on."""


@dataclass(frozen=True)
class Frame:
    """
    One picture of a source.

    :param image: (h, w) or (h, w, c) array that nobody writes to any more.
    :param encoding: its sensor_msgs/Image encoding, such as ``'bgr8'``.
    :param stamp_ns: when it was captured, in nanoseconds of CLOCK_MONOTONIC; None for a frame
        of a file, which is as new as the moment it is shown.
    """

    image: NDArray[Any]
    encoding: str
    stamp_ns: int | None = None


class Source(Protocol):
    """
    Somewhere that frames come from, one after the other.

    ``name`` says in a log line what it is. ``rate`` is its own rate in frames per second, 0.0
    when it has none. A ``live`` source goes on whether or not anybody reads it.
    """

    name: str
    rate: float
    live: bool

    def skip(self) -> bool:
        """
        Pass over the next frame without decoding it.

        :returns: False at the end.
        :raises CaptureError: the source has broken.
        """

    def read(self) -> Frame | None:
        """
        Read the next frame.

        :returns: the frame, or None at the end.
        :raises BrokenFrameError: this frame is unreadable; the next call reads the next one.
        :raises CaptureError: the source has broken.
        """

    def rewind(self) -> None:
        """
        Go back to the first frame.

        :raises CaptureError: the source has no way back.
        """

    def close(self) -> None:
        """Let go of the device or file; closing twice is allowed."""
