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

"""What is set up for frames, for how large ones, what is left alone and what is cleared away."""

from __future__ import annotations

from collections.abc import Callable
import fcntl
import os
from pathlib import Path
import shutil
import subprocess
import sys
import tempfile
import xml.etree.ElementTree as ElementTree

from conftest import CLIP, NodeProcess
import cv2
import numpy as np
from opencv_tools.ros.fastdds import other_users, profile as transport, shared_memory
from opencv_tools.ros.fastdds.profile import configured_fastdds, FastDdsSetup, NOT_CONFIGURED
from opencv_tools.ros.fastdds.shared_memory import free_bytes, remove_dead_segments
from opencv_tools.ros.publisher.frame_size import expected_frame_bytes
import pytest

Start = Callable[..., NodeProcess]

MB = 1 << 20
VGA, FULL_HD, UHD_4K, UHD_8K = (
    width * height * 3 for width, height in ((640, 480), (1920, 1080), (3840, 2160), (7680, 4320)))
PROFILE = 'FASTRTPS_DEFAULT_PROFILES_FILE'
CHOICES = (PROFILE, 'FASTDDS_DEFAULT_PROFILES_FILE', 'FASTDDS_BUILTIN_TRANSPORTS',
           'RMW_IMPLEMENTATION', 'OPENCV_TOOLS_TRANSPORT')
LARGEST_OF_FAST_DDS = 600_000  # bytes of the segment that it makes by itself

HOLD_LOCK = """
import fcntl, sys
with open(sys.argv[1]) as file:
    fcntl.flock(file, fcntl.LOCK_EX)
    print('locked', flush=True)
    sys.stdin.read()
"""
COUNT_PAGE_FAULTS = """
import resource
import numpy as np
from opencv_tools.ros.fastdds.profile import configured_fastdds

def use_two_frames():
    frames = [np.empty(6_000_000, np.uint8) for _ in range(2)]
    for frame in frames:
        frame.fill(1)

with configured_fastdds(0):
    use_two_frames()
before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
for _ in range(20):
    use_two_frames()
print((resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before) / 40)
"""


