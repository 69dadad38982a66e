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

"""The image topic of a subscription: the readers of its messages, as its publishers require."""

from __future__ import annotations

from collections.abc import Callable, Iterator
import time

from opencv_tools.base.logs import Log
from opencv_tools.image.errors import CdrError
from opencv_tools.topics.message_reader import ImageReader
from opencv_tools.topics.order import Position
from opencv_tools.topics.qos import describe_qos, following_qos, qos_mismatch
from opencv_tools.topics.queue import FrameQueue, QueuedFrame, ReceivedMessage
from opencv_tools.topics.topic_discovery import ImageTopic, TopicDiscovery
from opencv_tools.video.publisher_decoders import VideoDecoding
from rclpy.qos import DurabilityPolicy, QoSProfile

# Time in which every publisher discovers a new subscription, also over a slow network.
_OVERLAP_SECONDS = 1.0
# Frames that wait at the end, and one more than Fast DDS keeps for a subscription.
_MAX_MESSAGES = 5001
# Messages of video that wait, because a later one needs each of them.
_VIDEO_DEPTH = 60


class ImageSource:
    """
    Put the messages of the image topic into the queue; used in the executor only.

    The first reader is reliable and volatile, like most image publishers. The source subscribes
    again when a publisher offers less, and when all publishers are new and offer more. A publisher
    that leaves changes nothing. The old reader overlaps with the new one for a second.

    With several possible topics the first reader waits until those of a publisher on another host
    are known. The source changes to another topic after the first frame only when the last
    publisher has left.
    """

    def __init__(
        self, discovery: TopicDiscovery, depth: int | None, queue: FrameQueue, log: Log,
        before_message: Callable[[bytes], object], on_readers: Callable[[], object],
    ) -> None:
        """
        Choose a topic, without a reader until ``use`` is called.

        :param depth: number of messages that may wait; None for all.
        :param queue: queue that gets the frames.
        :param before_message: called with the publisher of a message before it is put.
        :param on_readers: called when ``readers`` has changed.
        """
        self._node = discovery.node
        self._discovery = discovery
        self._depth = depth
        self._queue = queue
        self._log = log
        self._before_message = before_message
        self._on_readers = on_readers
        #: Decoder of video; None to put the messages of video into the queue.
        self.decoding: VideoDecoding | None = None
        self._candidate: ImageTopic | None = None
        self._count_before = 0  # frames before the first publisher appeared
        #: Identifiers of the publishers that were found last.
        self.publishers: frozenset[bytes] = frozenset()
        #: The chosen topic.
        self.topic = discovery.best() or discovery.allowed[0]
        #: Requested quality of service.
        self.qos = self._best_qos(self.topic)
        #: Whether the topic may be subscribed to, because it is the choice.
        self.is_chosen = False
        self._reader: ImageReader | None = None
        self._previous: ImageReader | None = None
        self._retire_at = 0.0

    @property
    def topic_name(self) -> str:
        """Name of the topic after remapping."""
        return self._node.resolve_topic_name(self.topic.name)

    @property
    def is_used(self) -> bool:
        """Whether messages are received."""
        return self._reader is not None

    @property
    def is_latched(self) -> bool:
        """Whether the publishers keep their last messages for later subscriptions."""
        return bool(self.qos.durability == DurabilityPolicy.TRANSIENT_LOCAL)

    @property
    def has_frames(self) -> bool:
        """Whether frames have arrived since the first publisher appeared."""
        return self._queue.count > self._count_before

    @property
    def readers(self) -> list[ImageReader]:
        """Return the readers, oldest first; thread-safe."""
        return [reader for reader in (self._previous, self._reader) if reader]

    def use(self, is_used: bool) -> None:
        """Subscribe to the chosen topic, or receive the waiting messages and unsubscribe."""
        is_chosen = self._choose()  # also if all frames are shared from the beginning
        if is_used and self._reader is None and is_chosen:
            self._reader = ImageReader(self._node, self.topic, self.qos)
            self._change_readers()
        elif not is_used and self._reader:
            self._retire_previous()
            self._previous, self._reader = self._reader, None
            self._retire_previous()

    def receive(self, reader: ImageReader, *, keeps_all: bool = False) -> int | None:
        """
        Put a message into the queue.

        :param keeps_all: whether the queue may exceed its capacity.
        :returns: its time of reception in nanoseconds, 0 if unknown; None without a message.
        """
        received_ns: int | None = None
        for message, info in reader.take():
            received_ns = info.received_timestamp if info else 0
            publisher = bytes(info.publisher) if info else b''
            self._before_message(publisher)
            image = self.decoding.decode(
                message, publisher, info.number if info else 0) if self.decoding else message
            if image is None:
                self._queue.leave_out(publisher, Position(info.number) if info else None)
                continue
            frame: QueuedFrame = image if isinstance(image, CdrError) else ReceivedMessage(
                image, received_ns or time.time_ns(),
                publish_ns=info.source_timestamp if info else 0,
                number=info.number if info else 0, publisher=publisher)
            self._queue.put(frame, publisher, Position(info.number) if info else None,
                            keeps_all=keeps_all)
        return received_ns

    def drain(self) -> None:
        """Put the messages that were received until now into the queue."""
        for reader in self.readers:
            self._drain(reader)

    def received_until_now(
        self, reader: ImageReader, *, keeps_all: bool = False,
    ) -> Iterator[None]:
        """Put the messages that were received until now into the queue, one for each step."""
        now = time.time_ns()
        for _ in range(_MAX_MESSAGES):
            received_ns = self.receive(reader, keeps_all=keeps_all)
            if received_ns is None:
                return
            yield
            if received_ns >= now:
                return

    def adapt(self) -> bool:
        """
        Subscribe again if the profiles are incompatible, or new publishers offer more.

        :returns: whether the publishers have changed.
        """
        offers = self._discovery.publishers(self.topic)
        qos = self._best_qos(self.topic)
        publishers = frozenset(bytes(info.endpoint_gid) for info in offers)
        are_new = not self.publishers & publishers
        have_changed = publishers != self.publishers
        if have_changed:
            self.publishers = publishers
        if offers and qos != self.qos and (are_new or any(
                qos_mismatch(info.qos_profile, self.qos) for info in offers)):
            self._subscribe_again(self.topic, qos)
        return have_changed

    def choose_topic(self) -> bool:
        """
        Change the topic if it has no publisher, or no frames yet and another one is better.

        :returns: whether the topic has changed.
        """
        if not self.is_chosen or len(self._discovery.allowed) == 1 or (
                self.has_frames and self._discovery.publishers(self.topic)
                and not self._discovery.prefers_video(self.topic)):
            return False
        self._count_before = self._queue.count
        best = self._discovery.best() or self.topic
        # The topics of a camera do not appear at the same time; a better one may follow.
        if best not in (self.topic, self._candidate):
            self._candidate = best
            return False
        self._candidate = None
        if best == self.topic:
            return False
        self._subscribe_again(best, self._best_qos(best))
        return True

    def retire_when_due(self) -> None:
        """Remove the old reader, once every publisher has discovered the new one."""
        if self._previous and time.monotonic() >= self._retire_at:
            self._retire_previous()

    def destroy(self) -> None:
        """Unsubscribe."""
        for reader in self.readers:
            reader.destroy()
        self._reader = self._previous = None

    def _choose(self) -> bool:
        """Return whether a topic is chosen; choose the best one if that is possible."""
        if not self.is_chosen and self._discovery.is_complete():
            self.is_chosen, waited_for = True, self.topic
            self.topic = self._discovery.best() or self.topic
            self.qos = self._best_qos(self.topic)
            if self.topic != waited_for:
                self._log_topic()
        return self.is_chosen

    def _log_topic(self) -> None:
        self._log.info(f'Receiving {self.topic_name} ({self.topic.type_name}, '
                       f'{describe_qos(self.qos)}), as its publishers offer')

    def _best_qos(self, topic: ImageTopic) -> QoSProfile:
        """Return the quality of service that the publishers of a topic offer."""
        depth = self._depth
        if depth is not None and topic.is_video:
            depth = max(depth, _VIDEO_DEPTH)
        return following_qos(
            [info.qos_profile for info in self._discovery.publishers(topic)], depth)

    def _drain(self, reader: ImageReader) -> None:
        for _ in self.received_until_now(reader, keeps_all=not self._queue.keeps_newest):
            pass

    def _subscribe_again(self, topic: ImageTopic, qos: QoSProfile) -> None:
        """Subscribe with another topic or profile, if the topic is used."""
        is_same = topic == self.topic
        self.topic, self.qos = topic, qos
        if self._reader is None:
            return
        self._retire_previous()
        self._previous, self._reader = self._reader, None
        self._retire_at = time.monotonic() + _OVERLAP_SECONDS
        # The old publishers are gone, the type differs (a process has one type per topic), or
        # the messages have no numbers by which repeated ones are found.
        if not is_same or not self._previous.publisher_count() or not self._previous.has_numbers:
            self._retire_previous()
        self.use(True)
        self._log_topic()

    def _retire_previous(self) -> None:
        """Receive the waiting messages of the old reader, then remove it."""
        previous, self._previous = self._previous, None
        if previous:
            self._change_readers()
            self._drain(previous)
            previous.destroy()

    def _change_readers(self) -> None:
        for reader in self.readers:
            reader.is_alone = len(self.readers) == 1
        self._on_readers()
