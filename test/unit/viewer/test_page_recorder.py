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


"""Recordings of pages without a page: requests, bounds and frames in memory."""

from __future__ import annotations

from contextlib import closing
import errno
import os
from pathlib import Path
from threading import Event
from typing import Any

from console import Console
import numpy as np
from opencv_tools.bags.open_bag import Bag
from opencv_tools.bags.schemas import IMAGE
from opencv_tools.bags.writing import BagChannel
from opencv_tools.image.cdr import (
    cdr_to_compressed_image, cdr_to_image, WireCompressedImage, WireHeader, WireImage)
from opencv_tools.nodes.conversion import frame_of
from opencv_tools.recording import file_sink
from opencv_tools.recording.bag_sink import BagSink, MessageFrame
from opencv_tools.recording.errors import RecordingError
from opencv_tools.topics.queue import ReceivedMessage
from opencv_tools.viewer.errors import RequestError
from opencv_tools.viewer.recording import bag_recording as module
from opencv_tools.viewer.recording.bag_recording import BagRecording, Topic
from opencv_tools.viewer.recording.page_recorder import (
    bag_frames, BagFolder, topics_of, write_frames)
import pytest
from rclpy.node import Node

KNOWN = {1: Topic('/left', 'auto'), 2: Topic('/right', 'disparity')}
_RANDOM = np.random.default_rng(5)


def received(number: int, size: int = 4) -> ReceivedMessage:
    """Return a raw image as it is received, one a second."""
    image = _RANDOM.integers(0, 256, (size, size, 3), np.uint8)
    return ReceivedMessage(WireImage(
        header=WireHeader(number, 0, 'camera'), height=size, width=size, encoding='bgr8',
        is_bigendian=False, step=3 * size, data=image), number * 10**9, number * 10**9, number)


def compressed(number: int) -> ReceivedMessage:
    """Return a compressed image as it is received, half a second after a raw one."""
    data = np.frombuffer(_RANDOM.bytes(100), np.uint8)
    return ReceivedMessage(WireCompressedImage(
        header=WireHeader(number, 0, 'camera'), format='jpeg', data=data),
        number * 10**9 + 500_000_000)


@pytest.mark.parametrize(('numbers', 'names'), [
    ([1], ['/left']), ([2, 1], ['/right', '/left']), ([1, 1, 1], ['/left'])])
def test_topics_by_their_numbers(numbers: list[int], names: list[str]) -> None:
    assert [topic.name for topic in topics_of(numbers, KNOWN)] == names


@pytest.mark.parametrize(('wanted', 'sentence'), [
    ([], 'there is no topic to record'), ('/left', 'there is no topic to record'),
    (None, 'there is no topic to record'), (True, 'there is no topic to record'),
    ({'1': 1}, 'there is no topic to record'), ([3], '3 is not the number of a topic'),
    (['/left'], '/left is not the number of a topic'), ([[1]], '[1] is not the number of'),
    (['../../etc/passwd'], '../../etc/passwd is not the number of a topic'),
    ([True], 'True is not the number of a topic'), ([1.0], '1.0 is not the number of a topic'),
    ([float('nan')], 'nan is not the number'), ([{}], '{} is not the number of a topic'),
    ([None], 'None is not the number of a topic'), (['a' * 10**6], 'aaaa'),
    ([1] * 65, '65 topics are too many: a recording has 64 at most; hide others'),
    ([*range(10_000)], '10000 topics are too many')])
def test_numbers_that_are_refused(wanted: Any, sentence: str) -> None:
    with pytest.raises(RequestError) as caught:
        topics_of(wanted, KNOWN)
    assert str(caught.value).startswith(sentence)
    assert len(str(caught.value)) < 100


class StuckSink:
    """A bag on a disk that takes nothing until it may."""

    def __init__(self, folder: Path) -> None:
        self._sink = BagFolder(str(folder)).open()
        self.counts = self._sink.counts
        self.left = 5
        self.may_write = Event()

    def commit(self, frame: Any, prepared: Any) -> Path:
        self.may_write.wait()
        return self._sink.commit(frame, prepared)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._sink, name)


def raw_frames(*messages: ReceivedMessage) -> list[MessageFrame]:
    return [frame_of(one, BagChannel(topic='/left', type_name=IMAGE)) for one in messages]


