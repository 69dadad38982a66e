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
"""Look into a picture: values of pixels, zoom, lines, histograms; by pointer, wheel and keys."""

from __future__ import annotations

from collections.abc import Callable
import json

from chromium import Browser, Page
from conftest import spin_until
import cv2
from images import oriented_jpeg, UPRIGHT
import numpy as np
from pages import Camera, STRIPE, Viewer
import pytest
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from sensor_msgs.msg import CompressedImage
from test_page_layout import check_all
from test_page_video import VideoCamera
from waiting import wait_until

pytest_plugins = ['pages']

LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
TOPIC = '/front'
VALUE = f'tileOf({TOPIC!r}).querySelector(".pixel").textContent'
#: Part of the image that the page has asked for last.
REGION = 'JSON.stringify(sent.filter((one) => one.subscribe).at(-1).region ?? null)'
#: Whether the part of the image fills the frame, to half a pixel of the page.
COVERS = ('(([one, frame]) => one.left < frame.left + 0.5 && one.top < frame.top + 0.5 && '
          'one.right > frame.right - 0.5 && one.bottom > frame.bottom - 0.5)(["canvas", ".frame"]'
          f'.map((one) => tileOf({TOPIC!r}).querySelector(one).getBoundingClientRect()))')
CHART = f'tileOf({TOPIC!r}).querySelector(".chart .hint").textContent'
_RANDOM = np.random.default_rng(36)


def random_image(width: int = 640, height: int = 480) -> np.ndarray:
    return _RANDOM.integers(0, 256, (height, width, 3), np.uint8)


def open_image(viewer: Viewer, browser: Browser, camera: Node, image: np.ndarray,
               encoding: str = 'bgr8') -> Page:
    """Publish an image, and show it alone."""
    Camera(camera, TOPIC, LATCHED).publish_image(image, encoding)
    page = browser.new_page(f'{viewer.url}?topic={TOPIC}')
    page.wait_for(f'factOf({TOPIC!r}, "zoom")')
    page.evaluate('new Promise((done) => setTimeout(done, 1200))')  # the tiles have their size
    return page


def place_of(
        page: Page, x: float, y: float, size: tuple[int, int] = (640, 480)) -> dict[str, float]:
    """Return the place on the page of a pixel of the image that fits its frame."""
    left, top, width, height = page.evaluate(
        f'(({{left, top, width, height}}) => [left, top, width, height])('
        f'tileOf({TOPIC!r}).querySelector(".frame").getBoundingClientRect())')
    scale = min(width / size[0], height / size[1])
    return {'x': left + width / 2 + (x - size[0] / 2) * scale,
            'y': top + height / 2 + (y - size[1] / 2) * scale}


def move(page: Page, place: dict[str, float], **more: object) -> None:
    """Move the mouse."""
    page.call('Input.dispatchMouseEvent', type='mouseMoved', **place, **more)


def drag(page: Page, begin: dict[str, float], end: dict[str, float], **more: object) -> None:
    """Drag with the left button of the mouse."""
    for kind, place in (('mousePressed', begin), ('mouseMoved', end), ('mouseReleased', end)):
        page.call('Input.dispatchMouseEvent', type=kind, button='left', clickCount=1,
                  buttons=int(kind != 'mouseReleased'), **place, **more)


def wheel(page: Page, place: dict[str, float], pixels: float) -> None:
    """Turn the wheel of the mouse."""
    page.call('Input.dispatchMouseEvent', type='mouseWheel', deltaX=0, deltaY=pixels, **place)


@pytest.mark.parametrize('encoding', ['bgr8', 'rgb8'])
def test_value_under_the_cursor(
        encoding: str, viewer: Viewer, browser: Browser, camera: Node) -> None:
    image = random_image()
    page = open_image(viewer, browser, camera, image, encoding)
    for x, y in ((0, 0), (639, 479), (17, 400), (320, 240)):
        move(page, place_of(page, x + 0.5, y + 0.5))
        text = ', '.join(f'{name.upper()} {value}'
                         for name, value in zip(encoding[:3], image[y, x], strict=True))
        page.wait_for(f'{VALUE} === "{x}, {y}: {text}"')
    move(page, {'x': 5, 'y': 5})
    page.wait_for(f'{VALUE} === ""')
    assert page.complaints() == []


def test_value_of_a_pixel_that_the_cursor_has_left(
        viewer: Viewer, browser: Browser, camera: Node) -> None:
    image = random_image()
    page = open_image(viewer, browser, camera, image)
    page.evaluate('{ const { onmessage } = sockets[0]; sockets[0].onmessage = (event) => { '
                  'if (event.data instanceof ArrayBuffer || !JSON.parse(event.data).pixel) '
                  'onmessage(event); else window.answer = () => { '
                  'sockets[0].onmessage = onmessage; onmessage(event); }; }; }')
    move(page, place_of(page, 17.5, 400.5))
    page.wait_for('Boolean(window.answer)')
    move(page, place_of(page, 300.5, 100.5))
    texts = [f'{x}, {y}: ' + ', '.join(f'{name} {value}' for name, value in zip(
        'BGR', image[y, x], strict=True)) for x, y in ((17, 400), (300, 100))]
    assert page.evaluate(f'(answer(), {VALUE})') == texts[0]
    page.wait_for(f'{VALUE} === {texts[1]!r}')


