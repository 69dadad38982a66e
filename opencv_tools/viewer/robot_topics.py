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

"""Topics of the live robot, subscribed in the executor while somebody looks."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Collection
from dataclasses import dataclass
from functools import partial

from opencv_tools.base.logs import Log
from opencv_tools.message_types.definition import DefinitionError
from opencv_tools.topics.errors import ROS_ERRORS
from opencv_tools.topics.events import destroyable
from opencv_tools.transport.message_type import message_type
from opencv_tools.viewer.errors import RequestError
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy

DESCRIPTION, STATES, TRANSFORMS = 'robot_description', 'joint_states', 'tf'
#: Topics with positions.
MOTION = (STATES, TRANSFORMS, 'tf_static')
_TYPES = {DESCRIPTION: 'std_msgs/msg/String', STATES: 'sensor_msgs/msg/JointState',
          TRANSFORMS: 'tf2_msgs/msg/TFMessage'}
_LATCHED = QoSProfile(depth=10, durability=DurabilityPolicy.TRANSIENT_LOCAL)
_QUICK = QoSProfile(depth=10, reliability=ReliabilityPolicy.BEST_EFFORT)
# Topics by name: kind of their messages, and quality of service.
_TOPICS = {DESCRIPTION: (DESCRIPTION, QoSProfile(
    depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)), STATES: (STATES, _QUICK),
    TRANSFORMS: (TRANSFORMS, _QUICK), 'tf_static': (TRANSFORMS, _LATCHED)}
# Waiting messages, and their bytes that are read at once. Both bound the time of a reading.
_MAX_WAITING = 64
MAX_BYTES = {DESCRIPTION: 4_000_000, STATES: 1 << 18, TRANSFORMS: 1 << 16}


@dataclass(frozen=True)
class RobotState:
    """
    Publishers of the topics of the robot.

    :param topics: names of ``robot_description`` and ``joint_states`` after remapping.
    :param is_kept: whether a publisher of ``robot_description`` keeps its text for the node.
    """

    topics: tuple[str, str] = (f'/{DESCRIPTION}', f'/{STATES}')
    publishers: tuple[int, int] = (0, 0)
    is_kept: bool = True


class Inbox:
    """Newest serialized messages, which the executor puts and the loop of the server takes."""

    def __init__(self, on_message: Callable[[], object]) -> None:
        """
        Create an empty inbox.

        :param on_message: called in the executor after the first message since the last `begin`.
        """
        self._on_message = on_message
        self._is_announced = False
        self._waiting: dict[str, deque[bytes]] = {
            kind: deque(maxlen=1 if kind == DESCRIPTION else _MAX_WAITING) for kind in _TYPES}
        #: Sizes of messages that were too large to be kept, by kind.
        self.oversize: dict[str, int] = {}

    def put(self, kind: str, message: bytes) -> None:
        """Keep a message, unless it is too large."""
        if len(message) > MAX_BYTES[kind]:
            self.oversize[kind] = len(message)
        else:
            self.oversize.pop(kind, None)
            self._waiting[kind].append(message)
        if not self._is_announced:
            self._is_announced = True
            self._on_message()

    def refusals(self) -> list[str]:
        """Return sentences about the newest messages that were too large."""
        return [f'A message of {kind} has {size} bytes and is left out: '
                f'{MAX_BYTES[kind]} are the limit.' for kind, size in self.oversize.items()]

    def begin(self) -> None:
        """Announce the next message again."""
        self._is_announced = False

    def take(self, kind: str) -> list[bytes]:
        """Return the newest messages of a kind within the limit of bytes, oldest first."""
        waiting, left = self._waiting[kind], MAX_BYTES[kind]
        # The executor may append meanwhile, but it never makes the queue shorter.
        messages = [waiting.popleft() for _ in range(len(waiting))]
        first = len(messages)
        while first and len(messages[first - 1]) <= left:
            first -= 1
            left -= len(messages[first])
        return messages[first:]


class RobotTopics:
    """Subscribe to the topics of the robot, used in the executor only."""

    def __init__(self, node: Node, is_wanted: Callable[[str], bool], log: Log) -> None:
        """
        Create an object without subscriptions.

        :param is_wanted: returns whether the parameter ``topics`` allows a topic.
        """
        self._node = node
        self._is_wanted = is_wanted
        self._log = log
        self._names = {name: str(node.resolve_topic_name(name)) for name in _TOPICS}
        self._open: dict[str, Callable[[], object]] = {}

    def state(self) -> RobotState:
        """Return the publishers."""
        names = self._names[DESCRIPTION], self._names[STATES]
        if not self._is_wanted(names[0]):
            return RobotState(names)
        describing, moving = ([info for info in self._node.get_publishers_info_by_topic(name)
                               if info.topic_type == _TYPES[kind]]
                              for name, kind in zip(names, (DESCRIPTION, STATES)))
        return RobotState(names, (len(describing), len(moving)), any(
            info.qos_profile.durability != DurabilityPolicy.VOLATILE for info in describing))

    def open(self, inbox: Inbox, topics: Collection[str]) -> None:  # noqa: A003
        """
        Subscribe to topics; their publishers send again what they keep.

        :raises RequestError: the parameter ``topics`` does not allow it.
        """
        if not self._is_wanted(self._names[DESCRIPTION]):
            raise RequestError(f'{self._names[DESCRIPTION]} is not in the parameter topics: add '
                               'it there', 403)
        self.close(topics)
        for topic in topics:
            kind, qos = _TOPICS[topic]
            try:
                subscription = destroyable(self._node.create_subscription(
                    message_type(_TYPES[kind]), topic, partial(inbox.put, kind), qos, raw=True))
            except (DefinitionError, *ROS_ERRORS) as err:  # other middleware needs tf2_msgs
                self._log.warning(f'no subscription to {self._names[topic]}: {err}')
            else:
                self._open[topic] = partial(self._node.destroy_subscription, subscription)

    def close(self, topics: Collection[str] = (*_TOPICS,)) -> None:
        """Unsubscribe from topics."""
        for topic in {*topics} & self._open.keys():
            self._open.pop(topic)()


def missing_publishers(state: RobotState, is_read: bool, is_moving: bool) -> list[str]:
    """
    Return sentences about publishers that are missing, or that are too many.

    :param is_read: whether a description has arrived.
    :param is_moving: whether positions have arrived.
    """
    (description, states), (describing, moving) = state.topics, state.publishers
    notes = []
    if not describing:
        notes.append(f'No publisher on {description}.')
    elif not state.is_kept:
        notes.append(f'No new text on {description}: its publisher needs the durability '
                     'transient_local.')
    elif describing > 1:
        notes.append(f'{describing} publishers on {description}: the text that arrived last is '
                     'shown.')
    elif not is_read:
        notes.append(f'No text on {description} yet.')
    if not moving and not is_moving:
        notes.append(f'No publisher on {states}.')
    return notes
