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

"""Videos and image files, published by the executable and received in another process."""

from __future__ import annotations

from collections.abc import Callable
import functools
from pathlib import Path
import re

from conftest import CLIP, CLIP_FRAMES, decode_clip, NodeProcess, read_pictures, spin_until
import cv2
from images import draw_pattern
import numpy as np
from opencv_tools.cv_bridge import CvBridge
import pytest
from rclpy.node import Node
from rclpy.serialization import deserialize_message
from rclpy.time import Time
from sensor_msgs.msg import CompressedImage, Image

Start = Callable[..., NodeProcess]

# When the frames of data/variable_frame_rate.* are shown, in milliseconds.
TIMES = (0, 20, 60, 160, 200, 600, 640, 660, 740, 990, 1010, 1050, 1130, 1430, 1450, 1490, 1690,
         1730, 1750, 2000)


class Run:
    """A publisher in a namespace of its own, and what a subscriber in this process gets of it."""

    def __init__(self, start: Start, node: Node, name: str = 'run', **parameters: object) -> None:
        self.arrived: list[bytes] = []
        # Raw, for to take 2.7 MB apart while the next frame is due would hold up the publisher.
        node.create_subscription(
            Image, f'/{name}/video_frames', self.arrived.append, 1000, raw=True)
        self.publisher = start('img_publisher', '--ros-args', '-r', f'__ns:=/{name}',
                               **{'wait_for_subscribers': 1, **parameters})

    @functools.cached_property
    def messages(self) -> list[Image]:
        """All that has come, once the run is over."""
        return [deserialize_message(message, Image) for message in self.arrived]

    def is_over(self) -> bool:
        """Return whether all frames were published and received."""
        ended = re.search(r'Published (\d+) frames', self.publisher.output)
        return ended is not None and len(self.arrived) >= int(ended[1])


def finish(node: Node, *runs: Run, status: int = 0) -> str:
    """Wait until runs are over; the console of the last."""
    spin_until(node, lambda: all(run.is_over() for run in runs))
    for run in runs:
        assert run.publisher.finish() == status, run.publisher.output
    return runs[-1].publisher.output


def gaps(messages: list[Image]) -> np.ndarray:
    """Return the intervals between stamps in ms."""
    return np.diff([Time.from_msg(message.header.stamp).nanoseconds for message in messages]) / 1e6


def assert_gaps(messages: list[Image], expected: np.ndarray | float) -> None:
    """Compare with milliseconds; a busy machine may be later than that, but never earlier."""
    late = gaps(messages) - expected
    assert min(late) > -1.0


@functools.cache
def clip() -> list[np.ndarray]:
    return decode_clip()


def pixels(messages: list[Image]) -> list[np.ndarray]:
    return [CvBridge().imgmsg_to_cv2(message) for message in messages]


def assert_equal(received: list[np.ndarray], expected: list[np.ndarray]) -> None:
    for left, right in zip(received, expected, strict=True):
        np.testing.assert_array_equal(left, right, strict=True)


def assert_lines(console: str) -> None:
    """Every line is the node's own: nothing of FFmpeg or OpenCV."""
    own = re.compile(r'\[(INFO|WARN|ERROR)\] \[[0-9.]+\] \[([a-z_]+\.)?image_publisher\]: ')
    assert [line for line in console.splitlines() if not own.match(line)] == []


def write_numbered(folder: Path, count: int) -> None:
    """Write pictures that are as gray as their number."""
    folder.mkdir()
    for number in range(count):
        cv2.imwrite(str(folder / f'{number}.png'), np.full((6, 9), number, np.uint8))


def numbers(messages: list[Image]) -> list[int]:
    return [message.data[0] for message in messages]


@pytest.mark.thorough
def test_clip_is_published_in_order_and_in_time(
        start: Start, node: Node) -> None:
    run = Run(start, node, source=CLIP, publish_rate=0)
    finish(node, run)
    assert_equal(pixels(run.messages), clip())
    assert_gaps(run.messages, 40.0)


@pytest.mark.thorough
def test_stamps_of_a_variable_frame_rate(start: Start, node: Node) -> None:
    runs = [Run(start, node, suffix, source=CLIP.with_name(f'variable_frame_rate.{suffix}'),
                publish_rate=0) for suffix in ('mp4', 'mkv')]
    finish(node, *runs)
    for run in runs:
        assert_gaps(run.messages, np.diff(TIMES))
        for number, image in enumerate(pixels(run.messages)):  # each picture has its own time
            difference = [np.abs(draw_pattern(other, 64, 48) - image.astype(int)).mean()
                          for other in range(len(TIMES))]
            assert np.argmin(difference) == number


