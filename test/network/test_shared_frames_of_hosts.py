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

"""Shared frames on one host beside the image topic to another host."""

from __future__ import annotations

from pathlib import Path

from hosts import two_hosts
import pytest
from sharing import RemoteCamera, RemoteViewer, WINDOW


def test_viewers_of_two_hosts(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv('ROS_AUTOMATIC_DISCOVERY_RANGE', 'SUBNET')
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
