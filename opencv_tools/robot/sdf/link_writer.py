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

"""Writer of SDF links: inertials, visuals, collisions, and the context in which all is written."""

from __future__ import annotations

from dataclasses import dataclass

from lxml import etree
from opencv_tools.robot.geometry import Box, Capsule, Cylinder, Geometry, Mesh, Sphere
from opencv_tools.robot.kinematics import Kinematics
from opencv_tools.robot.model import Frame, FrameId, INERTIA, Joint, Link, MODEL, Shape, WORLD
from opencv_tools.robot.sdf.values import (
    CAPSULE, MATERIAL_COLORS, number_element, PBR, pose_element, text_element, Version)
from opencv_tools.robot.xml.document import Element
from opencv_tools.robot.xml.numbers import number_text, numbers_text
from opencv_tools.robot.xml.passthrough import embed_foreign, merge_unread, URDF_NAMESPACE
from opencv_tools.robot.xml.report import Report


@dataclass(frozen=True)
class WriteContext:
    """
    The output of a robot.

    :param relative: whether each link is placed relative to its parent link.
    """

    kinematics: Kinematics
    version: Version
    relative: bool
    report: Report

    def write_extension(self, element: Element, written: Frame | Joint | Link | Shape) -> None:
        """Write what the model does not represent: merge SDF, and embed URDF."""
        merge_unread(element, written.extension.sdf)
        embed_foreign(element, written.extension.urdf, 'urdf', self.report, written.name,
                      written.line)


def write_link(model: Element, link: Link, context: WriteContext) -> None:
    """Write a link into a model."""
    element = etree.SubElement(model, 'link', name=link.name)
    frame, kinematics = FrameId('link', link.name), context.kinematics
    joint = kinematics.parent_joint.get(link.name) if context.relative else None
    base = FrameId('link', joint.parent) if joint and joint.parent != WORLD else MODEL
    pose_element(element, kinematics.between(base, frame), base.name)
    if link.inertial is not None:
        inertial = etree.SubElement(element, 'inertial')
        pose_element(inertial, kinematics.within(frame, link.inertial.placement))
        number_element(inertial, 'mass', link.inertial.mass)
        moments = etree.SubElement(inertial, 'inertia')
        for tag, value in zip(INERTIA, link.inertial.inertia):
            number_element(moments, tag, value)
    for tag, shapes in (('collision', link.collisions), ('visual', link.visuals)):
        for shape in shapes:
            child = etree.SubElement(element, tag, name=shape.name)
            pose_element(child, kinematics.within(frame, shape.placement))
            _write_geometry(child, shape, context)
            _write_material(child, shape, context)
            context.write_extension(child, shape)
    context.write_extension(element, link)


def _write_geometry(element: Element, shape: Shape, context: WriteContext) -> None:
    geometry, unread = shape.geometry, shape.extension.sdf
    if geometry is None and unread is not None and unread.find('geometry') is not None:
        return  # it is a part of the extension
    parent = etree.SubElement(element, 'geometry')
    if geometry is None:
        etree.SubElement(parent, 'empty')
    elif isinstance(geometry, Capsule) and context.version < CAPSULE:
        capsule = etree.SubElement(parent, f'{{{URDF_NAMESPACE}}}capsule')
        capsule.set('radius', number_text(geometry.radius))
        capsule.set('length', number_text(geometry.length))
        length = geometry.length + 2 * geometry.radius
        _write_supported_geometry(parent, Cylinder(geometry.radius, length))
        context.report.warn('capsule', shape.name, shape.line,
                            f'not supported by SDF {context.version}; written as a cylinder of '
                            'the same length, and preserved as <urdf:capsule>')
    else:
        _write_supported_geometry(parent, geometry)


def _write_supported_geometry(parent: Element, geometry: Geometry) -> None:
    element = etree.SubElement(parent, type(geometry).__name__.lower())
    if isinstance(geometry, Box):
        text_element(element, 'size', numbers_text(geometry.size))
    elif isinstance(geometry, Mesh):
        text_element(element, 'uri', geometry.uri)
        if geometry.scale is not None:
            text_element(element, 'scale', numbers_text(geometry.scale))
    else:
        number_element(element, 'radius', geometry.radius)
        if not isinstance(geometry, Sphere):
            number_element(element, 'length', geometry.length)


def _write_material(visual: Element, shape: Shape, context: WriteContext) -> None:
    material = shape.material
    if material is None:
        return
    element = etree.SubElement(visual, 'material')
    if material.name:
        element.set(f'{{{URDF_NAMESPACE}}}name', material.name)
    for tag, field in MATERIAL_COLORS.items():
        color = getattr(material, field)
        if color is not None:
            text_element(element, tag, numbers_text(color))
    if material.texture and context.version >= PBR:
        metal = etree.SubElement(etree.SubElement(element, 'pbr'), 'metal')
        text_element(metal, 'albedo_map', material.texture)
    elif material.texture:
        etree.SubElement(element, f'{{{URDF_NAMESPACE}}}texture', filename=material.texture)
        context.report.preserve('texture', shape.name, shape.line, 'not supported by SDF '
                                f'{context.version}; preserved as <urdf:texture>')
