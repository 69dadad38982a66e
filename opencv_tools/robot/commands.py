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
What each command for robots does with its options.

What only one of the commands needs is imported inside its function.
"""

from __future__ import annotations

from argparse import Namespace
from collections.abc import Callable, Mapping
import json
import signal

from opencv_tools.robot.load import LoadOptions, read_robot
from opencv_tools.robot.model import Robot
from opencv_tools.robot.renaming import with_original_names
from opencv_tools.robot.sdf.includes import file_of_model
from opencv_tools.robot.xml.document import DescriptionError, Element, to_bytes
from opencv_tools.robot.xml.output import (
    check_different, check_not_inputs, NotWrittenError, print_message, print_text, write_all)
from opencv_tools.robot.xml.report import Report

_INPUTS = ('input', 'a', 'b', 'file', 'file2')
_OUTPUTS = ('output', 'report', 'plot', 'conventions', 'html')  # options that name a file to write


def run(name: str, options: Namespace) -> int:
    """Run a command, print its warnings and error to standard error, return the exit status."""
    report = Report()
    error = None
    try:
        _check_files(options)
        status = _COMMANDS[name](options, report)
    except DescriptionError as err:
        status, error = 2, err
    except BrokenPipeError:  # the reader of the output has ended
        return 128 + signal.SIGPIPE
    if error is None or isinstance(error, NotWrittenError):
        for note in report.warnings:
            print_message(f'{name}: warning: {note.text()}')
    if error is not None:
        print_message(f'{name}: error: {error}')
    return status


def _check_files(options: Namespace) -> None:
    """
    Check that no file of the command is replaced by another one.

    :raises DescriptionError: an output is another output or an input.
    """
    values = vars(options)
    outputs = {f'--{name}': values.get(name) for name in _OUTPUTS}
    check_different(outputs)
    check_not_inputs(outputs, [
        file_of_model(values[name]) for name in _INPUTS if values.get(name)])


def _urdf_to_sdf(options: Namespace, report: Report) -> int:
    from opencv_tools.robot.convert import convert_to_sdf, SdfOptions
    return _convert('urdf', options, report, lambda robot: convert_to_sdf(
        robot, report, SdfOptions(
            version=options.sdf_version, relative=options.poses == 'relative',
            inertial=options.inertial, fixed=options.fixed, mesh_uri=options.mesh_uri)))


def _sdf_to_urdf(options: Namespace, report: Report) -> int:
    from opencv_tools.robot.convert import convert_to_urdf, UrdfOptions
    return _convert('sdf', options, report, lambda robot: convert_to_urdf(
        robot, report, UrdfOptions(
            version=options.urdf_version, inertial=options.inertial,
            frame_links=options.frames == 'links', world_link=options.world_link,
            mesh_uri=options.mesh_uri)))


def _convert(language: str, options: Namespace, report: Report,
             convert: Callable[[Robot], Element]) -> int:
    robot, found = _read(options.input, options, report)
    if found != language:
        raise DescriptionError(f'is already {found.upper()}', source=robot.source)
    files = [(options.output, to_bytes(convert(robot)))]
    if options.report:
        text = json.dumps({'input': report.source, **report.as_json()}, indent=2)
        files.append((options.report, text.encode() + b'\n'))
    write_all(files)
    return 1 if options.strict and report.warnings else 0


def _robot_compare(options: Namespace, report: Report) -> int:
    from opencv_tools.robot.compare.compare import differences, table
    if options.a == options.b == '-':
        raise DescriptionError('only one of both robots can be on standard input')
    a, b = (_read(path, options, report)[0] for path in (options.a, options.b))
    found = differences(a, b, samples=options.samples, tolerance=options.tolerance,
                        everything=options.all)
    if found:
        print_text(table(found, None if options.all else options.most))
        return 1
    a = with_original_names(a)
    print_text(f'the same robot: links {len(a.links)}, joints {len(a.joints)}; compared at zero '
               f'and at {options.samples} random positions, tolerance {options.tolerance:g}')
    return 0


def _robot_frames(options: Namespace, report: Report) -> int:
    from opencv_tools.robot.frames.listing import frames
    from opencv_tools.robot.frames.text import text
    robot = with_original_names(_read(options.file, options, report)[0])
    listing = frames(robot, dict(options.joint), report)
    if options.plot:
        print_message('robot_frames: warning: --plot is deprecated and draws the same as '
                      '--conventions; robot_view shows the rest')
    for picture in filter(None, (options.conventions, options.plot)):
        from opencv_tools.robot.drawing.conventions import plot_conventions
        plot_conventions(robot, listing, picture)
    print_text(json.dumps(listing, indent=2) if options.format == 'json' else text(listing))
    return 0


def _robot_view(options: Namespace, report: Report) -> int:
    from opencv_tools.robot.view.command import robot_view
    return robot_view(options, report)


def _read(path: str, options: Namespace, report: Report) -> tuple[Robot, str]:
    """Read a robot with those options for reading that the command has."""
    values = vars(options)
    return read_robot(path, report, LoadOptions(
        arguments=dict(values.get('arg', ())), model=values.get('model', ''),
        root=values.get('root', ''), search=values.get('path', ()),
        find=values.get('find', 'path')))


_COMMANDS: Mapping[str, Callable[[Namespace, Report], int]] = {
    'urdf_to_sdf': _urdf_to_sdf, 'sdf_to_urdf': _sdf_to_urdf,
    'robot_compare': _robot_compare, 'robot_frames': _robot_frames,
    'robot_view': _robot_view}
