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

"""Reader of SDF links: inertials, visuals and collisions."""

from __future__ import annotations

from lxml import etree
from opencv_tools.robot.geometry import GEOMETRIES, Geometry, Material, Mesh, SOLIDS
from opencv_tools.robot.model import Extension, FrameId, INERTIA, Inertial, Link, Placement, Shape
from opencv_tools.robot.sdf.context import SdfContext
from opencv_tools.robot.sdf.fragments import with_capsule
from opencv_tools.robot.sdf.values import (
    colors_of, DEFAULT_INERTIAL, flag, FRAMES, number_of, pose_of, text_of, with_gazebo_color)
from opencv_tools.robot.xml.document import (
    DescriptionError, line_of, local_name, required_name, TrackedElement)
from opencv_tools.robot.xml.numbers import numbers, vector
from opencv_tools.robot.xml.passthrough import URDF_TAG


def read_link(element: TrackedElement, context: SdfContext) -> Link:
    """Read a link."""
    name = context.scope.qualified(required_name(element))
    frame = FrameId('link', name)
    shapes: dict[str, tuple[Shape, ...]] = {}
    for tag in ('visual', 'collision'):
        shapes[tag] = tuple(_read_shape(child, frame, context) for child in element.take_all(tag))
        if context.scope.file.version >= FRAMES:
            _check_unique_names(element, tag)
    placement, inertial = context.placement(element, context.scope.frame), element.find('inertial')
    return Link(
        name=name, placement=placement, visuals=shapes['visual'], collisions=shapes['collision'],
        inertial=None if inertial is None else _read_inertial(inertial, frame, context),
        extension=context.extension(element), default_mass=DEFAULT_INERTIAL[0],
        line=line_of(element))


def _check_unique_names(link: TrackedElement, tag: str) -> None:
    names = set()
    for child in link.take_all(tag):
        name = child.get('name')
        if name in names:
            raise DescriptionError(f'{name!r} is already the name of another {tag} of link '
                                   f'{link.get("name")!r}; use unique names', child)
        names.add(name)


def _read_inertial(element: TrackedElement, link: FrameId, context: SdfContext) -> Inertial:
    """Read an inertial, with the defaults of SDF; `inertia.auto_inertial` replaces it later."""
    if flag(element.element.get('auto'), element, 'auto'):
        for ignored in element.take_all('pose', 'inertia'):
            context.report.warn(ignored.tag, link.name, line_of(ignored),
                                'is ignored: auto="true" computes it from the collisions')
        element.find('mass')  # without its text, which stays among what is unread
        return Inertial(Placement(pose_of(None), link), *DEFAULT_INERTIAL)
    inertia = element.find('inertia')
    default_mass, default_moments = DEFAULT_INERTIAL
    ixx, ixy, ixz, iyy, iyz, izz = default_moments if inertia is None else (
        number_of(inertia, tag, default) for tag, default in zip(INERTIA, default_moments))
    pose = element.find('pose')
    if pose is not None and (pose.get('relative_to', '') or pose.get('frame', '')):
        context.report.warn('inertial', link.name, line_of(pose),
                            'relative_to= is ignored; the pose is relative to the link')
    return Inertial(Placement(pose_of(pose), link), number_of(element, 'mass', default_mass),
                    (ixx, ixy, ixz, iyy, iyz, izz))


def _read_shape(element: TrackedElement, link: FrameId, context: SdfContext) -> Shape:
    tag = local_name(element)
    material = element.find('material') if tag == 'visual' else None
    geometry, placement = _read_geometry(element, context), context.placement(element, link)
    return with_gazebo_color(Shape(
        name=required_name(element), placement=placement, geometry=geometry,
        material=None if material is None else _read_material(material, context),
        extension=_shape_extension(element, geometry, context), line=line_of(element)))


def _shape_extension(element: TrackedElement, geometry: Geometry | None, context: SdfContext
                     ) -> Extension:
    """Return the unread parts of a shape, with ``<empty/>`` in place of a missing geometry."""
    extension = context.extension(element)
    if geometry or extension.find_sdf('geometry') is not None:
        return extension
    unread = etree.Element(local_name(element)) if extension.sdf is None else extension.sdf
    etree.SubElement(etree.SubElement(unread, 'geometry'), 'empty')
    return Extension(extension.urdf, unread)


def _read_geometry(shape: TrackedElement, context: SdfContext) -> Geometry | None:
    element = shape.find('geometry')
    if element is None:
        context.report.warn(local_name(shape), required_name(shape), line_of(shape),
                            'has no <geometry>')
        return None
    preserved = element.take_first(f'{URDF_TAG}capsule')  # the writer put a cylinder in its place
    children = list(element.element.iterchildren(*GEOMETRIES))
    for ignored in children[1:]:
        context.report.warn(local_name(ignored), required_name(shape), line_of(ignored),
                            'ignored: only the first shape of a <geometry> is read')
    child = element.find(str(children[0].tag)) if children else None
    geometry = _read_known_geometry(child, context) if child else None
    return with_capsule(geometry, preserved, context.report, required_name(shape))


def _read_known_geometry(element: TrackedElement, context: SdfContext) -> Geometry:
    tag = local_name(element)
    if tag == 'mesh':
        uri, scale = text_of(element, 'uri'), element.find('scale')
        if not uri and context.scope.file.version < (1, 4):
            uri = text_of(element, 'filename')  # its name in SDF 1.2 and 1.3
        if not uri:
            raise DescriptionError('has no <uri>', element)
        return Mesh(context.resolved_uri(uri),
                    None if scale is None else vector(scale.text, scale))
    solid, sizes = SOLIDS[tag]
    return solid(*(_read_size(element, name, default, context)
                   for name, default in sizes.items()))


def _read_size(element: TrackedElement, tag: str, default: str, context: SdfContext
               ) -> float | tuple[float, ...]:
    child = element.find(tag)
    if child is None:
        context.report.warn(element.tag, '', line_of(element),
                            f'has no <{tag}>; the default of SDF is {default}')
    text, holder = (default, element) if child is None else (child.text, child)
    found = numbers(text, len(default.split()), holder)
    return found if len(found) > 1 else found[0]


def _read_material(element: TrackedElement, context: SdfContext) -> Material:
    pbr = element.find('pbr')
    metal = pbr.find('metal') if pbr else None
    uri = context.resolved_uri(text_of(metal, 'albedo_map')) if metal else ''
    return Material(name=element.get(f'{URDF_TAG}name', ''), texture=uri,
                    **colors_of(element))
