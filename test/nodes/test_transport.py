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

"""Transport between processes: order, no duplicates, right pixels, no losses."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import cache
import json
import os
from pathlib import Path
import re
import signal
import sys
import time
import zlib

from conftest import NodeProcess
from opencv_tools.capture.pattern import PatternSource, PatternSpec
import pytest
from waiting import wait_until, work

pytestmark = pytest.mark.thorough

Start = Callable[..., NodeProcess]
Count = Callable[..., NodeProcess]
COUNTER = Path(__file__).parents[1] / 'support' / 'frame_counter.py'
RELIABILITY = 'qos_overrides./video_frames.publisher.reliability'
# Small frames, after a signal five large ones, and then small ones again. The five fit into the
# segment and are 1900 pieces, of which Fast DDS lets 512 wait.
SEND = """
import signal
import numpy as np
from opencv_tools.image.cdr import WireHeader, WireImage
from opencv_tools.transport.zero_copy import publish_image
from opencv_tools.transport.fastdds.profile import configured_fastdds
import rclpy
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import Image

def publish(width, height):
    publish_image(publisher.handle, WireImage(
        header=WireHeader(0, 0, ''), height=height, width=width, encoding='mono8',
        is_bigendian=False, step=width, data=np.zeros(width * height, np.uint8)))

def publish_small_until_signal(width):
    while not (received := signal.sigtimedwait(signals, 0.05)):
        publish(width, 1)
    if received.si_signo == signal.SIGTERM:
        node.destroy_node()
        rclpy.shutdown()
        raise SystemExit

signals = {signal.SIGUSR1, signal.SIGTERM}
signal.pthread_sigmask(signal.SIG_BLOCK, signals)
rclpy.init()
with configured_fastdds(24_883_200):
    node = Node('sender')
publisher = node.create_publisher(
    Image, 'video_frames', QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT))
while True:
    publish_small_until_signal(1)
    for _ in range(5):
        publish(7680, 3240)
    print('sent', flush=True)
    publish_small_until_signal(2)
    print('continued', flush=True)
    publish_small_until_signal(3)
    print('ended', flush=True)
