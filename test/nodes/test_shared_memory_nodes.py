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

"""Frames in shared memory between processes: pixels, killed processes, losses and full memory."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
import os
from pathlib import Path
import signal
import subprocess
from typing import Any

from conftest import spin_until
from opencv_tools.ros.shared_frames.memory import MAX_DEPTH
import pytest
from rclpy.node import Node
from sharing import RemoteCamera, RemoteViewer, Viewer, WINDOW

pytestmark = pytest.mark.process


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


@pytest.fixture
def view(node: Node) -> Iterator[Callable[..., Viewer]]:
    """Return a function that creates viewers in this process."""
    viewers: list[Viewer] = []

    def _view(**options: Any) -> Viewer:
        viewers.append(Viewer(node, **options))
        return viewers[-1]

    yield _view
    for viewer in viewers:
        viewer.subscription.destroy()


@pytest.fixture(params=[False, True], ids=['executor', 'thread'])
def viewer(request: pytest.FixtureRequest, view: Callable[..., Viewer]) -> Viewer:
    return view(in_thread=request.param)


class Memory:
    """A mount namespace with a /dev/shm of its own."""

    def __init__(self, command: Sequence[str], megabytes: float) -> None:
        mounted = f'mount -t tmpfs -o size={int(megabytes * 2**20)} none /dev/shm && echo && cat'
        self._keeper = subprocess.Popen(
            [*command, 'sh', '-c', mounted], stdin=subprocess.PIPE, stdout=subprocess.PIPE)
        assert self._keeper.stdout.readline() == b'\n'
        users = () if os.getuid() == 0 else ('--user', '--preserve-credentials')
        #: Prefix of a command that runs in the namespace.
        self.within = ('nsenter', '--mount', *users, f'--target={self._keeper.pid}')
        #: Path of the folder on this machine.
        self.path = Path(f'/proc/{self._keeper.pid}/root/dev/shm')

    def files(self) -> list[str]:
        """Return the names of the files of shared frames."""
        return sorted(str(path.relative_to(self.path))
                      for path in self.path.rglob('*') if 'opencv_tools' in str(path))

    def free(self) -> int:
        """Return the number of free bytes."""
        found = os.statvfs(self.path)
        return found.f_bavail * found.f_frsize

    def close(self) -> None:
        self._keeper.communicate()


@pytest.fixture
def memory(mount_namespace: Sequence[str]) -> Iterator[Callable[[float], Memory]]:
    """Return a function that creates a /dev/shm of a number of megabytes."""
    memories: list[Memory] = []

    def _create(megabytes: float) -> Memory:
        memories.append(Memory(mount_namespace, megabytes))
        return memories[-1]

    yield _create
    for created in memories:
        created.close()


def send_until(camera: RemoteCamera, viewer: RemoteViewer, condition: Callable[[], bool]) -> None:
    """Publish, at most a few frames ahead of a viewer, until a condition holds."""
    def step() -> bool:
        numbers = [number for name, number, _, _ in viewer.frames if name == camera.name]
        if not numbers or camera.sent - numbers[-1] < WINDOW:
            camera.send()
        return condition()

    viewer.wait_until(step)


# Pixels

ENCODINGS = (('mono8', 1, 1), ('bgr8', 481, 641), ('16UC1', 7, 3), ('32FC1', 5, 9),
             ('bayer_rggb8', 33, 35), ('nv21', 4, 6), ('yuv422_yuy2', 5, 4), ('mono16', 11, 13))


@pytest.mark.parametrize('transport', ['raw', 'auto', 'shm'])
def test_pixels_of_each_transport(
        view: Callable[..., Viewer], remote_camera: Callable[..., RemoteCamera], transport: str,
) -> None:
    viewer = view(transport=transport)
    camera = remote_camera()

    def step() -> bool:
        if not viewer.count or camera.sent - viewer.numbers['ours'][-1] < WINDOW:
            camera.send(*ENCODINGS[camera.sent % len(ENCODINGS)])
        return viewer.count >= 50 and (transport == 'raw' or viewer.shared >= 40)

    spin_until(viewer.node, step)
    assert bool(viewer.shared) == (transport != 'raw')
    numbers = viewer.numbers['ours']
    assert numbers == [*range(numbers[0], numbers[0] + viewer.count)]


def test_pixels_of_png(
        view: Callable[..., Viewer], remote_camera: Callable[..., RemoteCamera]) -> None:
    viewer = view(transport='compressed')
    camera = remote_camera()

    def step() -> bool:
        camera.send(*[('16UC1', 31, 33), ('mono16', 7, 5)][camera.sent % 2])
        return viewer.count >= 20

    spin_until(viewer.node, step)
    assert not viewer.shared


# Handover

def test_plain_publisher_beside_shared_frames(
        viewer: Viewer, remote_camera: Callable[..., RemoteCamera]) -> None:
    ours = remote_camera()
    viewer.match(ours)
    for turn in range(3):
        viewer.watch_sharing(ours)
        plain = remote_camera(f'plain{turn}', is_plain=True)
        viewer.watch(lambda: not viewer.is_sharing, ours)
        viewer.match(ours, plain)
        viewer.watch(lambda: not viewer.shared and plain.sent > 50,  # noqa: B023
              ours, plain)
        viewer.assert_complete(ours, plain)
        plain.destroy()
    viewer.watch_sharing(ours)
    viewer.assert_complete(ours)


def test_second_sharing_publisher(
        viewer: Viewer, remote_camera: Callable[..., RemoteCamera]) -> None:
    first = remote_camera('first')
    viewer.match(first)
    viewer.watch_sharing(first)
    second = remote_camera('second')
    viewer.watch(lambda: not viewer.is_sharing, first)
    viewer.match(first, second)
    viewer.watch_sharing(first, second)
    viewer.assert_complete(first, second)
    second.destroy()
    until = first.sent + 100
    viewer.watch(lambda: first.sent > until, first)
    viewer.assert_complete(first)
    assert viewer.is_sharing


# Killed and stopped processes

def test_killed_readers(viewer: Viewer, remote_camera: Callable[..., RemoteCamera],
                        remote_viewer: Callable[..., RemoteViewer]) -> None:
    ours = remote_camera()
    viewer.match(ours)
    viewer.watch_sharing(ours)
    for _ in range(4):  # together more than a service may have
        readers = [remote_viewer(held=3) for _ in range(5)]
        viewer.watch(lambda: all(reader.has_shared(5) for reader in readers), ours)  # noqa: B023
        for reader in readers:
            reader.kill()
        viewer.watch_sharing(ours)
    viewer.assert_complete(ours)


def test_killed_publishers(memory: Callable[[float], Memory],
                           remote_camera: Callable[..., RemoteCamera],
                           remote_viewer: Callable[..., RemoteViewer]) -> None:
    folder = memory(256)
    viewer = remote_viewer(within=folder.within, held=3)
    for turn in range(20):
        camera = remote_camera(f'turn{turn}', within=folder.within)
        viewer.wait_until(lambda: camera.subscribers > 0)  # noqa: B023
        send_until(camera, viewer, lambda: viewer.has_shared(5, camera.name))  # noqa: B023
        camera.kill()
    for turn in range(20):
        numbers = [number for name, number, _, _ in viewer.frames if name == f'turn{turn}']
        assert numbers == [*range(numbers[0], numbers[0] + len(numbers))]
    viewer.kill()
    counts = []
    for _ in range(2):  # a new process removes what killed ones left behind
        camera, viewer = remote_camera(within=folder.within), remote_viewer(within=folder.within)
        send_until(camera, viewer, lambda: viewer.has_shared(5))  # noqa: B023
        counts.append(len(folder.files()))
        camera.kill()
        viewer.kill()
    assert max(counts) < 60, folder.files()


def test_reader_that_keeps_every_frame(
        viewer: Viewer, remote_camera: Callable[..., RemoteCamera],
        remote_viewer: Callable[..., RemoteViewer]) -> None:
    ours = remote_camera()
    viewer.match(ours)
    keeper = remote_viewer(held=10**6)
    viewer.watch(lambda: keeper.has_shared(100), ours)
    viewer.assert_complete(ours)
    keeper.wait_until(lambda: keeper.frames[-1][1] == ours.sent)
    numbers = [number for _, number, _, _ in keeper.frames]
    assert numbers == [*range(numbers[0], ours.sent + 1)]
    assert keeper.frames[-1][3] == 0


def test_losses_of_a_stopped_reader(
        viewer: Viewer, remote_camera: Callable[..., RemoteCamera],
        remote_viewer: Callable[..., RemoteViewer]) -> None:
    ours = remote_camera()
    viewer.match(ours)
    stopped = remote_viewer()
    viewer.watch(lambda: stopped.has_shared(5), ours)
    first = next(index for index, frame in enumerate(stopped.frames) if frame[2])
    _, first_number, _, lost_before = stopped.frames[first]
    for turn in range(1, 4):
        stopped.signal(signal.SIGSTOP)
        until = ours.sent + 200
        viewer.watch(lambda: ours.sent > until, ours)  # noqa: B023
        stopped.signal(signal.SIGCONT)
        stopped.wait_until(lambda: stopped.frames[-1][1] == ours.sent)
        numbers = [number for _, number, _, _ in stopped.frames[first:]]
        lost = stopped.frames[-1][3] - lost_before
        assert numbers == sorted(set(numbers))
        assert len(numbers) + lost == ours.sent - first_number + 1
        assert lost >= turn * (200 - MAX_DEPTH)
    viewer.assert_complete(ours)
