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

"""SQLite files of rosbags, damaged and hostile ones."""

from __future__ import annotations

import os
from pathlib import Path
import shutil
import sqlite3
import subprocess

from conftest import peak_memory
from hypothesis import given, settings, strategies
import numpy as np
from opencv_tools.bags.db3_reader import Db3Reader
from opencv_tools.bags.errors import BagError
from opencv_tools.bags.reading import BagMessage, BagTopic, MAX_BYTES, MAX_TEXT
from opencv_tools.bags.schemas import IMAGE
from opencv_tools.base.regular_files import RefusedFileError
from played_bags import BEGAN_NS, Entry, image_entry, read_all, write_rosbag2, written
import pytest

ENTRIES = [image_entry(number, topic=f'/camera_{number % 2}') for number in range(6)]


@pytest.fixture
def path(tmp_path: Path) -> Path:
    """Create a bag in SQLite."""
    return write_rosbag2(tmp_path / 'bag', '.db3', ENTRIES) / 'bag.db3'


def change(path: Path, *statements: str) -> Path:
    """Execute statements of SQL."""
    with sqlite3.connect(path) as database:
        for statement in statements:
            database.execute(statement)
    database.close()
    return path


def test_message_that_is_deleted_meanwhile(path: Path) -> None:
    reader = Db3Reader(path)
    message = next(iter([*reader.messages(reader.topics)]))
    assert isinstance(message, BagMessage)
    change(path, 'DELETE FROM messages')
    with pytest.raises(BagError, match='has no binary data'):
        message.load()
    reader.close()


def test_file_of_rosbags_is_read(path: Path) -> None:
    assert read_all(path) == (written(ENTRIES), [])
    reader = Db3Reader(path)
    assert reader.topics == {BagTopic(f'/camera_{number}', IMAGE): 3 for number in range(2)}
    assert (reader.first_ns, reader.last_ns) == (ENTRIES[0].log_ns, ENTRIES[-1].log_ns)
    found = [item.log_ns for item in reader.messages([BagTopic('/camera_1', IMAGE)])]
    assert found == [entry.log_ns for entry in ENTRIES[1::2]]
    reader.close()


def test_messages_come_in_the_order_of_their_times(tmp_path: Path) -> None:
    entries = [Entry(BEGAN_NS + int(number), bytes([number]))
               for number in np.random.default_rng(1).permutation(40)]
    folder = write_rosbag2(tmp_path / 'bag', '.db3', entries)
    assert read_all(folder / 'bag.db3') == (written(entries), [])


@pytest.mark.parametrize(('statements', 'begin'), [
    ([], 'std_msgs/Header header\n'), (['DROP TABLE message_definitions'], ''),
    (["UPDATE message_definitions SET encoding = 'ros2idl'"], ''),
    (['UPDATE message_definitions SET encoded_message_definition = '
      f"replace(hex(zeroblob({MAX_TEXT // 2})), '0', 'é')"], ''),
    (["UPDATE message_definitions SET encoded_message_definition = x'ff'"], ''),
    (["UPDATE message_definitions SET encoded_message_definition = CAST(x'ff' AS text)"],
     '\ufffd'),
    (["UPDATE message_definitions SET topic_type = 'a/A'"], ''),
    (['ALTER TABLE message_definitions RENAME COLUMN encoding TO other'], ''),
    (['DROP TABLE message_definitions', 'CREATE TABLE message_definitions(topic_type TEXT, '
      'encoding TEXT, encoded_message_definition TEXT)', 'INSERT INTO message_definitions '
      f"VALUES ('{IMAGE}', 'ros2msg', NULL)"], ''),
    (['ALTER TABLE message_definitions RENAME TO old',
      'CREATE VIEW message_definitions AS SELECT * FROM old'], ''),
    (['DROP TABLE message_definitions', 'CREATE TABLE message_definitions(topic_type TEXT, '
      "encoding TEXT DEFAULT 'ros2msg', encoded_message_definition TEXT GENERATED ALWAYS AS "
      '(hex(zeroblob(400000000))))', 'INSERT INTO message_definitions(topic_type) VALUES '
      f"('{IMAGE}')"], '')], ids=range(11))
def test_definitions(path: Path, statements: list[str], begin: str) -> None:
    reader = Db3Reader(change(path, *statements))
    for topic in reader.topics:
        assert topic.definition.startswith(begin) and bool(topic.definition) == bool(begin)
    reader.close()
    assert read_all(path) == (written(ENTRIES), [])


