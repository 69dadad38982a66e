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

"""What the command robot_view does with its options."""

from __future__ import annotations

from argparse import Namespace
import asyncio
from collections.abc import Iterator, Mapping
from contextlib import suppress

from opencv_tools.base.remedies import installation
from opencv_tools.robot.load import LoadOptions
from opencv_tools.robot.view.content import read_content, ViewOptions
from opencv_tools.robot.view.single_file import html_page
from opencv_tools.robot.xml.document import DescriptionError
from opencv_tools.robot.xml.output import print_message, write_parts
from opencv_tools.robot.xml.report import Report

_PORT = 8090


def robot_view(options: Namespace, report: Report) -> int:
    """Write the page to a file, or serve it until a signal; return the exit status."""
    paths = [path for path in (options.file, options.file2) if path is not None]
    _check_names({'FILE': options.file, 'FILE2': options.file2, '--html': options.html})
    if options.html and options.port is not None:
        raise DescriptionError('--port is for the page on this machine, and --html writes a file: '
                               'leave out one of them')
    view = ViewOptions(paths=paths, meshes=options.meshes, load=LoadOptions(
        arguments=dict(options.arg), model=options.model, search=options.path))
    if paths.count('-') > bool(options.html):
        raise DescriptionError('only one robot can be on standard input, and only with --html: '
                               'give a file')
    if not options.html:
        return _serve(view, _PORT if options.port is None else options.port)
    content = read_content(view, report)
    size = 0

    def counted() -> Iterator[bytes]:
        nonlocal size
        for part in html_page(content):
            size += len(part)
            yield part

    write_parts([(options.html, counted())])
    found = content.document['meshes']
    shown = [mesh for mesh in found if not mesh['reason']]
    for mesh in found:
        if mesh['reason'] and options.meshes:
            print_message(
                f'robot_view: warning: {mesh["role"]} {mesh["uri"]}: {mesh["reason"]}')
    if options.html != '-':
        print_message(f'{options.html}: {size} bytes; files of meshes {len(shown)} of '
                      f'{len(found)}, {sum(mesh["size"] for mesh in shown)} bytes')
    return 0


def _check_names(names: Mapping[str, str | None]) -> None:
    for option, name in names.items():
        if name == '':
            raise DescriptionError(f"{option} is '': give the name of a file")


def _serve(view: ViewOptions, port: int) -> int:
    try:
        from opencv_tools.robot.view.server import serve
    except ImportError as err:
        raise DescriptionError('the page on this machine needs Tornado: write the page to a file '
                               f'with --html, or {installation("tornado")}'
                               ) from err
    with suppress(asyncio.CancelledError):
        asyncio.run(serve(view, port, print_message))
    return 0
