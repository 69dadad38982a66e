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

"""One run of one way: its processes, and what happened to the frames."""

from __future__ import annotations

from contextlib import ExitStack
from dataclasses import dataclass
import json
import statistics
import subprocess
import tempfile
from threading import Timer
import time
from typing import Any, IO

import numpy as np
from transport_ends import command, STAGES
from transport_parts import Load

LATE_SECONDS = 1.0  # for frames that are still on their way at the end
SETTLE_SECONDS = 0.3  # from the first frame of all subscribers to the first frame that counts
START_SECONDS = 60.0
CONSOLE_LINES = 10


class ProcessError(Exception):
    """A process did not do its part; the text is the end of its console."""


class ImpossibleFigureError(Exception):
    """A figure cannot be right; the text is the reason."""


@dataclass(frozen=True)
class Way:
    """
    The processes that a frame passes.

    :param publisher: name of the publisher in ``transport_ends.ENDS``.
    :param subscriber: name of each subscriber.
    :param node: name of the node between them; '' for none.
    :param transport: parameter ``transport`` of the package's subscribers.
    """

    publisher: str
    subscriber: str
    node: str = ''
    transport: str = 'raw'


@dataclass(frozen=True, kw_only=True)
class Result:
    """
    What happened to the frames of one way in one run, or the medians of several.

    CPU times have the unit ms per frame and include user and system time of all threads.

    :param delivered: per cent of the frames that arrived at the worst subscriber.
    :param p50: median of the ages in ms, of all subscribers.
    :param p99: 99th percentile of the ages in ms.
    :param publisher_cpu: CPU time of the publisher, without the filling of loans.
    :param node_cpu: CPU time of the node in between, without that of the filter.
    :param filter_cpu: CPU time of the filter.
    :param subscriber_cpu: CPU time of one subscriber.
    :param cpu: CPU time of all processes, without that of the filter and of the filling.
    :param faults: page faults per frame of all processes.
    :param growth: MB of memory from frame 500 to the end, of the process with the most.
    :param stages: ms of each stage; empty if they are not known.
    """

    delivered: float
    p50: float
    p99: float
    publisher_cpu: float
    node_cpu: float
    filter_cpu: float
    subscriber_cpu: float
    cpu: float
    faults: float
    growth: float
    stages: tuple[float, ...]


class Process:
    """A process of ``transport_ends.py``."""

    def __init__(self, end: str, load: Load, console: IO[str]) -> None:
        """Start the process, with its standard error in a file."""
        self._console = console
        self._process = subprocess.Popen(
            command(end, load), stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=console,
            text=True)

    def wait_for(self, word: str) -> None:
        """Wait until the process prints a word."""
        assert self._process.stdout
        if self._process.stdout.readline().strip() != word:
            raise self._error()

    def begin(self) -> None:
        """Make the camera count its frames."""
        assert self._process.stdin
        self._process.stdin.write('begin\n')
        self._process.stdin.flush()

    def end(self) -> None:
        """End the process."""
        assert self._process.stdin
        self._process.stdin.close()

    def numbers(self) -> dict[str, Any]:
        """Wait for the end of the process, and read what it has measured."""
        assert self._process.stdout
        try:
            numbers: dict[str, Any] = json.loads(self._process.stdout.read())
        except json.JSONDecodeError as err:
            raise self._error() from err
        return numbers

    def kill(self) -> None:
        """Kill the process, if it has not ended."""
        self._process.kill()
        self._process.wait()

    def close(self) -> None:
        """End the process in any case."""
        self.kill()
        for stream in (self._process.stdin, self._process.stdout):
            assert stream
            stream.close()

    def _error(self) -> ProcessError:
        self.kill()
        self._console.seek(0)
        return ProcessError('\n'.join(self._console.read().splitlines()[-CONSOLE_LINES:])
                            or 'a process did not end in time')


def run_once(way: Way, load: Load, subscribers: int) -> Result:
    """
    Send frames one way.

    :raises ImpossibleFigureError: an age or a CPU time is negative.
    :raises ProcessError: a process failed, or refused the transport.
    """
    with ExitStack() as stack:
        def start(end: str) -> Process:
            console = stack.enter_context(tempfile.TemporaryFile('w+'))
            process = Process(end, load, console)
            stack.callback(process.close)
            limit = Timer(START_SECONDS + 3 * load.frames / load.rate, process.kill)
            limit.start()
            stack.callback(limit.cancel)
            return process

        receiving = [start(way.subscriber) for _ in range(subscribers)]
        between = [start(way.node)] if way.node else []
        publisher = start(way.publisher)
        for process in receiving:
            process.wait_for('ready')
        time.sleep(SETTLE_SECONDS)
        publisher.begin()
        publisher.wait_for('done')
        time.sleep(LATE_SECONDS)
        processes = *receiving, *between, publisher
        for process in processes:
            process.end()
        return _result(load, [process.numbers() for process in receiving],
                       [process.numbers() for process in between], publisher.numbers())


def _result(load: Load, received: list[dict[str, Any]], between: list[dict[str, Any]],
            sent: dict[str, Any]) -> Result:
    # The first second does not count for the ages.
    first = min(int(load.rate), load.frames // 2)

    def settled(measured: dict[str, Any], key: str) -> list[Any]:
        return [value for number, value in zip(measured['numbers'], measured.get(key, []))
                if number >= first]

    ages = np.array([age for measured in received for age in settled(measured, 'ages')]
                    or [np.nan]) / 1e6
    stages = np.array([times for times in settled(received[0], 'stages')
                       if len(times) == len(STAGES)]) / 1e6
    every = *received, *between, sent
    cpu = min(measured['cpu'] for measured in every)
    if cpu < 0 or np.nanmin(ages, initial=0.0) < 0:
        raise ImpossibleFigureError(
            f'the least CPU time of a process is {cpu:.3f} ms a frame, and the least age '
            f'{np.nanmin(ages):.3f} ms: both must be positive')
    return Result(
        delivered=100 * min(
            len(set(measured['numbers'])) for measured in received) / sent['frames'],
        p50=float(np.percentile(ages, 50)), p99=float(np.percentile(ages, 99)),
        publisher_cpu=sent['cpu'], node_cpu=sum(measured['cpu'] for measured in between),
        filter_cpu=sum(measured['left_out'] for measured in between),
        subscriber_cpu=statistics.fmean(measured['cpu'] for measured in received),
        cpu=sum(measured['cpu'] for measured in every),
        faults=sum(measured['faults'] for measured in every),
        growth=max(measured['growth'] for measured in every),
        stages=tuple(np.median(stages, 0).tolist()) if len(stages) else ())


def median(results: list[Result]) -> Result:
    """Return the median of each number, but the worst delivery and growth."""
    numbers = {name: statistics.median(getattr(result, name) for result in results)
               for name in Result.__dataclass_fields__ if name != 'stages'}
    numbers['delivered'] = min(result.delivered for result in results)
    numbers['growth'] = max(result.growth for result in results)
    return Result(**numbers, stages=tuple(
        statistics.median(times) for times in zip(*(result.stages for result in results))))
