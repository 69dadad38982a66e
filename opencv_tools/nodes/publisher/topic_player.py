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
from threading import Condition, Thread
import time

from opencv_tools.bags.compression import decompressed_message
from opencv_tools.bags.errors import BagError
from opencv_tools.bags.offered_qos import OfferedQos, read_offered_qos
from opencv_tools.bags.open_bag import open_bag_file
from opencv_tools.bags.reading import BagMessage, BagTopic, CDR, Damage
from opencv_tools.bags.schemas import CAMERA_INFO, camera_info_topic
from opencv_tools.capture.bag import BagSource
from opencv_tools.capture.frame import Recorded
from opencv_tools.image.text import printable
from opencv_tools.logs import Log
from opencv_tools.message_types.definition import DefinitionError, full_name
from opencv_tools.topics.topic_patterns import matches
from opencv_tools.transport.message_type import message_type
from opencv_tools.units import NANO
from rclpy.duration import Duration
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy

_MAX_DEPTH = 1000
_MAX_TOPICS = 500
_WARNING_SECONDS = 10.0
_CONFIRMATION_SECONDS = 2.0
_MAX_WAIT_SECONDS = 3600.0  # times in a bag may be years apart
_TRANSIENT_LOCAL, _BEST_EFFORT = 1, 2  # see OfferedQos


class _Pace:
    """The frames and the clock, at which the messages of a bag wait."""

    def __init__(self, from_start: bool) -> None:
        self.changed = Condition()
        self.is_closed = False
        self._from_start = from_start
        self._frame: Recorded | None = None  # the newest frame
        self._anchor: tuple[int, float] | None = None  # a time of the bag, and the time it was at
        self._reached = -1, -1  # play and time of the image that the messages have come to
        self._ended = -1  # play whose messages are published
        self._is_finishing = False

    def advance(self, frame: Recorded) -> None:
        """Set the newest frame; the first one of a play waits for the messages before it."""
        with self.changed:
            is_first = self._frame is None or self._frame.play != frame.play
            self._frame = frame
            self.changed.notify_all()
            if is_first:
                self.changed.wait_for(
                    lambda: self._reached >= (frame.play, frame.log_ns) or self._is_over)
            self._anchor = frame.log_ns, time.monotonic()
            self.changed.notify_all()

    def finish(self) -> None:
        """End at the next image, and wait for that."""
        with self.changed:
            self._is_finishing = True
            self.changed.notify_all()
            self.changed.wait_for(lambda: self._frame is None or self._is_over)

    def close(self) -> None:
        """End all waits."""
        with self.changed:
            self.is_closed = True
            self.changed.notify_all()

    def end_play(self, play: int) -> None:
        """Tell that all messages of a play are published."""
        with self.changed:
            self._ended = play
            self.changed.notify_all()

    def next_play(self, last: Recorded | None) -> Recorded | None:
        """Wait for the first frame of another play than that of a frame; None at the end."""
        with self.changed:
            while not self.is_closed and (
                    self._frame is None or (last and self._frame.play == last.play)):
                self.changed.wait()
            self._anchor = None
            return None if self.is_closed else self._frame

    def waits_for_frame(self, play: int, log_ns: int) -> bool:
        """Wait at an image until its frame or a later one is published; False at the end."""
        with self.changed:
            self._reached = play, log_ns
            self.changed.notify_all()
            self.changed.wait_for(lambda: (
                self._is_finishing or self.is_closed or self._is_past(play, log_ns)))
            return self._is_playing(play) and self._is_past(play, log_ns)

    def waits_until_due(self, play: int, log_ns: int, is_before: bool) -> bool:
        """
        Wait until a message is due, or the next frame is published; return False at the end.

        :param is_before: whether the message is before the first frame.
        """
        with self.changed:
            while self._is_playing(play):
                if self._anchor is None:
                    self._anchor = log_ns, time.monotonic()
                at_ns, at = self._anchor
                seconds = (log_ns - at_ns) / NANO - (time.monotonic() - at)
                if (seconds <= 0 or (is_before and not self._from_start)
                        or (not is_before and self._is_past(play, log_ns))):
                    return True
                self.changed.wait(min(seconds, _MAX_WAIT_SECONDS))
            return False

    @property
    def _is_over(self) -> bool:
        return self.is_closed or (self._frame is not None and self._ended >= self._frame.play)

    def _is_playing(self, play: int) -> bool:
        return not self.is_closed and self._frame is not None and self._frame.play == play

    def _is_past(self, play: int, log_ns: int) -> bool:
        """Return whether a frame of a time or a later one is published."""
        return self._frame is not None and (
            self._frame.play, self._frame.log_ns) >= (play, log_ns)


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
        self._publishers = {
            topic: publisher for topic in _wanted(source, patterns)[:_MAX_TOPICS]
            if (publisher := self._create_publisher(topic)) is not None}
        names = sorted(topic.name for topic in self._publishers)
        if names:
            log.info(f'Publishing {len(names)} topics of the bag: {" ".join(names)}')
        else:
            log.warning(f'No topic of the bag is published: none matches {" ".join(patterns)}')
        self._pace = _Pace(from_start)
        self._thread = Thread(target=self._run, name='topics', daemon=True)
        self._thread.start()

    def advance(self, frame: Recorded) -> None:
        """
        Let the messages before a frame be published, then those after it at their times.

        The first frame of each play waits for the messages before it.
        """
        self._pace.advance(frame)

    def finish(self) -> None:
        """Wait for the messages between the last frame and the next image, or for ``close``."""
        self._pace.finish()
        deadline = time.monotonic() + _CONFIRMATION_SECONDS
        for publisher in self._publishers.values():
            seconds = deadline - time.monotonic()
            if seconds > 0 and not self._pace.is_closed:
                publisher.wait_for_all_acked(Duration(seconds=seconds))

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
            if is_before and (is_image or not (self._from_start or _is_latched(message.topic))):
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
                for message in reader.messages([self._image, *self._publishers]):
                    if isinstance(message, Damage):
                        self._log.warning(message.reason, every=_WARNING_SECONDS, key='damage')
                    else:
                        yield message

    def _publish(self, message: BagMessage) -> None:
        try:
            serialized = bytes(decompressed_message(message.load()))
        except (BagError, OSError) as err:
            self._log.warning(
                f'a message of {printable(message.topic.name)} cannot be read: {err}',
                every=_WARNING_SECONDS, key=message.topic.name)
        else:
            self._publishers[message.topic].publish(serialized)
            self.count += 1

    def _create_publisher(self, topic: BagTopic) -> Publisher | None:
        try:
            return self._node.create_publisher(
                message_type(full_name(topic.type_name), topic.definition or None), topic.name,
                _qos(topic))
        except (DefinitionError, RuntimeError, ValueError) as err:
            self._log.warning(f'{printable(topic.name)} is not published: {printable(err)}')
            return None


