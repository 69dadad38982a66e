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

"""Nodes of other users of this machine, with which Fast DDS shares no memory."""

from __future__ import annotations

from collections.abc import Callable
import fcntl
import os
from pathlib import Path

from conftest import NodeProcess
from opencv_tools.ros.fastdds import other_users, shared_memory
import pytest

Start = Callable[..., NodeProcess]


@pytest.mark.parametrize(('discovery', 'sentence', 'frames'), [
    ('SUBNET', 'frames are sent over UDP and may be late; run all nodes as one user', 3),
    ('LOCALHOST', 'those nodes and this one exchange no frames', 0)])
def test_frames_from_one_user_to_another(
        start: Start, mount_namespace: tuple[str, ...], monkeypatch: pytest.MonkeyPatch,
        tmp_path: Path, discovery: str, sentence: str, frames: int) -> None:
    if os.getuid() != 0:
        pytest.skip('only root can be another user')
    (tmp_path / 'log').mkdir(mode=0o777)
    (tmp_path / 'log').chmod(0o777)
    monkeypatch.setenv('ROS_LOG_DIR', str(tmp_path / 'log'))
    monkeypatch.setenv('ROS_AUTOMATIC_DISCOVERY_RANGE', discovery)
    subscriber = start('img_subscriber', max_frames=3, within=(
        *mount_namespace, 'sh', '-c', 'mount -t tmpfs none /dev/shm && exec "$0" "$@"'))
    subscriber.wait_for('Waiting for /video_frames')
    # The other user may read everything, such as the interpreter in a folder of root.
    publisher = start('img_publisher', source='pattern', wait_for_subscribers=1, within=(
        'nsenter', '--mount', f'--target={subscriber.pid}', 'setpriv', '--reuid=65534',
        '--regid=65534', '--clear-groups', '--inh-caps=-all,+dac_read_search',
        '--ambient-caps=-all,+dac_read_search'))
    if frames:
        assert subscriber.finish() == 0, subscriber.output
    else:
        subscriber.wait_for('users: run all nodes as one user')
        subscriber.interrupt()
        assert subscriber.finish() == 0, subscriber.output
    assert f'Received {frames} frames' in subscriber.output
    publisher.interrupt()
    assert publisher.finish() == 0, publisher.output
    assert sentence in publisher.output


@pytest.mark.parametrize(('name', 'owner', 'is_held', 'found'), [
    ('fastrtps_port10161_el', 'another', True, 'jo'), ('fastrtps_port10161_el', 'me', True, ''),
    ('fastrtps_port10161_el', 'another', False, ''),
    ('fastrtps_port10411_el', 'another', True, ''), ('fastrtps_port7000_el', 'another', True, ''),
    ('fastrtps_port10161', 'another', True, ''),
    ('fastrtps_portx_el', 'another', True, '')])
def test_user_who_holds_a_port_of_the_domain(
        tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str, owner: str, is_held: bool,
        found: str) -> None:
    monkeypatch.setattr(shared_memory, 'SHARED_MEMORY', tmp_path)
    monkeypatch.setenv('ROS_DOMAIN_ID', '11')
    monkeypatch.setattr(os, 'geteuid', lambda: os.getuid() if owner == 'me' else -1)
    monkeypatch.setattr(other_users, '_user_name', lambda _: 'jo')
    os.mkfifo(tmp_path / 'fastrtps_port10160_el')  # opening it waits for a writer
    with (tmp_path / name).open('w') as file:
        if is_held:
            fcntl.flock(file, fcntl.LOCK_EX)
        assert other_users.find_other_user() == found
