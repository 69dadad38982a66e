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

"""Recording of bags: counts, manifest, limits, rings, full disks and killed recordings."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import replace
import errno
import hashlib
import json
import os
from pathlib import Path
import random
import signal
import subprocess
import sys
from threading import Event
import time

from bag_readers import account_of, decode, metadata_of, read_by_all, read_indexed
from conftest import disk_of, read_manifest, recorded_files
from console import Console
import numpy as np
from opencv_tools.bags.offered_qos import offered_qos_text, OfferedQos
from opencv_tools.bags.schemas import CAMERA_INFO, IMAGE
from opencv_tools.bags.writing import BagChannel
from opencv_tools.image.cdr import (
    compressed_image_to_cdr, image_to_cdr, WireCompressedImage, WireHeader, WireImage)
from opencv_tools.image.encodings import find_encoding
from opencv_tools.image.layout import array_to_wire
from opencv_tools.recording.bag_sink import BagSink, MessageBatch, MessageFrame, RecordedMessage
from opencv_tools.recording.errors import LimitReached, RecordingError, UnwritableError, Unwritten
from opencv_tools.recording.folder import Folder
from opencv_tools.recording.frames import CompressedFrame, ReceivedFrame
from opencv_tools.recording.image_encoder import EncoderSettings
from opencv_tools.recording.manifest import Manifest
from opencv_tools.recording.naming import FileNames, FrameMetadata
from opencv_tools.recording.open_sink import check_format, finish_bags, open_sink
from opencv_tools.recording.recorder import Recorder
from opencv_tools.recording.selection import Limits
import pytest
from rclpy.serialization import serialize_message
from recordings import frame_of, NANO, NO_LIMITS, open_videos, random_image
from sensor_msgs.msg import CameraInfo
from stepped_clock import SteppedClock
from waiting import pause, wait_until

CHANNEL = BagChannel(topic='/video_frames', type_name=IMAGE)


def open_bags(
    folder: Path, name: str = 'drive.mcap', on_exists: str = 'continue',
    limits: Limits = NO_LIMITS, clock: SteppedClock | None = None,
) -> BagSink:
    sink = open_sink(folder, FileNames(name), EncoderSettings('.mcap'), on_exists, limits,
                     sync=False, monotonic=clock.monotonic if clock else time.monotonic)
    assert isinstance(sink, BagSink)
    return sink


def frame(number: int, data_bytes: int = 1000, seconds: float | None = None) -> MessageFrame:
    """Return a frame as it is received, one per second."""
    time_ns = round((number if seconds is None else seconds) * NANO)
    message = WireImage(
        header=WireHeader(number, 7, 'camera'), height=1, width=data_bytes, encoding='my_own',
        is_bigendian=False, step=data_bytes, data=np.full(data_bytes, number % 256, np.uint8))
    return MessageFrame(
        metadata=FrameMetadata(number * NANO + 7, 'camera', 'my_own', CHANNEL.topic),
        message=message, channel=CHANNEL, receive_ns=1_700_000_000 * NANO + time_ns,
        arrival_ns=time_ns, publish_ns=number + 1, number=number)


def put(bags: BagSink, one: ReceivedFrame) -> str:
    return bags.commit(one, bags.prepare(one)).name


def put_all(bags: BagSink, numbers: Iterable[int], error: str = '', size: int = 1000) -> int:
    """Put frames and return the number of refused ones, whose error must contain a text."""
    failed = 0
    for number in numbers:
        try:
            put(bags, frame(number, size))
        except OSError as err:
            assert err.strerror == error
            failed += 1
    return failed


def numbers(path: Path) -> list[int]:
    """Return the numbers of the frames in a bag."""
    return [message.header.stamp.sec for message in decode(path) if hasattr(message, 'encoding')]


def lines(folder: Path) -> list[tuple[str, int]]:
    return [(line['file'], line['frames']) for line in read_manifest(folder)]


def camera_info(seconds: float, width: int = 3) -> RecordedMessage:
    time_ns = 1_700_000_000 * NANO + round(seconds * NANO)
    return RecordedMessage(
        channel=BagChannel(topic='/camera_info', type_name=CAMERA_INFO), log_ns=time_ns,
        parts=(serialize_message(CameraInfo(width=width)),), publish_ns=time_ns)


def test_messages_as_they_came(tmp_path: Path) -> None:
    recorder = Recorder(open_bags(tmp_path), Console(), block=True)
    frames = [frame(number) for number in range(20)]
    for one in frames:
        recorder.put(one)
    recorder.close()
    assert recorder.counts.written == 20 and not recorder.is_unfinished
    assert [stored.data for stored in read_by_all(tmp_path / 'drive.mcap')] == [
        image_to_cdr(one.message) for one in frames]
    assert lines(tmp_path) == [('drive.mcap', 20)]
    line, = read_manifest(tmp_path)
    assert (line['encoding'], line['stored_encoding'], line['size']) == (
        'my_own', 'my_own', [1000, 1])
    assert not list(tmp_path.glob('.*'))


@pytest.mark.parametrize('encoding', ['bgr8', 'mono16', '32FC1', 'bayer_rggb8', 'nv12'])
def test_frames_of_pixels(tmp_path: Path, encoding: str) -> None:
    image = random_image(encoding)
    bags = open_bags(tmp_path)
    put(bags, frame_of(image[:, ::-1][:, ::-1], encoding))
    bags.close()
    header = WireHeader(1_700_000_000, 0, 'camera')
    expected = array_to_wire(image, find_encoding(encoding), header)
    stored, = read_by_all(tmp_path / 'drive.mcap')
    assert stored.data == image_to_cdr(expected) and stored.topic == '/video_frames'


def test_compressed_frames(tmp_path: Path) -> None:
    bags = open_bags(tmp_path)
    metadata = FrameMetadata(-1, 'camera', 'jpeg', '/video_frames/compressed')
    put(bags, CompressedFrame(metadata=metadata, receive_ns=7, data=b'no picture'))
    bags.close()
    stored, = read_by_all(tmp_path / 'drive.mcap')
    assert stored.data == compressed_image_to_cdr(WireCompressedImage(
        header=WireHeader(-1, 999_999_999, 'camera'), format='jpeg', data=b'no picture'))
    assert (stored.topic, stored.log_ns) == ('/video_frames/compressed', 7)


def test_frames_of_messages_can_be_decoded() -> None:
    image = random_image('bgr8')
    message = array_to_wire(image, find_encoding('bgr8'))
    metadata = FrameMetadata(5, 'camera', 'bgr8', '/video_frames')
    decoded = MessageFrame(metadata=metadata, message=message, channel=CHANNEL, receive_ns=7,
                           arrival_ns=8).decode()
    assert np.array_equal(decoded.image, image)
    assert (decoded.metadata, decoded.receive_ns, decoded.arrival_ns) == (metadata, 7, 8)


def test_camera_info_is_written_in_the_order_of_reception(tmp_path: Path) -> None:
    bags = open_bags(tmp_path)
    for number in range(3):
        bags.add_message(camera_info(number + 0.5, number))
    for number in range(3):
        put(bags, frame(number))
    bags.close()
    found = read_by_all(tmp_path / 'drive.mcap')
    assert [stored.topic for stored in found] == 3 * ['/video_frames', '/camera_info']
    assert [stored.log_ns for stored in found] == sorted(stored.log_ns for stored in found)
    assert lines(tmp_path) == [('drive.mcap', 3)] and bags.counts.kept == 3


def test_newest_camera_info_is_kept_without_frames(tmp_path: Path) -> None:
    bags = open_bags(tmp_path)
    for number in range(1500):
        bags.add_message(camera_info(0, number))
    put(bags, frame(1))
    bags.close()
    *infos, _ = decode(tmp_path / 'drive.mcap')
    assert [info.width for info in infos] == [*range(500, 1500)]


def test_camera_info_alone_makes_no_bag(tmp_path: Path) -> None:
    bags = open_bags(tmp_path)
    bags.add_message(camera_info(0))
    bags.close()
    assert not list(tmp_path.iterdir())


def batch(first: int, count: int, data_bytes: int = 1000) -> MessageBatch:
    """Return messages of another topic, one per second."""
    channel = BagChannel(topic='/door', type_name='my_msgs/msg/Door', definition='bool is_open')
    times = [1_700_000_000 * NANO + number * NANO for number in range(first, first + count)]
    return MessageBatch(
        metadata=FrameMetadata(times[0], '', '', CHANNEL.topic), receive_ns=times[0],
        arrival_ns=first * NANO, messages=tuple(RecordedMessage(
            channel=channel, parts=(bytes(data_bytes),), log_ns=time_ns, publish_ns=time_ns,
            number=number) for number, time_ns in enumerate(times, first)))


def test_batches_alone_and_between_frames(tmp_path: Path) -> None:
    bags = open_bags(tmp_path)
    for item in (batch(1, 3), frame(4), batch(5, 2)):
        put(bags, item)
    bags.close()
    assert [(stored.topic, stored.log_ns // NANO - 1_700_000_000)
            for stored in read_by_all(tmp_path / 'drive.mcap')] == [
        ('/door', 1), ('/door', 2), ('/door', 3), ('/video_frames', 4), ('/door', 5), ('/door', 6)]
    assert lines(tmp_path) == [('drive.mcap', 1)]
    assert bags.counts.kept == 1


def test_bag_without_frames(tmp_path: Path) -> None:
    bags = open_bags(tmp_path)
    put(bags, batch(1, 3))
    bags.close()
    assert len(read_by_all(tmp_path / 'drive.mcap')) == 3
    assert lines(tmp_path) == [('drive.mcap', 0)]


@pytest.mark.parametrize('with_frame', [False, True])
def test_killed_recording_that_begins_with_a_batch(tmp_path: Path, with_frame: bool) -> None:
    bags = open_bags(tmp_path)
    put(bags, batch(1, 3))
    if with_frame:
        put(bags, frame(4))
    journal, = tmp_path.glob('.*')
    kept, content = journal.read_bytes(), (tmp_path / 'drive.mcap').read_bytes()
    bags.close()
    (tmp_path / 'manifest.jsonl').unlink()
    journal.write_bytes(kept)
    (tmp_path / 'drive.mcap').write_bytes(content)
    open_bags(tmp_path, 'other.mcap').close()
    assert len(read_by_all(tmp_path / 'drive.mcap')) == 3 + with_frame
    line, = read_manifest(tmp_path)
    assert (line['file'], line['frames']) == ('drive.mcap', with_frame)


def test_line_of_a_bag_that_begins_with_a_batch(tmp_path: Path) -> None:
    frames, both = open_bags(tmp_path / 'a'), open_bags(tmp_path / 'b')
    put(both, batch(1, 3))
    for bags in (frames, both):
        put(bags, frame(4))
        put(bags, frame(5))
        bags.close()
    (expected,), (found,) = map(read_manifest, (tmp_path / 'a', tmp_path / 'b'))
    own = {'bytes': 0, 'sha256': ''}
    assert {**found, **own} == {**expected, **own}


def test_batch_that_reaches_the_limit(tmp_path: Path) -> None:
    bags, item = open_bags(tmp_path, limits=Limits(max_bytes=20_000)), batch(1, 100)
    with pytest.raises(LimitReached):
        put(bags, item)
    bags.close()
    path = tmp_path / 'drive.mcap'
    assert len(read_by_all(path)) == item.result.written < 20
    assert 18_500 < path.stat().st_size <= 20_000


def test_batches_of_a_split(tmp_path: Path) -> None:
    bags = open_bags(tmp_path, 'a{seq}.mcap', limits=Limits(split_bytes=8000))
    for first in (1, 9, 17):
        put(bags, batch(first, 8))
    bags.close()
    assert [len(read_by_all(path)) for path in recorded_files(tmp_path)] == [8, 8, 8]


def test_batch_larger_than_its_bag(tmp_path: Path) -> None:
    """The rest of the batch is in the next bag, and no message is written twice."""
    bags = open_bags(
        tmp_path, 'a{seq}.mcap', limits=Limits(max_bytes=20_000, ring=True))
    item = batch(1, 25)
    put(bags, item)
    bags.close()
    assert item.result.written == 25
    path, = recorded_files(tmp_path)
    assert [stored.log_ns // NANO - 1_700_000_000 for stored in read_by_all(path)] == [
        *range(26 - len(read_by_all(path)), 26)]
    assert 1 <= len(read_by_all(path)) < 19


def latched(first: int, count: int, topic: str, offers: int = 1, depth: int = 1) -> MessageBatch:
    """Return messages of a topic that publishers keep for late subscribers."""
    qos = offered_qos_text([OfferedQos(durability=1, depth=depth)] * offers)
    item = batch(first, count, 80)
    channel = BagChannel(topic=topic, type_name='std_msgs/msg/String', qos=qos)
    return replace(item, messages=tuple(replace(
        one, channel=channel, parts=(b'\0\1\0\0\2\0\0\0' + bytes([first + number, 0]),))
        for number, one in enumerate(item.messages)))


def of_topic(path: Path, topic: str) -> list[int]:
    """Return the numbers of the messages of a topic in a bag, which is readable alone."""
    return [stored.data[8] for stored in read_by_all(path) if stored.topic == topic]


@pytest.mark.parametrize(('limits', 'topics', 'frames'), [
    (Limits(split_seconds=3.0), {'/robot_description': (1, 1)}, 20),
    (Limits(max_seconds=40.0, ring=True), {'/robot_description': (1, 1), '/tf_static': (3, 1)},
     100),
    (Limits(split_bytes=9000), {'/map': (1, 5), '/tf_static': (2, 2)}, 31)])
def test_each_file_begins_with_the_latched_messages(
        limits: Limits, topics: dict[str, tuple[int, int]], frames: int, tmp_path: Path) -> None:
    bags = open_bags(tmp_path, 'd_{seq:03d}.mcap', limits=limits)
    items = [latched(0, 7, topic, *kept) for topic, kept in topics.items()]
    for item in items:
        put(bags, item)
    for number in range(7, frames):
        put(bags, frame(number))
        put(bags, batch(number, 1))
    bags.close()
    files = recorded_files(tmp_path)
    assert len(files) > 3
    for path in files[0 if limits.ring else 1:]:
        stored = read_by_all(path)
        for topic, (offers, depth) in topics.items():
            assert of_topic(path, topic) == [*range(7 - offers * depth, 7)], path
        assert [one.topic for one in stored[:3]].count('/video_frames') <= 1
        assert [one.log_ns for one in stored] == sorted(one.log_ns for one in stored)
    if not limits.ring:
        assert of_topic(files[0], next(iter(topics))) == [*range(7)]
    assert [item.result.written for item in items] == [7] * len(items)
    assert bags.counts.kept == frames - 7


@pytest.mark.parametrize(('history', 'depth', 'kept'), [
    (3, 0, 1), (0, 0, 1), (1, 1, 1), (1, 4, 4), (2, 0, 7), (1, 6, 6)])
def test_latched_messages_of_each_publisher(
        history: int, depth: int, kept: int, tmp_path: Path) -> None:
    bags = open_bags(tmp_path, 'd_{seq:03d}.mcap', limits=Limits(split_seconds=3.0))
    qos = offered_qos_text([OfferedQos(durability=1, history=history, depth=depth)] * 3)
    for publisher in (b'a', b'b', b'c'):
        item = latched(0, 7, '/tf_static')
        put(bags, replace(item, messages=tuple(
            replace(one, channel=replace(one.channel, qos=qos), publisher=publisher)
            for one in item.messages)))
    for number in range(7, 20):
        put(bags, frame(number))
    bags.close()
    files = recorded_files(tmp_path)
    assert [of_topic(path, '/tf_static') for path in files[1:]] == [
        [*range(7 - kept, 7)] * 3] * (len(files) - 1)


@pytest.mark.parametrize('publishers', [3, 100, 101, 2000])
def test_latched_messages_of_many_publishers(publishers: int, tmp_path: Path) -> None:
    bags = open_bags(tmp_path, 'd_{seq:03d}.mcap', limits=Limits(split_seconds=3.0))
    for number in range(publishers):
        item = latched(0, 1, '/map')
        put(bags, replace(item, messages=tuple(
            replace(one, publisher=b'%d' % number) for one in item.messages)))
    put_all(bags, range(7, 20))
    bags.close()
    files = recorded_files(tmp_path)
    assert len(of_topic(files[-1], '/map')) == min(publishers, 100)
    assert ('/map has more latched messages' in bags.counts.warning) == (publishers > 100)


@pytest.mark.parametrize('waits', [0.0, 0.7, 3.0])  # the next file is tried after a second
def test_latched_message_is_in_the_file_after_a_full_disk(waits: float, tmp_path: Path) -> None:
    clock = SteppedClock()
    bags = open_bags(tmp_path, 'd_{seq}.mcap', clock=clock)
    put(bags, latched(0, 1, '/robot_description'))
    with disk_of(20_000):
        assert put_all(bags, range(1, 30), os.strerror(errno.EFBIG)) > 5
        for number, topic in enumerate(('/tf_static', '/late', '/late'), 30):
            clock.step_to(clock.now + waits)
            with pytest.raises(OSError):
                put(bags, latched(number, 1, topic))
    clock.step_to(clock.now + 3)
    assert put_all(bags, range(33, 35)) == 0
    put(bags, latched(35, 1, '/robot_description'))
    bags.close()
    first, second = recorded_files(tmp_path)
    assert of_topic(first, '/robot_description') == [0]
    assert of_topic(second, '/robot_description') == [0, 35]
    assert (of_topic(second, '/tf_static'), of_topic(second, '/late')) == ([30], [32])
    assert numbers(second) == [33, 34]


def counted(folder: Path, clock: SteppedClock | None = None, limits: Limits = NO_LIMITS,
            ) -> Recorder:
    """Return a recorder whose bags have its account, as those of a node."""
    bags = open_bags(folder, 'd_{seq}.mcap', limits=limits, clock=clock)
    recorder = Recorder(bags, Console(), block=True, writers=1)
    bags.read_losses(lambda: {CHANNEL.topic: recorder.counts.losses()})
    return recorder


@pytest.mark.parametrize(('seconds', 'files'), [(2.0, 25), (13.0, 4), (50.0, 1), (7.0, 8)])
def test_account_in_each_file_of_a_split(seconds: float, files: int, tmp_path: Path) -> None:
    recorder = counted(tmp_path, limits=Limits(split_seconds=seconds))
    recorder.put(latched(0, 7, '/tf_static', 2, 2))
    for number in range(1, 50):
        recorder.put(frame(number))
        if not number % 7:
            broken = CompressedFrame(metadata=FrameMetadata(2**70, '', 'jpeg', '/a'),
                                     receive_ns=1_700_000_000 * NANO, arrival_ns=number * NANO,
                                     data=b'a')
            recorder.put(broken)
    recorder.close()
    found = recorded_files(tmp_path)
    assert len(found) == files
    assert account_of(found) == {
        CHANNEL.topic: {'written': 49, 'failed': 7},
        '/tf_static': {'written': 7} | ({'repeated': 4 * files - 4} if files > 1 else {})}
    assert len({values['recording'] for path in found for _, values in metadata_of(path)
                if 'recording' in values}) == 1


@pytest.mark.parametrize('room', [9000, 30_000, 70_000, 33_333])
def test_account_after_a_full_disk(room: int, tmp_path: Path) -> None:
    clock = SteppedClock()
    recorder = counted(tmp_path, clock)
    done = list[object]()
    with disk_of(room):
        for number in range(100):
            recorder.put(frame(number), done.append)
        wait_until(lambda: len(done) == 100)
    clock.step_to(clock.now + 3)
    for number in range(100, 110):
        recorder.put(frame(number))
    recorder.close()
    files = recorded_files(tmp_path)
    counts = recorder.counts
    assert len(files) == 2 and counts.written + counts.failed == 110 and counts.failed > 20
    assert account_of(files) == {
        CHANNEL.topic: {'written': counts.written, 'failed': counts.failed}}
    unknown = [[values for _, values in metadata_of(path) if 'unknown' in values]
               for path in files]
    assert [len(one) for one in unknown] == [1, 0]
    assert unknown[0][0]['unknown'] == 'losses: the recorder was killed or the disk was full'


@pytest.mark.parametrize('lost', [1, 40, 300, 7])
def test_account_of_a_full_disk_without_a_next_bag(lost: int, tmp_path: Path) -> None:
    bags = open_bags(tmp_path, clock=SteppedClock())
    bags.read_losses(lambda: {CHANNEL.topic: {'failed': failed}})
    failed = 0
    put_all(bags, range(5))
    with disk_of(recorded_files(tmp_path)[0].stat().st_size + 1000):
        for number in range(lost):
            with pytest.raises(OSError):
                put(bags, frame(5 + number, 30_000))
            failed += 1
    bags.close()
    path, = recorded_files(tmp_path)
    assert account_of([path]) == {CHANNEL.topic: {'written': 5}}
    assert [('unknown' in values) for _, values in metadata_of(path)][-1]
    assert bags.counts.warning.startswith(f'the bags do not have the last {lost} losses')


@pytest.mark.parametrize('frames', [1, 5, 60, 23])
def test_account_of_a_killed_recording(frames: int, tmp_path: Path) -> None:
    bags = open_bags(tmp_path, 'd_{seq}.mcap', limits=Limits(split_seconds=7.0))
    put(bags, latched(0, 1, '/tf_static'))
    for number in range(1, frames + 1):
        put(bags, frame(number))
    path = recorded_files(tmp_path)[-1]
    content = path.read_bytes()
    bags.close()
    path.write_bytes(content)
    open_bags(tmp_path, 'other.mcap').close()
    account, files = account_of(recorded_files(tmp_path)), len(recorded_files(tmp_path))
    assert account.pop('/tf_static') == Counter(written=1, repeated=files - 1)
    assert account == {CHANNEL.topic: {'written': frames}}
    assert [('unknown' in values) for _, values in metadata_of(path)][-1]


def test_latched_messages_alone_make_no_bag(tmp_path: Path) -> None:
    bags = open_bags(tmp_path, 'd_{seq}.mcap', limits=Limits(max_bytes=20_000, ring=True))
    put(bags, latched(0, 1, '/map'))
    with pytest.raises(UnwritableError):
        put(bags, frame(1, 30_000))
    bags.close()
    assert [of_topic(path, '/map') for path in recorded_files(tmp_path)] in ([], [[0]])


def test_names_of_existing_bags(tmp_path: Path) -> None:
    for expected in ('drive.mcap', 'drive_1.mcap', 'drive_2.mcap'):
        bags = open_bags(tmp_path)
        assert put(bags, frame(1)) == expected
        bags.close()
    bags = open_bags(tmp_path, on_exists='overwrite')
    assert put_all(bags, range(2)) == 0
    bags.close()
    assert numbers(tmp_path / 'drive.mcap') == [0, 1]
    assert sorted(lines(tmp_path)) == [('drive.mcap', 2), ('drive_1.mcap', 1), ('drive_2.mcap', 1)]
    with pytest.raises(RecordingError, match=r'already contains drive\.mcap'):
        open_bags(tmp_path, on_exists='error')


def test_killed_recording_that_has_overwritten_a_bag(tmp_path: Path) -> None:
    kept: dict[Path, bytes] = {}
    for count in (5, 3):
        bags = open_bags(tmp_path, on_exists='overwrite')
        kept |= {path: path.read_bytes() for path in tmp_path.glob('manifest.jsonl')}
        put_all(bags, range(count))
        kept |= {path: path.read_bytes() for path in tmp_path.glob('.*')}
        bags.close()
    for path, content in kept.items():  # like a process that was killed before the end
        path.write_bytes(content)
    open_bags(tmp_path, 'other.mcap').close()
    assert lines(tmp_path) == [('drive.mcap', 3)] and not list(tmp_path.glob('.*'))


def test_limit_of_bytes_is_exact(tmp_path: Path) -> None:
    for size in (2000, 20_000, 21_000):
        folder = tmp_path / str(size)
        bags = open_bags(folder, limits=Limits(max_bytes=size))
        taken = 0
        with pytest.raises(LimitReached, match=f'^max_bytes is {size}$'):
            for taken in range(100):
                bags.add_message(camera_info(taken))
                put(bags, frame(taken))
        bags.close()
        assert bags.counts.kept == taken
        files = recorded_files(folder)
        assert size - 2000 < sum(path.stat().st_size for path in files) <= size or not files
        assert [numbers(path) for path in files] == ([[*range(taken)]] if taken else [])


@pytest.mark.parametrize(('limits', 'expected'), [
    (Limits(split_seconds=4.0), [[0, 1, 2, 3], [4, 5, 6, 7], [8, 9]]),
    (Limits(split_bytes=4000), [[0, 1, 2], [3, 4, 5], [6, 7, 8], [9]])])
def test_split(tmp_path: Path, limits: Limits, expected: list[list[int]]) -> None:
    bags = open_bags(tmp_path, 'drive_{seq}.mcap', limits=limits)
    assert put_all(bags, range(10)) == 0
    bags.close()
    assert bags.counts.kept == 10
    assert [numbers(path) for path in recorded_files(tmp_path)] == expected
    assert lines(tmp_path) == [
        (f'drive_{index}.mcap', len(part)) for index, part in enumerate(expected)]


def test_split_of_videos(tmp_path: Path) -> None:
    videos = open_videos(tmp_path, 'clip_{seq}.mkv', limits=Limits(split_seconds=2.0))
    for number in range(5):
        one = frame_of(np.full((16, 16), number, np.uint8), 'mono8', number)
        videos.commit(one, videos.prepare(one))
    videos.close()
    assert lines(tmp_path) == [('clip_0.mkv', 2), ('clip_1.mkv', 2), ('clip_2.mkv', 1)]


def test_split_of_images_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r'^a \.png file has one frame and cannot be split'):
        open_videos(tmp_path / 'out', 'x.png', limits=Limits(split_bytes=7))
    assert not (tmp_path / 'out').exists()


@pytest.mark.parametrize(('limits', 'least', 'most', 'most_bytes'), [
    (Limits(max_frames=20, ring=True), 18, 20, 50_000),
    (Limits(max_seconds=20.0, ring=True), 20, 22, 50_000),
    (Limits(max_bytes=60_000, ring=True), 20, 55, 60_000)])
def test_ring_keeps_the_newest_bags(
        tmp_path: Path, limits: Limits, least: int, most: int, most_bytes: int) -> None:
    bags = open_bags(tmp_path, 'drive_{seq:03d}.mcap', limits=limits)
    for number in range(100):
        put(bags, frame(number))
        assert sum(path.stat().st_size for path in recorded_files(tmp_path)) <= most_bytes
    bags.close()
    files = recorded_files(tmp_path)
    kept = [number for path in files for number in numbers(path)]
    assert kept == [*range(kept[0], 100)] and least <= len(kept) <= most
    assert sum(path.stat().st_size for path in files) <= most_bytes
    assert [frames for _, frames in lines(tmp_path)] == [len(numbers(path)) for path in files]


def test_ring_deletes_bags_of_earlier_recordings(tmp_path: Path) -> None:
    for begin in (0, 30):
        bags = open_bags(tmp_path, 'drive_{seq:03d}.mcap', limits=Limits(max_frames=40, ring=True))
        assert put_all(bags, range(begin, begin + 30)) == 0
        bags.close()
    kept = [number for path in recorded_files(tmp_path) for number in numbers(path)]
    assert kept == [*range(kept[0], 60)] and 36 <= len(kept) <= 40
    assert len(lines(tmp_path)) == len(recorded_files(tmp_path))


def test_ring_whose_oldest_bag_was_removed(tmp_path: Path) -> None:
    bags = open_bags(tmp_path, 'drive_{seq:03d}.mcap', limits=Limits(max_frames=20, ring=True))
    assert put_all(bags, range(20)) == 0
    recorded_files(tmp_path)[0].unlink()
    assert put_all(bags, range(20, 40)) == 0
    bags.close()
    kept = [number for path in recorded_files(tmp_path) for number in numbers(path)]
    assert kept == [*range(kept[0], 40)]


def test_frame_larger_than_the_ring(tmp_path: Path) -> None:
    bags = open_bags(tmp_path, limits=Limits(max_bytes=5000, ring=True))
    put(bags, frame(0, 500))
    with pytest.raises(UnwritableError, match='does not fit in the ring, whose max_bytes is 5000'):
        put(bags, frame(1, 6000))
    put(bags, frame(2, 500))
    bags.close()
    assert numbers(recorded_files(tmp_path)[-1]) == [2]
    assert bags.counts.kept == 2
    assert sum(path.stat().st_size for path in recorded_files(tmp_path)) <= 5000


def test_full_disk_then_room_again(tmp_path: Path) -> None:
    clock, console = SteppedClock(), Console()
    bags = open_bags(tmp_path, clock=clock)
    too_large = os.strerror(errno.EFBIG)
    with disk_of(50_000):
        failed = put_all(bags, range(100), too_large)
    kept = bags.counts.kept
    assert kept + failed == 100 and 30 < kept < 50
    clock.step_to(clock.now + 3)
    assert put_all(bags, range(100, 110)) == 0
    bags.close()
    files = recorded_files(tmp_path)
    assert [numbers(path) for path in files] == [[*range(kept)], [*range(100, 110)]]
    assert lines(tmp_path) == [('drive.mcap', kept), ('drive_1.mcap', 10)]
    assert bags.counts.kept == kept + 10 and not bags.counts.lost and not console.lines
    assert not list(tmp_path.glob('.*'))


@contextmanager
def full_disk_after_five_frames(folder: Path) -> Iterator[BagSink]:
    """Yield a recording that has no room; assert that drive.mcap stays without its summary."""
    bags = open_bags(folder)
    put_all(bags, range(5))
    with disk_of((folder / 'drive.mcap').stat().st_size):
        with pytest.raises(OSError, match=r'File too large: drive\.mcap has no index yet, which'):
            bags._end(bags._file)
        yield bags
    assert bags.counts.lost == 0


def check_first_bag(folder: Path) -> None:
    """Assert that drive.mcap has five frames and a line, and that no file is unfinished."""
    assert lines(folder)[0] == ('drive.mcap', 5)
    assert numbers(folder / 'drive.mcap') == [*range(5)]
    assert not list(folder.glob('.*'))


def test_late_summary_at_the_next_file(tmp_path: Path) -> None:
    with full_disk_after_five_frames(tmp_path) as bags:
        pass
    put(bags, frame(9))
    assert [entry.frames for entry in Manifest(tmp_path).entries()] == [5]
    bags.close()
    check_first_bag(tmp_path)


def test_late_summary_at_the_end(tmp_path: Path) -> None:
    with full_disk_after_five_frames(tmp_path) as bags:
        pass
    bags.close()
    check_first_bag(tmp_path)


def test_late_summary_by_the_next_recording(tmp_path: Path) -> None:
    too_large = os.strerror(errno.EFBIG)
    with full_disk_after_five_frames(tmp_path) as bags, pytest.raises(OSError, match=too_large):
        bags.close()
    assert not (tmp_path / 'manifest.jsonl').exists()
    open_bags(tmp_path).close()
    check_first_bag(tmp_path)


def test_every_frame_is_counted_on_a_full_disk(tmp_path: Path) -> None:
    clock, console = SteppedClock(), Console()
    recorder = Recorder(open_bags(tmp_path, clock=clock), console, block=True)
    with disk_of(20_000):
        for number in range(100):
            recorder.put(frame(number))
            clock.step_to(clock.now + 0.05)
        recorder.close()
    counts = recorder.counts
    assert counts.written + counts.failed == 100 and counts.written > 10
    assert recorder.is_unfinished  # the summary needs more room than a frame
    open_bags(tmp_path).close()
    files = recorded_files(tmp_path)
    assert counts.written == sum(len(numbers(path)) for path in files)
    assert counts.written == sum(frames for _, frames in lines(tmp_path))
    assert console.lines[0] == f'error: a frame was not written: {os.strerror(errno.EFBIG)}'


def test_removed_bag_is_noticed(tmp_path: Path) -> None:
    clock = SteppedClock()
    bags = open_bags(tmp_path, clock=clock)
    put_all(bags, range(3))
    (tmp_path / 'drive.mcap').unlink()
    clock.step_to(clock.now + 1)
    put_all(bags, range(3, 5))
    bags.close()
    assert (bags.counts.kept, bags.counts.lost) == (2, 3)
    assert bags.counts.reason == 'drive.mcap was removed or moved while it was written'
    assert lines(tmp_path) == [('drive.mcap', 2)] and numbers(tmp_path / 'drive.mcap') == [3, 4]


def test_error_of_one_frame(tmp_path: Path) -> None:
    console = Console()
    recorder = Recorder(open_bags(tmp_path), console, block=True)
    metadata = FrameMetadata(2**70, 'camera', 'jpeg', '/a')
    recorder.put(CompressedFrame(metadata=metadata, receive_ns=1, data=b'a'))
    recorder.put(frame(1))
    recorder.close()
    assert (recorder.counts.written, recorder.counts.failed) == (1, 1)
    assert 'a number is out of the range of its field' in console.lines[0]


RECORD = """
import pathlib, sys
from opencv_tools.bags.offered_qos import offered_qos_text, OfferedQos
from opencv_tools.bags.writing import BagChannel
from opencv_tools.image.cdr import WireHeader, WireImage
from opencv_tools.recording.bag_sink import MessageFrame
from opencv_tools.recording.image_encoder import EncoderSettings
from opencv_tools.recording.naming import FileNames, FrameMetadata
from opencv_tools.recording.open_sink import open_sink
from opencv_tools.recording.selection import Limits
bags = open_sink(pathlib.Path(sys.argv[1]), FileNames('drive_{seq}.mcap'),
                 EncoderSettings('.mcap'), 'continue', Limits(), False)
