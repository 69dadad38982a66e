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

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
import functools
from itertools import combinations, pairwise
import math
import os
from pathlib import Path
import re
import subprocess
import sys
from typing import Any

import numpy as np
from opencv_tools.robot.drawing import primitives
from opencv_tools.robot.drawing.primitives import (
    AXIS_COLORS, GREY, hull, outline, SHAPE_COLORS, TEXT_COLOR)
from opencv_tools.robot.drawing.labels import Labels
from opencv_tools.robot.frames.listing import frames
from opencv_tools.robot.drawing.plot import draw, plot
from opencv_tools.robot.geometry import Box, Capsule, Cylinder, Geometry, Mesh, Sphere
from opencv_tools.robot.model import Axis, FrameId, Joint, Link, MODEL, Placement, Robot, Shape
from opencv_tools.robot.pose import Pose, Vector
from opencv_tools.robot.xml.document import DescriptionError
import pytest


def on(link: str, pose: Pose = Pose()) -> Placement:  # noqa: B008
    return Placement(pose, FrameId('link', link))


BASE = Box((0.7, 0.3, 0.1))


def tutorial(geometry: Geometry | None = BASE, name: str = 'base_link') -> Robot:
    visual = Shape('', on(name, Pose((-0.1, 0.0, 0.0), (math.pi / 2, 0.0, math.pi / 2))),
                   Mesh('package://my_robot/meshes/robot_base.stl'))
    collision = Shape('', on(name, Pose((0.0, 0.0, -0.15))), geometry)
    return Robot('my_robot', (
        Link('base_footprint', Placement(Pose(), MODEL)),
        Link(name, Placement(Pose(), FrameId('joint', 'base_joint')), None, (visual,),
             (collision,))), (
        Joint('base_joint', 'fixed', 'base_footprint', name,
              on('base_footprint', Pose((0.0, 0.0, 0.2)))),))


def chain(count: int, pose: Pose = Pose((0.1, 0.0, 0.1), (0.0, 0.3, 0.5))) -> Robot:  # noqa: B008
    names = [f'link_{index}' for index in range(count)]
    return Robot('chain', (Link(names[0], Placement(Pose(), MODEL)), *(
        Link(name, Placement(Pose(), FrameId('joint', f'to_{name}'))) for name in names[1:])),
        tuple(Joint(f'to_{child}', 'continuous', parent, child, on(parent, pose),
                    (Axis((0.0, 0.0, 1.0)),)) for parent, child in pairwise(names)))


def words(path: Path) -> list[str]:
    return re.findall(r'<text[^>]*>([^<]*)</text>', path.read_text())


def test_a_png_is_a_picture_with_colours(tmp_path: Path) -> None:
    from matplotlib.image import imread
    path = tmp_path / 'robot.PNG'
    plot(tutorial(), {}, str(path))
    picture = imread(path)
    assert picture.shape[0] > 800
    assert picture.shape[1] > 1200
    for color in primitives.AXIS_COLORS:
        wanted = [int(color[start:start + 2], 16) / 255 for start in (1, 3, 5)]
        assert (abs(picture[..., :3] - wanted).max(axis=2) < 0.02).sum() > 100


def test_the_tutorials_schematic_has_names_and_sizes(tmp_path: Path) -> None:
    path = tmp_path / 'robot.svg'
    plot(tutorial(), {}, str(path))
    found = words(path)
    # In the view in space, in the tree and in the schematic.
    assert found.count('base_footprint') == 3
    assert found.count('base_link') == 3
    assert {'0.2', '0.15', '0.1', 'base_joint (fixed)', 'xyz 0 0 0.2', 'xyz 0 0 0', 'rpy 0 0 0',
            'visual of base_link (robot_base.stl)', 'collision of base_link (box)'} <= set(found)


def test_the_file_is_the_same_every_time_and_has_no_date(tmp_path: Path) -> None:
    one, other = tmp_path / 'one.svg', tmp_path / 'other.svg'
    for path in (one, other):
        plot(tutorial(), {}, str(path))
    assert one.read_bytes() == other.read_bytes()
    assert '<dc:date>' not in one.read_text()


