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

"""A picture of the two conventions: URDF places the joints of a robot, and SDF its links."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
import math
from typing import Any

from opencv_tools.robot.frames.columns import Column, Entry
from opencv_tools.robot.frames.drawing import (
    AXIS_COLORS, bent, DARK, GREY, hull, matplotlib_module, moved, numbers, outline, plain,
    Point, SHAPE_COLORS, UNITS)
from opencv_tools.robot.frames.figures import in_inches, new_figure, save, size_of
from opencv_tools.robot.frames.listing import depth_first, frames
from opencv_tools.robot.frames.text import heading, joint_text, link_text
from opencv_tools.robot.kinematics import Kinematics, with_mimics
from opencv_tools.robot.model import FrameId, MODEL, Robot
from opencv_tools.robot.pose import IDENTITY, Transform, Vector
from opencv_tools.robot.xml.report import Report

_FEW = 8  # links up to which all numbers stand on the right, and names on the left
_MOST = 60  # links with numbers
_MOST_ARROWS = 300  # with heads, which take their time
_WIDTH, _HEIGHT = 3.2, 4.2  # inches of the drawing: the most, and the least
_GAP, _MARGIN, _HEAD, _TITLE = 0.3, 0.25, 0.65, 0.3  # inches
_BEND = 0.25
_AZIMUTH, _ELEVATION = math.radians(-55), math.radians(22)  # of the eye, as in the view in space


@dataclass
class _Panel:
    """One convention: the frames that it has, and what it places by which numbers."""

    title: str
    text: str
    frames: list[Transform] = field(default_factory=list)
    arrows: list[tuple[Point, Point]] = field(default_factory=list)
    offsets: list[tuple[Point, Point]] = field(default_factory=list)
    joints: list[Point] = field(default_factory=list)
    entries: list[Entry] = field(default_factory=list)


def plot_conventions(robot: Robot, positions: Mapping[str, float], path: str,
                     report: Report | None = None) -> None:
    """
    Draw the joints that URDF places beside the links that SDF places, into a PNG or SVG file.

    :param positions: of its joints, as for `frames.frames`.
    :raises DescriptionError: as `plot.plot`.
    """
    save(path, lambda: draw(robot, frames(robot, positions, report), positions))


def draw(robot: Robot, listing: Mapping[str, Any], positions: Mapping[str, float]) -> Any:
    """
    Return a figure of matplotlib with a panel for each convention.

    :param listing: as `frames.frames` returns it at these positions.
    """
    kinematics = Kinematics(robot)
    poses = kinematics.forward(with_mimics(robot, {name: (at,) for name, at in positions.items()}))
    shapes = [(kind, [[_seen(point) for point in line] for line in moved(
                  lines, poses[FrameId('link', link.name)] @ kinematics.within(
                      FrameId('link', link.name), shape.placement).transform())])
              for link in robot.links
              for kind, some in (('visual', link.visuals), ('collision', link.collisions))
              for shape in some if (lines := outline(shape.geometry))]
    panels = [_urdf(listing, kinematics, poses), _sdf(listing, kinematics, poses)]
    figure = new_figure()
    views = [_View(figure.add_axes((0, 0, 1, 1)), panel, shapes) for panel in panels]
    title = figure.text(0.5, 0.5, plain(heading(listing), 150), fontsize=13, fontweight='bold',
                        color=DARK, ha='center', va='center')
    low, high = ([end(values) for values in zip(*(view.bounds[index] for view in views))]
                 for index, end in enumerate((min, max)))
    size = [max(end - start, 1e-9) for start, end in zip(low, high)]
    height = max(min(_HEIGHT, _WIDTH * size[1] / size[0]), *(view.text_height for view in views))
    scale = min(_WIDTH / size[0], height / size[1])
    widths = [view.lay_out(height, low, size, scale) for view in views]
    whole = max(sum(widths) + 3 * _MARGIN, size_of(title)[0] + 2 * _MARGIN)
    figure.set_size_inches(whole, height + _HEAD + _TITLE + 2 * _MARGIN)
    left = (whole - sum(widths) - _MARGIN) / 2
    for view, width in zip(views, widths):
        view.axes.set_position(in_inches(figure, left, _MARGIN, width, height + _HEAD))
        left += width + _MARGIN
    title.set_y(1 - (_MARGIN + _TITLE / 3) / figure.get_size_inches()[1])
    return figure


def _urdf(listing: Mapping[str, Any], kinematics: Kinematics, poses: Mapping[FrameId, Transform]
          ) -> _Panel:
    def home(link: str) -> FrameId:
        """Return the frame that URDF means by a link: that of the joint above it."""
        above = kinematics.parent_joint.get(link)
        return FrameId('joint', above.name) if above else FrameId('link', link)

    panel = _Panel('URDF: joints are placed', 'each <origin> is in the frame of the link above')
    names = [name for name, _ in depth_first(listing)]
    for name in names:
        place, above = poses[home(name)], kinematics.parent_joint.get(name)
        panel.frames.append(place)
        if len(names) <= _FEW:
            panel.entries.append(Entry(name, '', _seen(place.translation), on_left=True))
        if above:
            origin = kinematics.between(home(above.parent), FrameId('joint', above.name))
            parent = poses[home(above.parent)]
            point = _seen((parent @ origin.transform()).translation)
            panel.arrows.append((_seen(parent.translation), point))
            panel.offsets.append((point, _seen(place.translation)))
            panel.joints.append(point)
            panel.entries.append(Entry(
                joint_text(above.name, listing['joints'][above.name]),
                f'in {above.parent}\n{numbers(origin.xyz, origin.rpy, "  ")}', point))
    return panel


def _sdf(listing: Mapping[str, Any], kinematics: Kinematics, poses: Mapping[FrameId, Transform]
         ) -> _Panel:
    panel = _Panel('SDF: links are placed', 'each <pose> is in the frame of the model')
    start = _seen(IDENTITY.translation)
    panel.entries.append(Entry('frame of the model', '', start, on_left=True))
    for name, _ in depth_first(listing):
        frame, link = FrameId('link', name), listing['links'][name]
        place = poses[frame]
        pose = place.pose() if link['moved'] else kinematics.between(MODEL, frame)
        panel.frames.append(place)
        panel.arrows.append((start, _seen(place.translation)))
        panel.entries.append(Entry(link_text(name, link), numbers(pose.xyz, pose.rpy, '  '),
                                   _seen(place.translation)))
    for name, joint in listing['joints'].items():
        offset = joint['in_child']
        if any(abs(value) > 1e-9 for value in (*offset['xyz'], *offset['rpy'])):
            point = _seen(poses[FrameId('joint', name)].translation)
            link = poses[FrameId('link', joint['child'])]
            panel.offsets.append((_seen(link.translation), point))
            panel.joints.append(point)
            panel.entries.append(Entry(f'joint {joint_text(name, joint)}', (
                f'in {joint["child"]}\n{numbers(offset["xyz"], offset["rpy"], "  ")}'), point))
    return panel


class _View:
    """A panel as it is drawn: all of it in inches, on axes that are as large as it is."""

    def __init__(self, axes: Any, panel: _Panel, shapes: Sequence[tuple[str, list[list[Point]]]]
                 ) -> None:
        self.axes, self._panel, self._shapes = axes, panel, shapes
        axes.set_axis_off()
        self._heads = [axes.text(0, 0, panel.title, fontsize=12, fontweight='bold', color=DARK,
                                 ha='center', va='top'),
                       axes.text(0, 0, panel.text, fontsize=9, color=GREY, ha='center', va='top')]
        lefts = [entry for entry in panel.entries if entry.on_left]
        rights = [entry for entry in panel.entries if not entry.on_left]
        if len(rights) > _MOST:
            self._heads[1].set_text(
                f'{panel.text}; numbers of {_MOST} of {len(rights)}, the listing has all')
            rights = rights[:_MOST]
        if len(panel.frames) > _FEW:
            rights.sort(key=lambda entry: entry.point[0])
            half = len(rights) // 2
            lefts, rights = lefts + rights[:half], rights[half:]
        self._columns = [Column(axes, lefts), Column(axes, rights)]
        many = len(panel.frames) > _FEW
        self._arrows = [(start, end, -_BEND if many and _goes_right(start, end) else _BEND)
                        for start, end in panel.arrows if math.dist(start, end) > 1e-6]
        curves = [[start, *bent(start, end, bend), end] for start, end, bend in self._arrows]
        points = [point for line in (*curves, *panel.offsets, *(
            line for _, lines in shapes for line in lines)) for point in line]
        points += [_seen(place.translation) for place in panel.frames]
        points.append((0.0, 0.0))
        size = max(max(column) - min(column) for column in zip(*points)) or 1.0
        length = size * max(0.04, 0.14 / math.sqrt(len(panel.frames)))
        self._triads = [[(_seen(place.translation), _seen(place.apply((
            length * unit[0], length * unit[1], length * unit[2])))) for place in panel.frames]
            for unit in UNITS]
        points += [tip for lines in self._triads for _, tip in lines]
        xs, ys = zip(*points)
        self.bounds = (min(xs), min(ys)), (max(xs), max(ys))
        self._at: Callable[[Point], Point] = lambda point: point

    @property
    def text_height(self) -> float:
        """Height of the columns of texts in inches."""
        return max(column.height for column in self._columns)

    def lay_out(self, height: float, low: Sequence[float], size: Sequence[float], scale: float
                ) -> float:
        """
        Draw all, and return the width.

        :param height: in inches.
        :param low: the least of both coordinates of what is drawn, ``size`` how far it reaches.
        :param scale: inches for a metre.
        """
        left, right = self._columns
        drawn = scale * size[0]
        begin = left.width + _GAP if left.width else 0.0
        width = begin + drawn + _GAP + right.width
        heads = [size_of(text) for text in self._heads]
        more = max(0.0, *(head[0] - width for head in heads)) / 2
        width += 2 * more
        begin += more
        bottom = (height - scale * size[1]) / 2
        self._at = lambda point: (begin + scale * (point[0] - low[0]),
                                  bottom + scale * (point[1] - low[1]))
        self.axes.set_xlim(0.0, width)
        self.axes.set_ylim(0.0, height + _HEAD)
        for text, y in zip(self._heads, (height + _HEAD, height + _HEAD - heads[0][1] - 0.06)):
            text.set_position((width / 2, y))
        self._draw()
        left.lay_out(begin - _GAP, -1, height, self._at)
        right.lay_out(begin + drawn + _GAP, 1, height, self._at)
        return width

    def _draw(self) -> None:
        for kind, lines in self._shapes:
            self.axes.fill(*zip(*map(self._at, hull(point for line in lines for point in line))),
                           facecolor=SHAPE_COLORS[kind], alpha=0.1, zorder=1, clip_on=False)
            self._add_lines(lines, SHAPE_COLORS[kind], 0.5, 1, '-')
        for axis, color in zip(self._triads, AXIS_COLORS):
            self._add_lines(axis, color, 1.8, 5, '-')
        self._add_lines(self._panel.offsets, GREY, 1.2, 4, ':')
        width = 1.3 if len(self._arrows) <= _FEW else 0.8
        self._add_lines([bent(*arrow) for arrow in self._arrows[_MOST_ARROWS:]],
                        DARK, width, 6, '-')
        for start, end, bend in self._arrows[:_MOST_ARROWS]:
            self.axes.annotate('', self._at(end), xytext=self._at(start), zorder=6, arrowprops={
                'arrowstyle': '-|>', 'color': DARK, 'lw': width, 'shrinkA': 4, 'shrinkB': 5,
                'connectionstyle': f'arc3,rad={-bend}'})
        if self._panel.joints:
            self.axes.plot(*zip(*map(self._at, self._panel.joints)), 'h', color=GREY, zorder=4,
                           markersize=9, markerfacecolor='none', markeredgewidth=1.2)

    def _add_lines(self, lines: Iterable[Sequence[Point]], color: str, width: float, order: int,
                   style: str) -> None:
        self.axes.add_collection(matplotlib_module('collections').LineCollection(
            [[self._at(point) for point in line] for line in lines], colors=color,
            linewidths=width, linestyles=style, zorder=order, clip_on=False), autolim=False)


def _goes_right(start: Point, end: Point) -> bool:
    return end[0] > start[0] + 0.1 * abs(end[1] - start[1])


def _seen(point: Vector) -> Point:
    """Return where a point is for an eye that is far away."""
    x, y, z = point
    sine, cosine = math.sin(_AZIMUTH), math.cos(_AZIMUTH)
    return (cosine * y - sine * x,
            math.cos(_ELEVATION) * z - math.sin(_ELEVATION) * (cosine * x + sine * y))