"""
# Fast DDS sends nothing to a reader that stands still for a second.
GIVEN_UP_SECONDS = 1.0


@pytest.fixture
def send(tmp_path: Path) -> Iterator[NodeProcess]:
    """Start a process that sends frames, best effort, as far as signals let it."""
    process = NodeProcess([sys.executable, '-c', SEND], tmp_path / 'send.log', dict(os.environ))
    yield process
    process.kill()


@pytest.fixture
def count(tmp_path: Path) -> Iterator[Count]:
    """Start processes that count frames, and end those that a test leaves running."""
    processes: list[NodeProcess] = []

    def _count(kind: str, *words: str) -> NodeProcess:
        processes.append(NodeProcess([sys.executable, str(COUNTER), kind, *words],
                                     tmp_path / f'{kind}_{len(processes)}.log', dict(os.environ)))
        return processes[-1]

    yield _count
    for process in processes:
        process.kill()


@cache
def checksums(width: int, height: int, frames: int) -> dict[int, int]:
    """Return the frame numbers of the pattern by checksum."""
    source = PatternSource(PatternSpec(width, height))
    numbers = {zlib.crc32(source.read().image): number for number in range(frames)}
    assert len(numbers) == frames
    return numbers


def received(counter: NodeProcess, numbers: dict[int, int]) -> list[list[int]]:
    """
    End a counting process and list the numbers of each node's frames.

    They rise and every pixel is right. What our own subscription lacks it counts as lost.
    """
    counter.interrupt()
    assert counter.finish() == 0, counter.output
    found = []
    for frames, lost in json.loads(counter.output.splitlines()[-1]):
        assert set(frames) <= numbers.keys()
        found.append([numbers[checksum] for checksum in frames])
        assert found[-1] == sorted(set(found[-1]))
        missing = found[-1][-1] - found[-1][0] + 1 - len(frames) if frames else 0
        # Of a new publisher those that it sent before the first count, too.
        assert lost is None or missing <= lost <= missing + (found[-1][0] if frames else 0)
    return found


def wait_until_gone(files: set[Path]) -> None:
    """Wait until no segment is there; the nodes of another test may be the ones to remove it."""
    def left() -> list[Path]:
        return [path for path in files if path.exists()]

    wait_until(lambda: not left(), 'the removal', files=left, work=work)


LARGE = pytest.mark.parametrize(('width', 'height', 'rate', 'frames'), [
    (1920, 1080, 30, 40), (3840, 2160, 15, 20)])


@LARGE
def test_large_frames_to_a_reliable_subscriber(
        start: Start, count: Count, width: int, height: int, rate: int, frames: int) -> None:
    ours, plain = count('ours'), count('plain')
    publisher = start('img_publisher', source=f'pattern:{width}x{height}@{rate}', publish_rate=0.0,
                      max_frames=frames, wait_for_subscribers=2)
    assert publisher.finish() == 0, publisher.output
    assert re.search(rf'Published {frames} frames at [\d.]+ Hz, 0 dropped', publisher.output)
    numbers = checksums(width, height, frames)
    assert received(ours, numbers) == [list(range(frames))]
    assert len(received(plain, numbers)) == 1


@LARGE
def test_large_frames_to_best_effort_subscribers(
        start: Start, count: Count, width: int, height: int, rate: int, frames: int) -> None:
    counters = [count(kind, '--best-effort') for kind in ('ours', 'plain')]
    publisher = start('img_publisher', source=f'pattern:{width}x{height}@{rate}', publish_rate=0.0,
                      **{RELIABILITY: 'best_effort'})
    for counter in counters:
        counter.wait_for('the first frame')
    publisher.interrupt()
    assert publisher.finish() == 0, publisher.output
    published = int(re.search(r'Published (\d+) frames', publisher.output)[1])
    for counter in counters:
        (found,) = received(counter, checksums(width, height, max(published, frames)))
        assert 0 < len(found) <= published


@pytest.mark.parametrize('nodes', [1, 4])
def test_large_frames_to_several_subscribers(
        start: Start, count: Count, nodes: int) -> None:
    numbers = checksums(640, 480, 40)
    ours, plain = (count(kind, '--nodes', str(nodes)) for kind in ('ours', 'plain'))
    publisher = start('img_publisher', source='pattern:640x480@30', publish_rate=0.0,
                      max_frames=40, wait_for_subscribers=2 * nodes)
    assert publisher.finish() == 0, publisher.output
    assert received(ours, numbers) == nodes * [list(range(40))]
    assert len(received(plain, numbers)) == nodes


def test_subscribers_joining_leaving_and_killed(
        start: Start, count: Count) -> None:
    stays = count('ours')
    leaving, killed = (start('img_subscriber', mode='on_request') for _ in range(2))
    publisher = start('img_publisher', source='pattern:640x480@30', publish_rate=0.0,
                      wait_for_subscribers=3)
    for process in (leaving, killed):
        process.wait_for('Receiving video frame')
    late = count('ours')
    late.wait_for('the first frame')
    leaving.interrupt()
    assert leaving.finish() == 0, leaving.output
    killed.interrupt(signal.SIGKILL)
    killed.finish()
    another = count('ours')
    another.wait_for('the first frame')
    publisher.interrupt()
    assert publisher.finish() == 0, publisher.output
    published = int(re.search(r'Published (\d+) frames', publisher.output)[1])
    numbers = checksums(640, 480, published)
    for counter, first in ((stays, True), (late, False), (another, False)):
        (found,) = received(counter, numbers)
        assert found == list(range(found[0], found[0] + len(found)))
        assert (found[0] == 0) is first


def test_segments_of_killed_publishers_are_removed(
        start: Start, count: Count, tell: Callable[[str], None], other_domain: int,
        monkeypatch: pytest.MonkeyPatch) -> None:
    counter = count('ours')
    steady = start('img_publisher', source='pattern:640x480', wait_for_subscribers=1)
    counter.wait_for('the first frame')
    kept = steady.segments() | counter.segments()
    assert kept

    monkeypatch.setenv('ROS_DOMAIN_ID', str(other_domain))  # where they map no segment of those
    left_behind = set[Path]()
    for _ in range(4):
        doomed = [start('img_publisher', source='pattern:640x480@30', publish_rate=0.0)
                  for _ in range(3)]
        for process in doomed:
            process.wait_for('Publishing video frame')
        wait_until_gone(left_behind)  # those that were killed before these started
        for process in doomed:
            process.interrupt(signal.SIGKILL)
            assert process.finish() == -signal.SIGKILL
            left_behind |= process.left_behind
    remaining = [path.stat().st_size for path in left_behind if path.exists()]
    tell(f'{len(left_behind)} segments of 12 killed publishers, of which {len(remaining)} remain')
    assert len(left_behind) >= 12
    assert 0 < len(remaining) < len(left_behind)
    assert max(remaining) > 16 << 20
    assert start('img_publisher', source='pattern', max_frames=1).finish() == 0
    wait_until_gone(left_behind)

    assert all(path.exists() for path in kept)
    steady.interrupt()
    assert steady.finish() == 0, steady.output
    published = int(re.search(r'Published (\d+) frames at [\d.]+ Hz, 0 dropped', steady.output)[1])
    (found,) = received(counter, checksums(640, 480, published))
    assert found == list(range(len(found))) and found


def advance(send: NodeProcess, done: str) -> None:
    """Let the sender do its next step."""
    count = send.output.count(done)
    send.interrupt(signal.SIGUSR1)
    send.wait_until(lambda output: output.count(done) > count)


def stop_for_five_large_frames(counter: NodeProcess, send: NodeProcess) -> int | None:
    """Stop a process, and return how many frames it received then; None if it was too long."""
    begin = len(counter.output)
    counter.wait_until(lambda output: 'of 1 bytes' in output[begin:])
    begin = len(counter.output)
    stopped_at = time.monotonic()
    counter.interrupt(signal.SIGSTOP)
    advance(send, 'sent')
    counter.interrupt(signal.SIGCONT)
    is_short = time.monotonic() < stopped_at + GIVEN_UP_SECONDS / 2
    advance(send, 'continued')
    counter.wait_until(lambda output: 'of 3 bytes' in output[begin:] or (
        time.monotonic() > stopped_at + 20 * GIVEN_UP_SECONDS))
    advance(send, 'ended')
    is_whole = is_short and 'of 3 bytes' in counter.output[begin:]
    counter.kill()
    return counter.output[begin:].count('of 24883200 bytes') if is_whole else None


@pytest.mark.process
def test_subscriber_stopped_for_five_large_frames(
        count: Count, send: NodeProcess) -> None:
    stops = (stop_for_five_large_frames(count('ours'), send) for _ in range(50))
    assert next(frames for frames in stops if frames is not None) == 5
