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

"""Topics that are recorded beside the frames, and batches of their messages."""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

from opencv_tools.bags.writing import BagChannel
from opencv_tools.recording.bag_file import MessageBatch, RecordedMessage
from opencv_tools.recording.naming import FrameMetadata
from opencv_tools.recording.recorder import OnDone, Unwritten
from opencv_tools.topics.message_reader import MessageReader
from opencv_tools.topics.order import FrameOrder
from rclpy.qos import QoSProfile

_BATCH_BYTES = 1 << 22


@dataclass(eq=False)
class RecordedTopic:
    """A topic that is recorded, and the account of its messages."""

    reader: MessageReader
    channel: BagChannel
    message_class: type
    qos: QoSProfile
    order: FrameOrder = field(default_factory=FrameOrder)
    publishers: frozenset[bytes] = frozenset()  # identifiers of those that are followed
    received: int = 0
    written: int = 0
    unwritten: Counter[str] = field(default_factory=Counter)  # by the kind of `Unwritten`

    def __str__(self) -> str:
        """Return the account: received = written + dropped + failed + not processed + skipped."""
        return (f'{self.channel.topic}: {self.received} messages received, {self.written} written'
                f'{self._unwritten("dropped", "failed")}, {self.order.count} lost in transit'
                + ('' if self.order.is_complete else ' since the first received message')
                + self._unwritten('not processed', 'skipped'))

    def _unwritten(self, *names: str) -> str:
        return ''.join(f', {count} {name}' for name in names if (count := self.unwritten[name]))


_Taken = tuple[RecordedTopic, RecordedMessage]


class MessageBatches:
    """Messages that are recorded together, in the order of their arrival."""

    def __init__(self, image_topic: str, put: Callable[[MessageBatch, OnDone], object]) -> None:
        """
        Create a collector without messages.

        :param image_topic: topic of the frames after remapping.
        :param put: records messages; may wait.
        """
        self._image_topic = image_topic
        self._put = put
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
