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

"""Image topics, raw and compressed, and their publishers."""

from __future__ import annotations

from collections.abc import Sequence, Set
from dataclasses import dataclass
import os
import re
import time

from opencv_tools.base.text import enumerated, printable
from opencv_tools.image.cdr import COMPRESSED_IMAGE, DISPARITY_IMAGE, IMAGE
from opencv_tools.image.compressed_depth import COMPRESSED_DEPTH
from opencv_tools.topics.errors import ParameterError, ROS_ERRORS, ros_reason
from opencv_tools.topics.messages import MESSAGE_TYPES
from opencv_tools.topics.qos import qos_mismatch
from opencv_tools.transport.fastdds.profile import is_local
from opencv_tools.transport.fastdds.shared_memory import find_other_user
from opencv_tools.video.messages import VIDEO_TOPICS
from rclpy.node import Node
from rclpy.qos import QoSProfile
from rclpy.topic_endpoint_info import TopicEndpointInfo

#: Types of the messages that each transport uses.
TRANSPORTS = {
    'auto': (IMAGE, COMPRESSED_IMAGE, *VIDEO_TOPICS), 'raw': (IMAGE,),
    'compressed': (COMPRESSED_IMAGE,), COMPRESSED_DEPTH: (COMPRESSED_IMAGE,),
    'video': (*VIDEO_TOPICS,), 'disparity': (DISPARITY_IMAGE,), 'shm': (IMAGE,)}

# What rmw allows, less the longest suffix that a topic gets here.
_MAX_NAME = 247 - len(f'/{COMPRESSED_DEPTH}')
_HOST = slice(2, 4)  # of the identifier of an endpoint, as Fast DDS gives it
_NAME = re.compile(r'/[A-Za-z0-9_/]+')
# Time in which the topics of a publisher on another machine are discovered.
_COMPLETE_SECONDS = 1.0
#: Name of a publishing node that was not discovered yet, or that is no node of ROS.
UNKNOWN_NODE = '_NODE_NAME_UNKNOWN_'


@dataclass(frozen=True)
class ImageTopic:
    """
    A topic that may have frames.

    :param name: name of the topic before remapping.
    :param is_depth: whether its compressed images are those of compressed_depth_image_transport.
    """

    name: str
    type_name: str
    is_depth: bool = False

    @property
    def is_video(self) -> bool:
        """Whether its messages are pictures of video."""
        return self.type_name in VIDEO_TOPICS


def resolve_topic(node: Node, topic: str) -> str:
    """
    Return the name of a topic after remapping.

    :param topic: name before remapping.
    :raises ParameterError: the name is invalid.
    """
    refused = f'the topic name {topic!r} cannot be used: '
    if not isinstance(topic, str) or '\0' in topic:
        raise ParameterError(f'{refused}give a text without NUL')
    try:
        resolved = str(node.resolve_topic_name(topic))
    except ROS_ERRORS as err:
        raise ParameterError(f'{refused}{ros_reason(err)}') from err
    if len(resolved) > _MAX_NAME:
        raise ParameterError(f'{refused}with its namespace it has {len(resolved)} characters; '
                             f'give at most {_MAX_NAME}')
    return resolved


def image_topics(node: Node, types: Set[str] = MESSAGE_TYPES.keys()) -> list[str]:
    """
    Return the names of the topics that have publishers or subscriptions of images, sorted.

    :param types: types of messages to find.
    """
    # Topics that are not of ROS have other names.
    return sorted(name for name, found in node.get_topic_names_and_types()
                  if _NAME.fullmatch(name) and not types.isdisjoint(found))


_WITHOUT_VIDEO = ('images with 16 bits or floating-point numbers have no video: set '
                  'transport:=raw to receive them')


