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
Round trips of random robots with features of public files, checked by libsdformat and urdfdom.

``OPENCV_TOOLS_EXAMPLES`` is the number of robots of each kind.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
import json
import os
from pathlib import Path
from random import Random
import re
import subprocess
from typing import Any
import xml.etree.ElementTree as ElementTree

from hypothesis import given, HealthCheck, settings, strategies as st
from mutations import mutated
import numpy as np
from opencv_tools.robot.compare.compare import differences
from opencv_tools.robot.convert import convert_to_sdf, convert_to_urdf, SdfOptions
from opencv_tools.robot.load import read_robot
from opencv_tools.robot.renaming import with_original_names
from opencv_tools.robot.xml.document import DescriptionError, to_bytes
from opencv_tools.robot.xml.report import Report
import public_sdf
import public_urdf
import pytest
from resolved_poses import flat, poses_of_sdf, poses_of_urdf, ResolvedPoses, root_link
from waiting import communicate, LONGEST_SECONDS

EXAMPLES = int(os.environ.get('OPENCV_TOOLS_EXAMPLES', '100'))
PROPERTY = settings(max_examples=EXAMPLES, deadline=None, derandomize=True,
                    database=None, report_multiple_bugs=False,
                    suppress_health_check=list(HealthCheck))
SEEDS = st.integers(0, 2**32)
VERSIONS = ('1.7', '1.8', '1.9', '1.11')
TOLERANCE = 1e-9  # metres, and elements of rotation matrices

Parser = Callable[[Path], dict[str, Any]]


class LibSdformat:
    """A process that reads one file after another; it is restarted after a crash."""

    def __init__(self) -> None:
        self._process = self._start()

    def _start(self) -> subprocess.Popen[str]:
        return subprocess.Popen([os.environ['OPENCV_TOOLS_INTEROP'], '-'], stdin=subprocess.PIPE,
                                stdout=subprocess.PIPE, text=True)

    def __call__(self, path: Path) -> dict[str, Any]:
        """Return the result of a file."""
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        print(path, file=self._process.stdin, flush=True)
        line = self._process.stdout.readline()
        if line:
            answer: dict[str, dict[str, Any]] = json.loads(line)
            return answer[str(path)]
        self.close()
        self._process = self._start()
        return {'loaded': False, 'valid': False, 'messages': 'the process crashed', 'models': {}}

    def close(self) -> None:
        """End the process."""
        communicate(self._process)


@pytest.fixture(scope='module')
def libsdformat() -> Iterator[Parser]:
    process = LibSdformat()
    yield process
    process.close()


class Workspace:
    """A folder for the files of one robot after another, the parsers, and counts of results."""

    def __init__(self, folder: Path, libsdformat: Parser) -> None:
        self.folder = folder
        self.libsdformat = libsdformat
        self.counts: Counter[str] = Counter()

    def put(self, name: str, data: bytes) -> Path:
        """Write a file."""
        path = self.folder / name
        path.write_bytes(data)
        return path

    def count_refused(self, err: DescriptionError, accepted: bool) -> None:
        """Count a robot that is not converted although the other parser reads it."""
        if accepted:
            self.counts['refused'] += 1
            self.counts[f'refused: {re.sub("^[^ ]* |[0-9]+", "", str(err))}'] += 1

    def urdf(self, path: Path) -> bool:
        """Return whether urdfdom reads a file."""
        finished = subprocess.run(['check_urdf', str(path)], capture_output=True,
                                  timeout=LONGEST_SECONDS,
                                  check=False)
        return b'Successfully Parsed XML' in finished.stdout

    def model(self, path: Path, check: str = 'valid') -> Mapping[str, Any] | None:
        """Return the model as resolved by libsdformat; None if the result fails the check."""
        result = self.libsdformat(path)
        if not result[check] or len(result['models']) != 1:
            return None
        if 'has a name collision' in result['messages']:
            return None  # libsdformat renames and continues
        (model,) = result['models'].values()
        return None if model['errors'] else model


