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

"""Waits for the confirmation of published messages."""

from __future__ import annotations

from collections.abc import Callable
from itertools import count
from pathlib import Path
import re
import signal

from conftest import NodeProcess, read_pictures
from images import draw_pattern
import numpy as np
from opencv_tools.base.logs import Log
from opencv_tools.nodes.publisher.backlog import Backlog
import pytest
from rclpy.duration import Duration
from rclpy.qos import QoSProfile

Start = Callable[..., NodeProcess]

WAITING_LINE = 'waiting for a subscriber that has not received the last frames'
TIMEOUT_LINE = ('a subscriber has not received the last frames for 10 s; '
                'the publisher no longer waits for it, and it may lose frames')


class Channel:
    """A publisher of some depth, whose messages are all confirmed or all unconfirmed."""

    def __init__(self, depth: int) -> None:
        self.qos_profile = QoSProfile(depth=depth)
        self.topic_name = '/images'
        self.is_confirmed = False

    def wait_for_all_acked(self, timeout: Duration) -> bool:
        assert timeout.nanoseconds == 0  # rclpy would block the interpreter
        return self.is_confirmed


class SharedChannel:
    """A publisher of shared frames."""

    has_readers = has_ended = False

    def end(self) -> None:
        self.has_ended = True


class FakeLog:
    """A log with the clock that only ``sleep`` advances."""

    def __init__(self) -> None:
        self.now = 100.0
        self.lines: list[tuple[float, str]] = []
        self.on_sleep: Callable[[], object] = lambda: None

    def clock(self) -> float:
        return self.now

    def sleep(self, seconds: float) -> None:
        assert 0 < seconds < 0.1
        self.now += seconds
        self.on_sleep()

    def info(self, message: str) -> None:
        self.lines.append((round(self.now - 100.0, 1), message))

    debug = warning = error = info


@pytest.fixture
def log() -> FakeLog:
    return FakeLog()


@pytest.mark.parametrize('depth', [1, 3, 10])
def test_room_for_as_many_messages_as_the_depth(log: FakeLog, depth: int) -> None:
    channel = Channel(depth)
    backlog = Backlog([channel], Log(log), log.clock, log.sleep)
    for _ in range(depth):
        assert backlog.wait_for_room()
        backlog.add(channel)
    assert log.now == 100.0
    sleeps = count(1)
    log.on_sleep = lambda: backlog.stop() if next(sleeps) == 5 else None
    assert not backlog.wait_for_room()
    assert log.now == pytest.approx(100.0 + 5 * 0.002)
    channel.is_confirmed = True
    assert backlog.wait_for_room()
    channel.is_confirmed = False
    for _ in range(depth):
        assert backlog.wait_for_room()
        backlog.add(channel)
    assert not backlog.wait_for_room()


def test_wait_for_each_topic(log: FakeLog) -> None:
    first, second = channels = Channel(2), Channel(1)
    backlog = Backlog(channels, Log(log), log.clock, log.sleep)
    first.is_confirmed = True
    for channel in channels:
        backlog.add(channel)
    log.on_sleep = lambda: setattr(second, 'is_confirmed', log.now > 100.5)
    assert backlog.wait_for_room()
    assert log.now == pytest.approx(100.5, abs=0.003)
    assert log.lines == []


def test_timeout_of_10_s_until_the_next_confirmation(log: FakeLog) -> None:
    channel = Channel(1)
    backlog = Backlog([channel], Log(log), log.clock, log.sleep)
    backlog.add(channel)
    assert not backlog.wait_for_room()
    assert log.lines == [(2.0, WAITING_LINE), (10.0, TIMEOUT_LINE)]
    timeout_at = log.now
    backlog.add(channel)
    assert not backlog.wait_for_room()
    assert not backlog.wait_for_all()
    assert log.now == timeout_at

    channel.is_confirmed = True
    assert backlog.wait_for_room()
    channel.is_confirmed = False
    backlog.add(channel)
    log.on_sleep = lambda: backlog.stop() if log.now > timeout_at + 5 else None
    assert not backlog.wait_for_room()
    assert log.now > timeout_at + 5
    assert [text for _, text in log.lines] == [WAITING_LINE, TIMEOUT_LINE, WAITING_LINE]


