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

"""Recording of the messages of other topics beside the frames, as they were received."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from threading import Event, Thread
import time

from opencv_tools.bags.offered_qos import offered_qos_text
from opencv_tools.bags.schemas import camera_info_topic
from opencv_tools.bags.writing import BagChannel
from opencv_tools.image.errors import CdrError
from opencv_tools.image.text import printable
from opencv_tools.logs import Log
from opencv_tools.message_types.definition import DefinitionError
from opencv_tools.nodes.subscriber.bag_messages import offered_qos
from opencv_tools.recording.bag_file import MessageBatch, RecordedMessage
from opencv_tools.recording.naming import FrameMetadata
from opencv_tools.recording.recorder import OnDone
from opencv_tools.topics.errors import ParameterError
from opencv_tools.topics.message_reader import MessageReader
from opencv_tools.topics.order import FrameOrder, Position
from opencv_tools.topics.qos import following_qos
from opencv_tools.topics.topic_patterns import matches
from opencv_tools.topics.topic_types import TopicTypes
from opencv_tools.transport.message_type import message_type
from opencv_tools.transport.shared_frames.announcement import SUFFIX
from opencv_tools.video.messages import VIDEO_TOPICS
from rclpy.node import Node
from rclpy.qos import QoSProfile
from rclpy.topic_endpoint_info import TopicEndpointInfo

_DEPTH = 100  # messages of a topic that the middleware keeps
_POLL_SECONDS = 0.02
_BATCH_SECONDS = 0.1
_BATCH_BYTES = 1 << 22
_DISCOVERY_SECONDS = 0.5
_MAX_TAKEN = 1000  # messages of a topic before the next topic has its turn
_MAX_TOPICS = 500
_MAX_LEFT_OUT = 1000  # others whose names are remembered
_MAX_PUBLISHERS = 100
_WARNING_SECONDS = 10.0


@dataclass(eq=False)
class _Topic:
    """A topic that is recorded, and what became of its messages."""

    reader: MessageReader
    channel: BagChannel
    message_class: type
    qos: QoSProfile
    order: FrameOrder = field(default_factory=FrameOrder)
    publishers: int = 0
    received: int = 0
    written: int = 0

    def __str__(self) -> str:
        """Return the account of the messages."""
        return (f'{self.channel.topic}: {self.received} messages received, {self.written} '
                f'written, {self.order.count} lost in transit'
                + ('' if self.order.is_complete else ' since the first received message'))


class _Batches:
    """Messages that are recorded together, in the order of their arrival."""

    def __init__(self, image_topic: str, put: Callable[[MessageBatch, OnDone], object]) -> None:
        self._image_topic = image_topic
        self._put = put
        self._taken: list[tuple[_Topic, RecordedMessage]] = []
        self._bytes = 0
        self._finished: deque[tuple[list[tuple[_Topic, RecordedMessage]], MessageBatch]] = deque()

    def add(self, topic: _Topic, message: RecordedMessage) -> None:
        """Add a message, and record the batch if it is large."""
        self._taken.append((topic, message))
        self._bytes += message.size
        if self._bytes >= _BATCH_BYTES:
            self.flush()

    def flush(self) -> None:
        """Record the messages that were added."""
        if not self._taken:
            return
        taken = sorted(self._taken, key=lambda item: item[1].log_ns)
        self._taken, self._bytes = [], 0
        first = taken[0][1].log_ns
        batch = MessageBatch(
            metadata=FrameMetadata(first, '', '', self._image_topic), receive_ns=first,
            messages=tuple(message for _, message in taken))
        self._put(batch, lambda _: self._finished.append((taken, batch)))

    def count_finished(self) -> None:
        """Count the messages of batches that were written or have failed."""
        while self._finished:
            taken, batch = self._finished.popleft()
            for topic, _ in taken[:batch.result.written]:
                topic.written += 1


class TopicRecorder:
    """
    Record the messages of the topics that match patterns, in a thread.

    The thread takes the messages some times a second. The middleware has noted when each arrived.
    """

    def __init__(
        self, node: Node, patterns: Sequence[str], image_topic: str, log: Log,
        put: Callable[[MessageBatch, OnDone], object],
    ) -> None:
        """
        Start looking for topics.

        :param patterns: names of topics after remapping; ``*`` stands for any characters.
        :param image_topic: topic of the frames after remapping, which is recorded elsewhere.
        :param put: records messages; may wait.
        """
        self._node = node
        self._patterns = patterns
        self._excluded = {image_topic, f'{image_topic}/compressed', f'{image_topic}{SUFFIX}',
                          *(f'{image_topic}/{name}' for name in VIDEO_TOPICS.values()),
                          camera_info_topic(image_topic)}
        self._log = log
        self._types = TopicTypes(node)
        self._topics: dict[str, _Topic] = {}
        self._left_out: dict[str, frozenset[bytes]] = {}
        self._batches = _Batches(image_topic, put)
        self._is_closing = Event()
        self._thread = Thread(target=self._run, name='topics', daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Record the messages that have arrived, and unsubscribe."""
        self._is_closing.set()
        self._thread.join()
        for topic in self._topics.values():
            topic.reader.destroy()

    def log_summary(self) -> bool:
        """Log what became of the messages of each topic; return whether all were written."""
        self._batches.count_finished()
        topics = [self._topics[name] for name in sorted(self._topics)]
        for topic in topics:
            self._log.info(str(topic))
        if not topics:
            self._log.warning(f'No topic was recorded: none matches {" ".join(self._patterns)}')
        return all(topic.written == topic.received for topic in topics)

    def _run(self) -> None:
        flushed_at = discovered_at = 0.0
        while not self._is_closing.wait(_POLL_SECONDS):
            now = time.monotonic()
            if now >= discovered_at + _DISCOVERY_SECONDS:
                self._discover()
                discovered_at = now
            self._take_all()
            if now >= flushed_at + _BATCH_SECONDS:
                self._batches.flush()
                flushed_at = now
        self._take_all()
        self._batches.flush()

    def _discover(self) -> None:
        """Subscribe to the topics that have appeared."""
        found = dict(self._node.get_topic_names_and_types())
        for name, types in found.items():
            topic = self._topics.get(name)
            if topic is None:
                if self._is_wanted(name, found):
                    self._add(name, types)
            elif topic.publishers != self._node.count_publishers(name):
                self._follow(topic, self._publishers(name))

    def _follow(self, topic: _Topic, publishers: list[TopicEndpointInfo]) -> None:
        """Follow the quality of service of publishers that have changed."""
        name = topic.channel.topic
        topic.publishers = self._node.count_publishers(name)
        topic.order.discover(bytes(info.endpoint_gid) for info in publishers)
        if {_type_hash(info) for info in publishers} - {topic.channel.type_hash}:
            self._log.warning(f'{name} has publishers with another definition of '
                              f'{topic.channel.type_name}; the bag has that of the first',
                              once=f'definition of {name}')
        qos = following_qos([info.qos_profile for info in publishers], _DEPTH)
        if publishers and qos != topic.qos:
            self._drain(topic)
            topic.reader.destroy()
            topic.qos = qos
            topic.reader = MessageReader(self._node, topic.message_class, name, qos)

    def _is_wanted(self, name: str, names: dict[str, list[str]]) -> bool:
        """Return whether a topic matches, is not hidden, and is not a part of an image topic."""
        return (matches(name, self._patterns)
                and name not in self._excluded and '/_' not in name
                and not (name.endswith(SUFFIX) and name.removesuffix(SUFFIX) in names))

    def _publishers(self, name: str) -> list[TopicEndpointInfo]:
        return self._node.get_publishers_info_by_topic(name)[:_MAX_PUBLISHERS]

    def _add(self, name: str, types: list[str]) -> None:
        """Subscribe to a topic, if its type is known; else tell why not, once."""
        publishers = self._publishers(name)
        identifiers = frozenset(bytes(info.endpoint_gid) for info in publishers)
        if (not publishers or self._left_out.get(name) == identifiers
                or len(self._left_out) >= _MAX_LEFT_OUT):
            return
        try:
            if len(types) > 1:
                raise DefinitionError(
                    f'it has several types, {", ".join(map(printable, types))}')
            if len(self._topics) >= _MAX_TOPICS:
                raise DefinitionError(f'{_MAX_TOPICS} topics are, which is the limit')
            definition = self._types.find(publishers[0])
            if definition is None:
                return
            qos = following_qos([info.qos_profile for info in publishers], _DEPTH)
            message_class = message_type(definition.name, definition.text)
            reader = MessageReader(self._node, message_class, name, qos)
        except (DefinitionError, ParameterError) as err:
            self._left_out[name] = identifiers
            self._log.warning(f'{printable(name)} is not recorded: {err}')
            return
        self._topics[name] = _Topic(reader, BagChannel(
            topic=name, type_name=definition.name,
            qos=offered_qos_text(map(offered_qos, publishers)),
            type_hash=_type_hash(publishers[0]), definition=definition.text),
            message_class, qos)
        self._follow(self._topics[name], publishers)
        self._log.info(f'Recording {name} ({definition.name})')

    def _take_all(self) -> None:
        for topic in self._topics.values():
            self._drain(topic)
        self._batches.count_finished()

    def _drain(self, topic: _Topic) -> None:
        for _ in range(_MAX_TAKEN):
            if not self._take(topic):
                break

    def _take(self, topic: _Topic) -> bool:
        """Take a message; return whether there was one."""
        try:
            taken = topic.reader.take_serialized()
        except RuntimeError as err:
            self._log.error(f'a message of {topic.channel.topic} cannot be received: {err}',
                            every=_WARNING_SECONDS, key=topic.channel.topic)
            return False
        if taken is None:
            return False
        data, info = taken
        topic.received += 1
        try:
            topic.order.accepts(
                bytes(info.publisher), Position(info.number), info.source_timestamp)
        except CdrError as err:
            self._log.warning(f'{topic.channel.topic}: {err}', every=_WARNING_SECONDS,
                              key=topic.channel.topic)
        log_ns = info.received_timestamp or time.time_ns()
        self._batches.add(topic, RecordedMessage(
            channel=topic.channel, parts=(data,), log_ns=log_ns,
            publish_ns=info.source_timestamp or log_ns, number=info.number))
        return True


def _type_hash(publisher: TopicEndpointInfo) -> str:
    """Return the hash of the type of a publisher; '' if it names none."""
    return str(publisher.topic_type_hash).replace('INVALID', '')
