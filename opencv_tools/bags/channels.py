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

"""The topic of a bag as a channel of another bag, and its quality of service."""

from __future__ import annotations

from opencv_tools.bags.offered_qos import KEEP_ALL, KEEP_LAST, read_offered_qos
from opencv_tools.bags.reading import BagTopic, ROS2MSG
from opencv_tools.bags.writing import BagChannel
from opencv_tools.message_types.definition import DefinitionError, read_definition

_TRANSIENT_LOCAL = 1
#: Most messages of a topic that are repeated in the next file of a recording.
MOST_KEPT = 100


def kept_messages(topic: BagTopic | BagChannel, is_one_publisher: bool = False) -> int:
    """
    Return how many messages the publishers of a topic keep for late subscribers, up to 100.

    The depth of a publisher may be unknown, because discovery need not carry it: 1 then.

    :param is_one_publisher: whether those of one publisher are counted, the largest number.
    """
    depths = [max(1, {KEEP_LAST: offer.depth, KEEP_ALL: MOST_KEPT}.get(offer.history, 1))
              for offer in read_offered_qos(topic.qos) if offer.durability == _TRANSIENT_LOCAL]
    return min(MOST_KEPT, max(depths, default=0) if is_one_publisher else sum(depths))


def channel_of(topic: BagTopic) -> BagChannel:
    """Return a topic of a bag as a channel, with its definition or else that of this package."""
    encoding, definition = topic.other_schema or (ROS2MSG, topic.definition)
    if not definition and encoding == ROS2MSG:
        try:
            definition = read_definition(topic.type_name).text
        except DefinitionError:
            definition = ''  # a reader with the package can read it
    return BagChannel(topic=topic.name, type_name=topic.type_name, qos=topic.qos,
                      type_hash=topic.type_hash, definition=definition, schema_encoding=encoding)
