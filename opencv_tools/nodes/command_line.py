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

"""Parameters of the command line, and checks of arguments that ROS accepts but misapplies."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from opencv_tools.base.regular_files import read_regular
from opencv_tools.base.text import printable, without_password
from opencv_tools.nodes.parameters import Parameter
from opencv_tools.topics.errors import ParameterError
import yaml

_FILE_BYTES = 1_000_000
_FILE_DEPTH = 100
_ANY_NODE = ('*', '**')
_NAME_RULES = ('__node', '__name')

_WITH_VALUE = ('-p', '--param', '-r', '--remap', '--params-file', '--log-level',
               '--log-config-file', '-e', '--enclave')


def check_ros_arguments(
    args: Sequence[str], executable: str, node: str, table: Sequence[Parameter],
) -> list[str]:
    """
    Check remapping rules and parameter files for mistakes that ROS accepts silently.

    :param args: command line, program name first.
    :param node: name of the node, unless it is remapped.
    :returns: sentences about arguments that have no effect.
    :raises ParameterError: an argument is certainly a mistake.
    """
    options = list(_split(args))
    names = {parameter.name for parameter in table}
    for rule, left, _ in _remapping_rules(options):
        if left in names:
            shown = without_password(rule)
            raise ParameterError(f'{shown} is a remapping rule, but {left} is a parameter: '
                                 f'write --ros-args -p {shown}')
    nodes = _node_names(options, node)
    mistakes = (_check_file(Path(value), executable, nodes)
                for option, value in options if option == '--params-file')
    return [mistake for mistake in mistakes if mistake]


def given_parameters(args: Sequence[str], node: str) -> dict[str, Any]:
    """
    Return the parameters that a command line and its parameter files set for a node.

    rclpy's ``parameter_dict_from_yaml_file`` reads neither the command line nor wildcards such as
    ``/**/node``, and limits neither the size nor the depth of a file.

    :param args: command line, program name first.
    :param node: name of the node, unless it is remapped.
    :returns: values by name, not checked.
    :raises OSError: a file cannot be read, see ``load_parameters``.
    :raises ValueError: a file is not text, or is not a parameter file.
    :raises yaml.YAMLError: a value or a file is not YAML.
    """
    options = list(_split(args))
    nodes = _node_names(options, node)
    values: dict[str, Any] = {}
    for option, value in options:
        if option in ('-p', '--param'):
            name, _, text = value.partition(':=')
            owner, _, name = name.rpartition(':')
            if not owner or _is_section_of(owner, nodes):
                values[name] = yaml.safe_load(text)
        elif option == '--params-file':
            for section, parameters in parameter_sections(load_parameters(Path(value))):
                if not isinstance(parameters, dict):
                    raise ValueError(f'{value} is not a parameter file')
                if _is_section_of(section, nodes):
                    values.update(parameters)
    return values


def check_params_file(path: str) -> None:
    """
    Check that a parameter file exists, because launch only warns and starts nodes without it.

    :raises ParameterError: the file does not exist.
    """
    if not Path(path).is_file():
        raise ParameterError(f'params_file is {path!r}: give a file that exists')


def has_section(path: str, names: set[str]) -> bool:
    """
    Return whether a parameter file has a section for one of some nodes, or for every node.

    :returns: True also for a file that cannot be read, because rcl reports the reason.
    """
    sections = _sections(Path(path))
    return sections is None or any(_is_section_of(section, names) for section in sections)


def load_parameters(path: Path) -> Any:
    """
    Read a parameter file, within limits of its size and depth.

    :returns: content of the YAML document.
    :raises OSError: it cannot be read, is not a regular file, or is larger than 1 MB.
    :raises ValueError: it is not text.
    :raises yaml.YAMLError: it is not YAML, is nested too deeply, or has aliases; rcl refuses
        them too.
    """
    content = read_regular(path, _FILE_BYTES)
    loader = getattr(yaml, 'CSafeLoader', yaml.SafeLoader)  # CSafeLoader is much faster
    depth = 0
    for event in yaml.parse(content, loader):
        depth += isinstance(event, yaml.CollectionStartEvent)
        depth -= isinstance(event, yaml.CollectionEndEvent)
        if depth > _FILE_DEPTH or isinstance(event, yaml.AliasEvent):
            raise yaml.YAMLError(f'{path} is not a parameter file')
    return yaml.load(content, loader)


def parameter_sections(content: Any, path: str = '') -> Iterator[tuple[str, Any]]:
    """Yield the node name and the parameters of each section of a parameter file."""
    for name, value in content.items() if isinstance(content, dict) else ():
        if name == 'ros__parameters':
            yield path, value
        else:
            yield from parameter_sections(value, f'{path}/{name}' if path else str(name))


def _split(args: Sequence[str]) -> Iterator[tuple[str, str]]:
    """Yield each ROS option with its value, and every other word as the value of ''."""
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


def _remapping_rules(options: Sequence[tuple[str, str]]) -> Iterator[tuple[str, str, str]]:
    """Yield each remapping rule with its left side, without a node name, and its right side."""
    for option, rule in options:
        left, _, right = rule.partition(':=')
        if option in ('', '-r', '--remap') and right:
            yield rule, left.rpartition(':')[2], right


def _node_names(options: Sequence[tuple[str, str]], node: str) -> set[str]:
    """Return the names that remapping rules give to a node, or its own name without any."""
    renamed = {right for _, left, right in _remapping_rules(options) if left in _NAME_RULES}
    return renamed or {node}


def _is_section_of(section: str, nodes: set[str]) -> bool:
    """Return whether a section of a parameter file is for a node, or for every node."""
    name = section.rpartition('/')[2]
    return name in nodes or name in _ANY_NODE


def _sections(path: Path) -> list[str] | None:
    """Return the node names of a parameter file; None if it cannot be read."""
    try:
        return [printable(name) for name, _ in parameter_sections(load_parameters(path))]
    except (OSError, ValueError, RecursionError, yaml.YAMLError):
        return None


def _check_file(path: Path, executable: str, nodes: set[str]) -> str:
    """
    Check that a file has parameters for a node.

    :returns: a sentence about a section that names the executable instead of the node, or ''.
    :raises ParameterError: the file has parameters for other nodes only.
    """
    sections = _sections(path)
    if sections is None:
        return ''  # rcl reports the error, or reads the file anyway
    node = min(nodes)
    is_own = any(_is_section_of(name, nodes) for name in sections)
    misnamed = next((name for name in sections if name.rpartition('/')[2] == executable), '')
    if misnamed and executable not in nodes:
        right = misnamed.removesuffix(executable) + node
        mistake = (f'{path} has parameters for {misnamed}, but {executable} is the executable '
                   f'and {node} is the node: write {right}: instead of {misnamed}:')
    elif sections and not is_own:
        listed = ', '.join(sorted(set(sections))[:5])
        mistake = (f'{path} has parameters for {listed}, but none for this node: '
                   f'write {node}:, or /**: for every node')
    else:
        return ''
    if not is_own:
        raise ParameterError(mistake)
    return mistake
