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

"""Folders of packages, installed or as sources."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import islice
import os
from pathlib import Path
import re

from opencv_tools.base.regular_files import read_regular

_MAX_ABOVE = 20  # folders above a file
_MANIFEST = 'package.xml'
_MANIFEST_BYTES = 1_000_000
_NAME = re.compile(rb'<name>\s*([A-Za-z0-9_-]+)\s*</name>')


def is_package(folder: Path, name: str) -> bool:
    """Return whether a folder is the source of a package."""
    return bool(name) and package_name(folder) == name


def package_folders(path: Path) -> Iterator[Path]:
    """
    Return the folders above a file with a ``package.xml``, the nearest first.

    Those above the target of a link follow.
    """
    if '\0' in str(path):  # no file can have this name
        return iter(())
    places = path.absolute(), Path(os.path.realpath(path))
    above = dict.fromkeys(folder for place in places for folder in islice(
        place.parents, _MAX_ABOVE))
    return (folder for folder in above if (folder / _MANIFEST).is_file())


def package_name(folder: Path) -> str:
    """Return the name in the ``package.xml`` of a folder; empty without one."""
    try:
        found = _NAME.search(read_regular(folder / _MANIFEST, _MANIFEST_BYTES))
    except OSError:
        return ''
    return found[1].decode() if found else ''


def candidate_folders(package: str, start: Path) -> Iterator[Path]:
    """
    Return where the folder of a package may be: installed, or else above a file of the package.

    :param start: a file that names the package.
    """
    for prefix in filter(None, os.environ.get('AMENT_PREFIX_PATH', '').split(os.pathsep)):
        yield Path(prefix) / 'share' / package
    for entry in filter(None, os.environ.get('ROS_PACKAGE_PATH', '').split(os.pathsep)):
        folder = Path(entry)
        if folder.name == package:
            yield folder
        yield folder / package
        yield from sorted(folder.glob(f'*/{package}'))
    yield from _own_folders(package, start)


def own_files(path: str, start: Path) -> Iterator[Path]:
    """
    Return where a file of a package URI is if the package has no workspace.

    :param path: the URI without its scheme, which begins with the name of the package.
    :param start: a file that names the package.
    """
    package, _, inside = path.partition('/')
    return (folder / inside for folder in _own_folders(package, start))


def _own_folders(package: str, start: Path) -> Iterator[Path]:
    """Return the folders above a file that are the source of a package."""
    return (folder for folder in package_folders(start) if is_package(folder, package))
