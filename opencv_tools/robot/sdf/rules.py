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
Rules of the SDF parser for names, colours and values, applied to a written robot.

Invalid names are changed and colours are clamped. The originals are preserved as ``urdf:name`` and
``urdf:color`` and restored on the way back. Other invalid values are errors.
"""

from __future__ import annotations

from opencv_tools.robot.model import Inertial, Robot, WORLD
from opencv_tools.robot.renaming import allowed_name, flat_name, unique_name
from opencv_tools.robot.sdf.value_rules import (
    COLORS, find_flaw, is_ignored, parsed_elements, read_number)
from opencv_tools.robot.sdf.values import ORIGINAL_COLOR
from opencv_tools.robot.xml.document import DescriptionError, Element, line_of, local_name
from opencv_tools.robot.xml.numbers import clamped, numbers_text
from opencv_tools.robot.xml.passthrough import URDF_NAME, URDF_NAMESPACE
from opencv_tools.robot.xml.report import Report

# Elements whose names must not be reserved names of frames.
_FRAMED = ('light', 'sensor', 'particle_emitter', 'projector')
# Elements with names from `renaming.with_valid_sdf_names`, which are not changed again.
_VALID = ('link', 'joint', 'frame', 'collision', 'visual')
# Rounding error of the inequalities between moments of inertia, relative to the moments.
_ROUNDING = 1e-14


def keep_sdf_rules(root: Element, source: str, report: Report) -> None:
    """
    Change what the parser of SDF would reject.

    :param root: the ``<sdf>``; it is changed.
    :param source: the file that the robot comes from.
    :param report: receives the changes.
    :raises DescriptionError: an invalid value cannot be changed.
    """
    for element in parsed_elements(root):
        if len(element):
            _rename_children(element, report)
        if element.tag in COLORS:
            _clamp_color(element, report)
        flaw = find_flaw(element)
        if flaw:
            raise DescriptionError(flaw, source=source, line=line_of(element),
                                   tag=local_name(element))


def _rename_children(element: Element, report: Report) -> None:
    """Rename the children with reserved or duplicate names, or with ``::`` in their names."""
    named = [child for child in element if isinstance(child.tag, str) and child.tag != 'plugin'
             and child.get('name') is not None]
    renamable = [child for child in named if not _has_valid_name(child)]
    taken = {child.get('name', '') for child in named if _has_valid_name(child)}
    counts: dict[str, int] = {}
    for child in renamable:
        name = new = child.get('name', '')
        if child.tag in _FRAMED:
            new = f'{WORLD}_{child.tag}' if name == WORLD else allowed_name(name)
        elif not is_ignored(child):
            new = flat_name(name)
        if new in taken:
            new = unique_name(f'{new}_{local_name(child)}', taken, counts)
        taken.add(new)
        if new != name:
            child.set(URDF_NAME, child.get(URDF_NAME, name))
            child.set('name', new)
            report.warn(local_name(child), name, line_of(child),
                        f'renamed to {new!r}, because SDF requires unique names and reserves some')


def _has_valid_name(child: Element) -> bool:
    return child.tag in _VALID or str(child.tag).startswith(f'{{{URDF_NAMESPACE}}}')


def _clamp_color(element: Element, report: Report) -> None:
    """Clamp the components of a colour to 0 to 1."""
    words = (element.text or '').split()
    values = tuple(value for word in words if (value := read_number(word)) is not None)
    if len(values) == len(words) and clamped(values) != values:
        text = (element.text or '').strip()
        element.set(ORIGINAL_COLOR, text)
        element.text = numbers_text(clamped(values))
        previous = element.getprevious()
        if previous is not None and previous.get(ORIGINAL_COLOR) == text:
            return  # ambient and diffuse come from one colour of URDF
        report.warn(local_name(element), _owner(element), line_of(element),
                    f'{text!r} is outside of 0 to 1; clamped to {element.text!r}')


def _owner(element: Element) -> str:
    """Return the name of the nearest enclosing element with a name."""
    return next((name for outer in element.iterancestors() if (name := outer.get('name'))), '')


def report_inertials(robot: Robot, report: Report) -> None:
    """Report the inertials that are physically impossible."""
    for link in robot.links:
        if link.inertial is not None and not is_physical(link.inertial):
            report.warn('inertial', link.name, link.line, 'mass and moments of inertia are '
                        'physically impossible, Gazebo rejects them; converted unchanged')


def is_physical(inertial: Inertial) -> bool:
    """
    Return whether a body can have this mass and these moments of inertia.

    No principal moment may be greater than the sum of the two others. This holds if the matrix
    trace / 2 - moments has no negative eigenvalue, and therefore no negative principal minor.
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
