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

"""Run all benchmarks and write one table of their figures."""

from __future__ import annotations

import argparse
from datetime import date
import os
from pathlib import Path
import platform
import shlex
import signal
import subprocess
import sys
import tempfile

import cv2
from figures import Figure, read_figures, table
import numpy as np

BENCHMARKS = (
    'startup', 'robot', 'robot_page', 'bridge', 'depth', 'rectified', 'calibration', 'idle',
    'playback',
    'recording', 'bags', 'messages', 'datasets', 'viewer', 'viewer_page', 'viewer_look',
    'viewer_calibration',
    'video', 'transport',
    'transport --qos best_effort --runs 3 --ways "ours raw" "plain subscriber" tutorial',
    'transport --sizes 1920x1080@60 3840x2160@30 --runs 3 '
    '--ways "ours raw" "ours shm" "thread shm" tutorial',
    'transport --subscribers 1 2 4 --runs 3 --ways "ours raw" "ours shm" "thread shm" tutorial',
    'transport --subscribers 8 --sizes 1920x1080@60 --runs 3 --ways "ours shm" "thread shm"')


def cpu_model() -> str:
    """Return the name of the processor, or the machine type if it is unknown."""
    for line in Path('/proc/cpuinfo').read_text().splitlines():
        key, _, name = line.partition(':')
        if key.strip() == 'model name':
            return name.strip()
    return platform.machine()


def heading() -> str:
    """Return a line with the date and the machine of the measurement."""
    cores = len(os.sched_getaffinity(0))
    return (f'# Benchmarks of {date.today()}: {cpu_model()}, {cores} cores, '
            f'Python {platform.python_version()}, numpy {np.__version__}, '
            f'OpenCV {cv2.__version__}')


def run(benchmark: str, figures: Path) -> int:
    """Run a benchmark, which writes its figures to a file; its exit status."""
    name, *options = shlex.split(benchmark)
    script = Path(__file__).resolve().with_name(f'{name}.py')
    # In a session of its own it is ended by one signal, not by that of the terminal as well.
    process = subprocess.Popen([sys.executable, str(script), *options, '--json', str(figures)],
                               start_new_session=True)
    try:
        return process.wait()
    except KeyboardInterrupt:
        process.terminate()
        process.wait()
        raise


def main() -> int:
    """Print and write the table; the exit status is 1 when a benchmark did not run."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--output', type=Path, metavar='FILE', default=Path('benchmarks.md'),
                        help='to write the table to')
    options = parser.parse_args()
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    figures: list[Figure] = []
    failures: list[str] = []
    with tempfile.TemporaryDirectory() as folder:
        for number, benchmark in enumerate(BENCHMARKS):
            print(f'--- {benchmark}', flush=True)
            path = Path(folder) / f'{number}.json'
            status = run(benchmark, path)
            if path.exists():
                figures += read_figures(path)
            if status not in (0, 1) or not path.exists():  # 1 when it missed a goal, too
                failures.append(f'{benchmark} did not run: exit status {status}')
            print(flush=True)
    text = '\n\n'.join([heading(), table(figures), *failures])
    print(text)
    options.output.write_text(f'{text}\n')
    return 1 if failures else 0


if __name__ == '__main__':
    sys.exit(main())
