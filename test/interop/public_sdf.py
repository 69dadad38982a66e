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

"""Random SDF with features of public files: odd numbers and names, mixed versions."""

from __future__ import annotations

from random import Random
import xml.etree.ElementTree as ElementTree

from robots import add, axis, Element, pose

DRAKE = 'http://drake.mit.edu'
GZ = 'http://gazebosim.org/schema'
VERSIONS = ('1.4', '1.5', '1.6', '1.7', '1.8', '1.9')
for _prefix, _space in (('drake', DRAKE), ('gz', GZ)):
    ElementTree.register_namespace(_prefix, _space)
_NUMBERS = ('0', '-1', '1', '0.5', '-0.5', '1e16', '-1e16', '1e20', '-1e20', '-0.0', '1e308')
# Numbers that some parsers reject.
_ODD_NUMBERS = ('inf', '-inf', '1.7976931348623157e308', '1e-320')
_COLORS = ('0.1 0.2 0.3 1', '1 1 1', '0 0 0 0')
_ODD_COLORS = ('200 200 200 1', '1.5 0 0 2', '-0.1 0 0 1')
_SDF_TYPES = ('fixed', 'revolute', 'revolute', 'revolute', 'prismatic', 'continuous', 'ball',
              'universal', 'revolute2', 'screw', 'gearbox')


def some(random: Random, share: float = 0.3) -> bool:
    return random.random() < share


def odd_name(random: Random, plain: str) -> str:
    """Return a plain name, or sometimes a name as in C++ and in nested models."""
    odd = f'pkg::{plain}', f'a::b::{plain}', f'__{plain}__', f'{plain} {plain}', f'::{plain}'
    return random.choice(odd) if some(random, 0.07) else plain


def odd_number(random: Random, odd: float) -> str:
    return random.choice(_ODD_NUMBERS if some(random, odd) else _NUMBERS)


def plugin_element(random: Random, frames: list[str]) -> Element:
    """Return a plugin whose parameters have the names of SDF elements."""
    plugin = ElementTree.Element('plugin', name=odd_name(random, 'drive'), filename='libdrive.so')
    add(plugin, 'pose', '1 2 3 0 0 0', frame=random.choice(frames))
    turning = add(plugin, 'axis')
    add(turning, 'xyz', '0 0 1')
    add(turning, 'use_parent_model_frame', '1')
    add(plugin, f'{{{GZ}}}topic', 'a::b')
    add(plugin, 'link', name='pkg::link')
    add(plugin, 'element', 'x', foo='1')
    return plugin


def sensor_element(random: Random, frames: list[str], collision: str) -> Element:
    sensor = ElementTree.Element('sensor', name=odd_name(random, 'eye'), type='imu')
    if collision and some(random, 0.6):
        sensor.set('type', 'contact')
        add(add(sensor, 'contact'), 'collision', collision)
    if some(random):
        add(sensor, 'pose', pose(random))
    if some(random):
        sensor.append(plugin_element(random, frames))
    if some(random):
        add(sensor, 'api', name=odd_name(random, 'camera')).set(f'{{{GZ}}}priority', '1')
    return sensor


def sdf(random: Random) -> Element:
    """Return a robot in SDF of a random version, with elements of other versions."""
    version = random.choice(VERSIONS)
    root = ElementTree.Element('sdf', version=version)
    model = add(root, 'model', name=random.choice(('made_up', 'made_up', 'made up')))
    if some(random, 0.2):
        add(model, 'pose', pose(random))
    _fill_model(random, model, 1 + random.randrange(4), '', version)
    return root


def _fill_model(random: Random, model: Element, links: int, prefix: str, version: str
                ) -> list[str]:
    """Fill a model and return the names of its links."""
    old = float(version) < 1.7
    names = [f'{prefix}link_{index}' for index in range(links)]
    frames = ['__model__', *names]
    for name in names:
        link = add(model, 'link', name=name)
        # Before 1.7 the order of evaluation of poses is not specified.
        _sdf_pose(random, link, frames[:names.index(name) + 1])
        _sdf_link(random, link, frames)
    if not prefix and some(random, 0.25):
        inner = add(model, 'model', name='inner')
        _sdf_pose(random, inner, frames)
        names += [f'inner::{name}' for name in _fill_model(random, inner, 2, 'in_', version)]
    if not old and some(random):
        frame = add(model, 'frame', name=f'{prefix}frame', attached_to=names[0])
        _sdf_pose(random, frame, frames)
    for index in range(1, len(names)):
        if names[index] == 'inner::in_link_1':
            continue  # the nested model has this joint
        parent = names[random.randrange(index)]
        _sdf_joint(random, model, f'{prefix}joint_{index}', parent, names[index], frames)
    if not prefix and some(random, 0.15):
        _sdf_joint(random, model, 'anchor', 'world', names[0], frames)
    if some(random):
        model.append(plugin_element(random, names))
    return names


