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

from collections.abc import Callable, Sequence
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
from opencv_tools.nodes.subscriber.left_out_topics import LeftOutTopics
from opencv_tools.nodes.subscriber.message_batches import MessageBatches, RecordedTopic
from opencv_tools.recording.bag_file import MessageBatch, RecordedMessage
from opencv_tools.recording.recorder import OnDone
from opencv_tools.topics.errors import ParameterError
from opencv_tools.topics.message_reader import MessageReader
from opencv_tools.topics.order import Position
from opencv_tools.topics.qos import following_qos
from opencv_tools.topics.topic_patterns import matches
from opencv_tools.topics.topic_types import TopicTypes
from opencv_tools.transport.message_type import message_type
from opencv_tools.transport.shared_frames.announcement import SUFFIX
from opencv_tools.video.messages import VIDEO_TOPICS
from rclpy.node import Node
from rclpy.topic_endpoint_info import TopicEndpointInfo

_DEPTH = 100  # messages of a topic that the middleware keeps
_POLL_SECONDS = 0.02
_BATCH_SECONDS = 0.1
_DISCOVERY_SECONDS = 0.5
_MAX_TAKEN = 1000  # messages of a topic before the next topic has its turn
_MAX_TOPICS = 500
_MAX_PUBLISHERS = 100
_WARNING_SECONDS = 10.0


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
        self._topics: dict[str, RecordedTopic] = {}
        self._left_out = LeftOutTopics(log)
        self._has_failed = False
        self._batches = MessageBatches(image_topic, put)
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
        """
        Log the account of the messages of each topic.

        :returns: False if the recording of the topics has failed. Messages that were dropped, and
            those that could not be written, are reported by the recorder.
        """
        self._batches.count_finished()
        topics = [self._topics[name] for name in sorted(self._topics)]
        for topic in topics:
            self._log.info(str(topic))
        if not topics:
            self._log.warning(f'No topic was recorded: none matches {" ".join(self._patterns)}')
        return not self._has_failed

    def _run(self) -> None:
        try:
            self._record()
        except Exception as err:  # noqa: B902 - the error of a thread would be lost
            if self._node.context.ok():  # else ROS was shut down before `close`
                self._has_failed = True
                self._log.error('the topics are not recorded any more: '
                                f'{type(err).__name__}: {err}')
        finally:
            self._batches.flush()

    def _record(self) -> None:
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

    def _discover(self) -> None:
        """Subscribe to the topics that have appeared."""
        found = dict(self._node.get_topic_names_and_types())
        self._left_out.keep(found)
        for name, types in found.items():
            if name not in self._topics and not self._is_wanted(name, found):
                continue
            identifiers = frozenset[bytes]()
            try:
                publishers = self._node.get_publishers_info_by_topic(name)[:_MAX_PUBLISHERS]
                identifiers = frozenset(bytes(info.endpoint_gid) for info in publishers)
                if name in self._topics:
                    self._follow(self._topics[name], identifiers, publishers)
                elif publishers and not self._left_out.has(name, identifiers):
                    self._add(name, types, identifiers, publishers)
            except (DefinitionError, ParameterError, RuntimeError, ValueError) as err:
                if not self._node.context.ok():
                    raise
                kind = 'a publisher of ' if name in self._topics else ''
                self._left_out.add(name, identifiers, f'{kind}{printable(name)}', str(err))

    def _follow(
        self, topic: RecordedTopic, identifiers: frozenset[bytes],
        publishers: list[TopicEndpointInfo],
    ) -> None:
        """Follow the quality of service of publishers that have changed."""
        if topic.publishers == identifiers:
            return
        name = topic.channel.topic
        topic.order.discover(identifiers)
        if {_type_hash(info) for info in publishers} - {topic.channel.type_hash}:
            self._log.warning(f'{name} has publishers with another definition of '
                              f'{topic.channel.type_name}; the bag has that of the first',
                              once=f'definition of {name}')
        qos = following_qos([info.qos_profile for info in publishers], _DEPTH)
        if publishers and qos != topic.qos:
            reader = MessageReader(self._node, topic.message_class, name, qos)
            self._drain(topic)
            topic.reader.destroy()
            topic.reader, topic.qos = reader, qos
        topic.publishers = identifiers

    def _is_wanted(self, name: str, names: dict[str, list[str]]) -> bool:
        """Return whether a topic matches, is not hidden, and is not a part of an image topic."""
        return (matches(name, self._patterns)
                and name not in self._excluded and '/_' not in name
                and not (name.endswith(SUFFIX) and name.removesuffix(SUFFIX) in names))

    def _add(
        self, name: str, types: list[str], identifiers: frozenset[bytes],
        publishers: list[TopicEndpointInfo],
    ) -> None:
        """
        Subscribe to a topic, if the type is known; else wait for it.

        :raises DefinitionError: the type cannot be recorded.
        :raises ParameterError: the topic cannot be subscribed to.
        """
        if len(types) > 1:
            raise DefinitionError(f'it has several types, {", ".join(map(printable, types))}')
        if len(self._topics) >= _MAX_TOPICS:
            raise DefinitionError(f'{_MAX_TOPICS} topics are, which is the limit')
        definition = self._types.find(publishers[0])
        if definition is None:
            return
        qos = following_qos([info.qos_profile for info in publishers], _DEPTH)
        message_class = message_type(definition.name, definition.text)
        topic = RecordedTopic(
            MessageReader(self._node, message_class, name, qos), BagChannel(
                topic=name, type_name=definition.name,
                qos=offered_qos_text(map(offered_qos, publishers)),
                type_hash=_type_hash(publishers[0]), definition=definition.text),
            message_class, qos)
        self._topics[name] = topic
        self._follow(topic, identifiers, publishers)
        self._log.info(f'Recording {name} ({definition.name})')

    def _take_all(self) -> None:
        for topic in self._topics.values():
            self._drain(topic)
        self._batches.count_finished()

    def _drain(self, topic: RecordedTopic) -> None:
        for _ in range(_MAX_TAKEN):
            if not self._take(topic):
                break

    def _take(self, topic: RecordedTopic) -> bool:
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
        try:
            if not topic.order.accepts(
                    bytes(info.publisher), Position(info.number), info.source_timestamp):
                return True  # a latched message comes again after a new subscription
        except CdrError as err:
            self._log.warning(f'{topic.channel.topic}: {err}', every=_WARNING_SECONDS,
                              key=topic.channel.topic)
        topic.received += 1
        log_ns = info.received_timestamp or time.time_ns()
        self._batches.add(topic, RecordedMessage(
            channel=topic.channel, parts=(data,), log_ns=log_ns,
            publish_ns=info.source_timestamp or log_ns, number=info.number))
        return True


def _type_hash(publisher: TopicEndpointInfo) -> str:
    """Return the hash of the type of a publisher; '' if it names none."""
    return str(publisher.topic_type_hash).replace('INVALID', '')
