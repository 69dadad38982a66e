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

"""Debian's kernel, fetched and unpacked but never installed."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
import re
import shutil
import subprocess

METAPACKAGE = 'linux-image-amd64'  # depends on the newest kernel that apt knows of


class MachineError(Exception):
    """What keeps the test machine from doing its work, in a sentence for its user."""


@dataclass(frozen=True)
class Kernel:
    """An unpacked kernel package."""

    tree: Path
    version: str

    @property
    def image(self) -> Path:
        return self.tree / 'boot' / f'vmlinuz-{self.version}'

    @property
    def modules(self) -> Path:
        return self.tree / 'lib' / 'modules' / self.version

    def files_of(self, *names: str) -> list[Path]:
        """List the files of modules and of what they need, in the order of loading."""
        shown = subprocess.run(
            ['modprobe', '--dirname', self.tree, '--set-version', self.version, '--all',
             '--show-depends', *names], capture_output=True, text=True, check=True).stdout
        found = re.findall(r'^insmod (.*\S)', shown, re.MULTILINE)  # the others are built in
        return [Path(name) for name in dict.fromkeys(found)]


def get_kernel(cache: Path) -> Kernel:
    """
    Take the kernel from the cache, where it is put the first time.

    :raises MachineError: when there is none, and apt cannot get it either
    """
    tree = cache / 'kernel'
    if not tree.exists():
        # Only a tree that is whole gets the name.
        unfinished = cache / 'unfinished'
        shutil.rmtree(unfinished, ignore_errors=True)
        unfinished.mkdir(parents=True)
        _fetch(unfinished).rename(tree)
        shutil.rmtree(unfinished)
    return Kernel(tree, _version(tree))


def _fetch(folder: Path) -> Path:
    """Download and unpack the kernel into a folder; where it lies there."""
    depends = _ask(METAPACKAGE, ['apt-cache', 'depends', METAPACKAGE], folder)
    named = re.search(r'Depends: (linux-image-\S+)', depends)
    if named is None:
        raise MachineError(f'{METAPACKAGE} cannot be had: it names no kernel')
    package = named[1]
    print(f'Fetching {package} for the test machine', flush=True)
    _ask(package, ['apt-get', 'download', package], folder)
    archive, = folder.glob('*.deb')
    tree = folder / 'kernel'
    _ask(package, ['dpkg-deb', '--extract', archive.name, tree.name], folder)
    if not (tree / 'lib').exists():  # as from Debian 13 on
        (tree / 'lib').symlink_to('usr/lib')
    _ask(package, ['depmod', '--basedir', tree.name, _version(tree)], folder)
    return tree


def _version(tree: Path) -> str:
    modules, = (tree / 'lib' / 'modules').iterdir()
    return modules.name


def _ask(package: str, command: list[str], folder: Path) -> str:
    """Run a command that helps to get a package, and give what it prints."""
    try:
        finished = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
    except FileNotFoundError:
        raise MachineError(
            f'{package} cannot be had: {command[0]} is missing, and the test machine runs '
            "Debian's kernel") from None
    if finished.returncode != 0:
        reason = finished.stderr.strip().rpartition('\n')[2] or f'{command[0]} failed'
        raise MachineError(f'{package} cannot be had: {reason}')
    return finished.stdout
