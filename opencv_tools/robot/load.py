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

"""Files of robots, whichever format they are in."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from lxml import etree
from opencv_tools.robot.model import Robot
from opencv_tools.robot.sdf.includes import file_of_model
from opencv_tools.robot.sdf.reader import read_sdf
from opencv_tools.robot.trees import select_root
from opencv_tools.robot.urdf.reader import read_urdf
from opencv_tools.robot.xacro.expand import is_xacro
from opencv_tools.robot.xacro.process import expand_apart
from opencv_tools.robot.xml.document import (
    DescriptionError, display_name, Element, line_of, local_name, parse, read_bytes)
from opencv_tools.robot.xml.report import Report

URDF = 'urdf'
SDF = 'sdf'


@dataclass(frozen=True)
class LoadOptions:
    """
    What to take from a file, and where to look for others.

    :param arguments: of xacro, by name.
    :param model: the model, where a file of SDF has several.
    :param root: the link that all hangs on, where several links hang on nothing.
    :param search: folders with models that are included.
    """

    arguments: Mapping[str, str] = field(default_factory=dict)
    model: str = ''
    root: str = ''
    search: Sequence[str] = ()


def read_robot(path: str, report: Report, choices: LoadOptions = LoadOptions()
               ) -> tuple[Robot, str]:
    """
    Read a robot of either format; xacro is expanded where the root declares it.

    :param path: a file, a model's folder, or ``-`` for standard input.
    :returns: the robot under the names of the file, and the format: ``URDF`` or ``SDF``.
    :raises DescriptionError: there is no robot to be read.
    """
    path = file_of_model(path)
    report.source = display_name(path)
    root = _root(path, report, choices)
    tag = local_name(root)
    if tag == 'robot':
        return read_urdf(root, report, root_link=choices.root), URDF
    if tag != 'sdf':
        raise DescriptionError('is no robot; URDF begins with <robot>, SDF with <sdf>', root)
    robot = read_sdf(root, report, model=choices.model, search=choices.search)
    return (select_root(robot, choices.root, report) if choices.root else robot), SDF


def _root(path: str, report: Report, choices: LoadOptions) -> Element:
    """Parse a file; of xacro, what it expands to."""
    data, source = read_bytes(path), display_name(path)
    root = parse(data, source, report)
    if local_name(root) == 'robot' and is_xacro(root):
        expanded = expand_apart(path, data, choices.arguments, report)
        return parse(expanded, source, report)
    namespace = etree.QName(root).namespace
    if namespace:
        # As old files of ROS have it; neither format is in one.
        report.warn(local_name(root), '', line_of(root), f'is read without xmlns="{namespace}"')
        for element in root.iter(f'{{{namespace}}}*'):
            element.tag = local_name(element)
    for name in choices.arguments:
        report.warn(local_name(root), name, 0, 'is no argument of it: the file is not xacro')
    return root
