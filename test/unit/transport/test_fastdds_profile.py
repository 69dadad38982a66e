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

"""Configuration of Fast DDS and malloc, and environments in which nothing is configured."""

from __future__ import annotations

from collections.abc import Callable
import os
from pathlib import Path
import subprocess
import sys
import tempfile
import xml.etree.ElementTree as ElementTree

from conftest import NodeProcess
from opencv_tools.transport.fastdds import profile, shared_memory
from opencv_tools.transport.fastdds.profile import (
    configured_fastdds, FastDdsSetup, is_fastdds_2, NOT_CONFIGURED)
import pytest
from waiting import LONGEST_SECONDS

Start = Callable[..., NodeProcess]

MB = 1 << 20
VGA, FULL_HD, UHD_4K, UHD_8K = (
    width * height * 3 for width, height in ((640, 480), (1920, 1080), (3840, 2160), (7680, 4320)))
VARIABLES = 'FASTRTPS_DEFAULT_PROFILES_FILE', 'FASTDDS_DEFAULT_PROFILES_FILE'
PROFILE = VARIABLES[not is_fastdds_2()]
USER_VARIABLES = (*VARIABLES, 'FASTDDS_BUILTIN_TRANSPORTS',
                  'RMW_IMPLEMENTATION', 'OPENCV_TOOLS_TRANSPORT')
DEFAULT_SEGMENT = 600_000  # upper bound of the default segment of Fast DDS, in bytes

COUNT_PAGE_FAULTS = """
import resource
import numpy as np
from opencv_tools.transport.fastdds.profile import configured_fastdds


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
def _clean_environment(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Remove the configuration of the user."""
    for variable in USER_VARIABLES:
        monkeypatch.delenv(variable, raising=False)
    monkeypatch.chdir(tmp_path)


def profile_number(name: str) -> int | None:
    """Return a number of the profile in use; None if it is not set, or there is no profile."""
    path = os.environ.get(PROFILE)
    found = path and ElementTree.parse(path).find(
        f'.//{{http://www.eprosima.com/XMLSchemas/fastRTPS_Profiles}}{name}')
    return None if found in (None, '') else int(found.text)


