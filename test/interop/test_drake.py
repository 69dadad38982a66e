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

"""Inertials that follow from density and collisions, compared with Drake's newest libsdformat."""

from __future__ import annotations

import json
import os
from pathlib import Path
from random import Random
import subprocess
from typing import Any

import numpy as np
from opencv_tools.robot.cli import urdf_to_sdf
from opencv_tools.robot.kinematics import Kinematics
from opencv_tools.robot.load import read_robot
from opencv_tools.robot.model import FrameId, Link
from opencv_tools.robot.pose import rotated_tensor
from opencv_tools.robot.xml.report import Report
import pytest
from waiting import LONGEST_SECONDS

ROOT = Path(__file__).parents[2]
SCRIPT = Path(__file__).with_name('drake_inertials.py')
SHAPES = {'box': ('size', 3), 'sphere': ('radius', 1), 'cylinder': ('radius length', 1),
          'capsule': ('radius length', 1), 'ellipsoid': ('radii', 3), 'cone': ('radius length', 1)}


def numbers(random: Random, count: int, low: float, high: float) -> str:
    return ' '.join(f'{random.uniform(low, high):.4g}' for _ in range(count))


def pose(random: Random) -> str:
    return f'<pose>{numbers(random, 6, -1.5, 1.5)}</pose>' if random.random() < 0.8 else ''


def collision(random: Random, name: str, shape: str) -> str:
    """Return a collision of random size, place and density."""
    tags, count = SHAPES[shape]
    sizes = ''.join(f'<{tag}>{numbers(random, count, 0.05, 2)}</{tag}>' for tag in tags.split())
    density = f'<density>{numbers(random, 1, 1, 9000)}</density>' * (random.random() < 0.7)
    return (f'<collision name="{name}">{density}{pose(random)}<geometry><{shape}>{sizes}</{shape}>'
            '</geometry></collision>')


def robot(seed: int) -> str:
    """Return SDF with links whose inertials are computed."""
    random = Random(seed)
    links = ''
    for number in range(3):
        inertial = f'<density>{numbers(random, 1, 1, 9000)}</density>' * (random.random() < 0.5)
        shapes = random.choices(list(SHAPES), k=random.randint(1, 3))
        links += (f'<link name="link{number}">{pose(random)}<inertial auto="true">{inertial}'
                  '</inertial>' + ''.join(collision(random, f'shape{index}', shape)
                                          for index, shape in enumerate(shapes)) + '</link>')
    return f'<sdf version="1.11"><model name="robot">{links}</model></sdf>'


def inertial_in_link(link: Link, kinematics: Kinematics) -> list[float]:
    """Return mass, centre and moments in the axes of the link, as the script does."""
    assert link.inertial
    place = kinematics.within(FrameId('link', link.name), link.inertial.placement).transform()
    return [link.inertial.mass, *place.translation,
            *rotated_tensor(link.inertial.inertia, place.rotation)]


def test_computed_inertials_are_those_of_drake(
        tmp_path: Path, record_property: Any) -> None:
    drake = os.environ.get('OPENCV_TOOLS_DRAKE')
    if not drake:
        pytest.skip('PyPI has no drake for this version of Python')
    paths = [ROOT / 'test' / 'data' / 'robots' / 'sdf' / 'ok_auto_inertial.sdf']
    for seed in range(40):
        paths.append(tmp_path / f'{seed}.sdf')
        paths[-1].write_text(robot(seed))
    finished = subprocess.run([drake, str(SCRIPT), *map(str, paths)], capture_output=True,
                              text=True, timeout=LONGEST_SECONDS, check=False)
    assert finished.returncode == 0, finished.stderr
    drakes = json.loads(finished.stdout)
    largest, count = 0.0, 0
    for path in paths:
        made, _ = read_robot(str(path), Report())
        kinematics = Kinematics(made)
        assert {link.name for link in made.links} == set(drakes[str(path)])
        for link in made.links:
            ours, theirs = inertial_in_link(link, kinematics), drakes[str(path)][link.name]
            for part in (slice(0, 1), slice(1, 4), slice(4, 10)):
                scale = max(map(abs, theirs[part])) or 1.0
                largest = max(largest, *np.abs(np.subtract(ours[part], theirs[part])) / scale)
            count += 1
    record_property('inertials compared with Drake', count)
    record_property('largest relative difference from Drake', float(largest))
    assert largest < 1e-6


