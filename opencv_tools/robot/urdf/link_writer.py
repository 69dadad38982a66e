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

"""Mass, geometry and looks of links as URDF."""

from __future__ import annotations

from dataclasses import dataclass, field

from lxml import etree
from opencv_tools.robot.geometry import (
    Box, Capsule, Color, Cylinder, Geometry, LIGHT_COLORS, Material, Sphere)
from opencv_tools.robot.model import Inertial, Link, Robot, Shape
from opencv_tools.robot.pose import Pose
from opencv_tools.robot.urdf.link_reader import material_name, read_material, with_default_lights
from opencv_tools.robot.xml.document import Element, local_name
from opencv_tools.robot.xml.numbers import number_text, numbers_text
from opencv_tools.robot.xml.passthrough import embed_foreign, merge_unread, SDF_NAMESPACE
from opencv_tools.robot.xml.report import Report
from opencv_tools.robot.xml.schema import INERTIA
from opencv_tools.robot.xml.tracked import PARTLY_READ, TrackedElement

_Look = tuple[Color | None, str]


@dataclass
class Materials:
    """
    The names that materials have in the file, each for one look.

    :param looks: colour and texture by name, as they come to be written.
    :param wanted: the names that materials have already.
    """

    looks: dict[str, _Look] = field(default_factory=dict)
    wanted: set[str] = field(default_factory=set)

    @staticmethod
    def of(robot: Robot) -> Materials:
        """Collect the names of a robot, and what it says of them outside its links."""
        shapes = (shape for link in robot.links for shape in link.visuals)
        names = {shape.material.name for shape in shapes if shape.material}
        kept = robot.extension.urdf
        shared = [] if kept is None else [read_material(TrackedElement(part), Report())
                                          for part in kept.iterfind('material')]
        looks = {look.name: (look.color, look.texture) for look in reversed(shared) if look.name}
        return Materials(looks, {*names, *looks})

    def name_for(self, material: Material, link: Link, shape: Shape, report: Report) -> str:
        """Give a name that no other look has."""
        look = (material.color, material.texture)
        if material.name and self.looks.setdefault(material.name, look) == look:
            return material.name
        base = name = material_name(link.name, shape.name)
        count = 0
        while self.looks.get(name, look) != look or name in self.wanted:
            count += 1
            name = f'{base}_{count}'
        self.looks[name] = look
        self.wanted.add(name)
        if material.name:
            report.warn('material', material.name, shape.line, 'has another colour or texture '
                        f'elsewhere, and URDF one for each name; it is called {name!r} here')
        return name


def origin_element(parent: Element, pose: Pose) -> None:
    """Write ``<origin>`` where it moves anything."""
    if not pose.is_identity:
        etree.SubElement(parent, 'origin', xyz=numbers_text(pose.xyz), rpy=numbers_text(pose.rpy))


def inertial_element(parent: Element, inertial: Inertial, pose: Pose) -> None:
    """Write ``<inertial>``."""
    element = etree.SubElement(parent, 'inertial')
    origin_element(element, pose)
    etree.SubElement(element, 'mass', value=number_text(inertial.mass))
    etree.SubElement(element, 'inertia', dict(zip(INERTIA, map(number_text, inertial.inertia))))


def shape_element(parent: Element, tag: str, shape: Shape, pose: Pose, link: Link,
                  materials: Materials, report: Report) -> None:
    """
    Write a visual or a collision, or keep it for the way back where URDF has no such geometry.

    :param tag: ``visual`` or ``collision``.
    :param pose: where it is in the frame that URDF means by the link.
    """
    written = tag if shape.geometry else f'{{{SDF_NAMESPACE}}}{tag}'
    element = etree.SubElement(parent, written, {'name': shape.name} if shape.name else {})
    name = shape.name or link.name
    origin_element(element, pose)
    if shape.geometry:
        _geometry_element(element, shape.geometry)
    else:
        report.warn(tag, name, shape.line, f'{_missing_geometry(shape)}; kept as <sdf:{tag}>, '
                    'which only '
                    'the way back reads')
    rest = shape.extension.sdf
    if shape.material:
        _material_element(element, shape.material, shape, link, materials, report)
        rest = _with_lights(shape.material, rest)
    merge_unread(element, shape.extension.urdf)
    embed_foreign(element, rest, 'sdf', report, name, shape.line)


def _missing_geometry(shape: Shape) -> str:
    """Say what of a geometry URDF has no word for."""
    rest = shape.extension.sdf
    geometry = None if rest is None else rest.find('geometry')
    if geometry is None or not len(geometry):
        return 'has no geometry, which URDF demands'
    return f'URDF has no <{local_name(geometry[0])}>'


def _geometry_element(parent: Element, geometry: Geometry) -> None:
    element = etree.SubElement(parent, 'geometry')
    if isinstance(geometry, Box):
        etree.SubElement(element, 'box', size=numbers_text(geometry.size))
    elif isinstance(geometry, Sphere):
        etree.SubElement(element, 'sphere', radius=number_text(geometry.radius))
    elif isinstance(geometry, (Cylinder, Capsule)):
        etree.SubElement(element, 'cylinder' if isinstance(geometry, Cylinder) else 'capsule',
                         radius=number_text(geometry.radius), length=number_text(geometry.length))
    else:
        mesh = etree.SubElement(element, 'mesh', filename=geometry.uri)
        if geometry.scale is not None:
            mesh.set('scale', numbers_text(geometry.scale))


def _material_element(parent: Element, material: Material, shape: Shape, link: Link,
                      materials: Materials, report: Report) -> None:
    if not material.name and not material.color and not material.texture:
        return  # there is nothing that URDF could say
    name = materials.name_for(material, link, shape, report)
    element = etree.SubElement(parent, 'material', name=name)
    if material.color:
        etree.SubElement(element, 'color', rgba=numbers_text(material.color))
    if material.texture:
        etree.SubElement(element, 'texture', filename=material.texture)


def _with_lights(material: Material, rest: Element | None) -> Element | None:
    """Add to what is carried of a visual the lights that do not follow from the colour."""
    has_more = rest is not None and rest.find('material') is not None
    has_word = material.name or material.color or material.texture
    if has_word and not has_more and material == with_default_lights(material):
        return rest
    holder = etree.Element('visual')
    element = etree.SubElement(holder, 'material', {PARTLY_READ: 'true'})
    for tag in LIGHT_COLORS:
        color: Color | None = getattr(material, tag)
        if color:
            etree.SubElement(element, tag).text = numbers_text(color)
    merge_unread(holder, rest, marked=True)
    return holder
