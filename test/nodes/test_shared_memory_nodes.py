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
from concurrent.futures import ThreadPoolExecutor
import os
from pathlib import Path
import signal
import subprocess
import sys

from conftest import NodeProcess, read_manifest, spin_until
import cv2
import numpy as np
from opencv_tools.transport.shared_frames import publisher as shared_publisher
from opencv_tools.transport.shared_frames.memory import MAX_DEPTH
import pytest
from rclpy.node import Node
from sharing import (
    Camera, picture, RemoteCamera, RemoteViewer, send_until, TOPIC, Viewer, WINDOW)
from waiting import communicate, LONGEST_SECONDS, pause

pytest_plugins = ['sharing']
pytestmark = [pytest.mark.process, pytest.mark.thorough]


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


# Pixels

ENCODINGS = (('mono8', 1, 1), ('bgr8', 481, 641), ('16UC1', 7, 3), ('32FC1', 5, 9),
             ('bayer_rggb8', 33, 35), ('nv21', 4, 6), ('yuv422_yuy2', 5, 4), ('mono16', 11, 13))


@pytest.mark.parametrize('transport', ['raw', 'auto', 'shm'])
@pytest.mark.parametrize('is_loaned', [False, True], ids=['array', 'loan'])
def test_pixels_of_each_transport(
        view: Callable[..., Viewer], remote_camera: Callable[..., RemoteCamera], transport: str,
        is_loaned: bool) -> None:
    viewer = view(transport=transport)
    camera = remote_camera(is_loaned=is_loaned)

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
        viewer.watch(
            lambda: not viewer.shared and plain.sent > 50, ours, plain)  # noqa: B023
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


def test_nothing_is_written_for_killed_readers(
        node: Node, remote_viewer: Callable[..., RemoteViewer]) -> None:
    camera = Camera(node)
    killed = remote_viewer()
    send_until(camera, killed, lambda: killed.has_shared(5))
    killed.kill()

    def send_until_unread() -> bool:
        camera.send()
        return not camera.frames._topics.shared._writer.readers

    spin_until(node, send_until_unread)


@pytest.mark.parametrize('count', [1, 3, 10])
def test_frames_before_the_end_of_a_publisher(
        node: Node, remote_viewer: Callable[..., RemoteViewer], monkeypatch: pytest.MonkeyPatch,
        count: int) -> None:
    monkeypatch.setattr(shared_publisher, '_LEAVE_SECONDS', LONGEST_SECONDS)
    camera = Camera(node)
    viewer = remote_viewer(held=3)
    send_until(camera, viewer, lambda: viewer.has_shared(5))
    viewer.signal(signal.SIGSTOP)
    for number in range(count):
        camera.send(height=100 << number)  # in memory that is new to the reader
    with ThreadPoolExecutor(1) as pool:
        end = pool.submit(camera.destroy)
        pause(0.1)
        assert not end.done()
        viewer.signal(signal.SIGCONT)
        end.result()
    viewer.wait_until(lambda: viewer.frames[-1][1] == camera.sent)


@pytest.mark.parametrize('is_stopped', [False, True])
def test_end_of_publishers_while_a_reader_is_stopped(
        node: Node, remote_viewer: Callable[..., RemoteViewer], monkeypatch: pytest.MonkeyPatch,
        capfd: pytest.CaptureFixture[str], is_stopped: bool) -> None:
    monkeypatch.setattr(
        shared_publisher, '_LEAVE_SECONDS', 0.1 if is_stopped else LONGEST_SECONDS)
    camera = Camera(node)
    viewer = remote_viewer()
    send_until(camera, viewer, lambda: viewer.has_shared(5))
    if is_stopped:
        viewer.signal(signal.SIGSTOP)
    camera.destroy()
    published = sum(camera.frames.sent.values())
    count = min(published, MAX_DEPTH)
    warning = f'up to {count} of the last frames on {TOPIC}/shm were not received by each'
    assert capfd.readouterr().err.count(warning) == is_stopped
    assert published == camera.sent - camera.frames.without_subscribers


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


def test_publisher_killed_while_a_loan_is_filled(
        viewer: Viewer, remote_camera: Callable[..., RemoteCamera]) -> None:
    ours, other = remote_camera(is_loaned=True), remote_camera('other', is_loaned=True)
    viewer.match(ours, other)
    viewer.watch_sharing(ours, other)
    ours.kill_while_filling()
    until = other.sent + 50
    viewer.watch(lambda: other.sent > until, other)
    viewer.assert_complete(ours, other)


def test_reader_that_keeps_every_frame(
        remote_camera: Callable[..., RemoteCamera],
        remote_viewer: Callable[..., RemoteViewer]) -> None:
    ours = remote_camera()
    keeper, other = remote_viewer(held=10**6), remote_viewer()
    send_until(ours, keeper, lambda: keeper.has_shared(100) and other.has_shared(100))
    for viewer in (keeper, other):
        viewer.wait_until(lambda: viewer.frames[-1][1] == ours.sent)  # noqa: B023
        # The first two frames tell whether those before them count as lost.
        frames = viewer.frames[next(index for index, (*_, is_shared, _) in enumerate(viewer.frames)
                                    if index > 1 and is_shared):]
        numbers = [number for _, number, _, _ in frames]
        lost = frames[-1][3] - frames[0][3]
        assert len(numbers) + lost == ours.sent - numbers[0] + 1
        assert numbers == sorted(set(numbers))
    assert keeper.frames[-100][3] == keeper.frames[-1][3]


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


