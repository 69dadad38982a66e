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

from collections.abc import Callable, Iterable
import time

import numpy as np
from numpy.typing import NDArray
from opencv_tools.image.cdr import CdrError
from opencv_tools.recording.trouble import Log
from opencv_tools.ros.frame_sources import FrameSource, FrameSources
from opencv_tools.ros.lost_frames import LostFrames
from opencv_tools.ros.messages import FrameMessage
from opencv_tools.ros.qos import describe_qos, following_qos, qos_mismatch
from opencv_tools.ros.rcl import MessageInfo
from opencv_tools.ros.reception import Reception
from opencv_tools.ros.silence import Silence
from opencv_tools.ros.timers import create_steady_timer
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from rclpy.topic_endpoint_info import TopicEndpointInfo

# The executor has events only for publishers of the same type. The graph is polled for all others.
# Each poll wakes the executor, which is its cost.
_LOOK_SECONDS = 0.5
# Time in which every publisher discovers a new subscription, also over a slow network.
_OVERLAP_SECONDS = 1.0
# Maximum number of messages that Fast DDS keeps for a subscription.
_REMEMBERED = 5000


class FrameSubscription:
    """
    Receive the frames of a topic with the quality of service that its publishers offer.

    The first subscription is reliable and volatile, like most image publishers. The node
    subscribes again when a publisher offers less, and when all publishers are new and offer more.
    A publisher that leaves changes nothing. The old subscription overlaps with the new one for a
    second. Messages that both receive are passed on once, so that no frame is lost or doubled.

    With the transport ``auto`` raw images are preferred to compressed ones. After the first frame
    the topic changes only when its last publisher has left. Compressed images are on
    ``<topic>/compressed``, or on the topic itself.

    All callbacks run in the executor, one at a time, in the node's default callback group.
    """

    def __init__(
        self, node: Node, topic: str, transport: str, depth: int | None, log: Log,
        on_frame: Callable[[FrameMessage, int], None], on_broken: Callable[[CdrError], None],
    ) -> None:
        """
        Subscribe.

        :param node: node that receives the frames.
        :param topic: name of the image topic before remapping.
        :param transport: one of ``TRANSPORTS``.
        :param depth: number of newest frames that the middleware keeps; None to keep every frame,
            up to the limit of the middleware.
        :param log: log for the subscribed topic, and for the reason when no frames arrive.
        :param on_frame: called with a message and its time of reception in nanoseconds of the
            system clock.
        :param on_broken: called with the error of a message that cannot be read.
        """
        self._node = node
        self._log = log
        self._depth = depth
        self._on_frame = on_frame
        self._on_broken = on_broken
        self._sources = FrameSources(node, topic, transport)
        self._silence = Silence(log, self.describe_silence)
        self._candidate: FrameSource | None = None
        self._has_frames = False  # since the first publisher appeared
        #: Counter of messages that were published but did not arrive.
        self.losses = LostFrames()
        self._publishers: frozenset[bytes] = frozenset()
        self._heard: set[tuple[int, int]] = set()
        self._heard_before: set[tuple[int, int]] = set()
        self._previous: Reception | None = None
        self._retire_at = 0.0
        source = self._sources.best() or self._sources.allowed[0]
        self._reception = self._receive_from(source, self._best_qos(self._sources.offers(source)))
        self._looked_at = time.monotonic()
        self._timer = create_steady_timer(node, _LOOK_SECONDS, self._look)

    @property
    def topic_name(self) -> str:
        """Name of the subscribed topic after remapping."""
        return self._reception.topic_name

    @property
    def lost(self) -> int:
        """Count of messages that were published but did not arrive."""
        return self.losses.count

    def describe_silence(self) -> str:
        """Return the reason why no frame arrives, with a remedy, as a sentence."""
        return self._sources.describe_silence(self._reception.source, self._reception.qos)

    def close(self, is_patient: Callable[[], bool]) -> int:
        """
        Pass on the messages that were received until now, and unsubscribe.

        :param is_patient: returns whether to pass on another message; may wait before.
        :returns: number of messages that were not passed on, because of ``is_patient`` or Ctrl-C.
        """
        now = time.time_ns()
        rest = 0
        is_cut_short = False

        def goes_on() -> bool:
            nonlocal is_cut_short
            is_cut_short = is_cut_short or not is_patient()
            return not is_cut_short

        try:
            for reception in self._receptions():
                for taken in reception.waiting(now, goes_on):
                    rest = 1
                    self._take(reception, *taken)
                    rest = 0
        except KeyboardInterrupt:
            is_cut_short = True
        for reception in self._receptions() if is_cut_short else ():
            for _, info in reception.waiting(now):
                if not self._is_repeated((info.source_timestamp, info.number)):
                    self.losses.take(info)
                    rest += 1
        self.destroy()
        return rest

    def destroy(self) -> None:
        """Unsubscribe."""
        self._node.destroy_timer(self._timer)
        for reception in self._receptions():
            reception.destroy()
        self._previous = None

    def _receptions(self) -> list[Reception]:
        """Return the subscriptions, oldest first."""
        return [reception for reception in (self._previous, self._reception) if reception]

    # Publishers and their quality of service

    def _best_qos(self, offers: Iterable[TopicEndpointInfo]) -> QoSProfile:
        return following_qos([info.qos_profile for info in offers], self._depth)

    def _look(self) -> None:
        """Adapt to the publishers, and warn if no frames arrive."""
        now = time.monotonic()
        # If the executor was busy, received frames may not have been processed yet.
        elapsed = min(now - self._looked_at, 2 * _LOOK_SECONDS)
        self._looked_at = now
        if self._previous and now >= self._retire_at:
            self._retire_previous()
        self._choose_source()
        self._follow()
        # A latched topic may have published its only image already.
        latched = self._reception.qos.durability == DurabilityPolicy.TRANSIENT_LOCAL
        self._silence.watch(elapsed, latched and self._has_frames and bool(self._publishers))

    def _choose_source(self) -> None:
        """Change the topic if it has no publisher, or no frames yet and another one is better."""
        current = self._reception.source
        if len(self._sources.allowed) == 1 or (self._has_frames and self._sources.offers(current)):
            return
        self._has_frames = False
        best = self._sources.best() or current
        # The topics of a camera do not appear at the same time; a better one may follow.
        if best not in (current, self._candidate):
            self._candidate = best
            return
        self._candidate = None
        if best != current:
            self._subscribe_again(best, self._best_qos(self._sources.offers(best)))
            self._silence.forget()
            self.losses.begin()

    def _follow(self, _event: object = None) -> None:
        """Subscribe again if the profiles are incompatible, or new publishers offer more."""
        reception = self._reception
        offers = self._sources.offers(reception.source)
        qos = self._best_qos(offers)
        are_new = not self._publishers & _identify(offers)
        self._notice(offers)
        if offers and qos != reception.qos and (are_new or any(
                qos_mismatch(info.qos_profile, reception.qos) for info in offers)):
            self._subscribe_again(reception.source, qos)

    def _notice(self, offers: Iterable[TopicEndpointInfo]) -> None:
        """Reset the wait for a frame if the publishers have changed."""
        publishers = _identify(offers)
        if publishers != self._publishers:
            self._publishers = publishers
            self.losses.discover(publishers)
            self._silence.begin()

    # Subscriptions

    def _receive_from(self, source: FrameSource, qos: QoSProfile) -> Reception:
        return Reception(self._node, source, qos, self._take, self._follow)

    def _subscribe_again(self, source: FrameSource, qos: QoSProfile) -> None:
        old = self._reception
        self._retire_previous()
        self._previous, self._retire_at = old, time.monotonic() + _OVERLAP_SECONDS
        if source != old.source or not old.publisher_count():
            # The old publishers are gone, or the type differs: a process has one type per topic.
            self._retire_previous()
        self._reception = self._receive_from(source, qos)
        self._log.info(
            f'Receiving {self.topic_name} ({source.type_name}, {describe_qos(qos)}), '
            'as its publishers offer')

    def _retire_previous(self) -> None:
        """Pass on the received messages of the old subscription, then remove it."""
        if self._previous:
            self._previous.drain()
            self._previous.destroy()
            self._previous = None

    def _take(self, reception: Reception, data: NDArray[np.uint8], info: MessageInfo) -> None:
        """Pass a message on, unless the other subscription already has."""
        if self._previous and reception is not self._previous:
            self._previous.drain()  # keep the order of reception
        if self._is_repeated((info.source_timestamp, info.number)):
            return
        self._has_frames = True
        self.losses.take(info)
        try:
            message = reception.read(data)
        except CdrError as err:
            self._on_broken(err)
        else:
            self._on_frame(message, info.received_timestamp or time.time_ns())
        self._silence.end(self.topic_name)

    def _is_repeated(self, identity: tuple[int, int]) -> bool:
        """Return whether a message was passed on already, and remember it."""
        if identity in self._heard or identity in self._heard_before:
            return identity[0] > 0  # a message without a time cannot be identified
        self._heard.add(identity)
        if len(self._heard) == _REMEMBERED:
            self._heard_before, self._heard = self._heard, set()
        return False


def _identify(offers: Iterable[TopicEndpointInfo]) -> frozenset[bytes]:
    return frozenset(bytes(info.endpoint_gid) for info in offers)
