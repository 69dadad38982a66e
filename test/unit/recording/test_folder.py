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

"""Output folder of a recording: atomic files, journals, and leftovers of killed recordings."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
import errno
import fcntl
import hashlib
import json
import os
from pathlib import Path
import random
import subprocess
import sys
import threading
from typing import Any

from conftest import read_manifest, recorded_files
from console import Console
import cv2
import numpy as np
from opencv_tools.recording import folder as folder_module
from opencv_tools.recording.errors import RecordingError
from opencv_tools.recording.folder import Folder
from opencv_tools.recording.image_encoder import EncoderSettings
from opencv_tools.recording.manifest import FILE_NAME, Manifest, ManifestEntry, parse_line
from opencv_tools.recording.naming import FileNames
from opencv_tools.recording.open_sink import open_sink
from opencv_tools.recording.recorder import Recorder
from opencv_tools.recording.selection import Limits
import pytest
from recordings import (
    failing, gray_frame, gray_numbers, image_sink, manifest_line, record, record_ring)
from special_files import KINDS
from waiting import LONGEST_SECONDS, pause, wait_until, work_of

JOURNAL = '.recording-0a1b2c3d-.journal'  # of a recording that was killed


def test_removed_folder_is_created_again(tmp_path: Path) -> None:
    folder, console = tmp_path / 'mount' / 'out', Console()
    sink = open_sink(folder, FileNames('{seq}.png'), EncoderSettings('.png'), 'continue', Limits(),
                     False)
    recorder = Recorder(sink, console, writers=1)

    def put_and_wait(number: int) -> None:
        done = threading.Event()
        recorder.put(gray_frame(number), lambda _: done.set())
        wait_until(done.is_set)

    put_and_wait(0)
    (tmp_path / 'mount').rename(tmp_path / 'away')
    put_and_wait(1)
    put_and_wait(2)
    assert console.lines == ['error: a frame was not written: No such file or directory']
    assert not (tmp_path / 'mount').exists()  # a disk may have been mounted there
    (tmp_path / 'mount').mkdir()
    put_and_wait(3)
    put_and_wait(4)
    recorder.close()
    assert gray_numbers(folder) == [3, 4]
    assert len(read_manifest(folder)) == 2
    assert console.lines[1:] == ['info: Writing again; 2 frames were not written']
    assert (recorder.counts.written, recorder.counts.failed) == (3, 2)


def test_end_after_the_folder_is_gone(tmp_path: Path) -> None:
    sink = image_sink(tmp_path / 'mount' / 'out', '{seq}.png')
    frame = gray_frame(0)
    sink.commit(frame, sink.prepare(frame))
    (tmp_path / 'mount').rename(tmp_path / 'away')
    (tmp_path / 'mount').write_text('not a folder')
    sink.close()
    assert gray_numbers(tmp_path / 'away' / 'out') == [0]
    assert (tmp_path / 'mount').read_text() == 'not a folder'


def test_file_without_its_manifest_line_is_removed(
        tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def fill_the_disk(file: int, data: Any) -> int:
        return write(file, data[:10] if data[:1] == b'{' else data)

    record(tmp_path, 1)
    write = os.write
    monkeypatch.setattr(os, 'write', fill_the_disk)
    recorder = record(tmp_path, 3, first=1)
    assert recorder.counts.failed == 3
    assert gray_numbers(tmp_path) == [0]
    assert len(read_manifest(tmp_path)) == 1


DIE_WITHIN = """
import os, pathlib, sys
from opencv_tools.recording.manifest import Manifest
from recordings import gray_frame, image_sink
owner, name = {'link': (os, 'link'), 'unlink': (pathlib.Path, 'unlink'),
               'append': (Manifest, 'append')}[sys.argv[2]]
