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

"""Expansion of xacro in a separate process with limits."""

from __future__ import annotations

from pathlib import Path
import sys

from opencv_tools.robot.xacro import process as xacro_process
from opencv_tools.robot.xacro.expand import expand
from opencv_tools.robot.xacro.process import expand_apart, XacroLimits
from opencv_tools.robot.xml.document import DescriptionError
from opencv_tools.robot.xml.report import Report
import pytest
from xacro_files import HEAD

# The commands expand xacro in a separate process.
pytestmark = pytest.mark.process

EXPONENTIAL = '<xacro:property name="a0" value="lollollol"/>' + ''.join(
    f'<xacro:property name="a{n + 1}" value="{f"${{a{n}}}" * 10}"/>' for n in range(12))
SLOW = '9**9**9'
# Python handles no signal before the result.
UNINTERRUPTIBLE = 'max(range(10**15))'


@pytest.mark.quick_cases(1)
@pytest.mark.parametrize(('content', 'limits', 'message'), [
    ('\n<link name="${\'a\' * 2 * 10**8}"/>', XacroLimits(memory=200_000_000),
     ':2: <link>: needs more memory than the limit'),
    (EXPONENTIAL + '\n<link name="${a12}"/>', XacroLimits(memory=200_000_000),
     ':2: <link>: needs more memory than the limit'),
    ('\n<link name="${[[n] for n in range(10**9)]}"/>', XacroLimits(memory=200_000_000),
     'needs more memory than the limit'),
    ('\n<link name="${\'a\' * 10**10}"/>', XacroLimits(), ':2: <link>: needs more memory'),
    (f'\n<link name="${{{SLOW}}}"/>', XacroLimits(seconds=1),
     ':2: <link>: expansion needs more than 1 s of processor time; look for an expression'),
    (f'\n<link name="${{{UNINTERRUPTIBLE}}}"/>', XacroLimits(seconds=1, grace=0),
     ': expansion needs more than 1 s of processor time'),
    (f'\n<link name="${{{SLOW}}}"/>', XacroLimits(wait=0.5),
     ': expansion timed out after 0.5 s; lo'),
    (f'\n<link name="${{{UNINTERRUPTIBLE}}}"/>', XacroLimits(wait=0.5, grace=0),
     ': expansion timed'),
])
def test_limits_of_memory_and_time(
        content: str, limits: XacroLimits, message: str, tmp_path: Path) -> None:
    path = tmp_path / 'a.xacro'
    report = Report()
    data = f'{HEAD}{content}</robot>'.encode()
    with pytest.raises(DescriptionError) as caught:
        expand_apart(str(path), data, {}, report, limits)
    assert str(caught.value).startswith(str(path))
    assert message in str(caught.value)
    assert '\n' not in str(caught.value)


def test_separate_process_has_the_same_result(tmp_path: Path) -> None:
    path = tmp_path / 'a.xacro'
    for content in ('<xacro:arg name="a" default="1"/>\n<a b="$(arg a)" c="$(find p)"/>',
                    '<xacro:property name="pi" value="3"/>\n<link name="${nothing}"/>',
                    '<xacro:arg'):
        data = f'{HEAD}{content}</robot>'.encode()
        said = []
        for expanding in (expand, expand_apart):
            report = Report(str(path))
            try:
                result = expanding(str(path), data, {'a': '\u00fc', 'c': '3'}, report).decode()
            except DescriptionError as err:
                result = str(err)
            said.append((result, report))
        assert said[0] == said[1]


@pytest.mark.parametrize(('script', 'message'), [
    ('import nothing_at_all', "cannot be expanded: ModuleNotFoundError: No module named 'nothing"),
    ('raise MemoryError', 'needs more memory than the limit'),
    ('import sys; sys.exit(3)', 'cannot be expanded: the process ended with exit status 3'),
    ('pass', 'cannot be expanded: the process ended with exit status 0')])
def test_process_without_a_reply(
        script: str, message: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(
        xacro_process, 'worker_command', lambda _: [sys.executable, '-c', script])
    with pytest.raises(DescriptionError, match=f'^a[.]xacro: {message}'):
        expand_apart('a.xacro', f'{HEAD}</robot>'.encode(), {}, Report())


def test_output_of_other_modules_is_ignored(
        tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
        capfd: pytest.CaptureFixture[str]) -> None:
    (tmp_path / 'sitecustomize.py').write_text('print("good morning")')
    monkeypatch.setenv('PYTHONPATH', str(tmp_path))
    data = f'{HEAD}<link name="a"/></robot>'.encode()
    assert b'morning' not in expand_apart('a.xacro', data, {}, Report())
    assert capfd.readouterr() == ('', '')
