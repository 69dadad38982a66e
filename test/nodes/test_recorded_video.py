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

from bag_readers import decode, read_by_all
from conftest import NodeProcess, read_manifest
import mcap.reader
from opencv_tools.video.messages import COMPRESSED_VIDEO, FFMPEG_PACKET, VIDEO_TOPICS
import pytest
from rclpy.node import Node
from rosbags.rosbag2.metadata import parse_qos
from video_packets import flat_packets, video_message, VideoSender

Start = Callable[..., NodeProcess]
COUNT = 20


@pytest.mark.parametrize('type_name', [FFMPEG_PACKET, COMPRESSED_VIDEO])
def test_bag_has_the_published_bytes(
        start: Start, node: Node, tmp_path: Path, type_name: str) -> None:
    sender = VideoSender(node, '/front/image', type_name)
    subscriber = start(
        'img_subscriber', '--ros-args', '-r', 'video_frames:=/front/image', transport='video',
        output_dir=tmp_path / 'out', file_name='a.mcap', max_frames=COUNT, timeout=60)
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


def test_selected_frames_of_a_bag_are_images(start: Start, node: Node, tmp_path: Path) -> None:
    sender = VideoSender(node, '/front/image', FFMPEG_PACKET)
    subscriber = start(
        'img_subscriber', '--ros-args', '-r', 'video_frames:=/front/image', transport='video',
        output_dir=tmp_path / 'out', file_name='a.mcap', max_frames=5, every_n=2, timeout=60)
    sender.send(*(video_message(FFMPEG_PACKET, packet, number)
                  for number, packet in enumerate(flat_packets(10))))
    assert subscriber.finish() == 0, subscriber.output
    assert {stored.topic for stored in read_by_all(tmp_path / 'out' / 'a.mcap')} == {'/front/image'}
    found = decode(tmp_path / 'out' / 'a.mcap')
    assert [round(sum(one.data) / len(one.data) / 5) for one in found] == [0, 2, 4, 6, 8]
