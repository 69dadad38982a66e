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

"""
Each row of docs/element_mapping.md, and all elements of both formats.

Each element is added to a small robot. The robots with and without the element are converted to
the other format and back.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping
from copy import deepcopy
from dataclasses import dataclass
from functools import cache
import itertools
from pathlib import Path
import re

from lxml import etree
from opencv_tools.robot.compare.compare import differences
from opencv_tools.robot.convert import convert_to_sdf, convert_to_urdf, SdfOptions
from opencv_tools.robot.model import Robot
from opencv_tools.robot.renaming import with_original_names
from opencv_tools.robot.sdf.reader import read_sdf
from opencv_tools.robot.sdf.values import GAZEBO
from opencv_tools.robot.urdf.reader import read_urdf
from opencv_tools.robot.urdf.settings import SETTING_OF
from opencv_tools.robot.xml.document import DescriptionError, parse, to_bytes
from opencv_tools.robot.xml.passthrough import PREFIXES
from opencv_tools.robot.xml.report import LOSSY, PRESERVED, Report
import pytest
from rows import failures

Element = etree._Element

TABLES = Path(__file__).parents[3] / 'docs' / 'element_mapping.md'
ROBOTS = Path(__file__).parents[2] / 'data' / 'robots'
CONVERTED = 'converted'
OUTCOMES = {CONVERTED, PRESERVED, LOSSY}

MASS = {
    'urdf': '<inertial><mass value="1"/>'
            '<inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/></inertial>',
    'sdf': '<inertial><mass>1</mass><inertia><ixx>1</ixx><iyy>1</iyy><izz>1</izz></inertia>'
           '</inertial>',
}
# A path leads to the last of several links and joints: to the arm and the elbow.
SMALL_ROBOTS = {
    'urdf': f"""
<robot name="robot" version="1.1">
  <link name="body">{MASS['urdf']}</link>
  <link name="hand">{MASS['urdf']}</link>
  <link name="arm">{MASS['urdf']}</link>
  <joint name="wrist" type="continuous">
    <origin xyz="0 0 0.5" rpy="0 0 1"/>
    <parent link="body"/>
    <child link="hand"/>
    <axis xyz="0 0 1"/>
  </joint>
  <joint name="elbow" type="revolute">
    <parent link="body"/>
    <child link="arm"/>
    <axis xyz="0 0 1"/>
    <limit lower="-1" upper="1" effort="2" velocity="3"/>
  </joint>
</robot>""",
    'sdf': f"""
<sdf version="1.12">
<model name="robot">
  <link name="body">{MASS['sdf']}</link>
  <link name="hand"><pose>0 0 0.5 0 0 1</pose>{MASS['sdf']}</link>
  <link name="arm">{MASS['sdf']}</link>
  <joint name="wrist" type="continuous">
    <parent>body</parent>
    <child>hand</child>
    <axis><xyz>0 0 1</xyz></axis>
  </joint>
  <joint name="elbow" type="revolute">
    <parent>body</parent>
    <child>arm</child>
    <axis><xyz>0 0 1</xyz><limit><lower>-1</lower><upper>1</upper></limit></axis>
  </joint>
