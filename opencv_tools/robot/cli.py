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
The commands urdf_to_sdf, sdf_to_urdf, robot_compare and robot_frames.

What takes time to import comes in where it is used: ``--help`` is there at once.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Sequence
import json
import signal
import sys
from typing import NoReturn, TYPE_CHECKING

from opencv_tools.standard_streams import open_standard_streams

if TYPE_CHECKING:
    from opencv_tools.robot.load import LoadOptions
    from opencv_tools.robot.xml.report import Report

_MOST_DIFFERENCES = 50
_XACRO = 'xacro is expanded, which runs the Python expressions in it.'


def urdf_to_sdf(argv: Sequence[str] | None = None) -> int:
    """Convert a robot from URDF or xacro to SDF; exit as Unix commands do."""
    parser = _parser('urdf_to_sdf', 'Convert a robot from URDF to SDF and report what SDF cannot '
                     f'say. {_XACRO}')
    _add_input(parser, 'INPUT', 'URDF or xacro')
    _add_conversion_options(parser)
    _add_xacro_option(parser)
    parser.add_argument('--sdf-version', default='1.11', metavar='VERSION',
                        help='of the SDF, 1.4 to 1.12 [%(default)s]')
    parser.add_argument('--poses', default='model', choices=['model', 'relative'],
                        help='place each link in the model frame, or in its parent link with the '
                        'numbers of the input [%(default)s]')
    parser.add_argument('--fixed', default='keep', choices=['keep', 'lump'],
                        help='keep fixed joints, or make one link of what they hold together '
                        '[%(default)s]')
    parser.add_argument('--mesh-uri', default='model', choices=['model', 'package', 'keep'],
                        help='scheme of the URIs of files in packages [%(default)s]')
    return _run(parser, argv, _urdf_to_sdf)


def sdf_to_urdf(argv: Sequence[str] | None = None) -> int:
    """Convert a robot from SDF to URDF; exit as Unix commands do."""
    parser = _parser('sdf_to_urdf', 'Convert a robot from SDF to URDF and report what URDF cannot '
                     'say.')
    _add_input(parser, 'INPUT', 'SDF')
    _add_conversion_options(parser)
    _add_sdf_options(parser)
    parser.add_argument('--mesh-uri', default='package', choices=['model', 'package', 'keep'],
                        help='write places of models as package:// or model:// [%(default)s]')
    return _run(parser, argv, _sdf_to_urdf)


def robot_compare(argv: Sequence[str] | None = None) -> int:
    """Tell whether two files are of one robot; exit with 0 when they are and with 1 if not."""
    parser = _parser('robot_compare', 'Tell whether two files, of URDF or SDF, are of the same '
                     'robot: all placed in space, at zero and at random joint positions. The exit '
                     'status is 0 when they are and 1 when they differ.')
    _add_input(parser, 'A', 'URDF, xacro or SDF')
    _add_input(parser, 'B', 'URDF, xacro or SDF')
    _add_xacro_option(parser)
    _add_sdf_options(parser)
    parser.add_argument('--samples', type=_count, default=20, metavar='N',
                        help='random joint positions to compare at [%(default)s]')
    parser.add_argument('--all', action='store_true',
                        help=f'list all differences, not the first {_MOST_DIFFERENCES} only')
    parser.add_argument('--tolerance', type=_positive, default=1e-9, metavar='X',
                        help='in metres, radians and what else there is [%(default)s]')
    return _run(parser, argv, _robot_compare)


def robot_frames(argv: Sequence[str] | None = None) -> int:
    """List where the frames of a robot are; exit as Unix commands do."""
    parser = _parser('robot_frames', 'List where a robot has its joints, each in its parent link, '
                     'and its links, in the root link.')
    _add_input(parser, 'FILE', 'URDF, xacro or SDF')
    _add_xacro_option(parser)
    _add_sdf_options(parser)
    parser.add_argument('--joint', action='append', default=[], type=_position,
                        metavar='NAME=VALUE', help='position of a joint in radians or metres; '
                        'NAME:=VALUE is the same; may be given often')
    parser.add_argument('--format', default='text', choices=['text', 'json'], help='[%(default)s]')
    parser.add_argument('--plot', metavar='FILE', help='also draw the frames, .png or .svg')
    parser.add_argument('--conventions', metavar='FILE', help='also draw the joints that URDF '
                        'places beside the links that SDF places, .png or .svg')
    return _run(parser, argv, _robot_frames)


