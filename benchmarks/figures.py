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

"""Figures of the benchmarks and their common table."""

from __future__ import annotations

import argparse
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass
import json
from pathlib import Path

_TITLES = ('benchmark', 'figure', 'value', 'goal', 'verdict')
_VALUE = _TITLES.index('value')


@dataclass(frozen=True)
class Figure:
    """
    What a benchmark measured.

    :param benchmark: such as ``bridge``.
    :param name: of what is measured.
    :param value: of it.
    :param unit: such as ``ms``, ``x``, ``%`` or ``frames/s``.
    :param goal: for people to read, such as ``at most 1.15``; empty when there is none.
    :param met: whether the goal is; None when there is none.
    """

    benchmark: str
    name: str
    value: float
    unit: str
    goal: str = ''
    met: bool | None = None


def add_json_option(parser: argparse.ArgumentParser) -> None:
    """Parse the path of the file for the figures, ``--json``; None without it."""
    parser.add_argument('--json', type=Path, metavar='FILE', help='also write the figures there')


def write_figures(path: Path, figures: Sequence[Figure]) -> None:
    """Write figures to a file."""
    path.write_text(json.dumps([asdict(figure) for figure in figures], indent=2) + '\n')


def print_figures(figures: Iterable[Figure], path: Path | None) -> list[Figure]:
    """Print each figure when it is measured, and write all to a file, unless it is None."""
    found = []
    for figure in figures:
        found.append(figure)
        print(f'{figure.name:70}{figure.value:10.3f} {figure.unit:6}{figure.goal}', flush=True)
    if path:
        write_figures(path, found)
    return found


def read_figures(path: Path) -> list[Figure]:
    """Read the figures that were written to a file."""
    return [Figure(**fields) for fields in json.loads(path.read_text())]


def table(figures: Sequence[Figure]) -> str:
    """Return figures as a Markdown table with aligned columns."""
    rows = [_TITLES, *(_cells(figure) for figure in figures)]
    widths = [max(len(cell) for cell in column) for column in zip(*rows)]
    rule = ['-' * width for width in widths]
    rule[_VALUE] = rule[_VALUE][1:] + ':'
    rows.insert(1, tuple(rule))
    return '\n'.join(_line(row, widths) for row in rows)


def _line(cells: Sequence[str], widths: Sequence[int]) -> str:
    """Return a line of the table; the values are right-aligned."""
    padded = [cell.rjust(width) if column == _VALUE else cell.ljust(width)
              for column, (cell, width) in enumerate(zip(cells, widths))]
    return f'| {" | ".join(padded)} |'


def _cells(figure: Figure) -> tuple[str, ...]:
    """Return the texts of a line; values have three significant digits."""
    digits = '#.3g' if abs(figure.value) < 100 else '.0f'
    value = f'{figure.value:{digits}}'.rstrip('.')
    verdict = {True: 'met', False: 'missed', None: ''}[figure.met]
    return figure.benchmark, figure.name, f'{value} {figure.unit}', figure.goal, verdict
