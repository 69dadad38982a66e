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

"""Included SDF models: search for their files, and load the models."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
import os
from pathlib import Path
import re
from urllib.parse import unquote

from opencv_tools.robot.packages import own_files
from opencv_tools.robot.sdf.values import file_version, NEWEST, text_of, Version, version_of
from opencv_tools.robot.xml.document import (
    DescriptionError, Element, local_name, parse, required_name, source_of, TrackedElement)
from opencv_tools.robot.xml.input import read_bytes
from opencv_tools.robot.xml.report import Report

#: Environment variables with model folders, searched in this order after the caller's folders.
SEARCH_VARIABLES = ('GZ_SIM_RESOURCE_PATH', 'IGN_GAZEBO_RESOURCE_PATH', 'SDF_PATH',
                    'GAZEBO_MODEL_PATH')
# Limits against hostile files: includes can double the work at every level.
MAX_INCLUDES = 2000
MAX_DEPTH = 50
MAX_ELEMENTS = 300_000
_CONFIG = 'model.config'
_MODEL = 'model.sdf'
# A model on Gazebo's server, with or without its version.
_FUEL = re.compile(r'https?://([^/]+)/[^/]+/([^/]+)/models/([^/]+)(?:/([0-9]+|tip))?/?')
_NAMED_SCHEMES = ('model', 'package')


def search_folders(folder: Path, search: Sequence[str] = ()) -> list[Path]:
    """
    Return the folders in which files of models are searched.

    :param folder: folder of the file that names another one.
    :param search: folders that are searched before those of the environment.
    """
    folders = [*search, *(found for variable in SEARCH_VARIABLES
                          for found in os.environ.get(variable, '').split(os.pathsep))]
    return [folder, folder.parent, *(Path(found) for found in folders if found)]


class NoModelError(DescriptionError):
    """An included file without a model."""


@dataclass(frozen=True)
class ModelFile:
    """
    A model, its file, and the includes that lead to it.

    :param element: its ``<model>``.
    :param files: the chain of files, from the first file to the file of the model.
    :param includes: the chain of ``<include>`` elements, outermost first. Their values override
        those of the model; the outermost include has the highest priority.
    """

    element: TrackedElement
    version: Version
    files: tuple[Path, ...]
    includes: tuple[TrackedElement, ...] = ()

    @property
    def name(self) -> str:
        """Name of the model in the robot: that of the outermost include that has one."""
        own = required_name(self.element)
        return next(filter(None, (text_of(include, 'name') for include in self.includes)), own)

    @property
    def pose_holder(self) -> TrackedElement:
        """Element whose ``<pose>`` places the model; the model itself if no include has one."""
        return next((include for include in self.includes
                     if include.element.find('pose') is not None), self.element)

    @property
    def placement_frame(self) -> str:
        """Frame of the model that its pose places; empty for the model frame."""
        names = [*(text_of(include, 'placement_frame') for include in self.includes),
                 self.element.get('placement_frame', '')]
        return next(filter(None, names), '')


class ModelLoader:
    """Loads included models and reads each file once; for ``search`` see `search_folders`."""

    def __init__(self, search: Sequence[str], report: Report) -> None:
        self._search = search
        self._report = report
        self._roots: dict[Path, tuple[Element, Version]] = {}
        self._include_count = 0
        self._element_count = 0

    def load(self, include: TrackedElement, files: tuple[Path, ...]) -> ModelFile:
        """
        Return the model of an ``<include>``.

        :param files: the chain of files up to the one with the ``<include>``.
        :raises DescriptionError: the file is missing, or it does not have exactly one model.
        """
        includes = [include]
        while True:
            include = includes[-1]
            self._include_count += 1
            if self._include_count > MAX_INCLUDES or len(files) > MAX_DEPTH:
                raise DescriptionError(f'more than {MAX_INCLUDES} includes, or includes nested '
                                       f'deeper than {MAX_DEPTH}; use fewer includes', include)
            path = self._find(include, files[-1].parent)
            if path in files:
                cycle = [*files[files.index(path):], path]
                raise DescriptionError(f'include cycle: {" -> ".join(map(str, cycle))}', include)
            root, version = self._read(path, include)
            files = (*files, path)
            element = TrackedElement(_only_model(root, include))
            if text_of(include, 'placement_frame') and include.element.find('pose') is None:
                raise DescriptionError('has a <placement_frame> but no <pose>; add a <pose>',
                                       include)
            if local_name(element) == 'model':
                return ModelFile(element, version, files, tuple(includes))
            includes.append(element)

    def count_elements(self, model: ModelFile) -> None:
        """
        Count the elements of an included model, once for each include.

        :raises DescriptionError: all included models together have too many elements.
        """
        self._element_count += sum(1 for _ in self._roots[model.files[-1]][0].iter())
        if self._element_count > MAX_ELEMENTS:
            raise DescriptionError(f'the included models have more than {MAX_ELEMENTS} elements; '
                                   'include fewer models', model.includes[0])

    def _read(self, path: Path, include: TrackedElement) -> tuple[Element, Version]:
        if path not in self._roots:
            root = parse(read_bytes(str(path)), str(path), self._report)
            if local_name(root) == 'robot':
                raise DescriptionError(f'{path} is a URDF; convert it with urdf_to_sdf and '
                                       'include the result', include)
            if local_name(root) != 'sdf':
                raise DescriptionError(f'{path} is not SDF: its root is <{local_name(root)}>, '
                                       'expected <sdf>', include)
            self._roots[path] = root, file_version(root, self._report)
        return self._roots[path]

    def _find(self, include: TrackedElement, folder: Path) -> Path:
        """Return the file of an ``<include>`` that stands in a file of a folder."""
        uri = text_of(include, 'uri')
        candidates = self._candidates(uri, include, folder)
        for candidate in candidates:
            with suppress(OSError):  # the path is too long, or its folder is not readable
                if candidate.is_dir():
                    candidate = _file_in(candidate, include)
                if candidate.is_file():
                    return Path(os.path.realpath(candidate))
        searched = ', '.join(dict.fromkeys(map(str, candidates)))
        raise DescriptionError(f'<uri> {uri!r} is not found, searched {searched}; add the folder '
                               'that contains the model with --path', include)

    def _candidates(self, uri: str, include: TrackedElement, folder: Path) -> list[Path]:
        scheme, separator, path = uri.partition('://')
        if not separator:
            scheme, path = '', uri
        if not path:
            raise DescriptionError(f'<uri> {uri!r} does not name a file', include)
        if scheme in ('http', 'https'):
            if downloaded := _downloaded(uri):
                return downloaded
            raise DescriptionError(f'<uri> {uri!r} is not on this computer; download the model '
                                   'and add its folder with --path', include)
        if separator and scheme not in (*_NAMED_SCHEMES, 'file'):
            raise DescriptionError(f'<uri> {uri!r} is not supported; use model://, file:// or a '
                                   'path', include)
        if scheme in _NAMED_SCHEMES:
            path = path.lstrip('/')
        # Joining keeps an absolute path unchanged.
        return [*(base / path for base in search_folders(folder, self._search)),
                *own_files(path if separator else '', folder / '-')]


def _downloaded(uri: str) -> list[Path]:
    """Return the folders of a model that Gazebo has downloaded, newest version first."""
    match = _FUEL.fullmatch(uri)
    parts = [unquote(part).lower() for part in match.groups()[:3]] if match else []
    if match is None or any('/' in part or part in ('.', '..') for part in parts):
        return []
    server, owner, name = parts
    cache = Path(os.environ.get('GZ_FUEL_CACHE_PATH') or '~/.gz/fuel').expanduser()
    model = cache / server / owner / 'models' / name
    versions = [folder for folder in model.glob('[0-9]*') if folder.name.isdecimal()]
    versions.sort(key=lambda folder: int(folder.name), reverse=True)
    return [folder for folder in versions if match[4] in (None, 'tip', folder.name)]


def first_file(source: str) -> Path:
    """Return the real path of the file that a robot comes from."""
    return Path(os.path.realpath(source)) if source else Path.cwd() / '<stdin>'


def _only_model(root: Element, include: TrackedElement) -> Element:
    """Return the ``<model>`` of an included file, or the ``<include>`` in its place."""
    models = [child for child in root if child.tag in ('model', 'include')]
    if not models:
        raise NoModelError(f'{source_of(root)} has no model', include)
    if len(models) > 1:
        raise DescriptionError(f'{source_of(root)} has {len(models)} models; include a file with '
                               'one model', include)
    return models[0]


def file_of_model(path: str) -> str:
    """
    Return the SDF file of a model given by its folder or its model.config.

    :param path: any path. ``-`` and other files are returned unchanged.
    :raises DescriptionError: the folder has no SDF file.
    """
    folder = Path(path)
    try:
        if folder.name == _CONFIG and folder.is_file():
            folder = folder.parent
        elif path == '-' or not folder.is_dir():
            return path
        is_model = any((folder / name).is_file() for name in (_CONFIG, _MODEL))
    except OSError:  # the error is reported when the file is read
        return path
    if not is_model:
        raise DescriptionError(f'is a folder without {_CONFIG} and {_MODEL}; name a file',
                               source=path)
    return str(_file_in(folder, None))


def _file_in(folder: Path, include: TrackedElement | None) -> Path:
    """Return the SDF file of a model folder with the newest supported version."""
    config = folder / _CONFIG
    if not config.is_file():
        return folder / _MODEL
    root = parse(read_bytes(str(config)), str(config), Report())
    entries = [(version_of(entry.get('version', '')) or (0, 0), name)
               for entry in root.findall('sdf') if (name := (entry.text or '').strip())]
    supported = [entry for entry in entries if entry[0] <= NEWEST] or entries
    if not supported:
        raise DescriptionError(f'{config} has no <sdf> with a file name', include)
    # Of several entries with one version, the first counts.
    return folder / max(supported, key=lambda entry: entry[0])[1]
