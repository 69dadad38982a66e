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
Command lines of urdf_to_sdf, sdf_to_urdf, robot_compare, robot_frames and robot_view.

Slow imports are inside functions, so that ``--help`` is fast.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from functools import partial
import math
import sys
from typing import NoReturn

from opencv_tools.base.arguments import CommandParser, integer, real
from opencv_tools.base.signals import end_at_signals
from opencv_tools.base.standard_streams import open_standard_streams

_LOSSY = 'lossy conversion with --strict'
_MAX_DIFFERENCES = 50
_ANY_FORMAT = 'URDF, xacro or SDF file, or model folder'


def urdf_to_sdf(argv: Sequence[str] | None = None) -> int:
    """Convert a robot from URDF or xacro to SDF and return the exit status."""
    parser = _parser('urdf_to_sdf', 'Convert a robot from URDF or xacro to SDF.\n'
                     'Python expressions in a xacro file are executed.',
                     'my_arm.urdf.xacro --arg side:=left -o my_arm.sdf', _LOSSY)
    _add_input(parser, 'INPUT', 'URDF or xacro file')
    _add_conversion_options(parser, 'model')
    _add_xacro_option(parser)
    parser.add_argument('--find', default='path', choices=['path', 'package'],
                        help='$(find PACKAGE) in the text of plugins and others [%(default)s]')
    parser.add_argument('--sdf-version', default='1.11', metavar='VERSION',
                        help='SDF version of the output, 1.7 to 1.12 [%(default)s]')
    parser.add_argument('--poses', default='model', choices=['model', 'relative'],
                        help='frame of the link poses: the model, or the parent link with the '
                        'numbers of the input [%(default)s]')
    parser.add_argument('--fixed', default='frames', choices=['frames', 'keep', 'lump'],
                        help='fixed joints: make frames of links without mass, keep all links, or '
                        'merge the links that they connect [%(default)s]')
    return _run(parser, argv)


def sdf_to_urdf(argv: Sequence[str] | None = None) -> int:
    """Convert a robot from SDF to URDF and return the exit status."""
    parser = _parser('sdf_to_urdf', 'Convert a robot from SDF to URDF.',
                     'my_arm/model.sdf --inertial zero -o my_arm.urdf', _LOSSY)
    _add_input(parser, 'INPUT', 'SDF file or model folder')
    _add_conversion_options(parser, 'package')
    parser.add_argument('--urdf-version', default='', choices=['1.0', '1.1', '1.2'],
                        help='URDF version of the output; 1.0 has cylinders for capsules '
                        '[that of the original URDF, or else 1.0]')
    parser.add_argument('--frames', default='keep', choices=['keep', 'links'],
                        help='frames of SDF: keep them for the conversion back, or write empty '
                        'links on fixed joints, which tf has [%(default)s]')
    parser.add_argument('--world-link', default='', metavar='LINK',
                        help='fix all root links to this one, which is new or one of them, '
                        'because URDF allows one root link')
    _add_sdf_options(parser)
    return _run(parser, argv)


def robot_compare(argv: Sequence[str] | None = None) -> int:
    """Compare two robots and return 0 if they are the same, else 1."""
    parser = _parser('robot_compare', 'Compare two robots in any formats: inertials, shapes, '
                     'surfaces, colours, joints,\nand poses at zero and at random joint '
                     'positions; also sensors and plugins\nwith --all.',
                     'my_arm.urdf my_arm/model.sdf', 'the robots differ')
    _add_input(parser, 'A', _ANY_FORMAT)
    _add_input(parser, 'B', _ANY_FORMAT)
    _add_xacro_option(parser)
    _add_sdf_options(parser)
    parser.set_defaults(most=_MAX_DIFFERENCES)
    parser.add_argument('--samples', type=integer, default=20, metavar='N',
                        help='number of random joint positions [%(default)s]')
    parser.add_argument('--all', action='store_true',
                        help='compare all other elements too, such as gravity, sensors and '
                        f'plugins, and list more than {_MAX_DIFFERENCES} differences')
    parser.add_argument('--tolerance', type=_tolerance, default=1e-9, metavar='X',
                        help='greatest difference in metres, radians and other units; relative '
                        'for values above 1 and for inertials [%(default)s]')
    return _run(parser, argv)


def robot_frames(argv: Sequence[str] | None = None) -> int:
    """List the frames of a robot and return the exit status."""
    parser = _parser('robot_frames', 'List the frames of a robot: joints in their parent links, '
                     'links in the root link.',
                     'my_arm.urdf --joint elbow=0.5 --conventions both.png')
    _add_input(parser, 'FILE', _ANY_FORMAT)
    _add_xacro_option(parser)
    _add_sdf_options(parser)
    parser.add_argument('--joint', action='append', default=[], type=_joint_position,
                        metavar='NAME=VALUE', help='position of a joint in radians or metres; '
                        'NAME:=VALUE is accepted too; may be repeated')
    parser.add_argument('--format', default='text', choices=['text', 'json'],
                        help='format of the list [%(default)s]')
    parser.add_argument('--plot', help=argparse.SUPPRESS)  # until 0.4.0
    parser.add_argument('--conventions', metavar='PICTURE', help='also draw the joints that URDF '
                        'places beside the links that SDF places, as .png or .svg')
    return _run(parser, argv)


