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

"""Matplotlib figures without a display, their columns of texts in inches, and their files."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from importlib import import_module
from io import BytesIO
from pathlib import Path
from typing import Any

from opencv_tools.base.remedies import installation
from opencv_tools.robot.drawing.primitives import GREY, PALE, plain, Point, TEXT_COLOR
from opencv_tools.robot.xml.document import DescriptionError
from opencv_tools.robot.xml.output import write_all

DPI = 120
_SUFFIXES = ('.png', '.svg')
_LINE_GAP, _ENTRY_GAP = 0.03, 0.08  # inches, in a column
# Settings of the user are ignored, so that each robot has one picture. SVG keeps text as text.
_SETTINGS = {'svg.hashsalt': 'opencv_tools', 'svg.fonttype': 'none', 'font.size': 9.0,
             'font.family': ['DejaVu Sans']}


def matplotlib_module(name: str = '', package: str = 'matplotlib') -> Any:
    """
    Import matplotlib or a module of it, because only pictures need it.

    :raises DescriptionError: matplotlib is not installed.
    """
    try:
        return import_module(f'{package}.{name}' if name else package)
    except ImportError as err:
        raise DescriptionError('pictures need matplotlib; '
                               f'{installation("matplotlib", "python3-matplotlib")}') from err


def save(path: str, draw: Callable[[], Any]) -> None:
    """
    Write a picture to a PNG or SVG file atomically.

    :param path: file name with the suffix of its format.
    :raises DescriptionError: the suffix is not supported, matplotlib is not installed, or the
        file cannot be written.
    """
    suffix = Path(path).suffix.lower()
    if suffix not in _SUFFIXES:
        raise DescriptionError(f'a picture needs the suffix .png or .svg, not {suffix!r}',
                               source=path)
    data = BytesIO()
    with matplotlib_module().rc_context(_SETTINGS):
        draw().savefig(data, dpi=DPI, format=suffix[1:],
                       metadata={'Date': None} if suffix == '.svg' else None)
    write_all([(path, data.getvalue())])


def new_figure() -> Any:
    """Return an empty figure that pyplot does not manage."""
    figure = matplotlib_module('figure').Figure(dpi=DPI)
    matplotlib_module('backends.backend_agg').FigureCanvasAgg(figure)
    return figure


def in_inches(figure: Any, left: float, bottom: float, width: float, height: float
              ) -> tuple[float, float, float, float]:
    """Return a rectangle in fractions of the figure, for `Axes.set_position`."""
    whole, high = figure.get_size_inches()
    return left / whole, bottom / high, width / whole, height / high


def size_of(text: Any) -> tuple[float, float]:
    """Return the width and the height of a text in inches."""
    box = text.get_window_extent(text.figure.canvas.get_renderer())
    return box.width / DPI, box.height / DPI


@dataclass(frozen=True)
class Entry:
    """
    A bold title and grey numbers for a point of the drawing.

    :param rank: entries with a lower rank remain if there is no room for all.
    """

    title: str
    numbers: str
    point: Point
    on_left: bool = False
    rank: int = 0


class Column:
    """A column of entries, each near the height of its point."""

    def __init__(self, axes: Any, entries: Sequence[Entry]) -> None:
        self._axes = axes
        self._entries = sorted(entries, key=lambda entry: -entry.point[1])
        self._texts = [[axes.text(0, 0, plain(text), fontsize=8, color=color, va='top',
                                  fontweight=weight, linespacing=1.15)
                        for text, color, weight in ((entry.title, TEXT_COLOR, 'bold'),
                                                    (entry.numbers, GREY, 'normal')) if text]
                       for entry in self._entries]
        self._sizes = [[size_of(text) for text in texts] for texts in self._texts]
        self._heights = [sum(high for _, high in sizes) + _LINE_GAP for sizes in self._sizes]
        self.width = max((wide for sizes in self._sizes for wide, _ in sizes), default=0.0)
        self.height = sum(self._heights) + _ENTRY_GAP * len(self._heights)

    def lay_out(self, x: float, side: int, ends: Point, scale: float) -> None:
        """
        Place the texts and draw their lines.

        :param side: -1 for a column left of the drawing, 1 for a column right of it.
        :param scale: inches for each unit of the axes.
        """
        middles = _spread([entry.point[1] for entry in self._entries],
                          [(height + _ENTRY_GAP) / scale for height in self._heights], *ends)
        for index, (entry, middle) in enumerate(zip(self._entries, middles)):
            y = middle + self._heights[index] / 2 / scale
            for text, (_, high) in zip(self._texts[index], self._sizes[index]):
                text.set_position((x, y))
                text.set_horizontalalignment('left' if side > 0 else 'right')
                y -= (high + _LINE_GAP) / scale
            self._axes.plot([x - side * 0.05 / scale, entry.point[0]], [middle, entry.point[1]],
                            color=PALE, lw=0.7, zorder=3)


def _spread(targets: Sequence[float], heights: Sequence[float], bottom: float, top: float
            ) -> list[float]:
    """Return the middles of boxes that do not overlap, near their targets, from top to bottom."""
    middles: list[float] = []
    for middle, height in zip(targets, heights):
        middles.append(min(middle, top - height / 2))
        top = middles[-1] - height / 2
    for index in reversed(range(len(middles))):
        middles[index] = max(middles[index], bottom + heights[index] / 2)
        bottom = middles[index] + heights[index] / 2
    return middles