def press_with_shift(page: Page, key: str, **more: object) -> None:
    """Press an arrow with Shift."""
    for kind in ('keyDown', 'keyUp'):
        page.call('Input.dispatchKeyEvent', type=kind, key=key, modifiers=8, **more)


def test_reading_by_keys(viewer: Viewer, browser: Browser, camera: Node) -> None:
    image = random_image()
    page = open_image(viewer, browser, camera, image)

    def wait_for_value(x: int, y: int) -> None:
        text = ', '.join(f'{name} {value}' for name, value in zip('BGR', image[y, x], strict=True))
        page.wait_for(f'{VALUE} === "{x}, {y}: {text}"')

    press_with_shift(page, 'ArrowRight')
    wait_for_value(321, 240)
    press_with_shift(page, 'ArrowUp')
    press_with_shift(page, 'ArrowLeft', autoRepeat=True)
    wait_for_value(311, 239)
    for _ in range(4):
        page.press('+')
    for _ in range(40):
        press_with_shift(page, 'ArrowLeft', autoRepeat=True)
    press_with_shift(page, 'ArrowDown')
    wait_for_value(0, 240)
    page.wait_for_paint()
    inside = ('(({ left, right }, frame) => left >= frame.left - 9 && right < frame.right)('
              f'tileOf({TOPIC!r}).querySelector(".line").getBoundingClientRect(), '
              f'tileOf({TOPIC!r}).querySelector(".frame").getBoundingClientRect())')
    assert page.evaluate(inside)  # the cross, whose arm may be cut
    page.press('0')
    page.press('t')
    press_with_shift(page, 'ArrowRight')  # up in the image
    wait_for_value(0, 239)
    page.press('m')
    press_with_shift(page, 'ArrowDown')
    wait_for_value(1, 239)
    assert page.complaints() == []


def test_line_by_keys(viewer: Viewer, browser: Browser, camera: Node) -> None:
    page = open_image(viewer, browser, camera, random_image())
    line = f'tileOf({TOPIC!r}).querySelector(".line").getAttribute("d")'
    press_with_shift(page, 'ArrowDown')
    page.press('Enter')
    press_with_shift(page, 'ArrowDown')
    assert 'L' not in page.evaluate(line)  # there is no chart
    page.press('l')
    page.press('Enter')
    for _ in range(3):
        press_with_shift(page, 'ArrowRight', autoRepeat=True)
    page.press('Enter')
    press_with_shift(page, 'ArrowUp')
    assert page.evaluate(line).endswith('M320.5 242.5L350.5 242.5')
    page.wait_for(f'tileOf({TOPIC!r}).querySelectorAll(".chart path").length === 3')
    assert page.complaints() == []


def test_value_of_depth(viewer: Viewer, browser: Browser, camera: Node) -> None:
    depth = np.full((480, 640), 1234, np.uint16)
    depth[:, :320] = 0
    page = open_image(viewer, browser, camera, depth, '16UC1')
    move(page, place_of(page, 600.5, 7.5))
    page.wait_for(f'{VALUE} === "600, 7: 1234 (1.234 m)"')
    move(page, place_of(page, 6.5, 7.5))
    page.wait_for(f'{VALUE} === "6, 7: 0 (no depth)"')


def test_value_of_a_jpeg_and_of_the_displayed_frame(
        viewer: Viewer, browser: Browser, camera: Node) -> None:
    publisher = camera.create_publisher(CompressedImage, f'{TOPIC}/compressed', LATCHED)

    def publish(level: int) -> None:
        content = cv2.imencode('.jpg', np.full((480, 640, 3), level, np.uint8))[1]
        publisher.publish(CompressedImage(format='jpeg', data=content.tobytes()))

    publish(50)
    page = browser.new_page(f'{viewer.url}?topic={TOPIC}')
    page.wait_for(f'factOf({TOPIC!r}, "zoom")')
    page.evaluate('new Promise((done) => setTimeout(done, 1200))')
    move(page, place_of(page, 9.5, 9.5))
    page.wait_for(f'{VALUE} === "9, 9: B 50, G 50, R 50 of the JPEG"')
    page.press(' ')
    page.wait_for('sent.some((message) => message.held)')
    publish(200)
    move(page, place_of(page, 19.5, 9.5))
    page.wait_for(f'{VALUE} === "19, 9: B 50, G 50, R 50 of the JPEG"')
    page.press(' ')
    page.wait_for(f'{VALUE} === "19, 9: B 200, G 200, R 200 of the JPEG"')