def test_bytes_that_wait_for_the_disk(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, '_MAX_BYTES', 10 * 48)
    sink, console = StuckSink(tmp_path), Console()
    recording = BagRecording(sink, console)  # type: ignore[arg-type]
    frames = raw_frames(*(received(number) for number in range(30)))
    assert [recording.record(frame) for frame in frames].count(True) == 10
    sink.may_write.set()
    recording.stop()
    recording.finish()
    account = recording.account()
    assert (account['frames'], account['dropped'], account['failed']) == (10, 20, 0)
    assert account['bytes'] == 10 * 48
    assert sum(Bag(tmp_path / account['name']).topics.values()) == 10
    assert 'frames dropped: they arrive faster than they are written' in str(console.lines)


def test_bag_that_cannot_be_finished(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def close(_: BagSink) -> None:
        raise OSError(errno.ENOSPC, 'No space left on device')

    sink, console = BagFolder(str(tmp_path)).open(), Console()
    monkeypatch.setattr(BagSink, 'close', close)
    recording = BagRecording(sink, console)
    for frame in raw_frames(received(1)):
        recording.record(frame)
    recording.stop()
    assert recording.account()['problem'] == ''
    recording.finish()
    assert recording.account()['problem'] == (
        'the bag is not finished: the log has the reason; the next start of the node finishes it, '
        'if the disk has room')
    assert 'the recording was not finished: No space left on device' in str(console.lines)


def test_abandoned_frames(tmp_path: Path) -> None:
    sink = StuckSink(tmp_path)
    recording = BagRecording(sink, Console())  # type: ignore[arg-type]
    for frame in raw_frames(*(received(number) for number in range(30))):
        recording.record(frame)
    recording.recorder.abandon()
    sink.may_write.set()
    recording.stop()
    recording.finish()
    account = recording.account()
    assert account['frames'] + account['dropped'] == 30
    assert account['frames'] <= 1


@pytest.mark.process
def test_frames_in_memory(node: Node, tmp_path: Path) -> None:
    raw, jpegs = [received(number) for number in range(200)], [
        compressed(number) for number in range(200)]
    frames = bag_frames(node, {'/left': raw, '/right': jpegs, '/none': []})
    assert [frame.receive_ns for frame in frames] == [
        number * 500_000_000 for number in range(400)]
    saved = write_frames(BagFolder(str(tmp_path)).open('_kept'), frames, Console())
    assert (saved.written, saved.problem) == (400, '')
    bag = Bag(tmp_path / saved.name)
    assert not bag.warnings
    found: dict[str, list[bytes]] = {}
    with closing(bag):
        for message in bag.messages([*bag.topics]):
            name = message.topic.name
            read = cdr_to_image if name == '/left' else cdr_to_compressed_image
            found.setdefault(name, []).append(bytes(read(message.load()).data))
    assert found == {'/left': [bytes(one.message.data) for one in raw],
                     '/right/compressed': [bytes(one.message.data) for one in jpegs]}


@pytest.mark.process
def test_frames_in_memory_and_a_full_disk(
        node: Node, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    sink = BagFolder(str(tmp_path)).open('_kept')
    monkeypatch.setattr(file_sink, 'RESERVE_BYTES', 10**18)
    saved = write_frames(
        sink, bag_frames(node, {'/left': [received(number) for number in range(100)]}), Console())
    assert (saved.written, saved.name) == (0, '')
    assert saved.problem.startswith('100 of 100 frames were not written: the disk has ')
    assert [*tmp_path.iterdir()] == []
    with pytest.raises(RecordingError, match=r'the disk has .* MB left, and .*: remove files'):
        BagFolder(str(tmp_path)).open()


@pytest.mark.parametrize(('path', 'sentence'), [
    ('{topic}', 'record_dir {topic} cannot be used: a folder cannot have the field {topic}'),
    ('file', 'record_dir {}/file cannot be used: it is a file or a broken link; set record_dir'),
    ('a' * 300, 'record_dir {}/aaa'), ('file/bags', 'record_dir {}/file/bags cannot be used: ')])
def test_folders_that_cannot_be_used(
        path: str, sentence: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    Path('file').touch()
    with pytest.raises(RecordingError) as caught:
        BagFolder(path)
    assert str(caught.value).startswith(
        sentence if '{topic}' in sentence else sentence.format(tmp_path))
    assert 'output_dir' not in str(caught.value) and '\n' not in str(caught.value)


def test_names_of_bags(tmp_path: Path) -> None:
    folder = BagFolder(str(tmp_path))
    names = set()
    while len(names) < 3:  # several a second
        sink = folder.open()
        frame, = raw_frames(received(1))
        path = sink.commit(frame, sink.prepare(frame))
        sink.close()
        names.add(path.name)
    assert len([*tmp_path.glob('*.mcap')]) == len(names)
    assert not any(os.sep in name for name in names)
