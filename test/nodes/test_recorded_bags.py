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

"""The recorder of bags as a process: topics, camera_info, requests, rings and kills."""

from __future__ import annotations

from collections.abc import Callable
import itertools
import os
from pathlib import Path
import re
import signal
import time

from bag_readers import decode, read_by_all, Stored
from conftest import (
    call_service, CLIP, CLIP_FRAMES, decode_clip, NodeProcess, read_manifest, recorded_files,
    spin_until)
from mcap.reader import SeekingReader
import numpy as np
from opencv_tools.image.cdr import (
    cdr_to_compressed_image, cdr_to_image, compressed_image_to_cdr, image_to_cdr,
)
from opencv_tools.image.encodings import ENCODINGS
import pytest
from rclpy.duration import Duration
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.serialization import deserialize_message, serialize_message
from rosbags.rosbag2.metadata import parse_qos
from sending import create_publisher, send, stamped
from sensor_msgs.msg import CameraInfo, CompressedImage, Image
from sharing import Camera
from std_srvs.srv import Trigger
from waiting import wait_until

Start = Callable[..., NodeProcess]
BAG = 'drive.mcap'


def topic_messages(path: Path, topic: str) -> list[Stored]:
    return [stored for stored in read_by_all(path) if stored.topic == topic]


def message(number: int, encoding: str = 'mono8', size: int = 4) -> Image:
    return stamped(np.full((size, size), number, np.uint8), encoding, number)


def zero_padded(one: Image | CompressedImage) -> bytes:
    """Return the CDR of a message; rclpy leaves its padding undefined."""
    serialized = serialize_message(one)
    if isinstance(one, Image):
        return image_to_cdr(cdr_to_image(serialized))
    return compressed_image_to_cdr(cdr_to_compressed_image(serialized))


@pytest.fixture
def publisher(node: Node) -> Publisher:
    return create_publisher(node)


@pytest.mark.thorough
def test_clip_pixel_for_pixel(start: Start, tmp_path: Path) -> None:
    subscriber = start('img_subscriber', output_dir=tmp_path / 'out', file_name=BAG,
                       max_frames=CLIP_FRAMES, on_overflow='block')
    publisher = start('img_publisher', source=CLIP, publish_rate=0, wait_for_subscribers=1)
    assert publisher.finish() == 0, publisher.output
    assert subscriber.finish() == 0, subscriber.output
    assert '90 written to' in subscriber.output
    path = tmp_path / 'out' / BAG
    frames = [found for found in decode(path) if hasattr(found, 'encoding')]
    for found, expected in zip(frames, decode_clip(), strict=True):
        assert np.array_equal(np.frombuffer(found.data, np.uint8), expected.reshape(-1))
        assert (found.encoding, found.header.frame_id) == ('bgr8', 'camera')
    with path.open('rb') as file:
        reader = SeekingReader(file)
        messages = [one for *_, one in reader.iter_messages(topics=['/video_frames'])]
        metadata = {channel.topic: channel.metadata
                    for channel in reader.get_summary().channels.values()}
    assert [one.sequence for one in messages] == [*range(1, 91)]
    assert all(0 < one.publish_time <= one.log_time for one in messages)
    offer, = parse_qos(metadata['/video_frames']['offered_qos_profiles'])
    assert (offer.reliability.name, offer.durability.name) == ('RELIABLE', 'VOLATILE')
    assert re.fullmatch('RIHS01_[0-9a-f]{64}', metadata['/video_frames']['topic_type_hash'])
    line, = read_manifest(tmp_path / 'out')
    assert (line['file'], line['frames'], line['size']) == (BAG, 90, [1280, 720])


def test_every_encoding_and_broken_images(
        start: Start, node: Node, publisher: Publisher, tmp_path: Path) -> None:
    sent = [message(number, 'mono8') for number in range(len(ENCODINGS) + 3)]
    for image, encoding in zip(sent, (*ENCODINGS, 'my_own', '', 'mono8')):
        image.encoding = encoding
    sent[-1].height = 2**32 - 1
    subscriber = start('img_subscriber', output_dir=tmp_path / 'out', file_name=BAG,
                       max_frames=len(sent))
    send(node, publisher, *sent)
    assert subscriber.finish() == 0, subscriber.output
    found = topic_messages(tmp_path / 'out' / BAG, '/video_frames')
    assert [deserialize_message(stored.data, Image) for stored in found] == sent
    assert [stored.data for stored in found] == list(map(zero_padded, sent))


