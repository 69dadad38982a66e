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

"""A whole calibration in the page, from the link of a camera to the saved file."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
import itertools
from pathlib import Path
import re
from typing import Any
from urllib.parse import quote

from chromium import Browser, Page
from conftest import NodeProcess, spin_until
import numpy as np
from opencv_tools.calibration.board_pictures import board_pixels
from opencv_tools.calibration.boards import parse_board
from opencv_tools.calibration.detection import BoardFinder, Detection
from opencv_tools.cv_bridge import CvBridge
from pages import Viewer
import pytest
from rclpy.node import Node
from rclpy.qos import qos_profile_sensor_data
from rendered_boards import Camera
from sensor_msgs.msg import CameraInfo, CompressedImage, Image
from shown_boards import bend, BOARD, held_board, known_bend, RATE, write_former
from waiting import pause, wait_until

pytest_plugins = ['pages']

TOKEN = 'a-secret-text'
TOPIC = '/video_frames'
FORMER = 123.0  # focal length
PLACES = 14  # of the board


@pytest.fixture
def truth(start: Callable[..., NodeProcess], tmp_path: Path) -> Camera:
    """Publish pictures of a board, and return their camera."""
    camera = held_board(tmp_path / 'pictures', PLACES)
    start('img_publisher', source=tmp_path / 'pictures', publish_rate=RATE, loop=0,
          rectify='true', camera_info_url=write_former(tmp_path / 'former.yaml', FORMER))
    return camera


@pytest.fixture
def page(truth: Camera, start_viewer: Callable[..., Viewer], browser: Browser) -> Page:
    """Open the page of a calibration by its link."""
    viewer = start_viewer(token=TOKEN, control=True)
    opened = browser.new_page(f'{viewer.url}&topic={TOPIC}')
    opened.wait_for(f'numberOf("{TOPIC}") >= 0')
    opened.wait_for('!document.getElementById("calibrate").hidden')
    opened.go(opened.evaluate('document.getElementById("calibrate").href'))
    opened.wait_for(f'numberOf("{TOPIC}") >= 0')
    return opened


def choose(page: Page, board: str) -> None:
    """Write a board into its field, and press Enter."""
    page.wait_for('document.getElementById("board-text").value !== ""')
    page.evaluate('{ const field = document.getElementById("board-text"); field.focus(); '
                  f'field.value = {board!r}; field.dispatchEvent(new Event("input")); }}')
    page.press('Enter')


def click(page: Page, name: str) -> None:
    """Click a button as soon as it can be used."""
    page.wait_for(f'(() => {{ const button = document.getElementById("{name}"); return !button.'
                  'disabled && !button.hidden && button.offsetParent !== null; })()')
    page.evaluate(f'document.getElementById("{name}").click()')


def text_of(name: str) -> str:
    return f'document.getElementById("{name}").textContent'


def find_bent_board(node: Node, least: float) -> list[Detection]:
    """Return a board with at least some bend in a raw image, and in the rectified one."""
    finder, images, found = BoardFinder(parse_board(BOARD)), ({}, {}), []
    for topic, kept in zip(('video_frames', 'image_rect'), images):
        node.create_subscription(Image, topic, lambda image, kept=kept: kept.update(
            {(image.header.stamp.sec, image.header.stamp.nanosec): image}), 50)

    def find() -> bool:
        for stamp in images[0].keys() & images[1].keys():
            found[:] = [finder.find(CvBridge().imgmsg_to_cv2(kept.pop(stamp))) for kept in images]
            if bend(found[0]) > least and found[1].is_found:
                return True
        return False

    spin_until(node, find)
    return found


COUNT = 'document.querySelectorAll("#list li").length'


def test_margins_of_the_texts_on_a_phone(page: Page) -> None:
    page.resize(390, 844)
    for name in ('hint', 'capture', 'grid', 'panel'):
        edges = f'document.getElementById("{name}").getBoundingClientRect()'
        assert page.evaluate(f'Math.min({edges}.left, innerWidth - {edges}.right)') >= 8, name


def test_whole_calibration(page: Page, truth: Camera, node: Node) -> None:
    page.wait_for(f'{text_of("hint")} === "Choose the board."')
    choose(page, BOARD)
    page.wait_for('Number(document.querySelector(".overlay").dataset.corners) > 20')
    page.wait_for(f'{COUNT} >= 9')
    click(page, 'take')
    page.wait_for('sent.some((message) => message.take)')
    click(page, 'solve')
    page.wait_for(f'{text_of("verdict")}.startsWith("The calibration is ")')
    views = page.evaluate('[...document.querySelectorAll("#list li")].map('
                          '(one) => one.textContent)')
    # The image that was searched when the views were complete may be a view as well.
    later = [view for view in views if ' pixels' not in view]
    assert len(views) - len(later) >= 9 and len(later) <= 1
    assert all('not solved yet' in view for view in later)
    assert page.evaluate('document.querySelectorAll("#heat td").length') == 8 * 4  # cells
    click(page, 'save')
    page.wait_for(f'{text_of("notice")}.startsWith("Saved: /set_camera_info")')
    infos: list[CameraInfo] = []
    node.create_subscription(CameraInfo, 'camera_info', infos.append, qos_profile_sensor_data)
    spin_until(node, lambda: infos and infos[-1].k[0] != FORMER)
    np.testing.assert_allclose(infos[-1].k.reshape(3, 3), truth.k, atol=2.0)
    np.testing.assert_allclose(infos[-1].d[:2], truth.d[:2], atol=0.05)
    known = known_bend(truth, PLACES)
    raw, rectified = find_bent_board(node, known / 2)
    assert bend(rectified) < known / 10 < bend(raw) < known * 1.1
    count = page.evaluate(COUNT)
    page.evaluate('document.querySelector("#list button").click()')
    page.wait_for(f'{COUNT} === {count - 1} && {text_of("verdict")}.includes("solve again")')
    last = page.evaluate('[...document.querySelectorAll("#list button")].at(-1).dataset.number')
    click(page, 'undo')  # of the view that is shown last, whatever was taken meanwhile
    page.wait_for(f'{COUNT} === {count - 2} && sent.some((one) => one.delete === {last})')
    click(page, 'restore')
    page.wait_for(f'{text_of("notice")}.startsWith("The former calibration is back")')
    spin_until(node, lambda: infos[-1].k[0] == FORMER)
    assert page.complaints() == []


# Keeps how far the first column of circles is from its place in the picture below it, which the
# white edge of the board tells, in pixels of the image, for each picture with circles.
MEASURE = """
window.distances = [];
let circles = [];
const { arc, clearRect } = CanvasRenderingContext2D.prototype;
CanvasRenderingContext2D.prototype.clearRect = function (...words) {
  circles = [];
  clearRect.apply(this, words);
};
CanvasRenderingContext2D.prototype.arc = function (x, ...words) {
  circles.push(x / this.canvas.parentElement.clientWidth);
  arc.call(this, x, ...words);
};
const measure = (canvas) => {
  if (!circles.length) return;
  const row = canvas.getContext('2d').getImageData(0, %d, canvas.width, 1).data;
  const left = row.findIndex((value, place) => place %% 4 === 0 && value > 180) / 4;
  distances.push(Math.abs(Math.min(...circles) * canvas.width - left - %d));
};
// After the circles of the picture, which are drawn for the same picture of the screen.
document.addEventListener('drawn', ({ target }) => queueMicrotask(
  () => requestAnimationFrame(() => measure(target))), true);