@pytest.mark.parametrize(('depth', 'messages', 'lost'), [(10, 3, 3), (10, 60, 10), (1, 5, 1)])
def test_end_with_messages_that_nobody_confirmed(
        log: FakeLog, depth: int, messages: int, lost: int) -> None:
    channel = Channel(depth)
    backlog = Backlog([channel], Log(log), log.clock, log.sleep)
    for _ in range(messages):
        backlog.add(channel)
    assert not backlog.wait_for_all()  # the wait of 10 s is over
    assert not backlog.confirm_all()
    assert log.now == pytest.approx(100 + 10 + 25, abs=0.01)
    assert log.lines[-1][1] == (f'up to {lost} of the last messages on /images were not received '
                                'by each reliable subscriber; they may be lost')


@pytest.mark.parametrize('seconds', [0.0, 7.3, 24.9])
def test_end_with_messages_that_are_confirmed_late(log: FakeLog, seconds: float) -> None:
    channel = Channel(10)
    backlog = Backlog([channel], Log(log), log.clock, log.sleep)
    backlog.add(channel)
    assert not backlog.wait_for_all()
    later = log.now + seconds
    log.on_sleep = lambda: setattr(channel, 'is_confirmed', log.now >= later)
    assert backlog.confirm_all()
    assert log.now == pytest.approx(later, abs=0.01)


@pytest.mark.parametrize('seconds', [0.0, 7.3, 24.9])
def test_end_with_frames_that_readers_receive_late(log: FakeLog, seconds: float) -> None:
    channel, first, second = Channel(10), SharedChannel(), SharedChannel()
    backlog = Backlog([channel], Log(log), log.clock, log.sleep)
    first.has_readers = True
    log.on_sleep = lambda: setattr(first, 'has_readers', log.now < 100 + seconds)
    assert backlog.confirm_all([first, second])
    assert (first.has_ended, second.has_ended) == (True, True)
    assert log.now == pytest.approx(100 + seconds, abs=0.01)
    assert [text for _, text in log.lines] == [WAITING_LINE] * (seconds > 2)


def test_end_with_frames_that_a_reader_does_not_receive(log: FakeLog) -> None:
    first, second = SharedChannel(), SharedChannel()
    backlog = Backlog([Channel(10)], Log(log), log.clock, log.sleep)
    second.has_readers = True
    assert not backlog.confirm_all([first, second])
    assert log.now == pytest.approx(100 + 25, abs=0.01)
    assert log.lines == [(2.0, WAITING_LINE), (25.0, TIMEOUT_LINE.replace('10', '25'))]


def test_stop_ends_the_wait_at_the_end(log: FakeLog) -> None:
    channel = Channel(10)
    backlog = Backlog([channel], Log(log), log.clock, log.sleep)
    backlog.add(channel)
    log.on_sleep = backlog.stop
    assert backlog.confirm_all()
    assert log.lines == []


def test_wait_for_all_messages(log: FakeLog) -> None:
    channel = Channel(10)
    backlog = Backlog([channel], Log(log), log.clock, log.sleep)
    assert backlog.wait_for_all()
    backlog.add(channel)
    assert backlog.wait_for_room()
    log.on_sleep = lambda: setattr(channel, 'is_confirmed', log.now > 101.0)
    assert backlog.wait_for_all()
    assert log.now == pytest.approx(101.0, abs=0.003)


