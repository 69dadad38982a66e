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

"""Topics of a bag that are published beside its images, and their quality of service."""

from __future__ import annotations

from collections.abc import Sequence

from opencv_tools.bags.offered_qos import KEEP_LAST, OfferedQos, read_offered_qos
from opencv_tools.bags.reading import BagTopic, CDR
from opencv_tools.bags.schemas import CAMERA_INFO, camera_info_topic
from opencv_tools.capture.bag import BagSource
from opencv_tools.topics.topic_patterns import matches
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy

_MAX_DEPTH = 1000
_UNKNOWN_DEPTH = 10  # of a publisher that keeps all messages, or does not announce how many
_TRANSIENT_LOCAL, _BEST_EFFORT = 1, 2  # see OfferedQos


def played_topics(source: BagSource, patterns: Sequence[str]) -> list[BagTopic]:
    """
    Return the topics that match, without those that are published with the images.

    Topics whose messages are not CDR, which cannot be published, are the last ones.
    """
    info = BagTopic(camera_info_topic(source.topic.name), CAMERA_INFO)
    return sorted((topic for topic in source.topics.keys() - {source.topic, info}
                   if matches(topic.name, patterns)),
                  key=lambda topic: (topic.serialization != CDR, topic.name, topic.type_name))


def playback_qos(topic: BagTopic, count: int) -> QoSProfile:
    """
    Return the profile of the one publisher that stands for all recorded ones.

    A late subscriber gets as many latched messages as all recorded publishers keep together. Fast
    DDS does not announce how many these are; then it gets all, at most 1000.

    :param topic: topic with the quality of service of its recorded publishers.
    :param count: number of messages of the topic in the bag.
    """
    offers = read_offered_qos(topic.qos) or [OfferedQos()]
    is_latched = max(offer.durability for offer in offers) == _TRANSIENT_LOCAL
    are_known = all(offer.depth and offer.history == KEEP_LAST for offer in offers)
    depths = [offer.depth if offer.depth and offer.history == KEEP_LAST else _UNKNOWN_DEPTH
              for offer in offers]
    depth = max(depths) if not is_latched else (
        sum(depths) if are_known else max(sum(depths), count))
    return QoSProfile(
        history=HistoryPolicy.KEEP_LAST, depth=min(depth, _MAX_DEPTH),
        reliability=(ReliabilityPolicy.BEST_EFFORT
                     if max(offer.reliability for offer in offers) == _BEST_EFFORT
                     else ReliabilityPolicy.RELIABLE),
        durability=(DurabilityPolicy.TRANSIENT_LOCAL if is_latched
                    else DurabilityPolicy.VOLATILE))


def differences(publish_rate: float, stamp: str) -> list[str]:
    """
    Return sentences about the times and stamps of images that are not those of the bag.

    :param publish_rate: frames per second; 0.0 for the times of the bag.
    :param stamp: stamps of the images, as the parameter ``stamp``.
    """
    found = []
    if publish_rate:
        found.append(f'images are published at {publish_rate:g} Hz, and other topics between '
                     'them, not at the times of the bag; set publish_rate:=0.0 for these times')
    if stamp != 'original':
        found.append('other topics keep the stamps of the bag, images do not; set stamp:=original '
                     'for the stamps of the bag')
    return found