@pytest.mark.parametrize(('stamp_ns', 'text'), [
    (1_700_000_000_123_456_789, '1700000000.123456789 (2023-11-1'), (7, '0.000000007'),
    (12 * 10**9, '12.000000000')])
def test_origin_of_a_picture(
        viewer: Viewer, browser: Browser, camera: Node, stamp_ns: int, text: str) -> None:
    Camera(camera, TOPIC, LATCHED).publish_image(random_image(64, 48), 'bgr8', stamp_ns)
    page = browser.new_page(f'{viewer.url}?topic={TOPIC}')
    shown = page.wait_for(f'factOf({TOPIC!r}, "stamp")')
    assert shown.startswith(text) and ('.123)' in shown) == ('(' in text)
    frame = page.evaluate(f'factOf({TOPIC!r}, "frame")')
    assert 'frame_id camera' in frame
    page.press('y')
    page.wait_for('document.getElementById("notice").textContent === '
                  f'"Copied {TOPIC}, {shown}, {frame}"')
    assert page.complaints() == []


def test_places_of_extremes_and_over_exposed_pixels(
        viewer: Viewer, browser: Browser, camera: Node) -> None:
    image = np.full((480, 640, 3), 90, np.uint8)
    image[123, 456], image[400, 30] = (90, 255, 90), (90, 90, 4)
    page = open_image(viewer, browser, camera, image)
    page.press('h')
    buttons = f'[...tileOf({TOPIC!r}).querySelectorAll(".chart button")]'
    page.wait_for(f'{buttons}.map((one) => one.textContent).join() === '
                  '"smallest 4 at 30, 400,largest 255 at 456, 123"')
    page.evaluate(f'{buttons}[1].click()')
    page.wait_for(f'{VALUE} === "456, 123: B 90, G 255, R 90"')
    page.evaluate('sent.length = 0')
    page.press('x')
    marks = f'tileOf({TOPIC!r}).querySelector(".exposed")'
    page.wait_for(f'!{marks}.hidden && {marks}.width === 320')
    assert page.evaluate(
        f'[...{marks}.getContext("2d").getImageData(0, 0, 320, 240).data].map((one, place) => '
        'one && place % 4 === 3 ? (place - 3) / 4 : -1).filter((one) => one >= 0)'
    ) == [61 * 320 + 228]
    left, top = page.evaluate(
        f'((one, box, frame) => [box.left, box.top])({marks}, {marks}.getBoundingClientRect())')
    shown = place_of(page, 0, 0, (640, 480))
    assert abs(left - shown['x']) < 2 and abs(top - shown['y']) < 2
    page.press('x')
    page.wait_for(f'{marks}.hidden')
    assert page.complaints() == []


def test_zoom_by_wheel_and_pan(viewer: Viewer, browser: Browser, camera: Node) -> None:
    image = random_image(3840, 2160)
    page = open_image(viewer, browser, camera, image)
    size = 3840, 2160
    assert page.evaluate(REGION) == 'null'
    middle = place_of(page, 1000.5, 700.5, size)
    move(page, middle)
    page.wait_for(f'{VALUE}.startsWith("1000, 700: ")')
    for _ in range(20):
        wheel(page, middle, -120)
    expected = ', '.join(f'{name} {value}' for name, value in zip(
        'BGR', image[700, 1000], strict=True))
    page.wait_for(f'{VALUE} === "1000, 700: {expected}"')  # the cursor keeps its pixel
    region = json.loads(page.wait_for(f'{REGION} !== "null" && {REGION}'))
    assert region[0] <= 1000 < region[0] + region[2] and region[2] < 3840 / 8
    page.wait_for(f'tileOf({TOPIC!r}).querySelector("canvas").width <= {region[2] + 2}')
    # The picture has the pixels of the image.
    canvas = f'tileOf({TOPIC!r}).querySelector("canvas")'
    shown = page.wait_for(f'{canvas}.width < 400 && [{canvas}.width, {canvas}.height]')
    assert shown[0] >= region[2]
    assert page.evaluate('getComputedStyle(document.querySelector(".enlarged")).imageRendering'
                         ) == 'pixelated'
    drag(page, middle, {'x': middle['x'] - 100, 'y': middle['y']})
    page.wait_for(f'JSON.parse({REGION})[0] > {region[0]}')
    page.press('0')
    page.wait_for(f'{REGION} === "null" && {canvas}.style.width === "3840px"')
    page.evaluate('for (let press = 0; press < 12; press += 1) '
                  'document.querySelector("[data-look=in]").click()')
    page.wait_for(f'{canvas}.style.width !== "3840px"')
    assert page.evaluate(COVERS)
    assert page.complaints() == []


