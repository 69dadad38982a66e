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

"""Small /dev/shm of containers, and Fast DDS profiles of users."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from conftest import NodeProcess, read_pictures
from hosts import new_host
from images import draw_pattern
import numpy as np
import pytest

Start = Callable[..., NodeProcess]

COUNT = 30
UDP_ONLY = """<?xml version="1.0" encoding="UTF-8"?>
<profiles xmlns="http://www.eprosima.com/XMLSchemas/fastRTPS_Profiles">
  <transport_descriptors>
    <transport_descriptor>
      <transport_id>udp</transport_id>
      <type>UDPv4</type>
    </transport_descriptor>
  </transport_descriptors>
  <participant profile_name="users" is_default_profile="true">
    <rtps>
      <userTransports>
        <transport_id>udp</transport_id>
      </userTransports>
      <useBuiltinTransports>false</useBuiltinTransports>
    </rtps>
  </participant>
</profiles>
"""


@pytest.fixture(autouse=True)
def usual_discovery(domain: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """
    Let nodes find one another as by default; a host has a network of its own.

    With LOCALHOST rmw_fastrtps adds shared memory to the transports of any profile.
    """
    monkeypatch.setenv('ROS_AUTOMATIC_DISCOVERY_RANGE', 'SUBNET')


def assert_delivered(
        start: Start, within: tuple[str, ...], folder: Path, width: int, height: int,
) -> NodeProcess:
    """Send frames from one node to the other; the publisher, when it has ended."""
    subscriber = start('img_subscriber', within=within, output_dir=folder, max_frames=COUNT,
                       timeout=15)
    publisher = start('img_publisher', within=within, source=f'pattern:{width}x{height}@10',
                      publish_rate=0.0, max_frames=COUNT, wait_for_subscribers=1)
    assert subscriber.finish() == 0, subscriber.output
    assert publisher.finish() == 0, publisher.output
    pictures = read_pictures(folder)
    assert len(pictures) == COUNT
    assert all(np.array_equal(picture, draw_pattern(number, width, height))
               for number, picture in enumerate(pictures))
    for process in (subscriber, publisher):
        assert not [line for line in process.output.splitlines()
                    if 'Error' in line or '[RTPS' in line or '[ERROR]' in line]
    return publisher


def warnings_of_shared_memory(process: NodeProcess) -> list[str]:
    """List the warnings that name /dev/shm and the remedy."""
    return [line for line in process.output.splitlines()
            if '[WARN]' in line and '/dev/shm' in line and '--shm-size' in line]


@pytest.mark.parametrize('size', [(640, 480), (1920, 1080)])
def test_frames_through_docker_sized_shared_memory(
        start: Start, tmp_path: Path, size: tuple[int, int]) -> None:
    with new_host(shared_memory='64m') as host:
        publisher = assert_delivered(start, host.within, tmp_path / 'out', *size)
    assert warnings_of_shared_memory(publisher) == []


@pytest.mark.parametrize('size', ['8m', '9m'])  # without room for shared frames, and for a few
def test_small_frames_with_little_shared_memory(
        start: Start, tmp_path: Path, size: str) -> None:
    with new_host(shared_memory=size) as host:
        assert_delivered(start, host.within, tmp_path / 'out', 640, 480)


def test_large_frames_with_little_shared_memory(
        start: Start, tmp_path: Path) -> None:
    with new_host(shared_memory='8m') as host:
        publisher = assert_delivered(start, host.within, tmp_path / 'out', 1920, 1080)
    assert len(warnings_of_shared_memory(publisher)) == 1, publisher.output


@pytest.mark.parametrize('is_users', [False, True])
def test_profile_of_the_user_is_kept(
        start: Start, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, is_users: bool) -> None:
    if is_users:
        profile = tmp_path / 'profile.xml'
        profile.write_text(UDP_ONLY)
        monkeypatch.setenv('FASTRTPS_DEFAULT_PROFILES_FILE', str(profile))
    with new_host() as host:
        subscriber = start('img_subscriber', within=host.within, output_dir=tmp_path / 'out')
        publisher = start('img_publisher', within=host.within, source='pattern:640x480@10',
                          publish_rate=0.0, wait_for_subscribers=1)
        subscriber.wait_for(' Hz, ')
        assert bool(publisher.segments()) is not is_users
        assert bool(list(host.shared_memory.glob('*fastrtps*'))) is not is_users
        for process in (subscriber, publisher):
            process.interrupt()
            assert process.finish() == 0, process.output
