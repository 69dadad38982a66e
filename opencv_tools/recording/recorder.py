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

"""Frames to files: a queue, a few threads that write, and an order that they keep."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
import os
from pathlib import Path
from threading import Lock, Thread
from typing import Generic, Protocol, TypeVar

from opencv_tools.image.errors import ImageError
from opencv_tools.recording.frame_queue import FrameQueue
from opencv_tools.recording.frames import Frame
from opencv_tools.recording.selection import FullError
from opencv_tools.recording.trouble import Log, Throttle, Troubles

QUEUE_SIZE = 64  # frames

# Told where a frame is, or why it is nowhere.
OnDone = Callable[[Path | str], object]


class Prepared(Protocol):
    """What remains to be put in its place."""

    def discard(self) -> None:
        """Let go of it."""


P = TypeVar('P', bound=Prepared)


@dataclass
class Standing:
    """
    What became of the frames that were put in their place.

    :param kept: frames that are whole in files; fewer when a file is lost.
    :param lost: frames that were taken and are in no file.
    :param left_out: frames that were taken and were too much for the limits.
    :param reason: why frames were lost the last time.
    """

    kept: int = 0
    lost: int = 0
    left_out: int = 0
    reason: str = ''


class Files(Protocol[P]):
    """
    What frames are written to.

    A frame that was put in its place may wait in memory. It has its part in ``standing`` when it
    is known what became of it: at the latest when the files are closed.
    """

    standing: Standing

    def prepare(self, frame: Frame) -> P:
        """Do what takes time; more than one thread may."""

    def commit(self, frame: Frame, prepared: P) -> Path:
        """Put a frame in its place, one after another in their order; where it is."""

    def close(self) -> None:
        """Finish."""


@dataclass
class Account:
    """What became of the frames that were handed over; those that wait are not in it."""

    written: int = 0
    dropped: int = 0
    failed: int = 0
    left_out: int = 0


@dataclass(frozen=True)
class _Job:
    frame: Frame
    on_done: OnDone | None

    def done(self, outcome: Path | str) -> None:
        if self.on_done:
            self.on_done(outcome)


class Recorder(Generic[P]):
    """Write each frame beside the thread that hands it over, and in the order they came."""

    def __init__(
        self, files: Files[P], log: Log, queue_size: int = QUEUE_SIZE, writers: int = 0,
        block: bool = False, on_full: Callable[[], object] = lambda: None,
    ) -> None:
        """
        Start the threads.

        :param files: what frames are written to.
        :param log: where trouble is told.
        :param queue_size: frames that may wait to be written.
        :param writers: threads that write; 0 for as many as there are processors.
        :param block: when the queue is full, have ``put`` wait, instead of dropping the oldest.
        :param on_full: told, on any thread, that the files are as large as they may get.
        """
        self.account = Account()
        self.is_full = False
        self.is_unfinished = False  # though no frame may have failed
        self._seen = Standing()
        self._files = files
        self._log = log
        self._on_full = on_full
        self._queue: FrameQueue[_Job] = FrameQueue(queue_size, block)
        self._queue_size = queue_size
        self._troubles = Troubles(log)
        self._drop_warnings = Throttle()
        self._ordering = Lock()
        self._out_of_order: dict[int, tuple[_Job, P | Exception]] = {}
        self._next_place = 0
        self._threads = [Thread(target=self._write_all, name=f'writer-{index}', daemon=True)
                         for index in range(writers or len(os.sched_getaffinity(0)))]
        for thread in self._threads:
            thread.start()

    def put(self, frame: Frame, on_done: OnDone | None = None) -> bool:
        """
        Hand a frame over to be written.

        :param frame: the frame, which nobody changes any more.
        :param on_done: told, on any thread, where it was written or why it was not.
        :returns: False when another one, the oldest that waits, was dropped for it.
        """
        dropped = self._queue.put(_Job(frame, on_done))
        if not dropped:
            return True
        self.account.dropped += 1
        if self._drop_warnings.passes():
            self._log.warning(
                f'{self.account.dropped} frames dropped: they come faster than they are written, '
                f'and {self._queue_size} wait already; write .jpg, take every_n, or raise '
                'queue_size')
        dropped.done('it was dropped, as the queue is full')
        return False

    def close(self) -> None:
        """Write what waits in the queue, end the threads and finish the files."""
        self._queue.close()
        for thread in self._threads:
            thread.join()
        if self._threads:
            self._threads.clear()
            try:
                self._files.close()
            except (OSError, ImageError) as err:
                self.is_unfinished = True
                self._log.error(f'the recording was not finished: {reason_of(err)}')
            finally:
                self._settle()

    def _write_all(self) -> None:
        while (taken := self._queue.get()) is not None:
            place, job = taken
            prepared = self._prepare(job.frame)
            with self._ordering:
                self._out_of_order[place] = job, prepared
                while self._next_place in self._out_of_order:
                    self._finish(*self._out_of_order.pop(self._next_place))
                    self._next_place += 1

    def _prepare(self, frame: Frame) -> P | Exception:
        """Do what needs no order; what failed is told in its turn."""
        if self.is_full:
            return FullError('the recording is full')
        try:
            return self._files.prepare(frame)
        except Exception as err:  # noqa: B902 - the frames behind it wait for its turn
            return err

    def _finish(self, job: _Job, prepared: P | Exception) -> None:
        """Put a frame in its place, and take account of it."""
        try:
            path = self._commit(job.frame, prepared)
        except FullError as err:
            self.account.left_out += 1
            self._end(err)
            job.done(str(err))
        except Exception as err:  # noqa: B902 - as above
            self.account.failed += 1
            tell = self._troubles.outage if isinstance(err, OSError) else self._troubles.failed
            tell(f'a frame was not written: {reason_of(err)}')
            job.done(reason_of(err))
        else:
            job.done(path)
        finally:
            self._settle()

    def _settle(self) -> None:
        """Count what became of the frames that were put in their place."""
        standing, seen, account = replace(self._files.standing), self._seen, self.account
        self._seen = standing
        for _ in range(standing.lost - seen.lost):
            self._troubles.outage(f'a frame was not written: {standing.reason}')
        if standing.kept > seen.kept:
            self._troubles.written()
        account.written += standing.kept - seen.kept
        account.failed += standing.lost - seen.lost
        account.left_out += standing.left_out - seen.left_out

    def _commit(self, frame: Frame, prepared: P | Exception) -> Path:
        if isinstance(prepared, Exception):
            raise prepared
        try:
            if self.is_full:
                raise FullError('the recording is full')
            return self._files.commit(frame, prepared)
        except Exception:  # noqa: B902 - it is raised again
            prepared.discard()
            raise

    def _end(self, err: FullError) -> None:
        if not self.is_full:
            self.is_full = True
            self._log.info(f'The recording is full: {err}')
            self._on_full()


def reason_of(err: Exception) -> str:
    """Say what failed, without the name of a file that is another for every frame."""
    return (err.strerror if isinstance(err, OSError) else str(err)) or type(err).__name__
