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
    AXIS_COLORS, GREY, PALE, placed_lines, plain, Point, pose_text, SHAPE_COLORS, TEXT_COLOR,
    UNITS)
from opencv_tools.robot.frames.listing import depth_first, Listing
from opencv_tools.robot.frames.text import heading, joint_text, link_text
from opencv_tools.robot.kinematics import Kinematics
from opencv_tools.robot.model import FrameId, MODEL, Robot
from opencv_tools.robot.pose import IDENTITY, Transform, Vector
from opencv_tools.robot.xml.document import DescriptionError
from opencv_tools.robot.xml.output import write_all

DPI = 120
_SUFFIXES = ('.png', '.svg')
# Settings of the user are ignored, so that each robot has one picture. SVG keeps text as text.
_SETTINGS = {'svg.hashsalt': 'opencv_tools', 'svg.fonttype': 'none', 'font.size': 9.0,
             'font.family': ['DejaVu Sans']}
_FEW_LINKS = 8  # robots with more links have entries on both sides
_MAX_ENTRIES = 60
_MAX_ARROWS = 300  # further arrows are drawn as lines, which is faster
# Inches: maximum width and minimum height of the drawing, distances, and heights of a title, of a
# line of numbers and of the gap below them.
_WIDTH, _HEIGHT = 3.2, 4.2
_GAP, _MARGIN, _HEAD, _TITLE = 0.3, 0.25, 0.65, 0.3
_BOLD, _LINE, _BELOW = 0.18, 0.14, 0.12
_BEND = 0.25
_AZIMUTH, _ELEVATION = math.radians(-55), math.radians(22)  # as in the perspective view


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

    @property
    def height(self) -> float:
        """Height in inches."""
        return _BOLD + _BELOW + _LINE * (self.numbers.count('\n') + bool(self.numbers))


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
    One convention, with all points projected, in metres.

    :param arrows: arrows from a frame of reference to the placed frame.
    :param offsets: lines from a joint to its link.
    """

    title: str
    subtitle: str
    frames: list[Transform] = field(default_factory=list)
    arrows: list[tuple[Point, Point]] = field(default_factory=list)
    offsets: list[tuple[Point, Point]] = field(default_factory=list)
    entries: list[Entry] = field(default_factory=list)

    def columns(self) -> tuple[list[Entry], list[Entry]]:
        """Return the entries left and right of the drawing, as many as have room."""
        lefts = [entry for entry in self.entries if entry.on_left]
        rights = [entry for entry in self.entries if not entry.on_left]
        if len(rights) > _MAX_ENTRIES:
            self.subtitle += (f'; numbers of {_MAX_ENTRIES} of {len(rights)}, '
                              'the listing has all')
            ranks = sorted(range(len(rights)), key=lambda index: rights[index].rank)
            rights = [rights[index] for index in sorted(ranks[:_MAX_ENTRIES])]
        if len(self.frames) > _FEW_LINKS:
            rights.sort(key=lambda entry: entry.point[0])
            half = len(rights) // 2
            lefts, rights = lefts + rights[:half], rights[half:]
        return lefts, rights


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
    shapes = [(kind, [[_project(root.apply(point)) for point in line] for line in lines])
              for kind, lines in placed_lines(robot, listing) if lines]
    panels = _urdf_panel(listing, kinematics, poses), _sdf_panel(listing, kinematics, poses)
    columns = [panel.columns() for panel in panels]
    points = [(0.0, 0.0), *(point for _, lines in shapes for line in lines for point in line),
              *(point for panel in panels for arrow in panel.arrows for point in arrow),
              *(_project(pose.translation) for panel in panels for pose in panel.frames)]
    low, high = (tuple(map(extreme, zip(*points))) for extreme in (min, max))
    wide, tall = (max(b - a, 1e-9) for a, b in zip(low, high))
    height = max(min(_HEIGHT, _WIDTH * tall / wide), *(
        sum(entry.height for entry in side) for both in columns for side in both))
    scale = min(_WIDTH / wide, height / tall)
    figure, left = new_figure(), _MARGIN
    title = figure.text(0.5, 0.5, plain(heading(listing), 150), fontsize=13, fontweight='bold',
                        color=TEXT_COLOR, ha='center', va='center')
    view = _View(figure, scale, (low[0], (low[1] + high[1] - height / scale) / 2),
                 (scale * wide, height))
    placed = [view.panel(panel, sides, shapes) for panel, sides in zip(panels, columns)]
    whole = max(sum(right - left for _, left, right in placed) + 3 * _MARGIN,
                size_of(title)[0] + 2 * _MARGIN)
    tall = height + _HEAD + _TITLE + 2 * _MARGIN
    figure.set_size_inches(whole, tall)
    left = (whole - sum(right - left for _, left, right in placed) - _MARGIN) / 2
    for axes, begin, end in placed:
        axes.set_xlim(begin, end)
        axes.set_ylim(0, height + _HEAD)
        axes.set_position((left / whole, _MARGIN / tall, (end - begin) / whole,
                           (height + _HEAD) / tall))
        left += end - begin + _MARGIN
    title.set_y(1 - (_MARGIN + _TITLE / 3) / tall)
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


@dataclass(frozen=True)
class _View:
    """
    A figure with panels, whose axes are in inches.

    :param scale: inches for each metre.
    :param origin: point in metres at the left lower corner of the drawing.
    :param size: width and height of the drawing in inches, without texts.
    """

    figure: Any
    scale: float
    origin: Point
    size: Point

    def panel(self, panel: _Panel, columns: Sequence[Sequence[Entry]],
              shapes: Sequence[tuple[str, list[list[Point]]]]) -> tuple[Any, float, float]:
        """Draw a panel, and return its axes with the left and the right end."""
        axes = self.figure.add_axes((0, 0, 1, 1))
        axes.set_axis_off()
        width, height = self.size
        heads = [axes.text(width / 2, height + _HEAD - down, text, fontsize=size, color=color,
                           fontweight=weight, ha='center', va='top')
                 for text, down, size, weight, color in (
                     (panel.title, 0.0, 12, 'bold', TEXT_COLOR),
                     (panel.subtitle, 0.26, 9, 'normal', GREY))]
        half = max(size_of(head)[0] for head in heads) / 2
        left = min(width / 2 - half, -self._column(axes, columns[0], -1))
        right = max(width / 2 + half, width + self._column(axes, columns[1], 1))
        for kind, lines in shapes:
            self._lines(axes, lines, SHAPE_COLORS[kind], 0.5, 1)
            for line in lines:
                axes.fill(*zip(*map(self._at, line)), facecolor=SHAPE_COLORS[kind], alpha=0.05,
                          zorder=1, clip_on=False)
        self._arrows(axes, panel)
        length = max(self.size) / self.scale * max(0.04, 0.14 / math.sqrt(len(panel.frames)))
        for (x, y, z), color in zip(UNITS, AXIS_COLORS):
            self._lines(axes, [[_project(pose.translation), _project(pose.apply((
                x * length, y * length, z * length)))] for pose in panel.frames], color, 1.8, 5)
        return axes, left, right

    def _column(self, axes: Any, entries: Sequence[Entry], side: int) -> float:
        """Write entries left (-1) or right (1) of the drawing, and return their width."""
        entries = sorted(entries, key=lambda entry: -entry.point[1])
        x, widest = (self.size[0] + _GAP if side > 0 else -_GAP), 0.0
        middles = _spread([self._at(entry.point)[1] for entry in entries],
                          [entry.height for entry in entries], 0.0, self.size[1])
        for entry, middle in zip(entries, middles):
            y = middle + (entry.height - _BELOW) / 2
            for text, color, weight in ((entry.title, TEXT_COLOR, 'bold'),
                                        (entry.numbers, GREY, 'normal')):
                written = axes.text(x, y, plain(text), fontsize=8, color=color, va='top',
                                    fontweight=weight, linespacing=1.15,
                                    ha='left' if side > 0 else 'right') if text else None
                widest = max(widest, size_of(written)[0] + _GAP if written else 0.0)
                y -= _BOLD
            end = self._at(entry.point)
            axes.plot([x - side * 0.05, end[0]], [middle, end[1]], color=PALE, lw=0.7, zorder=3)
        return widest

    def _arrows(self, axes: Any, panel: _Panel) -> None:
        """Draw the arrows, the joints, and the lines between joints and links."""
        arrows = [arrow for arrow in panel.arrows if math.dist(*arrow) > 1e-6]
        width = 1.3 if len(arrows) <= _FEW_LINKS else 0.8
        self._lines(axes, arrows[_MAX_ARROWS:], TEXT_COLOR, width, 6)
        for start, end in arrows[:_MAX_ARROWS]:
            right = end[0] - start[0] > 0.1 * abs(end[1] - start[1])
            bend = _BEND if len(panel.frames) > _FEW_LINKS and right else -_BEND
            axes.annotate('', self._at(end), xytext=self._at(start), zorder=6, arrowprops={
                'arrowstyle': '-|>', 'color': TEXT_COLOR, 'lw': width, 'shrinkA': 4,
                'shrinkB': 5, 'connectionstyle': f'arc3,rad={bend}'})
        if panel.offsets:
            self._lines(axes, panel.offsets, GREY, 1.2, 4, ':')
            axes.plot(*zip(*(self._at(joint) for joint, _ in panel.offsets)), 'h', color=GREY,
                      zorder=4, markersize=9, markerfacecolor='none', markeredgewidth=1.2)

    def _at(self, point: Point) -> Point:
        return (self.scale * (point[0] - self.origin[0]), self.scale * (point[1] - self.origin[1]))

    def _lines(self, axes: Any, lines: Sequence[Sequence[Point]], color: str, width: float,
               order: int, style: str = '-') -> None:
        axes.add_collection(matplotlib_module('collections').LineCollection(
            [list(map(self._at, line)) for line in lines], colors=color, linewidths=width,
            linestyles=style, zorder=order, clip_on=False))


def _project(point: Vector) -> Point:
    """Return the orthographic projection of a point."""
    x, y, z = point
    sine, cosine = math.sin(_AZIMUTH), math.cos(_AZIMUTH)
    return (cosine * y - sine * x,
            math.cos(_ELEVATION) * z - math.sin(_ELEVATION) * (cosine * x + sine * y))
