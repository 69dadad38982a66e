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
A robot as both formats mean it: links, joints and frames, each placed in another frame.

A pose is kept as it is written together with the frame that it is written in, so that numbers
can go from one format to the other untouched. What only one of the formats has is kept as XML.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, replace
import math
from typing import NamedTuple

from lxml import etree
from opencv_tools.robot.geometry import Geometry, Material
from opencv_tools.robot.pose import Pose, Tensor, Vector

WORLD = 'world'  # of this name both formats understand the world; SDF has no such link


@dataclass(frozen=True, kw_only=True)
class JointKind:
    """
    Motion that all joint types of one kind have in common.

    :param name: name of the kind.
    :param axes: number of axes along or about which the joint moves.
    :param max_axes: largest number of axes that the joint may have in a file.
    :param random_span: for each number of a position, the distance from zero in radians or metres
        within which a random position of an unlimited joint lies.
    """

    name: str
    axes: int = 0
    max_axes: int = 0
    random_span: tuple[float, ...] = ()

    @property
    def dof(self) -> int:
        """Degrees of freedom: the number of values of a position."""
        return len(self.random_span)


_REVOLUTE = JointKind(name='revolute', axes=1, max_axes=1, random_span=(math.pi,))
_UNIVERSAL = JointKind(name='universal', axes=2, max_axes=2, random_span=(math.pi,) * 2)
# The kind of each joint type of URDF and SDF. The pitch of a screw joint is not modelled.
JOINT_KINDS: Mapping[str, JointKind] = {
    'fixed': JointKind(name='fixed'),
    'revolute': _REVOLUTE, 'continuous': _REVOLUTE, 'screw': _REVOLUTE,
    'prismatic': JointKind(name='prismatic', axes=1, max_axes=1, random_span=(1.0,)),
    'floating': JointKind(name='floating', max_axes=1,
                          random_span=(1.0, 1.0, 1.0, math.pi, math.pi, math.pi)),
    'planar': JointKind(name='planar', axes=1, max_axes=1, random_span=(1.0, 1.0, math.pi)),
    'ball': JointKind(name='ball', random_span=(math.pi,) * 3),
    'universal': _UNIVERSAL, 'revolute2': _UNIVERSAL, 'gearbox': _UNIVERSAL,
}
URDF_TYPES = ('fixed', 'revolute', 'continuous', 'prismatic', 'floating', 'planar')
WITHOUT_AXIS = ('fixed', 'floating')  # of those of URDF
SDF_TYPES = ('fixed', 'revolute', 'continuous', 'prismatic', 'screw', 'ball', 'universal',
             'revolute2', 'gearbox')


class FrameId(NamedTuple):
    """
    What names a frame: links and joints of URDF may have one name.

    :param kind: ``model``, ``link``, ``joint`` or ``frame``.
    :param name: of the link, joint or frame; empty for the model.
    """

    kind: str
    name: str


MODEL = FrameId('model', '')


@dataclass(frozen=True)
class Placement:
    """A pose and the frame in which it is written."""

    pose: Pose
    relative_to: FrameId


@dataclass(frozen=True)
class Extension:
    """
    What a format says beyond the fields here: elements with all that was read taken out.

    Each is an element of the object's own tag that has only attributes and children that were
    not read; None when there are none. They are never changed, only copied.

    :param urdf: in the words of URDF.
    :param sdf: in the words of SDF.
    """

    urdf: etree._Element | None = None
    sdf: etree._Element | None = None


NO_EXTENSION = Extension()


@dataclass(frozen=True)
class Inertial:
    """
    Mass in kg, and the moments of inertia in kg m2 about the frame that ``placement`` places.

    :param inertia: ixx, ixy, ixz, iyy, iyz, izz.
    """

    placement: Placement
    mass: float
    inertia: Tensor


@dataclass(frozen=True)
class Shape:
    """
    A visual or a collision of a link.

    :param name: may be empty, and need not be unique, where it comes from URDF.
    :param geometry: None for one that URDF has no word for; it is in ``extension.sdf`` then.
    :param material: None for a collision, and for a visual without one.
    """

    name: str
    placement: Placement
    geometry: Geometry | None
    material: Material | None = None
    extension: Extension = NO_EXTENSION
    line: int = field(default=0, compare=False)


