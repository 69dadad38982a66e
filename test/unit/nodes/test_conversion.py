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

"""Conversion of messages to frames: metadata, views and the limit of pixels."""

from __future__ import annotations

import struct
from typing import NamedTuple

from conftest import spin_until
import cv2
import numpy as np
from opencv_tools.base.logs import Log
from opencv_tools.base.units import NANO
from opencv_tools.cv_bridge import CvBridge
from opencv_tools.image.cdr import WireCompressedImage, WireHeader, WireImage, WireMessage
from opencv_tools.image.errors import SizeError
from opencv_tools.nodes.conversion import BagMessages, FrameConverter
from opencv_tools.recording.bag_sink import RecordedMessage
from opencv_tools.recording.naming import FrameMetadata
from opencv_tools.topics.queue import ReceivedMessage
import pytest
from rclpy.node import Node
from sensor_msgs.msg import CameraInfo

HEADER = WireHeader(1, 2, 'camera')
COLOR = np.random.default_rng(1).integers(0, 256, (37, 53, 3), np.uint8)
HUGE_PNG = b'\x89PNG\r\n\x1a\n' + struct.pack('>I4sII', 13, b'IHDR', 20000, 20000)


def raw_image(data: bytes, width: int, height: int) -> WireImage:
    return WireImage(header=HEADER, height=height, width=width, encoding='bgr8',
                     is_bigendian=False, step=3 * width, data=data)


def compressed_image(data: bytes) -> WireCompressedImage:
    return WireCompressedImage(header=HEADER, format='png', data=data)


def png(image: np.ndarray) -> bytes:
    done, data = cv2.imencode('.png', image)
    assert done
    return data.tobytes()


def test_raw_frame_is_a_view_with_metadata() -> None:
    data = COLOR.tobytes()
    frame = FrameConverter(CvBridge()).convert(raw_image(data, 53, 37), '/video_frames', 7)
    assert frame.metadata == FrameMetadata(NANO + 2, 'camera', 'bgr8', '/video_frames')
    assert (frame.receive_ns, frame.time_ns) == (7, NANO + 2)
    assert np.array_equal(frame.image, COLOR)
    assert np.may_share_memory(frame.image, np.frombuffer(data, np.uint8))


def test_compressed_frame_is_a_view_with_metadata() -> None:
    data = png(COLOR)
    frame = FrameConverter(CvBridge()).convert(compressed_image(data), '/camera/compressed', 7)
    assert frame.metadata == FrameMetadata(NANO + 2, 'camera', 'png', '/camera/compressed')
    assert frame.data is data
    decoded = frame.decode()
    assert np.array_equal(decoded.image, COLOR)
    assert (decoded.metadata.encoding, decoded.arrival_ns) == ('bgr8', frame.arrival_ns)


def test_arrival_times_of_a_converter_never_decrease() -> None:
    converter = FrameConverter(CvBridge())
    arrivals = [converter.convert(raw_image(COLOR.tobytes(), 53, 37), '', receive_ns).arrival_ns
                for receive_ns in (2**62, 0, 2**62, 1)]
    assert arrivals == sorted(arrivals)


@pytest.mark.parametrize('message', [
    raw_image(b'', 20000, 20000), compressed_image(HUGE_PNG)], ids=['raw', 'compressed'])
def test_error_of_a_large_message_names_the_parameter(message: WireMessage) -> None:
    with pytest.raises(SizeError) as raised:
        FrameConverter(CvBridge()).convert(message, '', 1)
    assert str(raised.value) == ('20000x20000 pixels are more than max_pixels=134217728; '
                                 'raise the parameter max_pixels to receive it')


def test_pixel_limit_belongs_to_the_frame() -> None:
    message = compressed_image(png(COLOR))
    frame = FrameConverter(CvBridge(), 53 * 37).convert(message, '', 1)
    assert np.array_equal(frame.decode().image, COLOR)
    with pytest.raises(SizeError):
        FrameConverter(CvBridge(), 53 * 37 - 1).convert(message, '', 1)


RECTIFIED = '/front/image_rect'


class Recording(NamedTuple):
    """A recording of the camera_info beside rectified images, and the messages of a camera."""

    messages: BagMessages
    recorded: list[RecordedMessage]

    def add_frame(self) -> None:
        self.messages.frame(
            ReceivedMessage(raw_image(bytes(9), 1, 3), 1, publish_ns=1, number=1), RECTIFIED)

    @property
    def topics(self) -> list[str]:
        return [message.channel.topic for message in self.recorded]


@pytest.mark.parametrize('is_discovered_late', [True, False])
@pytest.mark.parametrize('count', [1, 3, 20])
def test_early_camera_info_of_the_raw_images_is_not_recorded(
        node: Node, camera: Node, is_discovered_late: bool, count: int) -> None:
    raw = camera.create_publisher(CameraInfo, 'camera_info', 10)
    recorded: list[RecordedMessage] = []
    recording = Recording(
        BagMessages(node, RECTIFIED, Log(node.get_logger()), recorded.append), recorded)
    held = recording.messages._held
    assert held is not None

    def receive() -> bool:
        if raw.get_subscription_count():
            raw.publish(CameraInfo())
        return len(held) >= count

    spin_until(node, receive)
    name, sent = f'{RECTIFIED}/camera_info', len(held)
    if is_discovered_late:
        rectified = camera.create_publisher(CameraInfo, name, 10)
        spin_until(node, lambda: rectified.get_subscription_count() > 0)
        for _ in range(3):
            rectified.publish(CameraInfo())
        spin_until(node, lambda: len(held) >= sent + 3)
        camera.destroy_publisher(rectified)  # before the end of a short recording
        spin_until(node, lambda: not node.count_publishers(name))
    recording.add_frame()
    assert not recorded
    recording.messages.close()
    assert recording.topics == (
        [name] * 3 if is_discovered_late else ['/front/camera_info'] * len(held))


def test_camera_info_is_recorded_at_once_after_the_second_check(
        node: Node, camera: Node, monkeypatch: pytest.MonkeyPatch) -> None:
    raw = camera.create_publisher(CameraInfo, 'camera_info', 10)
    recorded: list[RecordedMessage] = []
    recording = Recording(
        BagMessages(node, '/front/image', Log(node.get_logger()), recorded.append), recorded)
    spin_until(node, lambda: raw.get_subscription_count() > 0)
    monkeypatch.setattr(recording.messages._throttle, 'passes', lambda *_: True)
    recording.add_frame()
    raw.publish(CameraInfo())
    spin_until(node, lambda: bool(recording.messages._held))
    assert not recorded
    recording.add_frame()
    assert len(recorded) == 1
    raw.publish(CameraInfo())
    spin_until(node, lambda: len(recorded) == 2)
    recording.messages.close()
