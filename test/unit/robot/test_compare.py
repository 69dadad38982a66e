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
import math
from typing import Any

from lxml import etree
from opencv_tools.robot.compare.compare import Difference, differences
from opencv_tools.robot.compare.table import table
from opencv_tools.robot.geometry import Box, Cylinder, Material, Mesh, Sphere
from opencv_tools.robot.model import (
    Axis, Dynamics, Extension, Frame, FrameId, Inertial, Joint, Limit, Link, Mimic, MODEL,
    Placement, Robot, Shape)
from opencv_tools.robot.pose import Pose, Vector
from opencv_tools.robot.xml.document import DescriptionError
import pytest
import robots

HALF = math.pi / 2
RED = (1.0, 0.0, 0.0, 1.0)


def on(link: str, pose: Pose = Pose()) -> Placement:  # noqa: B008
    return Placement(pose, FrameId('link', link))


def shape(link: str, name: str = '', **changes: Any) -> Shape:
    return replace(Shape(name, on(link, Pose((0.1, 0.0, 0.0))), Box((1.0, 2.0, 3.0))), **changes)


def urdf() -> Robot:
    """Build an arm as URDF places it, with one of everything."""
    arm = Link('arm', Placement(Pose(), FrameId('joint', 'turn')),
               Inertial(on('arm', Pose((0.0, 0.0, 0.5), (0.0, 0.0, HALF))), 2.0,
                        (1.0, 0.0, 0.0, 2.0, 0.0, 3.0)),
               (shape('arm', material=Material('red', RED)),), (shape('arm'),))
    return Robot('robot', (
        Link('base', Placement(Pose(), MODEL)), arm,
        Link('hand', Placement(Pose(), FrameId('joint', 'slide')))), (
        Joint('turn', 'revolute', 'base', 'arm', on('base', Pose((1.0, 0.0, 0.0), (HALF, 0, 0))), (
            Axis((0.0, 0.0, 2.0), Limit(-1.0, 2.0, 3.0, 4.0), Dynamics(0.5, 0.25)),)),
        Joint('slide', 'prismatic', 'arm', 'hand', on('arm', Pose((0.0, 0.0, 1.0))), (
            Axis((1.0, 0.0, 0.0), Limit(0.0, 0.5), mimic=Mimic('turn', 0.1, 0.2)),))))


def sdf() -> Robot:
    """Build the same arm as SDF places it: all in the model, and elsewhere in the world."""
    robot = urdf()
    base = Pose((5.0, 0.0, 0.0))
    poses = {'base': base, 'arm': Pose((6.0, 0.0, 0.0), (HALF, 0.0, 0.0)),
             'hand': Pose((6.0, -1.0, 0.0), (HALF, 0.0, 0.0))}
    links = tuple(replace(link, placement=Placement(poses[link.name], MODEL))
                  for link in robot.links)
    return replace(robot, links=links, joints=tuple(
        replace(joint, placement=on(joint.child)) for joint in robot.joints))


def absent(element: str, name: str) -> Difference:
    return Difference(element=element, name=name, property='presence', a='yes', b='no')


def with_link(robot: Robot, name: str, **changes: Any) -> Robot:
    return replace(robot, links=tuple(replace(link, **changes) if link.name == name else link
                                      for link in robot.links))


def with_joint(robot: Robot, which: str, **changes: Any) -> Robot:
    return replace(robot, joints=tuple(replace(joint, **changes) if joint.name == which else joint
                                       for joint in robot.joints))


def with_axis(robot: Robot, name: str, **changes: Any) -> Robot:
    joint = next(joint for joint in robot.joints if joint.name == name)
    return with_joint(robot, name, axes=(replace(joint.axes[0], **changes),))


def with_visual(robot: Robot, **changes: Any) -> Robot:
    visual, = robot.links[1].visuals
    return with_link(robot, 'arm', visuals=(replace(visual, **changes),))


def told(a: Robot, b: Robot, **options: Any) -> list[tuple[str, str, str]]:
    """Give what is told, the same whichever of both robots is the first."""
    found, other_way = (
        [(one.element, one.name, one.property) for one in differences(*both, **options)]
        for both in ((a, b), (b, a)))
    assert sorted(found) == sorted(other_way)
    return found


def test_a_robot_is_the_same_as_itself_however_it_is_placed() -> None:
    assert differences(urdf(), urdf(), tolerance=0.0) == []
    assert differences(urdf(), sdf(), tolerance=1e-12) == []
    assert differences(sdf(), urdf(), tolerance=1e-12) == []


