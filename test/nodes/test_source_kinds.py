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

"""Every kind of source, published by the executable."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import suppress
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
import itertools
from pathlib import Path
from threading import Thread

from conftest import CLIP, decode_clip, NodeProcess, spin_until
import cv2
from images import draw_pattern
import numpy as np
from opencv_tools.cv_bridge import CvBridge
import pytest
from rclpy.node import Node
from sensor_msgs.msg import Image
from waiting import pause

Start = Callable[..., NodeProcess]


def receive(start: Start, node: Node, count: int, **parameters: object) -> list[np.ndarray]:
    """Start a publisher and receive its first frames, in the encoding they come in."""
    messages: list[Image] = []
    node.create_subscription(Image, 'video_frames', messages.append, 50 + count)
    publisher = start('img_publisher', wait_for_subscribers=1, publish_rate=50, **parameters)
    spin_until(node, lambda: len(messages) >= count)
    if parameters.get('on_end', 'stop') == 'stop' or 'max_frames' in parameters:
        assert publisher.finish() == 0, publisher.output
        assert len(messages) == count
    return [CvBridge().imgmsg_to_cv2(message) for message in messages[:count]]


def assert_equal(received: list[np.ndarray], expected: list[np.ndarray]) -> None:
    for left, right in zip(received, expected, strict=True):
        np.testing.assert_array_equal(left, right)


@pytest.fixture
def pictures(tmp_path: Path) -> list[np.ndarray]:
    """Write three pictures to a folder, and give them."""
    (tmp_path / 'in').mkdir()
    images = [np.random.default_rng(number).integers(0, 256, (6, 9, 3), np.uint8)
              for number in range(3)]
    for number, image in enumerate(images):
        cv2.imwrite(str(tmp_path / 'in' / f'{number}.png'), image)
    return images


def test_pattern(start: Start, node: Node) -> None:
    received = receive(start, node, 3, source='pattern:40x30', max_frames=3)
    assert_equal(received, [draw_pattern(number, 40, 30) for number in range(3)])


def test_video_file(start: Start, node: Node) -> None:
    received = receive(start, node, 5, source=CLIP, max_frames=5)
    assert_equal(received, decode_clip(5))


@pytest.mark.quick_cases(1)
@pytest.mark.parametrize('name', ['in', 'in/*.png', 'in/[0-2].png'])
def test_folder_and_glob(
        start: Start, node: Node, tmp_path: Path, pictures: list[np.ndarray], name: str) -> None:
    assert_equal(receive(start, node, 3, source=f"'{tmp_path / name}'"), pictures)


def test_image_file(
        start: Start, node: Node, tmp_path: Path, pictures: list[np.ndarray]) -> None:
    assert_equal(receive(start, node, 1, source=tmp_path / 'in' / '1.png'), pictures[1:2])


def test_relative_path(
        start: Start, node: Node, pictures: list[np.ndarray]) -> None:
    assert_equal(receive(start, node, 1, source='in/2.png'), pictures[2:])


@pytest.mark.quick_cases(1)
@pytest.mark.parametrize(('on_end', 'order'), [
    ('stop', [0, 1, 2]), ('loop', [0, 1, 2, 0, 1, 2, 0]), ('hold', [0, 1, 2, 2, 2])])
def test_end_of_a_source(
        start: Start, node: Node, tmp_path: Path, pictures: list[np.ndarray], on_end: str,
        order: list[int]) -> None:
    received = receive(start, node, len(order), source=tmp_path / 'in', on_end=on_end)
    assert_equal(received, [pictures[number] for number in order])


@pytest.mark.thorough
def test_video_loop(start: Start, node: Node) -> None:
    received = receive(
        start, node, 95, source=CLIP, on_end='loop', max_frames=95, encoding='mono8')
    expected = [cv2.cvtColor(frame, cv2.COLOR_BGR2GRAY) for frame in decode_clip()]
    assert_equal(received, expected + expected[:5])


def test_empty_encoding_keeps_the_depth(
        start: Start, node: Node, tmp_path: Path) -> None:
    depth = np.random.default_rng(5).integers(0, 65536, (6, 9), np.uint16)
    cv2.imwrite(str(tmp_path / 'depth.png'), depth)
    (received,) = receive(start, node, 1, source='depth.png', encoding="''")
    assert received.dtype == np.uint16
    np.testing.assert_array_equal(received, depth)


class StreamHandler(BaseHTTPRequestHandler):
    """
    A web server with the clip, and with a camera of about 30 frames a second.

    The gray of their left and right half are the low and the high byte of their number.
    """

    def do_GET(self) -> None:
        if self.path == '/clip.mp4':
            self.send_clip(int(self.headers.get('Range', 'bytes=0-')[len('bytes='):-1]))
            return
        self.send_response(200)
        self.send_header('Content-Type', 'multipart/x-mixed-replace; boundary=frame')
        self.end_headers()
        for number in range(15) if self.path == '/broken.mjpg' else itertools.count():
            halves = np.array([[number % 256, number // 256]], np.uint8)
            picture = cv2.imencode('.jpg', halves.repeat(48, 0).repeat(32, 1))[1].tobytes()
            head = f'--frame\r\nContent-Type: image/jpeg\r\nContent-Length: {len(picture)}\r\n\r\n'
            try:
                self.wfile.write(head.encode() + picture + b'\r\n')
            except OSError:
                return  # the reader has left
            pause(1 / 30)

    def send_clip(self, begin: int) -> None:
        """Send the clip from a byte on, as web servers do for who wants to seek in it."""
        content = CLIP.read_bytes()
        self.send_response(206)
        self.send_header('Content-Range', f'bytes {begin}-{len(content) - 1}/{len(content)}')
        self.send_header('Content-Length', str(len(content) - begin))
        self.end_headers()
        with suppress(OSError):  # the reader may leave
            self.wfile.write(content[begin:])

    def log_message(self, *_: object) -> None:
        pass


@pytest.fixture
def server() -> Iterator[ThreadingHTTPServer]:
    """Serve streams on this machine."""
    with ThreadingHTTPServer(('127.0.0.1', 0), StreamHandler) as running:
        Thread(target=running.serve_forever, daemon=True).start()
        yield running
        running.shutdown()


@pytest.mark.thorough
def test_file_on_a_web_server(
        start: Start, node: Node, server: ThreadingHTTPServer) -> None:
    url = f'http://127.0.0.1:{server.server_port}/clip.mp4'
    assert_equal(receive(start, node, 90, source=url), decode_clip())


def test_stream_until_a_signal(
        start: Start, node: Node, server: ThreadingHTTPServer) -> None:
    shown: list[int] = []
    node.create_subscription(
        Image, 'video_frames',
        lambda message: shown.append(message.data[0] + 256 * message.data[-1]), 10)
    url = f'http://127.0.0.1:{server.server_port}/camera.mjpg'
    publisher = start('img_publisher', source=url, publish_rate=10)
    spin_until(node, lambda: len(shown) >= 5)
    publisher.interrupt()  # while the stream goes on, which never ends
    assert publisher.finish() == 0, publisher.output
    assert shown == sorted(set(shown))


def test_reconnect_to_a_stream(
        start: Start, node: Node, server: ThreadingHTTPServer) -> None:
    shown: list[int] = []
    node.create_subscription(
        Image, 'video_frames', lambda message: shown.append(message.data[0]), 10)
    url = f'http://127.0.0.1:{server.server_port}/broken.mjpg'
    publisher = start('img_publisher', source=url, publish_rate=0)
    spin_until(node, lambda: sum(np.diff(shown) < 0) >= 2)  # it began again, twice
    assert publisher.output.count(f'{url} ended or is no longer reachable; waiting') >= 2
    assert publisher.output.count(f'{url} is back after') >= 2


def test_images_of_different_sizes_and_a_broken_one(
        start: Start, node: Node, tmp_path: Path, pictures: list[np.ndarray]) -> None:
    (tmp_path / 'in' / '1.png').write_text('no picture')
    large = np.zeros((20, 30, 3), np.uint8)
    cv2.imwrite(str(tmp_path / 'in' / '3.png'), large)
    assert_equal(receive(start, node, 3, source='in'), [pictures[0], pictures[2], large])


def test_image_that_cannot_be_converted_is_skipped(
        start: Start, node: Node, tmp_path: Path, pictures: list[np.ndarray]) -> None:
    cv2.imwrite(str(tmp_path / 'in' / '0.tiff'), np.zeros((4, 4), np.float32))
    assert_equal(receive(start, node, 3, source='in'), pictures)
