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

"""
A robot in terms of both formats: links, joints and frames, each placed in another frame.

The model keeps each pose with the numbers of the file and with the frame that the file places it
in. A conversion can therefore copy the numbers. XML that the model does not represent is kept.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from copy import deepcopy
from dataclasses import dataclass, field, replace
import math
from typing import NamedTuple, TYPE_CHECKING, TypeVar
import warnings

from lxml import etree
from opencv_tools.robot.geometry import Geometry, Material
from opencv_tools.robot.joint_kinds import JOINT_KINDS, JointKind
from opencv_tools.robot.pose import Pose, Tensor, Vector

INERTIA = ('ixx', 'ixy', 'ixz', 'iyy', 'iyz', 'izz')  # tags of `Inertial.inertia`
WORLD = 'world'  # name of the inertial frame in both formats; SDF does not declare it as a link


class FrameId(NamedTuple):
    """
    Identifier of a frame. It has a kind, because a link and a joint of URDF may share a name.

    :param kind: ``model``, ``link``, ``joint`` or ``frame``.
    :param name: name of the link, joint or frame; empty for the model.
    """

    kind: str
    name: str


MODEL = FrameId('model', '')


@dataclass(frozen=True)
class Placement:
    """A pose and the frame that it is relative to."""

    pose: Pose
    relative_to: FrameId


@dataclass(frozen=True)
class Extension:
    """
    Source XML that the model does not represent, kept for the round trip.

    Each element has the tag of its object and only the attributes and children that the reader
    did not consume. It is None if there are none. The elements are copied and never changed.
    """

    urdf: etree._Element | None = None
    sdf: etree._Element | None = None

    def find_sdf(self, path: str) -> etree._Element | None:
        """Return the first SDF child with a path such as ``geometry/mesh``, if there is one."""
        return None if self.sdf is None else self.sdf.find(path)

    def with_sdf(self, sdf: etree._Element | None) -> Extension:
        """Return the extension with other SDF; an empty element is none."""
        return replace(self, sdf=_unless_empty(sdf))

    @property
    def marks(self) -> dict[str, str]:
        """Attributes of URDF: the name there, and marks for the conversion back."""
        return {} if self.urdf is None else {
            str(name): str(value) for name, value in self.urdf.attrib.items()}

    def marked(self, marks: Mapping[str, str | None]) -> Extension:
        """Return the extension with other values of marks; None removes a mark."""
        if self.urdf is None and not any(marks.values()):
            return self
        root = etree.Element('marked') if self.urdf is None else deepcopy(self.urdf)
        for name, value in marks.items():
            root.attrib.pop(name, '')
            if value is not None:
                root.set(name, value)
        return replace(self, urdf=_unless_empty(root))


def _unless_empty(element: etree._Element | None) -> etree._Element | None:
    is_empty = element is None or not (len(element) or element.attrib or element.text)
    return None if is_empty else element


NO_EXTENSION = Extension()


@dataclass(frozen=True)
class Inertial:
    """
    Inertial properties of a link.

    :param placement: pose of the centre of mass, with the axes of the moments of inertia.
    :param mass: mass in kg.
    :param inertia: moments of inertia ixx, ixy, ixz, iyy, iyz, izz in kg m2.
    """

    placement: Placement
    mass: float
    inertia: Tensor


@dataclass(frozen=True, kw_only=True)
class Shape:
    """
    A visual or a collision of a link.

    :param name: name of the shape; in URDF it may be empty or not unique.
    :param geometry: None for a geometry that URDF does not support; ``extension.sdf`` has it.
    :param material: None for a collision and for a visual without a material.
    """

    name: str
    placement: Placement
    geometry: Geometry | None
    material: Material | None = None
    extension: Extension = NO_EXTENSION
    line: int = field(default=0, compare=False)


@dataclass(frozen=True, kw_only=True)
class Link:
    """
    A rigid body. In URDF its frame is the frame of its parent joint.

    :param default_mass: mass in kg in a simulator if there is no inertial: 1 in SDF, 0 in URDF.
    """

    name: str
    placement: Placement
    inertial: Inertial | None = None
    visuals: tuple[Shape, ...] = ()
    collisions: tuple[Shape, ...] = ()
    extension: Extension = NO_EXTENSION
    default_mass: float = field(default=0.0, compare=False)
    line: int = field(default=0, compare=False)

    @property
    def has_mass(self) -> bool:
        """Whether the link has a mass or moments of inertia of its own that are not 0."""
        return self.inertial is not None and any((self.inertial.mass, *self.inertial.inertia))

    @property
    def is_world(self) -> bool:
        """Whether the link stands for the world, to which joints may be fixed."""
        return (self.name == WORLD and self.inertial is None and self.extension == NO_EXTENSION
                and not self.visuals and not self.collisions)


@dataclass(frozen=True)
class Limit:
    """
    Limits of a joint; infinite for no limit.

    :param lower: lowest position in radians or metres.
    :param upper: highest position in radians or metres.
    :param effort: greatest effort in N m or N; a negative value means no limit.
    :param velocity: greatest velocity in rad/s or m/s; a negative value means no limit.
    """

    lower: float = -math.inf
    upper: float = math.inf
    effort: float = math.inf
    velocity: float = math.inf


@dataclass(frozen=True)
class Dynamics:
    """Damping in N m s/rad or N s/m and friction in N m or N; None if the file has no value."""

    damping: float | None = None
    friction: float | None = None


@dataclass(frozen=True)
class Mimic:
    """Rule of a mimic joint: position = multiplier * position of ``joint`` + offset."""

    joint: str
    multiplier: float = 1.0
    offset: float = 0.0


@dataclass(frozen=True)
class Axis:
    """
    An axis of a joint.

    :param xyz: direction in the frame of the joint, with the numbers of the file; not 0 0 0.
    """

    xyz: Vector
    limit: Limit | None = None
    dynamics: Dynamics | None = None
    mimic: Mimic | None = None


@dataclass(frozen=True, kw_only=True)
class Joint:
    """
    A joint between two links.

    :param type: a key of ``JOINT_KINDS``.
    :param child: name of the link that moves with the frame of the joint.
    :param axes: at most ``kind.max_axes`` axes.
    :param is_loop: whether the joint closes a kinematic loop, which URDF does not support.
    """

    name: str
    type: str  # noqa: A003
    parent: str
    child: str
    placement: Placement
    axes: tuple[Axis, ...] = ()
    is_loop: bool = False
    extension: Extension = NO_EXTENSION
    line: int = field(default=0, compare=False)

    @property
    def kind(self) -> JointKind:
        """Kind of the joint's motion."""
        return JOINT_KINDS[self.type]

    @property
    def limit(self) -> Limit:
        """Limit of the first axis; a limit without bounds if there is none."""
        return (self.axes[0].limit if self.axes else None) or Limit()

    @property
    def has_position_limits(self) -> bool:
        """Whether the limits of the axes bound the position of the joint."""
        return self.type != 'continuous' and self.kind.name in (
            'revolute', 'prismatic', 'universal')


