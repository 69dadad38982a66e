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

"""Frames from process to process: each one arrives, in order, pixel for pixel."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import cache
import json
import os
from pathlib import Path
import re
import signal
import sys
import zlib

from conftest import NodeProcess
from opencv_tools.capture.pattern import PatternSource, PatternSpec
import pytest

Start = Callable[..., NodeProcess]
Count = Callable[..., NodeProcess]
COUNTER = Path(__file__).with_name('frame_counter.py')
RELIABILITY = 'qos_overrides./video_frames.publisher.reliability'


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
    """Give the numbers of the pattern's frames by their checksums."""
    source = PatternSource(PatternSpec(width, height))
    numbers = {zlib.crc32(source.read().image): number for number in range(frames)}
    assert len(numbers) == frames
    return numbers


def received(counter: NodeProcess, numbers: dict[int, int]) -> list[list[int | None]]:
    """End a counting process; the numbers of each node's frames, None where a pixel is wrong."""
    counter.interrupt()
    assert counter.finish() == 0, counter.output
    return [[numbers.get(checksum) for checksum in frames]
            for frames in json.loads(counter.output.splitlines()[-1])]


def segments_of(files: set[Path]) -> set[Path]:
    """Keep the segments of participants among the files of Fast DDS."""
    return {path for path in files if re.fullmatch('fastrtps_[0-9a-f]{16}', path.name)}


@pytest.mark.parametrize('reliability', ['reliable', 'best_effort'])
@pytest.mark.parametrize(('width', 'height', 'rate', 'frames', 'kinds'), [
    (1920, 1080, 30, 300, ('ours', 'plain')),
    # Two processors have not the time for both at once.
    (3840, 2160, 15, 150, ('ours',)), (3840, 2160, 15, 150, ('plain',))])
def test_every_frame_arrives_at_our_subscribers_and_at_plain_ones(
        start: Start, count: Count, tell: Callable[[str], None], width: int, height: int,
        rate: int, frames: int, kinds: tuple[str, ...], reliability: str) -> None:
    numbers = checksums(width, height, frames)
    words = ['--best-effort'] if reliability == 'best_effort' else []
    counters = {kind: count(kind, *words) for kind in kinds}
    publisher = start('img_publisher', source=f'pattern:{width}x{height}@{rate}', publish_rate=0.0,
                      max_frames=frames, wait_for_subscribers=len(kinds),
                      **{RELIABILITY: reliability})
    assert publisher.finish() == 0, publisher.output
    arrived = {kind: received(counter, numbers)[0] for kind, counter in counters.items()}
    tell(f'{width}x{height}@{rate} {reliability}: {frames} sent, '
         + ', '.join(f'{len(found)} delivered to {kind}' for kind, found in arrived.items()))
    assert re.search(rf'Published {frames} frames at [\d.]+ Hz, 0 dropped', publisher.output)
    assert arrived == {kind: list(range(frames)) for kind in kinds}


@pytest.mark.parametrize('nodes', [1, 2, 4])
def test_several_subscribers_at_once_get_every_frame(
        start: Start, count: Count, nodes: int) -> None:
    numbers = checksums(640, 480, 90)
    counters = [count(kind, '--nodes', str(nodes)) for kind in ('ours', 'plain')]
    publisher = start('img_publisher', source='pattern:640x480@30', publish_rate=0.0,
                      max_frames=90, wait_for_subscribers=2 * nodes)
    assert publisher.finish() == 0, publisher.output
    for counter in counters:
        assert received(counter, numbers) == nodes * [list(range(90))]


def test_subscribers_that_come_late_leave_or_are_killed_disturb_nobody(
        start: Start, count: Count) -> None:
    frames = 150
    numbers = checksums(640, 480, frames)
    staying = [count(kind) for kind in ('ours', 'plain')]
    leaving, killed = (start('img_subscriber', mode='on_request') for _ in range(2))
    publisher = start('img_publisher', source='pattern:640x480@30', publish_rate=0.0,
                      max_frames=frames, wait_for_subscribers=4)
    publisher.wait_for('Publishing video frame 1:')
    late = [count(kind) for kind in ('ours', 'plain')]
    for process in (leaving, killed):
        process.wait_for('Hz, 0 dropped')
    leaving.interrupt()
    killed.interrupt(signal.SIGKILL)
    assert leaving.finish() == 0, leaving.output
    assert publisher.finish() == 0, publisher.output
    for counter in staying:
        assert received(counter, numbers) == [list(range(frames))]
    for counter in late:
        (found,) = received(counter, numbers)
        assert 0 < len(found) < frames
        assert found == list(range(frames - len(found), frames))


def test_publishers_that_are_killed_leave_nothing_that_adds_up(
        start: Start, count: Count, tell: Callable[[str], None], other_domain: int,
        monkeypatch: pytest.MonkeyPatch) -> None:
    counter = count('ours')
    steady = start('img_publisher', source='pattern:640x480', wait_for_subscribers=1)
    steady.wait_for('Hz, 0 dropped')
    kept = segments_of(steady.segments() | counter.segments())
    assert kept

    monkeypatch.setenv('ROS_DOMAIN_ID', str(other_domain))  # where they map no segment of those
    left_behind = set[Path]()
    sizes = []
    for _ in range(5):
        doomed = [start('img_publisher', source='pattern:640x480@30', publish_rate=0.0)
                  for _ in range(4)]
        for process in doomed:
            process.wait_for('Publishing video frame')
        for process in doomed:
            process.interrupt(signal.SIGKILL)
            assert process.finish() == -signal.SIGKILL
            left_behind |= process.left_behind
        sizes.append(sum(path.stat().st_size for path in left_behind if path.exists()))
    names = segments_of(left_behind)
    assert len(names) >= 20
    largest = max(path.stat().st_size for path in names if path.exists())
    tell(f'{sizes[0]} bytes in /dev/shm after 4 killed publishers, {sizes[-1]} after 20')
    assert largest > 16 << 20
    assert sizes[-1] <= sizes[0] + largest
    assert start('img_publisher', source='pattern', max_frames=1).finish() == 0
    assert not [path for path in names if path.exists()]

    assert all(path.exists() for path in kept)
    steady.interrupt()
    assert steady.finish() == 0, steady.output
    published = int(re.search(r'Published (\d+) frames at [\d.]+ Hz, 0 dropped', steady.output)[1])
    assert received(counter, checksums(640, 480, published)) == [list(range(published))]
