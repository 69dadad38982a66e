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
The command line of img_convert for data sets: ``--format``, ``--check`` and ``--merge``.

Slow imports are inside functions, so that ``--help`` is fast.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from functools import partial

from opencv_tools.base.arguments import (
    CommandParser, integer, number_range, positive, real, run_command, with_range)
from opencv_tools.datasets.errors import DatasetError
from opencv_tools.datasets.plan import DEPTH_RANGE, FORMATS, LEROBOT, SHORTEN

_MODES = ('--format', '--check', '--merge')
_MOST_SHARDS = 1_000_000
_FARTHEST, _LEAST = 65.535, 0.001  # metres; LeRobot reads millimetres of 16 bits

_EXAMPLES = """\
examples:
  img_convert drive.mcap set/ --format lerobot --fps 30 \\
      --image front=/cam0/image_raw/compressed --state /joint_states.position \\
      --action /arm/command.position --task 'pick the cube'
  img_convert bags/ set/ --format lerobot --fps 30 --image front=/cam0/image_raw --dry-run
  img_convert --check set/
  img_convert bags/ shard_3/ --format lerobot ... --shard 3/100
  img_convert --merge shard_*/ set/

exit status:
  0  success
  1  a bag cannot be converted, a message failed (the set is written nevertheless), a set has
     errors, or a signal ended the command
  2  invalid arguments, also topics and joints that no bag has
"""


def is_for_datasets(argv: Sequence[str]) -> bool:
    """Return whether arguments of img_convert are for data sets."""
    return any(argument.partition('=')[0] in _MODES for argument in argv)


def main(argv: Sequence[str]) -> int:
    """
    Convert bags to a data set for training, or check or merge one.

    :returns: 0 on success, 1 if a bag or a set has errors or after an interrupt, 2 for invalid
        arguments.
    """
    options = _parser().parse_args(with_range(argv, '--depth-range'))

    def run_dataset() -> int:
        from opencv_tools.datasets.command import run
        from opencv_tools.datasets.lerobot import import_pyarrow
        import_pyarrow()
        return run(options)

    return run_command('img_convert', run_dataset, 'interrupted', DatasetError)


def _parser() -> argparse.ArgumentParser:
    parser = CommandParser(
        prog='img_convert', allow_abbrev=False, epilog=_EXAMPLES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
        description='Convert bags to a data set for training, or check or merge one.',
        usage='img_convert SOURCE TARGET --format FORMAT --fps N [options]\n'
              '       img_convert --check SET\n'
              '       img_convert --merge SHARD [SHARD ...] SET')
    parser.add_argument('paths', metavar='PATH', nargs='*', help='bag, folder with bags or glob '
                        'pattern, then the new folder; or what --check and --merge need')
    modes = parser.add_mutually_exclusive_group(required=True)
    modes.add_argument('--format', choices=FORMATS, default='', help=(
        f'{LEROBOT} (a data set of LeRobot, version 3), or single samples: webdataset (tar) or '
        'parquet, one file a bag'))
    modes.add_argument('--check', action='store_true', help='check a LeRobot data set')
    modes.add_argument('--merge', action='store_true', help='merge what --shard has written')
    _add_features(parser.add_argument_group('features'))
    _add_times(parser.add_argument_group('times and episodes'))
    _add_work(parser.add_argument_group('work'))
    return parser


def _add_features(group: argparse._ArgumentGroup) -> None:
    group.add_argument('--image', metavar='NAME=TOPIC', action='append', default=[],
                       help='camera: observation.images.NAME; for each camera once')
    group.add_argument('--depth', metavar='NAME=TOPIC', action='append', default=[], help=(
        'depth camera of 16UC1 (mm) or 32FC1 (m): observation.images.NAME_depth; for each once'))
    group.add_argument('--depth-range', type=_depth_range, default=DEPTH_RANGE, metavar='LOW:HIGH',
                       help='depths in metres that LeRobot stores [0.01:10]')
    group.add_argument('--depth-scale', choices=('log', 'linear'), default='log', help=(
        'steps of the depth in LeRobot: finer ones near the camera, or equal ones [%(default)s]'))
    group.add_argument('--state', metavar='TOPIC.FIELD', action='append', default=[], help=(
        'numbers of observation.state, such as /joint_states.position; several follow each other'))
    group.add_argument('--action', metavar='TOPIC.FIELD', action='append', default=[], help=(
        'numbers of action; next for the state of the next row'))
    group.add_argument('--vector', metavar='FEATURE=TOPIC.FIELD', action='append', default=[],
                       help='numbers of another feature, such as observation.effort=/arm.effort')
    group.add_argument('--joints', metavar='NAME,NAME', type=_names, default=(), help=(
        'names and order of the numbers that have names [order of the first message]'))
    group.add_argument('--task', metavar='TEXT', default='', help='task of the episodes')
    group.add_argument('--robot', dest='robot_type', metavar='NAME', default='',
                       help='name of the robot')


