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
Write the sheets of docs/viewer_pages.md: each page of img_viewer in three sizes, light and dark.

Needs what take_pictures.py needs. With a folder as argument, the single pictures are kept there.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
import math
import os
from pathlib import Path
import struct
import sys
import tempfile
from threading import Event, Thread
import time
import zlib

import cv2
import numpy as np
import rclpy
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from sensor_msgs.msg import CompressedImage, JointState
from std_msgs.msg import String
from take_pictures import (
    Browser, calibrating, CAMERAS, HISTOGRAM, IMAGES, new_browser, Page, publish_cameras, RATE,
    read_frames, ROOT, SECONDS, viewing)

SIZES = ((390, 844), (1280, 800), (1920, 1080))
SCHEMES = ('light', 'dark')
SCALE, MARGIN, BACKGROUND = 0.5, 12, 150
#: Sheets that are JPEG; the others are PNG with a palette.
PHOTOS = ('cameras', 'topic', 'recording', 'video', 'calibration')
#: Bytes that a JPEG may have; its quality is as high as they allow.
MAX_BYTES = 145_000
COLORS = 96
MANY = 60
ONE = f'?topic={CAMERAS[0]}'
SHOWN = 'document.querySelectorAll(".tile:not([hidden]) canvas[role=img]:not([hidden])").length'
VIDEO = 'document.querySelector(".facts")?.textContent.includes("h264")'
RECORD = ('{ const button = document.getElementById("record"); '
          'if (button.ariaPressed !== "true") button.click(); }')
#: Hides the name of the machine and its folder.
HIDE = ('for (const id of ["title", "recording"]) { const shown = document.getElementById(id); '
        'if (shown) shown.textContent = shown.textContent.replace(/^Cameras of .*/, '
        '"Cameras of robot").replace(/\\/\\S*\\/(?=bags\\/)/, ""); } true')
FRESH = 'document.querySelector(".tile:not([hidden]) .reason:not([hidden])") === null'


@dataclass(frozen=True, kw_only=True)
class Sheet:
    """
    A page of the viewer.

    :param name: name of its picture, without the extension.
    :param path: address after that of the viewer.
    :param ready: JavaScript that is true once the page has its contents.
    :param script: what is done then, in each size.
    """

    name: str
    path: str = ''
    ready: str = 'true'
    script: str = ''

    def take(self, browser: Browser, url: str, folder: Path) -> None:
        """Write the sheet of a viewer, and its single pictures to a folder."""
        address, _, token = url.partition('?')
        page = browser.new_page(url if token else address + self.path)
        for size in SIZES:
            page.resize(*size)
            page.go(address + self.path)
            page.wait_for(self.ready)
            if self.script:
                time.sleep(1.0)
                page.evaluate(f'{self.script}; true')
            time.sleep(SECONDS)
            shoot(page, size, folder / self.name)
        page.close()
        write_sheet(self.name, folder)


FIRST = (
    Sheet(name='cameras', ready=f'{SHOWN} >= 4'),
    Sheet(name='topic', path=ONE, ready=f'{SHOWN} >= 1', script=HISTOGRAM))
GRAPH = Sheet(name='graph', path='graph',
              ready='document.querySelectorAll("#topics .item").length >= 4')
TOKEN = Sheet(name='token')
RECORDING = Sheet(name='recording', ready=f'{SHOWN} >= 4', script=RECORD)
MANY_TOPICS = Sheet(name='many', ready=f'{SHOWN} >= 3')
ROBOT = Sheet(name='robot', path='robot/', ready='document.querySelector("canvas") !== null')
VIDEO_TOPIC = Sheet(name='video', path=ONE, ready=VIDEO)


def shoot(page: Page, size: tuple[int, int], file: Path) -> None:
    """Write the pictures of a page in one size, light and dark."""
    for scheme in SCHEMES:
        page.prefer(scheme)
        time.sleep(1.0)
        for _ in range(20):  # a picture without new ones is gray, for a moment on a busy machine
            if page.evaluate(FRESH):
                break
            time.sleep(0.3)
        page.evaluate(HIDE)
        page.screenshot(file.with_name(f'{file.name}_{size[0]}_{scheme}.png'))


