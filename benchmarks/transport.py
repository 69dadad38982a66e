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
The package's nodes against the tutorial's: what arrives, how old it is, and what it costs.

The ways run in turn, each with processes of its own. The package's processes use Fast DDS as the
package configures it, the tutorial's use its defaults. The age of a frame is the time from when
its publisher has it in hand to when a subscriber has it as an array. The first second of a run
does not count for the ages. All nodes in the middle flip frames from img_publisher for
img_subscriber; their CPU time is without the flip. The publisher of loans has a frame in hand when
the loan is filled, and its CPU time is without the filling. The YUYV camera's frames are converted
to bgr8 between both times. `iceoryx2 alone` is the engine of shared frames in a plain Python loop:
loans of bytes, without ROS.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass
import re
import statistics
import time

from figures import add_json_option, Figure, write_figures
from node_process import enter_domain, NAMESPACE
import numpy as np
from transport_ends import STAGES
from transport_figures import compare, compare_counts
from transport_parts import FRAMES, Load, RESULTS
from transport_run import median, ProcessError, Result, run_once, Way

_TRANSPORTS = ('raw', 'shm')
WAYS = {f'{name} {transport}': Way(*ends, transport=transport) for name, ends in {
    'ours': ('img_publisher', 'img_subscriber'),
    'thread': ('img_publisher', 'thread'),
    'own node': ('img_publisher', 'img_subscriber', 'own node'),
}.items() for transport in _TRANSPORTS} | {
    'ours loan': Way('loan publisher', 'img_subscriber', transport='shm'),
    'thread loan': Way('loan publisher', 'thread', transport='shm'),
    'camera raw': Way('yuyv publisher', 'img_subscriber'),
    'camera loan': Way('yuyv publisher', 'img_subscriber', transport='shm'),
    'own node loan': Way('img_publisher', 'img_subscriber', 'own node loan', transport='shm'),
    'iceoryx2 alone': Way('iceoryx2 publisher', 'iceoryx2 subscriber', transport='shm'),
    'plain subscriber': Way('img_publisher', 'tutorial subscriber'),
    'plain node': Way('img_publisher', 'img_subscriber', 'plain node'),
    'tutorial': Way('tutorial publisher', 'tutorial subscriber')}
TITLES = ('arrived %', 'p50 ms', 'p99 ms', 'CPU ms: pub.', 'node', 'each sub.', 'all', 'flip',
          'faults', 'p50/memcpy', 'tutorial/p50')
NOT_MEASURED = ('C++ with loaned messages of a fixed size is not measured: it needs rclcpp, which '
                'the ROS of PyPI does not have, and a message type of its own')
COPIES = 31
COLD_BYTES = 1 << 28  # of frames that are copied in turn, more than any cache holds


@dataclass(frozen=True)
class Size:
    """Width and height of frames in pixels, their rate in Hz, and all three as text."""

    text: str
    width: int
    height: int
    rate: int


def parse_size(text: str) -> Size:
    """
    Read a size and a rate.

    :raises argparse.ArgumentTypeError: the text is invalid.
    """
    match = re.fullmatch(r'([1-9][0-9]*)x([1-9][0-9]*)@([1-9][0-9]*)', text)
    if not match:
        raise argparse.ArgumentTypeError(f'{text!r} is not a size: write it as 1920x1080@30')
    return Size(text, *map(int, match.groups()))


