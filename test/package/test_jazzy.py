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

"""The script of CI for apt's ROS, and what runs it: the workflow and the Dockerfile."""

from __future__ import annotations

from pathlib import Path
import re
import shutil
import subprocess

from documentation import ROOT
from documented_commands import check_command, LAUNCH_FILES
import pytest
from waiting import LONGEST_SECONDS
import yaml

SCRIPT = (ROOT / '.ci' / 'jazzy').read_text()
STEPS = re.findall(r'^step_(\w+)\(\) {$', SCRIPT, re.MULTILINE)
COMMANDS = [line.strip() for line in SCRIPT.replace('\\\n', ' ').splitlines() if 'ros2 ' in line]
WORKFLOW = yaml.safe_load((ROOT / '.github' / 'workflows' / 'ci.yml').read_text())['jobs']['jazzy']
DOCKERFILE = (ROOT / 'docker' / 'jazzy.Dockerfile').read_text()


def steps_of(command: str) -> list[str]:
    """Return the steps that a command gives to the script."""
    return ' '.join(re.findall(r'\.ci/jazzy ([\w ]+)', command)).split()


def test_workflow_runs_each_step_once() -> None:
    commands = [step['run'] for step in WORKFLOW['steps'] if 'run' in step]
    assert [step for command in commands for step in steps_of(command)] == STEPS
    assert re.findall(r'^  set -- (.*)$', SCRIPT, re.MULTILINE)[0].split() == STEPS


def test_dockerfile_runs_the_steps_before_the_tests() -> None:
    assert steps_of(DOCKERFILE) == STEPS[:-1]
    assert re.findall('^FROM (.*)$', DOCKERFILE, re.MULTILINE) == [WORKFLOW['container']]


def test_commands_name_what_exists() -> None:
    assert len(COMMANDS) > 8
    for line in COMMANDS:
        check_command(re.sub(r'^.*?(?=ros2 )', '', line))
    launched = re.findall(r'ros2 launch opencv_tools (\S+)', SCRIPT)
    assert sorted(launched) == sorted(LAUNCH_FILES)


def test_packages_are_those_of_the_page() -> None:
    page = (ROOT / 'docs' / 'install.md').read_text()
    named = re.findall(r'ros_venv/bin/pip install (.*)', page)
    assert len(named) == 1
    assert re.findall(r'\n +(.*)\n  # Only the tests need these', SCRIPT) == named


@pytest.mark.process
def test_syntax_of_the_scripts() -> None:
    scripts = [ROOT / '.ci' / name for name in ('jazzy', 'run')]
    for script in scripts:
        subprocess.run(['bash', '-n', script], check=True, timeout=LONGEST_SECONDS)
    shellcheck = shutil.which('shellcheck')
    if shellcheck is None:
        pytest.skip('shellcheck is not on this machine; sudo apt install shellcheck')
    finished = subprocess.run([shellcheck, *scripts], capture_output=True, text=True,
                              timeout=LONGEST_SECONDS, check=False)
    assert (finished.returncode, finished.stdout) == (0, '')


def test_project_is_copied_without_what_make_creates() -> None:
    left_out = (ROOT / '.dockerignore').read_text().split()
    folders = re.findall('^/(.*)/$', (ROOT / '.gitignore').read_text(), re.MULTILINE)
    assert len(folders) > 5
    assert [name for name in folders if not any(Path(name).match(one) for one in left_out)] == []
