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

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
import time
from typing import Any, TypedDict

from opencv_tools.image.cdr import CdrError
from opencv_tools.ros.messages import FrameMessage, read_compressed_image, read_image
from opencv_tools.ros.qos import describe_qos, following_qos, qos_mismatch
from rclpy.clock import Clock, ClockType
from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from rclpy.topic_endpoint_info import TopicEndpointInfo
from sensor_msgs.msg import CompressedImage, Image

TRANSPORTS = ('auto', 'raw', 'compressed')

_IMAGE = 'sensor_msgs/msg/Image'
_COMPRESSED_IMAGE = 'sensor_msgs/msg/CompressedImage'
_TYPES: dict[str, tuple[Any, Callable[[bytes], FrameMessage]]] = {
    _IMAGE: (Image, read_image),
    _COMPRESSED_IMAGE: (CompressedImage, read_compressed_image),
}

# The executor has an event for a publisher of the same type only; for the rest the graph is looked
# at. Each look wakes the executor, which is what it costs.
_LOOK_SECONDS = 0.5
# A new subscription is known to every publisher by then, over a slow network too.
_OVERLAP_SECONDS = 1.0
_SILENCE_SECONDS = 3.0
_SILENCE_PERIODS = 3
# How much of the usual time between frames each frame makes.
_PERIOD_WEIGHT = 1 / 8
# As many messages as Fast DDS keeps for a subscription at most.
_REMEMBERED = 5000
_NAMED_TOPICS = 5
_UNKNOWN_NODE = '_NODE_NAME_UNKNOWN_'


class MessageInfo(TypedDict):
    """What rclpy tells of a message, as far as it is used here; a middleware may lack any."""

    source_timestamp: int | None
    received_timestamp: int | None
    publication_sequence_number: int | None


