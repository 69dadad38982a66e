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

"""Where things of a robot are: of URDF by this arithmetic, of SDF by what libsdformat says."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
import math
from typing import Any
import xml.etree.ElementTree as ElementTree

import numpy as np
from numpy.typing import NDArray

Element = ElementTree.Element
Matrix = NDArray[np.float64]
_FORMS = ('box', 'sphere', 'cylinder', 'capsule', 'mesh')
UNLIMITED = 1e16  # from here on a limit is none, in URDF as in SDF


@dataclass(frozen=True)
class Places:
    """
    Transforms in the frame of the root link, by names that are flat.

    :param shapes: visuals and collisions by link, tag and name.
    :param axes: direction in the root link, limits, damping and friction, by joint.
    """

    joints: dict[str, Matrix] = field(default_factory=dict)
    shapes: dict[tuple[str, str, str], Matrix] = field(default_factory=dict)
    inertials: dict[str, Matrix] = field(default_factory=dict)
    masses: dict[str, list[float]] = field(default_factory=dict)
    axes: dict[str, list[float]] = field(default_factory=dict)


def flat(name: str) -> str:
    """Return a name as URDF has that of a nested model."""
    return name.replace('::', '__')


def of_urdf(root: Element, *, named: bool) -> Places:
    """
    Return where all is in URDF, of which urdfdom takes the first element of each kind.

    :param named: whether shapes have names; else they are counted in their link.
    """
    result = Places()
    joints = {_got(joint, 'child', 'link'): joint for joint in root.findall('joint')}
    frames: dict[str, Matrix] = {}

    def frame(link: str) -> Matrix:
        if link not in frames:
            joint = joints.get(link)
            frames[link] = np.eye(4) if joint is None else (
                frame(_got(joint, 'parent', 'link')) @ origin(joint))
        return frames[link]

    for child, joint in joints.items():
        name = flat(joint.get('name', ''))
        result.joints[name] = frame(child)
        kind = joint.get('type')
        if kind in ('revolute', 'continuous', 'prismatic'):
            xyz = vector(_got(joint, 'axis', 'xyz', '1 0 0'))
            result.axes[name] = [*(frame(child)[:3, :3] @ xyz / np.linalg.norm(xyz)),
                                 *_urdf_limits(joint)]
    for link in root.findall('link'):
        name = link.get('name', '')
        inertial = link.find('inertial')
        if inertial is not None:
            result.inertials[name] = frame(name) @ origin(inertial)
            result.masses[name] = [float(_got(inertial, 'mass', 'value', '0')), *(
                float(_got(inertial, 'inertia', key, '0'))
                for key in ('ixx', 'ixy', 'ixz', 'iyy', 'iyz', 'izz'))]
        for tag in ('visual', 'collision'):
            for index, shape in enumerate(filter(_is_read, link.findall(tag))):
                key = (name, tag, shape.get('name', '') if named else str(index))
                result.shapes[key] = frame(name) @ origin(shape)
    return result


def _is_read(shape: Element) -> bool:
    """Return whether urdfdom has a geometry of this kind."""
    form = next(iter(shape.find('geometry') or ()), None)
    return form is not None and form.tag in _FORMS and (
        form.tag != 'mesh' or 'filename' in form.attrib)


def _got(element: Element, tag: str, name: str, default: str = '') -> str:
    """Return an attribute of the first child of a tag."""
    child = element.find(tag)
    return default if child is None else child.get(name, default)


def _urdf_limits(joint: Element) -> list[float]:
    lower, upper = (float(_got(joint, 'limit', key, '0')) for key in ('lower', 'upper'))
    if joint.get('type') == 'continuous':
        lower, upper = -math.inf, math.inf
    return limits(lower, upper, *(
        float(_got(joint, tag, key, default)) for tag, key, default in (
            ('limit', 'effort', 'inf'), ('limit', 'velocity', 'inf'),
            ('dynamics', 'damping', '0'), ('dynamics', 'friction', '0'))))


def limits(lower: float, upper: float, effort: float, velocity: float, damping: float,
           friction: float) -> list[float]:
    """Return what limits a joint, with infinity wherever there is no limit."""
    return [*(math.copysign(math.inf, value) if abs(value) >= UNLIMITED else value
              for value in (lower, upper)),
            *(math.inf if value < 0 or value >= UNLIMITED else value
              for value in (effort, velocity)), damping, friction]


def of_sdf(root: Element, model: Mapping[str, Any], base: str, *, named: bool) -> Places:
    """
    Return where all is in SDF.

    :param root: of the file, which says in what order things stand.
    :param model: what libsdformat resolved.
    :param base: the link in which all is placed; ``world`` for the world.
    :param named: see `of_urdf`.
    """
    starts = [np.linalg.inv(matrix(pose)) for name, pose in model.get('links', {}).items()
              if flat(name) == base]
    inverse = starts[0] if starts else matrix(model['in_world'])
    assert starts or base == 'world'
    inside = root.find('model')
    assert inside is not None
    result = Places()
    for name, pose in model.get('joints', {}).items():
        result.joints[flat(name)] = inverse @ matrix(pose)
    for name, pose in model['inertials'].items():
        result.inertials[flat(name)] = inverse @ matrix(pose)
        result.masses[flat(name)] = model['masses'][name]
    for name, kind in _joints(inside):
        axis = model.get('axes', {}).get(f'{name}/0')
        if axis and kind in ('revolute', 'continuous', 'prismatic'):
            xyz = result.joints[flat(name)][:3, :3] @ np.array(axis[:3])
            reach = (-math.inf, math.inf) if kind == 'continuous' else axis[3:5]
            result.axes[flat(name)] = [*xyz, *limits(*reach, *axis[5:])]
    for link, tag, index, shape in _shapes(inside):
        result.shapes[flat(link), tag, shape if named else str(index)] = inverse @ matrix(
            model[f'{tag}s'][f'{link}/{shape}'])
    return result


def _joints(model: Element, prefix: str = '') -> Iterator[tuple[str, str]]:
    for joint in model.findall('joint'):
        yield prefix + joint.get('name', ''), joint.get('type', '')
    for inner in model.findall('model'):
        yield from _joints(inner, f'{prefix}{inner.get("name")}::')


def _shapes(model: Element, prefix: str = '') -> Iterator[tuple[str, str, int, str]]:
    for link in model.findall('link'):
        for tag in ('visual', 'collision'):
            for index, shape in enumerate(link.findall(tag)):
                yield prefix + link.get('name', ''), tag, index, shape.get('name', '')
    for inner in model.findall('model'):
        yield from _shapes(inner, f'{prefix}{inner.get("name")}::')


def origin(element: Element) -> Matrix:
    """Return what ``<origin>`` of an element says."""
    roll, pitch, yaw = vector(_got(element, 'origin', 'rpy', '0 0 0'))
    result = np.eye(4)
    result[:3, :3] = _turn(yaw, 0, 1) @ _turn(pitch, 2, 0) @ _turn(roll, 1, 2)
    result[:3, 3] = vector(_got(element, 'origin', 'xyz', '0 0 0'))
    return result


def _turn(angle: float, one: int, other: int) -> Matrix:
    """Return a rotation that takes one of the axes to another one."""
    result = np.eye(3)
    result[[one, other], [one, other]] = math.cos(angle)
    result[other, one] = math.sin(angle)
    result[one, other] = -math.sin(angle)
    return result


def vector(text: str) -> NDArray[np.float64]:
    """Return three numbers."""
    return np.array([float(word) for word in text.split()])


def matrix(pose: Sequence[float]) -> Matrix:
    """Return what a place and a quaternion with w first say."""
    w, x, y, z = np.array(pose[3:]) / np.linalg.norm(pose[3:])
    result = np.eye(4)
    result[:3, :3] = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)]]
    result[:3, 3] = pose[:3]
    return result


def root_link(root: Element) -> str:
    """Return the link of URDF that hangs on nothing."""
    children = {_got(joint, 'child', 'link') for joint in root.findall('joint')}
    return next(name for link in root.findall('link')
                if (name := link.get('name', '')) not in children)
