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

"""
The nodes with a real V4L2 driver, ``vivid``, in the machine that ``machine.py`` boots.

Each test prints the figures of its scenario. What the driver does is asked of others than this
package: of v4l2-ctl and of the kernel's own trace.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
import os
from pathlib import Path
import re
import signal
import subprocess
import time

from conftest import (
    call_service, executable, NodeProcess, recorded_files, set_parameters, spin_until)
import cv2
import numpy as np
from opencv_tools.calibration.boards import parse_board
from opencv_tools.calibration.camera_file import read_camera, StoredCamera, write_camera
from opencv_tools.capture.errors import CaptureError
from opencv_tools.capture.v4l2.camera import CameraSource
from opencv_tools.capture.v4l2.modes import CameraRequest
import pytest
from rcl_interfaces.srv import DescribeParameters, GetParameters
import rclpy
from rclpy.context import Context
from rclpy.node import Node
from rclpy.parameter import parameter_value_to_python
from rclpy.time import Time
from rendered_boards import poses, wide_camera
from sensor_msgs.msg import CameraInfo, Image
from std_srvs.srv import SetBool
from waiting import LONGEST_SECONDS, pause

Start = Callable[..., NodeProcess]

BACK = 'is back after'
WEBCAM = ('n_devs=1', 'node_types=0x1', 'num_inputs=1', 'input_types=0x0')
# The node types as below, an HDMI input and an HDMI output.
LOOP = ('n_devs=1', 'node_types=0x101', 'num_inputs=1', 'input_types=0x3', 'num_outputs=1',
        'output_types=0x1')
VIDEO = Path('/dev/video0')
OUTPUT = Path('/dev/video1')
DRIVER = Path('/sys/bus/platform/drivers/vivid')
TRACE = Path('/sys/kernel/tracing')
PERIOD = 0.04  # seconds between frames of 640x480


def tell(scenario: str, figures: str) -> None:
    print(f'\n  {scenario}: {figures}', flush=True)


def run(*command: object) -> str:
    return subprocess.run([str(word) for word in command], check=True, text=True,
                          stdout=subprocess.PIPE, timeout=LONGEST_SECONDS).stdout


def control(*assignments: str) -> None:
    """Set controls of the camera as another program."""
    run('v4l2-ctl', '-d', VIDEO, '-c', ','.join(assignments))


def plug_in() -> None:
    DRIVER.joinpath('bind').write_text('vivid.0')


def unplug() -> None:
    DRIVER.joinpath('unbind').write_text('vivid.0')


@pytest.fixture(scope='module', autouse=True)
def driver() -> None:
    """Load the driver: one webcam."""
    run('modprobe', 'vivid', *WEBCAM)


@pytest.fixture(autouse=True)
def camera(driver: None) -> Iterator[None]:
    """Leave a camera behind as it was found: plugged in, with nothing wrong."""
    yield
    control('percentage_of_dropped_buffers=0', 'test_pattern=0', 'osd_text_mode=0')


class Viewer:
    """A subscriber that keeps images, and when they were published."""

    def __init__(self, node: Node) -> None:
        self.node = node
        self.images: list[Image] = []
        self.published: list[float] = []
        node.create_subscription(Image, 'video_frames', self._take, 10)

    def _take(self, image: Image, info: dict[str, int]) -> None:
        self.images.append(image)
        self.published.append(info['source_timestamp'] / 1e9)

    def wait_for(self, count: int) -> list[Image]:
        """Receive the next images."""
        first = len(self.images)
        spin_until(self.node, lambda: len(self.images) >= first + count)
        return self.images[first:first + count]

    def stamps(self) -> list[float]:
        return [Time.from_msg(image.header.stamp).nanoseconds / 1e9 for image in self.images]

    def ages(self) -> np.ndarray:
        """Return the ages of the images at publication in s."""
        return np.array(self.published) - self.stamps()


@pytest.fixture
def viewer(node: Node) -> Viewer:
    return Viewer(node)


def seconds_until(process: NodeProcess, text: str, count: int = 1) -> float:
    """Wait until a text is on the console once more than it was; how long it took."""
    began = time.monotonic()
    process.wait_until(lambda output: output.count(text) >= count, repr(text))
    return time.monotonic() - began


FORMATS = {
    'YUYV': ('yuv422_yuy2', 2 * 640, 480), 'GREY': ('mono8', 640, 480),
    'Y16': ('mono16', 2 * 640, 480), 'NV12': ('nv12', 640, 480), 'RGB3': ('rgb8', 3 * 640, 480),
}


def test_negotiated_formats(start: Start, viewer: Viewer) -> None:
    publisher = start('img_publisher', source=0, encoding="''", publish_rate=0)
    publisher.wait_for('opened: BGR3 640x480 at 25 Hz')
    for fourcc, (encoding, step, height) in FORMATS.items():
        assert not set_parameters(viewer.node, fourcc=fourcc)
        publisher.wait_for(f'opened: {fourcc} 640x480')
        while viewer.wait_for(1)[0].encoding != encoding:
            pass
        image = viewer.images[-1]
        assert (image.step, image.height, image.width) == (step, height, 640)
        assert len(image.data) == step * height * (3 if encoding == 'nv12' else 2) // 2
        told = run('v4l2-ctl', '-d', VIDEO, '--get-fmt-video')
        assert f"'{fourcc:4}'" in told and '640/480' in told
    assert not set_parameters(viewer.node, fourcc='MJPG', width=800, height=600, fps=60.0)
    publisher.wait_for('cannot send 60 Hz and sends ')
    remarks = [line for line in publisher.output.splitlines() if '[WARN]' in line]
    assert 'cannot send MJPG 800x600 and sends ' in remarks[-2]
    assert '320x180 640x360 640x480 1280x720' in remarks[-2]
    assert remarks[-1].endswith('it offers 1, 2, 4, 5, 10, 12.5, 15, 25')
    tell('formats', f'{", ".join(FORMATS)} as asked; MJPG 800x600 at 60 Hz refused in words')


@pytest.mark.parametrize('encoding', ['yuv422_yuy2', 'yuyv'])
def test_raw_frames_bit_for_bit(
        start: Start, tmp_path: Path, encoding: str) -> None:
    control('test_pattern=0', 'osd_text_mode=2')  # colour bars without a counter
    expected = tmp_path / 'expected.raw'
    run('v4l2-ctl', '-d', VIDEO, '--set-fmt-video=width=640,height=480,pixelformat=YUYV',
        '--stream-mmap', '--stream-count=1', f'--stream-to={expected}')
    subscriber = start('img_subscriber', output_dir=tmp_path / 'out', file_name='f{seq}.npy',
                       max_frames=10)
    publisher = start('img_publisher', source=0, encoding=encoding, max_frames=10,
                      wait_for_subscribers=1)
    assert subscriber.finish() == 0, subscriber.output
    assert publisher.finish() == 0, publisher.output
    assert 'opened: YUYV' in publisher.output
    reference = np.fromfile(expected, np.uint8).reshape(480, 640, 2)
    files = recorded_files(tmp_path / 'out')
    assert len(files) == 10
    assert all(np.array_equal(np.load(file), reference) for file in files)
    tell(f'raw YUYV as {encoding}',
         f'{len(files)} of {len(files)} files equal to what v4l2-ctl captured')


def test_rectified_images(start: Start, viewer: Viewer, tmp_path: Path) -> None:
    control('test_pattern=0', 'osd_text_mode=2')  # colour bars without a counter
    stored = StoredCamera(
        width=640, height=480, distortion_model='plumb_bob', d=(-0.3, 0.1, 0, 0, 0),
        k=(500, 0, 320, 0, 500, 240, 0, 0, 1), r=(1, 0, 0, 0, 1, 0, 0, 0, 1),
        p=(480, 0, 320, 0, 0, 480, 240, 0, 0, 0, 1, 0))
    file = tmp_path / 'vivid.yaml'
    write_camera(file, stored, 'vivid')
    rectified: list[Image] = []
    infos: list[CameraInfo] = []
    viewer.node.create_subscription(Image, 'image_rect', rectified.append, 10)
    viewer.node.create_subscription(CameraInfo, 'image_rect/camera_info', infos.append, 10)
    start('img_publisher', source=0, encoding='bgr8', rectify=True, camera_info_url=file)
    spin_until(viewer.node, lambda: viewer.images and rectified and infos)
    raw, straight = (np.frombuffer(image.data, np.uint8).reshape(480, 640, 3)
                     for image in (viewer.images[-1], rectified[-1]))
    maps = cv2.initUndistortRectifyMap(
        np.reshape(stored.k, (3, 3)), np.array(stored.d, float), None,
        np.reshape(stored.p, (3, 4))[:, :3], (640, 480), cv2.CV_32FC1)
    expected = cv2.remap(raw, *maps, cv2.INTER_LINEAR)
    difference = np.abs(straight.astype(int) - expected)
    assert difference.max() <= 8  # maps of 1/32 pixel
    assert infos[-1].k.tolist() == [480, 0, 320, 0, 480, 240, 0, 0, 1] and not any(infos[-1].d)
    tell('rectified', f'{difference.mean():.3f} of 255 from cv2.remap')


@pytest.fixture
def show() -> Iterator[Callable[[np.ndarray], None]]:
    """
    Connect the camera to an HDMI output; return a function that shows a YUYV image there.

    A test names this fixture before ``start``, because the driver is removed at its end.
    """
    run('rmmod', 'vivid')
    run('modprobe', 'vivid', *LOOP)
    try:
        for device in (OUTPUT, VIDEO):
            run('v4l2-ctl', '-d', device, '--set-dv-bt-timings', 'index=0')  # 640x480
        control('osd_text_mode=2', 'loop_video=1')
        with subprocess.Popen(
                ['v4l2-ctl', '-d', OUTPUT, '--stream-out-mmap=4', '--stream-from=-'],
                stdin=subprocess.PIPE, stdout=subprocess.DEVNULL,
                stderr=subprocess.DEVNULL) as output:

            def write(image: np.ndarray) -> None:
                for _ in range(4):  # the stream begins with four images; the last one stays
                    output.stdin.write(image.tobytes())
                output.stdin.flush()

            yield write
            output.stdin.close()
    finally:
        run('rmmod', 'vivid')
        run('modprobe', 'vivid', *WEBCAM)


def wait_for_pixels(viewer: Viewer, expected: np.ndarray) -> np.ndarray:
    """Return the first published image that differs by at most 1 from an image."""
    def newest() -> np.ndarray:
        return np.frombuffer(viewer.images[-1].data, np.uint8).reshape(expected.shape)

    viewer.images.clear()
    spin_until(viewer.node, lambda: viewer.images
               and cv2.absdiff(newest(), expected).max() <= 1)
    return newest()


def test_calibration_of_published_images(
        show: Callable[[np.ndarray], None], start: Start, viewer: Viewer, tmp_path: Path) -> None:
    text = 'charuco:9x6:40mm:30mm:4x4_50'
    truth, board = wide_camera(640, 480), parse_board(text)
    # The driver passes images on only if the formats of both ends are the same.
    publisher = start('img_publisher', source=0, fourcc='YUYV', encoding='bgr8', publish_rate=5)
    for number, pose in enumerate(poses(board, truth, 10)):
        gray = truth.see(board, pose, seed=number)
        sent = np.dstack((gray, np.full_like(gray, 128)))
        expected = cv2.cvtColor(sent, cv2.COLOR_YUV2BGR_YUY2)
        show(sent)
        cv2.imwrite(str(tmp_path / f'{number}.png'), wait_for_pixels(viewer, expected))
    publisher.interrupt()
    assert publisher.finish() == 0, publisher.output
    run(executable('img_calibrate'), tmp_path / '*.png', '--board', text,
        '-o', tmp_path / 'vivid.yaml')
    stored = read_camera(tmp_path / 'vivid.yaml')
    places = np.stack(np.meshgrid(np.linspace(0, 639, 33), np.linspace(0, 479, 25)),
                      axis=2).reshape(-1, 2)
    found, _ = cv2.projectPoints(
        np.insert(truth.rays(places), 2, 1.0, axis=1), np.zeros(3), np.zeros(3),
        np.reshape(stored.k, (3, 3)), np.array(stored.d))
    errors = np.linalg.norm(found[:, 0] - places, axis=1)
    tell('calibration', f'errors of the lens over the image: {errors.mean():.3f} pixels, at most '
         f'{errors.max():.3f}')
    # Without the driver, the same pictures have errors of 0.125 and 0.145 pixels. When the limited
    # range of YUYV is expanded and rounded to 8 bits, they have 0.13 and 0.16 pixels.
    assert errors.mean() < 0.2 and errors.max() < 0.3


def test_encoding_aliases(start: Start, viewer: Viewer) -> None:
    names = {'yuyv': 'YUYV', 'yuv422_yuy2': 'YUYV', 'uyvy': 'UYVY', 'yuv422': 'UYVY'}
    publisher = start('img_publisher', source=0, encoding='yuyv', publish_rate=0)
    for encoding, fourcc in names.items():
        assert not set_parameters(viewer.node, encoding=encoding)
        publisher.wait_for(f'opened: {fourcc} 640x480')
        while viewer.wait_for(1)[0].encoding != encoding:
            pass
        image = viewer.images[-1]
        assert (image.step, image.height, image.width) == (2 * 640, 480, 640)
        assert f"'{fourcc}'" in run('v4l2-ctl', '-d', VIDEO, '--get-fmt-video')
    assert 'frame dropped' not in publisher.output
    tell('names of encodings', f'{", ".join(names)} as asked')


def test_controls_as_parameters(start: Start, viewer: Viewer) -> None:
    publisher = start('img_publisher', source=0, brightness=100, contrst=5)
    publisher.wait_for('unknown parameter contrst is not used; did you mean contrast?')
    assert '100' in run('v4l2-ctl', '-d', VIDEO, '-C', 'brightness')
    listed = {name: (kind, bounds) for name, kind, bounds in re.findall(
        r'^ +(\w+) 0x\w+ \((int|bool|menu|intmenu)\) *: (.*)',
        run('v4l2-ctl', '-d', VIDEO, '-L'), re.MULTILINE) if 'read-only' not in bounds}
    described = call_service(
        viewer.node, DescribeParameters, '/image_publisher/describe_parameters',
        DescribeParameters.Request(names=list(listed))).descriptors
    assert [found.name for found in described] == list(listed)
    for found in described:
        kind, bounds = listed[found.name]
        if kind == 'int':
            least, most = map(int, re.match(r'min=(-?\d+) max=(-?\d+) ', bounds).groups())
            assert found.integer_range[0].from_value == least
            assert found.integer_range[0].to_value == most
        elif kind != 'bool':
            assert found.additional_constraints.startswith('one of: ')
    assert not set_parameters(viewer.node, contrast=42, horizontal_flip=True)
    told = run('v4l2-ctl', '-d', VIDEO, '-C', 'contrast,horizontal_flip')
    assert re.findall(r': (\d+)', told) == ['42', '1']
    assert 'out of range' in set_parameters(viewer.node, contrast=999)
    assert 'Wrong parameter type' in set_parameters(viewer.node, contrast='high')
    unplug()
    publisher.wait_for('is disconnected')
    assert not set_parameters(viewer.node, contrast=43)
    plug_in()
    publisher.wait_for('is back')
    told = run('v4l2-ctl', '-d', VIDEO, '-C', 'brightness,contrast,horizontal_flip')
    assert re.findall(r': (\d+)', told) == ['100', '43', '1']
    tell('controls', f'{len(listed)} parameters as v4l2-ctl lists the controls; '
         'set, refused, and set again on the camera that came back')


def shown(node: Node, *names: str) -> list[int]:
    """Read parameters as ``ros2 param get`` does."""
    answer = call_service(node, GetParameters, '/image_publisher/get_parameters',
                          GetParameters.Request(names=names))
    return [parameter_value_to_python(value) for value in answer.values]


def test_controls_set_by_another_program(start: Start, viewer: Viewer) -> None:
    control('contrast=128', 'horizontal_flip=0', 'vertical_flip=0')
    publisher = start('img_publisher', source=0, brightness=100, contrast=100,
                      horizontal_flip='false')
    viewer.wait_for(3)
    spin_until(viewer.node, lambda: shown(viewer.node, 'brightness') == [100])
    control('brightness=77', 'contrast=99', 'horizontal_flip=1')
    expected = [77, 99, True]
    names = ('brightness', 'contrast', 'horizontal_flip')
    spin_until(viewer.node, lambda: shown(viewer.node, *names) == expected)
    assert not set_parameters(viewer.node, vertical_flip=1)  # a switch, as at the start
    assert publisher.output.count('opened: ') == 1
    unplug()
    publisher.wait_for('is disconnected')
    plug_in()
    publisher.wait_for('is back')
    assert shown(viewer.node, *names, 'vertical_flip') == [*expected, True]
    told = run('v4l2-ctl', '-d', VIDEO, '-C', ','.join([*names, 'vertical_flip']))
    assert re.findall(r': (\d+)', told) == ['77', '99', '1', '1']
    tell('another program', 'its settings are shown, and made again on the camera that came back')


def test_width_and_height_reopen_once(start: Start, viewer: Viewer) -> None:
    publisher = start('img_publisher', source=0, publish_rate=0)
    viewer.wait_for(3)
    assert not set_parameters(viewer.node, width=1280, height=720)
    while viewer.wait_for(1)[0].width != 1280:
        pass
    assert viewer.images[-1].height == 720
    assert publisher.output.count('opened: ') == 2
    assert '[WARN]' not in publisher.output
    tell('width and height', 'set one after the other, the camera was opened once for both')


def test_fresh_frame_after_a_pause(start: Start, viewer: Viewer) -> None:
    publisher = start('img_publisher', source=0, publish_rate=0, width=320, height=180)
    viewer.wait_for(20)
    usual = float(np.median(viewer.ages()[-15:]))
    publisher.interrupt(signal.SIGSTOP)
    pause(1.0)
    count = len(viewer.images)
    resumed = time.time()
    publisher.interrupt(signal.SIGCONT)
    viewer.wait_for(15)
    period = np.median(np.diff(viewer.stamps()[:20]))
    # What was on its way when the process stopped may still arrive.
    first = int(np.argmax(np.diff(viewer.stamps()[count - 3:]))) + count - 2
    oldest = float(viewer.ages()[first:].max())
    # vivid stamps most of a period ahead.
    tell('freshness', 'after a pause of 1 s the oldest of 15 frames was published '
         f'{1000 * oldest:.0f} ms after its stamp, usual are {1000 * usual:.0f} ms, '
         f'the period is {1000 * period:.0f} ms')
    # The buffers that waited in the driver are from the begin of the pause.
    assert min(viewer.stamps()[first:]) > resumed - 0.5


@contextmanager
def trace(event: str) -> Iterator[None]:
    """Trace an event in the kernel."""
    if not TRACE.joinpath('events').exists():
        run('mount', '-t', 'tracefs', 'tracefs', TRACE)
    switch = TRACE / 'events' / event / 'enable'
    TRACE.joinpath('trace').write_text('')
    switch.write_text('1')
    try:
        yield
    finally:
        switch.write_text('0')


def monotonic_to_wall() -> float:
    """Return the seconds from CLOCK_MONOTONIC to the time of day, by the quickest reading."""
    readings = []
    for _ in range(100):
        before, now, after = time.monotonic(), time.time(), time.monotonic()
        readings.append((after - before, now - (before + after) / 2))
    return min(readings)[1]


def test_driver_timestamps(start: Start, viewer: Viewer) -> None:
    with trace('v4l2/v4l2_dqbuf'):
        start('img_publisher', source=0, publish_rate=0, width=320, height=180)
        viewer.wait_for(30)
        events = TRACE.joinpath('trace').read_text()
    monotonic = [int(text) / 1e9 for text in re.findall(r'timestamp = (\d+)', events)]
    driver = np.array(monotonic) + monotonic_to_wall()
    stamps = np.array(viewer.stamps()[5:30])
    off = [float(np.abs(driver - stamp).min()) for stamp in stamps]
    tell('stamps', f'{len(stamps)} within {1000 * max(off):.2f} ms of what the kernel traced, '
         f'median {1000 * float(np.median(off)):.2f} ms')
    assert (np.diff(stamps) > 0).all()
    assert max(off) < 0.005


@pytest.fixture(scope='class')
def by_id(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Create a symbolic link to the camera, like udev."""
    link = tmp_path_factory.mktemp('by-id') / 'camera'
    link.symlink_to(VIDEO)
    return link


