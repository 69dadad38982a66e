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

"""The messages that late subscribers would get, which each file of a recording begins with."""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Iterator
from itertools import chain
from typing import Generic, Protocol, TypeVar

from opencv_tools.bags.channels import kept_messages, MOST_KEPT
from opencv_tools.bags.writing import BagChannel
from opencv_tools.base.text import printable

_MOST_BYTES = 1 << 28


class Latched(Protocol):
    """A message of a channel from a publisher, whose identifier is b'' if unknown."""

    @property
    def channel(self) -> BagChannel: ...

    @property
    def publisher(self) -> bytes: ...

    @property
    def size(self) -> int: ...


M = TypeVar('M', bound=Latched)


class LatchedMessages(Generic[M]):
    """The last messages of each publisher; at most 100 of a topic, and 256 MB of all."""

    def __init__(self) -> None:
        #: Sentence about messages that exceed these limits; '' for none.
        self.warning = ''
        self._kept: dict[BagChannel, dict[bytes, deque[M]]] = {}
        self._bytes = 0

    def keep(self, message: M) -> None:
        """Keep a message instead of the oldest one of its publisher."""
        channel, publisher = message.channel, message.publisher
        depth = kept_messages(channel, is_one_publisher=bool(publisher))
        if not depth:
            return
        publishers = self._kept.setdefault(channel, {})
        own = publishers.pop(publisher, None) or deque[M]()
        publishers[publisher] = own  # the last one in the order of the publishers
        if len(own) >= depth:
            self._bytes -= own.popleft().size
        own.append(message)
        self._bytes += message.size
        while sum(map(len, publishers.values())) > MOST_KEPT or (
                publishers and self._bytes > _MOST_BYTES):
            self._remove_oldest(channel)

    def _remove_oldest(self, channel: BagChannel) -> None:
        publishers = self._kept[channel]
        oldest = next(iter(publishers))
        self._bytes -= publishers[oldest].popleft().size
        if not publishers[oldest]:
            del publishers[oldest]
        self.warning = (
            f'{printable(channel.topic)} has more latched messages than the {MOST_KEPT} of a '
            f'topic and {_MOST_BYTES >> 20} MB of all topics that are repeated; the next files '
            'begin without the oldest')

    def counts(self) -> Counter[str]:
        """Return the number of messages of each topic."""
        return Counter(message.channel.topic for message in self)

    def __iter__(self) -> Iterator[M]:
        """Yield the messages."""
        for publishers in self._kept.values():
            yield from chain.from_iterable(publishers.values())
