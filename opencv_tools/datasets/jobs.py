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

"""The bags of a conversion, converted one after the other, in processes, or on a Ray cluster."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from concurrent.futures import as_completed, Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
import glob
import multiprocessing
from multiprocessing import forkserver
import os
from pathlib import Path
import signal
from threading import Thread

from opencv_tools.bags.open_bag import BAG_SUFFIXES, is_bag, recordings
from opencv_tools.base.regular_files import user_path
from opencv_tools.base.signals import ignore_signals
from opencv_tools.base.text import printable, without_password
from opencv_tools.datasets.bag_conversion import convert_bag
from opencv_tools.datasets.errors import DatasetError, os_reason
from opencv_tools.datasets.folders import natural_key, part_folder
from opencv_tools.datasets.plan import Plan

_MOST_BAGS = 1_000_000


@dataclass(frozen=True)
class Job:
    """
    A bag, and the part that it becomes.

    :param name: name of the bag in the set: its path below the folder or pattern.
    :param folder: folder of its part.
    :param files: files of a recording that was split, the first of which is ``path``; empty for
        those of the path.
    """

    path: Path
    name: str
    folder: Path
    files: tuple[Path, ...] = ()


def find_jobs(source: str, parts: Path) -> list[Job]:
    """
    Find the bags of a source, in the natural order of their names.

    The files of a recording that was split are one bag.

    :param source: bag, folder with bags at any depth, or glob pattern.
    :param parts: folder of the parts.
    :raises DatasetError: there is no bag.
    """
    path = user_path(source)
    is_pattern = any(letter in source for letter in '*?[') and not path.exists()
    if is_bag(path) and not is_pattern:
        found = [(path, path.name)]
    elif path.is_dir():
        found = [(bag, str(bag.relative_to(path))) for bag in _bags_below(path)]
    else:
        found = _matching_bags(path)
    if not found:
        raise DatasetError(f'{without_password(source)} is no bag, and has none: give a file '
                           f'({", ".join(BAG_SUFFIXES)}), a folder or a pattern')
    if len(found) > _MOST_BAGS:
        raise DatasetError(f'{without_password(source)} has more than {_MOST_BAGS} bags')
    names = {bag.absolute(): name for bag, name in sorted(
        found, key=lambda pair: natural_key(pair[1]))}
    return [Job(files[0], names[files[0]], part_folder(parts.absolute(), names[files[0]]),
                tuple(files) if len(files) > 1 else ()) for files in recordings(names)]


def _matching_bags(pattern: Path) -> list[tuple[Path, str]]:
    """Return the bags of a glob pattern, each with its path below the folder of all."""
    matches = [Path(match) for match in glob.glob(str(pattern), recursive=True)]
    folders = {match for match in matches if match.is_dir() and is_bag(match)}
    bags = [match for match in matches  # not a folder and its files
            if match in folders or (is_bag(match) and folders.isdisjoint(match.parents))]
    if not bags:
        return []
    root = os.path.commonpath([bag.absolute().parent for bag in bags])
    return [(bag, str(bag.absolute().relative_to(root))) for bag in bags]


def _bags_below(folder: Path) -> Iterator[Path]:
    """Yield the bags in a folder and in the folders below; each folder once."""
    seen: set[tuple[int, int]] = set()
    for root, folders, files in os.walk(folder, followlinks=True):
        here = Path(root)
        status = here.stat()
        if (status.st_dev, status.st_ino) in seen:  # links may lead back
            folders.clear()
            continue
        seen.add((status.st_dev, status.st_ino))
        inner = [name for name in folders if is_bag(here / name)]
        yield from (here / name for name in inner)
        folders[:] = [name for name in folders
                      if name not in inner and not name.startswith('.')]
        yield from (here / name for name in files
                    if is_bag(here / name) and not name.startswith('.'))


def convert_job(job: Job, plan: Plan, threads: int) -> str:
    """Convert a bag; return '' or why it cannot be converted."""
    try:
        convert_bag(str(job.path), plan, str(job.folder), job.name, threads, job.files)
    except DatasetError as err:
        return str(err)
    except OSError as err:
        return os_reason(err)
    except MemoryError:
        return 'there is not enough memory'
    except Exception as err:  # noqa: B902 (a bag that no rule foresees costs only itself)
        return f'{type(err).__name__}: {printable(err)}'
    return ''


def convert_here(jobs: Sequence[Job], plan: Plan, workers: int) -> Iterator[tuple[Job, str]]:
    """
    Convert bags in processes of this machine.

    :param workers: number of processes; one bag is converted in this process by as many threads.
    :returns: an iterator over each bag and '' or its error, in the order in which they are done.
    """
    if len(jobs) == 1 or workers == 1:
        yield from ((job, convert_job(job, plan, workers)) for job in jobs)
        return
    rest = {job.name: job for job in jobs}
    threads = max(1, workers // len(jobs))
    for job, error in _in_processes(jobs, plan, min(workers, len(jobs)), threads):
        del rest[job.name]
        yield job, error
    for job in rest.values():  # one of them has ended all processes
        found = list(_in_processes([job], plan, 1, 1))
        yield found[0] if found else (job, 'its process was killed, perhaps for want of memory')


def _in_processes(jobs: Sequence[Job], plan: Plan, workers: int, threads: int,
                  ) -> Iterator[tuple[Job, str]]:
    """Convert bags; end without the rest of them if a process is killed."""
    context = multiprocessing.get_context('forkserver')
    context.set_forkserver_preload(
        ['av', 'pyarrow.parquet', 'opencv_tools.datasets.bag_conversion'])
    mask = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        forkserver.ensure_running()  # Ctrl-C would print a traceback while it imports
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, mask)
    pool = ProcessPoolExecutor(workers, context, initializer=_begin)
    try:
        futures: dict[Future[str], Job] = {
            pool.submit(convert_job, job, plan, threads): job for job in jobs}
        for future in as_completed(futures):
            try:
                yield futures[future], future.result()
            except BrokenProcessPool:
                return
    except BaseException:
        _kill(pool)
        raise
    finally:
        pool.shutdown(cancel_futures=True)


def _begin() -> None:
    """Begin a process: the parent answers to signals, and each process uses one thread."""
    import cv2
    ignore_signals()
    signal.signal(signal.SIGTERM, signal.SIG_DFL)  # by which a broken pool ends its processes
    cv2.setNumThreads(1)
    Thread(target=_end_with_parent, daemon=True).start()


def _end_with_parent() -> None:
    """End the process when its parent was killed; otherwise it would wait forever."""
    parent = multiprocessing.parent_process()
    if parent:
        parent.join()
        os._exit(1)


def _kill(pool: ProcessPoolExecutor) -> None:
    processes: Iterable[multiprocessing.Process] = (
        getattr(pool, '_processes', None) or {}).values()
    for process in list(processes):
        process.kill()
