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

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from importlib import import_module
from io import BytesIO
import math
from pathlib import Path
from typing import Any, NamedTuple

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
_WIDTH, _HEIGHT = 3.2, 4.2  # largest size of a drawing without texts, in inches
_ROW, _GAP, _MARGIN = 0.56, 0.3, 0.25
_BEND = 0.25
_AZIMUTH, _ELEVATION = math.radians(-55), math.radians(22)  # as in the perspective view


def matplotlib_module(*names: str) -> Any:
    """
    Import matplotlib or a module of it, because only pictures need it.

    :raises DescriptionError: matplotlib is not installed.
    """
    try:
        return import_module('.'.join(('matplotlib', *names)))
    except ImportError as err:
        raise DescriptionError('pictures need matplotlib; '
                               f'{installation("matplotlib")}') from err


def plot_conventions(robot: Robot, listing: Listing, path: str) -> None:
    """
    Draw the joints that URDF places beside the links that SDF places, and write it atomically.

    :param listing: a result of `listing.frames`.
    :param path: file name with the suffix of its format, PNG or SVG.
    :raises DescriptionError: the suffix is not supported, matplotlib is not installed, or the
        file cannot be written.
    """
    suffix = Path(path).suffix.lower()
    if suffix not in _SUFFIXES:
        raise DescriptionError(f'a picture needs the suffix .png or .svg, not {suffix!r}',
                               source=path)
    data = BytesIO()
    with matplotlib_module().rc_context(_SETTINGS):
        draw(robot, listing).savefig(
            data, dpi=DPI, format=suffix[1:], bbox_inches='tight', pad_inches=_MARGIN,
            metadata={'Date': None} if suffix == '.svg' else None)
    write_all([(path, data.getvalue())])


class Entry(NamedTuple):
    """
    A bold title and grey numbers for a point of the drawing.

    :param rank: entries with a lower rank remain if there is no room for all.
    """

    title: str
    numbers: str
    point: Point
    on_left: bool = False
    rank: int = 0


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


def draw(robot: Robot, listing: Listing) -> Any:
    """Return a matplotlib figure with axes in metres for each convention."""
    kinematics = Kinematics(robot)
    poses = kinematics.forward({
        name: joint['position'] for name, joint in listing['joints'].items()})
    root = poses[FrameId('link', listing['root'])]
    shapes = {kind: [[_project(root.apply(point)) for point in line] for line in lines]
              for kind, lines in placed_lines(robot, listing).items()}
    panels = _urdf_panel(listing, kinematics, poses), _sdf_panel(listing, kinematics, poses)
    columns = [panel.columns() for panel in panels]
    points = [(0.0, 0.0),
              *(point for lines in shapes.values() for line in lines for point in line),
              *(point for panel in panels for arrow in panel.arrows for point in arrow),
              *(_project(pose.translation) for panel in panels for pose in panel.frames)]
    (left, right), (low, high) = ((min(values), max(values)) for values in zip(*points))
    wide, tall = max(right - left, 1e-9), max(high - low, 1e-9)
    height = max(min(_HEIGHT, _WIDTH * tall / wide),
                 _ROW * max(len(side) for both in columns for side in both))
    inch = max(wide / _WIDTH, tall / height)  # in metres
    # A figure that pyplot does not manage.
    figure = matplotlib_module('figure').Figure((wide / inch, height), dpi=DPI)
    canvas = matplotlib_module('backends', 'backend_agg').FigureCanvasAgg(figure)
    middle = (low + high) / 2
    for panel, sides in zip(panels, columns):
        axes = figure.add_axes((0, 0, 1, 1), label=panel.title, xlim=(left, left + wide), ylim=(
            middle - inch * height / 2, middle + inch * height / 2))
        _draw_panel(axes, panel, shapes, inch)
        for entries, x, side in zip(sides, (left - _GAP * inch, right + _GAP * inch), (
                'right', 'left')):
            _write_column(axes, entries, x, side, inch)
    # The second axes begin where the texts of the first ones end.
    first, second = (axes.get_tightbbox(canvas.get_renderer()) for axes in figure.axes)
    move = first.x1 - second.x0 + _MARGIN * DPI
    figure.axes[1].set_position((move / figure.bbox.width, 0, 1, 1))
    figure.text((first.x0 + second.x1 + move) / 2 / figure.bbox.width, 1 + 0.8 / height,
                plain(heading(listing), 150), fontsize=13, fontweight='bold', color=TEXT_COLOR,
                ha='center')
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


