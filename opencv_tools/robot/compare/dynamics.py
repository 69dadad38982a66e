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

"""What a simulator takes of a robot as a whole: mass, centre of mass, and the mass matrix."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from opencv_tools.robot.compare.properties import Properties
from opencv_tools.robot.compare.side import Poses, Side
from opencv_tools.robot.model import FrameId, Joint
from opencv_tools.robot.pose import normalised, rotated_tensor, Transform, Vector, ZERO

ENERGY = 'kinetic energy at random velocities'
_Twist = tuple[Vector, Vector]  # angular velocity, and velocity of the point at the origin


def whole_properties(side: Side, poses: Sequence[Poses], velocities: Mapping[str, Sequence[float]]
                     ) -> Properties:
    """
    Return the mass, the centre of mass and the kinetic energies of a robot; empty without mass.

    The mass matrix M determines the energy v' M v / 2, and takes longer.

    :param poses: results of `Side.poses` at some positions, the first at zero.
    :param velocities: six random numbers for each joint, and for the robot by an empty name.
    """
    bodies = [(link.name, inertial, side.offset(link, inertial.placement))
              for link in side.links.values() if (inertial := side.inertial(link))]
    mass = sum(inertial.mass for _, inertial, _ in bodies)
    if not mass:
        return {}
    sums, energies = [0.0, 0.0, 0.0], []
    for number, place in enumerate(poses):
        twists, energy = _twists(side, place, velocities), 0.0
        for name, inertial, offset in bodies:
            pose = place[FrameId('link', name)] @ offset
            if not number:
                sums = [total + inertial.mass * value
                        for total, value in zip(sums, pose.translation)]
            (x, y, z), linear = twists[name]
            speed = _sum(linear, _cross((x, y, z), pose.translation))
            xx, xy, xz, yy, yz, zz = rotated_tensor(inertial.inertia, pose.rotation)
            energy += (inertial.mass * sum(value * value for value in speed)
                       + x * x * xx + y * y * yy + z * z * zz
                       + 2 * (x * y * xy + x * z * xz + y * z * yz)) / 2
        energies.append(energy)
    return {'mass': (mass,), 'centre of mass at zero': tuple(total / mass for total in sums),
            ENERGY: tuple(energies)}


def _twists(side: Side, poses: Poses, velocities: Mapping[str, Sequence[float]]
            ) -> dict[str, _Twist]:
    """Return the velocities of all links in the base."""
    root, kinematics = velocities[''], side.kinematics
    twists: dict[str, _Twist] = dict.fromkeys(kinematics.roots, (
        (root[0], root[1], root[2]), (root[3], root[4], root[5])))
    keys = {joint.name: key for key, joint in side.joints.items()}
    for name in kinematics.subtree(kinematics.roots):
        for joint in kinematics.child_joints[name]:
            twists[joint.child] = _moved(twists[name], joint, poses[FrameId('joint', joint.name)],
                                         velocities[keys[joint.name]])
    return twists


def _moved(twist: _Twist, joint: Joint, pose: Transform, velocity: Sequence[float]) -> _Twist:
    """Return the velocity of a joint's child; of three axes or more, about all of them."""
    kind, (a, b, c, *linear) = joint.kind.name, velocity
    if kind == 'fixed':
        return twist
    angular, speed = (a, b, c), (linear[0], linear[1], linear[2])
    if kind in ('revolute', 'prismatic'):
        x, y, z = normalised(joint.axes[0].xyz) if joint.axes else (0.0, 0.0, 1.0)
        x, y, z = pose.rotate((x, y, z))
        along = (a * x, a * y, a * z)
        angular, speed = (along, ZERO) if kind == 'revolute' else (ZERO, along)
    elif kind in ('ball', 'universal'):
        speed = ZERO
    return (_sum(twist[0], angular),
            _sum(_sum(twist[1], speed), _cross(pose.translation, angular)))


def _sum(u: Vector, v: Vector) -> Vector:
    return (u[0] + v[0], u[1] + v[1], u[2] + v[2])


def _cross(u: Vector, v: Vector) -> Vector:
    return (u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0])
