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

"""Bags for playback, written by other libraries: ``mcap`` and ``rosbags``."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any, NamedTuple

from mcap.writer import Writer
import numpy as np
from opencv_tools.bags.open_bag import open_bag_file
from opencv_tools.bags.reading import BagMessage, Damage
from opencv_tools.bags.schemas import COMPRESSED_IMAGE, IMAGE
from opencv_tools.image.cdr import (
    compressed_image_to_cdr, image_to_cdr, WireCompressedImage, WireHeader)
from opencv_tools.image.encodings import find_encoding
from opencv_tools.image.layout import array_to_wire
from rosbags.rosbag2 import StoragePlugin, Writer as RosbagsWriter
from rosbags.typesys import get_typestore, Stores

NANO = 10**9
BEGAN_NS = 1_700_000_000 * NANO
TOPIC = '/camera/image_raw'
PLUGINS = {'.mcap': StoragePlugin.MCAP, '.db3': StoragePlugin.SQLITE3}


class Entry(NamedTuple):
    """A message to write, with the text of its type, the quality of service and the encoding."""

    log_ns: int
    data: bytes
    topic: str = TOPIC
    type_name: str = IMAGE
    definition: str = ''
    qos: str = ''
    encoding: str = ''  # that of the bag if it is empty


def header(number: int) -> WireHeader:
    """Return the header of a numbered image; the numbers are 40 ms apart."""
    sec, nanosec = divmod(BEGAN_NS + number * 40_000_000, NANO)
    return WireHeader(sec, nanosec, f'optical_{number}')


def image_entry(number: int, image: np.ndarray | None = None, encoding: str = 'mono8',
                topic: str = TOPIC) -> Entry:
    """Return a raw image that was recorded 7 ms after its stamp, as gray as its number."""
    pixels = np.full((4, 6), number, np.uint8) if image is None else image
    wire = array_to_wire(pixels, find_encoding(encoding), header(number))
    return Entry(BEGAN_NS + number * 40_000_000 + 7_000_000, image_to_cdr(wire), topic)


def compressed_entry(number: int, data: Any, format_text: str = 'jpeg') -> Entry:
    """Return a compressed image, recorded like a raw one."""
    serialized = compressed_image_to_cdr(WireCompressedImage(
        header=header(number), format=format_text, data=data))
    return Entry(BEGAN_NS + number * 40_000_000 + 7_000_000, serialized, f'{TOPIC}/compressed',
                 COMPRESSED_IMAGE)


def write_mcap(path: Path, entries: Iterable[Entry], encoding: str = 'cdr',
               metadata: Iterable[tuple[str, dict[str, str]]] = (), **options: Any) -> Path:
    """Write a bag with the library mcap, whose options are keywords."""
    with path.open('wb') as file:
        writer = Writer(file, **options)
        writer.start('ros2', 'test')
        for record in metadata:
            writer.add_metadata(*record)
        channels: dict[tuple[str, ...], int] = {}
        schemas: dict[tuple[str, str], int] = {}
        for number, entry in enumerate(entries):
            schema = entry.type_name, entry.definition
            if schema not in schemas:
                schemas[schema] = writer.register_schema(
                    entry.type_name, 'ros2msg', entry.definition.encode())
            key = entry.topic, *schema, entry.encoding
            if key not in channels:
                channels[key] = writer.register_channel(
                    entry.topic, entry.encoding or encoding, schemas[schema],
                    {'offered_qos_profiles': entry.qos} if entry.qos else {})
            writer.add_message(
                channels[key], entry.log_ns, entry.data, entry.log_ns // 2, number)
        writer.finish()
    return path


def write_rosbag2(folder: Path, suffix: str, entries: Iterable[Entry]) -> Path:
    """Write a folder of rosbag2 with the library rosbags, in MCAP or SQLite."""
    types = get_typestore(Stores.ROS2_JAZZY)
    with RosbagsWriter(folder, version=9, storage_plugin=PLUGINS[suffix]) as writer:
        connections: dict[str, Any] = {}
        for entry in entries:
            if entry.topic not in connections:
                options: dict[str, Any] = {'typestore': types} if not entry.definition else {
                    'msgdef': entry.definition, 'rihs01': f'RIHS01_{"0" * 64}'}
                connections[entry.topic] = writer.add_connection(
                    entry.topic, entry.type_name, **options)
            writer.write(connections[entry.topic], entry.log_ns, entry.data)
    return folder


def read_all(path: Path) -> tuple[list[tuple[str, int, bytes]], list[str]]:
    """Return all messages that a reader finds in a file, and all that it reports."""
    reader = open_bag_file(path)
    try:
        found: list[BagMessage | Damage] = list(reader.messages(reader.topics))
        messages = [(item.topic.name, item.log_ns, bytes(item.load()))
                    for item in found if isinstance(item, BagMessage)]
        reports = [item.reason for item in found if isinstance(item, Damage)]
        return messages, [*([reader.warning] if reader.warning else []), *reports]
    finally:
        reader.close()


def written(entries: Iterable[Entry]) -> list[tuple[str, int, bytes]]:
    """Return entries in the form of ``read_all``, in the order of their times."""
    return sorted(((entry.topic, entry.log_ns, entry.data) for entry in entries),
                  key=lambda message: message[1])