def _parser(name: str, description: str) -> argparse.ArgumentParser:
    return argparse.ArgumentParser(
        prog=name, description=description, allow_abbrev=False,
        epilog='Exit status: 0, 1 as said above, 2 when the input cannot be read.')


def _add_input(parser: argparse.ArgumentParser, name: str, formats: str) -> None:
    parser.add_argument(name.lower(), metavar=name, help=f'{formats}; - for standard input')


def _add_conversion_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument('-o', '--output', metavar='FILE',
                        help='where to write to, whole or not at all [standard output]')
    parser.add_argument('--inertial', default='keep', choices=['keep', 'zero', 'default'],
                        help='links without <inertial>: keep, no mass, or 1 kg [%(default)s]')
    parser.add_argument('--root', default='', metavar='LINK',
                        help='convert what hangs on this link, where several hang on nothing')
    parser.add_argument('--report', metavar='FILE',
                        help='write what was carried and reported, as JSON')
    parser.add_argument('--strict', action='store_true',
                        help='exit with 1 when anything was reported')


def _add_xacro_option(parser: argparse.ArgumentParser) -> None:
    parser.add_argument('--arg', action='append', default=[], type=_argument,
                        metavar='NAME:=VALUE', help='an argument of xacro; NAME=VALUE is the '
                        'same; may be given often')


def _add_sdf_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument('--model', default='', metavar='NAME',
                        help='the model, where a file of SDF has several')
    parser.add_argument('--path', action='append', default=[], metavar='FOLDER',
                        help='where included models are, before GZ_SIM_RESOURCE_PATH; may be '
                        'given often')


def _argument(text: str) -> tuple[str, str]:
    name, separator, value = text.partition('=')
    name = name.removesuffix(':')
    if not name or not separator:
        raise argparse.ArgumentTypeError(f'{text!r} is not of the form name:=value')
    return name, value


def _position(text: str) -> tuple[str, float]:
    name, _, value = text.rpartition('=')
    name = name.removesuffix(':')
    try:
        position = float(value)
    except ValueError:
        position = float('nan')
    if not name or not abs(position) < float('inf'):
        raise argparse.ArgumentTypeError(f'{text!r} is not of the form name=number')
    return name, position


def _count(text: str) -> int:
    if not text.isdecimal():
        raise argparse.ArgumentTypeError(f'{text!r} is not a whole number from 0')
    return int(text)


