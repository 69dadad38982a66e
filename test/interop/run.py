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
Run the tests with other programs: python run.py [arguments of pytest].

The programs are the parsers libsdformat and urdfdom, and FFmpeg. Missing ones are installed from
Debian if apt-get is available and the user is root. Foxglove's reader of bags and schemas are
installed for these tests if npm is available. Drake has the newest libsdformat. It comes from PyPI
into an environment of its own, and so does the newest urdfdom.
"""

from __future__ import annotations

from collections import Counter
import os
from pathlib import Path
import shutil
import subprocess
import sys
import tempfile

import pytest

SOURCE = Path(__file__).with_name('poses.cpp')
LIBRARY = 'sdformat12'
# Required programs, with their Debian packages.
TOOLS = {'ign': 'ignition-tools', 'check_urdf': 'liburdfdom-tools', 'g++': 'g++',
         'pkg-config': 'pkg-config', 'ffmpeg': 'ffmpeg'}
LIBRARY_PACKAGE = 'libsdformat-dev'
NODE_MODULES = ('@mcap/core@2.2.2', '@foxglove/schemas@2.1.0')
# Packages of PyPI in an environment of their own, with their variables and programs.
JUDGES = {'drake==1.51.1': ('OPENCV_TOOLS_DRAKE', 'python'),
          'cmeel-urdfdom==6.0.0': ('OPENCV_TOOLS_CHECK_URDF', 'check_urdf')}
JUDGES_ENVIRONMENT = SOURCE.parents[2] / 'build' / 'judges'


def missing() -> list[str]:
    """Return the packages of missing programs and libraries."""
    packages = [package for name, package in TOOLS.items() if shutil.which(name) is None]
    if 'pkg-config' in packages or subprocess.run(
            ['pkg-config', '--exists', LIBRARY], check=False).returncode != 0:
        packages.append(LIBRARY_PACKAGE)
    return packages


def install(packages: list[str]) -> None:
    """Install packages if apt-get is available and the user is root."""
    if os.geteuid() == 0 and shutil.which('apt-get'):
        print(f'Installing {", ".join(packages)}', flush=True)
        environment = dict(os.environ, DEBIAN_FRONTEND='noninteractive')
        for command in (['update', '-qq'],
                        ['install', '-y', '-qq', '--no-install-recommends', *packages]):
            subprocess.run(['apt-get', *command], stdout=subprocess.DEVNULL, env=environment,
                           check=False)


def build(program: Path) -> None:
    """Compile the program that calls libsdformat."""
    flags = subprocess.run(['pkg-config', '--cflags', '--libs', LIBRARY], stdout=subprocess.PIPE,
                           text=True, check=True).stdout.split()
    subprocess.run(['g++', '-std=c++17', '-o', str(program), str(SOURCE), *flags], check=True)


def install_node_modules(folder: Path) -> None:
    """Install Foxglove's reader of bags and schemas in a folder if npm is available."""
    if shutil.which('npm'):
        (folder / 'package.json').write_text('{}')
        subprocess.run(['npm', 'install', '--silent', '--no-audit', '--no-fund', *NODE_MODULES],
                       cwd=folder, check=True)
        os.environ['OPENCV_TOOLS_NODE_MODULES'] = str(folder)


def install_judges() -> None:
    """Install what PyPI has for this machine, and keep it for the next run."""
    folder = JUDGES_ENVIRONMENT / 'bin'
    if not folder.exists():
        subprocess.run([sys.executable, '-m', 'venv', str(JUDGES_ENVIRONMENT)], check=True)
    for package, (variable, program) in JUDGES.items():
        stamp = JUDGES_ENVIRONMENT / package
        if not stamp.exists():
            command = [str(folder / 'python'), '-m', 'pip', 'install', '--quiet', package]
            if subprocess.run(command, check=False).returncode:
                continue
            stamp.touch()
        os.environ[variable] = str(folder / program)


class Figures:
    """Figures that the tests record, for the summary: sums of integers and maxima of floats."""

    def __init__(self) -> None:
        """Create empty figures."""
        self._sums: Counter[str] = Counter()
        self._largest: dict[str, float] = {}

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        """Add the figures of a test."""
        if report.when != 'call':
            return
        for name, value in report.user_properties:
            if isinstance(value, int):
                self._sums[name] += value
            elif isinstance(value, float):
                self._largest[name] = max(value, self._largest.get(name, 0.0))

    def pytest_terminal_summary(self, terminalreporter: pytest.TerminalReporter) -> None:
        """Print the figures."""
        for name, value in (*self._sums.items(), *self._largest.items()):
            terminalreporter.write_line(f'{value:{"6d" if isinstance(value, int) else "6.1e"}}  '
                                        f'{name}')


def main() -> int:
    """Return the exit status of pytest; 1 if a program is missing."""
    os.environ['PATH'] += ':/usr/bin:/bin'  # the folders of Debian's programs
    if missing():
        install(missing())
    packages = missing()
    if packages:
        print(f'programs of the tests are missing: sudo apt install {" ".join(packages)}',
              file=sys.stderr)
        return 1
    install_judges()
    with tempfile.TemporaryDirectory() as folder:
        program = Path(folder) / 'poses'
        build(program)
        install_node_modules(Path(folder))
        os.environ['OPENCV_TOOLS_INTEROP'] = str(program)
        return pytest.main(['-q', str(SOURCE.parent), *sys.argv[1:]], plugins=[Figures()])


if __name__ == '__main__':
    sys.exit(main())
