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

from dataclasses import replace
from itertools import pairwise
import json
import math
import re
from typing import Any

from opencv_tools.robot.frames.listing import frames
from opencv_tools.robot.frames.text import text
from opencv_tools.robot.geometry import Box
from opencv_tools.robot.model import (
    Axis, Frame, FrameId, Inertial, Joint, Limit, Link, Mimic, MODEL, Placement, Robot, Shape)
from opencv_tools.robot.pose import Pose
from opencv_tools.robot.xml.document import DescriptionError
from opencv_tools.robot.xml.report import Report
import pytest
import robots

HALF = math.pi / 2
ROOT_HALF = math.sqrt(0.5)


def on(link: str, pose: Pose = Pose()) -> Placement:  # noqa: B008
    return Placement(pose, FrameId('link', link))


def tutorial() -> Robot:
    """Build the tutorial's robot, with a wheel and a pusher that follows it."""
    visual = Shape('', on('base_link', Pose((-0.1, 0.0, 0.0), (HALF, 0.0, HALF))), None)
    collision = Shape('box', on('base_link', Pose((0.0, 0.0, -0.15))), Box((0.7, 0.3, 0.1)))
    return Robot('my_robot', (
        Link('base_footprint', Placement(Pose(), MODEL)),
        Link('base_link', Placement(Pose(), FrameId('joint', 'base_joint')),
             Inertial(on('base_link', Pose((0.0, 0.5, 0.0))), 2.5, (1.0, 0.1, 0.2, 2.0, 0.3, 3.0)),
             (visual,), (collision,)),
        Link('wheel', Placement(Pose(), FrameId('joint', 'turn'))),
        Link('pusher', Placement(Pose(), FrameId('joint', 'push')))), (
        Joint('base_joint', 'fixed', 'base_footprint', 'base_link',
              on('base_footprint', Pose((0.0, 0.0, 0.2)))),
        Joint('turn', 'continuous', 'base_link', 'wheel',
              on('base_link', Pose((0.0, 1.0, 0.0), (-HALF, 0.0, 0.0))), (Axis((0.0, 0.0, 3.0)),)),
        Joint('push', 'prismatic', 'base_link', 'pusher', on('base_link'), (
            Axis((1.0, 0.0, 0.0), Limit(-0.5, math.inf), mimic=Mimic('turn', 0.5, 0.25)),))))


def movable(**changes: Any) -> Robot:
    robot = tutorial()
    turn = replace(robot.joints[1], **changes)
    return replace(robot, joints=(robot.joints[0], turn, robot.joints[2]))


def test_the_listing_has_exactly_these_keys() -> None:
    listing = frames(tutorial(), {})
    assert list(listing) == ['robot', 'root', 'links', 'joints']
    assert listing['robot'] == 'my_robot'
    assert listing['root'] == 'base_footprint'
    assert set(listing['links']) == {'base_footprint', 'base_link', 'wheel', 'pusher'}
    for link in listing['links'].values():
        assert list(link) == [
            'parent', 'pose', 'moved', 'in_model', 'visuals', 'collisions', 'inertial']
    for joint in listing['joints'].values():
        assert list(joint) == ['type', 'parent', 'child', 'axis', 'pose', 'position', 'in_parent',
                               'in_child', 'lower', 'upper']
    assert json.loads(json.dumps(listing, allow_nan=False)) == listing


def test_the_tutorials_poses_are_those_of_its_text() -> None:
    listing = frames(tutorial(), {})
    base = listing['links']['base_link']
    assert base['parent'] == 'base_footprint'
    assert listing['links']['base_footprint']['parent'] is None
    assert base['pose'] == [0, 0, 0.2, 1, 0, 0, 0]
    assert listing['joints']['base_joint']['pose'] == [0, 0, 0.2, 1, 0, 0, 0]
    visual, = base['visuals']
    assert visual['pose'] == pytest.approx([-0.1, 0, 0.2, 0.5, 0.5, 0.5, 0.5])
    collision, = base['collisions']
    assert collision['name'] == 'box'
    assert collision['pose'] == pytest.approx([0, 0, 0.05, 1, 0, 0, 0])
    assert base['inertial'] == {'mass': 2.5, 'pose': [0, 0.5, 0.2, 1, 0, 0, 0],
                                'inertia': [1.0, 0.1, 0.2, 2.0, 0.3, 3.0]}
    assert listing['links']['wheel']['inertial'] is None


