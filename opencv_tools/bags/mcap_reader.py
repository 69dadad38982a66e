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

"""Reader of MCAP files."""

from __future__ import annotations

from collections import deque
from collections.abc import Collection, Iterator
from functools import partial
import heapq
from itertools import chain, islice
import os
from pathlib import Path

from opencv_tools.bags.errors import BagError, check_mcap
from opencv_tools.bags.mcap_contents import read_contents, Span
from opencv_tools.bags.mcap_format import MAGIC, MESSAGE, MESSAGE_CODE
from opencv_tools.bags.mcap_records import file_reader, flat_records, message_head, Read
from opencv_tools.bags.reading import BagMessage, BagTopic, Damage, MAX_BYTES
from opencv_tools.image.text import MAX_PATH, printable
from opencv_tools.regular_files import open_regular

_MAX_SORTED = 100_000  # messages of a span
_ITEM_BYTES = 600  # memory of a sorted message without its data

_Item = tuple[int, 'BagMessage | Damage']  # with its time


class McapReader:
    """A bag in MCAP."""

    def __init__(self, path: Path) -> None:
        """
        Open a file and find its topics.

        A file without a valid index is read once from its begin to its end.

        :raises BagError: the file is no MCAP file, or the library ``mcap`` is missing.
        :raises OSError: the file cannot be read.
        """
        check_mcap()
        self._name = printable(path.name, MAX_PATH)
        self._file = open_regular(path)
        self._read = file_reader(self._file)
        try:
            if self._read(0, len(MAGIC)) != MAGIC:
                raise BagError(f'{self._name} is not an MCAP file')
            contents = read_contents(self._read, os.fstat(self._file).st_size)
        except BaseException:
            self.close()
            raise
        self._spans, self._channels = contents.spans, contents.channels
        self.first_ns, self.last_ns = contents.times or (0, 0)
        self.topics = dict.fromkeys(contents.channels.values(), 0)
        for channel, topic in contents.channels.items():
            self.topics[topic] += contents.counts[channel]
        self.warning = '' if contents.cut_at is None else (
            f'{self._name} has no end: it was cut off, is damaged or is still being written; it '
            f'is read up to byte {contents.cut_at}')

    def close(self) -> None:
        if self._file >= 0:
            os.close(self._file)
            self._file = -1

    def messages(self, topics: Collection[BagTopic]) -> Iterator[BagMessage | Damage]:
        wanted = {channel: topic for channel, topic in self._channels.items() if topic in topics}
        waiting = deque(sorted(self._spans, key=lambda span: (span.start_ns, span.begin)))
        # Parts of the file whose times overlap, by the time of their next message, and the sizes
        # of their chunks and sorted messages in memory.
        opened: list[tuple[int, int, BagMessage | Damage, Iterator[_Item], list[int]]] = []
        while waiting or opened:
            while waiting and (not opened or (waiting[0].start_ns <= opened[0][0] and sum(
                    chain.from_iterable(part[-1] for part in opened)) <= MAX_BYTES)):
                span, sizes = waiting.popleft(), list[int]()
                items = self._span_items(span, wanted, sizes)
                for time_ns, item in islice(items, 1):
                    heapq.heappush(opened, (time_ns, span.begin, item, items, sizes))
            if opened:
                _, begin, item, items, sizes = opened[0]
                yield item
                following = next(items, None)
                if following is None:
                    heapq.heappop(opened)
                else:
                    heapq.heapreplace(opened, (following[0], begin, following[1], items, sizes))

    def _span_items(
        self, span: Span, wanted: dict[int, BagTopic], sizes: list[int],
    ) -> Iterator[_Item]:
        """Yield the messages of a span in the order of their times, unless there are too many."""
        items = self._unsorted_items(span, wanted, sizes)
        ordered = sorted(islice(items, _MAX_SORTED), key=lambda item: item[0])
        sizes.append(len(ordered) * _ITEM_BYTES)
        yield from ordered
        yield from items

    def _unsorted_items(
        self, span: Span, wanted: dict[int, BagTopic], sizes: list[int],
    ) -> Iterator[_Item]:
        for read, found in flat_records(self._read, span.begin, span.end, sizes):
            if isinstance(found, Damage):
                yield span.start_ns, Damage(f'{self._name}: {found.reason}')
            elif found.opcode == MESSAGE_CODE:
                head = message_head(read, found)
                if head is not None and head.channel in wanted:
                    begin = found.begin + MESSAGE.size
                    load = partial(self._load, read, begin, found.end - begin)
                    yield head.log_ns, BagMessage(
                        wanted[head.channel], head.log_ns, load, head.publish_ns, head.sequence)

    def _load(self, read: Read, begin: int, size: int) -> memoryview:
        if size > MAX_BYTES:
            raise BagError(f'{self._name}: a message claims {size} bytes; more than {MAX_BYTES} '
                           'are not read')
        data = read(begin, size)
        if len(data) < size:
            raise BagError(f'{self._name} has become shorter')
        return data