def write_sheet(name: str, folder: Path) -> None:
    """Write the pictures of a page as one, scaled down: the sizes in a row, dark below light."""
    rows = []
    height = round(SIZES[-1][1] * SCALE)
    for scheme in SCHEMES:
        parts: list[np.ndarray] = [np.full((height, MARGIN, 3), BACKGROUND, np.uint8)]
        for size in SIZES:
            picture = cv2.imread(str(folder / f'{name}_{size[0]}_{scheme}.png'))
            assert picture is not None
            small = cv2.resize(picture, None, fx=SCALE, fy=SCALE, interpolation=cv2.INTER_AREA)
            parts.append(cv2.copyMakeBorder(
                small, 0, height - small.shape[0], 0, MARGIN, cv2.BORDER_CONSTANT,
                value=(BACKGROUND,) * 3))
        rows.append(np.hstack(parts))
    line = np.full((MARGIN, rows[0].shape[1], 3), BACKGROUND, np.uint8)
    sheet = np.vstack([line, rows[0], line, rows[1], line])
    file = IMAGES / f'pages_{name}.{"jpg" if name in PHOTOS else "png"}'
    data = jpeg(sheet) if name in PHOTOS else palette_png(sheet)
    file.write_bytes(data)
    print(f'{file.relative_to(ROOT)}: {len(data)} bytes')


def jpeg(image: np.ndarray) -> bytes:
    """Return the best JPEG of a BGR image that is small enough."""
    for quality in range(90, 20, -5):
        data = cv2.imencode('.jpg', image, [
            cv2.IMWRITE_JPEG_QUALITY, quality, cv2.IMWRITE_JPEG_OPTIMIZE, 1])[1].tobytes()
        if len(data) <= MAX_BYTES:
            break
    return data


def palette_png(image: np.ndarray) -> bytes:
    """Return a BGR image as PNG with a palette, which OpenCV does not write."""
    packed = image.astype(np.uint32) @ np.array([1, 256, 65536], np.uint32)
    found, places, counts = np.unique(packed, return_inverse=True, return_counts=True)
    colors = np.stack([found >> shift & 255 for shift in (0, 8, 16)], 1).astype(np.float32)
    weights = counts ** 0.85  # rare colours count a little more
    sample = np.random.default_rng(1).choice(colors, 20_000, p=weights / weights.sum())
    cv2.setRNGSeed(1)
    end = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_MAX_ITER, 20, 0.5)
    labels = np.zeros((len(sample), 1), np.int32)
    centers = cv2.kmeans(sample, COLORS, labels, end, 1, cv2.KMEANS_PP_CENTERS)[2]
    palette = np.rint(centers).astype(np.uint8)
    nearest = np.argmin(((colors[:, None] - palette[None]) ** 2).sum(2), 1).astype(np.uint8)
    height, width = image.shape[:2]
    rows = np.pad(nearest[places].reshape(height, width), ((0, 0), (1, 0)))  # without a filter
    chunks = ((b'IHDR', struct.pack('>IIBBBBB', width, height, 8, 3, 0, 0, 0)),
              (b'PLTE', palette[:, ::-1].tobytes()), (b'IDAT', zlib.compress(rows.tobytes(), 9)),
              (b'IEND', b''))
    return b'\x89PNG\r\n\x1a\n' + b''.join(
        struct.pack('>I', len(data)) + kind + data + struct.pack('>I', zlib.crc32(kind + data))
        for kind, data in chunks)


@contextmanager
def publishing(prepare: Callable[[Node], Callable[[float], None]]) -> Iterator[None]:
    """Publish during the block, in a thread, with the function that `prepare` returns."""
    node = rclpy.create_node('robot')
    publish, end = prepare(node), Event()

    def run() -> None:
        while not end.is_set():
            publish(0.5)

    thread = Thread(target=run)
    thread.start()
    try:
        yield
    finally:
        end.set()
        thread.join()
        node.destroy_node()