def test_compressed_topic(start: Start, node: Node, tmp_path: Path) -> None:
    publisher = node.create_publisher(CompressedImage, '/front/image/compressed', 10)
    sent = [CompressedImage(format='h264', data=bytes(number)) for number in range(5)]
    subscriber = start(
        'img_subscriber', '--ros-args', '-r', 'video_frames:=/front/image',
        output_dir=tmp_path / 'out', file_name=BAG, max_frames=5)
    send(node, publisher, *sent)
    assert subscriber.finish() == 0, subscriber.output
    found = topic_messages(tmp_path / 'out' / BAG, '/front/image/compressed')
    assert [stored.data for stored in found] == list(map(zero_padded, sent))


def record_camera_info(
        start: Start, node: Node, path: Path,
        reliability: ReliabilityPolicy) -> tuple[list[CameraInfo], list[CameraInfo]]:
    """
    Record camera_info beside images; return what was sent and what the bag has.

    Assert that reliable messages are received before the recorder ends (a publisher that is not
    reliable waits for none), and that the recorder ends without an error.
    """
    qos = QoSProfile(depth=1000, reliability=reliability)
    images = node.create_publisher(Image, '/front/video_frames', 1000)
    infos = node.create_publisher(CameraInfo, '/front/camera_info', qos)
    sent: list[CameraInfo] = []
    numbers = itertools.count()

    def publish() -> None:
        images.publish(message(next(numbers) % 200))
        if infos.get_subscription_count():
            sent.append(CameraInfo(width=len(sent), d=[0.5]))
            infos.publish(sent[-1])

    subscriber = start('img_subscriber', '--ros-args', '-r', 'video_frames:=/front/video_frames',
                       output_dir=path.parent, file_name=BAG)
    timer = node.create_timer(0.02, publish)
    spin_until(node, lambda: len(sent) >= 5 and path.exists()
               and b'/front/camera_info' in path.read_bytes())
    node.destroy_timer(timer)
    wait_until(lambda: infos.wait_for_all_acked(Duration()))
    subscriber.interrupt()
    assert subscriber.finish() == 0, subscriber.output
    return sent, [deserialize_message(stored.data, CameraInfo)
                  for stored in topic_messages(path, '/front/camera_info')]


def test_reliable_camera_info(start: Start, node: Node, tmp_path: Path) -> None:
    sent, found = record_camera_info(
        start, node, tmp_path / 'out' / BAG, ReliabilityPolicy.RELIABLE)
    assert found == sent != []


def test_best_effort_camera_info(start: Start, node: Node, tmp_path: Path) -> None:
    sent, found = record_camera_info(
        start, node, tmp_path / 'out' / BAG, ReliabilityPolicy.BEST_EFFORT)
    assert found and all(info in sent for info in found)


def test_huge_camera_info_is_refused(
        start: Start, node: Node, publisher: Publisher, tmp_path: Path) -> None:
    infos = node.create_publisher(CameraInfo, 'camera_info', 10)
    subscriber = start('img_subscriber', output_dir=tmp_path / 'out', file_name=BAG)
    send(node, publisher, message(1))
    subscriber.wait_for('Receiving video frame')
    send(node, infos, CameraInfo(d=[0.0] * 10_000))
    subscriber.wait_for('on /camera_info was not recorded: a camera_info has at most 65536')
    subscriber.interrupt()
    assert subscriber.finish() == 0, subscriber.output
    assert len(read_by_all(tmp_path / 'out' / BAG)) == 1


@pytest.mark.thorough
def test_publish_time_and_number_of_each_transport(
        start: Start, camera: Node, tmp_path: Path) -> None:
    ours = Camera(camera)
    sent: list[tuple[int, int]] = []
    recorders = [start('img_subscriber', output_dir=tmp_path / transport, file_name=BAG,
                       transport=transport) for transport in ('raw', 'shm')]

    def send_until(condition: Callable[[], bool]) -> None:
        def step() -> bool:
            before = time.time_ns()
            ours.send()
            sent.append((before, time.time_ns()))
            return condition()

        spin_until(camera, step)

    spin_until(camera, lambda: ours.subscribers > 0)
    send_until(lambda: all('Receiving video frame' in one.output for one in recorders))
    until = len(sent) + 20
    send_until(lambda: len(sent) > until)
    for recorder in recorders:
        recorder.interrupt()
    numbers = []
    for recorder, transport in zip(recorders, ('raw', 'shm')):
        assert recorder.finish() == 0, recorder.output
        with (tmp_path / transport / BAG).open('rb') as file:
            messages = [one for *_, one in SeekingReader(file).iter_messages(
                log_time_order=False)]
        stamps = [found.header.stamp.sec for found in decode(tmp_path / transport / BAG)]
        for stamp, one in zip(stamps, messages, strict=True):
            before, after = sent[stamp - 1]
            assert before <= one.publish_time <= min(after, one.log_time), transport
        numbers.append({stamp: one.sequence for stamp, one in zip(stamps, messages)})
    common = numbers[0].keys() & numbers[1].keys()
    assert len(common) > 5
    assert {stamp: numbers[0][stamp] for stamp in common} == {
        stamp: numbers[1][stamp] for stamp in common}


