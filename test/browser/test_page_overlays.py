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

"""Boxes, calibrations, grid and cross over pictures, compared with what was published."""

from __future__ import annotations

from collections.abc import Callable
import json
from pathlib import Path
import re
from urllib.parse import parse_qsl

from chromium import Browser, Page
from conftest import spin_until
import cv2
from detections import Detector, filled, LabelledBox
import numpy as np
from pages import Camera, Viewer
import pytest
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from sensor_msgs.msg import CameraInfo
from test_page_layout import check_all, SIZES
from test_page_look import drag, place_of, wheel
from waiting import pause

pytest_plugins = ['pages']

LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
TOPIC, BOXES, INFO = '/front', '/detections', '/camera_info'
WIDTH, HEIGHT = 640, 480
STAMP = 1_700_000_000_123_456_789
#: Boxes in the order of their scores. The image has their pixels in red and in blue.
RED: LabelledBox = (150, 100, 80, 40, 0.0, 'cup', 0.9)
BLUE: LabelledBox = (400, 300, 100, 60, 0.5, 'dog', 0.5)
#: Sides of the drawn boxes on the page.
SIDES = ('[...document.querySelectorAll(".boxes path")].filter((one) => one.checkVisibility())'
         '.map((one) => { const {left, top, right, bottom} = one.getBoundingClientRect();'
         'return [left, top, right, bottom]; })')
LABELS = '[...document.querySelectorAll(".boxes text")].map((one) => one.textContent)'
#: Lines of the grid and the cross, and the first corner of the frame.
GRID = 'document.querySelector(".grid").getAttribute("d")'
FRAME = ('(({left, top}) => [left, top])(document.querySelector(".tile:not([hidden]) .frame")'
         '.getBoundingClientRect())')
# Records the number of each drawn picture with that in the label of its first box.
PAIR = ('window.pairs = []; document.addEventListener("drawn", () => setTimeout(() => {'
        f'const text = {LABELS}[0]; if (text) pairs.push([numberOf({TOPIC!r}), parseInt(text)]);'
        '}, 0), true);')
NOTE = f'(factOf({TOPIC!r}, "overlay") ?? "")'
SEARCH = 'new URL(location).search'
HOSTILE = '<img src=x onerror="window.attacked = true">'


def picture() -> np.ndarray:
    """Return an image with the pixels of both boxes."""
    image = np.zeros((HEIGHT, WIDTH, 3), np.uint8)
    filled(image, RED, (0, 0, 255))
    filled(image, BLUE, (255, 0, 0))
    return image


@pytest.fixture
def detector(camera: Node) -> Detector:
    """Publish an image, and two boxes of the same stamp."""
    Camera(camera, TOPIC, LATCHED).publish_image(picture(), 'bgr8', STAMP)
    found = Detector(camera, BOXES, LATCHED)
    found.publish(STAMP, [BLUE, RED])
    return found


def settle(page: Page) -> None:
    """Wait until the tiles have their size."""
    page.evaluate('new Promise((done) => setTimeout(done, 1200))')


def open_page(viewer: Viewer, browser: Browser, more: str = f'&boxes={BOXES}') -> Page:
    """Open the page of the image with overlays."""
    page = browser.new_page(f'{viewer.url}?topic={TOPIC}{more}')
    page.wait_for(f'factOf({TOPIC!r}, "zoom")')
    settle(page)
    return page


def press(page: Page, selector: str) -> None:
    """Press the left button of the mouse over an element."""
    place = page.evaluate(
        '(({left, top, width, height}) => ({x: left + width / 2, y: top + height / 2}))('
        f'document.querySelector({json.dumps(selector)}).getBoundingClientRect())')
    drag(page, place, place)


def colored(page: Page, folder: Path) -> list[tuple[float, ...]]:
    """Return the sides of the red and the blue field in a screenshot, if they are in view."""
    page.screenshot(folder / 'page.png')
    shot = cv2.imread(str(folder / 'page.png')).astype(int)
    sides = []
    for color in (2, 0):
        others = shot.sum(2) - shot[..., color]
        rows, columns = np.nonzero((shot[..., color] > 200) & (others < 130))
        sides.append((columns.min(), rows.min(), columns.max() + 1, rows.max() + 1)
                     if len(rows) > 50 else (np.nan,) * 4)
    return sides


