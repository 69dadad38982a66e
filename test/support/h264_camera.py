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

"""A camera that encodes H.264, in place of its driver: buffers that the test fills."""

from __future__ import annotations

from collections import deque
from pathlib import Path
import time

from opencv_tools.capture.v4l2.device import DequeuedBuffer
from opencv_tools.capture.v4l2.modes import Mode
import pytest
from waiting import pause

DEVICE = '/dev/video77'
_FORCE_KEY_FRAME = 0x009909e5


class H264Device:
    """What `VideoDevice` is for a driver: modes and filled buffers."""

    card = 'camera of a test'
    can_capture = True
    buffers = 5

    def __init__(self, fourccs: tuple[str, ...] = ('H264',)) -> None:
        self._modes = [Mode(fourcc, 160, 120) for fourcc in fourccs]
        self._filled: deque[DequeuedBuffer] = deque()
        self._data: dict[int, bytes] = {}
        self._sequence = 0
        self.requested_keys = 0

    def send(self, data: bytes, broken: bool = False) -> None:
        """Fill a buffer."""
        self._data[self._sequence] = data
        self._filled.append(DequeuedBuffer(
            index=self._sequence, start=0, stop=len(data), sequence=self._sequence,
            stamp_ns=time.monotonic_ns(), broken=broken))
        self._sequence += 1

    def lose(self) -> None:
        """Fill a buffer that nobody gets."""
        self._sequence += 1

    def modes(self, near: tuple[int, int]) -> list[Mode]:
        return self._modes

    def rates(self, mode: Mode) -> list[float]:
        return [30.0]

    def set_format(self, mode: Mode) -> tuple[Mode, int]:
        return mode, 0

    def set_rate(self, rate: float) -> float:
        return rate

    def controls(self, changed: bool = False) -> list[object]:
        return []

    def set_control(self, number: int, value: int) -> None:
        assert (number, value) == (_FORCE_KEY_FRAME, 1)
        self.requested_keys += 1

    def start(self, buffers: int) -> None:
        assert buffers >= self.buffers

    def wait(self, seconds: float) -> bool:
        if not self._filled:
            pause(min(seconds, 0.005))
        return bool(self._filled)

    def dequeue(self) -> DequeuedBuffer | None:
        return self._filled.popleft() if self._filled else None

    def image(self, buffer: DequeuedBuffer) -> memoryview:
        return memoryview(self._data[buffer.index])

    def requeue(self, index: int) -> None:
        del self._data[index]

    def close(self) -> None:
        self._filled.clear()


def connect(device: H264Device, monkeypatch: pytest.MonkeyPatch) -> H264Device:
    """Let `CameraSource` open a device, and return it."""
    def open_device(path: Path) -> H264Device:
        assert str(path) == DEVICE
        return device

    for name, found in (('VideoDevice', open_device), ('check_device', lambda path: None)):
        monkeypatch.setattr(f'opencv_tools.capture.v4l2.camera.{name}', found)
    return device
