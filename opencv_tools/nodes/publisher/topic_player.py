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

"""Playback of other topics of a bag, at the pace of its images or of the clock."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import closing
from dataclasses import dataclass
from threading import Condition, Thread
import time

from opencv_tools.bags.compression import decompressed_message
from opencv_tools.bags.errors import BagError
from opencv_tools.bags.offered_qos import KEEP_LAST, OfferedQos, read_offered_qos
from opencv_tools.bags.open_bag import open_bag_file
from opencv_tools.bags.reading import BagMessage, BagTopic, CDR, Damage
from opencv_tools.bags.schemas import CAMERA_INFO
from opencv_tools.base.logs import Log
from opencv_tools.base.text import printable
from opencv_tools.base.units import NANO
from opencv_tools.capture.bag import BagSource
from opencv_tools.capture.frame import Recorded
from opencv_tools.capture.player import LONG_WAIT_SECONDS
from opencv_tools.message_types.definition import DefinitionError, full_name
from opencv_tools.nodes.topic_patterns import matches
from opencv_tools.topics.errors import ROS_ERRORS, ros_reason
from opencv_tools.transport.message_type import message_type
from rclpy.duration import Duration
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy

_MAX_DEPTH = 1000
_UNKNOWN_DEPTH = 10  # of a publisher that keeps all messages, or does not announce how many
_TRANSIENT_LOCAL, _BEST_EFFORT = 1, 2  # see OfferedQos


def played_topics(source: BagSource, patterns: Sequence[str]) -> list[BagTopic]:
    """
    Return the topics that match, without those that are published with the images.

    Topics whose messages are not CDR, which cannot be published, are the last ones.
    """
    info = BagTopic(source.info_topic, CAMERA_INFO)
    return sorted((topic for topic in source.topics.keys() - {source.topic, info}
                   if matches(topic.name, patterns)),
                  key=lambda topic: (topic.serialization != CDR, topic.name, topic.type_name))


def playback_qos(topic: BagTopic, count: int) -> QoSProfile:
    """
    Return the profile of the one publisher that stands for all recorded ones.

    A late subscriber gets as many latched messages as all recorded publishers keep together. Fast
    DDS does not announce how many these are; then it gets all, at most 1000.

    :param topic: topic with the quality of service of its recorded publishers.
    """
    offers = read_offered_qos(topic.qos) or [OfferedQos()]
    is_latched = max(offer.durability for offer in offers) == _TRANSIENT_LOCAL
    are_known = all(offer.depth and offer.history == KEEP_LAST for offer in offers)
    depths = [offer.depth if offer.depth and offer.history == KEEP_LAST else _UNKNOWN_DEPTH
              for offer in offers]
    depth = max(depths) if not is_latched else (
        sum(depths) if are_known else max(sum(depths), count))
    return QoSProfile(
        history=HistoryPolicy.KEEP_LAST, depth=min(depth, _MAX_DEPTH),
        reliability=(ReliabilityPolicy.BEST_EFFORT
                     if max(offer.reliability for offer in offers) == _BEST_EFFORT
                     else ReliabilityPolicy.RELIABLE),
        durability=(DurabilityPolicy.TRANSIENT_LOCAL if is_latched
                    else DurabilityPolicy.VOLATILE))


def differences(publish_rate: float, stamp: str) -> list[str]:
    """
    Return sentences about the times and stamps of images that are not those of the bag.

    :param publish_rate: frames per second; 0.0 for the times of the bag.
    :param stamp: stamps of the images, as the parameter ``stamp``.
    """
    found = []
    if publish_rate:
        found.append(f'images are published at {publish_rate:g} Hz, and other topics between '
                     'them, not at the times of the bag; set publish_rate:=0.0 for these times')
    if stamp != 'original':
        found.append('other topics keep the stamps of the bag, images do not; set stamp:=original '
                     'for the stamps of the bag')
    return found


_MAX_WAIT_SECONDS = 3600.0  # times in a bag may be years apart
_PATIENCE_SECONDS = 2.0  # until a long wait is logged, because an image may end the wait


class Pace:
    """The frames and the clock, at which the messages of a bag wait."""

    def __init__(self, from_start: bool, on_long_wait: Callable[[float], object]) -> None:
        """
        Wait for the first frame.

        :param from_start: whether the messages before the first frame wait for their times.
        :param on_long_wait: called with the seconds of a wait of more than a minute.
        """
        self.changed = Condition()
        self.is_closed = False
        self._from_start = from_start
        self._on_long_wait = on_long_wait
        self._frame: Recorded | None = None  # the newest frame
        self._anchor: tuple[int, float] | None = None  # a time of the bag, and the time it was at
        self._reached = -1, -1  # play and time of the image that the messages have come to
        self._begun = -1  # play whose first frame is published
        self._ended = -1  # play whose messages are published
        self._is_finishing = False

    def advance(self, frame: Recorded) -> None:
        """
        Set the newest frame. A frame that is held comes again and changes nothing.

        The first frame of a play waits for the messages after the last frame of the play before,
        as ``finish`` does, and for the messages before itself.
        """
        with self.changed:
            last = self._frame
            if last and (last.play, last.log_ns) == (frame.play, frame.log_ns):
                return
            is_first = last is None or last.play != frame.play
            if is_first:
                self.finish()
                self._is_finishing = False
            self._frame = frame
            self.changed.notify_all()
            if is_first:
                self.changed.wait_for(
                    lambda: self._reached >= (frame.play, frame.log_ns) or self._is_over)
            self._begun, self._anchor = frame.play, (frame.log_ns, time.monotonic())
            self.changed.notify_all()

    def finish(self) -> None:
        """End the play at the next image, and wait for that."""
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
        """Set the play whose messages are all published."""
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
            self.changed.wait_for(lambda: self._is_finishing or self.is_closed or (
                self._begun >= play and self._is_past(play, log_ns)))
            return self._is_playing(play) and self._is_past(play, log_ns)

    def waits_until_due(self, play: int, log_ns: int, is_before: bool) -> bool:
        """
        Wait until a message is due, or the next frame is published; return False at the end.

        :param is_before: whether the message is before the first frame.
        """
        began, is_reported = time.monotonic(), False
        with self.changed:
            while self._is_playing(play):
                if self._anchor is None:
                    self._anchor = log_ns, time.monotonic()
                at_ns, at = self._anchor
                seconds = (log_ns - at_ns) / NANO - (time.monotonic() - at)
                if (seconds <= 0 or (is_before and not self._from_start)
                        or (not is_before and self._is_past(play, log_ns))):
                    return True
                longest = _MAX_WAIT_SECONDS
                if seconds > LONG_WAIT_SECONDS and not is_reported:
                    longest = began + _PATIENCE_SECONDS - time.monotonic()
                    if longest <= 0:
                        is_reported, longest = True, _MAX_WAIT_SECONDS
                        self._on_long_wait(seconds)
                self.changed.wait(min(seconds, longest))
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


_MAX_TOPICS = 500
_WARNING_SECONDS = 10.0
_CONFIRMATION_SECONDS = 2.0


@dataclass(frozen=True)
class _Playback:
    """
    A topic that is published.

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