def check_boxes(page: Page, folder: Path) -> None:
    """Check that the boxes are drawn around their pixels, as a screenshot shows them."""
    page.wait_for(f'{SIDES}.length === 2')
    settle(page)
    left, top, right, bottom = page.evaluate(
        '(({left, top, right, bottom}) => [left, top, right, bottom])('
        'document.querySelector(".tile:not([hidden]) .frame").getBoundingClientRect())')
    sides = np.clip(page.evaluate(SIDES), (left, top, left, top), (right, bottom, right, bottom))
    fields = np.array(colored(page, folder))
    in_view = np.isfinite(fields[:, 0])
    assert in_view.any()
    # The line of a box covers the outer pixels, and JPEG blurs the colours.
    np.testing.assert_allclose(sides[in_view], fields[in_view], atol=6)


def test_boxes_around_their_pixels(
        detector: Detector, viewer: Viewer, browser: Browser, tmp_path: Path) -> None:
    page = open_page(viewer, browser)
    for size in ((1280, 800), (390, 844), (1920, 1080)):
        page.resize(*size)
        settle(page)
        check_boxes(page, tmp_path)
    assert page.evaluate(LABELS) == ['cup 0.90', 'dog 0.50']
    page.wait_for(f'{NOTE} === "2 boxes"')
    assert page.complaints() == []


def test_zoomed_turned_and_flipped_boxes(
        detector: Detector, viewer: Viewer, browser: Browser, tmp_path: Path) -> None:
    page = open_page(viewer, browser)
    middle = place_of(page, 275, 200)
    for _ in range(2):
        wheel(page, middle, -70)
        check_boxes(page, tmp_path)
    drag(page, middle, {'x': middle['x'] + 15, 'y': middle['y'] - 10})
    for key in ('t', 'm', 't', 't'):
        page.press(key)
        check_boxes(page, tmp_path)
        upright = page.evaluate('[...document.querySelectorAll(".boxes text")].every((one) => {'
                                'const {a, b, c, d} = one.getScreenCTM();'
                                'return a > 0 && d > 0 && b === 0 && c === 0; })')
        assert upright
    page.press('0')
    check_boxes(page, tmp_path)
    assert page.complaints() == []


def test_choice_by_pointer_and_keys(
        detector: Detector, viewer: Viewer, browser: Browser, tmp_path: Path) -> None:
    page = open_page(viewer, browser, '')
    assert not page.evaluate('document.getElementById("overlays").checkVisibility()')
    press(page, '[data-look=overlays]')
    page.wait_for('document.querySelector("#overlays select").options.length === 2')
    assert detector.publisher.get_subscription_count() == 0
    page.evaluate('document.querySelector("#overlays select").focus()')
    page.press('ArrowDown')
    check_boxes(page, tmp_path)
    press(page, '#overlays [name=cross]')
    press(page, '#overlays [name=center]')  # it has the focus
    page.press(' ')
    assert 'center' not in dict(parse_qsl(page.evaluate(SEARCH)))
    assert page.evaluate('document.getElementById("state").textContent') == 'Live'
    page.press('h')
    page.wait_for('document.querySelector(".chart").checkVisibility()')
    page.press('h')
    page.evaluate('document.querySelector("#overlays [name=grid]").focus()')
    page.press('2')
    assert dict(parse_qsl(page.evaluate(SEARCH))) == {
        '?topic': TOPIC, 'boxes': BOXES, 'grid': '2', 'cross': 'true'}
    check_all(page)
    drawn = page.evaluate(GRID)
    assert drawn.count('M') == 6
    page.evaluate('document.activeElement.blur()')
    page.press('o')
    page.wait_for('!document.getElementById("overlays").checkVisibility()')
    page.evaluate('document.getElementById("link").click()')  # the address is what it copies
    page.go(page.evaluate('location.href'))
    check_boxes(page, tmp_path)
    assert page.evaluate(GRID).count('M') == 6
    page.press('Escape')
    page.wait_for(f'{SIDES}.length === 0')
    page.wait_for(f'sent.at(-1).overlays === {TOPIC!r} || '
                  'sent.some((one) => one.overlays && !one.boxes)')
    assert page.complaints() == []


def test_grid_and_cross_in_the_picture(
        detector: Detector, viewer: Viewer, browser: Browser) -> None:
    page = open_page(viewer, browser, '&grid=true&cross=true')
    corners = [place_of(page, x, y) for x, y in ((0, 0), (WIDTH, HEIGHT))]
    left, _ = page.evaluate(FRAME)
    sides = page.evaluate('(({left, top, right, bottom}) => [left, top, right, bottom])('
                          'document.querySelector(".grid").getBoundingClientRect())')
    np.testing.assert_allclose(sides, [corners[0]['x'], corners[0]['y'], corners[1]['x'],
                                       corners[1]['y']], atol=0.6)
    numbers = [float(one) for one in re.findall(r'-?[0-9.]+', page.evaluate(GRID))]
    third = place_of(page, WIDTH / 3, 0)
    assert numbers[0] == pytest.approx(third['x'] - left, abs=0.6)
    middle = place_of(page, WIDTH / 2, HEIGHT / 2)
    assert numbers[-3] == pytest.approx(middle['x'] - left, abs=0.6)
    assert page.evaluate(SIDES) == []
    assert detector.publisher.get_subscription_count() == 0


