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

"""Inertials: sums, and those of the solids of collisions with a density."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
import math
import operator
from pathlib import Path

from opencv_tools.robot.geometry import Mesh
from opencv_tools.robot.kinematics import Kinematics
from opencv_tools.robot.meshes import cone, ellipsoid, mesh_solid, NoSolidError, Solid, solid_of
from opencv_tools.robot.model import FrameId, Inertial, Link, Placement, Shape
from opencv_tools.robot.pose import Pose, rotated_tensor
from opencv_tools.robot.sdf.values import DEFAULT_INERTIAL, flag, number_of
from opencv_tools.robot.xml.document import DescriptionError, detached, Element
from opencv_tools.robot.xml.numbers import vector
from opencv_tools.robot.xml.report import Report


def solid_of_collision(shape: Shape, folders: Sequence[Path]) -> Solid:
    """
    Return the solid of a collision.

    :param folders: folders in which meshes are searched.
    :raises NoSolidError: it is not known, or the shape has no volume.
    """
    geometry, find_sdf = shape.geometry, shape.extension.find_sdf
    if isinstance(geometry, Mesh):
        if find_sdf('geometry/mesh/submesh') is not None:
            raise NoSolidError('it is a part of a mesh')
        return mesh_solid(geometry, folders)
    if geometry is not None:
        return solid_of(geometry)
    ellipse, peak = find_sdf('geometry/ellipsoid'), find_sdf('geometry/cone')
    if ellipse is not None:
        return ellipsoid(*vector(ellipse.findtext('radii', '1 1 1'), ellipse))
    if peak is not None:
        return cone(number_of(peak, 'radius', 0.5), number_of(peak, 'length', 1.0))
    raise NoSolidError('it is no solid')


_DENSITY = 1000.0  # of water in kg/m3, the default of SDF
_ROUNDING = 1e-9  # relative, of numbers that were converted there and back


def auto_inertial(link: Link, kinematics: Kinematics, report: Report,
                  folders: Sequence[Path] = ()) -> Inertial | None:
    """
    Return the inertial of a link that SDF computes from the density of the collisions.

    :param folders: folders in which meshes are searched.
    :param report: receives the collisions that have no share in it.
    :returns: mass 1 kg and moments 1 kg m2 if no collision has a volume; None if the inertial of
        the link is not ``auto``.
    :raises DescriptionError: the result is not finite.
    """
    element = _auto_element(link)
    if element is None:
        return None
    density, mass = (number_of(element, tag, None) for tag in ('density', 'mass'))
    parts = []
    for shape in link.collisions:
        try:
            solid = solid_of_collision(shape, folders)
        except NoSolidError as err:
            report.warn('collision', shape.name, shape.line, 'has no share in <inertial '
                        f'auto="true"> of link {link.name!r}: {err}')
        else:
            parts.append(_inertial_of(solid, shape, _DENSITY if density is None else density))
    frame = FrameId('link', link.name)
    if not parts:
        report.warn('inertial', link.name, link.line, 'auto="true" needs a collision with a '
                    'volume; the defaults of SDF are used')
        default_mass, moments = DEFAULT_INERTIAL
        return Inertial(Placement(Pose(), frame), default_mass if mass is None else mass, moments)
    total = total_inertial(parts, frame, kinematics)
    if mass is not None and total.mass:  # a given mass counts instead of the density
        ixx, ixy, ixz, iyy, iyz, izz = (mass / total.mass * one for one in total.inertia)
        total = replace(total, mass=mass, inertia=(ixx, ixy, ixz, iyy, iyz, izz))
    if not all(map(math.isfinite, (total.mass, *total.inertia))):
        raise DescriptionError(f'auto="true" of link {link.name!r} has a mass or moments that are '
                               'not finite; give a smaller density', element)
    return total


def _auto_element(link: Link) -> Element | None:
    element = link.extension.find_sdf('inertial')
    return element if element is not None and flag(element.get('auto'), element, 'auto') else None


def _inertial_of(solid: Solid, shape: Shape, density: float) -> Inertial:
    if shape.extension.sdf is not None:
        density = number_of(shape.extension.sdf, 'density', density)
    mass, placement = density * solid.volume, shape.placement
    if any(solid.centre):
        centre = placement.pose.transform() @ Pose(solid.centre).transform()
        placement = replace(placement, pose=centre.pose())
    xx, xy, xz, yy, yz, zz = (mass * moment for moment in solid.moments)
    return Inertial(placement, mass, (xx, xy, xz, yy, yz, zz))


def without_auto(link: Link) -> Link:
    """Return a link whose inertial is not ``auto``, so that its numbers count."""
    if _auto_element(link) is None or link.extension.sdf is None:
        return link
    sdf = detached(link.extension.sdf)
    for element in sdf.iterchildren('inertial'):
        element.attrib.pop('auto', None)
    return replace(link, extension=replace(link.extension, sdf=sdf))


def is_same_inertial(a: Inertial, b: Inertial, frame: FrameId, kinematics: Kinematics) -> bool:
    """Return whether two inertials of one frame are equal except for rounding."""
    poses = [kinematics.within(frame, one.placement).transform() for one in (a, b)]
    moments = [rotated_tensor(one.inertia, pose.rotation)
               for one, pose in zip((a, b), poses)]
    return (math.isclose(a.mass, b.mass, rel_tol=_ROUNDING)
            and math.dist(poses[0].translation, poses[1].translation) <= _ROUNDING
            and math.dist(*moments) <= _ROUNDING * max(map(abs, moments[0])))


def total_inertial(inertials: Sequence[Inertial], frame: FrameId, kinematics: Kinematics
                   ) -> Inertial:
    """Return the sum of inertials about their common centre, by the parallel axis theorem."""
    if len(inertials) == 1:
        return inertials[0]
    poses = [kinematics.within(frame, inertial.placement).transform() for inertial in inertials]
    mass = sum(inertial.mass for inertial in inertials)
    weights = [inertial.mass / mass if mass else 0.0 for inertial in inertials]
    centre_x, centre_y, centre_z = (sum(map(operator.mul, weights, values))
                                    for values in zip(*(pose.translation for pose in poses)))
    centre = (centre_x, centre_y, centre_z)
    total = [0.0] * 6
    for inertial, pose in zip(inertials, poses):
        x, y, z = (value - middle for value, middle in zip(pose.translation, centre))
        rotated = rotated_tensor(inertial.inertia, pose.rotation)
        shifted = (y * y + z * z, -x * y, -x * z, x * x + z * z, -y * z, x * x + y * y)
        total = [before + moment + inertial.mass * shift
                 for before, moment, shift in zip(total, rotated, shifted)]
    ixx, ixy, ixz, iyy, iyz, izz = total
    return Inertial(Placement(Pose(centre), frame), mass, (ixx, ixy, ixz, iyy, iyz, izz))
