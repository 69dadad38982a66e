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

"""The other topics of a bag that becomes another bag, copied between its frames."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from contextlib import suppress
from fnmatch import fnmatchcase
from itertools import chain
from pathlib import Path
from typing import Any

from opencv_tools.bags.channels import channel_of, kept_messages
from opencv_tools.bags.compression import decompressed_message
from opencv_tools.bags.errors import BagError
from opencv_tools.bags.open_bag import Bag
from opencv_tools.bags.reading import BagMessage, BagTopic, CDR
from opencv_tools.base.text import enumerated, printable
from opencv_tools.capture.bag import BagSource
from opencv_tools.recording.bag_sink import MessageBatch, RecordedMessage
from opencv_tools.recording.naming import FrameMetadata
from opencv_tools.recording.recorder import Recorder

_BATCH, _BATCH_BYTES = 1000, 1 << 20
_MOST_NAMED = 20


def check_patterns(source: BagSource, patterns: Sequence[str]) -> None:
    """
    Check that a bag has the topics that are chosen.

    :raises ValueError: a name or pattern matches none.
    """
    names = sorted({topic.name for topic in source.topics})
    missing = [one for one in patterns if one and not any(fnmatchcase(name, one)
                                                          for name in names)]
    if missing:
        raise ValueError(f"--topics has '{printable(missing[0])}', but the bag has no such topic; "
                         f'it has {enumerated([*map(printable, names)], _MOST_NAMED)}')


class OtherTopics:
    """The messages of all topics of a bag but that of its frames."""

    def __init__(self, source: BagSource, patterns: Sequence[str], recorder: Recorder[Any],
                 ) -> None:
        """
        Choose the topics.

        :param patterns: names of topics; ``*`` stands for any characters.
        """
        self._counts = Counter({topic: count for topic, count in source.topics.items()
                                if topic != source.topic and count})
        self._channels = {topic: channel_of(topic) for topic in self._counts
                          if topic.serialization == CDR and any(
                              fnmatchcase(topic.name, one) for one in patterns)}
        self._attachments = source.attachments
        self._recorder = recorder
        bag = Bag(Path(source.name), source.paths)
        items = (item for item in bag.messages(self._channels.keys())
                 if isinstance(item, BagMessage))
        self._bag, self._rest = bag, chain(items)
        self._written: Counter[BagTopic] = Counter()
        self._outside: Counter[BagTopic] = Counter()
        self._batches: list[tuple[MessageBatch, list[BagTopic]]] = []

    def copy(self, metadata: FrameMetadata, begin_ns: int, end_ns: int) -> None:
        """
        Copy the messages up to a time.

        :param metadata: description of the frame that follows.
        :param begin_ns: time before which only latched messages are copied.
        """
        taken: list[tuple[BagTopic, RecordedMessage]] = []
        size = 0
        for item in self._rest:
            if item.log_ns > end_ns:
                self._rest = chain([item], self._rest)
                break
            if item.log_ns < begin_ns and not kept_messages(item.topic):
                self._outside[item.topic] += 1
                continue
            with suppress(BagError, OSError):  # the account has those that fail
                data = decompressed_message(item.load())
                taken.append((item.topic, RecordedMessage(
                    channel=self._channels[item.topic], parts=(data,), log_ns=item.log_ns,
                    publish_ns=item.publish_ns or item.log_ns, number=item.number)))
                size += taken[-1][1].size
            if len(taken) == _BATCH or size >= _BATCH_BYTES:
                self._put(metadata, taken)
                taken, size = [], 0
        if taken:
            self._put(metadata, taken)

    def _put(self, metadata: FrameMetadata, taken: list[tuple[BagTopic, RecordedMessage]],
             ) -> None:
        first_ns = taken[0][1].log_ns
        batch = MessageBatch(metadata=metadata, receive_ns=first_ns, arrival_ns=first_ns,
                             messages=tuple(message for _, message in taken))
        topics = [topic for topic, _ in taken]

        def count(outcome: object) -> None:
            self._written.update(topics[:batch.result.written])

        self._recorder.put(batch, count)

    def close(self) -> None:
        """Count the messages that are not copied, because they follow the last frame."""
        self._outside.update(item.topic for item in self._rest)
        self._bag.close()

    @property
    def failed(self) -> int:
        """Return the number of messages of the chosen topics that were not written."""
        return sum(self._counts[topic] - self._written[topic] - self._outside[topic]
                   for topic in self._channels)

    @property
    def account(self) -> list[str]:
        """Sentences about the messages that were copied, and about those that were not."""
        rest = {f'{printable(topic.name)} ({count - self._written[topic]} of {count})'
                for topic, count in self._counts.items() if count > self._written[topic]}
        copied = sum(map(bool, self._written.values()))
        return [f'Copied {self._written.total()} messages of {copied} other topics, '
                f'{self.failed} failed'] * bool(self._channels) + [
            f'left out, with numbers of messages: {enumerated(sorted(rest), _MOST_NAMED)}'
        ] * bool(rest) + [
            f'left out: {self._attachments} attachments of the bag'] * bool(self._attachments)
