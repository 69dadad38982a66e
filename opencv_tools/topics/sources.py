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

"""The sources of the frames of a topic: the image topic and shared memory."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from opencv_tools.base.logs import Log
from opencv_tools.image.cdr import IMAGE
from opencv_tools.topics.image_source import ImageSource
from opencv_tools.topics.message_reader import MessageReader, WakeUps
from opencv_tools.topics.options import SubscriptionOptions
from opencv_tools.topics.queue import FrameQueue, QueuedFrame
from opencv_tools.topics.shared_frames import SharedFrames
from opencv_tools.topics.topic_discovery import TopicDiscovery
from opencv_tools.topics.video_decoding import VideoDecoding
from opencv_tools.transport.shared_frames.memory import NOT_SHARED
from opencv_tools.transport.shared_frames.publisher import can_share


class FrameSources:
    """
    Put the frames of a topic into a queue, by the way that its publishers offer.

    The caller lets one thread at a time change the sources. With the transport ``auto`` compressed
    images are on ``<topic>/compressed``, or on the topic itself.
    """

    def __init__(
        self, discovery: TopicDiscovery, queue: FrameQueue, options: SubscriptionOptions, log: Log,
        wake_ups: WakeUps,
    ) -> None:
        """
        Subscribe to the image topic, and to the announcements of shared frames.

        :param queue: queue that gets the frames.
        :param wake_ups: what wakes the executor; its readers become those of the sources.
        """
        self._discovery = discovery
        self._queue = queue
        self._options = options
        self._wake_ups = wake_ups
        #: Shared memory; None if it is not used.
        self.shared = SharedFrames(
            discovery, queue, log, options, on_change=wake_ups.wake,
            on_frame=(lambda: None) if options.threaded else wake_ups.wake,
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
        """Unsubscribe from the image topic while all its publishers share their frames."""
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
