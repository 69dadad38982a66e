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

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from importlib import import_module
from io import BytesIO
import math
from pathlib import Path
from typing import Any

from opencv_tools.base.remedies import installation
from opencv_tools.robot.drawing.primitives import (
    AXIS_COLORS, bezier_curve, GREY, hull, PALE, placed_shapes, plain, Point, pose_text, scaled,
    SHAPE_COLORS, TEXT_COLOR, transformed, UNITS)
from opencv_tools.robot.frames.listing import depth_first, Listing
from opencv_tools.robot.frames.text import heading, joint_text, link_text
from opencv_tools.robot.kinematics import Kinematics
from opencv_tools.robot.model import FrameId, MODEL, Robot
from opencv_tools.robot.pose import IDENTITY, Transform, Vector
from opencv_tools.robot.xml.document import DescriptionError
from opencv_tools.robot.xml.output import write_all

DPI = 120
_SUFFIXES = ('.png', '.svg')
_LINE_GAP, _ENTRY_GAP = 0.03, 0.08  # inches, in a column
# Settings of the user are ignored, so that each robot has one picture. SVG keeps text as text.
_SETTINGS = {'svg.hashsalt': 'opencv_tools', 'svg.fonttype': 'none', 'font.size': 9.0,
             'font.family': ['DejaVu Sans']}
_FEW_LINKS = 8  # robots with more links have entries on both sides
_MAX_ENTRIES = 60
_MAX_ARROWS = 300  # further arrows are drawn as lines, which is faster
# Inches: maximum width and minimum height of the drawing, and distances.
_WIDTH, _HEIGHT = 3.2, 4.2
_GAP, _MARGIN, _HEAD, _TITLE = 0.3, 0.25, 0.65, 0.3
_BEND = 0.25
_AZIMUTH, _ELEVATION = math.radians(-55), math.radians(22)  # as in the perspective view
_Shapes = Sequence[tuple[str, list[list[Point]]]]  # kind and lines


def matplotlib_module(name: str = '', package: str = 'matplotlib') -> Any:
    """
    Import matplotlib or a module of it, because only pictures need it.

    :raises DescriptionError: matplotlib is not installed.
    """
    try:
        return import_module(f'{package}.{name}' if name else package)
    except ImportError as err:
        raise DescriptionError('pictures need matplotlib; '
                               f'{installation("matplotlib")}') from err


def save(path: str, draw: Callable[[], Any]) -> None:
    """
    Write a picture to a PNG or SVG file atomically.

    :param path: file name with the suffix of its format.
    :raises DescriptionError: the suffix is not supported, matplotlib is not installed, or the
        file cannot be written.
    """
    suffix = Path(path).suffix.lower()
    if suffix not in _SUFFIXES:
        raise DescriptionError(f'a picture needs the suffix .png or .svg, not {suffix!r}',
                               source=path)
    data = BytesIO()
    with matplotlib_module().rc_context(_SETTINGS):
        draw().savefig(data, dpi=DPI, format=suffix[1:],
                       metadata={'Date': None} if suffix == '.svg' else None)
    write_all([(path, data.getvalue())])


def new_figure() -> Any:
    """Return an empty figure that pyplot does not manage."""
    figure = matplotlib_module('figure').Figure(dpi=DPI)
    matplotlib_module('backends.backend_agg').FigureCanvasAgg(figure)
    return figure


def in_inches(figure: Any, left: float, bottom: float, width: float, height: float
              ) -> tuple[float, float, float, float]:
    """Return a rectangle in fractions of the figure, for `Axes.set_position`."""
    whole, high = figure.get_size_inches()
    return left / whole, bottom / high, width / whole, height / high


def size_of(text: Any) -> tuple[float, float]:
    """Return the width and the height of a text in inches."""
    box = text.get_window_extent(text.figure.canvas.get_renderer())
    return box.width / DPI, box.height / DPI


@dataclass(frozen=True)
class Entry:
    """
    A bold title and grey numbers for a point of the drawing.

    :param rank: entries with a lower rank remain if there is no room for all.
    """

    title: str
    numbers: str
    point: Point
    on_left: bool = False
    rank: int = 0


