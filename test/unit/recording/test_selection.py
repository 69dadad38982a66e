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

"""Selection of frames by number, time and limits."""

from __future__ import annotations

from dataclasses import FrozenInstanceError, replace

import numpy as np
from opencv_tools.recording.errors import LimitReached, UnwritableError
from opencv_tools.recording.frames import ReceivedFrame
from opencv_tools.recording.manifest import ManifestEntry
from opencv_tools.recording.naming import FrameMetadata
from opencv_tools.recording.selection import Limits, Retention, Selection
import pytest

NANO = 10**9


def frame(stamp_ns: int, receive_ns: int = 0) -> ReceivedFrame:
    metadata = FrameMetadata(stamp_ns, 'camera', 'mono8', '/video_frames')
    return ReceivedFrame(metadata=metadata, receive_ns=receive_ns)


def selected(selection: Selection, times: list[int]) -> list[int]:
    return [number for number, time_ns in enumerate(times) if selection.selects(frame(time_ns))]


def stamps(count: int, rate: float, jitter_ms: float = 0.0, start: int = 100 * NANO) -> list[int]:
    jitter = np.random.default_rng(7).uniform(-jitter_ms, jitter_ms, count) * 1e6
    return [start + int(number * NANO / rate + shift) for number, shift in enumerate(jitter)]


def test_every_nth_frame_is_selected() -> None:
    assert selected(Selection(3, 0.0, Limits()), stamps(10, 30)) == [0, 3, 6, 9]
    assert selected(Selection(1, 0.0, Limits()), [0] * 5) == [0, 1, 2, 3, 4]


@pytest.mark.parametrize(('rate', 'max_rate', 'jitter_ms'), [
    (30, 10, 0), (30, 10, 5), (30, 10, 10), (30, 30, 5), (30, 100, 0), (25, 5, 8), (60, 7, 3),
    (29.97, 15, 2), (1000, 3, 0.4), (30, 5e-324, 0)])
def test_rate_is_independent_of_jitter(rate: float, max_rate: float, jitter_ms: float) -> None:
    seconds = 60
    selection = Selection(1, max_rate, Limits())
    taken = selected(selection, stamps(int(rate * seconds), rate, jitter_ms))
    expected = min(rate, max_rate) * seconds
    assert expected * 0.98 <= len(taken) <= expected + 1


@pytest.mark.parametrize('rate', [5, 30, 113])
@pytest.mark.parametrize('step_ns', [0, 1, 2000])
@pytest.mark.parametrize('begin', [0, 77, 1_700_000_000 * NANO])
def test_rate_of_stamps_that_stand_still(rate: float, step_ns: int, begin: int) -> None:
    selection = Selection(1, 2.0, Limits())
    arrivals = stamps(10 * rate, rate)
    taken = [number for number, arrival_ns in enumerate(arrivals) if selection.selects(
        replace(frame(begin + number * step_ns), arrival_ns=arrival_ns))]
    assert 19 <= len(taken) <= 22
    assert max(np.diff(taken)) <= rate


def test_third_of_the_rate_is_every_third_frame() -> None:
    assert selected(Selection(1, 10, Limits()), stamps(31, 30, 4)) == list(range(0, 31, 3))


def test_pause_or_clock_change_restarts_the_grid() -> None:
    selection = Selection(1, 1.0, Limits())
    times = [100, 100.5, 101, 500, 500.5, 501, 20, 20.5, 21]
    assert selected(selection, [int(time * NANO) for time in times]) == [0, 2, 3, 5, 6, 8]


@pytest.mark.parametrize(('times', 'expected'), [
    ([100, 102, 102.5, 103.5], [0, 1, 2, 3]),  # one period late: on the grid
    ([100, 102.01, 102.5, 103.5], [0, 1, 3]),  # later: a new grid
    ([100, 100.75, 101.75, 102.7], [0, 1, 2]),  # a quarter early: on the grid
    ([100, 100.74, 101.7, 102.7], [0, 2, 3]),
    ([100, 99, 100.75], [0, 2]),  # two periods early: skipped
    ([100, 98.99, 100.75, 101.7], [0, 1, 2, 3])])  # more: the clock was set
def test_frames_off_the_grid(times: list[float], expected: list[int]) -> None:
    selection = Selection(1, 1.0, Limits())
    assert selected(selection, [round(time * NANO) for time in times]) == expected


