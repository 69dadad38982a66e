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
Age of the pictures of the viewer in a browser, from the publisher's stamp to pixels in the page.

The stamp is read from the pixels. The page and MJPEG in ``<img>`` of the same server are measured
in turn. The page reports each picture that it has drawn. An ``<img>`` reports nothing, and is read
every 4 ms. Then the page of all topics shows a robot of moving links beside the camera, and does
not, in turn. Then the page is at the end of a link of 8 Mbit/s, beside a page on a quick link.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, ExitStack
import os
from pathlib import Path
import re
import shutil
import subprocess
import sys
import tempfile
import time

import cv2
from figures import add_json_option, Figure, write_figures
from node_process import enter_domain, NAMESPACE
import numpy as np
from opencv_tools.frames import FrameNode, main as run_node
from opencv_tools.video.settings import VideoSettings
from rclpy.qos import DurabilityPolicy, QoSProfile

ROOT = Path(__file__).resolve().parent.parent
sys.path.append(str(ROOT / 'test' / 'support'))
from chromium import BROWSER, Browser, new_browser, Page, wait_until  # noqa: E402, I100
from hosts import linked_hosts  # noqa: E402
from sensor_msgs.msg import JointState  # noqa: E402
from std_msgs.msg import Header, String  # noqa: E402

CLIP = ROOT / 'test' / 'data' / 'big_buck_bunny_720p.mp4'
RATE = 30.0
TOPIC = f'{NAMESPACE}/video_frames'
CANVAS = f"[data-topic='{TOPIC}'] canvas"
SETTLE_SECONDS = 3.0
BITS = 16  # of a stamp in ms, as squares in the upper rows of a frame
SQUARE = 80  # pixels
TURN_MS = 1 << BITS
ROBOTS = (30, 300)  # moving links
ROOMS = {'shown': 1440, 'hidden': 760}  # pixels of the window, for pictures of one size
ROBOT_ROUNDS = 3
ROBOT_RATIO = 1.2  # goal

# Reads the stamp from an element that shows frames, and notes the age when the stamp is new.
_WATCH = """
window.watch = (element) => {
  const probe = Object.assign(document.createElement('canvas'), { width: BITS, height: 1 });
  const context = probe.getContext('2d', { willReadFrequently: true });
  context.imageSmoothingEnabled = false; // a pixel of each square
  window.ages = [];
  let last = -1;
  const read = () => {
    const width = element.naturalWidth || element.width;
    const square = width / BITS;
    if (!width) return;
    context.drawImage(element, 0, square / 2, width, 1, 0, 0, BITS, 1);
    const { data } = context.getImageData(0, 0, BITS, 1);
    let stamp = 0;
    for (let bit = 0; bit < BITS; bit += 1) stamp += (data[4 * bit + 1] > 127) * 2 ** bit;
    if (stamp === last) return;
    last = stamp;
    ages.push((performance.timeOrigin + performance.now() - stamp + TURN) % TURN);
  };
  if (!element.matches('canvas')) return setInterval(read, 4);
  window.waits = [];
  element.addEventListener('drawn', (event) => {
    read();
    waits.push(1000 * (event.detail.sent - event.detail.stamp));
  });
};
""".replace('BITS', str(BITS)).replace('TURN', str(TURN_MS))


class Camera(FrameNode):
    """Publish a clip, each frame with its stamp in the pixels."""

    def __init__(self, topic: str, video: VideoSettings | None = None) -> None:
        """Read the clip."""
        super().__init__('camera')
        capture = cv2.VideoCapture(str(CLIP))
        self._frames = []
        while (read := capture.read())[0]:
            self._frames.append(read[1])
        self._publisher = self.publish_frames(topic, video=video)
        self._count = 0
        self.create_timer(1 / RATE, self._publish)

    def _publish(self) -> None:
        image = self._frames[self._count % len(self._frames)].copy()
        self._count += 1
        now = self.get_clock().now()
        bits = now.nanoseconds // 1_000_000 % TURN_MS >> np.arange(BITS) & 1
        image[:SQUARE, :BITS * SQUARE] = np.repeat(255 * bits, SQUARE)[None, :, None]
        self._publisher.publish(image, Header(stamp=now.to_msg()))