class Column:
    """A column of entries, each near the height of its point."""

    def __init__(self, axes: Any, entries: Sequence[Entry]) -> None:
        self._axes = axes
        self._entries = sorted(entries, key=lambda entry: -entry.point[1])
        self._texts = [[axes.text(0, 0, plain(text), fontsize=8, color=color, va='top',
                                  fontweight=weight, linespacing=1.15)
                        for text, color, weight in ((entry.title, TEXT_COLOR, 'bold'),
                                                    (entry.numbers, GREY, 'normal')) if text]
                       for entry in self._entries]
        self._sizes = [[size_of(text) for text in texts] for texts in self._texts]
        self._heights = [sum(high for _, high in sizes) + _LINE_GAP for sizes in self._sizes]
        self.width = max((wide for sizes in self._sizes for wide, _ in sizes), default=0.0)
        self.height = sum(self._heights) + _ENTRY_GAP * len(self._heights)

    def lay_out(self, x: float, side: int, ends: Point, scale: float) -> None:
        """
        Place the texts and draw their lines.

        :param side: -1 for a column left of the drawing, 1 for a column right of it.
        :param scale: inches for each unit of the axes.
        """
        middles = _spread([entry.point[1] for entry in self._entries],
                          [(height + _ENTRY_GAP) / scale for height in self._heights], *ends)
        for index, (entry, middle) in enumerate(zip(self._entries, middles)):
            y = middle + self._heights[index] / 2 / scale
            for text, (_, high) in zip(self._texts[index], self._sizes[index]):
                text.set_position((x, y))
                text.set_horizontalalignment('left' if side > 0 else 'right')
                y -= (high + _LINE_GAP) / scale
            self._axes.plot([x - side * 0.05 / scale, entry.point[0]], [middle, entry.point[1]],
                            color=PALE, lw=0.7, zorder=3)


def _spread(targets: Sequence[float], heights: Sequence[float], bottom: float, top: float
            ) -> list[float]:
    """Return the middles of boxes that do not overlap, near their targets, from top to bottom."""
    middles: list[float] = []
    for middle, height in zip(targets, heights):
        middles.append(min(middle, top - height / 2))
        top = middles[-1] - height / 2
    for index in reversed(range(len(middles))):
        middles[index] = max(middles[index], bottom + heights[index] / 2)
        bottom = middles[index] + heights[index] / 2
    return middles


@dataclass(kw_only=True)
class _Panel:
    """
    One convention, with all points projected.

    :param arrows: arrows from a frame of reference to the placed frame.
    :param offsets: lines from a joint to its link.
    """

    title: str
    subtitle: str
    frames: list[Transform] = field(default_factory=list)
    arrows: list[tuple[Point, Point]] = field(default_factory=list)
    offsets: list[tuple[Point, Point]] = field(default_factory=list)
    entries: list[Entry] = field(default_factory=list)


