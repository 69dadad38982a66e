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
import itertools
from pathlib import Path
import re
import shutil
import signal
import subprocess
import sys
from typing import Any

import av
from calibrations import CALIBRATION
from conftest import (
    call_service, CLIP, CLIP_FRAMES, decode_clip, EXAMPLES, NodeProcess, spin_until)
import cv2
import numpy as np
from opencv_tools.cv_bridge import CvBridge
from opencv_tools.frames import FrameSubscriber
from opencv_tools.transport.message_type import message_type
from opencv_tools.video.messages import cdr_to_video, COMPRESSED_VIDEO
import pytest
from rcl_interfaces.srv import GetParameters, SetParameters
from rclpy.duration import Duration
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.qos import QoSProfile
from sending import create_publisher, stamped
from sensor_msgs.msg import CompressedImage, Image
from sharing import Camera, TOPIC
from std_msgs.msg import String
from waiting import LONGEST_SECONDS, wait_until
import yaml

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


EDGES: dict[str, tuple[str, dict[str, str]]] = {
    'edges': ('edges.py', {}),
    'filtered_frames': ('img_filter', {
        'function': 'cv2:Canny', 'arguments': '50, 150', 'encoding': 'mono8'}),
    'compressed': ('img_filter', {
        'function': 'cv2.Canny', 'arguments': 'threshold1=50, threshold2=150',
        'encoding': 'mono8', 'transport': 'compressed', 'every': 'true'})}


@pytest.mark.thorough
def test_edges_of_the_same_stamp(start: Start, node: Node) -> None:
    sources, *received = receive(node, 'video_frames', *EDGES)
    publisher = start('img_publisher', source='pattern:160x120@20', publish_rate=0.0,
                      jpeg_quality=100)
    filters = [start(name, '--ros-args', '-r', f'filtered_frames:={topic}', '--', **parameters)
               for topic, (name, parameters) in EDGES.items()]
    for topic, results in zip(EDGES, received, strict=True):
        for source, result in wait_for_pairs(node, sources, results):
            expected = cv2.Canny(cv2.cvtColor(source, cv2.COLOR_BGR2GRAY), 50, 150)
            if topic == 'compressed':  # JPEG changes the pixels
                assert result.shape == expected.shape
            else:
                assert np.array_equal(result, expected)
    for filtering in filters:
        filtering.interrupt()
        assert filtering.finish() == 0
    assert publisher.is_running()


@pytest.mark.thorough
def test_interrupted_demo(start: Start, tmp_path: Path) -> None:
    script = tmp_path / 'examples' / 'demo.py'  # a copy, because it writes to the project
    script.parent.mkdir()
    shutil.copy(EXAMPLES / script.name, script)
    (tmp_path / 'test').symlink_to(EXAMPLES.parent / 'test')
    demo = start(str(script))
    demo.wait_for('Receiving video frame 1:')
    demo.interrupt()
    assert demo.finish() == 130
    assert 'Traceback' not in demo.output
    accounts = {line.split(': ')[1].split()[0] for line in demo.output.splitlines()}
    assert {'Published', 'Received'} <= accounts
    assert 'Published 90' not in demo.output  # the nodes were ended


@pytest.mark.thorough
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


@pytest.mark.thorough
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


@pytest.mark.thorough
def test_rectified_images(start: Start, node: Node, tmp_path: Path) -> None:
    (tmp_path / 'front.yaml').write_text(CALIBRATION)
    sources, results = receive(node, 'video_frames', 'rectified')
    start('img_publisher', source='pattern:640x480@20', publish_rate=0.0,
          camera_info_url=f'file://{tmp_path}/front.yaml')
    rectifier = start('rectify.py')
    values = yaml.safe_load(CALIBRATION)
    matrix, projection, rotation, distortion = (np.array(values[name]['data']) for name in (
        'camera_matrix', 'projection_matrix', 'rectification_matrix', 'distortion_coefficients'))
    for source, result in wait_for_pairs(node, sources, results, count=2):
        maps = cv2.initUndistortRectifyMap(
            matrix.reshape(3, 3), distortion, rotation.reshape(3, 3),
            projection.reshape(3, 4)[:, :3], (640, 480), cv2.CV_32FC1)
        expected = cv2.remap(source, *maps, cv2.INTER_LINEAR)
        # OpenCV interpolates at multiples of 1/32 pixel.
        assert np.abs(result.astype(int) - expected).mean() < 1
        assert np.abs(result.astype(int) - source).mean() > 5
    rectifier.interrupt()
    assert rectifier.finish() == 0


