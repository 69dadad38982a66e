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
The command img_convert.

Slow imports are inside functions, so that ``--help`` is fast.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
import sys

from opencv_tools.base.arguments import (
    COLORS, CommandParser, integer, INTERRUPTED, number_range, positive, run_command,
    with_range)
from opencv_tools.base.signals import end_at_signals
from opencv_tools.datasets.cli import is_for_datasets, main as convert_to_dataset


def main(argv: Sequence[str] | None = None) -> int:
    """
    Convert between bags, videos and image files, without ROS.

    :param argv: arguments; None for those of the process.
    :returns: 0 on success, 1 if a frame or file failed or after an interrupt, 2 for invalid
        arguments.
    """
    arguments = sys.argv[1:] if argv is None else argv
    if is_for_datasets(arguments):
        return convert_to_dataset(arguments)
    options = _parser().parse_args(with_range(arguments, '--range'))

    def run() -> int:
        from opencv_tools.convert.convert import convert, ConvertRequest
        return convert(ConvertRequest(**vars(options)))

    return run_command('img_convert', run)


def _parser() -> argparse.ArgumentParser:
    parser = CommandParser(
        prog='img_convert', allow_abbrev=False,
        formatter_class=argparse.RawDescriptionHelpFormatter,
        description='Convert between bags, videos and image files, without ROS.',
        epilog="""\
examples:
  img_convert drive.mcap 'out/{stamp}.png' --topic /camera/image_raw
  img_convert clip.mp4 clip.mcap
  img_convert 'frames/*.png' clip.mp4 --lossy
  img_convert --format lerobot --help   for data sets for training

exit status:
  0  success
  1  a frame or file failed, or a signal ended the conversion
  2  invalid arguments, also those that do not suit the source
""")
    parser.add_argument(
        'source', metavar='SOURCE', help='bag (.mcap, .db3 or folder of rosbag2), video file, '
        'image file, folder or glob of images, stream URL, or '
        'pattern[:depth][:WIDTHxHEIGHT[@FPS]]')
    parser.add_argument(
        'target', metavar='TARGET', help='template of the file names, such as out/{seq:06d}.png, '
        'with {seq}, {stamp}, {sec}, {nanosec}, {frame_id}, {encoding} or {topic}; the extension '
        'selects the format: .mcap, .mp4, .mkv, .avi, .png, .jpg, .tiff, .bmp, .webp or .npy')
    parser.add_argument('--topic', default='', help='topic of the images of a bag, if it has '
                        'several')
    parser.add_argument('--topics', default='*', metavar='TOPIC,TOPIC', help='other topics of a '
                        'bag that another bag gets; * stands for any characters [all]')
    parser.add_argument('--every', type=positive, default=1, metavar='N',
                        help='convert the first of every N frames [%(default)s]')
    parser.add_argument('--start', type=integer, default=0, metavar='FRAME',
                        help='number of the first frame to convert, counted from 0 [%(default)s]')
    parser.add_argument('--stop', type=positive, default=0, metavar='FRAME',
                        help='number of the first frame not to convert [end of the source]')
    parser.add_argument('--lossy', action='store_true', help='allow a format that loses quality, '
                        'alpha or bits, although the source is lossless')
    parser.add_argument('--range', type=number_range, dest='limits', metavar='LOW:HIGH',
                        help='with --lossy, numbers of depth and other images with one channel '
                        'and more than 8 bits that become black and white: millimetres of 16UC1, '
                        'metres of 32FC1')
    parser.add_argument('--colors', choices=COLORS, default=COLORS[0], help='colours from LOW to '
                        'HIGH in pictures and videos; 0 and NaN stay black, unless LOW is '
                        'negative [%(default)s]')
    parser.add_argument('--compressed', choices=('jpeg', 'png'), default='', help='compress the '
                        'raw images of a new bag; their topic then ends with /compressed')
    return parser


if __name__ == '__main__':
    sys.exit(end_at_signals(main, INTERRUPTED))