def test_keys_and_buttons_of_the_zoom(viewer: Viewer, browser: Browser, camera: Node) -> None:
    page = open_image(viewer, browser, camera, random_image(3840, 2160))
    zoom = f'factOf({TOPIC!r}, "zoom")'
    whole = page.evaluate(zoom)
    page.press('1')
    page.wait_for(f'{zoom} === "100 %"')
    assert json.loads(page.wait_for(f'{REGION} !== "null" && {REGION}'))[2] < 1280
    page.press('+')
    page.wait_for(f'{zoom} === "150 %"')
    page.press('-')
    page.wait_for(f'{zoom} === "100 %"')
    page.evaluate('document.querySelector("[data-look=fit]").click()')
    page.wait_for(f'{zoom} === {whole!r}')
    page.evaluate('document.querySelector("[data-look=in]").click()')
    page.wait_for(f'{zoom} !== {whole!r}')


def test_pinch(viewer: Viewer, browser: Browser, camera: Node) -> None:
    page = open_image(viewer, browser, camera, random_image())
    page.resize(390, 844)
    page.call('Emulation.setTouchEmulationEnabled', enabled=True, maxTouchPoints=2)
    page.evaluate('new Promise((done) => setTimeout(done, 1200))')
    middle = place_of(page, 320, 240)

    def touch(kind: str, *distances: float) -> None:
        page.call('Input.dispatchTouchEvent', type=kind, touchPoints=[
            {'x': middle['x'] + distance, 'y': middle['y'], 'id': number}
            for number, distance in enumerate(distances)])

    touch('touchStart', -30, 30)
    for distance in range(35, 121, 5):
        touch('touchMove', -distance, distance)
    touch('touchEnd')
    region = json.loads(page.wait_for(f'{REGION} !== "null" && {REGION}'))
    assert region[2] == pytest.approx(160, abs=40)
    assert region[0] + region[2] / 2 == pytest.approx(320, abs=20)


def test_line_and_histogram(viewer: Viewer, browser: Browser, camera: Node) -> None:
    image = np.zeros((480, 640), np.uint8)
    image[:, 320:] = 255
    page = open_image(viewer, browser, camera, image, 'mono8')
    assert not page.evaluate('document.getElementById("range").checkVisibility()')
    page.press('h')
    page.wait_for(f'{CHART} === "0 to 255, 50 % over-exposed, 50 % black"')
    page.press('l')
    page.wait_for(f'{CHART} === "Draw a line in the picture."')
    page.evaluate('new Promise((done) => setTimeout(done, 1200))')  # the panel has its place
    drag(page, place_of(page, 310.5, 100.5), place_of(page, 330.5, 100.5))
    page.wait_for(f'{CHART} === "0 to 255"')
    points = page.evaluate('document.querySelector(".chart path").getAttribute("d")').split('L')
    assert len(points) == 21
    assert [point.endswith(' 100') for point in points] == [True] * 10 + [False] * 11
    assert page.evaluate('document.querySelector(".line").getAttribute("d")') == (
        'M310.5 100.5L330.5 100.5')
    check_all(page)
    page.press('l')
    page.wait_for('document.querySelector(".chart").offsetWidth === 0')


def test_line_from_beside_the_picture_selects_no_text(
        viewer: Viewer, browser: Browser, camera: Node) -> None:
    page = open_image(viewer, browser, camera, random_image())
    picture = place_of(page, 310.5, 100.5)
    left, top, right, bottom = page.evaluate(
        '(({left, top, right, bottom}) => [left, top, right, bottom])('
        'document.querySelector(".facts").getBoundingClientRect())')
    for begin in (place_of(page, -3, 100), place_of(page, 320, 490)):
        for end in (picture, {'x': right - 2, 'y': bottom - 2}):
            drag(page, begin, end)
            assert page.evaluate('getSelection().toString()') == ''
    drag(page, {'x': left + 2, 'y': top + 2}, {'x': right - 2, 'y': bottom - 2})
    assert 'bgr8' in page.evaluate('getSelection().toString()')  # facts can be copied


def test_space_after_a_button(viewer: Viewer, browser: Browser, camera: Node) -> None:
    page = open_image(viewer, browser, camera, np.full((480, 640, 3), 255, np.uint8))
    button = f'tileOf({TOPIC!r}).querySelector("[data-look=exposed]")'
    page.evaluate('new Promise((done) => setTimeout(done, 1200))')  # the panel has its place
    left, top = page.evaluate(f'(({{x, y}}) => [x + 9, y + 9])({button}.getBoundingClientRect())')
    drag(page, *[{'x': left, 'y': top}] * 2)  # a click
    for is_paused in ('true', 'false'):  # the keys belong to the page
        page.wait_for(f'{button}.ariaPressed === "true"')
        page.press(' ')
        page.wait_for(f'document.getElementById("pause").ariaPressed === "{is_paused}"')
        assert page.evaluate(f'{button}.ariaPressed') == 'true'
    page.press('Tab')
    page.evaluate(f'{button}.focus()')  # as Tab does
    page.press(' ')
    page.wait_for(f'{button}.ariaPressed === "false"')
    assert page.evaluate('document.getElementById("pause").ariaPressed') == 'false'


