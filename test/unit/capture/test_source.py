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

"""Sources by their text, and texts that name no source."""

from __future__ import annotations

import os
from pathlib import Path

from conftest import CLIP, CLIP_FRAMES
from opencv_tools.capture.errors import CaptureError
from opencv_tools.capture.source import check_source, expected_size, open_source
from opencv_tools.capture.video import VideoSource
from playback import frames_of
import pytest
from special_files import KINDS


@pytest.mark.parametrize('text', [
    '', 'pattern:', 'pattern:640', 'pattern:0x480', 'pattern:640x480@0', 'pattern:640x480@1001',
    'pattern:99999x1', 'pattern:-1x5', 'pattern:640x480@30@30'])
def test_invalid_source_texts_are_refused(text: str) -> None:
    with pytest.raises(ValueError):
        check_source(text)


def test_video_can_be_a_file_url() -> None:
    source = open_source(f'file://{CLIP}')
    assert source.skip() and not source.live
    assert len(list(frames_of(source))) == CLIP_FRAMES - 1


def test_expected_size_closes_the_file(monkeypatch: pytest.MonkeyPatch) -> None:
    closed: list[str] = []
    monkeypatch.setattr(VideoSource, 'close', lambda source: closed.append(source.name))
    assert expected_size(str(CLIP)) == (1280, 720)
    assert closed == [str(CLIP)]


@pytest.mark.parametrize(('name', 'text'), [
    ('none.mp4', 'No such file or directory'), ('text.mp4', 'cannot be opened as a video'),
    ('empty.mp4', 'cannot be opened as a video'), ('folder', 'no image file in'),
    ('*.png', 'No such file or directory'), ('*.txt', 'no image file in'),
    ('loop', 'Too many levels of symbolic links'), ('loop/a.mp4', 'Too many levels of symbolic'),
    ('loop.mcap', 'Too many levels of symbolic links'), ('broken', 'No such file or directory'),
])
def test_files_that_are_not_sources_are_refused(tmp_path: Path, name: str, text: str) -> None:
    (tmp_path / 'text.mp4').write_text('hello')
    (tmp_path / 'some.txt').write_text('hello')
    (tmp_path / 'empty.mp4').touch()
    for link, target in (('loop', 'loop'), ('loop.mcap', 'loop.mcap'), ('broken', 'none')):
        (tmp_path / link).symlink_to(target)
    (tmp_path / 'folder').mkdir()
    with pytest.raises(CaptureError, match=text):
        open_source(str(tmp_path / name))


@pytest.mark.parametrize('suffix', ['.mcap', '.db3'])
def test_folder_of_bags_without_metadata(tmp_path: Path, suffix: str) -> None:
    for name in ('b', 'a'):
        (tmp_path / f'{name}{suffix}').touch()
    with pytest.raises(CaptureError) as caught:
        open_source(str(tmp_path))
    assert str(caught.value) == (
        f'{tmp_path} has no image file, and its bags have no metadata.yaml; give one of them, or '
        f"all as '{tmp_path}/*{suffix}'")


@pytest.mark.parametrize(('text', 'hint'), [
    ('patern', '; did you mean pattern?'), ('Pattern', '; did you mean pattern?'),
    ('pattren:320x240@5', '; did you mean pattern:320x240@5?'),
    ('lantern', ''), ('pat', ''), ('patterns/in.mp4', ''), ('patern/*.png', '')])
def test_mistyped_pattern_gets_a_hint(
        tmp_path: Path, monkeypatch: pytest.MonkeyPatch, text: str, hint: str) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.raises(CaptureError) as caught:
        open_source(text)
    assert str(caught.value) == f'{text} cannot be opened: No such file or directory{hint}'


def test_existing_file_named_like_pattern_is_opened(
        tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    Path('patern').write_text('hello')
    with pytest.raises(CaptureError) as caught:
        open_source('patern')
    assert str(caught.value) == (
        'patern cannot be opened as a video: it is damaged or not a video')


@pytest.mark.parametrize(('kind', 'name', 'reason'), [
    ('fifo', 'x.png', 'x.png is a named pipe; give a file or a folder'),
    ('socket', 'x.png', 'x.png is a socket; give a file or a folder'),
    ('socket', 'x.mp4', 'x.mp4 is a socket; give a file or a folder'),
    ('device', 'x.png', 'x.png is not a camera'),
    ('folder', 'x.png', 'no image file in .*x.png')])
def test_non_regular_files_are_refused_as_a_source(
        tmp_path: Path, kind: str, name: str, reason: str) -> None:
    KINDS[kind][0](tmp_path / name)
    with pytest.raises(CaptureError, match=reason):
        open_source(str(tmp_path / name))


@pytest.mark.parametrize('form', ['{}', 'file://{}'])
def test_named_pipe_is_not_read_for_its_size(
        tmp_path: Path, monkeypatch: pytest.MonkeyPatch, form: str) -> None:
    def _open(path: str) -> None:
        opened.append(path)
        raise CaptureError('no video')

    opened: list[str] = []
    monkeypatch.setattr('opencv_tools.capture.source.open_container', _open)
    os.mkfifo(tmp_path / 'pipe')
    text = form.format(tmp_path / 'pipe')
    assert expected_size(text) is None
    assert not opened
    with pytest.raises(CaptureError, match='no video'):
        open_source(text)  # because the pipe may contain a video
    assert opened == [str(tmp_path / 'pipe')]
