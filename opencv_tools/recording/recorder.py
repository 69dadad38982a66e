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

"""Recorder of frames: a bounded queue, threads that encode, and commits in order."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from dataclasses import astuple, dataclass, replace
from operator import add
import os
from pathlib import Path
from threading import Condition, Lock, Thread
from typing import Generic, Protocol, TypeVar

from opencv_tools.base.logs import Log
from opencv_tools.image.errors import ImageError, KeyFrameNeeded
from opencv_tools.recording.errors import error_text, FailureLog, LimitReached, Unwritten
from opencv_tools.recording.frames import ReceivedFrame

T = TypeVar('T')


class WriteQueue(Generic[T]):
    """A bounded queue that drops its oldest item or blocks ``put`` when it is full."""

    def __init__(self, size: int, block: bool) -> None:
        """
        Create an empty queue.

        :param block: whether ``put`` waits for room; otherwise it drops the oldest item.
        """
        self._size = size
        self._block = block
        self._waiting: deque[T] = deque()
        self._removed = 0
        self._closed = False
        self._lock = Lock()
        # One thread is woken for each item; waking all of them costs more than a packet of video.
        self._filled, self._freed = Condition(self._lock), Condition(self._lock)

    @property
    def has_room(self) -> bool:
        """Whether another item would neither drop one nor wait."""
        return len(self._waiting) < self._size

    def put(self, item: T) -> T | None:
        """
        Add an item.

        :returns: the item that was dropped, or None.
        """
        dropped = None
        with self._freed:
            if not self.has_room:
                if self._block:
                    self._freed.wait_for(lambda: self.has_room)
                else:
                    dropped = self._waiting.popleft()
            self._waiting.append(item)
            self._filled.notify()
        return dropped

    def get(self) -> tuple[int, T] | None:
        """
        Remove the oldest item, after a wait if the queue is empty.

        :returns: sequence number among all removed items, from 0, and the item; None if the queue
            is closed and empty.
        """
        with self._filled:
            self._filled.wait_for(lambda: self._waiting or self._closed)
            if not self._waiting:
                return None
            sequence = self._removed
            self._removed += 1
            item = self._waiting.popleft()
            self._freed.notify()
            return sequence, item

    def close(self) -> None:
        """Close the queue; ``get`` returns the remaining items, then None."""
        with self._filled:
            self._closed = True
            self._filled.notify_all()

    def clear(self) -> list[T]:
        """Remove and return the waiting items."""
        with self._freed:
            items = [*self._waiting]
            self._waiting.clear()
            self._freed.notify_all()
            return items


QUEUE_SIZE = 64  # frames
_LEFT_OUT_SECONDS = 10.0  # between two warnings


# Called with the path of a written frame, or with the reason why it was not written.
OnDone = Callable[[Path | Unwritten], object]


class Prepared(Protocol):
    """A prepared frame that is not committed yet."""

    def discard(self) -> None:
        """Release the prepared frame; there is nothing to do for one that is only in memory."""
        return


P = TypeVar('P', bound=Prepared)


@dataclass
class SinkCounts:
    """
    Counts of the frames that were committed to a sink.

    :param kept: frames that are complete in files; decreases when a file is lost.
    :param lost: frames that were accepted but are in no file.
    :param skipped: frames that were accepted but exceeded the limits.
    :param lost_others: other messages that were written, but are in no file any more.
    :param reason: reason for the latest loss.
    :param warning: sentence about the frames that the user should read; '' for none.
    """

    kept: int = 0
    lost: int = 0
    skipped: int = 0
    lost_others: int = 0
    reason: str = ''
    warning: str = ''


class Sink(Protocol[P]):
    """
    Destination of recorded frames.

    A committed frame may wait in memory. ``counts`` includes it when it is written or lost, at the
    latest in ``close``.
    """

    counts: SinkCounts

    def prepare(self, frame: ReceivedFrame) -> P:
        """Encode a frame; thread-safe."""

    def commit(self, frame: ReceivedFrame, prepared: P) -> Path:
        """Write a prepared frame and return its path; called in the order of the frames."""

    def close(self) -> None:
        """Finish all files."""


@dataclass
class FrameCounts:
    """Counts of the frames that were put into a recorder; frames in the queue are not counted."""

    written: int = 0
    dropped: int = 0
    failed: int = 0
    skipped: int = 0
    left_out: int = 0  # packets of video that need others, which are missing
    unprocessed: int = 0  # left at the end

    def __add__(self, other: FrameCounts) -> FrameCounts:
        return FrameCounts(*map(add, astuple(self), astuple(other)))

    def losses(self, lost: int = 0) -> dict[str, int]:
        """Return the number of the frames that are in no file, by what became of them."""
        return {'dropped': self.dropped, 'failed': self.failed, 'skipped': self.skipped,
                'left out': self.left_out, 'not processed': self.unprocessed,
                'lost in transit': lost}


@dataclass(frozen=True)
class _Job:
    frame: ReceivedFrame
    on_done: OnDone | None

    def done(self, outcome: Path | Unwritten) -> None:
        if self.on_done:
            self.on_done(outcome)


class Recorder(Generic[P]):
    """Write frames in worker threads, preserving their order."""

    def __init__(
        self, sink: Sink[P], log: Log, queue_size: int = QUEUE_SIZE, writers: int = 0,
        block: bool = False, on_full: Callable[[], object] = lambda: None,
    ) -> None:
        """
        Start the worker threads.

        :param queue_size: maximum number of frames that wait to be written.
        :param writers: number of worker threads; 0 for one per processor.
        :param block: whether ``put`` waits when the queue is full; otherwise the oldest frame is
            dropped.
        :param on_full: called on any thread when the recording reaches its limits.
        """
        self.counts = FrameCounts()
        self.is_full = False
        self.limit = ''  # which limit the recording has reached
        self.is_unfinished = False  # other messages or the end of a file failed
        self.is_abandoned = False
        self._abandoned: list[_Job] = []
        self._seen = SinkCounts()
        self._sink = sink
        self.log = log
        self.on_full = on_full
        self._queue: WriteQueue[_Job] = WriteQueue(queue_size, block)
        self._queue_size = queue_size
        self._failure_log = FailureLog(log)
        self._ordering = Lock()
        self._counting = Lock()
        self._out_of_order: dict[int, tuple[_Job, P | Exception]] = {}
        self._next_sequence = 0
        self._threads = [
            Thread(target=self._write_all, name=f'writer-{index}', daemon=True)
            for index in range(writers or len(os.sched_getaffinity(0)))]
        for thread in self._threads:
            thread.start()

    @property
    def has_room(self) -> bool:
        """Whether another frame would neither drop one nor wait."""
        return self._queue.has_room

    def put(self, frame: ReceivedFrame, on_done: OnDone | None = None) -> bool:
        """
        Put a frame into the queue.

        :param on_done: called on any thread with the path of the frame, or the reason why it was
            not written.
        :returns: False if the oldest frame of the queue was dropped.
        """
        dropped = self._queue.put(_Job(frame, on_done))
        if not dropped:
            return True
        with self._counting:  # frames and messages of topics may come from two threads
            self.counts.dropped += dropped.frame.count
        what = f'{self.counts.dropped} frames' if dropped.frame.count else 'messages of topics'
        self.log.warning(
            f'{what} dropped: they arrive faster than they are written, and the queue of '
            f'{self._queue_size} is full; write .jpg, set every_n, or raise queue_size',
            every=1.0, key=f'dropped {dropped.frame.count}')
        dropped.done(Unwritten('the frame was dropped because the queue is full', 'dropped'))
        return False

    @property
    def abandoned(self) -> int:
        """Return the number of frames that ``abandon`` has removed; no other count has them."""
        return sum(job.frame.count for job in self._abandoned)

    def abandon(self) -> None:
        """
        Remove the queued frames, also later ones; those that are being written are finished.

        A handler of signals may call this in any function of the recorder.
        """
        self.is_abandoned = True
        self._abandoned += self._queue.clear()

    def close(self) -> None:
        """
        Write the queued frames, stop the threads and finish the files.

        No thread may encode while the interpreter ends, because that would abort the process.
        """
        if self.is_abandoned:
            self.abandon()
        self._queue.close()
        if self._threads:
            for thread in self._threads:
                thread.join()
            self._threads.clear()
            for job in self._abandoned:
                job.done(Unwritten('the recording was interrupted', 'not processed'))
            try:
                self._sink.close()
            except (OSError, ImageError) as err:
                self.is_unfinished = True
                self.log.error(f'the recording was not finished: {error_text(err)}')
            finally:
                self._update_counts()

    def _write_all(self) -> None:
        while (item := self._queue.get()) is not None:
            sequence, job = item
            prepared = self._prepare(job.frame)
            with self._ordering:
                self._out_of_order[sequence] = job, prepared
                while self._next_sequence in self._out_of_order:
                    self._finish(*self._out_of_order.pop(self._next_sequence))
                    self._next_sequence += 1

    def _prepare(self, frame: ReceivedFrame) -> P | Exception:
        """Prepare a frame on any thread; return an error, which is reported in order."""
        if self.is_full:
            return LimitReached('the recording has reached its limits')
        try:
            return self._sink.prepare(frame)
        except Exception as err:  # noqa: B902 - later frames wait for the turn of this one
            return err

    def _finish(self, job: _Job, prepared: P | Exception) -> None:
        """Commit a frame and count the outcome."""
        try:
            path = self._commit(job.frame, prepared)
        except LimitReached as err:
            self.counts.skipped += job.frame.count
            if not self.is_full:
                self.is_full, self.limit = True, str(err)
                self.log.info(f'Recording limit reached: {err}')
                self.on_full()
            job.done(Unwritten(str(err), 'skipped'))
        except KeyFrameNeeded as err:
            self.counts.left_out += job.frame.count
            self.log.warning(f'a frame was left out until the next key frame: {err}',
                             every=_LEFT_OUT_SECONDS, key='left out')
            job.done(Unwritten(str(err), 'skipped'))
        except Exception as err:  # noqa: B902 - as above
            self.counts.failed += job.frame.count
            self.is_unfinished |= not job.frame.count
            what = 'a frame was' if job.frame.count else 'messages of topics were'
            reason = f'{what} not written: {error_text(err)}'
            if isinstance(err, OSError):
                self._failure_log.write_failed(reason, job.frame.count)
            else:
                self._failure_log.bad_frame(reason)
            job.done(Unwritten(error_text(err), 'failed'))
        else:
            if not job.frame.count:
                self._failure_log.write_succeeded()
            job.done(path)
        finally:
            self._update_counts()

    def _update_counts(self) -> None:
        """Count the outcome of committed frames and log losses."""
        now, seen, counts = replace(self._sink.counts), self._seen, self.counts
        self._seen = now
        for _ in range(now.lost - seen.lost):
            self._failure_log.write_failed(f'a frame was not written: {now.reason}')
        if now.lost_others > seen.lost_others:
            self.is_unfinished = True
            self.log.error(f'{now.lost_others - seen.lost_others} messages of topics are lost: '
                           f'{now.reason}')
        if now.warning != seen.warning:
            self.log.warning(now.warning)
        if now.kept > seen.kept:
            self._failure_log.write_succeeded()
        counts.written += now.kept - seen.kept
        counts.failed += now.lost - seen.lost
        counts.skipped += now.skipped - seen.skipped

    def _commit(self, frame: ReceivedFrame, prepared: P | Exception) -> Path:
        if isinstance(prepared, Exception):
            raise prepared
        try:
            if self.is_full:
                raise LimitReached('the recording has reached its limits')
            return self._sink.commit(frame, prepared)
        except Exception:  # noqa: B902 - it is raised again
            prepared.discard()
            raise
