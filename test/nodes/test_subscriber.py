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

"""The recorder as a process: encodings, selection, file names, requests and progress."""

from __future__ import annotations

from collections.abc import Callable
import itertools
import os
from pathlib import Path
import re
from threading import Event
import time

import av
from conftest import call_service, CLIP, NodeProcess, read_manifest, recorded_files, spin_until
import cv2
from images import random_image
import numpy as np
from opencv_tools.cv_bridge import CvBridge
from opencv_tools.image.encodings import ENCODINGS
from opencv_tools.transport.shared_frames.announcement import SUFFIX
import pytest
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import DurabilityPolicy, QoSProfile
from sending import create_publisher, NANO, send, stamped
from sensor_msgs.msg import CompressedImage, Image
from sharing import Camera, TOPIC
from std_msgs.msg import String
from std_srvs.srv import Trigger
from terminal import on_terminal

Start = Callable[..., NodeProcess]
Tell = Callable[[str], None]

LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)

GENERIC = [f'{depth}C{channels}' for depth in ('8U', '8S', '16U', '16S', '32S', '32F', '64F')
           for channels in (1, 2, 3, 4)]
_BYTES = {'mono8', 'bgr8', 'rgb8', '8UC1', '8UC3'}
_ALPHA = {'bgra8', 'rgba8', '8UC4'}
_WORDS = {'mono16', 'bgr16', 'rgb16', 'bgra16', 'rgba16', '16UC1', '16UC3', '16UC4'}
_FLOATS = {'32FC1', '32FC3', '64FC1'}
_COLORED_BYTES = {name for name in ENCODINGS
                  if name.startswith(('bayer', 'yu', 'uy', 'nv')) and not name.endswith('16')}
_COLORED_WORDS = {name for name in ENCODINGS if name.startswith('bayer') and name.endswith('16')}
KEPT = {
    '.png': _BYTES | _ALPHA | _WORDS | _COLORED_BYTES | _COLORED_WORDS,
    '.tif': _BYTES | _ALPHA | _WORDS | _FLOATS | _COLORED_BYTES | _COLORED_WORDS,
    '.jpg': _BYTES | _COLORED_BYTES,
    '.bmp': _BYTES | _COLORED_BYTES,
    '.webp': {'bgr8', 'rgb8', '8UC3'} | _COLORED_BYTES,
    '.npy': {*ENCODINGS, *GENERIC},
    '.mkv': _BYTES | _COLORED_BYTES | {'16UC1', 'mono16'},
}


def line_stamp(line: dict[str, object]) -> int:
    return line['stamp']['sec'] * NANO + line['stamp']['nanosec']


@pytest.fixture
def publisher(node: Node) -> Publisher:
    return create_publisher(node)


def received(process: NodeProcess) -> int:
    return int(re.search(r'Received (\d+) frames', process.output)[1])


def expected_picture(image: np.ndarray, encoding: str) -> np.ndarray:
    """Convert an image by cv_bridge to the channel order of OpenCV."""
    if ENCODINGS.get(encoding) is None or ENCODINGS[encoding].order == 'y':
        return image
    order = 'bgra' if ENCODINGS[encoding].order in ('bgra', 'rgba') else 'bgr'
    bits = 16 if ENCODINGS[encoding].dtype == 'uint16' else 8
    bridge = CvBridge()
    return bridge.imgmsg_to_cv2(bridge.cv2_to_imgmsg(image, encoding), f'{order}{bits}')