@pytest.mark.parametrize(('name', 'changes', 'what'), [
    ('turn', {'limit': Limit(-1.0, 2.1, 3.0, 4.0)}, ['upper']),
    ('turn', {'limit': Limit(-1.1, 2.0, 3.0, 4.0)}, ['lower']),
    ('turn', {'limit': Limit(-1.0, 2.0, 3.1, math.inf)}, ['effort', 'velocity']),
    ('turn', {'limit': None}, ['type', 'lower', 'upper', 'effort', 'velocity']),
    ('turn', {'dynamics': None}, ['damping', 'friction']),
    ('turn', {'dynamics': Dynamics(0.5)}, ['friction']),
    ('turn', {'mimic': Mimic('other')}, ['mimics', 'multiplier', 'offset']),
    ('slide', {'mimic': Mimic('turn', 0.1, 0.3)}, ['offset']),
    ('slide', {'mimic': Mimic('turn', 0.2, 0.2)}, ['multiplier']),
])
def test_what_a_joint_says_is_compared(name: str, changes: dict[str, Any], what: list[str]
                                       ) -> None:
    found = told(urdf(), with_axis(sdf(), name, **changes), samples=0)
    assert sorted(found) == sorted(('joint', name, one) for one in what)


def test_an_axis_is_compared_in_space_and_by_its_direction() -> None:
    assert told(urdf(), with_axis(sdf(), 'turn', xyz=(0.0, 0.0, 1e-9))) == []
    other = with_axis(sdf(), 'turn', xyz=(0.0, 1e-6, 1.0))
    assert told(urdf(), other, samples=0) == [('joint', 'turn', 'axis')]
    assert ('link', 'hand', 'pose at random positions') in told(urdf(), other)
    flipped = with_axis(sdf(), 'turn', xyz=(0.0, 0.0, -1.0))
    assert ('joint', 'turn', 'axis') in told(urdf(), flipped)


def test_a_revolute_without_limits_is_a_continuous() -> None:
    endless = with_axis(urdf(), 'turn', limit=Limit(-1e16, math.inf, 3.0, 4.0))
    continuous = with_axis(with_joint(sdf(), 'turn', type='continuous'), 'turn',
                           limit=Limit(effort=3.0, velocity=4.0))
    assert told(endless, continuous) == []


def test_negative_effort_is_no_limit() -> None:
    negative, endless = (with_axis(urdf(), 'slide', limit=Limit(0.0, 1.0, *limits)) for limits in (
        (-1.0, -2.5), (math.inf, 1e17)))
    assert told(negative, endless) == []
    limited = with_axis(urdf(), 'slide', limit=Limit(0.0, 1.0, 1.0, 2.5))
    assert told(negative, limited) == [
        ('joint', 'slide', 'effort'), ('joint', 'slide', 'velocity')]


def test_the_axes_of_fixed_joints_mean_nothing() -> None:
    fixed = with_joint(urdf(), 'turn', type='fixed')
    assert told(fixed, with_joint(sdf(), 'turn', type='fixed', axes=())) == []


def test_types_parents_children_and_loops_are_compared() -> None:
    assert ('joint', 'slide', 'type') in told(urdf(), with_joint(sdf(), 'slide', type='fixed'))
    assert ('joint', 'slide', 'parent') in told(urdf(), with_joint(sdf(), 'slide', parent='base'))
    loop = with_joint(urdf(), 'slide', is_loop=True)
    assert ('joint', 'slide', 'closes a loop') in told(urdf(), loop)


@pytest.mark.parametrize('pose', [Pose((0.1, 0.0, 1e-6)), Pose((0.1, 0.0, 0.0), (1e-6, 0.0, 0.0))])
def test_a_pose_that_is_off_is_told_once_with_its_size(pose: Pose) -> None:
    found = differences(urdf(), with_visual(sdf(), placement=on('arm', pose)))
    assert [(one.element, one.name, one.property) for one in found] == [
        ('visual', 'arm/0', 'pose at zero')]
    assert found[0].size == pytest.approx(1e-6)
    assert found[0].a != found[0].b
    assert differences(urdf(), with_visual(sdf(), placement=on('arm', pose)),
                       tolerance=2e-6) == []


def test_an_angle_is_told_exactly_where_it_is_small() -> None:
    for angle in (1e-12, 1e-9, 1e-3, 1.0, 3.0):
        turned = with_visual(urdf(), placement=on('arm', Pose((0.1, 0.0, 0.0), (0.0, angle, 0.0))))
        one, = differences(urdf(), turned, tolerance=1e-13, samples=0)
        assert one.size == pytest.approx(angle, rel=1e-3)


