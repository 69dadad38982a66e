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

"""Recording of bags against .npy files, and conversions by img_convert against OpenCV."""

from __future__ import annotations

from pathlib import Path
import sys

from bag_conversion import converting, help_start
from figures import Figure
from recording import (
    folder_here, main, print_heading, print_recording, record_publisher, Recording)

RATE, LARGE_RATE = 30, 15
MAX_CPU = 12.0  # ms of a 1080p frame


def recording(seconds: float) -> list[Figure]:
    """Record raw images as a bag and as .npy files, and 4K images as a bag."""
    print_heading('Raw images from our publisher', 'publisher', seconds)
    bag, arrays = (record(f'pattern:1920x1080@{RATE}', suffix, seconds, RATE)
                   for suffix in ('.mcap', '.npy'))
    large = record(f'pattern:3840x2160@{LARGE_RATE}', '.mcap', seconds, LARGE_RATE)
    cpu, other = bag.subscriber.per_frame, arrays.subscriber.per_frame
    print(f'CPU of a 1080p frame in a bag: {cpu / other:.2f} of .npy; goal at most {MAX_CPU:g} ms '
          f'{"met" if cpu <= MAX_CPU else "missed"}')
    return [
        kept_figure(f'1080p{RATE} in a bag, frames kept', bag),
        Figure('bags', f'1080p{RATE} in a bag, CPU', cpu, 'ms/frame', f'at most {MAX_CPU:g}',
               cpu <= MAX_CPU),
        Figure('bags', f'1080p{RATE} as .npy, CPU', other, 'ms/frame'),
        Figure('bags', f'1080p{RATE}, CPU of a bag against .npy', cpu / other, 'x'),
        kept_figure(f'4K{LARGE_RATE} in a bag, frames kept', large)]


def record(source: str, suffix: str, seconds: float, rate: float) -> Recording:
    """Record a source and print its line."""
    found = record_publisher(source, suffix, seconds, rate)
    print_recording(found)
    return found


def kept_figure(name: str, found: Recording) -> Figure:
    """Return the share of the sent frames that are in files."""
    return Figure(
        'bags', name, found.kept / found.sent * 100, '%', 'all', found.kept == found.sent)


def measure(seconds: float) -> list[Figure]:
    """Measure and print each section, and return the figures."""
    figures = [*recording(seconds), *help_start()]
    with folder_here() as folder:
        figures += converting(Path(folder))
    return figures


if __name__ == '__main__':
    sys.exit(main(__doc__, measure))
