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

"""Listing of the frames of a robot: keys, poses, positions and errors."""

from __future__ import annotations

from dataclasses import replace
import json
import math
from typing import Any

from listed_robots import HALF, on, shifted, tutorial
from opencv_tools.robot.frames.listing import frames
from opencv_tools.robot.frames.text import text
from opencv_tools.robot.model import (
    Axis, FrameId, Joint, Limit, Link, MODEL, Placement, Robot, RobotFrame)
from opencv_tools.robot.pose import Pose
from opencv_tools.robot.xml.document import DescriptionError
from opencv_tools.robot.xml.report import Report
import pytest
from rows import each_row

ROOT_HALF = math.sqrt(0.5)


def movable(**changes: Any) -> Robot:
    robot = tutorial()
    turn = replace(robot.joints[1], **changes)
    return replace(robot, joints=(robot.joints[0], turn, robot.joints[2]))


def test_keys_of_the_listing() -> None:
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


def test_poses_of_the_tutorial() -> None:
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


def test_joint_axes_and_limits() -> None:
    joints = frames(tutorial(), {})['joints']
    assert joints['turn']['axis'] == pytest.approx([0, 1, 0])
    assert (joints['turn']['lower'], joints['turn']['upper']) == (None, None)
    assert joints['push']['axis'] == [1, 0, 0]
    assert (joints['push']['lower'], joints['push']['upper']) == (-0.5, None)
    assert (joints['base_joint']['axis'], joints['base_joint']['lower']) == (None, None)
    assert (joints['turn']['type'], joints['turn']['parent'], joints['turn']['child']) == (
        'continuous', 'base_link', 'wheel')


def test_limits_of_1e16_are_unlimited() -> None:
    robot = movable(type='revolute', axes=(Axis((0.0, 0.0, 1.0), Limit(-1e16, 1e16)),))
    joint = frames(robot, {})['joints']['turn']
    assert (joint['lower'], joint['upper']) == (None, None)


def test_moved_links_and_mimic_joints() -> None:
    listing = frames(tutorial(), {'turn': HALF})
    assert listing['links']['wheel']['pose'] == pytest.approx(
        [0, 1, 0.2, 0.5, -0.5, 0.5, 0.5])
    assert listing['joints']['turn']['pose'] == listing['links']['wheel']['pose']
    assert listing['joints']['turn']['axis'] == pytest.approx([0, 1, 0])
    assert listing['links']['pusher']['pose'][0] == pytest.approx(HALF / 2 + 0.25)
    assert listing['links']['base_link'] == frames(tutorial(), {})['links']['base_link']


def test_first_axis_of_a_universal_joint() -> None:
    links = tuple(Link(name=name, placement=Placement(Pose(), MODEL)) for name in 'ab')
    robot = Robot(name='two', links=links,
                  joints=(Joint(name='j', type='universal', parent='a', child='b',
                                placement=on('b', Pose(rpy=(0.0, 0.0, HALF))),
                                axes=(Axis((1.0, 0.0, 0.0)), Axis((0.0, 1.0, 0.0)))),))
    assert frames(robot, {})['joints']['j']['axis'] == pytest.approx([0, 1, 0])


@each_row(('position', 'message'), [
    ({'nothing': 1.0}, "joint 'nothing' does not exist; the movable joints are 'turn'$"),
    ({'base_joint': 1.0}, "joint 'base_joint' is fixed, not of one degree of freedom; .*'turn'"),
    ({'push': 1.0}, "joint 'push' mimics 'turn'; move 'turn' instead"),
    ({'turn': math.nan}, "position of 'turn' is nan"),
    ({'turn': math.inf}, "position of 'turn' is inf"),
])
def test_impossible_position_errors(position: dict[str, float], message: str) -> None:
    with pytest.raises(DescriptionError, match=message):
        frames(tutorial(), position)


def test_position_of_a_floating_joint_error() -> None:
    with pytest.raises(DescriptionError, match=r"'turn' is floating, .*; the robot has no joint "
                       r"of one degree of freedom; its joints are 'base_joint', 'turn', 'push'$"):
        frames(movable(type='floating'), {'turn': 1.0})


@pytest.mark.parametrize(('count', 'message'), [
    (1, 'the robot has no movable joint$'),
    (2, "the robot has no movable joint; its joints are 'base_joint'$")])
def test_error_text_without_movable_joints(count: int, message: str) -> None:
    robot = replace(tutorial(), links=tutorial().links[:count],
                    joints=tutorial().joints[:count - 1])
    with pytest.raises(DescriptionError, match=f"joint 'arm' does not exist; {message}"):
        frames(robot, {'arm': 0.5})


