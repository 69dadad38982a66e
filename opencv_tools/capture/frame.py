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
from typing import Any, Literal, Protocol, TypeAlias

from numpy.typing import NDArray

MAX_RATE = 1000.0  # frames per second; what claims to be faster is wrong

#: Encoding of a frame that its camera has compressed itself: its image is the JPEG's bytes.
JPEG = 'jpeg'

#  CaptureError          the source cannot be opened, or has broken for good
#  ├─ UnavailableError   a camera or stream that is not there now, but may be later
#  └─ BrokenFrameError   one frame is unreadable; the next may be fine


class CaptureError(Exception):
    """A source that cannot be used; the message names it and the remedy."""


class UnavailableError(CaptureError):
    """A camera or stream that is not there now, or not for us, and may come back."""


class BrokenFrameError(CaptureError):
    """One frame that cannot be read, or the rest of a file, in a source that goes on."""


@dataclass(frozen=True)
class Frame:
    """
    One picture of a source.

    :param image: (h, w) or (h, w, c) array that nobody writes to any more; of ``JPEG`` the bytes
        of the compressed picture, (n,) uint8.
    :param encoding: its sensor_msgs/Image encoding, such as ``'bgr8'``, or ``JPEG``.
    :param stamp_ns: when it was captured, in nanoseconds of CLOCK_MONOTONIC; of a file's frame
        when it was due to be shown. A source that is a file leaves it to the player.
    :param position: of a file's frame its own time, in seconds; None where it has none.
    """

    image: NDArray[Any]
    encoding: str
    stamp_ns: int = 0
    position: float | None = None


class _Readable(Protocol):
    """
    Somewhere that frames come from, one after the other.

    ``name`` says in a log line what it is, ``description`` what it gives: format, size and rate.
    ``rate`` is its own rate in frames per second, 0.0 when it has none.
    """

    name: str
    description: str
    rate: float

    def close(self) -> None:
        """Let go of the device or file; closing twice is allowed."""


class FileSource(_Readable, Protocol):
    """A source that has a beginning and waits for its reader: a video, pictures, a pattern."""

    live: Literal[False]

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

        :raises CaptureError: it cannot be opened any more.
        """


class LiveSource(_Readable, Protocol):
    """
    A source that goes on whether or not anybody reads it: a camera or a stream.

    ``missed`` counts the frames that it gave and nobody could ask for, for want of time.
    """

    live: Literal[True]
    missed: int

    def wait(self, seconds: float) -> bool:
        """
        Wait for a frame.

        :returns: False when none came in this time.
        :raises UnavailableError: the camera or stream has gone.
        """

    def skip(self) -> None:
        """
        Pass over the frame that ``wait`` has found, without decoding it.

        :raises UnavailableError: the camera or stream has gone.
        """

    def read(self) -> Frame:
        """
        Read the frame that ``wait`` has found, the newest there is.

        :raises BrokenFrameError: this frame is unreadable.
        :raises UnavailableError: the camera or stream has gone.
        """


Source: TypeAlias = 'FileSource | LiveSource'
