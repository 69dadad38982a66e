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
from opencv_tools.recording.bag_sink import BagSink
from opencv_tools.recording.errors import plain_reason, RecordingError
from opencv_tools.recording.frames import ReceivedFrame
from opencv_tools.recording.image_encoder import EncoderSettings
from opencv_tools.recording.naming import FileNames
from opencv_tools.recording.open_sink import open_sink
from opencv_tools.recording.recorder import OnDone, Recorder
from opencv_tools.recording.selection import Selection
from opencv_tools.recording.session import RecordingSession
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


class SubscriberSession(RecordingSession):
    """The session of a node, with its parameters, and the calls of ``~/save``."""

    def __init__(
        self, node: Node, settings: RecorderSettings, log: Log, on_end: Callable[[], object],
    ) -> None:
        """
        Open the output folder.

        :param on_end: called on any thread when the recording has reached a limit.
        :raises RecordingError: the output folder cannot be used.
        """
        limits = settings.limits
        self._node = node
        self.folder = _absolute_path(settings.output_dir)
        names = FileNames(settings.file_name)
        encoder = EncoderSettings(
            names.suffix, to_color=settings.convert == 'auto', jpeg_quality=settings.jpeg_quality,
            png_compression=settings.png_compression, crf=settings.crf,
            lossy=settings.lossy, limits=settings.range, colors=settings.colors)
        sink = open_sink(self.folder, names, encoder, settings.on_exists, limits, settings.sync)
        super().__init__(
            Recorder(sink, log, settings.queue_size, settings.writers,
                     settings.on_overflow == 'block'),
            on_end, Selection(settings.every_n, settings.max_rate, limits))
        #: Sink of a bag, which also takes other messages; None for other formats.
        self.bag_sink = sink if isinstance(sink, BagSink) else None
        self.requests = SaveRequests(node) if settings.mode == 'on_request' else None

    def begin(self) -> None:
        """End after the maximum duration, whether a frame arrives then or not."""
        if self._selection.max_seconds:
            create_steady_timer(self._node, self._selection.max_seconds, self._end)

    def select(self, frame: ReceivedFrame) -> OnDone | None:
        """Select a frame by the calls of ``~/save``, if the node has this service."""
        if not self.requests:
            return super().select(frame)
        requests = self.requests.pop_all()
        return partial(self.requests.complete, requests) if requests else None

    def close(self) -> None:
        """Write the queued frames, and refuse further requests."""
        self.recorder.close()
        if self.requests:
            self.requests.close()


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
