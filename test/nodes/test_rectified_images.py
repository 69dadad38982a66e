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

"""Rectified images of the publisher: topics, transports, calibrations and changes."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

from calibrations import CALIBRATION
from conftest import NodeProcess, set_parameters, spin_until
import cv2
from images import random_image
import numpy as np
from opencv_tools.bags.schemas import CAMERA_INFO
from opencv_tools.cv_bridge import CvBridge
from opencv_tools.frames import Frame, FrameSubscriber
from opencv_tools.image.encodings import find_encoding
from opencv_tools.rectification import Rectifier
from played_bags import Entry, image_entry, write_mcap
import pytest
from rclpy.node import Node
from rclpy.serialization import serialize_message
from rclpy.time import Time
from sensor_msgs.msg import CameraInfo, CompressedImage, Image

Start = Callable[..., NodeProcess]
RECTIFIED_INFO = 'image_rect/camera_info'


def receive(node: Node, message_type: type, topic: str) -> dict[int, Any]:
    """Return a dictionary that collects the messages of a topic by their stamps."""
    messages: dict[int, Any] = {}

    def add(message: Any) -> None:
        messages[Time.from_msg(message.header.stamp).nanoseconds] = message

    node.create_subscription(message_type, topic, add, 50)
    return messages


def common(*received: dict[int, Any]) -> list[int]:
    return sorted(set.intersection(*map(set, received)))


def check_pixels(image: Image, info: CameraInfo, rectified: Image) -> None:
    """Check that an image was rectified by its camera_info."""
    raw = CvBridge().imgmsg_to_cv2(image)
    expected, encoding = Rectifier().rectify(raw, find_encoding(image.encoding), info)
    assert rectified.encoding == encoding.name
    assert rectified.header == image.header
    assert np.array_equal(CvBridge().imgmsg_to_cv2(rectified), expected)
    assert not np.array_equal(raw, expected)


@pytest.fixture
def calibration(tmp_path: Path) -> str:
    """Write a calibration for images of 640x480 pixels, and return its URL."""
    (tmp_path / 'front.yaml').write_text(CALIBRATION)
    return f'file://{tmp_path}/front.yaml'


@pytest.mark.quick_cases(1)
@pytest.mark.parametrize('turn', [
    {}, {'flip': 'horizontal', 'rotate': 90}, {'encoding': 'mono16'}],
    ids=['unturned', 'turned', 'mono16'])
def test_rectified_images_and_their_calibration(
        start: Start, node: Node, calibration: str, turn: dict[str, Any]) -> None:
    images, infos = receive(node, Image, 'video_frames'), receive(node, CameraInfo, 'camera_info')
    rectified = receive(node, Image, 'image_rect')
    rectified_infos = receive(node, CameraInfo, RECTIFIED_INFO)
    publisher = start('img_publisher', source='pattern:640x480@20', publish_rate=0,
                      camera_info_url=calibration, rectify='true', **turn)
    spin_until(node, lambda: len(common(images, infos, rectified, rectified_infos)) > 2)
    for stamp in common(images, infos, rectified, rectified_infos)[:3]:
        check_pixels(images[stamp], infos[stamp], rectified[stamp])
        info, of_rectified = infos[stamp], rectified_infos[stamp]
        assert of_rectified.header == info.header
        assert (of_rectified.width, of_rectified.height) == (info.width, info.height)
        assert not any(of_rectified.d) and any(info.d)
        assert np.array_equal(of_rectified.k.reshape(3, 3), info.p.reshape(3, 4)[:, :3])
        assert np.array_equal(of_rectified.p, info.p)
        assert np.array_equal(of_rectified.r.reshape(3, 3), np.eye(3))
    assert '[ERROR]' not in publisher.output


@pytest.mark.quick_cases(1)
@pytest.mark.parametrize('transport', ['shm', 'compressed', 'video'])
def test_transports_of_rectified_images(
        start: Start, node: Node, calibration: str, transport: str) -> None:
    frames: list[Frame] = []
    subscriber = FrameSubscriber(node, 'image_rect', frames.append, transport=transport)
    start('img_publisher', source='pattern:640x480@20', publish_rate=0, rectify='true',
          camera_info_url=calibration)
    spin_until(node, lambda: len(frames) > 3)
    subscriber.destroy()
    # The corners of the rectified images show no pixel of the raw ones.
    assert {frame.image.shape for frame in frames} == {(480, 640, 3)}
    assert frames[-1].image[:3, :3].max() < 40 < frames[-1].image[100:400, 100:500].max()


def test_remapped_names(start: Start, node: Node, calibration: str) -> None:
    beside = receive(node, Image, '/front/image_rect')
    below = receive(node, CameraInfo, '/front/image_rect/camera_info')
    compressed = receive(node, CompressedImage, '/front/image_rect/compressed')
    start('img_publisher', '--ros-args', '-r', 'video_frames:=/front/image', '--',
          source='pattern:640x480', camera_info_url=calibration, rectify='true')
    spin_until(node, lambda: bool(beside and below and compressed))


def test_each_name_can_be_remapped(start: Start, node: Node, calibration: str) -> None:
    images = receive(node, Image, '/a/straight')
    infos, compressed = receive(node, CameraInfo, '/b/info'), receive(
        node, CompressedImage, '/a/straight/compressed')
    start('img_publisher', '--ros-args', '-r', 'image_rect:=/a/straight',
          '-r', '/a/straight/camera_info:=/b/info', '--', source='pattern:640x480',
          camera_info_url=calibration, rectify='true')
    spin_until(node, lambda: bool(images and infos and compressed))


def test_one_name_for_both_images(start: Start, node: Node) -> None:
    publisher = start('img_publisher', '--ros-args', '-r', 'video_frames:=image_rect', '--',
                      source='pattern', rectify='true')
    assert publisher.finish() == 2
    assert 'but /image_rect is the topic of the images' in publisher.output


def test_images_without_a_calibration(start: Start, node: Node) -> None:
    images, rectified = receive(node, Image, 'video_frames'), receive(node, Image, 'image_rect')
    infos = receive(node, CameraInfo, RECTIFIED_INFO)
    publisher = start('img_publisher', source='pattern:64x48@50', publish_rate=0, rectify='true')
    publisher.wait_for('/image_rect is not published: the camera_info has no calibration')
    spin_until(node, lambda: len(images) > 20)
    assert not rectified and not infos
    assert publisher.output.count('[ERROR]') == 1
    assert 'camera_info_url names the file of the calibration' in publisher.output


def test_changes_of_the_parameter(start: Start, node: Node, calibration: str) -> None:
    images = receive(node, Image, 'video_frames')
    publisher = start('img_publisher', source='pattern:640x480@20', publish_rate=0,
                      camera_info_url=calibration)
    spin_until(node, lambda: bool(images))
    assert not node.get_publishers_info_by_topic('/image_rect')
    rectified = receive(node, Image, 'image_rect')
    for _ in range(2):
        rectified.clear()
        assert set_parameters(node, rectify=True) == ''
        spin_until(node, lambda: len(rectified) > 3)
        assert set_parameters(node, rectify=False) == ''
        spin_until(node, lambda: not node.get_publishers_info_by_topic('/image_rect'))
    count = len(images)
    spin_until(node, lambda: len(images) > count + 5)
    assert '[ERROR]' not in publisher.output


def test_awaited_subscriber_of_rectified_images(
        start: Start, node: Node, tmp_path: Path, calibration: str) -> None:
    cv2.imwrite(str(tmp_path / 'a.png'), random_image('bgr8', 480, 640))
    rectified = receive(node, Image, 'image_rect')
    publisher = start('img_publisher', source='a.png', camera_info_url=calibration,
                      rectify='true', wait_for_subscribers=1)
    assert publisher.finish() == 0
    spin_until(node, lambda: len(rectified) == 1)


def write_bag(path: Path, images: list[np.ndarray], encoding: str, info: CameraInfo) -> None:
    """Write images, each with the same calibration."""
    entries = []
    for number, image in enumerate(images):
        entry = image_entry(number, image, encoding)
        info.header.stamp = Time(nanoseconds=entry.log_ns - 7_000_000).to_msg()
        entries += [entry, Entry(entry.log_ns + 1, serialize_message(info),
                                 '/camera/camera_info', CAMERA_INFO)]
    write_mcap(path, entries)


@pytest.mark.quick_cases(1)
@pytest.mark.parametrize('encoding', ['mono8', 'yuyv', 'bayer_rggb8', '16UC1'])
def test_calibration_of_a_bag(
        start: Start, node: Node, tmp_path: Path, encoding: str) -> None:
    info = CameraInfo(
        width=64, height=48, distortion_model='plumb_bob', d=[-0.3, 0.1, 0.0, 0.0, 0.0],
        k=[60.0, 0, 31, 0, 60, 23, 0, 0, 1], r=np.eye(3).ravel(),
        p=[50.0, 0, 31, 0, 0, 50, 23, 0, 0, 0, 1, 0])
    write_bag(tmp_path / 'a.mcap', [random_image(encoding, 48, 64) for _ in range(3)], encoding,
              info)
    images, rectified = receive(node, Image, 'video_frames'), receive(node, Image, 'image_rect')
    publisher = start('img_publisher', source='a.mcap', encoding="''", publish_rate=0,
                      rectify='true', wait_for_subscribers=2, stamp='original')
    assert publisher.finish() == 0
    spin_until(node, lambda: len(common(images, rectified)) == 3)
    for stamp in common(images, rectified):
        check_pixels(images[stamp], info, rectified[stamp])


@pytest.mark.quick_cases(1)
@pytest.mark.parametrize(('fields', 'reason'), [
    ({'d': [float('nan')] * 5}, 'D of the camera_info has the value nan: give finite numbers'),
    ({'width': 2**32 - 1}, 'but its camera_info is for 4294967295x48 pixels')])
def test_unusable_calibration_of_a_bag(
        start: Start, node: Node, tmp_path: Path, fields: dict[str, Any], reason: str) -> None:
    info = CameraInfo(**{
        'width': 64, 'height': 48, 'distortion_model': 'plumb_bob', 'r': np.eye(3).ravel(),
        'k': [60.0, 0, 31, 0, 60, 23, 0, 0, 1],
        'p': [50.0, 0, 31, 0, 0, 50, 23, 0, 0, 0, 1, 0]} | fields)
    write_bag(tmp_path / 'a.mcap', [random_image('mono8', 48, 64)] * 9, 'mono8', info)
    images, rectified = receive(node, Image, 'video_frames'), receive(node, Image, 'image_rect')
    publisher = start('img_publisher', source='a.mcap', publish_rate=50, rectify='true',
                      wait_for_subscribers=2)
    assert publisher.finish() == 0
    spin_until(node, lambda: len(images) == 9)
    assert not rectified
    assert publisher.output.count('/image_rect is not published: ') == 1
    assert reason in publisher.output


@pytest.mark.parametrize('suffix', ['png', 'tiff'])
def test_files_of_mono16_are_rectified_as_depth(
        start: Start, node: Node, calibration: str, tmp_path: Path, suffix: str) -> None:
    depth = np.empty((480, 640), np.uint16)
    depth[:] = np.where(np.arange(640) % 37 < 20, 1000, 3000)  # edges between 1 and 3 m
    cv2.imwrite(str(tmp_path / f'depth.{suffix}'), depth)
    images, rectified = (receive(node, Image, topic) for topic in ('video_frames', 'image_rect'))
    publisher = start('img_publisher', source=tmp_path / f'depth.{suffix}', encoding='16UC1',
                      camera_info_url=calibration, rectify=True, wait_for_subscribers=2)
    spin_until(node, lambda: common(images, rectified))
    stamp = common(images, rectified)[0]
    assert images[stamp].encoding == rectified[stamp].encoding == '16UC1'
    raw, found = (CvBridge().imgmsg_to_cv2(one[stamp]) for one in (images, rectified))
    assert np.array_equal(raw, depth) and not np.array_equal(found, depth)
    assert {*np.unique(found)} <= {0, 1000, 3000}
    publisher.interrupt()
    assert publisher.finish() == 0, publisher.output
