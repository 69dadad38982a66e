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

"""Subscription that adapts to the publishers of a topic, with warnings about its frames."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence, Set
from functools import partial
from threading import current_thread, Lock, Thread
import time
from typing import NamedTuple

from opencv_tools.base.logs import Log
from opencv_tools.image.errors import CdrError
from opencv_tools.image.topic_names import camera_info_topic, camera_info_topics
from opencv_tools.topics.consumer import Consumer
from opencv_tools.topics.events import destroyable
from opencv_tools.topics.message_reader import MessageReader, WakeUps
from opencv_tools.topics.options import SubscriptionOptions
from opencv_tools.topics.queue import FrameQueue, ReceivedMessage
from opencv_tools.topics.rate_meter import RateMeter
from opencv_tools.topics.shared_frames import FrameSources
from opencv_tools.topics.timers import create_steady_timer
from opencv_tools.topics.topic_discovery import TopicDiscovery
from rclpy.node import Node
from rclpy.qos import qos_profile_sensor_data
from rclpy.subscription import Subscription
from rclpy.timer import Timer
from sensor_msgs.msg import CameraInfo

# Successive checks with frames of several publishers. A publisher that starts again overlaps with
# its former one for one check.
_CHECKS = 2


class MixedPublishers:
    """Log once that several publishers send frames on a topic, and of which nodes they are."""

    def __init__(self, log: Log, describe: Callable[[Set[bytes]], str]) -> None:
        self._log = log
        self._describe = describe
        self._counts: dict[bytes, int] = {}
        self._checks = 0
        self._logged: frozenset[bytes] = frozenset()

    def check(self, topic: str, counts: Mapping[bytes, int]) -> None:
        """
        Log a warning if several publishers have sent frames in the last checks.

        :param counts: number of frames by publisher until now.
        """
        active = frozenset(
            publisher for publisher, count in counts.items()
            if count > self._counts.get(publisher, 0))
        self._counts = dict(counts)
        self._checks = self._checks + 1 if len(active) > 1 else 0
        if self._checks >= _CHECKS and not active <= self._logged:
            self._logged = active
            self._log.warning(f'{len(active)} publishers on {topic}: {self._describe(active)}; '
                              'their frames are mixed')


_MIN_SECONDS = 3.0
_PERIODS = 3
# Weight of each check in the moving average of the period.


class NoFramesWarning:
    """Log why no frame arrives, three seconds or three periods after the last frame."""

    def __init__(self, log: Log, describe: Callable[[], str]) -> None:
        self._log = log
        self._describe = describe
        self._logged_reason = ''
        self._count = 0
        self._now = 0.0  # without the silence before each reset
        self.reset_period()

    def reset_period(self) -> None:
        """Reset the wait and the period, after a change of the publishers' topic."""
        self._meter = RateMeter(lambda: self._now)
        self._begin = self._warned_at = self._now

    def reset(self) -> None:
        """Reset the wait, but keep the period of the frames."""
        self._now -= self._silent_seconds
        self._warned_at = self._now

    def check(self, elapsed: float, count: int, topic: str, *, is_expected: bool) -> None:
        """
        Log the reason if frames are missing and the reason is new.

        :param elapsed: seconds since the last check.
        :param count: number of frames received until now.
        :param is_expected: whether silence is normal here; suppresses the warning.
        """
        received, self._count = count - self._count, count
        self._now += elapsed
        if received:
            self._meter.add(received)
            if self._logged_reason:
                self._logged_reason = ''
                self._log.info(f'Frames arrive on {topic}')
            return
        waited = min(self._silent_seconds, self._now - self._warned_at)
        if waited < max(_MIN_SECONDS, _PERIODS * self._meter.period):
            return
        self._warned_at = self._now
        reason = '' if is_expected else self._describe()
        if reason and reason != self._logged_reason:
            self._logged_reason = reason
            self._log.warning(f'No frames: {reason}')

    @property
    def _silent_seconds(self) -> float:
        silent = self._meter.silent_seconds
        return self._now - self._begin if silent is None else silent


# The executor has events only for publishers of the same type. The graph is polled for all others.
# Each poll wakes the executor, which is its cost.
_GRAPH_POLL_SECONDS = 0.5
_CHOICE_POLL_SECONDS = 0.1  # until there is a topic to subscribe to


class Account(NamedTuple):
    """
    What has become of the published frames.

    :param skipped: number of frames that newer ones have replaced before they were passed on.
    :param lost: number of frames that did not arrive, or whose video needs one that did not.
    :param before: number of frames that were sent before the first received one.
    :param uncounted: what the numbers do not have, see `FrameOrder.uncounted`.
    """

    skipped: int
    lost: int
    before: int
    uncounted: str