def plot_conventions(robot: Robot, listing: Listing, path: str) -> None:
    """
    Draw the joints that URDF places beside the links that SDF places, into a PNG or SVG file.

    :param listing: a result of `listing.frames`.
    :param path: file name with the suffix of its format.
    :raises DescriptionError: matplotlib is not installed, or the file cannot be written.
    """
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
    bounds = matplotlib_module('transforms').Bbox.union([view.axes.dataLim for view in views])
    wide, high = (max(length, 1e-9) for length in bounds.size)
    height = max(min(_HEIGHT, _WIDTH * high / wide), *(view.text_height for view in views))
    scale = min(_WIDTH / wide, height / high)
    widths = [view.lay_out(height, bounds, scale) for view in views]
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
            panel.offsets.append((point, _project(link.translation)))
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
    """A drawn panel, on axes in metres with columns of entries beside the drawing."""

    def __init__(self, axes: Any, panel: _Panel, shapes: _Shapes) -> None:
        self.axes, self._panel = axes, panel
        axes.set_axis_off()
        self._heads = [axes.text(0.5, 1, text, fontsize=size, fontweight=weight, color=color,
                                 ha='center', va='top', transform=axes.transAxes)
                       for text, size, weight, color in (
                           (panel.title, 12, 'bold', TEXT_COLOR),
                           (panel.subtitle, 9, 'normal', GREY))]
        self._columns = [Column(axes, entries) for entries in self._entries()]
        self.text_height = max(column.height for column in self._columns)  # inches
        self._draw_shapes(shapes)
        self._draw_arrows()
        axes.update_datalim([(0.0, 0.0), *(_project(pose.translation) for pose in panel.frames)])
        size = max(axes.dataLim.size) or 1.0
        length = size * max(0.04, 0.14 / math.sqrt(len(panel.frames)))
        for unit, color in zip(UNITS, AXIS_COLORS):
            self._add_lines([(_project(pose.translation), _project(pose.apply(
                scaled(unit, length)))) for pose in panel.frames], color, 1.8, 5)

    def lay_out(self, height: float, bounds: Any, scale: float) -> float:
        """
        Place the drawing and all texts.

        :param height: height of the drawing in inches, without the headings.
        :param bounds: bounding box of the drawing in metres.
        :param scale: inches for each metre.
        :returns: width of the panel in inches.
        """
        left, right = self._columns
        begin = left.width + _GAP if left.width else 0.0
        width = begin + scale * bounds.width + _GAP + right.width
        heads = [size_of(text) for text in self._heads]
        margin = max(0.0, *(head[0] - width for head in heads)) / 2
        width += 2 * margin
        self._heads[1].set_y(1 - (heads[0][1] + 0.06) / (height + _HEAD))
        x = bounds.x0 - (begin + margin) / scale
        low = bounds.y0 + (bounds.height - height / scale) / 2
        high = low + height / scale
        self.axes.set_xlim(x, x + width / scale)
        self.axes.set_ylim(low, high + _HEAD / scale)
        left.lay_out(bounds.x0 - _GAP / scale, -1, (low, high), scale)
        right.lay_out(bounds.x1 + _GAP / scale, 1, (low, high), scale)
        return width

    def _entries(self) -> tuple[list[Entry], list[Entry]]:
        """Return the entries left and right of the drawing, as many as have room."""
        lefts = [entry for entry in self._panel.entries if entry.on_left]
        rights = [entry for entry in self._panel.entries if not entry.on_left]
        if len(rights) > _MAX_ENTRIES:
            self._heads[1].set_text(f'{self._panel.subtitle}; numbers of {_MAX_ENTRIES} of '
                                    f'{len(rights)}, the listing has all')
            ranks = sorted(range(len(rights)), key=lambda index: rights[index].rank)
            rights = [rights[index] for index in sorted(ranks[:_MAX_ENTRIES])]
        if len(self._panel.frames) <= _FEW_LINKS:
            return lefts, rights
        rights.sort(key=lambda entry: entry.point[0])
        half = len(rights) // 2
        return lefts + rights[:half], rights[half:]

    def _draw_shapes(self, shapes: _Shapes) -> None:
        for kind, lines in shapes:
            corners = hull(point for line in lines for point in line)
            self.axes.fill(*zip(*corners), facecolor=SHAPE_COLORS[kind], alpha=0.1, zorder=1,
                           clip_on=False)
            self._add_lines(lines, SHAPE_COLORS[kind], 0.5, 1)

    def _draw_arrows(self) -> None:
        """Draw the arrows, the joints, and the lines between joints and links."""
        many, arrows = len(self._panel.frames) > _FEW_LINKS, []
        for start, end in self._panel.arrows:
            if math.dist(start, end) > 1e-6:
                right = end[0] - start[0] > 0.1 * abs(end[1] - start[1])
                arrows.append((start, end, -_BEND if many and right else _BEND))
        width = 1.3 if len(arrows) <= _FEW_LINKS else 0.8
        self._add_lines([bezier_curve(*arrow) for arrow in arrows[_MAX_ARROWS:]], TEXT_COLOR,
                        width, 6)
        for start, end, bend in arrows[:_MAX_ARROWS]:
            self.axes.update_datalim(bezier_curve(start, end, bend))
            self.axes.annotate('', end, xytext=start, zorder=6, arrowprops={
                'arrowstyle': '-|>', 'color': TEXT_COLOR, 'lw': width, 'shrinkA': 4,
                'shrinkB': 5, 'connectionstyle': f'arc3,rad={-bend}'})
        if self._panel.offsets:
            self._add_lines(self._panel.offsets, GREY, 1.2, 4, ':')
            self.axes.plot(*zip(*(joint for joint, _ in self._panel.offsets)), 'h', color=GREY,
                           zorder=4, markersize=9, markerfacecolor='none', markeredgewidth=1.2)

    def _add_lines(self, lines: Sequence[Sequence[Point]], color: str, width: float, order: int,
                   style: str = '-') -> None:
        self.axes.add_collection(matplotlib_module('collections').LineCollection(
            lines, colors=color, linewidths=width, linestyles=style, zorder=order, clip_on=False))


def _project(point: Vector) -> Point:
    """Return the orthographic projection of a point."""
    x, y, z = point
    sine, cosine = math.sin(_AZIMUTH), math.cos(_AZIMUTH)
    return (cosine * y - sine * x,
            math.cos(_ELEVATION) * z - math.sin(_ELEVATION) * (cosine * x + sine * y))
