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

"""A V4L2 capture device: its formats, controls and memory-mapped buffers."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager, suppress
import ctypes
from dataclasses import dataclass
import errno
from fcntl import ioctl
import mmap
import os
from pathlib import Path
import select
from threading import RLock
import time

from opencv_tools.base.text import printable
from opencv_tools.capture.v4l2 import videodev2
from opencv_tools.capture.v4l2.controls import changed_controls, Control, list_controls
from opencv_tools.capture.v4l2.modes import list_modes, list_rates, Mode, per_second
from opencv_tools.capture.v4l2.pixel_formats import pack_fourcc, unpack_fourcc
from opencv_tools.capture.v4l2.videodev2 import try_ioctl

# Largest time by which a driver's stamp may be in the future. Some drivers hand over a frame
# before the end of its period and stamp it with that end; vivid does so by most of a period.
_AHEAD_NANOSECONDS = 100_000_000


@dataclass(frozen=True, kw_only=True)
class DequeuedBuffer:
    """
    A filled buffer that the driver has handed over.

    :param index: index of the buffer, for ``VideoDevice.requeue``.
    :param start: offset of the first byte of the image in the buffer.
    :param stop: offset after the last byte of the image.
    :param sequence: the driver's number of the frame.
    :param stamp_ns: the driver's stamp in nanoseconds of CLOCK_MONOTONIC; 0 when the driver uses
        another clock.
    :param broken: whether the driver reports the data as damaged.
    """

    index: int
    start: int
    stop: int
    sequence: int
    stamp_ns: int
    broken: bool


def capture_ns(buffer: DequeuedBuffer) -> int:
    """Return the driver's time of a buffer in nanoseconds; now if it is missing or wrong."""
    now_ns = time.monotonic_ns()
    if not buffer.stamp_ns or buffer.stamp_ns > now_ns + _AHEAD_NANOSECONDS:
        return now_ns
    return buffer.stamp_ns


