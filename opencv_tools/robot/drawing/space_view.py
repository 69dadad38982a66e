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

"""Perspective view of a robot: frames of the links, their names, and outlines of shapes."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from itertools import combinations
import math
from typing import Any

from opencv_tools.robot.drawing.figure import matplotlib_module, text_box
from opencv_tools.robot.drawing.labels import Labels
from opencv_tools.robot.drawing.primitives import (
    AXIS_COLORS, extent, GREY, placed_shapes, scaled, SHAPE_COLORS, TEXT_COLOR, UNITS)
from opencv_tools.robot.frames.listing import joint_origins, link_poses, Listing
from opencv_tools.robot.frames.text import link_text
from opencv_tools.robot.model import Robot
from opencv_tools.robot.pose import Transform, Vector

_TOOLKIT = 'mpl_toolkits.mplot3d'
_MAX_NAMES = 40  # more names are not legible


def title(robot: Robot, listing: Listing) -> str:
    """Return the title of the view."""
    kinds = sorted({shape.kind for shape in placed_shapes(robot, listing) if shape.lines})
    shapes = f' ({", ".join(kinds)} in thin lines)' if kinds else ''
    return f'Frames of the links{shapes}'


def draw(axes: Any, robot: Robot, listing: Listing) -> list[float]:
    """
    Draw the frames of the links as triads, with lines from parent to child links.

    :returns: half of the visible extent along each axis.
    """
    poses = link_poses(listing)
    shapes = list(placed_shapes(robot, listing))
    points = [pose.translation for group in (poses, joint_origins(listing))
              for pose in group.values()]
    points += [point for shape in shapes for line in shape.lines for point in line]
    length = _triad_length(listing, poses, max(extent(points)[1]) or 0.5)
    triads = [[[pose.translation, pose.apply(scaled(unit, length))] for pose in poses.values()]
              for unit in UNITS]
    centre, halves = extent([*points, *(tip for lines in triads for _, tip in lines)])
    visible = [1.05 * max(half, 0.4 * max(halves)) for half in halves]
    for shape in shapes:
        _add_lines(axes, shape.lines, SHAPE_COLORS[shape.kind], 0.7)
    _add_lines(axes, list(_link_lines(listing, poses)), GREY, 1.2)
    for lines, color in zip(triads, AXIS_COLORS):
        _add_lines(axes, lines, color, 2.0)
    for name, middle, half, color in zip('xyz', centre, visible, AXIS_COLORS):
        getattr(axes, f'set_{name}lim')(middle - half, middle + half)
        getattr(axes, f'set_{name}label')(f'{name} [m]', color=color, fontsize=8, rotation=0)
        axis = getattr(axes, f'{name}axis')
        axis.set_rotate_label(False)
        axis.set_major_formatter(matplotlib_module('ticker').FuncFormatter(
            lambda value, _: f'{value:.4g}'))
        axis.set_pane_color((0.97, 0.97, 0.97, 1.0))
    axes.tick_params(labelsize=7, colors=GREY)
    axes.view_init(elev=22, azim=-55)
    return visible


def fit(figure: Any, axes: Any, halves: Sequence[float], cell: Any) -> None:
    """Zoom and shift the view so that it fills its cell, a bounding box in pixels."""
    zoom = 1.0
    for ticks, pad in ((4, 4), (4, 10), (3, 16), (2, 22)):
        for axis in _axis_objects(axes):
            axis.set_major_locator(matplotlib_module('ticker').MaxNLocator(ticks))
            axis.labelpad = pad
        for _ in range(3):
            axes.set_box_aspect(halves, zoom=zoom)
            figure.draw_without_rendering()
            box = _bounding_box(figure, axes)
            zoom *= 0.99 * min(cell.width / box.width, cell.height / box.height)
            position = axes.get_position(original=True)
            axes.set_position((
                position.x0 + (cell.x0 + cell.x1 - box.x0 - box.x1) / 2 / figure.bbox.width,
                position.y0 + (cell.y0 + cell.y1 - box.y0 - box.y1) / 2 / figure.bbox.height,
                position.width, position.height))
        axes.set_box_aspect(halves, zoom=zoom)
        figure.draw_without_rendering()
        if not any(a.overlaps(b) for a, b in combinations(
                map(text_box, _tick_labels(axes)), 2)):
            break


def name_frames(axes: Any, listing: Listing, cell: Any) -> None:
    """Write the names of links beside their frames."""
    project = matplotlib_module('proj3d', _TOOLKIT).proj_transform
    labels = Labels(axes, cell)
    for text in _tick_labels(axes):
        labels.avoid_text(text)
    links, poses = list(listing['links'].items()), link_poses(listing)
    length = _triad_length(listing, poses, max(extent(
        [pose.translation for pose in poses.values()])[1]))
    view = axes.get_proj()
    points = {name: project(*pose.translation, view)[:2] for name, pose in poses.items()}
    for name, link in links[:_MAX_NAMES]:
        if link['parent'] is not None:
            labels.avoid_line(points[link['parent']], points[name])
        for unit in UNITS:
            tip = poses[name].apply(scaled(unit, length))
            labels.avoid_line(points[name], project(*tip, view)[:2])
    if len(links) > _MAX_NAMES:
        labels.avoid_text(axes.figure.text(
            *axes.figure.transFigure.inverted().transform(cell.p0),
            f'names of {_MAX_NAMES} of {len(links)} links', fontsize=8, color=GREY))
    for name, link in links[:_MAX_NAMES]:
        labels.place(link_text(name, link), points[name], fontsize=8, color=TEXT_COLOR)


def _axis_objects(axes: Any) -> tuple[Any, ...]:
    return axes.xaxis, axes.yaxis, axes.zaxis


def _bounding_box(figure: Any, axes: Any) -> Any:
    """Return the bounding box of the view in pixels, with ticks and their labels."""
    renderer, box = figure.canvas.get_renderer(), matplotlib_module('transforms').Bbox
    corners = [matplotlib_module('proj3d', _TOOLKIT).proj_transform(x, y, z, axes.get_proj())[:2]
               for x in axes.get_xlim() for y in axes.get_ylim() for z in axes.get_zlim()]
    view = box.null()
    view.update_from_data_xy(axes.transData.transform(corners))
    axis_boxes = [axis.get_tightbbox(renderer) for axis in _axis_objects(axes)]
    return box.union([view, *(each for each in axis_boxes if each is not None)])


def _tick_labels(axes: Any) -> list[Any]:
    """Return the texts of the axes of a 3D view, with their positions of the last drawing."""
    texts = []
    for axis, (low, high) in zip(_axis_objects(axes), (
            axes.get_xlim(), axes.get_ylim(), axes.get_zlim())):
        # Axis.get_ticklabels() would return positions of a 2D axis.
        texts += [axis.label, *(tick.label1 for value, tick in zip(
            axis.get_majorticklocs(), axis.majorTicks) if low <= value <= high)]
    return [text for text in texts if text.get_text()]


def _link_lines(listing: Listing, poses: Mapping[str, Transform]) -> Iterator[list[Vector]]:
    """Return lines from each parent link by the joint to the child link."""
    for name, origin in joint_origins(listing).items():
        parent, child = (listing['joints'][name][end] for end in ('parent', 'child'))
        start, end = poses[parent].translation, poses[child].translation
        apart = math.dist(origin.translation, end) > 1e-9
        yield [start, origin.translation, end] if apart else [start, end]


def _add_lines(axes: Any, lines: Sequence[Sequence[Vector]], color: str, width: float) -> None:
    # Each line is split into pairs of points, because matplotlib 3.10 wants equal lengths.
    pairs = [line[start:start + 2] for line in lines for start in range(len(line) - 1)]
    if pairs:
        collection = matplotlib_module('art3d', _TOOLKIT).Line3DCollection(
            pairs, colors=color, linewidths=width)
        collection.set_clip_on(False)  # the clip area is a square even if the cell is wide
        axes.add_collection3d(collection)


def _triad_length(listing: Listing, poses: Mapping[str, Transform], widest: float) -> float:
    """Return a length for the axes of frames at which they are visible and do not touch."""
    steps = sorted(distance for name, link in listing['links'].items()
                   if link['parent'] is not None
                   and (distance := math.dist(poses[name].translation,
                                              poses[link['parent']].translation)) > 1e-9)
    typical = steps[len(steps) // 2] if steps else widest
    return min(0.3 * widest, max(0.06 * widest, 0.45 * typical))
