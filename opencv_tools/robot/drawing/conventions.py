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

"""Picture of two conventions: URDF places the joints of a robot, SDF places its links."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
import math
from typing import Any

from opencv_tools.robot.drawing.figure import (
    in_inches, matplotlib_module, new_figure, save, size_of)
from opencv_tools.robot.drawing.labels import Column, Entry
from opencv_tools.robot.drawing.primitives import (
    AXIS_COLORS, bezier_curve, GREY, hull, placed_shapes, plain, Point, pose_text, scaled,
    SHAPE_COLORS, TEXT_COLOR, transformed, UNITS)
from opencv_tools.robot.frames.listing import depth_first, Listing
from opencv_tools.robot.frames.text import heading, joint_text, link_text
from opencv_tools.robot.kinematics import Kinematics
from opencv_tools.robot.model import FrameId, MODEL, Robot
from opencv_tools.robot.pose import IDENTITY, Transform, Vector

_FEW_LINKS = 8  # robots with more links have entries on both sides
_MAX_ENTRIES = 60
_MAX_ARROWS = 300  # further arrows are drawn as lines, which is faster
# Inches: maximum width and minimum height of the drawing, and distances.
_WIDTH, _HEIGHT = 3.2, 4.2
_GAP, _MARGIN, _HEAD, _TITLE = 0.3, 0.25, 0.65, 0.3
_BEND = 0.25
_AZIMUTH, _ELEVATION = math.radians(-55), math.radians(22)  # as in the perspective view
_Shapes = Sequence[tuple[str, list[list[Point]]]]  # kind and lines


@dataclass(kw_only=True)
class _Panel:
    """
    One convention, with all points projected.

    :param frames: poses of the frames in the model.
    :param arrows: arrows from a frame of reference to the placed frame.
    :param offsets: lines between a joint and its link.
    :param joints: positions of the joints.
    """

    title: str
    subtitle: str
    frames: list[Transform] = field(default_factory=list)
    arrows: list[tuple[Point, Point]] = field(default_factory=list)
    offsets: list[tuple[Point, Point]] = field(default_factory=list)
    joints: list[Point] = field(default_factory=list)
    entries: list[Entry] = field(default_factory=list)


def plot_conventions(robot: Robot, listing: Listing, path: str) -> None:
    """Draw the joints that URDF places beside the links that SDF places, as `plot.plot`."""
    save(path, lambda: draw(robot, listing))


def draw(robot: Robot, listing: Listing) -> Any:
    """Return a matplotlib figure with a panel for each convention."""
    kinematics = Kinematics(robot)
    poses = kinematics.forward({
        name: joint['position'] for name, joint in listing['joints'].items()})
    root = poses[FrameId('link', listing['root'])]
    shapes = [(shape.kind, [[_project(point) for point in line]
                            for line in transformed(shape.lines, root)])
              for shape in placed_shapes(robot, listing) if shape.lines]
    figure = new_figure()
    views = [_View(figure.add_axes((0, 0, 1, 1)), panel, shapes)
             for panel in (_urdf_panel(listing, kinematics, poses),
                           _sdf_panel(listing, kinematics, poses))]
    title = figure.text(0.5, 0.5, plain(heading(listing), 150), fontsize=13, fontweight='bold',
                        color=TEXT_COLOR, ha='center', va='center')
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


def _urdf_panel(listing: Listing, kinematics: Kinematics, poses: Mapping[FrameId, Transform]
                ) -> _Panel:
    link_frame = kinematics.urdf_frame
    panel = _Panel(title='URDF places joints',
                   subtitle='each <origin> is relative to the parent link')
    names = [name for name, _ in depth_first(listing)]
    for name in names:
        pose, joint = poses[link_frame(name)], kinematics.parent_joint.get(name)
        panel.frames.append(pose)
        if len(names) <= _FEW_LINKS:
            panel.entries.append(Entry(name, '', _project(pose.translation), on_left=True))
        if joint:
            parent = poses[link_frame(joint.parent)]
            origin = kinematics.between(link_frame(joint.parent), FrameId('joint', joint.name))
            point = _project((parent @ origin.transform()).translation)
            panel.arrows.append((_project(parent.translation), point))
            panel.offsets.append((point, _project(pose.translation)))
            panel.joints.append(point)
            panel.entries.append(Entry(
                joint_text(joint.name, listing['joints'][joint.name]),
                f'in {joint.parent}\n{pose_text(origin.xyz, origin.rpy, "  ")}', point,
                rank=_rank(name, kinematics)))
    return panel


def _sdf_panel(listing: Listing, kinematics: Kinematics, poses: Mapping[FrameId, Transform]
               ) -> _Panel:
    panel = _Panel(title='SDF places links', subtitle='each <pose> is relative to the model')
    start = _project(IDENTITY.translation)
    panel.entries.append(Entry('frame of the model', '', start, on_left=True))
    for name, _ in depth_first(listing):
        frame, link = FrameId('link', name), listing['links'][name]
        pose = poses[frame].pose() if link['moved'] else kinematics.between(MODEL, frame)
        point = _project(poses[frame].translation)
        panel.frames.append(poses[frame])
        panel.arrows.append((start, point))
        panel.entries.append(Entry(
            link_text(name, link), pose_text(pose.xyz, pose.rpy, '  '), point,
            rank=_rank(name, kinematics)))
    for name, joint in listing['joints'].items():
        offset = joint['in_child']
        if any(abs(value) > 1e-9 for value in (*offset['xyz'], *offset['rpy'])):
            point = _project(poses[FrameId('joint', name)].translation)
            link = poses[FrameId('link', joint['child'])]
            panel.offsets.append((_project(link.translation), point))
            panel.joints.append(point)
            panel.entries.append(Entry(f'joint {joint_text(name, joint)}', (
                f'in {joint["child"]}\n{pose_text(**offset, separator="  ")}'), point,
                rank=_rank(joint['child'], kinematics)))
    return panel


def _rank(link: str, kinematics: Kinematics) -> int:
    """Return 0 for a link that its joint moves, 1 for one at the end of a chain, 2 for others."""
    joint = kinematics.parent_joint.get(link)
    if joint and joint.type != 'fixed':
        return 0
    return 2 if kinematics.child_joints[link] else 1


class _View:
    """A drawn panel, on axes in inches that have its size."""

    def __init__(self, axes: Any, panel: _Panel, shapes: _Shapes) -> None:
        self.axes, self._panel, self._shapes = axes, panel, shapes
        axes.set_axis_off()
        self._heads = [axes.text(0, 0, panel.title, fontsize=12, fontweight='bold',
                                 color=TEXT_COLOR, ha='center', va='top'),
                       axes.text(0, 0, panel.subtitle, fontsize=9, color=GREY, ha='center',
                                 va='top')]
        lefts = [entry for entry in panel.entries if entry.on_left]
        rights = [entry for entry in panel.entries if not entry.on_left]
        if len(rights) > _MAX_ENTRIES:
            self._heads[1].set_text(f'{panel.subtitle}; numbers of {_MAX_ENTRIES} of '
                                    f'{len(rights)}, the listing has all')
            ranks = sorted(range(len(rights)), key=lambda index: rights[index].rank)
            rights = [rights[index] for index in sorted(ranks[:_MAX_ENTRIES])]
        many = len(panel.frames) > _FEW_LINKS
        if many:
            rights.sort(key=lambda entry: entry.point[0])
            half = len(rights) // 2
            lefts, rights = lefts + rights[:half], rights[half:]
        self._columns = [Column(axes, lefts), Column(axes, rights)]
        self.text_height = max(column.height for column in self._columns)  # inches
        self._arrows = [
            (start, end, -_BEND if many and end[0] > start[0] + 0.1 * abs(end[1] - start[1])
             else _BEND) for start, end in panel.arrows if math.dist(start, end) > 1e-6]
        curves = [[start, *bezier_curve(start, end, bend), end]
                  for start, end, bend in self._arrows]
        points = [point for line in (*curves, *panel.offsets, *(
            line for _, lines in shapes for line in lines)) for point in line]
        points += [_project(pose.translation) for pose in panel.frames]
        points.append((0.0, 0.0))
        size = max(max(column) - min(column) for column in zip(*points)) or 1.0
        length = size * max(0.04, 0.14 / math.sqrt(len(panel.frames)))
        self._triads = [[(_project(pose.translation), _project(pose.apply(scaled(unit, length))))
                         for pose in panel.frames] for unit in UNITS]
        points += [tip for lines in self._triads for _, tip in lines]
        xs, ys = zip(*points)
        self.bounds = (min(xs), min(ys)), (max(xs), max(ys))
        self._to_inches: Callable[[Point], Point] = lambda point: point

    def lay_out(self, height: float, low: Sequence[float], size: Sequence[float], scale: float
                ) -> float:
        """Draw the panel with a height in inches and inches for each metre; return its width."""
        left, right = self._columns
        drawn = scale * size[0]
        begin = left.width + _GAP if left.width else 0.0
        width = begin + drawn + _GAP + right.width
        heads = [size_of(text) for text in self._heads]
        margin = max(0.0, *(head[0] - width for head in heads)) / 2
        width += 2 * margin
        begin += margin
        bottom = (height - scale * size[1]) / 2
        self._to_inches = lambda point: (begin + scale * (point[0] - low[0]),
                                         bottom + scale * (point[1] - low[1]))
        self.axes.set_xlim(0.0, width)
        self.axes.set_ylim(0.0, height + _HEAD)
        for text, y in zip(self._heads, (height + _HEAD, height + _HEAD - heads[0][1] - 0.06)):
            text.set_position((width / 2, y))
        self._draw()
        left.lay_out(begin - _GAP, -1, height, self._to_inches)
        right.lay_out(begin + drawn + _GAP, 1, height, self._to_inches)
        return width

    def _draw(self) -> None:
        for kind, lines in self._shapes:
            corners = hull(point for line in lines for point in line)
            self.axes.fill(*zip(*map(self._to_inches, corners)), facecolor=SHAPE_COLORS[kind],
                           alpha=0.1, zorder=1, clip_on=False)
            self._add_lines(lines, SHAPE_COLORS[kind], 0.5, 1, '-')
        for axis, color in zip(self._triads, AXIS_COLORS):
            self._add_lines(axis, color, 1.8, 5, '-')
        self._add_lines(self._panel.offsets, GREY, 1.2, 4, ':')
        width = 1.3 if len(self._arrows) <= _FEW_LINKS else 0.8
        self._add_lines([bezier_curve(*arrow) for arrow in self._arrows[_MAX_ARROWS:]],
                        TEXT_COLOR, width, 6, '-')
        for start, end, bend in self._arrows[:_MAX_ARROWS]:
            self.axes.annotate(
                '', self._to_inches(end), xytext=self._to_inches(start), zorder=6, arrowprops={
                    'arrowstyle': '-|>', 'color': TEXT_COLOR, 'lw': width, 'shrinkA': 4,
                    'shrinkB': 5, 'connectionstyle': f'arc3,rad={-bend}'})
        if self._panel.joints:
            self.axes.plot(*zip(*map(self._to_inches, self._panel.joints)), 'h', color=GREY,
                           zorder=4, markersize=9, markerfacecolor='none', markeredgewidth=1.2)

    def _add_lines(self, lines: Iterable[Sequence[Point]], color: str, width: float, order: int,
                   style: str) -> None:
        self.axes.add_collection(matplotlib_module('collections').LineCollection(
            [[self._to_inches(point) for point in line] for line in lines], colors=color,
            linewidths=width, linestyles=style, zorder=order, clip_on=False), autolim=False)


def _project(point: Vector) -> Point:
    """Return the orthographic projection of a point."""
    x, y, z = point
    sine, cosine = math.sin(_AZIMUTH), math.cos(_AZIMUTH)
    return (cosine * y - sine * x,
            math.cos(_ELEVATION) * z - math.sin(_ELEVATION) * (cosine * x + sine * y))
