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

"""Positions of the joints of the live robot, from untrusted messages."""

from __future__ import annotations

import math
from random import Random

from live_robots import ROBOT, TF
from opencv_tools.message_types.codec import MessageCodec
from opencv_tools.message_types.definition import read_definition
from opencv_tools.robot.compare.properties import random_position
from opencv_tools.robot.kinematics import joint_transform, Kinematics
from opencv_tools.robot.model import FrameId
from opencv_tools.robot.urdf.reader import read_urdf
from opencv_tools.robot.view.untrusted import text_content
from opencv_tools.robot.xml.document import parse
from opencv_tools.robot.xml.report import Report
from opencv_tools.viewer.robot.joints import joints_of, LiveJoint
from opencv_tools.viewer.robot.live import Positions
import pytest
from rclpy.serialization import serialize_message
from rows import each_row
from sensor_msgs.msg import JointState

PLANAR = ROBOT.replace('type="floating"', 'type="planar"').replace(
    '<origin xyz="1 0 0"/></joint>', '<origin xyz="1 0 0" rpy="0.3 0.2 0.1"/><axis xyz="1 2 3"/>'
    '</joint>')


def joints(text: str = ROBOT) -> list[LiveJoint]:
    return joints_of(text_content(text.encode(), 'r', Report()).document['robots'][0])


def states(names: list[str], positions: list[float]) -> bytes:
    return bytes(serialize_message(JointState(name=names, position=[*map(float, positions)])))


def transform(parent: str, child: str, numbers: list[float]) -> bytes:
    """Return a message with x, y, z and the quaternion w, x, y, z."""
    return MessageCodec(read_definition(TF)).write({'transforms': [{
        'header': {'frame_id': parent}, 'child_frame_id': child, 'transform': {
            'translation': dict(zip('xyz', numbers)),
            'rotation': dict(zip('wxyz', numbers[3:]))}}]})


@pytest.mark.parametrize('text', [ROBOT, PLANAR])
def test_position_in_a_transform_is_that_of_the_kinematics(text: str) -> None:
    robot = read_urdf(parse(text.encode(), '', Report()), Report())
    generator = Random(0)
    for _ in range(20):
        wanted = {joint.name: random_position(joint, generator) for joint in robot.joints}
        poses = Kinematics(robot).forward(wanted)
        positions = Positions(joints(text))
        for number, joint in enumerate(robot.joints):
            pose = (poses[FrameId('link', joint.parent)].inverse()
                    @ poses[FrameId('link', joint.child)])
            found = positions.read_transforms(transform(
                joint.parent, joint.child, [*pose.translation, *pose.quaternion()]))
            # Two positions of a floating joint have the same pose.
            moved = joint_transform(joint, found[number])
            expected = joint_transform(joint, wanted[joint.name])
            for one, other in zip(moved, expected, strict=True):
                assert one == pytest.approx(other, abs=1e-9)


def test_only_changes_of_positions() -> None:
    positions = Positions(joints())
    assert positions.read_states(states(['elbow', 'wrist'], [1, 2])) == {0: [1], 1: [2]}
    assert positions.read_states(states(['wrist', 'elbow'], [2, 1])) == {}
    assert positions.read_states(states(['elbow'], [3])) == {0: [3]}
    assert positions.values == {0: [3], 1: [2]}
    assert positions.read_states(states(['elbow'], [])) == {}  # velocities only
    assert positions.problem == ''
    assert positions.used == 3
    assert positions.read_states(states(['other'], [3])) == {}
    assert positions.used == 3


def test_joint_states_come_before_transforms() -> None:
    positions = Positions(joints())
    message = transform('base', 'arm', [0, 0, 1, 1, 0, 0, 0])
    assert [*positions.read_transforms(message)] == [0]
    assert positions.read_states(states(['elbow'], [0.5])) == {0: [0.5]}
    assert positions.read_transforms(message) == {}
    assert positions.used == 2


@each_row('numbers', [
    [0, 0, 0, 0, 0, 0, 0], [0, math.nan, 0, 1, 0, 0, 0], [0, 0, 1e300, 1, 0, 0, 0],
    [0, 0, 0, math.nan, 0, 0, 0], [0, 0, 0, math.inf, 0, 0, 0]])
def test_bad_transform(numbers: list[float]) -> None:
    assert Positions(joints()).read_transforms(transform('base', 'drone', numbers)) == {}


@pytest.mark.parametrize('message', [b'', b'\0\1\0\0', b'\0\1\0\0' + b'\xff' * 200])
def test_messages_that_cannot_be_read(message: bytes) -> None:
    positions = Positions(joints())
    assert positions.read_transforms(message) == {}
    assert positions.read_states(message) == {}
    assert positions.problem.startswith('a message ')
