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
Versions of URDF, and what the parser of each ignores, as urdfdom 6 does.

Version 1.1 of February 2026 added ``quat_xyzw`` and ``<capsule>``. Version 1.2 of April 2026 made
effort and velocity optional, and added limits of acceleration, deceleration and jerk.
"""

from __future__ import annotations

import re

from opencv_tools.robot.xml.document import Element, line_of
from opencv_tools.robot.xml.report import Report

_OWNER = 'string(ancestor::*[@name][1]/@name)'  # the nearest element with a name
_VERSION = re.compile(r'\s*\+?([0-9]{1,9})\.([0-9]{1,9})')  # as C++ reads two numbers
VERSIONS = ('1.0', '1.1', '1.2')
OLDEST, ROTATIONS, OPTIONAL_LIMITS = VERSIONS
NEW_LIMITS = ('acceleration', 'deceleration', 'jerk')  # of `OPTIONAL_LIMITS`
# The first version with an attribute, by the tag of its element.
_SINCE = {('origin', 'quat_xyzw'): ROTATIONS, **dict.fromkeys(
    (('limit', name) for name in NEW_LIMITS), OPTIONAL_LIMITS)}


def apply_version(root: Element, report: Report) -> str:
    """
    Return the version of a file, and remove the attributes that its parser ignores.

    :param root: the element ``<robot>``; it is changed.
    """
    text = root.get('version', OLDEST)
    match = _VERSION.fullmatch(text)
    parts = [int(part) for part in match.groups()] if match else []
    number = '.'.join(map(str, parts)) or text
    version = number if number in VERSIONS else VERSIONS[-1] if parts > [1, 2] else OLDEST
    if number != version:
        report.warn('robot', root.get('name', ''), line_of(root), f'version={text!r} is refused '
                    f'by the parser of URDF; the file is read as {version!r}')
    if 'version' in root.attrib:
        root.set('version', version)
    omit_newer(root, version, report)
    for element in root.iter('capsule') if version < ROTATIONS else ():
        report.warn('capsule', str(element.xpath(_OWNER)), line_of(element), 'is ignored by the '
                    f'parser of URDF before version="{ROTATIONS}" of <robot>; it is converted')
    return version


def omit_newer(root: Element, version: str, report: Report) -> None:
    """Remove the attributes of newer versions than that of a file."""
    for (tag, name), since in _SINCE.items():
        for element in root.iter(tag) if version < since else ():
            if element.attrib.pop(name, None) is not None:
                report.warn(tag, str(element.xpath(_OWNER)), line_of(element), f'{name}= is '
                            f'omitted: it has no effect before version="{since}" of <robot>')


def written_version(unread: Element | None, chosen: str) -> str:
    """
    Return the version of a written robot: 1.0, which all parsers read, if nothing else is asked.

    :param unread: what was not read of the robot of URDF, with its version.
    :param chosen: the version to write; empty for that of the robot.
    """
    own = '' if unread is None else unread.get('version', '')
    return chosen or (own if own in VERSIONS else OLDEST)
