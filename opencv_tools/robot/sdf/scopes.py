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

"""The model that is read of an SDF, with the models inside it."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

from opencv_tools.robot.model import FrameId, MODEL
from opencv_tools.robot.sdf.includes import first_file, ModelFile, ModelLoader, NoModelError
from opencv_tools.robot.sdf.values import (
    file_version, flag, MODEL_FRAME, SEPARATOR, text_of, Version)
from opencv_tools.robot.xml.document import (
    DescriptionError, Element, line_of, local_name, required_name)
from opencv_tools.robot.xml.report import Report
from opencv_tools.robot.xml.tracked import TrackedElement

_MODELS = ('model', 'include')


@dataclass
class Scope:
    """
    A model in which names are looked up: the robot's own, or one inside it.

    :param prefix: what the names of its links begin with in the robot; empty, or ending in ``::``.
    :param frame: the model's own frame.
    :param parent: the model around it; None for the robot's own.
    :param inner: the models directly inside it, in the order of the file.
    """

    part: ModelFile
    prefix: str = ''
    frame: FrameId = MODEL
    parent: Scope | None = None
    inner: list[Scope] = field(default_factory=list)

    @property
    def element(self) -> TrackedElement:
        """Give its ``<model>``."""
        return self.part.element

    @property
    def version(self) -> Version:
        """Give the version of its file."""
        return self.part.version

    @property
    def is_merged(self) -> bool:
        """Tell whether its links are the parent's own."""
        return self.parent is not None and self.prefix == self.parent.prefix

    @property
    def is_inside(self) -> bool:
        """Whether it is written in another model, not in a file of its own."""
        return self.parent is not None and not self.part.includes

    def qualified(self, name: str) -> str:
        """Give the name that something of this model has in the robot."""
        return self.prefix + name


def scopes_of(root: Element, library: ModelLoader, name: str, report: Report) -> list[Scope]:
    """
    Give the model to read, and after it all models inside it.

    :param root: the ``<sdf>``.
    :param name: of the model; empty where there is one only.
    :raises DescriptionError: there is none of this name, or there are several to choose from.
    """
    result = []
    pending = [Scope(_chosen(root, library, name, report))]
    while pending:
        scope = pending.pop()
        result.append(scope)
        for child in scope.element.take_all(*_MODELS):
            scope.inner.append(_inner(scope, child, library, report))
        pending.extend(reversed(scope.inner))
    return result


def _inner(scope: Scope, element: TrackedElement, library: ModelLoader, report: Report) -> Scope:
    if local_name(element) == 'model':
        part = ModelFile(element, scope.version, scope.part.files)
    else:
        part = library.part(element, scope.part.files)
        library.check_size(part)
    name = part.name
    if flag(element.get('merge'), element, 'merge'):
        frame = FrameId('frame', scope.qualified(f'_merged__{name}{MODEL_FRAME}'))
        report.preserve('include', name, line_of(element),
                     'its links are those of the model; where it was is frame '
                     f'{frame.name!r}')
        return Scope(part, scope.prefix, frame, scope)
    prefix = f'{scope.qualified(name)}{SEPARATOR}'
    report.preserve(local_name(element), name, line_of(element),
                 f'a model inside the model; the names of what is in it begin with {prefix!r}')
    return Scope(part, prefix, FrameId('frame', f'{prefix}{MODEL_FRAME}'), scope)


def _chosen(root: Element, library: ModelLoader, name: str, report: Report) -> ModelFile:
    version = file_version(root, report)
    candidates = list(_candidates(root, library))
    if not candidates:
        raise DescriptionError('has no model', root)
    names = [title for title, _ in candidates]
    if not name and len(candidates) > 1:
        raise DescriptionError(f'has {len(names)} models; choose one by --model: '
                               f'{", ".join(names)}', root)
    if name and name not in names:
        raise DescriptionError(f'has no model {name!r}; there is {", ".join(names)}', root)
    _, element = candidates[names.index(name) if name else 0]
    _note_rest(root, element, report)
    files = (first_file(root),)
    if local_name(element) == 'include':
        return library.part(TrackedElement(element), files)
    return ModelFile(TrackedElement(element), version, files)


def _candidates(root: Element, library: ModelLoader) -> Iterator[tuple[str, Element]]:
    """Give all models that might be read, by name."""
    for holder in (root, *root.iterchildren('world')):
        for element in holder.iterchildren(*_MODELS):
            if local_name(element) == 'model':
                yield required_name(element), element
            elif name := _include_name(element, library, first_file(root)):
                yield name, element


def _include_name(element: Element, library: ModelLoader, file: Path) -> str:
    """Name what is included; empty for lights and the like, which are no models."""
    try:
        return library.part(TrackedElement(element), (file,)).name
    except NoModelError:
        return ''
    except DescriptionError:
        # It is not to be found, which matters only if it is chosen.
        return text_of(element, 'name') or text_of(element, 'uri').rstrip('/').rpartition('/')[2]


def _note_rest(root: Element, chosen: Element, report: Report) -> None:
    """Note what is left out of the file and of the world around a model."""
    counts: dict[str, list[Element]] = {}
    for holder in (root, *root.iterchildren('world')):
        for child in holder.iterchildren('*'):
            if child is not chosen and local_name(child) != 'world':
                counts.setdefault(local_name(child), []).append(child)
    for tag, elements in counts.items():
        names = ', '.join(repr(name) for element in elements[:5]
                          if (name := element.get('name') or text_of(element, 'name')))
        report.warn(tag, '', line_of(elements[0]),
                    f'left out, it is outside the model: {names or len(elements)}')
