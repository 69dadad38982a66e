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

"""Models of an SDF file: the model to read, and the models nested in it."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

from opencv_tools.robot.model import FrameId, MODEL
from opencv_tools.robot.sdf.includes import first_file, ModelFile, ModelLoader, NoModelError
from opencv_tools.robot.sdf.values import file_version, flag, MODEL_FRAME, SEPARATOR, text_of
from opencv_tools.robot.xml.document import (
    DescriptionError, Element, line_of, local_name, required_name, source_of, TrackedElement)
from opencv_tools.robot.xml.report import Report

_MODELS = ('model', 'include')


@dataclass(kw_only=True)
class Scope:
    """
    A model in which names are looked up: the robot itself, or a model nested in it.

    :param prefix: prefix of its names in the robot; empty, or ending in ``::``.
    :param parent: the enclosing model; None for the robot.
    :param nested: the models directly inside, in the order of the file.
    """

    file: ModelFile
    prefix: str = ''
    frame: FrameId = MODEL
    parent: Scope | None = None
    nested: list[Scope] = field(default_factory=list)

    @property
    def element(self) -> TrackedElement:
        """Element ``<model>``."""
        return self.file.element

    @property
    def is_merged(self) -> bool:
        """Whether its links belong to the enclosing model."""
        return self.parent is not None and self.prefix == self.parent.prefix

    def qualified(self, name: str) -> str:
        """Return the robot-wide name of an object of this model."""
        return self.prefix + name


def collect_scopes(root: Element, loader: ModelLoader, name: str, report: Report) -> list[Scope]:
    """
    Return the model to read, followed by all models nested in it.

    :param root: the ``<sdf>``.
    :param name: name of the model; empty if the file has only one.
    :raises DescriptionError: the model is missing, or the choice is ambiguous.
    """
    result = []
    pending = [Scope(file=_select_model(root, loader, name, report))]
    while pending:
        scope = pending.pop()
        result.append(scope)
        for child in scope.element.take_all(*_MODELS):
            scope.nested.append(_nested_scope(scope, child, loader, report))
        pending.extend(reversed(scope.nested))
    return result


def _nested_scope(parent: Scope, element: TrackedElement, loader: ModelLoader, report: Report
                  ) -> Scope:
    if local_name(element) == 'model':
        file = ModelFile(element, parent.file.version, parent.file.files)
    else:
        file = loader.load(element, parent.file.files)
        loader.count_elements(file)
    name = file.name
    if flag(element.get('merge'), element, 'merge'):
        frame = FrameId('frame', parent.qualified(f'_merged__{name}{MODEL_FRAME}'))
        report.preserve('include', name, line_of(element), 'merged into the enclosing model; '
                        f'frame {frame.name!r} marks the frame of the included model')
        return Scope(file=file, prefix=parent.prefix, frame=frame, parent=parent)
    prefix = f'{parent.qualified(name)}{SEPARATOR}'
    report.preserve(local_name(element), name, line_of(element),
                    f'nested model; its names get the prefix {prefix!r}')
    return Scope(file=file, prefix=prefix, frame=FrameId('frame', f'{prefix}{MODEL_FRAME}'),
                 parent=parent)


def _select_model(root: Element, loader: ModelLoader, name: str, report: Report) -> ModelFile:
    version = file_version(root, report)
    candidates = list(_candidate_models(root, loader))
    if not candidates:
        raise DescriptionError('has no model', root)
    names = [candidate for candidate, _ in candidates]
    if not name and len(candidates) > 1:
        raise DescriptionError(f'has {len(names)} models; select one with --model: '
                               f'{", ".join(names)}', root)
    if name and name not in names:
        raise DescriptionError(f'has no model {name!r}; select one of {", ".join(names)}', root)
    element = candidates[names.index(name) if name else 0][1]
    _report_outside(root, element, report)
    files = (first_file(source_of(root)),)
    if local_name(element) == 'include':
        return loader.load(TrackedElement(element), files)
    return ModelFile(TrackedElement(element), version, files)


def _candidate_models(root: Element, loader: ModelLoader) -> Iterator[tuple[str, Element]]:
    """Return each model of the file and of its worlds, with its name."""
    for holder in (root, *root.iterchildren('world')):
        for element in holder.iterchildren(*_MODELS):
            if local_name(element) == 'model':
                yield required_name(element), element
            elif name := _included_name(element, loader, first_file(source_of(root))):
                yield name, element


def _included_name(element: Element, loader: ModelLoader, file: Path) -> str:
    """Return the name of an included model; empty for a light and the like."""
    try:
        return loader.load(TrackedElement(element), (file,)).name
    except NoModelError:
        return ''
    except DescriptionError:
        # A missing file matters only if this model is selected.
        return text_of(element, 'name') or text_of(element, 'uri').rstrip('/').rpartition('/')[2]


def _report_outside(root: Element, selected: Element, report: Report) -> None:
    """Report the elements outside the selected model, one note for each tag."""
    outside: dict[str, list[Element]] = {}
    for holder in (root, *root.iterchildren('world')):
        for child in holder.iterchildren('*'):
            if child is not selected and local_name(child) != 'world':
                outside.setdefault(local_name(child), []).append(child)
    for tag, elements in outside.items():
        names = ', '.join(repr(name) for element in elements[:5]
                          if (name := element.get('name') or text_of(element, 'name')))
        report.warn(tag, '', line_of(elements[0]),
                    f'omitted, outside the model: {names or len(elements)}')
