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

"""CPU time of the publisher without subscribers, and for each kind of subscriber."""

from __future__ import annotations

import argparse
from dataclasses import dataclass
from pathlib import Path
import re
import sys
import tempfile
import time
from typing import Any

from figures import add_json_option, Figure, write_figures
from node_process import enter_domain, NAMESPACE, NodeProcess
from opencv_tools.capture.source import open_source
import rclpy
from rclpy.qos import QoSProfile
from rclpy.signals import SignalHandlerOptions
from sensor_msgs.msg import CompressedImage, Image

ROOT = Path(__file__).resolve().parent.parent
SOURCES = ('pattern:1280x720@30', 'pattern:1920x1080@30', 'test/data/big_buck_bunny_720p.mp4')
TOPICS = {'video_frames': Image, 'video_frames/compressed': CompressedImage}
SUBSCRIPTIONS: dict[str, tuple[str, ...]] = {
    '(a) nobody subscribes': (),
    '(b) video_frames': ('video_frames',),
    '(c) video_frames/compressed': ('video_frames/compressed',),
    '(d) both': tuple(TOPICS),
}
SETTLE_SECONDS = 1.0  # after each change of what is subscribed

_SAID = re.compile(r'\[([0-9.]+)\] \[\S*image_publisher\]: Publishing video frame ([0-9]+):')


@dataclass(frozen=True)
class Cost:
    """
    What a stretch of time took.

    :param cpu: seconds of CPU, user and system, of all threads.
    :param seconds: how long it was.
    :param rate: frames per second.
    :param received: messages per second that arrived, of all subscriptions.
    """

    cpu: float
    seconds: float
    rate: float
    received: float = 0.0

    @property
    def per_frame(self) -> float:
        """CPU milliseconds per frame."""
        return self.cpu / self.seconds / self.rate * 1e3


class Publisher(NodeProcess):
    """An img_publisher, and how often it publishes."""

    def rate(self, seconds: float) -> float:
        """Return the frame rate in Hz of the last seconds, from the console output."""
        said = self._said()
        recent = [line for line in said if line[0] >= said[-1][0] - seconds]
        (began, first), (ended, last) = recent[0], recent[-1]
        if ended == began:
            raise SystemExit(f'no frame was published:\n{self.console()}')
        return (last - first) / (ended - began)

    def _said(self) -> list[tuple[float, int]]:
        """Return times and numbers of the frames on the console."""
        return [(float(line[1]), int(line[2])) for line in _SAID.finditer(
            self.console())]


class Audience:
    """A node in here that subscribes, and does nothing with what it gets."""

    def __init__(self) -> None:
        """Join the domain."""
        rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
        self._node = rclpy.create_node('audience', namespace=NAMESPACE)
        self._received = 0

    def attend(self, publisher: Publisher, topics: tuple[str, ...], seconds: float) -> Cost:
        """Subscribe for a while, and tell what that cost the publisher after it settled."""
        subscriptions = [
            self._node.create_subscription(TOPICS[topic], topic, self._take, QoSProfile(depth=10),
                                           raw=True) for topic in topics]
        self._spin(SETTLE_SECONDS)
        began, cpu, received = time.perf_counter(), publisher.cpu(), self._received
        self._spin(seconds)
        cpu, received = publisher.cpu() - cpu, self._received - received
        elapsed = time.perf_counter() - began
        for subscription in subscriptions:
            self._node.destroy_subscription(subscription)
        return Cost(cpu, elapsed, publisher.rate(seconds), received / elapsed)

    def close(self) -> None:
        """Leave the domain."""
        self._node.destroy_node()
        rclpy.shutdown()

    def _take(self, _: Any) -> None:
        self._received += 1

    def _spin(self, seconds: float) -> None:
        deadline = time.monotonic() + seconds
        while (left := deadline - time.monotonic()) > 0:
            rclpy.spin_once(self._node, timeout_sec=left)


def reading(text: str, seconds: float) -> Cost:
    """Read a source's frames in here, each when it is due, and do nothing else."""
    source = open_source(text)
    source.read()
    began = due = time.perf_counter()
    cpu = time.process_time()
    frames = 0
    while due < began + seconds:
        if source.read() is None:
            source.rewind()
            source.read()
        frames += 1
        due += 1 / source.rate
        time.sleep(max(0.0, due - time.perf_counter()))
    elapsed = time.perf_counter() - began
    cost = Cost(time.process_time() - cpu, elapsed, frames / elapsed)
    source.close()
    return cost


def measure(source: str, seconds: float) -> dict[str, Cost]:
    """Measure one source, read alone and published: name of the row to its cost."""
    costs = {'reading the source alone': reading(source, seconds)}
    with tempfile.TemporaryDirectory() as folder:
        publisher = Publisher('publisher', Path(folder), source=source, publish_rate=0.0,
                              on_end='loop')
        try:
            publisher.wait_for('Publishing video frame')
            audience = Audience()
            try:
                for name, topics in SUBSCRIPTIONS.items():
                    costs[name] = audience.attend(publisher, topics, seconds)
            finally:
                audience.close()
        finally:
            publisher.end()
    return costs


def print_costs(source: str, costs: dict[str, Cost]) -> None:
    """Print a table of one source."""
    print(f'{source:34}{"CPU ms/frame":>13}{"CPU %":>8}{"frames/s":>10}{"received/s":>12}'
          f'{"to (a)":>8}')
    idle = costs['(a) nobody subscribes'].per_frame
    for name, cost in costs.items():
        print(f'  {name:32}{cost.per_frame:13.3f}{cost.cpu / cost.seconds * 100:8.2f}'
              f'{cost.rate:10.1f}{cost.received:12.1f}{cost.per_frame / idle:8.2f}', flush=True)


def main() -> int:
    """Print what each subscription costs, for each source."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--seconds', type=float, default=10, help='to measure each row for')
    add_json_option(parser)
    options = parser.parse_args()
    if options.seconds < 3:
        parser.error('give 3 seconds or more: the console tells the rate once a second')
    enter_domain()
    figures = []
    for source in SOURCES:
        path = ROOT / source
        costs = measure(str(path) if path.exists() else source, options.seconds)
        print_costs(source, costs)
        figures += [Figure('idle', f'CPU, {path.name}, {name}', cost.per_frame, 'ms/frame')
                    for name, cost in costs.items()]
    print('(a) reads every frame, for a file plays in its own time, and makes nothing of it.')
    if options.json:
        write_figures(options.json, figures)
    return 0


if __name__ == '__main__':
    sys.exit(main())
