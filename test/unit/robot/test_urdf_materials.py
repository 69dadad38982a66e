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

"""Materials of URDF: names, colours and textures."""

from __future__ import annotations

from opencv_tools.robot.geometry import Material, Sphere
from opencv_tools.robot.model import FrameId, Link, MODEL, Placement, Robot, Shape
from opencv_tools.robot.pose import Pose
from opencv_tools.robot.xml.report import Report
import pytest
from rows import each_row
from urdf_models import BLACK, BOX, check_error, ENDS, read, RED, round_trip, visual, written


@pytest.mark.parametrize(('content', 'location', 'message'), [
    (visual(BOX + '<material name="m">\n<color rgba="1 1 1"/></material>'), '2: <color>',
     "rgba='1 1 1' is not 4 finite numbers"),
    (visual(BOX + '<material name="m">\n<color/></material>'), '2: <color>', 'rgba='),
])
def test_errors(content: str, location: str, message: str) -> None:
    check_error(content, location, message)


@each_row(('content', 'material'), [
    ('<material name="m"><color rgba="1 0 0 1"/></material>',
     Material(name='m', color=RED, ambient=RED, specular=BLACK, emissive=BLACK)),
    ('<material name=""><color rgba="1 0 0 1"/></material>', Material(name='', color=RED,
                                                                      ambient=RED, specular=BLACK,
                                                                      emissive=BLACK)),
    ('<material><texture filename="t.png"/></material>', Material(texture='t.png')),
    ('<material name="shared"/>', Material(name='shared', color=BLACK, ambient=BLACK,
                                           specular=BLACK, emissive=BLACK, texture='t')),
    ('<material name="other"/>', Material(name='other', color=RED, ambient=RED, specular=BLACK,
                                          emissive=BLACK)),
    ('<material name="m"><color rgba="1 0 0 1"/></material><preserved:sdf><material>'
     '<ambient>0 0 0 1</ambient></material></preserved:sdf>', Material(name='m', color=RED,
                                                                       ambient=BLACK)),
    ('<preserved:sdf><material><emissive>0 0 0 1</emissive></material></preserved:sdf>',
     Material(emissive=BLACK)),
    ('<preserved:sdf><material/></preserved:sdf>', Material()),
    ('', None),
])
def test_materials_in_a_round_trip(content: str, material: Material | None) -> None:
    model = read(visual(f'{BOX}{content}') + '<material name="shared"><color rgba="0 0 0 1"/>'
                 '<texture filename="t"/></material><link name="b"><visual>' + BOX
                 + '<material name="other"><color rgba="1 0 0 1"/></material></visual></link>'
                 f'<joint name="j" type="fixed">{ENDS}</joint>')
    assert model.links[0].visuals[0].material == material
    assert round_trip(model).links == model.links


def test_one_appearance_for_each_name() -> None:
    shapes = tuple(Shape(name=name, placement=Placement(Pose(), FrameId('link', 'a')),
                         geometry=Sphere(1.0),
                         material=Material(name=material, color=color, ambient=color,
                                           specular=BLACK, emissive=BLACK))
                   for name, material, color in (('', 'm', RED), ('x', 'm', BLACK),
                                                 ('', '', RED), ('', '', BLACK), ('', 'm', RED)))
    report = Report()
    model = Robot(name='r',
                  links=(Link(name='a', placement=Placement(Pose(), MODEL), visuals=shapes),))
    names = [one.get('name') for one in written(model, report).iter('material')]
    assert names == ['m', 'a_x', 'a_visual', 'a_visual_1', 'm']
    assert [note.name for note in report.warnings] == ['m']
