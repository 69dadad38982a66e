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

"""Surfaces and joint physics of URDF, compared element by element with what Gazebo makes of it."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from random import Random
import subprocess
from typing import Any
import xml.etree.ElementTree as ET

from opencv_tools.robot.cli import sdf_to_urdf, urdf_to_sdf
import pytest
from waiting import LONGEST_SECONDS

LINK = ('mu1', 'mu2', 'fdir1', 'kp', 'kd', 'minDepth', 'maxVel', 'maxContacts', 'laserRetro',
        'selfCollide', 'turnGravityOff', 'dampingFactor')
JOINT = ('stopCfm', 'stopErp', 'fudgeFactor', 'implicitSpringDamper', 'provideFeedback',
         'springReference', 'springStiffness')
FLAGS = {'selfCollide', 'turnGravityOff', 'implicitSpringDamper', 'provideFeedback'}
# What is compared: the elements of SDF that these settings become, in their owners.
COMPARED = {'collision': ('surface', 'max_contacts', 'laser_retro'),
            'link': ('self_collide', 'gravity', 'velocity_decay'),
            'joint': ('physics', 'axis/dynamics/spring_reference',
                      'axis/dynamics/spring_stiffness')}
# libsdformat writes these defaults of SDF for each joint with a block, and the value of
# implicitSpringDamper once more under its deprecated name.
DEFAULTS = {'axis/dynamics/spring_reference': 0.0, 'axis/dynamics/spring_stiffness': 0.0,
            'physics/ode/limit/cfm': 0.0, 'physics/ode/limit/erp': 0.2}
# The second one is not defined by SDF, and newer versions of libsdformat refuse it.
DEPRECATED = 'physics/ode/cfm_damping', 'physics/ode/provide_feedback'
BODY = """<link name="{0}"><inertial><mass value="2"/>
<inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/></inertial>
<collision><geometry><sphere radius="0.5"/></geometry></collision></link>"""
HINGE = """<joint name="{0}" type="revolute"><parent link="body0"/><child link="{1}"/>
<axis xyz="0 0 1"/><limit lower="-1" upper="1" effort="2" velocity="3"/></joint>"""


def value(random: Random, tag: str, is_public: bool) -> str:
    """Return a value; a public file writes numbers and flags in many ways."""
    if tag in FLAGS:
        return random.choice(('true', 'false', '1', '0') if is_public else ('true', 'false'))
    if tag == 'fdir1':
        return random.choice(('1 0 0', '0 1 0', '0 0 1'))
    if tag == 'maxContacts':
        return str(random.randint(1, 40))
    number = random.uniform(0.001, 10.0) * 10 ** random.randint(-2, 5)
    style = random.choice(('{:.3g}', '{:.1e}', ' {:.4f}', '{:.0f}.0 ')) if is_public else '{:.4g}'
    return style.format(number)


def block(random: Random, name: str, tags: tuple[str, ...], is_public: bool) -> str:
    """Return a block of some of the settings."""
    text = ''
    for tag in random.sample(tags, random.randint(1, len(tags))):
        content = value(random, tag, is_public)
        text += (f'<{tag} value="{content.strip()}"/>' if is_public and random.random() < 0.3
                 else f'<{tag}>{content}</{tag}>')
    return f'<gazebo reference="{name}">{text}</gazebo>'


def robot(seed: int, is_public: bool) -> str:
    """Return a robot of several links and joints with settings."""
    random = Random(seed)
    parts = [BODY.format(f'body{number}') for number in range(4)]
    parts += [HINGE.format(f'hinge{number}', f'body{number}') for number in range(1, 4)]
    parts += [block(random, f'body{number}', LINK, is_public) for number in range(4)]
    parts += [block(random, f'hinge{number}', JOINT, is_public) for number in range(1, 4)]
    return f'<robot name="robot">{"".join(parts)}</robot>'


def leaves(element: ET.Element, path: str) -> Iterator[tuple[str, Any]]:
    """Return the texts below an element by path, with numbers and flags as numbers."""
    text = (element.text or '').strip()
    if text:
        flag = {'true': '1', 'false': '0'}.get(text, text)
        yield path, tuple(map(float, flag.split()))
    for child in element:
        yield from leaves(child, f'{path}/{child.tag}')


def settings(text: str) -> dict[str, Any]:
    """Return the elements that are compared, by path."""
    found: dict[str, Any] = {}
    model = ET.fromstring(text).find('model')
    assert model is not None
    owners = [(kind, f'{kind} {owner.get("name")}', owner)
              for kind in ('link', 'joint') for owner in model.iter(kind)]
    owners += [('collision', f'collision {link.get("name")}', collision)
               for link in model.iter('link') for collision in link.findall('collision')]
    for kind, name, owner in owners:
        for path in COMPARED[kind]:
            for element in owner.findall(path):
                found.update(leaves(element, f'{name}/{path}'))
    return found


def expected(gazebo: dict[str, Any], ours: dict[str, Any]) -> dict[str, Any]:
    """Return what Gazebo reads, without what it would read from nothing."""
    return {path: found for path, found in gazebo.items() if path in ours or not (
        path.endswith(DEPRECATED) or found == (DEFAULTS.get(path.partition('/')[2]),))}


@pytest.mark.parametrize(('is_public', 'count'), [(False, 40), (True, 20)],
                         ids=['generated', 'public'])
def test_settings_are_those_of_gazebo(
        tmp_path: Path, capsys: pytest.CaptureFixture[str], record_property: Any,
        is_public: bool, count: int) -> None:
    compared = 0
    for seed in range(count):
        path = tmp_path / f'{seed}.urdf'
        path.write_text(robot(seed, is_public))
        gazebo = subprocess.run(['ign', 'sdf', '-p', str(path)], capture_output=True, text=True,
                                timeout=LONGEST_SECONDS, check=True).stdout
        assert urdf_to_sdf([str(path), '--sdf-version', '1.9']) == 0
        ours = settings(capsys.readouterr().out)
        assert ours == expected(settings(gazebo), ours), path.read_text()
        compared += len(ours)
    assert compared > 10 * count
    record_property('settings compared with Gazebo', compared)


# Each child of <gazebo>, with the reference of its block; values are none that others have.
CHILDREN: dict[str, tuple[str, ...]] = {
    'a': (
        '<material>Gazebo/FlatBlack</material>', '<mu1>0.37</mu1>', '<mu2>0.41</mu2>',
        '<fdir1>0 1 0</fdir1>', '<kp>1234.5</kp>', '<kd>67.5</kd>', '<minDepth>0.0075</minDepth>',
        '<maxVel>0.85</maxVel>', '<maxContacts>13</maxContacts>', '<laserRetro>0.55</laserRetro>',
        '<selfCollide>yes</selfCollide>', '<selfCollide>no</selfCollide>',
        '<turnGravityOff>yes</turnGravityOff>', '<dampingFactor>0.035</dampingFactor>',
        '<visual><transparency>0.45</transparency></visual>',
        '<visual><cast_shadows>0</cast_shadows></visual>',
        '<collision><surface><friction><ode><slip1>0.15</slip1></ode></friction></surface>'
        '</collision>', '<collision><max_contacts>17</max_contacts></collision>',
        '<gravity>0</gravity>', '<self_collide>1</self_collide>', '<enable_wind>1</enable_wind>',
        '<kinematic>1</kinematic>',
        '<velocity_decay><linear>0.25</linear></velocity_decay>',
        '<sensor name="s" type="imu"><update_rate>33</update_rate></sensor>',
        '<light name="l" type="point"><intensity>0.65</intensity></light>',
        '<plugin name="p" filename="p.so"><odd>1</odd></plugin>', '<odd>5</odd>'),
    'j': (
        '<stopCfm>0.15</stopCfm>', '<stopErp>0.35</stopErp>', '<fudgeFactor>0.95</fudgeFactor>',
        '<implicitSpringDamper>yes</implicitSpringDamper>',
        '<provideFeedback>yes</provideFeedback>', '<springReference>0.45</springReference>',
        '<springStiffness>2.75</springStiffness>',
        '<physics><ode><limit><cfm>0.65</cfm></limit></ode></physics>',
        '<gearbox_ratio>2.5</gearbox_ratio>', '<thread_pitch>3.5</thread_pitch>',
        '<axis><dynamics><damping>0.7</damping></dynamics></axis>',
        '<sensor name="f" type="force_torque"><update_rate>44</update_rate></sensor>',
        '<preserveFixedJoint>1</preserveFixedJoint>'),
    '': (
        '<static>yes</static>', '<self_collide>1</self_collide>', '<pose>1 2 3 0 0 0.5</pose>',
        '<plugin name="q" filename="q.so"><odd>2</odd></plugin>',
        '<allow_auto_disable>0</allow_auto_disable>', '<enable_wind>1</enable_wind>',
        '<gripper name="g"><palm_link>b</palm_link></gripper>',
        '<joint name="loop" type="ball"><parent>b</parent><child>a</child></joint>',
        '<joint name="loop" type="revolute"><pose>0 0 0.3 0.1 0 0</pose><parent>b</parent>'
        '<child>a</child><axis><xyz>0 1 0</xyz><limit><lower>-0.2</lower><upper>0.3</upper>'
        '</limit></axis></joint>',
        '<link name="c"><pose>4 5 6 0 0 0</pose><inertial><mass>7</mass></inertial></link>',
        '<frame name="tip"><pose>0 0 7 0 0 0</pose></frame>',
        '<frame name="tip" attached_to="b"><pose>0 0 8 0 0 0</pose></frame>'),
}
#: Children that are not converted, with the reason. Each has a warning.
REASONS = {
    'a <odd>': 'libsdformat copies what SDF does not define; nothing reads it',
    'j <axis>': 'it repeats the axis of the joint, and the first one counts',
}


DEFAULT_TAGS = ('cfm_damping', 'static')


def numbers(text: str) -> str:
    """Return a text with its numbers and flags in one form."""
    words = [{'true': '1', 'false': '0', 'yes': '1', 'no': '0'}.get(word, word)
             for word in text.split()]
    try:
        return ' '.join(repr(float(word)) for word in words)
    except ValueError:
        return ' '.join(words)


def texts(model: ET.Element) -> set[tuple[str, str]]:
    """Return all texts and attributes below a model, by the tags that lead there."""
    found = set()
    pending = [(model, 'model')]
    while pending:
        element, path = pending.pop()
        found |= {(f'{path}@{name}', numbers(value)) for name, value in element.attrib.items()
                  if name not in ('name', 'relative_to') and not name.startswith('{')}
        if (element.text or '').strip() and not len(element):
            found.add((path, numbers(element.text or '')))
        pending += [(child, f'{path}/{child.tag}') for child in element
                    if not child.tag.startswith('{')]
    return found


def added(path: Path, content: str, capsys: pytest.CaptureFixture[str]
          ) -> tuple[set[tuple[str, str]], set[tuple[str, str]], str]:
    """Return what a block adds to the SDF of Gazebo and to ours, and our warnings."""
    sphere = '<geometry><sphere radius="0.5"/></geometry>'
    links = (BODY.format('a') + BODY.format('b')).replace(
        '</link>', f'<visual>{sphere}</visual></link>')
    hinge = HINGE.format('j', 'b').replace('body0', 'a')
    path.write_text(f'<robot name="r">{links}{hinge}{content}</robot>')
    gazebo = subprocess.run(['ign', 'sdf', '-p', str(path)], capture_output=True, text=True,
                            timeout=LONGEST_SECONDS, check=True).stdout
    capsys.readouterr()
    assert urdf_to_sdf([str(path), '--sdf-version', '1.9']) == 0
    ours = capsys.readouterr()
    models = [ET.fromstring(text).find('model') for text in (gazebo, ours.out)]
    first, second = (texts(model) for model in models if model is not None)
    return first, second, ours.err


def test_each_child_of_gazebo(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / 'r.urdf'
    bare = added(path, '', capsys)
    wrong = {}
    for reference, contents in CHILDREN.items():
        for content in contents:
            tag = f'{reference} <{content[1:].partition(">")[0].partition(" ")[0]}>'
            attribute = f' reference="{reference}"' if reference else ''
            theirs, ours, errors = added(path, f'<gazebo{attribute}>{content}</gazebo>', capsys)
            # libsdformat also adds defaults, such as <static>false</static>.
            missing = {one for one in theirs - bare[0] - ours if one[1] in numbers_in(content)
                       and not one[0].endswith(DEPRECATED)
                       and (one[0].rpartition('/')[2] not in DEFAULT_TAGS or 'static' in content)}
            if tag in REASONS:
                assert 'no effect in SDF' in errors, tag
            elif missing or errors:
                wrong[content] = missing, errors
    assert wrong == {}


def numbers_in(content: str) -> set[str]:
    """Return the texts and attributes of XML, in the form of `numbers`."""
    found = set()
    for element in ET.fromstring(content).iter():
        found |= {numbers(value) for value in (element.text or '', *element.attrib.values())}
    return found


NEXT = '</gazebo><gazebo reference="a">'
DECAY = '<velocity_decay><linear>0.5</linear><angular>0.25</angular></velocity_decay>'


@pytest.mark.parametrize(('path', 'content'), [
    ('link/gravity', '<gravity>1</gravity><turnGravityOff>1</turnGravityOff>'),
    ('link/self_collide', '<self_collide>1</self_collide><selfCollide>0</selfCollide>'),
    ('static', '</gazebo><gazebo><static>1</static><static>0</static>'),
    ('static', '</gazebo><gazebo><static>0</static></gazebo><gazebo><static>1</static>'),
    ('link/velocity_decay/linear', '<velocity_decay><linear>0.5</linear></velocity_decay>'
     '<dampingFactor>0.1</dampingFactor>'),
    *[('link/velocity_decay/' + tag, content) for tag in ('linear', 'angular') for content in (
        '<dampingFactor>3</dampingFactor><dampingFactor>7</dampingFactor>',
        f'<dampingFactor>3</dampingFactor>{NEXT}<dampingFactor>7</dampingFactor>',
        f'<dampingFactor>3</dampingFactor>{NEXT}<dampingFactor>7</dampingFactor>{NEXT}{DECAY}',
        f'{DECAY}{NEXT}<dampingFactor>3</dampingFactor>{NEXT}<dampingFactor>7</dampingFactor>',
        f'<dampingFactor>3</dampingFactor>{DECAY}{NEXT}<dampingFactor>7</dampingFactor>',
        f'<dampingFactor>3</dampingFactor>{NEXT}{DECAY}')],
    ('link/collision/max_contacts', '<maxContacts>3</maxContacts><collision><max_contacts>5'
     '</max_contacts></collision>'),
    ('link/collision/surface/friction/ode/mu', '<mu1>3</mu1></gazebo><gazebo reference="a">'
     '<collision><surface><friction><ode><mu>5</mu></ode></friction></surface></collision>')])
def test_the_first_of_repeated_elements_is_that_of_gazebo(
        tmp_path: Path, capsys: pytest.CaptureFixture[str], path: str, content: str) -> None:
    file = tmp_path / 'r.urdf'
    file.write_text(f'<robot name="r">{BODY.format("a")}<gazebo reference="a">{content}</gazebo>'
                    '</robot>')
    gazebo = subprocess.run(['ign', 'sdf', '-p', str(file)], capture_output=True, text=True,
                            timeout=LONGEST_SECONDS, check=True).stdout
    assert urdf_to_sdf([str(file), '--sdf-version', '1.9']) == 0
    first, ours = (numbers(ET.fromstring(text).findtext(f'model/{path}', ''))
                   for text in (gazebo, capsys.readouterr().out))
    assert first and ours == first


PAINT = '<visual><material><{0}>0.25 0.5 0.75 1</{0}></material></visual>'
COLORS = ('ambient', 'diffuse', 'specular')
SHAPE = '<pose>0 0 {0} 0 0 0</pose><geometry><box><size>1 2 {0}</size></box></geometry>'


def first_values(text: str, tags: tuple[str, ...]) -> list[dict[str, str]]:
    """Return the first text at each of some paths in each visual and collision."""
    shapes = ET.fromstring(text).findall('model/link/*[geometry]')
    return [{tag: found for tag in tags if (found := numbers(shape.findtext(tag, '')))}
            for shape in shapes]


@pytest.mark.parametrize('has_color', [True, False])
@pytest.mark.parametrize('contents', [
    *[[PAINT.format(color)] for color in COLORS],
    *[[PAINT.format(color), '<material>Gazebo/Odd</material>'] for color in COLORS],
    ['<material>Gazebo/Odd</material>', PAINT.format('specular')],
    [PAINT.format('diffuse'), PAINT.format('ambient')],
    [PAINT.format('ambient').replace('0.25', '1'), PAINT.format('ambient')],
    [PAINT.format('diffuse'), PAINT.format('specular')],
    [PAINT.format('diffuse').replace('<visual>', '<visual name="n"><transparency>0.5'
                                     '</transparency>'),
     '<visual><transparency>0.25</transparency></visual>'],
    ['<collision><max_contacts>3</max_contacts><surface><bounce><threshold>7</threshold></bounce>'
     '</surface></collision>', '<collision name="n"><max_contacts>4</max_contacts><surface>'
     '<contact><ode><kp>3</kp></ode></contact></surface></collision>'],
    *[[f'<{tag}>{SHAPE.format(length)}</{tag}>'] for tag in ('visual', 'collision')
      for length in ('0.001', '0.7', '300')]])
def test_shapes_with_the_contents_of_blocks_are_those_of_gazebo(
        tmp_path: Path, capsys: pytest.CaptureFixture[str], contents: list[str], has_color: bool
) -> None:
    file, content = tmp_path / 'r.urdf', ('' if has_color else NEXT).join(contents)
    color = '<material name="m"><color rgba="1 0 1 1"/></material>' if has_color else ''
    visual = ('<visual><origin xyz="0 0 2"/><geometry><sphere radius="0.5"/></geometry>'
              f'{color}</visual>')
    body = BODY.format('a').replace('<collision>', f'{visual}<collision>')
    file.write_text(f'<robot name="r">{body}<gazebo reference="a">{content}</gazebo>'
                    '</robot>')
    gazebo = subprocess.run(['ign', 'sdf', '-p', str(file)], capture_output=True, text=True,
                            timeout=LONGEST_SECONDS, check=True).stdout
    assert urdf_to_sdf([str(file), '--sdf-version', '1.9']) == 0
    sdf = capsys.readouterr()
    tags = (*(f'material/{color}' for color in COLORS), 'material/script/name',
            'geometry[1]/box/size', 'geometry[1]/sphere/radius', 'transparency', 'max_contacts',
            'surface/bounce/threshold', 'surface/contact/ode/kp')
    first, ours = (first_values(text, tags) for text in (gazebo, sdf.out))
    for shape in ours:  # that of SDF, which Gazebo reads too
        if shape.get('material/specular') == numbers('0 0 0 1'):
            del shape['material/specular']
    assert sorted(ours, key=repr) == sorted(first, key=repr)
    poses = [[one.findtext('pose', '0 0 0 0 0 0') for one in ET.fromstring(text).findall(
        'model/link/*[geometry]')] for text in (gazebo, sdf.out)]
    assert sorted(map(numbers, poses[0])) == sorted(map(numbers, poses[1]))
    for tag in ('pose', 'geometry'):
        assert (f"<{tag}> 'a': is omitted" in sdf.err) is (f'<{tag}>' in content)
    (tmp_path / 'r.sdf').write_text(sdf.out)
    assert sdf_to_urdf([str(tmp_path / 'r.sdf'), '-o', str(file)]) == 0
    assert urdf_to_sdf([str(file), '--sdf-version', '1.9']) == 0
    again = first_values(capsys.readouterr().out, tags)
    assert again == first_values(sdf.out, tags)


@pytest.mark.parametrize(('path', 'content', 'other'), [
    ('gravity', '<turnGravityOff>1</turnGravityOff>', '<turnGravityOff>0</turnGravityOff>'),
    ('self_collide', '<selfCollide>1</selfCollide>', '<selfCollide>0</selfCollide>'),
    ('velocity_decay/linear', '<dampingFactor>0.2</dampingFactor>',
     '<dampingFactor>0.3</dampingFactor>')])
def test_settings_of_a_link_that_becomes_a_frame(
        tmp_path: Path, capsys: pytest.CaptureFixture[str], path: str, content: str, other: str
) -> None:
    file, text = tmp_path / 'r.urdf', (
        f'<robot name="r">{BODY.format("a")}<link name="b"/><joint name="j" type="fixed"><parent '
        f'link="a"/><child link="b"/></joint><gazebo reference="b">{content}</gazebo>')
    file.write_text(f'{text}</robot>')
    gazebo = subprocess.run(['ign', 'sdf', '-p', str(file)], capture_output=True, text=True,
                            timeout=LONGEST_SECONDS, check=True).stdout
    assert urdf_to_sdf([str(file), '--sdf-version', '1.9']) == 0
    sdf = capsys.readouterr().out
    first, ours = (numbers(ET.fromstring(one).findtext(f'model/link/{path}', ''))
                   for one in (gazebo, sdf))
    assert first and ours == first
    (tmp_path / 'r.sdf').write_text(sdf)
    assert sdf_to_urdf([str(tmp_path / 'r.sdf')]) == 0
    blocks = ET.fromstring(capsys.readouterr().out).findall('gazebo')
    assert [block.get('reference') for block in blocks] == ['b']
    file.write_text(f'{text}<gazebo reference="a">{other}</gazebo></robot>')
    assert urdf_to_sdf([str(file)]) == 0
    assert "'b': has no effect: link 'a'" in capsys.readouterr().err