def test_units_of_charts(viewer: Viewer, browser: Browser, camera: Node) -> None:
    image = np.full((480, 640), 1816, np.uint16)
    image[:, 320:], image[3, 5] = 2779, 1038
    page = open_image(viewer, browser, camera, image, '16UC1')
    page.press('h')
    page.wait_for(f'{CHART} === "1038 (1.038 m) to 2779 (2.779 m)"')
    page.wait_for(f'tileOf({TOPIC!r}).querySelector(".chart button").textContent === '
                  '"smallest 1038 (1.038 m) at 5, 3"')
    page.press('l')
    page.evaluate('new Promise((done) => setTimeout(done, 1200))')  # the panel has its place
    drag(page, place_of(page, 310.5, 100.5), place_of(page, 330.5, 100.5))
    page.wait_for(f'{CHART} === "1816 (1.816 m) to 2779 (2.779 m)"')


def test_values_of_decoded_video(viewer: Viewer, browser: Browser, camera: Node) -> None:
    video = VideoCamera(camera, TOPIC)
    page = browser.new_page(f'{viewer.url}?topic={TOPIC}')
    video.show(page, 0)
    page.wait_for(f'factOf({TOPIC!r}, "zoom")')
    page.evaluate('new Promise((done) => setTimeout(done, 1200))')
    move(page, place_of(page, 40.5, 220.5, (320, 240)))
    text = page.wait_for(f'{VALUE}.endsWith("of the decoded video") && {VALUE}')
    red, green, blue = (int(one.split()[1].rstrip(',')) for one in (
        text.removeprefix('40, 220: ').split(', ')))
    assert np.abs(np.array([blue, green, red]) - STRIPE[0]).max() < 24
    page.press('h')
    page.press('l')
    for way in ('histogram', 'profile'):
        button = f'tileOf({TOPIC!r}).querySelector("[data-look={way}]")'
        assert page.evaluate(f'{button}.disabled && {button}.title').endswith(
            'Pause the page, or add quality=90 to its address to get images.')
    assert not page.evaluate('document.getElementById("range").checkVisibility()')
    page.press(' ')
    page.wait_for('sent.some((one) => "busy" in one)')  # the picture is one of the node
    move(page, place_of(page, 120.5, 220.5, (320, 240)))
    page.wait_for(
        f'/^120, 220: B [0-9]+, G 2[0-9]+, R [0-9]+ of the decoded video$/.test({VALUE})')
    page.press('h')
    page.wait_for(f'{CHART}.startsWith("0 to 255")')
    page.press(' ')
    video.show(page, 3)
    page.wait_for(f'tileOf({TOPIC!r}).querySelector("[data-look=histogram]").disabled')
    assert not page.evaluate(f'tileOf({TOPIC!r}).querySelector(".chart").checkVisibility()')
    page.press('1')
    page.press('+')
    assert page.evaluate('sent.filter((one) => one.region).length') == 0
    video.show(page, 1)
    page.go(f'{viewer.url}?topic={TOPIC}&quality=90')  # as it says
    video.show(page, 2)
    page.press('h')
    page.wait_for(f'{CHART}.startsWith("0 to 255")')
    assert page.complaints() == []


class BothCamera:
    """A camera whose video is beside its images, which have other colours."""

    def __init__(self, node: Node) -> None:
        self.images, self.video = Camera(node, TOPIC), VideoCamera(node, TOPIC)
        self._node = node

    def show(self, page: Page, condition: str) -> None:
        """Publish both again and again, until a condition holds."""
        def is_shown() -> bool:
            self.video.publish(5)
            self.images.publish_image(np.full((240, 320, 3), (7, 8, 9), np.uint8), 'bgr8')
            return bool(page.evaluate(condition))

        spin_until(self._node, is_shown)


def open_both(viewer: Viewer, browser: Browser, camera: BothCamera) -> Page:
    """Show a topic with images and video alone, which comes as video, with the cursor in it."""
    page = browser.new_page(f'{viewer.url}?topic={TOPIC}')
    camera.show(page, f'numberOf({TOPIC!r}) === 5 && factOf({TOPIC!r}, "encoding") === "h264"')
    page.evaluate('new Promise((done) => setTimeout(done, 1200))')
    move(page, place_of(page, 40.5, 220.5, (320, 240)))
    page.wait_for(f'{VALUE}.endsWith("of the decoded video")')
    return page


