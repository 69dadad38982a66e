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

"""Links that do not carry the video of a topic."""

from __future__ import annotations

from opencv_tools.viewer.streams.video_channel import VideoLink


class Clock:
    """A clock that a test moves."""

    now = 100.0

    def __call__(self) -> float:
        return self.now


def fall_behind(link: VideoLink, clock: Clock, *pauses: float) -> bool:
    """Fall behind after each pause, and return whether the link is slow then."""
    for pause in pauses:
        clock.now += pause
        link.fell_behind()
    return link.is_slow


def test_two_delays_within_ten_seconds() -> None:
    link = VideoLink(clock := Clock())
    assert not fall_behind(link, clock, 0.0, 11.0, 12.0)
    assert fall_behind(link, clock, 9.0)


def test_trials_become_rare() -> None:
    link = VideoLink(clock := Clock())
    assert fall_behind(link, clock, 0.0, 1.0)
    for seconds in (30.0, 60.0, 120.0, 240.0, 480.0, 600.0, 600.0):
        clock.now += seconds - 1
        assert link.is_slow
        clock.now += 1
        assert not link.is_slow
        assert fall_behind(link, clock, 1.0, 1.0)


def test_delays_of_the_video_for_slow_links_change_nothing() -> None:
    link = VideoLink(clock := Clock())
    fall_behind(link, clock, 0.0, 1.0)
    assert fall_behind(link, clock, 10.0, 10.0)
    clock.now += 10.0
    assert not link.is_slow


def test_trials_begin_anew_after_a_link_that_was_quick() -> None:
    link = VideoLink(clock := Clock())
    fall_behind(link, clock, 0.0, 1.0)
    clock.now += 100.0
    assert fall_behind(link, clock, 0.0, 1.0)
    clock.now += 30.0
    assert not link.is_slow