def test_frames_without_a_stamp_use_the_arrival() -> None:
    selection = Selection(1, 10.0, Limits())
    taken = [number for number, arrival_ns in enumerate(stamps(31, 30))
             if selection.selects(replace(frame(0), arrival_ns=arrival_ns))]
    assert taken == list(range(0, 31, 3))


def test_selection_ends_at_max_frames() -> None:
    selection = Selection(1, 0.0, Limits(max_frames=2))
    selection.count()
    assert not selection.is_over
    selection.count()
    assert selection.is_over
    ring = Selection(1, 0.0, Limits(max_frames=1, ring=True))
    ring.count()
    assert not ring.is_over


@pytest.mark.parametrize('seconds', [0.5, 2.0])
def test_duration_begins_with_the_first_frame(seconds: float) -> None:
    times = iter([50.0, 50.0 + 0.99 * seconds, 50.0 + seconds])
    selection = Selection(1, 0.0, Limits(max_seconds=seconds), lambda: next(times))
    assert not selection.has_begun
    assert [selection.is_late() for _ in range(3)] == [False, False, True]
    assert selection.has_begun
    for_ever = Selection(1, 0.0, Limits(), iter([0.0, 1e9]).__next__)
    assert not for_ever.is_late() and not for_ever.is_late()


def entry(name: str, size: int = 10, receive_ns: int = 0) -> ManifestEntry:
    return ManifestEntry(
        seq=0, name=name, stamp_ns=0, receive_ns=receive_ns, frame_id='', encoding='',
        stored_encoding='', width=0, height=0, size=size, sha256='', frames=1)


def fill(retention: Retention, *entries: ManifestEntry, arrival_ns: int = 0) -> list[str]:
    """Add files and return the names of the files to delete."""
    deleted = []
    for new in entries:
        names = retention.make_room(new, arrival_ns)
        retention.remove(names)
        retention.add(new, arrival_ns)
        deleted += names
    return deleted


def test_ring_deletes_as_many_files_as_necessary() -> None:
    retention = Retention(Limits(max_bytes=30, ring=True), [entry('a'), entry('b')])
    assert fill(retention, entry('c')) == []
    assert fill(retention, entry('d')) == ['a']
    assert fill(retention, entry('large', 25)) == ['b', 'c', 'd']
    assert retention.count == 1
    assert retention.make_room(entry('larger', 30), 0) == ['large']
    with pytest.raises(UnwritableError) as caught:
        retention.make_room(entry('larger', 31), 0)
    assert str(caught.value) == ('a file of 31 bytes does not fit in the ring, whose max_bytes is '
                                 '30: give a larger max_bytes')
    assert retention.count == 1


def test_ring_counts_the_frames_of_its_files() -> None:
    earlier = [replace(entry('a'), frames=30), replace(entry('b'), frames=20)]
    retention = Retention(Limits(max_frames=100, ring=True), earlier)
    growing = replace(entry('c'), frames=50)
    assert retention.make_room(growing, 0) == []
    assert retention.make_room(replace(growing, frames=51), 0) == ['a']
    retention.remove(['a'])
    retention.add(growing, 0)
    assert retention.make_room(replace(entry('d'), frames=30), 0) == []
    assert retention.make_room(replace(entry('d'), frames=51), 0) == ['b', 'c']


@pytest.mark.parametrize(('limits', 'expected'), [
    (Limits(max_frames=7, max_seconds=8.0, max_bytes=9), Limits()),
    (Limits(split_seconds=2.5, split_bytes=7), Limits(0, 2.5, 7)),
    (Limits(max_frames=95, max_bytes=7, ring=True), Limits(10, 0.0, 1)),
    (Limits(max_seconds=20.0, ring=True, split_seconds=1.5), Limits(0, 1.5, 0)),
    (Limits(max_seconds=20.0, ring=True, split_seconds=9.0), Limits(0, 2.0, 0))])
def test_limits_of_one_file(limits: Limits, expected: Limits) -> None:
    assert limits.of_one_file() == expected


def test_limits_that_are_not_set() -> None:
    assert Limits() == Limits(max_frames=0, max_seconds=0.0, max_bytes=0, ring=False,
                              split_seconds=0.0, split_bytes=0)
    assert Limits().max_ns == 0
    with pytest.raises(FrozenInstanceError):
        Limits().max_frames = 1  # type: ignore[misc]


