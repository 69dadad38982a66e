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

"""The pictures of the rows of a bag, decoded once each, in the order of the rows."""

from __future__ import annotations

from collections.abc import Callable, Generator, Iterator, Sequence
from contextlib import closing
from dataclasses import replace
from itertools import count
from typing import Any, TypeVar

import cv2
import numpy as np
from numpy.typing import NDArray
from opencv_tools.base.text import printable
from opencv_tools.base.units import NANO
from opencv_tools.capture.bag_pictures import bag_pictures
from opencv_tools.capture.output_image import OutputImage
from opencv_tools.capture.picture_sizes import picture_sizes
from opencv_tools.datasets.episodes import episodes_of
from opencv_tools.datasets.errors import DatasetError
from opencv_tools.datasets.plan import Plan
from opencv_tools.datasets.rows import Rows
from opencv_tools.datasets.tracks import Recording

_Made = TypeVar('_Made')


class _FirstPicturesError(DatasetError):
    """The first pictures of a camera cannot be decoded, but a later one can."""

    def __init__(self, name: str, samples: Sequence[int], reason: str) -> None:
        super().__init__(reason)
        self.name, self.samples = name, samples

    def without(self, recording: Recording) -> Recording:
        """Return the samples of a bag without those pictures, which count as failed."""
        track, count = recording.tracks[self.name], len(self.samples)
        rest = {one: np.delete(getattr(track, one), self.samples, axis=0)
                for one in ('times', 'messages', 'values', 'logs', 'oldest', 'doubled')}
        return replace(recording, tracks={**recording.tracks, self.name: replace(
            track, failed=track.failed + count, **rest)}, warnings=[
                *recording.warnings,
                f'{self.name}: the first {count} pictures cannot be decoded: {self}'])


def with_rows(plan: Plan, recording: Recording, bag: str,
              use: Callable[[Recording, list[Rows]], _Made],
              ) -> tuple[Recording, list[Rows], _Made]:
    """
    Use the samples and the rows of a bag, which begin with pictures that can be decoded.

    :param bag: name of the bag, for a table of episodes.
    :param use: reader of the pictures; it is called again with later rows if the first pictures
        of a camera cannot be decoded.
    :returns: samples, rows of each episode, and what ``use`` returned.
    :raises DatasetError: a picture cannot be used, or as of `episodes_of`.
    """
    while True:
        attempt = replace(recording, warnings=[*recording.warnings])
        try:
            episodes = episodes_of(attempt, plan, bag)
            return attempt, episodes, use(attempt, episodes)
        except _FirstPicturesError as err:
            recording = err.without(recording)
        except DatasetError as err:
            if not recording.bag.warnings:
                raise
            raise DatasetError(f'{err} ({recording.bag.warnings[0]})') from err


def first_pictures(plan: Plan, recording: Recording, episodes: Sequence[Rows],
                   ) -> dict[str, OutputImage]:
    """
    Return the first picture of each camera.

    :raises DatasetError: as of `row_pictures`.
    """
    return {camera: next(row_pictures(plan, recording, camera, episodes))[1]
            for camera, _ in plan.images}


_MOST_AHEAD = 100  # pictures in memory


def row_pictures(plan: Plan, recording: Recording, name: str, episodes: Sequence[Rows],
                 ) -> Generator[tuple[int, OutputImage], None, None]:
    """
    Yield the picture of each row.

    :param recording: samples of the bag, which others may read at the same time.
    :param episodes: rows of each episode.
    :returns: an iterator over the number of the sample that is shown and its picture, whose
        ``image`` is (h, w, 3) BGR, or (h, w) for depth. A picture that
        cannot be decoded is replaced by the one before; the reason of the first one becomes a
        warning of the recording.
    :raises DatasetError: no picture can be decoded before the first row, or for too long, a
        picture cannot be converted, or its size is another one.
    """
    track = recording.tracks[name]
    samples = np.concatenate([rows.samples[name] for rows in episodes]).tolist()
    times = np.concatenate([rows.times for rows in episodes]).tolist()
    wanted = sorted(set(samples))
    pictures = _open_pictures(plan, recording, name, wanted)
    current = -1
    shown: tuple[int, OutputImage] | None = None
    size: tuple[int, int] | None = None
    reason = ''
    with closing(pictures):
        for sample, time_ns in zip(samples, times):
            if sample != current:
                current, picture = sample, _next(pictures)
                if isinstance(picture, str):
                    if not reason:
                        recording.warnings.append(f'{name}: message {track.messages[sample]} '
                                                  f'cannot be decoded: {picture}')
                    reason = picture
                else:
                    _check_size(name, size or picture.size, picture.size)
                    shown, size = (sample, picture), picture.size
            if shown is None:
                bad = [sample]
                for other in wanted[1:]:
                    if not isinstance(_next(pictures), str):
                        raise _FirstPicturesError(name, bad, reason)
                    bad.append(other)
                raise DatasetError(f'{name} has no picture for the first row: message '
                                   f'{track.messages[sample]} of {printable(track.topic.name)} '
                                   f'cannot be decoded: {reason}')
            _check_age(plan, name, time_ns - int(track.times[shown[0]]))
            yield shown