class Robot(FrameNode):
    """Publish a robot whose joints all move."""

    def __init__(self, links: int) -> None:
        """Publish its description."""
        super().__init__('robot')
        latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        self._description = self.create_publisher(
            String, '/robot_description', latched)
        self._states = self.create_publisher(JointState, '/joint_states', 10)
        self._names = [f'j{number}' for number in range(1, links)]
        sphere = '<visual><geometry><sphere radius="0.05"/></geometry></visual>'
        self._description.publish(String(data='<robot name="chain">' + ''.join(
            f'<link name="l{number}">{sphere}</link>' for number in range(links)) + ''.join(
            f'<joint name="j{number}" type="continuous"><parent link="l{number - 1}"/>'
            f'<child link="l{number}"/><origin xyz="0 0 0.1"/><axis xyz="0 1 0"/></joint>'
            for number in range(1, links)) + '</robot>'))
        self.create_timer(1 / RATE, self._move)

    def _move(self) -> None:
        now = self.get_clock().now()
        angle = float(np.sin(now.nanoseconds / 1e9)) / 50
        self._states.publish(JointState(header=Header(stamp=now.to_msg()), name=self._names,
                                        position=[angle] * len(self._names)))


@contextmanager
def started(folder: Path, *command: str, within: Sequence[str] = ()) -> Iterator[Path]:
    """Run a command for the duration of the block; the path of its console."""
    console = folder / f'{time.monotonic_ns()}.log'
    with console.open('w') as lines:
        process = subprocess.Popen([*within, *command], stdin=subprocess.DEVNULL, stderr=lines)
    try:
        yield console
    finally:
        process.terminate()
        process.wait()


@contextmanager
def camera_and_viewer(
        folder: Path, address: str, within: Sequence[str] = ()) -> Iterator[str]:
    """Run both nodes for the duration of the block; the address of the page."""
    with started(folder, sys.executable, str(Path(__file__)), '--publish', TOPIC,
                 within=within), \
            started(folder, sys.executable, '-m', 'opencv_tools.image_viewer', '--ros-args',
                    '-p', 'port:=0', '-p', f'address:={address}', within=within) as console:
        found = wait_until(lambda: re.search(r'Open (\S+) in a browser', console.read_text()))
        yield found[1]


def watch(
    page: Page, selector: str, seconds: float, settle: float = SETTLE_SECONDS,
) -> np.ndarray:
    """Return the ages in ms of the pictures that an element shows, after ``settle`` seconds."""
    page.wait_for(f'document.querySelector("{selector}")?.hidden === false')
    page.evaluate(f'watch(document.querySelector("{selector}"))')
    time.sleep(settle)
    page.evaluate('ages.length = 0')
    time.sleep(seconds)
    return np.array(page.evaluate('ages'))


def open_page(browser: Browser, url: str) -> Page:
    """Open the page of the topic."""
    address, _, token = url.partition('?')
    return browser.new_page(f'{address}?topic={TOPIC}&{token}', 1440, 900)


def describe(name: str, ages: np.ndarray, seconds: float) -> str:
    """Return a line of the ages."""
    p50, p95, p99 = np.percentile(ages, (50, 95, 99))
    return (f'{name:34} p50 {p50:6.1f} ms, p95 {p95:6.1f} ms, p99 {p99:6.1f} ms, '
            f'{len(ages) / seconds:5.1f} Hz')


def goal(name: str, value: float, most: float, unit: str = 'ms') -> Figure:
    """Return a figure that must not be larger than a limit."""
    return Figure('viewer_page', name, value, unit, f'at most {most:g}', value <= most)


def measure_ages(folder: Path, seconds: float) -> list[Figure]:
    """Measure the ages in the page and in ``<img>``, in turn, of the same server."""
    with camera_and_viewer(folder, '127.0.0.1') as url, new_browser(script=_WATCH) as browser:
        page = open_page(browser, url)
        ages = watch(page, CANVAS, seconds)
        wait = np.median(page.evaluate('waits'))
        page.close()
        page = browser.new_page(f'{url}healthz')
        page.evaluate('const picture = new Image(); document.body.append(picture); '
                      f'picture.src = "/stream?topic={TOPIC}"; true')
        mjpeg = watch(page, 'img', seconds)
    print(describe('page, 720p30', ages, seconds) + f', {wait:.1f} ms until it is sent')
    print(describe('MJPEG in <img>, 720p30', mjpeg, seconds))
    (p50, p99), (mjpeg50, mjpeg99) = (np.percentile(each, (50, 99)) for each in (ages, mjpeg))
    return [goal('age in the page, 720p30, p50', float(p50), 15),
            goal('age in the page, 720p30, p99', float(p99), 40),
            Figure('viewer_page', 'age of MJPEG in <img>, p50', float(mjpeg50), 'ms'),
            Figure('viewer_page', 'age of MJPEG in <img>, p99', float(mjpeg99), 'ms'),
            Figure('viewer_page', 'MJPEG to page, p50', float(mjpeg50 / p50), 'x')]


