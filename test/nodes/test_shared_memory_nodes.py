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

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from conftest import spin_until
import pytest
from rclpy.node import Node
from sharing import is_picture, RemoteCamera, RemoteViewer, TOPIC, Viewer

pytestmark = pytest.mark.process
WINDOW = 5  # frames on their way; fewer than any queue holds


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


def watch(viewer: Viewer, condition: Callable[[], bool], *cameras: RemoteCamera) -> None:
    """Publish, at most a few frames ahead of the reception, until a condition holds."""
    def step() -> bool:
        for camera in cameras:
            if camera.sent - len(viewer.numbers.get(camera.name, ())) < WINDOW:
                camera.send()
        return condition()

    spin_until(viewer.node, step)


def watch_sharing(viewer: Viewer, *cameras: RemoteCamera) -> None:
    watch(viewer, lambda: viewer.is_sharing and viewer.shared > 20, *cameras)


def match(viewer: Viewer, *cameras: RemoteCamera) -> None:
    """Wait until the image topic connects the viewer and only these cameras."""
    spin_until(viewer.node, lambda: all(camera.subscribers for camera in cameras)
               and viewer.subscription._subscription.publisher_count() == len(cameras))


def assert_complete(viewer: Viewer, *cameras: RemoteCamera) -> None:
    """Check that every frame arrived once and in order."""
    spin_until(viewer.node, lambda: all(
        len(viewer.numbers.get(camera.name, ())) >= camera.sent for camera in cameras))
    for camera in cameras:
        assert viewer.numbers[camera.name] == [*range(1, camera.sent + 1)]
    assert viewer.subscription.losses.count == 0
    assert viewer.errors == []


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
    match(viewer, ours)
    for turn in range(3):
        watch_sharing(viewer, ours)
        plain = remote_camera(f'plain{turn}', is_plain=True)
        watch(viewer, lambda: not viewer.is_sharing, ours)
        match(viewer, ours, plain)
        watch(viewer, lambda: not viewer.shared and plain.sent > 50,  # noqa: B023
              ours, plain)
        assert_complete(viewer, ours, plain)
        plain.destroy()
    watch_sharing(viewer, ours)
    assert_complete(viewer, ours)


def test_second_sharing_publisher(
        viewer: Viewer, remote_camera: Callable[..., RemoteCamera]) -> None:
    first = remote_camera('first')
    match(viewer, first)
    watch_sharing(viewer, first)
    second = remote_camera('second')
    watch(viewer, lambda: not viewer.is_sharing, first)
    match(viewer, first, second)
    watch_sharing(viewer, first, second)
    assert_complete(viewer, first, second)
    second.destroy()
    until = first.sent + 100
    watch(viewer, lambda: first.sent > until, first)
    assert_complete(viewer, first)
    assert viewer.is_sharing
