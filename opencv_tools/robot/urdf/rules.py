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
Rules of the URDF parser that a written robot has to keep.

What breaks a rule is corrected or refused.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
import math
import re

from opencv_tools.robot.names import Names
from opencv_tools.robot.urdf.versions import (
    NEW_LIMITS, OLDEST, omit_newer, OPTIONAL_LIMITS, VERSIONS)
from opencv_tools.robot.xml.document import DescriptionError, Element, line_of
from opencv_tools.robot.xml.numbers import clamped, number_text, numbers_text, UNLIMITED
from opencv_tools.robot.xml.passthrough import URDF_NAME
from opencv_tools.robot.xml.report import Report

# Attributes of a joint's elements that the parser reads as numbers.
_NUMBERS: Mapping[str, tuple[str, ...]] = {
    'calibration': ('rising', 'falling'),
    'dynamics': ('damping', 'friction'),
    'limit': ('lower', 'upper', 'effort', 'velocity', *NEW_LIMITS),
    'mimic': ('multiplier', 'offset'),
    'safety_controller': ('soft_lower_limit', 'soft_upper_limit', 'k_position', 'k_velocity'),
}
_REQUIRED: Mapping[str, str] = {'mimic': 'joint', 'safety_controller': 'k_velocity'}
_NUMBER = re.compile(r'[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?')


def keep_urdf_rules(root: Element, source: str, report: Report, version: str) -> None:
    """
    Correct what the parser of URDF would refuse.

    :param root: the element ``<robot>``; it is changed.
    :param source: the file that the robot comes from.
    :param version: the version of URDF to write.
    :raises DescriptionError: there is an error that cannot be corrected.
    """
    _restore_sdf(root)
    _complete_limits(root, version)
    _complete_dynamics(root)
    _clamp_colors(root, report)
    _rename_materials(root, report)
    _correct_version(root, report, version)
    _check_numbers(root, source, version)


def _restore_sdf(root: Element) -> None:
    """Restore names in ``<gazebo>`` that the rules of SDF changed."""
    for block in root.iterfind('gazebo'):
        for element in block.iter():
            if URDF_NAME in element.attrib:
                element.set('name', element.attrib.pop(URDF_NAME))


def _complete_limits(root: Element, version: str) -> None:
    """Write the effort and velocity of limits that have none; they mean no limit."""
    for limit in _joint_elements(root, 'limit'):
        limit.attrib.update({name: number_text(UNLIMITED) for name in ('effort', 'velocity')
                             if name not in limit.attrib})
        # A negative number means no limit too, but URDF 1.2 refuses it.
        for name in _NUMBERS['limit'][2:] if version >= OPTIONAL_LIMITS else ():
            if limit.get(name, '').strip()[:1] == '-':
                limit.set(name, number_text(UNLIMITED))


def _complete_dynamics(root: Element) -> None:
    """Remove empty ``<dynamics>``, and write the default damping if there are no numbers."""
    for joint in root.iterfind('joint'):
        found = joint.findall('dynamics')
        if len(found) == 1 and not len(found[0]) and not found[0].attrib:
            joint.remove(found[0])
    for dynamics in _joint_elements(root, 'dynamics'):
        if 'damping' not in dynamics.attrib and 'friction' not in dynamics.attrib:
            dynamics.set('damping', '0')


def _clamp_colors(root: Element, report: Report) -> None:
    for material in (*root.iterfind('material'), *root.iterfind('link/visual/material')):
        for color in material.iterfind('color'):
            text = color.get('rgba', '')
            if not all(map(_NUMBER.fullmatch, text.split())):
                continue
            values = tuple(map(float, text.split()))
            if clamped(values) != values:
                color.set('rgba', numbers_text(clamped(values)))
                report.warn('color', material.get('name', ''), line_of(color), f'rgba={text!r} is '
                            f'outside of 0 to 1; clamped to {color.get("rgba")!r}')


def _rename_materials(root: Element, report: Report) -> None:
    """Rename materials of the robot with equal names, as visuals use the first one."""
    materials = root.findall('material')
    taken, seen = Names(material.get('name', '') for material in materials), set[str]()
    for material in materials:
        name = material.get('name', '')
        if name in seen:
            new = taken.new(f'{name}_again')
            material.set('name', new)
            report.warn('material', name, line_of(material),
                        f'renamed to {new!r}, because URDF requires unique names')
        seen.add(name)


def _correct_version(root: Element, report: Report, version: str) -> None:
    text = root.get('version')
    if text is not None and text not in VERSIONS:
        report.warn('robot', root.get('name', ''), 0,
                    f'version={text!r} is not a version of URDF; {version!r} is written')
    if text is not None or version > OLDEST:
        root.set('version', version)
    omit_newer(root, version, report)


def _check_numbers(root: Element, source: str, version: str) -> None:
    """Refuse elements of joints that the parser cannot read; they come from a file of URDF."""
    for tag in _NUMBERS:
        for element in _joint_elements(root, tag):
            flaw, joint = _flaw(element, tag), element.getparent()
            lower, upper = (element.get(name, '0') for name in ('lower', 'upper'))
            if not flaw and version >= OPTIONAL_LIMITS and float(lower) > float(upper):
                flaw = (f'lower={lower!r} is greater than upper={upper!r}, which URDF {version} '
                        f'refuses; write --urdf-version {OLDEST}')
            if flaw and joint is not None:
                raise DescriptionError(f'joint {joint.get("name")!r}: {flaw}', source=source,
                                       line=line_of(element), tag=tag)


def _joint_elements(root: Element, tag: str) -> Iterator[Element]:
    """Return the first element with a tag of each joint; the parser reads no other."""
    for joint in root.iterfind('joint'):
        yield from joint.findall(tag)[:1]


def _flaw(element: Element, tag: str) -> str:
    """Return why the parser refuses an element of a joint; empty if it accepts the element."""
    required = _REQUIRED.get(tag, '')
    if required and required not in element.attrib:
        return f'has no {required}=, which URDF requires'
    for name in _NUMBERS[tag]:
        text = element.get(name, '0').strip()
        if not _NUMBER.fullmatch(text) or math.isinf(float(text)):
            return f'{name}={text!r} is not a finite number'
    return ''