@dataclass(frozen=True)
class _Source:
    """
    Where frames may be.

    :param name: of the topic, before it is remapped.
    :param type_name: of its messages.
    """

    name: str
    type_name: str


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
        self, node: Node, topic: str, transport: str, keep_all: bool,
        on_frame: Callable[[FrameMessage, int], None], on_broken: Callable[[CdrError], None],
    ) -> None:
        """
        Subscribe.

        :param node: the node that receives.
        :param topic: of the images, as in ``-r topic:=other``.
        :param transport: one of ``TRANSPORTS``.
        :param keep_all: keep every frame until it is taken, as far as the middleware can, not only
            the newest ten.
        :param on_frame: takes a message, and when it was received: nanoseconds of the system
            clock.
        :param on_broken: takes the error of a message that cannot be read.
        """
        self._node = node
        self._topic = topic
        self._keep_all = keep_all
        self._on_frame = on_frame
        self._on_broken = on_broken
        self._known_sources = _list_sources(topic, node.resolve_topic_name(topic))
        allowed = {'raw': {_IMAGE}, 'compressed': {_COMPRESSED_IMAGE}}.get(transport, _TYPES)
        self._sources = [source for source in self._known_sources if source.type_name in allowed]
        self._candidate: _Source | None = None
        self._has_frames = False  # since a publisher is there
        self._lost = 0
        self._last_number = 0
        self._publishers: frozenset[bytes] = frozenset()
        self._heard: set[tuple[int, int]] = set()
        self._heard_before: set[tuple[int, int]] = set()
        self._period = 0.0
        self._frame_at = 0.0
        self._silence = self._checked_at = 0.0
        self._said = ''
        self._previous: _Reception | None = None
        self._retire_at = 0.0
        source = self._best_source() or self._sources[0]
        self._reception = self._receive_from(source, self._best_qos(self._offers(source)))
        self._looked_at = time.monotonic()
        self._timer = node.create_timer(
            _LOOK_SECONDS, self._look, clock=Clock(clock_type=ClockType.STEADY_TIME))

    @property
    def topic_name(self) -> str:
        """Give the topic that is subscribed to now, as it is after remapping."""
        return self._reception.topic_name

    @property
    def lost(self) -> int:
        """
        Count the messages that were published but did not arrive.

        Known only while the topic has one publisher: each counts its messages for itself.
        """
        return self._lost

    def describe_silence(self) -> str:
        """Say in a sentence why no frame arrives, and what helps."""
        source = self._reception.source
        publishers = self._node.get_publishers_info_by_topic(source.name)
        offers = [info for info in publishers if info.topic_type == source.type_name]
        if offers:
            return _describe_silent(self.topic_name, offers, self._reception.qos)
        for other in self._known_sources:
            found = self._offers(other)
            if found:
                return self._describe_other_transport(other, found[0])
        if publishers:
            return (f'{self.topic_name} has a publisher of type {publishers[0].topic_type} '
                    f'({_describe_node(publishers[0])}), not {source.type_name}; '
                    f'{self._describe_images()}')
        return f'no publisher on {self.topic_name}; {self._describe_images()}'

    def destroy(self) -> None:
        """Receive no more."""
        self._node.destroy_timer(self._timer)
        for reception in (self._previous, self._reception):
            if reception:
                reception.destroy()
        self._previous = None

    # Publishers and what they offer

    def _offers(self, source: _Source) -> list[TopicEndpointInfo]:
        """Find the publishers of a source."""
        return [info for info in self._node.get_publishers_info_by_topic(source.name)
                if info.topic_type == source.type_name]

    def _best_source(self) -> _Source | None:
        """Find the first source that has a publisher."""
        return next(filter(self._offers, self._sources), None)

    def _best_qos(self, offers: Iterable[TopicEndpointInfo]) -> QoSProfile:
        return following_qos([info.qos_profile for info in offers], self._keep_all)

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
        self._watch_silence(elapsed)

    def _choose_source(self) -> None:
        """Change to the source that has publishers when this one has none, or no frames yet."""
        current = self._reception.source
        if len(self._sources) == 1 or (self._has_frames and self._offers(current)):
            return
        self._has_frames = False
        best = self._best_source() or current
        # A camera's topics do not appear at the same time; the better one may be the next.
        if best not in (current, self._candidate):
            self._candidate = best
            return
        self._candidate = None
        if best != current:
            self._subscribe_again(best, self._best_qos(self._offers(best)))
            self._period = 0.0

    def _follow(self, _event: object = None) -> None:
        """Subscribe again when what was asked for does not fit, or new publishers offer more."""
        reception = self._reception
        offers = self._offers(reception.source)
        qos = self._best_qos(offers)
        are_new = not self._publishers & _identify(offers)
        self._notice(offers)
        if offers and qos != reception.qos and (are_new or any(
                qos_mismatch(info.qos_profile, reception.qos) for info in offers)):
            self._subscribe_again(reception.source, qos)

    def _notice(self, offers: Iterable[TopicEndpointInfo]) -> None:
        """Begin to count anew, and to wait for a frame, when the publishers are others."""
        publishers = _identify(offers)
        if publishers != self._publishers:
            self._publishers = publishers
            self._last_number = 0
            self._frame_at = self._silence = self._checked_at = 0.0

    # Subscriptions

    def _receive_from(self, source: _Source, qos: QoSProfile) -> _Reception:
        return _Reception(self._node, source, qos, self._take, self._follow)

    def _subscribe_again(self, source: _Source, qos: QoSProfile) -> None:
        old = self._reception
        self._retire_previous()
        self._previous, self._retire_at = old, time.monotonic() + _OVERLAP_SECONDS
        if source != old.source or not old.publisher_count():
            # Nothing can come any more, or not the same; and a topic has one type in a process.
            self._retire_previous()
        self._reception = self._receive_from(source, qos)
        self._node.get_logger().info(
            f'Receiving {self.topic_name} ({source.type_name}, {describe_qos(qos)}), '
            'as its publishers offer')

    def _retire_previous(self) -> None:
        """Let go of the old subscription, once what it has received is passed on."""
        if self._previous:
            self._previous.drain()
            self._previous.destroy()
            self._previous = None

    def _take(self, reception: _Reception, data: bytes, info: MessageInfo) -> None:
        """Pass a message on, unless it was before."""
        number = info.get('publication_sequence_number') or 0
        if self._previous and reception is not self._previous:
            self._previous.drain()  # first what came first
        if self._is_repeated((info.get('source_timestamp') or 0, number)):
            return
        self._has_frames = True
        self._count_lost(reception, number)
        try:
            message = reception.read(data)
        except CdrError as err:
            self._on_broken(err)
        else:
            self._on_frame(message, info.get('received_timestamp') or time.time_ns())
        self._end_silence()

    def _is_repeated(self, identity: tuple[int, int]) -> bool:
        """Tell whether another subscription has passed a message on, and remember it."""
        if identity in self._heard or identity in self._heard_before:
            return identity[0] > 0  # without a time there is nothing to know it by
        self._heard.add(identity)
        if len(self._heard) == _REMEMBERED:
            self._heard_before, self._heard = self._heard, set()
        return False

    def _count_lost(self, reception: _Reception, number: int) -> None:
        """Count the messages that were published since the last one but did not arrive."""
        if not number or reception.publisher_count() != 1:
            self._last_number = 0
            return
        if self._last_number and number > self._last_number + 1:
            # Seldom, so there is time to see whether it is the same publisher still.
            self._notice(self._offers(reception.source))
        if self._last_number:
            self._lost += max(0, number - self._last_number - 1)
        # What was published before may come later, when it is asked for.
        self._last_number = max(number, self._last_number)

    # Silence

    def _end_silence(self) -> None:
        now = time.monotonic()
        if self._frame_at:
            interval = now - self._frame_at
            self._period += (interval - self._period) * (_PERIOD_WEIGHT if self._period else 1)
        self._frame_at = now
        self._silence = self._checked_at = 0.0
        if self._said:
            self._said = ''
            self._node.get_logger().info(f'Frames arrive on {self.topic_name}')

    def _watch_silence(self, elapsed: float) -> None:
        """Say why there are no frames, and say it again only when the reason is another."""
        self._silence += elapsed
        patience = max(_SILENCE_SECONDS, _SILENCE_PERIODS * self._period)
        if self._silence - self._checked_at < patience:
            return
        self._checked_at = self._silence
        latched = self._reception.qos.durability == DurabilityPolicy.TRANSIENT_LOCAL
        if latched and self._has_frames and self._publishers:
            return  # one picture may be all there is
        reason = self.describe_silence()
        if reason != self._said:
            self._said = reason
            self._node.get_logger().warning(f'No frames: {reason}')

    def _describe_other_transport(self, other: _Source, info: TopicEndpointInfo) -> str:
        """Say that there are frames, but not of the kind that was asked for."""
        name = self._node.resolve_topic_name(other.name)
        given = 'raw' if other.type_name == _IMAGE else 'compressed'
        wanted = self._reception.source.type_name
        if name == self.topic_name:
            fact = f'{name} has a publisher of type {other.type_name} ({_describe_node(info)}), ' \
                   f'not {wanted}'
        else:
            fact = f'no publisher of {wanted} on {self.topic_name}, but one of ' \
                   f'{other.type_name} on {name} ({_describe_node(info)})'
        return f'{fact}; set transport:={given} or transport:=auto'

    def _find_images(self) -> dict[str, set[str]]:
        """Find the topics where images are published, with their types, in order."""
        found = {}
        for name, types in sorted(self._node.get_topic_names_and_types()):
            if not _TYPES.keys().isdisjoint(types):  # which subscriptions have as well
                published = {
                    info.topic_type for info in self._node.get_publishers_info_by_topic(name)}
                if published & _TYPES.keys():
                    found[name] = published
        return found

    def _describe_images(self) -> str:
        """Say which topics have frames, and how to receive one."""
        topics = self._find_images()
        domain = f'ROS_DOMAIN_ID {self._node.context.get_domain_id()}'
        if not topics:
            return f'nobody publishes images in {domain}; ' \
                   'is a publisher running, with the same ROS_DOMAIN_ID?'
        allowed = {source.type_name for source in self._sources}
        example = next((name for name, types in topics.items() if not allowed.isdisjoint(types)),
                       '')
        remedy = f'-r {self._topic}:={example or next(iter(topics))}'
        if not example:
            remedy += ' -p transport:=auto'
        return f'there are images on {_enumerate(list(topics))} in {domain}; ' \
               f'receive one with {remedy}'


