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

"""What a conversion could not say in the other format, and what it kept for the way back."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field
from typing import Any

PRESERVED = 'preserved'  # kept in a namespace of its own; the way back restores it
LOSSY = 'lossy'  # means something else now, or is gone


class SourceLine(int):
    """
    A line that knows its file, for robots that are read from several.

    :param source: the name of the file; empty when that is not known.
    """

    source: str

    def __new__(cls, line: int, source: str = '') -> SourceLine:
        new = super().__new__(cls, line)
        new.source = source
        return new


@dataclass(frozen=True)
class Note:
    """
    One thing that a conversion did beyond writing the same in other words.

    :param level: ``carried`` or ``reported``.
    :param source: the file that it was found in.
    :param element: its tag.
    :param name: of the element, or of what it is in; empty when neither has one.
    :param line: in the file it comes from; 0 when that is not known.
    :param message: a sentence.
    """

    level: str
    source: str
    element: str
    name: str
    line: int
    message: str

    def text(self) -> str:
        """Give the note as a line of a terminal."""
        place = f'{self.source}:{self.line}' if self.line else self.source
        name = f' {self.name!r}' if self.name else ''
        return f'{place}: <{self.element}>{name}: {self.message}'


@dataclass
class Report:
    """
    The notes of one conversion, in the order in which they were made.

    :param source: the file that is being read.
    """

    source: str = ''
    notes: list[Note] = field(default_factory=list)

    def preserve(self, element: str, name: str, line: int, message: str) -> None:
        """Note what was kept in a namespace of its own."""
        self._note(PRESERVED, element, name, line, message)

    def warn(self, element: str, name: str, line: int, message: str) -> None:
        """Note what means something else now, or is gone."""
        self._note(LOSSY, element, name, line, message)

    def _note(self, level: str, element: str, name: str, line: int, message: str) -> None:
        source = line.source if isinstance(line, SourceLine) else ''
        self.notes.append(Note(level, source or self.source, element, name, int(line), message))

    @property
    def warnings(self) -> list[Note]:
        """Give what means something else now, or is gone."""
        return [note for note in self.notes if note.level == LOSSY]

    def as_json(self) -> dict[str, Any]:
        """Give both lists as JSON has them."""
        return {level: [{key: value for key, value in asdict(note).items() if key != 'level'}
                        for note in self.notes if note.level == level]
                for level in (LOSSY, PRESERVED)}
