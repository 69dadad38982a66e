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

from collections.abc import Sequence
from dataclasses import replace
from graphlib import CycleError
import math

from opencv_tools.robot.joint_kinds import JOINT_KINDS
from opencv_tools.robot.kinematics import (
    attached_links, check_mimic_cycles, cycle_text, joint_transform, Kinematics, plane,
    resolve_chain, with_mimics)
from opencv_tools.robot.model import (
    Axis, FrameId, Joint, Link, Mimic, MODEL, Placement, Robot, RobotFrame)
from opencv_tools.robot.pose import IDENTITY, Pose, Transform, Vector
from opencv_tools.robot.xml.document import DescriptionError
import pytest
import robots
from rows import each_row

ODD = Pose((0.1, 1 / 3, -0.7), (0.1, 0.2, 0.3))
X, Y, Z = (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)


def link_id(name: str) -> FrameId:
    return FrameId('link', name)


def joint_id(name: str) -> FrameId:
    return FrameId('joint', name)


def joint(name: str, parent: str, child: str, *, type_: str = 'continuous', pose: Pose = ODD,
          xyz: Vector = Z, mimic: Mimic | None = None, is_loop: bool = False) -> Joint:
    return Joint(name=name, type=type_, parent=parent, child=child,
                 placement=Placement(pose, link_id(parent)), axes=(Axis(xyz, mimic=mimic),),
                 is_loop=is_loop)


def chain(joints: Sequence[Joint]) -> Robot:
    """Create a robot with placements of URDF from joints to different child links."""
    return Robot(name='chain', links=(Link(name='base', placement=Placement(Pose(), MODEL)), *(
        Link(name=one.child, placement=Placement(Pose(), joint_id(one.name))) for one in joints
        if not one.is_loop)), joints=tuple(joints))


def check_transform(found: Transform, expected: Pose) -> None:
    assert found.pose().xyz == pytest.approx(expected.xyz, abs=1e-15)
    assert found.pose().rpy == pytest.approx(expected.rpy, abs=1e-15)


def followers(*mimics: tuple[str, Mimic | None]) -> Robot:
    return chain([joint(name, 'base', f'{name}_link', mimic=mimic) for name, mimic in mimics])


def test_urdf_poses_keep_their_numbers() -> None:
    robot = chain([joint('one', 'base', 'a'),
                   joint('two', 'a', 'b', pose=Pose((1e-17, 2.0, 0.0)))])
    kinematics = Kinematics(robot)
    assert kinematics.between(link_id('base'), joint_id('one')) == ODD
    assert kinematics.between(link_id('base'), link_id('a')) == ODD
    assert kinematics.between(link_id('a'), link_id('b')) == Pose((1e-17, 2.0, 0.0))
    assert kinematics.between(joint_id('one'), link_id('a')) == Pose()
    assert kinematics.within(joint_id('one'), Placement(ODD, link_id('a'))) == ODD


def test_sdf_poses_keep_their_numbers() -> None:
    robot = Robot(name='sdf',
                  links=(Link(name='a', placement=Placement(Pose(), MODEL)),
                         Link(name='b', placement=Placement(ODD, MODEL))),
                  joints=(Joint(name='j', type='fixed', parent='a', child='b',
                                placement=Placement(Pose(), link_id('b'))),))
    kinematics = Kinematics(robot)
    assert kinematics.between(link_id('a'), joint_id('j')) == ODD
    assert kinematics.between(MODEL, link_id('b')) == ODD
    assert kinematics.between(link_id('a'), MODEL) == Pose()


def test_pose_between_two_links_of_the_model() -> None:
    robot = Robot(name='sdf',
                  links=(Link(name='a', placement=Placement(Pose((1.0, 0.0, 0.0)), MODEL)),
                         Link(name='b', placement=Placement(Pose((1.0, 2.0, 0.0)), MODEL))))
    assert Kinematics(robot).between(link_id('a'), link_id('b')) == Pose((0.0, 2.0, 0.0))


