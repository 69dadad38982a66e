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

"""Packages of npm, which only some machines can install."""

from __future__ import annotations

from pathlib import Path
import shutil
import subprocess

import pytest
from waiting import LONGEST_SECONDS


def installed(package: str, folder: Path) -> Path:
    """Return the folder with the modules of a package, such as ``axe-core@4.14.1``, or skip."""
    npm = shutil.which('npm')
    if npm is None:
        pytest.skip('npm is not on this machine; sudo apt install npm')
    done = subprocess.run(
        [npm, 'install', '--prefix', str(folder), '--no-audit', '--no-fund', package],
        capture_output=True, text=True, timeout=LONGEST_SECONDS, check=False)
    if done.returncode:
        pytest.skip(f'npm cannot install {package}: {done.stderr.strip()[-300:]}')
    return folder / 'node_modules'
