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
import re

from opencv_tools.base.units import NANO

#: The longest duration, which stands for no limit.
INFINITE_NS = 2**63 - 1

#: The history of a publisher that keeps its last messages, or all.
KEEP_LAST, KEEP_ALL = 1, 2

# A line of a policy, without quotes; the first one of a publisher begins with a dash.
_POLICY = re.compile(
    r"(?P<first>- )?\s*(?P<name>history|depth|reliability|durability): '?(?P<value>\w{1,20})'?\s*")
_NUMBERS = {
    ('history', 'keep_last'): 1, ('history', 'keep_all'): 2, ('reliability', 'reliable'): 1,
    ('reliability', 'best_effort'): 2, ('durability', 'transient_local'): 1,
    ('durability', 'volatile'): 2}


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

    history: int = KEEP_LAST
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


def read_offered_qos(text: str) -> list[OfferedQos]:
    """
    Read the metadata ``offered_qos_profiles`` of a channel, with the policies that playback needs.

    :param text: YAML text, in which policies are numbers or, since ROS 2 Jazzy, names.
    :returns: history, depth, reliability and durability of each publisher; unknown values are
        replaced by the defaults.
    """
    offers: list[dict[str, str]] = []
    for line in text.splitlines():
        found = _POLICY.fullmatch(line)
        if found and found['first']:
            offers.append({})
        if found and offers:
            offers[-1].setdefault(found['name'], found['value'])
    numbers = [{name: _NUMBERS.get((name, value), int(value) if value.isdecimal() else None)
                for name, value in offer.items()} for offer in offers]
    return [OfferedQos(**{name: number for name, number in offer.items() if number is not None})
            for offer in numbers]


def _duration(nanoseconds: int) -> str:
    sec, nsec = divmod(min(max(0, nanoseconds), INFINITE_NS), NANO)
    return f'    sec: {sec}\n    nsec: {nsec}\n'
