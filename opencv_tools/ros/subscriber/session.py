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

"""Recording of the selected or requested frames, until a limit is reached."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
import time

from opencv_tools.logs import Log
from opencv_tools.recording.frames import ReceivedFrame
from opencv_tools.recording.recorder import FrameCounts
from opencv_tools.recording.selection import Selection
from opencv_tools.ros.subscriber.parameters import limits, open_recorder, RecorderSettings
from opencv_tools.ros.subscriber.save_service import SaveRequests
from opencv_tools.ros.timers import create_steady_timer
from rclpy.node import Node

# Period of the checks for room in the queue.
_POLL_SECONDS = 0.001


class RecordingSession:
    """Select frames by the parameters or the calls of ``~/save``, and record them."""

    def __init__(
        self, node: Node, settings: RecorderSettings, log: Log, on_end: Callable[[], object],
    ) -> None:
        """
        Open the output folder.

        :param node: node of the timer and of the service.
        :param settings: values of the parameters.
        :param log: log for failures.
        :param on_end: called on any thread when the recording has reached a limit.
        :raises ParameterError: the parameters contradict each other.
        :raises RecordingError: the output folder cannot be used.
        """
        bounds = limits(settings)
        self.has_ended = False
        self._node = node
        self._on_end = on_end
        self._selection = Selection(settings.every_n, settings.max_rate, bounds)
        self.folder, self._recorder = open_recorder(settings, bounds, log, self._end)
        self.requests = SaveRequests(node) if settings.mode == 'on_request' else None
        self._queue_size = settings.queue_size
        self._skipped = self._put_count = 0

    @property
    def counts(self) -> FrameCounts:
        """Counts of the frames that were recorded, dropped, refused or skipped."""
        counts = self._recorder.counts
        return replace(counts, skipped=counts.skipped + self._skipped)

    @property
    def dropped(self) -> int:
        """Number of frames that were dropped because the queue was full."""
        return self._recorder.counts.dropped

    @property
    def is_unfinished(self) -> bool:
        """Return whether closing the files failed."""
        return self._recorder.is_unfinished

    def record(self, frame: ReceivedFrame) -> None:
        """Record a frame if it is selected or requested."""
        selection = self._selection
        if not selection.has_begun and selection.max_seconds:
            create_steady_timer(self._node, selection.max_seconds, self._end)
        if selection.is_late():
            self._skipped += 1
            self._end()
            return
        requests = self.requests.pop_all() if self.requests else []
        if not (requests if self.requests else selection.selects(frame)):
            self._skipped += 1
            return
        selection.count()
        self._put_count += 1
        on_done = partial(self.requests.complete, requests) if self.requests else None
        if not self._recorder.put(frame, on_done):
            selection.uncount()
        if selection.is_over:
            self._end()

    def wait_for_room(self, deadline: float) -> bool:
        """
        Wait until the queue has room for another frame.

        :param deadline: end of the wait, in seconds of the monotonic clock.
        :returns: False at the deadline, and after the end of the recording.
        """
        while time.monotonic() < deadline and not self.has_ended:
            counts = self._recorder.counts
            if self._put_count - counts.written - counts.dropped - counts.failed \
                    - counts.skipped < self._queue_size:
                return True
            time.sleep(_POLL_SECONDS)
        return False

    def close(self) -> None:
        """Write the queued frames, and refuse further requests."""
        self._recorder.close()
        if self.requests:
            self.requests.close()

    def _end(self) -> None:
        self.has_ended = True
        self._on_end()
