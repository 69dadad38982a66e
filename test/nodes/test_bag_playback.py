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

"""Bags that are played by the executable, and recorded again."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
import re
import signal
import struct
import subprocess
from typing import Any

from calibrations import CALIBRATION
from conftest import (
    CLIP, CLIP_FRAMES, decode_clip, executable, NodeProcess, read_manifest, spin_until)
import cv2
from images import random_image
from mcap.reader import make_reader
import numpy as np
from opencv_tools.bags.schemas import CAMERA_INFO
from opencv_tools.image.encodings import ENCODINGS
from played_bags import (
    BEGAN_NS, compressed_entry, Entry, header, image_entry, TOPIC, write_mcap, write_rosbag2)
import pytest
from rclpy.node import Node
from rclpy.serialization import deserialize_message, serialize_message
from rclpy.time import Time
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import CameraInfo, CompressedImage, Image
from waiting import communicate

Start = Callable[..., NodeProcess]
JPEG_BYTES = cv2.imencode('.jpg', random_image('bgr8', 16, 24))[1].tobytes()


class Played:
    """The messages of topics that a publisher of a bag sends to this process."""

    def __init__(self, start: Start, node: Node, *kinds: type, **parameters: Any) -> None:
        topics = {Image: 'video_frames', CompressedImage: 'video_frames/compressed',
                  CameraInfo: 'camera_info', Clock: '/clock'}
        self._raw: dict[type, list[bytes]] = {kind: [] for kind in kinds}
        images = {Image, CompressedImage} & {*kinds}
        self.publisher = start('img_publisher', **{
            'wait_for_subscribers': len(images), 'encoding': "''", 'publish_rate': 0,
            **parameters})
        subscriptions = []
        # The publisher waits for the subscribers of images, which therefore come last.
        for kind in sorted(kinds, key=images.__contains__):
            spin_until(node, lambda: all(
                subscription.get_publisher_count() for subscription in subscriptions))
            subscriptions.append(node.create_subscription(
                kind, topics[kind], self._raw[kind].append, 1000, raw=True))
        spin_until(node, self._is_over)
        assert self.publisher.finish() == 0, self.publisher.output
        for subscription in subscriptions:
            node.destroy_subscription(subscription)

    def _is_over(self) -> bool:
        ended = re.search(r'Published (\d+) frames', self.publisher.output)
        return ended is not None and all(
            len(received) >= int(ended[1]) for received in self._raw.values())

    def messages(self, kind: type) -> list[Any]:
        return [deserialize_message(raw, kind) for raw in self._raw[kind]]


def stamps(messages: list[Any]) -> list[int]:
    return [Time.from_msg(message.header.stamp).nanoseconds for message in messages]


@pytest.mark.thorough
def test_clip_goes_through_topic_bag_topic_and_files(
        start: Start, node: Node, tmp_path: Path) -> None:
    recorder = start('img_subscriber', output_dir='bags', file_name='clip.mcap',
                     max_frames=CLIP_FRAMES, on_overflow='block')
    first = Played(start, node, Image, source=CLIP, encoding='bgr8', publish_rate=50,
                   wait_for_subscribers=2, frame_id='eye').messages(Image)
    assert recorder.finish() == 0, recorder.output
    writer = start('img_subscriber', output_dir='out', file_name='"{stamp}.png"',
                   max_frames=CLIP_FRAMES, on_overflow='block')
    second = Played(start, node, Image, source='bags/clip.mcap', stamp='original',
                    publish_rate=50, wait_for_subscribers=2).messages(Image)
    assert writer.finish() == 0, writer.output
    assert len(first) == CLIP_FRAMES
    for sent, played, expected in zip(first, second, decode_clip(), strict=True):
        assert sent == played
        assert played.data.tobytes() == expected.tobytes()
    assert {message.header.frame_id for message in second} == {'eye'}
    lines = read_manifest(tmp_path / 'out')
    assert [line['stamp']['sec'] * 10**9 + line['stamp']['nanosec'] for line in lines] == (
        stamps(first))
    for line, expected in zip(lines, decode_clip(), strict=True):
        np.testing.assert_array_equal(
            cv2.imread(str(tmp_path / 'out' / line['file'])), expected)


@pytest.mark.thorough
@pytest.mark.parametrize('suffix', ['.mcap', '.db3'])
def test_bag_of_rosbags_in_every_encoding(
        start: Start, node: Node, tmp_path: Path, suffix: str) -> None:
    names = [*ENCODINGS, '32FC1', '16SC1', '64FC3']
    entries = [image_entry(number, random_image(name, 4, 6), name)
               for number, name in enumerate(names)]
    write_rosbag2(tmp_path / 'bag', suffix, entries)
    played = Played(start, node, Image, source='bag', stamp='original').messages(Image)
    assert played == [deserialize_message(entry.data, Image) for entry in entries]


@pytest.mark.parametrize('chunk_size', [100, 300, 1000])
def test_frames_of_a_damaged_chunk_are_dropped(
        start: Start, node: Node, tmp_path: Path, chunk_size: int) -> None:
    entries = [*map(image_entry, range(20))]
    path = write_mcap(tmp_path / 'a.mcap', entries, chunk_size=chunk_size)
    with path.open('rb') as file:
        summary = make_reader(file).get_summary()
    assert summary
    chunk = summary.chunk_indexes[1]
    content = bytearray(path.read_bytes())
    content[chunk.chunk_start_offset + chunk.chunk_length // 2] ^= 255
    path.write_bytes(content)
    lost = sum(chunk.message_start_time <= entry.log_ns <= chunk.message_end_time
               for entry in entries)
    played = Played(start, node, Image, source='a.mcap')
    assert f' Hz, {lost} dropped' in played.publisher.output
    assert len(played.messages(Image)) == 20 - lost


def test_stamps_of_captures_keep_the_gaps_of_the_bag(
        start: Start, node: Node, tmp_path: Path) -> None:
    numbers = (0, 1, 5, 6)
    write_mcap(tmp_path / 'a.mcap', map(image_entry, numbers))
    before = node.get_clock().now().nanoseconds
    played = Played(start, node, Image, source='a.mcap', loop=2).messages(Image)
    after = node.get_clock().now().nanoseconds
    assert [message.data[0] for message in played] == [*numbers, *numbers]
    found = stamps(played)
    for part in (found[:4], found[4:]):
        assert [stamp - part[0] for stamp in part] == [number * 40_000_000 for number in numbers]
    assert before < found[0] < after and found[3] < found[4]
    assert {message.header.frame_id for message in played} == {'camera'}


def test_stamps_of_publications_are_those_of_the_clock(
        start: Start, node: Node, tmp_path: Path) -> None:
    far = image_entry(2)._replace(log_ns=BEGAN_NS + 10**18)
    write_mcap(tmp_path / 'a.mcap', [image_entry(1), far])
    before = node.get_clock().now().nanoseconds
    played = Played(start, node, Image, source='a.mcap', stamp='publish', publish_rate=100,
                    frame_id='eye').messages(Image)
    after = node.get_clock().now().nanoseconds
    assert [before, *stamps(played), after] == sorted([before, *stamps(played), after])
    assert {message.header.frame_id for message in played} == {'eye'}


def test_compressed_images_pass_byte_for_byte(
        start: Start, node: Node, tmp_path: Path) -> None:
    png = cv2.imencode('.png', random_image('16UC1', 8, 12))[1].tobytes()
    entries = [compressed_entry(0, JPEG_BYTES), compressed_entry(1, b'\xff\xd8 no picture'),
               compressed_entry(2, png, '16UC1; png compressed '),
               compressed_entry(3, b'the future', 'av2')]
    write_mcap(tmp_path / 'a.mcap', entries)
    played = Played(start, node, CompressedImage, source='a.mcap', stamp='original',
                    encoding='bgr8').messages(CompressedImage)
    assert played == [deserialize_message(entry.data, CompressedImage) for entry in entries]


def test_compressed_images_are_decoded_for_subscribers_of_raw_images(
        start: Start, node: Node, tmp_path: Path) -> None:
    write_mcap(tmp_path / 'a.mcap', [compressed_entry(number, JPEG_BYTES) for number in range(3)])
    played = Played(start, node, Image, CompressedImage, source='a.mcap', stamp='original')
    for raw, compressed in zip(
            played.messages(Image), played.messages(CompressedImage), strict=True):
        assert raw.header == compressed.header
        assert raw.data.tobytes() == cv2.imdecode(
            np.frombuffer(JPEG_BYTES, np.uint8), cv2.IMREAD_UNCHANGED).tobytes()


def info_entry(number: int) -> Entry:
    """Return a calibration of its own for a numbered image, recorded after the image."""
    info = CameraInfo(width=6, height=4, distortion_model='plumb_bob', d=[0.1] * 5,
                      k=[float(100 + number), 0.0, 3.0, 0.0, 90.0, 2.0, 0.0, 0.0, 1.0])
    stamp = header(number)
    info.header.stamp.sec, info.header.stamp.nanosec = stamp.sec, stamp.nanosec
    info.header.frame_id = stamp.frame_id
    return Entry(image_entry(number).log_ns + 2_000_000, serialize_message(info),
                 '/camera/camera_info', CAMERA_INFO)


@pytest.mark.quick_cases(1)
@pytest.mark.parametrize('stamp', ['original', 'capture'])
def test_calibration_of_the_bag_is_published_with_its_image(
        start: Start, node: Node, tmp_path: Path, stamp: str) -> None:
    (tmp_path / 'eye.yaml').write_text(CALIBRATION)
    entries = [entry for number in range(4) for entry in (image_entry(number), info_entry(number))]
    write_mcap(tmp_path / 'a.mcap', entries)
    played = Played(start, node, Image, CameraInfo, source='a.mcap', stamp=stamp,
                    camera_info_url=f'file://{tmp_path}/eye.yaml')
    for number, (image, info) in enumerate(zip(
            played.messages(Image), played.messages(CameraInfo), strict=True)):
        expected = deserialize_message(info_entry(number).data, CameraInfo)
        assert info.header == image.header
        if stamp == 'capture':
            expected.header = image.header
        assert info == expected


def test_calibration_turns_with_the_images(start: Start, node: Node, tmp_path: Path) -> None:
    write_mcap(tmp_path / 'a.mcap', [image_entry(1), info_entry(1)])
    info, = Played(start, node, Image, CameraInfo, source='a.mcap', rotate=90).messages(CameraInfo)
    assert (info.width, info.height, info.k[0], info.k[4]) == (4, 6, 90.0, 101.0)


def test_damaged_calibration_is_replaced_by_that_of_the_camera(
        start: Start, node: Node, tmp_path: Path) -> None:
    damaged = [info_entry(number)._replace(data=info_entry(number).data[:60])
               for number in range(3)]
    write_mcap(tmp_path / 'a.mcap', [*map(image_entry, range(3)), *damaged])
    played = Played(start, node, Image, CameraInfo, source='a.mcap')
    infos = played.messages(CameraInfo)
    assert [(info.width, info.height, info.k[0]) for info in infos] == [(6, 4, 0.0)] * 3
    assert played.publisher.output.count('the camera_info of the bag is not used') == 1


@pytest.mark.quick_cases(1)
@pytest.mark.parametrize('stamp', ['original', 'publish'])
def test_clock_has_the_time_of_each_frame(
        start: Start, node: Node, tmp_path: Path, stamp: str) -> None:
    write_mcap(tmp_path / 'a.mcap', map(image_entry, range(4)))
    played = Played(start, node, Image, Clock, source='a.mcap', stamp=stamp, clock='true')
    times = [Time.from_msg(message.clock).nanoseconds for message in played.messages(Clock)]
    assert times == ([image_entry(number).log_ns for number in range(4)]
                     if stamp == 'original' else stamps(played.messages(Image)))


def test_no_clock_without_a_request(start: Start, node: Node, tmp_path: Path) -> None:
    write_mcap(tmp_path / 'a.mcap', [image_entry(1)])
    publisher = start('img_publisher', source='a.mcap', on_end='hold')
    publisher.wait_for('Publishing video frame')
    assert node.count_publishers('/clock') == 0


def test_cut_bag_is_played_with_one_warning(start: Start, node: Node, tmp_path: Path) -> None:
    path = write_mcap(tmp_path / 'a.mcap', map(image_entry, range(6)), use_chunking=False)
    content = path.read_bytes()
    path.write_bytes(content[:content.index(bytes([4]) * 24)])
    played = Played(start, node, Image, source='a.mcap', loop=3)
    assert [message.data[0] for message in played.messages(Image)] == [0, 1, 2, 3] * 3
    assert played.publisher.output.count('a.mcap has no end') == 1


def write_long_bag(path: Path) -> Path:
    """Write a bag of millions of empty messages without an index."""
    write_mcap(path, [image_entry(1)], use_chunking=False)
    content = path.read_bytes()
    empty = struct.pack('<BQ', 5, 22) + bytes(22)
    with path.open('wb') as file:
        file.write(content[:content.index(b'\x0f' + struct.pack('<Q', 4))])
        for _ in range(40):
            file.write(empty * 100_000)
    return path


@pytest.mark.quick_cases(1)
@pytest.mark.parametrize('number', [signal.SIGINT, signal.SIGTERM])
def test_interrupt_while_a_bag_is_read(start: Start, tmp_path: Path, number: int) -> None:
    write_long_bag(tmp_path / 'long.mcap')
    publisher = start('img_publisher', source='long.mcap')
    publisher.wait_for('Reading long.mcap from its begin to its end')
    publisher.interrupt(number)
    assert publisher.finish() == 0, publisher.output
    assert 'opened' not in publisher.output


@pytest.mark.thorough
@pytest.mark.process
def test_interrupt_while_a_bag_is_read_for_a_conversion(tmp_path: Path) -> None:
    path = write_long_bag(tmp_path / 'long.mcap')
    with subprocess.Popen([executable('img_convert'), path, tmp_path / '{seq}.png'],
                          stderr=subprocess.PIPE, text=True) as process:
        assert process.stderr is not None
        assert 'from its begin to its end' in process.stderr.readline()
        process.send_signal(signal.SIGINT)
        _, errors = communicate(process)
    assert process.returncode == 1
    assert errors == 'img_convert: error: interrupted before the first frame\n'


def test_remedy_for_frames_that_have_no_colours(
        start: Start, node: Node, tmp_path: Path) -> None:
    write_mcap(tmp_path / 'a.mcap', [image_entry(1, np.zeros((4, 6), np.uint16), '16UC1')])
    node.create_subscription(Image, 'video_frames', print, 10)
    publisher = start('img_publisher', source='a.mcap', wait_for_subscribers=1)
    assert publisher.finish() == 1
    assert 'does not make sense; an empty encoding publishes frames as they are' in (
        publisher.output)


@pytest.mark.quick_cases(3)
@pytest.mark.parametrize(('parameters', 'status', 'reason'), [
    ({'source': 'two.mcap'}, 1, 'two.mcap has 2 topics of images; set bag_topic, or --topic of '
     'the command, to one of /camera/image_raw (sensor_msgs/msg/Image, 1 messages), /depth'),
    ({'source': 'two.mcap', 'bag_topic': '/none'}, 1, 'has no topic /none of images'),
    ({'source': 'none.mcap'}, 1, 'none.mcap cannot be opened: No such file'),
    ({'source': 'text.mcap'}, 1, 'text.mcap is not an MCAP file'),
    ({'source': 'broken.mcap'}, 1, 'broken.mcap has no readable frame'),
    ({'source': 'pattern', 'bag_topic': '/a'}, 2, "parameter bag_topic is '/a', but the source "
     'pattern is not a bag'),
    ({'source': 'pattern', 'stamp': 'original'}, 2, "parameter stamp is 'original', but"),
    ({'source': 'pattern', 'clock': 'true'}, 2, 'parameter clock is True, but')])
def test_errors_are_one_sentence(
        start: Start, tmp_path: Path, parameters: dict[str, str], status: int,
        reason: str) -> None:
    write_mcap(tmp_path / 'two.mcap', [image_entry(1), image_entry(2, topic='/depth')])
    write_mcap(tmp_path / 'broken.mcap', [Entry(BEGAN_NS, b'', TOPIC)])
    (tmp_path / 'text.mcap').write_text('no bag')
    publisher = start('img_publisher', **parameters)
    assert publisher.finish() == status
    assert publisher.output.count('[ERROR]') == 1 and reason in publisher.output
