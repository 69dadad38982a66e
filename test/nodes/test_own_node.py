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

"""The examples of a user's own node, and img_filter, as processes."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
import subprocess
import sys
from typing import Any

from conftest import (
    call_service, CLIP, CLIP_FRAMES, DEADLINE, decode_clip, NodeProcess, spin_until)
import cv2
import numpy as np
from opencv_tools.cv_bridge import CvBridge
import pytest
from rcl_interfaces.srv import SetParameters
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.qos import QoSProfile
from sensor_msgs.msg import Image
from std_msgs.msg import String

Start = Callable[..., NodeProcess]


def receive(node: Node, *topics: str) -> list[dict[int, np.ndarray]]:
    """Subscribe to topics, and return a dictionary of images by stamp for each."""
    collected: list[dict[int, np.ndarray]] = []
    for topic in topics:
        images: dict[int, np.ndarray] = {}

        def add(message: Image, images: dict[int, np.ndarray] = images) -> None:
            stamp = message.header.stamp
            images[stamp.sec * 10**9 + stamp.nanosec] = CvBridge().imgmsg_to_cv2(message).copy()

        node.create_subscription(Image, topic, add, QoSProfile(depth=50))
        collected.append(images)
    return collected


def wait_for_pairs(node: Node, sources: dict[int, np.ndarray], results: dict[int, np.ndarray],
                   count: int = 5) -> list[tuple[np.ndarray, np.ndarray]]:
    spin_until(node, lambda: len(sources.keys() & results.keys()) >= count)
    return [(sources[stamp], results[stamp]) for stamp in sources.keys() & results.keys()]


def has_image(images: dict[int, np.ndarray], expected: np.ndarray) -> bool:
    return any(np.array_equal(image, expected) for image in images.values())


@pytest.mark.parametrize('arguments', [
    ('edges.py', {}),
    ('img_filter', {'function': 'cv2:Canny', 'arguments': '50, 150', 'encoding': 'mono8'}),
    ('img_filter', {'function': 'cv2.Canny', 'arguments': 'threshold1=50, threshold2=150',
                    'encoding': 'mono8', 'transport': 'compressed', 'every': 'true'})],
    ids=['edges', 'img_filter', 'compressed'])
def test_edges_of_the_same_stamp(start: Start, node: Node,
                                 arguments: tuple[str, dict[str, str]]) -> None:
    name, parameters = arguments
    topic = 'edges' if name == 'edges.py' else 'filtered_frames'
    sources, results = receive(node, 'video_frames', topic)
    publisher = start('img_publisher', source='pattern:160x120@20', publish_rate=0.0,
                      jpeg_quality=100)
    filtering = start(name, **parameters)
    for source, result in wait_for_pairs(node, sources, results):
        expected = cv2.Canny(cv2.cvtColor(source, cv2.COLOR_BGR2GRAY), 50, 150)
        if 'transport' in parameters:  # JPEG changes the pixels
            assert result.shape == expected.shape
        else:
            assert np.array_equal(result, expected)
    filtering.interrupt()
    assert filtering.finish() == 0
    assert publisher.is_running()


def test_slow_detector(start: Start, node: Node) -> None:
    texts: list[str] = []
    node.create_subscription(String, 'detections', lambda message: texts.append(message.data), 10)
    start('img_publisher', source='pattern:640x480@60', publish_rate=0.0)
    detector = start('slow_detector.py')
    spin_until(node, lambda: len(texts) >= 3)
    detector.wait_for('frames searched')
    detector.interrupt()
    assert detector.finish() == 0
    assert set(texts) == {''}


def test_two_cameras(start: Start, node: Node) -> None:
    lefts, rights, both = receive(node, 'left/video_frames', 'right/video_frames', 'both')
    for side in ('left', 'right'):
        start('img_publisher', '--ros-args', '-r', f'__ns:=/{side}', '--',
              source='pattern:64x48@20', publish_rate=0.0)
    cameras = start('two_cameras.py')
    # A right image may have been published before this node was discovered.
    spin_until(node, lambda: sum(
        stamp in lefts and has_image(rights, pair[:, 64:]) for stamp, pair in both.items()) >= 5)
    for left, pair in wait_for_pairs(node, lefts, both):
        assert np.array_equal(pair[:, :64], left)
    cameras.interrupt()
    assert cameras.finish() == 0


def test_brightness_of_every_frame(start: Start, tmp_path: Path) -> None:
    brightness = start('brightness.py')
    publisher = start('img_publisher', source=CLIP, publish_rate=0.0, wait_for_subscribers=1)
    assert publisher.finish() == 0
    path = tmp_path / 'brightness.csv'
    brightness.wait_until(lambda _: path.read_text().count('\n') == CLIP_FRAMES)
    brightness.interrupt()
    assert brightness.finish() == 0
    lines = [line.split(',') for line in path.read_text().splitlines()]
    stamps = [int(stamp) for stamp, _ in lines]
    assert stamps == sorted(set(stamps))
    assert [mean for _, mean in lines] == [
        f'{cv2.cvtColor(frame, cv2.COLOR_BGR2GRAY).mean():.3f}' for frame in decode_clip()]


FAILING_NODE = """
import sys
from opencv_tools.frames import FrameNode, main