class _Reception:
    """One subscription of the middleware."""

    def __init__(
        self, node: Node, source: _Source, qos: QoSProfile,
        take: Callable[[_Reception, bytes, MessageInfo], None],
        on_publishers: Callable[[object], None],
    ) -> None:
        self.source = source
        self.qos = qos
        self._node = node
        self._take = take
        message_type, self.read = _TYPES[source.type_name]
        self._subscription = node.create_subscription(
            message_type, source.name, self._receive, qos, raw=True,
            event_callbacks=SubscriptionEventCallbacks(
                incompatible_qos=on_publishers, matched=on_publishers,
                use_default_callbacks=False))
        self.topic_name: str = self._subscription.topic_name

    def publisher_count(self) -> int:
        """Count the publishers that it receives from."""
        count: int = self._subscription.get_publisher_count()
        return count

    def drain(self) -> None:
        """Take what it has received until now."""
        now = time.time_ns()
        received = 0
        handle = self._subscription.handle
        while received < now:
            with handle:
                taken = handle.take_message(self._subscription.msg_type, self._subscription.raw)
            if taken is None:
                return
            self._receive(*taken)
            received = taken[1].get('received_timestamp') or 0

    def destroy(self) -> None:
        """Receive no more."""
        self._node.destroy_subscription(self._subscription)

    def _receive(self, data: bytes, info: MessageInfo) -> None:
        self._take(self, data, info)