def test_tolerance_is_absolute_up_to_a_metre_and_relative_beyond() -> None:
    def at(x: float) -> Robot:
        return with_visual(urdf(), placement=on('arm', Pose((x, 0.0, 0.0))))

    assert differences(at(1e6), at(1e6 + 1e-4), samples=0) == []
    assert differences(at(1e6), at(1e6 + 1e-2), samples=0) != []
    assert differences(at(1e-6), at(1e-6 + 1e-10), samples=0) == []
    assert differences(at(1e-6), at(1e-6 + 1e-8), samples=0) != []


def test_moments_of_inertia_are_compared_in_space_and_by_their_own_size() -> None:
    turned = Inertial(on('arm', Pose((0.0, 0.0, 0.5))), 2.0, (2.0, 0.0, 0.0, 1.0, 0.0, 3.0))
    assert told(urdf(), with_link(sdf(), 'arm', inertial=turned)) == []
    off = replace(turned, inertia=(1.0, 0.0, 0.0, 2.0, 0.0, 3.0))
    assert told(urdf(), with_link(sdf(), 'arm', inertial=off)) == [('inertial', 'arm', 'inertia')]
    light = replace(turned, mass=1e-12, inertia=(1e-12, 0.0, 0.0, 1e-12, 0.0, 1e-12))
    lighter = replace(turned, mass=2e-12, inertia=(1e-12, 0.0, 0.0, 1e-12, 0.0, 2e-12))
    found = told(*(with_link(urdf(), 'arm', inertial=one) for one in (light, lighter)))
    assert [what for _, _, what in found] == ['mass', 'inertia']


def test_centre_and_presence_of_inertials_are_compared() -> None:
    off = Inertial(on('arm', Pose((0.0, 0.1, 0.5))), 2.0, (2.0, 0.0, 0.0, 1.0, 0.0, 3.0))
    assert told(urdf(), with_link(sdf(), 'arm', inertial=off)) == [
        ('inertial', 'arm', 'pose at zero')]
    one, = differences(urdf(), with_link(sdf(), 'arm', inertial=None))
    assert one == absent('inertial', 'arm')


@pytest.mark.parametrize(('changes', 'what'), [
    ({'geometry': Box((1.0, 2.0, 3.001))}, ['size']),
    ({'geometry': Sphere(1.0)}, ['geometry', 'size', 'radius']),
    ({'geometry': Cylinder(1.0, 2.0)}, ['geometry', 'size', 'radius', 'length']),
    ({'material': None}, ['color']),
    ({'material': Material('red', (1.0, 0.0, 0.1, 1.0))}, ['color']),
    ({'material': Material('other name', RED, specular=(0.0, 0.0, 0.0, 1.0))}, []),
    ({'material': Material('', RED, emissive=(0.5, 0.0, 0.0, 1.0))}, ['emissive']),
    ({'material': Material('', RED, texture='package://a/b.png')}, ['texture']),
])
def test_geometry_and_look_are_compared(changes: dict[str, Any], what: list[str]) -> None:
    found = told(urdf(), with_visual(sdf(), **changes))
    assert sorted(found) == sorted(('visual', 'arm/0', one) for one in what)


def test_both_ways_to_name_a_mesh_and_no_scale_are_the_same() -> None:
    mesh = with_visual(urdf(), geometry=Mesh('package://robot/meshes/arm.stl'))
    assert told(mesh, with_visual(sdf(), geometry=Mesh('model://robot/meshes/arm.stl',
                                                       (1.0, 1.0, 1.0)))) == []
    assert told(mesh, with_visual(sdf(), geometry=Mesh('file://robot/meshes/arm.stl'))) == [
        ('visual', 'arm/0', 'uri')]
    assert told(mesh, with_visual(sdf(), geometry=Mesh('package://robot/meshes/arm.stl',
                                                       (1.0, 1.0, 0.999)))) == [
        ('visual', 'arm/0', 'scale')]


def test_geometry_that_only_sdf_has_is_compared_by_meaning() -> None:
    def plane(text: str) -> Robot:
        rest = etree.fromstring(f'<visual><geometry><plane>{text}</plane></geometry></visual>')
        return with_visual(urdf(), geometry=None, extension=Extension(sdf=rest))

    assert told(plane('<size>1 2.0</size>'), plane('<size> 1.0 2 </size>')) == []
    assert told(plane('<size>1 2</size>'), plane('<size>1 3</size>')) == [
        ('visual', 'arm/0', 'geometry')]


