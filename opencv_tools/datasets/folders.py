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
from contextlib import contextmanager, suppress
import hashlib
import os
from pathlib import Path
import re
import shutil

from opencv_tools.datasets.errors import DatasetError
from opencv_tools.image.text import printable
from opencv_tools.regular_files import natural_order

_OLD = '.replaced'
_UNSAFE = re.compile('[^A-Za-z0-9_.-]+')
_MAX_STEM = 60  # characters of the name of a bag in that of its part


def part_folder(parts: Path, bag: str) -> Path:
    """Return the folder of the part of a bag, by the name of the bag in the set."""
    digest = hashlib.sha256(bag.encode(errors='surrogateescape')).hexdigest()[:12]
    stem = _UNSAFE.sub('_', bag).strip('._')[-_MAX_STEM:]
    return parts / f'{stem}-{digest}'


def working_parts(target: Path) -> Path:
    """Return the folder of the parts of a set that is not complete yet, beside the set."""
    return target.with_name(f'.{target.name}.parts')


def remove_unfinished(parts: Path) -> None:
    """Remove the parts that processes have left behind when they were killed."""
    with suppress(FileNotFoundError):
        for entry in parts.iterdir():
            if entry.name.startswith('.') and entry.is_dir():
                shutil.rmtree(entry, ignore_errors=True)


def check_target(target: Path, marks: tuple[str, ...], overwrite: bool) -> None:
    """
    Check that a folder may be written.

    :param target: folder to be written.
    :param marks: files, one of which a folder that may be replaced has.
    :param overwrite: whether it may be replaced.
    :raises DatasetError: the folder exists and may not be replaced.
    """
    old = target.with_name(f'.{target.name}{_OLD}')
    if old.is_dir() and not target.exists():
        old.rename(target)  # a process was killed between the two steps of a replacement
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
    Write a folder beside another one, which it replaces when it is complete.

    :param target: folder that is replaced or created; see ``check_target``.
    :returns: the new folder, for the context. It is removed if the context raises an exception.
    :raises OSError: the folder cannot be written.
    """
    target.parent.mkdir(parents=True, exist_ok=True)
    work = target.with_name(f'.{target.name}.{os.urandom(6).hex()}')
    old = target.with_name(f'.{target.name}{_OLD}')
    work.mkdir()
    try:
        yield work
        if target.exists():
            shutil.rmtree(old, ignore_errors=True)
            target.rename(old)
        work.rename(target)
        shutil.rmtree(old, ignore_errors=True)
    finally:
        shutil.rmtree(work, ignore_errors=True)


def natural_key(name: str) -> list[list[tuple[bool, int, str]]]:
    """Return a sort key of a relative path, which orders ``2/a`` before ``10/a``."""
    return [natural_order(Path(part)) for part in Path(name).parts]
