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

"""Picture of a robot: perspective view, kinematic tree, and side view of a small robot."""

from __future__ import annotations

from typing import Any

from opencv_tools.robot.drawing import side_view, space_view
from opencv_tools.robot.drawing.figure import (
    DPI, in_inches, matplotlib_module, new_figure, save, size_of)
from opencv_tools.robot.drawing.primitives import GREY, PALE, plain, TEXT_COLOR
from opencv_tools.robot.frames.listing import depth_first, Listing, parent_joints
from opencv_tools.robot.frames.text import heading, joint_text, link_text
from opencv_tools.robot.model import Robot

_MAX_LINKS = 4  # of a robot with a side view
_MAX_ROWS = 60
# Inches.
_MARGIN, _TITLE, _HEAD, _GAP = 0.3, 0.55, 0.3, 0.3
_VIEW_WIDTH, _TREE_WIDTH = 7.5, 4.6  # the tree may be wider
_SIDE_HEIGHT = 4.3


def plot(robot: Robot, listing: Listing, path: str) -> None:
    """
    Draw a robot into a PNG or SVG file.

    :param listing: a result of `listing.frames`.
    :param path: file name with the suffix of its format.
    :raises DescriptionError: matplotlib is not installed, or the file cannot be written.
    """
    save(path, lambda: draw(robot, listing))


def draw(robot: Robot, listing: Listing) -> Any:
    """Return a matplotlib figure of a robot."""
    small = len(listing['links']) <= _MAX_LINKS
    height = 4.7 if small else max(6.5, 0.24 * min(len(listing['links']), _MAX_ROWS))
    bottom = _MARGIN + (_SIDE_HEIGHT + _MARGIN if small else 0.0)
    figure = new_figure()
    figure.set_size_inches(2 * _MARGIN + _VIEW_WIDTH + _GAP + _TREE_WIDTH,
                           bottom + height + _TITLE + _MARGIN)
    view = figure.add_axes((0, 0, 1, 1), projection='3d')
    tree = figure.add_axes((0, 0, 1, 1))
    halves = space_view.draw(view, robot, listing)
    _draw_tree(tree, listing)
    tree_width = _lay_out_tree(figure, tree, bottom, height - _HEAD)
    cell = (_MARGIN, bottom, _VIEW_WIDTH, height - _HEAD)
    view.set_position(in_inches(figure, *cell))
    width, high = figure.get_size_inches()
    title = figure.text(0.5, 1 - (_MARGIN + 0.3 * _TITLE) / high, plain(heading(listing), 150),
                        fontsize=14, fontweight='bold', color=TEXT_COLOR, ha='center', va='center')
    title.set_fontsize(14 * min(1.0, (width - 2 * _MARGIN) / size_of(title)[0]))
    figure.text(*in_inches(figure, _MARGIN + _VIEW_WIDTH / 2, bottom + height - _HEAD + 0.083,
                           0, 0)[:2], space_view.title(robot, listing), fontsize=10, color=GREY,
                ha='center')
    if small:
        width = _VIEW_WIDTH + _GAP + tree_width
        side = figure.add_axes(in_inches(figure, _MARGIN, _MARGIN, width, _SIDE_HEIGHT - _HEAD))
        drawn = side_view.draw(side, robot, listing)
    pixels = matplotlib_module('transforms').Bbox.from_bounds(*(DPI * value for value in cell))
    space_view.fit(figure, view, halves, pixels)
    space_view.name_frames(view, listing, pixels)
    if small:
        side_view.label(side, listing, *drawn)
    return figure


def _lay_out_tree(figure: Any, tree: Any, bottom: float, height: float) -> float:
    """Widen the figure for the texts of the tree, and return the width of the tree."""
    left = _MARGIN + _VIEW_WIDTH + _GAP
    tree.set_position(in_inches(figure, left, bottom, _TREE_WIDTH, height))
    width = _TREE_WIDTH
    for text in tree.texts:
        x, _ = getattr(text, 'xycoords', text).get_position()  # of the link in this row
        box = text.get_window_extent(figure.canvas.get_renderer())
        needed = box.x1 / DPI - left - x * _TREE_WIDTH + 0.05
        width = max(width, needed / (1 - x))
    figure.set_size_inches(left + width + _MARGIN, figure.get_size_inches()[1])
    tree.set_position(in_inches(figure, left, bottom, width, height))
    return width


def _draw_tree(axes: Any, listing: Listing) -> None:
    """Draw the links in rows, each below its parent link and with its parent joint."""
    axes.set_axis_off()
    axes.set_title('Kinematic tree', fontsize=10, color=GREY)
    rows = list(depth_first(listing))
    shown = rows[:_MAX_ROWS]
    parents, points = parent_joints(listing), {}
    step = min(0.07, 0.45 / max(1, *(depth for _, depth in shown)))
    height = max(len(shown) + (len(rows) > len(shown)), 10)
    axes.set_xlim(0, 1)
    axes.set_ylim(height, -0.5)
    size = min(9.0, max(5.0, 360 / height))
    for row, (name, depth) in enumerate(shown):
        x = 0.02 + step * depth
        points[name] = (x, row)
        parent = points.get(listing['links'][name]['parent'])
        if parent:
            axes.plot([parent[0], parent[0], x], [parent[1] + 0.2, row, row], color=PALE, lw=1.0,
                      solid_joinstyle='miter', zorder=1)
        axes.plot([x], [row], 'o', color=TEXT_COLOR, markersize=size / 2, zorder=2)
        text = axes.text(x + 0.022, row, plain(link_text(name, listing['links'][name])),
                         va='center', fontsize=size, color=TEXT_COLOR, fontweight='bold')
        if name in parents:
            joint = joint_text(parents[name], listing['joints'][parents[name]])
            axes.annotate(plain(f'   {joint}'), (1, 0.5), xycoords=text, va='center',
                          fontsize=size, color=GREY, annotation_clip=False)
    if len(rows) > len(shown):
        axes.text(0.02, len(shown), f'and {len(rows) - len(shown)} more links', va='center',
                  fontsize=size, color=GREY)
