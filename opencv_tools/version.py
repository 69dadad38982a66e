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

"""Version of the installed package, and the option ``--version`` of all commands."""

from __future__ import annotations

import argparse
from typing import Any


def package_version() -> str:
    """Return the version of the installed package; '' if it is used from its source."""
    from importlib.metadata import PackageNotFoundError, version  # slow, and seldom needed
    try:
        return version('opencv_tools')
    except PackageNotFoundError:
        return ''


class _Version(argparse.Action):
    """Print the version and exit; unlike argparse's own action, it is looked up only then."""

    def __call__(self, parser: argparse.ArgumentParser, *_arguments: Any) -> None:
        print(f'{parser.prog} {package_version() or "from its source"}')
        parser.exit()


def add_version(parser: argparse.ArgumentParser) -> None:
    """Add the option ``--version`` to a command."""
    parser.add_argument('--version', action=_Version, nargs=0, dest=argparse.SUPPRESS,
                        default=argparse.SUPPRESS, help='print the version and exit')