@pytest.mark.parametrize('way', ['histogram', 'zoom'])
def test_values_of_images_beside_video(
        way: str, viewer: Viewer, browser: Browser, camera: Node) -> None:
    both = BothCamera(camera)
    page = open_both(viewer, browser, both)
    if way == 'histogram':
        page.press('h')
        both.show(page, f'{CHART} === "0 to 255"')
        page.press('h')
        page.evaluate('new Promise((done) => setTimeout(done, 1200))')  # the panel is gone
        move(page, place_of(page, 40.5, 220.5, (320, 240)))
    else:
        wheel(page, place_of(page, 40.5, 220.5, (320, 240)), -300)
    both.show(page, f'{VALUE} === "40, 220: B 7, G 8, R 9"')
    page.press('0')
    both.show(page, f'{VALUE} === "40, 220: B 7, G 8, R 9"')  # still the images
    assert 'video' not in page.evaluate('sent.filter((one) => one.subscribe).at(-1)')
    page.press('Escape')
    both.show(page, f'numberOf({TOPIC!r}) === 5')  # video again
    assert page.complaints() == []


def test_video_that_is_paused_is_looked_into(
        viewer: Viewer, browser: Browser, camera: Node) -> None:
    both = BothCamera(camera)
    page = open_both(viewer, browser, both)
    page.press(' ')
    page.wait_for('sent.some((one) => "busy" in one)')  # the picture is one of the node
    page.wait_for(f'{VALUE}.endsWith(" of the decoded video")')
    assert page.evaluate(f'numberOf({TOPIC!r})') == 5
    page.press(',')
    page.wait_for(f'tileOf({TOPIC!r}).querySelector("output.step").textContent !== ""')
    page.press('h')
    page.wait_for(f'{CHART}.startsWith("0 to 255")')  # the images come once it is live
    page.press(' ')
    page.press('h')
    page.evaluate('new Promise((done) => setTimeout(done, 1200))')  # the chart is gone
    move(page, place_of(page, 40.5, 220.5, (320, 240)))
    both.show(page, f'{VALUE} === "40, 220: B 7, G 8, R 9"')
    assert 'video' not in page.evaluate('sent.filter((one) => one.subscribe).at(-1)')
    assert page.complaints() == []


def test_value_after_the_view_has_changed(
        viewer: Viewer, browser: Browser, camera: Node) -> None:
    image = random_image()
    page = open_image(viewer, browser, camera, image)

    def check(x: float, y: float) -> None:
        column, row = int(x), int(y)
        text = ', '.join(f'{name} {value}' for name, value in zip(
            'BGR', image[row, column], strict=True))
        page.wait_for(f'{VALUE} === "{column}, {row}: {text}"')

    place = place_of(page, 80.5, 440.5)
    move(page, place)
    check(80, 440)
    page.press('+')
    check(320 + (80.5 - 320) / 1.5, 240 + (440.5 - 240) / 1.5)
    page.evaluate('document.querySelector("[data-look=in]").click()')
    check(320 + (80.5 - 320) / 2.25, 240 + (440.5 - 240) / 2.25)
    page.press('0')
    check(80, 440)
    page.press('m')  # flipped from left to right
    check(639 - 80, 440)


def test_line_of_a_touch_that_is_cancelled(
        viewer: Viewer, browser: Browser, camera: Node) -> None:
    page = open_image(viewer, browser, camera, random_image())
    page.call('Emulation.setTouchEmulationEnabled', enabled=True, maxTouchPoints=1)
    page.press('l')
    page.evaluate('new Promise((done) => setTimeout(done, 1200))')  # the panel has its place
    drawn = 'document.querySelector(".line").getAttribute("d")'
    for kind, points in (('touchStart', [(100.5, 100.5)]), ('touchMove', [(200.5, 100.5)]),
                         ('touchCancel', [])):
        page.call('Input.dispatchTouchEvent', type=kind, touchPoints=[
            place_of(page, *point) for point in points])
    page.wait_for(f'{drawn} === "M100.5 100.5L200.5 100.5"')
    page.call('Emulation.setTouchEmulationEnabled', enabled=False)
    wait_until(lambda: move(page, place_of(page, 300.5, 300.5))  # the picture may get another size
               or page.evaluate(f'{VALUE}.startsWith("300, 300: ")'))
    assert page.evaluate(drawn) == 'M100.5 100.5L200.5 100.5'


