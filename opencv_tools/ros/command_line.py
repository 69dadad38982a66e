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


"""Arguments that ROS would take in silence but not as they were meant."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from opencv_tools.image.text import printable
from opencv_tools.regular_files import read_regular
from opencv_tools.ros.parameters import Parameter, ParameterError
import yaml

_FILE_BYTES = 1_000_000
_FILE_DEPTH = 100
_ANY_NODE = ('*', '**')

_WITH_VALUE = ('-p', '--param', '-r', '--remap', '--params-file', '--log-level',
               '--log-config-file', '-e', '--enclave')

# What ``load_parameters`` raises.
_LOAD_ERRORS = (OSError, ValueError, RecursionError, yaml.YAMLError)


def check_ros_arguments(
    args: Sequence[str], executable: str, node: str, table: Sequence[Parameter],
) -> list[str]:
    """
    Check what ROS does not: that remap rules are none of parameters, and files are for the node.

    :param args: the command line, program name first.
    :param executable: its name.
    :param node: the name of its node, unless it is remapped.
    :param table: the parameters of the node.
    :returns: sentences about what is not used.
    :raises ParameterError: something that was given cannot have been meant so.
    """
    given = list(_split(args))
    names = {parameter.name for parameter in table}
    renamed = set()
    for option, value in given:
        left, _, right = value.partition(':=')
        left = left.rpartition(':')[2]
        if option in ('', '-r', '--remap') and right:
            if left in names:
                raise ParameterError(f'{value} is a rule for topics, and {left} is a parameter: '
                                     f'write --ros-args -p {value}')
            if left in ('__node', '__name'):
                renamed.add(right)
    remarks = (_check_file(Path(value), executable, renamed or {node})
               for option, value in given if option == '--params-file')
    return [remark for remark in remarks if remark]


def check_params_file(path: str) -> None:
    """
    Check that a parameter file exists, for launch only warns and starts nodes without it.

    :param path: the file.
    :raises ParameterError: there is no such file.
    """
    if not Path(path).is_file():
        raise ParameterError(f'params_file is {path!r}: give a file that exists')


def load_parameters(path: Path) -> Any:
    """
    Read a parameter file, as long as that takes no time to speak of.

    :param path: the file.
    :returns: what the YAML says.
    :raises OSError: it cannot be read, is no regular file, or is larger than 1 MB.
    :raises ValueError: it is no text.
    :raises yaml.YAMLError: it is no YAML, nested too deep, or has aliases, which rcl refuses too.
    """
    content = read_regular(path, _FILE_BYTES)
    loader = getattr(yaml, 'CSafeLoader', yaml.SafeLoader)  # which is quicker by far
    depth = 0
    for event in yaml.parse(content, loader):
        depth += isinstance(event, yaml.CollectionStartEvent)
        depth -= isinstance(event, yaml.CollectionEndEvent)
        if depth > _FILE_DEPTH or isinstance(event, yaml.AliasEvent):
            raise yaml.YAMLError(f'{path} is no parameter file')
    return yaml.load(content, loader)


def parameter_sections(content: Any, path: str = '') -> Iterator[tuple[str, Any]]:
    """Yield the sections of a parameter file: the name of the node, and its parameters."""
    for name, value in content.items() if isinstance(content, dict) else ():
        if name == 'ros__parameters':
            yield path, value
        else:
            yield from parameter_sections(value, f'{path}/{name}' if path else str(name))


def _split(args: Sequence[str]) -> Iterator[tuple[str, str]]:
    """Yield each option of ROS and its value, and each word that is none as the value of ''."""
    words = iter(args[1:])
    is_ros = False
    for word in words:
        if word == '--ros-args':
            is_ros = True
        elif is_ros and word == '--':
            is_ros = False
        elif is_ros and word in _WITH_VALUE:
            yield word, next(words, '')
        else:
            yield '', word


def _check_file(path: Path, executable: str, nodes: set[str]) -> str:
    """
    Check that a file has parameters for a node.

    :returns: a sentence about a section that was meant for it, or ''.
    :raises ParameterError: it has parameters for others only.
    """
    try:
        sections = [printable(name) for name, _ in parameter_sections(load_parameters(path))]
    except _LOAD_ERRORS:
        return ''  # which rcl says, or reads all the same
    last = {name: name.rpartition('/')[2] for name in sections}
    own = [name for name in sections if last[name] in nodes or last[name] in _ANY_NODE]
    node = min(nodes)
    mistaken = next((name for name in sections if last[name] == executable), '')
    if mistaken and executable not in nodes:
        right = mistaken.removesuffix(executable) + node
        sentence = (f'{path} has parameters for {mistaken}, but {executable} is the executable '
                    f'and {node} is the node: write {right}: in place of {mistaken}:')
    else:
        listed = ', '.join(sorted(set(sections))[:5])
        sentence = (f'{path} has parameters for {listed}, and none for this node: '
                    f'write {node}:, or /**: for every node')
        mistaken = ''
    if sections and not own:
        raise ParameterError(sentence)
    return sentence if mistaken else ''
