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

"""The parameter ``priority`` of the nodes."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from opencv_tools.nodes.command_line import given_parameters
from opencv_tools.nodes.parameters import Parameter, parameter
import yaml

_PARAMETER = Parameter(
    'priority', 0, 'Real-time priority (SCHED_RR) of the threads that carry frames, from 1 '
    '(lowest) to 99 (highest); 0 for normal scheduling', bounds=(0, 99))


def priority_parameter() -> Any:
    """Return the field ``priority`` of a settings class."""
    return parameter(0, _PARAMETER.description, bounds=_PARAMETER.bounds)


def given_priority(args: Sequence[str], node: str) -> int:
    """
    Return the parameter ``priority``, which is needed before the node exists.

    :param args: command line, program name first.
    :param node: name of the node, unless it is remapped.
    :returns: the priority; 0 for a value that the node will refuse.
    """
    try:
        return int(_PARAMETER.accept(given_parameters(args, node).get('priority', 0)))
    except (OSError, RecursionError, ValueError, yaml.YAMLError):
        return 0
