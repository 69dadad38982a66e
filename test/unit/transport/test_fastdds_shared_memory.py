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

"""Free bytes of the shared memory, segments of dead processes, and nodes of other users."""

from __future__ import annotations

from collections.abc import Callable
import fcntl
import os
from pathlib import Path
import shutil
import subprocess
import sys

from conftest import NodeProcess
from opencv_tools.transport.fastdds import shared_memory
from opencv_tools.transport.fastdds.shared_memory import (
    find_other_user, free_bytes, remove_dead_profiles, remove_dead_segments)
import pytest

Start = Callable[..., NodeProcess]

HOLD_LOCK = """
import fcntl, sys
with open(sys.argv[1]) as file:
    fcntl.flock(file, fcntl.LOCK_EX)
    print('locked', flush=True)
    sys.stdin.read()
"""


HOLD_PROFILE = """
from pathlib import Path
import sys
from opencv_tools.transport.fastdds import profile
profile.SHARED_MEMORY = Path(sys.argv[1])
with profile.configured_fastdds(0):
    print('configured', flush=True)
    sys.stdin.read()
"""


@pytest.fixture
def folder(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Path:
    """Return an empty folder that replaces the shared memory."""
    monkeypatch.setattr(shared_memory, 'SHARED_MEMORY', tmp_path)
    return tmp_path


def make_segment(folder: Path, number: int, fast: str = 'fastrtps') -> Path:
    """Create the segment and the lock file of a dead process."""
    segment = folder / f'{fast}_{number:016x}'
    segment.write_bytes(bytes(1000))
    segment.with_name(f'{segment.name}_el').touch()
    return segment


@pytest.mark.process
def test_removal_of_dead_segments_only(folder: Path) -> None:
    dead = [make_segment(folder, number, fast) for number in (1, 0xfedcba9876543210)
            for fast in ('fastrtps', 'fastdds')]
    living = make_segment(folder, 2)
    others = [folder / name for name in (
        'fastrtps_port7411', 'fastrtps_port7411_el', 'sem.fastrtps_port7411_mutex',
        'fastrtps_0123456789abcdeg_el', 'fastrtps_0123456789abcdef0_el', 'fastrtps_0_el',
        'fastrtps_00000000000000aa', 'other_0000000000000001_el', 'opencv_tools_a.xml')]
    for path in others:
        path.touch()
    lock = living.with_name(f'{living.name}_el')
    with subprocess.Popen([sys.executable, '-c', HOLD_LOCK, str(lock)], stdin=subprocess.PIPE,
                          stdout=subprocess.PIPE) as owner:
        assert owner.stdout.readline() == b'locked\n'
        assert remove_dead_segments() == len(dead)
        assert set(folder.iterdir()) == {living, lock, *others}
        assert remove_dead_segments() == 0
        owner.kill()
    assert remove_dead_segments() == 1
    assert set(folder.iterdir()) == set(others)


@pytest.mark.process
def test_removal_of_dead_profiles_only(folder: Path) -> None:
    def profiles() -> set[Path]:
        return set(folder.glob('*.xml'))

    others = {folder / 'opencv_tools_12345678.xml', folder / 'opencv_tools_a.xml'}
    for path in others:
        path.touch()  # another process is about to write the first one
    (folder / 'opencv_tools_a.xml').write_text('<dds/>')
    with subprocess.Popen([sys.executable, '-c', HOLD_PROFILE, str(folder)],
                          stdin=subprocess.PIPE, stdout=subprocess.PIPE) as owner:
        assert owner.stdout.readline() == b'configured\n'
        remove_dead_profiles()
        assert len(profiles() - others) == 1
        owner.kill()
    assert len(profiles() - others) == 1
    remove_dead_profiles()
    assert profiles() == others


def test_segment_that_cannot_be_removed(folder: Path) -> None:
    immovable, dead = make_segment(folder, 1), make_segment(folder, 2)
    immovable.unlink()
    immovable.mkdir()  # unlink refuses a folder even for root
    assert remove_dead_segments() == 1
    assert immovable.exists()
    assert not dead.exists()


def test_lock_without_a_segment(folder: Path) -> None:
    make_segment(folder, 1).unlink()
    assert remove_dead_segments() == 1
    assert list(folder.iterdir()) == []


@pytest.mark.parametrize('kind', ['link', 'pipe', 'device'])
def test_special_files_instead_of_a_lock(folder: Path, kind: str) -> None:
    segment = make_segment(folder, 1)
    lock = segment.with_name(f'{segment.name}_el')
    target = lock.rename(folder / 'target')
    if kind == 'pipe':
        os.mkfifo(lock)
        end = os.open(lock, os.O_RDWR)  # so that opening it does not wait
    else:
        lock.symlink_to(target if kind == 'link' else '/dev/null')
    assert remove_dead_segments() == 0
    assert set(folder.iterdir()) == {segment, lock, target}
    if kind == 'pipe':
        os.close(end)


def test_free_bytes_of_the_file_system(
        monkeypatch: pytest.MonkeyPatch, folder: Path) -> None:
    def free() -> int:
        return shutil.disk_usage(folder).free

    # Other processes may write to the disk at the same time.
    assert any(before == free_bytes() or free_bytes() == free()
               for before in (free() for _ in range(1000)))
    monkeypatch.setattr(shared_memory, 'SHARED_MEMORY', folder / 'nowhere')
    assert free_bytes() == 0
    assert remove_dead_segments() == 0


@pytest.fixture
def start_users(
        start: Start, mount_namespace: tuple[str, ...], monkeypatch: pytest.MonkeyPatch,
        tmp_path: Path) -> Callable[[str], tuple[NodeProcess, NodeProcess]]:
    """Return a function that starts a publisher and, before it, a subscriber of another user."""
    if os.getuid() != 0:
        pytest.skip('only root can be another user')
    (tmp_path / 'log').mkdir(mode=0o777)
    (tmp_path / 'log').chmod(0o777)
    monkeypatch.setenv('ROS_LOG_DIR', str(tmp_path / 'log'))

    def start_both(discovery: str) -> tuple[NodeProcess, NodeProcess]:
        monkeypatch.setenv('ROS_AUTOMATIC_DISCOVERY_RANGE', discovery)
        subscriber = start('img_subscriber', max_frames=3, within=(
            *mount_namespace, 'sh', '-c', 'mount -t tmpfs none /dev/shm && exec "$0" "$@"'))
        subscriber.wait_for('Waiting for /video_frames')
        # The other user may read everything, such as the interpreter in a folder of root.
        return start('img_publisher', source='pattern', wait_for_subscribers=1, within=(
            'nsenter', '--mount', f'--target={subscriber.pid}', 'setpriv', '--reuid=65534',
            '--regid=65534', '--clear-groups', '--inh-caps=-all,+dac_read_search',
            '--ambient-caps=-all,+dac_read_search')), subscriber

    return start_both


def check_ends(subscriber: NodeProcess, count: int, publisher: NodeProcess, words: str) -> None:
    """Assert that both nodes end without an error, what was received and what the sender said."""
    assert subscriber.finish() == 0, subscriber.output
    assert f'Received {count} frames' in subscriber.output
    publisher.interrupt()
    assert publisher.finish() == 0, publisher.output
    assert words in publisher.output


@pytest.mark.thorough
def test_frames_from_one_user_to_another(
        start_users: Callable[[str], tuple[NodeProcess, NodeProcess]]) -> None:
    publisher, subscriber = start_users('SUBNET')
    check_ends(subscriber, 3, publisher,
               'frames are sent over UDP and may be late; run all nodes as one user')


@pytest.mark.thorough
@pytest.mark.skipif(os.environ.get('ROS_DISTRO') == 'kilted',
                    reason='Fast DDS 3 passes on some frames at times')
def test_users_who_exchange_no_frames(
        start_users: Callable[[str], tuple[NodeProcess, NodeProcess]]) -> None:
    publisher, subscriber = start_users('LOCALHOST')
    subscriber.wait_for('users: run all nodes as one user')
    subscriber.interrupt()
    check_ends(subscriber, 0, publisher, 'those nodes and this one exchange no frames')


@pytest.mark.parametrize('fast', ['fastrtps', 'fastdds'])
@pytest.mark.parametrize(('name', 'owner', 'is_held', 'found'), [
    ('port10161_el', 'another', True, 'jo'), ('port10161_el', 'me', True, ''),
    ('port10161_el', 'another', False, ''), ('port10411_el', 'another', True, ''),
    ('port7000_el', 'another', True, ''), ('port10161', 'another', True, ''),
    ('portx_el', 'another', True, '')])
def test_user_who_holds_a_port_of_the_domain(
        tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str, owner: str, is_held: bool,
        found: str, fast: str) -> None:
    monkeypatch.setattr(shared_memory, 'SHARED_MEMORY', tmp_path)
    monkeypatch.setenv('ROS_DOMAIN_ID', '11')
    monkeypatch.setattr(os, 'geteuid', lambda: os.getuid() if owner == 'me' else -1)
    monkeypatch.setattr(shared_memory, '_user_name', lambda _: 'jo')
    os.mkfifo(tmp_path / f'{fast}_port10160_el')  # opening it waits for a writer
    with (tmp_path / f'{fast}_{name}').open('w') as file:
        if is_held:
            fcntl.flock(file, fcntl.LOCK_EX)
        assert find_other_user() == found
