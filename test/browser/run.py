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
Run the tests of the viewer in a browser: python run.py [arguments for pytest].

The browser is Debian's Chromium. Hosts with a slow link are namespaces, which only root may make.
"""

from __future__ import annotations

import os
from pathlib import Path
import shutil
import sys

import pytest

TOOLS = {'chromium-headless-shell': 'chromium-headless-shell', 'ip': 'iproute2',
         'tc': 'iproute2', 'nsenter': 'util-linux', 'unshare': 'util-linux'}


def describe_missing() -> str:
    """Return a sentence with the missing requirements and their remedy, or ''."""
    if os.geteuid() != 0:
        return 'a slow link needs a network namespace, which only root may make: ' \
               'sudo make test-browser'
    missing = [name for name in TOOLS if shutil.which(name) is None]
    if not missing:
        return ''
    verb = 'is' if len(missing) == 1 else 'are'
    packages = ' '.join(dict.fromkeys(TOOLS[name] for name in missing))
    return f'{", ".join(missing)} {verb} missing: sudo apt install {packages}'


def pytest_configure(config: pytest.Config) -> None:
    """Load the fixtures of these tests, which import test/conftest.py."""
    config.pluginmanager.import_plugin('pages')


def main() -> int:
    """Return the exit status of pytest; 1 if a tool is missing."""
    os.environ['PATH'] += ':/usr/sbin:/sbin'  # where Debian keeps the tools
    sentence = describe_missing()
    if sentence:
        print(sentence, file=sys.stderr)
        return 1
    os.environ['OPENCV_TOOLS_BROWSER'] = '1'
    return pytest.main(['-q', str(Path(__file__).parent), *sys.argv[1:]],
                       plugins=[sys.modules[__name__]])


if __name__ == '__main__':
    sys.exit(main())
