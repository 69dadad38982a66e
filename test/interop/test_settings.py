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

from opencv_tools.robot.cli import urdf_to_sdf
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
DEPRECATED = 'physics/ode/cfm_damping'
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
