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

"""The packets of a camera that encodes H.264, none of which may be left out."""

from __future__ import annotations

from contextlib import suppress
import time

from opencv_tools.capture.errors import BrokenFrameError
from opencv_tools.capture.frame import CapturedFrame, live_frame
from opencv_tools.capture.live_video import LivePicture, LiveVideo
from opencv_tools.capture.v4l2.device import capture_ns, DequeuedBuffer, VideoDevice

_FORCE_KEY_FRAME = 0x009909e5  # V4L2_CID_MPEG_VIDEO_FORCE_KEY_FRAME
_REQUEST_SECONDS = 1.0  # between two requests of a key frame


class CameraPackets:
    """Read each packet of a camera in order."""

    #: Packets of half a second at 30 Hz, because a lost one costs others.
    buffers = 16
    needs_every = True

    def __init__(self, device: VideoDevice) -> None:
        """
        Wait for a key frame.

        :param device: device that sends H.264.
        """
        self._device = device
        self._video = LiveVideo()
        self._sequence = -1
        self._picture: LivePicture | None = None
        self._stamp_ns = 0
        self._requested_at = -_REQUEST_SECONDS

    @property
    def missed(self) -> int:
        """Count of the packets that could not be used."""
        return self._video.missed

    def wait(self, seconds: float) -> bool:
        """
        Wait for a packet that follows the last one, or for a key frame.

        :param seconds: timeout in seconds.
        :returns: False when the timeout has passed, or the packet could not be used.
        :raises OSError: the stream has failed.
        """
        if self._picture is None and self._device.wait(seconds):
            buffer = self._device.dequeue()
            if buffer:
                data = bytes(self._device.image(buffer))
                self._device.requeue(buffer.index)
                self._add(buffer, data)
        return self._picture is not None

    def skip(self) -> None:
        """Drop the packet. The next one is a key frame."""
        self._picture = None
        self._video.lose(0)

    def read(self) -> CapturedFrame:
        """
        Return the packet for which ``wait`` returned True.

        :raises BrokenFrameError: there is none.
        """
        picture, self._picture = self._picture, None
        if picture is None:
            raise BrokenFrameError('has no packet yet')
        return live_frame(picture, self._stamp_ns)

    def request_key_frame(self) -> None:
        """Request a key frame, at most one a second; not every camera sends it."""
        now = time.monotonic()
        if now >= self._requested_at + _REQUEST_SECONDS:
            self._requested_at = now
            with suppress(OSError):  # the next key frame comes by itself
                self._device.set_control(_FORCE_KEY_FRAME, 1)

    def _add(self, buffer: DequeuedBuffer, data: bytes) -> None:
        gap = buffer.sequence - self._sequence - 1 if self._sequence >= 0 else 0
        self._sequence = buffer.sequence
        if gap > 0 or buffer.broken:
            self._video.lose(max(0, gap) + buffer.broken)
        if not buffer.broken:
            self._picture = self._video.add(data)
            self._stamp_ns = capture_ns(buffer)
        if self._video.needs_key:
            self.request_key_frame()