@pytest.fixture(scope='class')
def survivor(by_id: Path) -> Iterator[tuple[NodeProcess, Viewer]]:
    """Start a publisher for all failures of its camera, and a subscriber."""
    environment = {**os.environ, 'ROS_DOMAIN_ID': '101',
                   'ROS_AUTOMATIC_DISCOVERY_RANGE': 'LOCALHOST'}
    publisher = NodeProcess(
        [executable('img_publisher'), '--ros-args', '-p', f'source:={by_id}'],
        by_id.with_name('survivor.log'), environment)
    context = Context()
    rclpy.init(context=context, domain_id=101)
    viewer = Viewer(Node('viewer', context=context))
    viewer.wait_for(3)
    yield publisher, viewer
    publisher.kill()
    viewer.node.destroy_node()
    rclpy.shutdown(context=context)


Survivor = tuple[NodeProcess, Viewer]


class Ordeal:
    """Something that goes wrong with the survivor's camera: how soon it is noticed and over."""

    def __init__(self, survivor: Survivor, text: str) -> None:
        self._publisher, self._viewer = survivor
        self._text = text
        self._times = self._publisher.output.count(text) + 1
        self._back = self._publisher.output.count(BACK) + 1

    def seconds_to_notice(self) -> float:
        return seconds_until(self._publisher, self._text, self._times)

    def seconds_to_come_back(self) -> float:
        seconds = seconds_until(self._publisher, BACK, self._back)
        self._viewer.wait_for(3)
        return seconds


