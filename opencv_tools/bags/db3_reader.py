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

"""Reader of the SQLite files that rosbag2 writes."""

from __future__ import annotations

from collections.abc import Collection, Iterator
from contextlib import suppress
from functools import partial
import os
from pathlib import Path
import sqlite3
from urllib.parse import quote

from opencv_tools.bags.errors import BagError
from opencv_tools.bags.reading import BagMessage, BagTopic, Damage, MAX_BYTES, MAX_TEXT, Texts
from opencv_tools.base.regular_files import check_kind, open_regular
from opencv_tools.base.text import MAX_PATH, printable

_LOCK_SECONDS = 2.0
_OTHER_FILES = '-journal', '-wal', '-shm'  # endings of the names of files that SQLite opens too
_MAX_TOPICS = 65536
# The columns of each table that are read. A view, a virtual table or a computed column could
# compute for ever. The id of a message is its _rowid_, which is always an integer.
_COLUMNS = {'topics': {'id', 'name', 'type', 'serialization_format'},
            'messages': {'id', 'topic_id', 'timestamp', 'data'}}
# A table of their texts, which bags have since ROS 2 Iron.
_DEFINITIONS = {'topic_type', 'encoding', 'encoded_message_definition'}
_QOS = 'offered_qos_profiles'  # not in old bags