def test_shared_frame_is_sent_until_all_readers_have_room(log: FakeLog) -> None:
    backlog = Backlog([], Log(log), log.clock, log.sleep)
    times: list[float] = []

    def send() -> bool:
        times.append(log.now)
        return log.now >= has_room_at

    has_room_at = 0.0
    assert backlog.deliver(send)
    has_room_at = 100.03
    assert backlog.deliver(send)
    assert times == pytest.approx([100.0, 100.0, 100.01, 100.02, 100.03])
    has_room_at = 200.0
    assert not backlog.deliver(send)
    assert log.lines == [(2.0, WAITING_LINE), (10.0, TIMEOUT_LINE)]
    times.clear()
    assert not backlog.deliver(send)  # the reader has no room since then
    assert len(times) == 1
    log.now = 200.0
    assert backlog.deliver(send)
    has_room_at = 201.0
    assert backlog.deliver(send)
    backlog.stop()
    has_room_at = 300.0
    assert not backlog.deliver(send)
    assert log.now < 202.0


def test_messages_wait_for_room_beside_a_reader_without_room(log: FakeLog) -> None:
    channel = Channel(1)
    backlog = Backlog([channel], Log(log), log.clock, log.sleep)
    assert not backlog.deliver(lambda: False)
    given_up_at = log.now
    backlog.add(channel)
    assert not backlog.wait_for_room()  # one slow subscriber is enough
    assert log.now == given_up_at
    channel.is_confirmed = True
    assert backlog.wait_for_room()
    assert backlog.deliver(lambda: True)
    assert backlog.wait_for_room()
    channel.is_confirmed = False
    backlog.add(channel)
    log.on_sleep = lambda: setattr(channel, 'is_confirmed', log.now > given_up_at + 1)
    assert backlog.wait_for_room()
    assert log.now > given_up_at + 1


@pytest.mark.thorough
@pytest.mark.parametrize(('on_overflow', 'transport'), [
    ('drop', 'auto'), ('block', 'auto'), ('drop', 'raw'), ('block', 'raw')])
def test_frames_for_a_stopped_subscriber(
        start: Start, tmp_path: Path, on_overflow: str, transport: str) -> None:
    subscriber = start('img_subscriber', output_dir=tmp_path / 'out', on_overflow=on_overflow,
                       transport=transport)
    publisher = start('img_publisher', source='pattern:64x48@50', publish_rate=0,
                      wait_for_subscribers=1)
    subscriber.wait_for('Receiving video frame')
    subscriber.interrupt(signal.SIGSTOP)
    publisher.wait_for(WAITING_LINE)
    subscriber.interrupt(signal.SIGCONT)
    lines = subscriber.output.count('Receiving video frame')
    subscriber.wait_until(lambda text: text.count('Receiving video frame') > lines + 1)
    for process in (subscriber, publisher):
        process.interrupt()
        assert process.finish() == 0, process.output
    received = int(re.search(
        r'Received (\d+) frames .*, 0 dropped, 0 failed, 0 lost in', subscriber.output)[1])
    written = read_pictures(tmp_path / 'out')
    assert len(written) == received > 10
    assert all(np.array_equal(picture, draw_pattern(number, 64, 48))
               for number, picture in enumerate(written))


@pytest.mark.quick_cases(1)
@pytest.mark.parametrize('transport', ['auto', 'raw'])
@pytest.mark.parametrize('file_name', ['f{seq}.png', 'v.mp4'])
def test_recorder_that_is_slower_than_a_file(
        start: Start, tmp_path: Path, transport: str, file_name: str) -> None:
    subscriber = start('img_subscriber', output_dir=tmp_path / 'out', on_overflow='block',
                       queue_size=2, transport=transport, file_name=file_name)
    subscriber.wait_for('Waiting for /video_frames')
    publisher = start('img_publisher', source='pattern:640x480@1000', publish_rate=0,
                      wait_for_subscribers=1, max_frames=300)
    assert publisher.finish() == 0, publisher.output
    subscriber.interrupt()  # the last frames wait
    assert subscriber.finish() == 0, subscriber.output
    ends = [process.output.splitlines()[-1] for process in (publisher, subscriber)]
    found = re.search(r'Published 300 frames at \S+ Hz, 0 dropped(.*)$', ends[0])
    assert found, ends
    ways = [int(count) for count in re.findall(r', (\d+) on /video_frames(?:/shm)?\b', found[1])]
    assert not ways or sum(ways) == 300, ends
    assert re.search(r'Received 300 frames at \S+ Hz: 300 written to ', ends[1]), ends
    assert ends[1].endswith(' 0 dropped, 0 failed, 0 lost in transit'), ends


