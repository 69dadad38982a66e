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

"""Reading of robot files of any format."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from lxml import etree
from opencv_tools.robot.convert import with_model_parts
from opencv_tools.robot.model import Robot
from opencv_tools.robot.sdf.includes import file_of_model
from opencv_tools.robot.sdf.reader import read_sdf
from opencv_tools.robot.urdf.reader import read_urdf
from opencv_tools.robot.xacro.process import expand_apart, is_xacro
from opencv_tools.robot.xml.document import DescriptionError, Element, line_of, local_name, parse
from opencv_tools.robot.xml.input import display_name, read_bytes
from opencv_tools.robot.xml.report import Report


@dataclass(frozen=True, kw_only=True)
class LoadOptions:
    """
    Options for reading a robot file.

    :param arguments: xacro arguments by name.
    :param model: name of the model to read; may be empty if an SDF file has only one.
    :param root: root link of the tree to read; empty for all trees.
    :param search: folders in which included models are searched.
    :param find: ``path`` or ``package``, see `xacro.expand.expand`.
    """

    arguments: Mapping[str, str] = field(default_factory=dict)
    model: str = ''
    root: str = ''
    search: Sequence[str] = ()
    find: str = 'path'


def read_robot(path: str, report: Report, options: LoadOptions = LoadOptions()
               ) -> tuple[Robot, str]:
    """
    Read a robot from URDF, xacro or SDF. The content of the file determines the format.

    :param path: a file, the folder of a model, or ``-`` for standard input.
    :returns: the robot with the names of the file, and the format: ``urdf`` or ``sdf``.
    :raises DescriptionError: the file is not a valid robot description.
    """
    path = file_of_model(path)
    report.source = display_name(path)
    return read_element(_parse_root(path, report, options), report, options)


def read_element(root: Element, report: Report, options: LoadOptions = LoadOptions()
                 ) -> tuple[Robot, str]:
    """
    Read a robot from the root element of URDF or SDF.

    :returns: see `read_robot`.
    :raises DescriptionError: the element is not a valid robot description.
    """
    tag = local_name(root)
    if tag == 'robot':
        return with_model_parts(read_urdf(root, report, root_link=options.root)), 'urdf'
    if tag != 'sdf':
        raise DescriptionError('is not a robot description; URDF has the root element <robot>, '
                               'SDF <sdf>', root)
    return read_sdf(root, report, model=options.model, root_link=options.root,
                    search=options.search), 'sdf'


def _parse_root(path: str, report: Report, options: LoadOptions) -> Element:
    """Return the root element of a file, with xacro expanded."""
    data, source = read_bytes(path), display_name(path)
    root = parse(data, source, report)
    if local_name(root) == 'robot' and is_xacro(root):
        expanded = expand_apart(path, data, options.arguments, report, find=options.find)
        return parse(expanded, source, report)
    namespace = etree.QName(root).namespace
    if namespace:
        # Old files of ROS have a default namespace, but no format has one.
        report.warn(local_name(root), '', line_of(root), f'ignored xmlns="{namespace}"')
        for element in root.iter(f'{{{namespace}}}*'):
            element.tag = local_name(element)
    for name in options.arguments:
        report.warn(local_name(root), name, 0, 'ignored this --arg, because the file is not xacro')
    return root