def test_frame_saved_on_request(
        start: Start, node: Node, publisher: Publisher, tmp_path: Path) -> None:
    recorder = start('img_subscriber', output_dir=tmp_path / 'out', file_name=BAG,
                     mode='on_request')
    numbers = itertools.count()
    timer = node.create_timer(0.02, lambda: publisher.publish(message(next(numbers) % 200)))
    for count in (1, 2, 3):
        answer = call_service(node, Trigger, 'image_subscriber/save', Trigger.Request())
        assert (answer.success, answer.message) == (True, str(tmp_path / 'out' / BAG))
        content = (tmp_path / 'out' / BAG).read_bytes()
        assert content.count(b'mono8') >= count
    node.destroy_timer(timer)
    recorder.interrupt()
    assert recorder.finish() == 0, recorder.output
    frames = read_by_all(tmp_path / 'out' / BAG)
    assert f' {len(frames)} written' in recorder.output and len(frames) >= 3


def test_ring_of_bags(start: Start, node: Node, publisher: Publisher, tmp_path: Path) -> None:
    recorder = start('img_subscriber', output_dir=tmp_path / 'out', file_name='d{seq:03d}.mcap',
                     ring=True, max_frames=20, on_overflow='block')
    send(node, publisher, *(message(number) for number in range(100)))
    recorder.wait_until(lambda _: (tmp_path / 'out' / 'd049.mcap').exists())
    recorder.interrupt()
    assert recorder.finish() == 0, recorder.output
    numbers = [found.header.stamp.nanosec for path in recorded_files(tmp_path / 'out')
               for found in decode(path)]
    assert numbers == [*range(numbers[0], 100)] and 18 <= len(numbers) <= 20
    assert '100 written to' in recorder.output
    assert len(read_manifest(tmp_path / 'out')) == 10


def test_killed_node_leaves_a_bag_that_the_next_one_finishes(
        start: Start, node: Node, publisher: Publisher, tmp_path: Path) -> None:
    killed = start('img_subscriber', output_dir=tmp_path / 'out', file_name=BAG)
    sent = [message(number) for number in range(20)]
    send(node, publisher, *sent)
    last = zero_padded(sent[-1])
    path = tmp_path / 'out' / BAG
    killed.wait_until(lambda _: path.exists() and last in path.read_bytes())
    killed.interrupt(signal.SIGKILL)
    killed.finish()
    following = start('img_subscriber', output_dir=tmp_path / 'out', max_frames=1)
    # The publisher does not know yet that the killed subscription is gone.
    timer = node.create_timer(0.05, lambda: publisher.publish(message(77)))
    spin_until(node, lambda: not following.is_running())
    node.destroy_timer(timer)
    assert following.finish() == 0, following.output
    assert [stored.data for stored in read_by_all(path)] == list(map(zero_padded, sent))
    assert [(line['file'], line['frames']) for line in read_manifest(tmp_path / 'out')] == [
        (BAG, 20), ('000000.png', 1)]


def test_missing_library(
        start: Start, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / 'empty' / 'mcap').mkdir(parents=True)
    (tmp_path / 'empty' / 'mcap' / '__init__.py').write_text('raise ImportError("none here")')
    monkeypatch.setenv('PYTHONPATH', str(tmp_path / 'empty'), prepend=os.pathsep)
    subscriber = start('img_subscriber', output_dir=tmp_path / 'out', file_name=BAG)
    assert subscriber.finish() == 2, subscriber.output
    assert re.search(r'bags need the library mcap, which cannot be imported \(none here\); '
                     "install it with 'pip install mcap'", subscriber.output)
    assert not (tmp_path / 'out').exists()
