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
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

from conftest import call_service, NodeProcess, set_parameters, spin_until
import cv2
from diagnostic_msgs.msg import DiagnosticArray
import numpy as np
from opencv_tools.capture.pattern import draw_pattern
from opencv_tools.ros.fastdds.profile import NOT_CONFIGURED
from opencv_tools.ros.publisher.calibration_file import read_camera_info
from opencv_tools.ros.publisher.camera_info import Calibration
from opencv_tools.ros.publisher.diagnostics import Diagnostics, SourceStatus
from opencv_tools.ros.publisher.image_topics import ImageTopics
from opencv_tools.ros.publisher.stamps import Stamper
import pytest
from rcl_interfaces.msg import ParameterType
from rcl_interfaces.srv import DescribeParameters, GetParameters
from rclpy.clock import ClockType, ROSClock
from rclpy.node import Node
from rclpy.parameter import parameter_value_to_python
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


def wait_for_data(node: Node, messages: list, data: bytes, kind: str) -> None:
    """Wait until the newest message is of a kind and has these data."""
    field = 'encoding' if kind == 'bgr8' else 'format'
    spin_until(node, lambda: bool(messages) and getattr(messages[-1], field) == kind
               and bytes(messages[-1].data) == data)


def nanoseconds(message: Image | CameraInfo) -> int:
    return Time.from_msg(message.header.stamp).nanoseconds


@pytest.fixture
def picture(tmp_path: Path) -> np.ndarray:
    """Make a file, p.png, that is shown again and again: its pixels."""
    image = draw_pattern(0, 64, 48)
    cv2.imwrite(str(tmp_path / 'p.png'), image)
    return image


# Beside the frames

FORMATS = {'rgb8': 'rgb8; jpeg compressed bgr8', 'mono8': 'mono8; jpeg compressed mono8',
           'bgr16': 'bgr8; jpeg compressed bgr8', 'bgr8': 'bgr8; jpeg compressed bgr8'}


def test_compressed_frames(start: Start, node: Node, picture: np.ndarray) -> None:
    messages = receive(node, CompressedImage, 'video_frames/compressed')
    start('img_publisher', source='p.png', on_end='loop', publish_rate=50, frame_id='eye')
    for encoding, format_text in FORMATS.items():
        shown = cv2.cvtColor(picture, cv2.COLOR_BGR2GRAY) if encoding == 'mono8' else picture
        expected = cv2.imencode('.jpg', shown, (cv2.IMWRITE_JPEG_QUALITY, 95))[1].tobytes()
        assert not set_parameters(node, encoding=encoding)
        wait_for_data(node, messages, expected, format_text)
    assert messages[-1].header.frame_id == 'eye'


def test_the_quality_of_compressed_frames_can_be_changed(start: Start, node: Node) -> None:
    messages = receive(node, CompressedImage, 'video_frames/compressed')
    start('img_publisher', source='pattern:320x240@50', publish_rate=0)
    spin_until(node, lambda: len(messages) > 3)
    before = len(messages[-1].data)
    assert not set_parameters(node, jpeg_quality=10)
    spin_until(node, lambda: len(messages[-1].data) < before / 2)


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
    refused = 'cannot be scaled to images of 640x360' in publisher.output
    assert refused == (focal_length == 0.0)


