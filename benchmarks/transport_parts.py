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

"""Parts of the processes that benchmarks/transport.py compares: camera, filter and counters."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
import json
from pathlib import Path
import resource
import sys
from threading import Thread
import time
from typing import Any, Literal

import cv2
import numpy as np
from numpy.typing import NDArray
from opencv_tools.capture.frame import CapturedFrame
from opencv_tools.image.encodings import find_encoding

FRAMES, RESULTS = 'video_frames', 'flipped_frames'
SETTLED_FRAMES = 500  # after which memory should not grow
_NUMBER_BITS = 32
_BITS = np.arange(_NUMBER_BITS)
_WARM_UP = 2**_NUMBER_BITS - 1  # number of frames that do not count
_PAGE = resource.getpagesize()


@dataclass(frozen=True, kw_only=True)
class Load:
    """
    Frames to send.

    :param width: width in pixels.
    :param height: height in pixels.
    :param rate: frames per second.
    :param frames: number of frames that count.
    :param qos: ``reliable`` or ``best_effort``.
    :param namespace: namespace of the nodes.
    :param topic: topic of the last subscribers.
    :param transport: parameter ``transport`` of the package's subscribers.
    :param priority: real-time priority of the package's nodes.
    """

    width: int
    height: int
    rate: float
    frames: int
    qos: str
    namespace: str
    topic: str
    transport: str
    priority: int

    @property
    def frame_bytes(self) -> int:
        """Size of a colour frame in bytes."""
        return self.width * self.height * 3

    @property
    def arguments(self) -> list[str]:
        """Command line arguments of a node."""
        words = ['--ros-args', '-r', f'__ns:={self.namespace}', '-p', f'priority:={self.priority}']
        for topic in (FRAMES, RESULTS):
            words += ['-p', f'qos_overrides.{self.namespace}/{topic}.publisher.reliability:='
                      f'{self.qos}']
        return words


class Meter:
    """
    CPU time, page faults and memory growth from the first counted frame to the last one.

    The CPU time is without that of the work which is left out between these frames.
    """

    def __init__(self) -> None:
        """Start with the first frame."""
        self.frames = 0
        self._left_out = 0.0
        self._settled_rss = 0.0
        self._first = self._last = (0.0, 0, 0.0)

    @contextmanager
    def leave_out(self) -> Iterator[None]:
        """Leave out the CPU time that this thread uses in the block."""
        began = time.thread_time()
        yield
        self._left_out += time.thread_time() - began

    def tick(self) -> None:
        """Count a frame; the first is not charged."""
        self._last = (time.process_time(), resource.getrusage(resource.RUSAGE_SELF).ru_minflt,
                      self._left_out)
        if not self.frames:
            self._first = self._last
        self.frames += 1
        if self.frames == SETTLED_FRAMES:
            self._settled_rss = _resident_mb()

    def report(self, **more: object) -> None:
        """Print the numbers of a frame as JSON."""
        charged = max(1, self.frames - 1)
        cpu, faults, left_out = ((last - first) / charged
                                 for first, last in zip(self._first, self._last))
        growth = _resident_mb() - self._settled_rss if self._settled_rss else 0.0
        _say(json.dumps({'frames': self.frames, 'cpu': (cpu - left_out) * 1e3,
                         'left_out': left_out * 1e3, 'faults': faults, 'growth': growth, **more}))


class Camera:
    """
    A camera that costs nothing: two existing frames in turn.

    The frames that count are numbered. Frames before and after them keep all nodes connected.
    """

    live: Literal[True] = True
    missed = 0
    needs_every = False
    warnings: Sequence[str] = ()
    name = 'a camera'

    def __init__(self, load: Load, encoding: str = 'bgr8') -> None:
        """Create the frames, with an encoding of three or two bytes a pixel."""
        self.description = encoding
        self.rate = load.rate
        self.meter = Meter()
        self._counts = False
        self._frames = load.frames
        random = np.random.default_rng(1)
        shape = load.height, load.width, find_encoding(encoding).channels
        self._images = [random.integers(0, 256, shape, np.uint8) for _ in range(2)]
        for image in self._images:
            image[(0, -1), :_NUMBER_BITS] = 128  # without colour, if the encoding has chroma
        self._due = time.monotonic()

    def begin(self) -> None:
        """Count frames from now on."""
        self._counts = True

    def wait(self, seconds: float) -> bool:
        """Wait until a frame is due."""
        left = self._due - time.monotonic()
        time.sleep(max(0.0, min(left, seconds)))
        return left <= seconds

    def skip(self) -> None:
        """Pass over a frame. After a stall frames come at the rate, as those of a driver do."""
        self._due += 1 / self.rate
        if self._due < time.monotonic():
            self._due = time.monotonic() + 1 / self.rate

    def read(self) -> CapturedFrame:
        """Return the next frame."""
        self.skip()
        if self._counts and self.meter.frames == self._frames:
            self._counts = False
            _say('done')
        number = self.meter.frames if self._counts else _WARM_UP
        image = self._images[number % 2]
        for row in (0, -1):  # the filter exchanges them
            _write_number(image[row], number)
        if self._counts:
            self.meter.tick()
        return CapturedFrame(image, self.description, time.monotonic_ns())

    def close(self) -> None:
        """Release nothing."""


class Flip:
    """The filter of the nodes in the middle, and its CPU time."""

    def __init__(self) -> None:
        """Start with the first frame."""
        self._meter = Meter()
        cv2.setNumThreads(1)  # otherwise the time is not that of this thread

    def __call__(self, image: NDArray[Any], out: NDArray[Any] | None = None) -> NDArray[Any]:
        """Return an image upside down, in a given array if there is one."""
        with self._meter.leave_out():
            flipped: NDArray[Any] = cv2.flip(image, 0, out)
        if _read_number(image[0]) != _WARM_UP:
            self._meter.tick()
        return flipped

    def report(self) -> None:
        """Print the numbers as JSON."""
        self._meter.report()


class Ages:
    """Numbers and ages of the received frames."""

    def __init__(self) -> None:
        """Start with the first frame."""
        self._meter = Meter()
        self._is_ready = False
        self._numbers: list[int] = []
        self._ages: list[int] = []

    def note(self, image: NDArray[Any], stamp_ns: int) -> bool:
        """Record the age of a frame, and return whether the frame counts."""
        age = time.time_ns() - stamp_ns
        number = _read_number(image[0])
        if number == _WARM_UP:
            if not self._is_ready:
                self._is_ready = True
                _say('ready')
            return False
        self._ages.append(age)
        self._numbers.append(number)
        self._meter.tick()
        return True

    def report(self, **more: object) -> None:
        """Print the numbers as JSON."""
        self._meter.report(numbers=self._numbers, ages=self._ages, **more)


def listen(begin: Callable[[], object], end: Callable[[], object]) -> None:
    """Call functions at each line of the standard input, and at its end."""
    def wait() -> None:
        for _ in sys.stdin:
            begin()
        end()

    Thread(target=wait, daemon=True).start()


def _write_number(row: NDArray[Any], number: int) -> None:
    """Write the number of a frame as black and white pixels, which a conversion keeps."""
    row[:_NUMBER_BITS, 0] = (number >> _BITS & 1) * 255


def _read_number(row: NDArray[Any]) -> int:
    """Read the number of a frame."""
    return int(((row[:_NUMBER_BITS, 0] > 127).astype(np.int64) << _BITS).sum())


def _say(line: str) -> None:
    print(line, flush=True)


def _resident_mb() -> float:
    return int(Path('/proc/self/statm').read_text().split()[1]) * _PAGE / 1e6
