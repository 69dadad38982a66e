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

"""Recording of selected or requested frames until a limit, and the service ``~/save``."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path
import time

from opencv_tools.base.logs import Log
from opencv_tools.base.regular_files import user_path
from opencv_tools.base.text import MAX_PATH, printable
from opencv_tools.nodes.subscriber.parameters import RecorderSettings
from opencv_tools.recording.bag_sink import BagSink, MessageBatch
from opencv_tools.recording.errors import plain_reason, RecordingError, Unwritten
from opencv_tools.recording.frames import PacketFrame, ReceivedFrame
from opencv_tools.recording.image_encoder import EncoderSettings
from opencv_tools.recording.naming import FileNames
from opencv_tools.recording.open_sink import open_sink
from opencv_tools.recording.recorder import OnDone, Recorder
from opencv_tools.recording.selection import Selection
from opencv_tools.topics.timers import create_steady_timer
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.node import Node
from rclpy.qos import QoSProfile
from rclpy.task import Future
from std_srvs.srv import Trigger

_TIMEOUT_SECONDS = 3.0
_END_SECONDS = 5.0
# Number of calls that the middleware keeps; the default depth of ROS services is 10.
_DEPTH = 1000


class SaveRequests:
    """Reply to each call of ``~/save`` when the next frame is written or has failed."""

    def __init__(self, node: Node) -> None:
        self._node = node
        self._waiting: list[Future] = []
        self._unanswered = 0
        self._is_closed = False
        # In the group of the subscription, a waiting call would block the frames.
        self._service = node.create_service(
            Trigger, '~/save', self._save, qos_profile=QoSProfile(depth=_DEPTH),
            callback_group=ReentrantCallbackGroup())

    def pop_all(self) -> list[Future]:
        """Return and clear the requests for the present frame."""
        taken, self._waiting = self._waiting, []
        return taken

    def complete(self, requests: list[Future], outcome: Path | str) -> None:
        """
        Complete requests with the outcome of their frame; thread-safe.

        :param requests: requests for the frame.
        :param outcome: path of the frame, or the reason why it was not written.
        """
        for request in requests:
            request.set_result(outcome)
        executor = self._node.executor
        if executor:
            executor.wake()

    def close(self) -> None:
        """Refuse waiting and new calls, because the node is shutting down."""
        self._is_closed = True
        self.complete(self.pop_all(), 'the node is shutting down')
        deadline = time.monotonic() + _END_SECONDS
        executor = self._node.executor
        while executor and self._unanswered and time.monotonic() < deadline:
            executor.spin_once(timeout_sec=0.1)

    async def _save(
        self, _request: Trigger.Request, response: Trigger.Response,
    ) -> Trigger.Response:
        if self._is_closed:
            response.message = 'the node is shutting down'
            return response
        request = Future()
        self._waiting.append(request)
        self._unanswered += 1
        timer = create_steady_timer(
            self._node, _TIMEOUT_SECONDS, lambda: self._fail(request))
        outcome = await request
        self._node.destroy_timer(timer)
        response.success = isinstance(outcome, Path)
        response.message = (printable(outcome, MAX_PATH) if response.success
                            else plain_reason(str(outcome)))
        self._unanswered -= 1
        return response

    def _fail(self, request: Future) -> None:
        """Fail a request that timed out. An older frame would not show the current scene."""
        if request in self._waiting:
            self._waiting.remove(request)
            request.set_result(f'no frame arrived within {_TIMEOUT_SECONDS:g} s')


# Period of the checks for room in the queue.
_POLL_SECONDS = 0.001


class RecordingSession:
    """Select frames by the parameters or the calls of ``~/save``, and record them."""

    def __init__(
        self, node: Node, settings: RecorderSettings, log: Log, on_end: Callable[[], object],
    ) -> None:
        """
        Open the output folder.

        :param on_end: called on any thread when the recording has reached a limit.
        :raises RecordingError: the output folder cannot be used.
        """
        self.skipped = 0  # frames that were not selected
        self.left_out = 0  # packets of video before the first key frame
        self._node = node
        self._on_end = on_end
        self._has_ended = False
        self._is_abandoned = False
        limits = settings.limits
        self._selection = Selection(settings.every_n, settings.max_rate, limits)
        self.folder = _absolute_path(settings.output_dir)
        names = FileNames(settings.file_name)
        encoder = EncoderSettings(
            names.suffix, to_color=settings.convert == 'auto', jpeg_quality=settings.jpeg_quality,
            png_compression=settings.png_compression, crf=settings.crf)
        sink = open_sink(self.folder, names, encoder, settings.on_exists, limits, settings.sync)
        self.recorder = Recorder(
            sink, log, settings.queue_size, settings.writers, settings.on_overflow == 'block',
            self._end)
        #: Sink of a bag, which also takes other messages; None for other formats.
        self.bag_sink = sink if isinstance(sink, BagSink) else None
        self.requests = SaveRequests(node) if settings.mode == 'on_request' else None

    def record(self, frame: ReceivedFrame) -> None:
        """Record a frame if it is selected or requested."""
        selection = self._selection
        if isinstance(frame, PacketFrame) and not (selection.has_begun or frame.packet.is_key):
            self.left_out += 1
            return
        if self._has_ended or self._is_late():
            self.skipped += 1
            return
        requests = self.requests.pop_all() if self.requests else []
        if not (requests if self.requests else selection.selects(frame)):
            self.skipped += 1
            return
        on_done = partial(self.requests.complete, requests) if self.requests else None
        self.recorder.put(frame, on_done)
        selection.count()
        if selection.is_over:
            self._end()

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
        :returns: False at the deadline, after ``abandon``, and after the end of the recording.
        """
        while time.monotonic() < deadline and not (self._has_ended or self._is_abandoned):
            if self.recorder.has_room:
                return True
            time.sleep(_POLL_SECONDS)
        return False

    def abandon(self) -> None:
        """Leave the frames that wait; a handler of signals may call this."""
        self._is_abandoned = True
        self.recorder.abandon()

    def close(self) -> None:
        """Write the queued frames, and refuse further requests."""
        if self._is_abandoned:
            self.recorder.abandon()
        self.recorder.close()
        if self.requests:
            self.requests.close()

    def _is_late(self) -> bool:
        """Begin with the first call, and end after the maximum duration."""
        selection = self._selection
        if not selection.has_begun and selection.max_seconds:
            create_steady_timer(self._node, selection.max_seconds, self._end)
        if not selection.is_late():
            return False
        self._end()
        return True

    def _end(self) -> None:
        self._has_ended = True
        self._on_end()


def _absolute_path(text: str) -> Path:
    """Return the path of the output folder, unless it is relative to a removed folder."""
    path = user_path(text)
    if text.startswith('~') and path.parts[0].startswith('~'):
        raise RecordingError(
            f'output_dir {text} cannot be used: there is no user {path.parts[0][1:]}; write '
            f'./{text} for a folder of this name')
    try:
        return path.absolute()
    except FileNotFoundError as err:
        raise RecordingError(
            f'output_dir {text} cannot be used: the working directory was removed; set output_dir '
            'to an absolute path') from err