class InfoReader:
    """
    Put the camera_info that belongs to an image topic into a queue.

    All topics that it may have are read, because that of rectified images may be discovered later
    than that of the camera.
    """

    def __init__(
        self, node: Node, images: str, queue: FrameQueue, wake_ups: WakeUps,
    ) -> None:
        """
        Read nothing yet; ``subscribe`` does.

        :param images: name of the image topic after remapping.
        """
        self._node, self._images = node, images
        self._queue, self._wake_ups = queue, wake_ups
        self._subscriptions: list[Subscription] = []
        self._last = self.topic
        queue.before_pairing = self._follow

    @property
    def topic(self) -> str:
        """Topic of the camera_info that belongs to the images now."""
        return camera_info_topic(self._images, self._node.count_publishers)

    def subscribe(self) -> None:
        """Read the topics."""
        self._subscriptions = [destroyable(self._node.create_subscription(
            CameraInfo, topic, partial(self._receive, topic), qos_profile_sensor_data))
            for topic in camera_info_topics(self._images)]

    def destroy(self) -> None:
        """Unsubscribe."""
        for subscription in self._subscriptions:
            self._node.destroy_subscription(subscription)
        self._subscriptions = []

    def _follow(self) -> None:
        """Forget the messages of a topic that no longer belongs to the images."""
        current = self.topic
        if current != self._last:
            self._queue.forget_infos()
            self._last = current

    def _receive(self, topic: str, info: CameraInfo) -> None:
        if topic == self.topic:
            self._queue.put_info(info)
            self._wake_ups.wake()


