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

"""Side view of a small robot: ground, frames, shapes and distances."""

from __future__ import annotations

from collections.abc import Mapping
import math
from typing import Any

from opencv_tools.robot.drawing.labels import Labels
from opencv_tools.robot.drawing.primitives import (
    AXIS_COLORS, bezier_curve, GREY, hull, PALE, placed_shapes, PlacedShape, plain, Point,
    pose_text, SHAPE_COLORS, TEXT_COLOR, UNITS)
from opencv_tools.robot.frames.listing import joint_origins, link_poses, Listing
from opencv_tools.robot.frames.text import joint_text, link_text
from opencv_tools.robot.geometry import Mesh
from opencv_tools.robot.model import Robot
from opencv_tools.robot.pose import Transform

_MAX_DISTANCES = 10
_MIN_DISTANCE = 1e-6  # metres
_Bounds = tuple[float, float, float, float]  # left, right, low, high


def draw(axes: Any, robot: Robot, listing: Listing) -> tuple[list[PlacedShape], float]:
    """
    Draw everything except the labels, which `label` adds after the layout.

    :returns: all shapes, and the length of the axes of frames.
    """
    shapes = list(placed_shapes(robot, listing))
    poses = link_poses(listing)
    bounds = left, right, low, high = _bounds(listing, shapes)
    unit = max(right - left, high - low) or 1.0
    axes.set_aspect('equal', adjustable='datalim')
    axes.set_title('Side view in metres: x to the right, z up, y away. Links are in '
                   f'{plain(listing["root"])}, joints in their parent links', fontsize=10,
                   color=GREY)
    axes.set_axis_off()
    ends, depth = [left - 0.5 * unit, right + 0.5 * unit], 0.03 * unit
    axes.plot(ends, [0.0, 0.0], color=TEXT_COLOR, lw=1.4, zorder=1)
    # This invisible line keeps labels off the ground.
    axes.plot(ends, [-depth / 2, -depth / 2], lw=0.0, zorder=0)
    axes.fill_between(ends, [-depth, -depth], [0.0, 0.0], facecolor='white', edgecolor=PALE,
                      hatch='////', linewidth=0.0, zorder=0)
    for shape in shapes:
        _draw_shape(axes, shape)
    length = _triad_length(listing, unit)
    for pose in poses.values():
        _draw_triad(axes, pose, length)
    _draw_joints(axes, listing, poses)
    _draw_distances(axes, listing, shapes, bounds, unit)
    return shapes, length


def label(axes: Any, listing: Listing, shapes: list[PlacedShape], length: float) -> None:
    """Write the names of links, joints, visuals and collisions."""
    labels = Labels(axes)
    for text in axes.texts:
        if text.get_text():
            labels.avoid_text(text)
    for line in axes.lines:
        labels.avoid_line(*line.get_xydata())
    for transform in link_poses(listing).values():
        _label_axes(labels, transform, length)
    for name, transform in link_poses(listing).items():
        pose = transform.pose()
        text = f'{link_text(name, listing["links"][name])}\n{pose_text(pose.xyz, pose.rpy)}'
        labels.place(text, _seen(transform), fontsize=8, fontweight='bold', color=TEXT_COLOR)
    for name, origin in joint_origins(listing).items():
        joint = listing['joints'][name]
        text = f'{joint_text(name, joint)}\n{pose_text(**joint["in_parent"])}'
        labels.place(text, _seen(origin), fontsize=8, color=GREY)
    for shape in shapes:
        labels.place(_shape_text(shape), _seen(shape.pose), fontsize=8,
                     color=SHAPE_COLORS[shape.kind])


def _shape_text(shape: PlacedShape) -> str:
    geometry = shape.shape.geometry
    detail = (geometry.uri.rpartition('/')[2] if isinstance(geometry, Mesh)
              else type(geometry).__name__.lower() if geometry else '')
    return f'{shape.kind} {shape.shape.name or f"of {shape.link}"}' + (
        f' ({detail})' if detail else '')


def _corners(shape: PlacedShape) -> list[Point]:
    return [(x, z) for line in shape.lines for x, _, z in line]


def _bounds(listing: Listing, shapes: list[PlacedShape]) -> _Bounds:
    """Return the extent of the robot and the ground."""
    points = [_seen(pose) for poses in (link_poses(listing), joint_origins(listing))
              for pose in poses.values()]
    points += [point for shape in shapes for point in (_seen(shape.pose), *_corners(shape))]
    return (min(x for x, _ in points), max(x for x, _ in points),
            min(0.0, *(z for _, z in points)), max(z for _, z in points))


def _seen(pose: Transform) -> Point:
    return pose.translation[0], pose.translation[2]


def _triad_length(listing: Listing, unit: float) -> float:
    points = [_seen(pose) for pose in link_poses(listing).values()]
    distances = [distance for index, (a, b) in enumerate(points) for c, d in points[:index]
                 if (distance := max(abs(c - a), abs(d - b))) > _MIN_DISTANCE]
    return max(0.06 * unit, min(0.16 * unit, 0.5 * min(distances, default=unit)))