def measure_robot(folder: Path, seconds: float) -> Iterator[Figure]:
    """Measure the ages beside a robot that is shown, and that is hidden, in turn."""
    for links in ROBOTS:
        ages: dict[str, list[np.ndarray]] = {'shown': [], 'hidden': []}
        elapsed = dict.fromkeys(ages, 0.0)
        with camera_and_viewer(folder, '127.0.0.1') as url, \
                started(folder, sys.executable, str(Path(__file__)), '--robot', str(links)), \
                new_browser(script=_WATCH) as browser:
            address, _, token = url.partition('?')
            for _ in range(ROBOT_ROUNDS):
                for robot, found in ages.items():
                    page = browser.new_page(f'{address}?robot={robot}&{token}', ROOMS[robot], 900)
                    begin = time.monotonic() + SETTLE_SECONDS
                    found.append(watch(page, CANVAS, seconds))
                    elapsed[robot] += time.monotonic() - begin  # a busy page answers late
                    page.close()
        for robot, found in ages.items():
            print(describe(f'robot of {links} links, {robot}', np.concatenate(found),
                           elapsed[robot]))
        shown, hidden = (np.median(np.concatenate(found)) for found in ages.values())
        yield Figure('viewer_page', f'age beside a robot of {links} links to that without, p50',
                     float(shown / hidden), 'x', f'at most {ROBOT_RATIO:g}',
                     bool(shown / hidden <= ROBOT_RATIO))


def measure_slow_link(folder: Path, seconds: float) -> list[Figure]:
    """Measure the ages at the end of a slow link, beside a page on a quick link."""
    with ExitStack() as stack:
        near, far = stack.enter_context(linked_hosts('8mbit', '64kb', '200ms'))
        url = stack.enter_context(camera_and_viewer(folder, near.address, near.within))
        quick_browser = stack.enter_context(new_browser(near.within, _WATCH))
        slow_browser = stack.enter_context(new_browser(far.within, _WATCH))
        quick = open_page(quick_browser, url)
        alone = watch(quick, CANVAS, seconds / 4)
        slow = open_page(slow_browser, url)
        slow.wait_for(f'document.querySelector("{CANVAS}")?.hidden === false')
        quick.evaluate('ages.length = 0')
        begin = time.monotonic()
        ages = watch(slow, CANVAS, seconds)
        beside = np.array(quick.evaluate('ages'))
        elapsed = time.monotonic() - begin
        shown = slow.evaluate(f'document.querySelector("{CANVAS}").closest(".tile")'
                              '.querySelector("[data-fact=shown] dd")?.textContent')
    third = len(ages) // 3
    growth = float(np.median(ages[-third:]) - np.median(ages[:third]))
    kept = len(beside) / elapsed / (len(alone) / (seconds / 4))
    print(describe('page behind 8 Mbit/s', ages, seconds) + f', {shown}')
    print(describe('quick page beside it', beside, elapsed))
    return [goal('age behind 8 Mbit/s, p50', float(np.percentile(ages, 50)), 150),
            goal('age behind 8 Mbit/s, p95', float(np.percentile(ages, 95)), 250),
            goal('growth of the age in the last third', growth, 25),
            Figure('viewer_page', 'rate of a quick page, beside a slow one to alone', kept, 'x',
                   'at least 0.95', kept >= 0.95)]


def main() -> int:
    """Print the figures; publish the frames for ``--publish``, a robot for ``--robot``."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--seconds', type=float, default=20.0, help='of each measurement')
    parser.add_argument('--publish', metavar='TOPIC', help=argparse.SUPPRESS)
    parser.add_argument('--robot', metavar='LINKS', type=int, help=argparse.SUPPRESS)
    add_json_option(parser)
    options = parser.parse_args()
    if options.publish:
        return run_node(lambda: Camera(options.publish), sys.argv[:1])
    if options.robot:
        return run_node(lambda: Robot(options.robot), sys.argv[:1])
    enter_domain()
    os.environ['PATH'] += ':/usr/sbin:/sbin'  # where Debian keeps tc
    figures = []
    with tempfile.TemporaryDirectory() as folder:
        if shutil.which(BROWSER) is None:
            print(f'{BROWSER} is missing: sudo apt install {BROWSER}')
        else:
            figures += measure_ages(Path(folder), options.seconds)
            figures += measure_robot(Path(folder), options.seconds / 4)
            if os.geteuid() == 0 and shutil.which('tc'):
                figures += measure_slow_link(Path(folder), options.seconds)
            else:
                print('a slow link needs root and tc: sudo apt install iproute2')
    if options.json:
        write_figures(options.json, figures)
    return int(any(figure.met is False for figure in figures))


if __name__ == '__main__':
    sys.exit(main())
