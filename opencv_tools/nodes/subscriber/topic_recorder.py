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

"""Recording of other topics beside the frames: which ones, their batches and account."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Container, Iterable, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from threading import Event, Lock, Thread
import time

from opencv_tools.bags.offered_qos import offered_qos_text
from opencv_tools.bags.writing import BagChannel
from opencv_tools.base.logs import Log
from opencv_tools.base.text import enumerated, printable
from opencv_tools.image.errors import CdrError
from opencv_tools.image.topic_names import camera_info_topic, IMAGE_SUFFIXES
from opencv_tools.message_types.definition import DefinitionError, full_name
from opencv_tools.nodes.conversion import offered_qos
from opencv_tools.nodes.subscriber.topic_types import TopicTypes
from opencv_tools.nodes.topic_patterns import matches
from opencv_tools.recording.bag_sink import MessageBatch, RecordedMessage
from opencv_tools.recording.errors import Unwritten
from opencv_tools.recording.naming import FrameMetadata
from opencv_tools.recording.recorder import OnDone
from opencv_tools.topics.errors import ParameterError, ROS_ERRORS, ros_reason
from opencv_tools.topics.message_reader import MessageReader
from opencv_tools.topics.order import FrameOrder, Position
from opencv_tools.topics.qos import following_qos
from opencv_tools.transport.message_type import message_type
from opencv_tools.transport.shared_frames.announcement import SUFFIX
from rclpy.node import Node
from rclpy.qos import QoSProfile
from rclpy.topic_endpoint_info import TopicEndpointInfo


@dataclass(eq=False)
class RecordedTopic:
    """A topic that is recorded, and the account of its messages."""

    channel: BagChannel
    message_class: type = object
    reader: MessageReader | None = None  # with `qos`, while there are publishers
    qos: QoSProfile | None = None
    order: FrameOrder = field(default_factory=FrameOrder)
    publishers: frozenset[bytes] = frozenset()  # identifiers of those that are followed
    received: int = 0
    written: int = 0
    unwritten: Counter[str] = field(default_factory=Counter)  # by the kind of `Unwritten`

    def account(self, with_type: bool = False) -> str:
        """
        Return the account: received = written + dropped + failed + not processed + skipped.

        :param with_type: whether the type of the messages is named.
        """
        kind = f' ({self.channel.type_name})' if with_type else ''
        return (f'{self.channel.topic}{kind}: {self.received} messages received, {self.written} '
                f'written{self._unwritten("dropped", "failed")}, {self.order.count} lost in '
                f'transit{self.order.uncounted("message")}'
                + self._unwritten('not processed', 'skipped'))

    @property
    def losses(self) -> dict[str, int]:
        """Messages that are in no bag, counted by what became of them."""
        return {**self.unwritten, 'lost in transit': self.order.count}

    def _unwritten(self, *names: str) -> str:
        return ''.join(f', {count} {name}' for name in names if (count := self.unwritten[name]))


_BATCH_BYTES = 1 << 22
_MAX_TAKEN = 1000  # messages of a topic before the next topic has its turn
_WARNING_SECONDS = 10.0


_Taken = tuple[RecordedTopic, RecordedMessage]


class MessageBatches:
    """Messages that are recorded together, in the order of their arrival."""

    def __init__(
        self, image_topic: str, put: Callable[[MessageBatch, OnDone], object], log: Log,
    ) -> None:
        """
        Create a collector without messages.

        :param image_topic: topic of the frames after remapping.
        :param put: records messages; may wait.
        """
        self._image_topic = image_topic
        self._put = put
        self._log = log
        self._taken: list[_Taken] = []
        self._bytes = 0
        self._counting = Lock()

    def add(self, topic: RecordedTopic, message: RecordedMessage) -> None:
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
        self._put(batch, partial(self._count, taken, batch))

    def _count(self, taken: list[_Taken], batch: MessageBatch, outcome: Path | Unwritten) -> None:
        """Count the messages of a batch that were written or have failed; on any thread."""
        with self._counting:
            for topic, _ in taken[:batch.result.written]:
                topic.written += 1
            if isinstance(outcome, Unwritten):
                for topic, _ in taken[batch.result.written:]:
                    topic.unwritten[outcome.kind] += 1

    def take_all(self, topics: Iterable[RecordedTopic]) -> None:
        """Take and add the messages of topics that have arrived."""
        for topic in topics:
            for _ in range(_MAX_TAKEN):
                if not self._take(topic):
                    break

    def _take(self, topic: RecordedTopic) -> bool:
        """Take a message; return whether there was one."""
        try:
            taken = topic.reader.take_serialized() if topic.reader else None
        except RuntimeError as err:
            self._log.error(f'a message of {topic.channel.topic} cannot be received: '
                            f'{ros_reason(err)}', every=_WARNING_SECONDS,
                            key=topic.channel.topic)
            return False
        if taken is None:
            return False
        data, info = taken
        try:
            if not topic.order.accepts(bytes(info.publisher), Position(info.number)):
                return True  # a latched message comes again after a new subscription
        except CdrError as err:
            self._log.warning(f'{topic.channel.topic}: {err}', every=_WARNING_SECONDS,
                              key=topic.channel.topic)
        topic.received += 1
        log_ns = info.received_timestamp or time.time_ns()
        self.add(topic, RecordedMessage(
            channel=topic.channel, parts=(data,), log_ns=log_ns,
            publish_ns=info.source_timestamp or log_ns, number=info.number,
            publisher=bytes(info.publisher)))
        return True


_MAX_LOGGED = 1000  # reasons


class LeftOutTopics:
    """
    Log once why a topic is not recorded, and again after a change of its publishers.

    Only topics that exist are remembered.
    """

    def __init__(self, log: Log) -> None:
        self._log = log
        self._publishers: dict[str, frozenset[bytes]] = {}
        self._logged = 0

    def keep(self, names: Container[str]) -> None:
        """Forget all topics but those with some names."""
        self._publishers = {
            name: publishers for name, publishers in self._publishers.items() if name in names}

    def has(self, name: str, publishers: frozenset[bytes]) -> bool:
        """Return whether a topic was added with the same publishers."""
        return self._publishers.get(name) == publishers

    def add(self, name: str, publishers: frozenset[bytes], shown: str, reason: str) -> None:
        """
        Add a topic.

        :param shown: what is not recorded, for the log.
        """
        if self.has(name, publishers):
            return
        self._publishers[name] = publishers
        self._logged += 1
        if self._logged <= _MAX_LOGGED:
            self._log.warning(f'{shown} is not recorded: {reason}')
        else:
            self._log.warning(
                f'more than {_MAX_LOGGED} topics are not recorded; further reasons are not logged',
                once='topics left out')


_DEPTH = 100  # messages of a topic that the middleware keeps
_POLL_SECONDS = 0.02
_BATCH_SECONDS = 0.1
_DISCOVERY_SECONDS = 0.5
_MAX_TOPICS = 500
_MAX_PUBLISHERS = 100


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
        self._excluded = {image_topic, f'{image_topic}{SUFFIX}',
                          *(f'{image_topic}/{name}' for name in IMAGE_SUFFIXES)}
        for name in sorted(self._excluded.intersection(patterns)):
            log.warning(f'{name} is not recorded beside {image_topic}, because it has the same '
                        'images; the parameter transport chooses the form that is recorded')
        self._image_topic = image_topic
        self._log = log
        self._types = TopicTypes()
        self._topics: dict[str, RecordedTopic] = {}  # that are received now
        self._accounts: dict[tuple[str, str, str], RecordedTopic] = {}  # name, type, hash
        self._left_out = LeftOutTopics(log)
        self._asked: list[str] = []  # topics whose types were not known at the last discovery
        self._beyond = 0  # topics beyond the limit that were logged
        self._has_failed = False
        self._batches = MessageBatches(image_topic, put, log)
        self._is_closing = Event()
        self._thread = Thread(target=self._run, name='topics', daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Record the messages that have arrived, and unsubscribe."""
        self._is_closing.set()
        self._thread.join()
        self._types.close()
        for topic in self._topics.values():
            if topic.reader:
                topic.reader.destroy()

    def losses(self) -> dict[str, dict[str, int]]:
        """Return for each topic how many messages are in no bag until now; on any thread."""
        found: dict[str, Counter[str]] = {}
        for (name, *_), topic in [*self._accounts.items()]:
            found.setdefault(name, Counter()).update(topic.losses)
        return {**found}

    def log_summary(self) -> bool:
        """
        Log the account of the messages of each topic.

        :returns: False if the recording of the topics has failed. Messages that were dropped, and
            those that could not be written, are reported by the recorder.
        """
        counts = Counter(name for name, *_ in self._accounts)
        for key in sorted(self._accounts):
            self._log.info(self._accounts[key].account(with_type=counts[key[0]] > 1))
        if self._asked:
            self._log.warning(f'{enumerated([*map(printable, self._asked)])} not recorded: the '
                              'recording ended before the definition of the type was sent')
        elif not counts:
            self._log.warning(f'No topic was recorded beside the images: no other one '
                              f'matches {" ".join(self._patterns)}')
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
            self._batches.take_all(self._topics.values())
            if now >= flushed_at + _BATCH_SECONDS:
                self._batches.flush()
                flushed_at = now
        self._batches.take_all(self._topics.values())

    def _discover(self) -> None:
        """Subscribe to the topics that have appeared."""
        found = dict(self._node.get_topic_names_and_types())
        self._left_out.keep(found)
        self._asked.clear()
        beyond = []
        for name in found:
            if name not in self._topics and not self._is_wanted(name, found):
                continue
            identifiers = frozenset[bytes]()
            try:
                used = self._node.resolve_topic_name(name)
                if used != name:
                    raise ParameterError(
                        f'a remapping of this node replaces its name by {used}; leave the '
                        'remapping out, or record the topic with another node')
                publishers = self._node.get_publishers_info_by_topic(name)
                identifiers = _identifiers(publishers)
                if name in self._topics:
                    self._follow(self._topics[name], publishers)
                if (name not in self._topics and publishers
                        and not self._left_out.has(name, identifiers)
                        and not self._add(name, publishers)):
                    beyond.append(name)
            except (DefinitionError, ParameterError, *ROS_ERRORS) as err:
                if not self._node.context.ok():
                    raise
                kind = 'a publisher of ' if name in self._topics else ''
                self._left_out.add(name, identifiers, f'{kind}{printable(name)}', ros_reason(err))
        if len(beyond) > self._beyond and self._log.warning(
                f'{len(beyond)} topics are not recorded, such as {printable(min(beyond))}: '
                f'{_MAX_TOPICS} topics are, which is the limit',
                every=_WARNING_SECONDS, key='topics beyond the limit'):
            self._beyond = len(beyond)

    def _follow(self, topic: RecordedTopic, found: list[TopicEndpointInfo]) -> None:
        """
        Follow the quality of service of publishers that have changed.

        End the recording of a topic whose publishers all have another type.
        """
        identifiers = _identifiers(found)
        if topic.publishers == identifiers:
            return
        publishers = [info for info in found if _type_name(info) == topic.channel.type_name]
        if found and not publishers:
            self._unsubscribe(topic)
            del self._topics[topic.channel.topic]
            return
        _warn_of_types(self._log, topic.channel, found)
        if publishers:
            self._subscribe(topic, publishers)
        topic.publishers = identifiers

    def _subscribe(self, topic: RecordedTopic, publishers: list[TopicEndpointInfo]) -> None:
        """Subscribe with the quality of service of publishers, unless that has not changed."""
        qos = following_qos(
            [info.qos_profile for info in publishers[:_MAX_PUBLISHERS]], _DEPTH)
        if qos != topic.qos:
            reader = MessageReader(self._node, topic.message_class, topic.channel.topic, qos)
            self._unsubscribe(topic)
            topic.reader, topic.qos = reader, qos

    def _unsubscribe(self, topic: RecordedTopic) -> None:
        """Record the messages that have arrived, and unsubscribe."""
        if topic.reader:
            self._batches.take_all([topic])
            topic.reader.destroy()
        topic.reader = topic.qos = None

    def _is_wanted(self, name: str, names: dict[str, list[str]]) -> bool:
        """Return whether a topic matches, is not hidden, and is not a part of an image topic."""
        return (matches(name, self._patterns)
                and name not in self._excluded and '/_' not in name
                and name != camera_info_topic(self._image_topic, self._node.count_publishers)
                and not (name.endswith(SUFFIX) and name.removesuffix(SUFFIX) in names))

    def _add(self, name: str, publishers: list[TopicEndpointInfo]) -> bool:
        """
        Subscribe to a topic, if the type is known; else wait for it.

        :returns: False if the topic is beyond the limit.
        :raises DefinitionError: the type cannot be recorded.
        :raises ParameterError: the topic cannot be subscribed to.
        """
        types = sorted({*map(_type_name, publishers)})
        if len(types) > 1:
            raise DefinitionError(f'it has several types, {enumerated(types)}')
        key = name, types[0], _type_hash(publishers[0])
        if key not in self._accounts and len(self._accounts) >= _MAX_TOPICS:
            return False
        definition = self._types.find(publishers[0])
        if definition is None:
            self._asked.append(name)
            return True
        topic = self._accounts.get(key) or RecordedTopic(BagChannel(
            topic=name, type_name=definition.name, type_hash=key[2], definition=definition.text,
            qos=offered_qos_text(map(offered_qos, publishers[:_MAX_PUBLISHERS]))))
        topic.message_class = message_type(definition.name, definition.text)
        topic.publishers = frozenset()
        self._follow(topic, publishers)
        self._topics[name] = self._accounts[key] = topic
        self._log.info(f'Recording {name} ({definition.name})')
        return True