class TestOneLife:
    """One publisher lives through all that goes wrong with its camera."""

    def test_a_stall_is_noticed_and_the_camera_comes_back(self, survivor: Survivor) -> None:
        ordeal = Ordeal(survivor, 'sent no frame for 2 s')
        control('percentage_of_dropped_buffers=100')
        noticed = ordeal.seconds_to_notice()
        control('percentage_of_dropped_buffers=0')
        back = ordeal.seconds_to_come_back()
        tell('stall', f'noticed in {noticed:.1f} s (read_timeout is 2 s), back in {back:.1f} s')
        assert noticed > 1.8  # read_timeout is 2 s

    @pytest.mark.parametrize(('scenario', 'fault', 'text'), [
        ('broken stream', 'inject_fatal_streaming_error=1', ' failed: '),
        ('disconnect', 'disconnect=1', 'is disconnected; check that it is plugged in')])
    def test_a_fault_is_noticed_and_the_camera_opened_anew(
            self, survivor: Survivor, scenario: str, fault: str, text: str) -> None:
        ordeal = Ordeal(survivor, text)
        control(fault)
        noticed = ordeal.seconds_to_notice()
        back = ordeal.seconds_to_come_back()
        tell(scenario, f'noticed in {noticed:.2f} s, back in {back:.2f} s')

    def test_an_unplugged_camera_is_found_again(self, survivor: Survivor) -> None:
        ordeal = Ordeal(survivor, 'is disconnected; check that it is plugged in')
        unplug()
        noticed = ordeal.seconds_to_notice()
        survivor[0].wait_for('does not exist')
        pause(1.0)
        plug_in()
        back = ordeal.seconds_to_come_back()
        tell('unplug', f'noticed in {noticed:.2f} s, back in {back:.1f} s after it was plugged in')

    def test_a_camera_is_found_under_another_number(
            self, survivor: Survivor, by_id: Path) -> None:
        ordeal = Ordeal(survivor, 'is disconnected; check that it is plugged in')
        with VIDEO.open():  # who still holds the old number keeps it from being given again
            unplug()
            ordeal.seconds_to_notice()
            plug_in()
            assert not VIDEO.exists()
            by_id.unlink()
            by_id.symlink_to('/dev/video1')
            back = ordeal.seconds_to_come_back()
        ordeal = Ordeal(survivor, 'is disconnected; check that it is plugged in')
        unplug()
        by_id.unlink()
        ordeal.seconds_to_notice()
        by_id.symlink_to(VIDEO)
        plug_in()
        again = ordeal.seconds_to_come_back()
        tell('by-id', f'back in {back:.1f} s as /dev/video1, and in {again:.1f} s as /dev/video0')


