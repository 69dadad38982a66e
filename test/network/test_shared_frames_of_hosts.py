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

"""Shared frames on one host, with little shared memory or beside another host."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from hosts import new_host, two_hosts
import pytest
from sharing import RemoteCamera, RemoteViewer, send_until, WINDOW

pytest_plugins = ['sharing']


@pytest.fixture(autouse=True)
def usual_discovery(domain: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """Let nodes discover each other as by default; a host has a network of its own."""
    monkeypatch.setenv('ROS_AUTOMATIC_DISCOVERY_RANGE', 'SUBNET')


def test_viewers_of_two_hosts(tmp_path: Path) -> None:
    with two_hosts('datagrams') as (near, far):
        camera = RemoteCamera(within=near.within)
        viewers = [RemoteViewer(tmp_path / f'{host.address}.log', within=host.within)
                   for host in (near, far)]
        beside, remote = viewers

        def step() -> bool:
            if all(not viewer.frames or camera.sent - viewer.frames[-1][1] < WINDOW
                   for viewer in viewers):
                camera.send('mono8', 48, 64)
            return beside.has_shared(100) and len(remote.frames) > 100

        try:
            remote.wait_until(step)
            for viewer in viewers:
                numbers = [number for _, number, _, _ in viewer.frames]
                assert numbers == [*range(numbers[0], numbers[0] + len(numbers))]
            assert not any(frame[2] for frame in remote.frames)
        finally:
            for process in (camera, *viewers):
                process.kill()


Shared = Callable[[int], bool]


@pytest.fixture
def are_large_frames_shared(
        remote_camera: Callable[..., RemoteCamera], remote_viewer: Callable[..., RemoteViewer],
        ) -> Shared:
    """
    Return a function: whether some of many 1080p frames are shared, with so many megabytes.

    Three viewers, which hold 0, 3 and 9 frames, each receive more than 40 frames. The function
    asserts that they go on and receive no frame twice.
    """
    def send(megabytes: int) -> bool:
        with new_host(shared_memory=f'{megabytes}m') as host:
            camera = remote_camera(within=host.within)
            viewers = [remote_viewer(within=host.within, held=held) for held in (0, 3, 9)]
            for viewer in viewers:
                send_until(camera, viewer, lambda: len(viewer.frames) > 40,  # noqa: B023
                           'bgr8', 1080, 1920)
            assert all(viewer.is_running() for viewer in viewers)
            for viewer in viewers:
                numbers = [number for _, number, _, _ in viewer.frames]
                # Fast DDS may deliver a message late to a new subscription, after the next one.
                assert len(numbers) == len(set(numbers))
            return any(frame[2] for viewer in viewers for frame in viewer.frames)

    return send


def test_large_frames_without_room_in_memory(are_large_frames_shared: Shared) -> None:
    assert not are_large_frames_shared(4)


@pytest.mark.parametrize('megabytes', [14, 32])
def test_large_frames_in_little_memory(are_large_frames_shared: Shared, megabytes: int) -> None:
    are_large_frames_shared(megabytes)  # they have room at times, beside Fast DDS


def test_large_frames_in_enough_memory(are_large_frames_shared: Shared) -> None:
    assert are_large_frames_shared(64)
