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

"""The sources of shared frames of a topic, and the services that announce them."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence, Set

from opencv_tools.base.logs import Log
from opencv_tools.image.cdr import IMAGE
from opencv_tools.topics.image_source import ImageSource
from opencv_tools.topics.message_reader import MessageReader, WakeUps
from opencv_tools.topics.options import SubscriptionOptions
from opencv_tools.topics.order import Way
from opencv_tools.topics.queue import FrameQueue, QueuedFrame
from opencv_tools.topics.shared_source import Origin, SharedSource, WriterEndedError
from opencv_tools.topics.topic_discovery import TopicDiscovery
from opencv_tools.transport.shared_frames.announcement import (
    AnnouncementError, read_announcement, SUFFIX)
from opencv_tools.transport.shared_frames.header import publisher_identity
from opencv_tools.transport.shared_frames.memory import MAX_DEPTH, NOT_SHARED, process_memory
from opencv_tools.transport.shared_frames.pages import SharedMemoryError
from opencv_tools.transport.shared_frames.publisher import can_share
from opencv_tools.video.publisher_decoders import VideoDecoding
from rclpy.qos import DurabilityPolicy, QoSProfile
from rclpy.serialization import deserialize_message
from std_msgs.msg import String

MAX_PUBLISHERS = 64
# Bytes of an identifier that are the same for all publishers of a process.
_PREFIX_BYTES = 12


class FrameSources:
    """
    Put the frames of a topic into a queue, by the way that its publishers offer.

    The caller lets one thread at a time change the sources. With the transport ``auto`` compressed
    images are on ``<topic>/compressed``, or on the topic itself.
    """

    def __init__(
        self, discovery: TopicDiscovery, queue: FrameQueue, options: SubscriptionOptions, log: Log,
        wake_ups: WakeUps, on_frame: Callable[[], object],
    ) -> None:
        """
        Subscribe to the image topic, and to the announcements of shared frames.

        :param queue: queue that gets the frames.
        :param wake_ups: what wakes the executor; its readers become those of the sources.
        :param on_frame: called in any thread after each shared frame that was put into the queue.
        """
        self._discovery = discovery
        self._queue = queue
        self._options = options
        self._wake_ups = wake_ups
        #: Shared memory; None if it is not used.
        self.shared = SharedFrames(
            discovery, queue, log, options, on_change=wake_ups.wake,
            on_frame=on_frame,
        ) if options.transport in ('auto', 'shm') and can_share() else None
        #: The image topic.
        self.image = ImageSource(
            discovery, options.depth, queue, log,
            self.shared.receive_before_message if self.shared else lambda publisher: None,
            self._watch)
        self.image.decoding = VideoDecoding(options.max_pixels) if options.decodes_video else None
        self._watch()
        self.image.use(options.has_image_topic)

    @property
    def is_expected(self) -> bool:
        """Whether a latched topic may have published its only image already."""
        return self.image.is_latched and self.image.has_frames and bool(self.image.publishers)

    def receive(
        self, ready: Sequence[MessageReader], is_full: bool, have_publishers_changed: bool,
    ) -> bool:
        """
        Receive a message of the image topic, and an announcement.

        :param ready: readers that have messages.
        :param is_full: whether a message is to wait in the middleware.
        :param have_publishers_changed: whether there is an event of a publisher.
        :returns: whether the publishers have changed.
        """
        reader = next((reader for reader in self.image.readers if reader in ready), None)
        if reader and not is_full:
            self.image.receive(reader)
        have_changed = have_publishers_changed and self.adapt()
        if self.shared:
            if self.shared.announcements in ready:
                self.shared.read_announcement()
            if self.shared.has_changed:
                self.update_sharing()
        return have_changed

    def adapt(self) -> bool:
        """Adapt to the publishers, and return whether they have changed."""
        have_changed = self.image.adapt()
        self.update_sharing()
        return have_changed

    def update_sharing(self) -> None:
        """Use the image topic once it is chosen, unless all its publishers share their frames."""
        are_shared = False
        if self.shared:
            for publisher in self.shared.check():
                self.image.drain()
                self.shared.stop_joining(publisher)
            is_raw = self.image.topic.type_name == IMAGE
            are_shared = self.shared.update(self.image.publishers if is_raw else frozenset())
        self.image.use(self._options.has_image_topic and not are_shared)

    def remaining_frames(self) -> Iterator[QueuedFrame]:
        """Yield the frames that wait and those that were received until now, oldest first."""
        if self.shared:
            self.shared.receive_remaining()
        for reader in self.image.readers:
            for _ in self.image.received_until_now(reader):
                while frame := self._queue.pop():
                    yield frame
        while frame := self._queue.pop():
            yield frame

    def explain_no_frames(self) -> str:
        """Return the reason why no frame arrives, with a remedy, as a sentence."""
        if not self._options.has_image_topic:
            if self.shared is None:
                return NOT_SHARED
            reason = self.shared.explain(self.image.publishers)
            if reason:
                return (f'{self.image.topic_name} has a publisher that does not share its frames '
                        f'with this process: {reason}; set transport:=auto')
        return self._discovery.explain_no_frames(self.image.topic, self.image.qos)

    def _watch(self) -> None:
        """Have the executor wait for the messages of the topic, and for announcements."""
        announcements = (self.shared.announcements,) if self.shared else ()
        self._wake_ups.readers = (*self.image.readers, *announcements)

    def destroy(self) -> None:
        """Unsubscribe."""
        self.image.destroy()
        if self.shared:
            self.shared.destroy()


class SharedServices:
    """Services by publisher, of at most ``MAX_PUBLISHERS`` publishers."""

    def __init__(self) -> None:
        self._services: dict[bytes, str] = {}
        self._reasons: dict[bytes, str] = {}  # why those of other publishers cannot be reached
        self._broken: dict[str, str] = {}  # reasons by service
        self._numbers: dict[bytes, tuple[int, int]] = {}  # of messages and frames

    def add(self, text: str, sender: bytes) -> None:
        """
        Read an announcement; it replaces the last one of its publisher.

        :param sender: identifier of the publisher of the message, from the middleware.
        :raises AnnouncementError: it is malformed, or another process speaks of the publisher.
        """
        announcement = read_announcement(text)
        publisher = bytes.fromhex(announcement.publisher)
        if publisher[:_PREFIX_BYTES] != sender[:_PREFIX_BYTES]:
            raise AnnouncementError('the announcement is of another process than its publisher')
        self._services.pop(publisher, None)
        self._reasons.pop(publisher, None)
        service = announcement.service
        if not service:
            self._reasons[publisher] = 'its /dev/shm has too little room'
        elif not announcement.is_reachable:
            self._reasons[publisher] = (
                'it runs on another machine, in another container or as another user')
        elif service in self._broken:
            self._reasons[publisher] = self._broken[service]
        else:
            self._services[publisher] = service
        if announcement.frames:
            self._numbers[publisher] = announcement.messages, announcement.frames
        for known in (self._services, self._reasons, self._numbers):
            while len(known) > MAX_PUBLISHERS:
                del known[next(iter(known))]

    def pop_numbers(self, publishers: Set[bytes]) -> list[tuple[bytes, int, int]]:
        """Return the last announced numbers of publishers, of messages and of frames, once."""
        return [(publisher, *self._numbers.pop(publisher))
                for publisher in publishers & self._numbers.keys()]

    def remove(self, publisher: bytes, service: str, reason: str) -> None:
        """Remove a service that failed, until its publisher announces another one."""
        if self._services.get(publisher) == service:
            del self._services[publisher]
            self._reasons[publisher] = reason
        self._broken[service] = reason
        while len(self._broken) > MAX_PUBLISHERS:
            del self._broken[next(iter(self._broken))]

    def include(self, publishers: Set[bytes]) -> bool:
        """Return whether all publishers have a service."""
        return publishers <= self._services.keys()

    def explain(self, publishers: Set[bytes]) -> str:
        """Return why a publisher does not share its frames with this process, or ''."""
        return next((self._reasons.get(
            publisher, 'it has no frames yet, or is not of opencv_tools with iceoryx2')
            for publisher in publishers - self._services.keys()), '')

    def of(self, publisher: bytes) -> str:
        """Return the service of a publisher, '' if it has none."""
        return self._services.get(publisher, '')


class SharedFrames:
    """
    Receive the frames that publishers on this machine share; used in the executor only.

    Frames are shared while all publishers of the topic share theirs. The numbers in the header of
    each frame show at which frame the image topic ends and the shared memory begins, see `Way`.
    """

    def __init__(
        self, discovery: TopicDiscovery, queue: FrameQueue, log: Log,
        options: SubscriptionOptions, *, on_change: Callable[[], None],
        on_frame: Callable[[], object],
    ) -> None:
        """
        Subscribe to the announcements.

        :param queue: queue that gets the frames.
        :param on_change: called in any thread when ``has_changed`` has become true.
        :param on_frame: called in any thread after each frame that was put into the queue.
        """
        self._topic = discovery.resolved
        self._queue = queue
        self._log = log
        self._depth = min(options.capacity, MAX_DEPTH)  # for the thread of a source
        self._max_views = options.max_views
        self._is_required = not options.has_image_topic
        self._on_change = on_change
        self._on_frame = on_frame
        #: Whether ``check`` and ``update`` are to be called.
        self.has_changed = False
        self._services = SharedServices()
        self._sources: dict[bytes, SharedSource] = {}
        #: Reader of the announcements.
        self.announcements = MessageReader(
            discovery.node, String, f'{self._topic}{SUFFIX}', QoSProfile(
                depth=MAX_PUBLISHERS, durability=DurabilityPolicy.TRANSIENT_LOCAL))

    def read_announcement(self) -> None:
        """Take an announcement, if there is one, which has its effect in ``update``."""
        taken = self.announcements.take_serialized()
        if taken is None:
            return
        data, info = taken
        try:
            self._services.add(
                deserialize_message(bytes(data), String).data, bytes(info.publisher))
        except (AnnouncementError, RuntimeError) as err:  # rclpy's RMWError is private
            self._log.debug(str(err))
            return
        self.has_changed = True

    def update(self, publishers: Set[bytes]) -> bool:
        """
        Open the frames of all publishers, or leave them if not all share.

        :returns: whether all frames come from shared memory.
        """
        with self._queue.lock:
            for publisher, messages, frames in self._services.pop_numbers(publishers):
                self._queue.order.learn(publisher, messages, frames)
        for publisher in self._sources.keys() - publishers:
            self._end(publisher)
        for publisher in publishers:
            source = self._sources.get(publisher)
            service = self._services.of(publisher)
            if source and service not in ('', source.origin.service):
                self._end(publisher)
        are_shared = bool(publishers) and self._services.include(publishers)
        for publisher in publishers - self._sources.keys():
            if are_shared or (self._is_required and self._services.of(publisher)):
                are_shared = self._open(publisher) and are_shared
        for publisher in [*self._sources]:
            self._direct(publisher, are_shared or self._is_required)
        return are_shared and all(
            self._way(publisher) is Way.SHARED for publisher in publishers)

    def check(self) -> list[bytes]:
        """
        Leave the sources that have failed or that are not needed any more.

        :returns: the publishers whose shared frames have waited too long for messages.
        """
        self.has_changed = False
        for publisher, source in [*self._sources.items()]:
            if source.error:
                self._fail(publisher, source.origin.service, source.error)
            elif self._way(publisher) is Way.TOPIC:
                self._close(publisher)
        return [publisher for publisher, source in self._sources.items() if source.is_overdue]

    def stop_joining(self, publisher: bytes) -> None:
        """Count the messages as lost that are missing before the next shared frame."""
        with self._queue.lock:
            if self._queue.order.way(publisher) is Way.JOINING:
                self._queue.order.change(publisher, Way.JOINING, is_overdue=True)
        self._sources[publisher].stop_joining()

    def receive_before_message(self, publisher: bytes) -> None:
        """Put the shared frames into the queue that may precede a message of a publisher."""
        if publisher in self._sources and self._way(publisher) is Way.LEAVING:
            self.has_changed = True
            self._receive(publisher)

    def explain(self, publishers: Set[bytes]) -> str:
        """Return why a publisher does not share its frames with this process, or ''."""
        return self._services.explain(publishers)

    def receive_remaining(self) -> None:
        """Put all waiting frames into the queue, and receive no more."""
        for publisher in [*self._sources]:
            self._end(publisher)

    def destroy(self) -> None:
        """Unsubscribe, and wait for the end of the threads."""
        sources = [*self._sources.values()]
        self._sources = {}
        for source in sources:
            source.close()
        for source in sources:
            source.join()
        self.announcements.destroy()

    def _way(self, publisher: bytes) -> Way:
        with self._queue.lock:
            return self._queue.order.way(publisher)

    def _change(self, publisher: bytes, way: Way) -> None:
        with self._queue.lock:
            self._queue.order.change(publisher, way)

    def _open(self, publisher: bytes) -> bool:
        """Open the frames of a publisher and return whether that was possible."""
        service = self._services.of(publisher)
        try:
            reader = process_memory().open_reader(service, self._depth, self._max_views)
        except SharedMemoryError as err:
            self._fail(publisher, service, err)
            return False
        self._change(publisher, Way.JOINING)
        origin = Origin(publisher, service, publisher_identity(publisher, self._topic))
        self._sources[publisher] = SharedSource(
            origin, reader, self._queue, self._note_change, self._on_frame)
        return True

    def _note_change(self) -> None:
        self.has_changed = True
        self._on_change()

    def _direct(self, publisher: bytes, is_shared: bool) -> None:
        """Have the frames of a publisher arrive by shared memory or by the image topic."""
        way = self._way(publisher)
        if is_shared:
            if way is Way.LEAVING:
                self._change(publisher, Way.SHARED)
        elif way is Way.SHARED:
            self._change(publisher, Way.LEAVING)
        elif way is Way.JOINING:
            self._close(publisher)

    def _receive(self, publisher: bytes) -> None:
        source = self._sources[publisher]
        try:
            source.receive()
        except SharedMemoryError as err:
            self._fail(publisher, source.origin.service, err)

    def _fail(self, publisher: bytes, service: str, err: Exception) -> None:
        """Return to the image topic, because the service of a publisher has failed."""
        log = self._log.debug if isinstance(err, WriterEndedError) else self._log.info
        log(f'A publisher of {self._topic} is not received by shared memory: {err}', once=str(err))
        self._services.remove(publisher, service, str(err))
        self._close(publisher)

    def _end(self, publisher: bytes) -> None:
        """Receive the rest of the frames of a publisher."""
        self._receive(publisher)
        self._close(publisher)

    def _close(self, publisher: bytes) -> None:
        source = self._sources.pop(publisher, None)
        if source:  # not closed by an error meanwhile
            source.close()
            self._change(publisher, Way.TOPIC)