def _identifiers(publishers: list[TopicEndpointInfo]) -> frozenset[bytes]:
    return frozenset(bytes(info.endpoint_gid) for info in publishers[:_MAX_PUBLISHERS])


def _type_name(publisher: TopicEndpointInfo) -> str:
    """Return the full name of the type of a publisher; a printable text if it is no name."""
    try:
        return full_name(publisher.topic_type)
    except DefinitionError:
        return printable(publisher.topic_type)


def _type_hash(publisher: TopicEndpointInfo) -> str:
    """Return the hash of the type of a publisher; '' if it names none."""
    return str(publisher.topic_type_hash).replace('INVALID', '')


def _warn_of_types(log: Log, channel: BagChannel, found: list[TopicEndpointInfo]) -> None:
    """Warn once of publishers with another type, or with another definition of the type."""
    name, type_name = channel.topic, channel.type_name
    others = sorted({*map(_type_name, found)} - {type_name})
    if others:
        log.warning(
            f'{name} has publishers of {enumerated(others)}, whose messages are neither '
            f'recorded nor counted while there are publishers of {type_name}',
            once=f'types of {name}: {" ".join(others)}')
    if any(_type_hash(info) != channel.type_hash for info in found
           if _type_name(info) == type_name):
        log.warning(f'{name} has publishers with another definition of {type_name}; the bag has '
                    'that of the first', once=f'definition of {name}')
