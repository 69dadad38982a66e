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

"""Signals at any time: exit status 0, complete files, no leftovers."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
import os
from pathlib import Path
import pty
import re
import signal
import subprocess

from conftest import executable, NodeProcess, read_manifest, read_pictures, recorded_files
from images import find_numbers
import numpy as np
import pytest
from rclpy.duration import Duration
from rclpy.node import Node
from sending import create_publisher, send, stamped
from waiting import pause, status_of, wait_until, work_of

pytestmark = pytest.mark.fresh

Start = Callable[..., NodeProcess]
IGNORING_SIGHUP = ('sh', '-c', 'trap "" HUP && exec "$0" "$@"')
SIGNALS = pytest.mark.parametrize('number', [signal.SIGINT, signal.SIGTERM])


@pytest.mark.quick_cases(1)
@SIGNALS
def test_clean_exit_of_both_nodes(
        start: Start, tmp_path: Path, number: int) -> None:
    subscriber = start('img_subscriber', output_dir=tmp_path / 'out')
    publisher = start('img_publisher', source='pattern:160x120@30', publish_rate=0,
                      wait_for_subscribers=1)
    subscriber.wait_for(' Hz, ')
    segments = subscriber.segments() | publisher.segments()
    assert segments

    subscriber.interrupt(number)
    assert subscriber.finish() == 0, subscriber.output
    publisher.interrupt(number)
    assert publisher.finish() == 0, publisher.output

    for process in (subscriber, publisher):
        assert '[ERROR]' not in process.output
        # A start that takes long is told, and is no fault of the end.
        assert not [line for line in process.output.splitlines()
                    if '[WARN]' in line and 'No frames: ' not in line]
    received = int(re.search(r'Received (\d+) frames', subscriber.output)[1])
    written = read_pictures(tmp_path / 'out')
    assert len(written) == received
    assert len(read_manifest(tmp_path / 'out')) == received
    assert len(find_numbers(written)) == received
    assert not [segment for segment in segments if segment.exists()]


@pytest.mark.quick_cases(2)
@SIGNALS
@pytest.mark.parametrize(('name', 'parameters', 'text'), [
    ('img_publisher', {'source': 'pattern', 'wait_for_subscribers': 1}, 'Waiting for 1'),
    ('img_subscriber', {}, 'Waiting for /video_frames'),
    ('img_publisher', {'source': 'pattern:8x8@0.01', 'publish_rate': 0}, 'video frame 1:'),
    ('img_publisher', {'source': 987}, 'camera /dev/video987 does not exist'),
])
def test_exit_while_waiting(
        start: Start, name: str, parameters: dict[str, object], text: str, number: int) -> None:
    process = start(name, **parameters)
    process.wait_for(text)
    process.interrupt(number)
    assert process.finish() == 0, process.output


def test_queued_frames_are_written_at_exit(start: Start, tmp_path: Path) -> None:
    subscriber = start('img_subscriber', output_dir=tmp_path / 'out')
    publisher = start('img_publisher', source='pattern:1280x720', publish_rate=100, max_frames=20,
                      wait_for_subscribers=1)
    assert publisher.finish() == 0, publisher.output
    subscriber.interrupt()
    subscriber.interrupt()  # as ros2 launch does after the terminal did
    assert subscriber.finish() == 0, subscriber.output
    received, written, failed = map(int, re.search(
        r'Received (\d+) .*: (\d+) written .* (\d+) failed', subscriber.output).groups())
    assert received > 1
    assert (written, failed) == (received, 0)
    assert len(read_pictures(tmp_path / 'out')) == written


@pytest.mark.thorough
@pytest.mark.parametrize(('name', 'queue_size'), [
    ('{seq:03d}.png', 10), ('{seq:03d}.png', 100), ('all.mkv', 10), ('all.mcap', 10)])
def test_second_interrupt_of_a_blocking_recorder(
        start: Start, node: Node, tmp_path: Path, name: str, queue_size: int) -> None:
    folder = tmp_path / 'out'
    recorder = start('img_subscriber', output_dir=folder, file_name=f'"{name}"', writers=1,
                     on_overflow='block', queue_size=queue_size, png_compression=9)
    noise = np.random.default_rng(1).integers(0, 256, (720, 1280, 3), np.uint8)
    publisher = create_publisher(node)
    send(node, publisher, *(stamped(noise, 'bgr8', number) for number in range(60)))
    wait_until(lambda: publisher.wait_for_all_acked(Duration()))
    recorder.wait_for('Receiving video frame')
    recorder.interrupt()
    pause(1.1)  # an earlier signal is that of ros2 launch
    if recorder.is_running():
        recorder.interrupt()
    status = recorder.finish()
    numbers = {name: int(number) for number, name in re.findall(
        r'(\d+) (frames at|written|dropped|failed|lost|not processed)', recorder.output)}
    unprocessed = numbers.pop('not processed', 0)
    assert status == (unprocessed > 0), recorder.output
    assert numbers == {'frames at': 60, 'written': 60 - unprocessed, 'dropped': 0,
                       'failed': 0, 'lost': 0}
    assert sum(line.get('frames', 1) for line in read_manifest(folder)) == numbers['written']


@pytest.mark.thorough
def test_signals_after_the_last_log_line(start: Start) -> None:
    subscriber = start('img_subscriber', max_frames=3)
    publisher = start('img_publisher', source='pattern', max_frames=3, wait_for_subscribers=1)
    for process, last_line in ((publisher, 'Published 3'), (subscriber, 'Received 3')):
        process.wait_for(last_line)
        while process.is_running():  # its interpreter shuts down
            for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
                process.interrupt(number)
            pause(0.001)
        assert process.finish() == 0, process.output


@pytest.mark.quick_cases(1)
@pytest.mark.process
@pytest.mark.parametrize('within', [(), IGNORING_SIGHUP], ids=['as usual', 'as by nohup'])
def test_recording_after_hangup(
        start: Start, tmp_path: Path, within: tuple[str, ...]) -> None:
    start('img_publisher', source='pattern:80x60@60', publish_rate=0)
    folder = tmp_path / 'out'
    console = b''
    master, slave = pty.openpty()
    os.set_blocking(master, False)

    def wait_for_files(count: int) -> None:
        def read() -> None:
            nonlocal console
            with suppress(BlockingIOError, OSError):  # a terminal that is full blocks who writes
                console += os.read(master, 1 << 16)
            pause(0.02)

        wait_until(lambda: len(recorded_files(folder)) >= count, f'{count} files', read,
                   files=lambda: len(recorded_files(folder)), output=lambda: console,
                   work=lambda: work_of(recorder.pid))

    with subprocess.Popen(
            ['setsid', '--ctty', *within, executable('img_subscriber'), '--ros-args',
             '-p', f'output_dir:={folder}'], stdin=slave, stdout=slave, stderr=slave) as recorder:
        try:
            os.close(slave)
            wait_for_files(3)
            os.close(master)
            if within:
                wait_for_files(len(recorded_files(folder)) + 3)
                recorder.send_signal(signal.SIGINT)
            assert status_of(recorder) == 0
        finally:
            with suppress(ProcessLookupError):
                recorder.kill()
    assert len(read_manifest(folder)) >= 3
    assert not list(folder.glob('.*'))