class VideoDevice:
    """
    A V4L2 capture device. All methods are thread-safe.

    ``card`` is the name of the device, ``can_capture`` whether it can stream video. The methods
    raise an OSError when the device rejects a request, is disconnected or is closed.
    """

    def __init__(self, path: Path) -> None:
        """
        Open a device.

        :raises OSError: the device cannot be opened; ENOTTY when it is not a V4L2 device.
        """
        self._lock = RLock()
        self._fd = os.open(path, os.O_RDWR | os.O_NONBLOCK | os.O_CLOEXEC)
        self._maps: list[mmap.mmap] = []
        capability = videodev2.v4l2_capability()
        try:
            ioctl(self._fd, videodev2.VIDIOC_QUERYCAP, capability)
        except OSError:
            os.close(self._fd)
            raise
        self.card = printable(capability.card.decode('utf-8', 'replace'))
        has_own = capability.capabilities & videodev2.V4L2_CAP_DEVICE_CAPS
        able = capability.device_caps if has_own else capability.capabilities
        captures = able & (
            videodev2.V4L2_CAP_VIDEO_CAPTURE | videodev2.V4L2_CAP_VIDEO_CAPTURE_MPLANE)
        self.can_capture = bool(captures and able & videodev2.V4L2_CAP_STREAMING)
        # The image processors of some boards only have the multi-planar interface, even for
        # formats with one plane.
        self._is_multiplanar = captures == videodev2.V4L2_CAP_VIDEO_CAPTURE_MPLANE
        self._type = (videodev2.V4L2_BUF_TYPE_VIDEO_CAPTURE_MPLANE if self._is_multiplanar
                      else videodev2.V4L2_BUF_TYPE_VIDEO_CAPTURE)

    def close(self) -> None:
        """
        Stop streaming and close the device. A second call has no effect.

        A view of an image keeps the device open until it is gone.
        """
        with self._lock:
            if self._fd < 0:
                return
            with suppress(OSError):  # it is disconnected
                ioctl(self._fd, videodev2.VIDIOC_STREAMOFF, ctypes.c_int32(self._type))
            for mapped in self._maps:
                with suppress(BufferError):  # then the last view of an image closes it
                    mapped.close()
            self._maps.clear()
            os.close(self._fd)
            self._fd = -1

    def modes(self, near: tuple[int, int]) -> list[Mode]:
        """Return the supported formats and sizes; parameter as for ``list_modes``."""
        with self._opened() as fd:
            return list(list_modes(fd, self._type, near))

    def rates(self, mode: Mode) -> list[float]:
        """Return the frame rates of a mode in Hz, in ascending order; see ``list_rates``."""
        with self._opened() as fd:
            return sorted(list_rates(fd, mode))

    def set_format(self, mode: Mode) -> tuple[Mode, int]:
        """
        Request a format.

        :returns: the mode that the device has set, which may differ, and the bytes from the start
            of one line to the start of the next.
        :raises OSError: EBUSY when another program streams.
        """
        request = videodev2.v4l2_format(type=self._type)
        pix = request.fmt.pix_mp if self._is_multiplanar else request.fmt.pix
        pix.width, pix.height = mode.width, mode.height
        pix.pixelformat, pix.field = pack_fourcc(mode.fourcc), videodev2.V4L2_FIELD_ANY
        with self._opened() as fd:
            ioctl(fd, videodev2.VIDIOC_S_FMT, request)
        step = (pix.plane_fmt[0] if self._is_multiplanar else pix).bytesperline
        return Mode(unpack_fourcc(pix.pixelformat), pix.width, pix.height), step

    def set_rate(self, rate: float) -> float:
        """
        Request a frame rate.

        :param rate: frames per second.
        :returns: the rate in Hz that the device has set; 0.0 when the device does not report it.
        """
        parameters = videodev2.v4l2_streamparm(type=self._type)
        capture = parameters.parm.capture
        with self._opened() as fd:
            if not try_ioctl(fd, videodev2.VIDIOC_G_PARM, parameters):
                return 0.0
            if capture.capability & videodev2.V4L2_CAP_TIMEPERFRAME:
                capture.timeperframe = videodev2.v4l2_fract(1000, round(rate * 1000))
                try_ioctl(fd, videodev2.VIDIOC_S_PARM, parameters)
        return per_second(capture.timeperframe)

    def controls(self, changed: bool = False) -> list[Control]:
        """
        Return the controls, as ``list_controls`` or ``changed_controls``.

        :param changed: whether to return only the controls that changed since the last call.
        """
        with self._opened() as fd:
            return list(changed_controls(fd) if changed else list_controls(fd))

    def control(self, control: Control) -> int:
        """Read the value of a control."""
        value = videodev2.v4l2_control(control.number)
        with self._opened() as fd:
            ioctl(fd, videodev2.VIDIOC_G_CTRL, value)
        return int(value.value)

    def set_control(self, number: int, value: int) -> None:
        """Write the value of the control with a number."""
        with self._opened() as fd:
            ioctl(fd, videodev2.VIDIOC_S_CTRL, videodev2.v4l2_control(number, value))

    def start(self, buffers: int) -> None:
        """
        Map the buffers, queue them and start streaming.

        :raises OSError: EBUSY when another program streams.
        """
        with self._opened() as fd:
            request = videodev2.v4l2_requestbuffers(
                buffers, self._type, videodev2.V4L2_MEMORY_MMAP)
            ioctl(fd, videodev2.VIDIOC_REQBUFS, request)
            for index in range(request.count):
                buffer, plane = self._make_buffer(index)
                ioctl(fd, videodev2.VIDIOC_QUERYBUF, buffer)
                offset = plane.m.mem_offset if self._is_multiplanar else plane.m.offset
                self._maps.append(mmap.mmap(fd, plane.length, prot=mmap.PROT_READ, offset=offset))
                self.requeue(index)
            ioctl(fd, videodev2.VIDIOC_STREAMON, ctypes.c_int32(self._type))

    @property
    def buffers(self) -> int:
        """Count of the buffers that the driver can fill before one must be requeued."""
        return len(self._maps)

    def wait(self, seconds: float) -> bool:
        """
        Wait until a buffer is filled.

        :param seconds: timeout in seconds.
        :returns: False when the timeout has passed.
        :raises OSError: the stream has failed.
        """
        poll = select.poll()
        poll.register(self._fd, select.POLLIN)
        events = poll.poll(seconds * 1000)
        if events and not events[0][1] & select.POLLIN:
            self.dequeue()  # raises the cause, most often ENODEV for a disconnected device
            raise OSError(errno.EIO, os.strerror(errno.EIO))
        return bool(events)

    def dequeue(self) -> DequeuedBuffer | None:
        """
        Dequeue the oldest filled buffer.

        :returns: the buffer, or None when no buffer is filled.
        :raises OSError: the stream has failed.
        """
        buffer, plane = self._make_buffer()
        with self._opened() as fd:
            try:
                ioctl(fd, videodev2.VIDIOC_DQBUF, buffer)
            except BlockingIOError:
                return None
        seconds, microseconds = buffer.timestamp
        clock = buffer.flags & videodev2.V4L2_BUF_FLAG_TIMESTAMP_MASK
        is_monotonic = clock == videodev2.V4L2_BUF_FLAG_TIMESTAMP_MONOTONIC
        return DequeuedBuffer(
            index=buffer.index, start=plane.data_offset if self._is_multiplanar else 0,
            stop=plane.bytesused or plane.length, sequence=buffer.sequence,
            stamp_ns=seconds * 10**9 + microseconds * 1000 if is_monotonic else 0,
            broken=bool(buffer.flags & videodev2.V4L2_BUF_FLAG_ERROR))

    def image(self, buffer: DequeuedBuffer) -> memoryview:
        """Return a view of the image in a buffer, until the driver fills it again."""
        return memoryview(self._maps[buffer.index])[buffer.start:buffer.stop]

    def requeue(self, index: int) -> None:
        """Queue the buffer with an index, so that the driver can fill it again."""
        with self._opened() as fd:
            ioctl(fd, videodev2.VIDIOC_QBUF, self._make_buffer(index)[0])

    def _make_buffer(
        self, index: int = 0,
    ) -> tuple[videodev2.v4l2_buffer, videodev2.v4l2_buffer | videodev2.v4l2_plane]:
        """Return a buffer and its plane; the same object twice if it is not multi-planar."""
        buffer = videodev2.v4l2_buffer(
            index=index, type=self._type, memory=videodev2.V4L2_MEMORY_MMAP)
        if not self._is_multiplanar:
            return buffer, buffer
        planes = (videodev2.v4l2_plane * 1)()
        buffer.m.planes, buffer.length = planes, len(planes)
        buffer.planes = planes  # a reference that keeps the planes alive
        return buffer, planes[0]

    @contextmanager
    def _opened(self) -> Iterator[int]:
        """
        Return the descriptor, and keep the device open while the caller uses the descriptor.

        The number of a closed descriptor can belong to another file.

        :raises OSError: the device is closed.
        """
        with self._lock:
            if self._fd < 0:
                raise OSError('the device is closed')
            yield self._fd
