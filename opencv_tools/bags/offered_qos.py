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

"""Quality of service of the publishers of a topic, as rosbag2 stores it."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from opencv_tools.units import NANO

#: The longest duration, which stands for no limit.
INFINITE_NS = 2**63 - 1


@dataclass(frozen=True, kw_only=True)
class OfferedQos:
    """
    Quality of service that a publisher offers.

    The policies are the numbers of rmw/types.h, because rosbag2 of ROS 2 Humble reads no names.

    :param history: 1 to keep the last messages, 2 to keep all, 3 if unknown.
    :param depth: number of messages that are kept.
    :param reliability: 1 for reliable, 2 for best effort.
    :param durability: 1 for transient local, 2 for volatile.
    :param deadline_ns: longest time between two messages in nanoseconds.
    :param lifespan_ns: time in nanoseconds after which a message is old.
    :param liveliness: 1 for automatic, 3 for manual by topic.
    :param liveliness_lease_ns: longest time between two signs of life in nanoseconds.
    """

    history: int = 1
    depth: int = 10
    reliability: int = 1
    durability: int = 2
    deadline_ns: int = INFINITE_NS
    lifespan_ns: int = INFINITE_NS
    liveliness: int = 1
    liveliness_lease_ns: int = INFINITE_NS


def offered_qos_text(offers: Iterable[OfferedQos]) -> str:
    """
    Return the YAML text of the metadata ``offered_qos_profiles`` of a channel.

    :param offers: quality of service of each publisher.
    """
    return ''.join(
        f'- history: {offer.history}\n'
        f'  depth: {offer.depth}\n'
        f'  reliability: {offer.reliability}\n'
        f'  durability: {offer.durability}\n'
        f'  deadline:\n{_duration(offer.deadline_ns)}'
        f'  lifespan:\n{_duration(offer.lifespan_ns)}'
        f'  liveliness: {offer.liveliness}\n'
        f'  liveliness_lease_duration:\n{_duration(offer.liveliness_lease_ns)}'
        '  avoid_ros_namespace_conventions: false\n' for offer in offers)


def _duration(nanoseconds: int) -> str:
    sec, nsec = divmod(min(max(0, nanoseconds), INFINITE_NS), NANO)
    return f'    sec: {sec}\n    nsec: {nsec}\n'