def copy_ms(size: Size) -> float:
    """Copy frames that no cache holds, with pauses; return the median in ms."""
    frame_bytes = size.width * size.height * 3
    count = max(2, COLD_BYTES // frame_bytes // 2)
    sources = [np.full(frame_bytes, number, np.uint8) for number in range(count)]
    targets = [np.ones(frame_bytes, np.uint8) for _ in range(count)]
    seconds = []
    for number in range(COPIES):
        time.sleep(1 / size.rate)
        began = time.perf_counter()
        np.copyto(targets[number % count], sources[number % count])
        seconds.append(time.perf_counter() - began)
    return statistics.median(seconds) * 1e3


def measure(
    options: argparse.Namespace, size: Size, subscribers: int,
) -> tuple[dict[str, Result], float]:
    """Run the ways in turn; return their medians, and the ms of one memcpy."""
    frames = round(size.rate * options.seconds)
    print(f'\n{size.text} bgr8, {options.qos}, {subscribers} subscriber(s), {frames} frames a run'
          f'\n{"":17}{"".join(f"{title:>13}" for title in TITLES)}')
    results: dict[str, list[Result]] = {name: [] for name in options.ways}
    copies = []
    for _ in range(options.runs):
        copies.append(copy_ms(size))
        for name in [*results]:
            way = WAYS[name]
            load = Load(
                width=size.width, height=size.height, rate=size.rate, frames=frames,
                qos=options.qos, namespace=NAMESPACE, topic=RESULTS if way.node else FRAMES,
                transport=way.transport, priority=options.priority)
            try:
                result = run_once(way, load, subscribers)
            except ProcessError as err:
                reason = str(err).splitlines()[-1].rpartition(']: ')[2]
                print(f'{name} skipped: {reason}', flush=True)
                del results[name]
            else:
                results[name].append(result)
                print_result(name, result, copies[-1])
    copy = statistics.median(copies)
    medians = {name: median(found) for name, found in results.items()}
    print(NOT_MEASURED)
    print(f'medians; one memcpy of a frame takes {copy:.2f} ms')
    for name, result in medians.items():
        print_result(name, result, copy, medians.get('tutorial'))
    return medians, copy


def print_result(
    name: str, result: Result, copy: float, tutorial: Result | None = None,
) -> None:
    """Print a line of the table."""
    values = (result.delivered, result.p50, result.p99, result.publisher_cpu, result.node_cpu,
              result.subscriber_cpu, result.cpu, result.filter_cpu, result.faults,
              result.p50 / copy, *((tutorial.p50 / result.p50,) if tutorial else ()))
    print(f'{name:17}{"".join(f"{value:13.2f}" for value in values)}', flush=True)


def print_stages(result: Result, copy: float) -> None:
    """Print the stages that make up the age of a frame."""
    print(f'\n{"stage of ours raw":30}{"ms":>7}{"copies":>8}')
    for stage, milliseconds in zip(STAGES, result.stages):
        print(f'{stage:30}{milliseconds:7.2f}{milliseconds / copy:8.1f}')


def print_figures(figures: list[Figure]) -> None:
    """Print the figures that have goals."""
    print()
    for figure in (figure for figure in figures if figure.goal):
        verdict = '' if figure.met else '  missed'
        print(f'{figure.name:78}{figure.value:9.2f} {figure.unit:9}{figure.goal}{verdict}')


def main() -> int:
    """Run the ways in turn and print what happened to the frames."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--ways', nargs='+', choices=tuple(WAYS), default=tuple(WAYS),
                        metavar='WAY', help=f'ways to compare: {", ".join(WAYS)}')
    parser.add_argument('--sizes', nargs='+', type=parse_size, metavar='SIZE',
                        default=[parse_size('1920x1080@30')], help='size and rate of the frames')
    parser.add_argument('--subscribers', nargs='+', type=int, default=[1],
                        help='numbers of subscribers, each a process')
    parser.add_argument('--seconds', type=float, default=5, help='duration of each run')
    parser.add_argument('--runs', type=int, default=5, help='runs of each way')
    parser.add_argument('--qos', choices=('reliable', 'best_effort'), default='reliable')
    parser.add_argument('--priority', type=int, default=0,
                        help="real-time priority of the package's nodes")
    add_json_option(parser)
    options = parser.parse_args()
    enter_domain()
    figures: list[Figure] = []
    for size in options.sizes:
        by_count = {}
        for subscribers in options.subscribers:
            medians, copy = measure(options, size, subscribers)
            by_count[subscribers] = medians
            if 'ours raw' in medians:
                print_stages(medians['ours raw'], copy)
            found = compare(size.text, options.qos, subscribers, medians, copy)
            print_figures(found)
            figures += found
        further = compare_counts(size.text, options.qos, by_count)
        print_figures(further)
        figures += further
    if options.json:
        write_figures(options.json, figures)
    return 0


if __name__ == '__main__':
    raise SystemExit(main())
