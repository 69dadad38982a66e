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

Each way runs as two processes, the one on Fast DDS as the package sets it up, the other on its
defaults, in turn. A third way is our publisher with the tutorial's subscriber. A frame's age is
taken from when its publisher has it in hand to when its subscriber has it as an array. The first
second of a run does not count for the ages.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass
import json
import re
import statistics
import subprocess
import tempfile
import time
from typing import Any, IO

from figures import add_json_option, Figure, write_figures
from node_process import enter_domain, NAMESPACE
import numpy as np
from transport_ends import command, Load, SETTLED_FRAMES

# Publisher and subscriber of each way.
WAYS = {'ours': ('ours', 'ours'), 'plain subscriber': ('ours', 'tutorial'),
        'tutorial': ('tutorial', 'tutorial')}
STAGES = ('frame in hand to middleware', "to the subscriber's history", 'executor wakes up',
          'message is taken', 'message to array')
FULL_HD = 1920 * 1080
GROWTH_MB = 10.0
COPIES = 31
COLD_BYTES = 1 << 28  # of frames that are copied in turn, more than any cache holds
LATE_SECONDS = 1.0  # for what is still on its way at the end
END_SECONDS = 30.0
CONSOLE_LINES = 10


@dataclass(frozen=True)
class Result:
    """
    What became of the frames of one way in one run, or the medians of several.

    :param delivered: frames that arrived, per cent of those that were sent.
    :param p50: median of the ages, in ms.
    :param p99: of the ages, in ms.
    :param publisher_cpu: ms a frame, user and system, of all threads.
    :param subscriber_cpu: the same.
    :param faults: page faults a frame, of both.
    :param growth: MB of memory from frame 500 to the end, of the process where it is more.
    :param stages: ms of each stage; empty where they are not known.
    """

    delivered: float
    p50: float
    p99: float
    publisher_cpu: float
    subscriber_cpu: float
    faults: float
    growth: float
    stages: tuple[float, ...]

    @property
    def cpu(self) -> float:
        """CPU time of both processes in ms per frame."""
        return self.publisher_cpu + self.subscriber_cpu