ARM = Robot('arm', (
    Link('base', Placement(Pose(), MODEL), visuals=(
        Shape('', on('base', Pose((0.0, 0.0, 0.05))), Box((0.2, 0.2, 0.1))),)),
    Link('arm', Placement(Pose(), FrameId('joint', 'elbow'))),
    Link('tool', Placement(Pose(), FrameId('joint', 'slide')), collisions=(
        Shape('', on('tool', Pose((0.1, 0.0, 0.0))), Sphere(0.05)),))), (
    Joint('elbow', 'continuous', 'base', 'arm', on('base', Pose((0.0, 0.0, 0.4))),
          (Axis((0.0, 1.0, 0.0)),)),
    Joint('slide', 'prismatic', 'arm', 'tool', on('arm', Pose((0.0, 0.0, 0.5))),
          (Axis((0.0, 0.0, 1.0)),))))
UPRIGHT = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
BENT = ((0.0, 0.0, -1.0), (0.0, 1.0, 0.0), (1.0, 0.0, 0.0))


@dataclass(frozen=True)
class Layout:
    """
    Where all of the arm is, at some positions of its joints, and how it is drawn.

    :param tool: where the link of this name is.
    :param center: of the sphere on it.
    :param axes: of the two links that move.
    :param middle: of what the view in space shows, and how far it reaches from there.
    :param lengths: of the axes of a frame in space and in the side view.
    :param sizes: in the side view: from where to where, the colour, and the text and its place.
    """

    positions: dict[str, float]
    tool: Vector
    center: Vector
    axes: Sequence[Vector]
    middle: Vector
    reach: Vector
    lengths: tuple[float, float]
    sizes: Sequence[tuple[tuple[float, float, float, float], str, str, tuple[float, float]]]
    box: tuple[float, float, float, float]
    unit: float

    @property
    def places(self) -> dict[str, tuple[Vector, Sequence[Vector]]]:
        moved = ', moved' if self.positions else ''
        return {'base': ((0.0, 0.0, 0.0), UPRIGHT), f'arm{moved}': ((0.0, 0.0, 0.4), self.axes),
                f'tool{moved}': (self.tool, self.axes)}


VISUAL, COLLISION = SHAPE_COLORS['visual'], SHAPE_COLORS['collision']
LAYOUTS = pytest.mark.parametrize('layout', [
    Layout({}, (0.0, 0.0, 0.9), (0.1, 0.0, 0.9), UPRIGHT, (0.025, 0.02125, 0.52125),
           (0.2189250, 0.2189250, 0.5473125), (0.1425, 0.152), (
               ((-0.29, 0.0, -0.29, 0.4), TEXT_COLOR, '0.4', (-0.2995, 0.2)),
               ((-0.385, 0.4, -0.385, 0.9), TEXT_COLOR, '0.5', (-0.3945, 0.65)),
               ((-0.48, 0.0, -0.48, 0.05), VISUAL, '0.05', (-0.4895, 0.025)),
               ((0.0, 1.178, 0.1, 1.178), COLLISION, '0.1', (0.05, 1.1875))),
           (-0.1, 0.15, 0.0, 0.95), 0.95),
    Layout({'elbow': math.pi / 2, 'slide': 0.1}, (0.6, 0.0, 0.4), (0.6, 0.0, 0.3), BENT,
           (0.30625, 0.00625, 0.2), (0.4265625, 0.170625, 0.21), (0.1125, 0.12), (
               ((-0.25, 0.0, -0.25, 0.4), TEXT_COLOR, '0.4', (-0.2575, 0.2)),
               ((0.0, 0.58, 0.5, 0.58), TEXT_COLOR, '0.5', (0.25, 0.5875)),
               ((0.5, 0.64, 0.6, 0.64), TEXT_COLOR, '0.1', (0.55, 0.6475)),
               ((-0.325, 0.0, -0.325, 0.05), VISUAL, '0.05', (-0.3325, 0.025)),
               ((-0.4, 0.4, -0.4, 0.3), COLLISION, '0.1', (-0.4075, 0.35))),
           (-0.1, 0.65, 0.0, 0.4), 0.75)], ids=['at zero', 'moved'])


def drawn(robot: Robot, positions: dict[str, float] | None = None) -> list[Any]:
    """List the views of the picture of a robot, which tests share and do not change."""
    return _drawn(robot, tuple((positions or {}).items()))


