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

"""Robots that this package reads and writes, compared with libsdformat and urdfdom."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
import itertools
import json
import math
import os
from pathlib import Path
from random import Random
import re
import subprocess
from typing import Any
import xml.etree.ElementTree as ElementTree

from opencv_tools.robot.convert import convert_to_sdf, convert_to_urdf, SdfOptions, UrdfOptions
from opencv_tools.robot.kinematics import Kinematics
from opencv_tools.robot.load import read_robot
from opencv_tools.robot.lumping import without_massless
from opencv_tools.robot.model import Axis, FrameId, Inertial, Link, MODEL, Placement, Robot
from opencv_tools.robot.physical import without_zero_masses
from opencv_tools.robot.pose import normalised, Pose, Tensor, Transform
from opencv_tools.robot.renaming import with_valid_sdf_names
from opencv_tools.robot.sdf.reader import read_sdf
from opencv_tools.robot.xml.document import DescriptionError, parse, to_bytes
from opencv_tools.robot.xml.numbers import UNLIMITED
from opencv_tools.robot.xml.report import Report
import pytest
import robots
from waiting import communicate, LONGEST_SECONDS

ROOT = Path(__file__).parents[2]
DATA = ROOT / 'test' / 'data' / 'robots'
SHIPPED = [ROOT / 'urdf' / 'my_robot.urdf.xacro', ROOT / 'urdf' / 'my_robot.urdf',
           ROOT / 'sdf' / 'my_robot' / 'model.sdf', ROOT / 'urdf' / 'my_arm.urdf',
           ROOT / 'sdf' / 'my_arm' / 'model.sdf']
# Debian's libsdformat does not know inertials that are computed, and it reports the preserved mesh
# without a name. The tests of the readers and of the inertia hold these files.
NOT_JUDGED = {'ok_auto_inertial.sdf', 'warning_auto_inertial_of_a_mesh.sdf',
              'warning_mesh_of_an_empty_filename.urdf'}
ROBOTS = [*SHIPPED, *sorted(
    path for path in DATA.glob('*/*.*')
    if path.name.startswith(('ok_', 'warning_', 'tutorial_')) and path.name not in NOT_JUDGED)]
SDF = [path for path in ROBOTS if path.suffix == '.sdf']

# Debian's libsdformat supports up to 1.9. It reads 1.11 with a message.
VERSIONS = ('1.9', '1.11')
POSES = ('model', 'relative')
UNKNOWN_VERSION = re.compile(
    r'Error \[Converter\.cc:\d+\] Unable to convert from SDF version 1\.11 to 1\.9')

TOLERANCE = 1e-12  # metres, and norm of the difference of unit quaternions

# Messages of libsdformat for the SDF files that only this package reads.
LIMITS_OF_LIBSDFORMAT: Mapping[str, str] = {
    'warning_color_above_1.sdf': 'The value <diffuse>200 200 200 1</diffuse> is invalid',
    'warning_text_before_the_declaration.sdf': 'Error parsing XML',
}
# Joints without an axis, for which libsdformat uses no default.
WITHOUT_AXIS: Mapping[str, str] = {
    'warning_axis_missing.sdf': 'shoulder/0',
}
# Messages of urdfdom for the URDF files that it reads only in part.
MESSAGES_OF_URDFDOM: Mapping[str, str] = {
    'warning_geometry_empty.urdf': 'Geometry tag contains no child element',
    'warning_geometry_unknown.urdf': "Unknown geometry type 'ellipsoid'",
    'warning_mesh_without_filename.urdf': 'Mesh must contain a filename attribute',
    'warning_texture_without_filename_or_color.urdf': r"material 'wood' undefined",
    'warning_visual_without_geometry.urdf': 'Could not parse visual element',
    'warning_undefined_material.urdf': r"material 'red' undefined",
}
NO_MESSAGE = r'\A\Z'
# Files that a parser of URDF refuses, and this package reads without a warning.
LIMITS_OF_URDFDOM_6: Mapping[str, str] = {
    'ok_declaration_and_comments.urdf': 'XML_ERROR_PARSING_DECLARATION',
}
# Debian's urdfdom 3, and version 6 of PyPI, which is newer than that of any release of ROS.
OLD, NEW = 'check_urdf', os.environ.get('OPENCV_TOOLS_CHECK_URDF', '')
URDFDOMS = [OLD, *([NEW] if NEW else [])]
# urdfdom before version 5, also that of ROS Jazzy, refuses the other versions of URDF.
NEWER_URDF = "Invalid 'version' specified; only version 1.0 is currently supported"


@dataclass(frozen=True)
class Case:
    """
    A file that was written, and the expected robot.

    :param robot: robot with the names of the file.
    """

    path: Path
    robot: Robot


@dataclass(frozen=True)
class Written:
    """All files written from one robot; ``original`` is its own file if that is SDF."""

    original: Case | None
    sdf: Sequence[Case]
    urdf: Sequence[Case]  # as it is written by default, and of version 1.0


def write_all(path: Path, folder: Path) -> Written:
    """Read a robot and write it in every way; from SDF to SDF through URDF."""
    robot, language = read_robot(str(path), Report())
    source, original = robot, None
    name = '_'.join(path.parts[-2:])  # several files are called model.sdf
    cases = []
    for version in ('1.0', ''):
        urdf = folder / f'{name}.{version}.urdf'
        urdf.write_bytes(to_bytes(convert_to_urdf(
            robot, Report(), UrdfOptions(version=version))))
        back, _ = read_robot(str(urdf), Report())
        cases.append(Case(urdf, back))
    if language == 'sdf':
        root = parse(path.read_bytes(), str(path), Report())
        source, original = back, Case(path, read_sdf(root, Report()))
    return Written(original, list(write_sdf_of(source, name, folder)), cases)


def write_sdf_of(robot: Robot, name: str, folder: Path) -> Iterator[Case]:
    """Write a robot as SDF in both versions and with both kinds of poses."""
    for version in VERSIONS:
        for poses in POSES:
            root = convert_to_sdf(
                robot, Report(), SdfOptions(version=version, relative=poses == 'relative'))
            path = folder / f'{name}.{version}.{poses}.sdf'
            path.write_bytes(to_bytes(root))
            weighed = without_zero_masses(with_valid_sdf_names(robot, Report()), Report())
            yield Case(path, without_massless(weighed, Report()))


@pytest.fixture(scope='session')
def written(tmp_path_factory: pytest.TempPathFactory) -> Mapping[Path, Written]:
    folder = tmp_path_factory.mktemp('parsed')
    return {path: write_all(path, folder) for path in ROBOTS}


@pytest.fixture(scope='session')
def libsdformat(written: Mapping[Path, Written]) -> Callable[[Path], dict[str, Any]]:
    """Return a function for the result of libsdformat, which has read all files at once."""
    files = [case.path for one in written.values()
             for case in (*one.sdf, *([one.original] if one.original else []))]
    results = run_libsdformat(files)
    return lambda path: results[str(path)]


def run_libsdformat(files: Sequence[Path]) -> dict[str, dict[str, Any]]:
    """Read files with libsdformat, 50 ms each, in one process for each core."""
    cores = len(os.sched_getaffinity(0))
    processes = [
        subprocess.Popen([os.environ['OPENCV_TOOLS_INTEROP'], *map(str, files[number::cores])],
                         stdout=subprocess.PIPE) for number in range(cores)]
    results: dict[str, dict[str, Any]] = {}
    for process in processes:
        results.update(json.loads(communicate(process)[0]))
        assert process.returncode == 0
    return results


def sdf_named(table: Mapping[str, str]) -> list[Path]:
    """Return the SDF files of a table; assert that each is there."""
    found = [path for path in SDF if path.name in table]
    assert len(found) == len(table)
    return found


def messages(result: Mapping[str, Any]) -> list[str]:
    """Return the messages of libsdformat except those about the unsupported version."""
    lines = re.sub(r'\x1b\[[\d;]*m', '', result['messages']).splitlines()
    return [line for line in lines if line and not UNKNOWN_VERSION.fullmatch(line)]


@pytest.mark.parametrize('path', ROBOTS, ids=lambda path: path.name)
def test_validity_of_written_sdf(
        path: Path, written: Mapping[Path, Written], libsdformat: Callable[[Path], dict[str, Any]],
        record_property: Callable[[str, object], None]) -> None:
    for case in written[path].sdf:
        result = libsdformat(case.path)
        assert result['valid'], result['messages'] + case.path.read_text()
        assert messages(result) == [], case.path.read_text()
    record_property('written SDF files that libsdformat reads as valid and without messages',
                    len(written[path].sdf))


@pytest.mark.parametrize('path', ROBOTS, ids=lambda path: path.name)
def test_poses_of_written_sdf(
        path: Path, written: Mapping[Path, Written], libsdformat: Callable[[Path], dict[str, Any]],
        record_property: Callable[[str, object], None]) -> None:
    for case in written[path].sdf:
        count, largest = compare(case.robot, libsdformat(case.path))
        record_property('poses in written SDF files that libsdformat resolves alike', count)
        record_property('largest difference, in metres or of unit quaternions', largest)


@pytest.mark.parametrize('path', sdf_named(LIMITS_OF_LIBSDFORMAT), ids=lambda path: path.name)
def test_sdf_that_libsdformat_does_not_read(
        path: Path, libsdformat: Callable[[Path], dict[str, Any]],
        record_property: Callable[[str, object], None]) -> None:
    assert LIMITS_OF_LIBSDFORMAT[path.name] in libsdformat(path)['messages']
    record_property('SDF files that libsdformat does not read', 1)


@pytest.mark.parametrize('path', [path for path in SDF if path.name not in {
    *LIMITS_OF_LIBSDFORMAT, *WITHOUT_AXIS}], ids=lambda path: path.name)
def test_poses_of_read_sdf(
        path: Path, written: Mapping[Path, Written], libsdformat: Callable[[Path], dict[str, Any]],
        record_property: Callable[[str, object], None]) -> None:
    original = written[path].original
    assert original is not None
    count, _ = compare(original.robot, libsdformat(path))
    record_property('poses in other SDF files that libsdformat resolves alike', count)


@pytest.mark.parametrize('path', sdf_named(WITHOUT_AXIS), ids=lambda path: path.name)
def test_poses_without_an_axis(
        path: Path, written: Mapping[Path, Written], libsdformat: Callable[[Path], dict[str, Any]],
        record_property: Callable[[str, object], None]) -> None:
    original = written[path].original
    assert original is not None
    result, joint = libsdformat(path), WITHOUT_AXIS[path.name]
    axes = result['models'][original.robot.name].setdefault('axes', {})
    assert joint not in axes
    axes[joint] = expected(original.robot)[1][joint]
    count, _ = compare(original.robot, result)
    record_property('poses in other SDF files that libsdformat resolves alike', count)


@pytest.mark.parametrize('path', ROBOTS, ids=lambda path: path.name)
def test_tree_of_written_urdf(
        path: Path, written: Mapping[Path, Written],
        record_property: Callable[[str, object], None]) -> None:
    for case, program in itertools.product(written[path].urdf, URDFDOMS):
        finished = check_urdf(case.path, program)
        if is_newer(case.path) and program == OLD:
            assert path.suffix == '.urdf' and is_newer(path)
            assert NEWER_URDF in finished.stderr
            record_property('written URDF files of versions that urdfdom 3 refuses', 1)
            continue
        assert 'Successfully Parsed XML' in finished.stdout, finished.stderr
        assert re.search(MESSAGES_OF_URDFDOM.get(path.name, NO_MESSAGE), finished.stderr)
        assert tree(finished.stdout) == {
            joint.child: joint.parent for joint in case.robot.joints if not joint.is_loop}
        record_property('written URDF files that urdfdom parses to the same tree', 1)


@pytest.mark.parametrize('path', [path for path in ROBOTS if path.suffix == '.urdf' and (
    'xmlns:xacro' not in path.read_text())], ids=lambda path: path.name)
def test_messages_about_read_urdf(
        path: Path, record_property: Callable[[str, object], None]) -> None:
    report = Report()
    robot, _ = read_robot(str(path), report)
    convert_to_sdf(robot, report)
    for program in URDFDOMS:
        finished = check_urdf(path, program)
        if is_newer(path) and program == OLD:
            assert NEWER_URDF in finished.stderr
        elif path.name in LIMITS_OF_URDFDOM_6 and program == NEW:
            assert LIMITS_OF_URDFDOM_6[path.name] in finished.stderr
        elif finished.stderr or 'Successfully Parsed XML' not in finished.stdout:
            assert report.warnings, finished.stderr
        record_property('URDF files whose messages of urdfdom are warnings of ours', 1)


@pytest.mark.parametrize('path', ROBOTS, ids=lambda path: path.name)
def test_written_urdf_of_the_newest_version(path: Path, tmp_path: Path) -> None:
    if not NEW:
        pytest.skip('PyPI has no urdfdom for this machine')
    robot, report = read_robot(str(path), Report())[0], Report()
    file = tmp_path / 'robot.urdf'
    try:
        file.write_bytes(to_bytes(convert_to_urdf(robot, report, UrdfOptions(version='1.2'))))
    except DescriptionError as err:
        assert path.name == 'warning_lower_greater_than_upper.urdf' and 'refuses' in str(err)
        return
    finished = check_urdf(file, NEW)
    assert 'Successfully Parsed XML' in finished.stdout, finished.stderr
    assert re.search(MESSAGES_OF_URDFDOM.get(path.name, NO_MESSAGE), finished.stderr)


@pytest.mark.parametrize('language', ['urdf', 'sdf'])
def test_random_robots(
        language: str, tmp_path: Path, record_property: Callable[[str, object], None]) -> None:
    generated: list[Written] = []
    for seed in range(12):
        path = tmp_path / f'made_up_{seed}.{language}'
        path.write_bytes(ElementTree.tostring(getattr(robots, language)(Random(seed), 8)))
        generated.append(write_all(path, tmp_path))
    results = run_libsdformat([case.path for one in generated for case in one.sdf])
    for one in generated:
        for case in one.sdf:
            result = results[str(case.path)]
            assert result['valid'] and messages(result) == [], (
                result['messages'] + case.path.read_text())
            compare(case.robot, result)
        for case, program in itertools.product(one.urdf, URDFDOMS):
            text, finished = case.path.read_text(), check_urdf(case.path, program)
            if is_newer(case.path) and program == OLD:
                assert language == 'urdf' and NEWER_URDF in finished.stderr
                continue
            assert 'Successfully Parsed XML' in finished.stdout, finished.stderr + text
            assert finished.stderr == '', text
    record_property('SDF files of random robots that libsdformat reads', len(results))


@pytest.mark.parametrize('path', [
    *SHIPPED[1:3], *sorted(DATA.glob('*/tutorial_*'))], ids=lambda path: path.name)
def test_robot_of_the_tutorial_in_the_other_format(path: Path, tmp_path: Path) -> None:
    robot, language = read_robot(str(path), Report())
    sdf, urdf = tmp_path / 'robot.sdf', tmp_path / 'robot.urdf'
    urdf.write_bytes(to_bytes(convert_to_urdf(robot, Report())))
    sdf.write_bytes(to_bytes(convert_to_sdf(
        robot if language == 'urdf' else read_robot(str(urdf), Report())[0], Report(),
        SdfOptions(version='1.9'))))
    printed = subprocess.run(['ign', 'sdf', '-p', str(sdf)], capture_output=True, text=True,
                             timeout=LONGEST_SECONDS, check=True).stdout
    model, tree_of_urdf = ElementTree.fromstring(printed), ElementTree.parse(urdf).getroot()
    assert len(model.findall('.//link')) == len(tree_of_urdf.findall('link')) == 2
    assert len(model.findall('.//joint')) == len(tree_of_urdf.findall('joint')) == 1
    colors = [shape.material.color for link in robot.links for shape in link.visuals
              if shape.material and shape.material.color]
    assert colors and sorted(colors) == sorted(
        tuple(map(float, (color.text or '').split())) for color in model.findall('.//diffuse'))


def test_rejected_values(tmp_path: Path) -> None:
    paths = [tmp_path / f'{number}.sdf' for number in range(len(robots.PARTS_OF_SDF))]
    for path, (content, _) in zip(paths, robots.PARTS_OF_SDF):
        path.write_text(f'<sdf version="1.9"><model name="m"><link name="a">{content}</link>'
                        '</model></sdf>')
    results = run_libsdformat(paths)
    for path, (content, words) in zip(paths, robots.PARTS_OF_SDF):
        assert results[str(path)]['valid'] is not bool(words), content


@pytest.mark.parametrize(('mass', 'inertia'), [
    (1, (1, 0, 0, 1, 0, 1)), (1, (1, 0, 0, 1, 0, 2)), (1, (1, 0, 0, 1, 0, 2.1)),
    (1, (0, 0, 0, 0, 0, 0)), (1e-9, (0, 0, 0, 0, 0, 0)), (1e-9, (0, 0, 0, 0, 0, 1)),
    (-1, (1, 0, 0, 1, 0, 1)), (1, (-1, 0, 0, 1, 0, 1)), (1, (1, 5, 0, 1, 0, 1)),
    (1, (1, 0.9999, 0, 1, 0, 1)), (1, (1, 0.4, 0, 1, 0, 1)), (1, (1e-6, 0, 0, 1e-6, 0, 2.1e-6)),
    (1, (2, 0.5, 0.25, 2, -0.5, 3)), (1, (2, 0.5, 1.25, 2, -0.5, 3)),
    (1, (0.1, 0, 0, 0.2, 0, 0.3)),
])
def test_rejected_moments_of_inertia(
        mass: float, inertia: Tensor, tmp_path: Path) -> None:
    placement = Placement(Pose(), FrameId('link', 'a'))
    xx, xy, xz, yy, yz, zz = map(float, inertia)
    inertial = Inertial(placement, float(mass), (xx, xy, xz, yy, yz, zz))
    robot = Robot(name='robot',
                  links=(Link(name='a', placement=Placement(Pose(), MODEL), inertial=inertial),))
    path = tmp_path / 'robot.sdf'
    report = Report()
    path.write_bytes(to_bytes(convert_to_sdf(robot, report, SdfOptions(version='1.9'))))
    assert run_libsdformat([path])[str(path)]['valid'] is not bool(report.warnings)


def test_command_and_library_agree(written: Mapping[Path, Written],
                                   libsdformat: Callable[[Path], dict[str, Any]]) -> None:
    for path in SHIPPED:
        case = written[path].sdf[0]
        finished = ign_check(case.path)
        assert (finished.returncode, finished.stdout) == (0, 'Valid.\n')
        assert libsdformat(case.path)['valid']
    wrong = sorted(DATA.glob('sdf/error_*_unknown*.sdf'))
    assert len(wrong) > 3
    results = run_libsdformat(wrong)
    for path in wrong:
        assert ('Valid' in ign_check(path).stdout) == results[str(path)]['valid'], path


def is_newer(path: Path) -> bool:
    """Return whether a file says another version of URDF than 1.0."""
    return re.search(r'<robot[^>]*\sversion="(?!1\.0")', path.read_text()) is not None


def check_urdf(path: Path, program: str = OLD) -> subprocess.CompletedProcess[str]:
    """Run the command of a urdfdom."""
    return subprocess.run([program, str(path)], capture_output=True, text=True,
                          timeout=LONGEST_SECONDS, check=False)


def ign_check(path: Path) -> subprocess.CompletedProcess[str]:
    """Run the command of Gazebo."""
    return subprocess.run(['ign', 'sdf', '-k', str(path)], capture_output=True, text=True,
                          timeout=LONGEST_SECONDS, check=False)


def compare(robot: Robot, result: Mapping[str, Any]) -> tuple[int, float]:
    """Compare a robot with that of libsdformat; return number and largest distance of poses."""
    model = result['models'][robot.name]
    assert model['errors'] == ''
    poses, axes, masses = expected(robot)
    assert {kind: set(group) for kind, group in poses.items() if kind != 'inertials'} == {
        kind: set(model.get(kind, {})) for kind in poses if kind != 'inertials'}
    largest = 0.0
    for kind, group in poses.items():
        for name, transform in group.items():
            distance = distance_of(transform, model[kind][name])
            assert distance <= TOLERANCE, (kind, name, transform, model[kind][name])
            largest = max(largest, distance)
    assert set(axes) <= set(model.get('axes', {}))
    for name, values in axes.items():
        assert limited(model['axes'][name]) == pytest.approx(values, abs=1e-12), name
    for name, values in masses.items():
        assert model['masses'][name] == pytest.approx(values, abs=1e-12), name
    return sum(map(len, poses.values())), largest


def expected(robot: Robot) -> tuple[dict[str, dict[str, Transform]], dict[str, list[float]],
                                    dict[str, list[float]]]:
    """Return poses in the model by kind and name, axes, and masses with moments of inertia."""
    kinematics = Kinematics(robot)
    links = [link for link in robot.links if not link.is_world]
    # SDF does not support these joints; their links are placed without them.
    joints = [joint for joint in robot.joints if joint.type not in ('floating', 'planar')]
    poses = {
        'links': {link.name: kinematics.pose(FrameId('link', link.name)) for link in links},
        'joints': {joint.name: kinematics.pose(FrameId('joint', joint.name))
                   for joint in joints},
        'frames': {frame.name: kinematics.pose(FrameId('frame', frame.name))
                   for frame in robot.frames},
        'visuals': shapes(kinematics, links, 'visuals'),
        'collisions': shapes(kinematics, links, 'collisions'),
        'inertials': {link.name: kinematics.placement_pose(link.inertial.placement)
                      for link in links if link.inertial},
    }
    axes = {f'{joint.name}/{number}': axis_values(axis, joint.type) for joint in joints
            if joint.type != 'fixed' for number, axis in enumerate(joint.axes)}
    masses = {link.name: [link.inertial.mass, *link.inertial.inertia]
              for link in links if link.inertial}
    return poses, axes, masses


def shapes(kinematics: Kinematics, links: Sequence[Link], kind: str) -> dict[str, Transform]:
    """Return the poses of visuals or collisions in the model."""
    return {f'{link.name}/{shape.name}': kinematics.placement_pose(shape.placement)
            for link in links for shape in getattr(link, kind)}


def axis_values(axis: Axis, kind: str) -> list[float]:
    """Return direction, limits, damping and friction of an axis in the order of libsdformat."""
    limit, dynamics = axis.limit, axis.dynamics
    lower, upper = (limit.lower, limit.upper) if limit else (-math.inf, math.inf)
    if kind == 'continuous':
        lower, upper = -math.inf, math.inf
    effort, velocity = (limit.effort, limit.velocity) if limit else (-1.0, -1.0)
    return [*normalised(axis.xyz), lower, upper, effort if effort >= 0 else math.inf,
            velocity if velocity >= 0 else math.inf,
            (dynamics.damping if dynamics else None) or 0.0,
            (dynamics.friction if dynamics else None) or 0.0]


def limited(values: Sequence[float]) -> list[float]:
    """Return an axis of libsdformat, with infinity for no limit."""
    *xyz, lower, upper, effort, velocity, damping, friction = values
    return [*xyz, *(math.copysign(math.inf, value) if abs(value) >= UNLIMITED else value
                    for value in (lower, upper)),
            *(math.inf if value < 0 or value >= UNLIMITED else value
              for value in (effort, velocity)), damping, friction]


def distance_of(transform: Transform, other: Sequence[float]) -> float:
    """Return the distance of two poses, of positions or of unit quaternions."""
    quaternion = transform.quaternion()
    return max(math.dist(transform.translation, other[:3]),
               min(math.dist(quaternion, other[3:]),
                   math.dist(quaternion, [-value for value in other[3:]])))


def tree(output: str) -> dict[str, str]:
    """Read the tree that check_urdf prints and return the parent of each link."""
    parents: dict[str, str] = {}
    above: list[str] = []
    for line in output.splitlines():
        root = re.match(r'root Link: (.*) has \d+ child\(ren\)$', line)
        child = re.match(r'( +)child\(\d+\):  (.*)$', line)
        if root:
            above = [root[1]]
        elif child:
            depth = len(child[1]) // 4
            del above[depth:]
            parents[child[2]] = above[-1]
            above.append(child[2])
    return parents
