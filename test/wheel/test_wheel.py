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
The package as pip installs it from a built wheel, where there is nothing else.

Each environment has one extra. The commands run without environment variables, so there is neither
ROS nor a library of this machine.
"""

from __future__ import annotations

from collections.abc import Iterator
from email import message_from_bytes
from pathlib import Path
import re
import shutil
import subprocess
import sys
import tarfile
import zipfile

import cv2
from dataset_bags import Drive
from documentation import ROOT
import jobs
from opencv_tools.calibration.boards import parse_board
import pytest
from rendered_boards import poses, small_camera
from waiting import LONGEST_SECONDS

_MADE = shutil.ignore_patterns(
    '.git', '.venv*', 'build', 'install', 'log', 'demo', '*.egg-info', '__pycache__', '.*_cache')
COMMANDS = sorted(re.findall(r"'(\w+) = opencv_tools", (ROOT / 'setup.py').read_text()))
_NO_SCREEN = 'test/nodes/test_viewer_http.py::test_snapshots'
#: Sentences of the pages that promise that something is not needed, and what shows it: a job of
#: ``jobs.py``, a test, or a file with a test of it.
PROMISES = {
    'README.md: need no ROS': 'test/support/typed_pages.py::README.md',
    'architecture.md: need neither ROS nor OpenCV':
        'test/package/test_layers.py::test_pure_modules_without_ros_and_opencv',
    'architecture.md: needs no ROS': 'nodes',
    'bags.md: needs no ROS': 'mcap',
    'bags.md: need nothing': 'db3',
    'calibration.md: needs no ROS': 'calibration',
    'calibration.md: needs no screen on the robot': _NO_SCREEN,
    'datasets.md: needs neither ROS nor LeRobot nor torch': 'joints of db3',
    'how_do_i.md: needs no screen':
        'test/unit/nodes/test_log_folder.py::test_node_in_an_unwritable_home',
    'how_do_i.md: needs no server': 'page of a robot',
    'networking.md: need no profile file':
        'test/nodes/test_transport.py::test_large_frames_to_a_reliable_subscriber',
    'networking.md: need neither setting':
        'test/nodes/test_transport.py::test_large_frames_to_a_reliable_subscriber',
    'own_node.md: needs no option': 'test/nodes/test_own_node.py::test_slow_detector',
    'platforms.md: need no ROS': 'robots',
    'publisher.md: needs no hardware': 'pictures',
    'robot_view.md: needs no ROS': 'server of a robot',
    'robot_view.md: needs no server and no network': 'page of a robot',
    'viewer.md: needs no screen': _NO_SCREEN,
    'viewer.md: needs no token any more':
        'test/nodes/test_viewer_http.py::test_token_of_the_url_becomes_a_cookie',
    'viewer.md: need no page': 'test/nodes/test_viewer_http.py::test_snapshots',
}


def _pythons() -> dict[str, str]:
    """Return each Python of this machine that the package supports, by its version."""
    names = [sys.executable]
    for name in (f'python3.{minor}' for minor in range(10, 15)):
        path = Path(shutil.which(name) or name)
        names += map(str, path.parents[1].glob(f'versions/*/bin/{name}')
                     if path.parent.name == 'shims' else [path])
    script = 'import ensurepip, sys; print(*sys.version_info[:2], sep="."); print(sys.executable)'
    found: dict[str, str] = {}
    for name in names:
        try:
            shown = subprocess.run([name, '-c', script], capture_output=True, text=True,
                                   timeout=LONGEST_SECONDS, check=True).stdout.split()
        except (OSError, subprocess.CalledProcessError):
            continue
        found.setdefault(shown[0], shown[1])
    return found


PYTHONS = _pythons()
#: Each extra alone in the Python of the tests, and all together in each Python.
CASES = [*((version, 'all') for version in PYTHONS),
         *((next(iter(PYTHONS)), extra) for extra in ('', *jobs.EXTRAS) if extra != 'all')]


def _run_pip(*words: object) -> None:
    finished = subprocess.run(
        [sys.executable, '-m', 'pip', '--cache-dir', ROOT / 'build' / 'pip', *map(str, words)],
        capture_output=True, text=True, check=False, stdin=subprocess.DEVNULL)
    assert finished.returncode == 0, finished.stdout + finished.stderr


@pytest.fixture(scope='session')
def built(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the folder of the sdist and of the wheel that is built from it."""
    folder = tmp_path_factory.mktemp('built')
    shutil.copytree(ROOT, folder / 'source', ignore=_MADE)
    subprocess.run([sys.executable, '-m', 'venv', folder / 'builder'], check=True)
    python = folder / 'builder' / 'bin' / 'python'
    _run_pip('--python', python, 'install', '--quiet', 'build')
    subprocess.run([python, '-m', 'build', '--outdir', folder / 'dist', folder / 'source'],
                   check=True, stdout=subprocess.DEVNULL)
    return folder / 'dist'