setattr(owner, name, lambda *_: os._exit(9))
sink = image_sink(pathlib.Path(sys.argv[1]), '{seq}.png')
frame = gray_frame(5)
sink.commit(frame, sink.prepare(frame))
"""


def leave_behind(folder: Path, kill_in: str) -> None:
    """Record a frame in a process that ends in the middle of a call, like a killed one."""
    died = subprocess.run([sys.executable, '-c', DIE_WITHIN, str(folder), kill_in], check=False,
                          env={**os.environ, 'PYTHONPATH': os.pathsep.join(sys.path)},
                          timeout=LONGEST_SECONDS)
    assert died.returncode == 9


@pytest.mark.quick_cases(1)
@pytest.mark.process
@pytest.mark.parametrize(('kill_in', 'is_there'), [
    ('link', False), ('unlink', True), ('append', True)])
def test_leftovers_of_a_killed_recording_are_completed(
        tmp_path: Path, kill_in: str, is_there: bool) -> None:
    record(tmp_path, 1, '{seq}.png')
    leave_behind(tmp_path, kill_in)
    assert list(tmp_path.glob('.recording-*'))
    assert gray_numbers(tmp_path) == ([0, 5] if is_there else [0])
    record(tmp_path, 1, '{seq}.png', first=9)
    assert gray_numbers(tmp_path) == ([0, 5, 9] if is_there else [0, 9])
    read_manifest(tmp_path)
    assert not list(tmp_path.glob('.*'))


RECORD_UNTIL_KILLED = """
import itertools, logging, pathlib, sys
import numpy as np
from opencv_tools.recording.open_sink import open_sink
from opencv_tools.recording.frames import RawFrame
from opencv_tools.recording.naming import FileNames, FrameMetadata
from opencv_tools.recording.recorder import Recorder
from opencv_tools.recording.selection import Limits
from opencv_tools.recording.image_encoder import EncoderSettings

sink = open_sink(pathlib.Path(sys.argv[1]), FileNames('{seq:05d}.png'), EncoderSettings('.png'),
                  'continue', Limits(), False)
recorder = Recorder(sink, logging, writers=2, block=True)
for number in itertools.count():
    image = np.full((20, 20), number % 256, np.uint8)
    recorder.put(RawFrame(
        metadata=FrameMetadata(1, '', 'mono8', ''), receive_ns=1, image=image))
