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
The command img_calibrate.

Slow imports are inside functions, so that ``--help`` is fast.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
import sys
from typing import TYPE_CHECKING

from opencv_tools.base.arguments import CommandParser, INTERRUPTED, run_command
from opencv_tools.base.signals import end_at_signals

if TYPE_CHECKING:
    from opencv_tools.calibration.command import TopicSearch


def main(
    argv: Sequence[str] | None = None, search_topics: TopicSearch | None = None,
) -> int:
    """
    Calibrate one or two cameras from files, without ROS, or from live topics.

    :param argv: arguments; None for those of the process.
    :param search_topics: search of live topics; None if they are not supported.
    :returns: 0 on success, 1 if there is no usable calibration or after an interrupt, 2 for
        invalid arguments.
    """
    options = _parser().parse_args(argv)

    def run() -> int:
        from opencv_tools.calibration.command import calibrate
        return calibrate(options, search_topics)

    return run_command('img_calibrate', run, 'error: interrupted')


def _parser() -> argparse.ArgumentParser:
    parser = CommandParser(
        prog='img_calibrate', allow_abbrev=False,
        formatter_class=argparse.RawDescriptionHelpFormatter,
        description='Calibrate a camera from pictures of a board.',
        epilog="""\
examples:
  img_calibrate --board charuco:11x8:30mm:22mm:5x5_250 --board-pdf board.pdf
  img_calibrate 'frames/*.png' --board charuco:11x8:30mm:22mm:5x5_250 -o camera.yaml
  img_calibrate drive.mcap --topic /image_raw --board chessboard:9x6:25mm --check camera.yaml
  img_calibrate left/ --right right/ --board aprilgrid:6x6:30mm:9mm:36h11 -o left.yaml \\
      --right-output right.yaml
  img_calibrate --topic /left/image_raw --right-topic /right/image_raw \\
      --board charuco:11x8:30mm:22mm:5x5_250 -o left.yaml --right-output right.yaml

exit status:
  0  success: the calibration is good or usable
  1  no usable calibration, a degraded one with --check, or a signal ended the command
  2  invalid arguments
""")
    parser.add_argument('sources', nargs='*', default=[], metavar='SOURCE', help='image '
                        'file, folder or glob of images, video file, or bag')
    parser.add_argument('--board', required=True, metavar='BOARD', help='board in the images: '
                        'charuco:COLUMNSxROWS:SQUARE:MARKER:DICTIONARY, chessboard:COLUMNSxROWS:'
                        'SQUARE (inner corners) or aprilgrid:COLUMNSxROWS:TAG:GAP:FAMILY; '
                        'lengths in mm, cm or m')
    parser.add_argument('-o', '--output', type=_file, metavar='FILE', help='calibration '
                        'file for camera_info_url, written atomically; replaces calibrations only')
    parser.add_argument('--model', default='plumb_bob',
                        choices=('plumb_bob', 'rational_polynomial', 'equidistant'),
                        help='distortion: 5 coefficients, 8 for wide lenses, or 4 for fisheye '
                        'lenses [%(default)s]')
    parser.add_argument('--name', default='camera', help='name of the camera in the file '
                        '[%(default)s]')
    parser.add_argument('--topic', default='', help='topic of the images of a bag, if it has '
                        'several; without SOURCE a live topic, until all views are there or '
                        'Ctrl-C')
    parser.add_argument('--check', type=_file, metavar='FILE', help='check this calibration '
                        'file with the images; nothing is written')
    parser.add_argument('--board-pdf', type=_file, metavar='FILE', help='write the board for a '
                        'printer, as .pdf or .svg')
    parser.add_argument('--right', default='', metavar='SOURCE', help='images of the right one of '
                        'two cameras; SOURCE has those of the left one')
    parser.add_argument('--right-topic', default='', metavar='TOPIC', help='topic of the images '
                        'of the right camera, if its bag has several; without SOURCE a live '
                        'topic')
    parser.add_argument('--right-output', type=_file, metavar='FILE',
                        help='calibration file of the right camera')
    return parser


def _file(text: str) -> str:
    """Return the name of a file; argparse shows the error."""
    if text in ('', '-'):
        raise argparse.ArgumentTypeError(f'{text!r} is not a file: give the name of a file')
    return text


if __name__ == '__main__':
    sys.exit(end_at_signals(main, INTERRUPTED))