@pytest.mark.parametrize('pose', [Pose(), ODD])
def test_placement_cycle_error(pose: Pose) -> None:
    robot = Robot(name='circle',
                  links=(Link(name='a', placement=Placement(pose, link_id('b'))),
                         Link(name='b', placement=Placement(pose, link_id('a')))), source='file')
    with pytest.raises(DescriptionError, match=r"^file: placement cycle: 'a' -> 'b' -> 'a'$"):
        Kinematics(robot).pose(link_id('a'))
    with pytest.raises(DescriptionError, match='placement cycle: '):
        Kinematics(robot).between(MODEL, link_id('a'))


def test_missing_frame_error() -> None:
    robot = Robot(name='lost',
                  links=(Link(name='a', placement=Placement(ODD, FrameId('frame', 'nowhere'))),))
    for frame in (link_id('a'), FrameId('joint', 'nothing')):
        with pytest.raises(DescriptionError, match=r"^(frame|joint) 'no\w+' does not exist"):
            Kinematics(robot).pose(frame)


@pytest.mark.thorough
def test_linear_time_for_a_chain_of_5000_links() -> None:
    def check(count: int) -> None:
        pose = Pose((0.0, 0.0, 0.001))
        kinematics = Kinematics(chain([
            joint(f'j{index}', f'l{index}' if index else 'base', f'l{index + 1}', pose=pose)
            for index in range(count)]))
        last = link_id(f'l{count}')
        assert kinematics.pose(last).translation[2] == pytest.approx(count / 1000)
        assert kinematics.forward({'j0': (0.5,)})[last].pose().rpy == pytest.approx((0, 0, 0.5))
        assert kinematics.subtree(kinematics.roots)[-1] == last.name

    check(5000)
    assert robots.is_linear(check)


@each_row(('type_', 'position', 'expected'), [
    ('fixed', (), Pose()),
    ('revolute', (0.5,), Pose(rpy=(0.0, 0.0, 0.5))),
    ('continuous', (4.0,), Pose(rpy=(0.0, 0.0, 4.0 - 2 * math.pi))),
    ('screw', (0.5,), Pose(rpy=(0.0, 0.0, 0.5))),
    ('prismatic', (-0.25,), Pose((0.0, 0.0, -0.25))),
    ('ball', (0.1, 0.2, 0.3), Pose(rpy=(0.1, 0.2, 0.3))),
    ('floating', (1.0, 2.0, 3.0, 0.1, 0.2, 0.3), Pose((1.0, 2.0, 3.0), (0.1, 0.2, 0.3))),
    ('universal', (0.25, 0.5), Pose(rpy=(0.0, 0.0, 0.75))),
    ('revolute2', (0.25, -0.25), Pose()),
    ('gearbox', (0.25, 0.5), Pose(rpy=(0.0, 0.0, 0.75))),
])
@each_row('length', [1.0, 7.0])
def test_joint_transforms_with_axes_of_any_length(
        type_: str, position: tuple[float, ...], expected: Pose, length: float) -> None:
    moved = joint('j', 'a', 'b', type_=type_, xyz=(0.0, 0.0, length))
    found = joint_transform(moved, position).pose()
    assert found.xyz == pytest.approx(expected.xyz)
    assert found.rpy == pytest.approx(expected.rpy)


def test_planar_motion_across_the_normal() -> None:
    for xyz in (Z, (1.0, 0.0, 0.0), (0.0, -2.0, 0.0), (1.0, 1.0, 1.0), (0.5, 0.5, 0.5)):
        planar = joint('j', 'a', 'b', type_='planar', xyz=xyz)
        one, other = (joint_transform(planar, position).translation
                      for position in ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0)))
        assert math.hypot(*one) == pytest.approx(1)
        assert math.hypot(*other) == pytest.approx(1)
        for first, second in ((one, other), (one, xyz), (other, xyz)):
            assert sum(a * b for a, b in zip(first, second)) == pytest.approx(0, abs=1e-15)
        assert joint_transform(planar, (0.0, 0.0, 1.0)).rotate(xyz) == pytest.approx(xyz)


