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

"""Calibrations by img_calibrate from live topics of publishers in other processes."""

from __future__ import annotations

from collections.abc import Callable, Iterator
import os
from pathlib import Path
import re
import signal
import subprocess
import sys
from types import SimpleNamespace

from conftest import executable, NodeProcess, spin_until
import cv2
import numpy as np
from numpy.typing import NDArray
from opencv_tools.calibration.boards import parse_board
from opencv_tools.calibration.camera_file import read_camera
from opencv_tools.frames import FramePublisher
from opencv_tools.topic_views import FramePairs
from played_bags import BEGAN_NS
import pytest
from rclpy.node import Node
from rclpy.time import Time
from rendered_boards import Camera, needs_markers, Pose, poses, wide_camera
from shown_boards import BOARD, held_board, RATE
from std_msgs.msg import Header
from waiting import LONGEST_SECONDS, work_of

Start = Callable[..., NodeProcess]

BASELINE = 0.06
#: Python of img_calibrate with a line of the progress for each image that was searched.
EVERY_IMAGE = """
import sys
from opencv_tools.base import progress
from opencv_tools.commands import img_calibrate
progress._SECONDS_BETWEEN_LINES = 0.0
sys.exit(img_calibrate())
"""
_STILL = 3  # images of each place
_APART_NS = 240_000_000  # from one image to the next


@pytest.fixture
def calibrate(tmp_path: Path) -> Iterator[Callable[..., NodeProcess]]:
    """Return a function that starts img_calibrate, which ends with the test."""
    processes: list[NodeProcess] = []

    def _calibrate(*words: object, code: str = '') -> NodeProcess:
        command = [sys.executable, '-c', code] if code else [executable('img_calibrate')]
        processes.append(NodeProcess([*command, *map(str, words)],
                                     tmp_path / 'img_calibrate.log', dict(os.environ)))
        return processes[-1]

    yield _calibrate
    for process in processes:
        process.kill()


def rendered_pairs(camera: Camera, count: int) -> Iterator[list[NDArray[np.uint8]]]:
    """Yield images of a left and a right camera, with a board that is held."""
    board = parse_board(BOARD)
    rotation = cv2.Rodrigues(np.array([0.005, -0.02, 0.01]))[0]
    for place, pose in enumerate(poses(board, camera, count, seed=4)):
        turned = cv2.Rodrigues(rotation @ cv2.Rodrigues(pose.rotation)[0])[0][:, 0]
        right = Pose(turned, rotation @ pose.translation - np.array([BASELINE, 0.0, 0.0]))
        yield [camera.see(board, one, seed=2 * place + side)
               for side, one in enumerate((pose, right))]


def views_of(output: str) -> int:
    """Return the number of views in the last line of the progress."""
    return int((re.findall(r'views: (\d+)', output) or ['0'])[-1])


