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

"""Models that an SDF includes: where their files are searched for, and what is in them."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
import os
from pathlib import Path

from opencv_tools.robot.sdf.values import file_version, NEWEST, text_of, Version, version_of
from opencv_tools.robot.xml.document import (
    DescriptionError, Element, local_name, parse, read_bytes, required_name, source_of)
from opencv_tools.robot.xml.report import Report
from opencv_tools.robot.xml.tracked import TrackedElement

# Folders with models, in the order in which they are searched after what the caller names.
SEARCH_VARIABLES = ('GZ_SIM_RESOURCE_PATH', 'IGN_GAZEBO_RESOURCE_PATH', 'SDF_PATH',
                    'GAZEBO_MODEL_PATH')
# A file that includes others twice each doubles with every step; no robot has as many as this.
MAX_INCLUDES = 2000
MAX_DEPTH = 50
MAX_ELEMENTS = 300_000
_CONFIG = 'model.config'
_MODEL = 'model.sdf'
_NAMED_SCHEMES = ('model', 'package')


class NoModelError(DescriptionError):
    """A file that is included where a model is expected, and has none."""


@dataclass(frozen=True)
class ModelFile:
    """
    A model, the file that it stands in, and how it came from there.

    :param element: its ``<model>``.
    :param files: the files from the first one to this one, by way of what includes what.
    :param includes: the ``<include>``s that lead to it, outermost first; what they say about the
        model overrides what it says itself, and the outermost one overrides the others.
    """

    element: TrackedElement
    version: Version
    files: tuple[Path, ...]
    includes: tuple[TrackedElement, ...] = ()

    @property
    def name(self) -> str:
        """Give the name of the model."""
        own = required_name(self.element)
        return next(filter(None, (text_of(include, 'name') for include in self.includes)), own)

    @property
    def placed_by(self) -> TrackedElement:
        """Give the element that has the ``<pose>`` of the model, if one has."""
        return next((include for include in self.includes
                     if include.element.find('pose') is not None), self.element)

    @property
    def placement_frame(self) -> str:
        """Give the frame of the model that its pose places; empty for the model's own."""
        names = [*(text_of(include, 'placement_frame') for include in self.includes),
                 self.element.get('placement_frame', '')]
        return next(filter(None, names), '')


class ModelLoader:
    """The files that one SDF includes; each is read once."""

    def __init__(self, search: Sequence[str], report: Report) -> None:
        """
        Note where to search.

        :param search: folders that are searched before those of the environment.
        """
        folders = [*search, *(folder for variable in SEARCH_VARIABLES
                              for folder in os.environ.get(variable, '').split(os.pathsep))]
        self._search = [Path(folder) for folder in folders if folder]
        self._report = report
        self._read: dict[Path, tuple[Element, Version]] = {}
        self._count = 0
        self._elements = 0

    def part(self, include: TrackedElement, files: tuple[Path, ...]) -> ModelFile:
        """
        Give the model that an ``<include>`` names.

        :param files: the files that lead to it, this one last.
        :raises DescriptionError: there is no such file, or no model in it.
        """
        includes = [include]
        while True:
            self._count += 1
            if self._count > MAX_INCLUDES or len(files) > MAX_DEPTH:
                raise DescriptionError(
                    f'there are more than {MAX_INCLUDES} includes, or more than {MAX_DEPTH} '
                    'inside each other; no robot has so many', includes[-1])
            path = self._file(includes[-1], files[-1].parent)
            if path in files:
                raise DescriptionError(f'{path} includes itself', includes[-1])
            root, version = self._root(path, includes[-1])
            files = (*files, path)
            element = TrackedElement(only_model(root, includes[-1]))
            if local_name(element) == 'model':
                part = ModelFile(element, version, files, tuple(includes))
                _check_placement(part)
                return part
            includes.append(element)

    def check_size(self, part: ModelFile) -> None:
        """
        Count the elements of a model that is included, each time that it is.

        :raises DescriptionError: all models together are larger than any robot.
        """
        self._elements += sum(1 for _ in self._read[part.files[-1]][0].iter())
        if self._elements > MAX_ELEMENTS:
            raise DescriptionError(f'the models that are included have more than {MAX_ELEMENTS} '
                                   'elements; no robot has so many', part.includes[0])

    def _root(self, path: Path, include: TrackedElement) -> tuple[Element, Version]:
        if path not in self._read:
            root = parse(read_bytes(str(path)), str(path), self._report)
            if local_name(root) == 'robot':
                raise DescriptionError(f'{path} is a URDF; convert it by urdf_to_sdf and include '
                                       'that', include)
            if local_name(root) != 'sdf':
                raise DescriptionError(f'{path} is no SDF, its root is <{local_name(root)}>',
                                       include)
            self._read[path] = root, file_version(root, self._report)
        return self._read[path]

    def _file(self, include: TrackedElement, folder: Path) -> Path:
        uri = text_of(include, 'uri')
        candidates = self._candidates(uri, include, folder)
        for candidate in candidates:
            with suppress(OSError):  # it is too long, or in a folder that cannot be read
                if candidate.is_dir():
                    candidate = _file_in(candidate, include)
                if candidate.is_file():
                    return Path(os.path.realpath(candidate))
        searched = ', '.join(dict.fromkeys(map(str, candidates)))
        raise DescriptionError(f'<uri> {uri!r} is not found; there is no {searched}: name the '
                               'folder that has it by --path', include)

    def _candidates(self, uri: str, include: TrackedElement, folder: Path) -> list[Path]:
        scheme, separator, rest = uri.partition('://')
        if not uri or (separator and not rest):
            raise DescriptionError(f'<uri> {uri!r} names no file', include)
        if separator and scheme in ('http', 'https'):
            raise DescriptionError(f'<uri> {uri!r} is not on this machine; download the model '
                                   'and name the folder that has it by --path', include)
        if separator and scheme not in (*_NAMED_SCHEMES, 'file'):
            raise DescriptionError(f'<uri> {uri!r} is none that is read; write model://, file:// '
                                   'or a path', include)
        name = rest if separator else uri
        if separator and scheme in _NAMED_SCHEMES:
            name = name.lstrip('/')
        # An absolute path stays itself, whatever folder it is joined to.
        return [base / name for base in (folder, folder.parent, *self._search)]


