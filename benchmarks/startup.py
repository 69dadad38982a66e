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

"""Time from the start of the publisher to its first published frame, each in a fresh process."""

from __future__ import annotations

import argparse
import os
import shutil
import statistics
import subprocess
import sys
import time

from figures import add_json_option, Figure, write_figures


def seconds_to_first_frame(source: str) -> float:
    """Start the publisher, wait for its first frame and end it."""
    program = shutil.which('img_publisher')
    if program is None:
        raise SystemExit('img_publisher is not in PATH: run make bench, or add the folder of the '
                         'executables to PATH')
    command = [program, '--ros-args', '-p', f'source:={source}', '-p', 'max_frames:=1']
    environment = dict(os.environ, ROS_AUTOMATIC_DISCOVERY_RANGE='LOCALHOST')
    began = time.perf_counter()
    with subprocess.Popen(command, stderr=subprocess.PIPE, text=True, env=environment) as process:
        for line in process.stderr:
            if 'Publishing video frame' in line:
                return time.perf_counter() - began
    raise SystemExit(f'{" ".join(command)} published no frame')


def main() -> int:
    """Print the median of several starts, after one that warms the machine."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--source', default='pattern', help='source of the frames')
    parser.add_argument('--runs', type=int, default=5, help='starts to take the median of')
    add_json_option(parser)
    options = parser.parse_args()
    seconds_to_first_frame(options.source)
    times = sorted(seconds_to_first_frame(options.source) for _ in range(options.runs))
    median = statistics.median(times)
    print(f'{options.source}: first frame after {median:.2f} s '
          f'(median of {options.runs}, {times[0]:.2f} to {times[-1]:.2f})')
    if options.json:
        write_figures(options.json, [
            Figure('startup', f'to the first frame, {options.source}', median, 's')])
    return 0


if __name__ == '__main__':
    sys.exit(main())