@pytest.mark.thorough
def test_images_without_a_calibration(start: Start, node: Node) -> None:
    receive(node, 'rectified')
    start('img_publisher', source='pattern:64x48@20', publish_rate=0.0)
    rectifier = start('rectify.py')
    rectifier.wait_for('the camera_info has no calibration')
    rectifier.interrupt()
    assert rectifier.finish() == 0


@pytest.mark.thorough
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
# What a callback does, the status of the node, and a line that it prints.
RAISED = ("raise RuntimeError('of the user')", 1, 'RuntimeError: of the user')
EXITED = ('sys.exit(3)', 3, 'closed')


@pytest.mark.quick_cases(2)
@pytest.mark.parametrize(('threaded', 'failure', 'status', 'last_line'), [
    (False, *RAISED), (True, *EXITED), (True, *RAISED), (False, *EXITED)])
def test_callback_that_fails_ends_the_node(
        start: Start, tmp_path: Path, threaded: bool, failure: str, status: int,
        last_line: str) -> None:
    start('img_publisher', source='pattern:64x48@20', publish_rate=0.0)
    finished = subprocess.run(
        [sys.executable, '-c', FAILING_NODE.format(threaded=threaded, failure=failure)],
        capture_output=True, text=True, timeout=LONGEST_SECONDS, check=False, cwd=tmp_path)
    assert finished.returncode == status, finished.stderr
    printed = finished.stdout.split()
    assert (printed.count('frame'), printed.count('closed')) == (1, 1)
    assert finished.stderr.count('Traceback') == (status == 1)
    assert last_line in (finished.stdout + finished.stderr).splitlines()


SLOW_NODE = """
import sys, time
from opencv_tools.frames import FrameNode, main

class Slow(FrameNode):
    def __init__(self):
        super().__init__('slow')
        self.receive_frames('video_frames', self.on_frame, every={every})
        self.create_timer(0.01, lambda: print('tick', flush=True))

    def on_frame(self, frame):
        print('frame', flush=True)
        time.sleep(0.1)

sys.exit(main(Slow))
"""


def send_until(process: NodeProcess, camera: Camera, node: Node,
               condition: Callable[[], bool]) -> None:
    """
    Publish until a condition holds, which is looked at after each frame.

    Fails when the process has printed 100 more lines 'frame', one for each frame it received.
    """
    before = process.output.count('frame\n')

    def holds() -> bool:
        camera.send('bgr8')
        count = process.output.count('frame\n') - before
        assert count < 100
        return condition()

    spin_until(node, holds)


@pytest.mark.thorough
@pytest.mark.parametrize('every', [False, True])
@pytest.mark.parametrize('number', [signal.SIGINT, signal.SIGTERM])
def test_callback_slower_than_a_camera_that_shares(
        start: Start, camera: Node, tmp_path: Path, every: bool, number: int) -> None:
    (tmp_path / 'slow.py').write_text(SLOW_NODE.format(every=every))
    ours = Camera(camera)
    slow = start(str(tmp_path / 'slow.py'))
    send_until(slow, ours, camera, lambda: 'frame\n' in slow.output)
    send_until(slow, ours, camera, lambda: not camera.count_subscribers(TOPIC))
    ticks = slow.output.count('tick')
    send_until(slow, ours, camera, lambda: slow.output.count('tick') >= ticks + 5)
    slow.interrupt(number)
    send_until(slow, ours, camera, lambda: not slow.is_running())
    assert slow.finish() == 0


@pytest.mark.thorough
def test_filter_slower_than_a_camera_that_shares(
        start: Start, camera: Node, tmp_path: Path) -> None:
    (tmp_path / 'mine.py').write_text(
        'import time\ndef slow(image):\n    print("frame", flush=True)\n    time.sleep(0.1)\n'
        '    return image\n')
    ours = Camera(camera)
    receive(camera, '/filtered_frames')
    slow = start('img_filter', function='mine:slow')
    send_until(slow, ours, camera, lambda: 'frame\n' in slow.output)
    send_until(slow, ours, camera, lambda: not camera.count_subscribers(TOPIC))
    slow.interrupt()
    send_until(slow, ours, camera, lambda: not slow.is_running())
    assert slow.finish() == 0


