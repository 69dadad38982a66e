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

"""
Conversion of bags to data sets: against a bare loop, on Ray, and the merge of shards.

The bare loop decodes the same JPEGs and encodes them with the same settings, by as many processes
as there are processors. It reads no bag, and writes no rows, statistics or small pictures.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from contextlib import suppress
import ctypes
from functools import partial
import importlib.util
import multiprocessing
import os
from pathlib import Path
import resource
import shutil
import statistics
import subprocess
import sys
import tempfile
import time

import cv2
from dataset_files import CAMERAS, FPS, write_bag, write_jpegs
from figures import add_json_option, Figure, print_figures
import numpy as np
from opencv_tools.datasets.bag_conversion import convert_bag
from opencv_tools.datasets.jobs import convert_here, find_jobs, Job
from opencv_tools.datasets.part import read_part
from opencv_tools.datasets.plan import NumbersSource, Plan
from opencv_tools.datasets.shards import write_shard
from opencv_tools.datasets.tracks import resolved
from opencv_tools.datasets.videos import VideoFileWriter

CORES = len(os.sched_getaffinity(0))
BAGS = 2 * CORES  # of the comparison with the bare loop
SMALL_BAGS, SMALL_FRAMES = 100, 4  # and pictures of each camera in a small bag
RATIO, RAY_SHARE, OVERHEAD, GB_SECONDS = 1.2, 0.9, 20.0, 90.0  # goals
_CRF = 23
_SUBREAPER = 36  # PR_SET_CHILD_SUBREAPER of prctl(2)
_STARTED = [sys.executable, '-c',
            'import sys; from opencv_tools.convert.cli import main; sys.exit(main())']


def run(command: Sequence[str | Path]) -> tuple[float, float]:
    """Run a command; return its seconds, and those of the processors for all its processes."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    began = time.perf_counter()
    with tempfile.TemporaryFile('w+') as output:
        process = subprocess.Popen([*map(str, command)], stdout=output, stderr=output,
                                   start_new_session=True)
        process.wait()
        seconds = time.perf_counter() - began
        if process.returncode:
            output.seek(0)
            raise SystemExit(output.read())
    with suppress(ChildProcessError):  # those that it has left behind are children now
        while True:
            os.waitpid(-process.pid, 0)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return seconds, sum(getattr(after, name) - getattr(before, name)
                        for name in ('ru_utime', 'ru_stime'))


def run_once(command: Sequence[str | Path], target: Path) -> tuple[float, float]:
    """Run a command as `run` does, and remove the folder that it writes."""
    found = run(command)
    shutil.rmtree(target)
    return found


def interleaved(ways: Mapping[str, Callable[[], tuple[float, float]]], rounds: int,
                ) -> dict[str, tuple[float, float]]:
    """Return the medians of the seconds and of the processors' seconds of each way."""
    found: dict[str, list[tuple[float, float]]] = {name: [] for name in ways}
    for _ in range(rounds):
        for name, way in ways.items():
            found[name].append(way())
    return {name: (statistics.median(one[0] for one in times),
                   statistics.median(one[1] for one in times)) for name, times in found.items()}


def options_of_plan() -> list[str]:
    """Return the options of img_convert for the bags."""
    images = [word for name, topic in CAMERAS.items() for word in ('--image', f'{name}={topic}')]
    return ['--format', 'lerobot', '--fps', str(FPS), *images, '--state',
            '/joint_states.position', '--action', 'next', '--task', 'wave', '--crf', str(_CRF)]


def plan_of_bags(bag: Path) -> Plan:
    """Return the same plan for functions of the package."""
    state = NumbersSource('/joint_states', ('position',))
    return resolved(Plan(fps=FPS, images=tuple(CAMERAS.items()), crf=_CRF, next_action=True,
                         vectors=(('observation.state', (state,)),), task='wave'), bag)


def encode(jpegs: Sequence[Path], count: int, target: Path) -> None:
    """Decode JPEGs and encode them as one video: the work of a process of the bare loop."""
    cv2.setNumThreads(1)
    contents = [np.frombuffer(path.read_bytes(), np.uint8) for path in jpegs]
    writer = VideoFileWriter(target, FPS, _CRF)
    for number in range(count):
        image = cv2.imdecode(contents[number % len(contents)], cv2.IMREAD_COLOR)
        writer.write(number, image, is_first=not number)
    writer.close()