@pytest.fixture
def workspace(tmp_path: Path, libsdformat: Parser) -> Workspace:
    return Workspace(tmp_path, libsdformat)


def read(path: Path) -> Any:
    """Return a robot with its original names."""
    return with_original_names(read_robot(str(path), Report())[0])


def urdf_through(workspace: Workspace, written: ElementTree.Element, random: Random) -> None:
    """Convert URDF to SDF and back; compare each output as read by the other parsers."""
    path = workspace.put('in.urdf', ElementTree.tostring(written))
    accepted, report = workspace.urdf(path), Report()
    workspace.counts['read by libsdformat'] += accepted
    try:
        robot, _ = read_robot(str(path), report)
        version = random.choice(VERSIONS)
        relative = random.random() < 0.5
        there = workspace.put('there.sdf', to_bytes(
            convert_to_sdf(robot, report, SdfOptions(version=version, relative=relative))))
    except DescriptionError as err:
        workspace.count_refused(err, accepted)
        return
    workspace.counts['converted'] += 1
    model = workspace.model(there)
    if any('physically impossible' in note.message for note in report.warnings):
        assert 'has invalid inertia' in workspace.libsdformat(there)['messages']
        if all(link.inertial is None or link.inertial.mass > 0 for link in robot.links):
            try:
                physical = to_bytes(convert_to_sdf(
                    robot, Report(), SdfOptions(inertial='physical')))
            except DescriptionError:  # the moments are near to those of no body
                return
            assert workspace.model(workspace.put('physical.sdf', physical)), path.read_text()
        return
    assert model is not None, (path.read_text(), there.read_text(), workspace.libsdformat(there))
    try:
        back = workspace.put('back.urdf', to_bytes(convert_to_urdf(read(there), Report())))
        links = tuple(replace(link, inertial=None) if link.inertial and link.inertial.mass == 0
                      else link for link in robot.links)  # as libsdformat takes a mass of 0
        assert not differences(replace(robot, links=links), read(back), samples=1,
                               tolerance=TOLERANCE)
    except DescriptionError:
        assert not accepted, (path.read_text(), there.read_text())
    if not accepted:
        return
    assert workspace.urdf(back), (path.read_text(), back.read_text())
    workspace.counts['compared'] += 1
    expected = poses_of_urdf(written, named=False)
    expected = replace(expected, inertials={
        name: pose for name, pose in expected.inertials.items() if expected.masses[name][0]})
    compare(expected, poses_of_urdf(ElementTree.parse(back).getroot(), named=False), path)
    kept = workspace.put('kept.sdf', to_bytes(convert_to_sdf(robot, Report(), SdfOptions(
        version=version, relative=relative, fixed='keep'))))  # no link is a frame
    model = workspace.model(kept)
    assert model is not None, (path.read_text(), kept.read_text(), workspace.libsdformat(kept))
    compare_in_order(expected, written, model, kept)


def sdf_through(workspace: Workspace, written: ElementTree.Element, random: Random) -> None:
    """Convert SDF to URDF and back; compare each output as read by the other parsers."""
    path = workspace.put('in.sdf', ElementTree.tostring(written))
    model = workspace.model(path, 'loaded')
    workspace.counts['read by libsdformat'] += model is not None
    try:
        robot, _ = read_robot(str(path), Report())
        there = workspace.put('there.urdf', to_bytes(convert_to_urdf(robot, Report())))
    except DescriptionError as err:
        workspace.count_refused(err, model is not None)
        return
    workspace.counts['converted'] += 1
    assert workspace.urdf(there), (path.read_text(), there.read_text())
    try:
        back = workspace.put('back.sdf', to_bytes(convert_to_sdf(
            read(there), Report(), SdfOptions(version=random.choice(VERSIONS)))))
    except DescriptionError:
        assert model is None, (path.read_text(), there.read_text())
    if model is None:
        return
    again = workspace.model(back)
    assert again is not None, (path.read_text(), back.read_text(), workspace.libsdformat(back))
    workspace.counts['compared'] += 1
    urdf = ElementTree.parse(there).getroot()
    base = root_link(urdf)
    compare(poses_of_sdf(written, model, base, named=True),
            poses_of_urdf(urdf, named=True), path)
    # A visual or a collision is renamed if both have one name.
    compare(poses_of_sdf(written, model, base, named=False),
            poses_of_sdf(ElementTree.parse(back).getroot(), again, base, named=False), path)