@pytest.mark.quick_cases(1)
@pytest.mark.parametrize('transport', ['raw', 'shm'])
def test_mirror_of_the_same_stamp(start: Start, node: Node, transport: str) -> None:
    (sources,) = receive(node, 'video_frames')
    results: dict[int, np.ndarray] = {}
    subscriber = FrameSubscriber(
        node, 'mirrored', lambda frame: results.__setitem__(frame.stamp_ns, frame.image),
        transport=transport)
    start('img_publisher', source='pattern:160x120@20', publish_rate=0.0)
    start('mirror.py')
    for source, result in wait_for_pairs(node, sources, results):
        assert np.array_equal(result, source[:, ::-1])
    subscriber.destroy()


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

def fill(image, factor, out):
    out[:] = factor
"""


@pytest.mark.thorough
def test_function_without_subscribers(start: Start, tmp_path: Path) -> None:
    (tmp_path / 'mine.py').write_text(MODULE)
    start('img_publisher', source='pattern:64x48@20', publish_rate=0.0)
    filtering = start('img_filter', function='mine:broken')
    filtering.wait_for('Filtering video frame 2')
    filtering.interrupt()
    assert filtering.finish() == 0
    output = filtering.output
    assert output.count('and /filtered_frames has none') == 1
    assert re.search(r'Filtering video frame \d+: not filtered .*, \d+ skipped\n', output)
    summary = re.search(
        r'Received (\d+) frames at .* 0 failed, \d+ skipped, (\d+) not filtered without', output)
    assert summary and summary[1] == summary[2]


@pytest.mark.parametrize('encoding', ['bgr8', "''"])
def test_filter_that_loses_bits(start: Start, node: Node, encoding: str) -> None:
    (results,) = receive(node, 'filtered_frames')
    start('img_publisher', source='pattern:64x48@20', publish_rate=0.0, encoding='mono16')
    filtering = start('img_filter', function='cv2:flip', arguments='1', encoding=encoding)
    spin_until(node, lambda: len(results) >= 3)
    filtering.interrupt()
    assert filtering.finish() == 0
    assert filtering.output.count(
        'mono16 images lose 8 bits in bgr8, as the parameter encoding has it; an empty encoding '
        'gives them to the function as they are') == (encoding == 'bgr8')
    assert {image.dtype.name for image in results.values()} == {
        'uint8' if encoding == 'bgr8' else 'uint16'}


def test_video_of_a_filter(start: Start, node: Node, tmp_path: Path) -> None:
    start('img_publisher', source='pattern:96x64@20', publish_rate=0.0)
    start('img_filter', function='cv2:flip', arguments='0', video_bit_rate=400000)
    codecs: list[str] = []
    node.create_subscription(
        message_type(COMPRESSED_VIDEO), 'filtered_frames/foxglove',
        lambda data: codecs.append(cdr_to_video(COMPRESSED_VIDEO, data).codec), 10, raw=True)
    recorder = start('img_subscriber', '--ros-args', '-r', 'video_frames:=filtered_frames', '--',
                     transport='video', output_dir=tmp_path, file_name='a.mkv', max_frames=15)
    assert recorder.finish() == 0, recorder.output
    widths: list[int] = []
    for path in sorted(tmp_path.glob('*.mkv')):  # another one for the real rate of the frames
        with av.open(str(path)) as video:
            widths += [frame.width for frame in video.decode(video=0)]
    assert widths == [96] * 15
    for codec, problem in ('libx264rgb', 'cannot be opened for 96x64 images'), ('h265', ''):
        values: Sequence[Any] = [Parameter('video_codec', value=codec).to_parameter_msg()]
        answer: Any = call_service(node, SetParameters, '/image_filter/set_parameters',
                                   SetParameters.Request(parameters=values))
        result, = answer.results
        assert problem in result.reason and result.successful == (problem == '')
    spin_until(node, lambda: 'h265' in codecs)


def test_filter_without_the_encoder_of_its_video(start: Start) -> None:
    filtering = start('img_filter', function='cv2:flip', arguments='0', video_codec='libx264rgb')
    assert filtering.finish() == 2
    assert "parameter video_codec is 'libx264rgb', but encoder" in filtering.output


def test_filter_with_a_maximum_rate(start: Start, node: Node) -> None:
    (results,) = receive(node, 'filtered_frames')
    start('img_publisher', source='pattern:64x48@20', publish_rate=0.0)
    start('img_filter', function='cv2:flip', arguments='1', every=True, max_rate=4.0)
    spin_until(node, lambda: len(results) >= 8)
    # The first frame may be a period late, and the last one a quarter of it early.
    assert max(results) - min(results) > (len(results) - 2.3) * 10**9 / 4


@pytest.mark.thorough
@pytest.mark.parametrize('function', ['both', 'fill'])
def test_functions_of_the_working_folder(
        start: Start, node: Node, tmp_path: Path, function: str) -> None:
    (tmp_path / 'mine.py').write_text(MODULE)
    (results,) = receive(node, 'filtered_frames')
    start('img_publisher', source='pattern:64x48@20', publish_rate=0.0)
    start('img_filter', function=f'mine:{function}', arguments='factor=7')
    failing = {text: start('img_filter', function=f'mine:{function}') for function, text in (
        ('broken', 'frame not filtered: ValueError: a line and another'),
        ('text', 'frame not filtered: CvBridgeError: the function returned str, not an array'))}
    spin_until(node, lambda: len(results) >= 2)
    assert all((image == 7).all() and image.shape == (48, 64, 3) for image in results.values())
    for text, filtering in failing.items():
        filtering.wait_for(text)
        filtering.interrupt()
        assert filtering.finish() == 1
        assert 'failed' in filtering.output


RESULTS = """
import numpy as np
count = 0