def _sdf_pose(random: Random, parent: Element, frames: list[str]) -> None:
    if some(random, 0.3):
        return
    element = add(parent, 'pose', pose(random))
    if some(random):
        element.set(random.choice(('relative_to', 'frame')), random.choice(frames))
    if some(random, 0.2):
        element.set('degrees', random.choice(('true', 'false', '1', '0')))
    elif some(random, 0.15):
        element.set('rotation_format', 'quat_xyzw')
        element.text = '0.1 0.2 0.3 0 0 0.6 0.8'


def _sdf_link(random: Random, link: Element, frames: list[str]) -> None:
    inertial = add(link, 'inertial')
    add(inertial, 'mass', random.choice(('1', '2.5', '1e-9')))
    if some(random):
        add(inertial, 'pose', pose(random))
    if some(random):
        inertia = add(inertial, 'inertia')
        for key, value in (('ixx', '0.1'), ('iyy', '0.1'), ('izz', '0.1')):
            add(inertia, key, value)
    collision = ''
    for index, tag in enumerate(random.choices(('visual', 'collision'), k=random.randrange(4))):
        # Many public files use one name for both.
        names = {shape.get('name') for shape in link.findall(tag)}
        shape = add(link, tag, name=f'{tag}_{index}' if 'body' in names else 'body')
        if tag == 'collision':
            collision = shape.get('name', '')
        if some(random):
            add(shape, 'pose', pose(random))
        geometry = add(shape, 'geometry')
        kind = random.randrange(5)
        if kind == 0:
            add(add(geometry, 'box'), 'size', '1 2 3')
        elif kind == 1:
            add(add(geometry, 'sphere'), 'radius', '0.5')
        elif kind == 2:
            cylinder = add(geometry, 'cylinder')
            add(cylinder, 'radius', '0.5')
            add(cylinder, 'length', '2')
        elif kind == 3:
            add(add(geometry, 'mesh'), 'uri', 'model://made_up/a.dae')
        else:
            add(add(geometry, 'plane'), 'normal', '0 0 1')
        if tag == 'visual' and some(random, 0.7):
            material = add(shape, 'material')
            for key in ('ambient', 'diffuse', 'specular', 'emissive'):
                if some(random, 0.6):
                    add(material, key, random.choice(
                        _ODD_COLORS if some(random, 0.015) else _COLORS))
            if some(random):
                script = add(material, 'script')
                add(script, 'uri', 'file://media/a.material')
                add(script, 'name', 'pkg::Grey')
    while some(random, 0.4):
        sensor = sensor_element(random, frames, collision)
        if all(sensor.get('name') != other.get('name') for other in link):
            link.append(sensor)
    if some(random, 0.1):
        add(link, f'{{{GZ}}}note', 'x').set(f'{{{GZ}}}kind', 'y')
        link.set(f'{{{GZ}}}kind', 'z')


def _sdf_joint(random: Random, model: Element, name: str, parent: str, child: str,
               frames: list[str]) -> None:
    kind = random.choice(_SDF_TYPES)
    joint = add(model, 'joint', name=name, type=kind)
    add(joint, 'parent', parent)
    add(joint, 'child', child)
    if some(random, 0.5):
        _sdf_pose(random, joint, frames)
    tags = {'ball': (), 'universal': ('axis', 'axis2'), 'revolute2': ('axis', 'axis2'),
            'gearbox': ('axis', 'axis2'), 'fixed': ('axis', 'axis2')[:random.randrange(2)]}
    for tag in tags.get(kind, ('axis',)):
        _sdf_axis(random, add(joint, tag), frames)
    if kind == 'gearbox':
        add(joint, 'gearbox_reference_body', frames[1])
        add(joint, 'gearbox_ratio', '2')
    if some(random):
        ode = add(add(joint, 'physics'), 'ode')
        add(add(ode, 'limit'), 'cfm', '0')
    if some(random, 0.15):
        joint.append(sensor_element(random, frames, ''))


def _sdf_axis(random: Random, turning: Element, frames: list[str]) -> None:
    xyz = add(turning, 'xyz', axis(random))
    if some(random):
        xyz.set('expressed_in', random.choice(frames))
    if some(random):
        add(turning, 'use_parent_model_frame', random.choice(('0', '1', 'true', 'false')))
    if some(random, 0.7):
        limit = add(turning, 'limit')
        lower, upper = limit_range(random, 0.02)
        for tag, text in (('lower', lower), ('upper', upper), ('effort', odd_number(random, 0.02)),
                          ('velocity', odd_number(random, 0.02)), ('stiffness', '1e8')):
            if some(random, 0.7):
                add(limit, tag, text)
    if some(random, 0.7):
        dynamics = add(turning, 'dynamics')
        for tag in ('damping', 'friction', 'spring_reference', 'spring_stiffness'):
            if some(random):
                add(dynamics, tag, random.choice(('0', '0.1', '1e9')))
    if some(random, 0.1):
        add(turning, 'initial_position', '0.5')


def limit_range(random: Random, odd: float) -> list[str]:
    """Return a lower and an upper limit, in order; a huge limit has the sign of no limit."""
    lower, upper = sorted((odd_number(random, odd), odd_number(random, odd)), key=float)
    return ['-1e20' if float(lower) > 1e15 else lower, '1e20' if float(upper) < -1e15 else upper]
