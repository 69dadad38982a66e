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
The command opencv_tools_info: the libraries that are installed, and those that are missing.

Each library is imported, because one that is installed may still not work.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from importlib import import_module, metadata
import os
import platform
from typing import Any

from opencv_tools.base.arguments import CommandParser, package_version, run_command
from opencv_tools.base.remedies import installation, LIBRARIES, Library, ROS


def main(argv: Sequence[str] | None = None) -> int:
    """
    Print a line for each library.

    :param argv: arguments; None for those of the process.
    :returns: 0; a missing library is no error, because no command needs all.
    """
    parser = CommandParser(
        prog='opencv_tools_info', allow_abbrev=False,
        formatter_class=argparse.RawDescriptionHelpFormatter,
        description='List the libraries that opencv_tools uses: the version of each, or how to '
        'install it.\nNo command needs all of them.')
    parser.parse_args(argv)
    return run_command(parser.prog, _print_libraries)


def _print_libraries() -> int:
    print(f'opencv_tools {package_version()}, Python {platform.python_version()}, '
          f'{platform.system()} on {platform.machine()}, '
          f'ROS_DISTRO {os.environ.get("ROS_DISTRO") or "not set"}')
    for module, library in LIBRARIES.items():
        if library is not ROS or module == 'rclpy':
            state, remedy = _state(module, library)
            print(f'{library.name:<11} {state:<10} {library.use}{remedy}')
    return 0


def _state(module: str, library: Library) -> tuple[str, str]:
    """Return the version of a library, or why there is none and the remedy."""
    try:
        found: Any = import_module(module)
        middleware = f', with {found.get_rmw_implementation_identifier()}' if (
            library is ROS) else ''
    except ModuleNotFoundError as err:
        reason = '' if err.name == module else f' ({err})'
        return 'missing', f'{reason}; {installation(library.pip)}'
    except Exception as err:  # noqa: B902 (a damaged library may raise anything)
        return 'broken', f' ({" ".join(str(err).split())}); {installation(library.pip)}'
    try:
        return metadata.version(library.pip or module), middleware
    except metadata.PackageNotFoundError:  # apt has no entry for some
        return getattr(found, '__version__', 'installed'), middleware