@pytest.mark.parametrize(('available', 'frame_bytes', 'segment'), [
    (2048 * MB, VGA, 16 * MB), (2048 * MB, FULL_HD, 8 * FULL_HD), (2048 * MB, UHD_4K, 8 * UHD_4K),
    (2048 * MB, 2 * UHD_4K, 256 * MB), (2048 * MB, UHD_8K, 3 * UHD_8K),
    (2048 * MB, 0, MB // 2),
    (64 * MB, VGA, 16 * MB), (64 * MB, FULL_HD, 32 * MB), (64 * MB, UHD_4K, None),
    (8 * MB, VGA, 4 * MB), (8 * MB, FULL_HD, None), (8 * MB, 0, MB // 2),
    (0, VGA, None), (0, 0, None)])
def test_segment_size(
        monkeypatch: pytest.MonkeyPatch, available: int, frame_bytes: int,
        segment: int | None) -> None:
    monkeypatch.setattr(profile, 'free_bytes', lambda: available)
    with configured_fastdds(frame_bytes) as made:
        path = Path(os.environ[PROFILE])
        assert profile_number('segment_size') == segment
        assert profile_number('nanosec') == 100_000_000
    assert (made.segment, made.free_bytes) == (segment or 0, available)
    assert PROFILE not in os.environ
    assert not path.exists()


@pytest.mark.parametrize(('available', 'frame_bytes', 'fragments'), [
    (2048 * MB, VGA, 512), (2048 * MB, FULL_HD, 766), (2048 * MB, UHD_4K, 3063),
    (2048 * MB, UHD_8K, 8192), (2048 * MB, 0, 4096), (8 * MB, 0, 4096), (MB, 0, 3276),
    (MB // 2, 0, None), (0, UHD_4K, None)])
def test_port_capacity(
        monkeypatch: pytest.MonkeyPatch, available: int, frame_bytes: int,
        fragments: int | None) -> None:
    monkeypatch.setattr(profile, 'free_bytes', lambda: available)
    with configured_fastdds(frame_bytes):
        assert profile_number('port_queue_capacity') == fragments


@pytest.mark.parametrize(('variable', 'value', 'buffer'), [
    ('ROS_AUTOMATIC_DISCOVERY_RANGE', 'SUBNET', 4 * MB),
    ('ROS_AUTOMATIC_DISCOVERY_RANGE', 'LOCALHOST', None), ('ROS_LOCALHOST_ONLY', '1', None)])
@pytest.mark.parametrize('frame_bytes', [0, VGA])
def test_udp_buffers_unless_the_middleware_adds_udp(
        monkeypatch: pytest.MonkeyPatch, variable: str, value: str, buffer: int | None,
        frame_bytes: int) -> None:
    monkeypatch.delenv('ROS_AUTOMATIC_DISCOVERY_RANGE')
    monkeypatch.setenv(variable, value)
    with configured_fastdds(frame_bytes):
        assert profile_number('receiveBufferSize') == buffer
        assert profile_number('sendBufferSize') is None


@pytest.mark.process
def test_warning_about_read_only_shared_memory(
        start: Start, mount_namespace: tuple[str, ...]) -> None:
    publisher = start('img_publisher', source='pattern', max_frames=1, within=(
        *mount_namespace, 'sh', '-c', 'mount -t tmpfs -o ro tmpfs /dev/shm && exec "$0" "$@"'))
    assert publisher.finish() == 0, publisher.output
    assert '/dev/shm is not writable: frames are sent over UDP' in \
        publisher.output.splitlines()[0]


@pytest.mark.parametrize('is_writable', [True, False])
def test_profile_without_writable_shared_memory(
        monkeypatch: pytest.MonkeyPatch, tmp_path: Path, is_writable: bool) -> None:
    nowhere = tmp_path / 'nowhere'
    monkeypatch.setattr(profile, 'SHARED_MEMORY', nowhere)
    monkeypatch.setattr(tempfile, 'tempdir', str(tmp_path if is_writable else nowhere))
    with configured_fastdds(VGA):
        assert profile_number('nanosec') == (100_000_000 if is_writable else None)
    assert PROFILE not in os.environ
    assert list(tmp_path.iterdir()) == []


def test_profile_that_another_process_has_removed() -> None:
    with configured_fastdds(VGA):
        Path(os.environ[PROFILE]).unlink()
    assert PROFILE not in os.environ


def test_profile_removed_after_an_exception() -> None:
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
def test_warning_about_frames_larger_than_the_segment(
        made: FastDdsSetup, frame_bytes: int, words: tuple[str, ...]) -> None:
    sentence = made.size_warning(frame_bytes)
    assert [word for word in words if word not in sentence] == []


@pytest.mark.parametrize('made', [
    FastDdsSetup('', 3 * FULL_HD, 8 * MB), FastDdsSetup('', 256 * MB, 2048 * MB),
    FastDdsSetup('left'), NOT_CONFIGURED])
def test_no_warning_about_frames_that_fit(
        made: FastDdsSetup) -> None:
    assert made.size_warning(FULL_HD) == ''


@pytest.mark.thorough
@pytest.mark.process
def test_page_faults_of_reused_frames(tell: Callable[[str], None]) -> None:
    def faults(transport: str) -> float:
        finished = subprocess.run(
            [sys.executable, '-c', COUNT_PAGE_FAULTS], check=True, capture_output=True, text=True,
            timeout=LONGEST_SECONDS,
            env={**os.environ, 'OPENCV_TOOLS_TRANSPORT': transport,
                 'NUMPY_MADVISE_HUGEPAGE': '0'})
        return float(finished.stdout)

    kept, returned = faults(''), faults('default')
    tell(f'page faults per frame of 6 MB: {kept:g} with memory kept, {returned:g} without')
    assert returned > 1000
    assert kept < returned / 100


@pytest.mark.parametrize(('variable', 'value', 'reason'), [
    ('OPENCV_TOOLS_TRANSPORT', 'default', 'OPENCV_TOOLS_TRANSPORT is default'),
    ('RMW_IMPLEMENTATION', 'rmw_cyclonedds_cpp', 'RMW_IMPLEMENTATION is rmw_cyclonedds_cpp'),
    ('FASTDDS_BUILTIN_TRANSPORTS', 'UDPv4', 'FASTDDS_BUILTIN_TRANSPORTS is set'),
    *((variable, '/mine.xml', f'{variable} is set') for variable in VARIABLES)])
def test_unchanged_user_variables(
        monkeypatch: pytest.MonkeyPatch, tmp_path: Path, variable: str, value: str,
        reason: str) -> None:
    monkeypatch.setenv(variable, value)
    monkeypatch.setattr(shared_memory, 'SHARED_MEMORY', tmp_path)
    segment = tmp_path / 'fastrtps_0000000000000001'
    for path in (segment, segment.with_name(f'{segment.name}_el')):
        path.touch()
    before = dict(os.environ)
    with configured_fastdds(UHD_4K) as made:
        assert dict(os.environ) == before
    assert made == FastDdsSetup(f'Fast DDS and malloc are not configured: {reason}')
    assert segment.exists()


@pytest.mark.parametrize('name', [
    'DEFAULT_FASTRTPS_PROFILES.xml', 'DEFAULT_FASTDDS_PROFILES.xml'])
def test_profile_file_of_the_user(tmp_path: Path, name: str) -> None:
    (tmp_path / name).touch()
    with configured_fastdds(UHD_4K) as made:
        assert PROFILE not in os.environ
    assert made == FastDdsSetup(f'Fast DDS and malloc are not configured: {name} exists')


@pytest.mark.thorough
@pytest.mark.parametrize(('transport', 'summary', 'is_large'), [
    ('', '16 MB of shared memory', True),
    ('default', 'not configured: OPENCV_TOOLS_TRANSPORT is default', False)])
def test_one_debug_line_about_the_configuration(
        start: Start, monkeypatch: pytest.MonkeyPatch, transport: str, summary: str,
        is_large: bool) -> None:
    monkeypatch.setenv('OPENCV_TOOLS_TRANSPORT', transport)
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
    assert is_large or max(sizes) < DEFAULT_SEGMENT
