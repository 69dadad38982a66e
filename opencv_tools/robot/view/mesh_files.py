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

"""
Files of meshes and textures in the folders of packages, read with limits.

Only files below the folder of the robot, the folder above it, a package or a folder of the search
path are read.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from html import unescape
from itertools import islice
import os
from pathlib import Path
import re
from urllib.parse import quote, unquote

from opencv_tools.base.regular_files import open_resolved, read_opened
from opencv_tools.base.text import printable
from opencv_tools.robot.meshes import LFS_POINTER, LFS_REASON, MAX_BYTES
from opencv_tools.robot.packages import is_package, package_folders, package_name
from opencv_tools.robot.sdf.includes import search_folders


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
    name = package or next(map(package_name, package_folders(place)), '')
    return next((folder for folder in package_folders(file) if is_package(folder, name)), None)


MAX_FILES = 2000
MAX_TOTAL = 200_000_000  # of all files of the page
KINDS = ('stl', 'obj', 'dae', 'glb')
MAX_NAMED = 100  # files that a mesh names
MAX_POINTER = 1024  # bytes of a pointer of Git LFS
_TYPES = {'png': 'image/png', 'jpg': 'image/jpeg', 'jpeg': 'image/jpeg'}
_IMAGES = (*_TYPES,)
# Kinds of the files that a file names, and their names in it.
_NAMED = {
    'obj': (('mtl',), re.compile(rb'^mtllib[ \t]+(\S[^\r\n]*)', re.MULTILINE)),
    'mtl': (_IMAGES, re.compile(
        rb'^[ \t]*map_Kd[ \t]+(?:-[^\r\n]*[ \t])?(\S[^\r\n]*)', re.MULTILINE)),
    'dae': (_IMAGES, re.compile(rb'<image\b[^<>]*>\s*<init_from>([^<]*)'))}
_PACKAGE_URI = re.compile('package://([A-Za-z0-9_-]{1,255})/([^/].{1,1000})', re.DOTALL)
_SCHEMES = ('file', 'model', 'package')
_ROLES = {KINDS: 'mesh', ('mtl',): 'material', _IMAGES: 'texture'}


class NoMeshError(Exception):
    """A mesh that the page does not show; the text is the reason."""


@dataclass(frozen=True)
class MeshFile:
    """
    A mesh of a robot, or a file that a mesh names.

    :param kind: extension of the file; '' if there is a reason.
    :param role: ``mesh``, ``material`` or ``texture``.
    :param path: the file without links; None if there is a reason.
    :param size: size of the file in bytes.
    :param reason: reason why the file is not shown; '' if it is shown.
    :param media_type: media type for a browser.
    :param parts: numbers of the materials and textures of a mesh, by their names in it.
    """

    uri: str
    role: str = 'mesh'
    kind: str = ''
    path: Path | None = None
    size: int = 0
    reason: str = ''
    media_type: str = 'application/octet-stream'
    parts: Mapping[str, int] = field(default_factory=dict)


class MeshFiles:
    """The meshes of one or two robots, each file once."""

    def __init__(self, is_shown: bool = True) -> None:
        """
        Create an empty collection.

        :param is_shown: whether meshes are shown; else each has a reason.
        """
        self.files: list[MeshFile] = []
        #: Places in which a file was searched in vain.
        self.missing: list[Path] = []
        self._is_shown = is_shown
        self._numbers: dict[tuple[str, str, Sequence[str]], int] = {}
        self._folders: list[Path] = []
        self._key = ''
        self._total = 0

    def search(self, source: str, search: Sequence[str] = ()) -> None:
        """Set the file that names the next meshes, and folders in which they are searched."""
        folder = absolute(source).parent if source != '<stdin>' else Path.cwd()
        folders = [*map(absolute, search_folders(folder, search))]
        # The folder above a robot in a folder of the root would contain every file.
        self._folders = [folder, *(one for one in folders if one != Path(one.anchor))]
        self._key = str(folder)

    def add(self, uri: str) -> int:
        """Return the number of a mesh; it is searched at the first time."""
        return self._add(uri, uri, KINDS)

    def read(self, number: int) -> bytes:
        """
        Return the content of a file.

        :raises NoMeshError: it is not shown, or it cannot be read any more.
        """
        file = self.files[number]
        if file.path is None:
            raise NoMeshError(file.reason)
        try:
            return _content(file.path)
        except OSError as err:
            raise NoMeshError(f'cannot be read: {err.strerror}') from err

    def _add(self, name: str, uri: str, kinds: tuple[str, ...]) -> int:
        key = (self._key, uri, kinds)
        if key not in self._numbers:
            file = self._find(printable(name, 200), uri, kinds)
            file = replace(file, parts=self._parts(file))
            self._numbers[key] = len(self.files)
            self.files.append(file)
        return self._numbers[key]

    def _parts(self, file: MeshFile) -> dict[str, int]:
        """Return the numbers of the files that a file names, and of those that these name."""
        parts: dict[str, int] = {}
        kinds, pattern = _NAMED.get(file.kind, ((), None))
        if file.path is None or pattern is None:
            return parts
        with suppress(OSError):
            found = pattern.finditer(_content(file.path))
            for name in (unescape(match[1].decode(errors='replace')).strip()
                         for match in islice(found, MAX_NAMED)):
                uri = name if '://' in name else _beside(file.path, name)
                parts[name] = number = self._add(name, uri, kinds)
                parts.update(self.files[number].parts)
        return parts

    def _find(self, name: str, uri: str, kinds: tuple[str, ...]) -> MeshFile:
        try:
            if not self._is_shown:
                raise NoMeshError('meshes are left out by --no-meshes')
            kind = Path(uri).suffix[1:].lower()
            if kind not in kinds:
                raise NoMeshError(f'the page shows only {", ".join(kinds)}')
            path = self._path(uri, kinds)
            size = path.stat().st_size
            if size > MAX_BYTES:
                raise NoMeshError(f'it has {size} bytes, but {MAX_BYTES} are the limit of a file')
            if self._total + size > MAX_TOTAL:
                raise NoMeshError(f'it has {size} bytes and the files before it {self._total}, '
                                  f'but {MAX_TOTAL} are the limit of all files')
            if len(self.files) >= MAX_FILES:
                raise NoMeshError(f'{MAX_FILES} files are the limit')
            if size < MAX_POINTER and _content(path).startswith(LFS_POINTER):
                self.missing.append(path)
                raise NoMeshError(f'it {LFS_REASON}')
        except (NoMeshError, OSError, ValueError) as err:
            return MeshFile(name, _ROLES[kinds], reason=printable(
                str(getattr(err, 'strerror', None) or err), 400))
        self._total += size
        return MeshFile(name, _ROLES[kinds], kind, path, size,
                        media_type=_TYPES.get(kind, MeshFile.media_type))

    def _path(self, uri: str, kinds: tuple[str, ...]) -> Path:
        scheme, separator, path = uri.rpartition('://')
        if separator and scheme not in _SCHEMES:
            raise NoMeshError('it is not on this computer')
        if scheme == 'file':
            path = unquote(path)
        places = [*self._places(scheme, path.lstrip('/') if separator else path)]
        roots = {root for root, _ in places}
        searched = [absolute(place) for _, place in places]
        found = [(place, file) for place in searched if (file := _regular(place))]
        for place, file in found:
            if not _is_of(file, kinds):
                raise NoMeshError('it is a link to a file of another kind')
            if root_of(file, place, roots):
                return file
        if found:
            raise NoMeshError('it is outside of the folder of the robot, of its packages and of '
                              'GZ_SIM_RESOURCE_PATH')
        self.missing += searched
        raise NoMeshError('it is not found; add its folder to GZ_SIM_RESOURCE_PATH')

    def _places(self, scheme: str, path: str) -> Iterator[tuple[Path, Path]]:
        """Return where a file may be, each place with a folder whose files may be read."""
        if scheme == 'file':
            path = f'/{path}'
            yield from ((root, Path(path)) for root in (
                *self._folders, *package_folders(Path(path))))
            return
        yield from ((root, root / path) for root in self._folders)
        package, _, inside = path.partition('/')
        if scheme and inside:
            yield from ((root, root / inside) for root in self._packages(package))

    def _packages(self, name: str) -> Iterator[Path]:
        """Return the folders of a package: above the robot's folder, and where it is installed."""
        if not re.fullmatch('[A-Za-z0-9_-]+', name):
            return
        for folder in [self._folders[0], *self._folders[0].parents]:
            if is_package(folder, name):
                yield folder
        yield from installed(name)


