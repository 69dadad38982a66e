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

"""Arrival times of received frames."""

from __future__ import annotations

from opencv_tools.base.units import NANO
from opencv_tools.recording.frames import ArrivalClock
import pytest

HOUR = 3600 * NANO
WALL = 500_000 * HOUR


@pytest.mark.parametrize('jump', [0, -HOUR, HOUR])
def test_arrival_times_are_independent_of_clock_changes(jump: int) -> None:
    monotonic, wall = [HOUR], [WALL]
    arrivals = ArrivalClock(lambda: monotonic[0], lambda: wall[0])
    found = []
    for number in range(6):
        received = wall[0] + 8
        monotonic[0] += 10
        wall[0] += 10 + (number == 3) * jump  # between the reception and the call
        found.append(arrivals.arrival_ns(received) - HOUR)
    assert found[:3] + found[4:] == [8, 18, 28, 48, 58]
    assert 28 <= found[3] <= 40