def _add_times(group: argparse._ArgumentGroup) -> None:
    group.add_argument('--fps', type=partial(integer, least=1, most=1000), metavar='N',
                       help='rows of a second')
    group.add_argument('--clock', choices=('stamp', 'log'), default='stamp', help=(
        'stamp for the stamps of the headers, log for the times of the recording [%(default)s]'))
    group.add_argument('--align-images', dest='image_choice', choices=('last', 'nearest'),
                       default='last', help=(
        'image of a row: the last one before its time, or the nearest [%(default)s]'))
    group.add_argument('--align-vectors', dest='vector_choice', choices=('last', 'linear'),
                       default='last', help=(
        'numbers of a row: the last ones before its time, or between two [%(default)s]'))
    group.add_argument('--max-gap', type=_seconds, default=1.0, metavar='SECONDS',
                       help='largest age of a sample of a row [%(default)s]')
    group.add_argument('--on-gap', choices=('fail', 'split'), default='fail', help=(
        'what an older sample does: fail, or split the episode and leave these rows out '
        '[%(default)s]'))
    group.add_argument('--ends', choices=('fail', SHORTEN), default='fail', help=(
        'what a topic does that begins later or ends earlier than the others by more than '
        '--max-gap: fail, or shorten the episode to its time [%(default)s]'))
    group.add_argument('--episodes', metavar='TOPIC.FIELD|TABLE.csv', default='', help=(
        "topic whose value is not 0, false or '' during an episode, or table with the columns "
        'start and end in seconds and, if needed, bag and task [one episode a bag]'))


def _add_work(group: argparse._ArgumentGroup) -> None:
    group.add_argument('--dry-run', action='store_true',
                       help='print what would become of each topic, and write nothing')
    group.add_argument('--overwrite', action='store_true', help='replace the data set TARGET')
    group.add_argument('--skip-failed', action='store_true',
                       help='write the set without the bags that cannot be converted')
    group.add_argument('--crf', type=partial(integer, most=51), default=23, metavar='N', help=(
        'quality of the videos, from 0 (best) to 51 (smallest) [%(default)s]'))
    group.add_argument('--jobs', type=positive, metavar='N', help=(
        'processes on this machine [number of processors]'))
    group.add_argument('--shard', type=_shard, metavar='I/N', help=(
        'convert only each N-th bag, from the I-th on, to TARGET, for --merge'))
    group.add_argument('--ray', metavar='ADDRESS', default='', help=(
        'convert the bags on a Ray cluster, such as auto or 10.0.0.5:6379; local for one that '
        'ends with the command'))
    group.add_argument('--ray-memory', type=positive, metavar='MB', default=1000, help=(
        'memory that Ray reserves for a bag [%(default)s]'))


def _seconds(text: str) -> float:
    seconds = real(text)
    if not 0 < seconds < 1e6:
        raise argparse.ArgumentTypeError(f'{text!r} is not a number of seconds above 0')
    return seconds


def _depth_range(text: str) -> tuple[float, float]:
    low, high = number_range(text)
    if low < 0 or high > _FARTHEST or high - low < _LEAST:
        raise argparse.ArgumentTypeError(f'{text!r} is no range of 1 mm or more within '
                                         f'0:{_FARTHEST:g}, the metres that LeRobot can read')
    return low, high


def _names(text: str) -> tuple[str, ...]:
    names = tuple(name.strip() for name in text.split(','))
    if not all(names) or len(set(names)) < len(names):
        raise argparse.ArgumentTypeError(f'{text!r} is not a list of different names')
    return names


def _shard(text: str) -> tuple[int, int]:
    first, slash, count = text.partition('/')
    if not slash:
        raise argparse.ArgumentTypeError(f'{text!r} is not I/N, such as 3/100')
    shards = integer(count, 1, _MOST_SHARDS)
    return integer(first, 1, shards), shards
