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

from collections.abc import Iterator, Mapping, Sequence
import math
from pathlib import Path
from typing import Any

from opencv_tools.robot import schematic
from opencv_tools.robot.drawing import (
    AXIS_COLORS, DARK, GREY, Labels, matplotlib_module, moved, outline, PALE, plain, reach,
    SHAPE_COLORS, toolkit_module, UNITS)
from opencv_tools.robot.frames import frames, in_depth, joints_above, transform_of
from opencv_tools.robot.model import Robot
from opencv_tools.robot.pose import Transform, Vector
from opencv_tools.robot.report import Report
from opencv_tools.robot.xml import DescriptionError

SUFFIXES = ('.png', '.svg')
_SMALL = 4  # links of a robot whose side view is worth drawing
_MOST_NAMES = 40  # that are legible in one picture
_MOST_ROWS = 60
_DPI = 120
# Not what somebody's settings are: the same file for the same robot, with texts as text in SVG.
_SETTINGS = {'svg.hashsalt': 'opencv_tools', 'svg.fonttype': 'none', 'font.size': 9.0,
             'font.family': ['DejaVu Sans']}


def plot(robot: Robot, positions: Mapping[str, float], path: str, report: Report | None = None
         ) -> None:
    """
    Draw a robot into a PNG or SVG file.

    :param positions: of its joints, as for `frames.frames`.
    :param path: its suffix says which of both.
    :raises DescriptionError: there is no such suffix, matplotlib is missing, the file cannot be
        written, or the frames cannot be listed.
    """
    suffix = Path(path).suffix.lower()
    if suffix not in SUFFIXES:
        raise DescriptionError(f'a picture is .png or .svg, not {suffix or "without a suffix"!r}',
                               source=path)
    matplotlib = matplotlib_module()
    listing = frames(robot, positions, report)
    with matplotlib.rc_context(_SETTINGS):
        figure = draw(robot, listing, positions)
        try:
            figure.savefig(path, dpi=_DPI, format=suffix[1:],
                           metadata={'Date': None} if suffix == '.svg' else None)
        except OSError as err:
            raise DescriptionError(f'cannot be written: {err.strerror}', source=path) from err


def draw(robot: Robot, listing: Mapping[str, Any], positions: Mapping[str, float]) -> Any:
    """
    Return a figure of matplotlib: the view in space, the tree, and the side view of a small robot.

    :param listing: as `frames.frames` gives it at these positions.
    """
    # Neither pyplot nor a display: what pyplot makes stays in its memory.
    rows = min(len(listing['links']), _MOST_ROWS)
    small = len(listing['links']) <= _SMALL
    figure = matplotlib_module('figure').Figure(
        figsize=(13.0, 10.0 if small else max(7.5, 0.24 * rows + 1)), dpi=_DPI)
    matplotlib_module('backends.backend_agg').FigureCanvasAgg(figure)
    grid = figure.add_gridspec(
        2 if small else 1, 2, width_ratios=(1.5, 1.0), left=0.03, right=0.97, top=0.92,
        bottom=0.05, hspace=0.1, wspace=0.06, height_ratios=(1.0, 0.9) if small else None)
    figure.suptitle(plain(_title(robot, positions)), fontsize=14, fontweight='bold', color=DARK)
    space = figure.add_subplot(grid[0, 0], projection='3d')
    _draw_space(space, robot, listing)
    _draw_tree(figure.add_subplot(grid[0, 1]), listing)
    side = figure.add_subplot(grid[1, :]) if small else None
    if side:
        schematic.draw(side, robot, listing)
    figure.draw_without_rendering()  # labels are placed on what is laid out
    _name_frames(space, listing)
    if side:
        schematic.label(side, robot, listing)
    return figure


def _title(robot: Robot, positions: Mapping[str, float]) -> str:
    put = [f'{name} = {value:.4g}' for name, value in positions.items()]
    more = ', ...' if len(put) > 4 else ''
    return f'{robot.name}   {", ".join(put[:4])}{more}' if put else robot.name