def test_warning_for_a_position_outside_the_limits() -> None:
    robot = movable(type='revolute', axes=(Axis((0.0, 0.0, 1.0), Limit(-1.0, 1.0)),))
    report = Report()
    frames(robot, {'turn': 1.0}, report)
    assert report.warnings == []
    assert frames(robot, {'turn': 1.5}, report) == frames(robot, {'turn': 1.5})
    note, = report.warnings
    assert (note.name, note.message) == ('turn', 'position 1.5 is outside the limits -1 to 1')


def test_poses_relative_to_the_root_link() -> None:
    robot = tutorial()
    away = Placement(Pose((7.0, 8.0, 9.0), (1.0, 2.0, 3.0)), MODEL)
    root = replace(robot.links[0], placement=away)
    moved = frames(replace(robot, links=(root, *robot.links[1:])), {'turn': 0.3})
    for name, link in frames(robot, {'turn': 0.3})['links'].items():
        assert moved['links'][name]['pose'] == pytest.approx(link['pose'], abs=1e-14)


def test_several_trees() -> None:
    robot = tutorial()
    other = Link(name='other', placement=Placement(Pose((1.0, 0.0, 0.0), (0.0, 0.0, HALF)), MODEL))
    listing = frames(replace(robot, links=(other, *robot.links)), {})
    assert listing['root'] == 'other'
    assert listing['links']['base_footprint']['parent'] is None
    assert listing['links']['base_footprint']['pose'] == pytest.approx(
        [0, 1, 0, ROOT_HALF, 0, 0, -ROOT_HALF])
    world = Link(name='world', placement=Placement(Pose(), MODEL))
    assert frames(replace(robot, links=(world, *robot.links)), {})['root'] == 'base_footprint'


def test_additional_frames() -> None:
    tip = RobotFrame(name='tip', attached_to=FrameId('link', 'wheel'),
                     placement=Placement(Pose((0.0, 0.0, 1.0)), FrameId('link', 'wheel')))
    listing = frames(replace(tutorial(), frames=(tip,)), {'turn': 0.5})
    assert listing['frames']['tip']['attached_to'] == 'wheel'
    assert listing['frames']['tip']['pose'][:3] == pytest.approx([0, 2, 0.2])
    assert 'frame tip  on wheel' in text(listing)


def test_errors_without_links_and_with_infinite_poses() -> None:
    with pytest.raises(DescriptionError, match='has no links'):
        frames(Robot(name='none', links=()), {})
    far = Pose((1.7e308, 0.0, 0.0))
    robot = Robot(name='far',
                  links=(Link(name='a', placement=Placement(Pose(), MODEL)),
                         Link(name='b', placement=on('a', far)),
                         Link(name='c', placement=on('b', far))))
    with pytest.raises(DescriptionError, match='too far away for floating-point'):
        frames(robot, {})


def test_poses_at_zero_and_at_a_position() -> None:
    for positions in ({}, {'hinge': 0.5}):
        listing = frames(shifted(), positions)
        arm, hinge = listing['links']['arm'], listing['joints']['hinge']
        # These numbers are those of the file at any position.
        assert arm['in_model'] == {'xyz': [0.5, 1.0, 0.3], 'rpy': [0.0, 0.0, 0.0]}
        assert hinge['in_child'] == {'xyz': [-0.3, 0.0, 0.0], 'rpy': [0.0, 0.0, 0.0]}
        assert hinge['in_parent']['xyz'] == pytest.approx([0.2, 0.0, 0.3])
        assert hinge['in_parent']['rpy'] == [0.0, 0.0, 0.0]
        assert hinge['pose'][:3] == pytest.approx([0.2, 0.0, 0.3])
        assert hinge['position'] == [positions.get('hinge', 0.0)]
    assert frames(shifted(), {})['links']['arm']['pose'][:3] == pytest.approx([0.5, 0.0, 0.3])
    assert arm['pose'][:3] == pytest.approx(
        [0.2 + 0.3 * math.cos(0.5), 0.0, 0.3 - 0.3 * math.sin(0.5)])


def test_moved_links() -> None:
    def moved(robot: Robot, positions: dict[str, float]) -> list[str]:
        return [name for name, link in frames(robot, positions)['links'].items() if link['moved']]

    tip = Link(name='tip', placement=Placement(Pose(), FrameId('joint', 'end')))
    robot = replace(tutorial(), links=(*tutorial().links, tip), joints=(
        *tutorial().joints, Joint(name='end', type='fixed', parent='wheel', child='tip',
                                  placement=on('wheel'))))
    assert moved(robot, {}) == ['pusher']  # it mimics, with an offset
    assert moved(robot, {'turn': -0.5}) == ['wheel', 'tip']
    assert moved(robot, {'turn': 0.5}) == ['wheel', 'pusher', 'tip']
    assert frames(robot, {'turn': 0.5})['joints']['push']['position'] == [0.5]
    assert frames(movable(type='floating'), {})['joints']['turn']['position'] == [0.0] * 6
