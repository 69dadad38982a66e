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

"""An executable before its node exists: its name, its settings and its command line."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from opencv_tools.base.remedies import explain_variables
from opencv_tools.nodes.command_line import check_ros_arguments
from opencv_tools.nodes.help_text import check_options
from opencv_tools.nodes.parameters import describe_parameters, Parameter, parameter_table
from opencv_tools.nodes.settings import NodeSettings, read_start
from opencv_tools.topics.errors import ParameterError
from opencv_tools.transport.fastdds.profile import ENVIRONMENT_HELP
from rclpy.utilities import remove_ros_args


@dataclass(frozen=True, kw_only=True)
class Executable:
    """
    Properties of an executable that are needed before its node exists.

    :param settings: parameters of the node; None if they are not known, and other arguments may
        be given as well.
    :param description: purpose of the executable, for ``--help``.
    :param example: example of ROS arguments, for ``--help``.
    :param priority: real-time priority of an executable without settings, see `NodeSettings`.
    :param frame_bytes: bytes of a published frame of an executable without settings.
    """

    name: str
    node: str
    settings: type[NodeSettings] | None = None
    description: str = ''
    example: str = ''
    priority: int = 0
    frame_bytes: int = 0

    def check_arguments(self, args: Sequence[str]) -> list[str]:
        """
        Handle ``--help`` and ``--version``, and exit on arguments that are no ROS arguments.

        :param args: command line, program name first.
        :returns: sentences about ROS arguments that have no effect.
        :raises ParameterError: a ROS argument is certainly a mistake, or a variable of ROS cannot
            be used.
        """
        unusable = explain_variables()
        if unusable:
            raise ParameterError(unusable)
        if self.settings is None:
            return []
        table = parameter_table(self.settings)
        mistakes = check_ros_arguments(args, self.name, self.node, table)
        check_options(self.name, remove_ros_args(args))  # which refuses what rcl refuses
        return mistakes

    def read_start(self, args: Sequence[str]) -> tuple[int, int]:
        """Return the real-time priority and the bytes of a frame of a command line."""
        if self.settings is None:
            return self.priority, self.frame_bytes
        return read_start(self.settings, args, self.node)

    def help_text(self, table: Sequence[Parameter]) -> str:
        """Return the text for `check_options`, which is kept in a file."""
        return (f'{self.description}\n\nexample:\n  {self.name} --ros-args {self.example}\n\n'
                f'{describe_parameters(table)}\n\n{ENVIRONMENT_HELP}')
