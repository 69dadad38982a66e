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

"""Bags for data sets: numbered pictures, joints and commands with times of any kind."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from opencv_tools.bags.schemas import COMPRESSED_IMAGE
from opencv_tools.image.cdr import compressed_image_to_cdr, WireCompressedImage, WireHeader
from played_bags import Entry, write_mcap, write_rosbag2
from rosbags.typesys import get_typestore, Stores

NANO = 10**9
BEGAN = 1_700_000_000 * NANO
TYPES = get_typestore(Stores.ROS2_JAZZY)
#: Names of the joints of a bag, unless others are given.
JOINTS = ('shoulder', 'elbow', 'wrist')
_BITS = 16
_CELL = 16  # pixels of a cell of a number


def numbered_picture(number: int, width: int = 160, height: int = 120) -> NDArray[np.uint8]:
    """Return a picture with its number in 4 x 4 cells, black or white, which every codec keeps."""
    image = np.full((height, width, 3), 90, np.uint8)
    image[..., 0] = np.linspace(40, 200, width, dtype=np.uint8)
    for bit in range(_BITS):
        row, column = divmod(bit, 4)
        image[row * _CELL:(row + 1) * _CELL, column * _CELL:(column + 1) * _CELL] = (
            235 if number >> bit & 1 else 20)
    return image


def number_of(image: NDArray[np.uint8]) -> int:
    """Return the number in a picture, gray or in colour."""
    gray = image if image.ndim == 2 else image.mean(axis=2)
    middle = _CELL // 2
    return sum(1 << bit for bit in range(_BITS) if gray[
        bit // 4 * _CELL + middle, bit % 4 * _CELL + middle] > 128)


def serialize(type_name: str, **fields: Any) -> bytes:
    """Return the CDR of a message, by rosbags."""
    return bytes(TYPES.serialize_cdr(TYPES.types[type_name](**fields), type_name))


def stamped(time_ns: int) -> Any:
    """Return a header with a time."""
    sec, nanosec = divmod(time_ns, NANO)
    time = TYPES.types['builtin_interfaces/msg/Time'](sec=sec, nanosec=nanosec)
    return TYPES.types['std_msgs/msg/Header'](stamp=time, frame_id='')


def jpeg_entry(number: int, time_ns: int, topic: str = '/cam0/image_raw/compressed',
               log_ns: int | None = None, **size: int) -> Entry:
    """Return a numbered JPEG that was recorded 5 ms after its stamp, unless ``log_ns`` says so."""
    data = cv2.imencode('.jpg', numbered_picture(number, **size))[1].tobytes()
    sec, nanosec = divmod(time_ns, NANO)
    cdr = compressed_image_to_cdr(WireCompressedImage(
        header=WireHeader(sec, nanosec, 'cam'), format='jpeg', data=data))
    return Entry(time_ns + 5_000_000 if log_ns is None else log_ns, cdr, topic, COMPRESSED_IMAGE)


def joints_entry(time_ns: int, values: Sequence[float], names: Sequence[str] = JOINTS,
                 topic: str = '/joint_states', log_ns: int | None = None) -> Entry:
    """Return a JointState, recorded 1 ms after its stamp."""
    empty = np.array([], np.float64)
    data = serialize('sensor_msgs/msg/JointState', header=stamped(time_ns), name=[*names],
                     position=np.array(values, np.float64), velocity=empty, effort=empty)
    return Entry(time_ns + 1_000_000 if log_ns is None else log_ns, data, topic,
                 'sensor_msgs/msg/JointState')


def plain_entry(log_ns: int, value: Any, topic: str, kind: str = 'Bool') -> Entry:
    """Return a message of std_msgs with one field."""
    name = f'std_msgs/msg/{kind}'
    return Entry(log_ns, serialize(name, data=value), topic, name)


@dataclass
class Drive:
    """
    A bag of a camera at 30 Hz and joints at 100 Hz, whose values are functions of their times.

    The number of picture k is k, and its time 33.333 ms times k after the begin.
    """

    seconds: float = 2.0
    topics: Sequence[str] = ('/cam0/image_raw/compressed',)
    lost: frozenset[int] = frozenset()
    jitter_ns: int = 0
    first: int = 0
    names: Sequence[str] = JOINTS
    others: list[Entry] = field(default_factory=list)

    def picture_ns(self, number: int) -> int:
        """Return the time of a picture."""
        jitter = self.jitter_ns * (number * 7919 % 13 - 6) // 6
        return BEGAN + number * NANO // 30 + jitter

    def entries(self) -> list[Entry]:
        """Return all messages, in the order of their times."""
        entries = [jpeg_entry(number, self.picture_ns(number), topic)
                   for topic in self.topics for number in range(round(self.seconds * 30))
                   if number not in self.lost and number >= self.first]
        for step in range(round(self.seconds * 100) + 1):
            time_ns = BEGAN + step * NANO // 100
            values = dict(zip(JOINTS, joint_values(time_ns)))
            ordered = [values.get(name, 0.0) for name in self.names]
            entries.append(joints_entry(time_ns, ordered, self.names))
            entries.append(joints_entry(time_ns, [10 * one for one in ordered], self.names,
                                        '/arm/command'))
        return sorted([*entries, *self.others], key=lambda entry: entry.log_ns)

    def write(self, path: Path) -> Path:
        """Write the bag: an MCAP file, or a folder of rosbag2 in SQLite without an extension."""
        path.parent.mkdir(parents=True, exist_ok=True)
        if path.suffix == '.mcap':
            return write_mcap(path, with_definitions(self.entries()))
        return write_rosbag2(path, '.db3', self.entries())


def joint_values(time_ns: int) -> list[float]:
    """Return the positions of the joints at a time, linear in it."""
    seconds = (time_ns - BEGAN) / NANO
    return [seconds, 2 - seconds, seconds / 4]


def with_definitions(entries: Iterable[Entry]) -> list[Entry]:
    """Return entries with the texts of their types, as rosbag2 writes them."""
    texts: dict[str, str] = {}
    for entry in entries:
        if entry.type_name not in texts:
            texts[entry.type_name] = TYPES.generate_msgdef(
                entry.type_name, ros_version=2)[0]
    return [entry._replace(definition=texts[entry.type_name]) for entry in entries]
