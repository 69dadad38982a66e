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

"""The file that keeps the token."""

from __future__ import annotations

import os
from pathlib import Path
import re
import stat

from opencv_tools.viewer.access import read_token
from opencv_tools.viewer.errors import ViewerError
import pytest


def test_token_that_is_created_and_kept(tmp_path: Path) -> None:
    path = tmp_path / 'token'
    token = read_token(str(path))
    assert re.fullmatch(r'[\w-]{24}', token)
    assert read_token(str(path)) == token
    assert stat.S_IMODE(path.stat().st_mode) == 0o600


def test_token_of_a_user(tmp_path: Path) -> None:
    path = tmp_path / 'token'
    path.write_text('open-sesame\n')
    path.chmod(0o400)
    assert read_token(str(path)) == 'open-sesame'


@pytest.mark.parametrize('mode', [0o644, 0o640, 0o606, 0o620, 0o700])
def test_token_that_others_can_read(tmp_path: Path, mode: int) -> None:
    path = tmp_path / 'token'
    path.write_text('open-sesame')
    path.chmod(mode)
    with pytest.raises(ViewerError, match=rf'others can read it \(mode {mode:o}\); run chmod 600'):
        read_token(str(path))
    assert path.read_text() == 'open-sesame'


@pytest.mark.parametrize('text', [
    '', 'auto', 'short', 'two\nlines of text', 'x' * 10_000, '\0' * 9])
def test_file_without_a_token(tmp_path: Path, text: str) -> None:
    path = tmp_path / 'token'
    path.write_text(text)
    path.chmod(0o600)
    with pytest.raises(ViewerError, match='it has no token'):
        read_token(str(path))


def test_paths_that_cannot_hold_a_token(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / 'pipe', 0o600)
    for path, reason in ((tmp_path, 'Is a directory'), (tmp_path / 'pipe', 'it is not a regular'),
                         (tmp_path / 'no' / 'token', 'No such file'), ('/proc/token', 'No such'),
                         ('a\0b', 'embedded null')):
        with pytest.raises(ViewerError, match=reason):
            read_token(str(path))
