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
Run tests that only root may run: python as_root.py browser|network [arguments for pytest].

They make hosts and slow links of network namespaces with tools of Debian; the browser is Debian's
Chromium.
"""

from __future__ import annotations

import os
from pathlib import Path
import shutil
import sys

import pytest

NETWORK_TOOLS = {'ip': 'iproute2', 'tc': 'iproute2', 'nft': 'nftables', 'nsenter': 'util-linux',
                 'unshare': 'util-linux'}
#: Required programs with their Debian packages, by folder of tests.
TOOLS = {'browser': {'chromium-headless-shell': 'chromium-headless-shell', **NETWORK_TOOLS},
         'network': NETWORK_TOOLS}


def describe_missing(folder: str) -> str:
    """Return a sentence with the missing requirements and their remedy, or ''."""
    if os.geteuid() != 0:
        return f'the tests make network namespaces, which only root may: sudo make test-{folder}'
    missing = [name for name in TOOLS[folder] if shutil.which(name) is None]
    if not missing:
        return ''
    verb = 'is' if len(missing) == 1 else 'are'
    packages = ' '.join(dict.fromkeys(TOOLS[folder][name] for name in missing))
    return f'{", ".join(missing)} {verb} missing: sudo apt install {packages}'


def main() -> int:
    """Return the exit status of pytest; 1 if a tool is missing, 2 without a folder of tests."""
    if len(sys.argv) < 2 or sys.argv[1] not in TOOLS:
        print(__doc__.strip(), file=sys.stderr)
        return 2
    folder, *arguments = sys.argv[1:]
    os.environ['PATH'] += ':/usr/sbin:/sbin'  # where Debian keeps the tools
    sentence = describe_missing(folder)
    if sentence:
        print(sentence, file=sys.stderr)
        return 1
    os.environ[f'OPENCV_TOOLS_{folder.upper()}'] = '1'
    return pytest.main(['-q', str(Path(__file__).with_name(folder)), *arguments])


if __name__ == '__main__':
    sys.exit(main())
