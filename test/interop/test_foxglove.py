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

"""Bags, read by Foxglove's own reader."""

from __future__ import annotations

import hashlib
import json
import os
from pathlib import Path
import subprocess
from typing import Any

import numpy as np
from opencv_tools.bags.finishing import finish_bag
from opencv_tools.bags.schemas import COMPRESSED_IMAGE, IMAGE
from opencv_tools.bags.writing import BagChannel, BagWriter
import pytest
from waiting import LONGEST_SECONDS

SCRIPT = Path(__file__).with_name('read_bag.mjs')
CHANNELS = (BagChannel(topic='/video_frames', type_name=IMAGE),
            BagChannel(topic='/video_frames/compressed', type_name=COMPRESSED_IMAGE))
NANO = 10**9


def read(path: Path, way: str) -> list[Any]:
    """Read a bag, indexed or streaming."""
    modules = os.environ.get('OPENCV_TOOLS_NODE_MODULES')
    if not modules:
        pytest.skip('npm is missing: sudo apt install npm')
    finished = subprocess.run(['node', str(SCRIPT), modules, str(path), way],
                              capture_output=True, text=True, timeout=LONGEST_SECONDS, check=True)
    return list(map(json.loads, finished.stdout.splitlines()))


def write(path: Path) -> tuple[BagWriter, list[Any]]:
    """Write messages of all sizes to two topics."""
    writer, expected = BagWriter(path), []
    for number in range(12):
        channel = CHANNELS[number % 3 == 1]
        data = np.random.default_rng(number).bytes((20, 5_000, 800_000)[number % 3])
        log_ns = NANO + number * NANO // 5
        writer.write(channel, (b'\0\1\0\0', data), log_ns=log_ns, publish_ns=number,
                     sequence=number)
        expected.append([channel.topic, str(log_ns), str(number), number,
                         hashlib.sha256(b'\0\1\0\0' + data).hexdigest()])
    return writer, expected


@pytest.mark.parametrize('way', ['indexed', 'streaming'])
def test_messages(tmp_path: Path, way: str) -> None:
    writer, expected = write(tmp_path / 'a.mcap')
    writer.close()
    assert read(tmp_path / 'a.mcap', way) == expected


def test_bag_that_is_being_written(tmp_path: Path) -> None:
    writer, expected = write(tmp_path / 'a.mcap')
    assert read(tmp_path / 'a.mcap', 'streaming') == [*expected, 'the end is missing']
    writer.close()


@pytest.mark.parametrize('cut', [1, 700, 100_000, 900_000])
def test_finished_bag(tmp_path: Path, cut: int) -> None:
    path = tmp_path / 'a.mcap'
    writer, expected = write(path)
    writer.close()
    path.write_bytes(path.read_bytes()[:-cut])
    count = finish_bag(path)
    found = read(path, 'indexed')
    assert found == read(path, 'streaming') == expected[:count] and found
