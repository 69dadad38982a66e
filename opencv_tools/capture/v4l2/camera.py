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

"""A V4L2 camera as a source, the cameras of this machine, and their errors in plain words."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import closing, contextmanager, ExitStack, suppress
import errno
from functools import lru_cache
import grp
import os
from pathlib import Path
import stat
import time
from typing import Literal

from opencv_tools.base.regular_files import natural_order
from opencv_tools.base.text import printable
from opencv_tools.capture.errors import BrokenFrameError, CaptureError, UnavailableError
from opencv_tools.capture.frame import CapturedFrame, live_frame, VIDEO
from opencv_tools.capture.live_video import LivePicture, LiveVideo
from opencv_tools.capture.v4l2.controls import Control
from opencv_tools.capture.v4l2.device import capture_ns, DequeuedBuffer, VideoDevice
from opencv_tools.capture.v4l2.modes import (
    CameraRequest, choose_mode, DEFAULT_RATE, DEFAULT_SIZE, describe_modes, Mode)
from opencv_tools.capture.v4l2.pixel_formats import PIXEL_FORMATS, PixelFormat, read_pixels
from opencv_tools.capture.v4l2.videodev2 import VIDEO_MAJOR

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
        Take over a started camera.

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


@contextmanager
def capture_errors(name: str) -> Iterator[None]:
    """
    Convert each OSError of a device to a CaptureError with a remedy.

    :param name: path of the device, for the message.
    :raises UnavailableError: the camera is disconnected, busy, or the user has no permission.
    :raises CaptureError: the device is not a camera.
    """
    try:
        yield
    except OSError as err:
        raise _to_capture_error(name, err) from err


def check_device(device: Path) -> None:
    """
    Check that a path is a V4L2 device.

    :raises UnavailableError: the path does not exist.
    :raises CaptureError: the path is another kind of file.
    """
    try:
        status = device.stat()
    except OSError as err:
        raise UnavailableError(
            f'camera {device} does not exist; cameras on this machine: {_present()}. '
            'To run without a camera: source:=pattern') from err
    if not stat.S_ISCHR(status.st_mode) or os.major(status.st_rdev) != VIDEO_MAJOR:
        raise CaptureError(f'{device} is not a camera; cameras on this machine: {_present()}')


def _present() -> str:
    """Return the cameras of this machine as text."""
    return ', '.join(map(str, list_cameras())) or 'none'


def list_cameras(folder: Path = Path('/dev')) -> list[Path]:
    """
    Return the devices that can capture video.

    A device that cannot be opened, for example for lack of permission, is included.

    :returns: paths in natural order: ``video2`` before ``video10``.
    """
    cameras = []
    for path in sorted(folder.glob('video*'), key=natural_order):
        with suppress(OSError):  # the device was removed after the listing
            if _can_capture(path, path.stat().st_ctime_ns):
                cameras.append(path)
    return cameras


# Cached, because opening another camera can wake that camera up, and the publisher lists the
# cameras repeatedly while its own is disconnected.
@lru_cache(maxsize=64)
def _can_capture(path: Path, _changed_ns: int) -> bool:
    """
    Return whether a device can capture video; True for a device that cannot be opened.

    :param _changed_ns: change time of the device in nanoseconds; a new device has a new one.
    """
    try:
        with closing(VideoDevice(path)) as device:
            return device.can_capture
    except OSError as err:
        return err.errno != errno.ENOTTY


def _to_capture_error(name: str, err: OSError) -> CaptureError:
    """Convert an OSError of a camera to a CaptureError that says the cause and the remedy."""
    if err.errno in (errno.EACCES, errno.EPERM):
        return UnavailableError(
            f'no permission to use camera {name}; add yourself to its group: '
            f'sudo usermod -aG {_group_name(name)} $USER, then log in again')
    if err.errno == errno.EBUSY:
        return UnavailableError(f'camera {name} is used by another program{_users(name)}')
    if err.errno in (errno.ENODEV, errno.ENXIO, errno.ENOENT):
        return UnavailableError(f'camera {name} is disconnected; check that it is plugged in')
    if err.errno == errno.ENOTTY:
        return CaptureError(f'{name} is not a V4L2 camera; cameras on this machine: {_present()}')
    return UnavailableError(f'camera {name} failed: {err.strerror or err}')


def _group_name(name: str) -> str:
    """Return the group of a device; its number if it has no name, as in some containers."""
    try:
        number = Path(name).stat().st_gid
        return grp.getgrgid(number).gr_name
    except OSError:
        return 'video'
    except KeyError:
        return str(number)


def _users(name: str) -> str:
    """Return the programs that have a device open, as far as this user can see them."""
    try:
        device = Path(name).stat().st_rdev
    except OSError:
        return ''
    users = []
    for process in Path('/proc').glob('[0-9]*'):
        try:
            held = any(file.stat().st_rdev == device for file in (process / 'fd').iterdir())
            if held and process.name != str(os.getpid()):
                command = (process / 'comm').read_text(errors='replace')
                users.append(f'{printable(command.strip())} (pid {process.name})')
        except OSError:
            continue  # the process has ended, or belongs to another user
    return f': {", ".join(users)}' if users else ''


# Relative tolerance of a rate: a camera may use 30000/1001 Hz for 30 Hz.
_RATE_TOLERANCE = 0.01


class CameraSource:
    """
    A V4L2 camera. Each frame has the capture time of its driver.

    ``warnings`` contains a warning for each requested setting that the camera has not applied.
    """

    live: Literal[True] = True

    def __init__(self, device: Path, request: CameraRequest) -> None:
        """
        Open a camera and start streaming.

        :param device: path such as ``/dev/video0``, or a link below ``/dev/v4l/by-id``.
        :raises UnavailableError: the camera is disconnected, busy, or the user has no permission.
        :raises CaptureError: the device is not a camera, or has no supported pixel format.
        """
        self.name = str(device)
        self.missed = 0
        self.warnings: list[str] = []
        check_device(device)
        with capture_errors(self.name), ExitStack() as stack:
            self._device = stack.enter_context(closing(VideoDevice(device)))
            self._start(request)
            stack.pop_all()  # the device stays open

    def wait(self, seconds: float) -> bool:
        with capture_errors(self.name):
            is_there = self._reader.wait(seconds)
        self.missed = self._reader.missed
        return is_there

    def skip(self) -> None:
        with capture_errors(self.name):
            self._reader.skip()

    def read(self) -> CapturedFrame:
        try:
            return self._reader.read()
        except BrokenFrameError as err:
            raise BrokenFrameError(f'camera {self.name} {err}') from err

    def close(self) -> None:
        self._device.close()

    def controls(self, changed: bool = False) -> dict[Control, int]:
        """
        Return the controls of the camera with their values.

        :param changed: whether to return only the controls that changed since the last call.
        :raises UnavailableError: the camera is disconnected.
        """
        values = {}
        with capture_errors(self.name):
            for control in self._device.controls(changed):
                with suppress(OSError):  # some cameras list controls that they do not have
                    values[control] = self._device.control(control)
        return values

    def set_control(self, control: Control, value: int) -> None:
        """
        Write the value of a control.

        :raises UnavailableError: the camera rejects the value, or is disconnected.
        """
        try:
            self._device.set_control(control.number, value)
        except OSError as err:
            raise UnavailableError(f'camera {self.name} rejected {control.name} {value} '
                                   f'({err.strerror or err}): {control.remedy}') from err

    def request_key_frame(self) -> None:
        """Request a key frame of a camera that encodes video."""
        self._reader.request_key_frame()

    def _start(self, request: CameraRequest) -> None:
        if not self._device.can_capture:
            raise CaptureError(
                f'{self.name} ({self._device.card}) cannot capture video; a camera can have '
                'several device numbers, so try the next one')
        modes = self._device.modes((request.width or DEFAULT_SIZE[0],
                                    request.height or DEFAULT_SIZE[1]))
        chosen = choose_mode(modes, request, self._device.rates)
        if chosen is None:
            raise CaptureError(
                f'camera {self.name} offers none of the supported pixel formats '
                f'{", ".join(PIXEL_FORMATS)}; it offers {describe_modes(modes) or "none"}')
        self._mode, step = self._device.set_format(chosen)
        if self._mode.fourcc not in PIXEL_FORMATS:
            raise CaptureError(
                f'camera {self.name} switched from {chosen.fourcc} to the unsupported pixel '
                f'format {self._mode.fourcc}; set fourcc to another format')
        self._reader = camera_reader(
            self._device, PIXEL_FORMATS[self._mode.fourcc], self._mode, step)
        self.needs_every = self._reader.needs_every
        self.rate = self._device.set_rate(request.fps or DEFAULT_RATE)
        self.warnings += _changes(self.name, request, self._mode, self.rate, modes, self._device)
        self._set_controls(dict(request.controls))
        self._device.start(self._reader.buffers)
        self.description = f'{self._mode.fourcc} {self._mode.size} at {self.rate:g} Hz'

    def _set_controls(self, requested: dict[str, int]) -> None:
        for control in self._device.controls() if requested else ():
            if control.name not in requested:
                continue
            try:
                self.set_control(control, requested[control.name])
            except UnavailableError as err:
                self.warnings.append(str(err))


def _changes(
    camera: str, request: CameraRequest, given: Mode, rate: float, modes: list[Mode],
    device: VideoDevice,
) -> Iterator[str]:
    """Yield a warning for each setting that a camera changed, with the supported values."""
    requested = Mode(request.fourcc or given.fourcc, request.width or given.width,
                     request.height or given.height)
    if requested != Mode(given.fourcc, given.width, given.height):
        offered = [mode for mode in modes if mode.fourcc in PIXEL_FORMATS]
        yield (f'camera {camera} cannot send {requested.fourcc} {requested.size} and sends '
               f'{given.fourcc} {given.size} instead; it offers {describe_modes(offered)}')
    if request.fps and abs(rate - request.fps) > _RATE_TOLERANCE * request.fps:
        rates = ', '.join(f'{other:g}' for other in device.rates(given))
        yield (f'camera {camera} cannot send {request.fps:g} Hz and sends {rate:g} Hz instead; '
               f'with {given.fourcc} {given.size} it offers {rates or "only this rate"}')
