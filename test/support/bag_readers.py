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

"""Readers of bags that others wrote: mcap, rosbags and mcap-ros2-support."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass
import json
from pathlib import Path
from typing import Any

import pytest

_REMEDY = 'not packaged for ROS: pip install mcap mcap-ros2-support rosbags'
_mcap = pytest.importorskip('mcap.reader', reason=_REMEDY)
_decoder = pytest.importorskip('mcap_ros2.decoder', reason=_REMEDY)
_rosbags = pytest.importorskip('rosbags.rosbag2.storage_mcap', reason=_REMEDY)


@dataclass(frozen=True)
class Stored:
    """A message in a bag."""

    topic: str
    log_ns: int
    data: bytes


def read_indexed(path: Path) -> list[Stored]:
    """Read with mcap by the indexes, with all checksums."""
    with path.open('rb') as file:
        reader = _mcap.SeekingReader(file, validate_crcs=True)
        found = [Stored(channel.topic, message.log_time, message.data)
                 for _, channel, message in reader.iter_messages(log_time_order=False)]
        assert reader.get_summary().statistics.message_count == len(found)
    return found


def read_streaming(path: Path) -> list[Stored]:
    """Read with mcap from the start to the end, without the indexes."""
    with path.open('rb') as file:
        reader = _mcap.NonSeekingReader(file, validate_crcs=True)
        return [Stored(channel.topic, message.log_time, message.data)
                for _, channel, message in reader.iter_messages(log_time_order=False)]


def read_by_rosbags(path: Path) -> list[Stored]:
    """Read with rosbags, in the order of time."""
    reader = _rosbags.McapReader(path)
    reader.open()
    try:
        return [Stored(connection.topic, log_ns, bytes(data)) for connection, log_ns, data in
                reader.messages(reader.connections, None, None)]
    finally:
        reader.close()


def metadata_of(path: Path) -> list[tuple[str, dict[str, str]]]:
    """Read the metadata records with mcap, by their indexes."""
    with path.open('rb') as file:
        return [(record.name, record.metadata)
                for record in _mcap.SeekingReader(file).iter_metadata()]


def account_of(paths: Iterable[Path]) -> dict[str, Counter[str]]:
    """Return the account of some files by topic; the messages in the files are as many."""
    found: dict[str, Counter[str]] = {}
    for path in paths:
        own: dict[str, Counter[str]] = {}
        for name, values in metadata_of(path):
            if name == 'opencv_tools' and 'account' in values:
                for topic, counts in json.loads(values['account']).items():
                    own.setdefault(topic, Counter()).update(counts)
                    found.setdefault(topic, Counter()).update(counts)
        stored = Counter(one.topic for one in read_indexed(path))
        assert {topic: counts['written'] + counts['repeated'] for topic, counts in own.items()
                if counts['written'] + counts['repeated']} == stored
    return found


def decode(path: Path) -> list[Any]:
    """Read with mcap-ros2-support, which decodes the messages by the schemas."""
    with path.open('rb') as file:
        reader = _mcap.SeekingReader(file, decoder_factories=[_decoder.DecoderFactory()])
        return [decoded for *_, decoded in reader.iter_decoded_messages(log_time_order=False)]


def read_by_all(path: Path) -> list[Stored]:
    """Read with each reader; all find the same messages."""
    found = read_indexed(path)
    assert found == read_streaming(path)
    key = [(stored.log_ns, stored.topic, stored.data) for stored in found]
    assert sorted(key) == sorted(
        (stored.log_ns, stored.topic, stored.data) for stored in read_by_rosbags(path))
    assert len(decode(path)) == len(found)
    return found