def test_boxes_before_and_after_their_picture(
        viewer: Viewer, browser: Browser, camera: Node) -> None:
    images, detector = Camera(camera, TOPIC), Detector(camera, BOXES)
    page = browser.new_page(f'{viewer.url}?topic={TOPIC}&boxes={BOXES}')
    images.show(page, 0, STAMP)
    page.evaluate(PAIR)
    spin_until(camera, lambda: detector.publisher.get_subscription_count() > 0)
    number = 0
    while page.evaluate('pairs.length') < 10:  # the detector needs the time of three pictures
        number += 1
        images.publish(number, STAMP + number)
        if number > 3:
            detector.publish(STAMP + number - 3, [(50, 50, 20, 20, 0, str(number - 3), 1)])
        pause(0.03)
    pairs = page.evaluate('pairs')
    assert [shown for shown, _ in pairs] == [drawn for _, drawn in pairs]
    detector.publish(STAMP + 9999, [RED])  # before its picture
    pause(0.1)
    images.publish(9999, STAMP + 9999)
    page.wait_for(f'numberOf({TOPIC!r}) === 9999 && {LABELS}.join() === "cup 0.90"')
    page.wait_for(f'{NOTE} === "1 box"')
    images.publish(10_000, STAMP + 10_000)  # no boxes follow
    page.wait_for(f'numberOf({TOPIC!r}) === 10000 && {LABELS}.length === 0')
    page.wait_for(f'{NOTE} === "no message of {BOXES} has the stamp of this picture"')
    assert page.complaints() == []


def test_boxes_without_a_stamp_and_of_another_frame(
        viewer: Viewer, browser: Browser, camera: Node) -> None:
    images, detector = Camera(camera, TOPIC, LATCHED), Detector(camera, BOXES, LATCHED)
    images.publish(5, 0)
    detector.publish(0, [RED])
    page = open_page(viewer, browser)
    page.wait_for(f'{NOTE} === "the messages of {BOXES} have no stamp, which boxes need"')
    images.publish(6, STAMP)
    detector.publish(STAMP, [RED], 'other\n<b>')
    page.wait_for(f'{NOTE} === String.raw`{BOXES} has the frame_id other\\n<b>, but the pictures '
                  'have camera`')
    assert page.evaluate(SIDES) == []
    detector.publish(STAMP, [RED], 'camera')
    page.wait_for(f'{SIDES}.length === 1')


def test_labels_within_the_frame(viewer: Viewer, browser: Browser, camera: Node) -> None:
    Camera(camera, TOPIC, LATCHED).publish_image(picture(), 'bgr8', STAMP)
    Detector(camera, BOXES, LATCHED).publish(STAMP, [
        (WIDTH - 10, 200, 16, 40, 0.0, 'a label at the right border', 0.9),
        (10, 300, 16, 40, 0.0, 'a label at the left border', 0.8)])
    page = open_page(viewer, browser)
    page.wait_for(f'{LABELS}.length === 2')
    for size in SIZES:
        page.resize(*size)
        settle(page)
        assert page.evaluate(
            '(({left, right}) => [...document.querySelectorAll(".boxes text")].every((one) => '
            '{ const box = one.getBoundingClientRect(); '
            'return box.left >= left - 2 && box.right <= right + 2; }))'
            '(document.querySelector(".tile:not([hidden]) .frame").getBoundingClientRect())')


