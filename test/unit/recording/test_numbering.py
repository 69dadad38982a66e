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

"""Numbers and names of new files, beside existing ones."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
import threading

from conftest import read_manifest, recorded_files
from console import Console
from opencv_tools.recording.errors import RecordingError
from opencv_tools.recording.image_encoder import EncoderSettings
from opencv_tools.recording.naming import FileNames
from opencv_tools.recording.open_sink import open_sink
from opencv_tools.recording.recorder import Recorder
from opencv_tools.recording.selection import Limits
import pytest
from recordings import gray_frame, gray_numbers, image_sink, record
from waiting import join


@pytest.mark.parametrize('suffix', ['.png', '.mp4'])
def test_long_file_name_is_reported_with_a_remedy(suffix: str, tmp_path: Path) -> None:
    console = Console()
    names = FileNames('a' * 251 + '{seq}' + suffix)
    sink = open_sink(tmp_path, names, EncoderSettings(suffix), 'continue', Limits(), sync=False)
    recorder = Recorder(sink, console, writers=1)
    recorder.put(gray_frame(0))
    recorder.close()
    assert recorder.counts.failed == 1
    assert [line for line in console.lines if 'too long' in line] == [
        f'error: a frame was not written: the file name {"a" * 37}... has 256 bytes, too long for '
        'the file system (usually 255); shorten file_name']


@pytest.mark.parametrize(('template', 'names'), [
    ('{seq:03d}.png', ['000.png', '001.png', '002.png', '003.png']),
    ('x.png', ['x.png', 'x_1.png', 'x_2.png', 'x_3.png']),
    ('{frame_id}.png', ['camera.png', 'camera_1.png', 'camera_2.png', 'camera_3.png'])])
def test_second_recording_continues(tmp_path: Path, template: str, names: list[str]) -> None:
    record(tmp_path, 2, template)
    record(tmp_path, 2, template, first=2)
    assert gray_numbers(tmp_path) == [0, 1, 2, 3]
    lines = read_manifest(tmp_path)
    assert [line['file'] for line in lines] == names
    assert [line['seq'] for line in lines] == [0, 1, 2, 3]


@pytest.mark.parametrize('count', [1, 3])
def test_numbers_continue_after_files_were_removed(tmp_path: Path, count: int) -> None:
    record(tmp_path, count)
    for path in recorded_files(tmp_path):
        path.unlink()
    record(tmp_path, 1)
    assert [path.name for path in recorded_files(tmp_path)] == [f'{count:03d}.png']


def test_copies_are_numbered_for_each_name(tmp_path: Path) -> None:
    sink = image_sink(tmp_path, '{frame_id}.png')
    gray = gray_frame(0)
    frames = [replace(gray, metadata=replace(gray.metadata, frame_id=name))
              for name in ('a', 'a', 'a', 'b', 'b', 'a')]
    paths = [sink.commit(frame, sink.prepare(frame)) for frame in frames]
    sink.close()
    assert [path.name for path in paths] == [
        'a.png', 'a_1.png', 'a_2.png', 'b.png', 'b_1.png', 'a_3.png']


def test_two_simultaneous_recordings_share_a_folder(tmp_path: Path) -> None:
    threads = [threading.Thread(target=record, args=(tmp_path, 40)) for _ in range(2)]
    for thread in threads:
        thread.start()
    for thread in threads:
        join(thread)
    assert sorted(gray_numbers(tmp_path)) == sorted([*range(40)] * 2)
    assert len(read_manifest(tmp_path)) == 80


def test_files_are_overwritten_on_request(tmp_path: Path) -> None:
    record(tmp_path, 3)
    record(tmp_path, 2, on_exists='overwrite', first=10)
    assert gray_numbers(tmp_path) == [10, 11, 2]
    assert len(read_manifest(tmp_path)) == 3


def test_existing_files_can_be_an_error(tmp_path: Path) -> None:
    (tmp_path / 'other.txt').touch()
    record(tmp_path, 2, on_exists='error')
    with pytest.raises(RecordingError, match=r'already contains 000\.png; set output_dir'):
        record(tmp_path, 2, on_exists='error')
    assert len([path for path in tmp_path.iterdir() if path.name.startswith('.')]) == 0


def test_file_of_another_program_is_not_changed(tmp_path: Path) -> None:
    names = FileNames('{seq}.png')
    recorder = Recorder(
        open_sink(tmp_path, names, EncoderSettings('.png'), 'error', Limits(), False), Console())
    (tmp_path / '0.png').write_text('mine')
    recorder.put(gray_frame(1))
    recorder.close()
    assert recorder.counts.failed == 1
    assert (tmp_path / '0.png').read_text() == 'mine'
