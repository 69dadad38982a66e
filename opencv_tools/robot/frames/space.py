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

"""The view of a robot in space: the frames of its links, their names, and outlines of shapes."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from itertools import combinations
import math
from typing import Any

from opencv_tools.robot.frames.drawing import (
    AXIS_COLORS, DARK, GREY, matplotlib_module, moved, outline, reach, SHAPE_COLORS,
    toolkit_module, UNITS)
from opencv_tools.robot.frames.labels import Labels, Rectangle
from opencv_tools.robot.frames.listing import joint_places, transform_of
from opencv_tools.robot.frames.text import link_text
from opencv_tools.robot.model import Robot
from opencv_tools.robot.pose import Transform, Vector

_MOST_NAMES = 40  # that are legible in one picture


def title(robot: Robot, listing: Mapping[str, Any]) -> str:
    kinds = sorted({kind for kind, _ in _outlines(robot, listing)})
    shown = f' ({", ".join(kinds)} in thin lines)' if kinds else ''
    return f'Frames of the links{shown}'


def draw(axes: Any, robot: Robot, listing: Mapping[str, Any]) -> list[float]:
    """
    Draw the frames of the links as triads, with lines from each to those below it.

    :returns: half of the size of what is shown, along each axis.
    """
    places = {name: transform_of(link['pose']) for name, link in listing['links'].items()}
    shapes = list(_outlines(robot, listing))
    points = [place.translation for some in (places, joint_places(listing))
              for place in some.values()] + [
        point for _, lines in shapes for line in lines for point in line]
    widest = max(reach(points, 0.0)[1]) or 0.5
    length = _triad_length(listing, places, widest)
    triads = [[[place.translation, place.apply(_scaled(unit, length))]
               for place in places.values()] for unit in UNITS]
    middle, halves = reach([*points, *(tip for lines in triads for _, tip in lines)], 0.0)
    halves_shown = [1.05 * max(half, 0.4 * max(halves)) for half in halves]
    for kind, lines in shapes:
        _add_lines(axes, lines, SHAPE_COLORS[kind], 0.7)
    _add_lines(axes, list(_ways(listing, places)), GREY, 1.2)
    for lines, color in zip(triads, AXIS_COLORS):
        _add_lines(axes, lines, color, 2.0)
    for setter, center, half, name, color in zip(
            (axes.set_xlim, axes.set_ylim, axes.set_zlim), middle, halves_shown, 'xyz',
            AXIS_COLORS):
        setter(center - half, center + half)
        axis = getattr(axes, f'{name}axis')
        axis.set_rotate_label(False)
        getattr(axes, f'set_{name}label')(f'{name} [m]', color=color, fontsize=8, rotation=0)
        axis.set_major_formatter(matplotlib_module('ticker').FuncFormatter(
            lambda value, _: f'{value:.4g}'))
        axis.set_pane_color((0.97, 0.97, 0.97, 1.0))
    axes.tick_params(labelsize=7, colors=GREY)
    axes.view_init(elev=22, azim=-55)
    return halves_shown


def fit(figure: Any, axes: Any, halves: Sequence[float], cell: Rectangle) -> None:
    """Zoom and shift the view in space, so that all of it is in its cell."""
    zoom, (left, bottom, right, top) = 1.0, cell
    for count, pad in ((4, 4), (4, 10), (3, 16), (2, 22)):
        for axis in (axes.xaxis, axes.yaxis, axes.zaxis):
            axis.set_major_locator(matplotlib_module('ticker').MaxNLocator(count))
            axis.labelpad = pad
        for _ in range(3):
            axes.set_box_aspect(halves, zoom=zoom)
            figure.draw_without_rendering()
            a, b, c, d = _extent(figure, axes)
            zoom *= 0.99 * min((right - left) / (c - a), (top - bottom) / (d - b))
            # The middle of what is seen goes to the middle of the cell.
            x, y = (left + right - a - c) / 2, (bottom + top - b - d) / 2
            place = axes.get_position(original=True)
            width, height = figure.bbox.width, figure.bbox.height
            axes.set_position((place.x0 + x / width, place.y0 + y / height, place.width,
                               place.height))
        axes.set_box_aspect(halves, zoom=zoom)
        figure.draw_without_rendering()
        if not _ticks_overlap(figure, axes):
            break


def name_frames(axes: Any, listing: Mapping[str, Any], cell: Rectangle) -> None:
    """Write the names of links beside their frames, as they are seen."""
    project = toolkit_module('proj3d').proj_transform
    labels = Labels(axes, cell)
    for text in _tick_labels(axes):
        labels.avoid_text(text)
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
    if len(links) > _MOST_NAMES:
        labels.avoid_text(axes.figure.text(
            *axes.figure.transFigure.inverted().transform(cell[:2]),
            f'names of {_MOST_NAMES} of {len(links)} links', fontsize=8, color=GREY))
    for name, link in links[:_MOST_NAMES]:
        labels.place(link_text(name, link), spots[name], fontsize=8, color=DARK)


def _extent(figure: Any, axes: Any) -> Rectangle:
    """Return the room that the view in space takes, in pixels, with its ticks and their labels."""
    renderer = figure.canvas.get_renderer()
    boxes = [axis.get_tightbbox(renderer) for axis in (axes.xaxis, axes.yaxis, axes.zaxis)]
    corners = [toolkit_module('proj3d').proj_transform(x, y, z, axes.get_proj())[:2]
               for x in axes.get_xlim() for y in axes.get_ylim() for z in axes.get_zlim()]
    points = [*axes.transData.transform(corners), *(
        corner for box in boxes if box is not None
        for corner in ((box.x0, box.y0), (box.x1, box.y1)))]
    (left, right), (bottom, top) = ((min(column), max(column)) for column in zip(*points))
    return left, bottom, right, top


def _tick_labels(axes: Any) -> list[Any]:
    """Return the texts of the axes of a view in space, as they were drawn last."""
    texts = []
    for axis, (low, high) in zip((axes.xaxis, axes.yaxis, axes.zaxis),
                                 (axes.get_xlim(), axes.get_ylim(), axes.get_zlim())):
        # The axis itself would put its labels where an axis in a plane has them.
        texts += [axis.label, *(tick.label1 for at, tick in zip(
            axis.get_majorticklocs(), axis.majorTicks) if low <= at <= high)]
    return [text for text in texts if text.get_text()]


def _ticks_overlap(figure: Any, axes: Any) -> bool:
    boxes = [text.get_window_extent(figure.canvas.get_renderer()) for text in _tick_labels(axes)]
    return any(one.overlaps(other) for one, other in combinations(boxes, 2))


def _ways(listing: Mapping[str, Any], places: Mapping[str, Transform]
          ) -> Iterator[list[Vector]]:
    """Return the way from each link, by the joint, to the link below it."""
    for name, joint in joint_places(listing).items():
        parent, child = (listing['joints'][name][end] for end in ('parent', 'child'))
        start, end = places[parent].translation, places[child].translation
        apart = math.dist(joint.translation, end) > 1e-9
        yield [start, joint.translation, end] if apart else [start, end]


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
    """Return the lines of each shape of known size, in place, and its kind."""
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