@pytest.mark.quick_cases(2)
@pytest.mark.parametrize('suffix', [suffix for suffix in KEPT if suffix != '.mkv'])
def test_every_encoding_is_exact_or_refused(
        start: Start, node: Node, publisher: Publisher, tmp_path: Path, suffix: str) -> None:
    names = [*ENCODINGS, *GENERIC]
    images = {name: random_image(name, 12, 16) for name in names}
    recorder = start('img_subscriber', output_dir=tmp_path / 'out', on_overflow='block',
                     file_name=f'f{{seq}}{suffix}', max_frames=len(names))
    send(node, publisher, *(stamped(image, name, NANO + index)
                            for index, (name, image) in enumerate(images.items())))
    everything = suffix == '.npy'
    assert recorder.finish() == (0 if everything else 1), recorder.output
    lines = {line['encoding']: line for line in read_manifest(tmp_path / 'out')}
    assert set(lines) == KEPT[suffix]
    for name, line in lines.items():
        assert line_stamp(line) == NANO + names.index(name)
        assert line['size'] == [16, 12]
        path = tmp_path / 'out' / line['file']
        if everything:
            kept = np.load(path)
            np.testing.assert_array_equal(kept, images[name])
            assert kept.dtype == images[name].dtype
            continue
        kept = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
        expected = expected_picture(images[name], name)
        assert kept.dtype == expected.dtype
        if suffix == '.jpg':
            expected = cv2.imdecode(cv2.imencode('.jpg', expected)[1], cv2.IMREAD_UNCHANGED)
        np.testing.assert_array_equal(kept, expected, err_msg=name)
        is_colored = name in _COLORED_BYTES | _COLORED_WORDS
        assert line['stored_encoding'] == (
            name if not is_colored else 'bgr16' if name.endswith('16') else 'bgr8')
    refused = set(re.findall(r'a frame was not written: a (\w+) frame cannot be stored',
                             recorder.output))
    assert refused <= set(names) - KEPT[suffix]
    # Ten lines at once, then one per second.
    assert len(refused) >= min(10, len(names) - len(KEPT[suffix]))
    assert received(recorder) == len(names)


