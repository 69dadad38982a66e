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

"""A node that publishes a robot, and a page of the robot without a browser."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

from opencv_tools.message_types.codec import MessageCodec
from opencv_tools.message_types.definition import read_definition
from opencv_tools.transport.message_type import message_type
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import DurabilityPolicy, QoSProfile
from sensor_msgs.msg import JointState
from std_msgs.msg import String
from tornado.websocket import websocket_connect
from viewing import Page
from waiting import until

TF = 'tf2_msgs/msg/TFMessage'
LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
#: A robot whose second joint mimics the first, and whose third one floats.
ROBOT = """<robot name="live"><link name="base"/><link name="arm"/><link name="hand"/>
<link name="drone"/>
<joint name="elbow" type="revolute"><parent link="base"/><child link="arm"/>
  <origin xyz="0 0 1" rpy="0.1 0 0"/><axis xyz="0 1 0"/>
  <limit lower="-2" upper="2" effort="1" velocity="1"/></joint>
<joint name="wrist" type="prismatic"><parent link="arm"/><child link="hand"/>
  <origin xyz="0 0 0.5"/><axis xyz="1 0 0"/><limit lower="-2" upper="2" effort="1" velocity="1"/>
  <mimic joint="elbow" multiplier="-0.5" offset="0.25"/></joint>
<joint name="flight" type="floating"><parent link="base"/><child link="drone"/>
  <origin xyz="1 0 0"/></joint></robot>"""


class RobotNode:
    """Publishers of a robot."""

    def __init__(self, node: Node) -> None:
        self._node = node
        self._descriptions: list[Publisher] = []
        self.states = node.create_publisher(JointState, 'joint_states', 10)
        self.transforms = node.create_publisher(message_type(TF), 'tf_static', LATCHED)

    def describe(self, text: str, qos: QoSProfile = LATCHED) -> Publisher:
        """Publish a description with a publisher of its own, which is returned."""
        publisher = self._node.create_publisher(String, 'robot_description', qos)
        publisher.publish(String(data=text))
        self._descriptions.append(publisher)
        return publisher

    def remove(self, publisher: Publisher) -> None:
        """End a publisher of a description."""
        self._descriptions.remove(publisher)
        self._node.destroy_publisher(publisher)

    def move(self, names: Sequence[str] = ('elbow',), positions: Sequence[float] = ()) -> None:
        """Publish joint_states."""
        self.states.publish(JointState(name=[*names], position=[*map(float, positions)]))

    def place(self, parent: str, child: str, xyz: Sequence[float], wxyz: Sequence[float]) -> None:
        """Publish a transform on tf_static."""
        transform = {'translation': dict(zip('xyz', xyz)), 'rotation': dict(zip('wxyz', wxyz))}
        self.transforms.publish(MessageCodec(read_definition(TF)).write({'transforms': [
            {'header': {'frame_id': parent}, 'child_frame_id': child, 'transform': transform}]}))

    def watched(self) -> list[int]:
        """Return the number of subscriptions to each topic."""
        return [publisher.get_subscription_count() for publisher in (
            *self._descriptions, self.states, self.transforms)]


class RobotClient(Page):
    """A connection as the page of the robot has it."""

    @classmethod
    async def watch(cls, url: str) -> RobotClient:
        """Connect to a server, given the address that it has printed, and look at the robot."""
        page = cls(await websocket_connect(url.replace('http', 'ws', 1) + 'robot/ws'),
                   'RobotAnswer')
        assert await page.text('hello') == {}
        await page.send(watch=True)
        return page

    async def state(self, condition: Callable[[Mapping[str, Any]], object]) -> Mapping[str, Any]:
        """Read until the state has a property; positions are answered."""
        while True:
            found: Any = await self.read()
            if 'positions' in found:
                await self.send(got=1)
            elif 'state' in found and condition(found['state']):
                return dict(found['state'])

    async def moved(self) -> dict[int, list[float]]:
        """Read the next positions by the number of the joint."""
        found = await self.text('positions')
        await self.send(got=1)
        return dict(found)


async def subscribed(robot: RobotNode) -> None:
    """Wait until the viewer subscribes to all topics."""
    await until(lambda: all(robot.watched()))