def test_values_of_a_jpeg_that_is_turned(viewer: Viewer, browser: Browser, camera: Node) -> None:
    shown = np.zeros((640, 480, 3), np.uint8)
    shown[:100, 400:] = 255
    content = oriented_jpeg(np.ascontiguousarray(UPRIGHT[8](shown)), 6)
    camera.create_publisher(CompressedImage, f'{TOPIC}/compressed', LATCHED).publish(
        CompressedImage(format='jpeg', data=content))
    for more in ('', '&width=120'):  # unchanged, and scaled by the node
        page = browser.new_page(f'{viewer.url}?topic={TOPIC}{more}')
        page.wait_for(f'factOf({TOPIC!r}, "size") === "480 \u00d7 640"')
        page.wait_for(f'factOf({TOPIC!r}, "shown").includes("unchanged")'
                      f' === {json.dumps(not more)}')
        page.evaluate('new Promise((done) => setTimeout(done, 1200))')
        for (x, y), level in (((410, 60), 255), ((390, 60), 0), ((410, 120), 0)):
            move(page, place_of(page, x + 0.5, y + 0.5, (480, 640)))
            page.wait_for(f'{VALUE} === "{x}, {y}: B {level}, G {level}, R {level} '
                          'of the JPEG"')
            color = page.evaluate(f'pixel(tileOf({TOPIC!r}).querySelector("canvas"), '
                                  f'{(x + 0.5) / 480}, {(y + 0.5) / 640})')
            assert np.abs(np.array(color) - level).max() < 24
        page.close()


def test_cursor_and_region_of_a_closed_connection(
        start_viewer: Callable[..., Viewer], browser: Browser, camera: Node) -> None:
    viewer = start_viewer()
    page = open_image(viewer, browser, camera, random_image())
    page.press('1')
    page.press('+')
    move(page, place_of(page, 320, 240))
    page.wait_for(f'{VALUE} !== ""')
    viewer.process.interrupt()
    assert viewer.process.finish() == 0
    page.wait_for('document.getElementById("state").textContent === "Reconnecting"')
    start_viewer(port=viewer.port)
    page.wait_for('document.getElementById("state").textContent === "Live"')
    page.evaluate('sent.length = 0')
    move(page, place_of(page, 322, 242))
    page.wait_for('sent.some((one) => one.pixel)')
    page.wait_for(f'/^[0-9]+, [0-9]+: B [0-9]+/.test({VALUE})')


def chart_of(topic: str) -> str:
    """Return the JavaScript of the chart of a topic; '' if it is not seen."""
    return (f'(({{ offsetHeight, innerText }}) => offsetHeight ? innerText.trim() : "")('
            f'tileOf({topic!r}).querySelector(".chart .hint"))')


def test_charts_of_two_topics(viewer: Viewer, browser: Browser, camera: Node) -> None:
    for topic, level in ((TOPIC, 0), ('/rear', 255)):
        Camera(camera, topic, LATCHED).publish_image(
            np.full((480, 640), level, np.uint8), 'mono8')
    page = browser.new_page(f'{viewer.url}?topic={TOPIC}&beside=/rear')
    page.wait_for(f'factOf({TOPIC!r}, "zoom") && factOf("/rear", "zoom")')
    page.evaluate('tileOf("/rear").querySelector("[data-look=histogram]").click()')
    page.wait_for(f'{chart_of("/rear")} === "0 to 255, 100 % over-exposed"')
    assert page.evaluate(chart_of(TOPIC)) == ''
    page.press('h')
    page.wait_for(f'{chart_of(TOPIC)} === "0 to 255, 100 % black"')
    page.wait_for(f'{chart_of("/rear")} === "0 to 255, 100 % over-exposed"')
    check_all(page)
    page.press('h')
    page.wait_for(f'{chart_of(TOPIC)} === ""')
    page.wait_for(f'{chart_of("/rear")} === "0 to 255, 100 % over-exposed"')


def test_questions_end_with_the_view(viewer: Viewer, browser: Browser, camera: Node) -> None:
    front = Camera(camera, TOPIC, LATCHED)
    front.publish(1)
    page = browser.new_page(f'{viewer.url}?topic={TOPIC}')
    page.wait_for(f'factOf({TOPIC!r}, "zoom")')
    page.press('h')
    page.wait_for(f'{CHART}.startsWith("0 to 255")')
    page.press('Escape')
    page.evaluate('sent.length = 0')
    for number in range(2, 6):
        front.show(page, number)
        page.evaluate('new Promise((done) => setTimeout(done, 250))')
    assert page.evaluate('sent.filter((one) => one.histogram).length') == 0
    page.evaluate(f'tileOf({TOPIC!r}).querySelector(".frame").click()')
    page.wait_for('sent.some((one) => one.histogram)')
    page.wait_for(f'{chart_of(TOPIC)}.startsWith("0 to 255")')


def test_histogram_of_what_is_seen(viewer: Viewer, browser: Browser, camera: Node) -> None:
    image = np.zeros((2160, 3840), np.uint8)
    image[1060:1100, 1900:1940] = 255
    page = open_image(viewer, browser, camera, image, 'mono8')
    page.press('h')
    page.wait_for(f'{CHART}.endsWith("over-exposed, 100 % black")')
    page.evaluate('new Promise((done) => setTimeout(done, 1200))')  # the tile has its size
    for _ in range(22):
        wheel(page, place_of(page, 1920.5, 1080.5, (3840, 2160)), -120)
    page.wait_for(f'{CHART} === "0 to 255, 100 % over-exposed"')


