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

"""Random robots, and a check that a conversion has linear cost."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
import math
from random import Random
import sys
from types import FrameType
import xml.etree.ElementTree as ElementTree

Element = ElementTree.Element
_COLORS = ('0.1 0.2 0.3 1', '0.9 0.9 0.9 0.5', '1 1 1 1', '0.123456789012345 0 1 1')
# Parts of a link of SDF, with what is said of those that its parser refuses.
PARTS_OF_SDF = (
    ('<sensor name="s" type="imu"><update_rate>x</update_rate></sensor>', "'x' is not a number"),
    ('<sensor name="s" type="imu"><update_rate>1e400</update_rate></sensor>', 'not a number'),
    ('<sensor name="s" type="imu"><update_rate>30 Hz</update_rate></sensor>', ''),
    ('<sensor name="s" type="imu"><update_rate>0x10</update_rate></sensor>', ''),
    (f'<sensor name="s" type="imu"><update_rate>0x{"f" * 300}</update_rate></sensor>',
     'not a number'),
    ('<sensor name="s" type="imu"><update_rate/></sensor>', ''),
    ('<sensor name="s" type="imu"><update_rate>inf</update_rate></sensor>', ''),
    ('<sensor name="s" type="imu"><always_on>yes</always_on></sensor>', 'true or false'),
    ('<sensor name="s" type="imu"><always_on>TRUE</always_on></sensor>', ''),
    ('<sensor name="s" type="imu"><pose>1 2 3 4 5 nan</pose></sensor>', '6 finite numbers'),
    ('<sensor name="s" type="imu"><pose rotation_format="quat_xyzw">0 0 0 0 0 1</pose></sensor>',
     '7 finite numbers'),
    ('<sensor name="s" type="imu"><pose rotation_format="quat_xyzw">0 0 0 0 0 0 1</pose>'
     '</sensor>', ''),
    ('<sensor name="s" type="camera"><camera><clip><far>0</far></clip></camera></sensor>',
     "'0' is outside of 0.1"),
    ('<sensor name="s" type="nose"/>', "type='nose'"),
    ('<sensor name="s"/>', 'has no type='),
    ('<sensor type="imu"/>', 'has no name='),
    ('<sensor name="s" type="imu"><plugin name="p" filename="f"><update_rate>x</update_rate>'
     '</plugin></sensor>', ''),
    ('<light name="l" type="spot"><direction>1 2</direction></light>', '3 numbers'),
    ('<light name="l" type="spot"><direction>1 2 3 4</direction></light>', ''),
    ('<light name="l" type="lamp"/>', "type='lamp'"),
    ('<light name="l" type="point"><diffuse>1 1</diffuse></light>', '3 or 4 numbers'),
    ('<light name="l" type="point"><diffuse>red</diffuse></light>', '3 or 4 numbers'),
    ('<light name="l" type="point"><diffuse>1 0 0</diffuse></light>', ''),
    ('<gravity>maybe</gravity>', 'true or false'),
    ('<battery/>', 'has no name='),
)
_URDF_TYPES = ('fixed', 'revolute', 'continuous', 'prismatic', 'floating', 'planar')
_SDF_TYPES = ('fixed', 'revolute', 'continuous', 'prismatic', 'ball', 'universal', 'revolute2',
              'screw', 'gearbox')


def add(parent: Element, tag: str, text: str = '', **attributes: str) -> Element:
    """Add a child."""
    child = ElementTree.SubElement(parent, tag, attributes)
    child.text = text
    return child


def number(random: Random) -> float:
    """Return a random number: round, arbitrary or zero."""
    return random.choice((0.0, 0.5, -0.25, 1e-7, random.uniform(-2, 2), random.uniform(-2, 2)))


def angle(random: Random) -> float:
    """Return a random angle, often one of a gimbal lock."""
    right = math.pi / 2
    return random.choice((0.0, right, -right, 1.5708, right - 1e-9, -right + 1e-12, math.pi,
                          random.uniform(-4, 4), random.uniform(-4, 4)))


def pose(random: Random) -> str:
    """Return six random numbers of a pose."""
    return ' '.join([*(repr(number(random)) for _ in range(3)),
                     *(repr(angle(random)) for _ in range(3))])


def axis(random: Random) -> str:
    """Return a random direction of any length."""
    return random.choice(('1 0 0', '0 0 1', '0 -1 0', '1 1 0', '0 0 3.5', '-0.3 0.4 1e-3',
                          '0.6 0 0.8'))


def urdf(random: Random, links: int) -> Element:
    """Create a random URDF robot with features of public robots."""
    name = random.choice(('made_up', 'made::up'))
    robot = ElementTree.Element('robot', name=name, version='1.1')
    add(add(robot, 'material', name='global'), 'color', rgba='0.2 0.4 0.6 1')
    for index in range(links):
        _urdf_link(random, robot, f'link_{index}')
    movable: list[str] = []
    for index in range(1, links):
        # Joints may be called as links are.
        name = random.choice((f'joint_{index}', f'link_{index}'))
        kind = random.choice(_URDF_TYPES)
        joint = add(robot, 'joint', name=name, type=kind)
        add(joint, 'parent', link=f'link_{random.randrange(index)}')
        add(joint, 'child', link=f'link_{index}')
        _origin(random, joint)
        if kind not in ('fixed', 'floating'):
            add(joint, 'axis', xyz=axis(random))
        if kind in ('revolute', 'prismatic'):
            add(joint, 'limit', lower=random.choice(('-1', '-0.123456789', '-1e16')), upper='1.5',
                effort=random.choice(('10', '1e16', '-1')), velocity=random.choice(('2.5', '-1')))
            if random.random() < 0.3:
                add(joint, 'safety_controller', k_velocity='10', soft_lower_limit='-0.5')
        elif kind == 'continuous' and random.random() < 0.5:
            add(joint, 'limit', lower='-1', upper='1', effort='-1', velocity='-1')
        if kind in ('revolute', 'continuous', 'prismatic'):
            if movable and random.random() < 0.3:
                add(joint, 'mimic', joint=random.choice(movable), multiplier='-0.5', offset='0.25')
            movable.append(name)
            if random.random() < 0.5:
                add(joint, 'dynamics', damping='0.1', friction='0.01')
            if random.random() < 0.2:
                add(joint, 'calibration', rising='0.5')
    if movable:
        transmission = add(robot, 'transmission', name='drive')
        add(add(transmission, 'joint', name=movable[0]), 'hardwareInterface', 'effort')
    block = add(robot, 'gazebo', reference='link_0')
    add(block, 'mu1', '0.2')
    eye = random.choice(('eye', 'made::eye', 'link_0', 'world'))
    sensor = add(block, 'sensor', name=eye, type='camera')
    add(sensor, 'pose', '0 0 0.5 0 0.1 0')
    add(sensor, 'api', name='made::Api')
    add(block, 'sensor', name=eye, type='imu')
    add(add(robot, 'gazebo'), 'plugin', name='drive', filename='libdrive.so')
    return robot


def _origin(random: Random, parent: Element) -> None:
    words = pose(random).split()
    if set(words) != {'0.0'} and random.random() < 0.9:
        add(parent, 'origin', xyz=' '.join(words[:3]), rpy=' '.join(words[3:]))


def _urdf_link(random: Random, robot: Element, name: str) -> None:
    link = add(robot, 'link', name=name)
    if random.random() < 0.5:
        inertial = add(link, 'inertial')
        _origin(random, inertial)
        add(inertial, 'mass', value='1.25')
        add(inertial, 'inertia', ixx='0.1', ixy='0.001', ixz='0', iyy='0.2', iyz='-0.002',
            izz='0.25')
    for tag in random.choices(('visual', 'collision'), k=random.randrange(4)):
        shape = add(link, tag)
        if random.random() < 0.5:
            shape.set('name', random.choice(('body', 'other')))
        _origin(random, shape)
        geometry = add(shape, 'geometry')
        kind = random.randrange(5)
        if kind == 0:
            add(geometry, 'box', size='0.1 0.2 0.30000000000000004')
        elif kind == 1:
            add(geometry, 'sphere', radius='0.7')
        elif kind == 2:
            add(geometry, 'cylinder', radius='0.05', length='0.4')
        elif kind == 3:
            add(geometry, 'capsule', radius='0.05', length='0.4')
        else:
            mesh = add(geometry, 'mesh', filename='package://made_up/meshes/a.stl')
            if random.random() < 0.5:
                mesh.set('scale', '0.001 0.0010000000000000002 -0.001')
        if tag == 'visual' and random.random() < 0.7:
            look = random.randrange(3)
            if look == 0:
                add(shape, 'material', name='global')
            elif look == 1:
                color = random.choice(_COLORS)
                add(add(shape, 'material', name=f'paint {color}'), 'color', rgba=color)
            else:
                add(add(shape, 'material', name='picture'), 'texture',
                    filename='package://made_up/a.png')


def sdf(random: Random, links: int) -> Element:
    """Create a random SDF robot, placed in random frames."""
    root = ElementTree.Element('sdf', version='1.11')
    model = add(root, 'model', name='made_up')
    if random.random() < 0.5:
        add(model, 'pose', '1 2 3 0 0 0.5')
    if random.random() < 0.5:
        add(model, 'self_collide', 'true')
    frames = ['__model__']
    for index in range(links):
        name = f'link_{index}'
        link = add(model, 'link', name=name)
        _sdf_pose(random, link, frames)
        frames.append(name)
        _sdf_link(random, link, name)
        if index and random.random() < 0.3:
            frame = add(model, 'frame', name=f'frame_{index}',
                        attached_to=random.choice(frames[1:]))
            _sdf_pose(random, frame, frames)
            frames.append(f'frame_{index}')
    movable: list[str] = []
    for index in range(1, links):
        _sdf_joint(random, model, f'joint_{index}', f'link_{random.randrange(index)}',
                   f'link_{index}', movable, frames)
    if links > 3 and random.random() < 0.4:
        # Closes a loop: URDF has none.
        _sdf_joint(random, model, 'loop', 'link_1', f'link_{links - 1}', [], frames)
    add(add(model, 'plugin', name='drive', filename='libdrive.so'), 'speed', '3')
    return root


def _sdf_pose(random: Random, parent: Element, frames: list[str]) -> None:
    if random.random() < 0.8:
        element = add(parent, 'pose', pose(random))
        if random.random() < 0.5:
            element.set('relative_to', random.choice(frames))


def _sdf_joint(random: Random, model: Element, name: str, parent: str, child: str,
               movable: list[str], frames: list[str]) -> None:
    kind = random.choice(_SDF_TYPES)
    joint = add(model, 'joint', name=name, type=kind)
    add(joint, 'parent', parent)
    add(joint, 'child', child)
    if random.random() < 0.5:
        _sdf_pose(random, joint, frames)
    if kind in ('fixed', 'ball'):
        return
    for tag in ('axis', 'axis2') if kind in ('universal', 'revolute2', 'gearbox') else ('axis',):
        turning = add(joint, tag)
        add(turning, 'xyz', axis(random))
        if random.random() < 0.2:
            turning[0].set('expressed_in', random.choice(frames))
        limit = add(turning, 'limit')
        if kind != 'continuous' and random.random() < 0.6:
            add(limit, 'lower', '-0.75')
            add(limit, 'upper', '1.25')
        add(limit, 'effort', '30')
        if random.random() < 0.5:
            dynamics = add(turning, 'dynamics')
            if random.random() < 0.5:
                add(dynamics, 'damping', '0.25')
            add(dynamics, 'spring_stiffness', '3')
    if kind in ('revolute', 'continuous', 'prismatic'):
        if movable and random.random() < 0.3:
            mimic = add(turning, 'mimic', joint=random.choice(movable))
            add(mimic, 'multiplier', '2')
            add(mimic, 'offset', '-0.5')
            add(mimic, 'reference', '0')
        movable.append(name)
    if kind == 'screw':
        add(joint, 'screw_thread_pitch', '0.01')
    if kind == 'gearbox':
        add(joint, 'gearbox_ratio', '3')
        add(joint, 'gearbox_reference_body', 'link_0')


def _sdf_link(random: Random, link: Element, name: str) -> None:
    if random.random() < 0.6:
        inertial = add(link, 'inertial')
        if random.random() < 0.7:
            add(inertial, 'pose', pose(random))
        add(inertial, 'mass', '2.5')
        inertia = add(inertial, 'inertia')
        for key, value in (('ixx', '0.1'), ('ixy', '0'), ('ixz', '0.01'), ('iyy', '0.2'),
                           ('iyz', '0'), ('izz', '0.25')):
            add(inertia, key, value)
    for tag in random.choices(('visual', 'collision'), k=random.randrange(4)):
        shape = add(link, tag, name=f'shape_{len(link.findall(tag))}')
        if random.random() < 0.7:
            add(shape, 'pose', pose(random))
        geometry = add(shape, 'geometry')
        kind = random.randrange(4)
        if kind == 0:
            add(add(geometry, 'box'), 'size', '1 2 3')
        elif kind == 1:
            mesh = add(geometry, 'mesh')
            add(mesh, 'uri', 'model://made_up/meshes/a.dae')
            add(mesh, 'scale', '0.001 0.001 0.0010000000000000002')
        elif kind == 2:
            add(add(geometry, 'plane'), 'normal', '0 1 0')
        else:
            add(add(geometry, 'sphere'), 'radius', '0.125')
        if tag == 'visual':
            add(shape, 'cast_shadows', 'false')
            material = add(shape, 'material')
            for key in random.sample(('ambient', 'diffuse', 'specular', 'emissive'), 2):
                add(material, key, random.choice(_COLORS))
        else:
            add(add(add(shape, 'surface'), 'bounce'), 'restitution_coefficient', '0.5')
    if random.random() < 0.3:
        sensor = add(link, 'sensor', name='eye', type='imu')
        add(sensor, 'pose', pose(random))
    if random.random() < 0.3:
        add(link, 'self_collide', 'true')


def elements(root: Element) -> Counter[str]:
    """Count the elements of a file by their paths."""
    return Counter(path for path, _ in _walk(root, root.tag))


def numbers(root: Element) -> Counter[tuple[str, str, tuple[float, ...]]]:
    """Count the numbers of a file by the paths and attributes that they stand in."""
    found: Counter[tuple[str, str, tuple[float, ...]]] = Counter()
    for path, element in _walk(root, root.tag):
        for name, text in [('', element.text or ''), *element.attrib.items()]:
            try:
                found[path, name, tuple(map(float, text.split()))] += 1
            except ValueError:
                continue
    return found


def _walk(element: Element, path: str) -> list[tuple[str, Element]]:
    found = [(path, element)]
    for child in element:
        found.extend(_walk(child, f'{path}/{child.tag}'))
    return found


def calls(function: Callable[[], object]) -> int:
    """Count the calls of functions that a function makes: the same on every machine."""
    count = 0

    def profile(_: FrameType, event: str, __: object) -> None:
        nonlocal count
        count += event in ('call', 'c_call')

    before = sys.getprofile()
    sys.setprofile(profile)
    try:
        function()
    finally:
        sys.setprofile(before)
    return count


def is_linear(function: Callable[[int], object]) -> bool:
    """
    Return whether a function makes about four times as many calls for four times as much.

    Neither may recurse: what is made of 1200 things is deeper than Python's limit.
    """
    function(10)  # what is only done once is done now
    few, many = calls(lambda: function(300)), calls(lambda: function(1200))
    return 3 * few < many < 4.5 * few
