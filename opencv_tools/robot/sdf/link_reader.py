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

"""What a link of SDF consists of: inertials, visuals and collisions, read."""

from __future__ import annotations

from dataclasses import dataclass
import os
from pathlib import Path

from lxml import etree
from opencv_tools.robot.geometry import Box, Capsule, Cylinder, Geometry, Material, Mesh, Sphere
from opencv_tools.robot.model import Extension, FrameId, Inertial, Link, MODEL, Placement, Shape
from opencv_tools.robot.sdf.names import FrameRegistry, JOINTS
from opencv_tools.robot.sdf.scopes import Scope
from opencv_tools.robot.sdf.values import (
    color_of, flag, FRAMES, MATERIAL_COLORS, MODEL_FRAME, pose_of, poses_in, text_of)
from opencv_tools.robot.xml.document import (
    DescriptionError, Element, line_of, local_name, required_name)
from opencv_tools.robot.xml.numbers import number, number_text, vector
from opencv_tools.robot.xml.passthrough import extract_foreign, URDF_NAMESPACE
from opencv_tools.robot.xml.report import Report
from opencv_tools.robot.xml.schema import INERTIA
from opencv_tools.robot.xml.tracked import TrackedElement

_FORMS = ('box', 'sphere', 'cylinder', 'capsule', 'mesh')
_KEPT_CAPSULE = f'{{{URDF_NAMESPACE}}}capsule'


@dataclass(frozen=True)
class Place:
    """
    Where elements are read: in which model, and what names mean there.

    :param folder: of the first file, which relative paths of meshes are relative to.
    """

    scope: Scope
    names: FrameRegistry
    report: Report
    folder: str

    def placement(self, holder: TrackedElement, default: FrameId) -> Placement:
        """
        Read the ``<pose>`` of an element.

        :param default: the frame that it is in where it names none.
        """
        pose = holder.find('pose')
        if pose is None:
            return Placement(pose_of(None), default)
        name, old = pose.get('relative_to', ''), pose.get('frame')
        if old is not None and self.scope.version >= FRAMES:
            self.report.warn('pose', holder.element.get('name', ''), line_of(pose),
                             'frame= means nothing from SDF 1.7 on, where it is relative_to=')
        elif old is not None:
            name = old
        frame = self.names.lookup(self.scope, name, pose, 'relative_to') if name else default
        return Placement(pose_of(pose), frame)

    def carried(self, element: TrackedElement) -> Extension:
        """Return what was not taken of an element."""
        return Extension(urdf=extract_foreign(element, 'urdf'), sdf=self.rest(element))

    def rest(self, element: TrackedElement) -> Element | None:
        """Return what was not taken of an element, in the words of SDF 1.7 and later."""
        rest = element.unread()
        if rest is None:
            return None
        for axis in rest.iterchildren('axis', 'axis2') if element.tag in JOINTS else ():
            if self.scope.version < FRAMES:
                _to_expressed_in(axis)
            xyz = axis.find('xyz')
            if xyz is not None and (name := xyz.get('expressed_in')):
                # Nothing follows it when names of nested models become flat ones.
                xyz.set('expressed_in', self._in_robot(name).replace('::', '__'))
        for pose in poses_in(rest):
            if self.scope.version < FRAMES and 'frame' in pose.attrib:
                pose.set('relative_to', pose.attrib.pop('frame'))
            if name := pose.get('relative_to'):
                pose.set('relative_to', self._in_robot(name))
        return rest

    def uri(self, text: str) -> str:
        """Give the URI of a file as it is right beside the first file."""
        files = self.scope.part.files
        if not text or '://' in text or len(files) == 1 or Path(text).is_absolute():
            return text
        return os.path.relpath(files[-1].parent / text, self.folder)

    def _in_robot(self, name: str) -> str:
        if self.scope.frame == MODEL:
            return name
        return self.scope.frame.name if name == MODEL_FRAME else self.scope.qualified(name)


def _to_expressed_in(axis: Element) -> None:
    """Say by ``expressed_in`` what older versions say by ``use_parent_model_frame``."""
    xyz, old = axis.find('xyz'), axis.find('use_parent_model_frame')
    if old is not None:
        if xyz is not None and flag(old.text, old):
            xyz.set('expressed_in', MODEL_FRAME)
        axis.remove(old)


def read_link(element: TrackedElement, place: Place) -> Link:
    """Read a link."""
    name = place.scope.qualified(required_name(element))
    frame = FrameId('link', name)
    shapes: dict[str, tuple[Shape, ...]] = {}
    for tag in ('visual', 'collision'):
        shapes[tag] = tuple(_shape(child, frame, place) for child in element.take_all(tag))
        _check_names(element, tag, place)
    placement, inertial = place.placement(element, place.scope.frame), element.find('inertial')
    return Link(name, placement, None if inertial is None else _inertial(inertial, frame, place),
                shapes['visual'], shapes['collision'], place.carried(element), line_of(element))


