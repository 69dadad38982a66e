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

"""One of two robots that are compared: its objects by common names, and other elements."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
import math

from opencv_tools.robot.compare.properties import (
    axis_properties, geometry_properties, is_continuous, material_properties, plain_uri,
    Properties, Value)
from opencv_tools.robot.kinematics import Kinematics
from opencv_tools.robot.model import (
    Extension, FrameId, Inertial, Joint, Link, MODEL, Placement, Robot, RobotFrame, Shape)
from opencv_tools.robot.names import flat_name
from opencv_tools.robot.pose import IDENTITY, Pose, rotated_tensor, Transform
from opencv_tools.robot.renaming import original_name, with_original_names
from opencv_tools.robot.sdf.values import DEFAULT_INERTIAL, pose_of
from opencv_tools.robot.xml.document import DescriptionError, Element, local_name
from opencv_tools.robot.xml.numbers import c_float

_FLAGS = {'true': (1.0,), 'false': (0.0,)}
_SCRIPT = 'material/script/name'  # a material of Gazebo, which is the colour if there is no other


def element_properties(extension: Extension) -> Properties:
    """
    Return all attributes and texts of the kept elements by path, with numbers as numbers.

    A path such as ``sensor[camera]/update_rate`` has the names of elements, or their numbers where
    several have one tag. An empty element is ``present``. The order of different tags, comments
    and spaces do not matter. Paths of URDF begin with ``urdf:``.
    """
    properties: Properties = {}
    for prefix, root in (('', extension.sdf), ('urdf:', extension.urdf)):
        if root is not None:
            properties.update((prefix + path.lstrip('/'), value) for path, value in _values(root))
    return properties


def _values(element: Element, path: str = '') -> Iterator[tuple[str, Value]]:
    attributes = {str(name): str(value) for name, value in element.attrib.items()
                  if not str(name).startswith('{')}
    text = (element.text or '').strip()
    children = list(element.iterchildren('*'))
    if element.tag == 'pose' and (numbers := _pose(element)):
        yield path, numbers
        attributes = {name: attributes[name] for name in attributes if name == 'relative_to'}
    elif text or not (children or element.attrib):
        yield path, _value(text) if text else 'present'
    for name, value in attributes.items():
        yield f'{path}@{name}', _value(value)
    for key, child in _keyed(children):
        yield from _values(child, f'{path}/{key}')


def _keyed(children: Iterable[Element]) -> Iterator[tuple[str, Element]]:
    """Yield children with their tags, and with names or numbers where these tell them apart."""
    by_tag: dict[str, list[Element]] = {}
    for child in children:
        by_tag.setdefault(local_name(child), []).append(child)
    for tag, siblings in by_tag.items():
        names = [flat_name(child.get('name', '')) for child in siblings]
        if not all(names) or len(set(names)) < len(names):
            names = [''] if len(siblings) == 1 else list(map(str, range(len(siblings))))
        for name, child in zip(names, siblings):
            yield f'{tag}[{name}]' if name else tag, child


def _pose(element: Element) -> tuple[float, ...]:
    """Return a pose in metres and radians; empty for other texts, which plugins may have."""
    try:
        pose = pose_of(element)
    except DescriptionError:
        return ()
    return *pose.xyz, *pose.rpy


def _value(text: str) -> Value:
    """Return the numbers of a text, of a flag 1 or 0, else the text as both formats write it."""
    if flag := _FLAGS.get(text.lower()):
        return flag
    try:
        numbers = tuple(map(c_float, text.split()))
    except ValueError:
        return plain_uri(flat_name(' '.join(text.split())))
    return numbers if numbers and all(map(math.isfinite, numbers)) else text


Key = tuple[str, str]  # element and name
Poses = Mapping[FrameId, Transform]


@dataclass(frozen=True)
class Item:
    """An object that is compared, with the frame in which it is fixed at an offset."""

    frame: FrameId
    offset: Transform = IDENTITY
    properties: Properties = field(default_factory=dict)


class Side:
    """One of the two robots, with its objects by names that are the same in both formats."""

    def __init__(self, robot: Robot) -> None:
        # What was massless in URDF has a mass in SDF, beside links with mass.
        has_mass = any(link.has_mass for link in robot.links)
        self._heavy = {original_name(link) for link in robot.links
                       if has_mass and not link.has_mass and link.default_mass}
        robot = self.robot = with_original_names(robot)
        self.kinematics = Kinematics(robot)
        self.links = dict(zip(_keys(link.name for link in robot.links), robot.links))
        self.joints = dict(zip(_keys(joint.name for joint in robot.joints), robot.joints))
        self.frames = dict(zip(_keys(frame.name for frame in robot.frames), robot.frames))

    def items(self, base: str, skipped: set[str], ordered: set[Key], everything: bool
              ) -> dict[Key, Item]:
        """Return all objects that are compared, by element and name."""
        def kept(owner: Robot | Link | Joint | RobotFrame | Shape) -> Properties:
            return element_properties(owner.extension) if everything else {}

        def seen(shape: Shape) -> Properties:
            found = element_properties(shape.extension)
            has_color = shape.material and shape.material.color
            return found if everything else {
                name: value for name, value in found.items()
                if name.startswith('surface/') or (name == _SCRIPT and not has_color)}

        to_base = self.kinematics.pose(self._base_frame(base)).inverse()
        items = {}
        if everything:
            items['robot', ''] = Item(self._base_frame(base), IDENTITY, {
                'name': self.robot.name, **kept(self.robot)})
        for key, link in self.links.items():
            if key in skipped:
                continue
            frame = FrameId('link', link.name)
            items['link', key] = Item(frame, IDENTITY, kept(link))
            inertial = self.inertial(link)
            if inertial:
                # The axes of the moments are arbitrary, so the moments are rotated into the base.
                offset = self.offset(link, inertial.placement)
                rotation = (to_base @ self.kinematics.pose(frame) @ offset).rotation
                items['inertial', key] = Item(frame, Transform(translation=offset.translation), {
                    'mass': (inertial.mass,),
                    'inertia': rotated_tensor(inertial.inertia, rotation)})
            for element, shapes in shapes_of(link):
                names = (map(str, range(len(shapes))) if (element, key) in ordered
                         else (shape.name for shape in shapes))
                for name, shape in zip(names, shapes):
                    items[element, f'{key}/{name}'] = Item(
                        frame, self.offset(link, shape.placement),
                        {**geometry_properties(shape), **material_properties(shape.material),
                         **seen(shape)})
        for key, joint in self.joints.items():
            items['joint', key] = Item(
                FrameId('joint', joint.name), IDENTITY,
                {**self._joint_properties(joint, to_base), **kept(joint)})
        for key, other in self.frames.items():
            items['frame', key] = Item(FrameId('frame', other.name), IDENTITY, kept(other))
        return items

    def poses(self, base: str, positions: Mapping[str, Sequence[float]]) -> Poses:
        """Return the poses of links, joints and frames in the base link."""
        poses = self.kinematics.forward(positions)
        to_base = poses.get(self._base_frame(base), IDENTITY).inverse()
        return {frame: to_base @ pose for frame, pose in poses.items()}

    def is_unused_world(self, key: str) -> bool:
        """Return whether a link is an empty world without joints to other links."""
        link = self.links[key]
        return link.is_world and not self.kinematics.child_joints[link.name]

    def _base_frame(self, base: str) -> FrameId:
        return FrameId('link', self.links[base].name) if base else MODEL

    def inertial(self, link: Link) -> Inertial | None:
        """Return what a simulator takes: a default beside links with mass if there is none."""
        if link.has_mass or link.name not in self._heavy:
            return link.inertial if link.has_mass else None
        return Inertial(Placement(Pose(), FrameId('link', link.name)), *DEFAULT_INERTIAL)

    def offset(self, link: Link, placement: Placement) -> Transform:
        """Return a placement in a link."""
        return self.kinematics.within(FrameId('link', link.name), placement).transform()

    def _joint_properties(self, joint: Joint, to_base: Transform) -> Properties:
        pose = to_base @ self.kinematics.pose(FrameId('joint', joint.name))
        continuous = is_continuous(joint)
        properties: Properties = {
            'type': 'continuous' if continuous else joint.type,
            'parent': flat_name(joint.parent), 'child': flat_name(joint.child),
            'closes a loop': 'yes' if joint.is_loop else 'no'}
        for index, axis in enumerate(joint.axes[:joint.kind.axes]):
            suffix = ' of axis2' if index else ''
            properties.update((f'{name}{suffix}', value)
                              for name, value in axis_properties(axis, pose).items()
                              if not (continuous and name in ('lower', 'upper')))
        return properties


def _keys(names: Iterable[str]) -> list[str]:
    """Return names as both formats write them; unchanged names if that would make two equal."""
    originals = list(names)
    keys = list(map(flat_name, originals))
    return keys if len(set(keys)) == len(set(originals)) else originals


def shapes_of(link: Link) -> tuple[tuple[str, tuple[Shape, ...]], ...]:
    return ('visual', link.visuals), ('collision', link.collisions)
