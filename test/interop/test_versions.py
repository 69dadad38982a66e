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

"""Attributes and elements in other SDF versions than their own, compared with libsdformat."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from opencv_tools.robot.sdf.reader import read_sdf
from opencv_tools.robot.xml.document import parse
from opencv_tools.robot.xml.report import Report
import pytest
from test_parsers import compare, run_libsdformat

VERSIONS = ('1.4', '1.5', '1.6', '1.7', '1.8', '1.9')
MASS = '<inertial><mass>1</mass></inertial>'
TURNED = '0 2 0 1 0.5 0'


def link(name: str, pose: str, content: str = '') -> str:
    """Return a link with the element ``<pose>``."""
    mass = '' if '<inertial' in content else MASS
    return f'<link name="{name}">{pose}{mass}{content}</link>'


def hinge(child: str, content: str, kind: str = 'revolute', parent: str = 'base') -> str:
    """Return a joint."""
    return (f'<joint name="to_{child}" type="{kind}"><parent>{parent}</parent>'
            f'<child>{child}</child>{content}</joint>')


def turning(number: int, xyz: str, *more: str, pose: str = '') -> str:
    """Return a rotated link and its parent joint with an axis."""
    return link(f'wheel_{number}', f'<pose>{TURNED}</pose>') + hinge(
        f'wheel_{number}', f'{pose}<axis>{xyz}{"".join(more)}<limit><lower>-1</lower><upper>1'
        '</upper></limit></axis>')


def in_model(text: str) -> str:
    """Return the element for an axis in the model frame."""
    return f'<use_parent_model_frame>{text}</use_parent_model_frame>'


BASE = link('base', '<pose>1 0 0 0 0 1</pose>')
FRAME = '<frame name="tip" attached_to="base"><pose relative_to="{}">0 0 1 0.3 0 0</pose></frame>'
ROBOTS: Mapping[str, str] = {
    'poses': ''.join(link(f'l{number}', f'<pose {attributes}>{TURNED}</pose>')
                     for number, attributes in enumerate((
                         'relative_to="base"', 'frame="base"', 'frame="base" relative_to="l0"',
                         'frame="" relative_to="base"', 'relative_to=""', 'degrees="true"',
                         'rotation_format="euler_rpy"'))),
    'quaternions': link('l', '<pose rotation_format="quat_xyzw">0 2 0 0 0 0.6 0.8</pose>'),
    'parts of a link': link('l', f'<pose>{TURNED}</pose>', (
        '<inertial><pose frame="base">0 0 1 0 0 0</pose><mass>2</mass></inertial><visual name="v">'
        '<pose relative_to="base">0 0 1 0 0 0</pose><geometry><capsule><radius>1</radius><length>2'
        '</length></capsule></geometry></visual>')),
    'inertials': link('l', f'<pose>{TURNED}</pose>', (
        '<inertial><pose relative_to="base">0 0 1 0 0 0</pose><mass>2</mass></inertial>')),
    'axes': ''.join((
        turning(0, '<xyz expressed_in="__model__">0 1 0</xyz>'),
        turning(1, '<xyz expressed_in="base">0 1 0</xyz>'),
        turning(2, '<xyz expressed_in="wheel_2">0 1 0</xyz>', pose='<pose>0 0 0 0.7 0 0</pose>'),
        turning(3, '<xyz expressed_in="base">0 1 0</xyz>', in_model('false')),
        turning(4, '<xyz expressed_in="base">0 1 0</xyz>', in_model('true')),
        turning(5, '<xyz>0 1 0</xyz>', in_model('1')),
        turning(6, '<xyz>0 1 0</xyz>', in_model('false')),
        turning(7, '<xyz>0 1 0</xyz>', in_model('false'), in_model('true')),
        turning(8, '<xyz>0 1 0</xyz>'))),
    'two axes': link('l', f'<pose>{TURNED}</pose>') + hinge(
        'l', '<axis><xyz>0 1 0</xyz></axis><axis2><xyz expressed_in="base">1 0 0</xyz></axis2>',
        'universal'),
    'joints': link('l', f'<pose>{TURNED}</pose>') + hinge(
        'l', '<pose frame="base">0 0 1 0.2 0 0</pose><axis><xyz>0 1 0</xyz></axis>', 'continuous')
    + link('m', '') + hinge('m', '<pose relative_to="l">0 0 1 0.2 0 0</pose>', 'fixed'),
    'frames': FRAME.format('base') + link('l', '<pose relative_to="tip">0 0 0 1 0 0</pose>')
    + hinge('l', '<axis><xyz expressed_in="tip">0 1 0</xyz></axis>', parent='tip'),
    'a mimic': turning(0, '<xyz>0 0 1</xyz>') + turning(
        1, '<xyz>0 0 1</xyz>', '<mimic joint="to_wheel_0"><multiplier>2</multiplier></mimic>'),
    'models': '<model name="arm" placement_frame="hand" canonical_link="hand">'
    '<pose relative_to="base">0 0 1 0 0 1</pose>' + link('hand', '<pose>1 0 0 0 0 0</pose>')
    + turning(0, '<xyz>0 1 0</xyz>', pose='').replace('base', 'hand') + '</model>',
    'includes': '<include merge="true"><uri>model://part</uri><name>one</name>'
    '<pose relative_to="base">0 0 1 0 0 0</pose></include><include><uri>model://part</uri>'
    '<name>two</name><placement_frame>lid</placement_frame><pose>0 0 1 0 0 0</pose></include>',
}
PART = f'<model name="part">{link("box", "")}{link("lid", "<pose>0 1 0 0 0 0</pose>")}</model>'


@pytest.fixture(scope='module')
def parsed(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str, str], tuple[Path, Any]]:
    """Return a function for the file of a robot in a version, and its result of libsdformat."""
    folder = tmp_path_factory.mktemp('versions')
    paths = {(name, version): folder / version / f'{name}.sdf'
             for name in ROBOTS for version in VERSIONS}
    for version in VERSIONS:
        part = folder / version / 'part'
        part.mkdir(parents=True)
        (part / 'model.sdf').write_text(f'<sdf version="{version}">{PART}</sdf>')
        (part / 'model.config').write_text(
            f'<model><name>part</name><sdf version="{version}">model.sdf</sdf></model>')
    for (name, version), path in paths.items():
        path.write_text(f'<sdf version="{version}"><model name="m" canonical_link="base">{BASE}'
                        f'{ROBOTS[name]}</model></sdf>')
    results = run_libsdformat(list(paths.values()))
    return lambda name, version: (paths[name, version], results[str(paths[name, version])])


@pytest.mark.parametrize('version', VERSIONS)
@pytest.mark.parametrize('name', ROBOTS)
def test_attributes_of_other_versions(
        name: str, version: str, parsed: Callable[[str, str], tuple[Path, Any]]) -> None:
    path, result = parsed(name, version)
    assert result['valid'], result['messages']
    compare(read_sdf(parse(path.read_bytes(), str(path), Report()), Report()), result)