def test_reconnect_timeout(start: Start, viewer: Viewer) -> None:
    publisher = start('img_publisher', source=0, reconnect=3)
    viewer.wait_for(3)
    unplug()
    try:
        began = time.monotonic()
        assert publisher.finish() == 1, publisher.output
        gave_up = time.monotonic() - began
    finally:
        plug_in()
    assert 'gave up after 3.' in publisher.output
    tell('given up', f'after {gave_up:.1f} s with status 1 (reconnect is 3)')
    assert gave_up > 2.5


def test_busy_camera_is_retried(start: Start, viewer: Viewer) -> None:
    other = subprocess.Popen(
        ['v4l2-ctl', '-d', VIDEO, '--stream-mmap', '--stream-count=100000'],
        stdout=subprocess.DEVNULL, stderr=subprocess.PIPE)
    try:
        assert other.stderr and other.stderr.read(1) == b'<'  # its first frame
        publisher = start('img_publisher', source=0)
        publisher.wait_for(
            f'camera /dev/video0 is used by another program: v4l2-ctl (pid {other.pid})')
        assert other.poll() is None
    finally:
        other.terminate()
        other.wait()
    back = seconds_until(publisher, BACK)
    viewer.wait_for(3)
    second = start('img_publisher', '--ros-args', '-r', '__ns:=/second', '--', source=0,
                   reconnect='never')
    assert second.finish() == 1
    assert 'is used by another program: img_publisher' in second.output
    assert call_service(viewer.node, SetBool, '/set_capture', SetBool.Request(data=False)).success
    run('v4l2-ctl', '-d', VIDEO, '--stream-mmap', '--stream-count=3')
    assert call_service(viewer.node, SetBool, '/set_capture', SetBool.Request(data=True)).success
    viewer.wait_for(3)
    tell('busy', f'its user is named; there {back:.1f} s after it was free; '
         'a second publisher ends with status 1; set_capture lets go of it')


