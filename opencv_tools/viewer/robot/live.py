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

"""The live robot of the server: its description, the positions of its joints and the pages."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import cache, partial
import hashlib
import math
from typing import Any, cast, Protocol

from opencv_tools.image.errors import CdrError
from opencv_tools.message_types.codec import MessageCodec
from opencv_tools.message_types.definition import read_definition
from opencv_tools.robot.pose import Quaternion, rotation_of_quaternion, Transform
from opencv_tools.topics.rate_meter import RateMeter
from opencv_tools.viewer.errors import RequestError
from opencv_tools.viewer.executor_calls import ExecutorCalls
from opencv_tools.viewer.hub import Hub
from opencv_tools.viewer.robot.joints import joint_position, LiveJoint
from opencv_tools.viewer.robot.reader import LiveRobot, read_description
from opencv_tools.viewer.robot_topics import (
    DESCRIPTION, Inbox, missing_publishers, MOTION, RobotTopics, STATES, TRANSFORMS)
from opencv_tools.viewer.watched import in_loop, LOAD, quiet_limit, Watched
from rclpy.serialization import deserialize_message
from sensor_msgs.msg import JointState
from std_msgs.msg import String

_LARGEST = 1e6  # metres or radians; a page cannot draw much larger numbers
_ONE_NUMBER = ('revolute', 'prismatic')  # kinds of joints that joint_states can have


class Positions:
    """Newest position of each joint that has one, by its number."""

    def __init__(self, joints: Iterable[LiveJoint] = ()) -> None:
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


_READ_SECONDS = 1.0  # between the begins of two readings


class Descriptions:
    """
    The newest robot, at most one reading each second; an error leaves the robot as it is.

    All methods run in the loop of the server.
    """

    def __init__(self, on_change: Callable[[bool], object]) -> None:
        """
        Create an object without a robot.

        :param on_change: called before and after a reading; its argument is whether there is a
            new robot.
        """
        self.robot: LiveRobot | None = None
        self.version = 0
        #: Reason why the newest description cannot be read; '' else.
        self.error = ''
        #: Whether a description is being read.
        self.is_reading = False
        self._on_change = on_change
        self._digest = b''
        self._task: asyncio.Task[None] | None = None

    def close(self) -> None:
        """End the reading."""
        if self._task:
            self._task.cancel()

    def refuse(self, reason: str) -> None:
        """Show why a description cannot be read, or does not arrive."""
        self.error = reason
        self._on_change(False)

    def read(self, inbox: Inbox, topic: str) -> None:
        """Read the newest description of an inbox, unless an older one is being read."""
        if self._task is None and (found := inbox.take(DESCRIPTION)):
            self._task = asyncio.ensure_future(self._read_all(inbox, found, topic))

    async def _read_all(self, inbox: Inbox, found: Sequence[bytes], topic: str) -> None:
        try:
            while found:
                await asyncio.gather(self._read(found[-1], topic), asyncio.sleep(_READ_SECONDS))
                found = inbox.take(DESCRIPTION)
        finally:
            self._task = None

    async def _read(self, message: bytes, topic: str) -> None:
        try:
            data = deserialize_message(message, String).data.encode(errors='replace')
            digest = hashlib.sha256(data).digest()
            if digest == self._digest:
                return
            self._digest, self.is_reading = digest, True
            self._on_change(False)
            robot = await read_description(data, topic)
        except (OSError, RequestError, RuntimeError) as err:  # rclpy's RMWError is private
            self.is_reading = False
            self.refuse(str(err))
            return
        self.is_reading = False
        self.robot, self.version, self.error = robot, self.version + 1, ''
        self._on_change(True)


_PERIOD = 1 / 30  # between two looks at the messages in seconds


class RobotPage(Protocol):
    """A page that shows the robot."""

    def show(self, state: dict[str, Any]) -> None:
        """Send the state; a later one replaces it."""

    def move(self, positions: dict[int, list[float]]) -> None:
        """Send positions of joints; later ones replace those of the same joint."""


class LiveRobots(Watched[RobotPage]):
    """
    Subscribe while pages look, and read what arrives.

    All methods run in the loop of the server.
    """

    def __init__(self, hub: Hub, topics: RobotTopics, calls: ExecutorCalls) -> None:
        """
        Create an object without a robot.

        :param topics: topics of the robot, used in the executor.
        """
        super().__init__()
        self._hub = hub
        self._topics = topics
        self._calls = calls
        self._loop = asyncio.get_running_loop()
        self.descriptions = Descriptions(self._show)
        self.positions = Positions()
        self._inbox: Inbox | None = None
        self._meter = RateMeter()
        self._timer: asyncio.TimerHandle | None = None
        self.on_unused = self._close_topics
        self._due = 0.0

    def close(self) -> None:
        """End all work."""
        self.descriptions.close()

    def join(self, page: RobotPage) -> None:
        """Send the robot to a page from now on."""
        super().join(page)
        page.show(self._state())
        if self._inbox is None:
            self._meter = RateMeter()
            self._inbox = Inbox(in_loop(self._arrived))
            self._open(self._inbox, DESCRIPTION, *(MOTION if self.descriptions.robot else ()))
        self._hub.watch(self._show)

    def _close_topics(self) -> None:
        self._hub.watchers.discard(self._show)
        self._inbox = None
        self._calls.call(self._topics.close)

    def _open(self, inbox: Inbox, *topics: str) -> None:
        self._calls.call(partial(self._topics.open, inbox, topics), in_loop(self._opened))

    def _opened(self, outcome: RequestError | None) -> None:
        if outcome:
            self.descriptions.refuse(str(outcome))

    def _arrived(self) -> None:
        if self._timer is None:
            wait = max(0.0, self._due - self._loop.time())
            self._timer = self._loop.call_later(wait, self._look)

    def _look(self) -> None:
        """Use the messages that have arrived."""
        self._timer, inbox, begin = None, self._inbox, self._loop.time()
        if inbox is None:
            return
        inbox.begin()
        changed: dict[int, list[float]] = {}
        for kind, read in ((STATES, self.positions.read_states),
                           (TRANSFORMS, self.positions.read_transforms)):
            for message in inbox.take(kind):
                before = self.positions.used
                changed |= read(message)
                if self.positions.used > before:
                    self._meter.add()
        if changed:
            for page in self.watchers:
                page.move(changed)
        self.descriptions.read(inbox, self._hub.state.robot.topics[0])
        self._due = begin + max(_PERIOD, LOAD * (self._loop.time() - begin))

    def _show(self, is_new: bool = False) -> None:
        """Show the state, after a change of the robot as well."""
        if is_new and self.descriptions.robot:
            self.positions = Positions(self.descriptions.robot.joints)
            if self._inbox:
                self._open(self._inbox, *MOTION)
        for page in self.watchers:
            page.show(self._state())

    def _state(self) -> dict[str, Any]:
        quiet = self._meter.silent_seconds
        is_late = quiet is None or quiet > quiet_limit(self._meter)
        version, error = self.descriptions.version, self.descriptions.error
        state = self._hub.state.robot
        is_reading = self.descriptions.is_reading
        notes = missing_publishers(state, bool(version or error or is_reading), quiet is not None)
        if is_reading:
            notes.append('A new description is being read.')
        if self.positions.problem:
            notes.append(f'{state.topics[1]}: {self.positions.problem}.')
        return {'version': version, 'error': error, 'late': is_late, 'age': quiet,
                'rate': round(self._meter.rate, 1),
                'notes': notes + (self._inbox.refusals() if self._inbox else [])}