@functools.cache
def _drawn(robot: Robot, items: tuple[tuple[str, float], ...]) -> list[Any]:
    positions = dict(items)
    return list(draw(robot, frames(robot, positions)).axes)


def near(one: Any, other: Any) -> bool:
    """Tell whether points are the same, and as many."""
    one, other = np.array(one, float), np.array(other, float)
    return one.shape == other.shape and bool(np.abs(one - other).max(initial=0.0) < 1e-9)


def in_view(axes: Any, *points: Vector) -> list[tuple[float, float]]:
    """Give where points in space are in a view of it."""
    from mpl_toolkits.mplot3d.proj3d import proj_transform
    return [proj_transform(*point, axes.get_proj())[:2] for point in points]


def segments(axes: Any, color: str) -> Any:
    """Give all lines of a colour in a view in space, as they are seen."""
    from matplotlib.colors import to_rgba
    return [line for one in axes.collections for line in one.get_segments()
            if tuple(one.get_edgecolor()[0]) == to_rgba(color)]


def marks(axes: Any, marker: str) -> list[tuple[float, float]]:
    return [(float(x), float(y)) for line in axes.lines if line.get_marker() == marker
            for x, y in zip(*line.get_data())]


def arrows(axes: Any, style: str, color: str) -> list[tuple[float, ...]]:
    """Give from where to where arrows go."""
    return [(*one.xyann, *one.xy) for one in axes.texts
            if (getattr(one, 'arrowprops', None) or {}).get('arrowstyle') == style
            and one.arrowprops['color'] == color]


def named(axes: Any) -> dict[str, tuple[float, float]]:
    """Return the points that texts are about, by the first line of each."""
    return {one.get_text().split('\n')[0]: getattr(one, 'xy', one.get_position())
            for one in axes.texts if one.get_text()}


def tip(place: Vector, axis: Vector, length: float) -> Vector:
    x, y, z = (start + length * part for start, part in zip(place, axis))
    return x, y, z


@LAYOUTS
def test_frames_in_space_are_where_kinematics_puts_them(layout: Layout) -> None:
    space = drawn(ARM, layout.positions)[0]
    places = layout.places
    # By the joints: the second one's link has moved on from there.
    stops = [place for place, _ in places.values()]
    if layout.positions:
        stops.insert(2, (0.5, 0.0, 0.4))
    assert near(segments(space, GREY), [in_view(space, *ends) for ends in pairwise(stops)])
    for index, color in enumerate(AXIS_COLORS):
        assert near(segments(space, color), [
            in_view(space, place, tip(place, axes[index], layout.lengths[0]))
            for place, axes in places.values()])
    for name, (place, _) in places.items():
        assert near(named(space)[name], in_view(space, place)[0])
    for limits, middle, half in zip((space.get_xlim(), space.get_ylim(), space.get_zlim()),
                                    layout.middle, layout.reach):
        assert limits == pytest.approx((middle - half, middle + half))
    assert [space.get_xlabel(), space.get_ylabel(), space.get_zlabel()] == [
        'x [m]', 'y [m]', 'z [m]']
    assert (space.elev, space.azim) == (22, -55)
    assert 'Frames of the links (collision, visual in thin lines)' in [
        text.get_text() for text in space.figure.texts]


@LAYOUTS
def test_shapes_in_space_are_where_their_links_are(layout: Layout) -> None:
    space = drawn(ARM, layout.positions)[0]
    edges = {frozenset((a, b)) for a, b in combinations(
        [(x, y, z) for x in (-0.1, 0.1) for y in (-0.1, 0.1) for z in (0.0, 0.1)], 2)
        if sum(one != other for one, other in zip(a, b)) == 1}
    seen = [in_view(space, *edge) for edge in edges]
    lines = segments(space, VISUAL)
    found = [[near(line, edge) or near(line, edge[::-1]) for edge in seen] for line in lines]
    assert len(seen) == 12
    assert all(map(any, found)) and all(map(any, zip(*found)))
    points = np.array(segments(space, COLLISION)).reshape(-1, 2)
    for axis in UPRIGHT:
        for radius in (-0.05, 0.05):
            pole = in_view(space, tip(layout.center, axis, radius))[0]
            assert np.hypot(*(points - pole).T).min() < 1e-9