def test_camera_connected_later(start: Start, viewer: Viewer) -> None:
    unplug()
    publisher = start('img_publisher', source=0)
    publisher.wait_for('camera /dev/video0 does not exist; cameras on this machine: none.')
    assert publisher.output.count('camera /dev/video0 does not exist') == 1
    pause(2.0)
    plug_in()
    back = seconds_until(publisher, BACK)
    viewer.wait_for(3)
    assert publisher.output.count('camera /dev/video0 does not exist') == 1
    tell('late camera', f'there {back:.1f} s after it was plugged in')


def test_permission_error_names_the_group() -> None:
    os.chown(VIDEO, 0, 44)
    VIDEO.chmod(0o660)
    os.seteuid(65534)
    try:
        with pytest.raises(CaptureError, match=r'no permission .* usermod -aG video \$USER'):
            CameraSource(VIDEO, CameraRequest())
    finally:
        os.seteuid(0)
    tell('permission', 'the group video is named')


def test_missed_frames_are_counted() -> None:
    source = CameraSource(VIDEO, CameraRequest(width=320, height=180))
    try:
        stamps = []
        for _ in range(5):
            while not source.wait(1.0):
                pass
            stamps.append(source.read().stamp_ns / 1e9)
            age = time.monotonic() - stamps[-1]
            pause(0.5)  # longer than the camera can wait
            # The oldest buffer is 0.5 s old; vivid stamps before the time has come.
            assert -0.1 < age < 0.4
        periods = (stamps[-1] - stamps[0]) * source.rate
        assert source.missed == pytest.approx(periods, rel=0.2)
    finally:
        source.close()
    tell('missed', f'{source.missed} of {periods:.0f} frames that a slow reader could not take')


