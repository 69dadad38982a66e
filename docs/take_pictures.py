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

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
import os
from pathlib import Path
import re
import subprocess
import sys
import tempfile
from threading import Thread
import time

import cv2
import numpy as np
from opencv_tools.cv_bridge import CvBridge
import rclpy
from rclpy.node import Node
from sensor_msgs.msg import CameraInfo, Image

ROOT = Path(__file__).resolve().parents[1]
IMAGES = ROOT / 'docs' / 'images'
sys.path.append(str(ROOT / 'test' / 'support'))
from chromium import Browser, new_browser, Page  # noqa: E402, I100
from detections import Detector  # noqa: E402, I100
from shown_boards import BOARD, held_board, RATE as BOARD_RATE, write_former  # noqa: E402, I100

CLIP = ROOT / 'test' / 'data' / 'big_buck_bunny_720p.mp4'
CAMERAS = ('/front/image_raw', '/left/image_raw', '/rear/image_raw')
DEPTH = '/front/depth/image_raw'
RATE = 10.0
SCENE, SCENE_FRAME = '/garden', 5
OVERLAYS = f'?topic={SCENE}/image_raw&boxes={SCENE}/detections&center=true&outline=true&grid=2'
HISTOGRAM = 'document.querySelector(".tile:not([hidden]) [data-look=histogram]").click()'
#: Name, address, width, height, and what is done in the page before the picture is taken.
PICTURES = (
    ('viewer.jpg', '', 1120, 800, ''),
    ('viewer_look.jpg', f'?topic={CAMERAS[0]}', 1120, 800, HISTOGRAM),
    ('viewer_dark.jpg', f'?topic={CAMERAS[0]}', 1920, 1080, HISTOGRAM),
    ('viewer_phone.jpg', '', 390, 844, ''),
    ('viewer_phone_look.jpg', f'?topic={CAMERAS[0]}', 390, 844, ''),
    ('viewer_depth.jpg', f'?topic={DEPTH}', 1280, 800, ''),
    ('viewer_graph.jpg', 'graph', 1280, 800, ''),
    ('viewer_overlays.jpg', OVERLAYS, 1280, 800, ''),
)
SECONDS = 6.0  # until rates and curves are there
#: Middle, width, height and angle of the boxes in the frame of the scene, with name and score.
BOXES = ((296, 407, 483, 332, 0.0, 'rabbit', 0.93), (1039, 350, 430, 190, 0.06, 'rock', 0.61))
VIEWS = 14  # of the board, in the picture of a calibration


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


def publish_cameras(
    node: Node, frames: Sequence[np.ndarray] = (),
) -> Callable[[float], None]:
    """Return a function that publishes frames, or those of the clip, for some seconds."""
    frames, bridge = frames or read_frames(), CvBridge()
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

    return publish


def publish_scene(node: Node) -> Callable[[float], None]:
    """Return a function that publishes a picture with boxes and a calibration for some seconds."""
    frame, bridge = read_frames()[SCENE_FRAME], CvBridge()
    images = node.create_publisher(Image, f'{SCENE}/image_raw', 10)
    infos = node.create_publisher(CameraInfo, f'{SCENE}/camera_info', 10)
    detector = Detector(node, f'{SCENE}/detections')
    matrix = [900.0, 0.0, 648.0, 0.0, 900.0, 355.0, 0.0, 0.0, 1.0]
    info = CameraInfo(width=1280, height=720, distortion_model='plumb_bob', k=matrix,
                      d=[-0.28, 0.07, 0.0, 0.0, 0.0], r=np.eye(3).ravel(),
                      p=[*matrix[:3], 0.0, *matrix[3:6], 0.0, *matrix[6:], 0.0])

    def publish(seconds: float) -> None:
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            now = node.get_clock().now()
            message = bridge.cv2_to_imgmsg(frame, 'bgr8')
            message.header.stamp = info.header.stamp = now.to_msg()
            infos.publish(info)
            images.publish(message)
            detector.publish(now.nanoseconds, BOXES)
            time.sleep(1 / RATE)

    return publish


