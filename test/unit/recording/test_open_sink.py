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

"""The sink of a recording: output folders and formats that are refused."""

from __future__ import annotations

from pathlib import Path

from opencv_tools.recording.errors import RecordingError, VideoError
from opencv_tools.recording.image_encoder import EncoderSettings
from opencv_tools.recording.naming import FileNames
from opencv_tools.recording.open_sink import check_format, open_sink
from opencv_tools.recording.selection import Limits
import pytest
from recordings import NO_LIMITS, open_videos, record


@pytest.mark.parametrize(('kind', 'sentence'), [
    ('file', 'it is a file or a broken link; set output_dir to a folder'),
    ('link', 'it is a file or a broken link; set output_dir to a folder'),
    ('loop', 'it is a file or a broken link; set output_dir to a folder'),
    ('below a loop', 'its path contains a loop of links; set output_dir to another folder'),
    ('long', 'it is too long for the file system; set output_dir to a shorter path')])
def test_unusable_output_dir_is_refused_with_a_remedy(
        kind: str, sentence: str, tmp_path: Path) -> None:
    path = tmp_path / ('a' * 256 if kind == 'long' else 'out')
    if kind == 'file':
        path.touch()
    elif kind != 'long':
        path.symlink_to(path if 'loop' in kind else path.with_name('nowhere'))
    if kind == 'below a loop':
        path /= 'out'
    with pytest.raises(RecordingError) as raised:
        open_sink(path, FileNames('{seq}.png'), EncoderSettings('.png'), 'continue', Limits(),
                  sync=False)
    assert str(raised.value).startswith('output_dir ')
    assert str(raised.value).endswith(f' cannot be used: {sentence}')


def test_output_dir_that_cannot_be_created_is_refused(tmp_path: Path) -> None:
    (tmp_path / 'file').touch()
    with pytest.raises(RecordingError, match=r'output_dir .*/file/out cannot be used'):
        record(tmp_path / 'file' / 'out', 1)


@pytest.mark.parametrize('suffix', ['.png', '.mkv'])
def test_unreadable_manifest_is_refused(tmp_path: Path, suffix: str) -> None:
    (tmp_path / 'manifest.jsonl').mkdir()
    with pytest.raises(RecordingError, match=r'output_dir .* cannot be used: Is a directory$'):
        open_sink(tmp_path, FileNames(f'x{suffix}'), EncoderSettings(suffix), 'continue',
                  NO_LIMITS, False)
    assert not list(tmp_path.glob('.*'))


def test_missing_pyav_refuses_videos_only(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def find_nothing() -> None:
        raise VideoError('install it')

    monkeypatch.setattr('opencv_tools.recording.open_sink.check_video', find_nothing)
    with pytest.raises(VideoError, match=r'^install it$'):
        check_format('.mkv')
    with pytest.raises(RecordingError, match=r'^install it$'):
        open_videos(tmp_path / 'out')
    assert not (tmp_path / 'out').exists()
    check_format('.png')
    open_videos(tmp_path / 'out', 'x.png').close()
    with pytest.raises(ValueError, match=r"^the extension '\.gif' .* \.png, .*\.npy, \.mp4, "):
        check_format('.gif')