def test_hostile_boxes(viewer: Viewer, browser: Browser, camera: Node) -> None:
    Camera(camera, TOPIC, LATCHED).publish_image(picture(), 'bgr8', STAMP)
    detector = Detector(camera, BOXES, LATCHED)
    nan, infinite = float('nan'), float('inf')
    detector.publish(STAMP, [
        (150, 100, 80, 40, 0, f'{HOSTILE}\x1b[2J\u202e', 0.5), (nan, 1, 2, 3, 0, 'a', 1),
        (1, infinite, 2, 3, 0, 'a', 1), (1, 1, -2, 3, 0, 'a', 1), (1, 1, 2, 0, 0, 'a', 1),
        (1, 1, 2, 3, infinite, 'a', 1), (1e30, 1, 2, 3, 0, 'a', 1), (1, 1, 1e300, 3, 0, 'a', 1),
        (-90_000, 1, 2, 3, 0, 'far', nan), (5, 5, 900_000, 900_000, 1e5, 'large', 0.4)])
    page = open_page(viewer, browser)
    page.wait_for(f'{NOTE} === "3 boxes, 7 left out without a valid place"')
    labels = page.evaluate(LABELS)
    assert labels[0].startswith('<img src=x onerror="window.attacked') and len(labels[0]) <= 45
    assert labels[1:] == ['large 0.40', 'far']
    assert page.evaluate('window.attacked') is None
    assert page.evaluate('document.documentElement.scrollWidth') <= 1280
    rows, columns = np.divmod(np.arange(10_000), 100)
    detector.publish(STAMP, [
        (6.0 * column, 4.0 * row, 5, 3, 0, 'a', row / 100)
        for row, column in zip(rows, columns, strict=True)])
    page.wait_for(f'{LABELS}.length === 500')
    page.wait_for(f'{NOTE} === "500 of 10000 boxes, those with the highest scores"')
    assert {*page.evaluate(LABELS)} == {f'a 0.{row}' for row in range(95, 100)}
    detector.publisher.publish(bytes(9_000_000))
    page.wait_for(f'{NOTE} === "a message of {BOXES} is left out: it has 9000000 bytes: 8388608 '
                  'are the limit"')
    detector.publish(STAMP, [RED])
    page.wait_for(f'{LABELS}.join() === "cup 0.90"')
    assert page.complaints() == []


def test_boxes_of_a_step_back(viewer: Viewer, browser: Browser, camera: Node) -> None:
    images, detector = Camera(camera, TOPIC), Detector(camera, BOXES)
    page = browser.new_page(f'{viewer.url}?topic={TOPIC}&boxes={BOXES}')
    images.wait_for_viewer()
    page.wait_for(f'followed.has({TOPIC!r})')  # from then on, the viewer keeps the frames
    images.show(page, 0, STAMP)
    spin_until(camera, lambda: detector.publisher.get_subscription_count() > 0)
    for number in range(1, 13):  # more than the node keeps for a page
        detector.publish(STAMP + number, [(50, 50, 20, 20, 0, str(number), 1)])
        images.publish(number, STAMP + number)
        page.wait_for(f'{LABELS}.join() === "{number} 1.00"')
    page.evaluate('document.getElementById("pause").click()')
    page.wait_for('sent.some((one) => one.held)')
    page.wait_for(f'{NOTE} === "1 box"')
    for number in range(11, 0, -1):
        page.press(',')
        page.wait_for(f'numberOf({TOPIC!r}) === {number} && {LABELS}.join() === "{number} 1.00"')
    page.press(',')
    page.wait_for(f'numberOf({TOPIC!r}) === 0 && {LABELS}.length === 0')
    assert page.complaints() == []


def test_two_pages_and_the_topic_beside(
        detector: Detector, viewer: Viewer, browser: Browser, camera: Node,
        tmp_path: Path) -> None:
    Camera(camera, '/rear', LATCHED).publish_image(picture(), 'bgr8', STAMP + 1)
    page = open_page(viewer, browser, f'&boxes={BOXES}&beside=/rear')
    other = open_page(viewer, browser)
    for one in (page, other):
        check_boxes(one, tmp_path) if one is other else one.wait_for(f'{SIDES}.length === 2')
    page.wait_for(f'factOf("/rear", "overlay") === "no message of {BOXES} has the stamp of a '
                  'picture"')
    assert detector.publisher.get_subscription_count() == 1
    other.close()
    page.evaluate('document.getElementById("pause").click()')
    page.wait_for('sent.some((one) => one.held)')
    page.press('1')  # a paused page can be zoomed
    page.wait_for(f'{SIDES}.length === 2 && tileOf({TOPIC!r}).querySelector(".zoomed") !== null')
    page.go('about:blank')
    spin_until(camera, lambda: detector.publisher.get_subscription_count() == 0)