def test_region_of_a_turned_picture(viewer: Viewer, browser: Browser, camera: Node) -> None:
    page = open_image(viewer, browser, camera, random_image(2160, 3840))
    page.press('t')
    page.press('1')
    region = json.loads(page.wait_for(f'{REGION} !== "null" && {REGION}'))
    width, height = page.evaluate(f'(({{ clientWidth, clientHeight }}) => [clientWidth, '
                                  f'clientHeight])(tileOf({TOPIC!r}).querySelector(".frame"))')
    assert width > 1.2 * height
    # The axis of the image that was the vertical one is the horizontal one of the screen.
    assert region[2:] == pytest.approx([height, width], abs=4)


def test_range_of_a_topic_that_was_left(viewer: Viewer, browser: Browser, camera: Node) -> None:
    depth = np.arange(320 * 240, dtype=np.uint16).reshape(240, 320)
    Camera(camera, TOPIC, LATCHED).publish_image(depth, '16UC1')
    page = browser.new_page(f'{viewer.url}?topic={TOPIC}&range=300,4000&colors=gray')
    query = 'decodeURIComponent(new URL(location).search)'
    page.wait_for(f'factOf({TOPIC!r}, "zoom")')
    page.press('Escape')
    assert page.evaluate(query) == ''
    page.evaluate(f'tileOf({TOPIC!r}).querySelector(".frame").click()')
    assert page.evaluate(query) == f'?topic={TOPIC}&range=300,4000&colors=gray'
    page.wait_for('sent.findLast((one) => one.subscribe).range?.join() === "300,4000"')
    # The bar shows the chosen limits before a picture has them.
    page.wait_for('document.getElementById("low").offsetWidth > 0')
    assert page.evaluate('(() => { document.getElementById("low").value = 500; '
                         'document.getElementById("range").dispatchEvent(new Event("change")); '
                         'return document.getElementById("bar-low").textContent; })()') == '500 mm'
    assert page.evaluate(query) == f'?topic={TOPIC}&range=500,4000&colors=gray'
    page.evaluate('history.back()')
    page.wait_for('document.body.dataset.view === "all"')
    assert page.evaluate(query) == ''
    page.evaluate('history.forward()')
    page.wait_for('document.body.dataset.view === "one"')
    assert page.evaluate(query) == f'?topic={TOPIC}&range=500,4000&colors=gray'


@pytest.mark.parametrize('name', ['front', '/front/compressed', 'front/ffmpeg'])
def test_other_names_of_a_topic(
        name: str, viewer: Viewer, browser: Browser, camera: Node) -> None:
    Camera(camera, TOPIC, LATCHED).publish(7)
    page = browser.new_page(f'{viewer.url}?topic={name}')
    page.wait_for(f'numberOf({TOPIC!r}) === 7')
    assert page.evaluate('document.querySelectorAll(".tile").length') == 1


def test_value_and_zoom_on_the_whole_screen(
        viewer: Viewer, browser: Browser, camera: Node) -> None:
    page = open_image(viewer, browser, camera, random_image())
    page.press('f')
    page.wait_for('document.fullscreenElement !== null')
    page.evaluate('new Promise((done) => setTimeout(done, 1200))')
    move(page, place_of(page, 320.5, 240.5))
    page.wait_for(f'{VALUE}.startsWith("320, 240: ")')
    picture, value, button = page.evaluate(
        '[".frame", ".pixel", "[data-look=in]"].map((one) => { const { left, top, right, bottom, '
        'width, height } = document.querySelector(`.tile ${one}`).getBoundingClientRect(); '
        'const found = document.elementFromPoint((left + right) / 2, (top + bottom) / 2); '
        'return found?.closest(one) && bottom <= innerHeight && [width, height]; })')
    assert picture and value and button and picture[0] > 1200 and picture[1] > 650
    zoom = f'factOf({TOPIC!r}, "zoom")'
    before = page.evaluate(zoom)
    page.press('+')
    page.wait_for(f'{zoom} !== {before!r}')


def test_right_click_draws_no_line(viewer: Viewer, browser: Browser, camera: Node) -> None:
    page = open_image(viewer, browser, camera, random_image())
    page.press('l')
    page.evaluate('new Promise((done) => setTimeout(done, 1200))')  # the tile has its size
    for kind, button in (('mousePressed', 'right'), ('mouseReleased', 'right')):
        page.call('Input.dispatchMouseEvent', type=kind, button=button, clickCount=1,
                  **place_of(page, 200.5, 200.5))
    drawn = 'document.querySelector(".line").getAttribute("d") ?? ""'
    assert page.evaluate(drawn) == ''
    drag(page, place_of(page, 100.5, 100.5), place_of(page, 200.5, 100.5))
    assert page.evaluate(drawn) == 'M100.5 100.5L200.5 100.5'
