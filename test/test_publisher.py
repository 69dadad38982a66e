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

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from conftest import call_service, NodeProcess, set_parameters, spin_until
import cv2
from diagnostic_msgs.msg import DiagnosticArray
import numpy as np
from opencv_tools.capture.pattern import draw_pattern
from opencv_tools.cv_bridge import CvBridge
from opencv_tools.ros.calibration_file import read_camera_info
import pytest
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.time import Time
from sensor_msgs.msg import CameraInfo, CompressedImage, Image
from sensor_msgs.srv import SetCameraInfo
from std_srvs.srv import SetBool

Start = Callable[..., NodeProcess]


def receive(node: Node, message_type: type, topic: str, depth: int = 50) -> list:
    """Keep the messages of a topic as they come."""
    messages: list = []
    node.create_subscription(message_type, topic, messages.append, depth)
    return messages


def pixels(message: Image) -> np.ndarray:
    return CvBridge().imgmsg_to_cv2(message)


def nanoseconds(message: Image | CameraInfo) -> int:
    return Time.from_msg(message.header.stamp).nanoseconds


# Beside the frames

@pytest.mark.parametrize(('encoding', 'format_text'), [
    ('bgr8', 'bgr8; jpeg compressed bgr8'), ('rgb8', 'rgb8; jpeg compressed bgr8'),
    ('mono8', 'mono8; jpeg compressed '), ('bgr16', 'bgr8; jpeg compressed bgr8')])
def test_compressed_frames(start: Start, node: Node, encoding: str, format_text: str) -> None:
    messages = receive(node, CompressedImage, 'video_frames/compressed')
    publisher = start('img_publisher', source='pattern:64x48', publish_rate=50, max_frames=3,
                      wait_for_subscribers=1, encoding=encoding, frame_id='eye')
    assert publisher.finish() == 0, publisher.output
    spin_until(node, lambda: len(messages) == 3)
    for number, message in enumerate(messages):
        assert message.format == format_text
        assert message.header.frame_id == 'eye'
        image = draw_pattern(number, 64, 48)
        if encoding == 'mono8':
            image = cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)
        expected = cv2.imencode('.jpg', image, (cv2.IMWRITE_JPEG_QUALITY, 95))[1]
        assert bytes(message.data) == expected.tobytes()


def test_the_quality_of_compressed_frames_can_be_changed(start: Start, node: Node) -> None:
    messages = receive(node, CompressedImage, 'video_frames/compressed')
    start('img_publisher', source='pattern:320x240@50', publish_rate=0)
    spin_until(node, lambda: len(messages) > 3)
    before = len(messages[-1].data)
    assert not set_parameters(node, jpeg_quality=10)
    messages.clear()
    spin_until(node, lambda: len(messages) > 3)
    assert len(messages[-1].data) < before / 2


def test_a_frame_that_is_no_picture_for_a_jpeg_still_goes_out(
        start: Start, node: Node, tmp_path: Path) -> None:
    cv2.imwrite(str(tmp_path / 'depth.tiff'), np.ones((4, 4), np.float32))
    images = receive(node, Image, 'video_frames')
    compressed = receive(node, CompressedImage, 'video_frames/compressed')
    publisher = start('img_publisher', source='depth.tiff', encoding="''", on_end='loop')
    spin_until(node, lambda: len(images) > 2)
    assert images[0].encoding == '32FC1'
    publisher.wait_for('[32FC1] is not a color format')
    assert not compressed


def test_the_topics_beside_follow_that_of_the_images(start: Start, node: Node) -> None:
    infos = receive(node, CameraInfo, '/front/camera_info')
    compressed = receive(node, CompressedImage, '/front/image/compressed')
    start('img_publisher', '--ros-args', '-r', 'video_frames:=/front/image', '--',
          source='pattern')
    spin_until(node, lambda: infos and compressed)


def test_the_quality_of_service_of_each_topic_can_be_overridden(start: Start, node: Node) -> None:
    topics = ('/video_frames', '/video_frames/compressed', '/camera_info')
    start('img_publisher', source='pattern', **{
        f'qos_overrides.{topic}.publisher.reliability': 'best_effort' for topic in topics})
    spin_until(node, lambda: all(map(node.get_publishers_info_by_topic, topics)))
    for topic in topics:
        (info,) = node.get_publishers_info_by_topic(topic)
        assert info.qos_profile.reliability == ReliabilityPolicy.BEST_EFFORT


CALIBRATION = """\
image_width: 640
image_height: 480
camera_name: front
camera_matrix: {rows: 3, cols: 3, data: [500.5, 0, 320.25, 0, 501.5, 240.75, 0, 0, 1]}
distortion_model: plumb_bob
distortion_coefficients: {rows: 1, cols: 5, data: [0.1, -0.2, 0.001, 0.002, 0]}
rectification_matrix: {rows: 3, cols: 3, data: [1, 0, 0, 0, 1, 0, 0, 0, 1]}
projection_matrix: {rows: 3, cols: 4, data: [480, 0, 322, 0, 0, 481, 239, 0, 0, 0, 1, 0]}
"""