def test_principal_point_and_undistorted_view(
        detector: Detector, viewer: Viewer, browser: Browser, camera: Node) -> None:
    publisher = camera.create_publisher(CameraInfo, INFO, LATCHED)
    k = [400.0, 0, 330.5, 0, 410.0, 250.5, 0, 0, 1]
    info = CameraInfo(
        width=WIDTH, height=HEIGHT, distortion_model='plumb_bob', d=[-0.3, 0.1, 0, 0, 0], k=k,
        r=np.eye(3).ravel(), p=[300.0, 0, 320, 0, 0, 300, 240, 0, 0, 0, 1, 0])
    publisher.publish(info)
    page = open_page(viewer, browser, '&center=true')
    drawn = 'document.querySelector(".camera").getAttribute("d")'
    page.wait_for(drawn)
    settle(page)
    left, top = page.evaluate(FRAME)
    numbers = [float(one) for one in re.findall(r'-?[0-9.]+', page.evaluate(drawn))]
    center = place_of(page, 331, 251)  # the first pixel of the image spans 0 to 1
    assert numbers[3] == pytest.approx(center['x'] - left, abs=0.5)
    assert numbers[1] == pytest.approx(center['y'] - top, abs=0.5)
    press(page, '[data-look=overlays]')
    settle(page)
    press(page, '#overlays [name=outline]')
    press(page, '#overlays [name=center]')
    settle(page)
    left, top = page.evaluate(FRAME)
    points = np.array([[float(one) for one in pair.split()] for pair in re.findall(
        r'[ML]([0-9.-]+ [0-9.-]+)', page.wait_for(f'{drawn}.length > 1000 && {drawn}'))])
    corner = cv2.projectPoints(
        np.linalg.inv(np.reshape(info.p, (3, 4))[:, :3]) @ [-0.5, -0.5, 1], np.zeros(3),
        np.zeros(3), np.reshape(k, (3, 3)), np.array([-0.3, 0.1, 0, 0, 0]))[0].ravel() + 0.5
    place = place_of(page, *corner)
    np.testing.assert_allclose(points[0], (place['x'] - left, place['y'] - top), atol=0.6)
    assert len(points) == 257
    check_all(page)
    info.k = np.zeros(9)
    publisher.publish(info)
    page.wait_for(f'{NOTE}.startsWith("the camera_info has no calibration, because its K is '
                  'zero")')
    assert page.evaluate(drawn) == ''
    assert page.complaints() == []


def test_camera_before_the_first_picture(
        viewer: Viewer, browser: Browser, camera: Node) -> None:
    Camera(camera, TOPIC, LATCHED).publish_image(picture(), 'bgr8', STAMP)
    camera.create_publisher(CameraInfo, INFO, LATCHED).publish(CameraInfo(
        width=WIDTH, height=HEIGHT, k=[400.0, 0, 320, 0, 400, 240, 0, 0, 1],
        p=[300.0, 0, 320, 0, 0, 300, 240, 0, 0, 0, 1, 0], r=np.eye(3).ravel()))
    page = browser.new_page(f'{viewer.url}?topic={TOPIC}&center=true&outline=true', script=(
        'const decode = createImageBitmap; const released = new Promise((release) => {'
        '  window.release = release; }); window.createImageBitmap = async (...image) => {'
        '  await released; return decode(...image); };'))
    page.wait_for('sent.some((one) => one.overlays)')
    settle(page)  # the camera arrives meanwhile
    page.evaluate('release()')
    page.wait_for('document.querySelector(".camera").getAttribute("d")?.length > 1000')
    assert page.complaints() == []


def test_topics_that_appear_later(
        start_viewer: Callable[..., Viewer], browser: Browser, camera: Node) -> None:
    viewer = start_viewer()
    Camera(camera, TOPIC, LATCHED).publish_image(picture(), 'bgr8', STAMP)
    page = open_page(viewer, browser, f'&boxes={BOXES}&center=true')
    page.wait_for(f'{NOTE} === "{BOXES} is not a published topic of '
                  f'vision_msgs/msg/Detection2DArray; {INFO} is not a published topic of '
                  'sensor_msgs/msg/CameraInfo"')
    assert page.evaluate('document.querySelector("#overlays select").value') == BOXES
    Detector(camera, BOXES, LATCHED).publish(STAMP, [RED, BLUE])
    page.wait_for(f'{SIDES}.length === 2')
    camera.create_publisher(CameraInfo, INFO, LATCHED).publish(CameraInfo())
    page.wait_for(f'{NOTE}.startsWith("2 boxes; the image has 640x480 pixels")')
    viewer.process.interrupt()
    assert viewer.process.finish() == 0
    page.wait_for('document.getElementById("state").textContent === "Reconnecting"')
    start_viewer(port=viewer.port)
    page.wait_for('document.getElementById("state").textContent === "Live"')
    page.wait_for(f'{SIDES}.length === 2')


def test_layout_with_overlays(
        detector: Detector, viewer: Viewer, browser: Browser) -> None:
    page = open_page(viewer, browser)
    page.press('o')
    page.wait_for(f'{SIDES}.length === 2')
    check_all(page)