def compare(expected: ResolvedPoses, found: ResolvedPoses, path: Path) -> None:
    """Check that all poses found are the expected ones."""
    for kind in ('joints', 'shapes', 'inertials', 'masses', 'axes'):
        here, there = getattr(expected, kind), getattr(found, kind)
        if kind == 'axes':
            # libsdformat has no default axis.
            there = {name: value for name, value in there.items() if name in here}
        assert there.keys() <= here.keys(), (kind, there.keys() - here.keys(), path.read_text())
        for name, value in there.items():
            check_close(here[name], value, f'{kind} {name}', path)


def check_close(expected: Any, found: Any, name: str, path: Path) -> None:
    """Check that numbers are equal except for rounding."""
    assert np.allclose(expected, found, rtol=1e-12, atol=TOLERANCE), (
        name, expected, found, path.read_text())


def compare_in_order(expected: ResolvedPoses, urdf: ElementTree.Element, model: Mapping[str, Any],
                     path: Path) -> None:
    """Compare links and joints of SDF with those of URDF in the same order."""
    sdf = ElementTree.parse(path).getroot()
    base = root_link(urdf)
    inside = sdf.find('model')
    assert inside is not None
    names = {
        'link': dict(zip((link.get('name', '') for link in inside.findall('link')),
                         (link.get('name', '') for link in urdf.findall('link')
                          if link.get('name') != 'world'), strict=True)),
        'joint': dict(zip((joint.get('name', '') for joint in inside.findall('joint')),
                          (joint.get('name', '') for joint in urdf.findall('joint')
                           if joint.get('type') not in ('floating', 'planar')), strict=True))}
    sdf_base = next((name for name, own in names['link'].items() if own == base), base)
    found = poses_of_sdf(sdf, model, sdf_base, named=False)
    for name, own in names['joint'].items():
        own = flat(own)
        check_close(expected.joints[own], found.joints[name], name, path)
        if own in expected.axes:
            check_close(expected.axes[own], found.axes[name], name, path)
    for name, own in names['link'].items():
        if own in expected.inertials:  # others have mass 0, which is no inertial of SDF
            check_close(expected.inertials[own], found.inertials[name], name, path)
            check_close(expected.masses[own], found.masses[name], name, path)
        for tag in ('visual', 'collision'):
            shapes = [pose for key, pose in found.shapes.items() if key[:2] == (name, tag)]
            originals = [pose for key, pose in expected.shapes.items() if key[:2] == (own, tag)]
            for shape, original in zip(shapes, originals, strict=True):
                check_close(original, shape, f'{tag} of {name}', path)


@pytest.mark.parametrize('is_mutated', [False, True], ids=['as made', 'mutated'])
@pytest.mark.parametrize('way', [urdf_through, sdf_through])
def test_round_trips_of_public_robots(
        way: Callable[..., None], is_mutated: bool, workspace: Workspace,
        record_property: Callable[[str, object], None]) -> None:
    make = public_urdf.urdf if way is urdf_through else public_sdf.sdf

    @given(SEEDS)
    @PROPERTY
    def through(seed: int) -> None:
        random = Random(seed)
        robot = make(random)
        way(workspace, mutated(random, robot) if is_mutated else robot, random)

    through()
    record(workspace, record_property)
    assert is_mutated or workspace.counts['refused'] == 0
    assert workspace.counts['compared'] > EXAMPLES / (6 if is_mutated else 3)


def record(workspace: Workspace, record_property: Callable[[str, object], None]) -> None:
    for name, count in workspace.counts.items():
        record_property(f'public robots: {name}', count)
