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

"""Perspective view of a robot."""

from __future__ import annotations

from itertools import combinations, pairwise
from typing import Any

from drawn_robots import (
    ARM, arrows, COLLISION, drawn, Layout, LAYOUTS, named, near, on, UPRIGHT, VISUAL)
import numpy as np
from opencv_tools.robot.drawing.primitives import AXIS_COLORS, GREY
from opencv_tools.robot.model import FrameId, Joint, Link, MODEL, Placement, Robot
from opencv_tools.robot.pose import Pose, Vector
import pytest


def in_view(axes: Any, *points: Vector) -> list[tuple[float, float]]:
    """Return the projections of points."""
    from mpl_toolkits.mplot3d.proj3d import proj_transform
    return [proj_transform(*point, axes.get_proj())[:2] for point in points]


def segments(axes: Any, color: str) -> Any:
    """Return the projections of all lines of a colour."""
    from matplotlib.colors import to_rgba
    return [line for one in axes.collections for line in one.get_segments()
            if tuple(one.get_edgecolor()[0]) == to_rgba(color)]


def tip(place: Vector, axis: Vector, length: float) -> Vector:
    x, y, z = (start + length * part for start, part in zip(place, axis))
    return x, y, z


@LAYOUTS
def test_frames_in_the_space_view(layout: Layout) -> None:
    space = drawn(ARM, layout.positions)[0]
    places = layout.places
    # The lines pass the joints; the second joint has moved its link away.
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
def test_shapes_in_the_space_view(layout: Layout) -> None:
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


def row(*steps: float) -> Robot:
    """Create links in a row along x."""
    names = [f'link_{index}' for index in range(len(steps) + 1)]
    return Robot(name='row',
                 links=(Link(name=names[0], placement=Placement(Pose(), MODEL)),
                        *(Link(name=name,
                               placement=Placement(Pose(), FrameId('joint', f'to_{name}')))
                          for name in names[1:])),
                 joints=tuple(Joint(name=f'to_{child}', type='fixed', parent=parent, child=child,
                                    placement=on(parent, Pose((step, 0.0, 0.0))))
                              for (parent, child), step in zip(pairwise(names), steps)))


@pytest.mark.quick_cases(1)
@pytest.mark.parametrize(('steps', 'in_space', 'beside'), [
    ((0.1, 0.1, 0.1), 0.045, 0.048), ((0.02, 0.02, 0.3), 0.0102, 0.0204),
    ((0.2, 0.9, 1.0), 0.315, 0.126), ((0.05, 0.5), 0.0825, 0.033), ((0.5,), 0.075, 0.08)])
def test_length_of_the_drawn_axes(
        steps: tuple[float, ...], in_space: float, beside: float) -> None:
    space, _, side = drawn(row(*steps))
    assert near(segments(space, AXIS_COLORS[2])[0],
                in_view(space, (0.0, 0.0, 0.0), (0.0, 0.0, in_space)))
    assert near(arrows(side, '-|>', AXIS_COLORS[2])[0], (0.0, 0.0, 0.0, beside))