def test_plane_independent_of_the_length_of_its_normal() -> None:
    for xyz in ((0.5, 0.5, math.sqrt(0.5)), (0.6, 0.8, 0.0), (0.5, math.sqrt(0.75), 0.0)):
        written = joint('j', 'a', 'b', type_='planar', xyz=xyz)
        for length in (1 - 1e-15, 1 + 1e-15, 3.0):
            x, y, z = (value * length for value in xyz)
            scaled = joint('j', 'a', 'b', type_='planar', xyz=(x, y, z))
            assert joint_transform(scaled, (1.0, 0.0, 0.0)).translation == pytest.approx(
                joint_transform(written, (1.0, 0.0, 0.0)).translation)


@each_row('type_', JOINT_KINDS)
def test_zero_position_by_default(type_: str) -> None:
    one = joint('j', 'base', 'a', type_=type_)
    assert joint_transform(one, ()) == IDENTITY
    zero = joint_transform(one, (0.0,) * one.kind.dof)
    assert zero.pose().is_identity
    poses = Kinematics(chain([one])).forward({})
    assert poses[link_id('a')].pose().xyz == ODD.xyz


def test_motion_of_all_descendant_links() -> None:
    robot = chain([joint('one', 'base', 'a', pose=Pose((1.0, 0.0, 0.0))),
                   joint('two', 'a', 'b', pose=Pose((1.0, 0.0, 0.0)), type_='prismatic')])
    poses = Kinematics(robot).forward({'one': (math.pi / 2,), 'two': (0.5,)})
    assert poses[link_id('b')].translation == pytest.approx((1.0, 1.0, 0.5))
    assert poses[joint_id('two')] == poses[link_id('b')]


def test_poses_of_several_root_links() -> None:
    robot = Robot(name='two',
                  links=(Link(name='a', placement=Placement(Pose(), MODEL)),
                         Link(name='b', placement=Placement(ODD, MODEL))))
    kinematics = Kinematics(robot)
    assert kinematics.roots == ['a', 'b']
    assert kinematics.forward({})[link_id('b')] == ODD.transform()


def test_loop_joint_moving_with_its_child() -> None:
    step = Pose((1.0, 0.0, 0.0))
    robot = chain([joint('one', 'base', 'a', pose=step), joint('two', 'base', 'b', pose=step),
                   joint('loop', 'a', 'b', pose=step, is_loop=True)])
    kinematics = Kinematics(robot)
    poses = kinematics.forward({'two': (math.pi / 2,)})
    assert poses[joint_id('loop')].translation == pytest.approx((1.0, 1.0, 0.0))
    assert poses[joint_id('loop')].pose().rpy == pytest.approx((0, 0, math.pi / 2))
    assert kinematics.parent_joint['b'].name == 'two'


def test_frames_moving_with_their_attached_link() -> None:
    robot = chain([joint('one', 'base', 'a', pose=Pose((1.0, 0.0, 0.0)))])
    tip = Placement(Pose((2.0, 0.0, 0.0)), link_id('base'))
    frames = tuple(RobotFrame(name=name, attached_to=attached_to,
                              placement=tip) for name, attached_to in (
        ('on_frame', FrameId('frame', 'on_link')), ('on_link', link_id('a')),
        ('on_joint', joint_id('one')), ('on_model', MODEL)))
    robot = Robot(name='frames', links=robot.links, joints=robot.joints, frames=frames)
    poses = Kinematics(robot).forward({'one': (math.pi / 2,)})
    for name in ('on_link', 'on_joint', 'on_frame'):
        assert poses[FrameId('frame', name)].translation == pytest.approx((1.0, 1.0, 0.0))
    assert poses[FrameId('frame', 'on_model')].translation == (2.0, 0.0, 0.0)


def test_attachment_cycle_and_missing_link_errors() -> None:
    links = (Link(name='base', placement=Placement(Pose(), MODEL)),)
    for target, message in (('b', "attachment cycle: 'a' -> 'b' -> 'a'"),
                            ('c', "frame 'c', which does not exist")):
        robot = Robot(name='circle', links=links, joints=(),
                      frames=tuple(RobotFrame(name=name, attached_to=FrameId('frame', other),
                                              placement=Placement(Pose(), MODEL))
                                   for name, other in (('a', target), ('b', 'a'))))
        with pytest.raises(DescriptionError, match=message):
            Kinematics(robot).forward({})


