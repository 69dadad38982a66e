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

"""The frame, and the interface of every source."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Literal, Protocol, TypeAlias

import numpy as np
from numpy.typing import NDArray
from opencv_tools.capture.live_video import LivePicture
from opencv_tools.image.cdr import WireMessage
from opencv_tools.video.messages import WireVideo

MAX_RATE = 1000.0  # frames per second; a source that reports more is wrong

#: Encoding of a frame that is compressed; its image is the bytes of the JPEG of a camera, or of
#: the compressed image of a bag.
JPEG = 'jpeg'

#: Encoding of a frame that is a packet of video from a bag, which is not decoded; its image is the
#: bytes of the packet.
VIDEO = 'video'


@dataclass(frozen=True, kw_only=True)
class Recorded:
    """
    The metadata of a frame in a bag.

    :param message: the message as it was recorded.
    :param log_ns: time of the recording in nanoseconds.
    :param play: number of times that the bag was rewound before this frame.
    :param publish_ns: time of publication in nanoseconds; 0 if unknown.
    :param number: number of the message from its publisher; 0 if unknown.
    :param camera_info: serialized sensor_msgs/CameraInfo of the frame; None if there is none.
    :param info_topic: topic of the camera_info; '' if there is none.
    :param serialized: buffer with the CDR of the message, decompressed; None if unknown.
    """

    message: WireMessage | WireVideo
    topic: str
    log_ns: int
    play: int = 0
    publish_ns: int = 0
    number: int = 0
    camera_info: Any = None
    info_topic: str = ''
    serialized: Any = None

    @property
    def header_ns(self) -> int:
        """Stamp of the message in nanoseconds; 0 if it has none."""
        return self.message.header.stamp_ns

    @property
    def time_ns(self) -> int:
        """Stamp of the message in nanoseconds, or the time of the recording if it has none."""
        return self.header_ns or self.log_ns


@dataclass(frozen=True)
class CapturedFrame:
    """
    One captured image.

    :param pixels: the image, or a function that returns it, always the same one; see `image`.
    :param encoding: sensor_msgs/Image encoding of the image, such as ``'bgr8'``, or ``JPEG``
        or ``VIDEO``.
    :param stamp_ns: capture time in nanoseconds of CLOCK_MONOTONIC. For a frame of a file, the
        time at which the frame was due; the player sets it, the source leaves 0.
    :param position: time of the frame in its file, in seconds; None if the file has no times.
    :param recorded: metadata of the frame if its file is a bag.
    :param video: packet of the frame if its camera or stream sends H.264.
    :param is_due: whether its image is due by the rate that was set. A packet of video that is not
        due is only passed on.
    """

    pixels: NDArray[Any] | Callable[[], NDArray[Any]]
    encoding: str
    stamp_ns: int = 0
    position: float | None = None
    recorded: Recorded | None = None
    video: LivePicture | None = None
    is_due: bool = True

    @property
    def image(self) -> NDArray[Any]:
        """
        Immutable (h, w) or (h, w, c) array of any byte order, decoded when it is used first.

        For ``JPEG`` and ``VIDEO`` frames it has the compressed bytes, (n,) uint8. That of a camera
        is valid until the next frame.

        :raises BrokenFrameError: a frame of ``read_ahead`` cannot be decoded.
        """
        return self.pixels() if callable(self.pixels) else self.pixels

    @property
    def is_video(self) -> bool:
        """Whether it is a frame of video in a bag, decoded or not."""
        return self.recorded is not None and isinstance(self.recorded.message, WireVideo)


def live_frame(picture: LivePicture, stamp_ns: int) -> CapturedFrame:
    """
    Return the frame of a packet of a camera or stream.

    :param stamp_ns: capture time in nanoseconds of CLOCK_MONOTONIC.
    """
    content = np.frombuffer(picture.packet.data, np.uint8)
    return CapturedFrame(content, VIDEO, stamp_ns, video=picture)


class _Readable(Protocol):
    """
    The common part of all sources.

    ``name`` identifies the source in log lines. ``description`` contains its format, size and
    rate. ``rate`` is its native rate in frames per second; 0.0 if it has none.
    """

    name: str
    description: str
    rate: float

    @property
    def warnings(self) -> Sequence[str]:
        """Sentences about what it lacks, or has lost."""

    def close(self) -> None:
        """Close the device or file. A second call has no effect."""


class FileSource(_Readable, Protocol):
    """
    A source that is read at any speed: a video, a bag, image files or the test pattern.

    ``count`` is the number of frames; 0 if it is unknown.
    """

    live: Literal[False]
    count: int

    def skip(self) -> bool:
        """
        Skip the next frame without decoding it.

        :returns: False at the end of the source.
        :raises CaptureError: the source has failed.
        """

    def read(self) -> CapturedFrame | None:
        """
        Read the next frame.

        :returns: the frame, or None at the end of the source.
        :raises BrokenFrameError: this frame is unreadable; the next call reads the next one.
        :raises CaptureError: the source has failed.
        """

    def read_ahead(self) -> CapturedFrame | None:
        """
        Read the next frame, whose image may be decoded when it is used, before the next call.

        :returns: as for ``read``.
        :raises BrokenFrameError: as for ``read``; also raised by the image of the frame.
        :raises CaptureError: the source has failed.
        """

    def rewind(self) -> None:
        """
        Go back to the first frame.

        :raises CaptureError: the source cannot be opened again.
        """


class LiveSource(_Readable, Protocol):
    """
    A source that sends frames at its own speed: a camera or a stream.

    ``missed`` counts the frames that were lost because the reader was too slow. With
    ``needs_every`` each frame needs the one before, so that a skipped one costs those until the
    next key frame.
    """

    live: Literal[True]
    missed: int
    needs_every: bool

    def wait(self, seconds: float) -> bool:
        """
        Wait for a frame. The memory of the last one is filled again.

        :param seconds: timeout in seconds.
        :returns: False when the timeout has passed.
        :raises UnavailableError: the camera or stream is disconnected.
        """

    def skip(self) -> None:
        """
        Drop the frame for which ``wait`` returned True, without decoding it.

        :raises UnavailableError: the camera or stream is disconnected.
        """

    def read(self) -> CapturedFrame:
        """
        Read the frame for which ``wait`` returned True, which is the newest one.

        :raises BrokenFrameError: this frame is unreadable.
        :raises UnavailableError: the camera or stream is disconnected.
        """


Source: TypeAlias = 'FileSource | LiveSource'
