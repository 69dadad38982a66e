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

"""Conversion of the bags of a source to a data set or a shard of one, and its dry run."""

from __future__ import annotations

from argparse import Namespace
from collections.abc import Iterator, Sequence
from functools import partial
import os
from pathlib import Path

from opencv_tools.base.logs import Log
from opencv_tools.base.text import MAX_PATH, printable
from opencv_tools.datasets.depth import codes_of, DepthImages
from opencv_tools.datasets.episodes import check_bags
from opencv_tools.datasets.errors import DatasetError
from opencv_tools.datasets.folders import check_target, locked_parts, remove_part, working_parts
from opencv_tools.datasets.jobs import convert_here, find_jobs, Job
from opencv_tools.datasets.merge import MARKS
from opencv_tools.datasets.part import bag_state, is_done, read_part
from opencv_tools.datasets.pictures import check_sizes, first_pictures, with_rows
from opencv_tools.datasets.plan import ACTION, IMAGES, LEROBOT, Plan
from opencv_tools.datasets.row_values import row_vectors, shortened, topic_accounts
from opencv_tools.datasets.set_writing import failed_messages, topic_lines, write_set
from opencv_tools.datasets.shards import write_shard
from opencv_tools.datasets.tracks import open_bag, read_recording, resolved
from opencv_tools.datasets.videos import check_depth_size


def describe_bag(job: Job, plan: Plan) -> int:
    """
    Print lines about a bag: all numbers and heads of pictures are read, the first pictures tried.

    :param plan: plan with the names of all numbers.
    :returns: number of messages that failed.
    :raises DatasetError: the bag cannot be converted by the plan.
    """
    bag, name = open_bag(job.path, job.files), job.name
    recording = read_recording(bag, plan)
    recording, episodes, pictures = with_rows(plan, recording, name, partial(first_pictures, plan))
    uses: dict[str, list[str]] = {}
    for camera, topic in plan.images:
        uses.setdefault(topic, []).append(IMAGES + camera)
    for key, sources in plan.vectors:
        for source in sources:
            names = ', '.join(source.names)
            uses.setdefault(source.topic, []).append(f'{key} ({printable(names)})')
    if plan.episodes:
        uses.setdefault(plan.episodes.topic, []).append('begin and end of episodes')
    kept = shortened(plan, episodes)
    row_vectors(plan, recording, episodes)
    for camera, _ in plan.images:
        check_sizes(recording, camera, episodes)
    rows = [len(one.times) for one in kept]
    for camera in plan.depth if any(rows) else ():
        codes = DepthImages(camera, codes_of(plan)).read(pictures[camera])
        if plan.format == LEROBOT:
            check_depth_size(codes)
    print(f'{printable(name)}: {sum(rows)} rows in {len(rows)} episodes')
    for found, count in sorted(bag.topics.items(), key=lambda pair: pair[0].name):
        use = ' and '.join(uses.get(found.name, ['not used']))
        print(f'  {printable(found.name)} ({printable(found.type_name)}, {count}): {use}')
    if plan.next_action:
        print(f'  {ACTION}: the state of the next row')
    described = {'topics': topic_accounts(recording, kept, kept)}
    for line in [*topic_lines([described]), *(f'warning: {one}' for one in recording.warnings)]:
        print(f'  {line}')
    if plan.images:
        print('  of each camera, only the first picture is decoded')
    return failed_messages([described])


_EXIT_OK, _EXIT_FAILURE = 0, 1
_MOST_TRIED = 100  # bags of which one must have the topics of the plan
_MOST_WARNINGS = 5  # of a bag


class Conversion:
    """A conversion of bags by the options of the command."""

    def __init__(self, options: Namespace, plan: Plan, target: Path, log: Log) -> None:
        """
        Find the bags.

        :raises DatasetError: there is none, or the first one does not suit the plan.
        """
        self._options, self._target, self._log = options, target, log
        self._parts = target if options.shard else working_parts(target)
        all_jobs = find_jobs(options.paths[0], self._parts)
        check_bags(plan.intervals, [job.name for job in all_jobs])
        self._jobs = all_jobs
        if options.shard:
            first, count = options.shard
            self._jobs = all_jobs[first - 1::count]
        for job in self._jobs:
            if job.files:
                log.info(f'{printable(job.name)} to {printable(job.files[-1].name)} are one '
                         f'recording of {len(job.files)} files')
        self._plan = self._resolved(plan, all_jobs)

    def run(self) -> int:
        """
        Convert the bags; return the exit status.

        :raises DatasetError: the target cannot be used.
        :raises OSError: a file cannot be read or written.
        """
        options = self._options
        if options.dry_run:
            return self._dry_run()
        if options.shard:
            write_shard(self._target, options.shard, self._plan.digest,
                        [job.name for job in self._jobs])
            done, failed = self._convert()
            lost = failed_messages(read_part(job.folder) for job in done)
            self._log.info(f'{len(done)} of {len(self._jobs)} bags are in '
                           f'{printable(self._target, MAX_PATH)}, {lost} messages failed; join '
                           'all shards with --merge')
            return _EXIT_FAILURE if failed or lost else _EXIT_OK
        with locked_parts(self._target):
            check_target(self._target, MARKS, options.overwrite)
            done, failed = self._convert()
            if not done or (failed and not options.skip_failed):
                self._log.error(
                    f'{len(failed)} of {len(self._jobs)} bags cannot be converted, so no set is '
                    'written; remove the causes and run the command again, which converts only '
                    'what is missing, or leave these bags out with --skip-failed')
                return _EXIT_FAILURE
            lost = write_set([job.folder for job in done], self._target, self._log)
            for part in self._parts.iterdir():
                if part.is_dir():
                    remove_part(part)
        return _EXIT_FAILURE if failed or lost else _EXIT_OK

    def _resolved(self, plan: Plan, jobs: Sequence[Job]) -> Plan:
        """Return the plan with the names of all numbers, those of the first bag that has them."""
        errors = []
        for job in jobs[:_MOST_TRIED]:
            try:
                return resolved(plan, job.path, job.files)
            except DatasetError as err:
                errors.append(type(err)(f'{printable(job.name)}: {err}'))
        raise errors[0]

    def _dry_run(self) -> int:
        failed = 0
        for job in self._jobs:
            try:
                failed += describe_bag(job, self._plan)
            except DatasetError as err:
                failed += 1
                self._log.error(f'{printable(job.name)}: {err}')
        return _EXIT_FAILURE if failed else _EXIT_OK

    def _convert(self) -> tuple[list[Job], list[Job]]:
        """Convert the bags that are missing; return all that are converted, and the others."""
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
            further = len(part['warnings']) - _MOST_WARNINGS
            for warning in [*part['warnings'][:_MOST_WARNINGS], *(
                    [f'{further} more warnings'] if further > 0 else [])]:
                self._log.warning(f'{printable(job.name)}: {warning}')
        return [job for job in self._jobs if job not in failed], failed

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
        return is_done(job.folder, plan, bag_state(job.path, job.files))
    except OSError:
        return False  # its conversion says why
