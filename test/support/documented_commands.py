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

"""Check of the commands of the documentation, without running them."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress
import importlib
import itertools
import re
import shlex

from documentation import ROOT
from opencv_tools import (
    basic_image_publisher, basic_image_subscriber, image_filter, image_viewer)
from opencv_tools.calibration.cli import main as img_calibrate
from opencv_tools.convert.cli import main as img_convert
from opencv_tools.datasets.cli import is_for_datasets
from opencv_tools.nodes.parameters import Parameter
from opencv_tools.robot import cli
import pytest
import yaml

PARAMETERS = {'img_publisher': basic_image_publisher.PARAMETERS,
              'img_subscriber': basic_image_subscriber.PARAMETERS,
              'img_filter': image_filter.PARAMETERS,
              'img_viewer': image_viewer.PARAMETERS}
NODES = {'/image_publisher': 'img_publisher', '/image_subscriber': 'img_subscriber',
         '/image_filter': 'img_filter', '/image_viewer': 'img_viewer'}
#: Commands without ROS, by name.
COMMANDS = {'img_calibrate': img_calibrate, 'img_convert': img_convert,
            'robot_compare': cli.robot_compare, 'robot_frames': cli.robot_frames,
            'robot_view': cli.robot_view, 'sdf_to_urdf': cli.sdf_to_urdf,
            'urdf_to_sdf': cli.urdf_to_sdf}
LAUNCH_FILES = {path.name: path.read_text() for path in (ROOT / 'launch').glob('*.launch.py')}
_MAKEFILE = (ROOT / 'Makefile').read_text().replace('\\\n', '')
MAKE_TARGETS = re.findall(r'^\.PHONY: (.*)$', _MAKEFILE, re.MULTILINE)[0]

#: Controls that most cameras have; the node has a parameter for each of the camera's own.
CAMERA_CONTROLS = {'brightness', 'exposure_time_absolute', 'white_balance_automatic'}
# Packages of others whose executables and launch files the pages name.
_OTHER_PACKAGES = {'my_package', 'ros_gz_sim'}
_ENDS = {'|', '||', '&', '&&', ';', '(', ')'}


def check_command(line: str) -> None:
    """Check that what a line of a shell names exists: executables, parameters, options."""
    for words in _simple_commands(line):
        name, *arguments = words
        if name in PARAMETERS:
            _check_parameters(name, arguments)
        elif name in COMMANDS:
            _check_options(name, arguments)
        elif name == 'make':
            assert set(arguments) <= set(MAKE_TARGETS.split()), line
        elif name == 'ros2':
            _check_ros2(*arguments)


def check_span(text: str) -> None:
    """Check the names in ``make TARGET`` and ``PARAMETER:=VALUE``; a value may be in capitals."""
    target = re.fullmatch(r'make ([\w-]+)', text)
    assert target is None or target[1] in MAKE_TARGETS.split(), text
    name, is_assignment, value = text.removeprefix('-p ').partition(':=')
    if not is_assignment or name.isupper() or not re.fullmatch(r'\w+', name):
        return
    executables = [executable for executable, table in PARAMETERS.items()
                   if name in {parameter.name for parameter in table}]
    launched = any(f"'{name}'" in code for code in LAUNCH_FILES.values())
    assert executables or launched or name in CAMERA_CONTROLS, f'no node has the parameter {name}'
    for executable in executables if not value.isupper() else ():
        with suppress(yaml.YAMLError):  # an example of an error
            _accept(executable, name, value)


def _simple_commands(line: str) -> Iterator[list[str]]:
    """Split a line into commands without assignments, sudo, ``ros2 run`` and folders."""
    lexer = shlex.shlex(line, posix=True, punctuation_chars=True)
    lexer.whitespace_split = True
    words: list[str] = []
    for word in (*lexer, ';'):
        if word not in _ENDS:
            words.append(word)
            continue
        while words and (re.match(r'\w+=', words[0]) or words[0] == 'sudo'):
            words = words[1:]
        if words[:3] == ['ros2', 'run', 'opencv_tools']:
            words = words[3:]
            assert words[0] in (*PARAMETERS, *COMMANDS), f'no executable has the name {words[0]}'
        if words:
            yield [words[0].removeprefix('.venv/bin/'), *words[1:]]
        words = []


def _check_parameters(executable: str, arguments: list[str]) -> None:
    assert not arguments or arguments[0] in ('--ros-args', '--help'), arguments
    for option, value in itertools.pairwise(arguments):
        if option == '-p':
            name, _, text = value.partition(':=')
            _accept(executable, name, text)
        elif option == '--params-file':
            assert (ROOT / value).is_file(), value


def _accept(executable: str, name: str, text: str) -> None:
    """Check that a node has a parameter and accepts a value for it."""
    if not name.startswith('qos_overrides.') and name not in CAMERA_CONTROLS:
        _parameter(executable, name).accept(yaml.safe_load(text))


def _parameter(executable: str, name: str) -> Parameter:
    found = [parameter for parameter in PARAMETERS[executable] if parameter.name == name]
    assert found, f'{executable} has no parameter {name}'
    return found[0]


def _check_options(command: str, arguments: list[str]) -> None:
    """Check that a command without ROS has the options."""
    known: set[str] = set()
    is_for_set = command == 'img_convert' and is_for_datasets(arguments)
    mode = ['--format=lerobot'] if is_for_set else []
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr('argparse.ArgumentParser.print_help', lambda parser: known.update(
            *(action.option_strings for action in parser._actions)))
        with pytest.raises(SystemExit):
            COMMANDS[command]([*mode, '--help'])
    assert known
    options = {word.partition('=')[0] for word in arguments if re.match('--?[a-z]', word)}
    assert options <= known, f'{command} has no option {options - known}'


def _check_ros2(verb: str, *arguments: str) -> None:
    """Check the arguments of ``ros2 launch``, ``ros2 param`` and ``ros2 service call``."""
    if verb in ('launch', 'run') and arguments[0] in _OTHER_PACKAGES:
        return
    if verb == 'launch':
        package, file, *assignments = arguments
        assert package == 'opencv_tools' and file in LAUNCH_FILES, file
        for name in (text.partition(':=')[0] for text in assignments):
            assert f"'{name}'" in LAUNCH_FILES[file], f'{file} has no argument {name}'
    elif verb == 'param':
        action, node, *rest = arguments
        assert action in ('list', 'describe', 'get', 'set', 'dump') and node in NODES, arguments
        if rest:
            parameter = _parameter(NODES[node], rest[0])
            assert action != 'set' or parameter.changeable, f'{rest[0]} is fixed at the start'
            if action == 'set':
                parameter.accept(yaml.safe_load(rest[1]))
    elif verb == 'service':
        package, kind, name = arguments[2].split('/')
        assert hasattr(importlib.import_module(f'{package}.{kind}'), name), arguments
    else:
        assert verb in ('bag', 'interface', 'node', 'pkg', 'topic'), verb