def test_list_of_cameras_has_capture_devices_only() -> None:
    run('rmmod', 'vivid')
    try:
        # Of node_types: 0x1 captures video, 0x100 shows it, 0x20000 captures metadata.
        run('modprobe', 'vivid', 'n_devs=2', 'node_types=0x20101,0x1', 'num_inputs=1,1',
            'input_types=0x0,0x0')
        nodes = sorted(path.name for path in Path('/dev').glob('video*'))
        able = [name for name in nodes if 'Video Capture' in device_caps(Path('/dev') / name)]
        with pytest.raises(CaptureError) as caught:
            CameraSource(Path('/dev/video99'), CameraRequest())
    finally:
        run('rmmod', 'vivid')
        run('modprobe', 'vivid', *WEBCAM)
    assert len(able) == 2 < len(nodes)
    listed = ', '.join(f'/dev/{name}' for name in able)
    assert f'cameras on this machine: {listed}. ' in str(caught.value)
    tell('nodes', f'{listed} of {", ".join(nodes)}')


def device_caps(node: Path) -> str:
    """Return what v4l2-ctl prints of a node itself, not of the whole device."""
    told = subprocess.run(  # it looks for every node among the media's entities, and complains
        ['v4l2-ctl', '-d', node, '-D'], check=True, text=True, stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL, timeout=LONGEST_SECONDS).stdout
    return told.partition('Device Caps')[2]


