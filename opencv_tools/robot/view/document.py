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

"""JSON-compatible document of a robot for the page: frames, shapes, joints and numbers."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
import math
from typing import Any, TYPE_CHECKING

from opencv_tools.robot.geometry import Mesh
from opencv_tools.robot.kinematics import attached_links, check_mimic_cycles, Kinematics
from opencv_tools.robot.model import (
    Axis, FrameId, Inertial, Joint, Link, MODEL, Placement, Robot, Shape)
from opencv_tools.robot.pose import normalised, Pose, Transform
from opencv_tools.robot.view.mesh_files import MeshFiles
from opencv_tools.robot.xml.document import DescriptionError
from opencv_tools.robot.xml.numbers import numbers

if TYPE_CHECKING:
    from lxml import etree

Document = dict[str, Any]
MAX_LINKS = 20_000
MAX_SHAPES = 50_000
# Sizes of the shapes that only SDF has, with their defaults.
_SDF_SIZES: Mapping[str, Mapping[str, str]] = {
    'ellipsoid': {'radii': '1 1 1'}, 'cone': {'radius': '0.5', 'length': '1'},
    'plane': {'normal': '0 0 1', 'size': '1 1'}}


def robot_document(robot: Robot, meshes: MeshFiles) -> Document:
    """
    Return a robot with everything that the page draws.

    :returns: a value for `json.dumps`. A transform is the rotation matrix in row-major order and
        the translation. ``step`` of a joint is its frame at zero in the parent link,
        ``child_step`` the child link in that frame, and ``pose`` of a root link its pose in the
        model. Links and joints are referred to by their number. ``order`` has the joints of the
        tree, parents first; ``mimic_order`` has all joints, each after those that it mimics.
    :raises DescriptionError: the robot is too large, or frames or mimics have a cycle.
    """
    _check_size(robot)
    kinematics = Kinematics(robot)
    link_numbers = {link.name: number for number, link in enumerate(robot.links)}
    joint_numbers = {joint.name: number for number, joint in enumerate(robot.joints)}
    reached = kinematics.subtree(kinematics.roots)
    return {
        'name': robot.name,
        'links': [_link(link, kinematics, joint_numbers, meshes) for link in robot.links],
        'joints': [_joint(joint, kinematics, link_numbers, joint_numbers)
                   for joint in robot.joints],
        'frames': _frames(robot, kinematics, link_numbers),
        'roots': [link_numbers[name] for name in kinematics.roots],
        'order': [joint_numbers[joint.name] for name in reached
                  for joint in kinematics.child_joints[name]],
        'mimic_order': [joint_numbers[joint.name] for joint in check_mimic_cycles(robot)],
    }


def _check_size(robot: Robot) -> None:
    shapes = sum(len(link.visuals) + len(link.collisions) for link in robot.links)
    for count, limit, name in ((len(robot.links), MAX_LINKS, 'links'),
                               (len(robot.joints), MAX_LINKS, 'joints'),
                               (len(robot.frames), MAX_LINKS, 'frames'),
                               (shapes, MAX_SHAPES, 'visuals and collisions')):
        if count > limit:
            raise DescriptionError(f'has {count} {name}, but the page shows {limit} at most; '
                                   'use a part of the robot', source=robot.source, tag='robot')
    if not robot.links:
        raise DescriptionError('has no links, so there is nothing to show; add a <link>',
                               source=robot.source, tag='robot')


def _link(link: Link, kinematics: Kinematics, joints: Mapping[str, int], meshes: MeshFiles
          ) -> Document:
    frame, parent = FrameId('link', link.name), kinematics.parent_joint.get(link.name)

    def shape(one: Shape) -> Document:
        material = one.material
        return {'name': one.name, 'pose': _offset(kinematics, link, one.placement),
                'geometry': _geometry(one, meshes),
                'color': list(material.color or material.ambient or ()) if material else []}

    return {
        'name': link.name, 'joint': joints[parent.name] if parent else -1,
        'pose': _transform(kinematics.pose(frame)),
        'in_model': pose_numbers(kinematics.between(MODEL, frame)),
        'visuals': [*map(shape, link.visuals)],
        'collisions': [*map(shape, link.collisions)],
        'inertial': link.inertial and {
            'mass': link.inertial.mass, 'inertia': list(link.inertial.inertia),
            'ellipsoid': _ellipsoid(link.inertial, kinematics.within(
                frame, link.inertial.placement).transform())},
    }


def _joint(joint: Joint, kinematics: Kinematics, links: Mapping[str, int],
           joints: Mapping[str, int]) -> Document:
    frame, dof = FrameId('joint', joint.name), joint.kind.dof
    parent, child = FrameId('link', joint.parent), FrameId('link', joint.child)
    limits = [_limit(axis) if joint.has_position_limits else (None, None)
              for axis in joint.axes[:joint.kind.axes]]
    limits += [(None, None)] * (dof - len(limits))
    return {
        'name': joint.name, 'type': joint.type, 'kind': joint.kind.name,
        'parent': links[joint.parent], 'child': links[joint.child], 'loop': joint.is_loop,
        'step': _transform(kinematics.between(parent, frame).transform()),
        'child_step': _transform(kinematics.between(frame, child).transform()),
        'loop_step': _transform(kinematics.between(child, frame).transform()),
        'axes': [list(normalised(axis.xyz)) for axis in joint.axes] or [[0.0, 0.0, 1.0]] * (
            joint.kind.name in ('revolute', 'prismatic', 'planar', 'universal')),
        'drawn_axes': min(len(joint.axes), joint.kind.axes),
        'limits': limits, 'spans': list(joint.kind.random_span),
        'mimic': [[index, joints.get(axis.mimic.joint, -1), axis.mimic.multiplier,
                   axis.mimic.offset]
                  for index, axis in enumerate(joint.axes[:dof]) if axis.mimic],
    }


def _frames(robot: Robot, kinematics: Kinematics, links: Mapping[str, int]) -> list[Document]:
    owners = {frame.name: frame for frame in robot.frames}
    return [{'name': frame.name, 'link': links[link.name],
             'step': _transform(kinematics.between(link, frame).transform()),
             'in_link': pose_numbers(kinematics.between(link, frame)),
             'attached_to': [*owners[frame.name].attached_to]}
            for frame, link in attached_links(robot).items()]


def pose_numbers(pose: Pose) -> list[float]:
    """Return x, y, z, roll, pitch and yaw; -0 becomes 0."""
    return _finite(value + 0.0 for value in (*pose.xyz, *pose.rpy))


def _transform(transform: Transform) -> list[float]:
    return _finite((*transform.rotation, *transform.translation))


def _offset(kinematics: Kinematics, link: Link, placement: Placement) -> list[float]:
    return _transform(kinematics.within(FrameId('link', link.name), placement).transform())


def _finite(values: Any) -> list[float]:
    found: list[float] = [*values]
    if not all(map(math.isfinite, found)):
        raise DescriptionError('a pose is too far away for floating-point numbers', tag='robot')
    return found


def _limit(axis: Axis) -> tuple[float | None, float | None]:
    lower, upper = (axis.limit.lower, axis.limit.upper) if axis.limit else (-math.inf, math.inf)
    return lower if math.isfinite(lower) else None, upper if math.isfinite(upper) else None


def _geometry(shape: Shape, meshes: MeshFiles) -> Document:
    geometry = shape.geometry
    if geometry is None:
        found = shape.extension.find_sdf('geometry')
        return _sdf_geometry(next(found.iterchildren('*'), None) if found is not None else None)
    if isinstance(geometry, Mesh):
        return {'kind': 'mesh', 'mesh': meshes.add(geometry.uri),
                'scale': list(geometry.scale or (1.0, 1.0, 1.0))}
    return {'kind': type(geometry).__name__.lower(), **vars(geometry)}


def _sdf_geometry(element: etree._Element | None) -> Document:
    if element is None:
        return {'kind': 'none', 'reason': 'the shape has no geometry'}
    tag = str(element.tag)
    if tag not in _SDF_SIZES:
        return {'kind': 'none', 'reason': f'the page does not draw <{tag}>'}
    sizes = {}
    try:
        for name, default in _SDF_SIZES[tag].items():
            found = numbers(element.findtext(name, default), len(default.split()), element)
            sizes[name] = found if len(found) > 1 else found[0]
    except DescriptionError as err:
        return {'kind': 'none', 'reason': str(err)}
    return {'kind': tag, **sizes}


def _ellipsoid(inertial: Inertial, pose: Transform) -> Document | None:
    """
    Return the homogeneous ellipsoid with a mass and moments of inertia; None if there is none.

    A principal moment of an ellipsoid is mass / 5 * (the sum of the squares of both other radii).

    :returns: the three ``radii`` in metres, and the ``pose`` of the ellipsoid in the link.
    """
    largest = max(map(abs, inertial.inertia))
    if not (inertial.mass > 0 and 0 < largest < math.inf):
        return None
    import numpy as np
    xx, xy, xz, yy, yz, zz = (moment / largest for moment in inertial.inertia)
    moments, axes = np.linalg.eigh(np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]))
    if np.linalg.det(axes) < 0:
        axes[:, 0] = -axes[:, 0]
    squares: Sequence[float] = (2.5 * (moments.sum() - 2 * moments)).tolist()
    factor = math.sqrt(largest / inertial.mass)
    radii = [math.sqrt(max(0.0, square)) * factor for square in squares]
    turned = pose @ Transform(tuple(axes.ravel().tolist()), (0.0, 0.0, 0.0))
    return {'radii': radii, 'pose': _transform(turned)} if all(map(math.isfinite, radii)) else None
