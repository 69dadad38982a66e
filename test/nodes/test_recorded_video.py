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

"""The recorder of video topics as a process: packets in bags and videos as they were published."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
import re
import signal

from bag_readers import decode, read_by_all
from conftest import CLIP, CLIP_FRAMES, NodeProcess, read_manifest
import cv2
import mcap.reader
from numbered_video import (
    flat_packets, MS, number_of, numbers, read_packets, units, video_message, VideoSender)
import numpy as np
from opencv_tools.recording.video.writer import count_frames
from opencv_tools.video.encoder import VideoEncoder
from opencv_tools.video.messages import cdr_to_video, COMPRESSED_VIDEO, FFMPEG_PACKET, VIDEO_TOPICS
from opencv_tools.video.settings import VideoSettings
import pytest
from rclpy.node import Node
from rosbags.rosbag2.metadata import parse_qos

Start = Callable[..., NodeProcess]
COUNT = 20


@pytest.mark.parametrize('type_name', [FFMPEG_PACKET, COMPRESSED_VIDEO])
def test_bag_has_the_published_bytes(
        start: Start, node: Node, tmp_path: Path, type_name: str) -> None:
    sender = VideoSender(node, '/front/image', type_name)
    subscriber = start(
        'img_subscriber', '--ros-args', '-r', 'video_frames:=/front/image', transport='video',
        output_dir=tmp_path / 'out', file_name='a.mcap', max_frames=COUNT)
    sent = [video_message(type_name, packet, number)
            for number, packet in enumerate(flat_packets(COUNT))]
    sender.send(*sent)
    assert subscriber.finish() == 0, subscriber.output
    path, topic = tmp_path / 'out' / 'a.mcap', f'/front/image/{VIDEO_TOPICS[type_name]}'
    # The middleware adds zeros up to a multiple of four bytes.
    assert [(stored.topic, stored.data) for stored in read_by_all(path)] == [
        (topic, one + bytes(-len(one) % 4)) for one in sent]
    stamps = [getattr(one, 'timestamp', None) or one.header.stamp for one in decode(path)]
    assert [stamp.nanosec for stamp in stamps] == [number * 10**6 for number in range(COUNT)]
    with path.open('rb') as file:
        summary = mcap.reader.SeekingReader(file).get_summary()
        channel, = summary.channels.values()
    offer, = parse_qos(channel.metadata['offered_qos_profiles'])
    assert offer.reliability.name == 'RELIABLE'
    assert re.fullmatch('RIHS01_[0-9a-f]{64}', channel.metadata['topic_type_hash'])
    line, = read_manifest(tmp_path / 'out')
    assert (line['stored_encoding'], line['size'], line['frames']) == ('h264', [48, 32], COUNT)


@pytest.mark.quick_cases(1)
@pytest.mark.parametrize('suffix', ['.mkv', '.mp4'])
def test_killed_video_of_packets_plays(
        start: Start, node: Node, tmp_path: Path, suffix: str) -> None:
    sender = VideoSender(node, '/video_frames', FFMPEG_PACKET)
    killed = start('img_subscriber', output_dir=tmp_path / 'out', file_name=f'a{suffix}',
                   transport='video', on_overflow='block')
    path = tmp_path / 'out' / f'a{suffix}'
    sender.send(*(video_message(FFMPEG_PACKET, packet, number, 40 * MS)
                  for number, packet in enumerate(flat_packets(100))))
    killed.wait_until(lambda _: path.exists() and (count_frames(path) or 0) > 50)
    killed.interrupt(signal.SIGKILL)
    killed.finish()
    found = numbers(path)
    assert len(found) > 50 and found == [number % 50 for number in range(len(found))]
    following = start('img_subscriber', output_dir=tmp_path / 'out', file_name=f'b{suffix}')
    following.wait_for('Waiting for')
    following.interrupt()
    assert following.finish() == 0, following.output
    line, = read_manifest(tmp_path / 'out')
    assert (line['file'], line['frames'], line['stored_encoding']) == (
        f'a{suffix}', len(found), 'h264')


def test_account_of_packets(start: Start, node: Node, tmp_path: Path) -> None:
    sender = VideoSender(node, '/video_frames', COMPRESSED_VIDEO)
    subscriber = start('img_subscriber', output_dir=tmp_path / 'out', file_name='a.mkv',
                       transport='video', max_frames=10)
    sender.send(*(video_message(COMPRESSED_VIDEO, packet, number)
                  for number, packet in enumerate(flat_packets(20, keys=(9,)))
                  if number > 5))
    assert subscriber.finish() == 0, subscriber.output
    assert ' 10 written to' in subscriber.output
    assert ' 3 left out before a key frame' in subscriber.output
    assert numbers(tmp_path / 'out' / 'a.mkv') == [*range(9, 19)]


@pytest.mark.thorough
def test_publisher_and_recorder_of_the_same_video(start: Start, tmp_path: Path) -> None:
    recorders = [start(
        'img_subscriber', output_dir=tmp_path / suffix, file_name=f'a.{suffix}',
        transport='video', on_overflow='block') for suffix in ('mcap', 'mkv')]
    publisher = start('img_publisher', source=CLIP, publish_rate=0, wait_for_subscribers=2)
    assert publisher.finish() == 0, publisher.output
    for recorder in recorders:
        recorder.wait_for('Receiving video frame')
        recorder.interrupt()
        assert recorder.finish() == 0, recorder.output
    messages = [cdr_to_video(FFMPEG_PACKET, stored.data)
                for stored in read_by_all(tmp_path / 'mcap' / 'a.mcap')
                if stored.topic == '/video_frames/ffmpeg']
    assert [content for *_, content in read_packets(tmp_path / 'mkv' / 'a.mkv')] == [
        units('h264', bytes(message.data)) for message in messages]
    assert len(messages) == CLIP_FRAMES


def test_selected_frames_of_a_bag_are_images(start: Start, node: Node, tmp_path: Path) -> None:
    sender = VideoSender(node, '/front/image', FFMPEG_PACKET)
    subscriber = start(
        'img_subscriber', '--ros-args', '-r', 'video_frames:=/front/image', transport='video',
        output_dir=tmp_path / 'out', file_name='a.mcap', max_frames=5, every_n=2)
    sender.send(*(video_message(FFMPEG_PACKET, packet, number)
                  for number, packet in enumerate(flat_packets(10))))
    assert subscriber.finish() == 0, subscriber.output
    path = tmp_path / 'out' / 'a.mcap'
    assert {stored.topic for stored in read_by_all(path)} == {'/front/image'}
    found = decode(path)
    assert [round(sum(one.data) / len(one.data) / 5) for one in found] == [0, 2, 4, 6, 8]


@pytest.mark.quick_cases(1)
@pytest.mark.parametrize('type_name', [FFMPEG_PACKET, COMPRESSED_VIDEO])
def test_recorded_bag_of_video_is_played(
        start: Start, node: Node, tmp_path: Path, type_name: str) -> None:
    sender = VideoSender(node, '/front/image', type_name)
    recorder = start(
        'img_subscriber', '--ros-args', '-r', 'video_frames:=/front/image', transport='video',
        output_dir=tmp_path / 'out', file_name='a.mcap', max_frames=COUNT)
    sender.send(*(video_message(type_name, packet, number)
                  for number, packet in enumerate(flat_packets(COUNT))))
    assert recorder.finish() == 0, recorder.output
    player_arguments = {'source': tmp_path / 'out' / 'a.mcap', 'publish_rate': 0,
                        'stamp': 'original', 'start_frame': 5, 'wait_for_subscribers': 1}
    second = start('img_subscriber', output_dir=tmp_path / 'pictures', transport='raw',
                   max_frames=COUNT - 5, on_overflow='block')
    player = start('img_publisher', **player_arguments)
    assert player.finish() == 0, player.output
    assert second.finish() == 0, second.output
    lines = read_manifest(tmp_path / 'pictures')
    assert [line['stamp']['nanosec'] for line in lines] == [
        number * MS for number in range(5, COUNT)]
    assert [number_of(cv2.imread(str(tmp_path / 'pictures' / line['file'])))
            for line in lines] == [*range(5, COUNT)]


@pytest.mark.parametrize('rate', [5, 20, 120, 43])
def test_each_further_video_of_a_promised_bit_rate_is_said(
        start: Start, tmp_path: Path, rate: int) -> None:
    recorder = start('img_subscriber', transport='video', output_dir=tmp_path / 'out',
                     file_name='a_{seq}.mkv', max_frames=max(40, 3 * rate))
    publisher = start('img_publisher', source=f'pattern:160x120@{rate}',
                      publish_rate=0.0, video_bit_rate=200_000, wait_for_subscribers=1)
    assert recorder.finish() == 0, recorder.output
    publisher.interrupt()
    publisher.finish()
    lines = read_manifest(tmp_path / 'out')
    assert sum(line['frames'] for line in lines) == max(40, 3 * rate)
    # There is one video, unless the machine is too busy for the rate.
    assert recorder.output.count('another video') == min(3, len(lines) - 1), recorder.output


def test_another_encoder_is_the_reason_of_another_video(
        start: Start, node: Node, tmp_path: Path) -> None:
    sender = VideoSender(node, '/video_frames', FFMPEG_PACKET)
    recorder = start('img_subscriber', transport='video', output_dir=tmp_path / 'out',
                     file_name='a.mkv', max_frames=2 * COUNT)
    packets = []
    for preset in ('superfast', 'ultrafast'):
        encoder = VideoEncoder(VideoSettings(preset=preset), 48, 32, 30.0)
        packets += [encoder.encode(np.full((32, 48), number, np.uint8), 'mono8', number * MS)
                    for number in range(COUNT)]
    sender.send(*(video_message(FFMPEG_PACKET, packet, number, 40 * MS)
                  for number, packet in enumerate(packets)))
    assert recorder.finish() == 0, recorder.output
    assert [line['frames'] for line in read_manifest(tmp_path / 'out')] == [COUNT, COUNT]
    assert recorder.output.count('another video, a_1.mkv, begins: the publisher of the video has '
                                 'opened its encoder anew') == 1, recorder.output
