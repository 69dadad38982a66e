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

"""Width and quality on simulated links."""

from __future__ import annotations

from opencv_tools.viewer.streams.channel import LinkRate
import pytest

MEGABIT = 1e6 / 8


def picture_bytes(link: LinkRate) -> int:
    """Return the size of a JPEG of a natural scene, about 1.2 bits a pixel at quality 80."""
    return int(link.width**2 * 9 / 16 * 0.15 * (link.quality / 80)**1.2)


def simulate(link: LinkRate, rate: float, round_trip: float, period: float = 1 / 30,
             seconds: float = 20.0, start: float = 100.0) -> float:
    """Answer pictures as a link of some bytes a second does; return the rate at the end."""
    now, sent = start, []
    while now < start + seconds:
        size = picture_bytes(link)
        needed = round_trip + link.window * size / rate
        now += max(needed / link.window, period)
        link.answered(size, needed, period, now)
        sent.append(now)
    recent = sent[-31:]
    return (len(recent) - 1) / (recent[-1] - recent[0])


def test_quick_link_keeps_the_wanted_size() -> None:
    link = LinkRate(1280, 80)
    assert simulate(link, 1000 * MEGABIT, 0.001) == pytest.approx(30, rel=0.02)
    assert (link.width, link.quality, link.window) == (1280, 80, 1)
    assert not link.is_lowered


def test_slow_link_lowers_the_width_until_the_rate_is_met() -> None:
    link = LinkRate(1920, 80)
    assert simulate(link, 8 * MEGABIT, 0.004) > 25
    assert link.width < 1280
    assert link.quality == 80  # the width was enough
    assert link.window == 1


def test_very_slow_link_lowers_the_quality_as_well() -> None:
    link = LinkRate(640, 80)
    simulate(link, 1 * MEGABIT, 0.004)
    assert link.width == 320
    assert link.quality < 80


def test_far_link_gets_two_pictures_of_the_wanted_size() -> None:
    link = LinkRate(640, 80)
    # At 30 Hz a round trip of 50 ms needs two pictures on their way.
    assert simulate(link, 1000 * MEGABIT, 0.05) == pytest.approx(30, rel=0.02)
    assert link.window == 2
    assert (link.width, link.quality) == (640, 80)


def test_window_is_at_most_two() -> None:
    link = LinkRate(640, 80)
    simulate(link, 1000 * MEGABIT, 0.5)
    assert link.window == 2


def test_size_returns_with_the_speed_of_the_link() -> None:
    link = LinkRate(1280, 80)
    simulate(link, 4 * MEGABIT, 0.004)
    assert link.width < 1280
    simulate(link, 1000 * MEGABIT, 0.001, seconds=60, start=200)
    assert (link.width, link.quality) == (1280, 80)


def test_failed_trials_become_rare() -> None:
    link = LinkRate(1280, 80)
    simulate(link, 8 * MEGABIT, 0.001, seconds=30)
    changes, last = 0, (link.width, link.quality)
    now = 200.0
    while now < 500:
        size = picture_bytes(link)
        now += max(0.001 + size / (8 * MEGABIT), 1 / 30)
        link.answered(size, 0.001 + size / (8 * MEGABIT), 1 / 30, now)
        if (link.width, link.quality) != last:
            changes, last = changes + 1, (link.width, link.quality)
    assert changes <= 24  # not one every 3 s, which would be 100


def test_fixed_size_never_changes() -> None:
    link = LinkRate(1920, 90, fixed=True)
    simulate(link, 1 * MEGABIT, 0.004)
    assert (link.width, link.quality) == (1920, 90)


def test_rate_of_the_link() -> None:
    link = LinkRate(640, 80)
    assert link.bytes_per_second is None
    simulate(link, 100 * MEGABIT, 0.0)
    assert link.bytes_per_second == pytest.approx(100 * MEGABIT, rel=0.01)
