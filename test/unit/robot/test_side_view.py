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

"""Side view of a small robot."""

from __future__ import annotations

import math
from typing import Any

from drawn_robots import (
    ARM, arrows, chain, COLLISION, drawn, Layout, LAYOUTS, marks, named, near, on, VISUAL)
import numpy as np
from opencv_tools.robot.drawing import primitives
from opencv_tools.robot.drawing.primitives import AXIS_COLORS, GREY, TEXT_COLOR
from opencv_tools.robot.model import Axis, Joint, Link, MODEL, Placement, Robot
from opencv_tools.robot.pose import Pose
import pytest


@LAYOUTS
def test_frames_and_shapes_in_the_side_view(layout: Layout) -> None:
    side = drawn(ARM, layout.positions)[2]
    x, _, z = layout.center
    assert near(marks(side, 'D'), [(0.0, 0.05)])
    assert near(marks(side, 's'), [(x, z)])
    places = [(place[::2], [axis[::2] for axis in axes])
              for place, axes in layout.places.values()]
    # The y axis points away and is a circle with a cross.
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
def test_distances_in_the_side_view(layout: Layout) -> None:
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
    # Thin lines lead from the measured points to the arrows.
    ends = [end for size, *_ in layout.sizes for end in (size[:2], size[2:])]
    thin = [line.get_xydata() for line in side.lines if line.get_color() == primitives.PALE]
    assert near([line[1] for line in thin], ends)
    known = [place[::2] for place, _ in layout.places.values()]
    known += [layout.center[::2], (0.0, 0.05), *marks(side, 'h')]
    assert all(any(near(line[0], place) for place in known) for line in thin)


@LAYOUTS
def test_ground_of_the_side_view(layout: Layout) -> None:
    side = drawn(ARM, layout.positions)[2]
    left, right, low, _ = layout.box
    ends = left - 0.5 * layout.unit, right + 0.5 * layout.unit
    assert near(side.lines[0].get_xydata(), [(ends[0], low), (ends[1], low)])
    ground = side.collections[0].get_paths()[0].get_extents()
    assert (ground.x0, ground.x1) == pytest.approx(ends)
    assert (ground.y0, ground.y1) == pytest.approx((-0.03 * layout.unit, 0.0))
    assert side.get_aspect() == 1.0 and side.get_adjustable() == 'datalim'
    assert not side.axison


def test_joint_arrows_in_the_side_view() -> None:
    side = drawn(ARM, {'elbow': math.pi / 2, 'slide': 0.1})[2]
    curves = [line.get_xydata() for line in side.lines if line.get_linestyle() == '--']
    assert len(curves) == 2 and len(curves[1]) == 19
    # A Bezier curve from (0, 0.4) to (0.5, 0.4) with the control point (0.25, 0.575).
    assert near(curves[1][[0, 9, 18]], [(0.025, 0.416625), (0.25, 0.4875), (0.475, 0.416625)])
    assert near(curves[0][9], (-0.07, 0.2))
    assert near(arrows(side, '-|>', GREY), [(*curve[-2], *curve[-1]) for curve in curves])
    # The joint stays at its origin, and the link has moved.
    assert near(marks(side, 'h'), [(0.0, 0.4), (0.5, 0.4)])
    dotted = [line.get_xydata() for line in side.lines if line.get_linestyle() == ':']
    assert near(dotted, [[(0.5, 0.4), (0.6, 0.4)]])
    texts = texts_at(side)
    assert near(texts['elbow (continuous) at 1.5708\nxyz 0 0 0.4\nrpy 0 0 0'], (0.0, 0.4))
    assert near(texts['slide (prismatic) at 0.1\nxyz 0 0 0.5\nrpy 0 0 0'], (0.5, 0.4))
    assert near(texts['tool, moved\nxyz 0.6 0 0.4\nrpy 0 1.571 0'], (0.6, 0.4))
    assert near(texts['base\nxyz 0 0 0\nrpy 0 0 0'], (0.0, 0.0))


@pytest.mark.thorough
def test_side_view_of_joints_away_from_their_links() -> None:
    robot = Robot(name='shifted',
                  links=(Link(name='base', placement=Placement(Pose(), MODEL)),
                         Link(name='arm', placement=Placement(Pose((0.5, 0.0, 0.3)), MODEL))),
                  joints=(Joint(name='hinge', type='revolute', parent='base', child='arm',
                                placement=on('arm', Pose((-0.3, 0.0, 0.0))),
                                axes=(Axis((0.0, 1.0, 0.0)),)),))
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


def test_axes_along_the_viewing_direction() -> None:
    robot = Robot(name='one', links=(
        Link(name='only', placement=Placement(Pose(), MODEL)),
        *(Link(name=f'at {x}', placement=on('only', Pose((x, 0.0, 0.0), (turn, 0.0, 0.0))))
          for x, turn in ((1.0, 0.0), (2.0, math.pi)))))
    side = drawn(robot)[2]
    assert (1.0, 0.0) in marks(side, 'x') and (2.0, 0.0) not in marks(side, 'x')
    assert (2.0, 0.0) in marks(side, '.') and (1.0, 0.0) not in marks(side, '.')


def test_axis_letters_of_coincident_frames() -> None:
    side = drawn(chain(4, Pose()))[2]
    assert [one.get_text() for one in side.texts if len(one.get_text()) == 1] == ['x', 'z']
