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

"""SDF in the <gazebo> blocks of URDF."""

from __future__ import annotations

from opencv_tools.robot.xml.document import Element
from opencv_tools.robot.xml.report import Report
from rows import each_row
from urdf_models import joint, LIMIT, read, written


def test_sdf_of_gazebo_blocks_belongs_to_the_model() -> None:
    model = read(joint(LIMIT) + """
        <gazebo><plugin name="p" filename="p.so"/><odd/></gazebo>
        <gazebo reference="a"><sensor name="s" type="imu"><pose>1 0 0 0 0 0</pose></sensor>
        <mu1>1</mu1><gravity>false</gravity></gazebo>
        <gazebo reference="j"><sensor name="f" type="imu"/>
        <provideFeedback>1</provideFeedback></gazebo>""")

    def tags(element: Element | None) -> list[object]:
        return [] if element is None else [child.tag for child in element]

    assert tags(model.extension.sdf) == ['plugin']
    assert tags(model.links[0].extension.sdf) == ['sensor', 'gravity']
    assert tags(model.joints[0].extension.sdf) == ['sensor', 'physics']
    assert model.extension.urdf is not None
    assert [tags(part) for part in model.extension.urdf] == [['odd'], ['mu1']]
    blocks = written(model).findall('gazebo')
    assert [(block.get('reference'), tags(block)) for block in blocks] == [
        (None, ['plugin']), ('a', ['sensor', 'turnGravityOff']),
        ('j', ['sensor', 'provideFeedback']), (None, ['odd']), ('a', ['mu1'])]


@each_row('part', [
    '<plugin name="p"/>', '<plugin name=" " filename="p.so"/>',
    '<sensor name="s" type="imu"><plugin filename="p.so"/></sensor>',
    '<sensor name="s" type="imu"><plugin name="p" filename=" "/></sensor>'])
def test_invalid_plugin_stays_in_its_block(part: str) -> None:
    report = Report()
    model = read(f'<link name="a"/><gazebo reference="a">{part}</gazebo>', report)
    assert 'the element is preserved unchanged' in report.warnings[0].message
    assert model.links[0].extension.sdf is None
    assert model.extension.urdf is not None
    assert len(model.extension.urdf.findall('gazebo/*')) == 1
