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

"""
A bag of one or several files: its topics, and its messages in their order.

A folder of rosbag2 has its files in the order of ``metadata.yaml``.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Iterator, Sequence
from contextlib import closing, suppress
from dataclasses import dataclass
from itertools import islice, pairwise
import os
from pathlib import Path
import re
from tempfile import TemporaryDirectory
from typing import NamedTuple

from opencv_tools.bags.account import has_account, recording_of
from opencv_tools.bags.compression import unpack_file
from opencv_tools.bags.db3_reader import Db3Reader
from opencv_tools.bags.errors import BagError
from opencv_tools.bags.mcap_reader import McapReader
from opencv_tools.bags.reading import BagMessage, BagReader, BagTopic, Damage
from opencv_tools.base.regular_files import natural_order, open_regular
from opencv_tools.base.remedies import installation
from opencv_tools.base.text import MAX_PATH, printable
from opencv_tools.base.units import NANO

__all__ = ['BAG_SUFFIXES', 'bag_files', 'BagFiles', 'is_bag', 'open_bag_file', 'read_file_names',
           'recordings']

#: Extensions of bags.
BAG_SUFFIXES = ('.mcap', '.db3')
_METADATA = 'metadata.yaml'
_NUMBERED = re.compile(r'(.*?)([0-9]{1,18})(\D*)')
# Longest time between two files of a recording. Messages of two topics may overlap.
_PAUSE_NS, _OVERLAP_NS = NANO, NANO // 2
_ROS1_SUFFIX = '.bag'
_KEY = 'relative_file_paths'
_KEY_DEPTH = 2  # mappings around the key
_MAX_BYTES = 1 << 20
_MAX_DEPTH = 32  # collections around a value; rosbag2 writes six
_MAX_EVENTS = 20_000  # about 1500 topics
# A directive begins a line. PyYAML compares each with all others within one event.
_DIRECTIVE = re.compile('(?:^|[\n\r\x85\u2028\u2029])\ufeff*%')


def read_file_names(path: Path) -> list[str]:
    """
    Read the names of the files of a bag, in their order.

    The file is read as a stream of events. Aliases are not expanded and no objects are created,
    so time and memory are bounded.

    :param path: path of ``metadata.yaml``.
    :returns: names of files, without folders.
    :raises BagError: the file is not YAML, has directives or no names or is too long, or PyYAML
        is missing.
    :raises OSError: the file cannot be read.
    """
    try:
        import yaml
    except ImportError as err:
        raise BagError(f'PyYAML cannot be imported ({err}); install it with pip') from err
    with os.fdopen(open_regular(path), 'rb') as file:
        content = file.read(_MAX_BYTES).decode(errors='replace')
    if _DIRECTIVE.search(content):
        raise BagError('it has directives of YAML, which rosbag2 does not write')
    depth, is_key = 0, False
    names: list[str] | None = None
    try:
        events = yaml.parse(content, getattr(yaml, 'CSafeLoader', yaml.SafeLoader))
        for event in islice(events, _MAX_EVENTS):
            if isinstance(event, yaml.CollectionEndEvent):
                if names is not None:
                    return names
                depth -= 1
            elif isinstance(event, yaml.CollectionStartEvent):
                names = [] if is_key and isinstance(event, yaml.SequenceStartEvent) else names
                depth += 1
                if depth > _MAX_DEPTH:
                    break
            elif names is not None and isinstance(event, yaml.ScalarEvent):
                names.append(Path(event.value).name)
            is_key = (depth == _KEY_DEPTH and isinstance(event, yaml.ScalarEvent)
                      and event.value == _KEY)
    except (yaml.YAMLError, ValueError) as err:
        raise BagError(f'it is not YAML: {printable(err)}') from err
    raise BagError(f'it has no {_KEY} in its first {_MAX_BYTES} bytes')


def is_bag(path: Path) -> bool:
    """Return whether a path is that of a bag: a file by its extension, or a folder of rosbag2."""
    if path.suffix.lower() in (*BAG_SUFFIXES, _ROS1_SUFFIX) or _is_packed(path):
        return not path.is_dir()
    return (path / _METADATA).is_file()


def _is_packed(path: Path) -> bool:
    """Return whether a path is that of a bag that rosbag2 has packed as a file."""
    return path.suffix.lower() in ('.zstd', '.zst') and Path(path.stem).suffix.lower() in (
        BAG_SUFFIXES)


def _unpacked_name(path: Path) -> str:
    return path.stem if _is_packed(path) else path.name


@dataclass(frozen=True)
class BagFiles:
    """
    The files of a bag.

    :param are_ordered: whether ``metadata.yaml`` has this order; otherwise the names have it.
    :param warning: why the metadata are not used, or which files they do not name; '' for neither.
    """

    paths: list[Path]
    are_ordered: bool = False
    warning: str = ''


def bag_files(path: Path) -> BagFiles:
    """
    Return the files of a bag.

    :param path: path of a file, or of a folder with ``metadata.yaml``.
    :returns: the file itself, or the bags in the folder.
    :raises BagError: there is no file that can be read.
    :raises OSError: the folder cannot be read.
    """
    shown = printable(path, MAX_PATH)
    if path.suffix.lower() == _ROS1_SUFFIX:
        raise BagError(f"{shown} is a bag of ROS 1; convert it with 'rosbags-convert --src "
                       f"{shown} --dst FOLDER' of rosbags; {installation('rosbags')}")
    if not path.is_dir():
        return BagFiles([path])
    # The name of a packed file is that of its content, which may be there as well.
    files = {_unpacked_name(file): file for file in sorted(
        path.iterdir(), key=_is_packed, reverse=True) if not file.name.startswith('.') and (
            _is_packed(file) or file.suffix.lower() in BAG_SUFFIXES)}
    if not files:
        raise BagError(f'{shown} has no file with the extension {" or ".join(BAG_SUFFIXES)}')
    return _in_order(path / _METADATA, files)


def _in_order(metadata: Path, files: dict[str, Path]) -> BagFiles:
    """Return files by name in the order of the metadata, if these can be used."""
    try:
        names = [_unpacked_name(Path(name)) for name in read_file_names(metadata)]
        for name, count in Counter(names).items():
            if name not in files or count > 1:
                raise BagError(f'it names {printable(name)} ' + (
                    f'{count} times' if name in files else 'which is not in the folder'))
        if not names:
            raise BagError('it names no files')
    except (BagError, OSError) as err:
        reason = err.strerror if isinstance(err, OSError) else err
        return BagFiles([*files.values()], warning=(
            f'{printable(metadata, MAX_PATH)} is not used: {reason}; the files are read in the '
            'order of their names'))
    others = sorted(files.keys() - set(names))
    return BagFiles([files[name] for name in names], True, (
        f'{printable(metadata, MAX_PATH)} does not name {len(others)} files of its folder, which '
        f'are not read, such as {printable(others[0])}') if others else '')


class _Part(NamedTuple):
    """
    A file of a bag, as far as it matters which one is the next of its recording.

    :param recording: identifier of the recording; '' if the file has none.
    :param topics: topics with messages.
    """

    path: Path
    recording: str
    first_ns: int
    last_ns: int
    topics: frozenset[BagTopic]

    def precedes(self, after: _Part) -> bool:
        """
        Return whether another file is the next one of the same recording.

        Both have its identifier. If one has none, the name has the next number, both have a topic,
        and the other file begins when this one ends.
        """
        if self.path.parent != after.path.parent or not (
                self.first_ns < after.first_ns and self.last_ns < after.last_ns
                and after.first_ns - self.last_ns >= -_OVERLAP_NS):
            return False
        if self.recording or after.recording:
            return self.recording == after.recording
        one, two = _number(self.path), _number(after.path)
        return bool(one and two and self.topics & after.topics
                    and one == (*two[:2], two[2] - 1)
                    and after.first_ns - self.last_ns <= _PAUSE_NS)


def _number(path: Path) -> tuple[str, str, int] | None:
    """Return the name of a file before and after its last number, and the number."""
    found = _NUMBERED.fullmatch(Path(_unpacked_name(path)).stem)
    return (found[1], found[3], int(found[2])) if found else None


def _part(path: Path, reader: BagReader) -> _Part:
    return _Part(path, recording_of(reader.metadata), reader.first_ns, reader.last_ns,
                 frozenset(topic for topic, count in reader.topics.items() if count))


def _order_problems(parts: Sequence[_Part]) -> Iterator[str]:
    """Yield a sentence for each file that does not follow the one before, of one recording."""
    for part, after in pairwise(parts):
        if not part.recording or part.recording != after.recording:
            continue
        one, two = printable(part.path.name), printable(after.path.name)
        if part.topics and after.topics and after.first_ns < part.first_ns:
            yield (f'{two} is read after {one}, but begins '
                   f'{(part.first_ns - after.first_ns) / NANO:.3f} s before it')
        count = _missing_files(part, after)
        if count:
            yield (f'{count} {"file is" if count == 1 else "files are"} missing between {one} '
                   f'and {two}')


def _missing_files(part: _Part, after: _Part) -> int:
    """Return how many numbers between two files have no file of another recording."""
    one, two = _number(part.path), _number(after.path)
    if not one or not two or one[:2] != two[:2] or part.path.parent != after.path.parent:
        return 0
    between = range(one[2] + 1, two[2])
    others = {found[2] for path in (part.path.parent.iterdir() if between else ())
              if (found := _number(path)) and found[:2] == one[:2] and found[2] in between
              and _is_of_another(path, part.recording)}
    return len(between) - len(others)


def _is_of_another(path: Path, recording: str) -> bool:
    """Return whether a file can be read, and is no part of a recording."""
    with suppress(BagError, OSError), closing(open_bag_file(path)) as reader:
        return recording_of(reader.metadata) != recording
    return False


def recordings(paths: Collection[Path]) -> list[list[Path]]:
    """
    Return the files of each recording, such as those of a split or of a ring.

    :param paths: bags in their order; a folder, and a file that cannot be read, is alone.
    """
    found: list[list[Path]] = []
    if len(paths) < 2:
        return [[*paths]]
    ends: dict[str, tuple[_Part, list[Path]]] = {}  # by identifier; those without are in ''
    for path in paths:
        files = [path]
        with suppress(BagError, OSError), closing(open_bag_file(path)) as reader:
            part = _part(path, reader)
            before = ends.get(part.recording)
            if before and before[0].precedes(part):
                files = before[1]
                files.append(path)
            ends[part.recording] = part, files
        if files == [path]:
            found.append(files)
    return found


def open_bag_file(path: Path) -> BagReader:
    """
    Open a file of a bag. One that is packed is unpacked to a temporary file without a name.

    :raises BagError: the file cannot be read as a bag.
    :raises OSError: the file cannot be read.
    """
    suffix = Path(_unpacked_name(path)).suffix.lower()
    reader: type[Db3Reader | McapReader] = Db3Reader if suffix == '.db3' else McapReader
    if not _is_packed(path):
        return reader(path)
    with TemporaryDirectory(prefix='opencv_tools-') as folder:
        content = Path(folder) / path.name
        unpack_file(path, content)
        return reader(content)


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
        #: Sentences about parts of the bag that are missing, or in another order.
        self.warnings = [found.warning] if found.warning else []
        #: Number of messages of each topic.
        self.topics: Counter[BagTopic] = Counter()
        #: Name and contents of each metadata record; begins of the same recording are there once.
        self.metadata: list[tuple[str, dict[str, str]]] = []
        #: Number of attachments.
        self.attachments = 0
        parts: list[_Part] = []
        for file in self.paths:
            with closing(open_bag_file(file)) as reader:
                self.topics.update(reader.topics)
                self.attachments += reader.attachments
                self.metadata += [one for one in reader.metadata
                                  if has_account([one]) or one not in self.metadata]
                self.warnings += [reader.warning] if reader.warning else []
                parts.append(_part(file, reader))
        self.warnings += _order_problems(parts)
        times = [time for part in parts if part.topics for time in (part.first_ns, part.last_ns)]
        #: Times of the first and the last message, in nanoseconds; 0 for an empty bag.
        self.first_ns, self.last_ns = min(times, default=0), max(times, default=0)
        #: Number of the file that is being read, from 0.
        self.file = 0
        self._reader: BagReader | None = None

    def messages(self, topics: Collection[BagTopic]) -> Iterator[BagMessage | Damage]:
        """
        Yield the messages of some topics.

        :param topics: topics to read.
        :raises BagError: a file cannot be read as a bag.
        :raises OSError: a file cannot be read.
        """
        for number, file in enumerate(self.paths):
            self.file, self._reader = number, open_bag_file(file)
            yield from self._reader.messages(topics)
            self.close()

    def close(self) -> None:
        """Close the file that is being read."""
        if self._reader is not None:
            self._reader.close()
            self._reader = None