#: Fixtures whose links weigh more in SDF, with a warning.
#: Robots that have another mass in Drake after the conversion, with the reason.
HEAVIER = {
    'tutorial_my_robot.urdf': 'no link has a mass; each has 1 kg in SDF, with a warning',
    'warning_inertial_missing.urdf': 'a massless link that moves has 1 kg in SDF, with a warning',
    'warning_inertial_zero.urdf': 'the only link has mass 0, which is 1 kg in SDF, with a warning',
    'warning_world_with_a_mass.urdf': 'Drake ignores the mass of a link of URDF named world',
}
#: Robots that end the program of Drake, with the reason.
FATAL = {
    'ok_effort_unlimited.urdf': 'a negative velocity means no limit; Drake takes the number',
    'ok_negative_effort.urdf': 'a negative velocity means no limit; Drake takes the number',
    'warning_lower_greater_than_upper.urdf': 'the limits are in the wrong order',
}
#: Robots that Drake refuses: the format, words of its message, and the reason.
REFUSED = {
    'ok_declaration_and_comments.urdf': (
        'urdf', 'XML_ERROR_PARSING_DECLARATION', 'it has a processing instruction'),
    'ok_global_materials.urdf': ('urdf', 'unknown package', 'it names a package for its texture'),
    'ok_other_namespaces.urdf': (
        'urdf', "joint 'screw' doesn't have a parent", 'Drake reads elements with a prefix'),
    'warning_contact_of_a_renamed_collision.urdf': (
        'sdf', 'XML Element[plugin], child of element[link]',
        'libsdformat copies a <plugin> of <gazebo> into the link too; Drake allows none there'),
    'warning_mimic_unknown_joint.urdf': (
        'urdf', "'thumb' which does not exist", 'the joint of the mimic is missing'),
    'warning_names_of_preserved_elements.urdf': (
        'urdf', "'held' which has 0 DOF cannot mimic", 'a fixed joint has a mimic'),
    'warning_robot_without_name.urdf': ('urdf', 'must have a name', 'the robot has no name'),
    'warning_sensor_name_with_double_colon.urdf': (
        'sdf', 'XML Element[api], child of element[sensor]', 'SDF has no <api>'),
}


def test_masses_of_converted_robots(tmp_path: Path, record_property: Any) -> None:
    drake = os.environ.get('OPENCV_TOOLS_DRAKE')
    if not drake:
        pytest.skip('PyPI has no drake for this version of Python')
    pairs = {}
    for path in sorted((ROOT / 'test' / 'data' / 'robots' / 'urdf').glob('*.urdf')):
        if not path.name.startswith('error_') and path.name not in FATAL:
            pairs[path] = tmp_path / f'{path.stem}.sdf'
            assert urdf_to_sdf([str(path), '-o', str(pairs[path])]) == 0
    finished = subprocess.run(
        [drake, str(SCRIPT.with_name('drake_masses.py')), *map(str, pairs), *map(
            str, pairs.values())], capture_output=True, text=True, timeout=LONGEST_SECONDS,
        check=False)
    found = json.loads(finished.stdout)
    different, refused, count = [], {}, 0
    for path, converted in pairs.items():
        results = {'urdf': found[str(path)], 'sdf': found[str(converted)]}
        errors = [(kind, one['error']) for kind, one in results.items() if 'error' in one]
        if errors:
            refused[path.name] = errors
            continue
        count += 1
        values = [[one['mass'], *(value for matrix in one['matrices'] for _, value in sorted(
            matrix.items()))] for one in results.values()]
        if len(values[0]) != len(values[1]) or not np.allclose(*values, rtol=1e-9, atol=1e-9):
            different.append(path.name)
    record_property('robots with the same mass and mass matrix in Drake', count)
    assert different == [*HEAVIER]
    assert {name: [kind for kind, _ in errors] for name, errors in refused.items()} == {
        name: [kind] for name, (kind, _, _) in REFUSED.items()}
    for name, ((_, error),) in refused.items():
        assert REFUSED[name][1] in error
