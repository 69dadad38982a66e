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

"""What stands in the file of each convention: its text, and the numbers and lines of poses."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

from opencv_tools.robot.convert import convert_to_sdf, convert_to_urdf
from opencv_tools.robot.load import LoadOptions, read_element, read_robot
from opencv_tools.robot.model import Joint, Link, Robot, RobotFrame
from opencv_tools.robot.renaming import with_original_names
from opencv_tools.robot.view.document import Document, pose_numbers
from opencv_tools.robot.xml.document import DescriptionError, Element, parse, to_bytes
from opencv_tools.robot.xml.input import read_bytes
from opencv_tools.robot.xml.report import Report

MAX_TEXT = 2_000_000  # bytes of a file that the page shows


def read_both(path: str, report: Report, options: LoadOptions) -> tuple[Robot, Document]:
    """
    Read a robot, and return it with the files of both conventions.

    :returns: the robot with its original names, and by ``urdf`` and ``sdf`` the ``name`` and the
        ``text`` of the file, and its ``poses``, see `_poses`. A file that is not given is
        written by the converter. A format that does not support the robot has a ``reason``.
    :raises DescriptionError: the file is not a valid robot description.
    """
    robot, given = read_robot(path, report, options)
    return both_files(robot, given, lambda: _given(path, robot))


def both_files(robot: Robot, given: str, read_given: Callable[[], Document | None]
               ) -> tuple[Robot, Document]:
    """
    Return what `read_both` returns.

    :param given: format of the file that is given, ``urdf`` or ``sdf``.
    :param read_given: returns that file, see `file_document`; None if it is not shown.
    """
    files: Document = {'given': given, 'file': Path(robot.source).name}
    for kind in ('urdf', 'sdf'):
        try:
            files[kind] = (read_given() if kind == given else None) or _converted(
                robot, kind, given)
        except DescriptionError as err:
            files[kind] = {'name': '', 'text': '', 'poses': {}, 'reason': str(err)}
    return with_original_names(robot), files


def _given(path: str, robot: Robot) -> Document | None:
    """Return the file of the robot; None if other lines were read, such as those of a macro."""
    if path == '-' or path.endswith('.xacro'):
        return None
    data = read_bytes(robot.source)
    if b'xmlns:xacro' in data:
        return None
    return file_document(Path(robot.source).name, data, robot)


def _converted(robot: Robot, kind: str, given: str) -> Document:
    """Return the file that the converter writes."""
    report = Report()
    convert: Callable[[Robot, Report], Element] = (
        convert_to_urdf if kind == 'urdf' else convert_to_sdf)
    data = to_bytes(convert(robot, report))
    origin = (f'expanded from {Path(robot.source).name}' if kind == given
              else f'written by {given}_to_{kind}')
    written = read_element(parse(data, '', report), report)[0]
    return file_document(f'{robot.name}.{kind}, {origin}', data, written)


def file_document(name: str, data: bytes, robot: Robot) -> Document:
    """Return the ``name``, the ``text`` and the ``poses`` of a file, or the ``reason``."""
    shown = with_original_names(robot)
    text = data.decode(errors='replace') if len(data) <= MAX_TEXT else ''
    return {'name': name, 'text': text, 'poses': _poses(shown),
            'reason': '' if text else f'a text of more than {MAX_TEXT} bytes is not shown'}


def _poses(robot: Robot) -> dict[str, dict[str, Any]]:
    """
    Return the poses of the file by ``link``, ``joint`` and ``frame``, and by name.

    :returns: line, numbers x, y, z, roll, pitch, yaw, and the frame that they are relative to:
        its kind and its name. ``file`` is another file that contains the line, or ''.
    """
    def pose(owner: Link | Joint | RobotFrame) -> dict[str, Any]:
        source = str(getattr(owner.line, 'source', ''))
        return {'line': int(owner.line), 'numbers': pose_numbers(owner.placement.pose),
                'in': [*owner.placement.relative_to],
                'file': Path(source).name if source != robot.source else ''}

    result: dict[str, dict[str, Any]] = {'link': {}, 'joint': {}, 'frame': {}}
    for identifier, owner in robot.frame_owners():
        result[identifier.kind][identifier.name] = pose(owner)
    return result