@pytest.mark.thorough
def test_frames_without_times_use_the_rate_of_the_file(
        start: Start, node: Node, tmp_path: Path) -> None:
    # The AVI has B-frames and no times: OpenCV tells 40, 80, ..., 280 and 0 ms.
    writer = cv2.VideoWriter(str(tmp_path / 'in.avi'), cv2.CAP_FFMPEG,
                             cv2.VideoWriter_fourcc(*'mpg2'), 25.0, (64, 48))
    for number in range(8):
        writer.write(draw_pattern(number, 64, 48))
    writer.release()
    run = Run(start, node, source='in.avi', publish_rate=0, start_frame=1, loop=5)
    finish(node, run)
    assert len(run.messages) == 35
    assert_gaps(run.messages, 40.0)


def damage(kind: str) -> bytes:
    """Create the clip with the last 40 % of its frames overwritten or cut off."""
    content = bytearray(CLIP.read_bytes())
    data, index = content.index(b'mdat') - 4, content.index(b'moov') - 4
    begin = data + (index - data) * 6 // 10
    randomness = np.random.default_rng(4)
    if kind == 'overwritten':
        content[begin:index] = randomness.bytes(index - begin)
    elif kind == 'spots':
        for position in randomness.integers(begin, index, 40):
            content[position] ^= 0xff
    elif kind == 'index_first':
        # The index moves before the data, so that the data's addresses grow by its size.
        moov = content[index:]
        table = moov.index(b'stco') + 12
        count = int.from_bytes(moov[table - 4:table], 'big')
        addresses = np.frombuffer(moov, '>u4', count, table) + len(moov)
        moov[table:table + 4 * count] = addresses.astype('>u4').tobytes()
        content = content[:data] + moov + content[data:begin]
    else:
        content = content[:begin]
    return bytes(content)


@pytest.mark.thorough
def test_damaged_video_plays_up_to_the_damage(
        start: Start, node: Node, tmp_path: Path) -> None:
    runs = {}
    for kind in ('overwritten', 'index_first', 'spots'):
        (tmp_path / f'{kind}.mp4').write_bytes(damage(kind))
        runs[kind] = Run(start, node, kind, source=f'{kind}.mp4', publish_rate=50,
                         encoding='mono8')
    finish(node, *runs.values())
    expected = [cv2.cvtColor(frame, cv2.COLOR_BGR2GRAY) for frame in clip()[:47]]
    for kind, run in runs.items():
        count, console = len(run.messages), run.publisher.output
        # Pictures after a damaged one are left out until the next key frame.
        assert count in ([*range(47, 91)] if kind == 'spots' else [47, 48])
        assert_equal(pixels(run.messages[:47]), expected)
        warnings = [line.partition(']: ')[2] for line in console.splitlines() if '[WARN]' in line]
        if kind == 'index_first':
            assert f'{kind}.mp4 is damaged: it ends after ' in warnings[-1]
        else:
            assert 0 <= CLIP_FRAMES - count - len(warnings) <= 1
            assert all(f'of {kind}.mp4 cannot be decoded' in line for line in warnings)
        assert_lines(console)


def test_video_without_index(start: Start, tmp_path: Path) -> None:
    (tmp_path / 'in.mp4').write_bytes(damage('cut_off'))
    publisher = start('img_publisher', source='in.mp4')
    assert publisher.finish() == 1
    assert 'in.mp4 cannot be opened as a video: it is damaged' in publisher.output
    assert_lines(publisher.output)


