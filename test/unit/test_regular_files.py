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

"""Reading of regular files only, and atomic writing of files."""

from __future__ import annotations

from collections.abc import Iterator
import errno
import io
import os
from pathlib import Path

import numpy as np
from opencv_tools.base.regular_files import (
    open_regular, open_resolved, read_opened, read_regular, RefusedFileError, replace_file,
    write_buffer, write_new)
import pytest
from special_files import KINDS

LIMIT = 1000


@pytest.fixture
def opened(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Record the names of opened files."""
    names: list[str] = []

    def _open(path: Path, flags: int, mode: int = 0o777) -> int:
        names.append(Path(path).name)
        return real(path, flags | os.O_NONBLOCK, mode)  # without it a pipe would block forever

    real = os.open
    monkeypatch.setattr(os, 'open', _open)
    return names


@pytest.mark.parametrize('flags', [os.O_RDONLY, os.O_RDWR | os.O_CREAT])
@pytest.mark.parametrize('kind', KINDS)
def test_non_regular_file_is_refused_before_opening(
        tmp_path: Path, opened: list[str], kind: str, flags: int) -> None:
    make, reason = KINDS[kind]
    make(tmp_path / 'x')
    with pytest.raises(RefusedFileError) as caught:
        open_regular(tmp_path / 'x', flags)
    assert reason in caught.value.strerror
    assert not opened


def test_file_replaced_by_a_pipe_is_refused(
        tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def _open(path: Path, flags: int, mode: int) -> int:
        path.unlink()
        os.mkfifo(path)
        assert flags & os.O_NONBLOCK and flags & os.O_CLOEXEC
        files.append(real(path, flags, mode))
        return files[-1]

    files: list[int] = []
    real = os.open
    (tmp_path / 'x').touch()
    monkeypatch.setattr(os, 'open', _open)
    with pytest.raises(RefusedFileError, match='x is a named pipe'):
        open_regular(tmp_path / 'x')
    with pytest.raises(OSError, match='Bad file descriptor'):
        os.fstat(files[0])


@pytest.mark.parametrize('target', ['whole', 'missing'])
def test_refused_links(tmp_path: Path, target: str) -> None:
    (tmp_path / 'whole').write_bytes(b'content')
    link = tmp_path / 'link'
    link.symlink_to(target)
    with pytest.raises(RefusedFileError, match='link is a symbolic link'):
        read_regular(link, LIMIT, follow=False)
    with pytest.raises(RefusedFileError, match='link is a symbolic link'):
        open_regular(link, os.O_RDWR | os.O_CREAT, follow=False)
    with pytest.raises(RefusedFileError, match='link is a symbolic link'):
        replace_file(link, b'new')
    assert not (tmp_path / 'missing').exists()


@pytest.mark.parametrize('replaced', ['folder/file', 'folder'])
def test_resolved_path_that_becomes_a_link(replaced: str, tmp_path: Path) -> None:
    for name in ('folder', 'other'):
        (tmp_path / name).mkdir()
        (tmp_path / name / 'file').write_text(name)
    path = (tmp_path / 'folder' / 'file').resolve()
    assert read_opened(open_resolved(path), path, LIMIT) == b'folder'
    (tmp_path / replaced).rename(tmp_path / 'old')
    (tmp_path / replaced).symlink_to(str(tmp_path / replaced).replace('folder', 'other'))
    with pytest.raises(OSError, match='link'):
        open_resolved(path)


def test_link_followed_on_request(tmp_path: Path) -> None:
    (tmp_path / 'whole').write_bytes(b'content')
    (tmp_path / 'link').symlink_to('whole')
    assert read_regular(tmp_path / 'link', LIMIT) == b'content'


def test_file_up_to_the_limit_is_read(tmp_path: Path) -> None:
    path = tmp_path / 'x'
    for content in (b'', b'x' * (LIMIT - 1), b'x' * LIMIT):
        path.write_bytes(content)
        assert read_regular(path, LIMIT) == content
    for size in (LIMIT + 1, 1 << 40):  # a sparse file of 1 TB
        os.truncate(path, size)
        with pytest.raises(RefusedFileError, match=f'x is larger than {LIMIT} bytes'):
            read_regular(path, LIMIT)


def test_file_without_a_size_is_read_up_to_the_limit() -> None:
    status = Path('/proc/self/status')  # a file whose reported size is 0
    assert read_regular(status, 1 << 20).startswith(b'Name:')
    with pytest.raises(RefusedFileError, match='status is larger than 100 bytes'):
        read_regular(status, 100)


def test_file_is_replaced_atomically(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path, old = tmp_path / 'x', tmp_path / 'old'
    for content in (b'first', b'second'):
        replace_file(path, content)
        assert path.read_bytes() == content
        assert list(tmp_path.iterdir()) == [path]
    old.hardlink_to(path)  # content for a program that has opened the old file
    replace_file(path, b'third')
    assert old.read_bytes() == b'second'
    monkeypatch.setattr(Path, 'replace', lambda *_: (tmp_path / 'none').rename(path))
    with pytest.raises(FileNotFoundError):
        replace_file(path, b'fourth')
    assert path.read_bytes() == b'third'
    assert {*tmp_path.iterdir()} == {path, old}


def test_new_file_replaces_no_other_file(tmp_path: Path) -> None:
    path = tmp_path / 'x'
    write_new(path, (b'first ', memoryview(b'file')))
    with pytest.raises(FileExistsError):
        write_new(path, (b'second',))
    assert path.read_bytes() == b'first file'


def test_new_file_is_removed_after_an_error(tmp_path: Path) -> None:
    def parts() -> Iterator[bytes]:
        yield b'first'
        raise OSError(errno.EIO, 'no more')

    with pytest.raises(OSError, match='no more'):
        write_new(tmp_path / 'x', parts())
    assert not [*tmp_path.iterdir()]


def test_buffer_is_written_completely_in_parts() -> None:
    class File(io.BytesIO):
        """A file that accepts three bytes at once."""

        def write(self, data: memoryview) -> int:
            return super().write(data[:3])

    file = File()
    write_buffer(file, np.arange(10, dtype=np.uint16))
    assert file.getvalue() == np.arange(10, dtype=np.uint16).tobytes()