def _draw_space(axes: Any, robot: Robot, listing: Mapping[str, Any]) -> None:
    """Draw the frames of the links as triads, with lines from each to those below it."""
    places = {name: transform_of(link['pose']) for name, link in listing['links'].items()}
    shapes = list(_outlines(robot, listing))
    points = [place.translation for place in places.values()] + [
        point for _, lines in shapes for line in lines for point in line]
    middle, halves = reach(points, 0.0)
    widest = max(halves) or 0.5
    halves_shown = [1.12 * max(half, 0.4 * widest) for half in halves]
    length = _triad_length(listing, places, widest)
    for kind, lines in shapes:
        _add_lines(axes, lines, SHAPE_COLORS[kind], 0.7)
    below = [(places[link['parent']].translation, places[name].translation)
             for name, link in listing['links'].items() if link['parent'] is not None]
    _add_lines(axes, below, GREY, 1.2)
    for unit, color in zip(UNITS, AXIS_COLORS):
        _add_lines(axes, [(place.translation, place.apply(_scaled(unit, length)))
                          for place in places.values()], color, 2.0)
    for setter, center, half, name, color in zip(
            (axes.set_xlim, axes.set_ylim, axes.set_zlim), middle, halves_shown, 'xyz',
            AXIS_COLORS):
        setter(center - half, center + half)
        getattr(axes, f'set_{name}label')(f'{name} [m]', color=color, fontsize=8)
        getattr(axes, f'{name}axis').set_major_locator(
            matplotlib_module('ticker').MaxNLocator(4))
        getattr(axes, f'{name}axis').set_pane_color((0.97, 0.97, 0.97, 1.0))
    axes.tick_params(labelsize=7, colors=GREY)
    axes.set_box_aspect(halves_shown, zoom=1.05)
    axes.view_init(elev=22, azim=-55)
    kinds = sorted({kind for kind, _ in shapes})
    axes.set_title('Frames of the links' + (f' ({", ".join(kinds)} in thin lines)'
                                            if kinds else ''), fontsize=10, color=GREY)


def _add_lines(axes: Any, lines: Sequence[Sequence[Vector]], color: str, width: float) -> None:
    # Each of two points: matplotlib 3.10 wants all lines to be of one length.
    pieces = [line[start:start + 2] for line in lines for start in range(len(line) - 1)]
    if pieces:
        collection = toolkit_module('art3d').Line3DCollection(
            pieces, colors=color, linewidths=width)
        collection.set_clip_on(False)  # what is drawn in is a square, however wide the room is
        axes.add_collection3d(collection)


def _outlines(robot: Robot, listing: Mapping[str, Any]
              ) -> Iterator[tuple[str, list[list[Vector]]]]:
    """Give the lines of all shapes whose size is known, placed, and what each is."""
    for link in robot.links:
        listed = listing['links'][link.name]
        for kind, shapes in (('visual', link.visuals), ('collision', link.collisions)):
            for shape, entry in zip(shapes, listed[f'{kind}s']):
                lines = outline(shape.geometry)
                if lines:
                    yield kind, moved(lines, transform_of(entry['pose']))


def _triad_length(listing: Mapping[str, Any], places: Mapping[str, Transform], widest: float
                  ) -> float:
    """Choose how long the axes of frames are: so that they are seen and do not touch."""
    steps = sorted(distance for name, link in listing['links'].items()
                   if link['parent'] is not None
                   and (distance := math.dist(places[name].translation,
                                              places[link['parent']].translation)) > 1e-9)
    typical = steps[len(steps) // 2] if steps else widest
    return min(0.3 * widest, max(0.06 * widest, 0.45 * typical))


def _scaled(vector: Vector, length: float) -> Vector:
    return (vector[0] * length, vector[1] * length, vector[2] * length)


def _name_frames(axes: Any, listing: Mapping[str, Any]) -> None:
    """Write the names of links beside their frames, as they are seen."""
    project = toolkit_module('proj3d').proj_transform
    labels = Labels(axes)
    links = list(listing['links'].items())
    places = {name: transform_of(link['pose']) for name, link in links}
    length = _triad_length(listing, places, max(reach(
        [place.translation for place in places.values()], 0.0)[1]))
    view = axes.get_proj()
    spots = {name: project(*place.translation, view)[:2] for name, place in places.items()}
    for name, link in links[:_MOST_NAMES]:
        if link['parent'] is not None:
            labels.avoid(spots[link['parent']], spots[name])
        for unit in UNITS:
            tip = places[name].apply(_scaled(unit, length))
            labels.avoid(spots[name], project(*tip, view)[:2])
    for name, _ in links[:_MOST_NAMES]:
        labels.place(name, spots[name], fontsize=8, color=DARK)
    if len(links) > _MOST_NAMES:
        axes.text2D(0.02, 0.02, f'names of {_MOST_NAMES} of {len(links)} links',
                    transform=axes.transAxes, fontsize=8, color=GREY)


def _draw_tree(axes: Any, listing: Mapping[str, Any]) -> None:
    """Draw the links, each below the one it hangs on, with the joint by which it does."""
    axes.set_axis_off()
    axes.set_title('Links, and the joints by which they hang', fontsize=10, color=GREY)
    rows = list(in_depth(listing))
    shown = rows[:_MOST_ROWS]
    above, spots = joints_above(listing), {}
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
        text = axes.text(x + 0.022, row, plain(name), va='center', fontsize=size, color=DARK,
                         fontweight='bold')
        if name in above:
            joint = listing['joints'][above[name]]
            axes.annotate(plain(f'   {above[name]} ({joint["type"]})'), (1, 0.5), xycoords=text,
                          va='center', fontsize=size, color=GREY, annotation_clip=False)
    if len(rows) > len(shown):
        axes.text(0.02, len(shown), f'and {len(rows) - len(shown)} more links', va='center',
                  fontsize=size, color=GREY)
