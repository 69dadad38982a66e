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

"""Figures of matplotlib: made without a display, laid out in inches, and saved."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

from opencv_tools.robot.frames.drawing import matplotlib_module
from opencv_tools.robot.xml.document import DescriptionError

SUFFIXES = ('.png', '.svg')
DPI = 120
# Not the user's own settings: one robot has one picture. Text stays text in SVG.
_SETTINGS = {'svg.hashsalt': 'opencv_tools', 'svg.fonttype': 'none', 'font.size': 9.0,
             'font.family': ['DejaVu Sans']}


def save(path: str, draw: Callable[[], Any]) -> None:
    """
    Write a picture to a PNG or SVG file.

    :param path: its suffix chooses one of both.
    :param draw: returns the figure.
    :raises DescriptionError: there is no such suffix, matplotlib is missing, or the file cannot be
        written.
    """
    suffix = Path(path).suffix.lower()
    if suffix not in SUFFIXES:
        raise DescriptionError(f'a picture is .png or .svg, not {suffix or "without a suffix"!r}',
                               source=path)
    with matplotlib_module().rc_context(_SETTINGS):
        figure = draw()
        try:
            figure.savefig(path, dpi=DPI, format=suffix[1:],
                           metadata={'Date': None} if suffix == '.svg' else None)
        except OSError as err:
            raise DescriptionError(f'cannot be written: {err.strerror}', source=path) from err


def new_figure() -> Any:
    """Return an empty figure, which pyplot does not keep."""
    figure = matplotlib_module('figure').Figure(dpi=DPI)
    matplotlib_module('backends.backend_agg').FigureCanvasAgg(figure)
    return figure


def in_inches(figure: Any, left: float, bottom: float, width: float, height: float
              ) -> tuple[float, float, float, float]:
    """Return a rectangle as a part of the figure, the way that `Axes.set_position` wants it."""
    whole, high = figure.get_size_inches()
    return left / whole, bottom / high, width / whole, height / high


def size_of(text: Any) -> tuple[float, float]:
    """Return the width and the height of a text in inches."""
    box = matplotlib_module('text').Text.get_window_extent(
        text, text.figure.canvas.get_renderer())
    return box.width / DPI, box.height / DPI
