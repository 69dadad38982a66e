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

"""Playback of the messages of other topics of a bag beside its images."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import closing
from dataclasses import dataclass
from threading import Thread
import time

from opencv_tools.bags.compression import decompressed_message
from opencv_tools.bags.errors import BagError
from opencv_tools.bags.open_bag import open_bag_file
from opencv_tools.bags.reading import BagMessage, BagTopic, CDR, Damage
from opencv_tools.capture.bag import BagSource
from opencv_tools.capture.frame import Recorded
from opencv_tools.image.text import printable
from opencv_tools.logs import Log
from opencv_tools.message_types.definition import DefinitionError, full_name
from opencv_tools.nodes.publisher.pace import Pace
from opencv_tools.nodes.publisher.played_topics import playback_qos, played_topics
from opencv_tools.topics.ros_errors import ROS_ERRORS, ros_reason
from opencv_tools.transport.message_type import message_type
from rclpy.duration import Duration
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import DurabilityPolicy

_MAX_TOPICS = 500
_WARNING_SECONDS = 10.0
_CONFIRMATION_SECONDS = 2.0


@dataclass(frozen=True)
class _Playback:
    """
    A topic that is published.

    :param publisher: its publisher.
    :param message_class: class of the messages.
    :param definition: text of their type; '' if the bag has none.
    :param is_latched: whether late subscribers get the last messages.
    """

    publisher: Publisher
    message_class: type
    definition: str
    is_latched: bool


class TopicPlayer:
    """
    Publish the messages of a bag at their times between its images, in a thread.

    The thread reads the images of the bag as well, and waits at each until its frame is published.
    Therefore the messages keep their place among the frames at any rate and in any pause.
    """

    def __init__(
        self, node: Node, source: BagSource, patterns: Sequence[str], log: Log, *,
        from_start: bool,
    ) -> None:
        """
        Create the publishers.

        :param source: bag that is played.
        :param patterns: names of topics in the bag; ``*`` stands for any characters.
        :param from_start: whether the first image of the bag is played first. Else the messages
            before the first frame are left out, except those that are latched.
        """
        self.count = 0  # published messages
        self._node = node
        self._log = log
        self._image = source.topic
        self._paths = source.paths
        self._from_start = from_start
        wanted = played_topics(source, patterns)
        if len(wanted) > _MAX_TOPICS:
            log.warning(f'{len(wanted) - _MAX_TOPICS} topics of the bag are not published, from '
                        f'{printable(wanted[_MAX_TOPICS].name)} on: {len(wanted)} match, '
                        f'{_MAX_TOPICS} are the limit')
        self._playbacks = {
            topic: playback for topic in wanted[:_MAX_TOPICS]
            if (playback := self._create_playback(topic, source.topics[topic])) is not None}
        names = sorted(topic.name for topic in self._playbacks)
        if names:
            log.info(f'Publishing {len(names)} topics of the bag: {" ".join(names)}')
        elif not wanted:
            log.warning(f'No topic of the bag is published: none matches {" ".join(patterns)}')
        self._pace = Pace(from_start, lambda seconds: log.info(
            f'the next message of other topics is due in {seconds:.0f} s, or with the next image'))
        self._thread = Thread(target=self._run, name='topics', daemon=True)
        self._thread.start()

    def advance(self, frame: Recorded) -> None:
        """
        Publish the messages before a frame, and from now on those after it at their times.

        The first frame of each play waits for the messages before it, and for those after the
        last frame of the play before.
        """
        self._pace.advance(frame)

    def finish(self) -> None:
        """Wait for the messages between the last frame and the next image, or for ``close``."""
        self._pace.finish()
        deadline = time.monotonic() + _CONFIRMATION_SECONDS
        for playback in self._playbacks.values():
            seconds = deadline - time.monotonic()
            if seconds > 0 and not self._pace.is_closed:
                playback.publisher.wait_for_all_acked(Duration(seconds=seconds))

    def close(self) -> None:
        """End the playback."""
        self._pace.close()
        self._thread.join()

    def _run(self) -> None:
        first: Recorded | None = None
        while first := self._pace.next_play(first):
            try:
                self._play(first.play, first.log_ns)
            except (BagError, OSError, RuntimeError) as err:
                self._log.error(f'the topics of the bag are not published any more: {err}')
            self._pace.end_play(first.play)

    def _play(self, play: int, first_ns: int) -> None:
        """Publish the messages of one play, whose first frame has a time in the bag."""
        for message in self._messages():
            is_image, is_before = message.topic == self._image, message.log_ns < first_ns
            if is_before and (is_image or not (
                    self._from_start or self._playbacks[message.topic].is_latched)):
                continue
            if is_image:
                if not self._pace.waits_for_frame(play, message.log_ns):
                    return
            elif self._pace.waits_until_due(play, message.log_ns, is_before):
                self._publish(message)
            else:
                return

    def _messages(self) -> Iterator[BagMessage]:
        """Yield the messages of the topics, and the images."""
        for path in self._paths:
            with closing(open_bag_file(path)) as reader:
                for message in reader.messages([self._image, *self._playbacks]):
                    if isinstance(message, Damage):
                        self._log.warning(message.reason, every=_WARNING_SECONDS, key='damage')
                    else:
                        yield message

    def _publish(self, message: BagMessage) -> None:
        playback = self._playbacks[message.topic]
        if not self._has_type(message.topic, playback):
            return
        try:
            serialized = bytes(decompressed_message(message.load()))
        except (BagError, OSError) as err:
            self._log.warning(
                f'a message of {printable(message.topic.name)} cannot be read: {err}',
                every=_WARNING_SECONDS, key=message.topic.name)
        else:
            playback.publisher.publish(serialized)
            self.count += 1

    def _has_type(self, topic: BagTopic, playback: _Playback) -> bool:
        """Return whether messages have the type that is published; log it once if not."""
        if topic.definition in ('', playback.definition):
            return True
        try:
            if message_type(full_name(topic.type_name),
                            topic.definition) is playback.message_class:
                return True
        except DefinitionError:
            pass
        self._log.warning(
            f'messages of {printable(topic.name)} are not published: their definition of '
            f'{printable(topic.type_name)} is not that of the first ones',
            once=f'definition of {topic.name}')
        return False

    def _create_playback(self, topic: BagTopic, count: int) -> _Playback | None:
        try:
            if topic.serialization != CDR:
                raise DefinitionError(
                    f'its messages are {printable(topic.serialization)}, not {CDR}')
            message_class = message_type(full_name(topic.type_name), topic.definition or None)
            qos = playback_qos(topic, count)
            publisher = self._node.create_publisher(message_class, topic.name, qos)
        except (DefinitionError, *ROS_ERRORS) as err:
            self._log.warning(
                f'{printable(topic.name)} is not published: {printable(ros_reason(err))}')
            return None
        return _Playback(publisher, message_class, topic.definition,
                         qos.durability == DurabilityPolicy.TRANSIENT_LOCAL)