def test_mimic_position_overriding_a_given_position() -> None:
    robot = followers(('lead', None), ('half', Mimic('lead', 0.5, 0.1)))
    assert with_mimics(robot, {'lead': (2.0,), 'half': (9.0,)}) == {
        'lead': (2.0,), 'half': (1.1,)}
    assert with_mimics(robot, {})['half'] == (0.1,)


def test_mimic_of_a_mimic_in_any_order() -> None:
    robot = followers(('third', Mimic('second', 2.0)), ('second', Mimic('lead', -1.0, 1.0)),
                      ('lead', None))
    assert with_mimics(robot, {'lead': (3.0,)}) == {
        'lead': (3.0,), 'second': (-2.0,), 'third': (-4.0,)}


def test_mimic_cycle_error() -> None:
    robot = followers(('outside', Mimic('a')), ('a', Mimic('b')), ('b', Mimic('a')))
    with pytest.raises(DescriptionError, match=r"<joint>: mimic cycle: 'a' -> 'b' -> 'a'$"):
        with_mimics(robot, {})
    with pytest.raises(DescriptionError, match=r"mimic cycle: 'a' -> 'a'$"):
        with_mimics(followers(('a', Mimic('a'))), {})


def test_mimic_of_either_axis_of_a_universal_joint() -> None:
    lead = joint('lead', 'base', 'a')
    for mimicking, expected in ((0, (4.0, 0.5)), (1, (0.25, 4.0))):
        axes = tuple(Axis(Z, mimic=Mimic('lead', 2.0) if index == mimicking else None)
                     for index in range(2))
        both = Joint(name='both', type='universal', parent='base', child='b',
                     placement=Placement(ODD, link_id('base')), axes=axes)
        robot = chain([lead, both])
        positions = with_mimics(robot, {'lead': (2.0,), 'both': (0.25, 0.5)})
        assert positions['both'] == expected
        assert link_id('b') in Kinematics(robot).forward(with_mimics(robot, {'lead': (2.0,)}))


def test_linear_time_for_a_long_chain_of_mimics() -> None:
    def check(count: int) -> None:
        robot = followers(*((f'j{index}', Mimic(f'j{index + 1}', 1.0, 1.0))
                            for index in range(count)), (f'j{count}', None))
        assert with_mimics(robot, {})['j0'] == (float(count),)

    check(5000)
    assert robots.is_linear(check)


def test_chain_of_nodes() -> None:
    following = {1: 2, 2: 3, 4: 5, 5: 6, 6: 5, 7: 7}
    assert resolve_chain(1, following.get) == [1, 2, 3]
    assert resolve_chain(3, following.get) == [3]
    for start, cycle in ((4, [5, 6, 5]), (6, [6, 5, 6]), (7, [7, 7])):
        with pytest.raises(CycleError) as caught:
            resolve_chain(start, following.get)
        assert caught.value.args[1] == cycle


def test_text_of_a_long_cycle() -> None:
    short, long = [*'abcdefa'], [*'abcdefga']
    assert cycle_text(CycleError('', short)) == (
        "'a' -> 'b' -> 'c' -> 'd' -> 'e' -> 'f' -> 'a'")
    assert cycle_text(CycleError('', long)) == (
        "'a' -> 'b' -> 'c' -> 'd' -> 'e' -> ... -> 'a'")
    assert cycle_text(CycleError('', [joint_id('a'), link_id('b')])) == "'a' -> 'b'"


def test_frames_of_links_in_urdf() -> None:
    kinematics = Kinematics(chain([
        joint('one', 'base', 'a'), joint('loop', 'a', 'base', is_loop=True)]))
    assert kinematics.urdf_frame('a') == joint_id('one')
    assert kinematics.urdf_frame('base') == link_id('base')