def jpeg(kind: str) -> bytes:
    """Return a JPEG with an embedded JPEG thumbnail, complete or cut off behind it."""
    noise = np.random.default_rng(6).integers(0, 256, (60, 80, 3), np.uint8)
    whole = cv2.imencode('.jpg', noise)[1].tobytes()
    thumbnail = b'\xff\xe1' + (len(whole) + 2).to_bytes(2, 'big') + whole
    return whole[:2] + thumbnail + whole[2:len(whole) // (2 if kind == 'cut off' else 1)]


@pytest.mark.parametrize(('name', 'content', 'reason'), [
    ('1.jpg', jpeg('cut off'), 'of a JPEG picture whose end is missing'),
    ('1.png', b'no picture', 'are not a picture that OpenCV can read')])
def test_broken_image_is_logged_and_counted(
        start: Start, node: Node, tmp_path: Path, name: str, content: bytes, reason: str) -> None:
    write_numbered(tmp_path / 'in', 1)
    (tmp_path / 'in' / name).write_bytes(content)
    (tmp_path / 'in' / '2.jpg').write_bytes(jpeg('whole'))
    run = Run(start, node, source='in', publish_rate=50)
    console = finish(node, run)
    assert [message.width for message in run.messages] == [9, 80]
    assert re.search(
        rf': frame dropped: in/{name} cannot be read: \d+ bytes {reason}\n', console)
    assert re.search(r'Published 2 frames at .* Hz, 1 dropped', console)


def test_image_encoding_is_preserved_to_disk(
        start: Start, node: Node, tmp_path: Path) -> None:
    (tmp_path / 'in').mkdir()
    kinds = {'0.png': ('mono16', 1), '1.png': ('bgr16', 3), '2.png': ('mono8', 1),
             '3.jpg': ('mono8', 1), '4.png': ('bgra8', 4), '5.jpg': ('bgr8', 3)}
    randomness = np.random.default_rng(5)
    for name, (encoding, channels) in kinds.items():
        depth = np.uint16 if encoding.endswith('16') else np.uint8
        image = randomness.integers(0, np.iinfo(depth).max, (6, 9, channels), depth, True)
        cv2.imwrite(str(tmp_path / 'in' / name), image)
    expected = [cv2.imread(str(tmp_path / 'in' / name), cv2.IMREAD_UNCHANGED) for name in kinds]
    subscriber = start('img_subscriber', '--ros-args', '-r', '__ns:=/run', output_dir='out',
                       max_frames=len(kinds))
    run = Run(start, node, source='in', encoding="''", publish_rate=50, wait_for_subscribers=2)
    finish(node, run)
    assert subscriber.finish() == 0, subscriber.output
    assert [message.encoding for message in run.messages] == [kind for kind, _ in kinds.values()]
    assert_equal(pixels(run.messages), expected)
    assert_equal(read_pictures(tmp_path / 'out'), expected)


def test_floats_with_a_compressed_reader(start: Start, node: Node, tmp_path: Path) -> None:
    depth = np.random.default_rng(5).normal(size=(6, 9)).astype(np.float32)
    cv2.imwrite(str(tmp_path / 'depth.tiff'), depth)
    node.create_subscription(CompressedImage, '/run/video_frames/compressed', print, 10)
    run = Run(start, node, source='depth.tiff', encoding="''", on_end='hold', publish_rate=50,
              max_frames=12, wait_for_subscribers=2)
    console = finish(node, run)
    assert [message.encoding for message in run.messages] == ['32FC1'] * 12
    assert_equal(pixels(run.messages), [depth] * 12)
    assert re.search(r'Published 12 frames at .* Hz, 0 dropped', console)
    assert [line.partition(']: ')[2] for line in console.splitlines() if '[WARN]' in line] == [
        '/run/video_frames/compressed has no frames: an image of 32FC1 cannot be stored '
        'as png; receive /run/video_frames, with transport:=raw or transport:=auto']


@pytest.mark.thorough
def test_part_of_a_folder_in_a_loop(
        start: Start, node: Node, tmp_path: Path) -> None:
    write_numbered(tmp_path / 'in', 4)
    whole = Run(start, node, 'whole', source='in', publish_rate=50, loop=3)
    part = Run(start, node, 'part', source='in', publish_rate=50, loop=2, start_frame=1,
               stop_frame=3)
    held = Run(start, node, 'held', source='in', publish_rate=50, start_frame=2, on_end='hold',
               max_frames=5)
    finish(node, whole, part, held)
    assert numbers(whole.messages) == [0, 1, 2, 3] * 3
    assert numbers(part.messages) == [1, 2, 1, 2]
    assert numbers(held.messages) == [2, 3, 3, 3, 3]


@pytest.mark.thorough
def test_video_deleted_during_a_loop(
        start: Start, node: Node, tmp_path: Path) -> None:
    copy = tmp_path / 'in.mp4'
    copy.write_bytes(CLIP.with_name('variable_frame_rate.mp4').read_bytes())
    run = Run(start, node, source='in.mp4', on_end='loop', publish_rate=50)
    spin_until(node, lambda: len(run.arrived) > len(TIMES))
    copy.unlink()
    console = finish(node, run, status=1)
    assert len(run.messages) % len(TIMES) == 0
    errors = [line for line in console.splitlines() if '[ERROR]' in line]
    assert len(errors) == 1 and 'in.mp4 cannot be opened as a video' in errors[0]
    assert_lines(console)


@pytest.mark.thorough
def test_image_deleted_during_a_loop(
        start: Start, node: Node, tmp_path: Path) -> None:
    write_numbered(tmp_path / 'in', 3)
    run = Run(start, node, source='in', on_end='loop', publish_rate=50, max_frames=60)
    spin_until(node, lambda: len(run.arrived) > 3)
    (tmp_path / 'in' / '1.png').unlink()
    console = finish(node, run)
    assert len(run.messages) == 60
    assert 'in/1.png cannot be read: No such file or directory' in console
    assert numbers(run.messages)[:4] == [0, 1, 2, 0]
    assert numbers(run.messages)[-4:] in ([0, 2, 0, 2], [2, 0, 2, 0])
