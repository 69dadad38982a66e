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
Compare results on arm64 with those on this machine: python run.py.

QEMU runs Debian's Python for arm64 with wheels for arm64 of the installed versions. Python and the
wheels are downloaded to ``.arm64`` and never installed. No wheel has rclpy, so only those parts
are compared that need no ROS: ``results.py`` lists them.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from importlib.metadata import version
import itertools
import json
from pathlib import Path
import shutil
import subprocess
import sys
import tempfile

PROJECT = Path(__file__).resolve().parents[2]
CACHE = PROJECT / '.arm64'
TOOLS = {'qemu-aarch64-static': 'qemu-user-static', 'apt-get': 'apt', 'dpkg-deb': 'dpkg'}
PACKAGES = ('python3-minimal', 'libpython3-stdlib', 'libstdc++6')
WHEELS = ('av', 'lxml', 'mcap', 'numpy', 'opencv-python-headless', 'PyYAML', 'tqdm', 'xacro')
PLATFORMS = ('manylinux2014_aarch64', 'manylinux_2_17_aarch64', 'manylinux_2_27_aarch64',
             'manylinux_2_28_aarch64')


class Arm64Error(Exception):
    """An error that prevents the comparison."""


def run(command: Sequence[str], folder: Path = PROJECT) -> str:
    """
    Return the text that a command prints.

    :raises Arm64Error: the command failed; the error has its last lines.
    """
    finished = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
    if finished.returncode:
        lines = (finished.stderr.strip() or finished.stdout.strip()).splitlines()
        raise Arm64Error('\n'.join((f'{" ".join(command[:6])} ... failed:', *lines[-15:])))
    return finished.stdout


def fetch_python(folder: Path) -> None:
    """Download Debian's Python for arm64 from the mirrors of this machine, and unpack it."""
    state = folder / 'apt'
    for name in ('lists/partial', 'archives/partial'):
        (state / name).mkdir(parents=True)
    (state / 'status').touch()  # no package is installed
    settings = ('APT::Architecture=arm64', 'APT::Architectures=arm64', f'Dir::State={state}',
                f'Dir::State::status={state}/status', f'Dir::Cache={state}',
                'APT::Sandbox::User=')
    apt = ['apt-get', '-qq', *(f'-o{setting}' for setting in settings)]
    run([*apt, 'update'])
    run([*apt, '--yes', '--no-install-recommends', '--download-only', 'install', *PACKAGES])
    for archive in sorted((state / 'archives').glob('*.deb')):
        run(['dpkg-deb', '--extract', str(archive), str(folder)])
    shutil.rmtree(state)


def python_of(tree: Path) -> Path:
    """Return the Python of an unpacked tree."""
    return (tree / 'usr/bin/python3').resolve()


def fetch_wheels(tree: Path) -> None:
    """Download the installed versions of the libraries for arm64."""
    release = python_of(tree).name.removeprefix('python')
    run([sys.executable, '-m', 'pip', 'install', '--quiet', '--disable-pip-version-check',
         '--no-deps', '--only-binary=:all:', '--python-version', release,
         '--target', str(tree / 'wheels'),
         *(f'--platform={name}' for name in PLATFORMS),
         *(f'{name}=={version(name)}' for name in WHEELS)])


def fetch() -> Path:
    """Return the folder of Python and the libraries for arm64; the first call downloads them."""
    tree = CACHE / 'tree'
    if not tree.exists():
        print('Downloading Python and libraries for arm64 to .arm64: 120 MB, 0.4 GB on the disk',
              flush=True)
        unfinished = CACHE / 'unfinished'
        shutil.rmtree(unfinished, ignore_errors=True)
        fetch_python(unfinished)
        fetch_wheels(unfinished)
        unfinished.rename(tree)  # only a complete tree has this name
    return tree


def emulated(tree: Path) -> list[str]:
    """Return the command of Python for arm64."""
    environment = {'PYTHONHOME': tree / 'usr', 'PYTHONPATH': f'{PROJECT}:{tree / "wheels"}',
                   'PYTHONDONTWRITEBYTECODE': 1, 'OPENBLAS_NUM_THREADS': 1}
    return ['qemu-aarch64-static', '-L', str(tree),
            *(part for name, value in environment.items() for part in ('-E', f'{name}={value}')),
            str(python_of(tree))]


def results(python: Sequence[str], machine: str = '') -> dict[str, str]:
    """
    Return the results of a Python.

    :param machine: processor that this Python must have; '' for any.
    :raises Arm64Error: the processor is another one, or a command failed.
    """
    with tempfile.TemporaryDirectory() as folder:
        script = Path(__file__).with_name('results.py')
        found = json.loads(run([*python, str(script), str(PROJECT)], Path(folder)))
    if machine and found['machine'] != machine:
        raise Arm64Error(f'the processor is {found["machine"]}, not {machine}')
    return dict(found['results'])


def agree(one: str, other: str) -> bool:
    """Return whether results have the same words; numbers after ``~`` may differ by 2."""
    pairs = [*itertools.zip_longest(one.split(), other.split(), fillvalue='')]
    return all(left == right or (left[:1] == right[:1] == '~' and
                                 abs(float(left[1:]) - float(right[1:])) <= 2)
               for left, right in pairs)


def main() -> int:
    """Return 0 if all results are equal, 1 if one differs or a program is missing."""
    missing = [package for name, package in TOOLS.items() if shutil.which(name) is None]
    if missing:
        print(f'programs are missing: sudo apt install {" ".join(missing)}', file=sys.stderr)
        return 1
    try:
        arm64 = results(emulated(fetch()), 'aarch64')
        here = results([sys.executable])
    except Arm64Error as err:
        print(err, file=sys.stderr)
        return 1
    different = [subject for subject in here | arm64
                 if not agree(here.get(subject, ''), arm64.get(subject, ''))]
    for subject in different:
        print(f'{subject} differs:\n  arm64: {arm64.get(subject)}\n  here:  {here.get(subject)}')
    kinds = Counter(subject.split()[0] if subject.split()[1] != 'to' else 'encodings'
                    for subject in here)
    print('compared with arm64:', ', '.join(f'{kind} {n}' for kind, n in kinds.items()))
    print(f'{len(here) - len(different)} of {len(here)} results are equal')
    return int(bool(different))


if __name__ == '__main__':
    sys.exit(main())