def copy_ms(load: Load) -> float:
    """Copy frames that no cache holds, at rest between; the median in ms."""
    count = max(2, COLD_BYTES // load.frame_bytes // 2)
    sources = [np.full(load.frame_bytes, number, np.uint8) for number in range(count)]
    targets = [np.zeros(load.frame_bytes, np.uint8) for _ in range(count)]
    for target in targets:
        target[:] = 1  # its memory is there from now on
    seconds = []
    for number in range(COPIES):
        time.sleep(1 / load.rate)
        began = time.perf_counter()
        np.copyto(targets[number % count], sources[number % count])
        seconds.append(time.perf_counter() - began)
    return statistics.median(seconds) * 1e3


def run_once(way: str, load: Load) -> Result:
    """Send frames one way."""
    publishes, subscribes = WAYS[way]
    with tempfile.TemporaryFile('w+') as console:
        subscriber = subprocess.Popen(
            command(subscribes, 'subscriber', load), stdin=subprocess.PIPE, stdout=subprocess.PIPE,
            stderr=console)
        publisher = subprocess.Popen(
            command(publishes, 'publisher', load), stdout=subprocess.PIPE, stderr=console)
        try:
            sent = _answer(publisher, load.frames / load.rate + END_SECONDS, console)
            time.sleep(LATE_SECONDS)
            received = _answer(subscriber, END_SECONDS, console)
        finally:
            for process in (publisher, subscriber):
                process.kill()
                process.wait()
    first = min(int(load.rate), len(received['ages']) // 2)
    ages = np.array(received['ages'][first:] or [np.nan]) / 1e6
    stages = np.array(received.get('stages', []))[first:] / 1e6
    return Result(
        received['delivered'] / sent['frames'] * 100, float(np.percentile(ages, 50)),
        float(np.percentile(ages, 99)), sent['cpu'], received['cpu'],
        sent['faults'] + received['faults'], max(sent['growth'], received['growth']),
        tuple(np.median(stages, 0).tolist()) if len(stages) else ())


def _answer(process: subprocess.Popen[bytes], seconds: float, console: IO[str]) -> Any:
    """Wait for the end of a process and read what it printed."""
    try:
        return json.loads(process.communicate(timeout=seconds)[0])
    except (json.JSONDecodeError, subprocess.TimeoutExpired) as err:
        console.seek(0)
        lines = console.read().splitlines()[-CONSOLE_LINES:]
        raise SystemExit('\n'.join([str(err), *lines])) from err


def median(results: list[Result]) -> Result:
    """Return the median of each number, but the worst delivery and growth."""
    def middle(name: str) -> float:
        return float(statistics.median(getattr(result, name) for result in results))

    stages = tuple(statistics.median(times) for times in zip(*(
        result.stages for result in results)))
    return Result(
        min(result.delivered for result in results), middle('p50'), middle('p99'),
        middle('publisher_cpu'), middle('subscriber_cpu'), middle('faults'),
        max(result.growth for result in results), stages)


def compare(
    load: Load, ours: Result, plain: Result, theirs: Result, copy: float,
) -> list[Figure]:
    """Return the figures of a load, with their goals."""
    title = f'{load.width}x{load.height}@{load.rate:g} {load.qos.replace("_", " ")}'
    is_light = load.width * load.height * load.rate <= FULL_HD * 30
    figures: list[Figure] = []

    def add(name: str, value: float, unit: str, least: float = 0.0, most: float = 0.0) -> None:
        goal = f'at least {least:g}' if least else f'at most {most:g}' if most else ''
        met = value >= least if least else value <= most if most else None
        figures.append(Figure('transport', f'{title}: {name}', value, unit, goal, met))

    add('delivered', ours.delivered, '%', least=100)
    add('delivered to a plain subscriber', plain.delivered, '%')
    add("delivered, tutorial's way", theirs.delivered, '%')
    add('age p50', ours.p50, 'ms')
    add('age p50 at a plain subscriber', plain.p50, 'ms')
    add('age p99', ours.p99, 'ms')
    if load.qos == 'reliable':
        # The little that arrives of the tutorial's frames when they may be lost is what was quick.
        add("age p50, tutorial's to ours", theirs.p50 / ours.p50, 'x', 4.5 if is_light else 8)
        add("age p99, tutorial's to ours", theirs.p99 / ours.p99, 'x', 6 if is_light else 0)
        add("CPU of both, tutorial's to ours", theirs.cpu / ours.cpu, 'x', 2.5 if is_light else 0)
    add('age p50 to one memcpy', ours.p50 / copy, 'x',
        most=10 if load.width * load.height <= FULL_HD else 12)
    add('CPU of both', ours.cpu, 'ms/frame')
    if load.frames > SETTLED_FRAMES:
        add(f'memory after frame {SETTLED_FRAMES}', ours.growth, 'MB', most=GROWTH_MB)
    return figures


def print_result(way: str, result: Result) -> None:
    """Print a line of the table of runs."""
    print(f'{way:18}{result.delivered:9.1f}{result.p50:9.2f}{result.p99:9.2f}'
          f'{result.publisher_cpu:13.2f}{result.subscriber_cpu:13.2f}{result.faults:10.0f}',
          flush=True)


def print_stages(result: Result, copy: float) -> None:
    """Print where the age of a frame comes from."""
    print(f'\n{"stage":30}{"ms":>7}{"copies":>8}')
    for stage, milliseconds in zip(STAGES, result.stages):
        print(f'{stage:30}{milliseconds:7.2f}{milliseconds / copy:8.1f}')


def parse_size(text: str) -> tuple[int, int]:
    """
    Read a size.

    :raises argparse.ArgumentTypeError: it is written otherwise.
    """
    match = re.fullmatch(r'([1-9][0-9]*)x([1-9][0-9]*)', text)
    if not match:
        raise argparse.ArgumentTypeError(f'{text!r} is no size: write it as 1920x1080')
    return int(match[1]), int(match[2])


def main() -> int:
    """Run the ways in turn and print what became of the frames."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--size', type=parse_size, default='1920x1080', help='of the frames')
    parser.add_argument('--rate', type=float, default=30, help='frames per second')
    parser.add_argument('--seconds', type=float, default=5, help='of each run')
    parser.add_argument('--runs', type=int, default=5, help='of each way')
    parser.add_argument('--qos', choices=('reliable', 'best_effort'), default='reliable')
    add_json_option(parser)
    options = parser.parse_args()
    enter_domain()
    width, height = options.size
    load = Load(width, height, options.rate, round(options.rate * options.seconds), options.qos,
                NAMESPACE)
    print(f'{load.width}x{load.height} bgr8 at {load.rate:g} Hz, {load.qos}, {load.frames} frames '
          f'a run\n{"":18}{"arrived %":>9}{"p50 ms":>9}{"p99 ms":>9}{"pub. CPU ms":>13}'
          f'{"sub. CPU ms":>13}{"faults":>10}')
    results: dict[str, list[Result]] = {way: [] for way in WAYS}
    copies = []
    for _ in range(options.runs):
        copies.append(copy_ms(load))
        for way in WAYS:
            results[way].append(run_once(way, load))
            print_result(way, results[way][-1])
    ours, plain, theirs = (median(results[way]) for way in WAYS)
    copy = statistics.median(copies)
    print_result('ours, median', ours)
    print_result('plain, median', plain)
    print_result('tutorial, median', theirs)
    print_stages(ours, copy)
    print(f'{"one memcpy of the frame":30}{copy:7.2f}{1:8.1f}\n')
    figures = compare(load, ours, plain, theirs, copy)
    for figure in figures:
        verdict = '' if figure.met in (True, None) else '  missed'
        print(f'{figure.name:62}{figure.value:9.2f} {figure.unit:9}{figure.goal}{verdict}')
    if options.json:
        write_figures(options.json, figures)
    return 0


if __name__ == '__main__':
    raise SystemExit(main())