def _draw_shape(axes: Any, shape: PlacedShape) -> None:
    color, corners = SHAPE_COLORS[shape.kind], _corners(shape)
    if corners:
        xs, zs = zip(*hull(corners))
        axes.fill(xs, zs, facecolor=color, alpha=0.13, zorder=2)
        axes.plot([*xs, xs[0]], [*zs, zs[0]], color=color, lw=1.3, zorder=3)
    axes.plot(*_seen(shape.pose), 'D' if shape.kind == 'visual' else 's', color=color,
              markersize=5, zorder=4)


def _draw_triad(axes: Any, pose: Transform, length: float) -> None:
    start = _seen(pose)
    for unit, color in zip(UNITS, AXIS_COLORS):
        x, y, z = pose.rotate(unit)
        if abs(y) > 0.99:
            # A circle with a cross points away from the viewer, one with a dot to the viewer.
            axes.plot(*start, 'o', markersize=9, markerfacecolor='white',
                      markeredgecolor=color, markeredgewidth=1.6, zorder=8)
            axes.plot(*start, 'x' if y > 0 else '.', markersize=5, color=color, zorder=9)
            continue
        end = (start[0] + length * x, start[1] + length * z)
        _draw_arrow(axes, start, end, 7, color=color, lw=2.0)


def _draw_arrow(axes: Any, start: Point, end: Point, order: int, **style: Any) -> None:
    """Draw an arrow, and a thin line that keeps labels off it."""
    axes.plot(*zip(start, end), color=style['color'], lw=0.1, zorder=order - 1)
    axes.annotate('', end, xytext=start, zorder=order, arrowprops={
        'arrowstyle': '-|>', 'shrinkA': 0, 'shrinkB': 0, **style})


def _label_axes(labels: Labels, pose: Transform, length: float) -> None:
    start = _seen(pose)
    for name, unit, color in zip('xyz', UNITS, AXIS_COLORS):
        x, y, z = pose.rotate(unit)
        if abs(y) <= 0.99:
            labels.place_if_free(name, (start[0] + length * x, start[1] + length * z),
                                 (5 * x, 5 * z), color=color, fontsize=8, zorder=9)


def _draw_joints(axes: Any, listing: Listing, poses: Mapping[str, Transform]) -> None:
    """Draw each joint with an arrow from its parent link and a line to its child link."""
    for name, origin in joint_origins(listing).items():
        joint = listing['joints'][name]
        start, end, child = (_seen(poses[joint['parent']]), _seen(origin),
                             _seen(poses[joint['child']]))
        axes.plot(*end, 'h', markersize=14, markerfacecolor='none', markeredgecolor=GREY,
                  markeredgewidth=1.5, zorder=5)
        if math.dist(end, child) > _MIN_DISTANCE:
            axes.plot(*zip(end, child), color=GREY, lw=1.2, linestyle=':', zorder=5)
        if math.dist(start, end) > _MIN_DISTANCE:
            # The arrow is bent, because axes of frames often lie on the straight line.
            curve = bezier_curve(start, end, 0.35)
            axes.plot(*zip(*curve), color=GREY, lw=1.5, linestyle='--', zorder=5)
            _draw_arrow(axes, curve[-2], curve[-1], 5, color=GREY, lw=1.5)


def _draw_distances(axes: Any, listing: Listing, shapes: list[PlacedShape], bounds: _Bounds,
                    unit: float) -> None:
    """Draw the distances between parent links, joints, child links and shapes."""
    poses, joints, pairs = link_poses(listing), listing['joints'], []
    for name, origin in joint_origins(listing).items():
        pairs += [(_seen(poses[joints[name]['parent']]), _seen(origin), TEXT_COLOR),
                  (_seen(origin), _seen(poses[joints[name]['child']]), TEXT_COLOR)]
    pairs += [(_seen(poses[shape.link]), _seen(shape.pose), SHAPE_COLORS[shape.kind])
              for shape in shapes]
    pairs = [pair for pair in dict.fromkeys(pairs) if math.dist(*pair[:2]) > _MIN_DISTANCE]
    left, _, _, high = bounds
    columns = rows = 0
    for (a, b), (c, d), color in pairs[:_MAX_DISTANCES]:
        if abs(d - b) > _MIN_DISTANCE:
            columns += 1
            x = left - (0.1 + 0.1 * columns) * unit
            _draw_distance(axes, ((a, b), (x, b)), ((c, d), (x, d)), color)
            axes.text(x - 0.01 * unit, (b + d) / 2, f'{abs(d - b):.4g}', rotation=90, ha='right',
                      va='center', fontsize=9, color=color)
        if abs(c - a) > _MIN_DISTANCE:
            rows += 1
            z = high + (0.16 + 0.08 * rows) * unit
            _draw_distance(axes, ((a, b), (a, z)), ((c, d), (c, z)), color)
            axes.text((a + c) / 2, z + 0.01 * unit, f'{abs(c - a):.4g}', ha='center', va='bottom',
                      fontsize=9, color=color)


def _draw_distance(axes: Any, first: tuple[Point, Point], second: tuple[Point, Point], color: str
                   ) -> None:
    for line in (first, second):
        axes.plot(*zip(*line), color=PALE, lw=0.7, zorder=1)
    _draw_arrow(axes, first[1], second[1], 6, arrowstyle='<|-|>', color=color, lw=1.0)