@LAYOUTS
def test_side_view_is_where_kinematics_puts_it(layout: Layout) -> None:
    side = drawn(ARM, layout.positions)[2]
    x, _, z = layout.center
    assert near(marks(side, 'D'), [(0.0, 0.05)])
    assert near(marks(side, 's'), [(x, z)])
    places = [(place[::2], [axis[::2] for axis in axes])
              for place, axes in layout.places.values()]
    # The axis y points away: a circle with a cross.
    for marker in 'ox':
        assert near(marks(side, marker), [place for place, _ in places])
    for index, letter in ((0, 'x'), (2, 'z')):
        tips = [tuple(start + layout.lengths[1] * part for start, part in zip(place, axes[index]))
                for place, axes in places]
        assert near(arrows(side, '-|>', AXIS_COLORS[index]),
                    [(*place, *end) for (place, _), end in zip(places, tips)])
        assert near([one.xy for one in side.texts if one.get_text() == letter], tips)
    assert side.get_title() == (
        'Side view in metres: x to the right, z up, y away. Links are in base, '
        'joints in their parent links')
    outlines = [patch.get_xy() for patch in side.patches]
    assert near(outlines[0], [(-0.1, 0), (0.1, 0), (0.1, 0.1), (-0.1, 0.1), (-0.1, 0)])
    assert np.abs(np.hypot(*(outlines[1] - (x, z)).T) - 0.05).max() < 1e-9
    assert near([outlines[1].min(axis=0), outlines[1].max(axis=0)],
                [(x - 0.05, z - 0.05), (x + 0.05, z + 0.05)])
    for one in outlines:
        assert any(near(line.get_xydata(), one) for line in side.lines)
    texts = named(side)
    for name, (place, _) in layout.places.items():
        assert near(texts[name], place[::2])
    assert near(texts['visual of base (box)'], (0.0, 0.05))
    assert near(texts['collision of tool (sphere)'], (x, z))


@LAYOUTS
def test_side_view_says_how_far_things_are_apart(layout: Layout) -> None:
    side = drawn(ARM, layout.positions)[2]
    for color in (TEXT_COLOR, VISUAL, COLLISION):
        wanted = [size for size in layout.sizes if size[1] == color]
        assert near(arrows(side, '<|-|>', color), [size[0] for size in wanted])
        texts = [text for text in side.texts if text.get_color() == color
                 and not getattr(text, 'arrowprops', None) and text.get_text()[0].isdigit()]
        assert [text.get_text() for text in texts] == [size[2] for size in wanted]
        assert near([text.get_position() for text in texts], [size[3] for size in wanted])
    for size, *_ in layout.sizes:
        assert any(near(line.get_xydata().ravel(), size) for line in side.lines)
    # Thin lines lead from what is measured to the arrows.
    ends = [end for size, *_ in layout.sizes for end in (size[:2], size[2:])]
    thin = [line.get_xydata() for line in side.lines if line.get_color() == primitives.PALE]
    assert near([line[1] for line in thin], ends)
    known = [place[::2] for place, _ in layout.places.values()]
    known += [layout.center[::2], (0.0, 0.05), *marks(side, 'h')]
    assert all(any(near(line[0], place) for place in known) for line in thin)


@LAYOUTS
def test_side_view_stands_on_the_ground(layout: Layout) -> None:
    side = drawn(ARM, layout.positions)[2]
    left, right, low, _ = layout.box
    ends = left - 0.5 * layout.unit, right + 0.5 * layout.unit
    assert near(side.lines[0].get_xydata(), [(ends[0], low), (ends[1], low)])
    ground = side.collections[0].get_paths()[0].get_extents()
    assert (ground.x0, ground.x1) == pytest.approx(ends)
    assert (ground.y0, ground.y1) == pytest.approx((-0.03 * layout.unit, 0.0))
    assert side.get_aspect() == 1.0 and side.get_adjustable() == 'datalim'
    assert not side.axison


