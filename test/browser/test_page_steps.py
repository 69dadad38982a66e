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
"""Steps through the frames that the node has kept, by keys, buttons and touch."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
import json
from typing import Any

from chromium import Browser, Page
from conftest import spin_until
import cv2
import numpy as np
from opencv_tools.image.cdr import WireHeader
from opencv_tools.image.encodings import find_encoding
from opencv_tools.image.layout import array_to_wire
from opencv_tools.transport.shared_frames.publisher import SharedFramePublisher
from pages import Camera, numbered_frame, STRIPE, Viewer
import pytest
from rclpy.node import Node
from sensor_msgs.msg import CompressedImage
from test_page_layout import check_all
from test_page_look import move, place_of, VALUE
from test_page_video import VideoCamera
from waiting import wait_until

pytest_plugins = ['pages']

TOPIC, OTHER = '/front', '/rear'
SIZE = 320, 240
BASE = 1_700_000_000  # seconds of the first stamp
TENTH = 10**8  # nanoseconds between two frames
TEXT = f'tileOf({TOPIC!r}).querySelector("output.step").textContent'
PATCH = 40, 220  # a pixel in the field that has values of its own in each frame
#: Place and size of the picture.
FRAME = ('(({left, top, width, height}) => [left, top, width, height].map(Math.round).join())('
         f'tileOf({TOPIC!r}).querySelector(".frame").getBoundingClientRect())')
SETTLED = 'new Promise((done) => setTimeout(done, 1200))'  # the tiles have their size
STATE = 'document.getElementById("state").textContent'


def values_of(number: int) -> list[int]:
    """Return the blue, green and red values of a field of a frame."""
    return [5 * number % 256, 9 * number % 256, 255 - 7 * number % 256]


def frame(number: int, width: int = SIZE[0], height: int = SIZE[1]) -> np.ndarray:
    """Return a numbered frame, one field of which has the values of the number."""
    image = numbered_frame(number, width, height)
    image[height * 4 // 5:, :width // 4] = values_of(number)
    return image


def stamp_of(number: int) -> int:
    """Return the stamp of a frame in nanoseconds."""
    return BASE * 10**9 + number * TENTH


@dataclass
class RawCamera(Camera):
    """A camera with raw images by an image topic."""

    def send(self, number: int, **size: int) -> None:
        self.publish_image(frame(number, **size), 'bgr8', stamp_of(number))


class JpegCamera(Camera):
    """A camera with JPEGs."""

    def __post_init__(self) -> None:
        self.publisher = self.node.create_publisher(
            CompressedImage, f'{self.topic}/compressed', self.qos)

    def send(self, number: int) -> None:
        content = cv2.imencode('.jpg', frame(number), [cv2.IMWRITE_JPEG_QUALITY, 98])[1]
        message = CompressedImage(format='jpeg', data=content.tobytes())
        message.header.stamp.sec, message.header.stamp.nanosec = divmod(stamp_of(number), 10**9)
        self.publisher.publish(message)


class SharedCamera(Camera):
    """A camera whose frames stay in shared memory."""

    def __post_init__(self) -> None:
        super().__post_init__()
        self.shared = SharedFramePublisher(self.node, self.publisher)

    @property
    def is_shared(self) -> bool:
        """Return whether the viewer has left the image topic, as it gets all frames here."""
        return self.shared.has_subscribers and not super().is_watched()

    def is_watched(self) -> bool:
        return self.shared.has_subscribers

    def send(self, number: int) -> None:
        header = WireHeader(*divmod(stamp_of(number), 10**9), 'camera')
        self.shared.publish(array_to_wire(frame(number), find_encoding('bgr8'), header),
                            is_message=super().is_watched())


def wait_for_history(page: Page, camera: Any) -> None:
    """Wait until the viewer keeps the frames of a camera."""
    camera.wait_for_viewer()
    page.wait_for(f'followed.has({camera.topic!r})')


def show_all(page: Page, camera: Any, first: int, last: int) -> None:
    """Publish frames one by one, each after the page has drawn the one before."""
    wait_for_history(page, camera)
    for number in range(first, last + 1):
        camera.send(number)
        page.wait_for(f'numberOf({camera.topic!r}) === {number}')


def open_alone(viewer: Viewer, browser: Browser, search: str = '') -> Page:
    """Open the page with one topic."""
    join = '&' if '?' in viewer.url else '?'
    page = browser.new_page(f'{viewer.url}{join}topic={TOPIC}{search}')
    page.wait_for(f'{STATE} === "Live"')
    return page


def pause(page: Page) -> None:
    page.press(' ')
    page.wait_for('sent.some((message) => message.held)')
    page.evaluate(SETTLED)


def middle_of(page: Page, way: str) -> dict[str, float]:
    """Return the middle of a button."""
    x, y = page.evaluate(
        '(({left, top, width, height}) => [left + width / 2, top + height / 2])('
        f'document.getElementById({way!r}).getBoundingClientRect())')
    return {'x': x, 'y': y}


def click(page: Page, way: str) -> None:
    """Click a button with the mouse."""
    place = middle_of(page, way)
    for kind in ('mousePressed', 'mouseReleased'):
        page.call('Input.dispatchMouseEvent', type=kind, button='left', clickCount=1, **place)


def touch(page: Page, way: str) -> None:
    """Touch a button."""
    page.call('Input.dispatchTouchEvent', type='touchStart', touchPoints=[middle_of(page, way)])
    page.call('Input.dispatchTouchEvent', type='touchEnd', touchPoints=[])


def check(page: Page, number: int, text: str) -> None:
    """Check that the page shows a frame: its picture, the value of its pixel, and its place."""
    page.wait_for(f'numberOf({TOPIC!r}) === {number}')
    page.wait_for(f'{TEXT} === {json.dumps(text)}')
    page.wait_for_paint()  # a text of several lines makes the picture smaller
    shown = page.evaluate(f'pixel(tileOf({TOPIC!r}).querySelector("canvas"), 0.125, 0.9)')
    assert np.abs(np.array(shown[::-1]) - values_of(number)).max() < 12
    found = (
        '(() => { const found = /^40, 220: B ([0-9]+), G ([0-9]+), R ([0-9]+)( of the JPEG)?$/'
        f'.exec({VALUE}); '
        f'return found && Math.abs(found[1] - {values_of(number)[0]}) < 5 '
        '&& JSON.stringify(found.slice(1, 4).map(Number)); })()')

    def look() -> str | None:
        move(page, place_of(page, PATCH[0] + 0.5, PATCH[1] + 0.5, SIZE))  # which a text may change
        page.evaluate('new Promise((done) => setTimeout(done, 100))')
        answer: str | None = page.evaluate(found)
        return answer

    blue, green, red = json.loads(wait_until(look, 'the value of the pixel') or '')
    assert np.abs(np.array([blue, green, red]) - values_of(number)).max() < 5


@pytest.mark.parametrize('kind', [RawCamera, JpegCamera])
def test_steps_by_keys(kind: type, viewer: Viewer, browser: Browser, camera: Node) -> None:
    source = kind(camera, TOPIC)
    page = open_alone(viewer, browser)
    show_all(page, source, 1, 12)
    pause(page)
    for number in (13, 14):
        source.send(number)  # while the page is paused
    for _ in range(5):
        page.press(',')
    check(page, 7, 'frame 7 of 12, 0.5 s before')
    for _ in range(2):
        page.press('.')
    check(page, 9, 'frame 9 of 12, 0.3 s before')
    for _ in range(10):
        page.press(',')
    check(page, 1, 'frame 1 of 12, 1.1 s before, the first one')
    for _ in range(20):
        page.press('.')
    check(page, 12, 'frame 12 of 12, 0.0 s before, the last one')
    page.press(' ')
    source.wait_for_viewer()
    show_all(page, source, 20, 22)  # live again
    assert page.evaluate(TEXT) == ''
    check_all(page)
    assert page.complaints() == []


def test_frames_of_shared_memory(viewer: Viewer, browser: Browser, camera: Node) -> None:
    source = SharedCamera(camera, TOPIC)
    page = open_alone(viewer, browser)
    spin_until(camera, lambda: source.publisher.get_subscription_count() > 0)
    last = 0
    while not source.is_shared:
        last += 1
        assert last < 500
        show_all(page, source, last, last)
    show_all(page, source, last + 1, last + 12)
    last += 12
    pause(page)
    for _ in range(11):
        page.press(',')
    check(page, last - 11, f'frame {last - 11} of {last}, 1.1 s before')
    source.send(last + 1)
    for _ in range(7):
        page.press('.')
    check(page, last - 4, f'frame {last - 4} of {last}, 0.4 s before')
    page.press(' ')
    # The viewer has subscribed again. It gets frames by the image topic, then by shared memory.
    for number in range(last + 2, last + 2000):
        source.send(number)
        page.evaluate('new Promise((done) => setTimeout(done, 30))')
        if page.evaluate(f'numberOf({TOPIC!r})') > last + 1 and source.is_shared:
            break
    assert page.evaluate(f'numberOf({TOPIC!r})') > last + 1
    assert source.is_shared
    assert page.complaints() == []


@pytest.mark.parametrize('size', [(1280, 800), (1920, 1080), (390, 844)])
def test_steps_by_buttons(
        size: tuple[int, int], viewer: Viewer, browser: Browser, camera: Node) -> None:
    source = RawCamera(camera, TOPIC)
    page = open_alone(viewer, browser)
    page.resize(*size)
    is_phone = size[0] < 600
    if is_phone:
        page.call('Emulation.setTouchEmulationEnabled', enabled=True, maxTouchPoints=2)
    assert page.evaluate('document.getElementById("later").hidden')
    show_all(page, source, 1, 12)
    page.wait_for(f'tileOf({TOPIC!r}).querySelector(".history .hint").textContent')
    page.evaluate(SETTLED)
    before = page.evaluate(FRAME)
    pause(page)
    for way, count in (('earlier', 5), ('later', 2)):
        for _ in range(count):
            (touch if is_phone else click)(page, way)
    check(page, 9, 'frame 9 of 12, 0.3 s before')
    page.evaluate(SETTLED)
    assert page.evaluate(FRAME) == before  # the picture keeps its place
    for _ in range(9):
        (touch if is_phone else click)(page, 'earlier')
    check(page, 1, 'frame 1 of 12, 1.1 s before, the first one')
    page.evaluate(SETTLED)
    assert page.evaluate(FRAME) == before
    check_all(page)
    if is_phone:
        return
    for scheme in ('dark', 'light'):
        page.prefer(scheme)
        check_all(page)


def test_held_key_shows_each_frame(viewer: Viewer, browser: Browser, camera: Node) -> None:
    source = RawCamera(camera, TOPIC)
    page = open_alone(viewer, browser)
    show_all(page, source, 1, 20)
    pause(page)
    page.evaluate('drawn.length = 0')
    for repeats in range(60):
        page.call('Input.dispatchKeyEvent', type='keyDown', key=',', text=',',
                  windowsVirtualKeyCode=ord(','), autoRepeat=repeats > 0)
        page.evaluate('new Promise((done) => setTimeout(done, 30))')
        if page.evaluate(f'numberOf({TOPIC!r})') <= 8:
            break
    page.call('Input.dispatchKeyEvent', type='keyUp', key=',', windowsVirtualKeyCode=ord(','))
    page.wait_for(f'numberOf({TOPIC!r}) <= 8')
    shown = page.evaluate('drawn.map((one) => one.number)')
    assert shown == [*range(19, shown[-1] - 1, -1)]  # without a gap


def test_zoom_while_stepped(viewer: Viewer, browser: Browser, camera: Node) -> None:
    source = RawCamera(camera, TOPIC)
    page = open_alone(viewer, browser)
    wait_for_history(page, source)
    sides = {'width': 1280, 'height': 960}
    for number in range(1, 7):
        source.send(number, **sides)
        page.wait_for(f'numberOf({TOPIC!r}) === {number}')
    pause(page)
    for _ in range(3):
        page.press(',')
    page.wait_for(f'numberOf({TOPIC!r}) === 3')
    place = place_of(page, 100.5, 900.5, (1280, 960))
    for _ in range(6):
        page.call('Input.dispatchMouseEvent', type='mouseWheel', deltaX=0, deltaY=-200, **place)
    region = json.loads(page.wait_for(
        '(({ region }) => region && region[2] < 400 && JSON.stringify(region))'
        '(sent.filter((one) => one.subscribe).at(-1))'))
    assert region[0] <= 100 < region[0] + region[2] and region[1] <= 900

    def check_region(number: int) -> None:
        canvas = f'tileOf({TOPIC!r}).querySelector("canvas")'
        values = values_of(number)
        text = f': B {values[0]}, G {values[1]}, R {values[2]}'
        page.wait_for(f'{VALUE}.endsWith({text!r})')
        page.wait_for(f'{canvas}.width < 600 && ((shown) => {values[::-1]}.every((one, place) => '
                      f'Math.abs(one - shown[place]) < 12))(pixel({canvas}, 0.1, 0.5))')

    move(page, place)
    check_region(3)
    page.press('.')
    check_region(4)
    page.press(',')
    page.press(',')
    check_region(2)
    page.press('h')
    page.wait_for(f'tileOf({TOPIC!r}).querySelector(".chart .hint").textContent'
                  ' === "0 to 255"')
    page.press('0')
    page.wait_for(f'numberOf({TOPIC!r}) === 2')
    assert page.complaints() == []


def test_topic_beside_shows_the_nearest_stamp(
        viewer: Viewer, browser: Browser, camera: Node) -> None:
    front, rear = RawCamera(camera, TOPIC), RawCamera(camera, OTHER)
    page = open_alone(viewer, browser, f'&beside={OTHER}')
    for source in (front, rear):
        wait_for_history(page, source)
    for number in range(1, 13):
        front.send(number)
        page.wait_for(f'numberOf({TOPIC!r}) === {number}')
        if number % 3 == 0:  # a third of the rate, and a stamp that is a bit later
            rear.publish_image(frame(number), 'bgr8', stamp_of(number) + TENTH // 4)
            page.wait_for(f'numberOf({OTHER!r}) === {number}')
    page.press(' ')
    page.wait_for('new Set(sent.filter((one) => one.held).map((one) => one.subscribe)).size === 2')
    for number, beside in ((11, 12), (10, 9), (9, 9), (8, 9), (7, 6), (6, 6)):
        page.press(',')
        page.wait_for(f'numberOf({TOPIC!r}) === {number} && numberOf({OTHER!r}) === {beside}')
    texts = '[...document.querySelectorAll("output.step")].map((one) => one.textContent).join("")'
    page.wait_for(f'{texts} === "frame 6 of 12, 0.6 s before"')  # only one place is announced
    check_all(page)


def test_values_beside_after_quick_steps(
        viewer: Viewer, browser: Browser, camera: Node) -> None:
    front, rear = RawCamera(camera, TOPIC), RawCamera(camera, OTHER)
    page = open_alone(viewer, browser, f'&beside={OTHER}')
    for source in (front, rear):
        wait_for_history(page, source)
    for number in range(1, 21):
        for source in (front, rear):
            source.send(number)
            page.wait_for(f'numberOf({source.topic!r}) === {number}')
    page.press(' ')
    page.wait_for('new Set(sent.filter((one) => one.held).map((one) => one.subscribe)).size === 2')
    page.evaluate(SETTLED)
    move(page, place_of(page, PATCH[0] + 0.5, PATCH[1] + 0.5, SIZE))
    before = page.evaluate(FRAME)
    shown = 20
    for key, count in ((',', 3), (',', 1), (',', 12), ('.', 5), (',', 40)):
        for _ in range(count):
            page.press(key)
        shown = max(1, shown - count) if key == ',' else shown + count
        blue, green, red = values_of(shown)
        for topic in (TOPIC, OTHER):
            page.wait_for(f'numberOf({topic!r}) === {shown} && '
                          f'tileOf({topic!r}).querySelector(".pixel").textContent'
                          f' === "40, 220: B {blue}, G {green}, R {red}"')
        page.wait_for_paint()
        assert page.evaluate(FRAME) == before
    assert page.complaints() == []


def test_steps_over_the_restart_of_a_publisher(
        viewer: Viewer, browser: Browser, camera: Node) -> None:
    first = RawCamera(camera, TOPIC)
    page = open_alone(viewer, browser)
    show_all(page, first, 1, 4)
    camera.destroy_publisher(first.publisher)
    second = RawCamera(camera, TOPIC)
    show_all(page, second, 5, 7)
    pause(page)
    for number in (6, 5, 4, 3):
        page.press(',')
        check(page, number, f'frame {number} of 7, {(7 - number) / 10} s before')
    camera.destroy_publisher(second.publisher)
    page.press('.')
    check(page, 4, 'frame 4 of 7, 0.3 s before')


def test_steps_before_the_end_of_a_camera(
        viewer: Viewer, browser: Browser, camera: Node) -> None:
    source = RawCamera(camera, TOPIC)
    page = open_alone(viewer, browser)
    show_all(page, source, 1, 5)
    camera.destroy_publisher(source.publisher)
    quiet = f'tileOf({TOPIC!r}).classList.contains("quiet")'
    page.wait_for(quiet)
    pause(page)
    assert not page.evaluate(quiet)
    for number in (4, 3):
        page.press(',')
        check(page, number, f'frame {number} of 5, 0.{5 - number} s before')
    page.press(' ')
    page.wait_for(quiet)


def test_limits(start_viewer: Callable[..., Viewer], browser: Browser, camera: Node) -> None:
    size = SIZE[0] * SIZE[1] * 3
    source, other = RawCamera(camera, TOPIC), RawCamera(camera, OTHER)
    viewer = start_viewer(history_bytes=4 * size + 4000)
    page = open_alone(viewer, browser)
    show_all(page, source, 1, 9)
    pause(page)
    for _ in range(6):
        page.press(',')
    check(page, 6, 'frame 1 of 4, 0.3 s before, the first one')
    page.press('.')
    check(page, 7, 'frame 2 of 4, 0.2 s before')
    busy = browser.new_page(f'{viewer.url}?topic={OTHER}')
    show_all(busy, other, 1, 3)
    gone = f'others needed the {4 * size + 4000} bytes of history_bytes'
    for last in (5, 9):  # half of the bytes stay for the pause
        page.press(',')
        check(page, 8, f'frame 1 of 2, 0.1 s before, earlier ones are gone: {gone}')
        show_all(busy, other, last - 1, last)
    check_all(page)


@pytest.mark.parametrize(('limit', 'reason'), [
    (0, 'history_bytes is 0'),
    (1000, r'a frame has 230[0-9]+ bytes, and history_bytes is 1000')])
def test_frames_that_are_not_kept(
        limit: int, reason: str, start_viewer: Callable[..., Viewer], browser: Browser,
        camera: Node) -> None:
    source = RawCamera(camera, TOPIC)
    page = open_alone(start_viewer(history_bytes=limit), browser)
    show_all(page, source, 1, 3)
    pause(page)
    page.press(',')
    page.wait_for(f'/^the node has kept no frame: {reason}$/.test({TEXT})')
    assert page.evaluate(f'numberOf({TOPIC!r})') == 3


def test_pictures_that_are_not_kept_for_the_pause(
        start_viewer: Callable[..., Viewer], browser: Browser, camera: Node) -> None:
    viewer = start_viewer()
    front, rear = RawCamera(camera, TOPIC), RawCamera(camera, OTHER)
    page = open_alone(viewer, browser)
    show_all(page, front, 1, 3)
    pause(page)
    page.press(',')
    check(page, 2, 'frame 2 of 3, 0.1 s before')
    sentence = ('nothing to step to: no frames are kept here for this pause: '
                'resume, then pause again')
    text = 'document.querySelector(".tile:not([hidden]) output.step").textContent'
    for key in ('ArrowRight', 'ArrowLeft'):
        page.press(key)
        page.wait_for(f'{text} === ""')
        page.press(',')
        page.wait_for(f'{text} === {sentence!r}')
    page.press('Escape')
    page.wait_for('![...document.querySelectorAll("output.step")].some((one) => one.textContent)')
    page.press(' ')
    show_all(page, front, 4, 5)
    show_all(page, rear, 6, 6)
    page.evaluate(f'tileOf({TOPIC!r}).querySelector(".frame").click()')
    show_all(page, front, 7, 8)
    pause(page)
    page.press(',')
    page.wait_for(f'{text}.startsWith("frame ")')
    viewer.process.interrupt()
    assert viewer.process.finish() == 0
    page.wait_for(f'{STATE} === "Reconnecting"')
    start_viewer(port=viewer.port)
    page.wait_for(f'{STATE} === "Paused" && {text} === ""')
    page.press(',')
    page.wait_for(f'{text} === {sentence!r}')


VIDEO_STATE = f'factOf({TOPIC!r}, "shown")'


def show_video(page: Page, video: VideoCamera, first: int, last: int) -> None:
    """Publish frames of video one by one, each after the page has drawn the one before."""
    for number in range(first, last + 1):
        video.publish(number)
        spin_until(video.node, lambda: bool(
            page.evaluate(f'numberOf({TOPIC!r}) === {number}')))  # noqa: B023


def test_first_pause_of_video_has_its_frames(
        viewer: Viewer, browser: Browser, camera: Node) -> None:
    video = VideoCamera(camera, TOPIC)
    page = open_alone(viewer, browser)
    video.show(page, 0)
    assert 'h264' in page.wait_for(VIDEO_STATE)
    show_video(page, video, 1, 12)
    page.press(' ')
    page.wait_for('sent.some((one) => "busy" in one)')  # the image of the node is drawn
    assert page.evaluate(f'numberOf({TOPIC!r})') == 12  # what it showed
    page.press(',')
    page.wait_for(f'numberOf({TOPIC!r}) === 11 && {TEXT}.startsWith("frame ")')
    move(page, place_of(page, 0.125 * SIZE[0], 0.95 * SIZE[1], SIZE))
    blue, green, red = STRIPE[0]
    value = page.wait_for(f'/R [0-9]+ of the decoded video$/.test({VALUE}) && {VALUE}')
    found = [int(part.split()[1]) for part in value.split(': ')[1].split(' of ')[0].split(', ')]
    assert np.abs(np.array(found) - [blue, green, red]).max() < 24
    for _ in range(4):
        page.press(',')
    page.wait_for(f'numberOf({TOPIC!r}) === 7')
    for _ in range(3):
        page.press('.')
    page.wait_for(f'numberOf({TOPIC!r}) === 10')
    for _ in range(40):
        page.press(',')
    # The page may have come after the key frame of an earlier packet with the number 0.
    page.wait_for(f'/(the first one|before this page looked)$/.test({TEXT})')
    assert page.evaluate(f'numberOf({TOPIC!r})') == 0
    page.press(' ')
    page.wait_for(f'{STATE} === "Live"')
    video.show(page, 13)
    page.wait_for(f'{VIDEO_STATE}?.includes("h264")')  # video again
    show_video(page, video, 14, 16)
    page.press(' ')
    page.wait_for(f'{STATE} === "Paused"')
    page.press(',')
    page.wait_for(f'numberOf({TOPIC!r}) === 15')
    assert page.complaints() == []
