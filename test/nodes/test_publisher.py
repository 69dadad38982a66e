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

"""Messages, services and parameters of the publisher."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from conftest import call_service, NodeProcess, set_parameters, spin_until
import cv2
from diagnostic_msgs.msg import DiagnosticArray
from images import draw_pattern
import numpy as np
from opencv_tools.image_codecs import encode_image
from opencv_tools.nodes.publisher.calibration_file import read_camera_info
import pytest
from rcl_interfaces.msg import ParameterEvent, ParameterType
from rcl_interfaces.srv import DescribeParameters, GetParameters
from rclpy.node import Node
from rclpy.parameter import parameter_value_to_python
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.time import Time
from sensor_msgs.msg import CameraInfo, CompressedImage, Image
from sensor_msgs.srv import SetCameraInfo
from std_srvs.srv import SetBool
from waiting import LONGEST_SECONDS

Start = Callable[..., NodeProcess]


def receive(node: Node, message_type: type, topic: str, depth: int = 50) -> list:
    """Return a list that collects the messages of a topic."""
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
    """Create the file p.png and return its pixels."""
    image = draw_pattern(0, 64, 48)
    cv2.imwrite(str(tmp_path / 'p.png'), image)
    return image


FORMATS = {'rgb8': 'rgb8; jpeg compressed bgr8', 'mono8': 'mono8; jpeg compressed mono8',
           'bgr16': 'bgr16; png compressed bgr16', 'bgr8': 'bgr8; jpeg compressed bgr8'}


def test_compressed_frames(start: Start, node: Node, picture: np.ndarray) -> None:
    messages = receive(node, CompressedImage, 'video_frames/compressed')
    start('img_publisher', source='p.png', on_end='loop', publish_rate=50, frame_id='eye')
    for encoding, format_text in FORMATS.items():
        shown = cv2.cvtColor(picture, cv2.COLOR_BGR2GRAY) if encoding == 'mono8' else picture
        expected = (encode_image(shown * np.uint16(257), '.png') if encoding == 'bgr16' else
                    cv2.imencode('.jpg', shown, (cv2.IMWRITE_JPEG_QUALITY, 95))[1]).tobytes()
        assert not set_parameters(node, encoding=encoding)
        wait_for_data(node, messages, expected, format_text)
    assert messages[-1].header.frame_id == 'eye'


def test_change_of_the_jpeg_quality(start: Start, node: Node) -> None:
    messages = receive(node, CompressedImage, 'video_frames/compressed')
    start('img_publisher', source='pattern:320x240@50', publish_rate=0)
    spin_until(node, lambda: len(messages) > 3)
    before = len(messages[-1].data)
    assert not set_parameters(node, jpeg_quality=10)
    spin_until(node, lambda: len(messages[-1].data) < before / 2)


def test_remapped_topics(start: Start, node: Node) -> None:
    infos = receive(node, CameraInfo, '/front/camera_info')
    compressed = receive(node, CompressedImage, '/front/image/compressed')
    start('img_publisher', '--ros-args', '-r', 'video_frames:=/front/image', '--',
          source='pattern')
    spin_until(node, lambda: infos and compressed)


def test_overridden_quality_of_service(start: Start, node: Node) -> None:
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


@pytest.mark.quick_cases(1)
@pytest.mark.parametrize(('size', 'focal_length'), [('640x480', 500.5), ('320x240', 250.25),
                                                    ('640x360', 0.0)])
def test_camera_info_of_each_image(
        start: Start, node: Node, tmp_path: Path, size: str, focal_length: float) -> None:
    (tmp_path / 'front.yaml').write_text(CALIBRATION)
    images, infos = receive(node, Image, 'video_frames'), receive(node, CameraInfo, 'camera_info')
    publisher = start('img_publisher', source=f'pattern:{size}', publish_rate=50,
                      camera_info_url=f'file://{tmp_path}/${{NAME}}.yaml', camera_name='front')

    def paired() -> list[Image]:
        """Return the images since both topics are discovered, up to the newest calibration."""
        return [image for image in images if infos
                and nanoseconds(infos[0]) <= nanoseconds(image) <= nanoseconds(infos[-1])]

    spin_until(node, lambda: len(paired()) > 4)
    stamps = {nanoseconds(info): info for info in infos}
    for image in paired():
        info = stamps[nanoseconds(image)]
        assert info.header == image.header
        assert (info.width, info.height) == (image.width, image.height)
        assert info.k[0] == focal_length
    refused = 'cannot be scaled to images of 640x360' in publisher.output
    assert refused == (focal_length == 0.0)


def test_saved_calibration(
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
    # The file has the calibration of the unrotated camera.
    assert (saved.k[0], saved.k[2], saved.d[2]) == (500.5, 639 - 320.25, -0.001)
    spin_until(node, lambda: infos[-1].k[0] > 0)
    assert (infos[-1].k == sent.k).all()
    assert infos[-1].d == sent.d


def test_refused_calibration(
        start: Start, node: Node, tmp_path: Path) -> None:
    start('img_publisher', source='pattern', camera_info_url='file:///proc/none/front.yaml')
    info = CameraInfo(width=64, height=48, distortion_model='plumb_bob')
    answer = call_service(
        node, SetCameraInfo, '/set_camera_info', SetCameraInfo.Request(camera_info=info))
    assert not answer.success
    assert answer.status_message.startswith('the camera_info has no calibration')
    (tmp_path / 'sent.yaml').write_text(CALIBRATION)
    answer = call_service(node, SetCameraInfo, '/set_camera_info', SetCameraInfo.Request(
        camera_info=read_camera_info(tmp_path / 'sent.yaml')))
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
    assert 0 <= float(values['age'].removesuffix(' ms at most')) < 1000 * LONGEST_SECONDS
    assert values['format'] == 'bgr8 64x48 at 20 Hz'
    assert (values['dropped'], values['missed'], values['reconnects']) == ('0', '0', '0')


def test_diagnostics_of_a_wait_for_subscribers(start: Start, node: Node) -> None:
    messages = receive(node, DiagnosticArray, '/diagnostics')
    start('img_publisher', source='pattern:64x48@20', wait_for_subscribers=1)
    spin_until(node, lambda: bool(messages))
    (status,) = messages[-1].status
    assert (status.level, status.message) == (b'\0', 'waiting for 1 subscriber(s)')
    receive(node, Image, 'video_frames')
    spin_until(node, lambda: messages[-1].status[0].message == 'publishing')


def test_diagnostics_without_a_camera(start: Start, node: Node) -> None:
    messages = receive(node, DiagnosticArray, '/diagnostics')
    start('img_publisher', source=987)
    spin_until(node, lambda: bool(messages))
    (status,) = messages[-1].status
    assert status.level == b'\2'
    assert status.message.startswith('camera /dev/video987 does not exist')


def test_password_of_a_source_is_nowhere(
        start: Start, node: Node, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv('ROS_LOG_DIR', str(tmp_path / 'log'))
    messages = receive(node, DiagnosticArray, '/diagnostics')
    events = receive(node, ParameterEvent, '/parameter_events')
    shown = 'http://***@127.0.0.1:9/x?key=***'
    publisher = start('img_publisher', source='http://me:CANARY@1@127.0.0.1:9/x?key=CANARY2')
    spin_until(node, lambda: bool(messages))
    answer = call_service(node, GetParameters, '/image_publisher/get_parameters',
                          GetParameters.Request(names=['source']))
    assert answer.values[0].string_value == shown
    (status,) = messages[-1].status
    assert status.message.startswith(f'{shown} is not reachable: 127.0.0.1 port 9: ')
    assert {value.key: value.value for value in status.values}['source'] == shown
    assert status.hardware_id == shown
    publisher.interrupt()
    assert publisher.finish() == 0
    assert f'{shown} is not reachable' in publisher.output
    written = [path.read_text(errors='replace') for path in tmp_path.rglob('*') if path.is_file()]
    assert not [text for text in (publisher.output, str(messages), str(events), *written)
                if 'CANARY' in text]


def test_paused_capture(start: Start, node: Node) -> None:
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

    wait_for_pauses(1)  # the frame that was due at the request is published
    paused = node.get_clock().now()
    wait_for_pauses(2)  # time for 100 frames without the pause
    # Earlier frames may still wait in the queue of this node.
    assert [image for image in images if Time.from_msg(image.header.stamp) > paused] == []
    assert call_service(node, SetBool, '/set_capture', SetBool.Request(data=True)).success
    spin_until(node, lambda: len(images) > 3)


ORIENTED = {
    ('horizontal', 0): lambda image: image[:, ::-1], ('vertical', 0): lambda image: image[::-1],
    ('none', 90): lambda image: cv2.rotate(image, cv2.ROTATE_90_CLOCKWISE),
    ('both', 270): lambda image: cv2.rotate(image[::-1, ::-1], cv2.ROTATE_90_COUNTERCLOCKWISE),
}


def test_flipped_and_rotated_frames(start: Start, node: Node, picture: np.ndarray) -> None:
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


def test_changed_parameters(start: Start, node: Node) -> None:
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
    # A frame may be late, but never early.
    spin_until(node, lambda: min(
        np.diff([nanoseconds(image) for image in images[-4:]])) > 0.19e9)


def test_types_of_changed_parameters(start: Start, node: Node) -> None:
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
    ('fourcc', 'HEVC', 'give a supported pixel format'), ('jpeg_quality', 0, 'out of range'),
    ('publish_rate', 2000, 'out of range'), ('publish_rate', '5', 'Wrong parameter type'),
    ('publish_rat', 5.0, 'unknown parameter publish_rat is not used; did you mean publish_rate?'))


def test_refused_changes(start: Start, node: Node) -> None:
    start('img_publisher', source='pattern:64x48')
    for name, value, reason in REFUSED:
        assert reason in set_parameters(node, **{name: value})


@pytest.mark.thorough
@pytest.mark.parametrize(('stamp', 'offset'), [('capture', -12.5), ('publish', 3.0)])
def test_increasing_stamps_in_ros_time(
        start: Start, node: Node, stamp: str, offset: float) -> None:
    stamps: list[int] = []
    received: list[int] = []

    def record(message: Image) -> None:
        received.append(node.get_clock().now().nanoseconds)
        stamps.append(nanoseconds(message))

    node.create_subscription(Image, 'video_frames', record, QoSProfile(depth=200))
    began = node.get_clock().now().nanoseconds
    publisher = start('img_publisher', source='pattern:64x48', publish_rate=200, max_frames=100,
                      wait_for_subscribers=1, stamp=stamp, stamp_offset=offset)
    spin_until(node, lambda: len(stamps) == 100)
    assert publisher.finish() == 0, publisher.output
    assert np.diff(stamps).min() > 0
    moments = np.array(stamps) - round(offset * 1e9)
    assert began < moments[0]
    assert (moments < received).all()


def test_progress_without_subscribers(start: Start) -> None:
    publisher = start('img_publisher', source='pattern', max_frames=5)
    assert publisher.finish() == 0, publisher.output
    assert 'Publishing video frame 1: no subscribers' in publisher.output
    assert 'Published 5 frames' in publisher.output