SLOW = """
import sys
import time
from opencv_tools.frames import FrameNode, main

def create_node():
    def receive(frame):
        time.sleep(0.02)
        if subscription._subscription.is_shared:  # the image topic waits for no callback
            skipped.append(subscription.skipped)
        if len(skipped) == 120:
            print('received 120,', skipped[-1] - skipped[0], 'skipped', flush=True)

    skipped = []
    node = FrameNode('own')
    subscription = node.receive_frames(
        'video_frames', receive, every=True, transport='shm', threaded=len(sys.argv) > 1)
    return node

sys.exit(main(create_node))
"""


@pytest.mark.thorough
@pytest.mark.parametrize('threaded', [(), ('threaded',)], ids=['executor', 'thread'])
def test_callback_that_is_slower_than_a_file(
        start: Start, tmp_path: Path, threaded: tuple[str, ...]) -> None:
    program = tmp_path / 'slow.py'
    program.write_text(SLOW)
    receiver = start(str(program), *threaded)
    start('img_publisher', source='pattern:64x48@500', publish_rate=0, wait_for_subscribers=1)
    receiver.wait_for('received 120, 0 skipped')


@pytest.mark.thorough
def test_killed_subscriber_of_shared_frames(start: Start, tmp_path: Path) -> None:
    killed, other = (start('img_subscriber', '--ros-args', '-r', f'__node:={name}',
                           output_dir=tmp_path / name, transport='shm')
                     for name in ('killed', 'other'))
    publisher = start('img_publisher', source='pattern:64x48@200', publish_rate=0,
                      wait_for_subscribers=2)
    for subscriber in (killed, other):
        subscriber.wait_for('Receiving video frame')
    killed.interrupt(signal.SIGKILL)
    killed.finish()
    first = read_last(publisher)
    publisher.wait_until(lambda _: read_last(publisher) > first + 200)
    for process in (publisher, other):
        process.interrupt()
        assert process.finish() == 0, process.output
    assert TIMEOUT_LINE not in publisher.output  # the memory of the killed one is removed
    published = re.search(r'Published (\d+) frames', publisher.output)
    summary = re.search(
        r'Received (\d+) frames .*, (\d+) dropped, 0 failed, (\d+) lost in', other.output)
    assert published and summary, other.output
    received, dropped, lost = map(int, summary.groups())
    assert first < received + lost <= int(published[1])
    assert len(read_pictures(tmp_path / 'other')) == received - dropped


def read_last(publisher: NodeProcess) -> int:
    """Return the number of the last frame on the console."""
    return int(['0', *re.findall(r'Publishing video frame (\d+)', publisher.output)][-1])


@pytest.mark.thorough
@pytest.mark.parametrize('transport', ['auto', 'raw'])
def test_interrupted_wait_for_a_subscriber(
        start: Start, tmp_path: Path, transport: str) -> None:
    subscriber = start('img_subscriber', output_dir=tmp_path / 'out', transport=transport)
    publisher = start('img_publisher', source='pattern:64x48@100', publish_rate=0,
                      wait_for_subscribers=1)
    subscriber.wait_for('Receiving video frame')
    subscriber.interrupt(signal.SIGSTOP)
    publisher.wait_for(WAITING_LINE)
    publisher.interrupt()
    assert publisher.finish() == 0, publisher.output
    subscriber.interrupt(signal.SIGCONT)
    subscriber.interrupt()
    assert subscriber.finish() == 0, subscriber.output
