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

"""Inertials, visuals and collisions of links, written as URDF."""

from __future__ import annotations

from lxml import etree
from opencv_tools.robot.geometry import Box, Geometry, Mesh, Sphere
from opencv_tools.robot.model import INERTIA, Inertial, Link, Shape
from opencv_tools.robot.pose import Pose
from opencv_tools.robot.urdf.materials import material_element, MaterialNames, with_lights
from opencv_tools.robot.xml.document import Element, local_name
from opencv_tools.robot.xml.numbers import number_text, numbers_text
from opencv_tools.robot.xml.passthrough import embed_foreign, merge_unread, SDF_NAMESPACE
from opencv_tools.robot.xml.report import Report


def origin_element(parent: Element, pose: Pose) -> None:
    """Write ``<origin>``, unless it is the identity."""
    if not pose.is_identity:
        etree.SubElement(parent, 'origin', xyz=numbers_text(pose.xyz), rpy=numbers_text(pose.rpy))


def inertial_element(parent: Element, inertial: Inertial, pose: Pose) -> None:
    """Write ``<inertial>``."""
    element = etree.SubElement(parent, 'inertial')
    origin_element(element, pose)
    etree.SubElement(element, 'mass', value=number_text(inertial.mass))
    etree.SubElement(element, 'inertia', dict(zip(INERTIA, map(number_text, inertial.inertia))))


def shape_element(parent: Element, tag: str, shape: Shape, pose: Pose, link: Link,
                  materials: MaterialNames, report: Report) -> None:
    """
    Write a visual or a collision. A shape without a geometry of URDF is preserved.

    :param tag: ``visual`` or ``collision``.
    :param pose: the pose in the frame of the link in URDF.
    """
    name = shape.name or link.name
    element = etree.SubElement(parent, tag if shape.geometry else f'{{{SDF_NAMESPACE}}}{tag}',
                               {'name': shape.name} if shape.name else {})
    origin_element(element, pose)
    if shape.geometry:
        _geometry_element(element, shape.geometry)
    else:
        report.warn(tag, name, shape.line, f'{_missing_geometry(shape)}; preserved as '
                    f'<sdf:{tag}> for the conversion back')
    sdf = shape.extension.sdf
    if shape.material:
        material_element(element, shape.material, shape, link, materials, report)
        sdf = with_lights(sdf, shape.material)
    merge_unread(element, shape.extension.urdf)
    embed_foreign(element, sdf, 'sdf', report, name, shape.line)


def _missing_geometry(shape: Shape) -> str:
    """Return why a shape has no geometry of URDF."""
    unread = shape.extension.sdf
    geometry = None if unread is None else unread.find('geometry')
    if geometry is None or not len(geometry):
        return 'has no geometry, which URDF requires'
    return f'<{local_name(geometry[0])}> is not supported by URDF'


def _geometry_element(parent: Element, geometry: Geometry) -> None:
    element = etree.SubElement(etree.SubElement(parent, 'geometry'),
                               type(geometry).__name__.lower())
    if isinstance(geometry, Box):
        element.set('size', numbers_text(geometry.size))
    elif isinstance(geometry, Mesh):
        element.set('filename', geometry.uri)
        if geometry.scale is not None:
            element.set('scale', numbers_text(geometry.scale))
    else:
        element.set('radius', number_text(geometry.radius))
        if not isinstance(geometry, Sphere):
            element.set('length', number_text(geometry.length))