def _list_sources(topic: str, resolved: str) -> Sequence[_Source]:
    """List where the frames of a topic may be, the best first."""
    image = _Source(topic, _IMAGE)
    itself = _Source(topic, _COMPRESSED_IMAGE)
    beside = _Source(f'{resolved}/compressed', _COMPRESSED_IMAGE)
    if resolved.endswith('/compressed'):
        return itself, image, beside
    return image, beside, itself


def _identify(offers: Iterable[TopicEndpointInfo]) -> frozenset[bytes]:
    return frozenset(bytes(info.endpoint_gid) for info in offers)


def _describe_silent(
    topic: str, offers: Sequence[TopicEndpointInfo], request: QoSProfile,
) -> str:
    """Say why publishers of the right type are not heard."""
    mismatches = [(info, qos_mismatch(info.qos_profile, request)) for info in offers]
    if all(mismatch for _, mismatch in mismatches):
        info, mismatch = mismatches[0]
        return (f'the publisher of {topic} ({_describe_node(info)}) does not offer the quality of '
                f'service that is asked for: {mismatch}; change that of the publisher')
    nodes = _enumerate(sorted({_describe_node(info) for info in offers}))
    return (f'{topic} has a publisher ({nodes}), which sends nothing that arrives; it may be '
            'paused or its source may have no frames, and containers on one machine have to '
            'share /dev/shm (--ipc=host)')


def _describe_node(info: TopicEndpointInfo) -> str:
    if info.node_name == _UNKNOWN_NODE:
        return 'which is no node of ROS'
    return f'node {info.node_namespace.rstrip("/")}/{info.node_name}'


def _enumerate(names: Sequence[str]) -> str:
    more = f' and {len(names) - _NAMED_TOPICS} more' if len(names) > _NAMED_TOPICS else ''
    return ', '.join(names[:_NAMED_TOPICS]) + more