def check_sizes(recording: Recording, name: str, episodes: Sequence[Rows]) -> None:
    """
    Check the sizes of the pictures of a camera by their heads, as far as these have them.

    :raises DatasetError: a picture has another size than the first one, or cannot be read.
    """
    track, first = recording.tracks[name], None
    wanted = {*track.messages[np.concatenate([rows.samples[name] for rows in episodes])].tolist()}
    try:
        for size in picture_sizes(recording.bag, track.topic, wanted):
            first = first or size
            _check_size(name, first, size)
    except (ValueError, OSError) as err:
        raise DatasetError(str(err)) from err


def _check_size(name: str, first: tuple[int, int], size: tuple[int, int]) -> None:
    if size != first:
        raise DatasetError(f'{name} changes its size from {first} to {size}; all pictures of a '
                           'camera must have one size: make one set for each size, by the times '
                           'in --episodes TABLE.csv')


def _open_pictures(plan: Plan, recording: Recording, name: str, samples: Sequence[int],
                   ) -> Generator[OutputImage | str, None, None]:
    """Return an iterator over the pictures of some samples, in the order of their stamps."""
    track = recording.tracks[name]
    messages = track.messages[samples]
    places = np.argsort(np.argsort(messages))  # in the bag, of pictures in the order of stamps
    # While one is shown, those that are read before their turn wait for it.
    latest = np.maximum.accumulate(places)
    ahead = int((latest - np.arange(len(places))).max() + (latest - places).max())
    if ahead > _MOST_AHEAD:
        begin, end = ((int(one) - recording.start_ns) / NANO
                      for one in track.times[samples][latest > places][[0, -1]])
        cause = f', since {track.step}; ' if track.step else '; use --clock log, or '
        raise DatasetError(
            f'{name} has pictures {ahead} places before those with earlier stamps, at most '
            f'{_MOST_AHEAD} are possible{cause}leave the time from {begin:.3f} s to {end:.3f} s '
            'out by the times in --episodes TABLE.csv')
    found = bag_pictures(recording.bag, track.topic, np.sort(messages).tolist(),
                         is_depth=name in plan.depth, kept=ahead + 1)
    return _in_order(found, places.tolist())


def _in_order(pictures: Generator[OutputImage | str, None, None], places: Sequence[int],
              ) -> Generator[OutputImage | str, None, None]:
    """Yield pictures in another order; those that are read before their turn wait."""
    waiting: dict[int, OutputImage | str] = {}
    numbers = count()
    with closing(pictures):
        for place in places:
            while place not in waiting:
                waiting[next(numbers)] = _next(pictures)
            yield waiting.pop(place)


def _next(pictures: Iterator[OutputImage | str]) -> OutputImage | str:
    try:
        return next(pictures, 'it is missing')
    except (ValueError, OSError) as err:
        raise DatasetError(str(err)) from err


def _check_age(plan: Plan, name: str, age_ns: int) -> None:
    """Check that a picture is not too old, because later ones cannot be decoded."""
    if abs(age_ns) > plan.max_gap * NANO:
        raise DatasetError(f'{name} has no picture that can be decoded for {age_ns / NANO:.3f} s; '
                           f'at most {plan.max_gap:g} s are allowed: use a larger --max-gap')


def depth_png(image: NDArray[np.uint16]) -> bytes:
    """Return a PNG of depth in millimetres."""
    return cv2.imencode('.png', image)[1].tobytes()


def luma(image: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Return the brightness of an image in BGR, (h, w)."""
    gray: Any = cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)
    return gray


def fingerprint(gray: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """
    Return a small picture, by which ``--check`` recognises a frame of a video.

    :param gray: (h, w) brightness.
    :returns: (64,) mean of each of 8 x 8 parts.
    """
    small: Any = cv2.resize(gray, (8, 8), interpolation=cv2.INTER_AREA)
    return small.ravel()
