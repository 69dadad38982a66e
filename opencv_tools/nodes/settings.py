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

"""What the start of a node needs of its parameters before the node exists."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from typing import Any

from opencv_tools.base.text import printable
from opencv_tools.nodes.command_line import given_parameters
from opencv_tools.nodes.parameters import parameter, parameter_table, with_values
from opencv_tools.topics.errors import ParameterError
import yaml

#: Bytes of a frame of 1920x1080 in colour.
FULL_HD_BYTES = 1920 * 1080 * 3


class NodeSettings:
    """
    Values of the parameters of a node; subclasses are frozen dataclasses of `parameter` fields.

    The node reads its parameters from ROS. Before, the middleware is configured for these values.
    """

    #: Real-time priority of the threads that carry frames, 1 to 99; 0 for normal scheduling.
    priority: int = 0
    #: Bytes of a published frame whose size is not known; 0 for a node that publishes none.
    FRAME_BYTES = 0

    def frame_bytes(self) -> int:
        """Return the expected bytes of a published frame."""
        return self.FRAME_BYTES


def priority_parameter() -> Any:
    """Return the field ``priority`` of a settings class."""
    return parameter(
        0, 'Real-time priority (SCHED_RR) of the threads that carry frames, from 1 (lowest) to 99 '
        '(highest); 0 for normal scheduling', bounds=(0, 99))


def read_start(
    settings: type[NodeSettings], args: Sequence[str], node: str,
) -> tuple[int, int]:
    """
    Read what the start of a node needs from a command line and its parameter files.

    :param args: command line, program name first.
    :param node: name of the node, unless it is remapped.
    :returns: the real-time priority and the expected bytes of a published frame. Values that the
        node will refuse do not count.
    :raises ParameterError: a value is an empty list, which ends rclpy with another exception.
    """
    try:
        given = given_parameters(args, node)
    except (OSError, RecursionError, ValueError, yaml.YAMLError):
        return settings.priority, settings.FRAME_BYTES
    for name, value in given.items():
        if value == []:
            raise ParameterError(f'parameter {printable(name)} is an empty list, which has no '
                                 'type in ROS: leave it out')
    known = [found for found in parameter_table(settings) if found.name in given]
    values: dict[str, Any] = {}
    for found in known:
        with suppress(ParameterError):
            values[found.name] = found.accept(given[found.name])
    try:
        is_accepted = len(values) == len(known)
        frame_bytes = with_values(
            settings(), values).frame_bytes() if is_accepted else settings.FRAME_BYTES
    except (OSError, RecursionError, ValueError):
        frame_bytes = settings.FRAME_BYTES
    return values.get('priority', settings.priority), frame_bytes
