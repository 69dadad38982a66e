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

"""A recording of image topics in a bag, until a page or the disk ends it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from threading import Lock
import time
from typing import Any, NamedTuple

from opencv_tools.base.logs import Log
from opencv_tools.base.text import printable
from opencv_tools.image.errors import ImageError
from opencv_tools.nodes.conversion import BagMessages
from opencv_tools.recording.bag_sink import BagSink, RecordedMessage
from opencv_tools.recording.recorder import Recorder
from opencv_tools.recording.session import RecordingSession
from opencv_tools.topics.options import SubscriptionOptions
from opencv_tools.topics.queue import ReceivedMessage
from opencv_tools.topics.subscription import FrameSubscription
from rclpy.node import Node

# Frames of a topic that the middleware keeps while the executor is busy.
_DEPTH = 64
# Frames that stay in shared memory while they wait to be written; more are copied.
_MAX_VIEWS = 2

# Frames that wait for the disk, and their bytes. A frame that finds no room is dropped.
_MAX_FRAMES, _MAX_BYTES = 1000, 256 << 20
_SILENT_SECONDS = 3.0
_MAX_SILENT = 3  # topics whose reasons are shown


class Topic(NamedTuple):
    """
    An image topic to record.

    :param name: name of the topic, without the end of a transport.
    :param transport: transport as the pages receive it; ``auto`` prefers compressed images.
    """

    name: str
    transport: str


class RecordedImages:
    """Receive each frame of a topic, and the camera_info beside it, in the executor."""

    def __init__(
        self, node: Node, topic: Topic, log: Log,
        session: RecordingSession, on_message: Callable[[RecordedMessage], object],
    ) -> None:
        """
        Subscribe.

        :param session: records each frame, as it was received.
        :param on_message: called with each camera_info, as it was received.
        :raises ParameterError: the topic cannot be subscribed to.
        """
        self.heard_at = time.monotonic()  # time of the last frame, or of the beginning
        self.recorded_topic = topic.name
        self._session = session
        self._subscription = FrameSubscription(
            node, topic.name, log, self._receive, self._count_unreadable,
            SubscriptionOptions(transport=topic.transport, depth=_DEPTH, prefers_compressed=True,
                                decodes_video=False, max_views=_MAX_VIEWS))
        self._messages = BagMessages(node, self._subscription.topic_name, log, on_message)
        self._subscription.start()

    @property
    def lost(self) -> int:
        """Return the number of frames that were published, but did not arrive."""
        account = self._subscription.account
        return account.lost + account.skipped

    def explain_briefly(self) -> str:
        """Return the reason why no frame arrives, without the remedies, which the log has."""
        return self._subscription.explain_no_frames().partition('; ')[0]

    def close(self) -> None:
        """Record what was received until now, as far as there is room, and unsubscribe."""
        self._session.others.unprocessed += self._subscription.close(
            lambda: self._session.recorder.has_room)
        self._messages.close()

    def _receive(self, received: ReceivedMessage) -> None:
        try:
            frame = self._messages.frame(received, self._subscription.topic_name)
        except ImageError as err:
            self._count_unreadable(err)
            return
        self.heard_at, self.recorded_topic = time.monotonic(), frame.channel.topic
        self._session.record(frame)

    def _count_unreadable(self, _: ImageError) -> None:
        self._session.others.failed += 1
        self.heard_at = time.monotonic()


class BagRecording(RecordingSession):
    """Record the frames of topics in one bag. Nothing waits for the disk but a thread."""

    def __init__(self, sink: BagSink, log: Log,
                 on_full: Callable[[], object] = lambda: None) -> None:
        """
        Begin without topics.

        :param on_full: called in the thread when the disk has too little space.
        """
        super().__init__(
            Recorder(sink, log, _MAX_FRAMES, writers=1), on_full, max_bytes=_MAX_BYTES)
        self.since = time.time()
        self._began = time.monotonic()
        self._sink = sink
        self._topics: dict[str, RecordedImages] = {}
        sink.read_losses(self._losses)
        self._info_topics: dict[str, str] = {}  # image topic beside each camera_info
        self._finishing = Lock()
        self._seconds = -1.0  # after the end

    @property
    def names(self) -> list[str]:
        """Names of the topics."""
        return [*self._topics]

    def receive(self, node: Node, topics: Sequence[Topic]) -> None:
        """
        Begin to receive topics, in the executor.

        :param topics: topics, each once.
        :raises ParameterError: a topic cannot be subscribed to; none is received then.
        """
        try:
            for topic in topics:
                self._topics[topic.name] = RecordedImages(
                    node, topic, self.recorder.log, self, partial(self._add_info, topic.name))
        except Exception:
            self.stop()
            raise

    def stop(self) -> None:
        """Receive nothing any more, in the executor or after it."""
        if self._seconds < 0:
            self._seconds = time.monotonic() - self._began
            for topic in self._topics.values():
                topic.close()

    def finish(self) -> None:
        """Write the waiting frames, and finish the bag; may take long, on any thread."""
        with self._finishing:
            self.recorder.close()

    def account(self) -> dict[str, Any]:
        """Return what has become of the frames, for a page."""
        counts = self.counts
        seconds = time.monotonic() - self._began if self._seconds < 0 else self._seconds
        return {
            'topics': self.names, 'since': self.since, 'seconds': round(seconds, 1),
            'frames': counts.written, 'dropped': counts.dropped + counts.unprocessed,
            'lost': sum(topic.lost for topic in self._topics.values()),
            'failed': counts.failed, 'bytes': self.written_bytes, 'left': self._sink.left,
            'name': self.path.name if self.path else '', 'problem': self._describe_problem()}

    def _losses(self) -> dict[str, dict[str, int]]:
        """Return how many frames of each topic are in no bag; some counts are of all topics."""
        return {'all topics of images': self.counts.losses(), **{
            topic.recorded_topic: {'lost in transit': topic.lost}
            for topic in [*self._topics.values()]}}

    def _describe_problem(self) -> str:
        """Return what the user should know, as a sentence; '' for nothing."""
        recorder = self.recorder
        problem = recorder.limit or (
            f'a frame was not written: {printable(self.problem)}' if self.problem else '')
        if recorder.is_unfinished:
            return (f'the bag is not finished: {problem or "the log has the reason"}; the next '
                    'start of the node finishes it, if the disk has room')
        if problem:
            return problem
        if recorder.counts.failed and self._sink.counts.reason:
            return (f'{recorder.counts.failed} frames are not written: '
                    f'{printable(self._sink.counts.reason)}')
        now = time.monotonic()
        silent = [] if self._seconds >= 0 else [
            (name, topic) for name, topic in self._topics.items()
            if now - topic.heard_at > _SILENT_SECONDS]
        reasons = [f'no frames of {printable(name)}: {printable(topic.explain_briefly())}'
                   for name, topic in silent[:_MAX_SILENT]]
        others = len(silent) - len(reasons)
        return '; '.join(reasons) + (f'; and {others} more' if others else '')

    def _add_info(self, name: str, message: RecordedMessage) -> None:
        """Record a camera_info once, which is beside several topics of one camera."""
        if self._info_topics.setdefault(message.channel.topic, name) == name:
            self._sink.add_message(message)