channel = BagChannel(topic='/video_frames', type_name='sensor_msgs/msg/Image')
number = 0
while True:
    size = (10, 3000, 800_000)[number % 3]
    message = WireImage(header=WireHeader(number, 7, 'camera'), height=1, width=size, step=size,
                        encoding='mono8', is_bigendian=False, data=bytes(size))
    metadata = FrameMetadata(number, 'camera', 'mono8', '/video_frames')
    frame = MessageFrame(metadata=metadata, message=message, channel=channel,
                         receive_ns=number * 10**7, arrival_ns=0)
    bags.commit(frame, bags.prepare(frame))
    number += 1
    print(number, flush=True)
"""


@pytest.mark.thorough
@pytest.mark.process
def test_twenty_killed_recordings_are_finished(tmp_path: Path) -> None:
    chosen = random.Random(21)
    for run in range(20):
        moment = chosen.randrange(1, 60)
        with subprocess.Popen([sys.executable, '-c', RECORD, str(tmp_path)],
                              stdout=subprocess.PIPE, text=True) as recording:
            for line in recording.stdout:
                if int(line) == moment:
                    pause(chosen.random() / 100)  # anywhere within a frame
                    recording.send_signal(signal.SIGKILL)
                    break
            written = max([moment, *map(int, recording.stdout.read().split())])
        open_bags(tmp_path, 'other.mcap').close()  # the next recording
        path = tmp_path / f'drive_{run}.mcap'
        found = numbers(path)
        assert found in ([*range(written)], [*range(written + 1)])
        assert len(read_by_all(path)) == len(found)
        assert lines(tmp_path)[-1] == (path.name, len(found))
        assert not list(tmp_path.glob('.*'))


def cut_bag(folder: Path, cut: int) -> Path:
    """Record ten frames, and cut off the end of the bag."""
    bags = open_bags(folder)
    put_all(bags, range(10))
    bags.close()
    path = folder / 'drive.mcap'
    path.write_bytes(path.read_bytes()[:-cut])
    return path


def test_cut_bag_without_a_journal_is_finished(tmp_path: Path) -> None:
    path = cut_bag(tmp_path, 1000)
    open_bags(tmp_path).close()
    assert numbers(path) == [*range(10)]
    assert lines(tmp_path) == [('drive.mcap', 10)]


@pytest.mark.parametrize('limit', [10, 10**6])
def test_long_killed_bag_has_no_digest(
        tmp_path: Path, monkeypatch: pytest.MonkeyPatch, limit: int) -> None:
    monkeypatch.setattr('opencv_tools.recording.folder._MAX_HASHED_BYTES', limit)
    path = cut_bag(tmp_path, 1000)
    open_bags(tmp_path).close()
    last = json.loads((tmp_path / 'manifest.jsonl').read_text().splitlines()[-1])
    digest = hashlib.sha256(path.read_bytes()).hexdigest()
    assert last['sha256'] == ('' if limit == 10 else digest)
    assert (last['bytes'], last['frames']) == (path.stat().st_size, 10)


def test_bag_of_a_running_recording_is_left_alone(tmp_path: Path) -> None:
    first = open_bags(tmp_path)
    put_all(first, range(3))
    second = open_bags(tmp_path)
    assert put(second, frame(9)) == 'drive_1.mcap'
    second.close()
    put_all(first, range(3, 6))
    first.close()
    assert numbers(tmp_path / 'drive.mcap') == [*range(6)]
    assert sorted(lines(tmp_path)) == [('drive.mcap', 6), ('drive_1.mcap', 1)]


def test_damaged_and_foreign_bags_are_left_alone(tmp_path: Path) -> None:
    damaged = bytearray(cut_bag(tmp_path, 300).read_bytes())
    damaged[17 + damaged[9]] = 0x33  # the code of the record after the header
    (tmp_path / 'drive.mcap').write_bytes(damaged)
    (tmp_path / 'text.mcap').write_text('text')
    (tmp_path / 'folder.mcap').mkdir()
    (tmp_path / 'link.mcap').symlink_to('nowhere')
    bags = open_bags(tmp_path, 'new.mcap')
    put(bags, frame(1))
    bags.close()
    assert (tmp_path / 'drive.mcap').read_bytes() == damaged
    assert (tmp_path / 'text.mcap').read_text() == 'text'


def test_bag_killed_in_its_header_is_removed(tmp_path: Path) -> None:
    bags = open_bags(tmp_path)
    put(bags, frame(1))
    journal, = tmp_path.glob('.*')
    kept = journal.read_bytes()
    bags.close()
    (tmp_path / 'manifest.jsonl').unlink()
    journal.write_bytes(kept)
    (tmp_path / 'drive.mcap').write_bytes((tmp_path / 'drive.mcap').read_bytes()[:30])
    open_bags(tmp_path).close()
    assert not list(tmp_path.iterdir())


def test_missing_library_refuses_bags_only(
        tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, 'mcap.records', None)
    text = "^bags need the library mcap, .* install it with 'pip install mcap' .see Install"
    with pytest.raises(ValueError, match=text):
        check_format('.mcap')
    with pytest.raises(RecordingError, match=text):
        open_bags(tmp_path / 'out')
    assert not (tmp_path / 'out').exists()
    check_format('.png')


def test_killed_bag_waits_for_the_library(
        tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = cut_bag(tmp_path, 500)
    content = path.read_bytes()
    with monkeypatch.context() as patch:
        patch.setitem(sys.modules, 'mcap.records', None)
        open_videos(tmp_path, 'x.png').close()
        assert path.read_bytes() == content
    open_bags(tmp_path).close()
    assert len(read_indexed(path)) == 10


def test_batch_on_a_full_disk(tmp_path: Path) -> None:
    """The messages that are counted are those in the file."""
    item, console = batch(1, 100), Console()
    recorder = Recorder(open_bags(tmp_path), console)
    with disk_of(20_000):
        recorder.put(item)
        recorder.close()
    path, = recorded_files(tmp_path)
    finish_bags(Folder(tmp_path))
    assert len(read_by_all(path)) == item.result.written > 10
    assert recorder.is_unfinished
    assert recorder.counts.failed == 0


def test_messages_that_are_not_written(tmp_path: Path) -> None:
    """Messages are no frames in the log, and each batch has its reason."""
    clock, console, results = SteppedClock(), Console(), list[Path | Unwritten]()
    recorder = Recorder(open_bags(tmp_path, 'a{seq}.mcap', clock=clock), console, writers=1)
    with disk_of(5000):
        recorder.put(batch(1, 10), results.append)
        wait_for_results(results, 1)
    clock.step_to(clock.now + 10)
    recorder.put(batch(11, 1), results.append)
    wait_for_results(results, 2)
    recorder.close()
    assert getattr(results[0], 'kind', '') == 'failed' and isinstance(results[1], Path)
    assert console.lines == [
        f'error: messages of topics were not written: {os.strerror(errno.EFBIG)}',
        'info: Writing again; messages of topics were not written']


@pytest.mark.parametrize(('limits', 'count', 'line'), [
    (Limits(max_bytes=5000), 'skipped', 'info: Recording limit reached: max_bytes is 5000'),
    (Limits(max_bytes=500, ring=True), 'failed', 'error: messages of topics were not written: a '),
])
def test_messages_beyond_a_limit(
        tmp_path: Path, limits: Limits, count: str, line: str) -> None:
    console, results = Console(), list[Path | Unwritten]()
    recorder = Recorder(open_bags(tmp_path, 'a{seq}.mcap', limits=limits), console, writers=1)
    recorder.put(batch(1, 10), results.append)
    recorder.put(batch(11, 10), results.append)
    recorder.close()
    assert [getattr(result, 'kind', '') for result in results] == [count, count]
    assert console.lines[0].startswith(line)


def test_messages_that_leave_the_queue(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    bags, may_write, results = open_bags(tmp_path), Event(), list[Path | Unwritten]()
    prepare = bags.prepare
    monkeypatch.setattr(bags, 'prepare', lambda item: may_write.wait() and prepare(item))
    recorder = Recorder(bags, Console(), queue_size=1, writers=1)
    recorder.put(batch(1, 1))
    wait_until(lambda: recorder.has_room, 'the first one in the writer')
    recorder.put(batch(2, 1), results.append)
    recorder.put(batch(3, 1), results.append)
    recorder.abandon()
    may_write.set()
    recorder.close()
    assert [getattr(result, 'kind', '') for result in results] == ['dropped', 'not processed']


def wait_for_results(results: list[Path | Unwritten], count: int) -> None:
    wait_until(lambda: len(results) >= count, f'{count} results', results=lambda: len(results))


def test_bag_of_messages_that_is_removed(tmp_path: Path) -> None:
    console = Console()
    recorder = Recorder(open_bags(tmp_path), console)
    written: list[Path | str] = []
    recorder.put(batch(1, 3), written.append)
    wait_until(lambda: written, 'the result')
    (tmp_path / 'drive.mcap').unlink()
    recorder.close()
    assert recorder.is_unfinished
    assert console.lines == ['error: 3 messages of topics are lost: drive.mcap was removed or '
                             'moved while it was written']
    assert recorder.counts.failed == 0


def test_batch_that_cannot_be_prepared(
        tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    bags, results = open_bags(tmp_path), list[Path | str]()
    monkeypatch.setattr(bags, 'prepare', None)
    recorder = Recorder(bags, Console())
    recorder.put(batch(1, 3), results.append)
    recorder.close()
    assert results == ["'NoneType' object is not callable"]
    assert recorder.is_unfinished
    assert recorder.counts.failed == 0
