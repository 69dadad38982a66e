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

"""Reader of URDF links, their visuals and their collisions."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import replace

from opencv_tools.robot.geometry import Box, Capsule, Cylinder, Geometry, Mesh, Sphere
from opencv_tools.robot.model import (
    Extension, FrameId, INERTIA, Inertial, Link, MODEL, Placement, Shape)
from opencv_tools.robot.pose import Pose
from opencv_tools.robot.urdf.context import UrdfContext
from opencv_tools.robot.urdf.materials import MaterialTable, visual_material
from opencv_tools.robot.urdf.poses import origin_of, preserved_pose
from opencv_tools.robot.xml.document import (
    Element, line_of, local_name, required_attribute, required_child, required_name,
    TrackedElement)
from opencv_tools.robot.xml.numbers import required_number, vector
from opencv_tools.robot.xml.passthrough import extract_foreign, SDF_TAG
from opencv_tools.robot.xml.report import Report


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
    if tag not in _GEOMETRIES:
        return f'<{tag}> is not a geometry of URDF; write one of {_GEOMETRY_TAGS}'
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


def _geometry(shape: TrackedElement, report: Report, link: str) -> Geometry:
    parent = required_child(shape, 'geometry')
    first, *others = _geometry_children(parent.element)
    for other in others:
        report.warn(local_name(other), link, line_of(other),
                    'is ignored; a geometry has one shape')
    element = required_child(parent, str(first.tag))
    for name in ('size', 'radius', 'length'):
        text = element.element.get(name, '')
        if '-' in text:
            with suppress(ValueError):  # _GEOMETRIES refuses other texts
                if min(map(float, text.split())) < 0:
                    report.warn(element.tag, link, line_of(element),
                                f'{name}={text!r} is negative')
    scale = element.element.get('scale', '')
    if element.tag == 'mesh' and len(scale.split()) == 1:
        report.warn('mesh', link, line_of(element),
                    f'scale={scale!r} is one number; it is used for all three axes')
    return _GEOMETRIES[element.tag](element)


def _mesh(element: TrackedElement) -> Mesh:
    scale = element.get('scale')
    if scale is not None and len(scale.split()) == 1:
        scale = ' '.join([scale] * 3)
    return Mesh(required_attribute(element, 'filename'),
                None if scale is None else vector(scale, element, 'scale'))


def _radius_and_length(element: TrackedElement) -> tuple[float, float]:
    return required_number(element, 'radius'), required_number(element, 'length')


_GEOMETRIES: Mapping[str, Callable[[TrackedElement], Geometry]] = {
    'box': lambda element: Box(vector(required_attribute(element, 'size'), element, 'size')),
    'sphere': lambda element: Sphere(required_number(element, 'radius')),
    'cylinder': lambda element: Cylinder(*_radius_and_length(element)),
    'capsule': lambda element: Capsule(*_radius_and_length(element)),
    'mesh': _mesh,
}
_GEOMETRY_TAGS = ', '.join(f'<{tag}>' for tag in _GEOMETRIES)


def read_link(element: TrackedElement, context: UrdfContext) -> Link:
    """Read a link, with what ``<gazebo>`` adds to it."""
    name = required_name(element)
    link_frame = context.link_frame(name)
    inertial = element.find('inertial')
    visuals, collisions = (shapes_of(element, tag, link_frame, context.materials, context.report)
                           for tag in ('visual', 'collision'))
    collisions = tuple(replace(shape, extension=context.gazebo.with_settings(
        shape.extension, 'collision', name)) for shape in collisions)
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
    if value < 0:
        report.warn('mass', link, line_of(mass), f'value={mass.get("value")!r} is negative')
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
