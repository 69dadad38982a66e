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

"""Batches of the messages of topics that are recorded beside the frames."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from pathlib import Path
import time

from opencv_tools.image.errors import CdrError
from opencv_tools.logs import Log
from opencv_tools.nodes.subscriber.recorded_topic import RecordedTopic
from opencv_tools.recording.bag_file import MessageBatch, RecordedMessage
from opencv_tools.recording.errors import Unwritten
from opencv_tools.recording.naming import FrameMetadata
from opencv_tools.recording.recorder import OnDone
from opencv_tools.topics.order import Position
from opencv_tools.topics.ros_errors import ros_reason

_BATCH_BYTES = 1 << 22
_MAX_TAKEN = 1000  # messages of a topic before the next topic has its turn
_WARNING_SECONDS = 10.0


_Taken = tuple[RecordedTopic, RecordedMessage]


class MessageBatches:
    """Messages that are recorded together, in the order of their arrival."""

    def __init__(
        self, image_topic: str, put: Callable[[MessageBatch, OnDone], object], log: Log,
    ) -> None:
        """
        Create a collector without messages.

        :param image_topic: topic of the frames after remapping.
        :param put: records messages; may wait.
        """
        self._image_topic = image_topic
        self._put = put
        self._log = log
        self._taken: list[_Taken] = []
        self._bytes = 0
        self._finished: deque[tuple[list[_Taken], MessageBatch, Path | Unwritten]] = deque()

    def add(self, topic: RecordedTopic, message: RecordedMessage) -> None:
        """Add a message, and record the batch if it is large."""
        self._taken.append((topic, message))
        self._bytes += message.size
        if self._bytes >= _BATCH_BYTES:
            self.flush()

    def flush(self) -> None:
        """Record the messages that were added."""
        if not self._taken:
            return
        taken = sorted(self._taken, key=lambda item: item[1].log_ns)
        self._taken, self._bytes = [], 0
        first = taken[0][1].log_ns
        batch = MessageBatch(
            metadata=FrameMetadata(first, '', '', self._image_topic), receive_ns=first,
            messages=tuple(message for _, message in taken))
        self._put(batch, lambda outcome: self._finished.append((taken, batch, outcome)))

    def count_finished(self) -> None:
        """Count the messages of batches that were written or have failed."""
        while self._finished:
            taken, batch, outcome = self._finished.popleft()
            for topic, _ in taken[:batch.result.written]:
                topic.written += 1
            if isinstance(outcome, Unwritten):
                for topic, _ in taken[batch.result.written:]:
                    topic.unwritten[outcome.kind] += 1

    def take_all(self, topic: RecordedTopic) -> None:
        """Take and add the messages of a topic that have arrived."""
        for _ in range(_MAX_TAKEN):
            if not self._take(topic):
                break

    def _take(self, topic: RecordedTopic) -> bool:
        """Take a message; return whether there was one."""
        try:
            taken = topic.reader.take_serialized()
        except RuntimeError as err:
            self._log.error(f'a message of {topic.channel.topic} cannot be received: '
                            f'{ros_reason(err)}', every=_WARNING_SECONDS,
                            key=topic.channel.topic)
            return False
        if taken is None:
            return False
        data, info = taken
        try:
            if not topic.order.accepts(
                    bytes(info.publisher), Position(info.number), info.source_timestamp):
                return True  # a latched message comes again after a new subscription
        except CdrError as err:
            self._log.warning(f'{topic.channel.topic}: {err}', every=_WARNING_SECONDS,
                              key=topic.channel.topic)
        topic.received += 1
        log_ns = info.received_timestamp or time.time_ns()
        self.add(topic, RecordedMessage(
            channel=topic.channel, parts=(data,), log_ns=log_ns,
            publish_ns=info.source_timestamp or log_ns, number=info.number))
        return True