@pytest.fixture(scope='session')
def inputs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the folder of the inputs of the jobs."""
    folder = tmp_path_factory.mktemp('inputs')
    for path in (folder / 'drive.mcap', folder / 'drive_db3'):
        Drive(seconds=0.4).write(path)
    shutil.copytree(ROOT / 'urdf', folder / 'urdf')
    shutil.copytree(ROOT / 'meshes', folder / 'meshes')
    shutil.copy(ROOT / 'test' / 'data' / 'big_buck_bunny_720p.mp4', folder / 'clip.mp4')
    (folder / 'views').mkdir()
    board, camera = parse_board(jobs.BOARD), small_camera()
    for number, pose in enumerate(poses(board, camera, 20)):
        cv2.imwrite(str(folder / 'views' / f'{number:03d}.png'), camera.see(board, pose))
    return folder


@pytest.fixture
def folder(inputs: Path, tmp_path: Path) -> Iterator[Path]:
    """Return a folder with the inputs, which is removed afterwards with what the test added."""
    shutil.copytree(inputs, tmp_path / 'work')
    yield tmp_path / 'work'
    shutil.rmtree(tmp_path)


def installed(python: str, extra: str, built: Path, folder: Path) -> Path:
    """Return a new virtual environment that has the wheel and an extra; '' for none."""
    environment = folder / 'environment'
    subprocess.run([python, '-m', 'venv', '--without-pip', environment], check=True)
    wheel, = built.glob('*.whl')
    _run_pip('--python', environment / 'bin' / 'python', 'install', '--quiet', '--no-compile',
             f'{wheel}[{extra}]' if extra else wheel)
    return environment


@pytest.mark.parametrize(('version', 'extra'), CASES)
def test_commands_and_jobs(version: str, extra: str, built: Path, folder: Path) -> None:
    environment = installed(PYTHONS[version], extra, built, folder.parent)
    assert sorted(path.name for path in (environment / 'bin').iterdir()
                  if path.name in COMMANDS) == COMMANDS
    problems = []
    for name in COMMANDS:
        for option, begin in (('--help', f'usage: {name} '), ('--version', f'{name} 0.')):
            end = jobs.run(environment, f'{name} {option}', folder)
            if end.status or end.stderr or not end.stdout.startswith(begin):
                problems.append(f'{name} {option}: {end}')
    extras = jobs.EXTRAS.get(extra, set())
    shown = jobs.run(environment, 'opencv_tools_info', folder).stdout
    assert re.search('^ROS 2 +missing', shown, re.MULTILINE), shown
    for one in extras:
        for library in jobs.BRINGS[one]:
            if not re.search(rf'^{library} +\d', shown, re.MULTILINE):
                problems.append(f'{library} is not there with {one}: {shown}')
    for job in jobs.JOBS.values():
        problems += jobs.problems_of(job, environment, extras, folder)
    assert problems == []


@pytest.mark.parametrize('version', PYTHONS)
def test_pip_of_a_new_environment_installs_commands(
        version: str, built: Path, tmp_path: Path) -> None:
    """The pip that Python brings, which may be years old, puts the commands into bin/."""
    subprocess.run([PYTHONS[version], '-m', 'venv', tmp_path / 'venv'], check=True)
    folder = tmp_path / 'venv' / 'bin'
    subprocess.run([folder / 'pip', 'install', '--quiet', '--no-deps', built.parent / 'source'],
                   check=True)
    assert sorted(path.name for path in folder.iterdir() if path.name in COMMANDS) == COMMANDS
    subprocess.run([folder / 'img_convert', '--version'], check=True)


def test_each_extra_of_setup_is_tested(built: Path) -> None:
    wheel, = built.glob('*.whl')
    with zipfile.ZipFile(wheel) as archive:
        metadata = message_from_bytes(archive.read(
            next(name for name in archive.namelist() if name.endswith('.dist-info/METADATA'))))
        names = {*archive.namelist()}
    assert {one for one in metadata.get_all('Provides-Extra', []) if one != 'test'} == {
        one for one in jobs.EXTRAS if ',' not in one}
    assert metadata['Description-Content-Type'] == 'text/markdown'
    assert str(metadata.get_payload()).startswith('# opencv_tools')
    assert metadata['Keywords'] and len(metadata.get_all('Classifier', [])) > 8
    files = {str(path.relative_to(ROOT)) for path in (ROOT / 'opencv_tools').rglob('*')
             if path.is_file() and path.suffix != '.pyc' and not path.match('*.d.ts')}
    assert files <= names


def test_sdist_has_what_the_readme_links_to(built: Path) -> None:
    sdist, = built.glob('*.tar.gz')
    with tarfile.open(sdist) as archive:
        names = {name.partition('/')[2] for name in archive.getnames()}
    links = {link.partition('#')[0] for link in re.findall(
        r'\]\((?!https?:)([^)]+)\)', (ROOT / 'README.md').read_text())}
    tracked = subprocess.run(['git', 'ls-files'], cwd=ROOT, capture_output=True, text=True,
                             check=False).stdout.split('\n')  # nothing without a repository
    assert len(links) > 10
    assert sorted((links | {*filter(None, tracked)}) - names) == []


def promises() -> list[str]:
    """Return what README and pages say to be needless: the page, and the words up to a stop."""
    pages = [ROOT / 'README.md', *sorted((ROOT / 'docs').glob('*.md'))]
    return [f'{page.name}: {" ".join(found.split())}' for page in pages
            for found in re.findall(r'\bneeds? (?:no|neither|nothing)\b[^.,:;|()\[\]]*',
                                    page.read_text().replace('`', ''))]


def test_each_promise_has_a_check() -> None:
    found = promises()
    assert len(found) > 10
    assert sorted({*found} - {*PROMISES}) == [], 'add a row to PROMISES with what shows it'
    assert sorted({*PROMISES} - {*found}) == [], 'no page says this any more'
    for check in PROMISES.values():
        path, _, name = check.partition('::')
        assert check in jobs.JOBS or name in (ROOT / path).read_text(), check