@pytest.fixture(autouse=True)
def _no_choices(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Take away what a user may have configured."""
    for variable in CHOICES:
        monkeypatch.delenv(variable, raising=False)
    monkeypatch.chdir(tmp_path)


@pytest.fixture
def folder(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Path:
    """Give an empty folder in place of the shared memory."""
    monkeypatch.setattr(shared_memory, 'SHARED_MEMORY', tmp_path)
    return tmp_path


def profile_in_force(name: str) -> int | None:
    """Read a number from the profile in force; None where it has none, or there is none."""
    path = os.environ.get(PROFILE)
    found = path and ElementTree.parse(path).find(
        f'.//{{http://www.eprosima.com/XMLSchemas/fastRTPS_Profiles}}{name}')
    return None if found in (None, '') else int(found.text)


def make_segment(folder: Path, number: int) -> Path:
    """Make what a process leaves behind in a folder; the segment."""
    segment = folder / f'fastrtps_{number:016x}'
    segment.write_bytes(bytes(1000))
    segment.with_name(f'{segment.name}_el').touch()
    return segment


# What is set up

@pytest.mark.parametrize(('available', 'frame_bytes', 'segment'), [
    (2048 * MB, VGA, 16 * MB), (2048 * MB, FULL_HD, 8 * FULL_HD), (2048 * MB, UHD_4K, 8 * UHD_4K),
    (2048 * MB, 2 * UHD_4K, 256 * MB), (2048 * MB, UHD_8K, 3 * UHD_8K),
    (2048 * MB, 0, MB // 2),
    (64 * MB, VGA, 16 * MB), (64 * MB, FULL_HD, 32 * MB), (64 * MB, UHD_4K, None),
    (8 * MB, VGA, 4 * MB), (8 * MB, FULL_HD, None), (8 * MB, 0, MB // 2),
    (0, VGA, None), (0, 0, None)])
def test_the_segment_holds_several_frames_as_far_as_there_is_room(
        monkeypatch: pytest.MonkeyPatch, available: int, frame_bytes: int,
        segment: int | None) -> None:
    monkeypatch.setattr(transport, 'free_bytes', lambda: available)
    with configured_fastdds(frame_bytes) as made:
        path = Path(os.environ[PROFILE])
        assert profile_in_force('segment_size') == segment
        assert profile_in_force('nanosec') == 100_000_000
    assert (made.segment, made.free_bytes) == (segment or 0, available)
    assert PROFILE not in os.environ
    assert not path.exists()


@pytest.mark.parametrize(('available', 'frame_bytes', 'fragments'), [
    (2048 * MB, VGA, 512), (2048 * MB, FULL_HD, 766), (2048 * MB, UHD_4K, 3063),
    (2048 * MB, UHD_8K, 8192), (2048 * MB, 0, 4096), (8 * MB, 0, 4096), (MB, 0, 3276),
    (MB // 2, 0, None), (0, UHD_4K, None)])
def test_the_pieces_of_the_frames_in_the_segment_may_wait_for_a_reader(
        monkeypatch: pytest.MonkeyPatch, available: int, frame_bytes: int,
        fragments: int | None) -> None:
    monkeypatch.setattr(transport, 'free_bytes', lambda: available)
    with configured_fastdds(frame_bytes):
        assert profile_in_force('port_queue_capacity') == fragments


@pytest.mark.parametrize(('variable', 'value', 'buffer'), [
    ('ROS_AUTOMATIC_DISCOVERY_RANGE', 'SUBNET', 4 * MB),
    ('ROS_AUTOMATIC_DISCOVERY_RANGE', 'LOCALHOST', None), ('ROS_LOCALHOST_ONLY', '1', None)])
@pytest.mark.parametrize('frame_bytes', [0, VGA])
def test_what_comes_over_udp_has_room_where_the_middleware_adds_no_udp_of_its_own(
        monkeypatch: pytest.MonkeyPatch, variable: str, value: str, buffer: int | None,
        frame_bytes: int) -> None:
    monkeypatch.delenv('ROS_AUTOMATIC_DISCOVERY_RANGE')
    monkeypatch.setenv(variable, value)
    with configured_fastdds(frame_bytes):
        assert profile_in_force('receiveBufferSize') == buffer
        assert profile_in_force('sendBufferSize') is None


@pytest.mark.process
def test_a_shared_memory_that_cannot_be_written_to_is_said_first(
        start: Start, mount_namespace: tuple[str, ...]) -> None:
    publisher = start('img_publisher', source='pattern', max_frames=1, within=(
        *mount_namespace, 'sh', '-c', 'mount -t tmpfs -o ro tmpfs /dev/shm && exec "$0" "$@"'))
    assert publisher.finish() == 0, publisher.output
    assert '/dev/shm is not writable: frames are sent over UDP' in \
        publisher.output.splitlines()[0]


@pytest.mark.parametrize('is_writable', [True, False])
def test_a_shared_memory_that_cannot_be_written_to_is_no_error(
        monkeypatch: pytest.MonkeyPatch, tmp_path: Path, is_writable: bool) -> None:
    nowhere = tmp_path / 'nowhere'
    monkeypatch.setattr(transport, 'SHARED_MEMORY', nowhere)
    monkeypatch.setattr(tempfile, 'tempdir', str(tmp_path if is_writable else nowhere))
    with configured_fastdds(VGA):
        assert profile_in_force('nanosec') == (100_000_000 if is_writable else None)
    assert PROFILE not in os.environ
    assert list(tmp_path.iterdir()) == []


def test_the_profile_goes_away_when_making_the_node_fails() -> None:
    paths = []
    with pytest.raises(ValueError, match='no node'), configured_fastdds(VGA):
        paths.append(Path(os.environ[PROFILE]))
        raise ValueError('no node')
    assert PROFILE not in os.environ
    assert not paths[0].exists()


@pytest.mark.parametrize(('made', 'frame_bytes', 'words'), [
    (FastDdsSetup('', 0, 8 * MB), FULL_HD, (
        '/dev/shm had 8 MB free', 'frames of 5.93 MB', 'increase it to 94.9 MB', '--shm-size=95m',
        '--ipc=host')),
    (FastDdsSetup('', 32 * MB, 64 * MB), UHD_4K, (
        '/dev/shm had 64 MB free', 'frames of 23.7 MB', '--shm-size=380m')),
    (FastDdsSetup('', 16 * MB, 2048 * MB), FULL_HD, (
        '16 MB reserved at startup', 'frames of 5.93 MB',
        'start the node with the frame size that it publishes'))])
def test_frames_that_do_not_fit_are_told_with_what_helps(
        made: FastDdsSetup, frame_bytes: int, words: tuple[str, ...]) -> None:
    sentence = made.size_warning(frame_bytes)
    assert [word for word in words if word not in sentence] == []


@pytest.mark.parametrize('made', [
    FastDdsSetup('', 3 * FULL_HD, 8 * MB), FastDdsSetup('', 256 * MB, 2048 * MB),
    FastDdsSetup('left'), NOT_CONFIGURED])
def test_nothing_is_told_of_frames_that_fit_or_where_the_user_has_chosen(
        made: FastDdsSetup) -> None:
    assert made.size_warning(FULL_HD) == ''


@pytest.mark.process
def test_memory_of_frames_is_kept(tell: Callable[[str], None]) -> None:
    def faults(choice: str) -> float:
        finished = subprocess.run(
            [sys.executable, '-c', COUNT_PAGE_FAULTS], check=True, capture_output=True, text=True,
            timeout=30, env={**os.environ, 'OPENCV_TOOLS_TRANSPORT': choice,
                             'NUMPY_MADVISE_HUGEPAGE': '0'})
        return float(finished.stdout)

    kept, given_back = faults(''), faults('default')
    tell(f'page faults a frame of 6 MB: {kept:g} with memory kept, {given_back:g} without')
    assert given_back > 1000
    assert kept < given_back / 100


# What is left alone

@pytest.mark.parametrize(('variable', 'value', 'reason'), [
    ('OPENCV_TOOLS_TRANSPORT', 'default', 'OPENCV_TOOLS_TRANSPORT is default'),
    ('RMW_IMPLEMENTATION', 'rmw_cyclonedds_cpp', 'RMW_IMPLEMENTATION is rmw_cyclonedds_cpp'),
    ('FASTDDS_BUILTIN_TRANSPORTS', 'UDPv4', 'FASTDDS_BUILTIN_TRANSPORTS is set'),
    (PROFILE, '/mine.xml', f'{PROFILE} is set'),
    ('FASTDDS_DEFAULT_PROFILES_FILE', '/mine.xml', 'FASTDDS_DEFAULT_PROFILES_FILE is set')])
def test_what_the_user_configured_is_left_alone(
        monkeypatch: pytest.MonkeyPatch, folder: Path, variable: str, value: str,
        reason: str) -> None:
    monkeypatch.setenv(variable, value)
    segment = make_segment(folder, 1)
    before = dict(os.environ)
    with configured_fastdds(UHD_4K) as made:
        assert dict(os.environ) == before
    assert made == FastDdsSetup(f'Fast DDS and malloc are not configured: {reason}')
    assert segment.exists()


@pytest.mark.parametrize('name', [
    'DEFAULT_FASTRTPS_PROFILES.xml', 'DEFAULT_FASTDDS_PROFILES.xml'])
def test_a_profile_in_the_folder_is_left_alone(tmp_path: Path, name: str) -> None:
    (tmp_path / name).touch()
    with configured_fastdds(UHD_4K) as made:
        assert PROFILE not in os.environ
    assert made == FastDdsSetup(f'Fast DDS and malloc are not configured: {name} exists')


@pytest.mark.parametrize(('choice', 'summary', 'is_large'), [
    ('', '16 MB of shared memory', True),
    ('default', 'not configured: OPENCV_TOOLS_TRANSPORT is default', False)])
def test_the_publisher_says_once_what_was_set_up(
        start: Start, monkeypatch: pytest.MonkeyPatch, choice: str, summary: str,
        is_large: bool) -> None:
    monkeypatch.setenv('OPENCV_TOOLS_TRANSPORT', choice)
    publisher = start('img_publisher', '--ros-args', '--log-level', 'img_publisher:=debug', '--',
                      source='pattern')
    publisher.wait_for('Publishing video frame 1:')
    sizes = [path.stat().st_size for path in publisher.segments()]
    publisher.interrupt()
    assert publisher.finish() == 0, publisher.output
    lines = [line for line in publisher.output.splitlines() if '[DEBUG]' in line]
    assert len(lines) == 1, lines
    assert summary in lines[0]
    assert (max(sizes) > 16 * MB) is is_large
    assert is_large or max(sizes) < LARGEST_OF_FAST_DDS


# Other users

@pytest.mark.parametrize(('discovery', 'sentence', 'frames'), [
    ('SUBNET', 'frames are sent over UDP and may be late; run all nodes as one user', 3),
    ('LOCALHOST', 'those nodes and this one exchange no frames', 0)])
def test_frames_go_from_user_to_user_over_udp_or_it_is_said(
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
def test_another_user_is_one_who_holds_a_port_of_the_domain(
        folder: Path, monkeypatch: pytest.MonkeyPatch, name: str, owner: str, is_held: bool,
        found: str) -> None:
    monkeypatch.setenv('ROS_DOMAIN_ID', '11')
    monkeypatch.setattr(os, 'geteuid', lambda: os.getuid() if owner == 'me' else -1)
    monkeypatch.setattr(other_users, '_user_name', lambda _: 'jo')
    os.mkfifo(folder / 'fastrtps_port10160_el')  # whoever opens it waits for a writer
    with (folder / name).open('w') as file:
        if is_held:
            fcntl.flock(file, fcntl.LOCK_EX)
        assert other_users.find_other_user() == found


# What is cleared away

@pytest.mark.process
def test_dead_segments_go_and_everything_else_stays(folder: Path) -> None:
    dead = [make_segment(folder, number) for number in (1, 0xfedcba9876543210)]
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


def test_a_segment_that_may_not_be_removed_is_no_error(folder: Path) -> None:
    immovable, dead = make_segment(folder, 1), make_segment(folder, 2)
    immovable.unlink()
    immovable.mkdir()  # which unlink refuses for root too
    assert remove_dead_segments() == 1
    assert immovable.exists()
    assert not dead.exists()


def test_a_lock_without_a_segment_goes_too(folder: Path) -> None:
    make_segment(folder, 1).unlink()
    assert remove_dead_segments() == 1
    assert list(folder.iterdir()) == []


@pytest.mark.parametrize('kind', ['link', 'pipe', 'device'])
def test_what_is_no_lock_is_neither_opened_nor_removed(folder: Path, kind: str) -> None:
    segment = make_segment(folder, 1)
    lock = segment.with_name(f'{segment.name}_el')
    target = lock.rename(folder / 'target')
    if kind == 'pipe':
        os.mkfifo(lock)
        end = os.open(lock, os.O_RDWR)  # so that whoever opens it need not wait
    else:
        lock.symlink_to(target if kind == 'link' else '/dev/null')
    assert remove_dead_segments() == 0
    assert set(folder.iterdir()) == {segment, lock, target}
    if kind == 'pipe':
        os.close(end)


def test_free_bytes_are_those_of_the_file_system(
        monkeypatch: pytest.MonkeyPatch, folder: Path) -> None:
    def told() -> int:
        return shutil.disk_usage(folder).free

    # Others write to the disk meanwhile.
    assert any(before == free_bytes() or free_bytes() == told()
               for before in (told() for _ in range(1000)))
    monkeypatch.setattr(shared_memory, 'SHARED_MEMORY', folder / 'nowhere')
    assert free_bytes() == 0
    assert remove_dead_segments() == 0


# How large frames will be

@pytest.mark.parametrize(('words', 'size'), [
    ((), VGA),
    (('-p', 'source:=pattern'), VGA),
    (('-p', 'source:=pattern:1920x1080@30'), FULL_HD),
    (('-p', 'width:=1280', '-p', 'height:=720'), 1280 * 720 * 3),
    (('-p', 'image_publisher:width:=1280', '--param', 'image_publisher:height:=720'),
     1280 * 720 * 3),
    (('-p', 'width:=1280'), 1280 * 480 * 3),
    (('-p', 'encoding:=mono8'), 640 * 480),
    (('-p', 'encoding:=rgba16'), 640 * 480 * 8),
    (('-p', 'encoding:=nv12'), 640 * 480 * 3 // 2),
    (('-p', "encoding:=''"), VGA),
    (('-p', 'source:=picture.png'), 64 * 48 * 3),
    (('-p', 'source:=.'), 64 * 48 * 3),
    (('-p', f'source:=file://{CLIP}'), 1280 * 720 * 3),
    (('-p', 'source:=picture.png', '-p', 'encoding:=mono8'), 64 * 48),
    (('-p', f'source:={CLIP}'), 1280 * 720 * 3),
    (('--params-file', 'cameras.yaml'), 320 * 240 * 3),
    (('--params-file', 'cameras.yaml', '-p', 'source:=pattern:160x120'), 160 * 120 * 3)])
def test_the_size_of_frames_is_told_by_the_command_line(
        tmp_path: Path, words: tuple[str, ...], size: int) -> None:
    cv2.imwrite(str(tmp_path / 'picture.png'), np.zeros((48, 64, 3), np.uint8))
    (tmp_path / 'cameras.yaml').write_text(
        '/**/image_publisher:\n  ros__parameters:\n    source: pattern:320x240\n')
    assert expected_frame_bytes(['img_publisher', '--ros-args', *words]) == size


@pytest.mark.parametrize('words', [
    ('-p', 'source:=rtsp://camera/stream'), ('-p', 'source:=nowhere.mp4'), ('-p', 'source:='),
    ('-p', 'source:=broken.png'), ('-p', 'source:=pattern:0x0'), ('-p', 'encoding:=foo'),
    ('-p', 'width:=wide'), ('-p', 'width:=[1]'), ('-p', 'width:={'),
    ('-p', 'source:=pipe'), ('-p', 'width:=.inf'), ('-p', f'source:={"[" * 3000}'),
    ('--params-file', 'nowhere.yaml'), ('--params-file', 'broken.png'),
    ('--params-file', 'list.yaml')])
def test_what_cannot_be_told_is_taken_for_full_hd(tmp_path: Path, words: tuple[str, ...]) -> None:
    os.mkfifo(tmp_path / 'pipe')  # whoever opens it waits for a writer
    (tmp_path / 'broken.png').write_bytes(b'\x89PNG\0')
    (tmp_path / 'list.yaml').write_text('image_publisher:\n  ros__parameters:\n    - width\n')
    assert expected_frame_bytes(['img_publisher', '--ros-args', *words]) == FULL_HD