def test_joints_in_the_side_view_are_bent_arrows_with_their_poses() -> None:
    side = drawn(ARM, {'elbow': math.pi / 2, 'slide': 0.1})[2]
    curves = [line.get_xydata() for line in side.lines if line.get_linestyle() == '--']
    assert len(curves) == 2 and len(curves[1]) == 19
    # A parabola from (0, 0.4) to (0.5, 0.4) that begins towards (0.25, 0.575).
    assert near(curves[1][[0, 9, 18]], [(0.025, 0.416625), (0.25, 0.4875), (0.475, 0.416625)])
    assert near(curves[0][9], (-0.07, 0.2))
    assert near(arrows(side, '-|>', GREY), [(*curve[-2], *curve[-1]) for curve in curves])
    # The joint stays at its origin. The link has moved on from there.
    assert near(marks(side, 'h'), [(0.0, 0.4), (0.5, 0.4)])
    dotted = [line.get_xydata() for line in side.lines if line.get_linestyle() == ':']
    assert near(dotted, [[(0.5, 0.4), (0.6, 0.4)]])
    texts = texts_at(side)
    assert near(texts['elbow (continuous) at 1.5708\nxyz 0 0 0.4\nrpy 0 0 0'], (0.0, 0.4))
    assert near(texts['slide (prismatic) at 0.1\nxyz 0 0 0.5\nrpy 0 0 0'], (0.5, 0.4))
    assert near(texts['tool, moved\nxyz 0.6 0 0.4\nrpy 0 1.571 0'], (0.6, 0.4))
    assert near(texts['base\nxyz 0 0 0\nrpy 0 0 0'], (0.0, 0.0))


def test_joints_that_are_not_at_their_links() -> None:
    robot = Robot('shifted', (Link('base', Placement(Pose(), MODEL)),
                              Link('arm', Placement(Pose((0.5, 0.0, 0.3)), MODEL))), (
        Joint('hinge', 'revolute', 'base', 'arm', on('arm', Pose((-0.3, 0.0, 0.0))),
              (Axis((0.0, 1.0, 0.0)),)),))
    side = drawn(robot)[2]
    assert near(marks(side, 'h'), [(0.2, 0.3)])
    arrow, = arrows(side, '-|>', GREY)
    assert math.dist(arrow[2:], (0.2, 0.3)) < 0.05
    texts = texts_at(side)
    assert near(texts['hinge (revolute)\nxyz 0.2 0 0.3\nrpy 0 0 0'], (0.2, 0.3))
    assert near(texts['arm\nxyz 0.5 0 0.3\nrpy 0 0 0'], (0.5, 0.3))
    assert {'0.2', '0.3'} <= set(texts)


def texts_at(axes: Any) -> dict[str, tuple[float, float]]:
    return {one.get_text(): getattr(one, 'xy', one.get_position()) for one in axes.texts}


@pytest.mark.parametrize(('turn', 'marker'), [(0.0, 'x'), (math.pi, '.')])
def test_axes_that_point_away_or_at_who_looks(turn: float, marker: str) -> None:
    robot = Robot('one', (Link('only', Placement(Pose(), MODEL)),
                          Link('other', on('only', Pose((1.0, 0.0, 0.0), (turn, 0.0, 0.0))))))
    assert (1.0, 0.0) in marks(drawn(robot)[2], marker)


def test_frames_in_one_place_have_their_letters_once() -> None:
    side = drawn(chain(4, Pose()))[2]
    assert [one.get_text() for one in side.texts if len(one.get_text()) == 1] == ['x', 'z']


def row(*steps: float) -> Robot:
    """Build links in a row along x."""
    names = [f'link_{index}' for index in range(len(steps) + 1)]
    return Robot('row', (Link(names[0], Placement(Pose(), MODEL)), *(
        Link(name, Placement(Pose(), FrameId('joint', f'to_{name}'))) for name in names[1:])),
        tuple(Joint(f'to_{child}', 'fixed', parent, child, on(parent, Pose((step, 0.0, 0.0))))
              for (parent, child), step in zip(pairwise(names), steps)))


@pytest.mark.parametrize(('steps', 'in_space', 'beside'), [
    ((0.1, 0.1, 0.1), 0.045, 0.048), ((0.02, 0.02, 0.3), 0.0102, 0.0204),
    ((0.2, 0.9, 1.0), 0.315, 0.126), ((0.05, 0.5), 0.0825, 0.033), ((0.5,), 0.075, 0.08)])