def test_joints_say_their_axis_in_the_root_frame_and_their_limits() -> None:
    joints = frames(tutorial(), {})['joints']
    assert joints['turn']['axis'] == pytest.approx([0, 1, 0])
    assert (joints['turn']['lower'], joints['turn']['upper']) == (None, None)
    assert joints['push']['axis'] == [1, 0, 0]
    assert (joints['push']['lower'], joints['push']['upper']) == (-0.5, None)
    assert (joints['base_joint']['axis'], joints['base_joint']['lower']) == (None, None)
    assert (joints['turn']['type'], joints['turn']['parent'], joints['turn']['child']) == (
        'continuous', 'base_link', 'wheel')


def test_limits_of_1e16_are_none() -> None:
    robot = movable(type='revolute', axes=(Axis((0.0, 0.0, 1.0), Limit(-1e16, 1e16)),))
    joint = frames(robot, {})['joints']['turn']
    assert (joint['lower'], joint['upper']) == (None, None)


def test_joints_move_what_hangs_on_them_and_mimics_follow() -> None:
    listing = frames(tutorial(), {'turn': HALF})
    assert listing['links']['wheel']['pose'] == pytest.approx(
        [0, 1, 0.2, 0.5, -0.5, 0.5, 0.5])
    assert listing['joints']['turn']['pose'] == listing['links']['wheel']['pose']
    assert listing['joints']['turn']['axis'] == pytest.approx([0, 1, 0])
    assert listing['links']['pusher']['pose'][0] == pytest.approx(HALF / 2 + 0.25)
    assert listing['links']['base_link'] == frames(tutorial(), {})['links']['base_link']


def test_the_first_axis_of_two_does_not_turn_with_the_second() -> None:
    links = tuple(Link(name, Placement(Pose(), MODEL)) for name in 'ab')
    robot = Robot('two', links, (
        Joint('j', 'universal', 'a', 'b', on('b', Pose(rpy=(0.0, 0.0, HALF))),
              (Axis((1.0, 0.0, 0.0)), Axis((0.0, 1.0, 0.0)))),))
    assert frames(robot, {})['joints']['j']['axis'] == pytest.approx([0, 1, 0])


@pytest.mark.parametrize(('position', 'message'), [
    ({'nothing': 1.0}, "joint 'nothing' does not exist; the movable joints are 'turn'$"),
    ({'base_joint': 1.0}, "joint 'base_joint' is fixed, not of one degree of freedom; .*'turn'"),
    ({'push': 1.0}, "joint 'push' mimics 'turn'; move 'turn' instead"),
    ({'turn': math.nan}, "position of 'turn' is nan"),
    ({'turn': math.inf}, "position of 'turn' is inf"),
])
def test_positions_that_no_joint_can_have_are_errors(position: dict[str, float], message: str
                                                     ) -> None:
    with pytest.raises(DescriptionError, match=message):
        frames(tutorial(), position)


def test_a_joint_of_several_numbers_is_an_error() -> None:
    with pytest.raises(DescriptionError, match=r"'turn' is floating, .*; the robot has no joint "
                       r"of one degree of freedom; its joints are 'base_joint', 'turn', 'push'$"):
        frames(movable(type='floating'), {'turn': 1.0})


@pytest.mark.parametrize(('count', 'message'), [
    (1, 'the robot has no movable joint$'),
    (2, "the robot has no movable joint; its joints are 'base_joint'$")])
def test_a_robot_without_movable_joints_is_said_to_have_none(count: int, message: str) -> None:
    robot = replace(tutorial(), links=tutorial().links[:count],
                    joints=tutorial().joints[:count - 1])
    with pytest.raises(DescriptionError, match=f"joint 'arm' does not exist; {message}"):
        frames(robot, {'arm': 0.5})


