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
The rules by which the parser of SDF takes or refuses a file, kept by a robot that is written.

A name is changed and a colour is cut where they break a rule. What was there is kept beside it as
``urdf:name`` or ``urdf:color``, and the way back restores it. What cannot be mended is refused.
"""

from __future__ import annotations


from opencv_tools.robot.model import Inertial, Robot, WORLD
from opencv_tools.robot.renaming import allowed_name, flat_name
from opencv_tools.robot.sdf.value_rules import (
    COLORS, flaw_of, is_passed_over, looked_at, read_number)
from opencv_tools.robot.sdf.values import CUT
from opencv_tools.robot.unique import unique_name
from opencv_tools.robot.xml.document import DescriptionError, Element, line_of, local_name
from opencv_tools.robot.xml.numbers import clamped, numbers_text
from opencv_tools.robot.xml.passthrough import URDF_NAME, URDF_NAMESPACE
from opencv_tools.robot.xml.report import Report

_URDF = f'{{{URDF_NAMESPACE}}}'
# Elements that may not be called as SDF calls its own frames.
_FRAMED = ('light', 'sensor', 'particle_emitter', 'projector')
# `names.with_valid_sdf_names` has seen to these; others that have one of their names give way.
_NAMED = ('link', 'joint', 'frame', 'collision', 'visual')
# What rounding leaves of an inequality between moments of inertia, as a part of them.
_ROUNDING = 1e-14


def keep_sdf_rules(root: Element, source: str, report: Report) -> None:
    """
    Mend what the parser of SDF would refuse.

    :param root: the element ``<sdf>``; it is changed.
    :param source: the file that the robot comes from.
    :param report: takes what is changed.
    :raises DescriptionError: there is something that cannot be mended.
    """
    for element in looked_at(root):
        if len(element):
            _change_names(element, report)
        if element.tag in COLORS:
            _cut_color(element, report)
        flaw = flaw_of(element)
        if flaw:
            raise DescriptionError(flaw, source=source, line=line_of(element),
                                   tag=local_name(element))


def _change_names(element: Element, report: Report) -> None:
    """Change names of the children that have ``::``, are reserved, or are there twice."""
    named = [child for child in element if isinstance(child.tag, str) and child.tag != 'plugin'
             and child.get('name') is not None]
    taken = {child.get('name', '') for child in named if _keeps_name(child)}
    counts: dict[str, int] = {}
    for child in named:
        if _keeps_name(child):
            continue
        name = wanted = child.get('name', '')
        if child.tag in _FRAMED:
            wanted = f'{WORLD}_{child.tag}' if name == WORLD else allowed_name(name)
        elif not is_passed_over(child):
            wanted = flat_name(name)
        tag, new = local_name(child), wanted
        if wanted in taken:
            new = unique_name(f'{wanted}_{tag}', taken, counts)
        taken.add(new)
        if new != name:
            child.set(URDF_NAME, child.get(URDF_NAME, name))
            child.set('name', new)
            report.warn(tag, name, line_of(child), 'SDF wants each name once and '
                        f'has some for itself; it is called {new!r} there')


def _keeps_name(child: Element) -> bool:
    return child.tag in _NAMED or str(child.tag).startswith(_URDF)


def _cut_color(element: Element, report: Report) -> None:
    """Cut the parts of a colour to 0 and 1."""
    words = (element.text or '').split()
    values = tuple(value for word in words if (value := read_number(word)) is not None)
    if len(values) == len(words) and clamped(values) != values:
        text = (element.text or '').strip()
        element.set(CUT, text)
        element.text = numbers_text(clamped(values))
        before = element.getprevious()
        if before is not None and before.get(CUT) == text:
            return  # the same colour, which URDF has once
        report.warn(local_name(element), _owner(element), line_of(element), f'{text!r} is beyond '
                    f'0 to 1, which SDF demands; {element.text!r} stands there')


def _owner(element: Element) -> str:
    """Return the name of the nearest element around one that has a name."""
    return next((name for one in element.iterancestors() if (name := one.get('name'))), '')


def note_inertials(robot: Robot, report: Report) -> None:
    """Report the masses and moments of inertia that no body has."""
    for link in robot.links:
        if link.inertial is not None and not is_possible(link.inertial):
            report.warn('inertial', link.name, link.line, 'no body has this mass and these '
                        'moments of inertia, and Gazebo refuses them; they are written as they '
                        'are')


def is_possible(inertial: Inertial) -> bool:
    """
    Return whether a body can have this mass and these moments of inertia.

    It can if no principal moment is above the sum of both others: if trace / 2 - moments, as a
    matrix, has no negative eigenvalue, and so no negative principal minor.
    """
    xx, xy, xz, yy, yz, zz = inertial.inertia
    half = (xx + yy + zz) / 2
    if inertial.mass < 0 or half < 0:
        return False
    if half == 0:
        return not any(inertial.inertia)
    a, b, c = ((half - moment) / half for moment in (xx, yy, zz))
    d, e, f = (-product / half for product in (xy, xz, yz))
    minors = (a, b, c, a * b - d * d, a * c - e * e, b * c - f * f,
              a * (b * c - f * f) - d * (d * c - f * e) + e * (d * f - b * e))
    return min(minors) >= -_ROUNDING