def soft_frames() -> list[np.ndarray]:
    """Return the frames of the clip in BGR, smaller and without the details of the grass."""
    return [cv2.resize(cv2.GaussianBlur(frame, (0, 0), 3.0), (854, 480))
            for frame in read_frames()]


def numbered_image(number: int) -> np.ndarray:
    """Return a BGR image of one colour with the number of its camera."""
    color = cv2.applyColorMap(np.full((1, 1), 255 * number // MANY, np.uint8), cv2.COLORMAP_HSV)
    image = np.full((180, 320, 3), color[0, 0] // 2, np.uint8)
    cv2.putText(image, f'{number:02}', (95, 120), cv2.FONT_HERSHEY_SIMPLEX, 3.0, (255,) * 3, 8,
                cv2.LINE_AA)
    return image


def publish_many(node: Node) -> Callable[[float], None]:
    """Return a function that publishes JPEGs of 60 cameras for some seconds."""
    data = [cv2.imencode('.jpg', numbered_image(number))[1].tobytes() for number in range(MANY)]
    publishers = [node.create_publisher(
        CompressedImage, f'/camera_{number:02}/image_raw/compressed', 1) for number in range(MANY)]

    def publish(seconds: float) -> None:
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            for place, publisher in enumerate(publishers):
                message = CompressedImage(format='jpeg', data=data[place])
                message.header.stamp = node.get_clock().now().to_msg()
                publisher.publish(message)
            time.sleep(2 / RATE)

    return publish


def publish_robot(node: Node) -> Callable[[float], None]:
    """Return a function that moves a robot for some seconds."""
    text = (ROOT / 'urdf' / 'my_arm.urdf').read_text()
    descriptions = node.create_publisher(String, '/robot_description', QoSProfile(
        depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL))
    descriptions.publish(String(data=text))
    states = node.create_publisher(JointState, '/joint_states', 10)

    def publish(seconds: float) -> None:
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            angle = math.sin(time.monotonic() / 2)
            message = JointState(name=['shoulder', 'elbow'], position=[angle, 0.5 + angle / 4])
            message.header.stamp = node.get_clock().now().to_msg()
            states.publish(message)
            time.sleep(1 / RATE)

    return publish


def take_cameras(browser: Browser, folder: Path) -> None:
    """Write the sheets of pages with four cameras."""
    with publishing(partial(publish_cameras, frames=soft_frames())):
        with viewing() as url:
            for sheet in FIRST:
                sheet.take(browser, url, folder)
            other = browser.new_page(url)  # so that the graph has a subscriber
            GRAPH.take(browser, url, folder)
            other.close()
        with viewing('video:=always') as url:
            VIDEO_TOPIC.take(browser, url, folder)
        with tempfile.TemporaryDirectory() as bags, viewing(
                'control:=true', 'record_dir:=bags', folder=bags) as url:
            TOKEN.take(browser, url.partition('?')[0], folder)
            RECORDING.take(browser, url, folder)


def main(folder: Path) -> int:
    """Write all sheets, and their single pictures to a folder; return the exit status."""
    os.environ.update(ROS_DOMAIN_ID='93', ROS_AUTOMATIC_DISCOVERY_RANGE='LOCALHOST')
    folder.mkdir(parents=True, exist_ok=True)
    rclpy.init()
    try:
        with new_browser() as browser:
            take_cameras(browser, folder)
            for prepare, sheet in ((publish_many, MANY_TOPICS), (publish_robot, ROBOT)):
                with publishing(prepare), viewing() as url:
                    sheet.take(browser, url, folder)
            with calibrating(browser) as page:
                for size in SIZES:
                    page.resize(*size)
                    shoot(page, size, folder / 'calibration')
            write_sheet('calibration', folder)
    finally:
        rclpy.shutdown()
    return 0


if __name__ == '__main__':
    with tempfile.TemporaryDirectory() as temporary:
        sys.exit(main(Path((*sys.argv[1:], temporary)[0])))
