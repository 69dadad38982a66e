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

"""The samples of the topics of a bag: their times, and the numbers in their messages."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from opencv_tools.bags.open_bag import Bag
from opencv_tools.bags.reading import BagMessage, BagTopic, CDR, Damage
from opencv_tools.base.text import enumerated, printable
from opencv_tools.base.units import NANO
from opencv_tools.capture.bag_video import can_begin, is_video
from opencv_tools.datasets.clocks import Clocks, LOG_REMEDY
from opencv_tools.datasets.errors import DatasetError, UnreadableError
from opencv_tools.datasets.plan import NumbersSource, Plan
from opencv_tools.datasets.samples import first_names, integers, Samples

# Differences of the clocks of two topics, relative to the recording.
_WARNING_NS, _ERROR_NS = NANO // 10, NANO // 2


@dataclass(frozen=True, kw_only=True)
class Track:
    """
    The samples of a topic.

    :param times: (n,) increasing times in nanoseconds.
    :param messages: (n,) number of the message of each sample among all of the topic, from 0.
    :param values: (n, d) numbers of each sample; (n, 0) for images.
    :param logs: (n,) times of the recording of the samples.
    :param doubled: whether each sample is in a time that is there twice; see `Samples.doubled`.
    :param step: sentence about the step of the clock; '' if there is none.
    :param late: number of samples that are left out, because a later one has the same time or,
        in a topic of video, an earlier one has a later time.
    :param partial: number of messages that have none of the numbers.
    :param oldest: (n,) time of the oldest number of each sample; that of the sample for images.
    :param parts: times of the samples that have a number, by its name, if not all have all.
    :param left_out: number of messages before the first one that can be decoded.
    :param failed: number of messages that cannot be read.
    """

    topic: BagTopic
    times: NDArray[np.int64]
    messages: NDArray[np.int64]
    values: NDArray[np.float64]
    oldest: NDArray[np.int64]
    parts: Mapping[str, NDArray[np.int64]]
    logs: NDArray[np.int64]
    doubled: NDArray[np.bool_]
    step: str
    late: int
    partial: int
    left_out: int
    failed: int


@dataclass(frozen=True, kw_only=True)
class Recording:
    """
    What a plan needs of a bag, without the pixels of its images.

    :param tracks: samples by name: the name of a camera, or the text of a source of numbers.
    :param events: time in nanoseconds and value of the messages that begin and end episodes.
    :param start_ns: time of the first message of the bag, by the clock of the samples.
    """

    bag: Bag
    tracks: dict[str, Track]
    events: list[tuple[int, Any]]
    start_ns: int
    warnings: list[str]


def open_bag(path: Path, files: Sequence[Path] = ()) -> Bag:
    """
    Open a bag.

    :param files: files of the bag; empty for those of the path.
    :raises UnreadableError: it cannot be read.
    """
    try:
        return Bag(path, files)
    except (ValueError, OSError) as err:
        raise UnreadableError(_reason(err)) from err


def find_topic(bag: Bag, name: str, images: bool = False) -> BagTopic:
    """
    Find a topic of a bag by its name.

    :param images: whether it must have images.
    :raises DatasetError: there is no such topic, or it cannot be read.
    """
    found = [topic for topic in bag.topics if topic.name == name and topic.serialization == CDR
             and (topic.has_images or not images)]
    found = [topic for topic in found if bag.topics[topic]] or found
    if len(found) != 1:
        known = sorted(printable(f'{topic.name} ({topic.type_name})') for topic in bag.topics
                       if topic.has_images or not images)
        kind = 'topic of images' if images else 'topic'
        raise DatasetError(
            f'there is no {kind} {printable(name)}; there is {enumerated(known, 20) or "none"}'
            + ''.join(f' ({warning})' for warning in bag.warnings[:1])
            if not found else f'{printable(name)} has messages of {len(found)} types')
    return found[0]


def resolved(plan: Plan, path: Path, files: Sequence[Path] = ()) -> Plan:
    """
    Return a plan that has the names of all numbers, as the first messages of a bag have them.

    :raises DatasetError: a topic has no message, or no such numbers.
    """
    bag = open_bag(path, files)
    for _, topic in plan.images:
        find_topic(bag, topic, images=True)
    names = {source: _chosen_names(bag, source) for source in plan.sources}
    found = {name for chosen in names.values() for name in chosen}
    missing = [name for source in plan.sources for name in source.names if name not in found]
    if missing:
        raise DatasetError(f"joint '{printable(missing[0])}' is missing; the topics have "
                           f'{enumerated(sorted(found), 20)}')
    vectors = tuple((key, tuple(NumbersSource(source.topic, source.path, names[source])
                                for source in sources)) for key, sources in plan.vectors)
    return Plan(**{**vars(plan), 'vectors': vectors})


def _chosen_names(bag: Bag, source: NumbersSource) -> tuple[str, ...]:
    """Return those names that a source has in its first message; all if it has none of them."""
    topic = find_topic(bag, source.topic)
    with closing(bag):
        found = first_names(bag.messages([topic]), topic, source)
    return tuple(name for name in source.names if name in found) or found


def _track(samples: Samples, plan: Plan, name: str, count: int) -> Track:
    """
    Return the samples in the order of their times; see `Samples.times`.

    :param count: number of messages that the topic has; those of a damaged part are not read.
    """
    times = samples.times(plan.clock, name)
    doubled, step = samples.doubled(plan.clock)
    logs, places = integers(samples.logs), integers(samples.places)
    order = np.arange(len(times)) if samples.has_video else np.argsort(times, kind='stable')
    values = np.frombuffer(samples.values, np.float64).reshape(len(times), -1)[order]
    times, partial, complete = times[order], np.zeros(len(times), np.bool_), np.arange(len(times))
    since = times
    parts: dict[str, NDArray[np.int64]] = {}
    if samples.source:
        known = np.frombuffer(samples.known, np.bool_).reshape(values.shape)[order]
        newest = np.maximum.accumulate(np.where(known, np.arange(len(times))[:, None], -1))
        values, oldest = values[newest, np.arange(values.shape[1])], newest.min(axis=1)
        if oldest[-1] < 0:
            missing = [one for one, place in zip(samples.source.names, newest[-1]) if place < 0]
            raise DatasetError(f'{name}: no message has {enumerated(missing)}')
        complete = np.flatnonzero(oldest >= 0)
        partial |= ~known.any(axis=1)
        since = times[oldest]
        if not known.all():
            parts = {f'{name}.{one}': times[column]
                     for one, column in zip(samples.source.names, known.T)}
    usable = complete[~partial[complete]]
    steps = np.diff(np.maximum.accumulate(times[usable])) > 0
    # The last one of messages with one time has the numbers of all.
    kept = usable[np.append(True, steps) if samples.has_video else np.append(steps, True)]
    return Track(
        topic=samples.topic, times=times[kept], messages=places[order][kept], values=values[kept],
        oldest=since[kept], parts=parts, logs=logs[order][kept],
        doubled=doubled[order][kept], step=step,
        partial=len(complete) - len(usable), late=len(usable) - len(kept),
        left_out=samples.left_out + len(times) - len(complete),
        failed=samples.damaged + max(0, count - samples.count))


def read_recording(bag: Bag, plan: Plan) -> Recording:
    """
    Read the times and numbers of a bag.

    :param plan: plan with the names of all numbers.
    :raises DatasetError: a topic, a field or a name is missing, or the times cannot be used.
    """
    samples = {name: Samples(found, can_begin=partial(can_begin, found.type_name),
                             is_video=partial(is_video, found.type_name))
               for name, topic in plan.images for found in (find_topic(bag, topic, images=True),)}
    for source in plan.sources:
        topic = find_topic(bag, source.topic)
        samples[str(source)] = Samples(topic, source)
    events = None
    if plan.episodes:
        topic = find_topic(bag, plan.episodes.topic)
        events = Samples(topic, plan.episodes, events=[])
    damages = _read(bag, [*samples.values(), *([events] if events else [])])
    warnings = [*bag.warnings]
    if damages:
        warnings.append(f'{damages} parts of the bag cannot be read')
    warnings += [f'{name}: {one.left_out} messages before the first key frame are left out'
                 for name, one in samples.items() if one.left_out]
    warnings += [f'{name}: the first message is left out, because its stamp is 0'
                 for name, one in samples.items()
                 if plan.clock == 'stamp' and one.leave_out_zero()]
    tracks = {name: _track(one, plan, name, bag.topics[one.topic])
              for name, one in samples.items()}
    warnings += _left_out_warnings(samples, tracks)
    clocks = {name: one.clocks for name, one in samples.items()}
    warnings += _step_warnings(plan, tracks, clocks) + _clock_warnings(tracks)
    clock = _Clock(tracks)
    has_steps = plan.clock == 'stamp' and any(one.log_jump < 0 for one in clocks.values())
    start_ns = (min(int(track.times[0]) for track in tracks.values()) if has_steps else
                clock.stamp(bag.first_ns))
    return Recording(bag=bag, tracks=tracks, events=_timed(events, plan, clock) if events else [],
                     start_ns=start_ns, warnings=warnings)


def _step_warnings(plan: Plan, tracks: Mapping[str, Track], clocks: Mapping[str, Clocks],
                   ) -> list[str]:
    """Return sentences about clocks that step, and of stamps that are slow or quick."""
    return [f'{name}: {one.step}' for name, one in tracks.items() if one.step] + [
        f'{name}: the stamps advance {one.speed:.3g} times as fast as the recording, as those of '
        'a simulation, and rows are counted by the stamps' for name, one in clocks.items()
        if plan.clock == 'stamp' and not _SLOWEST < one.speed < 1 / _SLOWEST]


def _left_out_warnings(samples: Mapping[str, Samples], tracks: Mapping[str, Track]) -> list[str]:
    """Return sentences about the messages between others that are left out."""
    found = []
    for name, one in samples.items():
        late = 'their times are not later than those before them' if one.has_video else (
            'later ones have the same times' + (
                '; numbers that only the earlier ones have are used' * bool(one.source)))
        counts = {
            'cannot be read': one.damaged,
            f'are left out, because {late}': tracks[name].late,
            'are left out, because they have none of the numbers': tracks[name].partial}
        found += [f'{name}: {count} messages {text}' for text, count in counts.items() if count]
    return found


class _Clock:
    """The clock of the samples, by the times of the recording."""

    def __init__(self, tracks: Mapping[str, Track]) -> None:
        longest = max(tracks.values(), key=lambda track: int(track.logs.max() - track.logs[0]))
        spans = [int(times[-1] - times[0]) for times in (longest.times, longest.logs)]
        speed = spans[0] / spans[1] if spans[1] > 0 else 1.0
        self._speed = 1.0 if _SLOWEST < speed < 1 / _SLOWEST else speed
        self._log = int(longest.logs[0])
        self._offset = int(np.median([
            np.median(track.times - (track.logs - self._log) * self._speed)
            for track in tracks.values()]))

    def stamp(self, log_ns: int) -> int:
        """Return the time of the samples at a time of the recording, both in nanoseconds."""
        return self._offset + round((log_ns - self._log) * self._speed)


def _read(bag: Bag, samples: list[Samples]) -> int:
    """Read the messages of a bag once; return the number of its damages."""
    by_topic: dict[BagTopic, list[Samples]] = {}
    for one in samples:
        by_topic.setdefault(one.topic, []).append(one)
    damages = 0
    try:
        with closing(bag):
            for item in bag.messages(by_topic.keys()):
                if isinstance(item, Damage):
                    damages += 1
                    continue
                for one in by_topic[item.topic]:
                    _add(one, item, bag.file)
    except (ValueError, OSError) as err:
        raise DatasetError(_reason(err)) from err
    return damages


def _add(samples: Samples, item: BagMessage, file: int) -> None:
    try:
        samples.add(item, file)
    except DatasetError as err:
        raise DatasetError(f'message {samples.count} of {printable(item.topic.name)}: {err}'
                           ) from err


_SLOWEST = 0.7  # speed of stamps without a warning


def _clock_warnings(tracks: dict[str, Track]) -> list[str]:
    """
    Return a sentence about clocks that differ a little.

    :raises DatasetError: they differ a lot.
    """
    # A drift that all topics share, as in a simulation, is no second clock.
    most = max(tracks.values(), key=lambda track: int(track.logs.max() - track.logs.min()))
    drift = most.logs - most.times
    offsets = {name: int(np.median(track.logs - track.times - np.interp(
        track.times, most.times, drift)))
               for name, track in tracks.items()}
    first, last = min(offsets, key=offsets.__getitem__), max(offsets, key=offsets.__getitem__)
    difference = offsets[last] - offsets[first]
    text = (f'the stamps of {first} are {difference / NANO:.3f} s ahead of those of {last}, '
            'compared with the times of the recording')
    if difference > _ERROR_NS:
        raise DatasetError(f'{text}: they have two clocks; {LOG_REMEDY}')
    return [text] if difference > _WARNING_NS else []


def _timed(events: Samples, plan: Plan, clock: _Clock) -> list[tuple[int, Any]]:
    has_stamp = plan.clock == 'stamp' and events.reader and events.reader.has_stamp
    times = (events.times('stamp', str(plan.episodes)).tolist() if has_stamp and events.logs else
             [clock.stamp(log) for log in events.logs])
    return sorted(zip(times, events.events or []), key=lambda pair: pair[0])


def _reason(err: Exception) -> str:
    return str(err.strerror if isinstance(err, OSError) and err.strerror else err)
