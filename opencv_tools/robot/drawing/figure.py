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

"""Matplotlib figures without a display, their layout in inches, and their files."""

from __future__ import annotations

from collections.abc import Callable
from importlib import import_module
from io import BytesIO
from pathlib import Path
from typing import Any

from opencv_tools.remedies import installation
from opencv_tools.robot.xml.document import DescriptionError
from opencv_tools.robot.xml.output import write_all

DPI = 120
_SUFFIXES = ('.png', '.svg')
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


def text_box(text: Any) -> Any:
    """Return the bounding box of a text in pixels, without the arrow of an annotation."""
    return matplotlib_module('text').Text.get_window_extent(
        text, text.figure.canvas.get_renderer())


def size_of(text: Any) -> tuple[float, float]:
    """Return the width and the height of a text in inches."""
    box = text_box(text)
    return box.width / DPI, box.height / DPI
