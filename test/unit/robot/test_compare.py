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

"""Comparison of two robots, and the table of their differences."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
import math
from typing import Any

from compared_robots import absent, free, HALF, on, RED, shape, urdf, with_axis, with_joint
from lxml import etree
from opencv_tools.robot.compare.compare import Difference, differences, table
from opencv_tools.robot.compare.dynamics import ENERGY
from opencv_tools.robot.geometry import Box, Cylinder, Material, Mesh, Sphere
from opencv_tools.robot.model import (
    Axis, Dynamics, Extension, FrameId, Inertial, Joint, Limit, Link, Mimic, MODEL, Placement,
    Robot, RobotFrame)
from opencv_tools.robot.pose import Pose, Vector
from opencv_tools.robot.xml.document import DescriptionError
import pytest
import robots
from rows import each_row

#: Properties of a robot as a whole.
WHOLE = [('robot', '', name) for name in ('mass', 'centre of mass at zero', ENERGY)]


def sdf() -> Robot:
    """Create the same arm with placements of SDF and another pose of the root link."""
    robot = urdf()
    base = Pose((5.0, 0.0, 0.0))
    poses = {'base': base, 'arm': Pose((6.0, 0.0, 0.0), (HALF, 0.0, 0.0)),
             'hand': Pose((6.0, -1.0, 0.0), (HALF, 0.0, 0.0))}
    links = tuple(replace(link, placement=Placement(poses[link.name], MODEL))
                  for link in robot.links)
    return replace(robot, links=links, joints=tuple(
        replace(joint, placement=on(joint.child)) for joint in robot.joints))


def with_link(robot: Robot, name: str, **changes: Any) -> Robot:
    return replace(robot, links=tuple(replace(link, **changes) if link.name == name else link
                                      for link in robot.links))


def with_visual(robot: Robot, **changes: Any) -> Robot:
    visual, = robot.links[1].visuals
    return with_link(robot, 'arm', visuals=(replace(visual, **changes),))


def diff(a: Robot, b: Robot, **options: Any) -> list[tuple[str, str, str]]:
    """Return the differences, which must not depend on the order of the robots."""
    found, other_way = (
        [(one.element, one.name, one.property) for one in differences(*both, **options)]
        for both in ((a, b), (b, a)))
    assert sorted(found) == sorted(other_way)
    return found


def test_equal_robots_with_different_placements() -> None:
    assert differences(urdf(), urdf(), tolerance=0.0) == []
    assert differences(urdf(), sdf(), tolerance=1e-12) == []
    assert differences(sdf(), urdf(), tolerance=1e-12) == []


@each_row(('name', 'changes', 'names'), [
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
def test_joint_properties(name: str, changes: dict[str, Any], names: list[str]) -> None:
    found = diff(urdf(), with_axis(sdf(), name, **changes), samples=0)
    assert sorted(found) == sorted(('joint', name, property_) for property_ in names)


def test_axis_direction_in_space() -> None:
    assert diff(urdf(), with_axis(sdf(), 'turn', xyz=(0.0, 0.0, 1e-9))) == []
    other = with_axis(sdf(), 'turn', xyz=(0.0, 1e-6, 1.0))
    assert diff(urdf(), other, samples=0) == [('joint', 'turn', 'axis')]
    assert ('link', 'hand', 'pose at random positions') in diff(urdf(), other)
    flipped = with_axis(sdf(), 'turn', xyz=(0.0, 0.0, -1.0))
    assert ('joint', 'turn', 'axis') in diff(urdf(), flipped)


def test_revolute_without_limits_equals_continuous() -> None:
    endless = with_axis(urdf(), 'turn', limit=Limit(-1e16, math.inf, 3.0, 4.0))
    continuous = with_axis(with_joint(sdf(), 'turn', type='continuous'), 'turn',
                           limit=Limit(effort=3.0, velocity=4.0))
    assert diff(endless, continuous) == []


def test_negative_effort_means_no_limit() -> None:
    negative, endless = (with_axis(urdf(), 'slide', limit=Limit(0.0, 1.0, *limits)) for limits in (
        (-1.0, -2.5), (math.inf, 1e17)))
    assert diff(negative, endless) == []
    limited = with_axis(urdf(), 'slide', limit=Limit(0.0, 1.0, 1.0, 2.5))
    assert diff(negative, limited) == [
        ('joint', 'slide', 'effort'), ('joint', 'slide', 'velocity')]


def test_ignored_axes_of_fixed_joints() -> None:
    fixed = with_joint(urdf(), 'turn', type='fixed')
    assert diff(fixed, with_joint(sdf(), 'turn', type='fixed', axes=())) == []


def test_joint_types_parents_and_loops() -> None:
    assert ('joint', 'slide', 'type') in diff(urdf(), with_joint(sdf(), 'slide', type='fixed'))
    assert ('joint', 'slide', 'parent') in diff(urdf(), with_joint(sdf(), 'slide', parent='base'))
    loop = with_joint(urdf(), 'slide', is_loop=True)
    assert ('joint', 'slide', 'closes a loop') in diff(urdf(), loop)


@pytest.mark.parametrize('pose', [Pose((0.1, 0.0, 1e-6)), Pose((0.1, 0.0, 0.0), (1e-6, 0.0, 0.0))])
def test_one_difference_for_a_different_pose(pose: Pose) -> None:
    found = differences(urdf(), with_visual(sdf(), placement=on('arm', pose)))
    assert [(one.element, one.name, one.property) for one in found] == [
        ('visual', 'arm/0', 'pose at zero')]
    assert found[0].size == pytest.approx(1e-6)
    assert found[0].a != found[0].b
    assert differences(urdf(), with_visual(sdf(), placement=on('arm', pose)),
                       tolerance=2e-6) == []


def test_precision_of_small_angles() -> None:
    for angle in (1e-12, 1e-9, 1e-3, 1.0, 3.0):
        turned = with_visual(urdf(), placement=on('arm', Pose((0.1, 0.0, 0.0), (0.0, angle, 0.0))))
        one, = differences(urdf(), turned, tolerance=1e-13, samples=0)
        assert one.size == pytest.approx(angle, rel=1e-3)


def test_absolute_and_relative_tolerance() -> None:
    def at(x: float) -> Robot:
        return with_visual(urdf(), placement=on('arm', Pose((x, 0.0, 0.0))))

    assert differences(at(1e6), at(1e6 + 1e-4), samples=0) == []
    assert differences(at(1e6), at(1e6 + 1e-2), samples=0) != []
    assert differences(at(1e-6), at(1e-6 + 1e-10), samples=0) == []
    assert differences(at(1e-6), at(1e-6 + 1e-8), samples=0) != []


def test_moments_of_inertia_in_space() -> None:
    turned = Inertial(on('arm', Pose((0.0, 0.0, 0.5))), 2.0, (2.0, 0.0, 0.0, 1.0, 0.0, 3.0))
    assert diff(urdf(), with_link(sdf(), 'arm', inertial=turned)) == []
    off = replace(turned, inertia=(1.0, 0.0, 0.0, 2.0, 0.0, 3.0))
    assert diff(urdf(), with_link(sdf(), 'arm', inertial=off)) == [
        ('inertial', 'arm', 'inertia'), WHOLE[2]]
    light = replace(turned, mass=1e-12, inertia=(1e-12, 0.0, 0.0, 1e-12, 0.0, 1e-12))
    lighter = replace(turned, mass=2e-12, inertia=(1e-12, 0.0, 0.0, 1e-12, 0.0, 2e-12))
    found = diff(*(with_link(urdf(), 'arm', inertial=one) for one in (light, lighter)))
    assert [what for _, _, what in found] == ['mass', 'inertia', 'mass', ENERGY]


def test_centre_and_presence_of_inertials() -> None:
    off = Inertial(on('arm', Pose((0.0, 0.1, 0.5))), 2.0, (2.0, 0.0, 0.0, 1.0, 0.0, 3.0))
    assert diff(urdf(), with_link(sdf(), 'arm', inertial=off)) == [
        ('inertial', 'arm', 'pose at zero'), *WHOLE[1:]]
    one, *_ = differences(urdf(), with_link(sdf(), 'arm', inertial=None))
    assert one == replace(absent('inertial', 'arm'), a='2 kg')


@each_row(('changes', 'what'), [
    ({'geometry': Box((1.0, 2.0, 3.001))}, ['size']),
    ({'geometry': Sphere(1.0)}, ['geometry', 'size', 'radius']),
    ({'geometry': Cylinder(1.0, 2.0)}, ['geometry', 'size', 'radius', 'length']),
    ({'material': None}, ['color']),
    ({'material': Material(name='red', color=(1.0, 0.0, 0.1, 1.0))}, ['color']),
    ({'material': Material(name='other name', color=RED, specular=(0.0, 0.0, 0.0, 1.0))}, []),
    ({'material': Material(name='', color=RED, emissive=(0.5, 0.0, 0.0, 1.0))}, ['emissive']),
    ({'material': Material(name='', color=RED, texture='package://a/b.png')}, ['texture']),
])
def test_geometry_and_material(changes: dict[str, Any], what: list[str]) -> None:
    found = diff(urdf(), with_visual(sdf(), **changes))
    assert sorted(found) == sorted(('visual', 'arm/0', one) for one in what)


def test_equal_mesh_uris_and_default_scale() -> None:
    mesh = with_visual(urdf(), geometry=Mesh('package://robot/meshes/arm.stl'))
    assert diff(mesh, with_visual(sdf(), geometry=Mesh('model://robot/meshes/arm.stl',
                                                       (1.0, 1.0, 1.0)))) == []
    assert diff(mesh, with_visual(sdf(), geometry=Mesh('file://robot/meshes/arm.stl'))) == [
        ('visual', 'arm/0', 'uri')]
    assert diff(mesh, with_visual(sdf(), geometry=Mesh('package://robot/meshes/arm.stl',
                                                       (1.0, 1.0, 0.999)))) == [
        ('visual', 'arm/0', 'scale')]


def test_geometry_that_only_sdf_supports() -> None:
    def plane(text: str) -> Robot:
        rest = etree.fromstring(f'<visual><geometry><plane>{text}</plane></geometry></visual>')
        return with_visual(urdf(), geometry=None, extension=Extension(sdf=rest))

    assert diff(plane('<size>1 2.0</size>'), plane('<size> 1.0 2 </size>')) == []
    assert diff(plane('<size>1 2</size>'), plane('<size>1 3</size>')) == [
        ('visual', 'arm/0', 'geometry')]


def test_visuals_matched_by_name_or_order() -> None:
    one, other = shape('arm', 'one'), shape('arm', 'other', geometry=Sphere(1.0))
    named = with_link(urdf(), 'arm', visuals=(one, other))
    assert diff(named, with_link(sdf(), 'arm', visuals=(other, one))) == []
    nameless = tuple(replace(some, name='') for some in (one, other))
    assert diff(named, with_link(sdf(), 'arm', visuals=nameless)) == []
    assert diff(named, with_link(sdf(), 'arm', visuals=(one,))) == [
        ('visual', 'arm/other', 'presence')]
    assert diff(named, with_link(sdf(), 'arm', visuals=nameless[:1])) == [
        ('visual', 'arm/1', 'presence')]
    bare = with_link(named, 'arm', collisions=())
    assert diff(named, bare) == [('collision', 'arm/0', 'presence')]


def test_missing_links_and_joints() -> None:
    extra = Link(name='extra', placement=Placement(Pose(), MODEL), visuals=(shape('extra'),))
    more = replace(urdf(), links=(*urdf().links, extra))
    assert diff(urdf(), more) == [('link', 'extra', 'presence')]
    assert diff(more, urdf()) == [('link', 'extra', 'presence')]
    joint = Joint(name='more', type='fixed', parent='base', child='extra', placement=on('base'))
    assert ('joint', 'more', 'presence') in diff(more, replace(more, joints=(*more.joints, joint)))


def test_common_base_of_several_roots() -> None:
    loose = Link(name='loose', placement=Placement(Pose((0.0, 3.0, 0.0)), MODEL))
    moved = Link(name='loose', placement=Placement(Pose((5.0, 3.0, 0.0)), MODEL))
    one = replace(urdf(), links=(*urdf().links, loose))
    assert diff(one, replace(sdf(), links=(moved, *sdf().links))) == []
    assert diff(one, replace(sdf(), links=(*sdf().links, loose))) == [
        ('link', 'loose', 'pose at zero')]


def test_ignored_empty_world() -> None:
    world = Link(name='world', placement=Placement(Pose((9.0, 0.0, 0.0)), MODEL))
    beside = replace(sdf(), links=(world, *sdf().links))
    assert diff(urdf(), beside) == []
    assert diff(beside, replace(urdf(), links=(*urdf().links, world))) == []


def test_robot_fixed_to_the_world() -> None:
    def fastened(robot: Robot, x: float) -> Robot:
        world = Link(name='world', placement=Placement(Pose((x, 0.0, 0.0)), MODEL))
        joint = Joint(name='foot', type='fixed', parent='world', child='base',
                      placement=on('base'))
        return replace(robot, links=(world, *robot.links), joints=(joint, *robot.joints))

    assert diff(fastened(urdf(), -1.0), fastened(sdf(), 4.0)) == []
    assert ('link', 'base', 'pose at zero') in diff(fastened(urdf(), 0.0), fastened(sdf(), 4.0))
    assert diff(urdf(), fastened(sdf(), 0.0)) == [('joint', 'foot', 'presence')]


def test_equal_names_of_nested_models() -> None:
    def renamed(robot: Robot, name: str) -> Robot:
        links = tuple(replace(link, name=name if link.name == 'hand' else link.name)
                      for link in robot.links)
        return with_joint(replace(robot, links=links), 'slide', child=name,
                          placement=on('arm', Pose((0.0, 0.0, 1.0))))

    assert diff(renamed(urdf(), 'gripper::hand'), renamed(urdf(), 'gripper__hand')) == []
    assert diff(urdf(), renamed(urdf(), 'finger')) != []


def test_original_names_of_converted_robots() -> None:
    own = etree.fromstring('<joint name="slide"/>')
    changed = with_joint(sdf(), 'slide', name='slide_joint', extension=Extension(urdf=own))
    assert diff(urdf(), changed) == []


def test_frames_of_both_robots() -> None:
    def framed(robot: Robot, pose: Pose) -> Robot:
        return replace(robot, frames=(RobotFrame(name='tip', attached_to=FrameId('link', 'hand'),
                                                 placement=on('hand', pose)),))

    assert diff(urdf(), framed(sdf(), Pose())) == []
    assert diff(framed(urdf(), Pose()), framed(sdf(), Pose())) == []
    assert diff(framed(urdf(), Pose()), framed(sdf(), Pose((0.0, 0.0, 1.0)))) == [
        ('frame', 'tip', 'pose at zero')]


@each_row('type_', ['ball', 'floating', 'planar', 'universal', 'revolute2', 'screw',
                    'gearbox', 'fixed', 'continuous', 'prismatic'])
def test_motion_of_every_joint_type(type_: str) -> None:
    axes = (Axis((0.0, 0.0, 1.0)), Axis((0.0, 1.0, 0.0)))
    assert diff(free(type_, axes), free(type_, axes)) == []
    off = diff(free(type_, axes), free(type_, axes, Pose((0.0, 0.1, 0.0), (0.1, 0.0, 0.0))))
    assert ('joint', 'j', 'pose at zero') in off
    # A different origin of a fixed joint does not move its child link.
    assert (('link', 'b', 'pose at random positions') in off) == (type_ != 'fixed')


def test_mimic_cycle_error_in_a_comparison() -> None:
    circle = with_axis(urdf(), 'turn', mimic=Mimic('slide'))
    with pytest.raises(DescriptionError, match='mimic cycle'):
        differences(circle, circle)


@pytest.mark.thorough
def test_linear_time_for_long_chains() -> None:
    def chain(count: int) -> Robot:
        names = ['base', *(f'l{index}' for index in range(count))]
        vector: Vector = (0.0, 0.6, 0.8)
        return Robot(name='chain',
                     links=(Link(name='base', placement=Placement(Pose(), MODEL)),
                            *(Link(name=name,
                                   placement=Placement(Pose(), FrameId('joint', f'j{name}')))
                              for name in names[1:])),
                     joints=tuple(Joint(name=f'j{child}', type='continuous', parent=parent,
                                        child=child,
                                        placement=on(parent,
                                                     Pose((0.0, 0.0, 0.1), (0.1, 0.0, 0.0))),
                                        axes=(Axis(vector),))
                                  for parent, child in pairwise(names)))

    def check(count: int) -> None:
        assert differences(chain(count), chain(count), samples=1) == []

    assert robots.is_linear(check)


@each_row('limit', [
    Limit(-1e300, 1e300), Limit(2e3, 3e3), Limit(5.0, -5.0), Limit(upper=-50.0),
    Limit(lower=50.0)])
def test_extreme_limits(limit: Limit) -> None:
    robot = free('prismatic', (Axis((1.0, 0.0, 0.0), limit),))
    assert differences(robot, robot) == []


def test_reproducible_random_positions() -> None:
    one = with_axis(urdf(), 'slide', mimic=None)
    other = with_axis(one, 'slide', xyz=(1.0, 0.01, 0.0))
    found = differences(one, other, tolerance=1e-9)
    assert found == differences(one, other, tolerance=1e-9)
    assert found != differences(one, other, tolerance=1e-9, seed=1)
    hand = next(one for one in found if one.name == 'hand')
    assert 0 < hand.size <= 0.5 * 0.01


def test_aligned_columns_of_the_table() -> None:
    assert table([]) == ''
    heading, first, second, count = table([
        Difference(element='joint', name='j', property='upper', a='1', b='22', size=21.0),
        absent('collision', 'a/0')]).splitlines()
    assert heading.split() == ['element', 'name', 'property', 'a', 'b', 'difference']
    assert first.index('upper') == second.index('presence') == heading.index('property')
    assert first.endswith('22  21')
    assert second == second.rstrip()
    assert count == '2 differences'


@each_row(('count', 'most', 'rows', 'last'), [
    (1, 50, 1, ['1 difference']), (50, 50, 50, ['50 differences']),
    (51, 50, 50, ['... and 1 more; --all shows them', '51 differences']),
    (173, 50, 50, ['... and 123 more; --all shows them', '173 differences']),
    (173, None, 173, ['173 differences'])])
def test_maximum_number_of_rows_of_the_table(count: int, most: int | None, rows: int,
                                             last: list[str]) -> None:
    found = [absent('link', f'{number}') for number in range(count)]
    lines = table(found, most).splitlines()
    assert [line.split()[1] for line in lines[1:rows + 1]] == [f'{n}' for n in range(rows)]
    assert lines[rows + 1:] == last
