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

"""A session of a recording: the frames that it takes until a limit, and their account."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path
from threading import Lock
import time
from typing import Any

from opencv_tools.recording.bag_sink import MessageBatch
from opencv_tools.recording.errors import Unwritten
from opencv_tools.recording.frames import PacketFrame, ReceivedFrame
from opencv_tools.recording.recorder import FrameCounts, OnDone, Recorder
from opencv_tools.recording.selection import Limits, Selection

# Period of the checks for room in the queue.
_POLL_SECONDS = 0.001


class RecordingSession:
    """Record frames until a limit of their number, their size or their time."""

    def __init__(
        self, recorder: Recorder[Any], on_end: Callable[[], object],
        selection: Selection | None = None, max_bytes: int = 0,
    ) -> None:
        """
        Begin without frames.

        :param recorder: recorder without frames, which its owner closes.
        :param on_end: called on any thread when the recording has reached a limit.
        :param selection: frames to record, and their limits; None for all frames.
        :param max_bytes: maximum size of the frames that wait for the disk; 0 means no limit.
        """
        self.recorder = recorder
        recorder.on_full = self._end
        #: Counts of the frames that have not reached the recorder.
        self.others = FrameCounts()
        #: File with the newest frame; None before the first one.
        self.path: Path | None = None
        #: Why the newest frame was not written; '' if it was.
        self.problem = ''
        self.written_bytes = 0
        self._selection = selection or Selection(1, 0.0, Limits())
        self._on_end = on_end
        self._max_bytes = max_bytes
        self._waiting_bytes = 0
        self._has_ended = False
        self._lock = Lock()

    @property
    def counts(self) -> FrameCounts:
        """Return what has become of the received frames; no count has those that wait."""
        return self.recorder.counts + self.others + FrameCounts(
            unprocessed=self.recorder.abandoned)

    def record(self, frame: ReceivedFrame) -> bool:
        """
        Record a frame if it is selected, and there is room for it.

        :returns: whether the frame is put into the queue, and no other frame was dropped.
        """
        selection = self._selection
        if isinstance(frame, PacketFrame) and not (selection.has_begun or frame.packet.is_key):
            self.others.left_out += 1
            return False
        on_done = None if self._has_ended or self._is_late() else self.select(frame)
        if not on_done:
            self.others.skipped += 1
            return False
        is_put = self._claim_room(frame.size) and self.recorder.put(
            frame, partial(self._note_done, frame.size, on_done))
        selection.count()
        if selection.is_over:
            self._end()
        return is_put

    def record_messages(self, batch: MessageBatch, on_done: OnDone) -> None:
        """Record messages of other topics, until the maximum duration; thread-safe."""
        if self._is_late():
            on_done(Unwritten('the recording has reached its limits', 'skipped'))
        else:
            self.recorder.put(batch, on_done)

    def wait_for_room(self, deadline: float) -> bool:
        """
        Wait until the queue has room for another frame.

        :param deadline: end of the wait, in seconds of the monotonic clock.
        :returns: False at the deadline, after the end, and after ``Recorder.abandon``.
        """
        while time.monotonic() < deadline and not (
                self._has_ended or self.recorder.is_abandoned):
            if self.recorder.has_room:
                return True
            time.sleep(_POLL_SECONDS)
        return False

    def begin(self) -> None:
        """Begin with the first frame or batch of messages."""

    def select(self, frame: ReceivedFrame) -> OnDone | None:
        """Return what to call with the outcome of a frame; None if it is not selected."""
        return (lambda _: None) if self._selection.selects(frame) else None

    def _is_late(self) -> bool:
        """Begin with the first call, and end after the maximum duration."""
        if not self._selection.has_begun:
            self.begin()
        if not self._selection.is_late():
            return False
        self._end()
        return True

    def _end(self) -> None:
        self._has_ended = True
        self._on_end()

    def _claim_room(self, size: int) -> bool:
        """Count the bytes of a frame, or drop it if too many wait."""
        with self._lock:
            has_room = not 0 < self._max_bytes < self._waiting_bytes + size
            if has_room or not self._waiting_bytes:
                self._waiting_bytes += size
                return True
            self.others.dropped += 1
        self.recorder.log.warning(
            f'{self.others.dropped} frames dropped: they arrive faster than they are written, and '
            f'{self._max_bytes >> 20} MB wait for the disk', every=1.0, key='dropped by size')
        return False

    def _note_done(self, size: int, on_done: OnDone, outcome: Path | Unwritten) -> None:
        """Count what has become of a frame; called on any thread."""
        with self._lock:
            self._waiting_bytes -= size
            if not isinstance(outcome, Unwritten):
                self.written_bytes += size
                self.path, self.problem = outcome, ''
            elif outcome.kind == 'failed':
                self.problem = outcome
        on_done(outcome)
