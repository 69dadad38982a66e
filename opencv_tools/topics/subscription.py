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

"""Subscription that adapts to the publishers of a topic, and reports why no frames arrive."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from threading import current_thread, Lock, Thread
import time
from typing import NamedTuple

from opencv_tools.image.cdr import IMAGE
from opencv_tools.image.errors import CdrError
from opencv_tools.logs import Log
from opencv_tools.topics.image_source import ImageSource
from opencv_tools.topics.message_reader import ImageReader, MessageReader, WakeUps
from opencv_tools.topics.mixed_publishers import MixedPublishers
from opencv_tools.topics.no_frames_warning import NoFramesWarning
from opencv_tools.topics.queue import FrameQueue, QueuedFrame, ReceivedMessage
from opencv_tools.topics.shared_frames import SharedFrames
from opencv_tools.topics.timers import create_steady_timer
from opencv_tools.topics.topic_discovery import TopicDiscovery
from opencv_tools.transport.shared_frames.memory import MAX_DEPTH
from opencv_tools.transport.shared_frames.publisher import can_share, NOT_SHARED
from opencv_tools.transport.shared_frames.reader import MAX_VIEWS
from rclpy.exceptions import InvalidHandle
from rclpy.node import Node
from rclpy.qos import qos_profile_sensor_data
from sensor_msgs.msg import CameraInfo

# The executor has events only for publishers of the same type. The graph is polled for all others.
# Each poll wakes the executor, which is its cost.
_GRAPH_POLL_SECONDS = 0.5


class Account(NamedTuple):
    """
    What has become of the published frames.

    :param skipped: number of frames that newer ones have replaced before they were passed on.
    :param lost: number of frames that did not arrive.
    :param is_complete: whether ``lost`` counts all frames of each publisher, not only those after
        the first one that arrived.
    """

    skipped: int
    lost: int
    is_complete: bool


class FrameSubscription:
    """
    Receive the frames of a topic with the quality of service that its publishers offer.

    The sources of the frames, which are the image topic and shared memory, put them into one
    queue. One consumer takes them from there: the executor, at most one frame each time it wakes
    up, or a thread of this object.

    With the transport ``auto`` compressed images are on ``<topic>/compressed``, or on the topic
    itself.
    """

    def __init__(
        self, node: Node, topic: str, transport: str, depth: int | None, log: Log,
        on_frame: Callable[[ReceivedMessage], object], on_broken: Callable[[CdrError], object], *,
        threaded: bool = False, camera_info: bool = False, prefers_compressed: bool = False,
        max_views: int = MAX_VIEWS,
    ) -> None:
        """
        Subscribe.

        :param node: node that receives the frames.
        :param topic: name of the image topic before remapping.
        :param transport: one of ``TRANSPORTS``.
        :param depth: number of frames that may wait, 1 for the newest one; None to keep every
            frame, up to the limit of the middleware.
        :param log: log for the subscribed topic, and for the reason when no frames arrive.
        :param on_frame: called with each frame, one call at a time.
        :param on_broken: called with the error of a message that cannot be read.
        :param threaded: whether a thread of this object calls ``on_frame`` and ``on_broken``, not
            the executor. Their exceptions are raised in the executor.
        :param camera_info: whether a frame waits for the calibration with the same stamp.
        :param prefers_compressed: whether ``auto`` prefers compressed images.
        :param max_views: number of frames that may stay in the shared memory; more are copied.
        :raises ParameterError: the name of the topic or the transport is invalid.
        """
        self._node = node
        self._on_frame = on_frame
        self._on_broken = on_broken
        self._queue = FrameQueue(depth or MAX_DEPTH, with_info=camera_info)
        self._discovery = TopicDiscovery(
            node, topic, transport, prefers_compressed=prefers_compressed)
        self._no_frames_warning = NoFramesWarning(log, self.explain_no_frames)
        self._mixed_publishers = MixedPublishers(
            log, lambda publishers: self._discovery.describe_publishers(
                self._image.topic, publishers))
        self._error: BaseException | None = None  # raised by a callback in its thread
        self._destroyer: Thread | None = None  # that has called `destroy`
        self._has_yielded = False
        self._sources = Lock()  # one thread at a time changes the sources
        self._wake_ups = WakeUps(
            node, self._wake, lambda: not threaded and self._queue.has_frames)
        self._has_image_topic = transport != 'shm'
        self._shared = SharedFrames(
            node, node.resolve_topic_name(topic), self._queue, log,
            depth=min(depth or MAX_DEPTH, MAX_DEPTH), max_views=max_views,
            is_required=not self._has_image_topic, on_change=self._wake_ups.wake,
            on_frame=(lambda: None) if threaded else self._wake_ups.wake,
        ) if transport in ('auto', 'shm') and can_share() else None
        self._image = ImageSource(
            node, self._discovery, depth, self._queue, log, on_readers=self._watch,
            before_message=(self._shared.receive_before_message if self._shared
                            else lambda publisher: None))
        self._watch([])
        self._image.use(self._has_image_topic)
        folder = node.resolve_topic_name(topic).rpartition('/')[0]
        self._info_subscription = node.create_subscription(
            CameraInfo, f'{folder}/camera_info', self._add_info, qos_profile_sensor_data,
        ) if camera_info else None
        self._polled_at = time.monotonic()
        self._timer = create_steady_timer(
            node, _GRAPH_POLL_SECONDS, self._poll_graph, self._wake_ups.callback_group)
        self._thread = Thread(
            target=self._run, name=f'frames of {topic}', daemon=True) if threaded else None
        if self._thread:
            self._thread.start()

    @property
    def topic_name(self) -> str:
        """Name of the subscribed topic after remapping."""
        return self._image.topic_name

    @property
    def account(self) -> Account:
        """Return the counts of frames that were not passed on until now."""
        with self._queue.lock:
            order = self._queue.order
            return Account(self._queue.skipped, order.count, order.is_complete)

    @property
    def is_latched(self) -> bool:
        """Whether the publishers keep their last messages for later subscriptions."""
        return self._image.is_latched

    @property
    def is_shared(self) -> bool:
        """Whether all frames come from shared memory."""
        return not self._image.is_used

    def explain_no_frames(self) -> str:
        """Return the reason why no frame arrives, with a remedy, as a sentence."""
        if self._info_subscription and self._queue.has_unpaired:
            return (f'{self.topic_name} has images, but {self._info_subscription.topic_name} has '
                    'no calibration with their stamps; publish it, or set camera_info=False')
        if not self._has_image_topic:
            if self._shared is None:
                return NOT_SHARED
            reason = self._shared.explain(self._image.publishers)
            if reason:
                return (f'{self.topic_name} has a publisher that does not share its frames with '
                        f'this process: {reason}; set transport:=auto')
        return self._discovery.explain_no_frames(self._image.topic, self._image.qos)

    def close(self, may_continue: Callable[[], bool]) -> int:
        """
        Pass on the messages that were received until now, and unsubscribe.

        A subscription with a thread has no use for this; its thread would pass on frames as well.

        :param may_continue: returns whether to pass on another message; may wait before.
        :returns: number of messages that were not passed on, due to ``may_continue`` or Ctrl-C.
        """
        unprocessed = 0
        is_interrupted = False
        if self._shared:
            self._shared.receive_remaining()
        for frame in self._remaining_frames():
            unprocessed += 1
            if is_interrupted:
                continue
            try:
                is_interrupted = not may_continue()
                if not is_interrupted:
                    self._call(frame)
                    unprocessed -= 1
            except KeyboardInterrupt:
                is_interrupted = True
        self.destroy()
        return unprocessed

    def destroy(self) -> None:
        """
        Unsubscribe, and wait until a running call of a callback has returned.

        A callback may call this. An exception of a callback in its thread that the executor has
        not raised is raised here. The executor raises one that follows in the callback that
        called this.
        """
        if self._destroyer is None:
            self._destroyer = current_thread()
            self._node.destroy_timer(self._timer)
            self._wake_ups.readers = ()
            with self._sources:
                self._image.destroy()
                if self._shared:
                    self._shared.destroy()
            if self._info_subscription:
                self._node.destroy_subscription(self._info_subscription)
            self._queue.close()
        if self._thread is not current_thread():
            if self._thread:
                self._thread.join()
            self._wake_ups.destroy()
            self._raise_error()

    # The consumer

    def _wake(self, ready: Sequence[MessageReader], have_publishers_changed: bool) -> None:
        """Receive what has arrived, and pass on at most one frame, in the executor."""
        self._raise_error()
        with self._sources:
            if self._destroyer:  # which is another thread
                return
            self._receive(ready, have_publishers_changed)
        if self._thread or self._yields_to_timers():
            return
        frame = self._queue.pop()
        if frame:
            self._call(frame)

    def _yields_to_timers(self) -> bool:
        """
        Return whether the next frame waits once for timers that are due.

        The executor runs waitables first, so that a slow callback would delay them twice.
        """
        with suppress(InvalidHandle):  # a timer that another thread destroys
            self._has_yielded = not self._has_yielded and self._queue.has_frames and any(
                timer.is_ready() for timer in self._node.timers)
        return self._has_yielded

    def _run(self) -> None:
        """Pass on frames in a thread, until the subscription is destroyed or a callback fails."""
        try:
            while frame := self._queue.wait():
                self._call(frame)
                del frame  # release the message before the next wait
        except BaseException as err:  # noqa: B902 (the executor or `destroy` raises it)
            self._error = err
            self._wake_ups.wake()
        else:
            if self._destroyer is current_thread():
                self._wake_ups.destroy()

    def _call(self, frame: QueuedFrame) -> None:
        if isinstance(frame, CdrError):
            self._on_broken(frame)
        else:
            self._on_frame(frame)

    def _raise_error(self) -> None:
        error, self._error = self._error, None
        if error is not None:
            raise error

    # The sources

    def _watch(self, readers: Sequence[ImageReader]) -> None:
        """Have the executor wait for the messages of some readers, and for announcements."""
        self._wake_ups.readers = (
            *readers, *([self._shared.announcements] if self._shared else []))

    def _receive(self, ready: Sequence[MessageReader], have_publishers_changed: bool) -> None:
        """Receive a message of the image topic, and an announcement."""
        reader = next((reader for reader in self._image.readers if reader in ready), None)
        # With a full queue the message waits in the middleware, until a frame was passed on.
        if reader and (self._thread or not self._queue.is_full):
            self._image.receive(reader)
        if have_publishers_changed:
            self._adapt()
        if self._shared:
            if self._shared.announcements in ready:
                self._shared.read_announcement(self._image.publishers)
            if self._shared.has_changed:
                self._update_sharing()

    def _remaining_frames(self) -> Iterator[QueuedFrame]:
        """Yield the frames that wait and those that were received until now, oldest first."""
        for reader in self._image.readers:
            for _ in self._image.received_until_now(reader):
                while frame := self._queue.pop():
                    yield frame
        while frame := self._queue.pop():
            yield frame

    def _add_info(self, info: CameraInfo) -> None:
        self._queue.put_info(info)
        self._wake_ups.wake()

    def _poll_graph(self) -> None:
        """Adapt to the publishers, and warn if no frames arrive."""
        now = time.monotonic()
        # If the executor was busy, received frames may not have been processed yet.
        elapsed = min(now - self._polled_at, 2 * _GRAPH_POLL_SECONDS)
        self._polled_at = now
        with self._sources:
            if self._destroyer:  # which is another thread
                return
            self._image.retire_when_due()
            if self._image.choose_topic():
                self._no_frames_warning.reset_period()
            self._adapt()
        with self._queue.lock:
            counts = dict(self._queue.order.accepted)
        self._mixed_publishers.check(self.topic_name, counts)
        # A latched topic may have published its only image already.
        self._no_frames_warning.check(
            elapsed, self._queue.complete, self.topic_name,
            is_expected=(self.is_latched and self._image.has_frames
                         and bool(self._image.publishers)))

    def _adapt(self) -> None:
        """Adapt to the publishers."""
        if self._image.adapt():
            self._no_frames_warning.reset()
        self._update_sharing()

    def _update_sharing(self) -> None:
        """Unsubscribe from the image topic while all its publishers share their frames."""
        if self._shared:
            for publisher in self._shared.check():
                self._image.drain()
                self._shared.stop_joining(publisher)
            is_raw = self._image.topic.type_name == IMAGE
            are_shared = self._shared.update(self._image.publishers if is_raw else frozenset())
            self._image.use(self._has_image_topic and not are_shared)
