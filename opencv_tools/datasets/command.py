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

"""What img_convert does for data sets: convert, check and merge."""

from __future__ import annotations

from argparse import Namespace
from collections.abc import Iterator, Sequence
import os
from pathlib import Path

from opencv_tools.datasets.check import row_problems
from opencv_tools.datasets.check_videos import has_fingerprints, video_problems
from opencv_tools.datasets.dry_run import describe_bag
from opencv_tools.datasets.episodes import check_bags
from opencv_tools.datasets.errors import DatasetError, os_reason
from opencv_tools.datasets.folders import (
    check_target, locked_parts, natural_key, remove_part, replaced_folder, working_parts)
from opencv_tools.datasets.jobs import convert_here, find_jobs, Job
from opencv_tools.datasets.lerobot import import_pyarrow, INFO
from opencv_tools.datasets.merge import check_alike, merge_parts
from opencv_tools.datasets.options import plan_of
from opencv_tools.datasets.part import bag_state, is_done, PART, read_part
from opencv_tools.datasets.plan import LEROBOT, Plan
from opencv_tools.datasets.report import topic_lines
from opencv_tools.datasets.sample_files import BAGS, gather_samples
from opencv_tools.datasets.set_reader import SetReader
from opencv_tools.datasets.shards import check_shards, write_shard
from opencv_tools.datasets.tracks import resolved
from opencv_tools.image.text import enumerated, MAX_PATH, printable
from opencv_tools.logs import ConsoleWriter, Log
from opencv_tools.regular_files import user_path

_EXIT_OK, _EXIT_FAILURE = 0, 1
_MOST_PROBLEMS = 20


def run(options: Namespace) -> int:
    """
    Do what the options say.

    :returns: the exit status.
    :raises DatasetError: an option is invalid.
    """
    log = Log(ConsoleWriter('img_convert'))
    import_pyarrow()
    paths = [user_path(path).absolute() for path in options.paths]
    if paths and paths[-1].name in ('', '..'):
        raise DatasetError(f'{printable(paths[-1], MAX_PATH)} has no name; give a folder by its '
                           'name')
    try:
        if options.check:
            _check_count(paths, 1, 1, 'img_convert --check SET')
            return _check(paths[0], log)
        if options.merge:
            _check_count(paths, 2, 1 << 30, 'img_convert --merge SHARD [SHARD ...] SET')
            return _merge(paths[:-1], paths[-1], options, log)
        _check_count(paths, 2, 2, 'img_convert SOURCE TARGET --format FORMAT')
        return _Conversion(options, plan_of(options), paths[1], log).run()
    except OSError as err:
        log.error(os_reason(err))
        return _EXIT_FAILURE


def _check_count(paths: Sequence[Path], least: int, most: int, usage: str) -> None:
    if not least <= len(paths) <= most:
        raise DatasetError(f'{len(paths)} paths are given; the usage is: {usage}')


class _Conversion:
    """A conversion of bags."""

    def __init__(self, options: Namespace, plan: Plan, target: Path, log: Log) -> None:
        self._options, self._target, self._log = options, target, log
        self._parts = target if options.shard else working_parts(target)
        all_jobs = find_jobs(options.paths[0], self._parts)
        check_bags(plan.intervals, [job.name for job in all_jobs])
        self._jobs = all_jobs
        if options.shard:
            first, count = options.shard
            self._jobs = all_jobs[first - 1::count]
        self._plan = self._resolved(plan, all_jobs)

    def run(self) -> int:
        """Convert the bags; return the exit status."""
        options = self._options
        if options.dry_run:
            return self._dry_run()
        if options.shard:
            write_shard(self._target, options.shard, [job.name for job in self._jobs])
            failed = self._convert()
            self._log.info(f'{len(self._jobs) - len(failed)} of {len(self._jobs)} bags are in '
                           f'{printable(self._target, MAX_PATH)}; join all shards with --merge')
            return _EXIT_FAILURE if failed else _EXIT_OK
        with locked_parts(self._target):
            check_target(self._target, (INFO, BAGS), options.overwrite)
            failed = self._convert()
            done = [job for job in self._jobs if job not in failed]
            if not done or (failed and not options.skip_failed):
                self._log.error(
                    f'{len(failed)} of {len(self._jobs)} bags cannot be converted, so no set is '
                    'written; mend them and run the command again, which converts only what is '
                    'missing, or leave them out with --skip-failed')
                return _EXIT_FAILURE
            if not _write_set([job.folder for job in done], self._target, self._log):
                return _EXIT_FAILURE
            for part in self._parts.iterdir():
                if part.is_dir():
                    remove_part(part)
        return _EXIT_FAILURE if failed else _EXIT_OK

    def _resolved(self, plan: Plan, jobs: Sequence[Job]) -> Plan:
        """Return the plan with the names of all numbers, those of the first bag that has them."""
        reason = ''
        for job in jobs:
            try:
                return resolved(plan, job.path)
            except DatasetError as err:
                reason = reason or f'{printable(job.name)}: {err}'
                if not self._options.skip_failed:
                    break
        raise DatasetError(reason)

    def _dry_run(self) -> int:
        failed = 0
        for job in self._jobs:
            try:
                for line in describe_bag(job.path, job.name, self._plan):
                    print(line)
            except DatasetError as err:
                failed += 1
                self._log.error(f'{printable(job.name)}: {err}')
        return _EXIT_FAILURE if failed else _EXIT_OK

    def _convert(self) -> list[Job]:
        """Convert the bags that are missing; return those that cannot be converted."""
        missing = [job for job in self._jobs if not _is_done(job, self._plan)]
        if len(missing) < len(self._jobs):
            self._log.info(f'{len(self._jobs) - len(missing)} of {len(self._jobs)} bags are '
                           'converted already')
        failed = []
        for number, (job, error) in enumerate(self._engine(missing), 1):
            shown = f'{number} of {len(missing)}, {printable(job.name)}'
            if error:
                failed.append(job)
                self._log.error(f'{shown}: {error}')
                continue
            part = read_part(job.folder)
            rows = sum(episode['length'] for episode in part['episodes'])
            self._log.info(f'{shown}: {rows} rows in {len(part["episodes"])} episodes')
            for warning in part['warnings']:
                self._log.warning(f'{printable(job.name)}: {warning}')
        return failed

    def _engine(self, jobs: Sequence[Job]) -> Iterator[tuple[Job, str]]:
        if not jobs:
            return iter(())
        if self._options.ray:
            from opencv_tools.datasets.on_ray import convert_on_ray
            return convert_on_ray(jobs, self._plan, self._options.ray,
                                  self._options.ray_memory * 10 ** 6)
        workers = self._options.jobs or len(os.sched_getaffinity(0))
        return convert_here(jobs, self._plan, workers)