def robot_view(argv: Sequence[str] | None = None) -> int:
    """Show a robot in a browser and return the exit status."""
    parser = _parser('robot_view', 'Show a robot in a browser, in the conventions of URDF and of '
                     'SDF; or what\ndiffers between two robots.',
                     'my_arm.urdf --html my_arm.html')
    _add_input(parser, 'FILE', _ANY_FORMAT)
    parser.add_argument('file2', metavar='FILE2', nargs='?', help='robot to compare with')
    parser.add_argument('--html', metavar='PAGE', help='write one HTML file that needs no server '
                        'and no network, instead of a page on this machine')
    parser.add_argument('--no-meshes', dest='meshes', action='store_false',
                        help='leave out meshes, which --html puts into the file')
    parser.add_argument('--port', type=partial(integer, most=65535), metavar='N',
                        help='port of the page on this machine; 0 for a free one [8090]')
    _add_xacro_option(parser)
    _add_sdf_options(parser)
    return _run(parser, argv)


def _parser(name: str, text: str, example: str, failure: str = '') -> argparse.ArgumentParser:
    statuses = ['0  success', *([f'1  {failure}'] if failure else []), '2  error']
    return CommandParser(
        prog=name, description=text, allow_abbrev=False,
        formatter_class=argparse.RawDescriptionHelpFormatter,
        epilog='\n  '.join(['example:', f'{name} {example}\n\nexit status:', *statuses]))


def _add_input(parser: argparse.ArgumentParser, name: str, formats: str) -> None:
    parser.add_argument(name.lower(), metavar=name, help=f'{formats}; - for standard input')


def _add_conversion_options(parser: argparse.ArgumentParser, mesh_uri: str) -> None:
    parser.add_argument('-o', '--output', metavar='FILE',
                        help='output file, written atomically [standard output]')
    parser.add_argument('--inertial', default='same', choices=[
        'same', 'keep', 'zero', 'default', 'physical'],
                        help='links without <inertial>: the same mass in a simulator, keep them, '
                        'set zero mass, or set 1 kg; physical: also replace impossible moments of '
                        'inertia by the nearest possible ones [%(default)s]')
    parser.add_argument('--mesh-uri', default=mesh_uri, choices=['model', 'package', 'keep'],
                        help='scheme of mesh and texture URIs: model://, package://, or as in the '
                        'input [%(default)s]')
    parser.add_argument('--root', default='', metavar='LINK',
                        help='root link of the tree to convert, if the file has several')
    parser.add_argument('--report', metavar='FILE',
                        help='write a JSON list of all preserved and lossy elements')
    parser.add_argument('--strict', action='store_true',
                        help='exit with 1 if the conversion is lossy')


def _add_xacro_option(parser: argparse.ArgumentParser) -> None:
    parser.add_argument('--arg', action='append', default=[], type=_argument,
                        metavar='NAME:=VALUE', help='xacro argument; NAME=VALUE is accepted too; '
                        'may be repeated')


def _add_sdf_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument('--model', default='', metavar='NAME',
                        help='name of the model, if an SDF file has several')
    parser.add_argument('--path', action='append', default=[], metavar='FOLDER',
                        help='folder of included models, searched before GZ_SIM_RESOURCE_PATH; '
                        'may be repeated')


def _argument(text: str) -> tuple[str, str]:
    name, separator, value = text.partition('=')
    name = name.removesuffix(':')
    if not name or not separator:
        raise argparse.ArgumentTypeError(f'{text!r} is not of the form NAME:=VALUE')
    return name, value


def _joint_position(text: str) -> tuple[str, float]:
    name, _, value = text.rpartition('=')
    name, position = name.removesuffix(':'), real(value)
    if not name or not math.isfinite(position):
        raise argparse.ArgumentTypeError(f'{text!r} is not of the form NAME=NUMBER')
    return name, position


def _tolerance(text: str) -> float:
    value = real(text)
    if not 0 <= value < math.inf:
        raise argparse.ArgumentTypeError(f'{text!r} is not a finite number of 0 or more')
    return value


def _run(parser: argparse.ArgumentParser, argv: Sequence[str] | None) -> int:
    open_standard_streams()
    options = parser.parse_args(argv)
    from opencv_tools.robot.commands import run
    return run(parser.prog, options)


def main() -> NoReturn:
    """Run the command that the first argument names."""
    commands = {command.__name__: command
                for command in (urdf_to_sdf, sdf_to_urdf, robot_compare, robot_frames, robot_view)}
    if len(sys.argv) < 2 or sys.argv[1] not in commands:
        sys.exit(f'usage: python3 -m opencv_tools.robot.cli {{{",".join(commands)}}} ...')
    sys.exit(end_at_signals(lambda: commands[sys.argv[1]](sys.argv[2:])))


if __name__ == '__main__':
    main()
