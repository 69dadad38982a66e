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
"""Boxes of detections, read from untrusted messages."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
import heapq
import math
import struct
from typing import Any

from opencv_tools.base.text import printable
from opencv_tools.base.units import NANO
from opencv_tools.image.errors import CdrError

#: Type of the messages.
DETECTIONS = 'vision_msgs/msg/Detection2DArray'
#: Largest size of a message in bytes, and number of its detections, which bound the time.
MAX_BYTES, MAX_DETECTIONS = 1 << 23, 10_000
#: Largest number of boxes for a page.
MAX_BOXES = 500
#: Largest number of pixels on an axis; no image is so large.
LARGEST = 1e6
_MAX_LABEL = 40
_HEAD_SIZE = 4  # bytes that identify the encapsulation; fields are aligned from their end
_ORDERS = {b'\0\0': '>', b'\0\1': '<'}
_POSE_SIZE = (7 + 36) * 8  # of PoseWithCovariance, which has no place in a picture


@dataclass(frozen=True)
class DetectedBox:
    """
    A box in pixels of the image; the first pixel spans 0 to 1.

    :param place: column and row of its middle, width, height, and angle in radians from the
        columns to the rows.
    """

    place: tuple[float, float, float, float, float]
    label: str


@dataclass(frozen=True)
class Boxes:
    """
    Boxes of a message.

    :param shown: those with the highest scores, best first.
    :param others: number of those with lower scores.
    :param invalid: number of those whose numbers are no box of an image.
    """

    shown: tuple[DetectedBox, ...]
    others: int
    invalid: int

    def as_json(self) -> list[Any]:
        """Return the boxes for the page."""
        return [[*(round(one, 3) for one in box.place), box.label] for box in self.shown]

    def describe(self) -> str:
        """Return the number of boxes, and of those that are left out."""
        count = len(self.shown)
        text = f'{count} boxes' if count != 1 else '1 box'
        if self.others:
            text = f'{count} of {count + self.others} boxes, those with the highest scores'
        return text + (f', {self.invalid} left out without a valid place' if self.invalid else '')


@dataclass(frozen=True)
class BoxHeader:
    """
    Header of a message.

    :param stamp_ns: stamp in nanoseconds; 0 if it has none.
    :param frame_id: coordinate frame; '' if it has none.
    """

    stamp_ns: int
    frame_id: str


def read_header(data: memoryview) -> BoxHeader:
    """
    Read the header of a message.

    :raises CdrError: the bytes are no message, or there are too many.
    """
    if len(data) > MAX_BYTES:
        raise CdrError(f'it has {len(data)} bytes: {MAX_BYTES} are the limit')
    return _Reader(data).header()


def read_boxes(data: memoryview) -> Boxes:
    """
    Read the boxes of a message.

    :raises CdrError: the bytes are no message, or it has too many detections.
    """
    reader = _Reader(data)
    reader.header()
    count = reader.count()
    if count > MAX_DETECTIONS:
        raise CdrError(f'it has {count} detections: {MAX_DETECTIONS} are the limit')
    valid = [one for one in reader.detections(count) if one is not None]
    best = heapq.nlargest(MAX_BOXES, valid, key=lambda one: one[0])
    return Boxes(tuple(DetectedBox(place, _label(name, score)) for score, place, name in best),
                 len(valid) - len(best), count - len(valid))


class _Reader:
    """Reads a Detection2DArray, for which the codec of any message needs ten times as long."""

    def __init__(self, data: memoryview) -> None:
        order = _ORDERS.get(bytes(data[:2]))
        if order is None or len(data) < _HEAD_SIZE:
            raise CdrError(f'{len(data)} bytes that are not plain CDR')
        self._data = data[_HEAD_SIZE:]
        self._at = 0
        self._count, self._stamp, self._score, self._box = (
            struct.Struct(order + fields) for fields in ('I', 'iI', 'd', '5d'))

    def header(self) -> BoxHeader:
        sec, nanosec = self._take(self._stamp, 4)
        return BoxHeader(sec * NANO + nanosec, str(self._string(), errors='replace'))

    def count(self) -> int:
        (count,) = self._take(self._count, 4)
        return int(count)

    def detections(
        self, count: int,
    ) -> Iterator[tuple[float, tuple[float, float, float, float, float], bytes] | None]:
        """Yield score, place and class of each detection; None for one that is no box."""
        for _ in range(count):
            self._take(self._stamp, 4)
            self._string()
            best, name = -math.inf, b''
            for number in range(self.count()):
                found = self._string()
                (score,) = self._take(self._score, 8)
                self._skip(_POSE_SIZE)
                if not number or score > best:
                    name = found
                    best = score if math.isfinite(score) else -math.inf
            x, y, angle, width, height = self._take(self._box, 8)
            self._string()
            is_valid = (abs(x) <= LARGEST and abs(y) <= LARGEST and 0 < width <= LARGEST
                        and 0 < height <= LARGEST and math.isfinite(angle))
            yield (best, (x, y, width, height, math.remainder(angle, math.tau)), name
                   ) if is_valid else None

    def _take(self, fields: struct.Struct, align: int) -> tuple[Any, ...]:
        begin = self._at + -self._at % align
        self._skip(begin - self._at + fields.size)
        return fields.unpack_from(self._data, begin)

    def _string(self) -> bytes:
        size = self.count()
        begin = self._at
        self._skip(size)
        return bytes(self._data[begin:self._at]).removesuffix(b'\0')

    def _skip(self, size: int) -> None:
        self._at += size
        if self._at > len(self._data):
            raise CdrError(f'{len(self._data)} bytes, but at least {self._at} belong to the '
                           'message')


def _label(name: bytes, score: float) -> str:
    text = printable(str(name, errors='replace'), _MAX_LABEL)
    return f'{text} {score:.2f}'.strip() if abs(score) < 1e6 else text
