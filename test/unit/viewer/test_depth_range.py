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

"""Ranges of depth that follow slowly."""

from __future__ import annotations

import numpy as np
from opencv_tools.viewer.streams.depth_colors import DepthRange, measure_limits, Steady
import pytest


def test_first_frame_is_the_range() -> None:
    followed = DepthRange()
    assert followed.limits is None
    followed.follow((1000.0, 3000.0), 5.0)
    assert followed.limits == (1000, 3000)


def test_range_follows_slowly_at_any_rate() -> None:
    found = []
    for rate in (5, 30):
        followed = DepthRange()
        followed.follow((1000.0, 3000.0), 0.0)
        for step in range(1, 2 * rate + 1):
            followed.follow((1000.0, 4000.0), step / rate)
            assert followed.limits is not None
        assert followed.limits[0] == 1000
        found.append(followed.limits[1])
    assert found == pytest.approx([3632, 3632], abs=1)  # two thirds in two seconds


def test_another_scene_has_its_range_at_once() -> None:
    followed = DepthRange()
    followed.follow((1000.0, 3000.0), 0.0)
    followed.follow((3001.0, 9000.0), 0.1)
    assert followed.limits == (3001, 9000)


def test_frame_is_shown_with_the_limits_after_it() -> None:
    followed = DepthRange()
    assert followed.at(0.0).after((1000.0, 3000.0)) == (1000, 3000)
    followed.follow((1000.0, 3000.0), 0.0)
    assert followed.at(0.0).after((1000.0, 9000.0)) == (1000, 3000)
    assert followed.at(0.0).after((4000.0, 9000.0)) == (4000, 9000)  # another scene
    late = followed.at(60.0).after((1500.0, 9000.0))  # a camera with a frame a minute
    assert late == pytest.approx((1500, 9000))
    assert followed.limits == (1000, 3000)
    assert Steady((1000.0, 3000.0)).after((1500.0, 9000.0)) == (1000, 3000)


def test_limits_of_most_numbers() -> None:
    assert measure_limits(np.arange(101)) == (2, 98)
    assert measure_limits(np.array([], np.float32)) == (0, 0)
    assert measure_limits(np.full(9, 7)) == (7, 7)


def test_range_of_the_largest_floats_stays_finite() -> None:
    followed = DepthRange()
    for step, numbers in enumerate(([-1.7e308, 1.7e308], [-1.7e308, -1.7e308], [1.7e308] * 2)):
        followed.follow(measure_limits(np.array(numbers)), step / 10)
        assert followed.limits is not None and np.isfinite(followed.limits).all()
