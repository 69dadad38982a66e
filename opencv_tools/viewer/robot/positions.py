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

"""Positions of joints, read from untrusted messages."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from functools import cache
import math
from typing import cast

from opencv_tools.image.errors import CdrError
from opencv_tools.message_types.codec import MessageCodec
from opencv_tools.message_types.definition import read_definition
from opencv_tools.robot.pose import Quaternion, rotation_of_quaternion, Transform
from opencv_tools.viewer.robot.joints import joint_position, LiveJoint
from rclpy.serialization import deserialize_message
from sensor_msgs.msg import JointState

_LARGEST = 1e6  # metres or radians; a page cannot draw much larger numbers
_ONE_NUMBER = ('revolute', 'prismatic')  # kinds of joints that joint_states can have


class Positions:
    """Newest position of each joint that has one, by its number."""

    def __init__(self, joints: Iterable[LiveJoint] = ()) -> None:
        """Create positions of joints, of which none is known."""
        joints = [*joints]
        self._by_name = {one.name: one for one in joints if one.kind in _ONE_NUMBER}
        self._by_links = {one.links: one for one in joints}
        self._in_states: set[int] = set()
        self.values: dict[int, list[float]] = {}
        #: Number of messages with a position that was used.
        self.used = 0
        #: Reason why the newest joint_states cannot be used, in whole or in part; '' else.
        self.problem = ''

    def read_states(self, message: bytes) -> dict[int, list[float]]:
        """
        Use a serialized message of ``sensor_msgs/msg/JointState``.

        :returns: the positions that have changed.
        """
        self.problem = ''
        try:
            states = deserialize_message(message, JointState)
        except (RuntimeError, ValueError) as err:  # rclpy's RMWError is private
            self.problem = f'a message cannot be read: {err}'
            return {}
        names, positions = states.name, states.position.tolist()
        if positions and len(positions) != len(names):
            self.problem = f'a message has {len(names)} names, but {len(positions)} positions'
            return {}
        found, unknown, bad = {}, 0, 0
        for name, position in zip(names, positions):
            joint = self._by_name.get(name)
            if joint is None:
                unknown += 1
            elif not abs(position) <= _LARGEST:  # NaN is not either
                bad += 1
            else:
                found[joint.number] = [position]
        if bad:
            self.problem = f'{bad} positions are not numbers within {_LARGEST:g}'
        elif unknown:
            self.problem = f'{unknown} of {len(names)} names are not movable joints of the robot'
        self._in_states.update(found)
        return self._changed(found)

    def read_transforms(self, message: bytes) -> dict[int, list[float]]:
        """
        Use a serialized message of ``tf2_msgs/msg/TFMessage``.

        Only transforms between the links of a joint count, and only without joint_states.

        :returns: the positions that have changed.
        """
        try:
            transforms = _codec().read(message)['transforms']
        except CdrError:
            return {}  # tf has many publishers, and none of them belongs to the robot alone
        found = {}
        for one in transforms:
            joint = self._by_links.get((one['header']['frame_id'], one['child_frame_id']))
            if joint is None or joint.number in self._in_states:
                continue
            position = _position(joint, one['transform'])
            if position is not None:
                found[joint.number] = position
        return self._changed(found)

    def _changed(self, found: dict[int, list[float]]) -> dict[int, list[float]]:
        self.used += bool(found)
        changed = {number: position for number, position in found.items()
                   if self.values.get(number) != position}
        self.values |= changed
        return changed


@cache
def _codec() -> MessageCodec:
    return MessageCodec(read_definition('tf2_msgs/msg/TFMessage'))


def _position(joint: LiveJoint, transform: Mapping[str, Mapping[str, float]]
              ) -> list[float] | None:
    """Return the position at which the child link has a pose in the parent; None for none."""
    x, y, z = (float(transform['translation'][name]) for name in 'xyz')
    quaternion = tuple(float(transform['rotation'][name]) for name in 'wxyz')
    length = math.hypot(*quaternion)
    if not (all(abs(value) <= _LARGEST for value in (x, y, z)) and 0.1 < length < 10):
        return None
    pose = Transform(rotation_of_quaternion(cast('Quaternion', quaternion)), (x, y, z))
    return joint_position(joint.kind, joint.axis,
                          joint.step.inverse() @ pose @ joint.child_step.inverse())
