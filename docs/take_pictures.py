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
Take the pictures of the documentation of img_viewer, so that they show the pages as they are.

Needs Debian's chromium-headless-shell. The cameras show three moments of a clip, and a depth image
of a floor with a ball.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
import os
from pathlib import Path
import re
import subprocess
import sys
import tempfile
import time

import cv2
import numpy as np
from opencv_tools.cv_bridge import CvBridge
import rclpy
from rclpy.node import Node
from sensor_msgs.msg import Image

ROOT = Path(__file__).resolve().parents[1]
IMAGES = ROOT / 'docs' / 'images'
sys.path.append(str(ROOT / 'test' / 'support'))
from chromium import new_browser, Page  # noqa: E402, I100

CLIP = ROOT / 'test' / 'data' / 'big_buck_bunny_720p.mp4'
CAMERAS = ('/front/image_raw', '/left/image_raw', '/rear/image_raw')
DEPTH = '/front/depth/image_raw'
RATE = 10.0
#: Name, address, width, height, and what is done in the page before the picture is taken.
PICTURES = (
    ('viewer.jpg', '', 1120, 800, ''),
    ('viewer_look.jpg', f'?topic={CAMERAS[0]}', 1120, 800,
     'document.querySelector(".tile:not([hidden]) [data-look=histogram]").click()'),
    ('viewer_depth.jpg', f'?topic={DEPTH}', 1280, 800, ''),
    ('viewer_graph.jpg', 'graph', 1280, 800, ''),
)
SECONDS = 6.0  # until rates and curves are there


def read_frames() -> list[np.ndarray]:
    """Return the frames of the clip in BGR."""
    capture, frames = cv2.VideoCapture(str(CLIP)), []
    while (read := capture.read())[0]:
        frames.append(read[1])
    return frames


def depth_image(width: int = 640, height: int = 360) -> np.ndarray:
    """Return a depth image in millimetres."""
    rows, columns = np.mgrid[:height, :width]
    depth = 4000 - 3000 * rows / height
    ball = (columns - width / 2) ** 2 + (rows - height / 2) ** 2
    near = ball < 90 ** 2
    depth[near] = 1200 - 3 * np.sqrt(90 ** 2 - ball[near])
    return depth.astype(np.uint16)


@contextmanager
def publishing(node: Node) -> Iterator[Callable[[float], None]]:
    """Yield a function that publishes all topics for some seconds."""
    frames, bridge = read_frames(), CvBridge()
    publishers = {name: node.create_publisher(Image, name, 10) for name in (*CAMERAS, DEPTH)}
    count = 0

    def publish(seconds: float) -> None:
        nonlocal count
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            for place, (name, publisher) in enumerate(publishers.items()):
                moment = (count + place * len(frames) // 3) % len(frames)
                message = (bridge.cv2_to_imgmsg(depth_image(), '16UC1') if name == DEPTH
                           else bridge.cv2_to_imgmsg(frames[moment], 'bgr8'))
                message.header.stamp = node.get_clock().now().to_msg()
                message.header.frame_id = name.split('/')[1]
                publisher.publish(message)
            count += 1
            time.sleep(1 / RATE)

    yield publish


def take(page: Page, publish: Callable[[float], None], file: Path, script: str) -> None:
    """Write a picture of a page that has received topics for some seconds."""
    publish(SECONDS)
    if script:
        page.evaluate(f'{script}; true')
        publish(SECONDS / 2)
    page.evaluate('if (document.title.startsWith("Cameras of")) '
                  'document.getElementById("title").textContent = "Cameras of robot"; true')
    page.screenshot(file)
    print(f'{file.relative_to(ROOT)}')


def main() -> int:
    """Take all pictures; return the exit status."""
    os.environ.update(ROS_DOMAIN_ID='93', ROS_AUTOMATIC_DISCOVERY_RANGE='LOCALHOST')
    rclpy.init()
    node = rclpy.create_node('robot')
    with tempfile.TemporaryFile('w+') as log:
        viewer = subprocess.Popen(['img_viewer', '--ros-args', '-p', 'port:=0'], stderr=log)
        try:
            with publishing(node) as publish, new_browser() as browser:
                found = None
                while not found and viewer.poll() is None:
                    publish(0.2)
                    log.seek(0)
                    found = re.search(r'Open (\S+) in a browser', log.read())
                if not found:
                    return 1
                for name, path, width, height, script in PICTURES:
                    page = browser.new_page(found[1] + path, width, height)
                    page.prefer('light')
                    take(page, publish, IMAGES / name, script)
                    page.close()
        finally:
            viewer.terminate()
            viewer.wait()
            rclpy.shutdown()
    return 0


if __name__ == '__main__':
    sys.exit(main())
