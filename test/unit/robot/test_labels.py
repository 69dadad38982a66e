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

"""Labels of points that do not overlap."""

from __future__ import annotations

from itertools import combinations
import math
from typing import Any

from drawn_robots import near
import numpy as np
from opencv_tools.robot.drawing.labels import Labels
import pytest
from rows import each_row


def test_labels_without_overlaps() -> None:
    axes = empty_axes()
    labels = Labels(axes)
    labels.avoid_line((0.0, 0.5), (1.0, 0.5))
    for index in range(12):
        labels.place(f'a_long_name_{index}', (0.5, 0.5))
    boxes = boxes_of(axes)
    assert len(boxes) == 12
    for one, other in combinations(boxes, 2):
        assert not one.overlaps(other)
    line = axes.transData.transform((0.5, 0.5))[1]
    assert not any(box.y0 < line < box.y1 for box in boxes)


def empty_axes() -> Any:
    """Create axes from 0 to 1 in a figure that has been laid out."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure
    figure = Figure(figsize=(8, 6), dpi=144)
    canvas: Any = FigureCanvasAgg(figure)
    axes = figure.add_subplot()
    canvas.figure.draw_without_rendering()
    return axes


def boxes_of(axes: Any) -> list[Any]:
    """Return the bounding boxes of texts, without the lines to their points."""
    from matplotlib.text import Text
    axes.figure.draw_without_rendering()
    return [Text.get_window_extent(text, axes.figure.canvas.get_renderer())
            for text in axes.texts if text.get_text()]


@each_row(('point', 'side', 'angle'), [
    ((0.5, 0.5), 'left', 25), ((0.999, 0.5), 'right', 155), ((0.5, 0.999), 'left', -60),
    ((0.999, 0.999), 'right', 240), ((0.001, 0.001), 'left', 60)])
def test_label_position_near_its_point(
        point: tuple[float, float], side: str, angle: float) -> None:
    axes = empty_axes()
    Labels(axes).place('a_long_name', point)
    label, = axes.texts
    turn = math.radians(angle)
    assert label.get_position() == pytest.approx((8 * math.cos(turn), 8 * math.sin(turn)))
    assert label.get_horizontalalignment() == side
    (box,), view = boxes_of(axes), axes.bbox
    assert view.x0 < box.x0 < box.x1 < view.x1 and view.y0 < box.y0 < box.y1 < view.y1


def test_labels_off_lines_and_lines_to_far_labels() -> None:
    axes = empty_axes()
    labels = Labels(axes)
    labels.avoid_line((0.3, 0.4), (0.7, 0.6))
    for _ in range(9):
        labels.place('a_long_name', (0.5, 0.5))
    texts = [text for text in axes.texts if text.get_text()]
    line = axes.transData.transform([(0.3 + 0.4 * part, 0.4 + 0.2 * part)
                                     for part in np.linspace(0, 1, 500)])
    for box in boxes_of(axes):
        assert not any(box.contains(*point) for point in line)
    far = [text.get_position() for text in texts
           if math.hypot(*text.get_position()) > 14.001]
    ties = [text for text in axes.texts if not text.get_text()]
    assert 0 < len(far) < 9
    assert near([tie.xyann for tie in ties], far)
    assert {tie.xy for tie in ties} == {(0.5, 0.5)}


def test_labels_off_other_texts() -> None:
    axes = empty_axes()
    labels = Labels(axes)
    labels.avoid_text(axes.text(0.51, 0.52, 'taken', fontsize=30))
    labels.place('a_name', (0.5, 0.5))
    taken, name = boxes_of(axes)
    assert not name.overlaps(taken)


def test_labels_without_a_free_position() -> None:
    axes = empty_axes()
    everywhere = Labels(axes)
    for row in range(101):
        everywhere.avoid_line((0.0, row / 100), (1.0, row / 100))
    for _ in range(2):
        everywhere.place('a_long_name', (0.999, 0.5))
    one, other = boxes_of(axes)
    assert not one.overlaps(other)
    crowded = Labels(axes)
    crowded.avoid_text(axes.text(0.5, 0.5, 'M', fontsize=1000, ha='center', va='center'))
    crowded.place('a_long_name', (0.999, 0.5))
    last, view = boxes_of(axes)[-1], axes.bbox
    for box in (one, other, last):
        assert view.x0 < box.x0 < box.x1 < view.x1 and view.y0 < box.y0 < box.y1 < view.y1


def test_label_of_a_point_outside_the_axes() -> None:
    axes = empty_axes()
    bounds = axes.figure.bbox
    Labels(axes, bounds).place('a_name', (1.02, 0.5))
    box, = boxes_of(axes)
    assert axes.bbox.x1 < box.x0 < box.x1 < bounds.width
    axes.figure.canvas.draw()
    pixels = np.asarray(axes.figure.canvas.buffer_rgba())[::-1]
    inside = pixels[int(box.y0):int(box.y1), int(box.x0):int(box.x1), :3]
    assert (inside.max(axis=2) < 100).sum() > 20