def test_order_of_descendant_links() -> None:
    robot = chain([joint('1', 'base', 'a'), joint('2', 'a', 'c'), joint('3', 'base', 'b'),
                   joint('4', 'c', 'd'), joint('5', 'b', 'e')])
    kinematics = Kinematics(robot)
    assert kinematics.roots == ['base']
    assert kinematics.subtree(['base']) == ['base', 'a', 'b', 'c', 'e', 'd']
    assert kinematics.subtree(('c', 'b')) == ['c', 'b', 'd', 'e']
    assert kinematics.subtree([]) == []
    assert [one.name for one in kinematics.child_joints['base']] == ['1', '3']


def test_placement_on_a_frame_that_is_placed_itself() -> None:
    away, further = Pose((1.0, 0.0, 0.0)), Pose((0.0, 2.0, 0.0))
    kinematics = Kinematics(Robot(name='two', links=(
        Link(name='a', placement=Placement(away, MODEL)),
        Link(name='b', placement=Placement(further, link_id('a'))))))
    assert kinematics.within(MODEL, Placement(away, link_id('a'))) == Pose((2.0, 0.0, 0.0))
    assert kinematics.within(MODEL, Placement(Pose(), link_id('b'))) == Pose((1.0, 2.0, 0.0))
    assert kinematics.between(link_id('b'), MODEL) == Pose((-1.0, -2.0, 0.0))
    assert kinematics.between(link_id('b'), link_id('a')) == Pose((0.0, -2.0, 0.0))
    assert kinematics.placement_pose(Placement(further, link_id('b'))).translation == (
        1.0, 4.0, 0.0)
    assert kinematics.pose(MODEL) == IDENTITY


def test_errors_of_missing_frames() -> None:
    robot = Robot(name='lost', source='file', links=(
        Link(name='a', placement=Placement(Pose(), FrameId('frame', 'nowhere'))),))
    message = "file: frame 'nowhere' does not exist, but a placement is relative to it"
    for ask in (Kinematics(robot).pose, lambda frame: Kinematics(robot).between(MODEL, frame)):
        with pytest.raises(DescriptionError) as caught:
            ask(link_id('a'))
        assert str(caught.value) == message


def test_joints_about_two_axes_and_along_two() -> None:
    axes = Axis(Z), Axis(X)
    universal = replace(joint('j', 'a', 'b', type_='universal'), axes=axes)
    check_transform(joint_transform(universal, (math.pi / 2, 0.25)),
                    Pose(rpy=(0.25, 0.0, math.pi / 2)))
    one_axis = joint('j', 'a', 'b', type_='universal', xyz=Y)
    check_transform(joint_transform(one_axis, (0.25, 0.5)), Pose(rpy=(0.0, 0.75, 0.0)))
    planar = joint('j', 'a', 'b', type_='planar', xyz=Z)
    check_transform(joint_transform(planar, (2.0, 3.0, 0.5)),
                    Pose((-3.0, 2.0, 0.0), (0.0, 0.0, 0.5)))


@pytest.mark.parametrize(('type_', 'position', 'expected'), [
    ('revolute', (0.5,), Pose(rpy=(0.0, 0.0, 0.5))), ('prismatic', (0.5,), Pose((0.0, 0.0, 0.5))),
    ('universal', (0.25, 0.5), Pose(rpy=(0.0, 0.0, 0.75)))])
def test_joint_without_an_axis(type_: str, position: tuple[float, ...], expected: Pose) -> None:
    check_transform(joint_transform(
        replace(joint('j', 'a', 'b', type_=type_), axes=()), position), expected)


def test_directions_across_a_normal() -> None:
    assert plane(Z) == ((0.0, 1.0, 0.0), (-1.0, 0.0, 0.0))
    assert plane(X) == ((0.0, 0.0, 1.0), (0.0, -1.0, 0.0))
    assert plane((0.0, -3.0, 0.0)) == ((0.0, 0.0, 1.0), (-1.0, 0.0, 0.0))
    for x, is_across_x in ((0.549, True), (-0.549, True), (0.55, False), (-0.55, False)):
        y, z = 0.5, math.sqrt(0.75 - x * x)
        first, second = plane((x, y, z))
        assert (first[0] == 0, first[1] == 0) == (is_across_x, not is_across_x)
        cross = (y * first[2] - z * first[1], z * first[0] - x * first[2],
                 x * first[1] - y * first[0])
        assert second == pytest.approx(cross)


