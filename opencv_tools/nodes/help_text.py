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
from collections.abc import Iterator, Sequence
from pathlib import Path
import re

from opencv_tools.base.arguments import CommandParser
from opencv_tools.base.text import without_password

FOLDER = Path(__file__).with_name('help')
#: Options that are no ROS arguments, with their help, by executable.
OPTIONS = {'img_viewer': {'--list': 'print all nodes and topics, and exit'}}


def check_options(name: str, args: Sequence[str]) -> None:
    """
    Handle ``--help`` and ``--version``, and exit on arguments that are no ROS arguments.

    :param name: executable, whose parameters are ROS arguments.
    :param args: command line, program name first.
    """
    text = FOLDER.joinpath(f'{name}.txt').read_text(encoding='utf-8')
    description, _, epilog = text.partition('\n\n')
    parser = CommandParser(
        prog=name, description=description, epilog=epilog,
        formatter_class=argparse.RawTextHelpFormatter,
        usage=f'{name} [--ros-args -p NAME:=VALUE ...]')
    for option, help_ in OPTIONS.get(name, {}).items():
        parser.add_argument(option, action='store_true', help=help_)
    _, unknown = parser.parse_known_args([*_plain_words(args)])
    if unknown:
        words = without_password(' '.join(unknown)).split(' ')
        parser.error(f'unrecognized arguments: {" ".join(words)}'
                     f'{_remedy(words, set(re.findall("^  ([a-z_]+) ", epilog, re.MULTILINE)))}')


def _plain_words(args: Sequence[str]) -> Iterator[str]:
    """Yield the arguments that are no ROS arguments."""
    is_ros = False
    for word in args[1:]:
        if word == '--ros-args':
            is_ros = True
        elif is_ros and word == '--':
            is_ros = False
        elif not is_ros:
            yield word


def _remedy(words: Sequence[str], names: set[str]) -> str:
    """Return how to write a parameter, or a source, that was given as ``--source 0`` or ``0``."""
    for word, following in zip(words, [*words[1:], '']):
        option, _, value = word.partition('=')
        name = option.lstrip('-').removesuffix(':').replace('-', '_')
        if option.startswith('-') and name in names:
            value = value or ('' if following.startswith('-') else following) or 'VALUE'
            return f'; write --ros-args -p {name}:={value}'
    if len(words) == 1 and 'source' in names and re.match('(?!-|.*:=).', words[0]):
        return f'; write --ros-args -p source:={words[0]}'
    return '; parameters are written --ros-args -p NAME:=VALUE'
