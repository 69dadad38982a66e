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

"""Quality of service in a bag, read by rosbags."""

from __future__ import annotations

from opencv_tools.bags.offered_qos import offered_qos_text, OfferedQos, read_offered_qos
import pytest

rosbags = pytest.importorskip('rosbags.rosbag2.metadata', reason='pip install rosbags')


def test_policies_are_read_by_rosbags() -> None:
    first, second = rosbags.parse_qos(offered_qos_text([
        OfferedQos(), OfferedQos(history=3, depth=0, reliability=2, durability=1,
                                 deadline_ns=1_500_000_000, liveliness=3)]))
    assert (first.history.name, first.depth, first.reliability.name, first.durability.name) == (
        'KEEP_LAST', 10, 'RELIABLE', 'VOLATILE')
    assert first.deadline == first.lifespan == first.liveliness_lease_duration
    assert (first.deadline.sec, first.deadline.nsec) == (9223372036, 854775807)
    assert (second.history.name, second.reliability.name, second.durability.name) == (
        'UNKNOWN', 'BEST_EFFORT', 'TRANSIENT_LOCAL')
    assert (second.deadline.sec, second.deadline.nsec, second.liveliness.value) == (
        1, 500_000_000, 3)


def test_policies_are_numbers_for_humble() -> None:
    text = offered_qos_text([OfferedQos(lifespan_ns=-1)])
    assert '- history: 1\n  depth: 10\n  reliability: 1\n  durability: 2\n  deadline:\n' in text
    assert '  lifespan:\n    sec: 0\n    nsec: 0\n' in text


def test_no_publisher() -> None:
    assert offered_qos_text([]) == ''


def test_policies_of_every_release_are_read() -> None:
    offers = [OfferedQos(), OfferedQos(history=2, depth=1000, reliability=2, durability=1)]
    assert read_offered_qos(offered_qos_text(offers)) == offers
    named = offered_qos_text(offers[1:]).replace('reliability: 2', 'reliability: best_effort')
    named = named.replace('durability: 1', "durability: 'transient_local'").replace(
        'history: 2', 'history: keep_all')
    assert read_offered_qos(named) == offers[1:]


@pytest.mark.parametrize('text', [
    '', 'depth: 3', '- depth', '- deadline:\n    sec: 3', 'a: &b [*b]'])
def test_no_known_policies(text: str) -> None:
    assert read_offered_qos(text) == []


def test_unknown_values_of_policies() -> None:
    assert read_offered_qos('- history: best\n  depth: x\n  reliability: system_default\n'
                            '  depth: 3') == [OfferedQos()]