TORN = """
import random, sys, time, zlib
import numpy as np
from opencv_tools.transport.shared_frames.header import FrameHeader
from opencv_tools.transport.shared_frames.memory import FrameMemory
COUNT, seed, service = 10000, int(sys.argv[1]), sys.argv[2] if len(sys.argv) > 2 else ''
choose = random.Random(seed)
if service:
    reader = FrameMemory().open_reader(service, choose.choice((1, 3, 16)))
    print('ready', flush=True)
    held, received, last, torn = [], 0, 0, 0
    while last < COUNT:
        if not reader.wait(0.05):
            continue
        while frame := reader.receive():
            assert frame.header.number > last
            last = frame.header.number
            received += 1
            torn += zlib.crc32(frame.data) != frame.header.height
            held.append(frame)
            while held and choose.random() < 0.6:
                old = held.pop(choose.randrange(len(held)))
                torn += zlib.crc32(old.data) != old.header.height
            if choose.random() < 0.01:
                time.sleep(choose.uniform(0, 0.01))
    torn += sum(zlib.crc32(old.data) != old.header.height for old in held)
    print(received, torn)
else:
    random_bytes = np.random.default_rng(seed).integers(0, 256, 2**20, np.uint8)
    writer = FrameMemory().create_writer(1000)
    print(writer.service, flush=True)
    sys.stdin.readline()
    for number in range(COUNT):
        size, first = choose.randrange(1, 30000), choose.randrange(2**19)
        slot = writer.lend(size)
        loan, views = slot.loan()
        loan[:] = random_bytes[first:first + size]
        del loan
        assert views() is None
        slot.publish(FrameHeader(height=zlib.crc32(slot.data), number=number + 1), '', 'mono8')
    sys.stdin.readline()
"""


def test_frames_are_never_torn() -> None:
    def run(*arguments: object) -> subprocess.Popen[str]:
        return subprocess.Popen(
            [sys.executable, '-c', TORN, *map(str, arguments)], stdin=subprocess.PIPE,
            stdout=subprocess.PIPE, text=True)

    processes = [run(7)]
    try:
        service = processes[0].stdout.readline().strip()
        processes += [run(seed, service) for seed in range(4)]
        assert all(reader.stdout.readline() == 'ready\n' for reader in processes[1:])
        processes[0].stdin.write('\n')
        processes[0].stdin.flush()
        for reader in processes[1:]:
            received, torn = map(int, communicate(reader)[0].split())
            assert (reader.returncode, torn) == (0, 0)
            assert 0 < received <= 10000
        communicate(processes[0])
        assert processes[0].returncode == 0
    finally:
        for process in processes:
            process.kill()
            process.communicate()


# Memory that is short

@pytest.mark.parametrize('left', [600_000, 0])
@pytest.mark.parametrize('is_loaned', [False, True], ids=['array', 'loan'])
def test_memory_that_becomes_full(
        left: int, is_loaned: bool, memory: Callable[[float], Memory],
        remote_camera: Callable[..., RemoteCamera],
        remote_viewer: Callable[..., RemoteViewer]) -> None:
    folder = memory(64)
    camera = remote_camera(within=folder.within, is_loaned=is_loaned)
    viewer = remote_viewer(within=folder.within)

    def send(condition: Callable[[], bool]) -> None:
        send_until(camera, viewer, condition, 'bgr8', 480, 640)

    send(lambda: viewer.has_shared(20))
    file = folder.path / 'filling'
    try:
        file.write_bytes(bytes(folder.free() - left))
        send(lambda: len(viewer.frames) > 40 and not any(
            frame[2] for frame in viewer.frames[-20:]))
        file.unlink()
        send(lambda: viewer.has_shared(20))
    finally:
        file.unlink(missing_ok=True)
    # The first two frames tell whether those before them count as lost.
    numbers = [number for _, number, _, _ in viewer.frames[2:]]
    lost = viewer.frames[-1][3] - viewer.frames[2][3]
    assert numbers == sorted(set(numbers))
    assert len(numbers) + lost == numbers[-1] - numbers[0] + 1
    assert lost <= 2  # one at each change of the way


# Where frames cannot be shared

BROKEN = {'not found': 'raise ImportError("no module named iceoryx2")', 'other version': ''}


