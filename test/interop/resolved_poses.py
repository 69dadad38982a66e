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

"""Poses of a robot in its root link: computed from URDF, or resolved by libsdformat from SDF."""

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
_GEOMETRIES = ('box', 'sphere', 'cylinder', 'capsule', 'mesh')
UNLIMITED = 1e16  # limits of at least this size mean no limit, in URDF and SDF


@dataclass(frozen=True)
class ResolvedPoses:
    """
    Poses in the frame of the root link, by flat names.

    :param shapes: poses of visuals and collisions by link, tag and name.
    :param masses: mass and moments of inertia by link.
    :param axes: direction in the root link, limits, damping and friction by joint.
    """

    joints: dict[str, Matrix] = field(default_factory=dict)
    shapes: dict[tuple[str, str, str], Matrix] = field(default_factory=dict)
    inertials: dict[str, Matrix] = field(default_factory=dict)
    masses: dict[str, list[float]] = field(default_factory=dict)
    axes: dict[str, list[float]] = field(default_factory=dict)


def flat(name: str) -> str:
    """Return the name that a URDF uses for an object of a nested model."""
    return name.replace('::', '__')


def poses_of_urdf(root: Element, *, named: bool) -> ResolvedPoses:
    """
    Return the poses of a URDF. As in urdfdom, the first element of a tag counts.

    :param named: whether shapes are identified by names; otherwise by their numbers in the link.
    """
    result = ResolvedPoses()
    joints = {_attribute(joint, 'child', 'link'): joint for joint in root.findall('joint')}
    frames: dict[str, Matrix] = {}

    def frame(link: str) -> Matrix:
        if link not in frames:
            joint = joints.get(link)
            frames[link] = np.eye(4) if joint is None else (
                frame(_attribute(joint, 'parent', 'link')) @ origin(joint))
        return frames[link]

    for child, joint in joints.items():
        name = flat(joint.get('name', ''))
        result.joints[name] = frame(child)
        kind = joint.get('type')
        if kind in ('revolute', 'continuous', 'prismatic'):
            xyz = vector(_attribute(joint, 'axis', 'xyz', '1 0 0'))
            result.axes[name] = [*(frame(child)[:3, :3] @ xyz / np.linalg.norm(xyz)),
                                 *_urdf_limits(joint)]
    for link in root.findall('link'):
        name = link.get('name', '')
        inertial = link.find('inertial')
        if inertial is not None:
            result.inertials[name] = frame(name) @ origin(inertial)
            result.masses[name] = [float(_attribute(inertial, 'mass', 'value', '0')), *(
                float(_attribute(inertial, 'inertia', key, '0'))
                for key in ('ixx', 'ixy', 'ixz', 'iyy', 'iyz', 'izz'))]
        for tag in ('visual', 'collision'):
            for index, shape in enumerate(filter(_is_read, link.findall(tag))):
                key = (name, tag, shape.get('name', '') if named else str(index))
                result.shapes[key] = frame(name) @ origin(shape)
    return result


def _is_read(shape: Element) -> bool:
    """Return whether urdfdom reads the geometry of a shape."""
    geometry = next(iter(shape.find('geometry') or ()), None)
    return geometry is not None and geometry.tag in _GEOMETRIES and (
        geometry.tag != 'mesh' or 'filename' in geometry.attrib)


def _attribute(element: Element, tag: str, name: str, default: str = '') -> str:
    """Return an attribute of the first child with a tag."""
    child = element.find(tag)
    return default if child is None else child.get(name, default)


def _urdf_limits(joint: Element) -> list[float]:
    lower, upper = (float(_attribute(joint, 'limit', key, '0')) for key in ('lower', 'upper'))
    if joint.get('type') == 'continuous':
        lower, upper = -math.inf, math.inf
    return limits(lower, upper, *(
        float(_attribute(joint, tag, key, default)) for tag, key, default in (
            ('limit', 'effort', 'inf'), ('limit', 'velocity', 'inf'),
            ('dynamics', 'damping', '0'), ('dynamics', 'friction', '0'))))


def limits(lower: float, upper: float, effort: float, velocity: float, damping: float,
           friction: float) -> list[float]:
    """Return limits, damping and friction of a joint, with infinity for no limit."""
    return [*(math.copysign(math.inf, value) if abs(value) >= UNLIMITED else value
              for value in (lower, upper)),
            *(math.inf if value < 0 or value >= UNLIMITED else value
              for value in (effort, velocity)), damping, friction]


def poses_of_sdf(root: Element, model: Mapping[str, Any], base: str, *, named: bool
                 ) -> ResolvedPoses:
    """
    Return the poses of an SDF.

    :param root: root element of the file, which has the order of the shapes.
    :param model: poses resolved by libsdformat.
    :param base: link that the poses are relative to; ``world`` for the world.
    :param named: as in `poses_of_urdf`.
    """
    starts = [np.linalg.inv(matrix(pose)) for name, pose in model.get('links', {}).items()
              if flat(name) == base]
    inverse = starts[0] if starts else matrix(model['in_world'])
    assert starts or base == 'world'
    inside = root.find('model')
    assert inside is not None
    result = ResolvedPoses()
    for name, pose in model.get('joints', {}).items():
        result.joints[flat(name)] = inverse @ matrix(pose)
    for name, pose in model['inertials'].items():
        result.inertials[flat(name)] = inverse @ matrix(pose)
        result.masses[flat(name)] = model['masses'][name]
    for name, kind in _joints(inside):
        axis = model.get('axes', {}).get(f'{name}/0')
        if axis and kind in ('revolute', 'continuous', 'prismatic'):
            xyz = result.joints[flat(name)][:3, :3] @ np.array(axis[:3])
            positions = (-math.inf, math.inf) if kind == 'continuous' else axis[3:5]
            result.axes[flat(name)] = [*xyz, *limits(*positions, *axis[5:])]
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
    """Return the transform of the ``<origin>`` of an element."""
    roll, pitch, yaw = vector(_attribute(element, 'origin', 'rpy', '0 0 0'))
    result = np.eye(4)
    result[:3, :3] = _rotation(yaw, 0, 1) @ _rotation(pitch, 2, 0) @ _rotation(roll, 1, 2)
    result[:3, 3] = vector(_attribute(element, 'origin', 'xyz', '0 0 0'))
    return result


def _rotation(angle: float, first: int, second: int) -> Matrix:
    """Return the rotation about an angle in the plane of two axes."""
    result = np.eye(3)
    result[[first, second], [first, second]] = math.cos(angle)
    result[second, first] = math.sin(angle)
    result[first, second] = -math.sin(angle)
    return result


def vector(text: str) -> NDArray[np.float64]:
    """Return the numbers of a text."""
    return np.array([float(word) for word in text.split()])


def matrix(pose: Sequence[float]) -> Matrix:
    """Return the transform of a position and a quaternion with w first."""
    w, x, y, z = np.array(pose[3:]) / np.linalg.norm(pose[3:])
    result = np.eye(4)
    result[:3, :3] = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)]]
    result[:3, 3] = pose[:3]
    return result


def root_link(root: Element) -> str:
    """Return the root link of a URDF."""
    children = {_attribute(joint, 'child', 'link') for joint in root.findall('joint')}
    return next(name for link in root.findall('link')
                if (name := link.get('name', '')) not in children)
