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

"""Folders of recordings that somebody else has written to."""

from __future__ import annotations

import json
import os
from pathlib import Path

import numpy as np
from opencv_tools.recording.errors import RecordingError
from opencv_tools.recording.folder import Folder
from opencv_tools.recording.frames import RawFrame
from opencv_tools.recording.image_encoder import EncoderSettings
from opencv_tools.recording.manifest import FILE_NAME, Manifest, parse_line
from opencv_tools.recording.naming import FileNames, FrameMetadata, NANO
from opencv_tools.recording.open_sink import open_sink
from opencv_tools.recording.selection import Limits
import pytest
from special_files import KINDS

FIELDS = {
    'seq': 0, 'file': 'a.png', 'stamp': {'sec': 1, 'nanosec': 0},
    'receive_time': {'sec': 1, 'nanosec': 0}, 'frame_id': 'a', 'encoding': 'bgr8',
    'stored_encoding': 'bgr8', 'size': [1, 1], 'bytes': 9, 'sha256': '00', 'frames': 1}
RING = Limits(max_frames=1, ring=True)


def line(**fields: object) -> bytes:
    return json.dumps(FIELDS | fields).encode() + b'\n'


def record(folder: Path, suffix: str = '.png', count: int = 2) -> None:
    files = open_sink(folder, FileNames(f'{{frame_id}}{{stamp}}{suffix}'), EncoderSettings(suffix),
                      'continue', RING if suffix == '.png' else Limits(), False)
    try:
        for second in range(count):
            time_ns = (1_700_000_000 + second) * NANO
            metadata = FrameMetadata(time_ns, 'camera', 'mono8', '/video_frames')
            frame = RawFrame(
                metadata=metadata, receive_ns=time_ns, image=np.zeros((20, 20), np.uint8))
            files.commit(frame, files.prepare(frame))
    finally:
        files.close()


@pytest.mark.parametrize('name', [
    '../victim.png', '{tmp}/victim.png', 'deeper/victim.png', '../out/../victim.png'])
def test_a_ring_deletes_nothing_outside_its_folder(tmp_path: Path, name: str) -> None:
    folder = tmp_path / 'out'
    (folder / 'deeper').mkdir(parents=True)
    victims = [tmp_path / 'victim.png', folder / 'deeper' / 'victim.png']
    for victim in victims:
        victim.write_text('precious')
    (folder / FILE_NAME).write_bytes(line(file=name.format(tmp=tmp_path)))
    assert Manifest(folder).entries() == []
    record(folder)
    assert [victim.read_text() for victim in victims] == ['precious'] * 2
    assert len(list(folder.glob('camera*.png'))) == 1


@pytest.mark.parametrize('fields', [
    {'file': ''}, {'file': '.'}, {'file': '..'}, {'file': '/'}, {'file': 'a/b'}, {'file': 'a\0b'},
    {'file': '\ud800'}, {'file': 7}, {'file': None}, {'seq': -1}, {'seq': 2**63}, {'bytes': -9},
    {'frames': -1}, {'seq': float('inf')}, {'seq': float('nan')}, {'size': [1]},
    {'stamp': {'sec': 1e300, 'nanosec': 0}}, {'size': [1, -1]}])
def test_lines_that_nobody_wrote_here_are_left_out(
        tmp_path: Path, fields: dict[str, object]) -> None:
    with pytest.raises(ValueError):
        parse_line(line(**fields))
    (tmp_path / FILE_NAME).write_bytes(line() + line(**fields) + b'[' * 100_000 + b'\n' + line())
    assert len(Manifest(tmp_path).entries()) == len(Manifest(tmp_path).tail()) == 2


@pytest.mark.parametrize('suffix', ['.png', '.mkv'])
@pytest.mark.parametrize('kind', ['link', *KINDS])
@pytest.mark.parametrize('name', [FILE_NAME, '.recording-0a1b2c3d-.journal'])
def test_a_folder_with_something_else_in_place_of_a_file(
        tmp_path: Path, name: str, kind: str, suffix: str) -> None:
    folder, victim = tmp_path / 'out', tmp_path / 'victim'
    folder.mkdir()
    victim.write_bytes(line())
    if kind == 'link':
        (folder / name).symlink_to(victim)
    else:
        KINDS[kind][0](folder / name)
    with pytest.raises(RecordingError, match=r'^output_dir .*/out cannot be used') as caught:
        record(folder, suffix)
    links = ('link', 'device')  # in a folder of ours a link to a device is a link
    reason = 'is a symbolic link, not a regular file' if kind in links else KINDS[kind][1]
    reason = reason if kind == 'folder' else f'{name} {reason}'
    assert str(caught.value).endswith(f'cannot be used: {reason}')
    assert [path.name for path in folder.iterdir()] == [name]
    assert victim.read_bytes() == line()


@pytest.mark.parametrize('kind', ['named pipe', 'symbolic link'])
def test_what_takes_the_place_of_the_manifest(tmp_path: Path, kind: str) -> None:
    manifest = Manifest(tmp_path)
    manifest.append(parse_line(line()))
    (tmp_path / FILE_NAME).rename(tmp_path / 'target')
    if kind == 'named pipe':
        os.mkfifo(tmp_path / FILE_NAME)
    else:
        (tmp_path / FILE_NAME).symlink_to('target')
    for act in (lambda: manifest.append(parse_line(line())), manifest.entries, manifest.tail,
                lambda: manifest.compact(lambda _: True, lambda _: tmp_path / 'new')):
        with pytest.raises(OSError, match=rf'manifest\.jsonl is a {kind}'):
            act()


def test_a_manifest_that_is_too_large_is_not_read(tmp_path: Path) -> None:
    (tmp_path / FILE_NAME).touch()
    os.truncate(tmp_path / FILE_NAME, 1 << 42)
    for act in (lambda: record(tmp_path), Manifest(tmp_path).entries):
        with pytest.raises((OSError, RecordingError), match=r'manifest\.jsonl is larger than'):
            act()


@pytest.mark.parametrize('name', ['../victim', 'link', 'pipe'])
def test_a_journal_gets_no_line_for_what_is_no_file_of_the_folder(
        tmp_path: Path, name: str) -> None:
    folder = tmp_path / 'out'
    folder.mkdir()
    (tmp_path / 'victim').write_text('precious')
    (folder / 'link').symlink_to('../victim')
    os.mkfifo(folder / 'pipe')
    (folder / '.recording-0a1b2c3d-.journal').write_bytes(line(file=name, sha256=''))
    Folder(folder).close()
    assert {path.name for path in folder.iterdir()} == {'link', 'pipe'}


def test_a_journal_without_a_number_of_its_own_removes_nothing(tmp_path: Path) -> None:
    other = Folder(tmp_path)
    temporary = other.write((b'content',))
    (tmp_path / '.recording-.journal').touch()
    Folder(tmp_path).close()
    assert temporary.exists()
    other.close()
