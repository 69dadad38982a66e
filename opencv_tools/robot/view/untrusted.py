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

"""Content of the page for a robot from an untrusted text; no file that it names is read."""

from __future__ import annotations

from opencv_tools.robot.urdf.reader import read_urdf
from opencv_tools.robot.view.content import Content, page_document
from opencv_tools.robot.view.conventions import both_files, file_document
from opencv_tools.robot.view.document import robot_document
from opencv_tools.robot.view.mesh_files import PackageMeshes
from opencv_tools.robot.xacro.process import is_xacro_name
from opencv_tools.robot.xml.document import DescriptionError, parse
from opencv_tools.robot.xml.report import Report


def text_content(data: bytes, name: str, report: Report) -> Content:
    """
    Read a robot from a text, without includes and without expressions of xacro.

    :param name: name of the text, for messages.
    :returns: see `content.read_content`; meshes are those of installed packages.
    :raises DescriptionError: the text is not valid URDF, or the robot is too large.
    """
    root = parse(data, name, report)
    for element in root.iter('{*}*'):
        if is_xacro_name(element):
            raise DescriptionError('is not expanded here: publish the output of xacro', element)
    read = read_urdf(root, report)
    robot, files = both_files(read, 'urdf', lambda: file_document(name, data, read))
    meshes = PackageMeshes()
    documents = [{**robot_document(robot, meshes), 'files': {**files, 'file': robot.name}}]
    return Content(page_document(documents, [], meshes, report), meshes)