@pytest.mark.parametrize('statements', [
    ['DROP TABLE messages'], ['DROP TABLE topics'],
    ['ALTER TABLE topics RENAME COLUMN serialization_format TO other'],
    ['ALTER TABLE messages RENAME TO old', 'CREATE VIEW messages AS SELECT * FROM old'],
    ['ALTER TABLE messages RENAME TO old',
     'CREATE TABLE messages (id INTEGER PRIMARY KEY, topic_id INTEGER, timestamp INTEGER, '
     'data BLOB GENERATED ALWAYS AS (hex(zeroblob(400000000))))'],
    ['ALTER TABLE messages ADD COLUMN _RowId_ text'],
    ['DROP TABLE messages',
     'CREATE VIRTUAL TABLE messages USING fts5(id, topic_id, timestamp, data)']])
def test_other_tables_are_refused(path: Path, statements: list[str]) -> None:
    with pytest.raises(BagError, match=r'^bag\.db3 (is not a bag of rosbag2|cannot be read)'):
        Db3Reader(change(path, *statements))


def test_messages_in_another_serialization_have_no_images(path: Path) -> None:
    change(path, "UPDATE topics SET serialization_format = 'ros1', type = 'sensor_msgs/Image'")
    reader = Db3Reader(path)
    assert not any(topic.has_images for topic in reader.topics)
    reader.close()


@pytest.mark.parametrize('content', [b'', b'no database', b'SQLite format 3\0' + bytes(100)])
def test_file_that_is_no_database_is_refused(tmp_path: Path, content: bytes) -> None:
    (tmp_path / 'a.db3').write_bytes(content)
    with pytest.raises(BagError, match=r'^a\.db3 (is not a bag of rosbag2|cannot be read)'):
        Db3Reader(tmp_path / 'a.db3')


@pytest.mark.process
def test_cut_file_is_refused_with_a_remedy_that_works(tmp_path: Path) -> None:
    entries = [image_entry(number, np.full((40, 60), number, np.uint8)) for number in range(40)]
    path = write_rosbag2(tmp_path / 'bag', '.db3', entries) / 'bag.db3'
    path.write_bytes(path.read_bytes()[:-60_000])
    with pytest.raises(BagError, match='malformed; its first messages are recovered by: ') as err:
        read_all(path)
    if shutil.which('sqlite3') is None:
        pytest.skip('the program sqlite3 is not installed')
    command = str(err.value).partition('recovered by: ')[2]
    subprocess.run(command, shell=True, cwd=path.parent, stderr=subprocess.DEVNULL, check=False)
    messages, reports = read_all(path.with_name('recovered.db3'))
    assert messages == written(entries)[:len(messages)] and len(messages) > 10
    assert not reports


def test_missing_file_is_not_created(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError):
        Db3Reader(tmp_path / 'a.db3')
    assert not any(tmp_path.iterdir())


def test_file_is_not_changed(path: Path) -> None:
    before = path.read_bytes()
    read_all(path)
    assert path.read_bytes() == before
    assert sorted(file.name for file in path.parent.iterdir()) == ['bag.db3', 'metadata.yaml']


@pytest.mark.parametrize('is_link', [False, True])
@pytest.mark.parametrize('suffix', ['', '-journal', '-wal', '-shm'])
def test_pipe_that_sqlite_would_open_is_refused(
        path: Path, tmp_path: Path, suffix: str, is_link: bool) -> None:
    name = path.with_name(path.name + suffix)
    name.unlink(missing_ok=True)
    os.mkfifo(name)
    if is_link:
        path = tmp_path / 'link.db3'
        path.symlink_to(name.parent / 'bag.db3')
    with pytest.raises(RefusedFileError, match='is a named pipe'):
        Db3Reader(path)


