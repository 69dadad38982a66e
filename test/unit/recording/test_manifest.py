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

"""The manifest of a recording: its lines, also those of other programs."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import fields, replace
import os
from pathlib import Path
import re
import threading

from conftest import read_manifest
from opencv_tools.recording.errors import RecordingError
from opencv_tools.recording.manifest import FILE_NAME, Manifest, ManifestEntry, parse_line
import pytest
from recordings import manifest_line, record, record_ring


def test_manifest_has_a_line_for_every_file(tmp_path: Path) -> None:
    record(tmp_path, 3)
    lines = read_manifest(tmp_path)
    assert [line['seq'] for line in lines] == [0, 1, 2]
    del lines[1]['bytes'], lines[1]['sha256']
    assert lines[1] == {
        'seq': 1, 'file': '001.png', 'stamp': {'sec': 1_700_000_001, 'nanosec': 0},
        'receive_time': {'sec': 1_700_000_001, 'nanosec': 5_000_000}, 'frame_id': 'camera',
        'encoding': 'mono8', 'stored_encoding': 'mono8', 'size': [20, 20], 'frames': 1}


def test_documented_keys_are_those_of_a_line(tmp_path: Path) -> None:
    record(tmp_path, 1)
    page = Path(__file__).parents[3].joinpath('docs', 'recording.md').read_text()
    table = page.partition('**The manifest.**')[2].partition('| key | meaning |')[2]
    keys = ' '.join(row.split('|')[1] for row in table.partition('\n\n')[0].splitlines()[2:])
    assert sorted(re.findall('`([a-z0-9_]+)`', keys)) == sorted(read_manifest(tmp_path)[0])


def test_every_field_is_read_back() -> None:
    values = {field.name: number if field.type == 'int' else f'{number:064x}'
              for number, field in enumerate(fields(ManifestEntry), 1)}
    entry = ManifestEntry(**values)
    assert parse_line(entry.line()) == entry


def test_truncated_last_line_is_removed(tmp_path: Path) -> None:
    record(tmp_path, 2)
    manifest = tmp_path / 'manifest.jsonl'
    manifest.write_bytes(manifest.read_bytes() + b'{"seq": 2, "fi' + b'x' * 5000)
    record(tmp_path, 1, first=2)
    assert len(read_manifest(tmp_path)) == 3


def test_line_added_during_a_compaction_is_kept(tmp_path: Path) -> None:
    record(tmp_path, 2)
    manifest = Manifest(tmp_path)
    first, second = manifest.entries()
    threads = []

    def write(lines: Iterable[bytes]) -> Path:
        threads.append(threading.Thread(target=manifest.append, args=[first]))
        threads[0].start()
        threads[0].join(0.3)  # ends only if the file is not locked
        path = tmp_path / 'new'
        path.write_bytes(b''.join(lines))
        return path

    manifest.compact(lambda entry: entry == second, write)
    threads[0].join()
    assert manifest.entries() == [second, first]


def test_tail_of_a_long_manifest(tmp_path: Path) -> None:
    record(tmp_path, 1)
    manifest = Manifest(tmp_path)
    [entry] = manifest.entries()
    lines = [replace(entry, seq=seq).line() for seq in range(6000)]
    (tmp_path / 'manifest.jsonl').write_bytes(b''.join(lines))
    tail = [entry.seq for entry in manifest.tail()]
    assert tail == list(range(tail[0], 6000))
    whole = len(b''.join(lines[tail[0]:]))
    assert whole <= 2 ** 20 < whole + len(lines[tail[0] - 1])


@pytest.mark.parametrize('name', [
    '../victim.png', '{tmp}/victim.png', 'deeper/victim.png', '../out/../victim.png'])
def test_ring_deletes_nothing_outside_its_folder(tmp_path: Path, name: str) -> None:
    folder = tmp_path / 'out'
    (folder / 'deeper').mkdir(parents=True)
    victims = [tmp_path / 'victim.png', folder / 'deeper' / 'victim.png']
    for victim in victims:
        victim.write_text('precious')
    (folder / FILE_NAME).write_bytes(manifest_line(file=name.format(tmp=tmp_path)))
    assert Manifest(folder).entries() == []
    record_ring(folder)
    assert [victim.read_text() for victim in victims] == ['precious'] * 2
    assert len(list(folder.glob('camera*.png'))) == 1


@pytest.mark.parametrize('fields', [
    {'file': ''}, {'file': '.'}, {'file': '..'}, {'file': '/'}, {'file': 'a/b'}, {'file': 'a\0b'},
    {'file': '\ud800'}, {'file': 7}, {'file': None}, {'seq': -1}, {'seq': 2**63}, {'bytes': -9},
    {'frames': -1}, {'seq': float('inf')}, {'seq': float('nan')}, {'size': [1]},
    {'stamp': {'sec': 1e300, 'nanosec': 0}}, {'size': [1, -1]}])
def test_invalid_lines_are_skipped(tmp_path: Path, fields: dict[str, object]) -> None:
    with pytest.raises(ValueError):
        parse_line(manifest_line(**fields))
    good, bad = manifest_line(), manifest_line(**fields)
    (tmp_path / FILE_NAME).write_bytes(good + bad + b'[' * 100_000 + b'\n' + good)
    assert len(Manifest(tmp_path).entries()) == len(Manifest(tmp_path).tail()) == 2


@pytest.mark.parametrize('kind', ['named pipe', 'symbolic link'])
def test_pipe_or_link_instead_of_the_manifest_is_refused(tmp_path: Path, kind: str) -> None:
    manifest = Manifest(tmp_path)
    manifest.append(parse_line(manifest_line()))
    (tmp_path / FILE_NAME).rename(tmp_path / 'target')
    if kind == 'named pipe':
        os.mkfifo(tmp_path / FILE_NAME)
    else:
        (tmp_path / FILE_NAME).symlink_to('target')
    for act in (lambda: manifest.append(parse_line(manifest_line())), manifest.entries,
                manifest.tail,
                lambda: manifest.compact(lambda _: True, lambda _: tmp_path / 'new')):
        with pytest.raises(OSError, match=rf'manifest\.jsonl is a {kind}'):
            act()


def test_manifest_that_is_too_large_is_not_read(tmp_path: Path) -> None:
    (tmp_path / FILE_NAME).touch()
    os.truncate(tmp_path / FILE_NAME, 1 << 42)
    for act in (lambda: record_ring(tmp_path), Manifest(tmp_path).entries):
        with pytest.raises((OSError, RecordingError), match=r'manifest\.jsonl is larger than'):
            act()
