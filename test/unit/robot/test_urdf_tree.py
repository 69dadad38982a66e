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

"""Tree of URDF links: unique names, ends of joints, the world and cycles."""

from __future__ import annotations

from opencv_tools.robot.xml.document import DescriptionError
from opencv_tools.robot.xml.report import Report
import pytest
from rows import each_row
from urdf_models import check_error, ENDS, joint, LINKS, read, round_trip, written


@each_row(('content', 'location', 'message'), [
    ('', '1: <robot>', 'has no <link>'),
    ('<link/>', '1: <link>', 'has no name'),
    ('<link name=" "/>', '1: <link>', 'has no name'),
    ('<link name="a"/>\n<link name="a"/>', '2: <link>', "name='a' is also"),
    (LINKS + '\n<joint type="fixed"/>', '2: <joint>', 'has no name'),
    (joint('', 'fixed') + f'\n<link name="c"/><joint name="j" type="fixed">{ENDS}</joint>',
     '2: <joint>', "name='j' is also"),
    (f'{LINKS}<joint name="j" type="fixed"><child link="b"/></joint>', '1: <joint>',
     "joint 'j' has no <parent link=>"),
    (f'{LINKS}<joint name="j" type="fixed"><parent link="b"/></joint>', '1: <joint>',
     "joint 'j' has no <child link=>"),
    (f'{LINKS}<joint name="j" type="fixed">\n<parent link="x"/><child link="b"/></joint>',
     '2: <parent>', "link='x' does not exist, in joint 'j'"),
    (f'{LINKS}<joint name="j" type="fixed">\n<parent link="a"/><child link="x"/></joint>',
     '2: <child>', "link='x' does not exist"),
    (f'{LINKS}<joint name="j" type="fixed">\n<parent/><child link="b"/></joint>', '2: <parent>',
     'has no link='),
    (f'{LINKS}<joint name="j" type="fixed"><parent link="a"/><child link="a"/></joint>',
     '1: <joint>', "joint 'j' has link 'a' as parent and as child"),
    (joint('', 'fixed') + f'\n<joint name="k" type="fixed">{ENDS}</joint>', '2: <joint>',
     "link 'b' is the child of two joints, 'j' and 'k'"),
    (joint('', 'fixed') + '<joint name="k" type="fixed"><parent link="b"/><child link="a"/>'
     '</joint>', '1: <joint>', "kinematic cycle: 'b' -> 'a' -> 'b'"),
    (joint('', 'fixed') + '<joint name="k" type="fixed"><parent link="b"/><child link="a"/>'
     '</joint><link name="alone"/>', '1: <joint>', 'kinematic cycle'),
])
def test_errors(content: str, location: str, message: str) -> None:
    check_error(content, location, message)


def test_long_cycle_is_shortened() -> None:
    links = ''.join(f'<link name="l{index}"/>' for index in range(100))
    joints = ''.join(f'<joint name="j{index}" type="fixed"><parent link="l{index}"/>'
                     f'<child link="l{(index + 1) % 100}"/></joint>' for index in range(100))
    with pytest.raises(DescriptionError, match=r"cycle: 'l1' -> .*'l5' -> \.\.\. -> 'l1'$"):
        read(links + joints)


def test_missing_world_is_an_empty_link() -> None:
    report = Report()
    model = read('<link name="a"/><joint name="j" type="fixed"><parent link="world"/>'
                 '<child link="a"/></joint>', report)
    assert [note.element for note in report.warnings] == ['joint']
    assert [link.name for link in model.links] == ['a', 'world']
    assert [link.get('name') for link in written(model).iterfind('link')] == ['a', 'world']


def test_world_in_a_round_trip() -> None:
    model = read('<link name="world"/><link name="a"/><joint name="j" type="fixed"><parent '
                 'link="world"/><child link="a"/></joint>')
    assert model.links[0].is_world
    assert round_trip(model) == model