@pytest.mark.thorough
@needs_markers
@pytest.mark.process
def test_two_cameras_until_all_views_are_there(
        node: Node, calibrate: Callable[..., NodeProcess], tmp_path: Path) -> None:
    pairs = list(rendered_pairs(wide_camera(640, 360), 24))
    publishers = [FramePublisher(node, f'/{side}/image') for side in ('left', 'right')]
    process = calibrate(
        '--topic', '/left/image', '--right-topic', '/right/image', '--board', BOARD,
        '-o', tmp_path / 'left.yaml', '--right-output', tmp_path / 'right.yaml',
        code=EVERY_IMAGE)
    spin_until(node, lambda: not process.is_running()
               or all(publisher.has_subscribers for publisher in publishers))
    number = 0

    def searched() -> int:
        return int((re.findall(r'Image (\d+):', process.output) or ['0'])[-1])

    def publish_what_was_awaited() -> bool:
        nonlocal number
        if searched() == number:  # a pair has the same stamp; each is shown 3 times, 0.24 s apart
            number += 1
            stamp = Time(nanoseconds=BEGAN_NS + number * _APART_NS).to_msg()
            for publisher, image in zip(publishers, pairs[number // _STILL % len(pairs)]):
                publisher.publish(image, Header(stamp=stamp))
        return not process.is_running()

    spin_until(node, publish_what_was_awaited, 'all views', searched=searched,
               work=lambda: work_of(process.pid))
    assert process.finish() == 0, process.output
    assert '\nBaseline: 0.0' in process.output
    left, right = (read_camera(tmp_path / f'{side}.yaml') for side in ('left', 'right'))
    assert -right.p[3] / right.p[0] == pytest.approx(BASELINE, rel=0.005)
    assert left.p[3] == 0 and left.p[:3] == right.p[:3]
    np.testing.assert_allclose(left.k, wide_camera(640, 360).k.ravel(), atol=1.0)


@pytest.mark.thorough
@needs_markers
def test_one_camera_until_an_interrupt(
        start: Start, calibrate: Callable[..., NodeProcess], tmp_path: Path) -> None:
    truth = held_board(tmp_path / 'pictures', 10)
    start('img_publisher', source=tmp_path / 'pictures', publish_rate=RATE, loop=0)
    process = calibrate('--topic', 'video_frames', '--board', BOARD, '-o', tmp_path / 'a.yaml')
    process.wait_until(lambda output: views_of(output) >= 8)
    assert re.search(r'Image \d+: [a-z,: ]+, views: \d', process.output)  # the next step is first
    process.interrupt()
    assert process.finish() == 0, process.output
    np.testing.assert_allclose(read_camera(tmp_path / 'a.yaml').k, truth.k.ravel(), atol=2.0)


@pytest.mark.thorough
def test_cameras_of_different_times(
        start: Start, calibrate: Callable[..., NodeProcess], tmp_path: Path) -> None:
    for side, offset in (('left', 0.0), ('right', 5.0)):
        start('img_publisher', '--ros-args', '-r', f'__ns:=/{side}', '--',
              source='pattern:64x48@20', stamp_offset=offset)
    process = calibrate(
        '--topic', 'left/video_frames', '--right-topic', 'right/video_frames',
        '--board', 'chessboard:9x6:25mm', '-o', tmp_path / 'a.yaml',
        '--right-output', tmp_path / 'b.yaml')
    process.wait_for('warning: the stamps of left/video_frames and right/video_frames differ by ')
    process.interrupt(signal.SIGTERM)
    assert process.finish() == 1
    assert 'error: views with the board: 0; give 4 to 100 images' in process.output
    assert not [*tmp_path.glob('*.yaml')]


@pytest.mark.process
def test_topic_with_an_invalid_name(calibrate: Callable[..., NodeProcess]) -> None:
    process = calibrate('--topic', '/a b', '--board', 'chessboard:9x6:25mm')
    assert process.finish() == 2
    assert "'/a b'" in process.output


@pytest.mark.process
@pytest.mark.parametrize(('name', 'value'), [
    ('ROS_DOMAIN_ID', 'abc'), ('ROS_DOMAIN_ID', '233'), ('RMW_IMPLEMENTATION', 'rmw_none_cpp')])
def test_environment_with_which_ros_cannot_start(
        calibrate: Callable[..., NodeProcess], monkeypatch: pytest.MonkeyPatch, name: str,
        value: str) -> None:
    monkeypatch.setenv(name, value)
    process = calibrate('--topic', '/a', '--board', 'chessboard:9x6:25mm')
    assert process.finish() == 2
    assert f"{name} is '{value}'" in process.output
    assert 'rcl' not in process.output.replace("'rmw_none_cpp'", '')


@pytest.mark.process
def test_topic_without_ros() -> None:
    script = ('import sys; sys.modules["rclpy"] = None\n'
              'from opencv_tools.commands import img_calibrate\nsys.exit(img_calibrate())')
    finished = subprocess.run(
        [sys.executable, '-c', script, '--topic', '/a', '--board', 'chessboard:9x6:25mm'],
        capture_output=True, text=True, timeout=LONGEST_SECONDS, check=False)
    assert finished.returncode == 1
    assert finished.stderr.startswith('img_calibrate: error: live topics need ROS 2, but ')


def frame(milliseconds: int) -> SimpleNamespace:
    return SimpleNamespace(stamp_ns=milliseconds * 1_000_000)


def test_pair_of_frames_that_are_not_the_newest() -> None:
    for camera in (0, 1):
        pairs = FramePairs(2)
        early, late = frame(100), frame(140)
        assert pairs.add(camera, early) == pairs.add(camera, late) == ()
        for one, milliseconds in ((early, 95), (late, 149)):
            other = frame(milliseconds)
            pair = (other, one) if camera else (one, other)
            assert pairs.add(1 - camera, other) == pair
        assert pairs.add(1 - camera, frame(140)) == ()  # each frame is in one pair


def test_pairs_of_frames() -> None:
    pairs = FramePairs(2)
    early, late = frame(100), frame(200)
    assert pairs.add(0, early) == pairs.add(0, late) == ()
    other = frame(209)
    assert pairs.add(1, other) == (late, other)
    assert pairs.add(1, frame(100)) == ()  # it is older than the last pair
    assert pairs.apart == 0.0
    for number in range(1000):  # a bounded number is kept
        assert pairs.add(number % 2, frame(1000 + 11 * number)) == ()
    assert pairs.apart == pytest.approx(0.011)
    one = FramePairs(1)
    assert one.add(0, early) == (early,) and one.apart == 0.0