def test_smallest_limits() -> None:
    selection = Selection(1, 0.0, Limits(max_frames=1))
    selection.count()
    assert selection.is_over
    by_number = Retention(Limits(max_frames=1, ring=True), [entry('a')])
    assert by_number.make_room(entry('b'), 0) == ['a']
    by_age = Retention(Limits(max_seconds=1e-9, ring=True), [])
    by_age.add(entry('a'), 5)
    assert by_age.make_room(entry('b'), 6) == []
    assert by_age.make_room(entry('b'), 7) == ['a']
    by_size = Retention(Limits(max_bytes=1), [])
    assert by_size.make_room(entry('a', 1), 0) == []
    with pytest.raises(LimitReached):
        by_size.make_room(entry('a', 2), 0)


def test_longest_duration() -> None:
    limits = Limits(max_seconds=1.5)
    assert (limits.max_ns, Selection(1, 0.0, limits).max_seconds) == (1_500_000_000, 1.5)
    ring = replace(limits, ring=True)
    assert (ring.max_ns, Selection(1, 0.0, ring).max_seconds) == (1_500_000_000, 0.0)


HOUR = 3600 * NANO
WALL = 500_000 * HOUR


@pytest.mark.parametrize('jump', [0, -HOUR, HOUR])
def test_age_of_a_file_is_independent_of_clock_changes(jump: int) -> None:
    retention = Retention(Limits(max_seconds=2.0, ring=True), [entry('earlier', 10, WALL - NANO)],
                          lambda: HOUR, lambda: WALL)
    deleted = [fill(retention, entry(str(number), 10, WALL + number * NANO + (number > 3) * jump),
                    arrival_ns=HOUR + number * NANO) for number in range(7)]
    assert deleted == [[], [], ['earlier'], ['0'], ['1'], ['2'], ['3']]


def test_file_with_a_future_time_is_the_oldest() -> None:
    earlier = [entry('old', 10, WALL - 3 * NANO), entry('new', 10, WALL - NANO),
               entry('future', 10, WALL + HOUR), entry('older', 10, WALL - 4 * NANO)]
    by_age = Retention(Limits(max_seconds=2.0, ring=True), earlier, lambda: HOUR, lambda: WALL)
    assert fill(by_age, entry('a'), arrival_ns=HOUR) == ['future', 'older', 'old']
    by_number = Retention(Limits(max_frames=4, ring=True), earlier, lambda: HOUR, lambda: WALL)
    assert fill(by_number, entry('a'), entry('b'), arrival_ns=HOUR) == ['future', 'older']


def test_file_of_this_moment_has_a_known_age() -> None:
    earlier = [entry('now', 10, WALL), entry('old', 10, WALL - NANO)]
    by_age = Retention(Limits(max_seconds=2.0, ring=True), earlier, lambda: HOUR, lambda: WALL)
    assert fill(by_age, entry('a'), arrival_ns=HOUR + NANO) == []
    assert fill(by_age, entry('b'), arrival_ns=HOUR + NANO + 1) == ['old']
    assert fill(by_age, entry('c'), arrival_ns=HOUR + 2 * NANO + 1) == ['now']
    by_number = Retention(Limits(max_frames=2, ring=True), earlier, lambda: HOUR, lambda: WALL)
    assert fill(by_number, entry('a')) == ['old']


def test_replaced_file_is_counted_once() -> None:
    retention = Retention(Limits(max_bytes=30, max_frames=3, ring=True), [])
    assert fill(retention, entry('a'), entry('b'), entry('c'), entry('b'), entry('a')) == []
    assert fill(retention, entry('d')) == ['c']


def test_no_file_is_deleted_without_a_ring() -> None:
    retention = Retention(Limits(max_frames=1, max_bytes=25), [])
    assert fill(retention, entry('a'), entry('b')) == []
    with pytest.raises(LimitReached, match=r'^max_bytes is 25, the next file has 10 bytes$'):
        retention.make_room(entry('c'), 0)
    assert fill(retention, entry('small', 5)) == []
    assert retention.count == 0
    with pytest.raises(LimitReached):
        retention.make_room(entry('small', 1), 0)
