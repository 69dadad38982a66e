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

"""Axes and frames of SDF, which a URDF may contain."""

from __future__ import annotations

import math

from lxml import etree
from opencv_tools.robot.convert import convert_to_sdf, SdfOptions
from opencv_tools.robot.model import Axis, Dynamics, FrameId, Limit, Mimic, MODEL, Placement
from opencv_tools.robot.pose import Pose, Vector
from opencv_tools.robot.sdf.fragments import axis_from_element, axis_to_element, frame_from_element
from opencv_tools.robot.sdf.reader import read_sdf
from opencv_tools.robot.xml.document import parse
from opencv_tools.robot.xml.report import Report
import pytest
from sdf_models import joint, read, reread, TWO, VERSIONS, with_axis, written


@pytest.mark.parametrize(('now', 'expected'), [('0 0 1', (0, 0, 2)), ('0 1 0', (0, 1, 0))])
def test_original_axis_unless_edited(now: str, expected: Vector) -> None:
    robot = read(TWO + joint(f'<axis><xyz urdf:xyz="0 0 2">{now}</xyz></axis>', 'prismatic'))
    assert robot.joints[0].axes[0].xyz == expected


def test_mimic_with_reference() -> None:
    axis = '<axis><mimic joint="k"><multiplier>2</multiplier><offset>1</offset>{}</mimic></axis>'
    leader = '<link name="c"/>' + joint('<axis/>', 'prismatic', 'k', child='c')
    for reference, offset in (('', 1.0), ('<reference>3</reference>', -5.0)):
        robot = read(TWO + leader + joint(axis.format(reference), 'prismatic'), '1.11')
        assert robot.joints[1].axes[0].mimic == Mimic('k', 2.0, offset)


def test_attributes_of_an_omitted_limit_are_lost() -> None:
    # An infinite limit is omitted, and with it its attributes.
    model = read(TWO + joint('<axis><limit><lower odd="1">-1e17</lower><upper>1</upper></limit>'
                             '</axis>', 'revolute'))
    there = convert_to_sdf(model, Report(), SdfOptions(version='1.9'))
    assert [child.tag for child in there.iterfind('model/joint/axis/limit/*')] == ['upper']


def test_axis_and_frame_from_elements() -> None:
    root = parse(b'<x><axis><xyz>0 2 0</xyz></axis><frame name="f" attached_to="a">'
                 b'<pose relative_to="__model__">1 0 0 0 0 0</pose></frame></x>', '', Report())
    assert axis_from_element(root[0]).xyz == (0, 2, 0)
    frame = frame_from_element(root[1], lambda name, element: FrameId('link', name))
    assert frame.attached_to == FrameId('link', 'a')
    assert frame.placement == Placement(Pose((1, 0, 0)), MODEL)


def test_limits_and_dynamics_with_values() -> None:
    axis = written(with_axis(Axis((0.0, 0.0, 1.0), Limit(-1.0, effort=5.0),
                                  Dynamics(friction=0.1)))).find('joint/axis')
    assert axis is not None
    assert [(child.tag, child.text) for child in axis.iter() if not len(child)] == [
        ('xyz', '0 0 1'), ('lower', '-1'), ('effort', '5'), ('friction', '0.1')]


def test_mimic_of_an_axis_by_version() -> None:
    made = axis_to_element(Axis((0.0, 0.0, 2.0), mimic=Mimic('j')), 'axis2', (1, 12))
    assert made.tag == 'axis2' and made.findtext('xyz') == '0 0 1'
    assert made.find('mimic') is not None
    assert axis_to_element(Axis((0.0, 0.0, 2.0), mimic=Mimic('j')), 'axis', (1, 9)).find(
        'mimic') is None


@pytest.mark.parametrize(('effort', 'text'), [(-1.0, None), (math.inf, None), (0.0, '0')])
def test_unlimited_effort(effort: float, text: str | None) -> None:
    robot = with_axis(Axis((0.0, 0.0, 1.0), Limit(-1.0, 1.0, effort, 2.0)))
    assert written(robot).findtext('joint/axis/limit/effort') == text
    for version in VERSIONS:
        assert reread(robot, version).joints[0].axes == robot.joints[0].axes


def test_edited_effort_replaces_the_original() -> None:
    model = written(with_axis(Axis((0.0, 0.0, 1.0), Limit(-1.0, 1.0, -1.0, -1.0))))
    limit = model.find('joint/axis/limit')
    assert limit is not None
    etree.SubElement(limit, 'effort').text = '5'
    root = model.getparent()
    assert root is not None
    result = read_sdf(root, Report()).joints[0]
    assert result.axes[0].limit == Limit(-1.0, 1.0, 5.0, -1.0)
    assert result.extension.sdf is None
