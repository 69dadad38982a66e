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

"""Frames from the publisher process through the subscriber process to disk."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
import re
import signal

from conftest import (
    CLIP, CLIP_FRAMES, decode_clip, NodeProcess, read_pictures, recorded_files)
from images import draw_pattern, find_numbers
import numpy as np
from opencv_tools.frames import FramePublisher
import pytest
from rclpy.node import Node
from std_msgs.msg import Header
from waiting import pause, wait_until

Start = Callable[..., NodeProcess]
RELIABILITY = 'qos_overrides./video_frames.publisher.reliability'


def assert_same_frames(written: list[np.ndarray], expected: list[np.ndarray]) -> None:
    assert len(written) == len(expected)
    different = [index for index, (left, right) in enumerate(zip(written, expected))
                 if not np.array_equal(left, right)]
    assert not different


@pytest.mark.thorough
def test_every_frame_of_the_clip_is_recorded(start: Start, tmp_path: Path) -> None:
    subscriber = start('img_subscriber', output_dir=tmp_path / 'out', max_frames=CLIP_FRAMES,
                       on_overflow='block')
    publisher = start('img_publisher', source=CLIP, publish_rate=0, wait_for_subscribers=1)
    assert publisher.finish() == 0, publisher.output
    assert subscriber.finish() == 0, subscriber.output
    assert_same_frames(read_pictures(tmp_path / 'out'), decode_clip())
    assert re.search(r'Published 90 frames at [\d.]+ Hz, 0 dropped', publisher.output)
    assert re.search(r'Received 90 frames .*: 90 written to .*, 0 dropped, 0 failed, 0 lost',
                     subscriber.output)


@pytest.mark.thorough
def test_best_effort_frames_are_recorded_or_lost(
        start: Start, tmp_path: Path) -> None:
    subscriber = start('img_subscriber', output_dir=tmp_path / 'out', on_overflow='block')
    publisher = start('img_publisher', source='pattern:1280x720@30', publish_rate=0,
                      wait_for_subscribers=1, **{RELIABILITY: 'best_effort'})
    subscriber.wait_until(lambda text: text.count('Receiving video frame') > 1)
    for process in (subscriber, publisher):
        process.interrupt()
        assert process.finish() == 0, process.output
    numbers = find_numbers(read_pictures(tmp_path / 'out'))
    received, written, lost = map(int, re.search(
        r'Received (\d+) .*: (\d+) written to .* (\d+) lost', subscriber.output).groups())
    assert received == written == len(numbers)
    assert received + lost == numbers[-1] - numbers[0] + 1
    before = re.search(r'(\d+) sent before the first received frame', subscriber.output)
    assert numbers[0] == int(before[1] if before else 0)


def test_best_effort_publisher_started_first(start: Start, tmp_path: Path) -> None:
    publisher = start('img_publisher', source='pattern:64x48', publish_rate=50,
                      **{RELIABILITY: 'best_effort'})
    publisher.wait_for('Publishing video frame 1:')
    subscriber = start('img_subscriber', output_dir=tmp_path / 'out', max_frames=5)
    assert subscriber.finish() == 0, subscriber.output
    assert len(read_pictures(tmp_path / 'out')) == 5


@pytest.mark.thorough
def test_two_recorders_get_every_frame(start: Start, tmp_path: Path) -> None:
    subscribers = [start('img_subscriber', output_dir=tmp_path / name, max_frames=30)
                   for name in ('first', 'second')]
    publisher = start('img_publisher', source='pattern:320x240@60', publish_rate=0, max_frames=30,
                      wait_for_subscribers=2)
    assert publisher.finish() == 0, publisher.output
    expected = [draw_pattern(number, 320, 240) for number in range(30)]
    for subscriber, name in zip(subscribers, ('first', 'second')):
        assert subscriber.finish() == 0, subscriber.output
        assert_same_frames(read_pictures(tmp_path / name), expected)


def test_progress_on_the_console(
        start: Start, tmp_path: Path) -> None:
    subscriber = start('img_subscriber', output_dir=tmp_path / 'out', max_frames=60)
    publisher = start('img_publisher', source='pattern:64x48@30', publish_rate=0, max_frames=60,
                      wait_for_subscribers=1)
    assert publisher.finish() == subscriber.finish() == 0
    line = re.compile(r'video frame \d+: 64x48 bgr8, ([\d.]+ Hz, )?0 dropped')
    for process, phrase in ((publisher, 'Publishing'), (subscriber, 'Receiving')):
        lines = [text for text in process.output.splitlines() if f'{phrase} video frame' in text]
        assert 2 <= len(lines) < 60  # not one for each frame
        assert all(line.search(text) for text in lines), lines


@pytest.mark.thorough
def test_numbering_continues_after_an_earlier_run(start: Start, tmp_path: Path) -> None:
    for expected in (3, 6):
        subscriber = start('img_subscriber', output_dir=tmp_path / 'out', max_frames=3)
        start('img_publisher', source='pattern:64x48', publish_rate=50, max_frames=3,
              wait_for_subscribers=1)
        assert subscriber.finish() == 0, subscriber.output
        assert len(read_pictures(tmp_path / 'out')) == expected
    assert_same_frames(read_pictures(tmp_path / 'out'),
                       [draw_pattern(number % 3, 64, 48) for number in range(6)])


@pytest.mark.quick_cases(1)
@pytest.mark.parametrize('file_name', ['frame_{seq}.tiff', 'frame_{seq:04d}.npy'])
def test_format_from_the_extension(start: Start, tmp_path: Path, file_name: str) -> None:
    subscriber = start('img_subscriber', output_dir=tmp_path / 'out', max_frames=2,
                       file_name=file_name)
    start('img_publisher', source='pattern:64x48', publish_rate=50, max_frames=2,
          wait_for_subscribers=1, encoding='rgb8')
    assert subscriber.finish() == 0, subscriber.output
    written = tmp_path / 'out' / file_name.format(seq=1)
    expected = draw_pattern(1, 64, 48)
    if written.suffix == '.npy':
        # The array as it was sent, which is rgb8.
        assert np.array_equal(np.load(written), expected[..., ::-1])
    else:
        assert_same_frames(read_pictures(tmp_path / 'out', '.tiff')[1:], [expected])


def test_frame_unsupported_by_the_format(
        start: Start, tmp_path: Path) -> None:
    subscriber = start('img_subscriber', output_dir=tmp_path / 'out', max_frames=1,
                       file_name='{seq}.jpg'.join('""'))
    start('img_publisher', source='pattern:64x48', encoding='mono16', max_frames=1,
          wait_for_subscribers=1)
    assert subscriber.finish() == 1
    assert 'a mono16 frame cannot be stored as .jpg; set the extension of file_name to .png' in (
        subscriber.output)
    assert not list((tmp_path / 'out').iterdir())


@pytest.mark.process
@pytest.mark.parametrize('is_killed', [False, True])
@pytest.mark.parametrize(('ways', 'topic'), [
    (('raw', 'compressed'), '/compressed'), (('compressed', 'raw'), ''), (('raw', 'raw'), ''),
    (('compressed', 'compressed'), '/compressed'), (('shm', 'raw'), ''), (('raw', 'auto'), '')])
def test_account_of_a_recorder_beside_another(
        start: Start, node: Node, tmp_path: Path, ways: tuple[str, str], topic: str,
        is_killed: bool) -> None:
    publisher = FramePublisher(node, 'video_frames')

    def record(name: str) -> NodeProcess:
        """Start a recorder, and publish until it has received frames."""
        recorder = start('img_subscriber', output_dir=tmp_path / name, transport=ways[name == 'b'],
                         on_overflow='block', file_name='f{frame_id}.png')
        recorder.wait_for('Waiting for')
        wait_until(lambda: send() and 'Receiving video frame' in recorder.output)
        return recorder

    def send() -> int:
        sent.append(len(sent))
        publisher.publish(draw_pattern(len(sent), 64, 48), Header(frame_id=f'{len(sent):06d}'))
        pause(0.01)
        return len(sent)

    sent: list[int] = []
    first = record('a')
    for _ in range(17):
        send()
    if is_killed:
        first.interrupt(signal.SIGKILL)
        first.finish()
    second = record('b')
    for _ in range(23):
        send()
    wait_until((tmp_path / f'b/f{len(sent):06d}.png').exists)
    second.interrupt()
    assert second.finish() == 0, second.output
    numbers = [int(path.stem[1:]) for path in recorded_files(tmp_path / 'b')]
    received, lost, before = map(int, re.search(
        r'Received (\d+) .* (\d+) lost in transit(?:, (\d+) sent before the first)?',
        second.output).groups('0'))
    assert received == len(numbers)
    assert received + lost == len(sent) - numbers[0] + 1
    # What was not on the topic of the second recorder is in the numbers of the publisher.
    on_topic = publisher.sent[f'/video_frames{topic}']
    assert before + received + lost == on_topic, (second.output, publisher.sent)
    assert on_topic <= len(sent) - publisher.without_subscribers