class PackageMeshes(MeshFiles):
    """
    The meshes of an untrusted robot: only files of installed packages, by ``package://``.

    A link may lead to the source of the same package, as ``--symlink-install`` makes them. What a
    mesh names beside it must be in its package.
    """

    def __init__(self) -> None:
        super().__init__()
        self._read: set[Path] = set()  # folders of packages from which a mesh was read

    def _path(self, uri: str, kinds: tuple[str, ...]) -> Path:
        if kinds != KINDS and uri.startswith('file://'):
            file = _regular(Path(unquote(uri.removeprefix('file://'))))
            if file and _is_of(file, kinds) and root_of(file, file, self._read):
                return file
            raise NoMeshError('it is not in the package of its mesh')
        found = _PACKAGE_URI.fullmatch(uri)
        if not found or '..' in Path(uri).parts:
            raise NoMeshError('it is not of the form package://PACKAGE/FILE')
        package, inside = found.groups()
        for root in installed(package):
            if not (file := _regular(root / inside)):
                continue
            folder = root_of(file, root / inside, [root], package)
            if folder is None or not _is_of(file, kinds):
                raise NoMeshError('it is a link out of its package')
            self._read.add(folder)
            return file
        raise NoMeshError('it is not in an installed package of this computer')


def _content(file: Path) -> bytes:
    """Read a file, unless a link has replaced a part of its path since it was found."""
    return read_opened(open_resolved(file), file, MAX_BYTES)


def _regular(place: Path) -> Path | None:
    """Return a file without links, None if it does not exist."""
    file = resolved(place) if os.path.lexists(place) else place
    if not file.is_file():
        if os.path.lexists(file):
            raise NoMeshError('it is not a regular file')
        return None
    return file


def _is_of(file: Path, kinds: Sequence[str]) -> bool:
    return file.suffix[1:].lower() in kinds


def _beside(mesh: Path, name: str) -> str:
    """Return the URI of a file that a mesh names; Gazebo has textures in a folder of their own."""
    path = Path(unquote(name.replace('\\', '/')))
    places = [mesh.parent / path, mesh.parent.parent / 'materials' / 'textures' / path]
    return f'file://{quote(str(next(filter(Path.is_file, places), places[0])))}'