@pytest.mark.parametrize('broken', BROKEN)
def test_broken_iceoryx2(viewer: Viewer, remote_camera: Callable[..., RemoteCamera],
                         start: Callable[..., NodeProcess], monkeypatch: pytest.MonkeyPatch,
                         tmp_path: Path, broken: str) -> None:
    (tmp_path / 'iceoryx2.py').write_text(BROKEN[broken])
    ours = remote_camera(PYTHONPATH=str(tmp_path))
    viewer.match(ours)
    viewer.watch(lambda: ours.sent > 100, ours)
    viewer.assert_complete(ours)
    assert not viewer.shared
    ours.destroy()
    sharing = remote_camera('sharing')
    monkeypatch.setenv('PYTHONPATH', str(tmp_path), prepend=':')
    recorder = start('img_subscriber', '--ros-args', '--log-level', 'image_subscriber:=debug')
    reason = 'is not received by shared memory: iceoryx2'

    def step() -> bool:
        sharing.send()
        return reason in recorder.output and 'Receiving video frame' in recorder.output

    spin_until(viewer.node, step)
    recorder.interrupt()
    assert recorder.finish() == 0
    assert recorder.output.count(reason) == 1


def test_transport_of_ros(viewer: Viewer, remote_camera: Callable[..., RemoteCamera]) -> None:
    ours = remote_camera(OPENCV_TOOLS_TRANSPORT='default')
    viewer.match(ours)
    viewer.watch(lambda: ours.sent > 100, ours)
    viewer.assert_complete(ours)
    assert not viewer.shared
    assert not viewer.node.count_publishers(f'{TOPIC}/shm')


def test_recorder_of_shared_frames(
        remote_camera: Callable[..., RemoteCamera], start: Callable[..., NodeProcess],
        node: Node, tmp_path: Path) -> None:
    folder = tmp_path / 'out'
    recorder = start('img_subscriber', output_dir=folder, file_name='"{stamp}.png"',
                     transport='shm', max_frames=30)
    ours = remote_camera()

    def step() -> bool:
        ours.send('bgr8', 31, 17)
        assert not ours.subscribers
        return not recorder.is_running()

    spin_until(node, step)
    assert recorder.finish() == 0, recorder.output
    lines = read_manifest(folder)
    assert len(lines) == 30
    for line in lines:
        found = cv2.imread(str(folder / line['file']), cv2.IMREAD_UNCHANGED)
        assert np.array_equal(found, picture(line['stamp']['sec'], 'bgr8', 31, 17))


@pytest.mark.parametrize(('plain', 'environment', 'text'), [
    (False, {'OPENCV_TOOLS_TRANSPORT': 'default'}, 'it has no frames yet, or is not of '
     'opencv_tools with iceoryx2; set transport:=auto'),
    (True, {}, 'is not of opencv_tools with iceoryx2; set transport:=auto')])
def test_explanation_of_frames_that_are_not_shared(
        remote_camera: Callable[..., RemoteCamera], start: Callable[..., NodeProcess],
        node: Node, plain: bool, environment: dict[str, str], text: str) -> None:
    recorder = start('img_subscriber', transport='shm')
    ours = remote_camera(is_plain=plain, **environment)

    def step() -> bool:
        ours.send()
        return text in recorder.output

    spin_until(node, step)
    assert recorder.output.count('No frames: /video_frames has a publisher that does not share '
                                 'its frames with this process') == 1


def test_explanation_without_iceoryx2(
        start: Callable[..., NodeProcess], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv('OPENCV_TOOLS_TRANSPORT', 'default')
    recorder = start('img_subscriber', transport='shm')
    recorder.wait_for("install it with 'pip install iceoryx2' (see Install in the README), or")
    recorder.interrupt()
    assert recorder.finish() == 0


@pytest.mark.parametrize('place', ['container', 'user'] if os.getuid() == 0 else ['container'])
def test_publisher_in_another_place(
        memory: Callable[[float], Memory], remote_camera: Callable[..., RemoteCamera],
        remote_viewer: Callable[..., RemoteViewer], monkeypatch: pytest.MonkeyPatch,
        tmp_path: Path, place: str) -> None:
    # Fast DDS has no shared memory between these places.
    monkeypatch.setenv('FASTDDS_BUILTIN_TRANSPORTS', 'UDPv4')
    monkeypatch.setenv('ROS_AUTOMATIC_DISCOVERY_RANGE', 'SUBNET')
    folder = memory(64)
    other = [*folder.within]
    if place == 'container':
        other = [*memory(64).within]
    else:
        (tmp_path / 'log').mkdir()
        (tmp_path / 'log').chmod(0o777)
        monkeypatch.setenv('ROS_LOG_DIR', str(tmp_path / 'log'))
        # The other user may read everything, such as the interpreter in a folder of root.
        other += ['setpriv', '--reuid=65534', '--regid=65534', '--clear-groups',
                  '--inh-caps=-all,+dac_read_search', '--ambient-caps=-all,+dac_read_search']
    camera = remote_camera(within=other)
    viewer = remote_viewer(within=folder.within)
    only_shared = remote_viewer(within=folder.within, transport='shm')
    send_until(camera, viewer, lambda: len(viewer.frames) > 100)
    assert not any(frame[2] for frame in viewer.frames)
    numbers = [number for _, number, _, _ in viewer.frames]
    assert numbers == [*range(numbers[0], numbers[0] + len(numbers))]
    assert not only_shared.frames
    neighbour = remote_camera('neighbour', within=folder.within)
    camera.destroy()
    send_until(neighbour, viewer, lambda: viewer.has_shared(5, 'neighbour'))
