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

"""
Video topics against JPEG on a radio network: frames shown, bytes, and age, by the loss of packets.

The frames are those of ``video.py`` with noise, 1280x720 at 30 Hz. Publisher and subscriber are in
network namespaces, whose packets are late by 20 ms. Needs root.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator
from contextlib import ExitStack
import json
import os
from pathlib import Path
import subprocess
import sys
import time

from figures import add_json_option, Figure, print_figures
import numpy as np
from opencv_tools.frames import Frame, FrameNode, main as run_node
from video import Camera, TOPIC

ROOT = Path(__file__).resolve().parent.parent
sys.path.append(str(ROOT / 'test' / 'support'))
from late_link import late_hosts  # noqa: E402, I100

DELAY_MS = 20
LOSSES = 1, 5  # per cent
TOPICS = {'compressed': 'compressed', 'video': 'ffmpeg'}
#: Transport, reliability, and bit rate of the video, 0 for a constant quality.
WAYS = (('compressed', 'reliable', 0), ('compressed', 'best_effort', 0), ('video', 'reliable', 0),
        ('video', 'reliable', 1_500_000), ('video', 'best_effort', 1_500_000))
WAIT_SECONDS = 20.0


class Receiver(FrameNode):
    """Print the ages of the frames that arrive in some seconds, in ms."""

    def __init__(self, transport: str, seconds: float) -> None:
        """Subscribe."""
        super().__init__('receiver')
        self._ages: list[float] = []
        self._seconds = seconds
        self.receive_frames(TOPIC, self._note, every=True, transport=transport)

    def _note(self, frame: Frame) -> None:
        if not self._ages:
            self.create_timer(self._seconds, self._end)
        self._ages.append((time.time_ns() - frame.stamp_ns) / 1e6)

    def _end(self) -> None:
        print(json.dumps(self._ages), flush=True)
        if not self.done.done():
            self.done.set_result(0)


def measure(loss: int, transport: str, reliability: str, bit_rate: int, seconds: float,
            ) -> Iterator[Figure]:
    """Measure one way of sending the frames."""
    qos = f'qos_overrides./{TOPIC}/{TOPICS[transport]}.publisher.reliability:={reliability}'
    with ExitStack() as stack:
        near, far = stack.enter_context(late_hosts(DELAY_MS, loss))
        camera = subprocess.Popen([*near.within, sys.executable, __file__, 'camera',
                                   str(bit_rate), '--ros-args', '-p', qos],
                                  stdout=subprocess.DEVNULL)
        stack.callback(camera.wait)
        stack.callback(camera.terminate)
        before = near.sent_bytes()
        try:
            ages = json.loads(subprocess.run(
                [*far.within, sys.executable, __file__, 'receiver', transport, str(seconds)],
                stdout=subprocess.PIPE, timeout=WAIT_SECONDS + seconds, check=True).stdout)
        except subprocess.TimeoutExpired:
            ages = []
        sent = near.sent_bytes() - before
    video = f' of {bit_rate / 1e6:g} Mbit/s' if bit_rate else ''
    name = f'{transport}{video}, {reliability}, {loss} % lost'
    yield Figure('video_network', f'{name}: shown in {seconds:g} s', len(ages), 'frames')
    yield Figure('video_network', f'{name}: sent', sent / 1e6, 'MB')
    for per_cent in (50, 95) if ages else ():
        yield Figure('video_network', f'{name}: age p{per_cent}',
                     float(np.percentile(ages, per_cent)), 'ms')


def main() -> int:
    """Print the figures."""
    ends: dict[str, Callable[[], int]] = {
        'camera': lambda: run_node(lambda: Camera(int(sys.argv[2])), sys.argv[:1] + sys.argv[3:]),
        'receiver': lambda: run_node(
            lambda: Receiver(sys.argv[2], float(sys.argv[3])), sys.argv[:1])}
    if len(sys.argv) > 1 and sys.argv[1] in ends:
        return ends[sys.argv[1]]()
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--seconds', type=float, default=10.0, help='duration of a run')
    add_json_option(parser)
    options = parser.parse_args()
    os.environ['ROS_AUTOMATIC_DISCOVERY_RANGE'] = 'SUBNET'
    print_figures((figure for loss in LOSSES for way in WAYS
                   for figure in measure(loss, *way, options.seconds)), options.json)
    return 0


if __name__ == '__main__':
    sys.exit(main())
