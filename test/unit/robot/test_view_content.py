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

"""Documents of robots for the page, and the numbers of both conventions."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
from opencv_tools.robot.view import document
from opencv_tools.robot.view.content import read_content, to_json, ViewOptions
from opencv_tools.robot.xml.document import DescriptionError
from opencv_tools.robot.xml.report import Report
import pytest
from rows import each_row

ROOT = Path(__file__).parents[3]
URDF, SDF = ROOT / 'urdf' / 'my_arm.urdf', ROOT / 'sdf' / 'my_arm' / 'model.sdf'


def read(*paths: Path) -> dict[str, Any]:
    return read_content(ViewOptions(paths=[*map(str, paths)]), Report()).document


def test_numbers_of_both_conventions() -> None:
    files = read(URDF)['robots'][0]['files']
    assert files['given'] == 'urdf'
    assert files['urdf']['name'] == 'my_arm.urdf'
    assert files['urdf']['text'] == URDF.read_text()
    elbow = files['urdf']['poses']['joint']['elbow']
    assert (elbow['numbers'], elbow['in']) == ([0, 0, 0.4, 0, 0, 0], ['link', 'upper_arm'])
    assert '<joint name="elbow"' in URDF.read_text().splitlines()[elbow['line'] - 1]
    assert files['sdf']['name'] == 'my_arm.sdf, written by urdf_to_sdf'
    forearm = files['sdf']['poses']['link']['forearm']
    assert (forearm['numbers'], forearm['in']) == ([0, 0, 0.5, 0, 0, 0], ['model', ''])
    assert '<link name="forearm"' in files['sdf']['text'].splitlines()[forearm['line'] - 1]


def test_file_of_a_model_folder() -> None:
    files = read(SDF.parent)['robots'][0]['files']
    assert (files['given'], files['sdf']['text']) == ('sdf', SDF.read_text())
    assert files['urdf']['name'] == 'my_arm.urdf, written by sdf_to_urdf'


def test_expanded_file_of_xacro() -> None:
    files = read(ROOT / 'urdf' / 'my_robot.urdf.xacro')['robots'][0]['files']
    assert files['urdf']['name'] == 'my_robot.urdf, expanded from my_robot.urdf.xacro'
    assert files['sdf']['name'] == 'my_robot.sdf, written by urdf_to_sdf'
    assert 'xacro' not in files['urdf']['text']
    line = files['urdf']['poses']['joint']['base_joint']['line']
    assert '<joint name="base_joint"' in files['urdf']['text'].splitlines()[line - 1]


def test_robot_that_one_convention_does_not_support() -> None:
    files = read(ROOT / 'test/data/robots/sdf/warning_loop.sdf')['robots'][0]['files']
    assert files['sdf']['text']
    assert set(files['urdf']) == {'name', 'text', 'poses', 'reason'}


def test_two_equal_robots() -> None:
    found = read(URDF, SDF)
    assert len(found['robots']) == 2
    assert found['differences'] == []


def test_differences_with_their_parts(tmp_path: Path) -> None:
    other = tmp_path / 'other.urdf'
    other.write_text(URDF.read_text().replace('<sphere radius="', '<sphere radius="1'))
    found = read(URDF, other)['differences']
    tool = [link['name'] for link in read(URDF)['robots'][0]['links']].index('tool')
    assert found
    assert {(one['element'], *map(tuple, one['parts'])) for one in found} <= {
        (kind, (tool, 0), (tool, 0)) for kind in ('visual', 'collision')}
    assert all(one['a'] != one['b'] for one in found)


def test_difference_of_the_second_shape(tmp_path: Path) -> None:
    paths = tmp_path / 'a.urdf', tmp_path / 'b.urdf'
    for path, name in zip(paths, ('', ' name="v"')):
        for radius in (1, 2):
            shape = '<visual{}><geometry><sphere radius="{}"/></geometry></visual>'.format
            path.with_stem(f'{path.stem}{radius}').write_text(
                f'<robot name="r"><link name="m"/><link name="l">{shape("", 1)}'
                f'{shape(name, radius)}</link><joint name="j" type="fixed"><parent link="m"/>'
                '<child link="l"/></joint></robot>')
        found = read(*(path.with_stem(f'{path.stem}{radius}') for radius in (1, 2)))
        assert [[*map(tuple, one['parts'])] for one in found['differences']] == [[(1, 1)] * 2]


def test_link_of_one_robot_only(tmp_path: Path) -> None:
    other = tmp_path / 'other.urdf'
    other.write_text(URDF.read_text().replace(
        '</robot>', '<link name="new"/><joint name="more" type="fixed"><parent link="tool"/>'
        '<child link="new"/></joint></robot>'))
    found = read(URDF, other)['differences']
    assert [(one['name'], one['a'], one['b'], [*map(list, one['parts'])]) for one in found] == [
        ('new', 'no', 'yes', [[-1, -1], [4, -1]]), ('more', 'no', 'yes', [[-1, -1], [3, -1]])]


def test_ellipsoid_of_a_body() -> None:
    # A homogeneous ellipsoid of 5 kg with the radii 1, 2 and 3 m.
    inertia = 'ixx="13" iyy="10" izz="5" ixy="0" ixz="0" iyz="0"'
    found = read_text(f'<link name="l"><inertial><mass value="5"/><inertia {inertia}/></inertial>'
                      '</link>')['links'][0]['inertial']['ellipsoid']
    assert sorted(found['radii']) == pytest.approx([1, 2, 3])


def test_axes_of_an_ellipsoid() -> None:
    inertia = np.array([[11.0, 1.0, -1.5], [1.0, 10.0, 2.0], [-1.5, 2.0, 6.0]])
    text = ' '.join(f'i{"xyz"[row]}{"xyz"[column]}="{inertia[row, column]}"'
                    for row in range(3) for column in range(row, 3))
    found = read_text(f'<link name="l"><inertial><mass value="5"/><inertia {text}/></inertial>'
                      '</link>')['links'][0]['inertial']['ellipsoid']
    axes, squares = np.array(found['pose'][:9]).reshape(3, 3), np.square(found['radii'])
    assert np.linalg.det(axes) == pytest.approx(1)
    assert axes @ np.diag(squares.sum() - squares) @ axes.T == pytest.approx(inertia)


@each_row('inertia', ['0" iyy="0" izz="0', '1e300" iyy="1" izz="1',
                      '-1" iyy="-1" izz="-1', '1" iyy="1" izz="5'])
def test_inertial_without_an_ellipsoid_or_with_a_flat_one(inertia: str) -> None:
    found = read_text(f'<link name="l"><inertial><mass value="5"/><inertia ixx="{inertia}" '
                      'ixy="0" ixz="0" iyz="0"/></inertial></link>')
    to_json(found)


@pytest.mark.parametrize(('name', 'geometry'), [
    ('ellipsoid', {'kind': 'ellipsoid', 'radii': (0.1, 0.2, 0.3)}),
    ('cone', {'kind': 'cone', 'radius': 0.1, 'length': 0.3}),
    ('polyline', {'kind': 'none', 'reason': 'the page does not draw <polyline>'})])
def test_visual_that_only_sdf_has(name: str, geometry: dict[str, Any]) -> None:
    found = read(ROOT / f'test/data/robots/sdf/warning_{name}.sdf')['robots'][0]
    assert found['links'][0]['visuals'][0]['geometry'] == geometry


def test_plane_with_a_wrong_size(tmp_path: Path) -> None:
    text = (ROOT / 'test/data/robots/sdf/warning_plane.sdf').read_text()
    for size, kind, reason in (('10 10', 'plane', ''),
                               ('10', 'none', "<plane>: '10' is not 2 finite numbers")):
        (tmp_path / 'plane.sdf').write_text(text.replace('10 10', size))
        shape, = read(tmp_path / 'plane.sdf')['robots'][0]['links'][0]['collisions']
        assert shape['geometry']['kind'] == kind
        assert reason in shape['geometry'].get('reason', '')


def test_frames_with_what_they_are_attached_to() -> None:
    found = read(ROOT / 'test/data/robots/sdf/ok_frames.sdf')['robots'][0]
    assert [(frame['name'], frame['attached_to'], found['links'][frame['link']]['name'],
             frame['in_link'][:3]) for frame in found['frames']] == [
        ('origin', ['model', ''], 'base', [0, 0, 0]),
        ('tool', ['link', 'arm'], 'arm', [0.5, 0, 0]),
        ('tip', ['frame', 'tool'], 'arm', [0.5, 0, 0.25]),
        ('start', ['link', 'arm'], 'arm', [-1, 0, 2])]
    assert found['files']['sdf']['poses']['frame']['start']['in'] == ['link', 'base']


def test_pose_that_is_too_far_away() -> None:
    joints = ''.join(f'<link name="l{number + 1}"/><joint name="j{number}" type="fixed">'
                     f'<parent link="l{number}"/><child link="l{number + 1}"/>'
                     '<origin xyz="1e308 0 0"/></joint>' for number in range(3))
    with pytest.raises(DescriptionError, match='too far away'):
        read_text(f'<link name="l0"/>{joints}')


def test_robot_with_too_many_links(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(document, 'MAX_LINKS', 1)
    with pytest.raises(DescriptionError, match='has 2 links, but the page shows 1 at most'):
        read_text('<link name="a"/><link name="b"/><joint name="j" type="fixed"><parent link="a"/>'
                  '<child link="b"/></joint>')


def test_text_inside_of_an_element_of_html() -> None:
    text = to_json({'name': '</script><!-- & -->'})
    assert not {'<', '>', '&'} & {*text}
    assert json.loads(text) == {'name': '</script><!-- & -->'}


def read_text(text: str) -> dict[str, Any]:
    from opencv_tools.robot.urdf.reader import read_urdf
    from opencv_tools.robot.view.document import robot_document
    from opencv_tools.robot.view.mesh_files import MeshFiles
    from opencv_tools.robot.xml.document import parse
    report = Report()
    robot = read_urdf(parse(f'<robot name="r">{text}</robot>'.encode(), '', report), report)
    return robot_document(robot, MeshFiles())
