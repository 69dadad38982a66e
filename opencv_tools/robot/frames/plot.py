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

"""A picture of a robot: its frames in space, the tree of its links, and a side view with sizes."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from opencv_tools.robot.frames import schematic, space
from opencv_tools.robot.frames.drawing import DARK, GREY, PALE, plain
from opencv_tools.robot.frames.figures import in_inches, new_figure, save, size_of
from opencv_tools.robot.frames.labels import Rectangle
from opencv_tools.robot.frames.listing import depth_first, frames, parent_joints
from opencv_tools.robot.frames.text import heading, joint_text, link_text
from opencv_tools.robot.model import Robot
from opencv_tools.robot.xml.report import Report

_SMALL = 4  # links of a robot whose side view is worth drawing
_MOST_ROWS = 60
# In inches.
_MARGIN, _TITLE, _HEAD = 0.3, 0.55, 0.3
_LEFT, _RIGHT = 7.5, 4.6  # widths of the view in space and, at least, of the tree
_SIDE = 4.3  # height of the side view


def plot(robot: Robot, positions: Mapping[str, float], path: str, report: Report | None = None
         ) -> None:
    """
    Draw a robot into a PNG or SVG file.

    :param positions: of its joints, as for `frames.frames`.
    :param path: its suffix says which of both.
    :raises DescriptionError: there is no such suffix, matplotlib is missing, the file cannot be
        written, or the frames cannot be listed.
    """
    save(path, lambda: draw(robot, frames(robot, positions, report)))


def draw(robot: Robot, listing: Mapping[str, Any]) -> Any:
    """
    Return a figure of matplotlib: the view in space, the tree, and the side view of a small robot.

    :param listing: as `frames.frames` returns it.
    """
    rows = min(len(listing['links']), _MOST_ROWS)
    small = len(listing['links']) <= _SMALL
    high = 4.7 if small else max(6.5, 0.24 * rows)
    side_high = _SIDE + _MARGIN if small else 0.0
    top = _MARGIN + side_high + high - _HEAD
    figure = new_figure()
    figure.set_size_inches(2 * _MARGIN + _LEFT + 0.3 + _RIGHT,
                           2 * _MARGIN + _TITLE + high + side_high)
    view = figure.add_axes((0, 0, 1, 1), projection='3d')
    tree = figure.add_axes((0, 0, 1, 1))
    halves = space.draw(view, robot, listing)
    _draw_tree(tree, listing)
    tree_width = _lay_out_tree(figure, tree, side_high + _MARGIN, high)
    view.set_position(in_inches(figure, _MARGIN, _MARGIN + side_high, _LEFT, high - _HEAD))
    whole, tall = figure.get_size_inches()
    title = figure.text(0.5, 1 - (_MARGIN + 0.3 * _TITLE) / tall, plain(heading(listing), 150),
                        fontsize=14, fontweight='bold', color=DARK, ha='center', va='center')
    title.set_fontsize(14 * min(1.0, (whole - 2 * _MARGIN) / size_of(title)[0]))
    figure.text(*in_inches(figure, _MARGIN + _LEFT / 2, top + 0.083, 0, 0)[:2],
                space.title(robot, listing), fontsize=10, color=GREY, ha='center')
    side = None
    if small:
        width = _LEFT + 0.3 + tree_width
        side = figure.add_axes(in_inches(figure, _MARGIN, _MARGIN, width, _SIDE - _HEAD))
        schematic.draw(side, robot, listing)
    cell = _pixels(figure, _MARGIN, side_high + _MARGIN, _LEFT, high - _HEAD)
    space.fit(figure, view, halves, cell)
    space.name_frames(view, listing, cell)
    if side:
        schematic.label(side, robot, listing)
    return figure


def _pixels(figure: Any, left: float, bottom: float, width: float, height: float) -> Rectangle:
    dpi = figure.dpi
    return left * dpi, bottom * dpi, (left + width) * dpi, (bottom + height) * dpi


def _lay_out_tree(figure: Any, tree: Any, bottom: float, height: float) -> float:
    """Make the figure as wide as the texts of the tree need it, and return the tree's width."""
    tree.set_position(in_inches(figure, 2 * _MARGIN + _LEFT, bottom, _RIGHT, height - _HEAD))
    figure.draw_without_rendering()
    start, end = (tree.transAxes.transform((x, 0))[0] for x in (0, 1))
    width = _RIGHT
    for text in tree.texts:
        box = text.get_window_extent(figure.canvas.get_renderer())
        row = text.xycoords if hasattr(text, 'xycoords') else text
        x = row.get_position()[0]
        reach_ = box.x1 - (start + x * (end - start))
        width = max(width, (reach_ / figure.dpi + 0.05) / (1 - x))
    whole = 2 * _MARGIN + _LEFT + 0.3 + width
    figure.set_size_inches(whole, figure.get_size_inches()[1])
    tree.set_position(in_inches(figure, _MARGIN + _LEFT + 0.3, bottom, width, height - _HEAD))
    return width


def _draw_tree(axes: Any, listing: Mapping[str, Any]) -> None:
    """Draw the links, each below the one it hangs on, with the joint by which it does."""
    axes.set_axis_off()
    axes.set_title('Links, and the joints by which they hang', fontsize=10, color=GREY)
    rows = list(depth_first(listing))
    shown = rows[:_MOST_ROWS]
    above, spots = parent_joints(listing), {}
    step = min(0.07, 0.45 / max(1, *(depth for _, depth in shown)))
    height = max(len(shown) + (len(rows) > len(shown)), 10)
    axes.set_xlim(0, 1)
    axes.set_ylim(height, -0.5)
    size = min(9.0, max(5.0, 360 / height))
    for row, (name, depth) in enumerate(shown):
        x = 0.02 + step * depth
        spots[name] = (x, row)
        parent = spots.get(listing['links'][name]['parent'])
        if parent:
            axes.plot([parent[0], parent[0], x], [parent[1] + 0.2, row, row], color=PALE, lw=1.0,
                      solid_joinstyle='miter', zorder=1)
        axes.plot([x], [row], 'o', color=DARK, markersize=size / 2, zorder=2)
        text = axes.text(x + 0.022, row, plain(link_text(name, listing['links'][name])),
                         va='center', fontsize=size, color=DARK, fontweight='bold')
        if name in above:
            joint = listing['joints'][above[name]]
            axes.annotate(plain(f'   {joint_text(above[name], joint)}'), (1, 0.5), xycoords=text,
                          va='center', fontsize=size, color=GREY, annotation_clip=False)
    if len(rows) > len(shown):
        axes.text(0.02, len(shown), f'and {len(rows) - len(shown)} more links', va='center',
                  fontsize=size, color=GREY)