@pytest.mark.parametrize(('size', 'focal_length'), [('640x480', 500.5), ('320x240', 250.25),
                                                    ('640x360', 0.0)])
def test_camera_info_is_in_step_with_the_images(
        start: Start, node: Node, tmp_path: Path, size: str, focal_length: float) -> None:
    (tmp_path / 'front.yaml').write_text(CALIBRATION)
    images, infos = receive(node, Image, 'video_frames'), receive(node, CameraInfo, 'camera_info')
    publisher = start('img_publisher', source=f'pattern:{size}', publish_rate=50,
                      camera_info_url=f'file://{tmp_path}/${{NAME}}.yaml', camera_name='front')
    spin_until(node, lambda: len(images) > 5 and len(infos) > 5)
    stamps = {nanoseconds(info): info for info in infos}
    for image in images[1:5]:
        info = stamps[nanoseconds(image)]
        assert info.header == image.header
        assert (info.width, info.height) == (image.width, image.height)
        assert info.k[0] == focal_length
    refused = 'cannot be scaled to pictures of 640x360' in publisher.output
    assert refused == (focal_length == 0.0)


def test_a_calibration_is_saved_and_published_from_then_on(
        start: Start, node: Node, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv('ROS_HOME', str(tmp_path / 'ros'))
    infos = receive(node, CameraInfo, '/left/camera_info')
    start('img_publisher', '--ros-args', '-r', '__ns:=/left', '--', source='pattern:640x480')
    spin_until(node, lambda: len(infos) > 1)
    assert infos[-1].k[0] == 0.0
    (tmp_path / 'sent.yaml').write_text(CALIBRATION)
    sent = read_camera_info(tmp_path / 'sent.yaml')
    answer = call_service(node, SetCameraInfo, '/left/set_camera_info',
                          SetCameraInfo.Request(camera_info=sent))
    assert answer.success, answer.status_message
    saved = read_camera_info(tmp_path / 'ros' / 'camera_info' / 'left.yaml')
    assert saved == sent
    infos.clear()
    spin_until(node, lambda: len(infos) > 1)
    assert infos[-1].k[0] == 500.5


def test_a_calibration_that_cannot_be_saved_is_refused_with_the_reason(
        start: Start, node: Node, tmp_path: Path) -> None:
    start('img_publisher', source='pattern', camera_info_url='file:///proc/none/front.yaml')
    answer = call_service(node, SetCameraInfo, '/set_camera_info', SetCameraInfo.Request(
        camera_info=CameraInfo(width=64, height=48, distortion_model='plumb_bob')))
    assert not answer.success
    assert '/proc/none/front.yaml cannot be written' in answer.status_message


def test_diagnostics(start: Start, node: Node) -> None:
    messages = receive(node, DiagnosticArray, '/diagnostics')
    receive(node, Image, 'video_frames')
    start('img_publisher', source='pattern:64x48@20', publish_rate=0)
    spin_until(node, lambda: len(messages) == 4)
    (status,) = messages[-1].status
    values = {value.key: value.value for value in status.values}
    assert status.name == 'image_publisher: source'
    assert (status.level, status.message) == (b'\0', 'publishing')
    assert float(values['rate'].split()[0]) == pytest.approx(20, abs=2)
    assert 0 <= float(values['age'].split()[0]) < 100
    assert values['format'] == 'bgr8 64x48 at 20 Hz'
    assert (values['dropped'], values['missed'], values['reconnects']) == ('0', '0', '0')
    seconds = np.diff([nanoseconds(message) for message in messages]) / 1e9
    assert seconds == pytest.approx(1.0, abs=0.2)


def test_diagnostics_tell_that_there_is_no_camera(start: Start, node: Node) -> None:
    messages = receive(node, DiagnosticArray, '/diagnostics')
    start('img_publisher', source=987)
    spin_until(node, lambda: bool(messages))
    (status,) = messages[-1].status
    assert status.level == b'\2'
    assert status.message.startswith('there is no camera /dev/video987')


# While it runs

def test_capture_can_be_paused(start: Start, node: Node) -> None:
    images = receive(node, Image, 'video_frames')
    start('img_publisher', source='pattern:64x48@50', publish_rate=0)
    spin_until(node, lambda: len(images) > 3)
    answer = call_service(node, SetBool, '/set_capture', SetBool.Request(data=False))
    assert answer.message == 'paused'
    spin_for(node, 0.3)
    images.clear()
    spin_for(node, 0.5)
    assert not images
    assert call_service(node, SetBool, '/set_capture', SetBool.Request(data=True)).success
    spin_until(node, lambda: len(images) > 3)


def spin_for(node: Node, seconds: float) -> None:
    """Spin a node for a time."""
    until = node.get_clock().now().nanoseconds + seconds * 1e9
    spin_until(node, lambda: node.get_clock().now().nanoseconds > until)


ORIENTED = {
    ('horizontal', 0): lambda image: image[:, ::-1], ('vertical', 0): lambda image: image[::-1],
    ('none', 90): lambda image: cv2.rotate(image, cv2.ROTATE_90_CLOCKWISE),
    ('both', 270): lambda image: cv2.rotate(image[::-1, ::-1], cv2.ROTATE_90_COUNTERCLOCKWISE),
}


@pytest.mark.parametrize(('flip', 'rotate'), ORIENTED)
def test_frames_are_flipped_then_rotated(
        start: Start, node: Node, flip: str, rotate: int) -> None:
    images = receive(node, Image, 'video_frames')
    compressed = receive(node, CompressedImage, 'video_frames/compressed')
    publisher = start('img_publisher', source='pattern:64x48', flip=flip, rotate=rotate,
                      publish_rate=50, max_frames=3, wait_for_subscribers=2)
    assert publisher.finish() == 0, publisher.output
    spin_until(node, lambda: len(images) == len(compressed) == 3)
    for number, (image, small) in enumerate(zip(images, compressed)):
        expected = ORIENTED[flip, rotate](draw_pattern(number, 64, 48))
        assert np.array_equal(pixels(image), expected)
        assert cv2.imdecode(np.frombuffer(small.data, np.uint8), 1).shape == expected.shape


def test_parameters_can_be_changed_while_it_runs(start: Start, node: Node) -> None:
    images = receive(node, Image, 'video_frames')
    start('img_publisher', source='pattern:64x48', publish_rate=50)

    def newest() -> Image:
        spin_for(node, 0.1)
        images.clear()
        spin_until(node, lambda: bool(images))
        return images[-1]

    assert newest().encoding == 'bgr8'
    for name, value, field, expected in (
            ('encoding', 'mono16', 'encoding', 'mono16'), ('rotate', 90, 'width', 48),
            ('flip', 'vertical', 'height', 64)):
        assert not set_parameters(node, **{name: value})
        assert getattr(newest(), field) == expected
    assert not set_parameters(node, frame_id='left')
    assert newest().header.frame_id == 'left'
    assert not set_parameters(node, publish_rate=5.0)
    spin_for(node, 0.3)
    images.clear()
    spin_for(node, 2.0)
    assert len(images) == pytest.approx(10, abs=1)


@pytest.mark.parametrize(('name', 'value', 'reason'), [
    ('source', 'pattern:8x8', 'read-only'), ('rotate', 91, 'give one of 0, 90, 180, 270'),
    ('encoding', 'bgr9', "parameter encoding is 'bgr9'"),
    ('fourcc', 'H264', 'the known pixel formats are'), ('jpeg_quality', 0, 'out of range')])
def test_a_change_that_cannot_be_is_refused_with_the_reason(
        start: Start, node: Node, name: str, value: object, reason: str) -> None:
    start('img_publisher', source='pattern:64x48')
    assert reason in set_parameters(node, **{name: value})


# Stamps

@pytest.mark.parametrize(('stamp', 'offset'), [('capture', 0.0), ('publish', 0.0),
                                               ('capture', -12.5), ('publish', 3.0)])
def test_stamps_are_the_time_of_ros_and_rise(
        start: Start, node: Node, stamp: str, offset: float) -> None:
    ages: list[float] = []
    stamps: list[int] = []

    def note(message: Image) -> None:
        stamps.append(nanoseconds(message))
        ages.append((node.get_clock().now().nanoseconds - stamps[-1]) / 1e9)

    node.create_subscription(Image, 'video_frames', note, QoSProfile(depth=200))
    publisher = start('img_publisher', source='pattern:64x48', publish_rate=200, max_frames=100,
                      wait_for_subscribers=1, stamp=stamp, stamp_offset=offset)
    spin_until(node, lambda: len(ages) == 100)
    assert publisher.finish() == 0, publisher.output
    assert np.median(ages) == pytest.approx(-offset, abs=0.05)
    gaps = np.diff(stamps)
    assert gaps.min() > 0
    if stamp == 'capture':  # the time at which each was due, whenever it was shown
        assert np.median(gaps) == pytest.approx(5e6, abs=1e5)


def test_a_node_without_subscribers_says_so(start: Start) -> None:
    publisher = start('img_publisher', source='pattern', max_frames=5)
    assert publisher.finish() == 0, publisher.output
    assert 'Publishing video frame 1: nobody subscribes' in publisher.output
    assert 'Published 5 frames' in publisher.output
