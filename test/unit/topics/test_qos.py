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

"""Quality of service that follows the publishers."""

from __future__ import annotations

from opencv_tools.topics.qos import following_qos, qos_mismatch
import pytest
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy

RELIABLE = QoSProfile(depth=10)
BEST_EFFORT = QoSProfile(depth=10, reliability=ReliabilityPolicy.BEST_EFFORT)
LATCHED = QoSProfile(depth=10, durability=DurabilityPolicy.TRANSIENT_LOCAL)
LATCHED_BEST_EFFORT = QoSProfile(depth=10, durability=DurabilityPolicy.TRANSIENT_LOCAL,
                                 reliability=ReliabilityPolicy.BEST_EFFORT)


@pytest.mark.parametrize(('offers', 'reliability', 'durability'), [
    ((), 'RELIABLE', 'VOLATILE'),
    ((RELIABLE,), 'RELIABLE', 'VOLATILE'),
    ((RELIABLE, BEST_EFFORT), 'BEST_EFFORT', 'VOLATILE'),
    ((LATCHED, LATCHED), 'RELIABLE', 'TRANSIENT_LOCAL'),
    ((LATCHED, RELIABLE), 'RELIABLE', 'VOLATILE'),
    ((LATCHED, BEST_EFFORT), 'BEST_EFFORT', 'VOLATILE'),
    ((LATCHED_BEST_EFFORT,), 'BEST_EFFORT', 'VOLATILE')])
@pytest.mark.parametrize('depth', [10, 64, None])
def test_following_qos(
        offers: tuple[QoSProfile, ...], reliability: str, durability: str,
        depth: int | None) -> None:
    qos = following_qos(offers, depth)
    assert (qos.reliability.name, qos.durability.name) == (reliability, durability)
    assert qos.history == (HistoryPolicy.KEEP_LAST if depth else HistoryPolicy.KEEP_ALL)
    assert depth in (qos.depth, None)
    assert [qos_mismatch(offer, qos) for offer in offers] == [''] * len(offers)