class Failing(FrameNode):
    def __init__(self):
        super().__init__('failing')
        self.receive_frames('video_frames', self.on_frame, threaded={threaded})

    def on_frame(self, frame):
        print('frame', frame.stamp_ns)
        {failure}

    def close(self):
        status = super().close()
        print('closed')
        return status

sys.exit(main(Failing))
"""


@pytest.mark.parametrize('threaded', [False, True])
@pytest.mark.parametrize(('failure', 'status', 'last_line'), [
    ("raise RuntimeError('of the user')", 1, 'RuntimeError: of the user'),
    ('sys.exit(3)', 3, 'closed')], ids=['exception', 'exit'])
@pytest.mark.process
def test_callback_that_fails_ends_the_node(
        start: Start, tmp_path: Path, threaded: bool, failure: str, status: int,
        last_line: str) -> None:
    program = FAILING_NODE.format(threaded=threaded, failure=failure)
    start('img_publisher', source='pattern:64x48@20', publish_rate=0.0)
    finished = subprocess.run([sys.executable, '-c', program], capture_output=True, text=True,
                              timeout=DEADLINE, check=False, cwd=tmp_path)
    assert finished.returncode == status
    printed = finished.stdout.split()
    assert (printed.count('frame'), printed.count('closed')) == (1, 1)
    assert finished.stderr.count('Traceback') == (status == 1)
    assert last_line in (finished.stdout + finished.stderr).splitlines()


MODULE = """
import numpy as np

def broken(image):
    raise ValueError('a line\\nand another')

def nothing(image):
    return None

def text(image):
    return 'text'

def both(image, factor=1):
    return factor, np.full_like(image, factor)
"""


@pytest.mark.parametrize(('function', 'text'), [
    ('broken', 'frame not filtered: ValueError: a line and another'),
    ('text', 'frame not filtered: CvBridgeError: the function returned str, not an array')])
def test_function_that_fails(start: Start, node: Node, tmp_path: Path, function: str,
                             text: str) -> None:
    (tmp_path / 'mine.py').write_text(MODULE)
    receive(node, 'filtered_frames')
    start('img_publisher', source='pattern:64x48@20', publish_rate=0.0)
    filtering = start('img_filter', function=f'mine:{function}')
    filtering.wait_for(text)
    filtering.interrupt()
    assert filtering.finish() == 1
    assert 'failed' in filtering.output


def test_function_of_the_working_folder(start: Start, node: Node, tmp_path: Path) -> None:
    (tmp_path / 'mine.py').write_text(MODULE)
    (results,) = receive(node, 'filtered_frames')
    start('img_publisher', source='pattern:64x48@20', publish_rate=0.0)
    start('img_filter', function='mine:both', arguments='factor=7')
    spin_until(node, lambda: len(results) >= 2)
    assert all((image == 7).all() and image.shape == (48, 64, 3) for image in results.values())


@pytest.mark.parametrize(('parameters', 'text'), [
    ({}, "parameter function is '': give module:function, for example cv2:Canny"),
    ({'function': 'cv2:Cany'}, "AttributeError: module 'cv2' has no attribute 'Cany'"),
    ({'function': 'no_such_module:f'}, "No module named 'no_such_module'"),
    ({'function': 'cv2:__version__'}, 'it is not a function'),
    ({'function': 'cv2:flip', 'arguments': '1, [2'}, "parameter arguments is '1, [2'"),
    ({'function': 'cv2:flip', 'encoding': 'bgr9'}, 'bgr9'),
    ({'functon': 'cv2:flip'}, 'functon')], ids=[
        'none', 'no function', 'no module', 'text', 'arguments', 'encoding', 'name'])
def test_refused_parameters(start: Start, parameters: dict[str, Any], text: str) -> None:
    filtering = start('img_filter', **parameters)
    assert filtering.finish() == 2
    assert text in filtering.output
    assert len(filtering.output.splitlines()) == 1


def test_function_cannot_be_changed(start: Start, node: Node) -> None:
    start('img_filter', function='cv2:flip', arguments='1')
    values: Sequence[Any] = [Parameter('function', value='os:system').to_parameter_msg()]
    answer: Any = call_service(node, SetParameters, '/image_filter/set_parameters',
                               SetParameters.Request(parameters=values))
    assert not answer.results[0].successful
