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

"""The side view of a small robot: the ground, frames, shapes, and how far they are apart."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

from opencv_tools.robot.frames.drawing import (
    AXIS_COLORS, bent, DARK, GREY, hull, moved, numbers, outline, PALE, plain, Point,
    SHAPE_COLORS, UNITS)
from opencv_tools.robot.frames.labels import Labels
from opencv_tools.robot.frames.listing import joint_places, transform_of
from opencv_tools.robot.frames.text import joint_text, link_text
from opencv_tools.robot.geometry import Mesh
from opencv_tools.robot.model import Robot, Shape
from opencv_tools.robot.pose import Transform

_MOST_SIZES = 10
_LEAST = 1e-6  # metres that are no distance


@dataclass(frozen=True)
class _Placed:
    """A visual or collision as it is seen from the side."""

    kind: str
    link: str
    shape: Shape
    place: Transform

    @property
    def center(self) -> Point:
        return _seen(self.place)

    @property
    def corners(self) -> list[Point]:
        return [(x, z) for line in moved(outline(self.shape.geometry), self.place)
                for x, _, z in line]

    @property
    def text(self) -> str:
        geometry = self.shape.geometry
        what = (geometry.uri.rpartition('/')[2] if isinstance(geometry, Mesh)
                else type(geometry).__name__.lower() if geometry else '')
        return f'{self.kind} {self.shape.name or f"of {self.link}"}' + (
            f' ({what})' if what else '')


def draw(axes: Any, robot: Robot, listing: Mapping[str, Any]) -> None:
    """Draw all but the texts: `label` places them where nothing else is."""
    shapes = list(_shapes(robot, listing))
    places = _places(listing)
    box = left, right, low, high = _box(listing, shapes)
    unit = max(right - left, high - low) or 1.0
    axes.set_aspect('equal', adjustable='datalim')
    axes.set_title(f'Side view: x to the right, z up, y away; metres. Links are in '
                   f'{plain(listing["root"])}, joints in the link above', fontsize=10, color=GREY)
    axes.set_axis_off()
    _draw_ground(axes, left - 0.5 * unit, right + 0.5 * unit, 0.03 * unit)
    for one in shapes:
        _draw_shape(axes, one)
    for place in places.values():
        _draw_triad(axes, place, _triad_length(listing, unit))
    _draw_joints(axes, listing, places)
    _draw_sizes(axes, listing, shapes, box, unit)


def label(axes: Any, robot: Robot, listing: Mapping[str, Any]) -> None:
    """Write the names of links, joints, visuals and collisions."""
    labels = Labels(axes)
    for text in axes.texts:
        if text.get_text():
            labels.avoid_text(text)
    for line in axes.lines:
        points = [(float(x), float(y)) for x, y in zip(*line.get_data())]
        for start, end in pairwise(points):
            labels.avoid(start, end)
    places, joints = _places(listing), joint_places(listing)
    left, right, low, high = _box(listing, list(_shapes(robot, listing)))
    length = _triad_length(listing, max(right - left, high - low) or 1.0)
    for place in places.values():
        _name_axes(labels, place, length)
    for name, place in places.items():
        link = listing['links'][name]
        pose = place.pose()
        labels.place(f'{link_text(name, link)}\n{numbers(pose.xyz, pose.rpy)}', _seen(place),
                     fontsize=8, fontweight='bold', color=DARK)
    for name, place in joints.items():
        joint = listing['joints'][name]
        labels.place(f'{joint_text(name, joint)}\n{numbers(**joint["in_parent"])}', _seen(place),
                     fontsize=8, color=GREY)
    for one in _shapes(robot, listing):
        labels.place(one.text, one.center, fontsize=8, color=SHAPE_COLORS[one.kind])


def _places(listing: Mapping[str, Any]) -> dict[str, Transform]:
    return {name: transform_of(link['pose']) for name, link in listing['links'].items()}


def _shapes(robot: Robot, listing: Mapping[str, Any]) -> Iterator[_Placed]:
    for link in robot.links:
        listed = listing['links'][link.name]
        for kind, shapes in (('visual', link.visuals), ('collision', link.collisions)):
            for shape, entry in zip(shapes, listed[f'{kind}s']):
                yield _Placed(kind, link.name, shape, transform_of(entry['pose']))


def _box(listing: Mapping[str, Any], shapes: list[_Placed]
         ) -> tuple[float, float, float, float]:
    """Return from where to where all reaches: left, right, low, high."""
    points = [_seen(place) for places in (_places(listing), joint_places(listing))
              for place in places.values()]
    points += [point for one in shapes for point in (one.center, *one.corners)]
    return (min(x for x, _ in points), max(x for x, _ in points),
            min(0.0, *(z for _, z in points)), max(z for _, z in points))


def _seen(place: Transform) -> Point:
    return place.translation[0], place.translation[2]


def _triad_length(listing: Mapping[str, Any], unit: float) -> float:
    spots = [_seen(place) for place in _places(listing).values()]
    steps = [distance for index, (a, b) in enumerate(spots) for c, d in spots[:index]
             if (distance := max(abs(c - a), abs(d - b))) > _LEAST]
    return max(0.06 * unit, min(0.16 * unit, 0.5 * min(steps, default=unit)))


def _draw_ground(axes: Any, left: float, right: float, depth: float) -> None:
    axes.plot([left, right], [0.0, 0.0], color=DARK, lw=1.4, zorder=1)
    # Not to be seen: it keeps names off the ground.
    axes.plot([left, right], [-depth / 2, -depth / 2], lw=0.0, zorder=0)
    axes.fill_between([left, right], [-depth, -depth], [0.0, 0.0], facecolor='white',
                      edgecolor=PALE, hatch='////', linewidth=0.0, zorder=0)


def _draw_shape(axes: Any, one: _Placed) -> None:
    color = SHAPE_COLORS[one.kind]
    if one.corners:
        xs, zs = zip(*hull(one.corners))
        axes.fill(xs, zs, facecolor=color, alpha=0.13, zorder=2)
        axes.plot([*xs, xs[0]], [*zs, zs[0]], color=color, lw=1.3, zorder=3)
    axes.plot(*([value] for value in one.center), 'D' if one.kind == 'visual' else 's',
              color=color, markersize=5, zorder=4)


def _draw_triad(axes: Any, place: Transform, length: float) -> None:
    start = _seen(place)
    for unit, color in zip(UNITS, AXIS_COLORS):
        x, y, z = place.rotate(unit)
        if abs(y) > 0.99:
            # It points away (a cross, as the end of an arrow is) or to whoever looks (a dot).
            axes.plot(*([value] for value in start), 'o', markersize=9, markerfacecolor='white',
                      markeredgecolor=color, markeredgewidth=1.6, zorder=8)
            axes.plot(*([value] for value in start), 'x' if y > 0 else '.', markersize=5,
                      color=color, zorder=9)
            continue
        end = (start[0] + length * x, start[1] + length * z)
        axes.plot(*zip(start, end), color=color, lw=0.1, zorder=6)
        axes.annotate('', end, xytext=start, zorder=7, arrowprops={
            'arrowstyle': '-|>', 'color': color, 'lw': 2.0, 'shrinkA': 0, 'shrinkB': 0})


def _name_axes(labels: Labels, place: Transform, length: float) -> None:
    for unit, color in zip(UNITS, AXIS_COLORS):
        x, y, z = place.rotate(unit)
        if abs(y) <= 0.99:
            start = _seen(place)
            labels.place_if_free(
                'xyz'[UNITS.index(unit)], (start[0] + length * x, start[1] + length * z),
                (5 * x, 5 * z), color=color, fontsize=8, zorder=9)


def _draw_joints(axes: Any, listing: Mapping[str, Any], places: Mapping[str, Transform]) -> None:
    """Draw a mark where each joint is, an arrow to it, and a line to a link that is elsewhere."""
    for name, place in joint_places(listing).items():
        joint = listing['joints'][name]
        start, end, link = (_seen(places[joint['parent']]), _seen(place),
                            _seen(places[joint['child']]))
        axes.plot(*([value] for value in end), 'h', markersize=14, markerfacecolor='none',
                  markeredgecolor=GREY, markeredgewidth=1.5, zorder=5)
        if _apart(end, link):
            axes.plot(*zip(end, link), color=GREY, lw=1.2, linestyle=':', zorder=5)
        if _apart(start, end):
            # Bent, because the axes of frames often lie right on the straight line.
            curve = bent(start, end, 0.35)
            axes.plot(*zip(*curve), color=GREY, lw=1.5, linestyle='--', zorder=5)
            axes.annotate('', curve[-1], xytext=curve[-2], zorder=5, arrowprops={
                'arrowstyle': '-|>', 'color': GREY, 'lw': 1.5, 'shrinkA': 0, 'shrinkB': 0})


def _apart(one: Point, other: Point) -> bool:
    return max(abs(one[0] - other[0]), abs(one[1] - other[1])) > _LEAST


def _draw_sizes(axes: Any, listing: Mapping[str, Any], shapes: list[_Placed],
                box: tuple[float, float, float, float], unit: float) -> None:
    """Draw how far links are from those above, and shapes from their links, with numbers."""
    places = _places(listing)
    joints, pairs = listing['joints'], []
    for name, place in joint_places(listing).items():
        pairs += [(_seen(places[joints[name]['parent']]), _seen(place), DARK),
                  (_seen(place), _seen(places[joints[name]['child']]), DARK)]
    pairs += [(_seen(places[one.link]), one.center, SHAPE_COLORS[one.kind]) for one in shapes]
    pairs = [pair for pair in dict.fromkeys(pairs) if _apart(*pair[:2])]
    left, _, _, high = box
    columns = rows = 0
    for (a, b), (c, d), color in pairs[:_MOST_SIZES]:
        if abs(d - b) > _LEAST:
            columns += 1
            x = left - (0.1 + 0.1 * columns) * unit
            _draw_size(axes, ((a, b), (x, b)), ((c, d), (x, d)), color)
            axes.text(x - 0.01 * unit, (b + d) / 2, f'{abs(d - b):.4g}', rotation=90, ha='right',
                      va='center', fontsize=9, color=color)
        if abs(c - a) > _LEAST:
            rows += 1
            z = high + (0.16 + 0.08 * rows) * unit
            _draw_size(axes, ((a, b), (a, z)), ((c, d), (c, z)), color)
            axes.text((a + c) / 2, z + 0.01 * unit, f'{abs(c - a):.4g}', ha='center', va='bottom',
                      fontsize=9, color=color)


def _draw_size(axes: Any, one: tuple[Point, Point], other: tuple[Point, Point], color: str
               ) -> None:
    for line in (one, other):
        axes.plot(*zip(*line), color=PALE, lw=0.7, zorder=1)
    axes.plot(*zip(one[1], other[1]), color=color, lw=0.1, zorder=1)
    axes.annotate('', other[1], xytext=one[1], zorder=6, arrowprops={
        'arrowstyle': '<|-|>', 'color': color, 'lw': 1.0, 'shrinkA': 0, 'shrinkB': 0})
