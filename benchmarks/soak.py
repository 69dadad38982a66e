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

"""Ten minutes of both nodes: no lost frames, no growth of memory, files or threads."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
import os
from pathlib import Path
import re
import statistics
import sys
import tempfile
import time
from typing import Any

from node_process import enter_domain, NAMESPACE, NodeProcess, START_SECONDS
import numpy as np
import rclpy
from rclpy.parameter import Parameter
from rclpy.parameter_client import AsyncParameterClient
from rclpy.qos import QoSProfile
from rclpy.signals import SignalHandlerOptions
from rclpy.subscription import Subscription
from rclpy.task import Future
from sensor_msgs.msg import CompressedImage

RATE = 30
SAMPLE_SECONDS = 2.0
GROWTH_MB = 10.0

PUBLISHED = re.compile(r'Published ([0-9]+) frames at .* Hz, ([0-9]+) dropped')
RECEIVED = re.compile(r'Received ([0-9]+) frames at .* Hz: ([0-9]+) written to .*, '
                      r'([0-9]+) dropped, ([0-9]+) failed')
PROGRESS = re.compile(r'.*ing video frame .* ([0-9]+) dropped')
TROUBLE = re.compile(r'\[WARN\].*|\[ERROR\].*|\[FATAL\].*|Traceback.*')


@dataclass(frozen=True)
class Held:
    """What a process holds at a time: MB of memory, file descriptors and threads."""

    at: float
    memory: float
    descriptors: int
    threads: int


class WatchedNode(NodeProcess):
    """A node, and what it held over the time."""

    def __init__(self, name: str, folder: Path, **parameters: object) -> None:
        """Start it."""
        self.held: list[Held] = []
        self.segments: set[tuple[Path, int]] = set()  # with the number of the file's inode
        self._others = {path.stat().st_ino for path in Path('/dev/shm').iterdir()}
        super().__init__(name, folder, **parameters)

    def look(self, at: float) -> Held:
        """Record memory, files and threads of the process; end the run if it has exited."""
        if self.process.poll() is not None:
            raise SystemExit(f'soak: the {self.name} ended by itself: failed\n{self.console()}')
        folder = Path('/proc', str(self.process.pid))
        status = dict(line.split(':', 1) for line in (folder / 'status').read_text().splitlines())
        maps = [line.split() for line in (folder / 'maps').read_text().splitlines()]
        self.segments.update((Path(words[-1]), int(words[4])) for words in maps
                             if words[-1].startswith('/dev/shm/') and 'fastrtps' in words[-1])
        return Held(at, int(status['VmRSS'].split()[0]) / 1024,
                    len(list((folder / 'fd').iterdir())), int(status['Threads']))

    def left(self) -> list[os.stat_result]:
        """List the files in shared memory that it used and that are still there."""
        found = [(number, path.stat()) for path, number in self.segments if path.exists()]
        return [status for number, status in found
                if status.st_ino == number and number not in self._others]

    def losses(self) -> str:
        """Return the console lines with a changed number of dropped frames."""
        lines = list(PROGRESS.finditer(self.console()))
        return '\n'.join(line[0] for before, line in pairwise(lines) if before[1] != line[1])


class Visitor:
    """A node in here that subscribes to the compressed frames at times, and sets parameters."""

    def __init__(self) -> None:
        """Join the domain."""
        rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
        self.received: list[int] = []  # frames of each visit
        self.answers: list[Future] = []
        self._node = rclpy.create_node('visitor', namespace=NAMESPACE)
        self._parameters = AsyncParameterClient(self._node, 'image_publisher')
        self._subscription: Subscription | None = None

    def act(self, at: float, end: float) -> None:
        """Do what is to be done after so many seconds: subscribe from 10 to 15 of every 30."""
        visit, second = divmod(at, 30)
        if self._subscription:
            if second >= 15:
                self._node.destroy_subscription(self._subscription)
                self._subscription = None
            elif len(self.answers) <= visit and second >= 12:
                look = ('horizontal', 50) if visit % 2 == 0 else ('none', 95)
                self.answers.append(self._parameters.set_parameters(
                    [Parameter('flip', value=look[0]), Parameter('jpeg_quality', value=look[1])]))
        elif 10 <= second < 15 and at < end - 10:
            self.received.append(0)
            self._subscription = self._node.create_subscription(
                CompressedImage, 'video_frames/compressed', self._take, QoSProfile(depth=10),
                raw=True)

    def spin(self, seconds: float) -> None:
        """Receive frames for a number of seconds."""
        deadline = time.monotonic() + seconds
        while (left := deadline - time.monotonic()) > 0:
            rclpy.spin_once(self._node, timeout_sec=left)

    def close(self) -> None:
        """Leave the domain; the shared memory that was here is gone then."""
        self._node.destroy_node()
        rclpy.shutdown()

    def _take(self, _: Any) -> None:
        self.received[-1] += 1


def collect(folder: Path) -> list[int]:
    """Remove the images of a folder and return the numbers of complete ones."""
    numbers = []
    for path in folder.glob('*.jpg'):
        content = path.read_bytes()
        if content.startswith(b'\xff\xd8') and content.endswith(b'\xff\xd9'):
            numbers.append(int(path.stem))
        path.unlink()
    return numbers


def watch(nodes: Sequence[WatchedNode], visitor: Visitor, seconds: float, files: Path
          ) -> list[int]:
    """Look at the nodes, print a line a minute, and give the numbers of the files there were."""
    print(f'{"":15}{"publisher":>23}{"subscriber":>23}\n{"minute":>6}{"files":>9}'
          + f'{"MB":>10}{"fds":>5}{"threads":>8}' * 2 + f'{"shm MB":>10}{"load":>7}')
    numbers: list[int] = []
    began = time.monotonic()
    for until in (*range(0, int(seconds - 0.5), 60), seconds):
        while True:
            at = time.monotonic() - began
            for node in nodes:
                node.held.append(node.look(at))
            numbers += collect(files)
            visitor.act(at, seconds)
            if at >= until:
                break
            visitor.spin(min(SAMPLE_SECONDS, until - at))
        last = [node.held[-1] for node in nodes]
        columns = ''.join(f'{one.memory:10.1f}{one.descriptors:5}{one.threads:8}' for one in last)
        used = {one.st_ino: one.st_blocks for node in nodes for one in node.left()}
        shared = sum(used.values()) / 2048
        print(f'{until / 60:6g}{len(numbers):9}{columns}{shared:10.1f}{os.getloadavg()[0]:7.1f}',
              flush=True)
    return numbers


def growth(node: WatchedNode) -> tuple[str, list[str]]:
    """Return the growth of a node in the last quarter, and its errors."""
    end = node.held[-1].at
    times, memory = np.array([(one.at, one.memory) for one in node.held if one.at > end / 10]).T
    first = statistics.median(memory[times < end / 5])
    more = statistics.median(memory[times > end * 3 / 4]) - first
    slope = np.polyfit(times, memory, 1)[0] * 3600
    faults = [f'the memory of the {node.name} grew'] if more > GROWTH_MB else []
    early = [one for one in node.held if one.at < max(end / 10, 30)]
    for noun in ('descriptors', 'threads'):
        began, ended = max(getattr(one, noun) for one in early), getattr(node.held[-1], noun)
        if ended > began:
            faults.append(f'the {node.name} has {ended} {noun}, at the start {began}')
    return f'{node.name}: {first:.1f} MB {more:+.1f}, {slope:+.1f} MB per hour', faults


def count(published: str, received: str, numbers: list[int], expected: float
          ) -> tuple[str, list[str]]:
    """Compare what the nodes said in the end with each other and with the files there were."""
    sent, came = PUBLISHED.search(published), RECEIVED.search(received)
    if not (sent and came):
        return 'no frames', ['a node did not say how it went']
    frames, lost = map(int, sent.groups())
    arrived, written, dropped, failed = map(int, came.groups())
    faults = []
    if {frames, arrived, written} != {len(numbers)} or lost or dropped or failed:
        faults.append('frames were missed')
    if sorted(numbers) != list(range(len(numbers))):
        faults.append('numbers of files are missing')
    if frames < expected / 2:
        faults.append(f'{expected:.0f} frames were due')
    return (f'{frames} frames, {lost} dropped, {arrived} received, {dropped} dropped, '
            f'{written} written, {failed} failed, {len(numbers)} files', faults)


def soak(seconds: float, folder: Path) -> int:
    """Run both nodes, end them and say how it went; the exit status."""
    files = folder / 'frames'
    nodes: list[WatchedNode] = []
    visitor = Visitor()
    try:
        nodes.append(WatchedNode('subscriber', folder, output_dir=files,
                                 file_name='"{seq:06d}.jpg"'))
        nodes.append(WatchedNode('publisher', folder, source=f'pattern:640x480@{RATE}',
                                 publish_rate=0.0, wait_for_subscribers=1))
        subscriber, publisher = nodes
        deadline = time.monotonic() + START_SECONDS
        while 'Receiving video frame' not in subscriber.console():
            if not all(node.look(0.0) for node in nodes) or time.monotonic() > deadline:
                raise SystemExit('soak: no frame came: failed')
            visitor.spin(0.1)
        numbers = watch((publisher, subscriber), visitor, seconds, files)
        statuses = {publisher.name: publisher.end()}
        visitor.spin(1.0)  # what is on its way arrives
        statuses[subscriber.name] = subscriber.end()
    finally:
        for node in nodes:
            node.end()
        visitor.close()
    numbers += collect(files)
    faults = [f'the {name} ended with {status}' for name, status in statuses.items() if status]
    for node in (publisher, subscriber):
        told, found = growth(node)
        print(told)
        faults += found + sorted(set(TROUBLE.findall(node.console())))
        faults += [f'{len(node.left())} files left in /dev/shm'] if node.left() else []
    faults += [f'left: {path.name}' for path in files.iterdir()
               if path.name != 'manifest.jsonl']
    print(f'{len(visitor.received)} visits got {sum(visitor.received)} compressed frames')
    faults += ['a visit got no compressed frame'] if not all(visitor.received) else []
    if not all(answer.done() and all(result.successful for result in answer.result().results)
               for answer in visitor.answers):
        faults.append('a parameter was not changed')
    told, found = count(publisher.console(), subscriber.console(), numbers, seconds * RATE)
    faults += found
    if found:
        print(publisher.losses(), subscriber.losses(), sep='\n')
    print(f'soak: {told}: {"failed: " + "; ".join(faults) if faults else "ok"}')
    return 1 if faults else 0


def main() -> int:
    """Run the soak; the exit status is 0 when nothing is wrong."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--minutes', type=float, default=10, help='how long')
    options = parser.parse_args()
    if options.minutes < 0.5:
        parser.error('give half a minute or more')
    enter_domain()
    with tempfile.TemporaryDirectory() as folder:
        return soak(options.minutes * 60, Path(folder))


if __name__ == '__main__':
    sys.exit(main())
