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

"""The pages of the documentation: their blocks of code with marks, their links, their anchors."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
import re
import shutil

ROOT = Path(__file__).parents[2]
PAGES = tuple(path.relative_to(ROOT) for path in (
    ROOT / 'README.md', *sorted((ROOT / 'docs').rglob('*.md'))))

#: Languages of blocks that are run.
RUN = ('bash', 'console', 'python')
#: Languages of blocks that are shown.
SHOWN = ('', 'cpp', 'json', 'text', 'xml', 'yaml', '{toctree}')

#: Parts of the project that the commands of the pages use.
USED = ('Makefile', 'config', 'docs', 'examples', 'meshes', 'sdf', 'test/data', 'urdf')

# PyPI has no ros2 command, and a container often has no sudo.
_STAND_INS = {
    'ros2': """#!/bin/bash
[ "$1 $2" = 'run opencv_tools' ] && exec "${@:3}"
echo "ros2 $1 is not on PyPI: mark the block with 'needs ros'" >&2
exit 1
""",
    'sudo': '#!/bin/bash\nexec "$@"\n'}

#: Begin of the texts of nodes that have nothing to do. No block may wait for one.
NOTHING_SEEN = re.compile(r'[Nn]o |Waiting|Filtering')
#: Warnings at the end of an example that did nothing.
NOTHING_DONE = re.compile(r'No topic (of the bag is published|was recorded)')

_FENCE = re.compile(r'( *)(`{3,}|~{3,})([^`]*)$')
_MARK = re.compile(r'<!-- test: (.*) -->$')
_LINK = re.compile(
    r'!?\[(?:[^][]|\[[^]]*\])*\]\(\s*([^)\s]+)[^)]*\)'  # [text](target)
    r'|^\[[^]^]+\]:\s*(\S+)'                            # [text]: target
    r'|\bsrc="([^"]+)"', re.MULTILINE)


@dataclass(frozen=True, kw_only=True)
class Block:
    """
    A fenced block of code.

    :param page: path of its page in the project.
    :param line: number of the line of the fence, from 1.
    :param language: language of the fence.
    :param code: text between the fences, without their indentation.
    :param marks: what ``<!-- test: ... -->`` on the line before has, split at ``;``.
    """

    page: Path
    line: int
    language: str
    code: str
    marks: tuple[str, ...]

    @property
    def name(self) -> str:
        """Page and number of the line, as an editor reads them."""
        return f'{self.page}:{self.line}'

    @property
    def until(self) -> str:
        """Text in the output after which the block is interrupted; '' if it ends by itself."""
        return next((mark.removeprefix('until ') for mark in self.marks
                     if mark.startswith('until ')), '')

    @property
    def file(self) -> str:
        """Name of the file that a reader writes the block to; '' for a block that is run."""
        return next((mark.removeprefix('file ') for mark in self.marks
                     if mark.startswith('file ')), '')

    @property
    def is_run(self) -> bool:
        """Whether this machine can run the block: no camera, no ROS, no reason against it."""
        return not any(mark.startswith(('needs camera', 'needs ros', 'not run: '))
                       for mark in self.marks)

    def marks_are_known(self) -> bool:
        """Return whether every mark has a meaning."""
        known = re.compile(r'until \S.*|file \S+|needs (camera|root|ros)|not run: \S.*')
        return all(known.fullmatch(mark) for mark in self.marks)

    def commands(self) -> Iterator[tuple[str, str]]:
        """Yield the commands of a block of a shell, and the lines that a console shows below."""
        text = self.code.replace('\\\n', ' ')
        if self.language == 'console':
            for part in re.split(r'^\$ ', text, flags=re.MULTILINE)[1:]:
                command, _, shown = part.partition('\n')
                yield command, shown
        else:
            lines = iter(text.splitlines())
            for line in lines:
                if line.strip() and not line.startswith('#'):
                    here = re.search(r'<<(\w+)$', line)
                    document = [*_until_word(lines, here[1])] if here else []
                    yield '\n'.join([line, *document]), ''


def copy_used(root: Path) -> None:
    """Copy the files of the project that the pages use to a new folder."""
    for name in USED:
        if (ROOT / name).is_dir():
            shutil.copytree(ROOT / name, root / name)
        else:
            root.mkdir(exist_ok=True)
            shutil.copy(ROOT / name, root / name)


def add_stand_ins(folder: Path) -> None:
    """Write scripts for the commands that this machine does not have to a folder."""
    for name, text in _STAND_INS.items():
        if shutil.which(name) is None:
            (folder / name).write_text(text)
            (folder / name).chmod(0o755)


def matches(expected: str, output: str) -> bool:
    """Return whether an output has the expected lines; ``...`` stands for any text or lines."""
    pattern = ''.join(
        r'(?:.*\n)*?' if line.strip() == '...'
        else re.escape(line.rstrip()).replace(re.escape('...'), '.*') + r'[ \t]*\n'
        for line in expected.splitlines())
    return re.fullmatch(pattern, ''.join(f'{line}\n' for line in output.splitlines())) is not None


def read_blocks(page: Path) -> list[Block]:
    """
    Read the fenced blocks of a page.

    :raises ValueError: a block is not closed, or a mark is not on the line before a block.
    """
    found: list[Block] = []
    lines = (ROOT / page).read_text(encoding='utf-8').splitlines()
    numbers = iter(range(len(lines)))
    marks: tuple[str, ...] = ()
    for number in numbers:
        fence = _FENCE.match(lines[number])
        if fence:
            code = [line.removeprefix(fence[1]) for line in _until(lines, numbers, fence[2])]
            found.append(Block(page=page, line=number + 1, language=fence[3].strip(),
                               code='\n'.join(code) + '\n', marks=marks))
            marks = ()
            continue
        if marks:
            raise ValueError(f'{page}:{number}: the mark is not on the line before a block')
        mark = _MARK.match(lines[number].strip())
        if mark is None and re.search(r'<!-- *test\b', lines[number]):
            raise ValueError(f'{page}:{number + 1}: a mark is <!-- test: ... --> on its own line')
        if mark:
            marks = (mark[1],) if mark[1].startswith('not run:') else tuple(
                re.split(r'; *', mark[1]))
    if marks:
        raise ValueError(f'{page}: the last mark has no block')
    return found


def _until(lines: list[str], numbers: Iterator[int], fence: str) -> Iterator[str]:
    """Read the lines up to the closing fence."""
    for number in numbers:
        if lines[number].strip().startswith(fence) and not lines[number].strip(' `~'):
            return
        yield lines[number]
    raise ValueError(f'the last block with {fence} is not closed')


def _until_word(lines: Iterator[str], word: str) -> Iterator[str]:
    """Yield the lines of a here-document, and its last one, which is a word."""
    for line in lines:
        yield line
        if line == word:
            return


def _without_blocks(page: Path) -> str:
    text = (ROOT / page).read_text(encoding='utf-8')
    return re.sub(r'^( *)(`{3,}|~{3,}).*?^ *\2[`~]*$', '', text, flags=re.MULTILINE | re.DOTALL)


def read_spans(page: Path) -> list[str]:
    """Return the texts of the code spans of a page that are on one line."""
    return re.findall(r'(?<!`)`([^`\n]+)`(?!`)', _without_blocks(page))


def read_links(page: Path) -> list[str]:
    """Return the targets of the links and images of a page, but those in code."""
    text = re.sub(r'(`+)(?!`).+?(?<!`)\1(?!`)', 'code', _without_blocks(page))
    return [next(filter(None, link.groups())) for link in _LINK.finditer(text)]


def read_anchors(page: Path) -> set[str]:
    """Return the anchors of the headings of a page, as code hosts and MyST make them."""
    found: set[str] = set()
    for heading in re.findall(r'^#{1,6} +(.*?)[ #]*$', _without_blocks(page), re.MULTILINE):
        shown = re.sub(r'!?\[([^]]*)\]\([^)]*\)', r'\1', heading)
        slug = re.sub(r'[^\w\- ]', '', shown.strip().lower()).replace(' ', '-')
        numbered = (f'{slug}-{number}' for number in range(1, 1000))
        found.add(slug if slug not in found else next(
            name for name in numbered if name not in found))
    return found
