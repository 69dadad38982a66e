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
"""Fixtures of the tests in a browser, and frames whose number can be read from a page."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
import re
from typing import Any

from chromium import Browser, new_browser, Page
from conftest import NodeProcess, spin_until
import numpy as np
import pytest
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import QoSProfile
from sending import stamped
from sensor_msgs.msg import Image

#: Colours of the stripe at the bottom of a numbered frame, in BGR.
STRIPE = ((0, 0, 255), (0, 255, 0), (255, 0, 0), (255, 255, 255))
_CELLS = 4  # a number has 16 bits, in rows of four squares

#: Runs in each page before its own scripts. A picture counts only as it is in the canvas.
SCRIPT = """
window.drawn = [];
window.sockets = [];
window.sent = [];
window.received = [];
window.followed = new Set();
window.WebSocket = class extends WebSocket {
  constructor(...words) {
    super(...words);
    sockets.push(this);
    this.addEventListener('message', ({ data }) => {
      if (data instanceof ArrayBuffer) {
        if (received.length < 10) received.push(data.slice(0));
      } else {
        for (const { name } of JSON.parse(data).status ?? []) followed.add(name);
      }
    });
  }
  send(text) { super.send(text); sent.push(JSON.parse(text)); }
};
window.pixel = (canvas, x, y) => [...canvas.getContext('2d').getImageData(
  Math.floor(x * canvas.width), Math.floor(y * canvas.height), 1, 1).data].slice(0, 3);
window.numberIn = (canvas) => {
  let number = 0;
  for (let bit = 0; bit < 16; bit += 1) {
    if (pixel(canvas, (bit % 4 + 0.5) / 4, ((bit >> 2) + 0.5) / 5)[1] > 127) number += 2 ** bit;
  }
  return number;
};
window.tileOf = (topic) => [...document.querySelectorAll('.tile')].find(
  (tile) => tile.dataset.topic === topic);
window.numberOf = (topic) => {
  const canvas = tileOf(topic)?.querySelector('canvas');
  return canvas && !canvas.hidden ? numberIn(canvas) : -1;
};
window.factOf = (topic, fact) => tileOf(topic)?.querySelector(
  `[data-fact=${fact}] dd`)?.textContent;
document.addEventListener('drawn', (event) => drawn.push({
  topic: event.target.closest('.tile').dataset.topic, number: numberIn(event.target),
  stamp: event.detail.stamp,
  age: (performance.timeOrigin + performance.now()) / 1000 - event.detail.stamp,
}), true);
"""


def numbered_frame(number: int, width: int = 320, height: int = 240) -> np.ndarray:
    """
    Return a frame with 16 black or white squares, the bits of a number, above coloured fields.

    :param number: number from 0 to 65535.
    :param width: width in pixels.
    :param height: height in pixels.
    :returns: (height, width, 3) uint8 array in BGR.
    """
    image = np.zeros((height, width, 3), np.uint8)
    rows, columns = np.arange(height) * (_CELLS + 1) // height, np.arange(width) * _CELLS // width
    for row in range(_CELLS):
        for column in range(_CELLS):
            place = np.ix_(rows == row, columns == column)
            image[place] = 255 * (number >> (row * _CELLS + column) & 1)
            image[np.ix_(rows == _CELLS, columns == column)] = STRIPE[column]
    return image


@dataclass
class Camera:
    """
    A publisher of numbered frames.

    :param node: node of the publisher.
    :param topic: name of the topic.
    :param qos: quality of service.
    """

    node: Node
    topic: str
    qos: QoSProfile = field(default_factory=lambda: QoSProfile(depth=10))
    publisher: Publisher = field(init=False)

    def __post_init__(self) -> None:
        self.publisher = self.node.create_publisher(Image, self.topic, self.qos)

    def publish(self, number: int, stamp_ns: int | None = None) -> None:
        """Publish a numbered frame; its stamp is now, or a time in nanoseconds."""
        self.publish_image(numbered_frame(number), 'bgr8', stamp_ns)

    def publish_image(self, image: np.ndarray, encoding: str, stamp_ns: int | None = None) -> None:
        """Publish an image."""
        now = self.node.get_clock().now().nanoseconds
        self.publisher.publish(stamped(image, encoding, now if stamp_ns is None else stamp_ns))

    def show(self, page: Page, number: int, stamp_ns: int | None = None) -> None:
        """
        Wait for the viewer's subscription, publish a frame once, and wait until the page draws it.

        The tile of the topic must be the one that shows the number in its pixels. Fails after
        ten minutes without a subscription or without the picture.
        """
        self.wait_for_viewer()
        self.publish(number, stamp_ns)
        page.wait_for(f'numberOf({self.topic!r}) === {number}')

    def is_watched(self) -> bool:
        """Return whether the viewer subscribes."""
        return self.publisher.get_subscription_count() > 0

    def wait_for_viewer(self) -> None:
        """Wait until the viewer subscribes."""
        spin_until(self.node, self.is_watched)

    def wait_for_no_viewer(self) -> None:
        """Wait until the viewer has ended its subscription."""
        spin_until(self.node, lambda: not self.is_watched())


@dataclass
class Viewer:
    """
    A node that serves the page.

    :param process: process of the node.
    :param url: address of the page.
    """

    process: NodeProcess
    url: str = ''

    def __post_init__(self) -> None:
        self.process.wait_for(' in a browser')
        self.url = re.search(r'Open (\S+) in a browser', self.process.output)[1]

    @property
    def port(self) -> int:
        """Port of the page."""
        return int(re.search(r':(\d+)/', self.url)[1])


@pytest.fixture
def browser() -> Iterator[Browser]:
    """Start a browser with an empty profile; every page can read the numbers of frames."""
    with new_browser(script=SCRIPT) as started:
        yield started


@pytest.fixture
def start_viewer(start: Callable[..., NodeProcess]) -> Callable[..., Viewer]:
    """Return a function that starts a viewer on a free port, with parameters."""
    def _start(**given: Any) -> Viewer:
        return Viewer(start('img_viewer', **{'port': 0, **given}))

    return _start


@pytest.fixture
def viewer(start_viewer: Callable[..., Viewer]) -> Viewer:
    """Start a viewer with the default parameters on a free port."""
    return start_viewer()