"""


@pytest.mark.thorough
@pytest.mark.process
def test_recording_killed_at_any_moment_leaves_whole_files(tmp_path: Path) -> None:
    moments = random.Random(5)
    checked: set[Path] = set()
    for _ in range(12):
        with subprocess.Popen(
                [sys.executable, '-c', RECORD_UNTIL_KILLED, str(tmp_path)]) as process:
            try:
                wait_until(lambda: len(recorded_files(tmp_path)) > len(checked), 'another file',
                           files=lambda: len(recorded_files(tmp_path)),
                           work=lambda: work_of(process.pid))
                assert process.poll() is None
                pause(moments.uniform(0, 0.02))
            finally:
                process.kill()
        for path in set(recorded_files(tmp_path)) - checked:
            picture = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
            assert picture is not None and picture.shape == (20, 20) and np.ptp(picture) == 0, path
            checked.add(path)
    record(tmp_path, 1, '{seq:05d}.png')
    assert [line['seq'] for line in sorted(read_manifest(tmp_path), key=lambda line: line['seq'])
            ] == list(range(len(checked) + 1))
    assert not list(tmp_path.glob('.*'))


def test_temporary_files_of_other_recordings_stay(tmp_path: Path) -> None:
    other = Folder(tmp_path)
    temporary = other.write((b'content',))
    record(tmp_path, 1)
    assert temporary.exists()
    other.close()


@pytest.mark.parametrize('suffix', ['.png', '.npy'])
def test_file_is_flushed_to_disk_before_it_is_renamed(
        suffix: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    done: list[str] = []

    def note(name: str, call: Callable[..., object]) -> Callable[..., object]:
        return lambda *args: (done.append(name), call(*args))[1]

    monkeypatch.setattr(os, 'fsync', note('fsync', os.fsync))
    monkeypatch.setattr(os, 'link', note('link', os.link))
    Folder(tmp_path).write((b'content',))
    for sync in (True, False):
        sink = open_sink(
            tmp_path, FileNames(f'{{seq}}{suffix}'), EncoderSettings(suffix), 'continue', Limits(),
            sync)
        recorder = Recorder(sink, Console(), writers=1)
        recorder.put(gray_frame(0))
        recorder.close()
    assert done == ['fsync', 'link', 'link']


def test_folder_that_is_read_only_after_a_rename(
        tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    sink, first, second = image_sink(tmp_path, '{seq:03d}.png'), gray_frame(0), gray_frame(1)
    images = sink.prepare(first), sink.prepare(second)
    with monkeypatch.context() as read_only:  # the manifest is not created, nothing is removed
        read_only.setattr(os, 'open', failing(errno.EACCES))
        read_only.setattr(os, 'unlink', failing(errno.EACCES))
        assert sink.commit(first, images[0]) == tmp_path / '000.png'
        with pytest.raises(PermissionError):
            sink.commit(second, images[1])
    assert not (tmp_path / FILE_NAME).exists()
    sink.commit(second, images[1])
    assert [line['seq'] for line in read_manifest(tmp_path)] == [0, 1]
    sink.close()
    assert sink.counts.kept == 2


def test_last_line_of_a_folder_that_was_read_only(
        tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    sink, frame = image_sink(tmp_path, '{seq:03d}.png'), gray_frame(0)
    prepared = sink.prepare(frame)
    with monkeypatch.context() as read_only:
        read_only.setattr(os, 'open', failing(errno.EACCES))
        read_only.setattr(os, 'unlink', failing(errno.EACCES))
        sink.commit(frame, prepared)
    sink.close()
    assert [line['seq'] for line in read_manifest(tmp_path)] == [0]


@pytest.mark.parametrize('number', [
    errno.EPERM, errno.EOPNOTSUPP, errno.ENOSYS, errno.EMLINK])
def test_nothing_is_overwritten_without_hard_links(
        tmp_path: Path, monkeypatch: pytest.MonkeyPatch, number: int) -> None:
    monkeypatch.setattr(os, 'link', failing(number))
    record(tmp_path, 2)
    (tmp_path / '002.png').write_text('mine')
    sink = image_sink(tmp_path, '{seq:03d}.png')
    (tmp_path / '003.png').write_text('mine too')
    frame = gray_frame(4)
    assert sink.commit(frame, sink.prepare(frame)).name == '004.png'
    sink.close()
    assert (tmp_path / '003.png').read_text() == 'mine too'
    lines = (tmp_path / 'manifest.jsonl').read_text().splitlines()
    assert [json.loads(line)['seq'] for line in lines] == [0, 1, 4]


def test_other_errors_of_links_are_reported(
        tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os, 'link', failing(errno.EIO))
    assert record(tmp_path, 2).counts.failed == 2
    assert not list(tmp_path.glob('*.png')) and not list(tmp_path.glob('.*'))


def test_file_system_without_locks_is_supported(
        tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(fcntl, 'flock', failing(errno.ENOLCK))
    record(tmp_path, 2)
    record(tmp_path, 1, first=2)
    assert gray_numbers(tmp_path) == [0, 1, 2]
    assert len(read_manifest(tmp_path)) == 3
    assert not list(tmp_path.glob('.*'))


def test_next_recording_adds_the_deferred_lines(tmp_path: Path) -> None:
    record(tmp_path, 3)
    entries = Manifest(tmp_path).entries()
    (tmp_path / 'manifest.jsonl').unlink()
    folder = Folder(tmp_path)
    for entry in entries[:2]:
        folder.defer_line(entry)
    folder.write_journal(entries[2])
    folder.write_journal(replace(entries[2], frame_id=''))  # shorter than the previous content
    os.close(folder._journal._file)  # like a process that ends
    Folder(tmp_path).close()
    assert [line['seq'] for line in read_manifest(tmp_path)] == [0, 1, 2]
    assert not list(tmp_path.glob('.*'))


def test_rest_of_a_longer_journal_is_ignored(tmp_path: Path) -> None:
    record(tmp_path, 3)
    entries = Manifest(tmp_path).entries()
    (tmp_path / 'manifest.jsonl').unlink()
    folder = Folder(tmp_path)
    folder.defer_line(entries[0])
    folder.write_journal(entries[1])
    folder.write_deferred()
    folder.write_journal(entries[0])
    os.close(folder._journal._file)
    Folder(tmp_path).close()
    assert [entry.seq for entry in Manifest(tmp_path).entries()] == [0]


def test_line_of_a_removed_file_is_not_added(tmp_path: Path) -> None:
    record(tmp_path, 2)
    entries = Manifest(tmp_path).entries()
    folder = Folder(tmp_path)
    for name in ('manifest.jsonl', '000.png'):
        (tmp_path / name).unlink()
    for entry in entries:
        folder.defer_line(entry)
    folder.write_deferred()
    folder.close()
    assert [line['seq'] for line in read_manifest(tmp_path)] == [1]


def test_no_file_descriptor_stays_open(tmp_path: Path) -> None:
    before = len(list(Path('/proc/self/fd').iterdir()))
    (tmp_path / '.recording-abandoned-.journal').touch()
    (tmp_path / '.recording-abandoned-0.part').touch()
    record(tmp_path, 3)
    assert not list(tmp_path.glob('.*'))
    assert len(list(Path('/proc/self/fd').iterdir())) == before


def test_files_have_the_mode_of_the_umask(tmp_path: Path) -> None:
    before = os.umask(0o026)
    try:
        sink = image_sink(tmp_path, '{seq}.png')
        frame = gray_frame(0)
        sink.commit(frame, sink.prepare(frame))
        modes = {path.suffix: path.stat().st_mode & 0o777 for path in tmp_path.iterdir()}
        sink.close()
    finally:
        os.umask(before)
    assert modes == {'.png': 0o640, '.jsonl': 0o640, '.journal': 0o640}


def test_folder_that_cannot_be_cleaned_up_is_left_unchanged(
        tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def open_some(path: Path, *args: Any) -> int:
        if 'abandoned' in path.name:
            raise PermissionError(errno.EACCES, 'Permission denied')
        return open_file(path, *args)

    open_file = os.open
    abandoned = tmp_path / '.recording-abandoned-.journal'
    abandoned.touch()
    monkeypatch.setattr(os, 'open', open_some)
    with pytest.raises(PermissionError):
        Folder(tmp_path)
    assert list(tmp_path.iterdir()) == [abandoned]


def test_leftovers_removed_by_another_recording_are_skipped(
        tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def clean_up_and_lock(file: int, how: int) -> None:
        locked.append(file)
        for path in listed[2 * (len(locked) < 2):]:  # the first lock is on its own journal
            path.unlink()
        lock(file, how)

    lock, locked = fcntl.flock, []
    for name in ('.journal', '0.part'):
        (tmp_path / f'.recording-abandoned-{name}').touch()
    real_glob = Path.glob
    listed = [*tmp_path.glob('.recording-abandoned*')]
    monkeypatch.setattr(Path, 'glob', lambda path, pattern: iter(
        listed if pattern == '.recording-*' else real_glob(path, pattern)))
    monkeypatch.setattr(fcntl, 'flock', clean_up_and_lock)
    Folder(tmp_path).close()
    assert not list(real_glob(tmp_path, '.recording-*'))


def test_two_recordings_that_begin_at_once_clean_up(
        tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def open_after_another(path: Path, *args: Any) -> int:
        if 'abandoned' in path.name:
            path.unlink()
        return open_file(path, *args)

    open_file = os.open
    abandoned = tmp_path / '.recording-abandoned-.journal'
    abandoned.touch()
    monkeypatch.setattr(os, 'open', open_after_another)
    record(tmp_path, 1)
    assert not list(tmp_path.glob('.*'))


@pytest.mark.parametrize('name', ['.journal', 'manifest.jsonl'])
def test_file_removed_after_its_creation_is_created_again(
        tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str) -> None:
    def open_and_remove(path: str | Path, *args: Any) -> int:
        file = open_file(path, *args)
        if str(path).endswith(name) and not removed:
            removed.append(path)
            Path(path).unlink()
        return file

    open_file, removed = os.open, []
    monkeypatch.setattr(os, 'open', open_and_remove)
    sink = image_sink(tmp_path, '{seq}.png')
    assert len(list(tmp_path.glob('.*.journal'))) == 1
    frame = gray_frame(0)
    sink.commit(frame, sink.prepare(frame))
    sink.close()
    assert removed
    assert len(read_manifest(tmp_path)) == 1
    assert not list(tmp_path.glob('.*'))


@pytest.mark.parametrize(('name', 'kind', 'suffix'), [
    (FILE_NAME, 'link', '.mkv'), (FILE_NAME, 'fifo', '.png'), (FILE_NAME, 'folder', '.mkv'),
    (JOURNAL, 'link', '.png'), (JOURNAL, 'socket', '.mkv'), (JOURNAL, 'device', '.png')])
def test_non_regular_manifest_or_journal_is_refused(
        tmp_path: Path, name: str, kind: str, suffix: str) -> None:
    folder, victim = tmp_path / 'out', tmp_path / 'victim'
    folder.mkdir()
    victim.write_bytes(manifest_line())
    if kind == 'link':
        (folder / name).symlink_to(victim)
    else:
        KINDS[kind][0](folder / name)
    with pytest.raises(RecordingError, match=r'^output_dir .*/out cannot be used') as caught:
        record_ring(folder, suffix)
    links = ('link', 'device')  # a link to a device counts as a link
    reason = 'is a symbolic link, not a regular file' if kind in links else KINDS[kind][1]
    reason = reason if kind == 'folder' else f'{name} {reason}'
    assert str(caught.value).endswith(f'cannot be used: {reason}')
    assert [path.name for path in folder.iterdir()] == [name]
    assert victim.read_bytes() == manifest_line()


@pytest.mark.parametrize('name', ['../victim', 'link', 'pipe'])
def test_journal_entry_outside_the_folder_is_ignored(tmp_path: Path, name: str) -> None:
    folder = tmp_path / 'out'
    folder.mkdir()
    (tmp_path / 'victim').write_text('precious')
    (folder / 'link').symlink_to('../victim')
    os.mkfifo(folder / 'pipe')
    (folder / JOURNAL).write_bytes(manifest_line(file=name, sha256=''))
    Folder(folder).close()
    assert {path.name for path in folder.iterdir()} == {'link', 'pipe'}


def test_journal_without_a_number_removes_nothing(tmp_path: Path) -> None:
    other = Folder(tmp_path)
    temporary = other.write((b'content',))
    (tmp_path / '.recording-.journal').touch()
    Folder(tmp_path).close()
    assert temporary.exists()
    other.close()


DIGEST = hashlib.sha256(b'content').hexdigest()


def add_file(folder: Path, name: str = 'a.png', **fields: object) -> ManifestEntry:
    """Write a file of seven bytes, and return its entry."""
    (folder / name).write_bytes(b'content')
    return parse_line(manifest_line(file=name, bytes=7, sha256=DIGEST, **fields))


def leave_entry(folder: Path, entry: ManifestEntry) -> None:
    """Write the journal of a killed recording."""
    (folder / JOURNAL).write_bytes(entry.line())


def hidden(folder: Path) -> list[str]:
    return [path.suffix for path in folder.glob('.*')]


@pytest.mark.parametrize(('name', 'found', 'frames'), [
    ('a.MKV', 7, 7), ('a.MKV', 1, 1), ('a.MKV', None, 0), ('a.png', 7, 0)])
def test_file_that_is_finished_after_a_kill(
        tmp_path: Path, name: str, found: int | None, frames: int) -> None:
    entry = add_file(tmp_path, name, frames=3)
    leave_entry(tmp_path, replace(entry, size=0, sha256=''))
    finished = []
    Folder(tmp_path, finishers={'.mkv': lambda path: finished.append(path) or found}).close()
    assert finished == [tmp_path / name][:name == 'a.MKV']
    assert Manifest(tmp_path).entries() == [replace(entry, frames=frames)]
    assert hidden(tmp_path) == []


def test_file_without_frames_is_removed_after_a_kill(tmp_path: Path) -> None:
    entry = add_file(tmp_path, 'a.mkv')
    leave_entry(tmp_path, replace(entry, sha256=''))
    Folder(tmp_path, finishers={'.mkv': lambda _: 0}).close()
    assert [*tmp_path.iterdir()] == []


def test_finished_file_is_not_finished_again(tmp_path: Path) -> None:
    entry = add_file(tmp_path, 'a.mkv', frames=3)
    leave_entry(tmp_path, entry)
    Folder(tmp_path, finishers={'.mkv': lambda _: 0}).close()
    assert Manifest(tmp_path).entries() == [entry]


def test_entry_of_another_content_is_not_added(tmp_path: Path) -> None:
    leave_entry(tmp_path, replace(add_file(tmp_path), sha256='00'))
    Folder(tmp_path).close()
    assert [path.name for path in tmp_path.iterdir()] == ['a.png']


@pytest.mark.parametrize(('name', 'digest', 'numbers'), [
    ('a.png', DIGEST, [4]),  # the manifest has the line
    ('b.png', DIGEST, [4, 9]), ('a.png', '00', [9])])
@pytest.mark.parametrize('is_finished', [False, True])
def test_entry_beside_a_line_of_the_manifest(
        tmp_path: Path, name: str, digest: str, numbers: list[int], is_finished: bool) -> None:
    Manifest(tmp_path).append(replace(add_file(tmp_path, name), seq=4, sha256=digest))
    entry = add_file(tmp_path, seq=9)
    leave_entry(tmp_path, entry if is_finished else replace(entry, sha256=''))
    Folder(tmp_path).close()
    assert [line.seq for line in Manifest(tmp_path).entries()] == numbers


def test_digest_of_a_long_unfinished_file(tmp_path: Path) -> None:
    entry = replace(add_file(tmp_path), sha256='')
    os.truncate(tmp_path / 'a.png', 2**30 + 1)  # without blocks on the disk
    leave_entry(tmp_path, entry)
    Folder(tmp_path).close()
    assert Manifest(tmp_path).entries() == [replace(entry, size=2**30 + 1, frames=0)]


@pytest.mark.parametrize(('most', 'is_finished', 'has_digest'), [
    (7, False, True), (6, False, False), (6, True, True)])
def test_longest_file_with_a_digest(
        tmp_path: Path, monkeypatch: pytest.MonkeyPatch, most: int, is_finished: bool,
        has_digest: bool) -> None:
    monkeypatch.setattr(folder_module, '_MAX_HASHED_BYTES', most)
    entry = add_file(tmp_path)
    leave_entry(tmp_path, entry if is_finished else replace(entry, sha256=''))
    Folder(tmp_path).close()
    assert [line.sha256 for line in Manifest(tmp_path).entries()] == [DIGEST if has_digest else '']


@pytest.mark.parametrize('replaced', [False, True])
def test_published_file_and_its_line(tmp_path: Path, replaced: bool) -> None:
    entry = add_file(tmp_path)
    folder = Folder(tmp_path)
    temporary = folder.write((b'con', b'tents'))
    assert (temporary.read_bytes(), folder.path) == (b'contents', tmp_path)
    if replaced:
        assert folder.publish(temporary, entry, replace=True) == tmp_path / 'a.png'
        assert folder.manifest.entries() == [entry]
    else:
        with pytest.raises(FileExistsError):
            folder.publish(temporary, entry, replace=False)
        assert not (tmp_path / FILE_NAME).exists()
    assert (tmp_path / 'a.png').read_bytes() == (b'contents' if replaced else b'content')
    assert temporary.exists() is not replaced
    folder.close()


def test_temporary_name_after_the_publication(
        tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = Folder(tmp_path)
    entry = parse_line(manifest_line())
    folder.publish(folder.write((b'content',)), entry, replace=False)
    assert hidden(tmp_path) == ['.journal']
    temporary = folder.write((b'content',))
    with monkeypatch.context() as patch:
        patch.setattr(os, 'unlink', failing(errno.EROFS))
        folder.publish(temporary, replace(entry, name='b.png'), replace=False)
    assert [line.name for line in folder.manifest.entries()] == ['a.png', 'b.png']
    assert temporary.samefile(tmp_path / 'b.png')  # the next recording removes the first name
    folder.close()


def test_file_is_renamed_without_hard_links(
        tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os, 'link', failing(errno.EMLINK))
    folder = Folder(tmp_path)
    temporary = folder.write((b'content',))
    target = folder.publish(temporary, parse_line(manifest_line()), replace=False)
    assert (target.name, target.read_bytes()) == ('a.png', b'content')
    assert hidden(tmp_path) == ['.journal']
    folder.close()


def test_journal_has_the_line_before_the_manifest(
        tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def read_journal(*_: object) -> None:
        (journal,) = tmp_path.glob('.*.journal')
        found.append((journal.read_bytes(), (tmp_path / 'a.png').exists()))

    found: list[tuple[bytes, bool]] = []
    monkeypatch.setattr(Manifest, 'append', read_journal)
    folder, entry = Folder(tmp_path), parse_line(manifest_line())
    folder.publish(folder.write(()), entry, replace=False)
    folder.close()
    assert found == [(entry.line() + b'\n', True)]


@pytest.mark.parametrize('is_link', [False, True])
def test_existing_name_without_hard_links(
        tmp_path: Path, monkeypatch: pytest.MonkeyPatch, is_link: bool) -> None:
    target = tmp_path / 'a.png'
    if is_link:
        target.symlink_to('nothing')
    else:
        target.touch()
    monkeypatch.setattr(os, 'link', failing(errno.EPERM))
    folder = Folder(tmp_path)
    with pytest.raises(FileExistsError) as caught:
        folder.publish(folder.write(()), parse_line(manifest_line()), replace=False)
    folder.close()
    error = caught.value
    assert (error.errno, error.strerror, error.filename) == (
        errno.EEXIST, 'File exists', str(target))


def test_file_that_disappears_before_its_line(
        tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def remove_and_fail(*_: object) -> None:
        (tmp_path / 'a.png').unlink()
        raise OSError(errno.ENOSPC, 'full')

    monkeypatch.setattr(Manifest, 'append', remove_and_fail)
    folder = Folder(tmp_path)
    with pytest.raises(OSError, match='full'):
        folder.publish(folder.write(()), parse_line(manifest_line()), replace=False)
    folder.close()


def test_folder_that_is_not_removed_is_created_again(tmp_path: Path) -> None:
    folder = Folder(tmp_path / 'out')
    (journal,) = (tmp_path / 'out').iterdir()
    folder.recreate()
    assert [*(tmp_path / 'out').iterdir()] == [journal]
    journal.unlink()
    folder.recreate()
    assert hidden(tmp_path / 'out') == ['.journal']
    folder.close()


def test_most_deferred_lines(tmp_path: Path) -> None:
    folder = Folder(tmp_path)
    for number in range(102):
        folder.defer_line(add_file(tmp_path, f'{number}.png', seq=number))
    folder.write_deferred()
    assert [line.seq for line in folder.manifest.entries()] == [*range(2, 102)]
    folder.write_deferred()
    assert len(folder.manifest.entries()) == 100
    folder.close()
    assert hidden(tmp_path) == []


def test_deferred_line_of_an_unfinished_file(tmp_path: Path) -> None:
    entry = add_file(tmp_path)
    folder = Folder(tmp_path)
    folder.defer_line(replace(entry, size=0, sha256=''))
    folder.write_deferred()
    assert folder.manifest.entries() == [replace(entry, frames=0)]
    folder.close()


def test_deferred_lines_of_a_full_disk(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    entries = [add_file(tmp_path, name) for name in ('a.png', 'b.png')]
    folder = Folder(tmp_path)
    for entry in entries:
        folder.defer_line(entry)
    with monkeypatch.context() as patch:
        patch.setattr(Manifest, 'append', failing(errno.ENOSPC))
        with pytest.raises(OSError, match='No space left on device'):
            folder.write_deferred()
    folder.close()
    assert hidden(tmp_path) == ['.journal']  # for the next recording
    Folder(tmp_path).close()
    assert (Manifest(tmp_path).entries(), hidden(tmp_path)) == (entries, [])


@pytest.mark.parametrize('frames', [0, 5])
def test_line_of_a_changed_file(tmp_path: Path, frames: int) -> None:
    folder = Folder(tmp_path)
    for number, name in enumerate(('a.png', 'b.png', 'a.png', 'c.png')):
        folder.manifest.append(add_file(tmp_path, name, seq=number))
    (tmp_path / 'a.png').write_bytes(b'longer content')
    folder.update_line('a.png', frames)
    lines = {line.seq: line for line in folder.manifest.entries()}
    assert sorted(lines) == [1, 2, 3]  # the last line of the file counts
    assert (lines[2].name, lines[2].frames, lines[2].size, lines[2].sha256) == (
        'a.png', frames, 14, hashlib.sha256(b'longer content').hexdigest())
    folder.close()


@pytest.mark.parametrize(('name', 'frames'), [('a.png', None), ('b.png', 5)])
def test_line_of_an_unchanged_file(tmp_path: Path, name: str, frames: int | None) -> None:
    folder = Folder(tmp_path)
    entry = add_file(tmp_path)
    folder.manifest.append(entry)
    (tmp_path / 'a.png').write_bytes(b'longer content')
    folder.update_line(name, frames)
    assert folder.manifest.entries() == [entry]
    folder.close()


def test_stale_lines_are_removed(tmp_path: Path) -> None:
    folder = Folder(tmp_path)
    for name in ('000.png', '001.png', 'other.png', '000.png'):
        folder.manifest.append(add_file(tmp_path, name))
    for name in ('001.png', 'other.png'):
        (tmp_path / name).unlink()
    folder.remove_stale_lines(FileNames('{seq:03d}.png'))
    assert [line.name for line in folder.manifest.entries()] == ['000.png', 'other.png']
    folder.close()