def vary(image):
    global count
    count += 1
    kind = (np.float32, np.int16, np.uint8)[count % 3]
    return np.full((4, 6, 2 if kind is np.uint8 else 1), count, kind)
"""


def test_results_without_a_compressed_form(start: Start, node: Node, tmp_path: Path) -> None:
    (tmp_path / 'mine.py').write_text(RESULTS)
    (results,) = receive(node, 'filtered_frames')
    node.create_subscription(CompressedImage, 'filtered_frames/compressed', print, 10)
    start('img_publisher', source='pattern:64x48@20', publish_rate=0.0)
    filtering = start('img_filter', function='mine:vary', every=True)
    spin_until(node, lambda: len(results) >= 7)
    filtering.interrupt()
    assert filtering.finish() == 0
    values = [int(image.flat[0]) for image in results.values()]
    assert values == [*range(values[0], values[0] + len(values))]
    assert re.search(r'Received \d+ frames at .* Hz: 0 failed', filtering.output)
    assert sorted(re.findall(r'an image of (\w+) cannot be stored as png', filtering.output)) == [
        '16SC1', '32FC1', '8UC2']


RUN_FILTER = """
import sys
from opencv_tools.frames import run_filter


def halve(image):
    print('image', image[0, 0], flush=True)
    return image // 2 if image[0, 0] % 2 == 0 else None

sys.exit(run_filter(halve, 'video_frames', 'halves', encoding='mono8'))
"""


def test_filter_of_a_function(start: Start, node: Node, tmp_path: Path) -> None:
    (tmp_path / 'mine.py').write_text(RUN_FILTER)
    publisher = create_publisher(node)
    filtering = start(str(tmp_path / 'mine.py'))
    spin_until(node, lambda: publisher.get_subscription_count() == 1)
    publisher.publish(stamped(np.full((4, 4), 98, np.uint8), 'mono8', 98))
    wait_until(lambda: publisher.wait_for_all_acked(Duration()))
    for _ in range(2):  # the executor has served the frame before the second answer
        call_service(node, GetParameters, '/img_filter/get_parameters', GetParameters.Request())
    (halves,) = receive(node, 'halves')
    values = itertools.cycle(range(90))

    def has_halves() -> bool:
        value = next(values)
        publisher.publish(stamped(np.full((4, 4), value, np.uint8), 'mono8', value))
        return len(halves) >= 2

    spin_until(node, has_halves)
    filtering.interrupt()
    assert filtering.finish() == 0
    assert 'image 98' not in filtering.output
    assert all(stamp % 2 == 0 and (image == stamp // 2).all() for stamp, image in halves.items())


@pytest.mark.quick_cases(2)
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
