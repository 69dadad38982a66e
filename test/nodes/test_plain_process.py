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

"""A node that uses nothing of this package keeps its process as it was, whatever it imports."""

from __future__ import annotations

import json
import subprocess
import sys

import pytest
from waiting import LONGEST_SECONDS

_SCRIPT = """
import json, os, sys
before = dict(os.environ)
import numpy as np, rclpy
from rclpy.node import Node
from sensor_msgs.msg import Image
import {module}
rclpy.init()
node = Node('plain')
publisher = node.create_publisher(Image, 'video_frames', 10)

def resident():
    return int(open('/proc/self/statm').read().split()[1]) * os.sysconf('SC_PAGE_SIZE')

begin = resident()
frame = np.ones({size}, np.uint8)
del frame
kept = resident() - begin
segments = [os.stat(line.split()[-1]).st_size for line in open('/proc/self/maps')
            if '/dev/shm/fast' in line and 'port' not in line]
print(json.dumps([kept, max(segments, default=0), os.sched_getscheduler(0),
                  {{name: value for name, value in os.environ.items()
                    if before.get(name) != value}}]))
node.destroy_node()
rclpy.shutdown()
"""


@pytest.mark.process
@pytest.mark.usefixtures('domain')
@pytest.mark.parametrize(('module', 'size'), [
    ('rclpy', 6_220_800), ('opencv_tools.cv_bridge', 921_600), ('opencv_tools.frames', 6_220_800),
    ('opencv_tools.frames', 24_883_200), ('opencv_tools.frames', 17_000_000)])
def test_process_of_a_plain_node(module: str, size: int) -> None:
    """Freed memory returns to the system, and Fast DDS and the scheduling are as they were."""
    finished = subprocess.run(
        [sys.executable, '-c', _SCRIPT.format(module=module, size=size)], capture_output=True,
        text=True, timeout=LONGEST_SECONDS, check=True)
    kept, segment, scheduler, environment = json.loads(finished.stdout)
    assert kept < size / 2
    assert segment < 1_000_000
    assert (scheduler, environment) == (0, {})


_OWN_NODE = """
import os, sys
from opencv_tools.frames import FrameNode, main

class Receiving(FrameNode):
    def __init__(self):
        super().__init__('receiving')
        print(max(os.stat(line.split()[-1]).st_size for line in open('/proc/self/maps')
                  if '/dev/shm/fast' in line and 'port' not in line))
        self.done.set_result(0)

sys.exit(main(Receiving, ['node'], frame_size=({width}, {height})))
"""


@pytest.mark.process
@pytest.mark.usefixtures('domain')
@pytest.mark.parametrize(('width', 'height', 'low', 'high'), [
    (0, 0, 0.5, 1.1), (640, 480, 16, 18), (1920, 1080, 48, 54), (3001, 2001, 137, 155)])
def test_reserved_memory_of_an_own_node(width: int, height: int, low: float, high: float) -> None:
    """The size of the published frames decides, also that of no frames."""
    finished = subprocess.run(
        [sys.executable, '-c', _OWN_NODE.format(width=width, height=height)], capture_output=True,
        text=True, timeout=LONGEST_SECONDS, check=True)
    assert low < int(finished.stdout) / 1e6 < high