def test_axes_are_long_enough_to_be_seen_and_do_not_touch(
        steps: tuple[float, ...], in_space: float, beside: float) -> None:
    space, _, side = drawn(row(*steps))
    assert near(segments(space, AXIS_COLORS[2])[0],
                in_view(space, (0.0, 0.0, 0.0), (0.0, 0.0, in_space)))
    assert near(arrows(side, '-|>', AXIS_COLORS[2])[0], (0.0, 0.0, 0.0, beside))


def test_tree_has_a_row_for_each_link_below_what_it_hangs_on() -> None:
    tree = drawn(ARM)[1]
    spots = [(0.02, 0), (0.09, 1), (0.16, 2)]
    assert near(marks(tree, 'o'), spots)
    assert near([named(tree)[name] for name in ('base', 'arm', 'tool')],
                [(x + 0.022, y) for x, y in spots])
    assert near([line.get_xydata() for line in tree.lines if line.get_marker() == 'None'], [
        [(a, b + 0.2), (a, d), (c, d)] for (a, b), (c, d) in pairwise(spots)])
    joints = {one.get_text().strip(): (one.xycoords.get_text(), one.xy) for one in tree.texts
              if hasattr(one, 'xycoords')}
    assert joints == {'elbow (continuous)': ('arm', (1, 0.5)),
                      'slide (prismatic)': ('tool', (1, 0.5))}
    assert (tree.get_xlim(), tree.get_ylim()) == ((0, 1), (10, -0.5))


@pytest.mark.parametrize(('count', 'bottom', 'height'), [
    (5, 10, 7.65), (40, 40, 10.75), (62, 61, 15.55)])
def test_long_trees_and_names_that_are_left_out(count: int, bottom: float, height: float) -> None:
    space, tree = drawn(chain(count))
    rows = min(count, 60)
    step = min(0.07, 0.45 / (rows - 1))
    assert near(marks(tree, 'o'), [(0.02 + step * index, index) for index in range(rows)])
    assert tree.get_ylim() == (bottom, -0.5)
    assert space.figure.get_size_inches() == pytest.approx((13.0, height))
    named_links = sum(name.startswith('link_') for name in named(space))
    assert named_links == min(count, 40)
    assert (f'names of 40 of {count} links' in [text.get_text() for text in space.figure.texts]
            ) == (count > 40)
    if count > 60:
        assert named(tree)['and 2 more links'] == (0.02, 60)


def test_only_small_robots_have_a_side_view() -> None:
    assert [len(drawn(chain(count))) for count in (1, 4, 5)] == [3, 3, 2]
    assert drawn(chain(4))[0].figure.get_size_inches() == pytest.approx((13.0, 10.45))


def test_the_title_says_the_positions() -> None:
    figure = drawn(chain(6), {'to_link_2': 0.5})[0].figure
    assert figure.texts[0].get_text() == 'robot chain at to_link_2=0.5'
    assert figure.texts[0].get_fontsize() == 14
    long = Robot('n' * 200, chain(6).links, chain(6).joints)
    title = drawn(long)[0].figure.texts[0]
    assert title.get_text() == f'robot {"n" * 141}...' and title.get_fontsize() < 14


def test_positions_are_in_the_file(tmp_path: Path) -> None:
    path = tmp_path / 'arm.svg'
    plot(ARM, {'elbow': math.pi / 2, 'slide': 0.1}, str(path))
    assert {'robot arm at elbow=1.5708, slide=0.1', '0.5', 'rpy 0 1.571 0', 'tool, moved'} <= set(
        words(path))


def test_names_do_not_lie_on_one_another() -> None:
    axes = empty_axes()
    labels = Labels(axes)
    labels.avoid_line((0.0, 0.5), (1.0, 0.5))
    for index in range(12):
        labels.place(f'a_long_name_{index}', (0.5, 0.5))
    boxes = boxes_of(axes)
    assert len(boxes) == 12
    for one, other in combinations(boxes, 2):
        assert not one.overlaps(other)
    line = axes.transData.transform((0.5, 0.5))[1]
    assert not any(box.y0 < line < box.y1 for box in boxes)