def bare_loop(jpegs: Path, videos: int, count: int, target: Path) -> None:
    """Encode some videos of the same pictures, in a process for each processor."""
    target.mkdir()
    context = multiprocessing.get_context('fork')
    with ProcessPoolExecutor(CORES, context) as pool:
        for future in [pool.submit(encode, sorted(jpegs.iterdir()), count,
                                   target / f'{number}.mp4') for number in range(videos)]:
            future.result()


def conversion(folder: Path, megabytes: int, rounds: int) -> Iterator[Figure]:
    """Compare the conversion of some bags, and of one bag, with the bare loop."""
    jpegs = folder / 'jpegs'
    mean = write_jpegs(jpegs)
    for bags, share in ((BAGS, 1), (1, 3)):
        count = max(2, megabytes * 10 ** 6 // (share * bags * len(CAMERAS)) // mean)
        source = folder / f'{bags}_bags'
        size = sum(write_bag(source / f'{number}.mcap', jpegs, count) for number in range(bags))
        ours, bare = folder / 'set', folder / 'bare'

        medians = interleaved({
            'ours': partial(run_once, [*_STARTED, source, ours, *options_of_plan()], ours),
            'bare': partial(run_once, [sys.executable, __file__, '--bare', jpegs,
                                       str(bags * len(CAMERAS)), str(count), bare], bare)}, rounds)
        times = [ours / bare for ours, bare in zip(medians['ours'], medians['bare'])]
        shown = f'{bags} bags' if bags > 1 else '1 bag'
        goal, is_judged = (f'at most {RATIO}', True) if bags > 1 else ('', False)
        for kind, value in zip(('time', 'processor time'), times):
            yield Figure('datasets', f'{size / 1e6:.0f} MB in {shown}: {kind} against a bare loop',
                         value, 'x', goal, value <= RATIO if is_judged else None)
        seconds = medians['ours'][0] * 1e9 / size
        yield Figure('datasets', f'1 GB of JPEG in {shown}, from {size / 1e6:.0f} MB', seconds,
                     's', f'at most {GB_SECONDS:g} on two cores' if is_judged else '',
                     seconds <= GB_SECONDS if is_judged else None)
        shutil.rmtree(source)


def parts_of(jobs: Sequence[Job], folder: Path) -> list[Job]:
    """Return the jobs with the folders of their parts elsewhere."""
    return [Job(job.path, job.name, folder / job.folder.name) for job in jobs]


def convert_all(jobs: Sequence[Job], plan: Plan) -> None:
    """Convert bags one after the other, without any engine."""
    cv2.setNumThreads(1)
    for job in jobs:
        convert_bag(str(job.path), plan, str(job.folder), job.name)


def ideal(pool: ProcessPoolExecutor, jobs: Sequence[Job], plan: Plan, workers: int) -> float:
    """Return the seconds of processes that have imported everything and share the bags evenly."""
    began = time.perf_counter()
    for future in [pool.submit(convert_all, jobs[number::workers], plan)
                   for number in range(workers)]:
        future.result()
    return time.perf_counter() - began


def timed(converted: Iterator[tuple[Job, str]]) -> float:
    """Return the seconds of an engine; each bag must be converted."""
    began = time.perf_counter()
    for job, error in converted:
        if error:
            raise SystemExit(f'{job.name}: {error}')
    return time.perf_counter() - began


def small_bags(folder: Path, jobs: Sequence[Job], plan: Plan, rounds: int) -> Iterator[Figure]:
    """Compare the engines with processes that have no engine, on many small bags."""
    numbers = (step for step in range(1 << 30))

    def fresh() -> list[Job]:
        return parts_of(jobs, folder / f'parts_{next(numbers)}')

    # Ray's threads forbid a fork of this process.
    with ProcessPoolExecutor(CORES, multiprocessing.get_context('forkserver')) as pool:
        ideal(pool, fresh()[:CORES], plan, CORES)  # starts the processes
        medians = interleaved({
            'processes': lambda: (timed(convert_here(fresh(), plan, CORES)), 0.0),
            'ideal': lambda: (ideal(pool, fresh(), plan, CORES), 0.0)}, rounds)
        yield overhead(f'{len(jobs)} small bags by {CORES} processes', medians['processes'][0],
                       medians['ideal'][0])
        if importlib.util.find_spec('ray') is None:
            print('Ray is not installed, so it is not measured: pip install ray', flush=True)
            return
        for workers in (1, 2) if CORES > 1 else (1,):
            yield from on_ray(pool, fresh, plan, workers, rounds)


def on_ray(pool: ProcessPoolExecutor, fresh: Callable[[], list[Job]], plan: Plan, workers: int,
           rounds: int) -> Iterator[Figure]:
    """
    Measure a Ray cluster of this machine with some workers.

    The start of the cluster is not counted, but each run starts workers, which import everything.
    """
    from opencv_tools.datasets.on_ray import convert_on_ray
    from ray.cluster_utils import Cluster
    cluster = Cluster(initialize_head=True, head_node_args={
        'num_cpus': workers, 'include_dashboard': False})
    try:
        timed(convert_on_ray(fresh()[:workers], plan, cluster.address, 0))  # fills the disk cache
        start = timed(convert_on_ray(fresh()[:workers], plan, cluster.address, 0))
        medians = interleaved({
            'ray': lambda: (timed(convert_on_ray(fresh(), plan, cluster.address, 0)), 0.0),
            'ideal': lambda: (ideal(pool, fresh(), plan, workers), 0.0)}, rounds)
    finally:
        cluster.shutdown()
    share = medians['ideal'][0] / medians['ray'][0]
    named = f'{workers} worker{"s" if workers > 1 else ""}'
    yield Figure('datasets', f'Ray, {named}: one small bag each, with the start of the workers',
                 start, 's')
    yield Figure('datasets', f'{SMALL_BAGS} small bags on Ray, {named}: part of ideal', share, 'x',
                 f'at least {RAY_SHARE}', share >= RAY_SHARE)
    yield overhead(f'{SMALL_BAGS} small bags on Ray, {named}', medians['ray'][0],
                   medians['ideal'][0])


def overhead(name: str, seconds: float, least: float) -> Figure:
    """Return how much more time an engine takes."""
    percent = (seconds / least - 1) * 100
    return Figure('datasets', f'{name}: overhead', percent, '%', f'below {OVERHEAD:g}',
                  percent < OVERHEAD)


def merge(folder: Path, jobs: Sequence[Job], rounds: int) -> Figure:
    """Measure the merge of a shard for each bag."""
    shards = []
    for number, job in enumerate(jobs):
        shards.append(folder / f'shard_{number}')
        shards[-1].mkdir()
        job.folder.rename(shards[-1] / job.folder.name)
        write_shard(shards[-1], (number + 1, len(jobs)), read_part(shards[-1] / job.folder.name)[
            'plan'], [job.name])
    target = folder / 'merged'
    merging = partial(run_once, [*_STARTED, '--merge', *shards, target], target)
    seconds, _ = interleaved({'merge': merging}, rounds)['merge']
    return Figure('datasets', f'merge of {len(shards)} shards', seconds, 's')


def figures(folder: Path, options: argparse.Namespace) -> Iterator[Figure]:
    """Measure everything."""
    yield from conversion(folder, options.megabytes, options.rounds)
    bags = folder / 'small'
    for number in range(SMALL_BAGS):
        write_bag(bags / f'{number}.mcap', folder / 'jpegs', SMALL_FRAMES)
    jobs = find_jobs(str(bags), folder / 'parts')
    plan = plan_of_bags(jobs[0].path)
    yield from small_bags(folder, jobs, plan, max(1, options.rounds // 2))
    timed(convert_here(jobs, plan, CORES))
    yield merge(folder, jobs, options.rounds)


def main() -> int:
    """Print the figures; the exit status is 1 when a goal is missed."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--megabytes', type=int, metavar='N', default=150,
                        help='size of the bags of the comparison with the bare loop [%(default)s]')
    parser.add_argument('--rounds', type=int, metavar='N', default=3,
                        help='runs of each way [%(default)s]')
    parser.add_argument('--bare', nargs=4, metavar=('JPEGS', 'VIDEOS', 'COUNT', 'TARGET'),
                        help=argparse.SUPPRESS)
    add_json_option(parser)
    options = parser.parse_args()
    if options.bare:
        jpegs, videos, count, target = options.bare
        bare_loop(Path(jpegs), int(videos), int(count), Path(target))
        return 0
    ctypes.CDLL(None).prctl(_SUBREAPER, 1, 0, 0, 0)
    with tempfile.TemporaryDirectory() as folder:
        found = print_figures(figures(Path(folder), options), options.json)
    return int(any(figure.met is False for figure in found))


if __name__ == '__main__':
    sys.exit(main())
