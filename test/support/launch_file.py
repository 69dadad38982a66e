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

"""
Start of a launch file where ``ros2 launch`` is missing, which is not on PyPI.

``python launch_file.py FILE NAME:=VALUE...`` reads the few actions that the launch files of the
package consist of, starts their nodes with the same command lines as launch_ros, and ends them at
Ctrl-C.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
import runpy
import shutil
import signal
import subprocess
import sys
import tempfile
from types import ModuleType
from typing import Any

import yaml

#: Values of the launch arguments by name.
Context = dict[str, str]


@dataclass
class DeclareLaunchArgument:
    """An argument of a launch file; without a default it must be given."""

    name: str
    default_value: str | None = None
    description: str = ''
    choices: Sequence[str] | None = None

    def declare(self, context: Context) -> None:
        """Check the value, or set the default."""
        if self.name not in context:
            assert self.default_value is not None, f'the argument {self.name} is required'
            context[self.name] = self.default_value
        assert not self.choices or context[self.name] in self.choices, (
            f'{self.name}:={context[self.name]} is none of {self.choices}')


@dataclass
class LaunchConfiguration:
    """The value of a launch argument."""

    name: str

    def perform(self, context: Context) -> str:
        """Return the value."""
        return context[self.name]


@dataclass
class ParameterValue:
    """A parameter with its type; launch_ros converts only substitutions."""

    content: str | LaunchConfiguration
    value_type: type

    def perform(self, context: Context) -> object:
        """Return the value with its type."""
        if isinstance(self.content, LaunchConfiguration):
            return self.value_type(self.content.perform(context))
        assert isinstance(self.content, self.value_type), self
        return self.content


@dataclass
class Node:
    """A node, started by its executable."""

    package: str
    executable: str
    name: str
    output: str = 'log'
    namespace: str | LaunchConfiguration = ''
    parameters: list[Any] = field(default_factory=list)

    def command(self, context: Context, folder: Path) -> list[str]:
        """Return the command line; parameters are passed in files, as launch_ros does."""
        namespace = (self.namespace if isinstance(self.namespace, str)
                     else self.namespace.perform(context))
        words = ['-r', f'__node:={self.name}']
        words += ['-r', f'__ns:=/{namespace.lstrip("/")}'] if namespace else []
        for number, given in enumerate(self.parameters):
            path = Path(given) if isinstance(given, str) else (
                folder / f'{namespace}_{self.name}_{number}.yaml')
            if isinstance(given, dict):
                values = {
                    name: value.perform(context) if isinstance(value, ParameterValue) else value
                    for name, value in given.items()}
                path.write_text(yaml.safe_dump({'/**': {'ros__parameters': values}}))
            words += ['--params-file', str(path)]
        executable = shutil.which(self.executable)
        assert self.package == 'opencv_tools' and executable, self
        return [executable, '--ros-args', *words]


@dataclass
class OpaqueFunction:
    """A function that returns the nodes."""

    function: Callable[[Context], list[Node]]


def commands(file: Path, context: Context, folder: Path) -> list[list[str]]:
    """
    Return the command lines of the nodes of a launch file.

    :param file: path of the launch file.
    :param context: given arguments; the defaults are added.
    :param folder: folder for parameter files.
    """
    names = {'launch': {'LaunchContext': dict, 'LaunchDescription': list},
             'launch.actions': {'DeclareLaunchArgument': DeclareLaunchArgument,
                                'OpaqueFunction': OpaqueFunction},
             'launch.substitutions': {'LaunchConfiguration': LaunchConfiguration},
             'launch_ros': {},
             'launch_ros.actions': {'Node': Node},
             'launch_ros.parameter_descriptions': {'ParameterValue': ParameterValue}}
    for name, content in names.items():
        sys.modules[name] = ModuleType(name)
        vars(sys.modules[name]).update(content)
    actions = runpy.run_path(str(file))['generate_launch_description']()
    nodes: list[Node] = []
    for action in actions:
        if isinstance(action, DeclareLaunchArgument):
            action.declare(context)
        else:
            nodes += action.function(context)
    return [node.command(context, folder) for node in nodes]


def start(command_lines: list[list[str]]) -> None:
    """Start nodes and wait for their end; SIGINT and SIGTERM interrupt them."""
    nodes = [subprocess.Popen(words) for words in command_lines]

    def interrupt(*_: object) -> None:
        for node in nodes:
            node.send_signal(signal.SIGINT)

    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, interrupt)
    for node, words in zip(nodes, command_lines):
        if node.wait():
            print(f'process has died: {words}', flush=True)


if __name__ == '__main__':
    with tempfile.TemporaryDirectory() as temporary:
        given = dict(argument.split(':=', 1) for argument in sys.argv[2:])
        start(commands(Path(sys.argv[1]), given, Path(temporary)))