class TopicDiscovery:
    """The raw, compressed and video topics of an image topic, and their publishers."""

    def __init__(
        self, node: Node, topic: str, transport: str, *, prefers_compressed: bool = False,
    ) -> None:
        """
        List the topics.

        :param topic: name of the image topic before remapping.
        :param transport: one of ``TRANSPORTS``.
        :param prefers_compressed: whether compressed topics are better than raw ones.
        :raises ParameterError: the transport or the name of the topic is invalid.
        """
        if transport not in TRANSPORTS:
            raise ParameterError(f'transport is {transport!r}: give one of '
                                 f'{", ".join(TRANSPORTS)}')
        #: Node whose graph is queried.
        self.node = node
        #: Name of the image topic after remapping.
        self.resolved = resolve_topic(node, topic)
        self._topic = topic
        self._possible = _possible_topics(topic, self.resolved)
        #: Topics that the transport allows, best first.
        self.allowed = sorted(
            (possible for possible in self._possible
             if possible.type_name in TRANSPORTS[transport] and (
                 possible.is_depth if transport == COMPRESSED_DEPTH else
                 transport != 'compressed' or not possible.is_depth or possible.name == topic)),
            key=lambda allowed: prefers_compressed * (
                2 * allowed.is_video + (allowed.type_name == IMAGE or allowed.is_depth)))
        self._video = [possible for possible in self.allowed if possible.is_video]
        self._host: bytes | None = None  # of this process
        self._has_other_hosts = not is_local() or bool(os.environ.get('ROS_STATIC_PEERS'))
        self._found_at = 0.0

    def publishers(self, image_topic: ImageTopic) -> list[TopicEndpointInfo]:
        """Return the publishers of a topic."""
        return [info for info in self.node.get_publishers_info_by_topic(image_topic.name)
                if info.topic_type == image_topic.type_name]

    def describe_publishers(self, image_topic: ImageTopic, publishers: Set[bytes]) -> str:
        """Return the names of the nodes of some publishers of a topic."""
        return enumerated(sorted(
            _describe_node(info) for info in self.publishers(image_topic)
            if bytes(info.endpoint_gid) in publishers))

    def best(self) -> ImageTopic | None:
        """Return the best topic that has a publisher, or None."""
        found = [*filter(self.publishers, self.allowed)]
        if not found or not self.prefers_video(found[0]):
            return found[0] if found else None
        video = [one for one in found if one.is_video]
        # A publisher with all kinds of video is one of this package, which has a topic of depth
        # for depth only. Depth has no video.
        depth = [one for one in found if one.is_depth and len(video) == len(VIDEO_TOPICS)]
        return (depth or video)[0]

    def is_complete(self) -> bool:
        """
        Return whether `best` is the choice, because no better topic is to be expected.

        The topics of a publisher on another machine are not discovered at once. Raw images of the
        first one would fill a slow link, and delay the discovery of the others.
        """
        if not self._has_other_hosts or len({one.is_video for one in self.allowed}) == 1:
            return True
        best, now = self.best(), time.monotonic()
        if best is None:
            self._found_at = 0.0
            return False
        self._found_at = self._found_at or now
        return (best.is_video or now - self._found_at >= _COMPLETE_SECONDS
                or not all(map(self._is_remote, self.publishers(best))))

    def prefers_video(self, image_topic: ImageTopic) -> bool:
        """Return whether video is better, because the publishers are on other machines."""
        return (not image_topic.is_video and any(map(self.publishers, self._video))
                and all(map(self._is_remote, self.publishers(image_topic))))

    def _is_remote(self, info: TopicEndpointInfo) -> bool:
        """Return whether a publisher is on another machine, as far as Fast DDS tells."""
        if self._host is None:
            own = self.node.get_name(), self.node.get_namespace()
            self._host = next((
                bytes(found.endpoint_gid)[_HOST]
                for found in self.node.get_publishers_info_by_topic('/parameter_events')
                if (found.node_name, found.node_namespace) == own), None)
        return self._host not in (None, bytes(info.endpoint_gid)[_HOST])

    def explain_no_frames(self, image_topic: ImageTopic, qos: QoSProfile) -> str:
        """Return the reason why no frame arrives, with a remedy, as a sentence."""
        topic = self._resolved_name(image_topic)
        publishers = self.node.get_publishers_info_by_topic(image_topic.name)
        offers = [info for info in publishers if info.topic_type == image_topic.type_name]
        depth = [one.name for one in self._possible if one.is_depth and self.publishers(one)]
        if offers and image_topic.is_video and depth:
            return (f'{topic} has no frame, because depth has no video, and {depth[0]} has depth; '
                    'set transport:=compressedDepth, or transport:=raw')
        if offers:
            return _describe_silent(topic, offers, qos)
        for published in self._possible:
            infos = self.publishers(published)
            if infos:
                return self._describe_other_type(image_topic, published, infos[0])
        if publishers:
            return (f'{topic} has a publisher of type {printable(publishers[0].topic_type)} '
                    f'({_describe_node(publishers[0])}), not {image_topic.type_name}; '
                    f'{self._describe_images()}')
        return f'no publisher on {topic}; {self._describe_images()}'

    def _resolved_name(self, image_topic: ImageTopic) -> str:
        return self.node.resolve_topic_name(image_topic.name)

    def _describe_other_type(
        self, subscribed: ImageTopic, published: ImageTopic, info: TopicEndpointInfo,
    ) -> str:
        """Describe frames of the other message type."""
        topic, name = self._resolved_name(subscribed), self._resolved_name(published)
        transport = COMPRESSED_DEPTH if published.is_depth else next(
            name for name, types in TRANSPORTS.items()
            if name != 'auto' and published.type_name in types)
        if name == topic:
            publisher = f'{name} has a publisher of type {published.type_name} ' \
                        f'({_describe_node(info)}), not {subscribed.type_name}'
        else:
            publisher = f'no publisher of {subscribed.type_name} on {topic}, but one of ' \
                        f'{published.type_name} on {name} ({_describe_node(info)})'
        return f'{publisher}; set transport:={transport} or transport:=auto'

    def _describe_images(self) -> str:
        """Describe the topics that have images, and how to subscribe to one."""
        topics = {}
        own = self.node.get_name(), self.node.get_namespace()  # a filter publishes as well
        for name in image_topics(self.node):
            published = {
                info.topic_type for info in self.node.get_publishers_info_by_topic(name)
                if (info.node_name, info.node_namespace) != own}
            if published & MESSAGE_TYPES.keys():
                topics[name] = published
        domain = f'ROS_DOMAIN_ID {self.node.context.get_domain_id()}'
        if not topics:
            return f'no images are published in {domain}; ' \
                   'is a publisher running, with the same ROS_DOMAIN_ID?'
        allowed = {image_topic.type_name for image_topic in self.allowed}
        example = next((name for name, types in topics.items() if not allowed.isdisjoint(types)),
                       '')
        remedy = f'receive one with -r {self._topic}:={example or next(iter(topics))}'
        if self._topic.startswith('/'):  # chosen from a list, as img_viewer does
            remedy = 'choose one of them'
        elif not example:
            remedy += ' -p transport:=auto'
        return f'images are published on {enumerated([*map(printable, topics)])} in {domain}; ' \
               f'{remedy}'


