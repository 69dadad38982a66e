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
The rules by which the parser of URDF takes or refuses a file, kept by a robot that is written.

What can be mended is mended. A colour that is cut is kept as ``sdf:rgba`` for the way back. What
cannot be mended is refused.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
import math
import re

from opencv_tools.robot.sdf.values import CUT as CUT_SDF
from opencv_tools.robot.unique import unique_name
from opencv_tools.robot.urdf.link_reader import CUT
from opencv_tools.robot.xml.document import DescriptionError, Element, line_of
from opencv_tools.robot.xml.numbers import clamped, number_text, numbers_text, unclamped, UNLIMITED
from opencv_tools.robot.xml.passthrough import URDF_NAME
from opencv_tools.robot.xml.report import Report

# Numbers of the parts of a joint that the parser reads, and those that have to be there.
_NUMBERS: Mapping[str, tuple[str, ...]] = {
    'calibration': ('rising', 'falling'),
    'dynamics': ('damping', 'friction'),
    'limit': ('lower', 'upper', 'effort', 'velocity'),
    'mimic': ('multiplier', 'offset'),
    'safety_controller': ('soft_lower_limit', 'soft_upper_limit', 'k_position', 'k_velocity'),
}
_REQUIRED: Mapping[str, str] = {'mimic': 'joint', 'safety_controller': 'k_velocity'}
_NUMBER = re.compile(r'[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?')
_VERSION = re.compile(r'1\.\d+')


def keep_urdf_rules(root: Element, source: str, report: Report) -> None:
    """
    Mend what the parser of URDF would refuse.

    :param root: the element ``<robot>``; it is changed.
    :param source: the file that the robot comes from.
    :param report: takes what is changed.
    :raises DescriptionError: there is something that cannot be mended.
    """
    for rule in _RULES:
        rule(root, source, report)


def _restore(root: Element, _: str, __: Report) -> None:
    """Restore what the rules of SDF changed in elements of Gazebo."""
    for block in root.iterfind('gazebo'):
        for element in block.iter():
            if URDF_NAME in element.attrib:
                element.set('name', element.attrib.pop(URDF_NAME))
            if CUT_SDF in element.attrib:
                element.text = unclamped(element.text or '', element.attrib.pop(CUT_SDF))


def _complete_limits(root: Element, _: str, __: Report) -> None:
    """Write the effort and the velocity of limits that have none: no limit."""
    for limit in _parts(root, 'limit'):
        for name in ('effort', 'velocity'):
            if name not in limit.attrib:
                limit.set(name, number_text(UNLIMITED))


def _complete_dynamics(root: Element, _: str, __: Report) -> None:
    """Leave out ``<dynamics>`` that is empty; write the default where it says other things."""
    for joint in root.iterfind('joint'):
        for dynamics in joint.findall('dynamics'):
            if not len(dynamics) and not dynamics.attrib:
                joint.remove(dynamics)
    for dynamics in _parts(root, 'dynamics'):
        if 'damping' not in dynamics.attrib and 'friction' not in dynamics.attrib:
            dynamics.set('damping', '0')


def _cut_colors(root: Element, _: str, report: Report) -> None:
    """Cut the parts of colours to 0 and 1."""
    for path in ('material/color', 'link/visual/material/color'):
        for color in root.iterfind(path):
            _cut_color(color, report)


def _cut_color(color: Element, report: Report) -> None:
    text = color.get('rgba', '')
    if not all(map(_NUMBER.fullmatch, text.split())):
        return
    values = tuple(map(float, text.split()))
    if clamped(values) != values:
        color.set('rgba', numbers_text(clamped(values)))
        color.set(CUT, text)
        material = color.getparent()
        name = '' if material is None else material.get('name', '')
        report.warn('color', name, line_of(color), f'rgba={text!r} is beyond 0 to 1, which URDF '
                    f'demands; {color.get("rgba")!r} stands there')


def _name_materials(root: Element, _: str, report: Report) -> None:
    """Name each material of the robot once: visuals of that name mean the first one."""
    materials = root.findall('material')
    taken = {material.get('name', '') for material in materials}
    seen: set[str] = set()
    counts: dict[str, int] = {}
    for material in materials:
        name = material.get('name', '')
        if name in seen:
            new = unique_name(f'{name}_again', taken, counts)
            taken.add(new)
            material.set('name', new)
            report.warn('material', name, line_of(material), 'URDF wants each name once; it is '
                        f'called {new!r} there')
        seen.add(name)


def _write_version(root: Element, _: str, report: Report) -> None:
    version = root.get('version')
    if version is not None and not _VERSION.fullmatch(version):
        root.set('version', '1.0')
        report.warn('robot', root.get('name', ''), 0, f'version={version!r} is none of URDF; '
                    "it is '1.0' there")


def _refuse_numbers(root: Element, source: str, _: Report) -> None:
    """Refuse what the parser does not read in a joint; all this stood in a file of URDF once."""
    for tag in _NUMBERS:
        for part in _parts(root, tag):
            flaw, joint = _flaw(part, tag), part.getparent()
            if flaw and joint is not None:
                raise DescriptionError(f'{flaw} in joint {joint.get("name")!r}', source=source,
                                       line=line_of(part), tag=tag)


def _parts(root: Element, tag: str) -> list[Element]:
    """Return of each joint the first element with a tag; the parser looks at no other."""
    found = (joint.find(tag) for joint in root.iterfind('joint'))
    return [part for part in found if part is not None]


def _flaw(part: Element, tag: str) -> str:
    needed = _REQUIRED.get(tag, '')
    if needed and needed not in part.attrib:
        return f'has no {needed}=, which URDF demands,'
    for name in _NUMBERS[tag]:
        text = part.get(name, '0').strip()
        if not _NUMBER.fullmatch(text) or math.isinf(float(text)):
            return f'{name}={text!r} is not a finite number'
    return ''


_RULES: tuple[Callable[[Element, str, Report], None], ...] = (
    _restore, _complete_limits, _complete_dynamics, _cut_colors, _name_materials, _write_version,
    _refuse_numbers)
