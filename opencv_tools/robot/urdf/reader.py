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
URDF, read as a robot.

Each joint is placed in its parent link. Each link with a parent joint is placed in that joint.
"""

from __future__ import annotations

from collections.abc import Iterable
from contextlib import suppress
from dataclasses import replace
import math
from pathlib import Path

from lxml import etree
from opencv_tools.robot.geometry import GEOMETRIES, Geometry, Mesh, SOLIDS
from opencv_tools.robot.joint_kinds import JOINT_KINDS, URDF_TYPES, WITHOUT_AXIS
from opencv_tools.robot.kinematics import check_mimic_cycles
from opencv_tools.robot.model import (
    Axis, Dynamics, Extension, FrameId, INERTIA, Inertial, Joint, Limit, Link, Mimic, MODEL,
    Placement, Robot, RobotFrame, Shape)
from opencv_tools.robot.pose import Pose
from opencv_tools.robot.sdf.fragments import (
    AXES, axis_from_element, frame_from_element, mimic_of_urdf, with_capsule)
from opencv_tools.robot.sdf.values import MODEL_FRAME, with_gazebo_color
from opencv_tools.robot.trees import select_root
from opencv_tools.robot.urdf.context import read_context, UrdfContext
from opencv_tools.robot.urdf.materials import (
    MaterialTable, visual_material, with_block_colors)
from opencv_tools.robot.urdf.poses import origin_of, preserved_pose
from opencv_tools.robot.urdf.tree import LinkTree
from opencv_tools.robot.urdf.versions import apply_version, NEW_LIMITS, OPTIONAL_LIMITS
from opencv_tools.robot.xml.defined import read_table, report_undefined
from opencv_tools.robot.xml.document import (
    AnyElement, DescriptionError, Element, line_of, local_name, required_attribute,
    required_child, required_name, source_of, TrackedElement)
from opencv_tools.robot.xml.numbers import limit_number, number, required_number, vector
from opencv_tools.robot.xml.passthrough import extract_foreign, SDF_TAG
from opencv_tools.robot.xml.report import Report

_DEFAULT_NAME = 'robot'
_DEFINED = read_table(Path(__file__).with_name('elements.txt'))


def shapes_of(element: TrackedElement, tag: str, link_frame: FrameId, materials: MaterialTable,
              report: Report) -> tuple[Shape, ...]:
    """
    Read each ``<visual>`` or ``<collision>`` of a link, and those that the URDF writer preserved.

    A shape without a geometry of URDF is skipped; it stays among what is unread of the link.
    """
    link, shapes = required_name(element), []
    for child in element.take_all(tag, f'{SDF_TAG}{tag}'):
        problem = _geometry_problem(child) if child.tag == tag else ''
        if problem:
            report.warn(tag, child.element.get('name') or link, line_of(child),
                        f'{problem}; the {tag} is left out')
            element.put_back(child)
        else:
            shapes.append(_shape(child, link_frame, link, materials, report))
    return tuple(shapes)


def _geometry_problem(shape: TrackedElement) -> str:
    """Return why urdfdom reads no geometry of a shape; empty if it reads one."""
    geometry = shape.element.find('geometry')
    if geometry is None:
        return 'has no <geometry>'
    children = _geometry_children(geometry)
    if not children:
        return 'has an empty <geometry>'
    tag = local_name(children[0])
    if tag not in GEOMETRIES:
        tags = ', '.join(f'<{one}>' for one in GEOMETRIES)
        return f'<{tag}> is not a geometry of URDF; write one of {tags}'
    has_no_file = tag == 'mesh' and not children[0].get('filename', '').strip()
    return '<mesh> has no filename=' if has_no_file else ''


def _geometry_children(geometry: Element) -> list[Element]:
    """Return the children of a geometry that have no namespace."""
    return [child for child in geometry if not str(child.tag).startswith('{')]


def _shape(element: TrackedElement, link_frame: FrameId, link: str, materials: MaterialTable,
           report: Report) -> Shape:
    tag = local_name(element)
    sdf = extract_foreign(element, 'sdf')
    material = None
    if tag == 'visual':
        preserved = None if sdf is None else TrackedElement(sdf)
        material = visual_material(element, preserved, materials, report, link)
        sdf = None if preserved is None else preserved.unread()
    geometry = None if element.tag != tag else _geometry(element, report, link)
    placement = Placement(origin_of(element), link_frame)
    return Shape(name=element.get('name', ''), placement=placement, geometry=geometry,
                 material=material, extension=Extension(element.unread(), sdf),
                 line=line_of(element))


def _geometry(shape: TrackedElement, report: Report, link: str) -> Geometry | None:
    parent = required_child(shape, 'geometry')
    first, *others = _geometry_children(parent.element)
    for other in others:
        report.warn(local_name(other), link, line_of(other),
                    'is ignored; a geometry has one shape')
    preserved = parent.take_first(f'{SDF_TAG}capsule')  # the writer put a cylinder in its place
    element = required_child(parent, str(first.tag))
    _warn_negative(element, ('size', 'radius', 'length'), link, report)
    geometry = _mesh(element, report, link) if element.tag == 'mesh' else _solid(element)
    return with_capsule(geometry, preserved, report, link)


def _warn_negative(element: TrackedElement, names: Iterable[str], owner: str, report: Report
                   ) -> None:
    for name in names:
        text = element.element.get(name, '')
        with suppress(ValueError):  # readers refuse other texts
            if '-' in text and min(map(float, text.split())) < 0:
                report.warn(element.tag, owner, line_of(element), f'{name}={text!r} is negative')


def _mesh(element: TrackedElement, report: Report, link: str) -> Mesh:
    scale = element.get('scale')
    if scale is not None and len(scale.split()) == 1:
        report.warn('mesh', link, line_of(element),
                    f'scale={scale!r} is one number; it is used for all three axes')
        scale = ' '.join([scale] * 3)
    return Mesh(required_attribute(element, 'filename'),
                None if scale is None else vector(scale, element, 'scale'))


def _solid(element: TrackedElement) -> Geometry:
    solid, sizes = SOLIDS[local_name(element)]
    return solid(*(
        vector(required_attribute(element, name), element, name) if name == 'size'
        else required_number(element, name) for name in sizes))


def read_link(element: TrackedElement, context: UrdfContext) -> Link:
    """Read a link, with what ``<gazebo>`` adds to it."""
    name = required_name(element)
    link_frame = context.link_frame(name)
    inertial = element.find('inertial')
    visuals, collisions = (
        tuple(with_gazebo_color(with_block_colors(replace(
            shape, extension=context.gazebo.with_settings(shape.extension, tag, name)),
            colors, name, context.report))
              for shape in shapes_of(element, tag, link_frame, context.materials, context.report))
        for tag, colors in (('visual', context.gazebo.colors.get(name, {})), ('collision', {})))
    return Link(
        name=name, placement=_link_placement(element, context),
        inertial=None if inertial is None else _inertial(
            inertial, link_frame, context.report, name),
        visuals=visuals, collisions=collisions, line=line_of(element),
        extension=context.extension(element, FrameId('link', name)))


def _link_placement(element: TrackedElement, context: UrdfContext) -> Placement:
    """Return the placement of a link in its parent joint, or of a root link in the model."""
    name = required_name(element)
    parent_joint = context.tree.parent_joint.get(name)
    if parent_joint is None:
        return Placement(preserved_pose(element) or Pose(), MODEL)
    offset = context.offsets.get(name)
    pose = offset.transform().inverse().pose() if offset else Pose()
    return Placement(pose, FrameId('joint', required_name(parent_joint)))


def _inertial(element: TrackedElement, link_frame: FrameId, report: Report, link: str
              ) -> Inertial:
    mass, inertia = required_child(element, 'mass'), element.find('inertia')
    value = required_number(mass, 'value')
    _warn_negative(mass, ('value',), link, report)
    missing = [name for name in INERTIA if inertia is None or name not in inertia]
    if inertia is None:
        report.warn('inertial', link, line_of(element), 'has no <inertia>; its moments are 0')
    elif missing:
        report.warn('inertia', link, line_of(inertia),
                    f'has no {", ".join(f"{name}=" for name in missing)}; missing moments are 0')
    ixx, ixy, ixz, iyy, iyz, izz = (
        0.0 if inertia is None or name in missing else required_number(inertia, name)
        for name in INERTIA)
    return Inertial(Placement(origin_of(element), link_frame), value,
                    (ixx, ixy, ixz, iyy, iyz, izz))


def read_joint(element: TrackedElement, context: UrdfContext) -> Joint:
    """Read a joint with its axes, and with what ``<gazebo>`` adds to it."""
    name, joint_type = required_name(element), element.get('type')
    if joint_type not in URDF_TYPES:
        problem = 'has no type=' if joint_type is None else f'type={joint_type!r} is not supported'
        raise DescriptionError(f'{problem}; give one of {", ".join(URDF_TYPES)}', element)
    is_loop = element.tag != 'joint'
    parent, child = context.tree.ends(element)
    placement = Placement(origin_of(element), context.link_frame(parent))
    if is_loop and (pose := preserved_pose(element)) is not None:
        placement = Placement(pose, FrameId('link', child))
    sdf_type = element.get(f'{SDF_TAG}type', '')
    axes = () if sdf_type else _axes(element, joint_type, context)
    extension = context.extension(element, FrameId('joint', name))
    if sdf_type:
        joint_type = sdf_type
        axes, extension = _sdf_axes(element, sdf_type, extension)
    return Joint(name=name, type=joint_type, parent=parent, child=child, placement=placement,
                 axes=axes, is_loop=is_loop, extension=extension, line=line_of(element))


def _sdf_axes(element: TrackedElement, sdf_type: str, extension: Extension
              ) -> tuple[tuple[Axis, ...], Extension]:
    """Return the axes of a joint that URDF does not have, and its extension without them."""
    if sdf_type not in JOINT_KINDS:
        raise DescriptionError(f'type={sdf_type!r} is not a joint type of SDF', element)
    sdf = TrackedElement(etree.Element('joint') if extension.sdf is None else extension.sdf)
    axes = tuple(axis_from_element(axis) for axis in map(sdf.find, AXES) if axis is not None)
    return axes, Extension(extension.urdf, sdf.unread())


def _axes(element: TrackedElement, joint_type: str, context: UrdfContext) -> tuple[Axis, ...]:
    if joint_type in WITHOUT_AXIS:
        return ()
    axis = element.find('axis')
    xyz = (1.0, 0.0, 0.0)
    if axis is not None and 'xyz' in axis:
        xyz = vector(axis.get('xyz'), axis, 'xyz')
        if not any(xyz):
            raise DescriptionError(
                f'xyz={axis.get("xyz")!r} has no direction; give {joint_type} joint '
                f'{required_name(element)!r} a non-zero axis', axis)
    limit, dynamics = _limit(element, joint_type, context), element.find('dynamics')
    values = None if dynamics is None else Dynamics(*(
        number(dynamics.get(name), dynamics, name) if name in dynamics else None
        for name in ('damping', 'friction')))
    return (Axis(xyz, limit, values, _mimic(element, context)),)


def _limit(element: TrackedElement, joint_type: str, context: UrdfContext) -> Limit | None:
    limit = element.find('limit')
    has_position_limits = joint_type in ('revolute', 'prismatic')
    if limit is None:
        if has_position_limits:
            raise DescriptionError(
                f'a {joint_type} joint requires <limit effort= velocity=>', element)
        return None
    is_required = joint_type != 'planar' and context.version < OPTIONAL_LIMITS
    effort, velocity = (_effort_or_velocity(limit, name, is_required=is_required)
                        for name in ('effort', 'velocity'))
    if context.version >= OPTIONAL_LIMITS:
        for name in NEW_LIMITS:
            number(limit.element.get(name, '0'), limit, name)
        _warn_negative(limit, ('effort', 'velocity', *NEW_LIMITS), required_name(element),
                       context.report)
    if not has_position_limits:
        return Limit(effort=effort, velocity=velocity)
    for name in ('lower', 'upper') if context.version >= OPTIONAL_LIMITS else ():
        if name not in limit:
            raise DescriptionError(f'has no {name}=, which URDF {context.version} requires', limit)
    lower, upper = (limit_number(limit.get(name, '0'), limit, name) for name in ('lower', 'upper'))
    if lower > upper:
        context.report.warn('limit', required_name(element), line_of(limit),
                            f'lower={lower!r} is greater than upper={upper!r}')
    return Limit(lower, upper, effort, velocity)


def _effort_or_velocity(limit: TrackedElement, name: str, *, is_required: bool) -> float:
    if name not in limit and is_required:
        raise DescriptionError(f'has no {name}=, which URDF requires before version '
                               f'{OPTIONAL_LIMITS}', limit)
    value = limit_number(limit.get(name, 'inf'), limit, name)
    return abs(value) if math.isinf(value) else value


def _mimic(element: TrackedElement, context: UrdfContext) -> Mimic | None:
    mimic = element.find('mimic')
    if mimic is None:
        return None
    joint = mimic.element.get('joint', '').strip()
    if not joint:
        raise DescriptionError('has no joint=; name the joint to follow', mimic)
    if joint not in context.tree.joints:
        context.report.warn('mimic', required_name(element), line_of(mimic),
                            f'joint={joint!r} does not exist; the <mimic> is preserved without '
                            'effect')
        return None
    mimic.get('joint')
    return mimic_of_urdf(mimic, joint)


def read_urdf(element: Element, report: Report, *, root_link: str = '') -> Robot:
    """
    Read a robot.

    :param element: the element ``<robot>``.
    :param root_link: root of the tree to read, if the file has several trees.
    :raises DescriptionError: the element is not a valid robot.
    """
    root = TrackedElement(element)
    if root.tag != 'robot':
        raise DescriptionError(f'is not URDF; its root is <{local_name(root)}> instead of <robot>',
                               root)
    name = root.get('name', '').strip()
    if not name:
        name = _DEFAULT_NAME
        report.warn('robot', '', line_of(root), f'has no name; it is named {name!r}')
    context = read_context(root, report, apply_version(element, report))
    tree = context.tree
    canonical = root.get(f'{SDF_TAG}canonical_link', '')
    if canonical and canonical not in tree.links:
        raise DescriptionError(f'canonical_link={canonical!r} is not a link of the robot', root)
    robot = Robot(
        name=name, source=source_of(root),
        links=tuple(read_link(link, context) for link in tree.links.values()),
        joints=tuple(read_joint(joint, context) for joint in tree.joints.values()),
        frames=_frames(root, tree), canonical_link=canonical,
        extension=context.robot_extension(root))
    report_undefined([*((part.extension.urdf, part.name) for part in robot.parts()
                        if part.extension.urdf is not None), *(
        (one, one.get('name', '')) for one in element.iterchildren('material'))],
        _DEFINED, 'URDF', report)
    robot = select_root(robot, root_link, report)
    check_mimic_cycles(robot)
    return robot


def _frames(root: TrackedElement, tree: LinkTree) -> tuple[RobotFrame, ...]:
    elements = root.take_all(f'{SDF_TAG}frame')
    ids = {'': MODEL, MODEL_FRAME: MODEL}
    for kind, names in (('frame', map(required_name, elements)),
                        ('joint', tree.joints), ('link', tree.links)):
        ids.update((name, FrameId(kind, name)) for name in names)

    def lookup(name: str, element: AnyElement) -> FrameId:
        if name not in ids:
            raise DescriptionError(f'{name!r} is not a link, joint or frame of the robot', element)
        return ids[name]

    frames = []
    for element in elements:
        frame = frame_from_element(element, lookup)
        urdf = extract_foreign(element, 'urdf')
        frames.append(replace(frame, extension=Extension(urdf, element.unread())))
    return tuple(frames)