def _possible_topics(topic: str, resolved: str) -> Sequence[ImageTopic]:
    """Return the topics that may have the frames of an image topic, best first."""
    raw = ImageTopic(topic, IMAGE)
    is_depth = resolved.endswith(f'/{COMPRESSED_DEPTH}')
    compressed = ImageTopic(topic, COMPRESSED_IMAGE, is_depth)
    depth = ImageTopic(f'{resolved}/{COMPRESSED_DEPTH}', COMPRESSED_IMAGE, is_depth=True)
    subtopic = ImageTopic(f'{resolved}/compressed', COMPRESSED_IMAGE)
    video = [ImageTopic(f'{resolved}/{suffix}', type_name)
             for type_name, suffix in VIDEO_TOPICS.items()]
    own_video = [ImageTopic(topic, type_name) for type_name in VIDEO_TOPICS]
    if is_depth or resolved.endswith('/compressed'):
        return compressed, raw, subtopic, *own_video
    if resolved.endswith(tuple(f'/{suffix}' for suffix in VIDEO_TOPICS.values())):
        return *own_video, raw, compressed
    return raw, subtopic, compressed, depth, *video, *own_video, ImageTopic(topic, DISPARITY_IMAGE)


def _describe_silent(
    topic: str, offers: Sequence[TopicEndpointInfo], request: QoSProfile,
) -> str:
    """Describe why publishers of the right type deliver no frame."""
    mismatches = [(info, qos_mismatch(info.qos_profile, request)) for info in offers]
    if all(mismatch for _, mismatch in mismatches):
        info, mismatch = mismatches[0]
        return (f'the publisher of {topic} ({_describe_node(info)}) does not offer the requested '
                f'quality of service: {mismatch}; change that of the publisher')
    nodes = enumerated(sorted({_describe_node(info) for info in offers}))
    without_video = f'; {_WITHOUT_VIDEO}' if offers[0].topic_type in VIDEO_TOPICS else ''
    user = find_other_user()
    if user:
        return (f'no frame arrives from the publisher of {topic} ({nodes}); user {user} also runs '
                'nodes on this machine, and Fast DDS shares no memory between users: run all '
                'nodes as one user')
    return (f'no frame arrives from the publisher of {topic} ({nodes}); the publisher may be '
            'paused or have crashed, may wait for another slow or killed subscriber, or have no '
            'frames from its source; containers on one machine '
            f'have to share /dev/shm (--ipc=host){without_video}')


def _describe_node(info: TopicEndpointInfo) -> str:
    if info.node_name == UNKNOWN_NODE:
        return 'not a ROS node'
    return 'node ' + printable(f'{info.node_namespace.rstrip("/")}/{info.node_name}')
