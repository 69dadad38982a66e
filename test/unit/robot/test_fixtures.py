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

"""Fixtures in data/robots: outcomes by their names, and facts by their comments."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
import functools
from functools import partial
import math
from pathlib import Path
import random
import re
from types import ModuleType
from typing import Any

from lxml import etree
from opencv_tools.robot.cli import sdf_to_urdf, urdf_to_sdf
from opencv_tools.robot.compare.compare import differences
from opencv_tools.robot.kinematics import Kinematics, with_mimics
from opencv_tools.robot.load import read_robot
from opencv_tools.robot.model import Extension, FrameId, Link, Robot
from opencv_tools.robot.pose import normalised, Pose
from opencv_tools.robot.renaming import with_original_names
from opencv_tools.robot.xml.document import PARTLY_READ
from opencv_tools.robot.xml.report import Report
import pytest
from rows import failures

Command = Callable[[Sequence[str] | None], int]
Text = pytest.CaptureFixture[str]
# A preserved element: owner, path of tags, attributes and text.
Entry = tuple[str, tuple[str, ...], tuple[tuple[str, str], ...], str]

ROBOTS = Path(__file__).parents[2] / 'data' / 'robots'
FIXTURES = {path.name: path for path in sorted(ROBOTS.glob('*/*.*'))}
ERRORS = [name for name in FIXTURES if name.startswith('error_')]
WARNINGS = [name for name in FIXTURES if name.startswith('warning_')]
FINE = [name for name in FIXTURES if name.startswith('ok_')]
TUTORIAL = [name for name in FIXTURES if name.startswith('tutorial_')]
CONVERTED = [*WARNINGS, *FINE, *TUTORIAL]
# The others have colours that both formats refuse.
RESTORED = [name for name in CONVERTED if not name.startswith('warning_color_above_1')]

# Each conversion of xacro starts a process, and has plain URDF before it.
PLAIN_URDF = [name for name in RESTORED if name.endswith('.urdf')]

# Expected messages of an empty file, which has no comments.
EXPECTED = {'error_empty.urdf': ['not well-formed XML']}

# The conversion moves the link frame, so poses in it are computed there and back: the poses of the
# preserved elements in the frame of their link, by the tag of the element.
COMPUTED_POSES: dict[str, dict[str, tuple[float, ...]]] = {
    'ok_joint_frame_away_from_the_child.sdf': {'sensor': (0, 0.4, 0, 0, 0, 0)},
    'ok_light_with_a_placed_pose.sdf': {
        'light': (0, 1, 1, 0, 0, -math.pi / 2), 'sensor': (0, 0, 0, 0, 0, math.pi / 2)},
}

# The conversion corrects what breaks a rule of the format, so it is not restored: the preserved
# elements that only the original has, and those that only the result has.
CORRECTED: dict[str, tuple[list[Entry], list[Entry]]] = {
    'ok_contact_of_a_visuals_name.sdf': (
        [], [('visual base 0', ('visual',), (('name', 'body'),), '')]),
    'warning_duplicate_material_name.sdf': (
        [('model', ('model', 'material'), (('name', 'red'),), '')],
        [('model', ('model', 'material'), (('name', 'red_again'),), '')]),
    'warning_version_of_urdf.sdf': (
        [('model', ('model',), (('version', '2'),), '')],
        [('model', ('model',), (('version', '1.0'),), '')]),
}

# Fixtures that yourdfpy cannot check, and the reason.
NOT_IN_YOURDFPY = {
    'ok_axis_not_of_length_1.urdf': 'yourdfpy does not normalise the axis of a prismatic joint',
    'ok_capsule.urdf': 'yourdfpy does not support capsules',
    'ok_mimic_of_a_mimic.urdf': 'yourdfpy reads the position of a mimic of a mimic as 0',
    'ok_continuous_limit_of_effort_1_2.urdf': 'yourdfpy requires effort and velocity',
    'ok_limit_without_effort_1_2.urdf': 'yourdfpy requires effort and velocity',
    'ok_quaternion_1_1.urdf': 'yourdfpy ignores quaternions',
    'warning_capsule.sdf': 'yourdfpy does not support capsules',
    'warning_capsule_without_version.urdf': 'yourdfpy does not support capsules',
    'warning_capsule_without_length.sdf': 'yourdfpy does not support capsules',
    'warning_geometry_empty.urdf': 'yourdfpy requires a geometry',
    'warning_geometry_unknown.urdf': 'yourdfpy does not support ellipsoids',
    'warning_visual_without_geometry.urdf': 'yourdfpy requires a geometry',
}


def rows_of(names: Iterable[str]) -> Iterator[tuple[str]]:
    """Return a row for each name."""
    return ((name,) for name in names)


def _expected(name: str) -> list[str]:
    found = re.search(r'<!-- expect: (.*?) -->', _text(name))
    return found[1].split('; ') if found else EXPECTED[name]


def _expected_line(name: str) -> int:
    found = re.search(r'<!-- expect-line: (\d+) -->', _text(name))
    return int(found[1]) if found else 0


def _text(name: str) -> str:
    return FIXTURES[name].read_bytes().decode('utf-8', 'replace')


def _is_sdf(name: str) -> bool:
    return name.endswith('.sdf')


def _there(name: str) -> Command:
    return sdf_to_urdf if _is_sdf(name) else urdf_to_sdf


def _back(name: str) -> Command:
    return urdf_to_sdf if _is_sdf(name) else sdf_to_urdf


@functools.cache
def _read(path: Path) -> Robot:
    return read_robot(str(path), Report())[0]


def _original(name: str) -> Robot:
    return _read(FIXTURES[name])


Ways = Callable[[str], tuple[Path, Path]]


@pytest.fixture(scope='module')
def ways(tmp_path_factory: pytest.TempPathFactory) -> Ways:
    """Return a function that converts a fixture, and converts the result back."""
    return functools.cache(lambda name: _convert(name, tmp_path_factory.mktemp('ways')))


def _convert(name: str, folder: Path, options: Sequence[str] = ()) -> tuple[Path, Path]:
    there, back = folder / f'{name}.there', folder / f'{name}.back'
    given: dict[Command, list[str]] = {urdf_to_sdf: [*options], sdf_to_urdf: []}
    assert _there(name)([str(FIXTURES[name]), '-o', str(there), *given[_there(name)]]) == 0
    assert _back(name)([str(there), '-o', str(back), *given[_back(name)]]) == 0
    return there, back


def test_number_of_fixtures() -> None:
    assert len(ERRORS) >= 60
    assert len(WARNINGS) >= 20
    assert len(FINE) >= 60
    assert len(TUTORIAL) == 2
    assert len(ERRORS + CONVERTED) == len(FIXTURES)


def test_errors(tmp_path: Path, capfd: Text) -> None:
    assert failures(partial(_check_error, tmp_path, capfd), rows_of(ERRORS)) == []


def _check_error(tmp_path: Path, capfd: Text, name: str) -> None:
    command, path = _there(name), FIXTURES[name]
    capfd.readouterr()  # of a row that failed
    assert command([str(path), '-o', str(tmp_path / 'output')]) == 2
    output, message = capfd.readouterr()
    assert output == ''
    assert list(tmp_path.iterdir()) == []
    assert message.count('\n') == 1
    assert message.startswith(f'{command.__name__}: error: {path}')
    for words in _expected(name):
        assert words in message
    line = _expected_line(name)
    if line:
        assert f'{path}:{line}: <' in message


def test_warnings(tmp_path: Path, capfd: Text) -> None:
    assert failures(partial(_check_warnings, tmp_path, capfd), rows_of(WARNINGS)) == []


def _check_warnings(tmp_path: Path, capfd: Text, name: str) -> None:
    command, path = _there(name), FIXTURES[name]
    capfd.readouterr()  # of a row that failed
    assert command([str(path)]) == 0
    output, message = capfd.readouterr()
    etree.fromstring(output.encode())
    for note in message.splitlines():
        _, _, place = note.partition(f'{command.__name__}: warning: ')
        assert place.startswith((f'{path}', f'{ROBOTS / "sdf" / "parts"}'))
    for words in _expected(name):
        assert words in message
    line = _expected_line(name)
    if line:
        assert f'{path}:{line}: <' in message
    # A file with warnings is converted, too.
    written = tmp_path / name
    assert command([str(path), '--strict', '-o', str(written)]) == 1
    assert written.read_text() == output


def test_fixtures_without_warnings(capfd: Text) -> None:
    assert failures(partial(_check_no_warning, capfd), rows_of(FINE)) == []


def _check_no_warning(capfd: Text, name: str) -> None:
    capfd.readouterr()  # of a row that failed
    assert _there(name)([str(FIXTURES[name]), '--strict']) == 0
    output, message = capfd.readouterr()
    assert message == ''
    etree.fromstring(output.encode())


def test_conversion_back_has_the_same_robot(ways: Ways) -> None:
    assert failures(partial(_check_same_robot, ways), rows_of(RESTORED)) == []


def _check_same_robot(ways: Ways, name: str) -> None:
    original = _original(name)
    for path in ways(name):
        found = with_original_names(_read(path))
        assert differences(original, found, samples=2, tolerance=1e-12) == []


def test_conversion_back_restores_extensions(ways: Ways) -> None:
    assert failures(partial(_check_extensions, ways), rows_of(
        name for name in RESTORED if name not in CORRECTED and name not in COMPUTED_POSES)) == []


def _check_extensions(ways: Ways, name: str) -> None:
    _, back = ways(name)
    assert Counter(_extension_entries(_read(back))) == Counter(_extension_entries(_original(name)))


@pytest.mark.parametrize('name', CORRECTED)
def test_corrected_extensions_after_a_round_trip(name: str, ways: Ways) -> None:
    _, back = ways(name)
    original, restored = (Counter(_extension_entries(robot))
                          for robot in (_original(name), _read(back)))
    removed, added = CORRECTED[name]
    assert (original - restored, restored - original) == (Counter(removed), Counter(added))


@pytest.mark.parametrize('name', COMPUTED_POSES)
def test_extensions_beside_computed_poses(name: str, ways: Ways) -> None:
    _, back = ways(name)
    original, restored = (Counter(
        entry for entry in _extension_entries(robot) if entry[1][-1] != 'pose')
        for robot in (_original(name), _read(back)))
    assert restored == original


@pytest.mark.parametrize('name', COMPUTED_POSES)
def test_computed_poses_after_a_round_trip(name: str, ways: Ways) -> None:
    _, back = ways(name)
    found = [(path[-2], attributes, [*map(float, text.split())])
             for _, path, attributes, text in _extension_entries(_read(back))
             if path[-1] == 'pose']
    assert sorted(found) == [(tag, (), pytest.approx(numbers, abs=1e-12))
                             for tag, numbers in sorted(COMPUTED_POSES[name].items())]


def test_relative_poses_keep_all_numbers(tmp_path: Path) -> None:
    assert failures(partial(_check_numbers, tmp_path), rows_of(PLAIN_URDF)) == []


def _check_numbers(tmp_path: Path, name: str) -> None:
    _, back = _convert(name, tmp_path, ['--poses', 'relative'])
    original, restored = _original(name), _read(back)
    assert differences(original, restored, samples=0, tolerance=0) == []
    assert [joint.placement for joint in restored.joints] == [
        joint.placement for joint in original.joints]
    assert {link.name: _numbers(link) for link in restored.links} == {
        link.name: _numbers(link) for link in original.links}


def test_relative_poses_of_sdf(tmp_path: Path) -> None:
    assert failures(partial(_check_relative_poses, tmp_path), rows_of(
        name for name in RESTORED if _is_sdf(name))) == []


def _check_relative_poses(tmp_path: Path, name: str) -> None:
    _, back = _convert(name, tmp_path, ['--poses', 'relative'])
    assert differences(_original(name), _read(back), samples=2, tolerance=1e-12) == []


@pytest.mark.quick_cases(1)
@pytest.mark.parametrize('version', ['1.7', '1.8', '1.10', '1.12'])
def test_versions_of_sdf(version: str, tmp_path: Path) -> None:
    wrong = []
    for name in PLAIN_URDF:
        _, back = _convert(name, tmp_path, ['--sdf-version', version])
        original, restored = _original(name), _read(back)
        if (differences(original, restored, samples=1, tolerance=1e-12)
                or Counter(_extension_entries(restored))
                != Counter(_extension_entries(original))):
            wrong.append(name)
    assert wrong == []


PLACES = [(name, *fact.groups()) for name in CONVERTED for fact in re.finditer(
    r'<!-- (link|joint|frame) (\S+): ([-\d. e]+) -->', _text(name))]
AXES = [(name, *fact.groups()) for name in CONVERTED for fact in re.finditer(
    r'<!-- axis (\S+): ([-\d. e]+) -->', _text(name))]


@functools.cache
def _kinematics(name: str) -> Kinematics:
    return Kinematics(_original(name))


def test_frames_in_comments() -> None:
    assert failures(_check_frame, PLACES) == []


def _check_frame(name: str, kind: str, thing: str, numbers: str) -> None:
    x, y, z, roll, pitch, yaw = map(float, numbers.split())
    found = _kinematics(name).pose(FrameId(kind, thing))
    expected = Pose((x, y, z), (roll, pitch, yaw)).transform()
    assert found.translation == pytest.approx(expected.translation, abs=1e-12)
    assert found.rotation == pytest.approx(expected.rotation, abs=1e-12)


def test_axes_in_comments() -> None:
    assert failures(_check_axis, AXES) == []


def _check_axis(name: str, thing: str, numbers: str) -> None:
    joint, = (joint for joint in _original(name).joints if joint.name == thing)
    found = normalised(joint.axes[0].xyz)
    assert found == pytest.approx(tuple(map(float, numbers.split())), abs=1e-12)


# Elements of a <gazebo> block have their poses in the frame of the parent joint.
MOVED = [
    ('ok_joint_frame_away_from_the_child.sdf', 'knock', '0.8 0 0 0 0 -1.5707963267948966'),
    ('ok_light_with_a_placed_pose.sdf', 'bulb', '0.5 1 1 0 0 -1.5707963267948966'),
    ('ok_light_with_a_placed_pose.sdf', 'turned', '0.5 0 0 0 0 1.5707963267948966'),
    ('ok_sensors.sdf', 'eye', '0.1 0 0 0 0 0'),
]


@pytest.mark.parametrize(('name', 'thing', 'numbers'), MOVED)
def test_poses_in_gazebo_blocks(name: str, thing: str, numbers: str, ways: Ways) -> None:
    there = etree.parse(ways(name)[0])
    pose, = there.xpath(f'gazebo/*[@name="{thing}"]/pose')
    assert pose.attrib == {}
    assert [*map(float, pose.text.split())] == pytest.approx(
        [*map(float, numbers.split())], abs=1e-12)


@pytest.fixture(scope='module')
def yourdfpy() -> ModuleType:
    return pytest.importorskip('yourdfpy', reason='not packaged for ROS: pip install yourdfpy')


def test_forward_kinematics_of_yourdfpy(ways: Ways, yourdfpy: ModuleType) -> None:
    assert failures(partial(_check_with_yourdfpy, ways, yourdfpy), rows_of(
        name for name in CONVERTED if name not in NOT_IN_YOURDFPY)) == []


def _check_with_yourdfpy(ways: Ways, yourdfpy: ModuleType, name: str) -> None:
    there, back = ways(name)
    path = there if _is_sdf(name) else back
    robot = _read(path)
    seen = yourdfpy.URDF.load(str(path), load_meshes=False, build_collision_scene_graph=False)
    generator = random.Random(7)
    for sample in range(2):
        positions = {joint: generator.uniform(-1, 1) if sample else 0.0
                     for joint in seen.actuated_joint_names}
        _compare_with_yourdfpy(robot, seen, positions)


def _compare_with_yourdfpy(robot: Robot, seen: Any, positions: dict[str, float]) -> None:
    kinematics = Kinematics(robot)
    # yourdfpy reads floating joints as fixed. Screw joints are floating in URDF.
    moved = {name: value for name, value in positions.items()
             if seen.joint_map[name].type in ('revolute', 'continuous', 'prismatic')}
    seen.update_cfg({**dict.fromkeys(positions, 0.0), **moved})
    poses = kinematics.forward(with_mimics(robot, {name: (moved[name],) for name in moved}))
    base, = kinematics.roots
    home = poses[FrameId('link', base)].inverse()
    # The frame of a link in URDF is that of its parent joint.
    for joint in kinematics.parent_joint.values():
        ours = home @ poses[FrameId('joint', joint.name)]
        theirs = seen.get_transform(joint.child, base)
        assert math.dist(ours.translation, theirs[:3, 3]) < 1e-9
        assert math.dist(ours.rotation, theirs[:3, :3].ravel()) < 1e-9


def _numbers(link: Link) -> tuple[object, ...]:
    """Return the numbers of the placements in a link, and its mass."""
    inertial = link.inertial if link.has_mass else None
    return (link.placement.pose, [shape.placement.pose for shape in link.visuals],
            [shape.placement.pose for shape in link.collisions],
            inertial and (inertial.placement.pose, inertial.mass, inertial.inertia))


def _extension_entries(robot: Robot) -> Iterator[Entry]:
    yield from _entries(robot.extension, 'model')
    for link in robot.links:
        yield from _entries(link.extension, f'link {link.name}')
        for index, shape in enumerate(link.visuals):
            yield from _entries(shape.extension, f'visual {link.name} {index}')
        for index, shape in enumerate(link.collisions):
            yield from _entries(shape.extension, f'collision {link.name} {index}')
    for joint in robot.joints:
        yield from _entries(joint.extension, f'joint {joint.name}')
    for frame in robot.frames:
        yield from _entries(frame.extension, f'frame {frame.name}')


def _entries(extension: Extension, owner: str) -> Iterator[Entry]:
    for root in (extension.urdf, extension.sdf):
        for element in () if root is None else root.iter(etree.Element):
            path = [str(step.tag) for step in (element, *element.iterancestors())]
            attributes = tuple(sorted((str(name), str(value)) for name, value
                                      in element.attrib.items() if name != PARTLY_READ))
            yield owner, tuple(reversed(path)), attributes, (element.text or '').strip()
