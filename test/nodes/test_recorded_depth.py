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

"""Depth that nodes record and publish, bit for bit."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
import struct

from conftest import NodeProcess, read_manifest, recorded_files, spin_until
import cv2
import numpy as np
from opencv_tools.capture.source import open_source
from playback import frames_of
import pytest
from rclpy.node import Node
from rclpy.qos import QoSProfile
from sending import create_publisher, NANO, send, stamped
from sensor_msgs.msg import CompressedImage

Start = Callable[..., NodeProcess]


def depth(number: int, encoding: str) -> np.ndarray:
    random = np.random.default_rng(number)
    if encoding == '32FC1':
        image = random.uniform(0, 9, (23, 37)).astype(np.float32)
        image.flat[:3] = np.nan, np.inf, 1e-40
        return image
    image = random.integers(0, 2**16, (23, 37)).astype(np.uint16)
    image.flat[:3] = 0, 1, 65535
    return image


def read(path: Path) -> np.ndarray:
    return np.load(path) if path.suffix == '.npy' else cv2.imread(
        str(path), cv2.IMREAD_UNCHANGED)


@pytest.mark.quick_cases(2)
@pytest.mark.parametrize(('encoding', 'suffix'), [
    ('32FC1', '.tiff'), ('32FC1', '.npy'), ('16UC1', '.png'), ('16UC1', '.tiff'),
    ('16UC1', '.npy')])
def test_recorded_pictures(
        start: Start, node: Node, tmp_path: Path, encoding: str, suffix: str) -> None:
    publisher = create_publisher(node)
    recorder = start('img_subscriber', output_dir=tmp_path / 'out', on_overflow='block',
                     file_name=f'f{{seq}}{suffix}', max_frames=5)
    send(node, publisher, *(stamped(depth(number, encoding), encoding, NANO + number)
                            for number in range(5)))
    assert recorder.finish() == 0, recorder.output
    for number in range(5):
        found = read(tmp_path / 'out' / f'f{number}{suffix}')
        assert found.tobytes() == depth(number, encoding).tobytes()
        assert found.shape == (23, 37) and found.dtype == depth(0, encoding).dtype


@pytest.mark.quick_cases(1)
@pytest.mark.parametrize('suffix', ['.mkv', '.png', '.tiff', '.npy'])
def test_recorded_topic_of_compressed_depth(
        start: Start, node: Node, tmp_path: Path, suffix: str) -> None:
    publisher = node.create_publisher(
        CompressedImage, '/depth/compressedDepth', QoSProfile(depth=100))
    recorder = start(
        'img_subscriber', '--ros-args', '-r', 'video_frames/compressed:=/depth/compressedDepth',
        transport='compressed', output_dir=tmp_path / 'out', on_overflow='block',
        file_name=f'f{{seq}}{suffix}', max_frames=5)
    spin_until(node, lambda: publisher.get_subscription_count() > 0)
    for number in range(5):
        png = cv2.imencode('.png', depth(number, '16UC1'))[1].tobytes()
        message = CompressedImage(format='16UC1; compressedDepth png')
        message.data = struct.pack('<iff', 0, 0, 0) + png
        message.header.stamp.sec, message.header.stamp.nanosec = 1, number * 40_000_000
        publisher.publish(message)
    assert recorder.finish() == 0, recorder.output
    paths = recorded_files(tmp_path / 'out')
    found = ([frame.image for frame in frames_of(open_source(str(paths[0])))]
             if suffix == '.mkv' else [read(path) for path in paths])
    np.testing.assert_array_equal(found, [depth(number, '16UC1') for number in range(5)])


@pytest.mark.parametrize('encoding', ['16UC1', 'mono16'])
def test_recorded_video_is_published(
        start: Start, node: Node, tmp_path: Path, encoding: str) -> None:
    images = [depth(number, encoding) for number in range(7)]
    publisher = create_publisher(node)
    recorder = start('img_subscriber', output_dir=tmp_path / 'out', on_overflow='block',
                     file_name='clip.mkv', max_frames=7)
    send(node, publisher, *(stamped(image, encoding, NANO + number * 40_000_000)
                            for number, image in enumerate(images)))
    assert recorder.finish() == 0, recorder.output
    node.destroy_publisher(publisher)
    second = start('img_subscriber', output_dir=tmp_path / 'arrays', on_overflow='block',
                   file_name='f{seq}.npy', max_frames=7)
    player = start('img_publisher', source=tmp_path / 'out' / 'clip.mkv', encoding="''",
                   publish_rate=0, wait_for_subscribers=1)
    assert player.finish() == 0, player.output
    assert second.finish() == 0, second.output
    lines = read_manifest(tmp_path / 'arrays')
    assert [line['encoding'] for line in lines] == [encoding] * 7
    np.testing.assert_array_equal(
        [np.load(tmp_path / 'arrays' / line['file']) for line in lines], images)
    times = np.array([line['stamp']['sec'] + line['stamp']['nanosec'] / NANO for line in lines])
    assert np.diff(times).min() > 0.039  # a wait of the publisher makes them longer only


@pytest.mark.thorough
def test_recorded_video_to_look_at(start: Start, node: Node, tmp_path: Path) -> None:
    publisher = create_publisher(node)
    recorder = start('img_subscriber', output_dir=tmp_path / 'out', on_overflow='block',
                     file_name='clip.mkv', max_frames=3, lossy='true', range_low=300.0,
                     range_high=5000.0, colors='turbo')
    image = np.kron([[0, 300, 2650, 5000]], np.ones((32, 32))).astype(np.uint16)
    send(node, publisher, *(stamped(image, '16UC1', NANO + number * 40_000_000)
                            for number in range(3)))
    assert recorder.finish() == 0, recorder.output
    assert [line['stored_encoding'] for line in read_manifest(tmp_path / 'out')] == ['h264']
    for frame in frames_of(open_source(str(tmp_path / 'out' / 'clip.mkv'))):
        np.testing.assert_allclose(
            frame.image[16, 16::32].astype(int),
            [(0, 0, 0), (59, 18, 48), (60, 252, 164), (3, 4, 122)], atol=12)
