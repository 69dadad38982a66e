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

"""Random URDF with features of public files from other tools and simulators."""

from __future__ import annotations

from random import Random
import xml.etree.ElementTree as ElementTree

from public_sdf import (
    DRAKE, GZ, limit_range, odd_name, odd_number, plugin_element, sensor_element, some)
from robots import add, axis, Element, pose

_TYPES = ('fixed', 'revolute', 'revolute', 'continuous', 'continuous', 'prismatic', 'floating',
          'planar')


def urdf(random: Random) -> Element:
    """Return a robot in URDF with elements of other tools and simulators."""
    robot = ElementTree.Element('robot', name=random.choice(
        ('my::robot', '__world__', 'made up', 'world')) if some(random, 0.15) else 'made_up')
    if some(random):
        robot.set('version', '1.0')
    if some(random, 0.5):
        add(add(robot, 'material', name=odd_name(random, 'grey')), 'color', rgba='0.2 0.4 0.6 1')
    links = 1 + random.randrange(4)
    for index in range(links):
        _urdf_link(random, add(robot, 'link', name=f'link_{index}'), robot)
    joints: list[str] = []
    for index in range(1, links):
        _urdf_joint(random, robot, index, joints)
    while some(random, 0.5):
        robot.append(_foreign(random))
    while some(random, 0.5):
        block = add(robot, 'gazebo')
        reference = random.choice(('', 'link_0', f'link_{links - 1}', *joints[:1], 'nowhere'))
        if reference:
            block.set('reference', reference)
        block.append(random.choice((plugin_element, _sensor_of_link))(random, ['link_0']))
        add(block, 'material', 'Gazebo/Blue')
        add(block, 'selfCollide', 'true')
    return robot


def _sensor_of_link(random: Random, frames: list[str]) -> Element:
    return sensor_element(random, frames, random.choice(('', 'body', 'link_0_collision')))


def _foreign(random: Random) -> Element:
    """Return elements that URDF does not define, some with names of SDF elements."""
    tag = random.choice(('frame', 'element', 'model', 'pose', 'mimic', 'carried', 'sensor', 'axis',
                         'name', f'{{{DRAKE}}}loop', f'{{{GZ}}}note', 'joint_state'))
    element = ElementTree.Element(tag, name=odd_name(random, 'hand'), link='link_0',
                                  xyz='0 0 -2.1')
    if some(random):
        element.set(f'{{{DRAKE}}}kind', 'a::b')
    if some(random):
        add(element, random.choice(('bar', 'pose', 'element', 'name')), '1 2 3', frame='link_0')
    return element


def _urdf_link(random: Random, link: Element, robot: Element) -> None:
    if some(random, 0.6):
        inertial = add(link, 'inertial')
        _origin(random, inertial)
        add(inertial, 'mass', value=random.choice(('1', '0', '2.5')))
        add(inertial, 'inertia', ixx='0.1', ixy='0', ixz='0', iyy='0.1', iyz='0', izz='0.1')
    for tag in random.choices(('visual', 'collision'), k=random.randrange(4)):
        shape = add(link, tag)
        if some(random, 0.5):
            shape.set('name', odd_name(random, random.choice(('body', 'other'))))
        _origin(random, shape)
        geometry = add(shape, 'geometry')
        kind = random.randrange(3)
        if kind == 0:
            add(geometry, 'box', size='0.1 0.2 0.3')
        elif kind == 1:
            add(geometry, 'sphere', radius='0.7')
        else:
            mesh = add(geometry, 'mesh', filename='package://made_up/meshes/a.stl')
            if some(random):
                mesh.set('scale', '0.001 0.001 -0.001')
        if tag == 'visual' and some(random, 0.6):
            material = add(shape, 'material', name=odd_name(random, f'paint{random.randrange(3)}'))
            if some(random, 0.7):
                add(material, 'color', rgba=random.choice(('0.1 0.2 0.3 1', '1 1 1 0.5')))
        if some(random, 0.1):
            shape.append(_foreign(random))
    while some(random, 0.2):
        link.append(_foreign(random))


def _urdf_joint(random: Random, robot: Element, index: int, joints: list[str]) -> None:
    name = random.choice((f'joint_{index}', f'link_{index}', f'pkg::joint_{index}'))
    kind = random.choice(_TYPES)
    joint = add(robot, 'joint', name=name, type=kind)
    add(joint, 'parent', link=f'link_{random.randrange(index)}')
    add(joint, 'child', link=f'link_{index}')
    _origin(random, joint)
    if kind not in ('fixed', 'floating') or some(random):
        add(joint, 'axis', xyz=axis(random))
    if kind in ('revolute', 'prismatic') or some(random):
        limit = add(joint, 'limit', effort=odd_number(random, 0.05),
                    velocity=odd_number(random, 0.05))
        if some(random, 0.8):
            for key, text in zip(('lower', 'upper'), limit_range(random, 0.05), strict=True):
                limit.set(key, text)
        if some(random):
            limit.set(f'{{{DRAKE}}}acceleration', '2.5')
    if some(random, 0.5):
        dynamics = add(joint, 'dynamics', damping=random.choice(('0', '0.1', '1e9')))
        if some(random, 0.5):
            dynamics.set('friction', '0.1')
    for _ in range(random.choice((0, 0, 1, 2)) if joints else 0):
        add(joint, 'mimic', joint=random.choice(joints), multiplier='-0.5', offset='0.25')
    joints.append(name)
    if some(random, 0.2):
        add(joint, 'safety_controller', k_velocity='10', soft_lower_limit='-0.5')
    while some(random, 0.2):
        joint.append(_foreign(random))


def _origin(random: Random, parent: Element) -> None:
    words = pose(random).split()
    if some(random, 0.8):
        add(parent, 'origin', xyz=' '.join(words[:3]), rpy=' '.join(words[3:]))
