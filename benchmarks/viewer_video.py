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
Age and rate of a video topic in the page of the viewer, by the link of the page.

The topic is 1280x720 at 30 Hz, and the browser decodes it. The stamp is read from the pixels, as
in ``viewer_page.py``. Each link is one of network namespaces, where the page has a certificate.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from contextlib import ExitStack
import os
from pathlib import Path
import re
import sys
import tempfile

from figures import add_json_option, Figure, print_figures
from node_process import enter_domain
import numpy as np
from opencv_tools.frames import main as run_node
from opencv_tools.video.settings import VideoSettings
from viewer_page import _WATCH, Camera, CANVAS, open_page, started, TOPIC, watch

ROOT = Path(__file__).resolve().parent.parent
sys.path.append(str(ROOT / 'test' / 'support'))
from chromium import new_browser, wait_until  # noqa: E402, I100
from hosts import linked_hosts  # noqa: E402

#: Links with rate, packets lost of a thousand, largest p50 and p95 of the age, and smallest rate.
LINKS = {
    'free link': ('1gbit', 0, 30.0, None, None),
    '2 Mbit/s': ('2mbit', 0, None, 150.0, 25.0),
    '8 Mbit/s, 1 % lost': ('8mbit', 10, None, 150.0, 25.0),
}
# A page on a slow link gets a smaller video after a few seconds.
_SETTLE_SECONDS = 12.0
BIT_RATES = {'quality 23': 0, '1.2 Mbit/s': 1_200_000}


def measure(name: str, bit_rate: int, folder: Path, seconds: float) -> np.ndarray:
    """Return the ages of the pictures at the end of a link, in ms."""
    rate, lost, *_ = LINKS[name]
    with ExitStack() as stack:
        near, far = stack.enter_context(linked_hosts(rate, '64kb', '200ms'))
        if lost:
            for host in near, far:
                host.lose('packets', lost)
        stack.enter_context(started(
            folder, sys.executable, __file__, '--publish', str(bit_rate), within=near.within))
        console = stack.enter_context(started(
            folder, sys.executable, '-m', 'opencv_tools.image_viewer', '--ros-args',
            '-p', 'port:=0', '-p', f'address:={near.address}', '-p', 'certificate:=auto',
            within=near.within))
        url = wait_until(lambda: re.search(r'Open (\S+) in a browser', console.read_text()))[1]
        page = open_page(stack.enter_context(new_browser(
            far.within, _WATCH, ['--ignore-certificate-errors'])), url)
        ages = watch(page, CANVAS, seconds, _SETTLE_SECONDS)
        shown = page.evaluate(f'document.querySelector("{CANVAS}").closest(".tile")'
                              '.querySelector("[data-fact=shown] dd")?.textContent')
        print(f'{name}: {shown}, {near.sent_bytes() / 1e6:.1f} MB sent', flush=True)
        return ages


def figures(name: str, video: str, ages: np.ndarray, seconds: float) -> Iterator[Figure]:
    """Compare the ages at the end of a link with its goals."""
    *_, most50, most95, least = LINKS[name]
    for label, value, unit, most in (
            ('age p50', float(np.percentile(ages, 50)), 'ms', most50),
            ('age p95', float(np.percentile(ages, 95)), 'ms', most95)):
        yield Figure('viewer_video', f'{name}, {video}: {label}', value, unit,
                     f'at most {most:g}' if most else '', value <= most if most else None)
    rate = len(ages) / seconds
    yield Figure('viewer_video', f'{name}, {video}: pictures', rate, 'Hz',
                 f'at least {least:g}' if least else '', rate >= least if least else None)


def main() -> int:
    """Print the figures; publish the frames for ``--publish``."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--seconds', type=float, default=20.0, help='of each measurement')
    parser.add_argument('--publish', type=int, metavar='BIT_RATE', help=argparse.SUPPRESS)
    add_json_option(parser)
    options = parser.parse_args()
    if options.publish is not None:
        settings = VideoSettings(bit_rate=options.publish)
        return run_node(lambda: Camera(os.environ['MEASURED_TOPIC'], settings), sys.argv[:1])
    enter_domain()
    os.environ['MEASURED_TOPIC'] = TOPIC
    os.environ['PATH'] += ':/usr/sbin:/sbin'  # where Debian keeps tc
    with tempfile.TemporaryDirectory() as folder:
        found = print_figures((
            figure for name in LINKS for video, bit_rate in BIT_RATES.items()
            for figure in figures(name, video, measure(
                name, bit_rate, Path(folder), options.seconds), options.seconds)), options.json)
    return int(any(figure.met is False for figure in found))


if __name__ == '__main__':
    sys.exit(main())
