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

"""The commands that choose and repeat tests: changed.py, thorough.py and own_namespaces.py."""

from __future__ import annotations

import os
from pathlib import Path
import re
import subprocess
import sys

import changed
import own_namespaces
import pytest
import thorough
from waiting import LONGEST_SECONDS

# Few tests, because each is read with all that it imports.
TESTS = [changed.TEST / 'nodes' / 'test_topic_views.py',
         changed.TEST / 'unit' / 'robot' / 'test_pose.py']
#: The tests of these tests need none, and they are slow.
# Options of colcon are those of plugins.
NO_PLUGINS = {'PYTEST_DISABLE_PLUGIN_AUTOLOAD': '1', 'PYTEST_ADDOPTS': ''}
OUTPUT = """\
FAILED test/nodes/test_a.py::test_x[a - b] - assert 1 == 2
FAILED test/nodes/test_a.py::test_y
ERROR test/unit/test_b.py - ImportError: no module
ERROR test/unit/test_b.py::test_z - at teardown
FAILED test/unit/test_b.py::test_z - assert 0
FAILED elsewhere
"""


@pytest.mark.parametrize(('path', 'inside', 'outside'), [
    ('opencv_tools/image/jpeg.py', 'test/unit/image/test_jpeg.py',
     'test/unit/robot/test_pose.py'),
    ('opencv_tools/robot/pose.py', 'test/unit/robot/test_pose.py',
     'test/unit/image/test_jpeg.py'),
    ('opencv_tools/datasets/statistics.py', 'test/unit/datasets/test_statistics.py',
     'test/unit/video/test_encoder.py'),
    ('test/support/playback.py', 'test/unit/capture/test_video.py',
     'test/unit/robot/test_pose.py')])
def test_tests_that_a_file_reaches(path: str, inside: str, outside: str) -> None:
    tests = [changed.ROOT / inside, changed.ROOT / outside]
    assert all(test.is_file() for test in tests)
    assert changed.reached([path], tests) == [inside]


def test_change_of_other_files() -> None:
    assert changed.reached(['docs/bags.md'], TESTS) == ['test/package']
    assert changed.reached(['Makefile'], TESTS) == ['test']
    assert changed.reached(['test/conftest.py'], TESTS) == ['test']
    assert changed.reached([], TESTS) == []


def test_executable_that_a_test_starts() -> None:
    assert changed.reached(['opencv_tools/topic_views.py'], TESTS) == [
        'test/nodes/test_topic_views.py']


def test_failed_tests_of_an_output() -> None:
    assert thorough.failed_tests(OUTPUT) == [
        'test/nodes/test_a.py::test_x[a - b]', 'test/nodes/test_a.py::test_y',
        'test/unit/test_b.py', 'test/unit/test_b.py::test_z']


@pytest.mark.parametrize(('names', 'page', 'reason'), [
    ([], '| a |', ''), (['b'], '`a`', ''), (['b', 'c', 'd'], '', ''),
    (['b', 'c', 'd', 'e'], '', '4 tests were unsteady; at most 3 may be'),
    (['b', 'a'], '`a`', 'unsteady before already, see test/unsteady.md: a')])
def test_verdict_about_unsteady_tests(names: list[str], page: str, reason: str) -> None:
    assert thorough.verdict(names, page) == reason


@pytest.mark.process
def test_unsteady_test_is_listed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
                                 capsys: pytest.CaptureFixture[str]) -> None:
    # The group's only test fails unless it runs alone.
    (tmp_path / 'Makefile').write_text(
        'group:\n\t@test -n "$$OPENCV_TOOLS_ONLY" || '
        '{ echo "FAILED test/unit/test_a.py::test_b - assert 0"; exit 1; }\n'
        'broken:\n\t@echo "FAILED test/unit/test_c.py::test_d - assert 0"; exit 1\n')
    page = tmp_path / 'unsteady.md'
    page.write_text('| date | test |\n')
    for name, value in (('ROOT', tmp_path), ('PAGE', page), ('LOGS', tmp_path / 'logs')):
        monkeypatch.setattr(thorough, name, value)
    monkeypatch.setattr(sys, 'argv', ['thorough.py', 'group'])
    assert thorough.main() == 0
    assert page.read_text().endswith(' | `test/unit/test_a.py::test_b` |\n')
    assert 'UNSTEADY' in capsys.readouterr().out
    assert thorough.main() == 1  # it is listed now
    monkeypatch.setattr(sys, 'argv', ['thorough.py', 'broken'])
    assert thorough.main() == 1
    assert 'FAILED twice: test/unit/test_c.py::test_d' in capsys.readouterr().out


@pytest.mark.process
def test_linters_are_left_out_of_the_quick_tests() -> None:
    found = re.search(r"' -m' ' (.*?)'", (changed.ROOT / 'Makefile').read_text())
    assert found is not None
    collected = subprocess.run(
        [sys.executable, '-m', 'pytest', '--collect-only', '--noconftest', '-q', '-m', found[1],
         changed.TEST / 'package' / 'test_linters.py'],
        env={**os.environ, **NO_PLUGINS}, stdout=subprocess.DEVNULL, check=False)
    assert collected.returncode == pytest.ExitCode.NO_TESTS_COLLECTED


@pytest.mark.process
def test_namespaces_of_a_worker() -> None:
    reason = own_namespaces.reason_against()
    if reason:
        assert reason.startswith(('unshare: ', 'mount: ', '['))
        return
    shown = subprocess.run(
        [*own_namespaces.PREFIX, 'sh', '-c', 'ls -A /dev/shm; id -u; grep -c : /proc/net/dev'],
        capture_output=True, text=True, check=True).stdout
    assert shown.split() == [str(os.geteuid()), '1']  # no file, and one network interface


@pytest.mark.process
def test_hang_in_a_library_ends_by_a_failure(tmp_path: Path) -> None:
    (tmp_path / 'test_hang.py').write_text(
        'import ctypes\nimport conftest\n\nconftest.HANG_SECONDS = 0.5\n\n\n'
        'def test_hang():\n    ctypes.PyDLL(None).pause()  # keeps the GIL\n')
    ended = subprocess.run(
        [sys.executable, '-m', 'pytest', '-c', changed.ROOT / 'setup.cfg', '--rootdir', tmp_path,
         '-p', 'no:cacheprovider', '-p', 'conftest', tmp_path],
        env={**os.environ, **NO_PLUGINS, 'PYTHONPATH': os.pathsep.join(sys.path)},
        capture_output=True, text=True, timeout=LONGEST_SECONDS, check=False)
    assert ended.returncode == 1
    assert 'in test_hang' in ended.stderr  # the stacks of all threads
