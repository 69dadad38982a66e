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

"""File names: valid and invalid templates, and names from hostile messages."""

from __future__ import annotations

from contextlib import nullcontext
import re

from hypothesis import given, settings, strategies as st
from opencv_tools.recording.naming import check_folder, FileNames, FrameMetadata, numbered_copy
import pytest

FRAME = FrameMetadata(
    1700000000_000000042, 'camera/left', '16UC1; png compressed ', '/front/video_frames')


@pytest.mark.parametrize(('template', 'name', 'suffix'), [
    ('{seq:06d}.png', '000042.png', '.png'),
    ('{seq}.JPG', '42.JPG', '.jpg'),
    ('a[{seq:d}]+b.tiff', 'a[42]+b.tiff', '.tiff'),
    ('{seq}_{seq:03d}.npy', '42_042.npy', '.npy'),
    ('{stamp}_{seq}.png', '1700000000.000000042_42.png', '.png'),
    ('{stamp:.3f}_{seq}.png', '1700000000.000_42.png', '.png'),
    ('{sec}_{nanosec}_{seq}.png', '1700000000_000000042_42.png', '.png'),
    ('{frame_id}-{seq}.png', 'camera_left-42.png', '.png'),
    ('{topic}{seq:d}.png', 'front_video_frames42.png', '.png'),
    ('{encoding}.{seq}.png', '16UC1__png_compressed_.42.png', '.png'),
    ('{{{seq}}}.png', '{42}.png', '.png'),
])
def test_file_names_of_templates(template: str, name: str, suffix: str) -> None:
    names = FileNames(template)
    assert names.name(42, FRAME) == name
    assert names.suffix == suffix
    assert names.is_numbered
    assert names.matches(name) and not names.matches(f'{name}~')
    assert names.next_seq([name, names.name(7, FRAME), 'other.txt', f'x/{name}', '']) == 43
    assert names.next_seq([]) == 0


@pytest.mark.parametrize(('template', 'name'), [
    ('x.png', 'x.png'), ('{stamp}.png', '1700000000.000000042.png'), ('{frame_id}.png',
                                                                      'camera_left.png')])
def test_file_names_without_a_number(template: str, name: str) -> None:
    names = FileNames(template)
    assert names.name(42, FRAME) == name
    assert names.matches(name) and names.matches(numbered_copy(name, 12))
    assert not names.is_numbered
    assert names.next_seq([name]) == 0
    assert names.name(0, FRAME) == name


def test_copies_are_numbered_before_the_extension() -> None:
    assert numbered_copy('clip.front.mp4', 2) == 'clip.front_2.mp4'


def test_missing_stamp_is_written_as_zeros() -> None:
    unstamped = FrameMetadata(0, '', '', '')
    assert FileNames('{stamp}.png').name(0, unstamped) == '0.000000000.png'
    assert FileNames('{frame_id}.png').name(0, unstamped) == '_.png'


@pytest.mark.parametrize('template', [
    '{}.png', '{other}.png', '{seq', '{seq:x}.png', '{seq:q}.png', '{seq:+d}.png', 'a/{seq}.png',
    '../{seq}.png', '.{seq}.png', '{seq.real}.png', '{seq:,}.png', '{0}.png', '{seq!r}.png',
    '{frame_id:d}.png', '{stamp:{seq}}.png', 'a\0{seq}.png', '{frame_id.__class__}{seq}.png'])
def test_invalid_templates_are_refused(template: str) -> None:
    with pytest.raises(ValueError):
        FileNames(template)


@pytest.mark.parametrize(('path', 'field'), [
    ('{topic}', '{topic}'), ('/a/x{seq:06d}/b', '{seq:06d}'), ('a/{sec', ''), ('a/{seconds}', ''),
    ('a/{sec/b}', ''), ('a/{x}', ''), ('seq', ''), ('', '')])
def test_fields_in_a_folder(path: str, field: str) -> None:
    with pytest.raises(ValueError, match=re.escape(field)) if field else nullcontext():
        check_folder(path)


@settings(deadline=None)
@given(st.text(), st.text(), st.text())
def test_message_cannot_name_a_file_outside_the_folder(
        frame_id: str, encoding: str, topic: str) -> None:
    metadata = FrameMetadata(0, frame_id, encoding, topic)
    name = FileNames('{frame_id}{encoding}{topic}.png').name(0, metadata)
    assert name.isascii() and name.isprintable()
    assert not set(name) & set('/\\ "\'$`;&|<>*?\n')
    assert name[0] not in '.-~'
    assert len(name) < 255


@pytest.mark.parametrize('frame_id', ['../../etc/passwd', '..', '/etc/cron.d/x', '.bashrc', '-rf',
                                      'a\0b', 'x' * 10_000])
def test_hostile_frame_ids_become_ordinary_names(frame_id: str) -> None:
    name = FileNames('{frame_id}.png').name(0, FrameMetadata(0, frame_id, '', ''))
    assert '/' not in name and '\0' not in name
    assert name[0] not in '.-'
    assert len(name) <= 68