def _positive(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = -1.0
    if not 0 <= value < float('inf'):
        raise argparse.ArgumentTypeError(f'{text!r} is not a number from 0')
    return value


def _urdf_to_sdf(options: argparse.Namespace, report: Report) -> int:
    from opencv_tools.robot.convert import convert_to_sdf
    from opencv_tools.robot.load import read_robot, URDF
    from opencv_tools.robot.xml.document import DescriptionError, to_bytes
    robot, language = read_robot(options.input, report, _choices(options))
    if language != URDF:
        raise DescriptionError('is SDF already', source=robot.source)
    root = convert_to_sdf(
        robot, report, version=options.sdf_version, relative=options.poses == 'relative',
        inertial=options.inertial, lump=options.fixed == 'lump', mesh_uri=options.mesh_uri)
    return _converted(options, report, to_bytes(root))


def _sdf_to_urdf(options: argparse.Namespace, report: Report) -> int:
    from opencv_tools.robot.convert import convert_to_urdf
    from opencv_tools.robot.load import read_robot, SDF
    from opencv_tools.robot.xml.document import DescriptionError, to_bytes
    robot, language = read_robot(options.input, report, _choices(options))
    if language != SDF:
        raise DescriptionError('is URDF already', source=robot.source)
    root = convert_to_urdf(robot, report, inertial=options.inertial, mesh_uri=options.mesh_uri)
    return _converted(options, report, to_bytes(root))


def _converted(options: argparse.Namespace, report: Report, data: bytes) -> int:
    """Write what a conversion gave, and its report."""
    from opencv_tools.robot.xml.output import write_all
    files = [(options.output, data)]
    if options.report:
        text = json.dumps({'input': report.source, **report.as_json()}, indent=2)
        files.append((options.report, text.encode() + b'\n'))
    write_all(files)
    return 1 if options.strict and report.warnings else 0


def _robot_compare(options: argparse.Namespace, report: Report) -> int:
    from opencv_tools.robot.compare.compare import differences
    from opencv_tools.robot.compare.table import table
    from opencv_tools.robot.load import read_robot
    from opencv_tools.robot.renaming import with_original_names
    from opencv_tools.robot.xml.document import DescriptionError
    from opencv_tools.robot.xml.output import print_text
    if options.a == options.b == '-':
        raise DescriptionError('standard input can be one of the two only')
    one, other = (with_original_names(read_robot(path, report, _choices(options))[0])
                  for path in (options.a, options.b))
    found = differences(one, other, samples=options.samples, tolerance=options.tolerance)
    if found:
        print_text(table(found, None if options.all else _MOST_DIFFERENCES))
        return 1
    print_text(f'the same robot: links {len(one.links)}, joints {len(one.joints)}; at zero and '
               f'at {options.samples} random positions, to {options.tolerance:g}')
    return 0


def _robot_frames(options: argparse.Namespace, report: Report) -> int:
    from opencv_tools.robot.frames.listing import frames
    from opencv_tools.robot.frames.text import text
    from opencv_tools.robot.load import read_robot
    from opencv_tools.robot.renaming import with_original_names
    from opencv_tools.robot.xml.output import print_text
    robot = with_original_names(read_robot(options.file, report, _choices(options))[0])
    positions = dict(options.joint)
    listing = frames(robot, positions, report)
    if options.plot:
        from opencv_tools.robot.frames.plot import plot
        plot(robot, positions, options.plot)
    if options.conventions:
        from opencv_tools.robot.frames.conventions import plot_conventions
        plot_conventions(robot, positions, options.conventions)
    print_text(json.dumps(listing, indent=2) if options.format == 'json' else text(listing))
    return 0


def _choices(options: argparse.Namespace) -> LoadOptions:
    """Give what the options say of reading; each command has some of them."""
    from opencv_tools.robot.load import LoadOptions
    given = vars(options)
    return LoadOptions(arguments=dict(given.get('arg', ())), model=given.get('model', ''),
                   root=given.get('root', ''), search=tuple(given.get('path', ())))


def _run(parser: argparse.ArgumentParser, argv: Sequence[str] | None,
         command: Callable[[argparse.Namespace, Report], int]) -> int:
    """Run a command, say on standard error what it reports, and give its exit status."""
    open_standard_streams()
    options = parser.parse_args(argv)
    from opencv_tools.robot.xml.document import DescriptionError
    from opencv_tools.robot.xml.output import NotWrittenError, print_message
    from opencv_tools.robot.xml.report import Report
    report = Report()
    error = None
    try:
        status = command(options, report)
    except DescriptionError as err:
        status, error = 2, err
    except BrokenPipeError:  # whoever reads has what they wanted
        return 128 + signal.SIGPIPE
    except KeyboardInterrupt:
        return 128 + signal.SIGINT
    if error is None or isinstance(error, NotWrittenError):
        for note in report.warnings:
            print_message(f'{parser.prog}: warning: {note.text()}')
    if error is not None:
        print_message(f'{parser.prog}: error: {error}')
    return status


_COMMANDS = (urdf_to_sdf, sdf_to_urdf, robot_compare, robot_frames)


def main() -> NoReturn:
    """Run the command that the first argument names."""
    commands = {command.__name__: command for command in _COMMANDS}
    if len(sys.argv) < 2 or sys.argv[1] not in commands:
        sys.exit(f'usage: python3 -m opencv_tools.robot.cli {{{",".join(commands)}}} ...')
    sys.exit(commands[sys.argv[1]](sys.argv[2:]))


if __name__ == '__main__':
    main()