def test_missed_frames_on_the_console(start: Start, viewer: Viewer) -> None:
    publisher = start('img_publisher', source=0, publish_rate=0, width=320, height=180)
    viewer.wait_for(3)
    control('percentage_of_dropped_buffers=50')
    spin_until(viewer.node, lambda: bool(re.search(
        r'Publishing video frame \d+: .* Hz, 0 dropped, \d+ missed', publisher.output)))
    publisher.interrupt()
    assert publisher.finish() == 0, publisher.output
    missed = re.search(r'Published .* 0 dropped, (\d+) missed', publisher.output)[1]
    tell('half the frames gone', f'{missed} missed, as the console says')


def capture_bars(fourcc: str) -> np.ndarray:
    """Read one frame of colour bars without a counter."""
    control('osd_text_mode=2')
    source = CameraSource(VIDEO, CameraRequest(fourcc=fourcc))
    try:
        assert source.description.startswith(fourcc)
        assert source.wait(LONGEST_SECONDS)
        return source.read().image.copy()
    finally:
        source.close()


def test_frame_in_use_after_its_camera_was_closed() -> None:
    source = CameraSource(VIDEO, CameraRequest(width=320, height=180))
    try:
        assert source.wait(LONGEST_SECONDS)
        image = source.read().image
        pixels = image.copy()
        pause(1.0)  # the driver fills its other buffers
        assert np.array_equal(image, pixels)
    finally:
        source.close()
    assert np.array_equal(image, pixels)  # its memory is still there
    with pytest.raises(ValueError, match='read-only'):
        image[:] = 0
    with pytest.raises(CaptureError, match='is used by another program'):
        CameraSource(VIDEO, CameraRequest())
    del image
    CameraSource(VIDEO, CameraRequest()).close()
    tell('kept frame', 'readable after close; the camera is free with its last view')


