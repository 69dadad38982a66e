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

"""Image topics of the graph and the subscriptions to them, used in the executor only."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, field
from fnmatch import fnmatchcase
import itertools
from typing import Any

from opencv_tools.base.logs import Log
from opencv_tools.base.text import enumerated, printable
from opencv_tools.image.cdr import COMPRESSED_IMAGE, DISPARITY_IMAGE, IMAGE
from opencv_tools.image.compressed_depth import COMPRESSED_DEPTH
from opencv_tools.topics.options import SubscriptionOptions
from opencv_tools.topics.subscription import FrameSubscription
from opencv_tools.topics.topic_discovery import image_topics, UNKNOWN_NODE
from opencv_tools.video.messages import VIDEO_TOPICS
from opencv_tools.viewer.control import CameraControl
from opencv_tools.viewer.overlays.boxes import DETECTIONS
from opencv_tools.viewer.overlays.topics import OverlayTopics
from opencv_tools.viewer.protocol import base_name, MAX_TOPICS, VIDEOS
from opencv_tools.viewer.recording.bag_recording import Topic
from opencv_tools.viewer.robot_topics import RobotState, RobotTopics
from opencv_tools.viewer.streams.feed import Feed, FeedKey
from opencv_tools.viewer.streams.packets import PACKETS
from rclpy.node import Node

# Names of topics whose numbers are remembered.
_MAX_NUMBERS = 10_000

# Number of frames that the middleware keeps while the executor is busy.
_DEPTH = 3
_PACKET_DEPTH = 60  # a missing packet ends the video until the next key frame
_TRANSPORTS = {IMAGE: 'raw', COMPRESSED_IMAGE: 'compressed', DISPARITY_IMAGE: 'disparity',
               **dict.fromkeys(VIDEO_TOPICS, 'video')}
# Codecs of other transports, whose messages are not images that OpenCV can decode.
_OTHER_TRANSPORTS = ('/theora', '/zstd')


@dataclass(kw_only=True)
class ViewTopic:
    """
    An image topic: raw, compressed and video together.

    :param number: number of the topic, which never changes.
    :param name: name of the topic, without the end of a transport.
    :param transports: published transports: ``raw``, ``compressed``, ``disparity`` and ``video``.
    :param senders: published topics of the publishers, by their identifiers.
    """

    number: int
    name: str
    transports: list[str] = field(default_factory=list)
    nodes: list[str] = field(default_factory=list)
    publishers: int = 0
    senders: dict[bytes, str] = field(default_factory=dict)

    def as_json(self) -> dict[str, Any]:
        """Return the values of the protocol."""
        values = asdict(self)
        del values['senders']
        return {'id': values.pop('number'), **values}

    def transport(self, default: str, *, original: bool = False, video: bool = False) -> str:
        """
        Return the transport of a subscription.

        :param default: transport for pictures.
        :param original: whether raw images are preferred to other ones.
        :param video: whether packets of video are preferred.
        """
        if video and 'video' in self.transports:
            return PACKETS
        if self.transports == ['disparity']:
            return 'disparity'
        if original and 'raw' in self.transports and len(self.transports) > 1:
            return 'raw'
        return default


@dataclass(frozen=True)
class GraphState:
    """
    Topics and nodes at one moment.

    :param topics: topics by name, in alphabetical order.
    :param more: number of image topics that are not among them.
    :param nodes: names of the ``cameras`` and ``recorders`` that can be controlled; empty without
        control.
    :param detections: names of the topics with boxes.
    :param recording: account of the recording of the pages; None if they cannot record.
    """

    topics: dict[str, ViewTopic] = field(default_factory=dict)
    more: int = 0
    nodes: dict[str, list[str]] = field(default_factory=dict)
    robot: RobotState = field(default_factory=RobotState)
    detections: list[str] = field(default_factory=list)
    recording: dict[str, Any] | None = None

    def lists(self) -> dict[str, Any]:
        """Return what a page lists, by the name of the message."""
        return {'topics': [topic.as_json() for topic in self.topics.values()],
                'more': self.more, 'robot': self.robot.publishers[0] > 0,
                'detections': self.detections,
                **({'nodes': self.nodes} if self.nodes else {}),
                **({'recording': self.recording} if self.recording else {})}

    def describe_unknown(self, name: str) -> str:
        """Return the sentence about a name that is not an image topic."""
        sentence = f'{printable(name)} is not an image topic; '
        if not self.topics:
            return f'{sentence}no images are published'
        return (f'{sentence}the image topics are '
                f'{enumerated([*self.topics], further=self.more)}')


class Graph:
    """Find the image topics, and subscribe to those that somebody looks at."""

    def __init__(self, node: Node, patterns: Sequence[str], transport: str, log: Log,
                 control: CameraControl | None) -> None:
        """
        Create a graph without subscriptions.

        :param patterns: names of topics, with ``*`` for any text; empty for all topics.
        :param transport: ``auto``, ``raw`` or ``compressed``; auto prefers compressed images.
        :param control: control of other nodes, if it is allowed.
        """
        #: Node of the subscriptions.
        self.node = node
        self._patterns = patterns
        is_depth = transport == COMPRESSED_DEPTH
        self._transport = 'compressed' if is_depth else transport
        self._ending = f'/{COMPRESSED_DEPTH}' if is_depth else ''
        self._log = log
        self.control = control
        self._numbers: dict[str, int] = {}
        self._next_number = itertools.count(1)
        self._open: dict[FeedKey, tuple[Feed, FrameSubscription]] = {}
        #: Topics of the robot, used in the executor as well.
        self.robot = RobotTopics(node, self._is_wanted, log)
        #: Topics of overlays, used in the executor as well.
        self.overlays = OverlayTopics(node, self._is_wanted)

    def find(self, name: str) -> ViewTopic | None:
        """Return a published image topic, which need not be in the list."""
        found: dict[str, ViewTopic] = {}
        for base, published in self._published():
            if base == name:
                self._add_publishers(found, base, published)
        return found.get(name)

    def open(self, key: FeedKey, feed: Feed) -> None:  # noqa: A003
        """Subscribe to a topic; its frames go to a feed."""
        if key not in self._open:
            name, transport = key
            options = SubscriptionOptions(
                transport='video', depth=_PACKET_DEPTH, decodes_video=False,
            ) if transport == PACKETS else SubscriptionOptions(
                transport=transport, depth=_DEPTH, prefers_compressed=True)
            subscription = FrameSubscription(
                self.node, name, self._log, feed.put, feed.count_broken, options)
            self._open[key] = feed, subscription
            subscription.start()

    def close(self, key: FeedKey, feed: Feed) -> bool:
        """Unsubscribe the feed of a topic; return whether it was subscribed."""
        is_open = key in self._open and self._open[key][0] is feed
        if is_open:
            self._open.pop(key)[1].destroy()
        return is_open

    def close_all(self) -> None:
        """Unsubscribe from all topics."""
        for key, (feed, _) in tuple(self._open.items()):
            self.close(key, feed)
        self.robot.close()
        self.overlays.close_all()

    def state(self) -> GraphState:
        """Return the topics and nodes, and set the states of the feeds."""
        topics, more = self._topics()
        for (name, _), (feed, subscription) in self._open.items():
            feed.restarts.check(topics[name].senders)
            feed.reason = self._reason(topics[name], feed, subscription)
            feed.lost, feed.is_latched = subscription.account.lost, subscription.is_latched
        nodes = (self.control.nodes(node for topic in topics.values() for node in topic.nodes)
                 if self.control else {})
        recorder = self.control and self.control.recorder
        recording = recorder.state({
            topic.number: Topic(name, topic.transport(self._transport))
            for name, topic in topics.items()}) if recorder else None
        return GraphState(topics, more, nodes, self.robot.state(),
                          self.overlays.names(DETECTIONS), recording)

    def _topics(self) -> tuple[dict[str, ViewTopic], int]:
        """Return the topics of the list and those that somebody looks at; count the others."""
        found: dict[str, ViewTopic] = {}
        others = set()
        looked_at = {name for name, _ in self._open}
        for base, name in self._published():
            if base in found or base in looked_at or len(found) < MAX_TOPICS:
                self._add_publishers(found, base, name)
            else:
                others.add(base)
        for name in looked_at - found.keys():
            found[name] = self._topic(name)
        return dict(sorted(found.items())), len(others)

    def _published(self) -> Iterator[tuple[str, str]]:
        """Yield the names of the published image topics, without and with their ends."""
        types_shown = {name for name, transport in _TRANSPORTS.items()
                       if self._transport in ('auto', transport)}
        names = {*image_topics(self.node, types_shown)}
        for name in sorted(names):
            base = base_name(name)
            # All of them are those of an img_publisher of depth, which has no video.
            has_depth = names >= {f'{base}{end}' for end in (*VIDEOS, f'/{COMPRESSED_DEPTH}')}
            if (name.endswith(self._ending) and not name.endswith(_OTHER_TRANSPORTS)
                    and not (has_depth and name.endswith(VIDEOS)) and self._is_wanted(base)):
                yield base, name

    def _reason(self, topic: ViewTopic, feed: Feed, subscription: FrameSubscription) -> str:
        if not feed.look() or (feed.frames and topic.publishers and subscription.is_latched):
            return ''
        if not topic.publishers:
            return f'no publisher on {printable(topic.name)}: it has ended, or the network is cut'
        return subscription.explain_no_frames()

    def _is_wanted(self, name: str) -> bool:
        return not self._patterns or any(fnmatchcase(name, wanted) for wanted in self._patterns)

    def _topic(self, name: str) -> ViewTopic:
        if name not in self._numbers:
            self._numbers[name] = next(self._next_number)
            if len(self._numbers) > _MAX_NUMBERS:
                del self._numbers[next(iter(self._numbers))]
        return ViewTopic(number=self._numbers[name], name=name)

    def _add_publishers(self, found: dict[str, ViewTopic], base: str, name: str) -> None:
        """Add the publishers of a raw, compressed or video topic to the image topic."""
        count = 0
        for info in self.node.get_publishers_info_by_topic(name):
            transport = _TRANSPORTS.get(info.topic_type)
            if transport is None or self._transport not in ('auto', transport) or (
                    name.endswith(VIDEOS) and transport != 'video'):
                continue
            count += 1
            if base not in found:
                found[base] = self._topic(base)
            topic = found[base]
            node = printable(f'{info.node_namespace.rstrip("/")}/{info.node_name}')
            topic.publishers = max(topic.publishers, count)
            topic.senders[bytes(info.endpoint_gid)] = name
            if transport not in topic.transports:
                topic.transports.append(transport)
            if node not in topic.nodes and info.node_name != UNKNOWN_NODE:
                topic.nodes.append(node)


def open_again(graph: Graph, key: FeedKey, feed: Feed) -> None:
    """Subscribe the feed of a topic again, for a key frame."""
    if graph.close(key, feed):
        graph.open(key, feed)
