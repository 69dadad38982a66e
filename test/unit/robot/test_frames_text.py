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

"""Listing of the frames of a robot as text."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
import re
from typing import Any

from listed_robots import on, shifted, tutorial
from opencv_tools.robot.frames.listing import frames
from opencv_tools.robot.frames.text import text
from opencv_tools.robot.model import Axis, FrameId, Joint, Link, MODEL, Placement, Robot
from opencv_tools.robot.pose import Pose
import pytest
import robots
from rows import each_row


def cells(listing: dict[str, Any]) -> list[list[str]]:
    """Return the cells of the text in rows."""
    return [re.split(r'  +', line.strip()) for line in text(listing).splitlines()]


@pytest.mark.parametrize(('positions', 'wanted'), [
    ({}, [['robot shifted', 'in', 'xyz in metres', 'rpy in radians'],
          ['link base', 'base', '0 0 0', '0 0 0'],
          ['- <pose> in SDF', '__model__', '0 1 0', '0 0 0'],
          ['joint hinge (revolute)', 'base', '0.2 0 0.3', '0 0 0'],
          ['- <pose> in SDF', 'arm', '-0.3 0 0', '0 0 0'],
          ['link arm', 'base', '0.5 0 0.3', '0 0 0'],
          ['- <pose> in SDF', '__model__', '0.5 1 0.3', '0 0 0']]),
    ({'hinge': 0.5}, [['robot shifted at hinge=0.5', 'in', 'xyz in metres', 'rpy in radians'],
                      ['link base', 'base', '0 0 0', '0 0 0'],
                      ['- <pose> in SDF', '__model__', '0 1 0', '0 0 0'],
                      ['joint hinge (revolute) at 0.5', 'base', '0.2 0 0.3', '0 0 0'],
                      ['- <pose> in SDF', 'arm', '-0.3 0 0', '0 0 0'],
                      ['link arm, moved', 'base', '0.46327 0 0.15617', '0 0.5 0'],
                      ['- <pose> in SDF', '__model__', '0.5 1 0.3', '0 0 0']])],
    ids=['at zero', 'moved'])
def test_text_of_joints_and_links(positions: dict[str, float], wanted: list[list[str]]) -> None:
    assert cells(frames(shifted(), positions)) == wanted


def test_aligned_columns_of_the_text() -> None:
    listing = frames(tutorial(), {})
    lines = text(listing).splitlines()
    assert [line.split('  ')[0] for line in lines if line.startswith('link')] == [
        'link base_footprint']
    starts = [re.match(r' *[a-z]+ [a-z_]+', line) for line in lines]
    assert [start.group() for start in starts if start and 'robot' not in start.group()] == [
        'link base_footprint', '  joint base_joint', '  link base_link', '    joint turn',
        '    link wheel', '    joint push', '    link pusher']
    rows = cells(listing)
    assert ['joint turn (continuous)', 'base_link', '0 1 0', '-1.5708 0 0'] in rows
    assert ['link wheel', 'base_footprint', '0 1 0.2', '-1.5708 0 0'] in rows
    assert ['- visual', 'base_footprint', '-0.1 0 0.2', '1.5708 0 1.5708'] in rows
    assert ['- inertial 2.5 kg', 'base_footprint', '0 0.5 0.2', '0 0 0'] in rows
    for column in (' in  ', 'xyz', 'rpy'):
        at = lines[0].index(column) + (column[0] == ' ')
        assert all(line[at - 1] == ' ' != line[at] for line in lines)


def test_text_of_a_loop_joint() -> None:
    loop = Joint(name='loop', type='revolute', parent='wheel', child='pusher',
                 placement=on('wheel', Pose((0.0, 0.0, 0.1))), axes=(Axis((0.0, 0.0, 1.0)),),
                 is_loop=True)
    robot = tutorial()
    rows = cells(frames(replace(robot, joints=(*robot.joints, loop)), {}))
    assert ['loop to pusher by loop (revolute)', 'wheel', '0 0 0.1', '0 0 0'] in rows
    assert ['- <pose> in SDF', 'pusher', '0 1.1 0', '-1.5708 0 0'] in rows


@each_row(('count', 'wanted'), [
    (0, 'robot chain'), (1, 'robot chain at jl1=0.5'),
    (4, 'robot chain at jl1=0.5, jl2=0.5, jl3=0.5, jl4=0.5'),
    (5, 'robot chain at jl1=0.5, jl2=0.5, jl3=0.5, jl4=0.5, ...')])
def test_positions_in_the_heading(count: int, wanted: str) -> None:
    positions = {f'jl{index + 1}': 0.5 for index in range(count)}
    assert cells(frames(chain(6), positions))[0][0] == wanted


def chain(count: int) -> Robot:
    names = [f'l{index}' for index in range(count)]
    return Robot(name='chain',
                 links=(Link(name='l0', placement=Placement(Pose(), MODEL)),
                        *(Link(name=name,
                               placement=Placement(Pose(), FrameId('joint', f'j{name}')))
                          for name in names[1:])),
                 joints=tuple(Joint(name=f'j{child}', type='continuous', parent=parent,
                                    child=child,
                                    placement=on(parent, Pose((0.0, 0.0, 0.1), (0.1, 0.0, 0.0))),
                                    axes=(Axis((0.0, 0.0, 1.0)),))
                              for parent, child in pairwise(names)))


@pytest.mark.thorough
def test_text_of_a_chain_of_5000_links() -> None:
    def listed(count: int) -> str:
        return text(frames(chain(count), {}))

    assert robots.is_linear(listed)
    lines = listed(5000).splitlines()
    assert len(lines) == 10000
    assert max(map(len, lines)) < 160
    assert '(4999) link l4999' in lines[-1]
