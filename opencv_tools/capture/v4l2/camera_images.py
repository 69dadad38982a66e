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

"""Images of a camera, of which the newest is read, and packets of H.264, which are all read."""

from __future__ import annotations

from contextlib import suppress
import time

from opencv_tools.capture.errors import BrokenFrameError
from opencv_tools.capture.frame import CapturedFrame, live_frame, VIDEO
from opencv_tools.capture.live_video import LivePicture, LiveVideo
from opencv_tools.capture.v4l2.device import capture_ns, DequeuedBuffer, VideoDevice
from opencv_tools.capture.v4l2.modes import Mode
from opencv_tools.capture.v4l2.pixel_formats import PixelFormat, read_pixels

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


# A driver that grants two buffers has one at a time, which is full with each frame.
_MIN_FULL = 2


class CameraImages:
    """Read the newest image of a camera. ``missed`` counts the others."""

    #: The driver fills two buffers while one is published, one waits and one is just exchanged.
    buffers = 5
    needs_every = False

    def __init__(
        self, device: VideoDevice, pixel_format: PixelFormat, mode: Mode, step: int,
    ) -> None:
        """
        Wait for the first image.

        :param device: device that sends images.
        :param pixel_format: format of the pixels.
        :param step: bytes of a row; 0 if it is unknown.
        """
        self.missed = 0
        self._device = device
        self._pixel_format, self._mode, self._step = pixel_format, mode, step
        self._sequence = -1
        self._held: DequeuedBuffer | None = None  # not read yet
        self._lent: DequeuedBuffer | None = None  # memory of the last frame

    def wait(self, seconds: float) -> bool:
        """
        Wait for an image. The memory of the last one is filled again.

        :param seconds: timeout in seconds.
        :returns: False when the timeout has passed.
        :raises OSError: the stream has failed.
        """
        of_driver = self._device.buffers - bool(self._lent or self._held)
        self.skip()
        if self._device.wait(seconds):
            self._dequeue_newest(of_driver)
        return self._held is not None

    def skip(self) -> None:
        """Return the memory of the last image and of the held one to the driver."""
        buffer = self._lent or self._held  # never both
        self._lent = self._held = None
        if buffer:
            self._device.requeue(buffer.index)

    def read(self) -> CapturedFrame:
        """
        Read the image for which ``wait`` returned True.

        :raises BrokenFrameError: there is none, or the driver reports it as damaged.
        """
        if self._held is None:
            raise BrokenFrameError('has no frame yet')
        self._lent, self._held = self._held, None
        if self._lent.broken:
            raise BrokenFrameError('sent a damaged frame')
        image = read_pixels(self._pixel_format, self._device.image(self._lent),
                            self._mode.height, self._mode.width, self._step)
        return CapturedFrame(image, self._pixel_format.encoding, capture_ns(self._lent))

    def request_key_frame(self) -> None:
        """Do nothing, because each image stands alone."""

    def _dequeue_newest(self, of_driver: int) -> None:
        """
        Dequeue the newest filled buffer and requeue the older ones.

        :param of_driver: number of buffers that the driver could fill.
        """
        filled = 0
        while (buffer := self._device.dequeue()) is not None:
            if self._held:
                self.skip()
                self.missed += 1
            if self._sequence >= 0:
                self.missed += max(0, buffer.sequence - self._sequence - 1)
            self._held, self._sequence = buffer, buffer.sequence
            filled += 1
        if filled >= max(of_driver, _MIN_FULL):
            # All buffers were full, so the driver has dropped newer frames than these. This frame
            # is old; the next one will be the newest.
            self.skip()
            self.missed += 1


def camera_reader(
    device: VideoDevice, pixel_format: PixelFormat, mode: Mode, step: int,
) -> CameraPackets | CameraImages:
    """
    Return the reader of a camera: of each packet of video, otherwise of the newest image.

    :param device: device of the camera, with this mode.
    :param pixel_format: format of the pixels.
    :param step: bytes of a row; 0 if it is unknown.
    """
    if pixel_format.encoding == VIDEO:
        return CameraPackets(device)
    return CameraImages(device, pixel_format, mode, step)
