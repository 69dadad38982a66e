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

"""Masses and moments of inertia that a body can have."""

from __future__ import annotations

from dataclasses import replace

from opencv_tools.robot.model import Inertial, Link, Robot
from opencv_tools.robot.pose import Tensor
from opencv_tools.robot.xml.document import DescriptionError
from opencv_tools.robot.xml.numbers import numbers_text
from opencv_tools.robot.xml.report import Report

# Rounding error of the inequalities between moments of inertia, relative to the moments.
_ROUNDING = 1e-14
# Of the largest second moment, so that no moment of inertia is 0 for a simulator.
_SMALLEST = 1e-6


def without_zero_masses(robot: Robot, report: Report) -> Robot:
    """Return a robot whose links of mass 0 have no inertial; simulators of SDF count 1 kg."""
    def changed(link: Link) -> Link:
        if link.inertial is None or link.inertial.mass:
            return link
        has_moments = any(link.inertial.inertia)
        (report.warn if has_moments else report.preserve)(
            'inertial', link.name, link.line, 'has mass 0, which is 1 kg in SDF; converted like a '
            'link without <inertial>' + ', without its moments of inertia' * has_moments)
        return replace(link, inertial=None)

    return replace(robot, links=tuple(map(changed, robot.links)))


def report_inertials(robot: Robot, report: Report) -> None:
    """Report the inertials that are physically impossible."""
    for link in robot.links:
        inertial = link.inertial
        if inertial is not None and not is_physical(inertial):
            impossible = (f'the mass {inertial.mass:g} is' if inertial.mass < 0 else
                          'the moments of inertia are')
            report.warn('inertial', link.name, link.line, f'{impossible} physically impossible, '
                        'and Gazebo rejects the link; converted unchanged')


def with_physical_inertials(robot: Robot, report: Report) -> Robot:
    """
    Return a robot in which physically impossible moments of inertia are the nearest possible ones.

    :raises DescriptionError: a mass is negative, or the moments are those of no body at all.
    """
    def changed(link: Link) -> Link:
        inertial = link.inertial
        if inertial is None or is_physical(inertial):
            return link
        if inertial.mass < 0:
            raise DescriptionError(f'link {link.name!r} has the negative mass {inertial.mass:g}; '
                                   'correct it', source=robot.source, line=link.line,
                                   tag='inertial')
        moments = nearest_moments(inertial.inertia) if inertial.mass else None
        if moments is None or not is_physical(replace(inertial, inertia=moments)):
            raise DescriptionError(
                f'link {link.name!r} has the mass {inertial.mass:g} and the moments of inertia '
                f'{numbers_text(inertial.inertia)}, to which no physical ones are near; correct '
                'them', source=robot.source, line=link.line, tag='inertial')
        report.warn('inertial', link.name, link.line, 'the moments of inertia '
                    f'{numbers_text(inertial.inertia)} are physically impossible; they become '
                    f'{numbers_text(moments)}')
        return replace(link, inertial=replace(inertial, inertia=moments))

    return replace(robot, links=tuple(map(changed, robot.links)))


def nearest_moments(inertia: Tensor) -> Tensor | None:
    """
    Return the moments of inertia of a body that are nearest to given ones, with the same axes.

    The integral of x x^T over the mass is S = trace(I) / 2 - I. A body has no negative eigenvalue
    of S (P. Wensing, S. Kim, J. Slotine, Linear matrix inequalities for physically consistent
    inertial parameter identification, 2018). So negative ones become almost 0, which gives the
    nearest S in the Frobenius norm, and I = trace(S) - S.

    :param inertia: ixx, ixy, ixz, iyy, iyz, izz in kg m2.
    :returns: the moments in the same order; None if S has no positive eigenvalue.
    """
    import numpy as np
    scale = max(map(abs, inertia))
    xx, xy, xz, yy, yz, zz = (moment / scale for moment in inertia)
    moments = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    values, axes = np.linalg.eigh(np.trace(moments) / 2 * np.eye(3) - moments)
    if values[-1] <= 0:
        return None
    values = np.maximum(values, _SMALLEST * values[-1])
    result = values.sum() * np.eye(3) - axes @ np.diag(values) @ axes.T
    xx, xy, xz, yy, yz, zz = (scale * float(moment) for moment in result[np.triu_indices(3)])
    return xx, xy, xz, yy, yz, zz


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
