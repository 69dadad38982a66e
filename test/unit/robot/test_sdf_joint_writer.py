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

"""Writer of SDF joints in every version."""

from __future__ import annotations

from dataclasses import replace
import math

from lxml import etree
from opencv_tools.robot.kinematics import Kinematics
from opencv_tools.robot.model import Axis, Extension, FrameId, Limit, Mimic, Placement
from opencv_tools.robot.pose import Pose
from opencv_tools.robot.xml.report import Report
import pytest
from sdf_models import HALF, reread, urdf_robot, VERSIONS, with_axis, written


def test_pose_of_a_joint_away_from_its_child() -> None:
    robot = urdf_robot()
    links = (*robot.links[:1], *(replace(link, placement=replace(
        link.placement, pose=Pose((1.0, 0.0, 0.0)))) for link in robot.links[1:]))
    assert written(replace(robot, links=links)).findtext('joint/pose') == '-1 0 0 0 0 0'


@pytest.mark.parametrize('version', VERSIONS)
@pytest.mark.parametrize('kind', ['fixed', 'revolute', 'continuous', 'prismatic', 'floating',
                                  'planar', 'screw'])
def test_round_trip_of_joint_types_by_version(version: str, kind: str) -> None:
    robot = urdf_robot(kind)
    limit = Limit(-1.0, 2.0) if kind == 'revolute' else None
    robot = replace(robot, joints=tuple(replace(joint, axes=tuple(
        replace(axis, limit=limit) for axis in joint.axes)) for joint in robot.joints))
    other = reread(robot, version)
    assert [joint.type for joint in other.joints] == [kind, kind]
    assert [joint.axes for joint in other.joints] == [joint.axes for joint in robot.joints]
    for link in robot.links:
        frame = FrameId('link', link.name)
        one, two = Kinematics(robot).pose(frame), Kinematics(other).pose(frame)
        assert math.dist((*one.rotation, *one.translation),
                         (*two.rotation, *two.translation)) < 1e-12


@pytest.mark.parametrize(('version', 'xyz'), [('1.4', (0.0, 0.6, 0.8)), ('1.5', (0.6, 0.0, 0.8))])
def test_unit_axis_and_its_frame_by_version(
        version: str, xyz: tuple[float, ...]) -> None:
    robot = with_axis(Axis((3.0, 0.0, 4.0)))
    robot = replace(robot, joints=(replace(robot.joints[0], placement=Placement(
        Pose(rpy=(0.0, 0.0, HALF)), FrameId('link', 'base'))), robot.joints[1]))
    element = written(robot, version=version).find('joint/axis/xyz')
    assert element is not None
    assert tuple(map(float, (element.text or '').split())) == pytest.approx(xyz)
    assert element.get('{urn:opencv_tools:urdf}xyz') == '3 0 4'


def test_mimic_by_version() -> None:
    robot = with_axis(Axis((0.0, 0.0, 1.0), Limit(0.0, 1.0), mimic=Mimic('hand_joint', 2.0, 0.1)))
    report = Report()
    mimic = written(robot, report).find('joint/axis/mimic')
    assert mimic is not None and mimic.get('joint') == 'hand_joint' and not report.notes
    assert [child.text for child in mimic] == ['2', '0.1', '0']
    old = written(robot, report, '1.10')
    assert old.find('joint/axis/mimic') is None
    assert dict(old.find('joint/{urn:opencv_tools:urdf}mimic').attrib) == {  # type: ignore
        'joint': 'hand_joint', 'multiplier': '2', 'offset': '0.1'}
    assert [note.level for note in report.notes] == ['preserved']
    for version in ('1.10', '1.11'):
        assert reread(robot, version).joints[0].axes == robot.joints[0].axes


@pytest.mark.parametrize('kind', ['floating', 'planar'])
def test_unsupported_joint_types(kind: str) -> None:
    report = Report()
    model = written(urdf_robot(kind), report, relative=True)
    assert not model.findall('joint')
    assert model.find('{urn:opencv_tools:urdf}joint').get('type') == kind  # type: ignore
    assert model.xpath('link[@name="arm"]/pose/@relative_to') == ['base']
    assert [note.name for note in report.warnings] == ['arm_joint', 'hand_joint']


def test_fixed_and_continuous_joints_in_old_versions() -> None:
    report = Report()
    model = written(urdf_robot('fixed'), report, '1.4')
    assert model.xpath('joint/@type') == ['revolute'] * 2
    assert [child.text for child in model.find('joint/axis/limit')] == ['0', '0']  # type: ignore
    assert len(report.warnings) == 2
    model = written(urdf_robot('continuous'), report, '1.5')
    assert model.xpath('joint/@type') == ['revolute'] * 2 and not model.xpath('//limit')
    assert len(report.warnings) == 2


def test_removed_limits_of_a_continuous_joint() -> None:
    robot = urdf_robot('continuous')
    rest = etree.fromstring('<joint xmlns:c="urn:opencv_tools:preserved"><axis c:part="true">'
                            '<limit><lower>-1</lower><effort>2</effort></limit></axis></joint>')
    robot = replace(robot, joints=tuple(
        replace(one, extension=Extension(sdf=rest)) for one in robot.joints))
    for version, lower in (('1.5', None), ('1.6', '-1')):
        report = Report()
        made = written(robot, report, version).find('joint')
        assert made is not None and made.findtext('axis/limit/lower') == lower
        assert made.findtext('axis/limit/effort') == '2'
        reported = [note.element for note in report.warnings]
        assert reported == ([] if lower else ['lower'] * len(robot.joints))


def test_round_trip_of_an_unlimited_revolute_joint() -> None:
    robot = with_axis(Axis((0.0, 0.0, 1.0), Limit(effort=1.0, velocity=2.0)))
    for version in VERSIONS:
        result = reread(robot, version).joints[0]
        assert (result.type, result.axes) == ('revolute', robot.joints[0].axes)
        assert written(robot, version=version).find('joint').get('type') == (  # type: ignore
            'revolute')