def test_time_of_the_publisher_for_a_frame(start: Start, tmp_path: Path) -> None:
    figures = []
    for encoding in ('bgr8', 'yuv422_yuy2'):
        subscriber = start('img_subscriber', max_rate=0.1, output_dir=tmp_path / encoding)
        publisher = start('img_publisher', source=0, width=1280, height=720, fourcc='YUYV',
                          publish_rate=0, encoding=encoding, wait_for_subscribers=1)
        publisher.wait_for('Publishing video frame 1:')
        pause(3.0)
        begun, first = processor_seconds(publisher.pid), published(publisher)
        pause(10.0)
        seconds, count = processor_seconds(publisher.pid) - begun, published(publisher) - first
        for process in (subscriber, publisher):
            process.interrupt()
            assert process.finish() == 0, process.output
        assert count > 0
        figures.append(f'{1000 * seconds / count:.2f} ms to publish {encoding}')
    tell('processor time of a YUYV frame of 1280x720', ', '.join(figures))


def published(publisher: NodeProcess) -> int:
    """Return the number of the last frame on the console."""
    return int(re.findall(r'Publishing video frame (\d+):', publisher.output)[-1])


def processor_seconds(pid: int) -> float:
    """Return the processor time of a process, see proc(5)."""
    fields = Path(f'/proc/{pid}/stat').read_text().rpartition(')')[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf('SC_CLK_TCK')


def test_multiplanar_camera() -> None:
    fourccs = ('YUYV', 'NV12', 'RGB3')
    expected = [capture_bars(fourcc) for fourcc in fourccs]
    run('rmmod', 'vivid')
    try:
        run('modprobe', 'vivid', *WEBCAM, 'multiplanar=2')
        assert 'Multiplanar' in run('v4l2-ctl', '-d', VIDEO, '--info')
        images = [capture_bars(fourcc) for fourcc in fourccs]
    finally:
        run('rmmod', 'vivid')
        run('modprobe', 'vivid', *WEBCAM)
    assert all(map(np.array_equal, images, expected))
    tell('multi-planar', f'{", ".join(fourccs)}: the same pixels')