def _is_done(job: Job, plan: Plan) -> bool:
    try:
        return is_done(job.folder, plan, bag_state(job.path))
    except OSError:
        return False  # its conversion says why


def _write_set(parts: Sequence[Path], target: Path, log: Log) -> bool:
    """Write a set of parts; return whether they fit each other."""
    try:
        described = [read_part(part) for part in parts]
        check_alike(described)
        with replaced_folder(target) as folder:
            if described[0]['format'] == LEROBOT:
                merge_parts(parts, described, folder)
            else:
                gather_samples(parts, described, folder)
    except DatasetError as err:
        log.error(str(err))
        return False
    for line in topic_lines(described):
        log.info(line)
    episodes = [episode for part in described for episode in part['episodes']]
    log.info(f'{printable(target, MAX_PATH)} has {len(episodes)} episodes with '
             f'{sum(episode["length"] for episode in episodes)} rows of {len(parts)} bags')
    return True


def _merge(folders: Sequence[Path], target: Path, options: Namespace, log: Log) -> int:
    found: dict[str, Path] = {}
    for folder in folders:
        parts = [path.parent for path in folder.glob(f'*/{PART}')
                 if not path.parent.name.startswith('.')]
        if not parts and not [*folder.glob('shard_*.json')]:
            raise DatasetError(f'{printable(folder, MAX_PATH)} has no part of a data set; give '
                               'folders that --shard has written')
        for part in parts:
            bag = read_part(part)['bag']
            if bag in found:
                raise DatasetError(f'{printable(bag)} is in {printable(found[bag].parent)} and in '
                                   f'{printable(folder)}; merge each bag once')
            found[bag] = part
    for warning in check_shards(folders, found.keys(), options.skip_failed):
        log.warning(warning)
    if not found:
        raise DatasetError('the shards have no bag')
    with locked_parts(target):
        check_target(target, (INFO, BAGS), options.overwrite)
        is_written = _write_set(
            [found[bag] for bag in sorted(found, key=natural_key)], target, log)
    return _EXIT_OK if is_written else _EXIT_FAILURE


def _check(folder: Path, log: Log) -> int:
    problems: list[str] = []
    try:
        reader = SetReader(folder)
        episodes = reader.episodes()
        problems += row_problems(reader, episodes)
        problems += video_problems(reader, episodes)
    except DatasetError as err:
        problems.append(str(err))
    for problem in problems[:_MOST_PROBLEMS]:
        log.error(problem)
    if problems:
        log.error(f'{printable(folder, MAX_PATH)} has {len(problems)} errors')
        return _EXIT_FAILURE
    videos = enumerated([printable(key) for key in reader.video_keys]) or 'no videos'
    compared = 'compared with the bags' if has_fingerprints(reader) else (
        'not compared with their origin, which is unknown')
    pictures = f'; the pictures are {compared}' if reader.video_keys else ''
    log.info(f'{printable(folder, MAX_PATH)} is complete: {len(episodes)} episodes, '
             f'{episodes[-1]["dataset_to_index"]} rows, {videos}{pictures}')
    return _EXIT_OK
