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

"""Report of a conversion: what was preserved for the conversion back, and what was lossy."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field
from typing import Any

PRESERVED = 'preserved'  # kept in a namespace of its own; the conversion back restores it
LOSSY = 'lossy'  # changed or lost


class SourceLine(int):
    """
    Number of a line in a known file, for robots that are read from several files.

    :param source: name of the file; empty if it is unknown.
    """

    source: str

    def __new__(cls, line: int, source: str = '') -> SourceLine:
        new = super().__new__(cls, line)
        new.source = source
        return new


@dataclass(frozen=True, kw_only=True)
class Note:
    """
    A change that a conversion made to an element.

    :param level: ``PRESERVED`` or ``LOSSY``.
    :param name: name of the element or of its nearest owner; empty if neither has a name.
    :param line: line in the file; 0 if it is unknown.
    """

    level: str
    source: str
    element: str
    name: str
    line: int
    message: str

    def text(self) -> str:
        """Return the note as one line of text."""
        location = f'{self.source}:{self.line}' if self.line else self.source
        name = f' {self.name!r}' if self.name else ''
        return f'{location}: <{self.element}>{name}: {self.message}'


@dataclass
class Report:
    """
    Notes of one conversion of a file, in the order in which they were made.

    :param files: files that were read, and those that were searched in vain.
    """

    source: str = ''
    notes: list[Note] = field(default_factory=list)
    files: list[str] = field(default_factory=list)

    def preserve(self, element: str, name: str, line: int, message: str) -> None:
        """Add a note about an element that is preserved."""
        self._add(PRESERVED, element, name, line, message)

    def warn(self, element: str, name: str, line: int, message: str) -> None:
        """Add a note about an element that is changed or lost."""
        self._add(LOSSY, element, name, line, message)

    def _add(self, level: str, element: str, name: str, line: int, message: str) -> None:
        source = line.source if isinstance(line, SourceLine) else ''
        self.notes.append(Note(level=level, source=source or self.source, element=element,
                               name=name, line=int(line), message=message))

    @property
    def warnings(self) -> list[Note]:
        """All notes about elements that are changed or lost."""
        return [note for note in self.notes if note.level == LOSSY]

    def as_json(self) -> dict[str, Any]:
        """Return the notes as JSON, in one list for each level."""
        return {level: [{key: value for key, value in asdict(note).items() if key != 'level'}
                        for note in self.notes if note.level == level]
                for level in (LOSSY, PRESERVED)}
