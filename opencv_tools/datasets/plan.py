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

"""The plan of a conversion: which topics become which features of a data set."""

from __future__ import annotations

from dataclasses import asdict, dataclass
import hashlib
import json
import re
from typing import Any

from opencv_tools.base.text import printable
from opencv_tools.datasets.errors import DatasetError

STATE, ACTION = 'observation.state', 'action'
IMAGES = 'observation.images.'
#: Times of the samples of each row, in nanoseconds.
STAMPS = 'stamp_ns'
#: Columns that every data set has.
RESERVED = ('timestamp', 'frame_index', 'episode_index', 'index', 'task_index', STAMPS, 'bag',
            'episode', 'frame', 'task')
#: Value of --action for the state of the next row.
NEXT = 'next'
#: Depths in metres that LeRobot stores if no others are given.
DEPTH_RANGE = (0.01, 10.0)
#: Value of --ends that leaves rows out.
SHORTEN = 'shorten'
LEROBOT, WEBDATASET, PARQUET = FORMATS = ('lerobot', 'webdataset', 'parquet')

# A name becomes a part of the name of a file and of a key of a sample in a tar archive.
_NAME = re.compile('[A-Za-z0-9_]{1,64}')
_FEATURE = re.compile(r'(?=.{1,64}\Z)[A-Za-z0-9_]+(\.[A-Za-z0-9_]+)*')
_VERSION = 2  # of what is written; another one converts all bags anew


@dataclass(frozen=True)
class NumbersSource:
    """
    Numbers in the messages of a topic.

    :param path: names of the fields from the message to the numbers; a number selects an element.
    :param names: names of the numbers, in the order of the feature; empty until a bag is known.
    """

    topic: str
    path: tuple[str, ...] = ()
    names: tuple[str, ...] = ()

    def __str__(self) -> str:
        """Return the text from which the source is parsed."""
        return printable('.'.join((self.topic, *self.path)))


@dataclass(frozen=True)
class Interval:
    """
    An interval of a bag that becomes an episode.

    :param bag: name of the bag in the set, or of its file or folder; '' for every bag.
    :param start: seconds from the first message of the bag.
    :param end: the same, of the end.
    :param task: text of the task; '' for that of the plan.
    """

    bag: str
    start: float
    end: float
    task: str = ''


@dataclass(frozen=True, kw_only=True)
class Plan:
    """
    What becomes of a bag.

    :param format: one of ``FORMATS``.
    :param fps: rows of a second.
    :param images: name of each camera, and its topic.
    :param depth: names of those cameras of ``images`` that are for depth.
    :param depth_range: smallest and largest depth of videos in metres.
    :param depth_scale: 'log' or 'linear' steps of the depth of videos.
    :param vectors: name of each feature of numbers, and the sources that follow each other in it.
    :param next_action: whether the action is the state of the next row.
    :param image_choice: which image belongs to a row: 'last' before it, or 'nearest'.
    :param vector_choice: which numbers belong to a row: 'last' before it, or 'linear' between two.
    :param clock: 'stamp' for the stamps of the headers, 'log' for the times of the recording.
    :param max_gap: largest age of a sample in seconds.
    :param splits: whether rows with older samples end an episode; otherwise they are an error.
    :param ends: 'shorten' to leave out rows at the begin and end that a topic has no sample for;
        'fail' for an error if they are longer than ``max_gap``, as in the middle.
    :param episodes: source of a value that is not 0, false or '' during an episode; None for one
        episode a bag.
    :param intervals: intervals of bags that become episodes; empty for one episode a bag.
    :param crf: constant rate factor of x264.
    :param robot_type: name of the robot; '' if unknown.
    """

    format: str = LEROBOT  # noqa: A003
    fps: int
    images: tuple[tuple[str, str], ...] = ()
    depth: tuple[str, ...] = ()
    depth_range: tuple[float, float] = DEPTH_RANGE
    depth_scale: str = 'log'
    vectors: tuple[tuple[str, tuple[NumbersSource, ...]], ...] = ()
    next_action: bool = False
    task: str = ''
    image_choice: str = 'last'
    vector_choice: str = 'last'
    clock: str = 'stamp'
    max_gap: float = 1.0
    splits: bool = False
    ends: str = 'fail'
    episodes: NumbersSource | None = None
    intervals: tuple[Interval, ...] = ()
    crf: int = 23
    robot_type: str = ''

    @property
    def digest(self) -> str:
        """Text that differs for another plan."""
        content = json.dumps([_VERSION, asdict(self)], sort_keys=True)
        return hashlib.sha256(content.encode()).hexdigest()

    @property
    def sources(self) -> list[NumbersSource]:
        """All sources of numbers, each once."""
        return list(dict.fromkeys(one for _, sources in self.vectors for one in sources))


def parse_numbers_source(text: str) -> NumbersSource:
    """
    Read a source such as ``/joint_states.position``.

    :raises DatasetError: the text has no topic.
    """
    topic, *path = text.split('.')
    if not topic.startswith('/') or not all(path):
        raise DatasetError(f"'{printable(text)}' is not a topic with fields; give for example "
                           '/joint_states.position')
    return NumbersSource(topic, tuple(path))


def parse_named(text: str, what: str, is_feature: bool = False) -> tuple[str, str]:
    """
    Read a name and a topic, such as ``front=/cam0/image_raw``.

    :param what: what the name is for, in an error.
    :param is_feature: whether the parts of the name may have points between them.
    :raises DatasetError: the text has no topic, or the name cannot be that of a feature.
    """
    name, _, topic = text.partition('=')
    if not (_FEATURE if is_feature else _NAME).fullmatch(name) or not topic.startswith('/'):
        raise DatasetError(f"'{printable(text)}' does not name {what}; give NAME=/topic, the name "
                           f'with letters, digits{", points" * is_feature} and _ only')
    return name, topic


def unique(pairs: list[tuple[str, Any]]) -> tuple[tuple[str, Any], ...]:
    """
    Return pairs of names and values.

    :raises DatasetError: a name is given twice.
    """
    names = [name for name, _ in pairs]
    twice = next((name for name in names if names.count(name) > 1), None)
    if twice:
        raise DatasetError(f"'{printable(twice)}' is given twice; give each name once")
    return tuple(pairs)
