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

"""Values that the SDF parser rejects."""

from __future__ import annotations

from lxml import etree
from opencv_tools.robot.convert import convert_to_sdf, convert_to_urdf
from opencv_tools.robot.sdf.reader import read_sdf
from opencv_tools.robot.urdf.reader import read_urdf
from opencv_tools.robot.xml.document import parse, to_bytes
from opencv_tools.robot.xml.report import Report
import pytest
import robots


@pytest.mark.parametrize(('content', 'words'), robots.PARTS_OF_SDF)
def test_invalid_values_stay_in_gazebo(content: str, words: str) -> None:
    report = Report()
    text = f'<robot name="r"><link name="a"/><gazebo reference="a">{content}</gazebo></robot>'
    robot = read_urdf(parse(text.encode(), '', report), report)
    flaws = [note.message for note in report.warnings]
    root = convert_to_sdf(robot, report, inertial='zero')
    tag = etree.fromstring(content).tag
    if not words:
        assert flaws == [] and root.find(f'model/link/{tag}') is not None
        return
    assert len(flaws) == 1 and words in flaws[0]
    assert root.find(f'model/link/{tag}') is None
    result = read_sdf(parse(to_bytes(root), '', Report()), Report())
    back = convert_to_urdf(result, Report())
    assert back.xpath('gazebo/@reference') == ['a']
    kept, before = back.xpath('gazebo/*')[0], etree.fromstring(content)
    assert [(one.tag, one.attrib, one.text) for one in kept.iter() if not len(one)] == [
        (one.tag, one.attrib, one.text) for one in before.iter() if not len(one)]
