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

"""Frames to files: a queue, a few threads that write, and files that are whole or not there."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
import os
from pathlib import Path
from queue import Full, Queue
from threading import Lock, Thread
from typing import Any

from numpy.typing import NDArray
from opencv_tools.recording.naming import FileNames
from opencv_tools.recording.writers import encode_frame

QUEUE_SIZE = 64  # frames
_MAX_WRITERS = 4


class RecordingError(Exception):
    """A folder that cannot be recorded to; the message says why."""


@dataclass(frozen=True)
class _Job:
    seq: int
    image: NDArray[Any]
    encoding: str


class Recorder:
    """Write each frame to a numbered file, beside the thread that hands it over."""

    def __init__(
        self, folder: Path, names: FileNames, on_failure: Callable[[str], None],
        queue_size: int = QUEUE_SIZE,
    ) -> None:
        """
        Make the folder when it is missing, and start the threads.

        :param folder: where the files go; numbering goes on after those that are there.
        :param names: names of the files; the extension is the format.
        :param on_failure: told, on a thread of the recorder, why a frame was not written.
        :param queue_size: frames that may wait to be written; more are dropped.
        :raises RecordingError: the folder cannot be made or written to.
        """
        self.written = 0
        self.dropped = 0
        self.failed = 0
        self._folder = folder
        self._names = names
        self._on_failure = on_failure
        self._next_seq = names.next_seq(_prepare(folder))
        self._queue: Queue[_Job | None] = Queue(queue_size)
        self._counting = Lock()
        self._threads = [Thread(target=self._write_all, name=f'writer-{index}', daemon=True)
                         for index in range(min(_MAX_WRITERS, os.cpu_count() or 1))]
        for thread in self._threads:
            thread.start()

    def put(self, image: NDArray[Any], encoding: str) -> bool:
        """
        Hand a frame over to be written.

        :param image: (h, w) or (h, w, c) array that nobody writes to any more.
        :param encoding: its sensor_msgs/Image encoding.
        :returns: False when the queue is full and the frame was dropped.
        """
        try:
            self._queue.put_nowait(_Job(self._next_seq, image, encoding))
        except Full:
            self.dropped += 1
            return False
        self._next_seq += 1
        return True

    def close(self) -> None:
        """Write what waits in the queue, and end the threads."""
        for _ in self._threads:
            self._queue.put(None)
        for thread in self._threads:
            thread.join()
        self._threads.clear()

    def _write_all(self) -> None:
        for job in iter(self._queue.get, None):
            try:
                self._write(job)
            except (OSError, ValueError) as err:
                with self._counting:
                    self.failed += 1
                self._on_failure(f'frame {job.seq} was not written: {err}')
            else:
                with self._counting:
                    self.written += 1

    def _write(self, job: _Job) -> None:
        """Write a file under a temporary name and rename it, so that it is whole or not there."""
        path = self._folder / self._names.name(job.seq)
        content = encode_frame(job.image, job.encoding, self._names.suffix)
        temporary = path.with_name(f'.{path.name}.{os.getpid()}.part')
        try:
            temporary.write_bytes(content)
            temporary.replace(path)
        except OSError:
            temporary.unlink(missing_ok=True)
            raise


def _prepare(folder: Path) -> list[str]:
    """
    Make a folder ready to be written to.

    :returns: the names of what is in it.
    :raises RecordingError: it cannot be made, read or written to.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        names = [path.name for path in folder.iterdir()]
    except OSError as err:
        raise RecordingError(f'output_dir {folder} cannot be used: {err.strerror}') from err
    if not os.access(folder, os.W_OK | os.X_OK):
        raise RecordingError(f'output_dir {folder} cannot be written to: no permission')
    return names