"""
MOVED_BOARD, MOVED_SCALE, MOVED_EDGE = 'chessboard:7x5:30mm', 1.0, 20
MOVED_SIZE, MOVED_STEP = (640, 360), 8  # pixels


def moved_board(number: int) -> np.ndarray:
    """Return a picture with the board, which moves to the right and back."""
    board = board_pixels(parse_board(MOVED_BOARD), MOVED_SCALE, MOVED_EDGE)
    height, width = board.shape
    room = (MOVED_SIZE[0] - width) // MOVED_STEP
    image = np.full(MOVED_SIZE[::-1], 110, np.uint8)
    left = MOVED_STEP * abs((number + room) % (2 * room) - room)
    image[MOVED_EDGE:MOVED_EDGE + height, left:left + width] = board
    return image


@pytest.mark.parametrize(('kind', 'topic', 'convert'), [
    (Image, TOPIC, lambda image: CvBridge().cv2_to_imgmsg(image, 'mono8')),
    (CompressedImage, f'{TOPIC}/compressed', CvBridge().cv2_to_compressed_imgmsg)])
def test_corners_of_the_picture_that_is_shown(
        start_viewer: Callable[..., Viewer], browser: Browser, node: Node, kind: type, topic: str,
        convert: Callable[[np.ndarray], Any]) -> None:
    publisher, numbers = node.create_publisher(kind, topic, 10), itertools.count()

    def publish() -> None:
        message = convert(moved_board(next(numbers)))
        message.header.stamp = node.get_clock().now().to_msg()
        publisher.publish(message)
        pause(1 / 25)

    viewer = start_viewer(token=TOKEN, control=True)
    page = browser.new_page(f'{viewer.url.replace("?", "calibrate?")}&topic={TOPIC}')
    page.evaluate(MEASURE % (MOVED_EDGE * 3 // 2, MOVED_EDGE + 30))
    choose(page, MOVED_BOARD)
    wait_until(lambda: page.evaluate('distances.length') > 30, 'pictures with corners', publish,
               drawn=lambda: page.evaluate('drawn.length'))
    assert max(page.evaluate('distances')) < 2
    assert page.complaints() == []


def test_page_that_is_opened_before_the_camera_starts(
        start: Callable[..., NodeProcess], start_viewer: Callable[..., Viewer],
        browser: Browser) -> None:
    viewer = start_viewer(token=TOKEN, control=True)
    page = browser.new_page(f'{viewer.url.replace("?", "calibrate?")}&topic={TOPIC}')
    page.wait_for(f'tileOf("{TOPIC}").querySelector(".reason").textContent')
    start('img_publisher', source='pattern:64x48', publish_rate=RATE)
    page.wait_for(f'numberOf("{TOPIC}") >= 0')


def test_no_calibration_of_rectified_pictures(
        truth: Camera, start_viewer: Callable[..., Viewer], browser: Browser) -> None:
    viewer = start_viewer(token=TOKEN, control=True)
    page = browser.new_page(f'{viewer.url}&topic={TOPIC}')
    page.wait_for('!document.getElementById("calibrate").hidden')
    page.wait_for('tileOf("/image_rect") !== undefined')
    page.press('r')  # the button still leads to the raw pictures
    assert page.evaluate('document.getElementById("calibrate").href').endswith(
        f'topic={quote(TOPIC, safe="")}')
    page.press('ArrowRight')
    page.wait_for('document.title.startsWith("/image_rect")')
    assert page.evaluate('document.getElementById("calibrate").hidden')
    assert page.complaints() == []


def test_reloaded_page_continues(page: Page) -> None:
    choose(page, BOARD)
    page.wait_for(f'{COUNT} >= 4')
    click(page, 'solve')  # no more views are taken
    page.wait_for(f'{text_of("verdict")} !== ""')
    count = page.evaluate(COUNT)
    page.go(page.evaluate('location.href'))
    page.wait_for(f'{COUNT} === {count}')
    assert re.fullmatch(rf'views: {count} \(20 are enough\), covered: \d+ % of the image '
                        r'\(80 % is enough\)', page.evaluate(text_of('counts')))
    assert page.evaluate('document.getElementById("board-text").value') == BOARD
    page.evaluate('window.confirm = () => true')
    click(page, 'discard')
    page.wait_for(f'{text_of("notice")} === "All views were removed."')
    assert page.complaints() == []


def test_wrong_board_is_explained(page: Page) -> None:
    choose(page, 'charuco:5')
    page.wait_for(f'{text_of("notice")}.startsWith("The board is ")')
    assert page.evaluate('document.getElementById("views").hidden')
    choose(page, 'charuco:5x4:40mm:30mm:4x4_50')
    page.wait_for(f'{text_of("hint")}.startsWith("Markers up to ")')
    assert page.complaints() == []


@pytest.mark.parametrize(('width', 'height'), [(1280, 800), (390, 844), (844, 390)])
def test_layout(page: Page, width: int, height: int) -> None:
    choose(page, BOARD)
    page.wait_for(f'{COUNT} >= 4')
    click(page, 'solve')
    page.wait_for(f'{text_of("verdict")} !== ""')
    page.resize(width, height)
    for scheme in ('light', 'dark'):
        page.prefer(scheme)
        assert page.evaluate('document.documentElement.scrollWidth') <= width
        outside = page.evaluate(
            '[...document.querySelectorAll("button, a.button, input, select, td")].filter('
            '(one) => { const box = one.getBoundingClientRect(); return box.width && '
            '(box.left < 0 || box.right > innerWidth); }).map((one) => one.id || one.textContent)')
        assert outside == []
    assert page.evaluate('[...document.querySelectorAll("button, a[href], input, select")].every('
                         '(one) => one.textContent.trim() || one.labels?.length '
                         '|| one.getAttribute("aria-label"))')
    assert page.complaints() == []


@pytest.mark.parametrize('stamped', [True, False])
def test_corners_go_with_the_board(
        start_viewer: Callable[..., Viewer], browser: Browser, node: Node, stamped: bool) -> None:
    publisher = node.create_publisher(Image, TOPIC, 10)
    blank = np.full(MOVED_SIZE[::-1], 110, np.uint8)

    def publish(image: np.ndarray) -> None:
        message = CvBridge().cv2_to_imgmsg(image, 'mono8')
        if stamped:
            message.header.stamp = node.get_clock().now().to_msg()
        publisher.publish(message)
        pause(1 / 25)

    viewer = start_viewer(token=TOKEN, control=True)
    page = browser.new_page(f'{viewer.url.replace("?", "calibrate?")}&topic={TOPIC}')
    choose(page, MOVED_BOARD)
    corners = 'Number(document.querySelector("[data-corners]")?.dataset.corners ?? 0)'
    for image, count in ((moved_board(3), 35), (blank, 0), (moved_board(9), 35)):
        wait_until(lambda: page.evaluate(corners) == count,  # noqa: B023
                   f'{count} corners', partial(publish, image),
                   drawn=lambda: page.evaluate('drawn.length'))
    assert page.complaints() == []