def test_visuals_are_found_by_name_where_all_have_one_and_else_by_order() -> None:
    one, other = shape('arm', 'one'), shape('arm', 'other', geometry=Sphere(1.0))
    named = with_link(urdf(), 'arm', visuals=(one, other))
    assert told(named, with_link(sdf(), 'arm', visuals=(other, one))) == []
    nameless = tuple(replace(some, name='') for some in (one, other))
    assert told(named, with_link(sdf(), 'arm', visuals=nameless)) == []
    assert told(named, with_link(sdf(), 'arm', visuals=(one,))) == [
        ('visual', 'arm/other', 'presence')]
    assert told(named, with_link(sdf(), 'arm', visuals=nameless[:1])) == [
        ('visual', 'arm/1', 'presence')]
    bare = with_link(named, 'arm', collisions=())
    assert told(named, bare) == [('collision', 'arm/0', 'presence')]


def test_a_link_or_joint_that_is_missing_is_told_but_not_all_that_it_has() -> None:
    extra = Link('extra', Placement(Pose(), MODEL), visuals=(shape('extra'),))
    more = replace(urdf(), links=(*urdf().links, extra))
    assert told(urdf(), more) == [('link', 'extra', 'presence')]
    assert told(more, urdf()) == [('link', 'extra', 'presence')]
    joint = Joint('more', 'fixed', 'base', 'extra', on('base'))
    assert ('joint', 'more', 'presence') in told(more, replace(more, joints=(*more.joints, joint)))


def test_several_roots_are_compared_relative_to_the_first_that_both_have() -> None:
    loose = Link('loose', Placement(Pose((0.0, 3.0, 0.0)), MODEL))
    moved = Link('loose', Placement(Pose((5.0, 3.0, 0.0)), MODEL))
    one = replace(urdf(), links=(*urdf().links, loose))
    assert told(one, replace(sdf(), links=(moved, *sdf().links))) == []
    assert told(one, replace(sdf(), links=(*sdf().links, loose))) == [
        ('link', 'loose', 'pose at zero')]


def test_an_empty_world_in_one_only_is_no_difference() -> None:
    world = Link('world', Placement(Pose((9.0, 0.0, 0.0)), MODEL))
    beside = replace(sdf(), links=(world, *sdf().links))
    assert told(urdf(), beside) == []
    assert told(beside, replace(urdf(), links=(*urdf().links, world))) == []


def test_a_robot_fastened_to_the_world_is_compared_relative_to_it() -> None:
    def fastened(robot: Robot, x: float) -> Robot:
        world = Link('world', Placement(Pose((x, 0.0, 0.0)), MODEL))
        joint = Joint('foot', 'fixed', 'world', 'base', on('base'))
        return replace(robot, links=(world, *robot.links), joints=(joint, *robot.joints))

    assert told(fastened(urdf(), -1.0), fastened(sdf(), 4.0)) == []
    assert ('link', 'base', 'pose at zero') in told(fastened(urdf(), 0.0), fastened(sdf(), 4.0))
    assert told(urdf(), fastened(sdf(), 0.0)) == [('joint', 'foot', 'presence')]


def test_names_of_nested_models_are_the_same_in_either_format() -> None:
    def renamed(robot: Robot, name: str) -> Robot:
        links = tuple(replace(link, name=name if link.name == 'hand' else link.name)
                      for link in robot.links)
        return with_joint(replace(robot, links=links), 'slide', child=name,
                          placement=on('arm', Pose((0.0, 0.0, 1.0))))

    assert told(renamed(urdf(), 'gripper::hand'), renamed(urdf(), 'gripper__hand')) == []
    assert told(urdf(), renamed(urdf(), 'finger')) != []


def test_a_name_that_a_conversion_changed_is_the_one_before() -> None:
    own = etree.fromstring('<joint name="slide"/>')
    changed = with_joint(sdf(), 'slide', name='slide_joint', extension=Extension(urdf=own))
    assert told(urdf(), changed) == []


def test_frames_are_compared_where_both_robots_have_them() -> None:
    def framed(robot: Robot, pose: Pose) -> Robot:
        return replace(robot, frames=(Frame('tip', FrameId('link', 'hand'), on('hand', pose)),))

    assert told(urdf(), framed(sdf(), Pose())) == []
    assert told(framed(urdf(), Pose()), framed(sdf(), Pose())) == []
    assert told(framed(urdf(), Pose()), framed(sdf(), Pose((0.0, 0.0, 1.0)))) == [
        ('frame', 'tip', 'pose at zero')]


