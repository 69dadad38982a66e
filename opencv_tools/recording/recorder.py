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

"""Recorder of frames: a queue, threads that encode, and commits in the order of the frames."""

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

# Called with the path of a written frame, or with the reason why it was not written.
OnDone = Callable[[Path | str], object]


class Prepared(Protocol):
    """A prepared frame that is not committed yet."""

    def discard(self) -> None:
        """Release the prepared frame."""


P = TypeVar('P', bound=Prepared)


@dataclass
class Standing:
    """
    Counts of the frames that were committed to a sink.

    :param kept: frames that are complete in files; decreases when a file is lost.
    :param lost: frames that were accepted but are in no file.
    :param left_out: frames that were accepted but exceeded the limits.
    :param reason: reason for the latest loss.
    """

    kept: int = 0
    lost: int = 0
    left_out: int = 0
    reason: str = ''


class Files(Protocol[P]):
    """
    Destination of recorded frames.

    A committed frame may wait in memory. ``standing`` counts it when it is written or lost, at the
    latest in ``close``.
    """

    standing: Standing

    def prepare(self, frame: Frame) -> P:
        """Encode a frame; thread-safe."""

    def commit(self, frame: Frame, prepared: P) -> Path:
        """Write a prepared frame and return its path; called in the order of the frames."""

    def close(self) -> None:
        """Finish all files."""


@dataclass
class Account:
    """Counts of the frames that were put into a recorder; frames in the queue are not counted."""

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
    """Write frames in worker threads, preserving their order."""

    def __init__(
        self, files: Files[P], log: Log, queue_size: int = QUEUE_SIZE, writers: int = 0,
        block: bool = False, on_full: Callable[[], object] = lambda: None,
    ) -> None:
        """
        Start the worker threads.

        :param files: destination of the frames.
        :param log: log for failures.
        :param queue_size: maximum number of frames that wait to be written.
        :param writers: number of worker threads; 0 for one per processor.
        :param block: whether ``put`` waits when the queue is full; otherwise the oldest frame is
            dropped.
        :param on_full: called on any thread when the recording reaches its limits.
        """
        self.account = Account()
        self.is_full = False
        self.is_unfinished = False  # closing the files failed, although no frame may have
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
        Put a frame into the queue.

        :param frame: immutable frame.
        :param on_done: called on any thread with the path of the frame, or the reason why it was
            not written.
        :returns: False if the oldest frame of the queue was dropped.
        """
        dropped = self._queue.put(_Job(frame, on_done))
        if not dropped:
            return True
        self.account.dropped += 1
        if self._drop_warnings.passes():
            self._log.warning(
                f'{self.account.dropped} frames dropped: they arrive faster than they are '
                f'written, and the queue of {self._queue_size} is full; write .jpg, set every_n, '
                'or raise queue_size')
        dropped.done('the frame was dropped because the queue is full')
        return False

    def close(self) -> None:
        """Write the queued frames, stop the threads and finish the files."""
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
        """Prepare a frame on any thread; return an error, which is reported in order."""
        if self.is_full:
            return FullError('the recording has reached its limits')
        try:
            return self._files.prepare(frame)
        except Exception as err:  # noqa: B902 - later frames wait for the turn of this one
            return err

    def _finish(self, job: _Job, prepared: P | Exception) -> None:
        """Commit a frame and count the outcome."""
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
        """Count the outcome of committed frames and log losses."""
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
                raise FullError('the recording has reached its limits')
            return self._files.commit(frame, prepared)
        except Exception:  # noqa: B902 - it is raised again
            prepared.discard()
            raise

    def _end(self, err: FullError) -> None:
        if not self.is_full:
            self.is_full = True
            self._log.info(f'Recording limit reached: {err}')
            self._on_full()


def reason_of(err: Exception) -> str:
    """Return the text of an error, without a file name that differs for every frame."""
    return (err.strerror if isinstance(err, OSError) else str(err)) or type(err).__name__