def test_a_position_outside_the_limits_is_noted_and_taken() -> None:
    robot = movable(type='revolute', axes=(Axis((0.0, 0.0, 1.0), Limit(-1.0, 1.0)),))
    report = Report()
    frames(robot, {'turn': 1.0}, report)
    assert report.warnings == []
    assert frames(robot, {'turn': 1.5}, report) == frames(robot, {'turn': 1.5})
    note, = report.warnings
    assert (note.name, note.message) == ('turn', 'position 1.5 is outside the limits -1 to 1')


def test_poses_are_in_the_root_links_frame_wherever_that_is() -> None:
    robot = tutorial()
    away = Placement(Pose((7.0, 8.0, 9.0), (1.0, 2.0, 3.0)), MODEL)
    root = replace(robot.links[0], placement=away)
    moved = frames(replace(robot, links=(root, *robot.links[1:])), {'turn': 0.3})
    for name, link in frames(robot, {'turn': 0.3})['links'].items():
        assert moved['links'][name]['pose'] == pytest.approx(link['pose'], abs=1e-14)


def test_every_tree_is_listed_and_the_first_one_has_the_root() -> None:
    robot = tutorial()
    other = Link('other', Placement(Pose((1.0, 0.0, 0.0), (0.0, 0.0, HALF)), MODEL))
    listing = frames(replace(robot, links=(other, *robot.links)), {})
    assert listing['root'] == 'other'
    assert listing['links']['base_footprint']['parent'] is None
    assert listing['links']['base_footprint']['pose'] == pytest.approx(
        [0, 1, 0, ROOT_HALF, 0, 0, -ROOT_HALF])
    world = Link('world', Placement(Pose(), MODEL))
    assert frames(replace(robot, links=(world, *robot.links)), {})['root'] == 'base_footprint'


def test_other_frames_are_listed_only_if_there_are_any() -> None:
    tip = Frame('tip', FrameId('link', 'wheel'), Placement(Pose((0.0, 0.0, 1.0)), FrameId(
        'link', 'wheel')))
    listing = frames(replace(tutorial(), frames=(tip,)), {'turn': 0.5})
    assert listing['frames']['tip']['attached_to'] == 'wheel'
    assert listing['frames']['tip']['pose'][:3] == pytest.approx([0, 2, 0.2])
    assert 'frame tip  on wheel' in text(listing)


def test_a_robot_without_links_and_one_beyond_numbers_are_errors() -> None:
    with pytest.raises(DescriptionError, match='has no links'):
        frames(Robot('none', ()), {})
    far = Pose((1.7e308, 0.0, 0.0))
    robot = Robot('far', (Link('a', Placement(Pose(), MODEL)), Link('b', on('a', far)),
                          Link('c', on('b', far))))
    with pytest.raises(DescriptionError, match='too far away for floating-point'):
        frames(robot, {})


def shifted() -> Robot:
    """Build a robot whose joint is not where its link is, on a root away from the model."""
    return Robot('shifted', (
        Link('base', Placement(Pose((0.0, 1.0, 0.0)), MODEL)),
        Link('arm', Placement(Pose((0.5, 1.0, 0.3)), MODEL))), (
        Joint('hinge', 'revolute', 'base', 'arm', on('arm', Pose((-0.3, 0.0, 0.0))),
              (Axis((0.0, 1.0, 0.0)),)),))