def _draw_panel(axes: Any, panel: _Panel, shapes: Mapping[str, Sequence[Sequence[Point]]],
                inch: float) -> None:
    """Draw the headings, the shapes, the arrows, and the frames."""
    axes.set_axis_off()
    for text, up, size, weight, color in ((panel.title, 32, 12, 'bold', TEXT_COLOR),
                                          (panel.subtitle, 14, 9, 'normal', GREY)):
        axes.annotate(text, (0.5, 1), (0, up), xycoords='axes fraction', ha='center',
                      textcoords='offset points', fontsize=size, fontweight=weight, color=color)
    collections = matplotlib_module('collections')
    for kind, lines in shapes.items():
        color = SHAPE_COLORS[kind]
        axes.add_collection(collections.PolyCollection(
            lines, closed=False, facecolors=f'{color}0d', edgecolors=color, linewidths=0.5,
            zorder=1, clip_on=False))
    arrows = [arrow for arrow in panel.arrows if math.dist(*arrow) > 1e-6]
    width = 1.3 if len(arrows) <= _FEW_LINKS else 0.8
    for start, end in arrows[:_MAX_ARROWS]:
        right = end[0] - start[0] > 0.1 * abs(end[1] - start[1])
        bend = _BEND if len(panel.frames) > _FEW_LINKS and right else -_BEND
        axes.annotate('', end, start, zorder=6, arrowprops={
            'arrowstyle': '-|>', 'color': TEXT_COLOR, 'lw': width, 'shrinkA': 4, 'shrinkB': 5,
            'connectionstyle': f'arc3,rad={bend}'})
    length = inch * max(axes.figure.get_size_inches()) * max(
        0.04, 0.14 / math.sqrt(len(panel.frames)))
    frames = [(color, 1.8, '-', 5, [
        (_project(pose.translation), _project(pose.apply((x * length, y * length, z * length))))
        for pose in panel.frames]) for (x, y, z), color in zip(UNITS, AXIS_COLORS)]
    for color, line_width, style, order, pairs in (
            *frames, (TEXT_COLOR, width, '-', 6, arrows[_MAX_ARROWS:]),
            (GREY, 1.2, ':', 4, panel.offsets)):
        axes.add_collection(collections.LineCollection(
            pairs, colors=color, linewidths=line_width, linestyles=style, zorder=order,
            clip_on=False))
    if panel.offsets:
        axes.plot(*zip(*(joint for joint, _ in panel.offsets)), 'h', color=GREY, clip_on=False,
                  zorder=4, markersize=9, markerfacecolor='none', markeredgewidth=1.2)


def _write_column(axes: Any, entries: Sequence[Entry], x: float, align: str, inch: float) -> None:
    """Write entries beside the drawing, near the heights of their points but not overlapping."""
    bottom, top = axes.get_ylim()
    shared = {'fontsize': 8, 'ha': align, 'annotation_clip': False}
    for below, entry in zip(reversed(range(len(entries))), sorted(
            entries, key=lambda entry: -entry.point[1])):
        y = max(min(entry.point[1], top), bottom + _ROW * inch * (below + 0.5))
        top = y - _ROW * inch
        axes.annotate(plain(entry.title), entry.point, (x, y), va='center', fontweight='bold',
                      color=TEXT_COLOR, **shared, arrowprops={
                          'arrowstyle': '-', 'color': PALE, 'lw': 0.7, 'shrinkB': 0, 'zorder': 3,
                          'relpos': (float(align == 'right'), 0.5)})
        axes.annotate(plain(entry.numbers), (x, y), (0, -6), textcoords='offset points', va='top',
                      color=GREY, linespacing=1.15, **shared)


def _project(point: Vector) -> Point:
    """Return the orthographic projection of a point."""
    x, y, z = point
    sine, cosine = math.sin(_AZIMUTH), math.cos(_AZIMUTH)
    return (cosine * y - sine * x,
            math.cos(_ELEVATION) * z - math.sin(_ELEVATION) * (cosine * x + sine * y))
