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

"""Folders that appear complete or not at all, and those of the parts of a set."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
import hashlib
import os
from pathlib import Path
import re
import shutil

from opencv_tools.base.regular_files import is_same_file, natural_order, open_regular, try_lock
from opencv_tools.base.text import MAX_PATH, printable
from opencv_tools.datasets.errors import DatasetError

_LOCK, _OLD, _NEW = '.lock', '.replaced', '.new'
_UNSAFE = re.compile('[^A-Za-z0-9_.-]+')
_MAX_STEM = 60  # characters of the name of a bag in that of its part


def part_folder(parts: Path, bag: str) -> Path:
    """Return the folder of the part of a bag, by the name of the bag in the set."""
    stem = _UNSAFE.sub('_', bag)[-_MAX_STEM:].strip('._')
    return parts / f'{stem}-{bag_digest(bag)}'


def bag_digest(bag: str) -> str:
    """Return 12 letters and digits that differ for each name of a bag in a set."""
    return hashlib.sha256(bag.encode(errors='surrogateescape')).hexdigest()[:12]


def working_parts(target: Path) -> Path:
    """Return the folder of the parts of a set that is not complete yet, beside the set."""
    return target.with_name(f'.{target.name}.parts')


@contextmanager
def locked_parts(target: Path) -> Iterator[Path]:
    """
    Lock a set, and remove what commands have left behind that were killed.

    :returns: folder of its parts, for the context. It is removed at the end if it has no parts.
    :raises DatasetError: another command writes the set.
    :raises OSError: the folder cannot be written.
    """
    parts = working_parts(target)
    if parts.is_symlink():
        raise DatasetError(f'{printable(parts, MAX_PATH)} is a link; remove it')
    parts.mkdir(parents=True, exist_ok=True)
    path = parts / _LOCK
    with os.fdopen(open_regular(path, os.O_RDWR | os.O_CREAT, follow=False), 'r+b') as lock:
        if not try_lock(lock.fileno()) or not is_same_file(lock.fileno(), path):
            raise DatasetError(f'another img_convert is writing {printable(target, MAX_PATH)}; '
                               'wait for its end')
        try:
            if (parts / _OLD).is_dir() and not target.exists():
                (parts / _OLD).rename(target)  # killed between the two steps of a replacement
            for entry in parts.iterdir():
                if entry.name.startswith('.') and entry.is_dir():
                    shutil.rmtree(entry, ignore_errors=True)
            yield parts
        finally:
            if [*parts.iterdir()] == [path]:
                path.unlink()
                parts.rmdir()


def remove_part(folder: Path) -> None:
    """Remove a folder, which is complete or absent at any time."""
    removed = folder.with_name(f'.{os.urandom(6).hex()}')
    folder.rename(removed)
    shutil.rmtree(removed, ignore_errors=True)


def check_target(target: Path, marks: tuple[str, ...], overwrite: bool) -> None:
    """
    Check that a folder may be written.

    :param target: folder to be written.
    :param marks: files, one of which a folder that may be replaced has.
    :param overwrite: whether it may be replaced.
    :raises DatasetError: the folder exists and may not be replaced.
    """
    if target.is_symlink() or (target.exists() and not target.is_dir()):
        raise DatasetError(f'{printable(target)} is not a folder; give a new one')
    if not target.is_dir() or not any(target.iterdir()):
        return
    if not any((target / mark).is_file() for mark in marks):
        raise DatasetError(f'{printable(target)} has files that are no data set; give a new '
                           'folder')
    if not overwrite:
        raise DatasetError(f'{printable(target)} is a data set already; give a new folder, or '
                           'replace it with --overwrite')


@contextmanager
def replaced_folder(target: Path) -> Iterator[Path]:
    """
    Write a folder that replaces another one when it is complete.

    :param target: folder that is replaced or created, within ``locked_parts``.
    :returns: the new folder, for the context. It is removed if the context raises an exception.
    :raises OSError: the folder cannot be written.
    """
    parts = working_parts(target)
    work, old = parts / _NEW, parts / _OLD
    work.mkdir()
    try:
        yield work
        if target.exists():
            target.rename(old)
        work.rename(target)
        if old.exists():
            remove_part(old)
    finally:
        shutil.rmtree(work, ignore_errors=True)


def natural_key(name: str) -> list[list[tuple[bool, int, str]]]:
    """Return a sort key of a relative path, which orders ``2/a`` before ``10/a``."""
    return [natural_order(Path(part)) for part in Path(name).parts]