def empty_axes() -> Any:
    """Build axes from 0 to 1 that are laid out."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure
    figure = Figure(figsize=(8, 6), dpi=144)
    canvas: Any = FigureCanvasAgg(figure)
    axes = figure.add_subplot()
    canvas.draw()
    return axes


def boxes_of(axes: Any) -> list[Any]:
    """List the rooms that texts take, without the lines to their points."""
    from matplotlib.text import Text
    axes.figure.canvas.draw()
    return [Text.get_window_extent(text, axes.figure.canvas.get_renderer())
            for text in axes.texts if text.get_text()]


@pytest.mark.parametrize(('point', 'side', 'angle'), [
    ((0.5, 0.5), 'left', 25), ((0.999, 0.5), 'right', 155), ((0.5, 0.999), 'left', -60),
    ((0.999, 0.999), 'right', 240), ((0.001, 0.001), 'left', 60)])
def test_a_name_is_next_to_its_point_and_in_the_picture(
        point: tuple[float, float], side: str, angle: float) -> None:
    axes = empty_axes()
    Labels(axes).place('a_long_name', point)
    label, = axes.texts
    turn = math.radians(angle)
    assert label.get_position() == pytest.approx((8 * math.cos(turn), 8 * math.sin(turn)))
    assert label.get_horizontalalignment() == side
    (box,), view = boxes_of(axes), axes.bbox
    assert view.x0 < box.x0 < box.x1 < view.x1 and view.y0 < box.y0 < box.y1 < view.y1


def test_names_keep_off_lines_and_are_tied_to_their_points_when_far() -> None:
    axes = empty_axes()
    labels = Labels(axes)
    labels.avoid_line((0.3, 0.4), (0.7, 0.6))
    for _ in range(9):
        labels.place('a_long_name', (0.5, 0.5))
    texts = [text for text in axes.texts if text.get_text()]
    line = axes.transData.transform([(0.3 + 0.4 * part, 0.4 + 0.2 * part)
                                     for part in np.linspace(0, 1, 500)])
    for box in boxes_of(axes):
        assert not any(box.contains(*point) for point in line)
    far = [text.get_position() for text in texts
           if math.hypot(*text.get_position()) > 14.001]
    ties = [text for text in axes.texts if not text.get_text()]
    assert 0 < len(far) < 9
    assert near([tie.xyann for tie in ties], far)
    assert {tie.xy for tie in ties} == {(0.5, 0.5)}


def test_names_keep_off_texts() -> None:
    axes = empty_axes()
    labels = Labels(axes)
    labels.avoid_text(axes.text(0.51, 0.52, 'taken', fontsize=30))
    labels.place('a_name', (0.5, 0.5))
    taken, name = boxes_of(axes)
    assert not name.overlaps(taken)


def test_a_name_is_drawn_though_its_point_is_beyond_the_axes() -> None:
    axes = empty_axes()
    bounds = axes.figure.bbox
    Labels(axes, bounds).place('a_name', (1.02, 0.5))
    box, = boxes_of(axes)
    assert axes.bbox.x1 < box.x0 < box.x1 < bounds.width
    pixels = np.asarray(axes.figure.canvas.buffer_rgba())[::-1]
    inside = pixels[int(box.y0):int(box.y1), int(box.x0):int(box.x1), :3]
    assert (inside.max(axis=2) < 100).sum() > 20


@pytest.mark.parametrize(('geometry', 'distance', 'lines'), [
    (Sphere(0.5), lambda x, y, z: math.hypot(x, y, z), 3),
    (Cylinder(0.5, 1.0), lambda x, y, z: math.hypot(x, y), 6),
    (Capsule(0.5, 1.0), lambda x, y, z: math.hypot(x, y, max(abs(z) - 0.5, 0.0)), 8)])
def test_outlines_lie_on_the_shapes(
        geometry: Geometry, distance: Callable[[float, float, float], float], lines: int) -> None:
    found = outline(geometry)
    assert len(found) == lines
    for line in found:
        assert [distance(*point) for point in line] == pytest.approx([0.5] * len(line))
    assert len({point for line in found for point in line}) > 40


@pytest.mark.parametrize('geometry', [
    Capsule(0.5, 1.0), Mesh('a.stl'), None])
def test_any_geometry_is_drawn(tmp_path: Path, geometry: Geometry | None) -> None:
    path = tmp_path / 'robot.svg'
    plot(tutorial(geometry), {}, str(path))
    assert any(word.startswith('collision of base_link') for word in words(path))


@pytest.mark.parametrize(('geometry', 'size'), [
    (Box((1.0, 2.0, 3.0)), (1.0, 2.0, 3.0)), (Sphere(1.0), (2.0, 2.0, 2.0)),
    (Cylinder(0.5, 1.0), (1.0, 1.0, 1.0)), (Capsule(0.5, 1.0), (1.0, 1.0, 2.0))])
def test_outlines_are_as_large_as_the_shapes(geometry: Geometry, size: tuple[float, ...]) -> None:
    columns = zip(*(point for line in outline(geometry) for point in line))
    assert tuple(max(column) - min(column) for column in columns) == pytest.approx(size)


def test_a_hull_goes_round_its_points() -> None:
    corners = [(0.0, 0.0), (2.0, 0.0), (2.0, 1.0), (0.0, 1.0)]
    assert hull([*corners, (1.0, 0.5), (1.0, 0.0), (2.0, 1.0)]) == corners
    assert hull([(1.0, 1.0)]) == [(1.0, 1.0)]
    assert sorted(hull([(0.0, 0.0), (1.0, 1.0), (2.0, 2.0)])) == [(0.0, 0.0), (2.0, 2.0)]


@pytest.mark.parametrize('robot', [
    Robot('one', (Link('only', Placement(Pose(), MODEL)),)),
    chain(4, Pose()),
    chain(5, Pose((1e-9, 0.0, 0.0))),
    chain(3, Pose((1e6, 0.0, 0.0))),
], ids=['one link', 'all in one place', 'tiny', 'huge'])
def test_odd_robots_are_drawn_without_a_warning(
        tmp_path: Path, robot: Robot, recwarn: pytest.WarningsRecorder) -> None:
    plot(robot, {}, str(tmp_path / 'robot.svg'))
    assert not recwarn.list


def test_names_are_no_formulas(tmp_path: Path) -> None:
    path = tmp_path / 'robot.svg'
    plot(tutorial(name='a$b$_{c} <&>'), {}, str(path))
    assert words(path).count('a$b$_{c} &lt;&amp;&gt;') == 3


@pytest.mark.parametrize('name', ['robot.pdf', 'robot', 'png'])
def test_another_suffix_is_an_error(tmp_path: Path, name: str) -> None:
    with pytest.raises(DescriptionError, match=r'needs the suffix \.png or \.svg, not'):
        plot(tutorial(), {}, str(tmp_path / name))
    assert list(tmp_path.iterdir()) == []


def test_a_file_that_cannot_be_written_is_an_error(tmp_path: Path) -> None:
    with pytest.raises(DescriptionError, match='cannot be written: No such file'):
        plot(tutorial(), {}, str(tmp_path / 'nowhere' / 'robot.svg'))


def test_without_matplotlib_the_error_says_how_to_get_it(
        monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setitem(sys.modules, 'matplotlib', None)
    with pytest.raises(DescriptionError, match='pip install matplotlib` or `sudo apt'):
        plot(tutorial(), {}, str(tmp_path / 'robot.png'))


@pytest.mark.process
def test_neither_matplotlib_nor_numpy_is_imported_before_it_is_needed() -> None:
    script = ('import sys, opencv_tools.robot.drawing.plot; '
              'assert not {"matplotlib", "numpy"} & set(sys.modules)')
    subprocess.run([sys.executable, '-c', script], check=True, timeout=30)


@pytest.mark.process
def test_neither_a_figure_nor_a_setting_stays(tmp_path: Path) -> None:
    script = ('import matplotlib, sys; before = matplotlib.rcParams.copy(); '
              'from test_plot import plot, tutorial; '
              f'plot(tutorial(), {{}}, {str(tmp_path / "robot.svg")!r}); '
              'assert "matplotlib.pyplot" not in sys.modules; '
              'assert matplotlib.rcParams.copy() == before')
    subprocess.run([sys.executable, '-c', script], check=True, timeout=60,
                   env={**os.environ, 'PYTHONPATH': os.pathsep.join(sys.path)})