@contextmanager
def calibrating(browser: Browser) -> Iterator[Page]:
    """Yield the page of a calibration whose views are there."""
    with tempfile.TemporaryDirectory() as folder, viewing('control:=true') as url:
        held_board(Path(folder) / 'board', VIEWS)
        former = write_former(Path(folder) / 'former.yaml', 400.0)
        camera = subprocess.Popen([
            'img_publisher', '--ros-args', '-p', f'source:={folder}/board', '-p', 'loop:=0', '-p',
            f'publish_rate:={BOARD_RATE}', '-p', f'camera_info_url:={former}'],
            stderr=subprocess.DEVNULL)
        try:
            page = browser.new_page(url, 1280, 800)  # with its token
            page.prefer('light')
            page.wait_for('document.querySelector(".tile") !== null')
            page.go(f'{url.partition("?")[0]}calibrate?topic=/video_frames')
            page.wait_for('document.getElementById("board-text")?.value')
            page.evaluate('{ const field = document.getElementById("board-text"); field.focus(); '
                          f'field.value = {BOARD!r}; field.dispatchEvent(new Event("input")); }}')
            page.press('Enter')
            page.wait_for('document.querySelectorAll("#list li").length >= 8')
            yield page
        finally:
            camera.terminate()
            camera.wait()


@contextmanager
def viewing(*parameters: str, folder: str | None = None) -> Iterator[str]:
    """Start a viewer, in a folder if one is given, and yield the address of its pages."""
    with tempfile.TemporaryFile('w+') as log:
        viewer = subprocess.Popen(['img_viewer', '--ros-args', *(
            word for one in ('port:=0', *parameters) for word in ('-p', one))],
            stderr=log, cwd=folder)
        try:
            found = None
            while not found:
                if viewer.poll() is not None:
                    raise RuntimeError('img_viewer has ended')
                time.sleep(0.2)
                log.seek(0)
                found = re.search(r'Open (\S+) in a browser', log.read())
            yield found[1]
        finally:
            viewer.terminate()
            viewer.wait()


def take(page: Page, publish: Callable[[float], None], file: Path, script: str) -> None:
    """Write a picture of a page that has received topics for some seconds."""
    publish(SECONDS)
    if script:
        page.evaluate(f'{script}; true')
        publish(SECONDS / 2)
    page.evaluate('if (document.title.startsWith("Cameras of")) '
                  'document.getElementById("title").textContent = "Cameras of robot"; true')
    publishing = Thread(target=publish, args=(SECONDS,))  # a picture without new ones is gray
    publishing.start()
    time.sleep(SECONDS / 4)
    page.screenshot(file)
    publishing.join()
    print(f'{file.relative_to(ROOT)}')


def main() -> int:
    """Take all pictures; return the exit status."""
    os.environ.update(ROS_DOMAIN_ID='93', ROS_AUTOMATIC_DISCOVERY_RANGE='LOCALHOST')
    rclpy.init()
    node = rclpy.create_node('robot')
    try:
        with viewing() as url, new_browser() as browser:
            publish = publish_cameras(node)
            for name, path, width, height, script in PICTURES:
                if path == OVERLAYS:  # the last one; the others do not show this topic
                    publish = publish_scene(node)
                publish(SECONDS)  # the topics are known
                page = browser.new_page(url + path, width, height)
                page.prefer('dark' if name == 'viewer_dark.jpg' else 'light')
                take(page, publish, IMAGES / name, script)
                page.close()
            with calibrating(browser) as page:
                page.screenshot(IMAGES / 'calibrate.jpg')
                print('docs/images/calibrate.jpg')
    finally:
        rclpy.shutdown()
    return 0


if __name__ == '__main__':
    sys.exit(main())