def test_frames_of_the_model_and_its_canonical_link() -> None:
    world = Link(name='world', placement=Placement(Pose(), MODEL))
    links = (world, Link(name='a', placement=Placement(Pose(), MODEL)),
             Link(name='b', placement=Placement(Pose(), MODEL)))
    frame = RobotFrame(name='f', attached_to=MODEL, placement=Placement(Pose(), MODEL))
    robot = Robot(name='r', links=links, frames=(frame,))
    for one, link in ((robot, 'a'), (replace(robot, canonical_link='b'), 'b'),
                      (replace(robot, links=(world,)), 'world')):
        assert attached_links(one) == {FrameId('frame', 'f'): link_id(link)}
    assert attached_links(Robot(name='r', links=())) == {}


def test_links_of_attached_frames() -> None:
    def frame(name: str, attached_to: FrameId) -> RobotFrame:
        return RobotFrame(name=name, attached_to=attached_to, placement=Placement(Pose(), MODEL))

    robot = chain([joint('one', 'base', 'a')])
    first, second = FrameId('frame', 'first'), FrameId('frame', 'second')
    third = FrameId('frame', 'third')
    assert attached_links(replace(robot, frames=(
        frame('first', second), frame('second', joint_id('one')), frame('third', first)))) == {
            first: link_id('a'), second: link_id('a'), third: link_id('a')}
    for target, text in ((link_id('x'), "link 'x'"), (joint_id('base'), "joint 'base'"),
                         (FrameId('frame', 'a'), "frame 'a'")):
        with pytest.raises(DescriptionError) as caught:
            attached_links(replace(robot, frames=(frame('f', target),), source='file'))
        assert str(caught.value) == (
            f"file: frame 'f' is attached to {text}, which does not exist")


def test_order_of_joints_that_mimic() -> None:
    robot = followers(('third', Mimic('second')), ('second', Mimic('lead')), ('lead', None))
    names = [one.name for one in check_mimic_cycles(robot)]
    assert names == ['lead', 'second', 'third']


def test_error_of_a_cycle_of_three_mimics() -> None:
    robot = followers(('a', Mimic('b')), ('b', Mimic('c')), ('c', Mimic('a')))
    lines = {'a': 10, 'b': 20, 'c': 30}
    robot = replace(robot, source='file', joints=tuple(
        replace(one, line=lines[one.name]) for one in robot.joints))
    with pytest.raises(DescriptionError) as caught:
        check_mimic_cycles(robot)
    name = str(caught.value).split("'")[1]
    circle = ' -> '.join(repr('abcabc'['abc'.index(name) + step]) for step in (0, 1, 2, 0))
    assert str(caught.value) == f'file:{lines[name]}: <joint>: mimic cycle: {circle}'


def test_mimic_of_a_joint_outside_the_robot() -> None:
    robot = followers(('a', Mimic('elsewhere', 3.0, 0.5)))
    assert with_mimics(robot, {'elsewhere': (2.0, 7.0)})['a'] == (6.5,)
    assert with_mimics(robot, {'elsewhere': ()}) == {'elsewhere': (), 'a': (0.5,)}
    assert with_mimics(robot, {}) == {'a': (0.5,)}


def test_numbers_that_a_mimic_does_not_change() -> None:
    robot = chain([joint('lead', 'base', 'a'),
                   joint('flat', 'a', 'b', type_='planar', mimic=Mimic('lead', 2.0)),
                   joint('rigid', 'b', 'c', type_='fixed', mimic=Mimic('lead', 2.0))])
    assert with_mimics(robot, {'lead': (0.5,), 'flat': (9.0, 8.0)}) == {
        'lead': (0.5,), 'flat': (1.0, 8.0, 0.0), 'rigid': ()}
    assert with_mimics(robot, {})['flat'] == (0.0, 0.0, 0.0)
