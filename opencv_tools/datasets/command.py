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

"""The command img_convert for data sets: its options, and convert, check and merge."""

from __future__ import annotations

from argparse import Namespace
from collections.abc import Sequence
from dataclasses import fields, replace
from pathlib import Path

from opencv_tools.base.logs import ConsoleWriter, Log
from opencv_tools.base.regular_files import user_path
from opencv_tools.base.text import MAX_PATH, printable
from opencv_tools.datasets.check import check_set
from opencv_tools.datasets.conversion import Conversion
from opencv_tools.datasets.episodes import read_intervals
from opencv_tools.datasets.errors import DatasetError, os_reason, UnreadableError
from opencv_tools.datasets.plan import (
    ACTION, IMAGES, Interval, LEROBOT, NEXT, NumbersSource, parse_named, parse_numbers_source,
    Plan, RESERVED, STAMPS, STATE, unique)
from opencv_tools.datasets.set_writing import merge_shards


def plan_of(options: Namespace) -> Plan:
    """
    Return the plan that the options describe; the names of numbers are those of ``--joints``.

    :raises DatasetError: an option is invalid or missing.
    """
    if options.fps is None:
        raise DatasetError('--fps is missing: give the rows of a second, such as the rate of the '
                           'cameras')
    is_next = options.action == [NEXT]
    vectors = _vectors(options, is_next)
    images = [parse_named(text, 'a camera') for text in options.image]
    depth = [(f'{name}_depth', topic) for name, topic in (
        parse_named(text, 'a camera') for text in options.depth)]
    if not images and not depth and not vectors:
        raise DatasetError('nothing is selected: give --image, --depth, --state, --action or '
                           '--vector')
    if (options.depth_range, options.depth_scale) != (Plan.depth_range, Plan.depth_scale):
        if options.format != LEROBOT:
            raise DatasetError(f'--depth-range and --depth-scale are for {LEROBOT}; PNG have '
                               'millimetres')
        if not depth:
            raise DatasetError('--depth-range and --depth-scale have an effect with --depth only: '
                               'give --depth NAME=/topic, or leave them out')
    for option, text in (('--task', options.task), ('--robot', options.robot_type)):
        if not text.isprintable():
            raise DatasetError(f"{option} '{printable(text)}' is not a printable text")
    episodes, intervals = _episodes(options.episodes)
    given = {one.name: getattr(options, one.name) for one in fields(Plan) if one.name in options}
    return Plan(**given | {
        'images': unique(images + depth), 'depth': tuple(name for name, _ in depth),
        'vectors': unique(vectors), 'next_action': is_next,
        'splits': options.on_gap == 'split', 'episodes': episodes, 'intervals': intervals})


def _vectors(options: Namespace, is_next: bool) -> list[tuple[str, tuple[NumbersSource, ...]]]:
    """Return the sources of each feature of numbers, with its name."""
    if is_next and not options.state:
        raise DatasetError('--action next needs --state')
    if NEXT in options.action and not is_next:
        raise DatasetError('--action next cannot have another action beside it')
    vectors = [(key, _sources(texts, options.joints)) for key, texts in (
        (STATE, options.state), (ACTION, [] if is_next else options.action)) if texts]
    for text in options.vector:
        name, source = parse_named(text, 'a feature', is_feature=True)
        if (name in RESERVED or name.startswith((IMAGES, f'{STAMPS}.'))
                or (is_next and name == ACTION)):
            raise DatasetError(f"a feature cannot have the name '{name}', which every data set "
                               'has; give another name')
        vectors.append((name, _sources([source], ())))
    return vectors


def _episodes(text: str) -> tuple[NumbersSource | None, tuple[Interval, ...]]:
    """Return the topic that begins episodes, or their intervals in a file."""
    if text.startswith('/') and not text.endswith('.csv'):
        return parse_numbers_source(text), ()
    return None, read_intervals(user_path(text)) if text else ()


def _sources(texts: Sequence[str], joints: tuple[str, ...]) -> tuple[NumbersSource, ...]:
    sources = tuple(replace(parse_numbers_source(text), names=joints) for text in texts)
    if len(set(sources)) < len(sources):
        raise DatasetError(f'{printable(texts[0])} is given twice')
    return sources


_EXIT_OK, _EXIT_FAILURE = 0, 1


def run(options: Namespace) -> int:
    """
    Do what the options say.

    :returns: the exit status.
    :raises DatasetError: an option is invalid.
    """
    log = Log(ConsoleWriter('img_convert'))
    paths = [user_path(path).absolute() for path in options.paths]
    if paths and paths[-1].name in ('', '..'):
        raise DatasetError(f'{printable(paths[-1], MAX_PATH)} has no name; give a folder by its '
                           'name')
    try:
        if options.check:
            _check_count(paths, 1, 1, 'img_convert --check SET')
            return _EXIT_OK if check_set(paths[0], log) else _EXIT_FAILURE
        if options.merge:
            _check_count(paths, 2, 1 << 30, 'img_convert --merge SHARD [SHARD ...] SET')
            failed = merge_shards(paths[:-1], paths[-1], overwrite=options.overwrite,
                                  skip_failed=options.skip_failed, log=log)
            return _EXIT_FAILURE if failed else _EXIT_OK
        _check_count(paths, 2, 2, 'img_convert SOURCE TARGET --format FORMAT')
        return Conversion(options, plan_of(options), paths[1], log).run()
    except OSError as err:
        log.error(os_reason(err))
    except UnreadableError as err:
        log.error(str(err))
    return _EXIT_FAILURE


def _check_count(paths: Sequence[Path], least: int, most: int, usage: str) -> None:
    if not least <= len(paths) <= most:
        raise DatasetError(f'{len(paths)} paths are given; the usage is: {usage}')
