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

"""Playback of files: order, rate, pauses, repetition and the part that is played."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from threading import Event, Lock
import time
from typing import Any

from conftest import CLIP, CLIP_FRAMES
import cv2
from images import draw_pattern
import numpy as np
from opencv_tools.capture.errors import CaptureError
from opencv_tools.capture.frame import CapturedFrame, Source
from opencv_tools.capture.pattern import PatternSource, PatternSpec
from opencv_tools.capture.player import Pacer, Player, published_rate, SYSTEM_CLOCK
from opencv_tools.capture.settings import CaptureSettings
from opencv_tools.capture.source import open_source
from playback import numbers, play
import pytest
from stepped_clock import BEGAN, SteppedClock


@pytest.fixture
def clock() -> SteppedClock:
    return SteppedClock()


@pytest.fixture
def numbered(tmp_path: Path) -> Source:
    """Create a folder of four images with the numbers 0 to 3."""
    for number in range(4):
        cv2.imwrite(str(tmp_path / f'{number}.png'), np.full((2, 2), number, np.uint8))
    return open_source(str(tmp_path))


@pytest.mark.parametrize(('on_end', 'expected'), [
    ('stop', [0, 1, 2]), ('loop', [0, 1, 2, 0, 1, 2, 0]), ('hold', [0, 1, 2, 2, 2, 2, 2])])
def test_action_at_the_end_of_a_source(tmp_path: Path, on_end: str, expected: list[int]) -> None:
    for number in range(3):
        cv2.imwrite(str(tmp_path / f'{number}.png'), np.full((2, 2), number, np.uint8))
    player = play(open_source(str(tmp_path)), publish_rate=500.0, on_end=on_end)
    assert numbers(player, 7) == expected


@pytest.mark.parametrize('on_end', ['stop', 'hold'])
def test_source_without_a_readable_frame_fails(tmp_path: Path, on_end: str) -> None:
    (tmp_path / '1.png').write_text('no picture')
    player = play(open_source(str(tmp_path)), lambda err: None, publish_rate=100.0, on_end=on_end)
    with pytest.raises(CaptureError, match='has no readable frame'):
        list(player.frames())


@pytest.mark.parametrize(('settings', 'period'), [({}, 1 / 64), ({'publish_rate': 8.0}, 1 / 8)])
def test_native_and_requested_rate_of_a_file(
        clock: SteppedClock, settings: dict[str, Any], period: float) -> None:
    player = play(PatternSource(PatternSpec(8, 8, 64.0)), clock=clock, stop_frame=51, **settings)
    shown = [(clock.now, frame.stamp_ns) for frame in player.frames()]
    due = [BEGAN + number * period for number in range(51)]
    assert shown == [(seconds, int(seconds * 1e9)) for seconds in due]


def test_image_files_are_played_at_10_hz(numbered: Source, clock: SteppedClock) -> None:
    shown = [clock.now for _ in play(numbered, clock=clock).frames()]
    assert shown == pytest.approx([BEGAN, BEGAN + 0.1, BEGAN + 0.2, BEGAN + 0.3])


@pytest.mark.parametrize(('is_live', 'asked', 'own', 'expected'), [
    (False, 0.0, 20.0, 20.0), (False, 5.0, 20.0, 5.0), (False, 120.0, 20.0, 120.0),
    (False, 0.0, 0.0, 10.0), (True, 0.0, 43.0, 43.0), (True, 5.0, 30.0, 5.0),
    (True, 120.0, 30.0, 30.0), (True, 7.0, 0.0, 7.0), (True, 0.0, 0.0, 0.0)])
def test_rate_that_is_published(
        is_live: bool, asked: float, own: float, expected: float, numbered: Source,
        monkeypatch: pytest.MonkeyPatch) -> None:
    for name, value in (('live', is_live), ('rate', own)):
        monkeypatch.setattr(type(numbered), name, value)
    assert published_rate(asked, numbered) == expected


def test_pacer_does_not_catch_up_after_a_delay(clock: SteppedClock) -> None:
    pacer = Pacer(clock)
    pacer.advance(0.0625)
    assert not pacer.is_due()
    assert not pacer.is_due(early=0.05)
    assert pacer.is_due(early=0.0625)
    # The frames due at 0.0625, 0.125 and 0.1875 are late; one of them is yielded at once.
    clock.step_to(BEGAN + 0.25)
    assert pacer.is_due()
    pacer.advance(0.0625)
    assert pacer.is_due()
    pacer.advance(0.0625)
    assert pacer.is_due()
    pacer.advance(0.0625)
    assert not pacer.is_due()
    clock.step_to(BEGAN + 0.3125)
    assert pacer.is_due()


@pytest.mark.parametrize('interval', [0.0, 1.0, 1000.0])
def test_first_frame_is_due_at_once_with_any_interval(
        clock: SteppedClock, interval: float) -> None:
    pacer = Pacer(clock)
    pacer.change(interval)  # the clock of a machine counts from its start, which may be later
    assert pacer.is_due()
    pacer.advance(interval)
    clock.step_to(BEGAN + interval)
    assert pacer.is_due()


def test_late_reader_gets_one_frame_at_once(clock: SteppedClock) -> None:
    shown = []
    for frame in play(PatternSource(PatternSpec(8, 8, 64.0)), clock=clock, stop_frame=6).frames():
        shown.append((64 * (clock.now - BEGAN), 64 * (frame.stamp_ns / 1e9 - BEGAN)))
        if len(shown) == 2:
            clock.step_to(clock.now + 10.5 / 64)
    assert shown == [(0, 0), (1, 1), (11.5, 10.5), (11.5, 11.5), (12.5, 12.5), (13.5, 13.5)]


def test_stop_ends_the_wait_for_a_frame(clock: SteppedClock) -> None:
    stopped = Event()
    clock.plan(2.5, stopped.set)
    player = play(PatternSource(PatternSpec(8, 8, 0.125)), stopped=stopped, clock=clock)
    assert len(list(player.frames())) == 1
    assert clock.now == BEGAN + 2.5


@pytest.mark.parametrize(('old', 'new', 'changed_at', 'due'), [
    (0.02, 32.0, 2.5, [0.0, 2.5, 2.53125]),  # the new period has passed
    (0.125, 0.5, 1.0, [0.0, 2.0, 4.0]),
    (1.0, 0.25, 0.5, [0.0, 4.0, 8.0]),
    (0.0, 8.0, 100.0, [0.0, 100.0, 100.125]),  # from the times of a file
    (0.02, 0.02, 7.0, [0.0, 50.0, 100.0])])
def test_change_of_the_rate_during_a_wait(
        clock: SteppedClock, old: float, new: float, changed_at: float, due: list[float]) -> None:
    settings, changed = CaptureSettings(publish_rate=old), Event()

    def change() -> None:
        nonlocal settings
        settings = CaptureSettings(publish_rate=new)
        changed.set()

    clock.plan(changed_at, change)
    player = Player(StampedSource(0.0, 1000.0, 2000.0), lambda: settings, Event(), lambda: False,
                    pytest.fail, clock)
    player.changed = changed
    assert [(frame.stamp_ns / 1e9 - BEGAN, clock.now - BEGAN) for frame in player.frames()] == [
        (seconds, seconds) for seconds in due]


def test_stop_after_a_change_of_the_rate(clock: SteppedClock) -> None:
    stopped, changed = Event(), Event()
    for seconds in (1.0, 2.0):
        clock.plan(seconds, changed.set)
    clock.plan(2.5, lambda: (stopped.set(), changed.set()))
    player = play(PatternSource(PatternSpec(8, 8, 0.125)), stopped=stopped, clock=clock)
    player.changed = changed
    assert len(list(player.frames())) == 1
    assert clock.now == BEGAN + 2.5


def test_pause_holds_playback_without_losing_frames(clock: SteppedClock) -> None:
    held = Event()
    source = PatternSource(PatternSpec(200, 3, 64.0))
    player = Player(
        source, lambda: CaptureSettings(stop_frame=20), Event(), held.is_set, pytest.fail, clock)
    stamps, images = [], []
    for frame in player.frames():
        stamps.append(frame.stamp_ns / 1e9 - BEGAN)
        images.append(frame.image)
        if len(stamps) == 10:
            held.set()
            clock.plan(0.5, held.clear)
    gaps = np.diff(stamps)
    assert 0.5 <= gaps[9] < 0.5 + 0.05  # polled 50 times a second
    assert np.delete(gaps, 9) == pytest.approx(1 / 64)
    for number, image in enumerate(images):
        assert np.array_equal(image, draw_pattern(number, 200, 3))
    assert len(images) == 20


class StampedSource(PatternSource):
    """A file source whose frames have positions."""

    def __init__(self, *positions: float) -> None:
        super().__init__(PatternSpec(8, 8, 25.0))
        self._positions = positions

    def read(self) -> CapturedFrame | None:
        number = self._number
        if number == len(self._positions):
            return None
        return replace(super().read(), position=self._positions[number])


@pytest.mark.parametrize(('rate', 'gaps'), [
    (0.0, [0.05, 0.2, 0.01, 0.04, 0.05, 0.2, 0.01]), (50.0, [0.02] * 7)])
def test_times_of_the_file_or_a_requested_rate_pace_frames(
        clock: SteppedClock, rate: float, gaps: list[float]) -> None:
    source = StampedSource(3.0, 3.05, 3.25, 3.26)  # the second play steps back by 0.26 s
    player = play(source, clock=clock, publish_rate=rate, loop=2)
    shown = [(frame.stamp_ns / 1e9, clock.now) for frame in player.frames()]
    for times in zip(*shown, strict=True):
        assert times == pytest.approx(BEGAN + np.cumsum([0.0, *gaps]))


@pytest.mark.parametrize(('settings', 'expected'), [
    ({'loop': 2}, [0, 1, 2, 3, 0, 1, 2, 3]),
    ({'start_frame': 2}, [2, 3]),
    ({'stop_frame': 2}, [0, 1]),
    ({'start_frame': 1, 'stop_frame': 3, 'loop': 2}, [1, 2, 1, 2]),
    ({'loop': 0, 'stop_frame': 1}, [0] * 9),
    ({'stop_frame': 9}, [0, 1, 2, 3]),
    ({'on_end': 'hold', 'loop': 2}, [0, 1, 2, 3, 0, 1, 2, 3, 3]),
])
def test_first_stop_and_plays_select_frames(
        numbered: Source, settings: dict[str, Any], expected: list[int]) -> None:
    assert numbers(play(numbered, publish_rate=500.0, **settings), 9) == expected


@pytest.mark.parametrize('first', [4, 5, 7])
def test_start_frame_after_the_end_of_a_folder_is_refused(numbered: Source, first: int) -> None:
    with pytest.raises(CaptureError, match=f'^start_frame is {first}, but .* has only 4 '):
        list(play(numbered, publish_rate=500.0, start_frame=first).frames())


def test_start_frame_after_the_end_of_a_video_is_refused() -> None:
    with pytest.raises(CaptureError, match=f'has only {CLIP_FRAMES} frames, numbered from 0$'):
        list(play(open_source(str(CLIP)), publish_rate=500.0, start_frame=CLIP_FRAMES).frames())


def test_system_clock_waits_for_an_event_or_a_timeout() -> None:
    assert time.monotonic() <= SYSTEM_CLOCK.monotonic() <= time.monotonic()
    event = Event()
    assert not SYSTEM_CLOCK.wait(event, 0.01)
    event.set()
    assert SYSTEM_CLOCK.wait(event, 3600.0)


@pytest.mark.parametrize(('rate', 'expected'), [(0.0, [100.0]), (0.01, [])])
def test_long_waits_of_a_file(rate: float, expected: list[float]) -> None:
    """A bag may have years between two images; a rate of the user is no surprise."""
    player, waits = play(StampedSource(0.0, 1.0, 101.0), publish_rate=rate), []
    player.on_long_wait = waits.append
    assert len(list(player.frames())) == 3
    assert waits == pytest.approx(expected)


def test_wait_of_a_thousand_years() -> None:
    class Stopped(Event):

        def wait(self, timeout: float | None = None) -> bool:
            self.set()
            return super().wait(timeout) and Lock().acquire(timeout=timeout or 0)

    assert SYSTEM_CLOCK.wait(Stopped(), 4e10)