def _wanted(source: BagSource, patterns: Sequence[str]) -> list[BagTopic]:
    """Return the topics that match, without those that are published with the images."""
    info = BagTopic(camera_info_topic(source.topic.name), CAMERA_INFO)
    return sorted((topic for topic in source.topics - {source.topic, info}
                   if topic.serialization == CDR
                   and matches(topic.name, patterns)),
                  key=lambda topic: topic.name)


def _offer(topic: BagTopic) -> OfferedQos:
    """Return what all publishers of a topic have offered."""
    offers = read_offered_qos(topic.qos) or [OfferedQos()]
    return OfferedQos(
        depth=max(offer.depth for offer in offers),
        reliability=max(offer.reliability for offer in offers),
        durability=max(offer.durability for offer in offers))


def _is_latched(topic: BagTopic) -> bool:
    return _offer(topic).durability == _TRANSIENT_LOCAL


def _qos(topic: BagTopic) -> QoSProfile:
    offer = _offer(topic)
    return QoSProfile(
        history=HistoryPolicy.KEEP_LAST, depth=min(max(1, offer.depth), _MAX_DEPTH),
        reliability=(ReliabilityPolicy.BEST_EFFORT if offer.reliability == _BEST_EFFORT
                     else ReliabilityPolicy.RELIABLE),
        durability=(DurabilityPolicy.TRANSIENT_LOCAL if offer.durability == _TRANSIENT_LOCAL
                    else DurabilityPolicy.VOLATILE))
