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

"""Writer of SDF: links, frames, the world and extensions."""

from __future__ import annotations

from dataclasses import replace

from lxml import etree
from opencv_tools.robot.kinematics import Kinematics
from opencv_tools.robot.model import Extension, Frame, FrameId, Link, MODEL, Placement, Robot
from opencv_tools.robot.pose import Pose
from opencv_tools.robot.sdf.fragments import frame_to_element
from opencv_tools.robot.sdf.writer import write_sdf
from opencv_tools.robot.xml.document import DescriptionError
from opencv_tools.robot.xml.report import Report
import pytest
from sdf_models import reread, TURNED, urdf_robot, written


def test_link_poses_without_zero_poses() -> None:
    model = written(urdf_robot())
    poses = model.xpath('link/pose')
    assert [pose.getparent().get('name') for pose in poses] == ['arm', 'hand']
    assert poses[0].text == '0.1 0.2 0.3 0 0 1.5708' and not poses[0].attrib
    assert model.find('joint/pose') is None
    assert model.findtext('joint/parent') == 'base' and model.findtext('joint/child') == 'arm'


def test_relative_poses_keep_their_numbers() -> None:
    poses = written(urdf_robot(), relative=True).xpath('link/pose')
    assert [(pose.get('relative_to'), pose.text) for pose in poses] == [
        ('base', '0.1 0.2 0.3 0 0 1.5708'), ('arm', '0.1 0.2 0.3 0 0 1.5708')]


def test_relative_poses_need_1_7() -> None:
    with pytest.raises(DescriptionError, match=r'use version 1[.]7'):
        write_sdf(urdf_robot(), Report(), version='1.6', relative=True)


def test_world_is_not_a_link() -> None:
    robot = urdf_robot()
    links = (replace(robot.links[0], name='world'), *robot.links[1:])
    joints = (replace(robot.joints[0], parent='world', placement=Placement(
        TURNED, FrameId('link', 'world'))), robot.joints[1])
    robot = replace(robot, links=links, joints=joints)
    model = written(robot, relative=True)
    assert model.xpath('link/@name') == ['arm', 'hand']
    assert model.findtext('joint/parent') == 'world'
    assert model.xpath('link/pose/@relative_to') == ['arm']
    assert {link.name for link in reread(robot).links} == {'world', 'arm', 'hand'}


def test_errors_of_robots() -> None:
    world = Link(name='world', placement=Placement(Pose(), MODEL))
    with pytest.raises(DescriptionError, match='has no links'):
        written(Robot(name='r', links=(world,)))
    robot = urdf_robot()
    robot = replace(robot, links=(*robot.links[:2], replace(
        world, placement=robot.links[2].placement)), joints=(robot.joints[0], replace(
            robot.joints[1], child='world')))
    with pytest.raises(DescriptionError, match="has the child 'world'"):
        written(robot)


def test_frames_by_version() -> None:
    frame = Frame(name='tip', attached_to=FrameId('link', 'hand'),
                  placement=Placement(TURNED, FrameId('link', 'hand')))
    robot = urdf_robot(frames=(frame,), canonical_link='hand')
    report = Report()
    model = written(robot, report)
    made = model.find('frame')
    assert made is not None and dict(made.attrib) == {'name': 'tip', 'attached_to': 'hand'}
    assert made.findtext('pose') == '0.1 0.2 0.3 0 0 1.5708' and not report.notes
    assert model.get('canonical_link') == 'hand'
    old = written(robot, report, '1.6')
    assert old.find('frame') is None and old.get('canonical_link') is None
    assert [note.element for note in report.warnings] == ['model', 'frame']
    assert reread(robot, '1.6').frames == (frame,)


def test_frame_attached_to_an_unsupported_joint() -> None:
    frame = Frame(name='tip', attached_to=FrameId('joint', 'hand_joint'),
                  placement=Placement(Pose(), FrameId('joint', 'hand_joint')))
    made = written(urdf_robot('floating', frames=(frame,))).find('frame')
    assert made is not None and made.get('attached_to') == 'hand'
    kept = frame_to_element(frame, Kinematics(urdf_robot('floating', frames=(frame,))))
    assert kept.get('attached_to') == 'hand_joint'


def test_restored_and_preserved_extensions() -> None:
    robot = urdf_robot(extension=Extension(
        urdf=etree.fromstring('<robot version="1"><transmission name="t"/></robot>'),
        sdf=etree.fromstring('<model><static>true</static><plugin name="p"/></model>')))
    link = replace(robot.links[0], extension=Extension(
        urdf=etree.fromstring('<link name="x"/>'),
        sdf=etree.fromstring('<link><pose/><sensor><pose relative_to="arm"/></sensor></link>')))
    robot = replace(robot, links=(link, *robot.links[1:]))
    report = Report()
    model = written(robot, report)
    assert model.findtext('static') == 'true'
    kept = model.find('{urn:opencv_tools:preserved}urdf')
    assert kept is not None and kept.find('transmission') is not None
    assert kept.get('version') == '1'
    assert model[0].get('{urn:opencv_tools:urdf}name') == 'x'
    assert [(note.level, note.element) for note in report.notes] == [
        ('preserved', '@version'), ('preserved', 'transmission')]
    assert model.xpath('link/sensor/pose/@relative_to') == ['arm']
    old = written(robot, report, '1.6')
    assert old.xpath('link/sensor/pose/@frame') == ['arm']
    # Extensions are not changed.
    assert link.extension.sdf is not None
    assert link.extension.sdf.xpath('sensor/pose/@relative_to') == ['arm']
