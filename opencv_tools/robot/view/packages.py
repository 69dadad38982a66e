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

"""Folders of packages, and the files of which they consist."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from itertools import islice
import os
from pathlib import Path
import re

from opencv_tools.regular_files import read_regular

_MAX_ABOVE = 20  # folders above a file
_MANIFEST = 'package.xml'
_MANIFEST_BYTES = 1_000_000
_NAME = re.compile(rb'<name>\s*([A-Za-z0-9_-]+)\s*</name>')


def absolute(path: str | Path) -> Path:
    """Return an absolute path without .. in it; links are not followed."""
    return Path(os.path.normpath(Path(path).absolute()))


def resolved(path: str | Path) -> Path:
    """Return a path without links; that of a loop of links is one of its links."""
    return Path(os.path.realpath(path))  # Path.resolve raises RuntimeError for a loop


def installed(package: str) -> Iterator[Path]:
    """Return where a package may be installed."""
    for prefix in os.environ.get('AMENT_PREFIX_PATH', '').split(os.pathsep):
        if prefix:
            yield absolute(prefix) / 'share' / package


def is_package(folder: Path, name: str) -> bool:
    """Return whether a folder is the source of a package."""
    return bool(name) and _name(folder) == name


def package_folders(path: Path) -> Iterator[Path]:
    """Return the folders above a file with a ``package.xml``, the nearest first."""
    return (folder for folder in islice(path.parents, _MAX_ABOVE)
            if (folder / _MANIFEST).is_file())


def root_of(file: Path, place: Path, roots: Iterable[Path], package: str = '') -> Path | None:
    """
    Return the folder because of which a file may be read; None if it must not be read.

    :param file: the file without links.
    :param place: its path, which may have links, below one of the folders.
    :param roots: folders whose files may be read. A link out of them may lead to the source of
        the same package, as ``--symlink-install`` makes them.
    :param package: name of the package; '' for that of the folders above the place.
    """
    roots = [*roots]
    for root in map(resolved, roots):
        if file.is_relative_to(root):
            return root
    if not any(place.is_relative_to(root) for root in roots):
        return None
    name = package or next(map(_name, package_folders(place)), '')
    return next((folder for folder in package_folders(file) if is_package(folder, name)), None)


def _name(folder: Path) -> str:
    try:
        found = _NAME.search(read_regular(folder / _MANIFEST, _MANIFEST_BYTES))
    except OSError:
        return ''
    return found[1].decode() if found else ''