class FrameSubscription:
    """
    Receive the frames of a topic with the quality of service that its publishers offer.

    The sources of the frames, which are the image topic and shared memory, put them into one
    queue. One consumer takes them from there: the executor, at most one frame each time it wakes
    up, or a thread of this object.
    """

    def __init__(
        self, node: Node, topic: str, log: Log, on_frame: Callable[[ReceivedMessage], object],
        on_broken: Callable[[CdrError], object], options: SubscriptionOptions,
    ) -> None:
        """
        Subscribe, without a call of a callback before ``start``.

        :param topic: name of the image topic before remapping.
        :param on_frame: called with each frame, one call at a time.
        :param on_broken: called with the error of a message that cannot be read. An exception of
            a callback in a thread is raised in the executor.
        :param options: transport, number of frames that may wait, and so on.
        :raises ParameterError: the name of the topic or the transport is invalid.
        """
        self._node = node
        self._queue = FrameQueue(options.capacity, with_info=options.camera_info)
        self._consumer = Consumer(
            node, self._queue, on_frame, on_broken, lambda: self._wake_ups.wake())
        discovery = TopicDiscovery(node, topic, options.transport,
                                   prefers_compressed=options.prefers_compressed)
        self._no_frames_warning = NoFramesWarning(log, self.explain_no_frames)
        self._mixed_publishers = MixedPublishers(
            log, lambda publishers: discovery.describe_publishers(
                self._sources.image.topic, publishers))
        self._destroyer: Thread | None = None  # that has begun the end
        self._changing = Lock()  # one thread at a time changes the sources
        self._wake_ups = WakeUps(
            node, self._wake, lambda: self._consumer.is_pending)
        self._sources = FrameSources(
            discovery, self._queue, options, log, self._wake_ups, self._consumer.wake)
        self._polled_at = time.monotonic()
        self._is_threaded = options.threaded
        self._infos = InfoReader(node, discovery.resolved, self._queue, self._wake_ups) if (
            options.camera_info) else None
        self._timer: Timer | None = None

    def start(self) -> None:
        """
        Call the callbacks from now on.

        All that they use has to exist, because the executor may spin in another thread.
        """
        def end_thread(has_failed: bool) -> None:
            if has_failed:
                self._wake_ups.wake()  # the executor raises the exception
            elif self._destroyer is current_thread():
                self._wake_ups.destroy()

        with self._changing:
            if self._infos:
                self._infos.subscribe()
            self._timer = create_steady_timer(
                self._node, _GRAPH_POLL_SECONDS if self._sources.image.is_chosen else
                _CHOICE_POLL_SECONDS, self._poll_graph, self._wake_ups.callback_group)
            if self._is_threaded:
                self._consumer.start_thread(f'frames of {self.topic_name}', end_thread)
            self._wake_ups.start()

    @property
    def topic_name(self) -> str:
        """Name of the subscribed topic after remapping."""
        return self._sources.image.topic_name

    @property
    def account(self) -> Account:
        """Return the counts of frames that were not passed on until now."""
        with self._queue.lock:
            order = self._queue.order
            return Account(self._queue.skipped, order.count + self._queue.left_out,
                           order.before, order.uncounted('frame'))

    @property
    def is_latched(self) -> bool:
        """Whether the publishers keep their last messages for later subscriptions."""
        return self._sources.image.is_latched

    @property
    def is_shared(self) -> bool:
        """Whether all frames come from shared memory."""
        image = self._sources.image
        return image.is_chosen and not image.is_used

    def explain_no_frames(self) -> str:
        """Return the reason why no frame arrives, with a remedy, as a sentence."""
        if self._infos and self._queue.has_unpaired:
            return (f'{self.topic_name} has images, but {self._infos.topic} has no calibration '
                    'with their stamps; publish it, or set camera_info=False')
        if self._queue.waits_for_key_frame:
            return (f'{self.topic_name} has video, but no key frame with parameter sets, which '
                    'its packets need; it has to repeat them')
        return self._sources.explain_no_frames()

    def close(self, may_continue: Callable[[], bool]) -> int:
        """
        Pass on the messages that were received until now, and unsubscribe.

        A subscription with a thread has no use for this; its thread would pass on frames as well.

        :param may_continue: returns whether to pass on another message; may wait before.
        :returns: number of messages that were not passed on, due to ``may_continue`` or Ctrl-C.
        """
        self._stop_receiving()
        unprocessed = 0
        is_interrupted = False
        for frame in self._sources.remaining_frames():
            unprocessed += 1
            if is_interrupted:
                continue
            try:
                is_interrupted = not may_continue()
                if not is_interrupted:
                    self._consumer.pass_on(frame)
                    unprocessed -= 1
            except KeyboardInterrupt:
                is_interrupted = True
            if is_interrupted:
                self._sources.image.decoding = None  # the others are only counted
        self.destroy()
        return unprocessed

    def destroy(self) -> None:
        """
        Unsubscribe, and wait until a running call of a callback has returned.

        A callback may call this. An exception of a callback in its thread that the executor has
        not raised is raised here. The executor raises one that follows in the callback that
        called this.
        """
        self._stop_receiving()
        with self._changing:
            self._sources.destroy()
        self._queue.close()
        if not self._consumer.is_current_thread:
            self._consumer.join()
            self._wake_ups.destroy()
            self._consumer.raise_error()

    def _stop_receiving(self) -> None:
        """Have the executor receive nothing more; may be called again."""
        with self._changing:
            if self._destroyer:
                return
            self._destroyer = current_thread()
            self._wake_ups.readers = ()
            if self._timer:
                self._node.destroy_timer(self._timer)
            if self._infos:
                self._infos.destroy()

    def _wake(self, ready: Sequence[MessageReader], have_publishers_changed: bool) -> None:
        """Receive what has arrived, and pass on at most one frame, in the executor."""
        self._consumer.raise_error()
        with self._changing:
            if self._destroyer:  # which is another thread
                return
            # With a full queue the message waits in the middleware, until a frame was passed on.
            is_full = not self._consumer.has_thread and self._queue.is_full
            if self._sources.receive(ready, is_full, have_publishers_changed):
                self._no_frames_warning.reset()
        if self._consumer.is_pending:
            with self._consumer.calling:
                frame = self._consumer.next_in_executor()
                if frame:
                    self._consumer.pass_on(frame)

    def _poll_graph(self) -> None:
        """Adapt to the publishers, and warn if no frames arrive."""
        now = time.monotonic()
        # If the executor was busy, received frames may not have been processed yet.
        elapsed = min(now - self._polled_at, 2 * _GRAPH_POLL_SECONDS)
        self._polled_at = now
        with self._changing:
            if self._destroyer:  # which is another thread
                return
            self._sources.image.retire_when_due()
            if self._sources.image.choose_topic():
                self._no_frames_warning.reset_period()
            if self._sources.adapt():
                self._no_frames_warning.reset()
            if self._timer and self._sources.image.is_chosen:
                self._timer.timer_period_ns = int(_GRAPH_POLL_SECONDS * 1e9)
        with self._queue.lock:
            counts = dict(self._queue.order.accepted)
        self._mixed_publishers.check(self.topic_name, counts)
        self._no_frames_warning.check(
            elapsed, self._queue.complete, self.topic_name,
            is_expected=self._sources.is_expected)