</model>
</sdf>""",
}

# Minimal contents of an element, by the end of its path; all other elements are empty.
CONTENTS = {
    'urdf': {
        'visual': '<visual><geometry><sphere radius="1"/></geometry></visual>',
        'collision': '<collision><geometry><sphere radius="1"/></geometry></collision>',
        'geometry/box': '<box size="1 1 1"/>',
        'geometry/cylinder': '<cylinder radius="1" length="1"/>',
        'geometry/capsule': '<capsule radius="1" length="1"/>',
        'geometry/mesh': '<mesh filename="package://robot/a.stl"/>',
        'visual/material': '<material name="red"><color rgba="1 0 0 1"/></material>',
        'material/color': '<color rgba="1 0 0 1"/>',
        'material/texture': '<texture filename="a.png"/>',
        'mimic': '<mimic joint="wrist"/>',
        'dynamics': '<dynamics damping="0.5"/>',
        'origin': '<origin xyz="1 2 3"/>',
        'gazebo': '<gazebo reference="arm"><preserveFixedJoint>1</preserveFixedJoint></gazebo>',
        'gazebo/mu1': '<mu1>0.5</mu1>',
        'safety_controller': '<safety_controller k_velocity="1"/>',
        'gazebo/sensor': '<sensor name="eye" type="imu"/>',
        'gazebo/plugin': '<plugin name="drive" filename="libdrive.so"/>',
        'gazebo/light': '<light name="lamp" type="point"/>',
    },
    'sdf': {
        'visual': '<visual name="shell"><geometry><sphere><radius>1</radius></sphere></geometry>'
                  '</visual>',
        'collision': '<collision name="solid"><geometry><sphere><radius>1</radius></sphere>'
                     '</geometry></collision>',
        'geometry/box': '<box><size>1 1 1</size></box>',
        'geometry/cylinder': '<cylinder><radius>1</radius><length>1</length></cylinder>',
        'geometry/capsule': '<capsule><radius>1</radius><length>1</length></capsule>',
        'geometry/mesh': '<mesh><uri>model://robot/a.stl</uri></mesh>',
        'visual/material': '<material><ambient>1 0 0 1</ambient><diffuse>1 0 0 1</diffuse>'
                           '<specular>0 0 0 1</specular><emissive>0 0 0 1</emissive></material>',
        'material/pbr': '<pbr><metal><albedo_map>a.png</albedo_map></metal></pbr>',
        'axis2': '<axis2><xyz>1 0 0</xyz></axis2>',
        'axis/mimic': '<mimic joint="wrist"><multiplier>2</multiplier></mimic>',
        'axis2/mimic': '<mimic joint="wrist"><multiplier>2</multiplier></mimic>',
        'dynamics': '<dynamics><damping>0.5</damping></dynamics>',
        'axis2/limit': '<limit><lower>-1</lower></limit>',
        'model/frame': '<frame name="tip"/>',
        'sensor': '<sensor name="eye" type="imu"/>',
        'light': '<light name="lamp" type="point"/>',
        'particle_emitter': '<particle_emitter name="smoke" type="point"/>',
        'battery': '<battery name="cell"/>',
        'plugin': '<plugin name="drive" filename="libdrive.so"/>',
        'projector': '<projector name="beam"/>',
        'gripper': '<gripper name="grip"/>',
        'pose': '<pose>1 2 3 0.1 0.2 0.3</pose>',
        'model/include': '<include><uri>parts/camera</uri><pose>0 0 1 0 0 0</pose></include>',
        'model/model': f'<model name="camera"><link name="base">{MASS["sdf"]}</link></model>',
    },
}

# Text of an element or attribute, by the end of its path; the default is 0.25.
TEXTS = {
    'urdf': {
        '@name': 'else', '@xyz': '0.6 0 0.8', '@rpy': '0.1 0.2 0.3', '@size': '1 2 3',
        '@filename': 'package://robot/b.stl', '@scale': '1 2 3', '@rgba': '0.1 0.2 0.3 0.4',
        'joint/@type': 'prismatic', 'parent/@link': 'hand', 'child/@link': 'arm',
        'mimic/@joint': 'wrist', '@reference': 'elbow', 'gravity': 'false', 'fdir1': '1 0 0',
        'maxContacts': '7', 'visibility_flags': '7', 'max_contacts': '7',
        **dict.fromkeys((
            'selfCollide', 'turnGravityOff', 'cfmDamping', 'implicitSpringDamper',
            'provideFeedback'), 'true'),
        'robot/@version': '1.2', 'gazebo/static': 'true',
    },
    'sdf': {
        '@name': 'else', 'pose': '1 2 3 0.1 0.2 0.3', '@relative_to': 'hand',
        '@degrees': 'true', '@rotation_format': 'quat_xyzw', 'size': '1 2 3', 'scale': '1 2 3',
        '@auto': 'true',
        '@canonical_link': 'arm', '@placement_frame': 'hand', '@attached_to': 'arm',
        'joint/@type': 'prismatic', 'joint/parent': 'hand', 'joint/child': 'arm',
        'xyz': '0 0.6 0.8', '@expressed_in': 'turned', 'mimic/@joint': 'wrist',
        'mimic/@axis': 'axis2', '@merge': 'true', 'include/uri': 'parts/camera',
        'include/name': 'else', 'include/placement_frame': 'lens',
        'mesh/uri': 'model://robot/b.stl',
        'material/diffuse': '0.1 0.2 0.3 0.4', 'material/ambient': '0.1 0.2 0.3 0.4',
        'material/specular': '0.1 0.2 0.3 0.4', 'material/emissive': '0.1 0.2 0.3 0.4',
        'sensor/@type': 'camera', 'light/@type': 'spot', 'particle_emitter/@type': 'box',
        'particle_size': '1 2 3', 'direction': '0 0 1', 'fdir1': '1 0 0',
        'radii': '1 2 3', 'heightmap/pos': '1 2 3', 'plane/normal': '0 0 1',
        **dict.fromkeys(('light/diffuse', 'light/specular', 'color_start', 'color_end'),
                        '0.1 0.2 0.3 1'),
        **dict.fromkeys((
            'allow_auto_disable', 'always_on', 'cast_shadows', 'double_sided', 'emitting',
            'enable_metrics', 'enable_wind', 'gravity', 'kinematic', 'lighting', 'loop',
            'must_be_base_link', 'provide_feedback', 'self_collide', 'static',
            'submesh/center', 'use_terrain_paging', 'visualize'),
            'true'),
    },
}

# Elements that are restored with the same meaning but other numbers.
REWRITTEN = re.compile(
    r'model/@placement_frame|model/frame/pose|model/joint/axis2/(xyz|mimic)')


@dataclass(frozen=True)
class Row:
    """
    A row of a table.

    :param paths: the paths of the row, without alternatives.
    :param outcomes: a subset of ``OUTCOMES``.
    """

    paths: tuple[str, ...]
    outcomes: frozenset[str]
    text: str


def _rows(language: str) -> list[Row]:
    rows = []
    heading = {'urdf': 'element of URDF', 'sdf': 'element of SDF'}[language]
    table = TABLES.read_text().split(f'| {heading} |')[1].split('\n\n')[0]
    for line in table.splitlines()[2:]:
        first, outcomes, _ = (cell.strip() for cell in line.strip('|').split('|', 2))
        rows.append(Row(tuple(_alternatives(first.strip('`'))),
                        frozenset(outcomes.split(', ')), line))
    return rows


def _alternatives(text: str) -> Iterator[str]:
    parts = [part.split(',') for part in re.split(r'[{}]', text)]
    return map(''.join, itertools.product(*parts))


ROWS = {language: _rows(language) for language in SMALL_ROBOTS}
LISTED = {language: [line for line in (ROBOTS / f'{language}_elements.txt').read_text().split('\n')
                     if line and not line.startswith('#')] for language in SMALL_ROBOTS}


@cache
def _row(language: str, path: str) -> Row | None:
    """Return the row of a path: its own, or the longest that includes it by ``/**``."""
    best: tuple[int, bool, Row] | None = None
    for row in ROWS[language]:
        for pattern in row.paths:
            stem = pattern.removesuffix('/**')
            fits = path == stem or (stem != pattern and path.startswith(f'{stem}/'))
            if fits and (best is None or (len(stem), path == pattern) > best[:2]):
                best = len(stem), path == pattern, row
    return best[2] if best else None


PATHS = [(language, path) for language in SMALL_ROBOTS
         for path in dict.fromkeys([*LISTED[language], *(
             one.removesuffix('/**') for row in ROWS[language] for one in row.paths)])]


def test_format_of_the_tables() -> None:
    for language, rows in ROWS.items():
        assert len(rows) > 50
        paths = [path for row in rows for path in row.paths]
        assert len(set(paths)) == len(paths), 'an element has two rows'
        for row in rows:
            assert row.outcomes <= OUTCOMES and row.outcomes, row.text
            for path in row.paths:
                stem = path.removesuffix('/**')
                assert any(f'{one}/'.startswith(f'{stem}/') for one in LISTED[language]), row.text


@pytest.mark.parametrize('language', SMALL_ROBOTS)
def test_row_of_every_element(language: str) -> None:
    assert [path for path in LISTED[language] if _row(language, path) is None] == []


def test_rows_of_elements_in_gazebo() -> None:
    for owner, tags in GAZEBO.items():
        path = 'model' if owner == 'model' else f'model/{owner}'
        for tag in tags - {'plugin'}:
            row = _row('sdf', f'{path}/{tag}')
            assert row and row.outcomes == {PRESERVED} and '<gazebo' in row.text


@dataclass(frozen=True)
class Outcome:
    """A robot in the other format: all of it, what is not preserved, and what is."""

    there: Element
    report: Report
    plain: str
    preserved: Counter[str]


def _outcome(language: str, root: Element) -> Outcome:
    there, report = _converted(language, root)
    return Outcome(there, report, _plain(language, there), _preserved(language, there))


@cache
def _outcome_of(language: str, text: bytes) -> Outcome:
    """Return the outcome of a robot without the tested element, which many elements share."""
    return _outcome(language, etree.fromstring(text))


# Without its own row, an element belongs to that of an outer element.
OWN_ROWS = [(language, path) for language, path in PATHS if any(
    path == one.removesuffix('/**') for row in ROWS[language] for one in row.paths)]
OTHERS = [pair for pair in PATHS if pair not in OWN_ROWS]
BY_ROW = pytest.mark.parametrize('pairs', [
    [*OWN_ROWS, *OTHERS[::8]], OTHERS], ids=['elements of the tables', 'other elements'])


@pytest.mark.quick_cases(1)
@BY_ROW
def test_conversion_of_every_element(pairs: list[tuple[str, str]]) -> None:
    assert failures(_check_conversion, pairs) == []


def _check_conversion(language: str, path: str) -> None:
    row = _row(language, path)
    assert row is not None
    with_it, without = (_built(language, one, path) for one in (path, _above(language, path, row)))
    bare = etree.tostring(without, method='c14n')
    found = _outcome(language, with_it)
    _check_round_trip(language, path, row, with_it, found.there)
    if etree.tostring(with_it, method='c14n') == bare:  # the element is required
        return
    found_bare = _outcome_of(language, bare)
    plain = found.plain != found_bare.plain
    if CONVERTED in row.outcomes:
        assert plain, 'makes no difference to the other format'
    elif row.outcomes == {PRESERVED}:
        assert not plain, 'makes a difference to the other format'
    kept, kept_without = found.preserved, found_bare.preserved
    if PRESERVED in row.outcomes:
        assert kept != kept_without, 'is not preserved'
        assert path.endswith('@name') or _notes(found.report, PRESERVED)
    else:
        name = path.rpartition('/')[2].lstrip('@')
        assert kept[name] == kept_without[name], 'is preserved'
    reported = _notes(found.report, LOSSY) - _notes(found_bare.report, LOSSY)
    assert bool(reported) == (LOSSY in row.outcomes), reported


@pytest.mark.quick_cases(1)
@BY_ROW
def test_single_element_of_which_nothing_is_read(pairs: list[tuple[str, str]]) -> None:
    assert failures(_check_unread_element, (
        (language, path) for language, path in pairs if '/' in path and '@' not in path)) == []


def _check_unread_element(language: str, path: str) -> None:
    root = _built(language, path, path)
    top = root if language == 'urdf' else root[0]
    element = top.findall('/'.join(path.split('/')[1:]))[-1]
    name = element.get('name')
    element.clear()
    element.attrib.update({'note': 'x', **({'name': name} if name else {})})
    try:
        there, _ = _converted(language, root)
        back, _ = _converted('sdf' if language == 'urdf' else 'urdf', there)
    except DescriptionError:  # it needs more than its presence
        return
    back = back if language == 'urdf' else back[0]
    assert len(_at(back, path)) <= len(_at(top, path))


def _above(language: str, path: str, row: Row) -> str:
    """Return the nearest enclosing path with another row."""
    while '/' in path and _row(language, path) == row:
        path = path.rpartition('/')[0]
    return path


def _by_end(table: Mapping[str, str], path: str) -> str | None:
    return next((table[end] for end in sorted(table, key=len, reverse=True)
                 if path == end or path.endswith(f'/{end}')), None)


def _built(language: str, path: str, tested: str) -> Element:
    """Build a robot with the element of a path, and with what the tested element needs."""
    root = etree.fromstring(SMALL_ROBOTS[language], etree.XMLParser(remove_blank_text=True))
    element = top = root if language == 'urdf' else root[0]
    steps = path.split('/')[1:]
    if 'axis2' in steps:
        top.findall('joint')[-1].set('type', 'universal')
    if 'gazebo' in tested.split('/'):  # some of its elements belong to collisions
        for shape in ('collision', 'visual'):
            top.findall('link')[-1].append(etree.fromstring(CONTENTS['urdf'][shape]))
    if '@expressed_in' in steps:
        top.append(etree.fromstring('<frame name="turned"><pose>0 0 0 1 0 0</pose></frame>'))
    done = path.split('/')[0]
    for step in steps:
        done += f'/{step}'
        if step.startswith('@'):
            _set(element, step, str(_by_end(TEXTS[language], done) or '0.25'), done, top)
            break
        element = _child(language, element, step, done)
    else:
        inside = any(one.startswith(f'{path}/') for one in LISTED[language])
        text = _by_end(TEXTS[language], path)
        if text or not (len(element) or element.attrib or inside):
            element.text = text or '0.25'
    if 'gazebo' in steps and ('joint', steps[-1]) in SETTING_OF:
        top.findall('gazebo')[-1].set('reference', 'elbow')
    if path.endswith('gazebo/static'):  # applies to the whole robot
        del top.findall('gazebo')[-1].attrib['reference']
    _connect_nested_models(top)
    return root


def _child(language: str, element: Element, step: str, done: str) -> Element:
    found = element.findall(step)
    if found:
        return found[-1]
    if element.tag == 'geometry':
        element.clear()
    filled = _by_end(CONTENTS[language], done)
    child = etree.fromstring(filled) if filled else etree.Element(step)
    element.append(child)
    return child


def _set(element: Element, step: str, value: str, path: str, top: Element) -> None:
    if path.endswith('/link/@name'):  # and its references
        for end in top.findall('joint')[-1].findall('child'):
            end.text = value if end.text else None
            if end.get('link'):
                end.set('link', value)
    element.set(step[1:], value)
    if step == '@rotation_format':
        element.text = '1 2 3 0 0 0.6 0.8'


def _connect_nested_models(top: Element) -> None:
    """Connect the links of nested models to the other links."""
    for inner in (*top.findall('include'), *top.findall('model')):
        name = inner.findtext('name') or inner.get('name') or 'camera'
        joint = etree.SubElement(top, 'joint', name='mount', type='fixed')
        etree.SubElement(joint, 'parent').text = 'body'
        merged = inner.get('merge') == 'true'
        etree.SubElement(joint, 'child').text = 'base' if merged else f'{name}::base'


def _read(language: str, root: Element, report: Report) -> Robot:
    root = parse(to_bytes(deepcopy(root)), 'robot', report)
    if language == 'urdf':
        return read_urdf(root, report)
    return with_original_names(read_sdf(root, report, search=[str(ROBOTS / 'sdf')]))


def _converted(language: str, root: Element) -> tuple[Element, Report]:
    report = Report()
    robot = _read(language, root, report)
    if language == 'urdf':
        return convert_to_sdf(robot, report, SdfOptions(version='1.12')), report
    return convert_to_urdf(robot, report), report


def _check_round_trip(language: str, path: str, row: Row, root: Element, there: Element) -> None:
    other = 'sdf' if language == 'urdf' else 'urdf'
    back, _ = _converted(other, there)
    original, restored = (_read(language, one, Report()) for one in (root, back))
    assert differences(original, restored, samples=1, tolerance=1e-12) == []
    if not any('::' in link.name for link in original.links):
        for kind in ('links', 'joints', 'frames'):
            names = ([thing.name for thing in getattr(robot, kind)]
                     for robot in (original, restored))
            assert next(names) == next(names)
    if row.outcomes & {PRESERVED} and CONVERTED not in row.outcomes and not REWRITTEN.search(path):
        top = (root, back) if language == 'urdf' else (root[0], back[0])
        assert _at(top[0], path)
        assert set(_at(top[0], path)) <= set(_at(top[1], path)), 'is not restored'


def _at(top: Element, path: str) -> list[str]:
    """Return the values of all elements or attributes at a path."""
    inside, _, attribute = '/'.join(['.', *path.split('/')[1:]]).partition('/@')
    found = top.findall(inside)
    if attribute:
        return [value for element in found if (value := element.get(attribute)) is not None]
    return [etree.tostring(_stripped(element), method='c14n').decode() for element in found]


def _stripped(element: Element) -> Element:
    """Copy an element without white space around its texts."""
    copy = deepcopy(element)
    copy.tail = None
    for inner in copy.iter():
        inner.text = (inner.text or '').strip() or None
        inner.tail = None
    etree.cleanup_namespaces(copy)
    return copy


def _is_preserved(language: str, name: str) -> bool:
    """Return whether a name belongs to the format that was read."""
    namespaces = (f'{{{PREFIXES[prefix]}}}' for prefix in (language, 'preserved'))
    return name.startswith(tuple(namespaces)) or (language == 'sdf' and name == 'gazebo')


def _plain(language: str, root: Element) -> str:
    """Return a converted robot without the preserved parts."""
    copy = _stripped(root)
    for element in list(copy.iter()):
        holder = element.getparent()
        if holder is not None and _is_preserved(language, str(element.tag)):
            holder.remove(element)
        for name in list(element.attrib):
            if _is_preserved(language, str(name)):
                del element.attrib[name]
    etree.cleanup_namespaces(copy)
    return etree.tostring(copy, method='c14n').decode()


def _preserved(language: str, root: Element) -> Counter[str]:
    """Count the preserved parts of a converted robot, by name and by value."""
    found: Counter[str] = Counter()
    for element in root.iter():
        above = (element, *element.iterancestors())
        inside = any(_is_preserved(language, str(one.tag)) for one in above)
        entries = [(str(name), str(value)) for name, value in element.attrib.items()
                   if inside or _is_preserved(language, str(name))]
        if inside:
            entries.append((str(element.tag), (element.text or '').strip()))
        for name, value in entries:
            name = etree.QName(name).localname
            found.update([name, f'{name}={value}'])
    return found


def _notes(report: Report, level: str) -> Counter[tuple[str, str, str]]:
    return Counter((note.element, note.name, note.message) for note in report.notes
                   if note.level == level)


SPHERE = {'urdf': '<geometry><sphere radius="2"/></geometry>',
          'sdf': '<geometry><sphere><radius>2</radius></sphere></geometry>'}
#: Elements twice, first with the default, by format and by the element that has them.
REPEATED = {
    'urdf': {
        'joint[@name="elbow"]': (
            '<origin/><origin xyz="1 2 3"/>', '<origin xyz="0 0 0"/><origin rpy="1 0 0"/>',
            '<dynamics damping="0"/><dynamics damping="5"/>', '<axis/><axis xyz="0 1 0"/>',
            '<axis xyz="1 0 0"/><axis xyz="0 1 0"/>', '<mimic joint="wrist"/>'
            '<mimic joint="wrist" multiplier="7"/>',
            '<limit effort="1e16" velocity="1e16"/><limit lower="-1" effort="1" velocity="1"/>'),
        'joint[@name="wrist"]': (
            '<limit effort="1e16" velocity="1e16"/><limit effort="1" velocity="1"/>',),
        'link[@name="hand"]': tuple(
            f'<{tag} name="s"><origin/><origin xyz="1 2 3"/>{SPHERE["urdf"]}<geometry>'
            f'<box size="9 9 9"/></geometry></{tag}>' for tag in ('visual', 'collision')),
        'link[@name="hand"]/inertial': ('<origin/><origin xyz="0 0 0.1"/>', '<mass value="4"/>'),
        'link': (f'{MASS["urdf"]}<inertial><mass value="9"/></inertial>',),
    },
    'sdf': {
        'joint[@name="elbow"]': (
            '<pose>0 0 0 0 0 0</pose><pose>1 2 3 0 0 0</pose>', '<pose/><pose>0 0 1 0 0 0</pose>'),
        'joint[@name="wrist"]/axis': (
            '<limit/><limit><lower>-1</lower></limit>', '<dynamics/><dynamics><damping>3</damping>'
            '</dynamics>', '<xyz>0 0 1</xyz><xyz>0 1 0</xyz>'),
        'link[@name="arm"]': (
            '<pose>0 0 0 0 0 0</pose><pose>1 2 3 0 0 0</pose>', *(
                f'<{tag} name="s"><pose/><pose>1 2 3 0 0 0</pose>{SPHERE["sdf"]}<geometry><box/>'
                f'</geometry></{tag}>' for tag in ('visual', 'collision'))),
        'link[@name="arm"]/inertial': ('<pose/><pose>0 0 0.1 0 0 0</pose>', '<mass>7</mass>'),
    },
}


@pytest.mark.parametrize(('language', 'path', 'content'), [
    (language, path, content) for language, paths in REPEATED.items()
    for path, contents in paths.items() for content in contents])
def test_repeated_elements_keep_the_effect_of_the_first(
        language: str, path: str, content: str) -> None:
    root = etree.fromstring(SMALL_ROBOTS[language])
    holder = (root if language == 'urdf' else root[0]).find(path)
    assert holder is not None
    added = etree.fromstring(f'<a>{content}</a>')
    for tag in {str(child.tag) for child in added if len(added) > 1 and holder.tag != 'inertial'}:
        for old in holder.findall(tag):
            holder.remove(old)
    holder.extend(list(added))
    there, _ = _converted(language, root)
    other = 'sdf' if language == 'urdf' else 'urdf'
    back, _ = _converted(other, there)
    original, *found = (_read(one, tree, Report()) for one, tree in (
        (language, root), (other, there), (language, back)))
    for robot in found:
        assert differences(original, robot, samples=2, tolerance=1e-12) == []
