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

"""Image topics, and the explanation when no frames arrive."""

from __future__ import annotations

from pathlib import Path

from conftest import spin_until
from opencv_tools.topics.topic_discovery import TopicDiscovery
from opencv_tools.transport.fastdds import shared_memory
from opencv_tools.transport.message_type import message_type
from opencv_tools.video.messages import COMPRESSED_VIDEO, FFMPEG_PACKET
import pytest
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import CompressedImage, Image
from std_msgs.msg import String

TOPIC = '/video_frames'
RELIABLE = QoSProfile(depth=10)
BEST_EFFORT = QoSProfile(depth=10, reliability=ReliabilityPolicy.BEST_EFFORT)


@pytest.fixture(autouse=True)
def _no_other_user(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Hide the nodes of other users of this machine."""
    monkeypatch.setattr(shared_memory, 'SHARED_MEMORY', tmp_path)


@pytest.mark.parametrize(('transport', 'published', 'sentence'), [
    ('raw', {TOPIC: String},
     '/video_frames has a publisher of type std_msgs/msg/String (node /front/camera), '
     'not sensor_msgs/msg/Image; no images are published in ROS_DOMAIN_ID'),
    ('auto', {TOPIC: String, '/b': Image, '/a': CompressedImage},
     'not sensor_msgs/msg/Image; images are published on /a, /b in ROS_DOMAIN_ID {domain}; '
     'receive one with -r video_frames:=/a'),
    ('raw', {TOPIC: CompressedImage},
     '/video_frames has a publisher of type sensor_msgs/msg/CompressedImage '
     '(node /front/camera), not sensor_msgs/msg/Image; '
     'set transport:=compressed or transport:=auto'),
    ('raw', {f'{TOPIC}/compressed': CompressedImage},
     'no publisher of sensor_msgs/msg/Image on /video_frames, but one of '
     'sensor_msgs/msg/CompressedImage on /video_frames/compressed (node /front/camera); '
     'set transport:=compressed or transport:=auto'),
    ('compressed', {TOPIC: Image},
     'no publisher of sensor_msgs/msg/CompressedImage on /video_frames/compressed, but one of '
     'sensor_msgs/msg/Image on /video_frames (node /front/camera); '
     'set transport:=raw or transport:=auto'),
    ('raw', {f'/{letter}': Image for letter in 'gfedcba'},
     'no publisher on /video_frames; images are published on /a, /b, /c, /d, /e and 2 more in '
     'ROS_DOMAIN_ID {domain}; receive one with -r video_frames:=/a'),
    ('raw', {'/a': CompressedImage, '/b': Image, '/c': String},
     'images are published on /a, /b in ROS_DOMAIN_ID {domain}; '
     'receive one with -r video_frames:=/b'),
    ('raw', {'/jpeg': CompressedImage},
     'receive one with -r video_frames:=/jpeg -p transport:=auto'),
    ('raw', {f'{TOPIC}/compressedDepth': CompressedImage},
     'sensor_msgs/msg/CompressedImage on /video_frames/compressedDepth (node /front/camera); '
     'set transport:=compressedDepth or transport:=auto'),
    ('compressed', {'/b': CompressedImage}, 'no publisher on /video_frames/compressed; images'),
])
def test_explanation_with_a_remedy(
        node: Node, camera: Node, domain: int, transport: str, published: dict[str, type],
        sentence: str) -> None:
    for topic, published_type in published.items():
        camera.create_publisher(published_type, topic, RELIABLE)
    discovery = TopicDiscovery(node, 'video_frames', transport)
    spin_until(node, lambda: all(map(node.count_publishers, published)) and (
        '_NODE_NAME_UNKNOWN_' not in {
            info.node_name for topic in published
            for info in node.get_publishers_info_by_topic(topic)}))
    assert sentence.format(domain=domain) in discovery.explain_no_frames(
        discovery.allowed[0], RELIABLE)


def test_explanation_of_a_topic_that_was_chosen_from_a_list(
        node: Node, camera: Node, domain: int) -> None:
    camera.create_publisher(Image, '/a', RELIABLE)
    discovery = TopicDiscovery(node, TOPIC, 'auto')
    spin_until(node, lambda: node.count_publishers('/a') == 1)
    assert discovery.explain_no_frames(discovery.allowed[0], RELIABLE) == (
        f'no publisher on {TOPIC}; images are published on /a in ROS_DOMAIN_ID {domain}; '
        'choose one of them')


def test_explanation_of_a_video_topic_without_frames(node: Node, camera: Node) -> None:
    topic = f'{TOPIC}/ffmpeg'
    camera.create_publisher(message_type(FFMPEG_PACKET), topic, RELIABLE)
    discovery = TopicDiscovery(node, 'video_frames', 'video')
    spin_until(node, lambda: node.count_publishers(topic) == 1)
    assert discovery.explain_no_frames(discovery.allowed[0], RELIABLE).endswith(
        'images with 16 bits or floating-point numbers have no video: set transport:=raw to '
        'receive them')


def test_explanation_of_the_video_of_depth(node: Node, camera: Node) -> None:
    topics = f'{TOPIC}/ffmpeg', f'{TOPIC}/compressedDepth'
    for topic, kind in zip(topics, (message_type(FFMPEG_PACKET), CompressedImage)):
        camera.create_publisher(kind, topic, RELIABLE)
    discovery = TopicDiscovery(node, 'video_frames', 'video')
    spin_until(node, lambda: all(map(node.count_publishers, topics)))
    assert discovery.explain_no_frames(discovery.allowed[0], RELIABLE) == (
        '/video_frames/ffmpeg has no frame, because depth has no video, and '
        '/video_frames/compressedDepth has depth; set transport:=compressedDepth, or '
        'transport:=raw')


def test_order_of_transports(node: Node) -> None:
    for prefers_compressed, first in ((False, ('Image', 'CompressedImage')),
                                      (True, ('CompressedImage', 'Image'))):
        discovery = TopicDiscovery(
            node, 'video_frames', 'auto', prefers_compressed=prefers_compressed)
        types = [topic.type_name.rpartition('/')[2] for topic in discovery.allowed]
        assert tuple(dict.fromkeys(types)) == (*first, 'FFMPEGPacket', 'CompressedVideo')


RAW, JPEG = TOPIC, f'{TOPIC}/compressed'
DEPTH, PACKETS, VIDEO = (
    f'{TOPIC}/{suffix}' for suffix in ('compressedDepth', 'ffmpeg', 'foxglove'))
OURS = (RAW, JPEG, PACKETS, VIDEO)


@pytest.mark.parametrize(('topic', 'transport', 'published', 'is_remote', 'best'), [
    (TOPIC, 'compressedDepth', (RAW, JPEG, DEPTH), False, DEPTH),
    (TOPIC, 'compressedDepth', (RAW, JPEG), False, None),
    (TOPIC, 'compressed', (RAW, DEPTH), False, None),
    (TOPIC, 'compressed', (JPEG, DEPTH), False, JPEG),
    (DEPTH, 'compressed', (DEPTH,), False, DEPTH), (DEPTH, 'auto', (DEPTH,), False, DEPTH),
    (TOPIC, 'auto', (DEPTH,), False, DEPTH), (TOPIC, 'auto', (JPEG, DEPTH), False, JPEG),
    (TOPIC, 'auto', (*OURS, DEPTH), False, RAW), (TOPIC, 'auto', (*OURS, DEPTH), True, DEPTH),
    (TOPIC, 'auto', OURS, True, PACKETS),
    (TOPIC, 'auto', (RAW, JPEG, PACKETS, DEPTH), True, PACKETS),
    (TOPIC, 'auto', (RAW, JPEG, DEPTH), True, RAW)])
def test_topics_of_depth(
        node: Node, camera: Node, monkeypatch: pytest.MonkeyPatch, topic: str, transport: str,
        published: tuple[str, ...], is_remote: bool, best: str | None) -> None:
    types = {RAW: Image, PACKETS: message_type(FFMPEG_PACKET),
             VIDEO: message_type(COMPRESSED_VIDEO)}
    for name in published:
        camera.create_publisher(types.get(name, CompressedImage), name, 10)
        spin_until(node, lambda name=name: node.count_publishers(name) > 0)
    monkeypatch.setattr(TopicDiscovery, '_is_remote', lambda *_: is_remote)
    found = TopicDiscovery(node, topic, transport).best()
    assert (found and found.name) == best


def test_own_topics_are_not_suggested(node: Node) -> None:
    node.create_publisher(Image, '/filtered', RELIABLE)
    discovery = TopicDiscovery(node, 'video_frames', 'raw')
    spin_until(node, lambda: node.count_publishers('/filtered') == 1)
    assert 'no images are published' in discovery.explain_no_frames(
        discovery.allowed[0], RELIABLE)


def test_explanation_of_incompatible_qos(node: Node, camera: Node) -> None:
    discovery = TopicDiscovery(node, 'video_frames', 'auto')
    camera.create_publisher(Image, TOPIC, BEST_EFFORT)
    spin_until(node, lambda: node.count_publishers(TOPIC) == 1)
    assert 'best effort publisher and reliable subscription' in discovery.explain_no_frames(
        discovery.allowed[0], RELIABLE)