def test_locked_file_is_reported(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr('opencv_tools.bags.db3_reader._LOCK_SECONDS', 0.01)
    writer = sqlite3.connect(path, isolation_level=None)
    writer.execute('BEGIN EXCLUSIVE')
    with pytest.raises(BagError, match='database is locked'):
        Db3Reader(path)
    writer.close()


def test_bag_that_is_being_written_is_read_up_to_the_last_commit(path: Path) -> None:
    writer = sqlite3.connect(path, isolation_level=None)
    writer.execute('PRAGMA journal_mode = WAL')
    writer.execute('BEGIN')
    writer.execute("INSERT INTO messages VALUES (100, 1, 5, x'00')")
    assert read_all(path) == (written(ENTRIES), [])
    writer.execute('COMMIT')
    assert len(read_all(path)[0]) == len(ENTRIES) + 1
    writer.close()


@pytest.mark.parametrize(('statement', 'reason'), [
    (f'UPDATE messages SET data = zeroblob({MAX_BYTES + 1}) WHERE id = 2',
     f'has {MAX_BYTES + 1} bytes; more than {MAX_BYTES} are not read'),
    ("UPDATE messages SET data = 'text' WHERE id = 2", 'has no binary data'),
    ("UPDATE messages SET timestamp = 'never' WHERE id = 2", 'has no time')])
def test_bad_message_is_reported_and_the_rest_is_read(
        path: Path, statement: str, reason: str) -> None:
    reader = Db3Reader(change(path, statement))
    loaded, reasons = [], []
    for item in reader.messages(reader.topics):
        try:
            loaded.append(bytes(item.load()))
        except (AttributeError, BagError) as err:
            reasons.append(str(err) if isinstance(err, BagError) else item.reason)
    reader.close()
    assert loaded == [entry.data for number, entry in enumerate(ENTRIES) if number != 1]
    assert len(reasons) == 1 and reason in reasons[0]


def peak_memory_of_loading(path: Path, failures: int) -> int:
    """Return the peak memory in KB of a process that loads all messages of a bag."""
    script = ('import sys; from pathlib import Path\n'
              'from opencv_tools.bags.db3_reader import Db3Reader\n'
              'from opencv_tools.bags.errors import BagError\n'
              'reader, failures = Db3Reader(Path(sys.argv[1])), 0\n'
              'for item in reader.messages(reader.topics):\n'
              '    try: item.load()\n'
              '    except (AttributeError, BagError): failures += 1\n'
              f'assert failures == {failures}\n')
    try:
        return peak_memory(script, path)
    finally:
        path.unlink()


@pytest.mark.process
@pytest.mark.thorough
def test_huge_messages_need_less_than_a_gigabyte(path: Path) -> None:
    change(path, *(f'UPDATE messages SET data = zeroblob(900000000) WHERE id = {number}'
                   for number in (1, 2)))
    assert peak_memory_of_loading(path, failures=2) < 500_000  # KB


@pytest.mark.process
@pytest.mark.thorough
@pytest.mark.parametrize(('column', 'failures'), [('timestamp', 1), ('topic_id', 0), ('data', 1)])
@pytest.mark.parametrize('index', ['', 'CREATE INDEX long ON messages ({})'])
def test_long_text_instead_of_another_value(
        path: Path, column: str, failures: int, index: str) -> None:
    change(path, f'UPDATE messages SET {column} = CAST(zeroblob(300000000) AS text) WHERE id = 2',
           *([index.format(column)] if index else []))
    assert peak_memory_of_loading(path, failures) < 300_000


@pytest.fixture(scope='module')
def whole(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    """Return the content of a bag in SQLite."""
    folder = tmp_path_factory.mktemp('whole') / 'bag'
    content = (write_rosbag2(folder, '.db3', ENTRIES) / 'bag.db3').read_bytes()
    shutil.rmtree(folder)
    return content


def read_damaged(tmp_path_factory: pytest.TempPathFactory, content: bytes) -> None:
    """Read a file, which may raise a BagError of one line only."""
    path = tmp_path_factory.getbasetemp() / 'damaged.db3'
    path.write_bytes(content)
    try:
        read_all(path)
    except BagError as err:
        assert '\n' not in str(err)


any_damage = given(
    positions=strategies.lists(strategies.tuples(
        strategies.integers(0, 1 << 16), strategies.binary(min_size=1, max_size=9)), max_size=6))


def check_damaged_bytes_raise_nothing_else_than_bag_errors(
        tmp_path_factory: pytest.TempPathFactory, whole: bytes,
        positions: list[tuple[int, bytes]]) -> None:
    content = bytearray(whole)
    for position, data in positions:
        position %= len(content)
        content[position:position + len(data)] = data
    read_damaged(tmp_path_factory, content)


@pytest.mark.quick_cases(1)
@pytest.mark.parametrize('examples', [50, 200])
def test_damaged_bytes_raise_nothing_else_than_bag_errors(
        examples: int, tmp_path_factory: pytest.TempPathFactory, whole: bytes) -> None:
    check = any_damage(check_damaged_bytes_raise_nothing_else_than_bag_errors)
    settings(max_examples=examples)(check)(tmp_path_factory=tmp_path_factory, whole=whole)


def test_cut_file_raises_nothing_else_than_bag_errors(
        tmp_path_factory: pytest.TempPathFactory, whole: bytes) -> None:
    for size in range(0, len(whole), 97):
        read_damaged(tmp_path_factory, whole[:size])


def test_quality_of_service_that_is_computed(path: Path) -> None:
    change(path, 'DROP TABLE topics', 'CREATE TABLE topics(id INTEGER PRIMARY KEY, name TEXT, '
           'type TEXT, serialization_format TEXT, offered_qos_profiles TEXT GENERATED ALWAYS AS '
           '(hex(zeroblob(400000000))))')
    with pytest.raises(BagError, match='its table topics is missing or has other columns'):
        Db3Reader(path)