def free(type_: str, axes: tuple[Axis, ...], pose: Pose = Pose()) -> Robot:  # noqa: B008
    links = tuple(Link(name, Placement(Pose(), MODEL)) for name in 'ab')
    return Robot('free', links, (Joint('j', type_, 'a', 'b', on('b', pose), axes),))


@pytest.mark.parametrize('type_', ['ball', 'floating', 'planar', 'universal', 'revolute2', 'screw',
                                   'gearbox', 'fixed', 'continuous', 'prismatic'])
def test_every_kind_of_joint_is_moved(type_: str) -> None:
    axes = (Axis((0.0, 0.0, 1.0)), Axis((0.0, 1.0, 0.0)))
    assert told(free(type_, axes), free(type_, axes)) == []
    off = told(free(type_, axes), free(type_, axes, Pose((0.0, 0.1, 0.0), (0.1, 0.0, 0.0))))
    assert ('joint', 'j', 'pose at zero') in off
    # Beside a fixed joint only one that moves shows where it is.
    assert (('link', 'b', 'pose at random positions') in off) == (type_ != 'fixed')


@pytest.mark.parametrize('limit', [
    Limit(-1e300, 1e300), Limit(2e3, 3e3), Limit(5.0, -5.0), Limit(upper=-50.0),
    Limit(lower=50.0)])
def test_any_limits_can_be_compared(limit: Limit) -> None:
    robot = free('prismatic', (Axis((1.0, 0.0, 0.0), limit),))
    assert differences(robot, robot) == []


def test_positions_are_within_limits_and_the_same_for_the_same_seed() -> None:
    one = with_axis(urdf(), 'slide', mimic=None)
    other = with_axis(one, 'slide', xyz=(1.0, 0.01, 0.0))
    found = differences(one, other, tolerance=1e-9)
    assert found == differences(one, other, tolerance=1e-9)
    assert found != differences(one, other, tolerance=1e-9, seed=1)
    hand = next(one for one in found if one.name == 'hand')
    assert 0 < hand.size <= 0.5 * 0.01


def test_circles_are_errors() -> None:
    circle = with_axis(urdf(), 'turn', mimic=Mimic('slide'))
    with pytest.raises(DescriptionError, match='mimic cycle'):
        differences(circle, circle)


def test_a_table_is_aligned_and_empty_without_differences() -> None:
    assert table([]) == ''
    heading, first, second, count = table([
        Difference(element='joint', name='j', property='upper', a='1', b='22', size=21.0),
        absent('collision', 'a/0')]).splitlines()
    assert heading.split() == ['element', 'name', 'property', 'a', 'b', 'difference']
    assert first.index('upper') == second.index('presence') == heading.index('property')
    assert first.endswith('22  21')
    assert second == second.rstrip()
    assert count == '2 differences'


@pytest.mark.parametrize(('count', 'most', 'rows', 'last'), [
    (1, 50, 1, ['1 difference']), (50, 50, 50, ['50 differences']),
    (51, 50, 50, ['... and 1 more; --all shows them', '51 differences']),
    (173, 50, 50, ['... and 123 more; --all shows them', '173 differences']),
    (173, None, 173, ['173 differences'])])
def test_a_table_has_a_limit(count: int, most: int | None, rows: int, last: list[str]) -> None:
    found = [absent('link', f'{number}') for number in range(count)]
    lines = table(found, most).splitlines()
    assert [line.split()[1] for line in lines[1:rows + 1]] == [f'{n}' for n in range(rows)]
    assert lines[rows + 1:] == last


def test_long_chains_take_linear_time() -> None:
    def chain(count: int) -> Robot:
        names = ['base', *(f'l{index}' for index in range(count))]
        vector: Vector = (0.0, 0.6, 0.8)
        return Robot('chain', (Link('base', Placement(Pose(), MODEL)), *(
            Link(name, Placement(Pose(), FrameId('joint', f'j{name}'))) for name in names[1:])),
            tuple(Joint(f'j{child}', 'continuous', parent, child,
                        on(parent, Pose((0.0, 0.0, 0.1), (0.1, 0.0, 0.0))), (Axis(vector),))
                  for parent, child in pairwise(names)))

    def check(count: int) -> None:
        assert differences(chain(count), chain(count), samples=1) == []

    assert robots.is_linear(check)
