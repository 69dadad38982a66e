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
Waits of somebody who looks: from the address to the first picture, from the pointer to a value.

A new browser opens the page of all topics, cold, and again in other tabs, warm. Then the pointer
moves over the pictures of four topics at 10 Hz: raw and depth of 640x480, JPEG of 640x480 and 4K.
"""

from __future__ import annotations

import argparse
import json
import os
from pathlib import Path
import sys
import tempfile
import time

import cv2
from figures import add_json_option, Figure, write_figures
from node_process import enter_domain, NAMESPACE
import numpy as np
from opencv_tools.cv_bridge import CvBridge
from opencv_tools.frames import FrameNode, main as run_node
from sensor_msgs.msg import CompressedImage, Image
from viewer_page import camera_and_viewer, CLIP, goal, started
# After viewer_page, which knows the folder of the browser.
from chromium import Browser, new_browser  # noqa: I100

RATE = 10.0
TABS = 5  # warm
TOPICS = {'raw 640x480': 'raw', 'float depth 640x480': 'depth', 'JPEG 640x480': 'jpeg',
          'JPEG 4K': 'jpeg_4k'}
VALUE_MS = 50  # goals
OPENING_MS = 400
OPENING_KB = 120
# Notes when the first picture is drawn. Measures the time to the next value under the pointer.
_WATCH = """
document.addEventListener('drawn', () => { window.drawn ??= performance.now(); }, true);
window.pointAt = async (part) => {
  const picture = document.querySelector('.tile:not([hidden]) .frame');
  const output = document.querySelector('.tile:not([hidden]) .pixel');
  const { left, top, width, height } = picture.querySelector('canvas').getBoundingClientRect();
  const before = output.textContent.split(':')[0];
  const begin = performance.now();
  const found = new Promise((done) => {
    new MutationObserver((_, observer) => {
      if (!output.textContent.includes(':') || output.textContent.startsWith(before + ':')) return;
      observer.disconnect();
      done(performance.now() - begin);
    }).observe(output, { childList: true });
  });
  picture.dispatchEvent(new PointerEvent('pointermove', { bubbles: true, pointerType: 'mouse',
    clientX: left + part[0] * width, clientY: top + part[1] * height }));
  return found;
};
"""


class Topics(FrameNode):
    """Publish a frame on four topics."""

    def __init__(self, namespace: str) -> None:
        """Read a frame, and encode it."""
        super().__init__('topics')
        clip = cv2.VideoCapture(str(CLIP))
        small = cv2.resize(clip.read()[1], (640, 480))
        large = cv2.resize(small, (3840, 2160))
        bridge = CvBridge()
        images = {'raw': bridge.cv2_to_imgmsg(small, 'bgr8'), 'depth': bridge.cv2_to_imgmsg(
            np.float32(small[..., 0]) / 50, '32FC1')}
        files = {'jpeg': bridge.cv2_to_compressed_imgmsg(small),
                 'jpeg_4k': bridge.cv2_to_compressed_imgmsg(large)}
        self._messages = [
            *((self.create_publisher(Image, f'{namespace}/{name}', 1), message)
              for name, message in images.items()),
            *((self.create_publisher(CompressedImage, f'{namespace}/{name}/compressed', 1),
               message)
              for name, message in files.items())]
        self.create_timer(1 / RATE, self._publish)

    def _publish(self) -> None:
        for publisher, message in self._messages:
            message.header.stamp = self.get_clock().now().to_msg()
            publisher.publish(message)


def measure_opening(browser: Browser, url: str) -> list[Figure]:
    """Measure the time to the first picture, cold and warm, and the bytes of the first load."""
    waits, sizes = [], []
    for _ in range(1 + TABS):
        page = browser.new_page(url, 1440, 900)
        waits.append(page.wait_for('window.drawn'))
        sizes.append(page.evaluate(
            "['navigation', 'resource'].flatMap((kind) => performance.getEntriesByType(kind))"
            '.reduce((sum, one) => sum + one.transferSize, 0)'))
        page.close()
    warm = float(np.median(waits[1:]))
    print(f'opening: cold {waits[0]:.0f} ms and {sizes[0] / 1000:.0f} kB, warm {warm:.0f} ms')
    return [Figure('viewer_look', 'opening to the first picture, cold', waits[0], 'ms'),
            goal('opening to the first picture, warm', warm, OPENING_MS),
            goal('bytes of the first load', sizes[0] / 1000, OPENING_KB, 'kB')]


def measure_values(browser: Browser, url: str, seconds: float) -> list[Figure]:
    """Measure the time from a movement of the pointer to the value under it."""
    figures = []
    for name, topic in TOPICS.items():
        address, _, token = url.partition('?')
        page = browser.new_page(f'{address}?topic={NAMESPACE}/{topic}&{token}', 1440, 900)
        page.wait_for('window.drawn')
        places = np.random.default_rng(1)
        end = time.monotonic() + seconds
        waits = []
        while time.monotonic() < end:
            time.sleep(0.05)
            waits.append(page.evaluate(f'pointAt({json.dumps(list(places.random(2)))})'))
        page.close()
        p50, p95 = np.percentile(waits, (50, 95))
        print(f'value under the pointer, {name:20} p50 {p50:5.1f} ms, p95 {p95:5.1f} ms')
        figures.append(goal(f'value under the pointer, {name}, p95', float(p95), VALUE_MS))
    return figures


def main() -> int:
    """Print the figures; publish the topics for ``--publish``."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--seconds', type=float, default=10.0, help='of each topic')
    parser.add_argument('--publish', metavar='NAMESPACE', help=argparse.SUPPRESS)
    add_json_option(parser)
    options = parser.parse_args()
    if options.publish:
        return run_node(lambda: Topics(options.publish), sys.argv[:1])
    enter_domain()
    with tempfile.TemporaryDirectory() as folder, \
            started(Path(folder), sys.executable, str(Path(__file__)), '--publish',
                    NAMESPACE), \
            camera_and_viewer(Path(folder), '127.0.0.1') as url, \
            new_browser(script=_WATCH) as browser:
        figures = [*measure_opening(browser, url),
                   *measure_values(browser, url, options.seconds)]
    print(f'load {os.getloadavg()[0]:.1f}')
    if options.json:
        write_figures(options.json, figures)
    return int(any(figure.met is False for figure in figures))


if __name__ == '__main__':
    sys.exit(main())
