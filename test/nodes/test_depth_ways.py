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

"""Depth from each publisher over each transport to each file, bag and function, exactly."""

from __future__ import annotations

from collections.abc import Callable
import itertools
from pathlib import Path
from typing import Any

from conftest import NodeProcess, spin_until
import cv2
import numpy as np
from numpy.typing import NDArray
from opencv_tools.capture.frame import CapturedFrame
from opencv_tools.capture.output_image import depth_form, OutputImage
from opencv_tools.capture.pattern import PatternSource, PatternSpec
from opencv_tools.capture.settings import CaptureSettings
from opencv_tools.capture.source import open_source
from opencv_tools.frames import DepthSettings, Frame, FramePublisher, FrameSubscriber
from played_bags import compressed_entry, write_mcap
import pytest
from rclpy.node import Node
from sensor_msgs.msg import CompressedImage

Start = Callable[..., NodeProcess]
COUNT = 5
WAYS = [('raw', 'png'), ('compressed', 'png'), ('compressedDepth', 'png'),
        ('compressedDepth', 'rvl'), ('auto', 'png')]
FILES = ('depth_{seq}.png', 'depth_{seq}.tiff', 'depth_{seq}.npy', 'depth.mcap')
CASES = sorted(itertools.product(WAYS, FILES), key=lambda case: (
    WAYS.index(case[0]) - FILES.index(case[1])) % 5)


def pattern(width: int, height: int) -> list[NDArray[np.uint16]]:
    source = PatternSource(PatternSpec(width, height, is_depth=True))
    return [source.read().image for _ in range(COUNT)]


def read_images(folder: Path) -> list[NDArray[Any]]:
    """Return the images of the files of a recording, in their order."""
    paths = sorted(path for path in folder.iterdir() if path.suffix != '.jsonl')
    if paths[0].suffix == '.npy':
        return [*map(np.load, paths)]
    if paths[0].suffix == '.mcap':
        source = open_source(str(paths[0]))
        return [OutputImage(frame, CaptureSettings()).image
                for frame in iter(source.read, None)][:COUNT]
    return [cv2.imread(str(path), cv2.IMREAD_UNCHANGED) for path in paths]


@pytest.mark.quick_cases(5)
@pytest.mark.parametrize(('way', 'file_name'), CASES)
def test_depth_is_recorded_exactly(
        start: Start, tmp_path: Path, way: tuple[str, str], file_name: str) -> None:
    transport, codec = way
    subscriber = start('img_subscriber', output_dir=tmp_path / 'out', file_name=file_name,
                       transport=transport, max_frames=COUNT, on_overflow='block')
    publisher = start('img_publisher', source='pattern:depth:66x49', encoding="''",
                      publish_rate=0, max_frames=COUNT, wait_for_subscribers=1,
                      depth_format=codec)
    assert publisher.finish() == 0, publisher.output
    assert f'Published {COUNT} frames' in publisher.output
    assert 'without subscribers' not in publisher.output and 'in no form' not in publisher.output
    assert subscriber.finish() == 0, subscriber.output
    images = read_images(tmp_path / 'out')
    for found, expected in zip(images, pattern(66, 49), strict=True):
        assert found.dtype == np.uint16 and np.array_equal(found, expected)


def test_topic_of_depth_exists_while_frames_have_depth(
        node: Node, camera: Node, capfd: pytest.CaptureFixture[str]) -> None:
    publisher = FramePublisher(camera, 'image', depth=DepthSettings('rvl'))
    topic = '/front/image/compressedDepth'
    publisher.publish(np.zeros((4, 6, 3), np.uint8))
    assert not node.count_publishers(topic)
    received: list[CompressedImage] = []
    node.create_subscription(CompressedImage, topic, received.append, 10)
    spin_until(node, lambda: publisher.has_subscribers)
    publisher.publish(np.zeros((4, 6, 3), np.uint8))
    assert publisher.without_form == 1
    assert f'{topic} has no frames: an image of bgr8 has no depth' in capfd.readouterr().err
    for number in range(3):
        publisher.publish(np.full((4, 6), number + 1, np.uint16))
    spin_until(node, lambda: len(received) == 3)
    assert {one.format for one in received} == {'16UC1; compressedDepth rvl'}
    assert publisher.without_form == 1
    for _ in range(10):
        publisher.publish(np.zeros((4, 6), np.uint8))
    spin_until(node, lambda: not node.count_publishers(topic))
    publisher.destroy()


@pytest.mark.parametrize('codec', ['png', 'rvl'])
@pytest.mark.parametrize(('encoding', 'error'), [('16UC1', 0), ('mono16', 0), ('32FC1', 0.02)])
@pytest.mark.parametrize('transport', ['raw', 'compressedDepth', 'shm'])
def test_function_gets_depth(
        node: Node, camera: Node, encoding: str, error: float, transport: str, codec: str) -> None:
    publisher = FramePublisher(camera, 'image', depth=DepthSettings(codec))
    frames: list[Frame] = []
    subscriber = FrameSubscriber(
        node, '/front/image', frames.append, encoding='', transport=transport, every=True)
    spin_until(node, lambda: publisher.has_subscribers)
    numbers = np.random.default_rng(3).integers(200, 9000, (31, 45))
    numbers[:5, :7] = 0
    image = (numbers / 1000).astype('f4') if encoding == '32FC1' else numbers.astype('u2')

    def publish() -> bool:
        if not frames:
            publisher.publish(image, encoding=encoding)
        return bool(frames)

    spin_until(node, publish)
    assert frames[0].encoding == encoding
    found = np.nan_to_num(frames[0].image)
    allowed = error if transport == 'compressedDepth' else 0
    assert np.abs(found.astype(float) - image).max() <= allowed
    subscriber.destroy()
    publisher.destroy()


@pytest.mark.parametrize(('transport', 'is_kept'), [
    ('compressedDepth', True), ('raw', False), ('compressed', False)])
def test_depth_of_a_bag_is_played(
        start: Start, tmp_path: Path, transport: str, is_kept: bool) -> None:
    expected = pattern(33, 20)
    entries = []
    for number, image in enumerate(expected, 1):
        output = OutputImage(CapturedFrame(image, '16UC1'), CaptureSettings(depth_format='rvl'))
        entries.append(compressed_entry(number, *depth_form(output)))
    path = write_mcap(tmp_path / 'a.mcap', entries)
    subscriber = start('img_subscriber', output_dir=tmp_path / 'out', file_name='b.mcap',
                       transport=transport, max_frames=COUNT, on_overflow='block')
    publisher = start('img_publisher', source=path, encoding="''", publish_rate=0,
                      wait_for_subscribers=1, depth_format='png')
    assert publisher.finish() == 0, publisher.output
    assert subscriber.finish() == 0, subscriber.output
    source = open_source(str(tmp_path / 'out' / 'b.mcap'))
    frames = [*iter(source.read, None)][:COUNT]
    for frame, image, entry in zip(frames, expected, entries, strict=True):
        assert np.array_equal(OutputImage(frame, CaptureSettings()).image, image)
        assert (frame.image.tobytes() in entry.data) == is_kept
