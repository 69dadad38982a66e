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
Where the age of a loaned frame comes from: microseconds from one stage to the next.

A publisher lends frames of 1920x1080 at 30 Hz to a subscriber, in the executor or in a thread. The
time of each stage is taken by wrappers around the functions of the package, so that it can be
compared with that of an older checkout: `PYTHONPATH=<checkout> python benchmarks/stages.py`.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
import json
import signal
import statistics
import subprocess
import sys
from threading import Thread
import time
from typing import Any

from builtin_interfaces.msg import Time
from figures import add_json_option, Figure, print_figures
from node_process import enter_domain
import numpy as np
from opencv_tools.base.units import NANO
from opencv_tools.frames import Frame, FrameNode, main as run_node
from opencv_tools.frames.loan import LoanedFrame
from opencv_tools.topics.queue import FrameQueue
from opencv_tools.transport.shared_frames.publisher import SharedFramePublisher
from opencv_tools.transport.shared_frames.reader import FrameReader
from opencv_tools.transport.shared_frames.writer import FrameWriter
from std_msgs.msg import Header

WIDTH, HEIGHT, RATE = 1920, 1080, 30
WARM_UP = 30  # frames that do not count
# Stages in their order, each until the moment that its name tells.
STAGES = ('stamped, block ends', 'checked, counts asked', 'header filled', 'sent, reader awake',
          'frame read', 'in the queue', 'callback')

Moments = dict[str, int]


class Marks:
    """The moments of frames by their stamps, in nanoseconds of the system clock."""

    def __init__(self) -> None:
        self.frames: dict[int, Moments] = {}
        self._current: Moments = {}

    def before(self, owner: type, name: str, stage: str) -> None:
        """Take the moment of each call of a method."""
        method = getattr(owner, name)

        def marked(*arguments: Any, **options: Any) -> Any:
            self._current[stage] = time.time_ns()
            return method(*arguments, **options)

        setattr(owner, name, marked)

    def after(self, owner: type, name: str, stage: str) -> None:
        """Take the moment of each return of a method with a result."""
        method = getattr(owner, name)

        def marked(*arguments: Any, **options: Any) -> Any:
            result = method(*arguments, **options)
            if result is not None and result is not False:
                self._current[stage] = time.time_ns()
            return result

        setattr(owner, name, marked)

    def keep(self, stamp_ns: int) -> None:
        """Keep what was taken as the moments of a frame."""
        self.frames[stamp_ns] = {**self._current}


class Publisher(FrameNode):
    """Lends frames in a thread."""

    def __init__(self, marks: Marks, frames: int) -> None:
        """Start the thread."""
        super().__init__('publishing')
        self._marks, self._count = marks, frames
        self._frames = self.publish_frames('video_frames')
        self._image = np.zeros((HEIGHT, WIDTH, 3), np.uint8)
        Thread(target=self._publish, daemon=True).start()

    def _publish(self) -> None:
        while not self._frames.has_subscribers:
            time.sleep(0.01)
        due = time.monotonic()
        for _ in range(self._count):
            due += 1 / RATE
            time.sleep(max(0.0, due - time.monotonic()))
            with self._frames.loan(HEIGHT, WIDTH) as loan:
                np.copyto(loan.image, self._image)
                now = time.time_ns()
                loan.source = Header(stamp=Time(sec=now // NANO, nanosec=now % NANO))
            self._marks.keep(now)
        self.done.set_result(0)


def publish(frames: int) -> None:
    """Run the publisher, and print the moments of its frames."""
    marks = Marks()
    marks.before(LoanedFrame, '__exit__', STAGES[0])
    marks.before(SharedFramePublisher, 'publish', STAGES[1])
    marks.before(FrameWriter, 'send', STAGES[2])
    _run(lambda: Publisher(marks, frames), marks)


def subscribe(*, threaded: bool) -> None:
    """Run a subscriber until a signal, and print the moments of its frames."""
    marks = Marks()
    marks.after(FrameReader, 'wait', STAGES[3])
    marks.after(FrameReader, 'receive', STAGES[4])
    marks.after(FrameQueue, 'put', STAGES[5])

    def receive(frame: Frame) -> None:
        marks._current[STAGES[6]] = time.time_ns()
        marks.keep(frame.stamp_ns)

    def create_node() -> FrameNode:
        node = FrameNode('receiving')
        node.receive_frames('video_frames', receive, encoding='', every=True, threaded=threaded)
        return node

    _run(create_node, marks)


def _run(create_node: Callable[[], FrameNode], marks: Marks) -> None:
    run_node(create_node, ['node'], frame_size=(WIDTH, HEIGHT))
    print(json.dumps(marks.frames))


def measure(way: str, seconds: int) -> list[Figure]:
    """Return the median of each stage, and of the age."""
    subscriber, publisher = (
        subprocess.Popen([sys.executable, __file__, '--end', end, '--seconds', str(seconds)],
                         stdout=subprocess.PIPE, text=True)
        for end in (way, 'publisher'))
    sent = json.loads(publisher.communicate()[0])
    time.sleep(1)
    subscriber.send_signal(signal.SIGINT)
    received = json.loads(subscriber.communicate()[0])
    spans: dict[str, list[float]] = {}
    for stamp in [stamp for stamp in sent if stamp in received][WARM_UP:]:
        moments, last = {**sent[stamp], **received[stamp]}, int(stamp)
        for stage in STAGES:
            spans.setdefault(stage, []).append((moments[stage] - last) / 1e3)
            last = moments[stage]
        spans.setdefault('age', []).append((last - int(stamp)) / 1e3)
    return [Figure('stages', f'{way}: {stage}', statistics.median(spans[stage]), 'us')
            for stage in (*STAGES, 'age')]


def main() -> int:
    """Print the stages of both ways."""
    ends = {'publisher': publish, 'executor': lambda _: subscribe(threaded=False),
            'thread': lambda _: subscribe(threaded=True)}
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--seconds', type=int, default=10, help='duration of each way')
    parser.add_argument('--end', choices=tuple(ends), help=argparse.SUPPRESS)
    add_json_option(parser)
    options = parser.parse_args()
    enter_domain()
    if options.end:
        ends[options.end](options.seconds * RATE)
        return 0
    print_figures([figure for way in ('thread', 'executor')
                   for figure in measure(way, options.seconds)], options.json)
    return 0


if __name__ == '__main__':
    sys.exit(main())
