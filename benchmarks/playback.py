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

"""Deviation from the frame rate: ten seconds of a pattern and of a folder in a loop."""

from __future__ import annotations

import argparse
from pathlib import Path
import re
import tempfile

import cv2
from figures import add_json_option, Figure, write_figures
from node_process import enter_domain, NodeProcess
import numpy as np

SECONDS = 10
RATES = {'pattern': 30, 'folder': 25}


def play(folder: Path, source: str, rate: int) -> float:
    """Play a source without subscribers for ten seconds and return its frames per second."""
    name = 'pattern:64x48' if source == 'pattern' else str(folder / 'pictures')
    publisher = NodeProcess('publisher', folder, source=name, publish_rate=rate, on_end='loop',
                            max_frames=SECONDS * rate + 1)
    publisher.wait_for('Published ')
    publisher.end()
    found = re.search(r'Published \d+ frames at ([\d.]+) Hz', publisher.console())
    if found is None:
        raise SystemExit(f'no rate was printed:\n{publisher.console()}')
    return float(found[1])


def main() -> int:
    """Print the deviation of each rate from the requested one."""
    parser = argparse.ArgumentParser(description=__doc__)
    add_json_option(parser)
    options = parser.parse_args()
    enter_domain()
    figures = []
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / 'pictures').mkdir()
        for number in range(2):
            cv2.imwrite(str(folder / 'pictures' / f'{number}.png'),
                        np.full((6, 9), number, np.uint8))
        for source, rate in RATES.items():
            deviation = abs(play(folder, source, rate) / rate - 1) * 100
            figures.append(Figure(
                'playback', f'{source} at {rate} Hz for {SECONDS} s: deviation', deviation, '%',
                'at most 2', deviation <= 2))
            print(f'{figures[-1].name:50}{deviation:7.2f} %  {figures[-1].goal}', flush=True)
    if options.json:
        write_figures(options.json, figures)
    return 0


if __name__ == '__main__':
    raise SystemExit(main())
