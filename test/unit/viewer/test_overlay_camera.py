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
"""Overlay of a camera, from messages that anybody can publish."""

from __future__ import annotations

from typing import Any

from conftest import spin_until
import numpy as np
from opencv_tools.image.errors import ImageError
from opencv_tools.viewer.overlays.page_overlays import camera_json, CameraOverlay, MAX_INFO_BYTES
from opencv_tools.viewer.overlays.sources import CameraInfoSource
from opencv_tools.viewer.overlays.topics import CALIBRATION, OverlayTopics
import pytest
from rclpy.node import Node
from rclpy.serialization import deserialize_message, serialize_message
from sensor_msgs.msg import CameraInfo

SIZE = 640, 480
KEY = '/front', CALIBRATION


def info(**fields: Any) -> CameraInfo:
    return CameraInfo(**{
        'width': 640, 'height': 480, 'distortion_model': 'plumb_bob',
        'd': [-0.3, 0.1, 0, 0, 0], 'k': [400.0, 0, 330.25, 0, 410, 250.5, 0, 0, 1],
        'p': [300.0, 0, 320, 0, 0, 300, 240, 0, 0, 0, 1, 0], 'r': np.eye(3).ravel()} | fields)


def test_raw_and_rectified_images() -> None:
    data = serialize_message(info())
    raw = camera_json(data, '/front/image_raw', SIZE)
    assert raw['center'] == [330.75, 251.0]
    assert len(raw['outline']) == 256
    rectified = camera_json(data, '/front/image_rect_color', SIZE)
    assert rectified == {'center': [320.5, 240.5], 'outline': []}


def test_points_that_the_model_does_not_have() -> None:
    k = [10.0, 0, 1e9, 0, 10, 240, 0, 0, 1]
    shown = camera_json(serialize_message(info(
        distortion_model='equidistant', d=[], k=k, r=[0.0, 0, 1, 0, 1, 0, -1, 0, 0])),
        '/front', SIZE)
    assert shown['center'] is None
    assert None in shown['outline']


def test_messages_that_cannot_be_used() -> None:
    for data in (b'', b'\0\1\0\0', bytes(100), bytes(MAX_INFO_BYTES + 1),
                 serialize_message(info())[:60]):
        with pytest.raises(ImageError, match='camera_info'):
            camera_json(data, '/front', SIZE)


def test_overlay_is_sent_when_it_has_changed() -> None:
    sent: list[dict[str, Any]] = []
    size: list[tuple[int, int]] = []
    source = CameraInfoSource(KEY)
    overlay = CameraOverlay(source, '/front', lambda: size[-1] if size else None, sent.append)
    source.watchers.add(overlay.look)
    assert overlay.describe() == 'no camera_info of /front yet'
    for sec in range(3):
        message = info()
        message.header.stamp.sec = sec
        source.receive([np.frombuffer(serialize_message(message), np.uint8)])
        size.append(SIZE)
        overlay.look()
    assert len(sent) == 1 and sent[0]['camera']['topic'] == '/front'
    assert overlay.describe() == ''
    size.append((320, 240))
    overlay.look()
    assert sent[1]['camera'] == {'topic': '/front', 'center': None, 'outline': []}
    assert overlay.describe().startswith('the image has 320x240 pixels, but its camera_info')
    size.append(SIZE)
    source.receive([serialize_message(info(k=np.zeros(9)))])
    assert 'its K is zero' in overlay.describe()
    source.receive([serialize_message(info(d=[1e300] * 5))])
    assert overlay.describe().startswith('no point of the undistorted view is near the image')
    source.receive([serialize_message(info())])
    assert overlay.describe() == ''


@pytest.mark.parametrize(('image', 'expected'), [
    ('/front/image_rect', 400), ('/front/image', 300), ('/front/image_raw/compressed', 300)])
def test_calibration_that_belongs_to_an_image_topic(
        node: Node, camera: Node, image: str, expected: int) -> None:
    publishers = {
        300: camera.create_publisher(CameraInfo, 'camera_info', 10),
        400: camera.create_publisher(CameraInfo, 'image_rect/camera_info', 10)}
    for publisher in publishers.values():
        spin_until(node, lambda name=publisher.topic_name: node.count_publishers(name) > 0)
    source = CameraInfoSource((image, CALIBRATION))
    topics = OverlayTopics(node, lambda _: True)
    topics.open(source.key, source.receive)
    spin_until(node, lambda: publishers[expected].get_subscription_count() > 0)
    for width, publisher in publishers.items():
        publisher.publish(info(width=width))
    spin_until(node, lambda: bool(source.newest))
    assert deserialize_message(source.newest, CameraInfo).width == expected
    topics.close_all()
