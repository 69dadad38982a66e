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

"""Size and processor time of depth images of 640x480, as RVL and as PNG."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator
import sys
import time

from figures import add_json_option, Figure, print_figures
import numpy as np
from numpy.typing import NDArray
from opencv_tools.image.compressed_depth import DEPTH_CODECS
from opencv_tools.image_codecs import decode_depth, encode_depth

GOAL_MS = 10.0  # of RVL each way
_MILLI = 1e-3


def room() -> NDArray[np.uint16]:
    """Return depth in millimetres of a floor and walls with steps, noise, and 5 % without data."""
    random = np.random.default_rng(1)
    rows, columns = np.mgrid[:480, :640]
    depth = np.where(rows > 300, 3000 - 4 * (rows - 300), 3000 + 500 * (columns // 160))
    depth[150:350, 200:330] = 1200
    depth = depth + np.rint(random.normal(0, (depth / 1000) ** 2))
    depth[random.random(depth.shape) < 0.02] = 0
    depth[140:350, 190:200] = 0  # the shadow of the projector
    return depth.astype(np.uint16)


def best_ms(work: Callable[[], object], rounds: int) -> float:
    """Return the shortest processor time of a call in milliseconds."""
    times = []
    for _ in range(rounds):
        began = time.process_time()
        work()
        times.append(time.process_time() - began)
    return min(times) / _MILLI


def measure(rounds: int) -> Iterator[Figure]:
    """Yield the size and the time of each codec."""
    image = room()
    for codec in DEPTH_CODECS:
        content, format_text = encode_depth(image, '16UC1', codec)
        yield Figure('depth', f'{codec}: size of the raw image', len(content) / image.nbytes, 'x')
        for way, work in {'encoded': lambda codec=codec: encode_depth(image, '16UC1', codec),
                          'decoded': lambda content=content, text=format_text: decode_depth(
                              content, text)}.items():
            value = best_ms(work, rounds)
            has_goal = codec == 'rvl'
            yield Figure('depth', f'{codec} {way}', value, 'ms',
                         f'at most {GOAL_MS:g}' if has_goal else '',
                         value <= GOAL_MS if has_goal else None)


def main() -> int:
    """Print the figures; the exit status is 1 when a goal was missed."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--rounds', type=int, default=50, help='calls of each [%(default)s]')
    add_json_option(parser)
    options = parser.parse_args()
    figures = print_figures(measure(options.rounds), options.json)
    return 1 if any(figure.met is False for figure in figures) else 0


if __name__ == '__main__':
    sys.exit(main())
