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

"""What a link of SDF consists of: inertials, visuals and collisions, written."""

from __future__ import annotations

from lxml import etree
from opencv_tools.robot.geometry import Box, Capsule, Cylinder, Geometry, Material, Mesh, Sphere
from opencv_tools.robot.model import Inertial, Shape
from opencv_tools.robot.pose import Pose
from opencv_tools.robot.sdf.values import (
    CAPSULE, MATERIAL_COLORS, PBR, pose_element, text_element, Version, version_text)
from opencv_tools.robot.xml.document import Element
from opencv_tools.robot.xml.numbers import number_text, numbers_text
from opencv_tools.robot.xml.passthrough import embed_foreign, merge_unread, URDF_NAMESPACE
from opencv_tools.robot.xml.report import Report
from opencv_tools.robot.xml.schema import INERTIA


def inertial_element(link: Element, inertial: Inertial, pose: Pose) -> None:
    """
    Write an ``<inertial>`` into a link.

    :param pose: where it is in the link.
    """
    element = etree.SubElement(link, 'inertial')
    pose_element(element, pose)
    text_element(element, 'mass', number_text(inertial.mass))
    moments = etree.SubElement(element, 'inertia')
    for tag, value in zip(INERTIA, inertial.inertia):
        text_element(moments, tag, number_text(value))


def shape_element(link: Element, tag: str, shape: Shape, pose: Pose, version: Version,
                  report: Report) -> None:
    """
    Write a visual or a collision into a link.

    :param tag: ``visual`` or ``collision``.
    :param pose: where it is in the link.
    """
    element = etree.SubElement(link, tag, name=shape.name)
    pose_element(element, pose)
    _geometry_element(element, shape, version, report)
    if shape.material is not None:
        _material_element(element, shape, shape.material, version, report)
    merge_unread(element, shape.extension.sdf)
    embed_foreign(element, shape.extension.urdf, 'urdf', report, shape.name, shape.line)


def _geometry_element(element: Element, shape: Shape, version: Version, report: Report) -> None:
    geometry = shape.geometry
    rest = shape.extension.sdf
    if geometry is None and rest is not None and rest.find('geometry') is not None:
        return  # it is put back with all else that is carried
    parent = etree.SubElement(element, 'geometry')
    if geometry is None:
        etree.SubElement(parent, 'empty')
    elif isinstance(geometry, Capsule) and version < CAPSULE:
        kept = etree.SubElement(parent, f'{{{URDF_NAMESPACE}}}capsule')
        kept.set('radius', number_text(geometry.radius))
        kept.set('length', number_text(geometry.length))
        length = geometry.length + 2 * geometry.radius
        _plain_geometry(parent, Cylinder(geometry.radius, length))
        report.warn('capsule', shape.name, shape.line,
                    f'SDF {version_text(version)} has no capsules; a cylinder of the same length '
                    'stands there, and the capsule is kept as <urdf:capsule>')
    else:
        _plain_geometry(parent, geometry)


def _plain_geometry(parent: Element, geometry: Geometry) -> None:
    element = etree.SubElement(parent, type(geometry).__name__.lower())
    if isinstance(geometry, Box):
        text_element(element, 'size', numbers_text(geometry.size))
    elif isinstance(geometry, Mesh):
        text_element(element, 'uri', geometry.uri)
        if geometry.scale is not None:
            text_element(element, 'scale', numbers_text(geometry.scale))
    else:
        text_element(element, 'radius', number_text(geometry.radius))
        if not isinstance(geometry, Sphere):
            text_element(element, 'length', number_text(geometry.length))


def _material_element(element: Element, shape: Shape, material: Material, version: Version,
                      report: Report) -> None:
    target = etree.SubElement(element, 'material')
    if material.name:
        target.set(f'{{{URDF_NAMESPACE}}}name', material.name)
    for tag, field in MATERIAL_COLORS.items():
        color = getattr(material, field)
        if color is not None:
            text_element(target, tag, numbers_text(color))
    if material.texture and version >= PBR:
        metal = etree.SubElement(etree.SubElement(target, 'pbr'), 'metal')
        text_element(metal, 'albedo_map', material.texture)
    elif material.texture:
        kept = etree.SubElement(target, f'{{{URDF_NAMESPACE}}}texture')
        kept.set('filename', material.texture)
        report.preserve('texture', shape.name, shape.line,
                     f'SDF {version_text(version)} has no <pbr>; kept as <urdf:texture>')
