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

"""Random joint positions of a comparison."""

from __future__ import annotations

from compared_robots import free, urdf, with_axis
from opencv_tools.robot.compare.compare import differences
from opencv_tools.robot.model import Axis, Limit
import pytest


@pytest.mark.parametrize('limit', [
    Limit(-1e300, 1e300), Limit(2e3, 3e3), Limit(5.0, -5.0), Limit(upper=-50.0),
    Limit(lower=50.0)])
def test_extreme_limits(limit: Limit) -> None:
    robot = free('prismatic', (Axis((1.0, 0.0, 0.0), limit),))
    assert differences(robot, robot) == []


def test_reproducible_random_positions() -> None:
    one = with_axis(urdf(), 'slide', mimic=None)
    other = with_axis(one, 'slide', xyz=(1.0, 0.01, 0.0))
    found = differences(one, other, tolerance=1e-9)
    assert found == differences(one, other, tolerance=1e-9)
    assert found != differences(one, other, tolerance=1e-9, seed=1)
    hand = next(one for one in found if one.name == 'hand')
    assert 0 < hand.size <= 0.5 * 0.01