def test_joints_and_links_have_their_own_numbers() -> None:
    for positions in ({}, {'hinge': 0.5}):
        listing = frames(shifted(), positions)
        arm, hinge = listing['links']['arm'], listing['joints']['hinge']
        # As they are written, wherever the joint is.
        assert arm['in_model'] == {'xyz': [0.5, 1.0, 0.3], 'rpy': [0.0, 0.0, 0.0]}
        assert hinge['in_child'] == {'xyz': [-0.3, 0.0, 0.0], 'rpy': [0.0, 0.0, 0.0]}
        assert hinge['in_parent']['xyz'] == pytest.approx([0.2, 0.0, 0.3])
        assert hinge['in_parent']['rpy'] == [0.0, 0.0, 0.0]
        assert hinge['pose'][:3] == pytest.approx([0.2, 0.0, 0.3])
        assert hinge['position'] == [positions.get('hinge', 0.0)]
    assert frames(shifted(), {})['links']['arm']['pose'][:3] == pytest.approx([0.5, 0.0, 0.3])
    assert arm['pose'][:3] == pytest.approx(
        [0.2 + 0.3 * math.cos(0.5), 0.0, 0.3 - 0.3 * math.sin(0.5)])


def test_links_below_a_joint_that_is_not_at_zero_have_moved() -> None:
    def moved(robot: Robot, positions: dict[str, float]) -> list[str]:
        return [name for name, link in frames(robot, positions)['links'].items() if link['moved']]

    tip = Link('tip', Placement(Pose(), FrameId('joint', 'end')))
    robot = replace(tutorial(), links=(*tutorial().links, tip), joints=(
        *tutorial().joints, Joint('end', 'fixed', 'wheel', 'tip', on('wheel'))))
    assert moved(robot, {}) == ['pusher']  # it mimics, with an offset
    assert moved(robot, {'turn': -0.5}) == ['wheel', 'tip']
    assert moved(robot, {'turn': 0.5}) == ['wheel', 'pusher', 'tip']
    assert frames(robot, {'turn': 0.5})['joints']['push']['position'] == [0.5]
    assert frames(movable(type='floating'), {})['joints']['turn']['position'] == [0.0] * 6


def cells(listing: dict[str, Any]) -> list[list[str]]:
    """Split the lines of the text at its columns."""
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


def test_text_is_a_tree_with_aligned_columns() -> None:
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


def test_text_says_what_closes_a_loop() -> None:
    loop = Joint('loop', 'revolute', 'wheel', 'pusher', on('wheel', Pose((0.0, 0.0, 0.1))),
                 (Axis((0.0, 0.0, 1.0)),), is_loop=True)
    robot = tutorial()
    rows = cells(frames(replace(robot, joints=(*robot.joints, loop)), {}))
    assert ['loop to pusher by loop (revolute)', 'wheel', '0 0 0.1', '0 0 0'] in rows
    assert ['- <pose> in SDF', 'pusher', '0 1.1 0', '-1.5708 0 0'] in rows


@pytest.mark.parametrize(('count', 'wanted'), [
    (0, 'robot chain'), (1, 'robot chain at jl1=0.5'),
    (4, 'robot chain at jl1=0.5, jl2=0.5, jl3=0.5, jl4=0.5'),
    (5, 'robot chain at jl1=0.5, jl2=0.5, jl3=0.5, jl4=0.5, ...')])
def test_the_heading_says_the_positions(count: int, wanted: str) -> None:
    positions = {f'jl{index + 1}': 0.5 for index in range(count)}
    assert cells(frames(chain(6), positions))[0][0] == wanted


def chain(count: int) -> Robot:
    names = [f'l{index}' for index in range(count)]
    return Robot('chain', (Link('l0', Placement(Pose(), MODEL)), *(
        Link(name, Placement(Pose(), FrameId('joint', f'j{name}'))) for name in names[1:])),
        tuple(Joint(f'j{child}', 'continuous', parent, child,
                    on(parent, Pose((0.0, 0.0, 0.1), (0.1, 0.0, 0.0))),
                    (Axis((0.0, 0.0, 1.0)),)) for parent, child in pairwise(names)))


def test_a_chain_of_5000_links_is_listed_in_linear_time_and_no_wide_lines() -> None:
    def listed(count: int) -> str:
        return text(frames(chain(count), {}))

    assert robots.is_linear(listed)
    lines = listed(5000).splitlines()
    assert len(lines) == 10000
    assert max(map(len, lines)) < 160
    assert '(4999) link l4999' in lines[-1]