def first_file(root: Element) -> Path:
    """Give the file that a root comes from, as circles of includes are found by."""
    source = source_of(root)
    return Path(os.path.realpath(source)) if source else Path.cwd() / '<stdin>'


def only_model(root: Element, include: TrackedElement) -> Element:
    """
    Give the ``<model>`` of an included file, or the ``<include>`` that stands for it.

    :raises DescriptionError: it has none, or several.
    """
    models = [child for child in root if child.tag in ('model', 'include')]
    if not models:
        raise NoModelError(f'{source_of(root)} has no model', include)
    if len(models) > 1:
        raise DescriptionError(f'{source_of(root)} has {len(models)} models where one is expected',
                               include)
    return models[0]


def file_of_model(path: str) -> str:
    """
    Return the file of a model that is named by its folder or its model.config.

    :param path: any file; one of another name is returned as it is, and so is ``-``.
    :raises DescriptionError: there is no such file.
    """
    folder = Path(path)
    try:
        if folder.name == _CONFIG and folder.is_file():
            folder = folder.parent
        elif path == '-' or not folder.is_dir():
            return path
        is_model = any((folder / name).is_file() for name in (_CONFIG, _MODEL))
    except OSError:  # reading it says why
        return path
    if not is_model:
        raise DescriptionError(f'is a folder without {_CONFIG} and {_MODEL}; name a file',
                               source=path)
    return str(_file_in(folder, None))


def _file_in(folder: Path, include: TrackedElement | None) -> Path:
    """Give the SDF of a model's folder that is the newest one of those that are read."""
    config = folder / _CONFIG
    if not config.is_file():
        return folder / _MODEL
    root = parse(read_bytes(str(config)), str(config), Report())
    entries = [((version_of(entry.get('version', '')) or (0, 0)), name)
               for entry in root.findall('sdf') if (name := (entry.text or '').strip())]
    known = [entry for entry in entries if entry[0] <= NEWEST] or entries
    if not known:
        raise DescriptionError(f'{config} names no <sdf>', include)
    newest = max(version for version, _ in known)
    return folder / next(name for version, name in known if version == newest)


def _check_placement(part: ModelFile) -> None:
    for include in part.includes:
        if text_of(include, 'placement_frame') and include.element.find('pose') is None:
            raise DescriptionError('has a <placement_frame> and no <pose> for it', include)
