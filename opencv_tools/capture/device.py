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

"""A V4L2 capture device: opened, asked for its formats and controls, and streamed from."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
import ctypes
from dataclasses import dataclass
import errno
import mmap
import os
from pathlib import Path
import select
from threading import RLock
from typing import Any

from opencv_tools.capture import videodev
from opencv_tools.capture.controls import changed_controls, Control, list_controls
from opencv_tools.capture.modes import Mode
from opencv_tools.capture.offers import list_modes, list_rates, per_second
from opencv_tools.capture.videodev import ask, ask_about
from opencv_tools.image.text import printable

# Enough to capture into while one is read and one waits.
_BUFFERS = 4


@dataclass(frozen=True)
class StreamFormat:
    """What a device really sends: ``step`` is bytes from one line to the next."""

    fourcc: str
    width: int
    height: int
    step: int


@dataclass(frozen=True)
class Captured:
    """
    A filled buffer.

    :param index: which one, for ``VideoDevice.requeue``.
    :param start: the first byte of the picture in it.
    :param stop: the byte behind the last one.
    :param sequence: the device's count of frames.
    :param stamp_ns: the driver's stamp in nanoseconds of CLOCK_MONOTONIC, 0 when it has another.
    :param broken: the device says that the data are damaged.
    """

    index: int
    start: int
    stop: int
    sequence: int
    stamp_ns: int
    broken: bool


class VideoDevice:
    """A capture device; its methods may be called from several threads."""

    def __init__(self, path: Path) -> None:
        """
        Open a device.

        :raises OSError: it cannot be opened, with ENOTTY when it is no V4L2 device.
        """
        self._lock = RLock()
        self._fd = os.open(path, os.O_RDWR | os.O_NONBLOCK | os.O_CLOEXEC)
        self._maps: list[mmap.mmap] = []
        capability = videodev.Capability()
        try:
            ask(self._fd, videodev.QUERYCAP, capability)
        except OSError:
            os.close(self._fd)
            raise
        self.card = printable(capability.card.decode('utf-8', 'replace'))
        has_own = capability.capabilities & videodev.HAS_DEVICE_CAPS
        able = capability.device_caps if has_own else capability.capabilities
        captures = able & (videodev.CAN_CAPTURE | videodev.CAN_CAPTURE_PLANES)
        self.can_capture = bool(captures and able & videodev.CAN_STREAM)
        # The image processors of some boards tell of each plane, if there is but one.
        self._planar = captures == videodev.CAN_CAPTURE_PLANES
        self._type = videodev.CAPTURE_PLANES if self._planar else videodev.CAPTURE

    def close(self) -> None:
        """Stop and let go of the device; closing twice is allowed."""
        with self._lock:
            if self._fd < 0:
                return
            for mapped in self._maps:
                mapped.close()
            self._maps.clear()
            os.close(self._fd)
            self._fd = -1

    def modes(self, near: tuple[int, int]) -> list[Mode]:
        """
        List formats and sizes; where any size goes, the one nearest to ``near`` (width, height).

        :raises OSError: the device is gone.
        """
        with self._opened() as fd:
            return list(list_modes(fd, self._type, near))

    def rates(self, mode: Mode) -> list[float]:
        """
        List the frames per second of a mode; of a range its ends; empty when it is not told.

        :raises OSError: the device is gone.
        """
        with self._opened() as fd:
            return sorted(list_rates(fd, mode))

    def set_format(self, mode: Mode) -> StreamFormat:
        """
        Ask for a format.

        :returns: what the device made of it.
        :raises OSError: the device refuses, with EBUSY when another program streams from it.
        """
        structure = videodev.PlanarFormat if self._planar else videodev.Format
        wanted: Any = structure(
            type=self._type, width=mode.width, height=mode.height,
            pixelformat=videodev.pack_fourcc(mode.fourcc), field=videodev.FIELD_ANY)
        with self._opened() as fd:
            ask(fd, videodev.S_FMT, wanted)
        step = wanted.planes[0].bytesperline if self._planar else wanted.bytesperline
        return StreamFormat(
            videodev.unpack_fourcc(wanted.pixelformat), wanted.width, wanted.height, step)

    def set_rate(self, rate: float) -> float:
        """
        Ask for a rate in frames per second.

        :returns: what the device made of it, 0.0 when it does not tell.
        :raises OSError: the device is gone.
        """
        parameters = videodev.StreamParameters(type=self._type)
        with self._opened() as fd:
            if not ask_about(fd, videodev.G_PARM, parameters):
                return 0.0
            if parameters.capability & videodev.HAS_TIME_PER_FRAME:
                parameters.timeperframe = videodev.Fraction(1000, round(rate * 1000))
                ask_about(fd, videodev.S_PARM, parameters)
        return per_second(parameters.timeperframe)

    def controls(self, changed: bool = False) -> list[Control]:
        """
        List the settings that can be changed and are one number.

        :param changed: only those that were changed since they were listed.
        :raises OSError: the device is gone.
        """
        with self._opened() as fd:
            return list(changed_controls(fd) if changed else list_controls(fd))

    def control(self, control: Control) -> int:
        """
        Read a setting.

        :raises OSError: the device refuses.
        """
        value = videodev.ControlValue(control.number)
        with self._opened() as fd:
            ask(fd, videodev.G_CTRL, value)
        return int(value.value)

    def set_control(self, control: Control, value: int) -> None:
        """
        Change a setting.

        :raises OSError: the device refuses.
        """
        with self._opened() as fd:
            ask(fd, videodev.S_CTRL, videodev.ControlValue(control.number, value))

    def start(self) -> None:
        """
        Begin to stream.

        :raises OSError: the device refuses, with EBUSY when another program streams from it.
        """
        with self._opened() as fd:
            request = videodev.BufferRequest(_BUFFERS, self._type, videodev.MMAP)
            ask(fd, videodev.REQBUFS, request)
            for index in range(request.count):
                buffer, plane = self._make_buffer(index)
                ask(fd, videodev.QUERYBUF, buffer)
                self._maps.append(mmap.mmap(
                    fd, plane.length, prot=mmap.PROT_READ, offset=plane.offset))
                self.requeue(index)
            ask(fd, videodev.STREAMON, ctypes.c_int32(self._type))

    @property
    def buffers(self) -> int:
        """Count the buffers that the device may fill before one is given back."""
        return len(self._maps)

    def wait(self, seconds: float) -> bool:
        """
        Wait until a buffer is filled.

        :returns: False when none was in this time.
        :raises OSError: the device is gone, or its stream has broken.
        """
        poll = select.poll()
        poll.register(self._fd, select.POLLIN)
        events = poll.poll(seconds * 1000)
        if events and not events[0][1] & select.POLLIN:
            self.dequeue()  # tells what has happened, most often that the device is gone
            raise OSError(errno.EIO, os.strerror(errno.EIO))
        return bool(events)

    def dequeue(self) -> Captured | None:
        """
        Take the oldest filled buffer.

        :returns: None when none is filled yet.
        :raises OSError: the device is gone, or its stream has broken.
        """
        buffer, plane = self._make_buffer()
        with self._opened() as fd:
            try:
                ask(fd, videodev.DQBUF, buffer)
            except BlockingIOError:
                return None
        stamp_ns = buffer.seconds * 10**9 + buffer.microseconds * 1000
        monotonic = buffer.flags & videodev.BUFFER_CLOCK == videodev.BUFFER_CLOCK_MONOTONIC
        return Captured(
            buffer.index, plane.data_offset if isinstance(plane, videodev.Plane) else 0,
            plane.bytesused or plane.length, buffer.sequence, stamp_ns if monotonic else 0,
            bool(buffer.flags & videodev.BUFFER_IS_BROKEN))

    def content(self, captured: Captured) -> bytes:
        """Copy the picture in a buffer."""
        return self._maps[captured.index][captured.start:captured.stop]

    def requeue(self, index: int) -> None:
        """
        Give a buffer back to be filled.

        :raises OSError: the device is gone.
        """
        with self._opened() as fd:
            ask(fd, videodev.QBUF, self._make_buffer(index)[0])

    def _make_buffer(
        self, index: int = 0,
    ) -> tuple[videodev.Buffer, videodev.Buffer | videodev.Plane]:
        """Make the description of a buffer, and of its plane, which may be the same."""
        buffer = videodev.Buffer(index=index, type=self._type, memory=videodev.MMAP)
        if not self._planar:
            return buffer, buffer
        planes = (videodev.Plane * 1)()
        buffer.offset, buffer.length = ctypes.addressof(planes), len(planes)
        buffer.planes = planes  # which has to live as long
        return buffer, planes[0]

    @contextmanager
    def _opened(self) -> Iterator[int]:
        """Keep the device open while it is asked; a number of a closed file may be another's."""
        with self._lock:
            if self._fd < 0:
                raise OSError('the device is closed')
            yield self._fd
