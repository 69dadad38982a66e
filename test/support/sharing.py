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

"""Cameras and viewers of numbered frames, in this process or as processes of their own."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import suppress
from functools import lru_cache
import json
import os
from pathlib import Path
import signal
import subprocess
import sys
import time
from typing import Any
from weakref import WeakSet
import zlib

from conftest import executor_of
import numpy as np
from opencv_tools.base.logs import Log
from opencv_tools.cv_bridge import CvBridge
from opencv_tools.frames import Frame, FramePublisher
from opencv_tools.image.encodings import find_encoding
from opencv_tools.topics.options import SubscriptionOptions
from opencv_tools.topics.queue import ReceivedMessage
from opencv_tools.topics.shared_source import SharedSource
from opencv_tools.topics.subscription import FrameSubscription
from opencv_tools.transport.fastdds.profile import configured_fastdds
import pytest
import rclpy
from rclpy.context import Context
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from sensor_msgs.msg import Image
from std_msgs.msg import Header
from waiting import pause, wait_until, work, work_of

TOPIC = '/video_frames'
LARGEST = 1080 * 1920 * 3  # bytes for which the process of a camera reserves memory
WINDOW = 5  # frames on their way; fewer than any queue holds


@lru_cache(256)
def picture(number: int, encoding: str = '16UC1', height: int = 3, width: int = 5) -> np.ndarray:
    """Return the random pixels of a numbered frame, which are read-only."""
    found = find_encoding(encoding)
    rows = found.rows(height)
    shape = (rows, width) if found.channels == 1 else (rows, width, found.channels)
    data = np.random.default_rng(number).bytes(rows * width * found.pixel_bytes)
    return np.frombuffer(data, found.dtype).reshape(shape)


def is_picture(frame: Frame) -> bool:
    """Return whether a frame has the pixels of its number, which is its stamp."""
    rows, width = frame.raw.shape[:2]
    height = find_encoding(frame.raw_encoding).height(rows)
    expected = picture(frame.stamp.sec, frame.raw_encoding, height, width)
    return frame.raw.shape == expected.shape and frame.raw.tobytes() == expected.tobytes()


class Camera:
    """A publisher of numbered frames, which shares them or is a plain publisher of rclpy."""

    def __init__(self, node: Node, name: str = 'ours', is_plain: bool = False,
                 topic: str = TOPIC, is_loaned: bool = False) -> None:
        self.name = name
        self.sent = 0
        self._node = node
        self._is_loaned = is_loaned
        self._plain = node.create_publisher(Image, topic, 10) if is_plain else None
        self.frames = None if is_plain else FramePublisher(node, topic)

    @property
    def subscribers(self) -> int:
        """Return the number of subscriptions of the image topic."""
        publisher = self._plain or self.frames._topics.images
        return int(publisher.get_subscription_count())

    def send(self, encoding: str = '16UC1', height: int = 3, width: int = 5) -> None:
        """Publish the next frame."""
        self.sent += 1
        pixels = picture(self.sent, encoding, height, width)
        header = Header(frame_id=self.name)
        header.stamp.sec = self.sent
        if self._plain:
            self._plain.publish(CvBridge().cv2_to_imgmsg(pixels, encoding, header=header))
        elif self._is_loaned:
            with self.frames.loan(height, width, encoding, header) as loan:
                loan.image[:] = pixels
        else:
            self.frames.publish(pixels, header, encoding=encoding)

    def die_while_filling(self) -> None:
        """End the process by SIGKILL when half of a loaned frame is filled."""
        with self.frames.loan(4, 4) as loan:
            loan.image[:2] = self.sent % 256
            os.kill(os.getpid(), signal.SIGKILL)

    def end_sharing(self) -> None:
        """Close the service without an announcement; the image topic remains."""
        self.frames._topics.shared.destroy()

    def destroy(self) -> None:
        """Remove the publisher."""
        if self._plain:
            self._node.destroy_publisher(self._plain)
        else:
            self.frames.destroy()


class RemoteCamera:
    """A camera in a process of its own."""

    def __init__(self, name: str = 'ours', is_plain: bool = False, within: Sequence[str] = (),
                 is_loaned: bool = False, **environment: str) -> None:
        self.name = name
        self.sent = 0
        self._process = subprocess.Popen(
            [*within, sys.executable, __file__, 'camera', name, str(int(is_plain)),
             str(int(is_loaned))],
            stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True,
            env=_environment(environment))
        self.pid = self._process.pid

    @property
    def subscribers(self) -> int:
        """Return the number of subscriptions of the image topic."""
        return int(self._ask(['subscribers']))

    def send(self, *arguments: object) -> None:
        """Publish the next frame, as `Camera.send` does."""
        self.sent += 1
        self._ask(['send', *arguments])

    def destroy(self) -> None:
        """End the process."""
        with suppress(BrokenPipeError):
            self._process.stdin.close()
        assert self._process.wait() == 0

    def kill(self) -> None:
        """End the process by SIGKILL."""
        self._process.kill()
        self._process.wait()

    def kill_while_filling(self) -> None:
        """End the process by SIGKILL when it has filled half of a loaned frame."""
        with pytest.raises(AssertionError, match='ended with status -9'):
            self._ask(['die while filling'])

    def _ask(self, command: list[object]) -> str:
        self._process.stdin.write(json.dumps(command) + '\n')
        self._process.stdin.flush()
        answer = self._process.stdout.readline()
        assert answer, f'the camera ended with status {self._process.wait()}'
        return answer


class Viewer:
    """A subscription that checks the pixels and collects the numbers of its frames."""

    def __init__(self, node: Node, transport: str = 'auto', threaded: bool = False,
                 depth: int | None = None, hold: Callable[[Frame], object] = bool) -> None:
        self.node = node
        self.numbers: dict[str, list[int]] = {}
        self.given: dict[str, list[int]] = {}  # numbers that the publisher gave
        self.errors: list[Exception] = []
        self.shared = 0  # number of newest frames that came from shared memory
        self._hold = hold
        self.subscription = FrameSubscription(
            node, TOPIC, Log(node.get_logger()), self._take, self.errors.append,
            SubscriptionOptions(transport=transport, depth=depth, threaded=threaded))
        self.subscription.start()

    @property
    def is_sharing(self) -> bool:
        """Whether all frames come from shared memory."""
        return self.subscription.is_shared

    @property
    def count(self) -> int:
        """Return the number of received frames."""
        return sum(map(len, self.numbers.values()))

    @property
    def publishers(self) -> int:
        """Return the number of publishers that the image topic connects."""
        reader = self.subscription._sources.image._reader
        return reader.publisher_count() if reader else 0

    @property
    def missed(self) -> int:
        """Return the number of frames that newer ones replaced, or that did not arrive."""
        return sum(self.subscription.account[:2])

    def received(self, camera: Camera | RemoteCamera) -> int:
        """Return the number of frames received from a camera."""
        return len(self.numbers.get(camera.name, ()))

    def _take(self, received: ReceivedMessage) -> None:
        message = received.message
        frame = Frame(message)
        assert is_picture(frame), (frame.frame_id, frame.stamp.sec, frame.description)
        self.numbers.setdefault(frame.frame_id, []).append(frame.stamp.sec)
        self.given.setdefault(frame.frame_id, []).append(received.number)
        self.shared = self.shared + 1 if isinstance(message.data, np.ndarray) else 0
        self._hold(frame)

    def watch(self, condition: Callable[[], bool], *cameras: Camera | RemoteCamera,
              window: int = WINDOW) -> None:
        """
        Spin this viewer, and publish from the cameras, until a condition holds.

        It looks at the condition first, so it publishes nothing if the condition holds at once;
        without cameras it only spins. A camera waits while this viewer lacks ``window`` of its
        frames. Of the frames, it asserts only the pixels, as `_take` does.
        """
        def step() -> None:
            for camera in cameras:
                if camera.sent - len(self.numbers.get(camera.name, ())) < window:
                    camera.send()
            executor.spin_once(timeout_sec=0.002)

        with executor_of(self.node) as executor:
            wait_until(condition, 'the condition', step, work=work,
                       sent=lambda: [camera.sent for camera in cameras],
                       received=lambda: {name: len(found) for name, found in self.numbers.items()})

    def watch_sharing(self, *cameras: Camera | RemoteCamera) -> None:
        """Publish until only shared memory is used and the newest 21 frames came from it."""
        self.watch(lambda: self.is_sharing and self.shared > 20, *cameras)

    def match(self, *cameras: Camera | RemoteCamera) -> None:
        """Wait, publishing nothing, until the image topic connects exactly these cameras."""
        self.watch(lambda: all(camera.subscribers for camera in cameras)
                   and self.publishers == len(cameras))

    def assert_complete(self, *cameras: Camera | RemoteCamera) -> None:
        """Wait for all frames sent; assert that each came once, in order, without an error."""
        self.watch(lambda: all(
            len(self.numbers.get(camera.name, ())) >= camera.sent for camera in cameras))
        for camera in cameras:
            assert self.numbers[camera.name] == [*range(1, camera.sent + 1)]
        assert self.subscription.account[:2] == (0, 0)
        assert self.errors == []


@pytest.fixture
def view(node: Node) -> Iterator[Callable[..., Viewer]]:
    """Return a function that creates viewers, which end with the test."""
    viewers: list[Viewer] = []

    def _view(**options: Any) -> Viewer:
        viewers.append(Viewer(node, **options))
        return viewers[-1]

    yield _view
    for viewer in viewers:
        viewer.subscription.destroy()


@pytest.fixture
def hold_threads(monkeypatch: pytest.MonkeyPatch) -> Callable[[Iterable[SharedSource]], None]:
    """
    Return a function that has the threads of some sources receive nothing more.

    It returns when each of these threads is held.
    It holds the threads of all other sources as well, until the end of the test.
    """
    held: WeakSet[SharedSource] = WeakSet()

    def wait(source: SharedSource) -> None:
        held.add(source)
        pause(0.01)

    def _hold(sources: Iterable[SharedSource]) -> None:
        monkeypatch.setattr(SharedSource, '_wait', wait)
        wait_until(lambda: {*sources} <= {*held}, 'the wait of the threads')

    return _hold


@pytest.fixture(params=[False, True], ids=['executor', 'thread'])
def viewer(request: pytest.FixtureRequest, view: Callable[..., Viewer]) -> Viewer:
    """Create a viewer that receives in the executor, and one that does so in a thread."""
    return view(threaded=request.param)


class RemoteViewer:
    """A viewer in a process of its own, which keeps its newest frames."""

    def __init__(self, log: Path, transport: str = 'auto', held: int = 0,
                 within: Sequence[str] = (), **environment: str) -> None:
        self._log = log
        with log.open('w') as console:
            self._process = subprocess.Popen(
                [*within, sys.executable, __file__, 'viewer', transport, str(held)],
                stdout=console, env=_environment(environment))
        self.pid = self._process.pid

    @property
    def frames(self) -> list[tuple[str, int, int, int]]:
        """Name and number, shared frames and lost frames until then, of each received frame."""
        text = self._log.read_text()
        return [tuple(json.loads(line)) for line in text[:text.rfind('\n') + 1].splitlines()
                if line.startswith('["')]  # Fast DDS prints its errors

    def wait_until(self, condition: Callable[[], bool]) -> None:
        """Wait for a condition; fail at once if the process has ended."""
        def is_met() -> bool:
            met = condition()
            assert met or self.is_running(), f'ended with status {self._process.poll()}'
            return met

        wait_until(is_met, frames=lambda: len(self.frames), work=lambda: work_of(self.pid))

    def has_shared(self, count: int, name: str = '') -> bool:
        """Return whether the newest frames came from shared memory, the last from a camera."""
        frames = self.frames
        return bool(frames) and frames[-1][2] >= count and name in ('', frames[-1][0])

    def is_running(self) -> bool:
        """Return whether the process is running."""
        return self._process.poll() is None

    def signal(self, number: int) -> None:
        """Send a signal."""
        self._process.send_signal(number)

    def kill(self) -> None:
        """End the process by SIGKILL."""
        self._process.kill()
        self._process.wait()


@pytest.fixture
def remote_camera() -> Iterator[Callable[..., RemoteCamera]]:
    """Return a function that starts cameras, which end with the test."""
    cameras: list[RemoteCamera] = []

    def _start(*arguments: Any, **options: Any) -> RemoteCamera:
        cameras.append(RemoteCamera(*arguments, **options))
        return cameras[-1]

    yield _start
    for camera in cameras:
        camera.kill()


@pytest.fixture
def remote_viewer(tmp_path: Path) -> Iterator[Callable[..., RemoteViewer]]:
    """Return a function that starts viewers, which end with the test."""
    viewers: list[RemoteViewer] = []

    def _start(**options: Any) -> RemoteViewer:
        viewers.append(RemoteViewer(tmp_path / f'viewer_{len(viewers)}.log', **options))
        return viewers[-1]

    yield _start
    for viewer in viewers:
        viewer.kill()


def send_until(camera: Camera | RemoteCamera, viewer: RemoteViewer,
               condition: Callable[[], bool], *picture: object) -> None:
    """
    Publish, a few frames ahead of a viewer or a few per second, until a condition holds.

    At least one frame is published before the first look at the condition. Nothing is asserted of
    the frames. Fails if the viewer ends.

    :param picture: encoding, height and width of the frames, as for `Camera.send`.
    """
    sent_at = 0.0

    def step() -> bool:
        nonlocal sent_at
        numbers = [number for name, number, _, _ in viewer.frames if name == camera.name]
        # Frames that find no room are lost, sometimes all that are on their way.
        if (not numbers or camera.sent - numbers[-1] < WINDOW
                or time.monotonic() > sent_at + 0.2):
            camera.send(*picture)
            sent_at = time.monotonic()
        return condition()

    viewer.wait_until(step)


def _environment(changed: dict[str, str]) -> dict[str, str]:
    folders = (*changed.pop('PYTHONPATH', '').split(':'), *sys.path)
    return {**os.environ, **changed, 'PYTHONPATH': ':'.join(filter(None, folders))}


def _context() -> Context:
    context = Context()
    rclpy.init(context=context)
    return context


def _run_camera(name: str, is_plain: str, is_loaned: str) -> None:
    camera = Camera(Node('remote_camera', context=_context()), name, is_plain == '1',
                    is_loaned=is_loaned == '1')
    for line in sys.stdin:
        command, *arguments = json.loads(line)
        if command == 'send':
            camera.send(*arguments)
        elif command == 'die while filling':
            camera.die_while_filling()
        print(camera.subscribers, flush=True)


def _run_viewer(transport: str, held: str) -> None:
    """Print what arrived, after each frame; ``held`` is a number of newest frames."""
    frames: list[tuple[Frame, int]] = []

    def report(frame: Frame) -> None:
        frames.append((frame, zlib.crc32(frame.raw)))
        del frames[:max(0, len(frames) - int(held))]
        if len(frames) < 10 or not frame.stamp.sec % 50:
            assert all(zlib.crc32(kept.raw) == checksum for kept, checksum in frames)
        print(json.dumps([frame.frame_id, frame.stamp.sec, viewer.shared,
                          viewer.missed]), flush=True)

    node = Node('remote_viewer', context=_context())
    viewer = Viewer(node, transport, hold=report)
    with suppress(ExternalShutdownException, KeyboardInterrupt), executor_of(node) as executor:
        executor.spin()


if __name__ == '__main__':
    run, largest = {'camera': (_run_camera, LARGEST), 'viewer': (_run_viewer, 0)}[sys.argv[1]]
    with configured_fastdds(largest):
        run(*sys.argv[2:])
