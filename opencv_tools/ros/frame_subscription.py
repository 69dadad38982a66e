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

"""A subscription to frames that asks for what their publishers offer, and says why none come."""

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

# The executor has an event for a publisher of the same type only; for the rest the graph is looked
# at. Each look wakes the executor, which is what it costs.
_LOOK_SECONDS = 0.5
# A new subscription is known to every publisher by then, over a slow network too.
_OVERLAP_SECONDS = 1.0
# As many messages as Fast DDS keeps for a subscription at most.
_REMEMBERED = 5000


class FrameSubscription:
    """
    Receive the frames of a topic, whatever quality of service its publishers offer.

    It begins reliable and volatile, which publishers of images offer as a rule. It subscribes
    again when a publisher offers less, and when all publishers are new and offer more. A publisher
    that leaves changes nothing. The old subscription stays for a second beside the new one, and
    what both receive is passed on once, so that no frame is lost or doubled.

    With the transport ``auto`` it receives raw images where any are published, else compressed
    ones. Once a frame has come it stays with that topic until the last publisher of it is gone.
    Compressed images are those on ``<topic>/compressed``, or on the topic itself.

    All calls come from the executor, one at a time: it uses the node's default callback group.
    """

    def __init__(
        self, node: Node, topic: str, transport: str, depth: int | None, log: Log,
        on_frame: Callable[[FrameMessage, int], None], on_broken: Callable[[CdrError], None],
    ) -> None:
        """
        Subscribe.

        :param node: the node that receives.
        :param topic: of the images, as in ``-r topic:=other``.
        :param transport: one of ``TRANSPORTS``.
        :param depth: how many of the newest frames the middleware keeps until they are taken; None
            for every frame, as far as it can.
        :param log: where it is said what is received, and why nothing is.
        :param on_frame: takes a message, and when it was received: nanoseconds of the system
            clock.
        :param on_broken: takes the error of a message that cannot be read.
        """
        self._node = node
        self._log = log
        self._depth = depth
        self._on_frame = on_frame
        self._on_broken = on_broken
        self._sources = FrameSources(node, topic, transport)
        self._silence = Silence(log, self.describe_silence)
        self._candidate: FrameSource | None = None
        self._has_frames = False  # since a publisher is there
        #: Those that were published but did not arrive.
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
        """Give the topic that is subscribed to now, as it is after remapping."""
        return self._reception.topic_name

    @property
    def lost(self) -> int:
        """Count the messages that were published but did not arrive."""
        return self.losses.count

    def describe_silence(self) -> str:
        """Say in a sentence why no frame arrives, and what helps."""
        return self._sources.describe_silence(self._reception.source, self._reception.qos)

    def close(self, is_patient: Callable[[], bool]) -> int:
        """
        Pass on what was received until now, and receive no more.

        :param is_patient: returns, maybe after a wait, whether to pass on one more message.
        :returns: how many messages were not passed on, as somebody was not patient or pressed
            Ctrl-C.
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
        """Receive no more."""
        self._node.destroy_timer(self._timer)
        for reception in self._receptions():
            reception.destroy()
        self._previous = None

    def _receptions(self) -> list[Reception]:
        """Return the subscriptions, the oldest first."""
        return [reception for reception in (self._previous, self._reception) if reception]

    # Publishers and what they offer

    def _best_qos(self, offers: Iterable[TopicEndpointInfo]) -> QoSProfile:
        return following_qos([info.qos_profile for info in offers], self._depth)

    def _look(self) -> None:
        """Follow the publishers, and say so when frames are missing."""
        now = time.monotonic()
        # Where the executor was busy elsewhere, frames may have come that nobody took yet.
        elapsed = min(now - self._looked_at, 2 * _LOOK_SECONDS)
        self._looked_at = now
        if self._previous and now >= self._retire_at:
            self._retire_previous()
        self._choose_source()
        self._follow()
        # One picture that was published before may be all there is.
        latched = self._reception.qos.durability == DurabilityPolicy.TRANSIENT_LOCAL
        self._silence.watch(elapsed, latched and self._has_frames and bool(self._publishers))

    def _choose_source(self) -> None:
        """Change to the source that has publishers when this one has none, or no frames yet."""
        current = self._reception.source
        if len(self._sources.allowed) == 1 or (self._has_frames and self._sources.offers(current)):
            return
        self._has_frames = False
        best = self._sources.best() or current
        # A camera's topics do not appear at the same time; the better one may be the next.
        if best not in (current, self._candidate):
            self._candidate = best
            return
        self._candidate = None
        if best != current:
            self._subscribe_again(best, self._best_qos(self._sources.offers(best)))
            self._silence.forget()
            self.losses.begin()

    def _follow(self, _event: object = None) -> None:
        """Subscribe again when what was asked for does not fit, or new publishers offer more."""
        reception = self._reception
        offers = self._sources.offers(reception.source)
        qos = self._best_qos(offers)
        are_new = not self._publishers & _identify(offers)
        self._notice(offers)
        if offers and qos != reception.qos and (are_new or any(
                qos_mismatch(info.qos_profile, reception.qos) for info in offers)):
            self._subscribe_again(reception.source, qos)

    def _notice(self, offers: Iterable[TopicEndpointInfo]) -> None:
        """Begin to wait for a frame when the publishers are others."""
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
            # Nothing can come any more, or not the same; and a topic has one type in a process.
            self._retire_previous()
        self._reception = self._receive_from(source, qos)
        self._log.info(
            f'Receiving {self.topic_name} ({source.type_name}, {describe_qos(qos)}), '
            'as its publishers offer')

    def _retire_previous(self) -> None:
        """Let go of the old subscription, once what it has received is passed on."""
        if self._previous:
            self._previous.drain()
            self._previous.destroy()
            self._previous = None

    def _take(self, reception: Reception, data: NDArray[np.uint8], info: MessageInfo) -> None:
        """Pass a message on, unless it was before."""
        if self._previous and reception is not self._previous:
            self._previous.drain()  # first what came first
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
        """Tell whether another subscription has passed a message on, and remember it."""
        if identity in self._heard or identity in self._heard_before:
            return identity[0] > 0  # without a time there is nothing to know it by
        self._heard.add(identity)
        if len(self._heard) == _REMEMBERED:
            self._heard_before, self._heard = self._heard, set()
        return False


def _identify(offers: Iterable[TopicEndpointInfo]) -> frozenset[bytes]:
    return frozenset(bytes(info.endpoint_gid) for info in offers)
