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

"""Command line of a node as ``--help`` shows it: without the node, so without ROS."""

from __future__ import annotations

import argparse
from pathlib import Path

from opencv_tools.base.arguments import CommandParser

#: Folder of the texts, which ``docs/write_parameters.py`` writes.
FOLDER = Path(__file__).with_name('help')


def node_parser(name: str, text: str) -> CommandParser:
    """
    Return the command line of a node, whose parameters are ROS arguments.

    :param text: the description in one line, an empty line, and what stands below the options.
    """
    description, _, epilog = text.partition('\n\n')
    return CommandParser(
        prog=name, description=description, epilog=epilog,
        formatter_class=argparse.RawTextHelpFormatter,
        usage=f'{name} [--ros-args -p NAME:=VALUE ...]')


def show_help(name: str, option: str) -> int:
    """Show what ``--help`` or ``--version`` asks for, and exit."""
    text = FOLDER.joinpath(f'{name}.txt').read_text(encoding='utf-8')
    node_parser(name, text).parse_args([option])
    return 0