@dataclass(frozen=True)
class Link:
    """A rigid body. In URDF its frame is that of the joint above it."""

    name: str
    placement: Placement
    inertial: Inertial | None = None
    visuals: tuple[Shape, ...] = ()
    collisions: tuple[Shape, ...] = ()
    extension: Extension = NO_EXTENSION
    line: int = field(default=0, compare=False)

    @property
    def is_world(self) -> bool:
        """Tell whether this stands for the world, to which joints may be fastened."""
        return (self.name == WORLD and self.inertial is None and self.extension == NO_EXTENSION
                and not self.visuals and not self.collisions)


@dataclass(frozen=True)
class Limit:
    """
    How far, how strongly and how fast a joint moves; infinite where there is no limit.

    :param lower: in radians or metres, ``upper`` too.
    :param effort: in N m or N; a negative one means no limit, too, and is kept as URDF has it.
    :param velocity: in rad/s or m/s; as ``effort``.
    """

    lower: float = -math.inf
    upper: float = math.inf
    effort: float = math.inf
    velocity: float = math.inf


@dataclass(frozen=True)
class Dynamics:
    """Damping in N m s/rad or N s/m and friction in N m or N; None where nothing is written."""

    damping: float | None = None
    friction: float | None = None


@dataclass(frozen=True)
class Mimic:
    """A joint that follows another one: position = multiplier * the other's + offset."""

    joint: str
    multiplier: float = 1.0
    offset: float = 0.0


@dataclass(frozen=True)
class Axis:
    """
    An axis of a joint, in the joint's own frame.

    :param xyz: its direction as it is written, of any length but 0.
    """

    xyz: Vector
    limit: Limit | None = None
    dynamics: Dynamics | None = None
    mimic: Mimic | None = None


@dataclass(frozen=True)
class Joint:
    """
    A joint between two links.

    :param type: a key of ``JOINT_KINDS``.
    :param child: the link that moves with the joint's frame.
    :param axes: none, one, or two for those types that have two.
    :param is_loop: whether it closes a loop of links, of which URDF has none.
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


@dataclass(frozen=True)
class Frame:
    """A frame that is neither link nor joint; it moves with what it is attached to."""

    name: str
    attached_to: FrameId
    placement: Placement
    extension: Extension = NO_EXTENSION
    line: int = field(default=0, compare=False)


@dataclass(frozen=True)
class Robot:
    """
    A robot, or any other model.

    :param canonical_link: the link that the model's frame moves with; empty for the first one.
    :param source: the file that it comes from, for messages.
    """

    name: str
    links: tuple[Link, ...]
    joints: tuple[Joint, ...] = ()
    frames: tuple[Frame, ...] = ()
    canonical_link: str = ''
    extension: Extension = NO_EXTENSION
    source: str = ''

    def frame_owners(self) -> Iterator[tuple[FrameId, Link | Joint | Frame]]:
        """Give all that has a frame of its own, with what names it."""
        for kind, things in (('link', self.links), ('joint', self.joints), ('frame', self.frames)):
            for thing in things:
                yield FrameId(kind, thing.name), thing

    def extension_elements(self) -> Iterator[etree._Element]:
        """Return the XML that the model does not represent, of the robot and of all its parts."""
        shapes = (shape for link in self.links for shape in (*link.visuals, *link.collisions))
        parts: tuple[Robot | Link | Joint | Frame | Shape, ...] = (
            self, *self.links, *self.joints, *self.frames, *shapes)
        for extension in (part.extension for part in parts):
            yield from (element for element in (extension.urdf, extension.sdf)
                        if element is not None)

    def map_placements(self, place: Callable[[Placement], Placement]) -> Robot:
        """Give the robot with every placement in it as a function has it."""
        def shapes(things: tuple[Shape, ...]) -> tuple[Shape, ...]:
            return tuple(replace(shape, placement=place(shape.placement)) for shape in things)

        return replace(
            self,
            links=tuple(replace(
                link, placement=place(link.placement), visuals=shapes(link.visuals),
                collisions=shapes(link.collisions), inertial=link.inertial and replace(
                    link.inertial, placement=place(link.inertial.placement)))
                for link in self.links),
            joints=tuple(replace(joint, placement=place(joint.placement))
                         for joint in self.joints),
            frames=tuple(replace(frame, placement=place(frame.placement))
                         for frame in self.frames))
