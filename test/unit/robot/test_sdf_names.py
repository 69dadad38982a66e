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

"""Names of frames in SDF, and canonical links."""

from __future__ import annotations

from opencv_tools.robot.kinematics import attached_links, Kinematics
from opencv_tools.robot.model import FrameId
import pytest
from rows import each_row
from sdf_models import joint, read, TWO


@pytest.mark.parametrize('version', ['1.4', '1.6'])
def test_shared_names_in_old_versions(version: str) -> None:
    visual = '<visual name="v"><geometry/></visual>'
    robot = read(f'<link name="a">{visual * 2}</link><link name="b"><pose frame="x"/></link>'
                 '<link name="x"/>' + joint(name='x'), version)
    assert len(robot.links[0].visuals) == 2
    assert robot.links[1].placement.relative_to == FrameId('link', 'x')


@each_row(('content', 'attributes', 'expected'), [
    (TWO, '', ''), (TWO, 'canonical_link="b"', 'b'), (TWO, 'canonical_link="a"', 'a'),
    ('<model name="n" canonical_link="b">' + TWO + '</model>', '', 'n::b'),
    ('<model name="n">' + TWO + '</model><link name="c"/>', '', ''),
    ('<model name="n">' + TWO + '</model><link name="c"/>', 'canonical_link="n::a"', 'n::a')])
def test_canonical_link(content: str, attributes: str, expected: str) -> None:
    assert read(content, attributes=attributes).canonical_link == expected


def test_static_nested_model_without_links() -> None:
    robot = read('<link name="a"/><model name="n"><pose>1 0 0 0 0 0</pose><static>true</static>'
                 '<frame name="f"><pose>0 2 0 0 0 0</pose></frame></model>' + joint(child='n::f')
                 .replace('>a<', '>world<'))
    assert [frame.name for frame in robot.frames] == ['n::__model__', 'n::f']
    kinematics = Kinematics(robot)
    assert set(attached_links(robot).values()) == {FrameId('link', 'a')}
    assert kinematics.pose(FrameId('frame', 'n::f')).translation == (1, 2, 0)
    assert (robot.joints[0].parent, robot.joints[0].child) == ('world', 'a')
