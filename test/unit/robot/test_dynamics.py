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

"""Mass, centre of mass and kinetic energy of robots, with values that were computed by hand."""

from __future__ import annotations

from opencv_tools.robot.compare.compare import differences
from opencv_tools.robot.compare.dynamics import ENERGY, whole_properties
from opencv_tools.robot.compare.side import Side
from opencv_tools.robot.lumping import lump_fixed
from opencv_tools.robot.model import Robot
from opencv_tools.robot.urdf.reader import read_urdf
from opencv_tools.robot.xml.document import parse
from opencv_tools.robot.xml.report import Report
import pytest

STILL = [0.0] * 6


def body(name: str, mass: float, x: float = 0.0, izz: float = 0.5) -> str:
    return (f'<link name="{name}"><inertial><origin xyz="{x} 0 0"/><mass value="{mass}"/><inertia '
            f'ixx="0.25" ixy="0" ixz="0" iyy="0.25" iyz="0" izz="{izz}"/></inertial></link>')


def joint(name: str, kind: str, parent: str, child: str, x: float = 0.0) -> str:
    return (f'<joint name="{name}" type="{kind}"><origin xyz="{x} 0 0"/><parent link="{parent}"/>'
            f'<child link="{child}"/><axis xyz="0 0 2"/><limit lower="-1" upper="1" effort="1" '
            'velocity="1"/></joint>')


def robot(text: str) -> Robot:
    return read_urdf(parse(f'<robot name="r">{text}</robot>'.encode(), 'r.urdf', Report()),
                     Report())


@pytest.mark.parametrize(('kind', 'velocity', 'energy'), [
    ('continuous', 2.0, (3 * 0.5**2 + 0.5) * 2.0**2 / 2), ('prismatic', 2.0, 3 * 2.0**2 / 2),
    ('revolute', -0.125, (3 * 0.5**2 + 0.5) * 0.125**2 / 2), ('fixed', 2.0, 0.0)])
def test_energy_of_a_joint(kind: str, velocity: float, energy: float) -> None:
    side = Side(robot(body('a', 1) + body('b', 3, 0.5) + joint('j', kind, 'a', 'b', 1)))
    found = whole_properties(side, [side.poses('a', {})], {'': STILL, 'j': [velocity] * 6})
    assert found['mass'] == (4.0,)
    assert found['centre of mass at zero'] == pytest.approx((3 * 1.5 / 4, 0, 0))
    assert found[ENERGY] == pytest.approx((energy,))


def test_energy_of_a_chain_and_of_a_moving_base() -> None:
    side = Side(robot(body('a', 1) + body('b', 3, 0.5) + body('c', 2, 0.25) + joint(
        'j', 'continuous', 'a', 'b') + joint('k', 'continuous', 'b', 'c', 1)))
    moving = {'': [0, 0, 0, 0, 2, 0], 'j': [1] * 6, 'k': [2] * 6}
    # The velocities of the centres along y, and the angular velocities.
    expected = (1 * 2**2 + 3 * (2 + 0.5)**2 + 0.5 * 1 + 2 * (2 + 1 + 0.25 * 3)**2 + 0.5 * 3**2) / 2
    assert whole_properties(side, [side.poses('a', {})], moving)[ENERGY] == pytest.approx((
        expected,))


def test_lumped_robot_is_the_same_as_a_whole() -> None:
    original = robot(body('a', 1) + body('b', 3, 0.5) + body('c', 2, 0.25) + joint(
        'j', 'continuous', 'a', 'b') + joint('k', 'fixed', 'b', 'c', 1))
    found = differences(original, lump_fixed(original, Report()))
    assert found and all(difference.element != 'robot' for difference in found)


def test_inertia_about_the_axis_of_a_wheel() -> None:
    first, second = (robot(body('a', 1, izz=one) + body('b', 3, izz=other) + joint(
        'j', 'continuous', 'a', 'b')) for one, other in ((0.5, 0.75), (0.75, 0.5)))
    found = [difference.property for difference in differences(first, second)
             if difference.element == 'robot']
    assert found == [ENERGY]


def test_robots_without_mass() -> None:
    text = '<link name="a"/><link name="b"/>' + joint('j', 'continuous', 'a', 'b')
    side = Side(robot(text))
    assert whole_properties(side, [side.poses('a', {})], {'': STILL, 'j': STILL}) == {}
