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

"""A bag of one or several files: its topics, and its messages in their order."""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Iterator, Sequence
from contextlib import closing
from pathlib import Path

from opencv_tools.bags.open_bag import bag_files, BagFiles, open_bag_file
from opencv_tools.bags.reading import BagMessage, BagReader, BagTopic, Damage
from opencv_tools.base.regular_files import natural_order
from opencv_tools.base.text import MAX_PATH, printable


class Bag:
    """
    A bag whose files are read one after the other.

    Their order is that of ``metadata.yaml``, or else the natural order of their names. The bag is
    used by one thread at a time.
    """

    def __init__(self, path: Path, files: Sequence[Path] = ()) -> None:
        """
        Find the topics of a bag.

        :param path: path of a file, or of a folder of rosbag2.
        :param files: files of the bag; empty for those of the path.
        :raises BagError: a file cannot be read as a bag.
        :raises OSError: a file cannot be read.
        """
        #: Name of the bag in messages.
        self.name = printable(path, MAX_PATH)
        found = BagFiles([*files]) if files else bag_files(path)
        #: Files of the bag, in their order.
        self.paths = found.paths if found.are_ordered else sorted(found.paths, key=natural_order)
        #: Sentences about parts of the bag that are missing.
        self.warnings = [found.warning] if found.warning else []
        #: Number of messages of each topic.
        self.topics: Counter[BagTopic] = Counter()
        times: list[int] = []
        for file in self.paths:
            with closing(open_bag_file(file)) as reader:
                self.topics.update(reader.topics)
                self.warnings += [reader.warning] if reader.warning else []
                times += [reader.first_ns, reader.last_ns] if any(reader.topics.values()) else []
        #: Times of the first and the last message, in nanoseconds; 0 for an empty bag.
        self.first_ns, self.last_ns = min(times, default=0), max(times, default=0)
        self._reader: BagReader | None = None

    def messages(self, topics: Collection[BagTopic]) -> Iterator[BagMessage | Damage]:
        """
        Yield the messages of some topics.

        :param topics: topics to read.
        :raises BagError: a file cannot be read as a bag.
        :raises OSError: a file cannot be read.
        """
        for file in self.paths:
            self._reader = open_bag_file(file)
            yield from self._reader.messages(topics)
            self.close()

    def close(self) -> None:
        """Close the file that is being read."""
        if self._reader is not None:
            self._reader.close()
            self._reader = None
