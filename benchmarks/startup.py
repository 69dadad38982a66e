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
Time from the start of a process to its first frame or page, and to the end of --help.

Each start is a fresh process. The processes that it needs run already.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from contextlib import contextmanager, ExitStack
from dataclasses import dataclass
import re
import signal
import statistics
import subprocess
import sys
import tempfile
import time
from urllib.request import urlopen

from figures import add_json_option, Figure, print_figures
from node_process import enter_domain, NAMESPACE

_RUN = ('import sys; from opencv_tools.commands import {0} as run; sys.argv[0] = "{0}"; '
        'sys.exit(run())')
_PLAIN = """
import sys, rclpy
from rclpy.node import Node
from sensor_msgs.msg import Image
rclpy.init(args=sys.argv)
node = Node('plain')
{}
"""
_SCRIPTS = {
    'rclpy publisher': _PLAIN.format(
        "publisher = node.create_publisher(Image, 'video_frames', 10)\n"
        "publisher.publish(Image(height=480, width=640, encoding='bgr8', step=1920, "
        "data=bytes(480 * 1920)))\nprint('first', flush=True)"),
    'rclpy subscriber': _PLAIN.format(
        "subscription = node.create_subscription(Image, 'video_frames', lambda _: "
        "print('first', flush=True), 10)\nrclpy.spin(node)"),
    'own node': """
from opencv_tools.frames import FrameNode, main
class Receiving(FrameNode):
    def __init__(self):
        super().__init__('receiving')
        self.receive_frames('video_frames', lambda frame: print('first', flush=True))
main(Receiving)
"""}


@dataclass(frozen=True)
class Start:
    """
    A start to measure.

    :param name: of an executable, or of a script above.
    :param phrase: pattern of what it prints with its first frame; a group is the URL of its page.
    :param others: executables that run meanwhile.
    """

    name: str
    phrase: str = 'first'
    options: tuple[str, ...] = ()
    others: tuple[Start, ...] = ()
    goal: float | None = None


_SOURCE = '-p', 'source:=pattern:640x480@120'
_PUBLISHER = Start('img_publisher', 'Publishing video frame', _SOURCE, goal=0.25)
_SUBSCRIBER = Start('img_subscriber', 'Receiving video frame', (
    '-p', f'output_dir:={tempfile.gettempdir()}', '-p', 'file_name:=startup.jpg',
    '-p', 'max_frames:=0'), (_PUBLISHER,), goal=0.25)
_STARTS = (
    Start('rclpy publisher'), _PUBLISHER, Start('rclpy subscriber', others=(_PUBLISHER,)),
    _SUBSCRIBER, Start('own node', others=(_PUBLISHER,), goal=0.25),
    Start('img_filter', 'Filtering video frame', (
        '-p', 'function:=cv2:flip', '-p', 'arguments:=1'), (
            _PUBLISHER, Start('rclpy subscriber', '', ('-r', 'video_frames:=filtered_frames'))),
          goal=0.35),
    Start('img_viewer', r'Open (\S+) in', ('-p', 'port:=0'), (_PUBLISHER,), goal=0.4))
_COMMANDS = ('img_publisher', 'img_subscriber', 'img_filter', 'img_viewer', 'img_convert',
             'img_calibrate', 'urdf_to_sdf', 'robot_view', 'opencv_tools_info')
_HELP_GOAL = 0.06


@contextmanager
def _running(start: Start) -> Iterator[subprocess.Popen[str]]:
    script = _SCRIPTS.get(start.name) or _RUN.format(start.name)
    process = subprocess.Popen(
        [sys.executable, '-c', script, '--ros-args', '-r', f'__ns:={NAMESPACE}', *start.options],
        stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
    with process:
        try:
            yield process
        finally:
            process.send_signal(signal.SIGINT)  # peers would wait for a killed process
            process.communicate()


def _wait_for(process: subprocess.Popen[str], start: Start) -> None:
    """Wait for the first frame or page."""
    assert process.stdout
    lines = []
    for line in process.stdout:
        lines.append(line)
        found = re.search(start.phrase, line)
        if found and found.lastindex:
            urlopen(found[1]).read()
        if found:
            return
    raise SystemExit(f'{start.name} ended:\n{"".join(lines)}')


def seconds_to_first_frame(start: Start, runs: int) -> float:
    """Return the median time of some starts, after one that warms the machine."""
    seconds = []
    for _ in range(runs + 1):
        began = time.perf_counter()
        with _running(start) as process:
            _wait_for(process, start)
            seconds.append(time.perf_counter() - began)
    return statistics.median(seconds[1:])


def seconds_to_end(command: str, option: str, runs: int) -> float:
    """Return the median time that a command takes with an option."""
    seconds = []
    for _ in range(runs + 1):
        began = time.perf_counter()
        subprocess.run([sys.executable, '-c', _RUN.format(command), option], check=False,
                       stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        seconds.append(time.perf_counter() - began)
    return statistics.median(seconds[1:])


def measure(runs: int) -> Iterator[Figure]:
    """Yield the figures."""
    for start in _STARTS:
        with ExitStack() as stack:
            for other in start.others:
                process = stack.enter_context(_running(other))
                if other.phrase:
                    _wait_for(process, other)
            seconds = seconds_to_first_frame(start, runs)
        yield _figure(f'start of {start.name}', seconds, start.goal)
    for option in ('--help', '--version', '--wrong'):
        for command in _COMMANDS:
            yield _figure(f'{command} {option}', seconds_to_end(command, option, runs), _HELP_GOAL)


def _figure(name: str, seconds: float, goal: float | None) -> Figure:
    if goal is None:
        return Figure('startup', name, seconds, 's')
    return Figure('startup', name, seconds, 's', f'at most {goal:g}', seconds <= goal)


def main() -> int:
    """Print the median of several starts."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--runs', type=int, default=5, help='starts to take the median of')
    add_json_option(parser)
    options = parser.parse_args()
    enter_domain()
    print_figures(measure(options.runs), options.json)
    return 0


if __name__ == '__main__':
    sys.exit(main())
