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

"""From the options of img_convert to the plan of a conversion."""

from __future__ import annotations

from argparse import Namespace
from collections.abc import Sequence
from dataclasses import replace

from opencv_tools.datasets.episodes import read_intervals
from opencv_tools.datasets.errors import DatasetError
from opencv_tools.datasets.plan import (
    ACTION, Interval, NEXT, NumbersSource, parse_named, parse_numbers_source, Plan, RESERVED,
    STATE, unique)
from opencv_tools.image.text import printable
from opencv_tools.regular_files import user_path


def plan_of(options: Namespace) -> Plan:
    """
    Return the plan that the options describe; the names of numbers are those of ``--joints``.

    :raises DatasetError: an option is invalid or missing.
    """
    if options.fps is None:
        raise DatasetError('--fps is missing: give the rows of a second, such as the rate of the '
                           'cameras')
    is_next = options.action == [NEXT]
    if is_next and not options.state:
        raise DatasetError('--action next needs --state')
    if NEXT in options.action and not is_next:
        raise DatasetError('--action next cannot have another action beside it')
    vectors = [(key, _sources(texts, options.joints)) for key, texts in (
        (STATE, options.state), (ACTION, [] if is_next else options.action)) if texts]
    for text in options.vector:
        name, source = parse_named(text, 'a feature')
        if name in RESERVED or (is_next and name == ACTION):
            raise DatasetError(f"a feature cannot have the name '{name}', which every data set "
                               'has; give another name')
        vectors.append((name, _sources([source], ())))
    images = [parse_named(text, 'a camera') for text in options.image]
    if not images and not vectors:
        raise DatasetError('nothing is selected: give --image, --state, --action or --vector; '
                           '--dry-run lists the topics then')
    for option, text in (('--task', options.task), ('--robot', options.robot)):
        if not text.isprintable():
            raise DatasetError(f"{option} '{printable(text)}' is not a printable text")
    episodes = None
    intervals: tuple[Interval, ...] = ()
    if options.episodes.startswith('/') and not options.episodes.endswith('.csv'):
        episodes = parse_numbers_source(options.episodes)
    elif options.episodes:
        intervals = read_intervals(user_path(options.episodes))
    return Plan(
        format=options.format, fps=options.fps, images=unique(images), vectors=unique(vectors),
        next_action=is_next, task=options.task, image_choice=options.align_images,
        vector_choice=options.align_vectors, clock=options.clock, max_gap=options.max_gap,
        splits=options.on_gap == 'split', episodes=episodes, intervals=intervals,
        crf=options.crf, robot_type=options.robot)


def _sources(texts: Sequence[str], joints: tuple[str, ...]) -> tuple[NumbersSource, ...]:
    sources = tuple(replace(parse_numbers_source(text), names=joints) for text in texts)
    if len(set(sources)) < len(sources):
        raise DatasetError(f'{printable(texts[0])} is given twice')
    return sources