class Db3Reader:
    """A bag in the format ``sqlite3`` of rosbag2."""

    def __init__(self, path: Path) -> None:
        """
        Open a file and find its topics.

        :raises BagError: the file is not a bag of rosbag2, is damaged or is locked.
        :raises OSError: the file cannot be read, or a file that SQLite opens with it is not a
            regular file.
        """
        self.topics: dict[BagTopic, int] = {}
        self.first_ns = self.last_ns = self.attachments = 0
        self.metadata: list[tuple[str, dict[str, str]]] = []
        self.warning = ''
        self._name = printable(path.name, MAX_PATH)
        self._ids: dict[int, BagTopic] = {}
        # SQLite would wait for a named pipe. It follows links before it opens the other files.
        os.close(open_regular(path))
        path = path.resolve()
        for suffix in _OTHER_FILES:
            other = path.with_name(path.name + suffix)
            with suppress(FileNotFoundError):
                check_kind(other, other.stat().st_mode)
        self._database = sqlite3.connect(
            f'file:{quote(str(path))}?mode=ro', _LOCK_SECONDS, uri=True,
            check_same_thread=False)
        self._database.text_factory = lambda data: data.decode(errors='replace')
        try:
            self._read_topics()
        except BaseException as err:
            self.close()
            if isinstance(err, (sqlite3.Error, ValueError, OverflowError)):
                raise self._error(err) from err
            raise

    def close(self) -> None:
        self._database.close()

    def messages(self, topics: Collection[BagTopic]) -> Iterator[BagMessage | Damage]:
        ids = [number for number, topic in self._ids.items() if topic in topics]
        marks = ', '.join('?' * len(ids))
        try:
            # The data are read one by one, because sorting them would copy the whole file. A text
            # instead of a number may be long, also in an index, so only its type is read.
            for number, topic_id, time_ns in self._database.execute(
                    "SELECT _rowid_, topic_id, CASE typeof(timestamp) WHEN 'integer' THEN "
                    'timestamp END FROM messages NOT INDEXED WHERE CASE typeof(topic_id) '
                    f"WHEN 'integer' THEN topic_id IN ({marks}) END ORDER BY 3, 1", ids):
                if isinstance(time_ns, int):
                    load = partial(self._load, number)
                    yield BagMessage(self._ids[topic_id], time_ns, load, place=number)
                else:
                    yield Damage(f'{self._name}: message {number} has no time')
        except sqlite3.Error as err:
            raise self._error(err) from err

    def _load(self, number: int) -> memoryview:
        try:
            size, data = self._database.execute(
                "SELECT CASE typeof(data) WHEN 'blob' THEN length(data) END, "
                "CASE WHEN typeof(data) = 'blob' AND length(data) <= ? THEN data END "
                'FROM messages WHERE _rowid_ = ?', (MAX_BYTES, number)).fetchone() or (0, None)
        except sqlite3.Error as err:
            raise self._error(err) from err
        if not isinstance(data, bytes):
            raise BagError(
                f'{self._name}: message {number} has {size} bytes; more than {MAX_BYTES} are not '
                'read' if data is None and size else
                f'{self._name}: message {number} has no binary data')
        return memoryview(data)

    def _read_topics(self) -> None:
        self._database.execute('PRAGMA trusted_schema = OFF')
        found = {table: self._check_table(table, columns) for table, columns in _COLUMNS.items()}
        texts = Texts()
        definitions = self._read_definitions(texts)
        qos = f'substr({_QOS}, 1, {MAX_TEXT})' if _QOS in found['topics'] else "''"
        for number, name, kind, serialization, offers in self._database.execute(
                'SELECT id, substr(name, 1, 1000), substr(type, 1, 1000), '
                'substr(serialization_format, 1, 1000), '
                f"{qos} FROM topics WHERE typeof(id) = 'integer' LIMIT {_MAX_TOPICS}"):
            self._ids[number] = topic = BagTopic(
                str(name), str(kind), str(serialization), definitions.get(str(kind), ''),
                texts.keep(str(offers or '').encode()))
            self.topics.setdefault(topic, 0)
        for number, count, first_ns, last_ns in self._database.execute(
                'SELECT topic_id, count(*), min(timestamp), max(timestamp) '
                "FROM messages NOT INDEXED WHERE typeof(timestamp) = 'integer' "
                "AND typeof(topic_id) = 'integer' GROUP BY topic_id"):
            if number in self._ids:
                self.topics[self._ids[number]] += count
                self.first_ns = min(self.first_ns or first_ns, first_ns)
                self.last_ns = max(self.last_ns, last_ns)

    def _read_definitions(self, texts: Texts) -> dict[str, str]:
        """Return the texts of types; none of a table that rosbag2 does not write."""
        with suppress(BagError):
            self._check_table('message_definitions', _DEFINITIONS)
            return {str(kind): texts.keep(text.encode()) for kind, text in self._database.execute(
                'SELECT substr(topic_type, 1, 1000), substr(encoded_message_definition, 1, '
                f"{MAX_TEXT + 1}) FROM message_definitions WHERE encoding = 'ros2msg' "
                f"AND typeof(encoded_message_definition) = 'text' LIMIT {_MAX_TOPICS}")}
        return {}

    def _check_table(self, name: str, columns: set[str]) -> set[str]:
        """Return those columns of a table that are known; it has at least some of them."""
        found = self._database.execute(
            "SELECT count(*) FROM sqlite_master WHERE name = ? AND type = 'table' "
            "AND sql LIKE 'CREATE TABLE%'", (name,)).fetchone()
        # Each row ends with 0 for an ordinary column.
        kinds = {row[1].lower(): row[-1] for row in self._database.execute(
            f'PRAGMA table_xinfo({name})')}
        known = kinds.keys() & {_QOS, *columns}
        if (not found[0] or '_rowid_' in kinds or not columns <= known
                or any(kinds[column] != 0 for column in known)):
            raise BagError(f'{self._name} is not a bag of rosbag2: its table {name} is missing or '
                           'has other columns')
        return known

    def _error(self, err: Exception) -> BagError:
        reason = printable(err)
        if 'malformed' in reason:
            reason += (f'; its first messages are recovered by: sqlite3 {self._name} .dump | '
                       "sed 's/^ROLLBACK.*/COMMIT;/' | sqlite3 recovered.db3")
        return BagError(f'{self._name} cannot be read as a bag: {reason}')