def _check_names(link: TrackedElement, tag: str, place: Place) -> None:
    names = set()
    for child in link.take_all(tag) if place.scope.version >= FRAMES else ():
        name = child.get('name')
        if name in names:
            raise DescriptionError(f'{name!r} is the name of another {tag} of link '
                                   f'{link.get("name")!r} already; give each its own', child)
        names.add(name)


def _inertial(element: TrackedElement, link: FrameId, place: Place) -> Inertial:
    """Read an inertial; what it does not say is as SDF has it by default."""
    moments = element.find('inertia')
    values = [1.0, 0.0, 0.0, 1.0, 0.0, 1.0]
    for index, tag in enumerate(INERTIA):
        if moments is not None and (child := moments.find(tag)) is not None:
            values[index] = number(child.text, child)
    ixx, ixy, ixz, iyy, iyz, izz = values
    mass, pose = element.find('mass'), element.find('pose')
    if pose is not None and (pose.get('relative_to', '') or pose.get('frame', '')):
        place.report.warn('inertial', link.name, line_of(pose), 'its pose is in its link, so that '
                          'what it is relative to means nothing')
    return Inertial(Placement(pose_of(pose), link), 1.0 if mass is None else number(
        mass.text, mass), (ixx, ixy, ixz, iyy, iyz, izz))


def _shape(element: TrackedElement, link: FrameId, place: Place) -> Shape:
    tag = local_name(element)
    look = element.find('material') if tag == 'visual' else None
    geometry, placement = _geometry(element, place), place.placement(element, link)
    material = None if look is None else _material(look, place)
    name, rest = required_name(element), place.carried(element)
    return Shape(name, placement, geometry, material,
                 rest if geometry else _with_geometry(rest, tag), line_of(element))


def _with_geometry(rest: Extension, tag: str) -> Extension:
    """Say what no geometry is, where nothing is said."""
    if rest.sdf is not None and rest.sdf.find('geometry') is not None:
        return rest
    element = etree.Element(tag) if rest.sdf is None else rest.sdf
    etree.SubElement(etree.SubElement(element, 'geometry'), 'empty')
    return Extension(rest.urdf, element)


def _geometry(shape: TrackedElement, place: Place) -> Geometry | None:
    element = shape.find('geometry')
    if element is None:
        place.report.warn(local_name(shape), required_name(shape), line_of(shape),
                          'has no <geometry>')
        return None
    capsule = element.take_first(_KEPT_CAPSULE)
    if capsule is not None:
        element.take_first('cylinder')  # which stands for it
        return Capsule(number(capsule.get('radius'), capsule, 'radius'),
                       number(capsule.get('length'), capsule, 'length'))
    forms = list(element.element.iterchildren(*_FORMS))
    for other in forms[1:]:
        place.report.warn(local_name(other), required_name(shape), line_of(other),
                          'is not read, a geometry is one shape')
    form = element.find(str(forms[0].tag)) if forms else None
    return _shape_geometry(form, place) if form else None


def _shape_geometry(element: TrackedElement, place: Place) -> Geometry:
    tag = local_name(element)
    if tag == 'mesh':
        uri, scale = text_of(element, 'uri'), element.find('scale')
        if not uri and place.scope.version < (1, 4):
            uri = text_of(element, 'filename')  # as the oldest versions had it
        if not uri:
            raise DescriptionError('has no <uri>', element)
        return Mesh(place.uri(uri), None if scale is None else vector(scale.text, scale))
    if tag == 'box':
        size = element.find('size')
        if size is None:
            _warn_of_default(element, 'size', '1 1 1', place)
        return Box((1.0, 1.0, 1.0) if size is None else vector(size.text, size))
    radius = _length(element, 'radius', 0.5 if tag == 'capsule' else 1.0, place)
    if tag == 'sphere':
        return Sphere(radius)
    form = Cylinder if tag == 'cylinder' else Capsule
    return form(radius, _length(element, 'length', 1.0, place))


def _length(element: TrackedElement, tag: str, default: float, place: Place) -> float:
    child = element.find(tag)
    if child is None:
        _warn_of_default(element, tag, number_text(default), place)
    return default if child is None else number(child.text, child)


def _warn_of_default(element: TrackedElement, tag: str, default: str, place: Place) -> None:
    place.report.warn(element.tag, '', line_of(element),
                      f'has no <{tag}>; it is {default}, as SDF has it')


def _material(element: TrackedElement, place: Place) -> Material:
    colors = {field: color_of(child) for tag, field in MATERIAL_COLORS.items()
              if (child := element.find(tag)) is not None}
    kept = element.take_first(f'{{{URDF_NAMESPACE}}}texture')
    pbr = element.find('pbr')
    metal = pbr.find('metal') if pbr else None
    texture = place.uri(text_of(metal, 'albedo_map')) if metal else ''
    return Material(element.get(f'{{{URDF_NAMESPACE}}}name', ''),
                    texture=texture if kept is None else kept.get('filename', ''), **colors)