def test_a_calibration_is_saved_and_published_from_then_on(
        start: Start, node: Node, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv('ROS_HOME', str(tmp_path / 'ros'))
    infos = receive(node, CameraInfo, '/left/camera_info')
    start('img_publisher', '--ros-args', '-r', '__ns:=/left', '--', source='pattern:640x480',
          rotate=180)
    spin_until(node, lambda: len(infos) > 1)
    assert infos[-1].k[0] == 0.0
    (tmp_path / 'sent.yaml').write_text(CALIBRATION)
    sent = read_camera_info(tmp_path / 'sent.yaml')
    answer = call_service(node, SetCameraInfo, '/left/set_camera_info',
                          SetCameraInfo.Request(camera_info=sent))
    assert answer.success, answer.status_message
    saved = read_camera_info(tmp_path / 'ros' / 'camera_info' / 'left.yaml')
    # The file has the camera itself, which is not turned.
    assert (saved.k[0], saved.k[2], saved.d[2]) == (500.5, 639 - 320.25, -0.001)
    spin_until(node, lambda: infos[-1].k[0] > 0)
    assert (infos[-1].k == sent.k).all()
    assert infos[-1].d == sent.d


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
    spin_until(node, lambda: bool(messages) and messages[-1].status[0].message == 'publishing')
    (status,) = messages[-1].status
    values = {value.key: value.value for value in status.values}
    assert (status.name, status.level) == ('image_publisher: source', b'\0')
    assert float(values['rate'].removesuffix(' Hz')) > 0
    assert float(values['age'].removesuffix(' ms at most')) >= 0
    assert values['format'] == 'bgr8 64x48 at 20 Hz'
    assert (values['dropped'], values['missed'], values['reconnects']) == ('0', '0', '0')


def test_diagnostics_of_a_period(node: Node, monkeypatch: pytest.MonkeyPatch) -> None:
    now = 100.0
    monkeypatch.setattr('opencv_tools.ros.publisher.diagnostics.time',
                        SimpleNamespace(monotonic=lambda: now))
    messages = receive(node, DiagnosticArray, '/diagnostics')
    condition = SourceStatus(source='eye', description='bgr8 4x3', unavailable_reason='',
                             paused=False, missed=0, dropped=0, reconnects=0)
    diagnostics = Diagnostics(node, lambda: condition)
    spin_until(node, lambda: node.count_publishers('/diagnostics') == 1)
    for age in (0.01, 0.025, 0.02):
        diagnostics.count(age)
    now += 2.0
    condition = replace(condition, missed=2, dropped=1)
    spin_until(node, lambda: bool(messages))
    (status,) = messages[0].status
    values = {value.key: value.value for value in status.values}
    assert (values['rate'], values['age']) == ('1.5 Hz', '25.0 ms at most')
    assert (status.level, status.message) == (b'\1', '3 frames lost in the last second')
    assert (values['dropped'], values['missed']) == ('1', '2')


def test_diagnostics_tell_that_subscribers_are_awaited(start: Start, node: Node) -> None:
    messages = receive(node, DiagnosticArray, '/diagnostics')
    start('img_publisher', source='pattern:64x48@20', wait_for_subscribers=1)
    spin_until(node, lambda: bool(messages))
    (status,) = messages[-1].status
    assert (status.level, status.message) == (b'\0', 'waiting for 1 subscriber(s)')
    receive(node, Image, 'video_frames')
    spin_until(node, lambda: messages[-1].status[0].message == 'publishing')


def test_diagnostics_tell_that_there_is_no_camera(start: Start, node: Node) -> None:
    messages = receive(node, DiagnosticArray, '/diagnostics')
    start('img_publisher', source=987)
    spin_until(node, lambda: bool(messages))
    (status,) = messages[-1].status
    assert status.level == b'\2'
    assert status.message.startswith('camera /dev/video987 does not exist')


# While it runs

def test_capture_can_be_paused(start: Start, node: Node) -> None:
    images = receive(node, Image, 'video_frames')
    start('img_publisher', source='pattern:64x48@50', publish_rate=0)
    spin_until(node, lambda: len(images) > 3)
    answer = call_service(node, SetBool, '/set_capture', SetBool.Request(data=False))
    assert answer.message == 'paused'
    reports = receive(node, DiagnosticArray, '/diagnostics')

    def wait_for_pauses(count: int) -> None:
        reports.clear()
        spin_until(node, lambda: [report.status[0].message for report in reports[-count:]]
                   == ['paused'] * count)

    wait_for_pauses(1)
    images.clear()
    wait_for_pauses(2)  # of 100 frames, were it not paused
    assert not images
    assert call_service(node, SetBool, '/set_capture', SetBool.Request(data=True)).success
    spin_until(node, lambda: len(images) > 3)


ORIENTED = {
    ('horizontal', 0): lambda image: image[:, ::-1], ('vertical', 0): lambda image: image[::-1],
    ('none', 90): lambda image: cv2.rotate(image, cv2.ROTATE_90_CLOCKWISE),
    ('both', 270): lambda image: cv2.rotate(image[::-1, ::-1], cv2.ROTATE_90_COUNTERCLOCKWISE),
}


def test_frames_are_flipped_then_rotated(start: Start, node: Node, picture: np.ndarray) -> None:
    images = receive(node, Image, 'video_frames')
    compressed = receive(node, CompressedImage, 'video_frames/compressed')
    start('img_publisher', source='p.png', on_end='loop', publish_rate=50)
    for (flip, rotate), orient in ORIENTED.items():
        assert not set_parameters(node, flip=flip, rotate=rotate)
        expected = orient(picture)
        jpeg = cv2.imencode('.jpg', expected, (cv2.IMWRITE_JPEG_QUALITY, 95))[1].tobytes()
        wait_for_data(node, images, expected.tobytes(), 'bgr8')
        assert (images[-1].height, images[-1].width) == expected.shape[:2]
        wait_for_data(node, compressed, jpeg, 'bgr8; jpeg compressed bgr8')


def test_parameters_can_be_changed_while_it_runs(start: Start, node: Node) -> None:
    images = receive(node, Image, 'video_frames')
    start('img_publisher', source='pattern:64x48', publish_rate=50)

    spin_until(node, lambda: bool(images))
    assert (images[0].encoding, images[0].width, images[0].header.frame_id) == (
        'bgr8', 64, 'camera')
    for name, value, expected in (
            ('encoding', 'mono16', lambda image: image.encoding == 'mono16'),
            ('rotate', 90, lambda image: (image.width, image.height) == (48, 64)),
            ('frame_id', 'left', lambda image: image.header.frame_id == 'left')):
        assert not set_parameters(node, **{name: value})
        spin_until(node, lambda expected=expected: expected(images[-1]))
    assert not set_parameters(node, publish_rate=5.0)
    # A frame may be late, but none comes before its time.
    spin_until(node, lambda: min(
        np.diff([nanoseconds(image) for image in images[-4:]])) > 0.19e9)


def test_a_change_is_taken_as_at_the_start(start: Start, node: Node) -> None:
    start('img_publisher', source='pattern:64x48')
    assert not set_parameters(node, publish_rate=5, fps=10, stamp_offset=-1, frame_id=7,
                              reconnect=3)
    names = ['publish_rate', 'fps', 'stamp_offset', 'frame_id', 'reconnect']
    got = call_service(node, GetParameters, '/image_publisher/get_parameters',
                       GetParameters.Request(names=names)).values
    assert [parameter_value_to_python(value) for value in got] == [5.0, 10.0, -1.0, '7', '3']
    assert [value.type for value in got] == [ParameterType.PARAMETER_DOUBLE] * 3 + [
        ParameterType.PARAMETER_STRING] * 2
    described = call_service(
        node, DescribeParameters, '/image_publisher/describe_parameters',
        DescribeParameters.Request(names=names)).descriptors
    assert [found.type for found in described] == [value.type for value in got]
    assert described[0].floating_point_range[0].to_value == 1000.0


REFUSED = (
    ('source', 'pattern:8x8', 'read-only'), ('camera_info_url', '/x', 'read-only'),
    ('rotate', 91, 'give one of 0, 90, 180, 270'),
    ('encoding', 'bgr9', "parameter encoding is 'bgr9'"),
    ('fourcc', 'H264', 'give a supported pixel format'), ('jpeg_quality', 0, 'out of range'),
    ('publish_rate', 2000, 'out of range'), ('publish_rate', '5', 'Wrong parameter type'),
    ('publish_rat', 5.0, 'unknown parameter publish_rat is not used; did you mean publish_rate?'))


def test_a_change_that_cannot_be_is_refused_with_the_reason(start: Start, node: Node) -> None:
    start('img_publisher', source='pattern:64x48')
    for name, value, reason in REFUSED:
        assert reason in set_parameters(node, **{name: value})


# Stamps

@pytest.mark.parametrize(('stamp', 'offset'), [('capture', -12.5), ('publish', 3.0)])
def test_stamps_are_the_time_of_ros_and_rise(
        start: Start, node: Node, stamp: str, offset: float) -> None:
    stamps: list[int] = []
    received: list[int] = []

    def note(message: Image) -> None:
        received.append(node.get_clock().now().nanoseconds)
        stamps.append(nanoseconds(message))

    node.create_subscription(Image, 'video_frames', note, QoSProfile(depth=200))
    began = node.get_clock().now().nanoseconds
    publisher = start('img_publisher', source='pattern:64x48', publish_rate=200, max_frames=100,
                      wait_for_subscribers=1, stamp=stamp, stamp_offset=offset)
    spin_until(node, lambda: len(stamps) == 100)
    assert publisher.finish() == 0, publisher.output
    assert np.diff(stamps).min() > 0
    moments = np.array(stamps) - round(offset * 1e9)
    assert began < moments[0]
    assert (moments < received).all()


@pytest.mark.parametrize(('captured', 'stamp', 'offset', 'expected'), [
    (49.0, 'capture', 0.0, 99.0), (49.0, 'publish', 0.0, 100.0), (49.0, 'capture', -12.5, 86.5),
    (50.0, 'publish', 3.0, 103.0), (40.0, 'capture', -95.0, 1e-9)])
def test_stamps_to_the_nanosecond(
        monkeypatch: pytest.MonkeyPatch, captured: float, stamp: str, offset: float,
        expected: float) -> None:
    monkeypatch.setattr('opencv_tools.ros.publisher.stamps.time',
                        SimpleNamespace(monotonic_ns=lambda: 50 * 10**9))
    clock = ROSClock()
    clock._set_ros_time_is_active(True)
    clock.set_ros_time_override(Time(seconds=100, clock_type=ClockType.ROS_TIME))
    stamper = Stamper(clock)
    stamps = [Time.from_msg(stamper.stamp(int(captured * 1e9), stamp, offset)).nanoseconds
              for _ in range(3)]
    assert stamps == [round(expected * 1e9) + extra for extra in range(3)]


def test_the_subscribers_that_are_awaited_are_given_a_moment(
        node: Node, monkeypatch: pytest.MonkeyPatch) -> None:
    topics = ImageTopics(node, 'video_frames', Calibration('', 'eye', print), NOT_CONFIGURED, 2)
    now = 100.0
    clock = SimpleNamespace(monotonic=lambda: now)
    assert not topics.may_publish()
    first, _ = (node.create_subscription(Image, 'video_frames', print, 10) for _ in range(2))
    spin_until(node, lambda: topics.images.get_subscription_count() == 2)
    monkeypatch.setattr('opencv_tools.ros.publisher.image_topics.time', clock)
    assert [topics.may_publish() for _ in range(2)] == [False, False]
    now += 0.19
    assert not topics.may_publish()
    node.destroy_subscription(first)  # and the time begins anew with the next
    spin_until(node, lambda: topics.images.get_subscription_count() == 1)
    assert not topics.may_publish()
    node.create_subscription(Image, 'video_frames', print, 10)
    spin_until(node, lambda: topics.images.get_subscription_count() == 2)
    assert not topics.may_publish()
    now += 0.19
    assert not topics.may_publish()
    now += 0.02
    assert topics.may_publish()
    now -= 1.0
    assert topics.may_publish()


def test_a_node_without_subscribers_says_so(start: Start) -> None:
    publisher = start('img_publisher', source='pattern', max_frames=5)
    assert publisher.finish() == 0, publisher.output
    assert 'Publishing video frame 1: no subscribers' in publisher.output
    assert 'Published 5 frames' in publisher.output