def test_every_encoding_is_in_a_video_or_refused(
        start: Start, node: Node, publisher: Publisher, tmp_path: Path) -> None:
    names = [*ENCODINGS, *GENERIC]
    recorder = start('img_subscriber', output_dir=tmp_path / 'out', on_overflow='block',
                     file_name='clip.mkv', max_frames=len(names))
    send(node, publisher, *(
        stamped(_flat(name), name, NANO + index * NANO // 30)
        for index, name in enumerate(names)))
    assert recorder.finish() == 1, recorder.output
    lines = read_manifest(tmp_path / 'out')
    assert sum(line['frames'] for line in lines) == len(KEPT['.mkv'])


def _flat(name: str) -> np.ndarray:
    image = random_image(name, 64, 64)
    image[...] = 77
    return image


def test_bad_messages_are_counted(
        start: Start, node: Node, publisher: Publisher, tmp_path: Path) -> None:
    recorder = start('img_subscriber', output_dir=tmp_path / 'out', on_overflow='block',
                     file_name='f{frame_id}_{seq}.png', max_frames=6)
    good = np.zeros((4, 4), np.uint8)
    hostile = stamped(good, 'mono8', 1, '../../../tmp/evil')
    huge, short, nonsense = (stamped(good, 'mono8', 1) for _ in range(3))
    huge.height = huge.width = huge.step = 2**32 - 1
    short.data = short.data[:3]
    nonsense.encoding = '../mono8\n' * 1000
    send(node, publisher, huge, hostile, short, nonsense, stamped(good, 'mono8', 2),
         *[nonsense] * 3, *[stamped(good, 'mono8', 3)] * 4)
    assert recorder.finish() == 1, recorder.output
    assert received(recorder) == 12
    assert '6 written to' in recorder.output and ' 6 failed' in recorder.output
    assert recorder.output.count('message not recorded') == 3
    assert [path.name for path in recorded_files(tmp_path / 'out')] == [
        'f_._.._.._tmp_evil_0.png', *(f'fcamera_{seq}.png' for seq in range(1, 6))]
    assert len(read_manifest(tmp_path / 'out')) == 6


def test_file_names_from_metadata(
        start: Start, node: Node, publisher: Publisher, tmp_path: Path) -> None:
    name = '{topic}-{frame_id}-{encoding}-{sec}-{nanosec}-{stamp}.npy'
    recorder = start('img_subscriber', output_dir=tmp_path / 'out', file_name=f'v{name}',
                     max_frames=2)
    image = np.zeros((2, 2), np.uint16)
    send(node, publisher, *[stamped(image, 'mono16', 5 * NANO + 42, 'left/camera')] * 2)
    assert recorder.finish() == 0, recorder.output
    stem = 'vvideo_frames-left_camera-mono16-5-000000042-5.000000042'
    assert [line['file'] for line in read_manifest(tmp_path / 'out')] == [
        f'{stem}.npy', f'{stem}_1.npy']


@pytest.mark.quick_cases(2)
@pytest.mark.parametrize(('parameters', 'numbers', 'ends'), [
    ({'every_n': 7, 'max_frames': 4}, [0, 7, 14, 21], True),
    ({'max_rate': 10.0}, list(range(0, 60, 3)), False),
    ({'max_bytes': 3500}, [0, 1, 2], True),
    ({'max_bytes': 3500, 'ring': 'true'}, [57, 58, 59], False),
    ({'max_frames': 5, 'ring': 'true'}, [55, 56, 57, 58, 59], False),
])
def test_selected_frames(
        start: Start, node: Node, publisher: Publisher, tmp_path: Path,
        parameters: dict[str, object], numbers: list[int], ends: bool) -> None:
    recorder = start('img_subscriber', output_dir=tmp_path / 'out', file_name='f{seq}.bmp',
                     on_overflow='block', **parameters)
    # A file has 54 + 16 * 64 bytes, so that three fit into 3500.
    frames = [stamped(np.full((16, 21, 3), number, np.uint8), 'bgr8', NANO + number * NANO // 30)
              for number in range(60)]
    send(node, publisher, *frames)
    if not ends:
        recorder.wait_for('Receiving video frame')
        _wait_until_received(recorder, tmp_path / 'out', numbers[-1])
        recorder.interrupt()
    assert recorder.finish() == 0, recorder.output
    assert ' 0 lost in transit' in recorder.output
    lines = read_manifest(tmp_path / 'out')
    assert [cv2.imread(str(tmp_path / 'out' / line['file']))[0, 0, 0] for line in lines] == numbers
    assert line_stamp(lines[-1]) == NANO + numbers[-1] * NANO // 30


def _wait_until_received(recorder: NodeProcess, folder: Path, last: int) -> None:
    def is_recorded(_: str) -> bool:
        values = [cv2.imread(str(path)) for path in recorded_files(folder)]
        return any(value is not None and value[0, 0, 0] == last for value in values)

    recorder.wait_until(is_recorded, f'frame {last}')


def test_duration_ends_without_further_frames(
        start: Start, node: Node, publisher: Publisher, tmp_path: Path) -> None:
    recorder = start('img_subscriber', output_dir=tmp_path / 'out', max_duration=1.0)
    broken, whole = (stamped(np.zeros((4, 4), np.uint8), 'mono8', 1) for _ in range(2))
    broken.encoding = 'none'
    send(node, publisher, broken, whole)
    assert recorder.finish() == 1, recorder.output
    assert len(read_manifest(tmp_path / 'out')) == 1


@pytest.mark.thorough
def test_compressed_topic_is_recorded_unchanged(
        start: Start, node: Node, tmp_path: Path) -> None:
    messages: list[CompressedImage] = []
    node.create_subscription(CompressedImage, 'video_frames/compressed', messages.append, 100)
    recorder = start('img_subscriber', output_dir=tmp_path / 'out', transport='compressed',
                     file_name='f{stamp}.jpg', max_frames=30)
    start('img_publisher', source='pattern:320x240@30', publish_rate=0, wait_for_subscribers=2)
    spin_until(node, lambda: len(messages) >= 35)
    assert recorder.finish() == 0, recorder.output
    sent = {f'f{message.header.stamp.sec}.{message.header.stamp.nanosec:09d}.jpg': message
            for message in messages}
    lines = read_manifest(tmp_path / 'out')
    assert len(lines) == 30
    for line in lines:
        assert (tmp_path / 'out' / line['file']).read_bytes() == bytes(sent[line['file']].data)
        assert line['encoding'] == line['stored_encoding'] == sent[line['file']].format
        assert line['size'] == [320, 240]


@pytest.mark.thorough
def test_video_times_of_a_minute_of_stamps(
        start: Start, node: Node, publisher: Publisher, tmp_path: Path, tell: Tell) -> None:
    recorder = start('img_subscriber', output_dir=tmp_path / 'out', file_name='clip.mp4',
                     on_overflow='block', max_frames=601)
    jitter = np.random.default_rng(3).integers(-45_000_000, 45_000_000, 601)
    stamps = [1_700_000_000 * NANO + number * NANO // 10 + int(shift)
              for number, shift in enumerate(jitter)]
    spin_until(node, lambda: publisher.get_subscription_count() > 0)
    for number, stamp in enumerate(stamps):
        image = np.full((48, 64, 3), number % 200 + 20, np.uint8)
        publisher.publish(stamped(image, 'bgr8', stamp))
    assert recorder.finish() == 0, recorder.output
    [line] = read_manifest(tmp_path / 'out')
    assert (line['file'], line['frames'], line_stamp(line)) == ('clip.mp4', 601, stamps[0])
    with av.open(str(tmp_path / 'out' / 'clip.mp4')) as video:
        frames = list(video.decode(video=0))
    times = [frame.pts * frame.time_base for frame in frames]
    deviations = [abs(float(time - times[0]) - (stamp - stamps[0]) / NANO)
                  for time, stamp in zip(times, stamps)]
    assert len(frames) == 601
    assert max(deviations) < 0.001
    assert float(times[-1] - times[0]) > 59.9
    for number in (0, 300, 600):
        assert abs(int(frames[number].to_ndarray(format='bgr24').mean()) - number % 200 - 20) < 4
    tell(f'a minute of video: 601 frames, largest deviation '
         f'{max(deviations) * 1e6:.0f} us')


@pytest.mark.thorough
def test_recording_without_pyav(
        start: Start, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / 'modules').mkdir()
    (tmp_path / 'modules' / 'av.py').write_text(
        'raise ModuleNotFoundError("No module named \'av\'", name="av")\n')
    monkeypatch.setenv('PYTHONPATH', str(tmp_path / 'modules'), prepend=os.pathsep)
    start('img_publisher', source=CLIP, on_end='loop')
    refused = start('img_subscriber', output_dir=tmp_path / 'none', file_name='x.mp4')
    recorder = start('img_subscriber', output_dir=tmp_path / 'out', file_name='f{seq}.png',
                     max_frames=1)
    assert recorder.finish() == 0, recorder.output
    assert [line['file'] for line in read_manifest(tmp_path / 'out')] == ['f0.png']
    assert refused.finish() == 2, refused.output
    assert refused.output.count('\n') == 1
    assert re.search(
        r"parameter file_name is 'x\.mp4': videos need PyAV, which cannot be imported \(No module "
        r"named 'av'\); install it with .*'pip install av' \(see Install in the README\)\n$",
        refused.output)
    assert not (tmp_path / 'none').exists()


@pytest.mark.quick_cases(1)
@pytest.mark.parametrize('on_exists', ['continue', 'overwrite'])
def test_new_video_for_a_new_size(
        start: Start, node: Node, publisher: Publisher, tmp_path: Path, on_exists: str) -> None:
    recorder = start('img_subscriber', output_dir=tmp_path / 'out', file_name='clip.mkv',
                     on_overflow='block', max_frames=30, on_exists=on_exists)
    sizes = [(48, 64)] * 10 + [(60, 80)] * 10 + [(48, 64)] * 10
    send(node, publisher, *(stamped(np.zeros((*size, 3), np.uint8), 'bgr8', NANO + n * NANO // 10)
                            for n, size in enumerate(sizes)))
    assert recorder.finish() == 0, recorder.output
    lines = read_manifest(tmp_path / 'out')
    assert [(line['file'], line['size'], line['frames'], line['seq']) for line in lines] == [
        ('clip.mkv', [64, 48], 10, 0), ('clip_1.mkv', [80, 60], 10, 1),
        ('clip_2.mkv', [64, 48], 10, 2)]
    assert 'exists already' not in recorder.output
    again = start('img_subscriber', output_dir=tmp_path / 'out', file_name='clip.mkv',
                  max_frames=1, on_exists=on_exists)
    send(node, publisher, stamped(np.zeros((48, 64, 3), np.uint8), 'bgr8', NANO))
    assert again.finish() == 0, again.output
    assert ('clip.mkv exists already: the recording is written to clip_3.mkv' in again.output) == (
        on_exists == 'continue')


def test_frame_saved_on_request(
        start: Start, node: Node, publisher: Publisher, tmp_path: Path) -> None:
    recorder = start('img_subscriber', output_dir=tmp_path / 'out', mode='on_request',
                     file_name='f{seq}.png', every_n=100)
    numbers = itertools.count(1)

    def publish() -> None:
        publisher.publish(stamped(np.full((4, 4), next(numbers) % 256, np.uint8), 'mono8', 1))

    timer = node.create_timer(0.02, publish)
    for seq in range(3):
        answer = call_service(node, Trigger, 'image_subscriber/save', Trigger.Request())
        assert (answer.success, answer.message) == (True, str(tmp_path / 'out' / f'f{seq}.png'))
        lines = read_manifest(tmp_path / 'out')
        assert len(lines) == seq + 1
    node.destroy_timer(timer)
    began = time.monotonic()
    answer = call_service(node, Trigger, 'image_subscriber/save', Trigger.Request())
    assert (answer.success, answer.message) == (False, 'no frame arrived within 3 s')
    assert time.monotonic() - began > 2.5
    timer = node.create_timer(0.02, lambda: publisher.publish(
        stamped(np.zeros((4, 4), np.float32), '32FC1', 1)))
    answer = call_service(node, Trigger, 'image_subscriber/save', Trigger.Request())
    assert not answer.success
    assert answer.message.startswith('a 32FC1 frame cannot be stored as .png')
    recorder.interrupt()
    assert recorder.finish() == 1, recorder.output
    assert '3 written' in recorder.output and ' 1 failed' in recorder.output


@pytest.mark.thorough
@pytest.mark.process
def test_blocking_recorder_slower_than_a_camera_that_shares(
        start: Start, camera: Node, tmp_path: Path) -> None:
    folder = tmp_path / 'out'
    recorder = start('img_subscriber', output_dir=folder, on_overflow='block', writers=1,
                     queue_size=1, png_compression=9)
    ours = Camera(camera)
    spin_until(camera, lambda: ours.subscribers > 0)

    def send_until(condition: Callable[[], bool]) -> None:
        """Publish until a condition holds, without a pause in which the recorder catches up."""
        def holds() -> bool:
            ours.send('bgr8', 1080, 1920)
            return condition()

        spin_until(camera, holds)

    send_until(lambda: 'Receiving video frame' in recorder.output)
    send_until(lambda: not camera.count_subscribers(TOPIC))
    recorder.interrupt()
    send_until(lambda: not recorder.is_running())
    assert recorder.finish() == 0, recorder.output
    assert f' {len(read_manifest(folder))} written' in recorder.output


@pytest.mark.thorough
@pytest.mark.process
@pytest.mark.parametrize('transport', ['auto', 'raw', 'shm'])
def test_recorder_that_joins_a_running_publisher(
        start: Start, camera: Node, tmp_path: Path, transport: str) -> None:
    ours = Camera(camera)
    first = start('img_subscriber', output_dir=tmp_path / 'first')
    spin_until(camera, lambda: ours.subscribers > 0)

    def send_until(condition: Callable[[], bool]) -> None:
        def step() -> bool:
            ours.send()
            return condition()

        spin_until(camera, step)

    send_until(lambda: 'Receiving video frame' in first.output)
    # More messages than a new publisher can have sent, even if it is found late. There are
    # messages as long as a plain subscription needs them.
    received = Event()
    plain = camera.create_subscription(Image, TOPIC, lambda _: received.set(), 10)
    send_until(received.is_set)
    for _ in range(2000):
        ours.send()
    camera.destroy_subscription(plain)
    send_until(lambda: not camera.count_subscribers(TOPIC))
    second = start('img_subscriber', output_dir=tmp_path / 'second', transport=transport,
                   max_frames=10)

    send_until(lambda: not second.is_running())
    assert second.finish() == 0, second.output
    before = re.search(r' lost in transit, (\d+) sent before the first received frame\n',
                       second.output)
    assert before and int(before[1]) > 2000, second.output
    first.interrupt()
    assert first.finish() == 0, first.output
    assert ' lost in transit\n' in first.output


@pytest.mark.process
def test_progress_bar_on_a_terminal(
        node: Node, publisher: Publisher, tmp_path: Path) -> None:
    with on_terminal('img_subscriber', output_dir=tmp_path / 'out', max_frames=20,
                     on_overflow='block') as terminal:
        image = np.zeros((4, 4), np.uint8)
        send(node, publisher, stamped(np.zeros((4, 4), np.float32), '32FC1', 1),
             *[stamped(image, 'mono8', 1)] * 19)
        assert terminal.finish() == 1
    text = terminal.text
    assert re.search(r'\rReceiving video frame 1/20 \|.*4x4 32FC1, 0 dropped', text)
    assert re.search(r'Receiving video frame 20/20 \|', text)
    for line in re.split(r'[\r\n]+', text):
        assert 'INFO' not in line or 'Receiving video frame' not in line, line


@pytest.mark.thorough
@pytest.mark.process
def test_bad_announcement_with_a_progress_bar(
        node: Node, publisher: Publisher, tmp_path: Path) -> None:
    announcements = node.create_publisher(String, f'/video_frames{SUFFIX}', LATCHED)
    announcements.publish(String(data='\x1b[2J'))
    with on_terminal('img_subscriber', '--log-level', 'image_subscriber:=debug',
                     output_dir=tmp_path / 'out', max_frames=3) as terminal:
        terminal.wait_for(']: the announcement is not JSON')
        send(node, publisher, *[stamped(np.zeros((4, 4), np.uint8), 'mono8', 1)] * 3)
        assert terminal.finish() == 0, terminal.text
    assert len(recorded_files(tmp_path / 'out')) == 3