@dataclass(frozen=True, kw_only=True)
class RobotFrame:
    """A frame beside those of links and joints; it moves with the frame that it is attached to."""

    name: str
    attached_to: FrameId
    placement: Placement
    extension: Extension = NO_EXTENSION
    line: int = field(default=0, compare=False)


_Placed = TypeVar('_Placed', Shape, Link, Joint, RobotFrame)


@dataclass(frozen=True, kw_only=True)
class Robot:
    """
    A robot or another model.

    :param canonical_link: link that the frame of the model moves with; empty for the first link.
    :param source: name of the file for messages.
    """

    name: str
    links: tuple[Link, ...]
    joints: tuple[Joint, ...] = ()
    frames: tuple[RobotFrame, ...] = ()
    canonical_link: str = ''
    extension: Extension = NO_EXTENSION
    source: str = ''

    def frame_owners(self) -> Iterator[tuple[FrameId, Link | Joint | RobotFrame]]:
        """Return all links, joints and frames, each with the identifier of its frame."""
        for kind, owners in (('link', self.links), ('joint', self.joints), ('frame', self.frames)):
            for owner in owners:
                yield FrameId(kind, owner.name), owner

    def parts(self) -> Iterator[Robot | Link | Joint | RobotFrame | Shape]:
        """Return the robot and all its parts, which have extensions."""
        yield self
        for link in self.links:
            yield link
            yield from link.visuals + link.collisions
        yield from self.joints
        yield from self.frames

    def extension_elements(self) -> Iterator[etree._Element]:
        """Return the XML that the model does not represent, of the robot and of all its parts."""
        for part in self.parts():
            yield from (element for element in (part.extension.urdf, part.extension.sdf)
                        if element is not None)

    def map_frame_ids(self, change: Callable[[FrameId], FrameId]) -> Robot:
        """Return the robot with every reference to a frame replaced by a function's result."""
        robot = replace(self, frames=tuple(
            replace(frame, attached_to=change(frame.attached_to)) for frame in self.frames))
        return robot.map_placements(lambda placement: replace(
            placement, relative_to=change(placement.relative_to)))

    def map_placements(self, change: Callable[[Placement], Placement]) -> Robot:
        """Return the robot with every placement replaced by the result of a function."""
        def changed(owners: tuple[_Placed, ...]) -> tuple[_Placed, ...]:
            return tuple(replace(owner, placement=change(owner.placement)) for owner in owners)

        return replace(
            self, joints=changed(self.joints), frames=changed(self.frames),
            links=tuple(replace(
                link, visuals=changed(link.visuals), collisions=changed(link.collisions),
                inertial=link.inertial and replace(
                    link.inertial, placement=change(link.inertial.placement)))
                for link in changed(self.links)))


if not TYPE_CHECKING:
    def __getattr__(name: str) -> object:
        """Return `RobotFrame` by its former name, until 0.4.0."""
        if name == 'Frame':
            warnings.warn(f'{__name__}.Frame is called RobotFrame', DeprecationWarning,
                          stacklevel=2)
            return RobotFrame
        raise AttributeError(f'module {__name__!r} has no attribute {name!r}')
