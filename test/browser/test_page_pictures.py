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
"""Pictures in the page: their pixels, their facts, and when the page asks for them."""

from __future__ import annotations

import array
from collections.abc import Callable
import json
from pathlib import Path
import time
from urllib.request import urlopen

from chromium import Browser, Page
from conftest import NodeProcess
import cv2
import numpy as np
from pages import Camera, numbered_frame, Viewer
import pytest
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from sending import NANO
from sensor_msgs.msg import CompressedImage, Image
from stereo_msgs.msg import DisparityImage
from test_page_layout import check_all
from waiting import LONGEST_SECONDS, wait_until

pytest_plugins = ['pages']

TOPIC = '/front/video_frames'
LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)


def select(page: Page, topic: str) -> None:
    """Click on the picture of a topic."""
    page.evaluate(f'tileOf({topic!r}).querySelector(".frame").click()')


def test_pixels_of_numbered_frames(viewer: Viewer, browser: Browser, camera: Node) -> None:
    front, page = Camera(camera, TOPIC), browser.new_page(viewer.url)
    for number in (1, 0x8000, 0xA5C3, 0):
        front.show(page, number)
    colors = [page.evaluate(f'pixel(tileOf({TOPIC!r}).querySelector("canvas"), {x}, 0.9)')
              for x in (0.125, 0.375, 0.625)]
    assert np.abs(np.array(colors) - 255 * np.eye(3)).max() < 16, colors
    assert page.wait_for(f'factOf({TOPIC!r}, "size")') == '320 \u00d7 240'
    assert page.evaluate(f'factOf({TOPIC!r}, "encoding")') == 'bgr8'
    assert page.evaluate(f'factOf({TOPIC!r}, "lost")') == '0'
    assert page.complaints() == []


@pytest.mark.parametrize(('seconds', 'text'), [
    (7300, '2 h'), (3 * 86400 + 60, '3 d'), (130, '2 min'),
])
def test_age_of_a_picture(
        seconds: int, text: str, viewer: Viewer, browser: Browser, camera: Node) -> None:
    front, page = Camera(camera, TOPIC), browser.new_page(viewer.url)
    front.show(page, 7, time.time_ns() - seconds * NANO)
    page.wait_for(f'factOf({TOPIC!r}, "age") === {text!r}')


def test_age_grows_without_frames(viewer: Viewer, browser: Browser, camera: Node) -> None:
    front, page = Camera(camera, TOPIC), browser.new_page(viewer.url)
    front.show(page, 7)
    page.wait_for(f'parseFloat(factOf({TOPIC!r}, "age")) > 2'
                  f' && factOf({TOPIC!r}, "age").endsWith(" s")')


def test_age_of_simulated_time(viewer: Viewer, browser: Browser, camera: Node) -> None:
    front, page = Camera(camera, TOPIC), browser.new_page(viewer.url)
    front.show(page, 7, 12 * NANO)
    assert page.wait_for(f'factOf({TOPIC!r}, "age")').endswith(('s', 'min'))


def test_eight_topics_on_one_socket(viewer: Viewer, browser: Browser, camera: Node) -> None:
    cameras = [Camera(camera, f'/camera_{number}') for number in range(8)]
    page = browser.new_page(viewer.url)
    page.wait_for('document.querySelectorAll(".tile").length === 8')
    for number, one in enumerate(cameras):
        one.show(page, 100 + number)
    assert [page.evaluate(f'numberOf({one.topic!r})') for one in cameras] == [*range(100, 108)]
    assert page.evaluate('sockets.length') == 1
    with urlopen(f'{viewer.url}topics', timeout=LONGEST_SECONDS) as answer:
        assert [topic['name'] for topic in json.load(answer)['topics']] == [
            one.topic for one in cameras]


def test_one_topic_and_the_keys(viewer: Viewer, browser: Browser, camera: Node) -> None:
    left, right = Camera(camera, '/left'), Camera(camera, '/right')
    page = browser.new_page(viewer.url)
    for one in (left, right):
        one.show(page, 5)
    select(page, '/left')
    right.wait_for_no_viewer()
    assert left.is_watched()
    assert page.evaluate('tileOf("/right").offsetWidth') == 0
    assert page.evaluate('document.title').startswith('/left')
    for key, name in (('ArrowLeft', '/right'), ('ArrowLeft', '/left'), ('ArrowRight', '/right')):
        page.press(key)
        assert page.evaluate('document.title').startswith(name)
    left.wait_for_no_viewer()
    right.show(page, 6)
    assert page.evaluate('new URL(location).searchParams.get("topic")') == '/right'
    page.press('Escape')
    left.wait_for_viewer()
    assert page.evaluate('new URL(location).searchParams.get("topic")') is None
    page.evaluate('history.back()')
    page.wait_for('document.title.startsWith("/right")')
    left.wait_for_no_viewer()


def test_focus_moves_with_the_arrows(viewer: Viewer, browser: Browser, camera: Node) -> None:
    for name in 'abc':
        Camera(camera, f'/{name}')
    page = browser.new_page(viewer.url)
    page.wait_for('document.querySelectorAll(".tile").length === 3')
    for key, name in (('ArrowRight', 'a'), ('ArrowRight', 'b'), ('ArrowRight', 'c'),
                      ('ArrowRight', 'c'), ('ArrowLeft', 'b')):
        page.press(key)
        assert page.evaluate('document.activeElement.closest(".tile").dataset.topic') == f'/{name}'
    page.press('Enter')
    page.wait_for('document.title.startsWith("/b")')


def test_focus_moves_between_rows(viewer: Viewer, browser: Browser, camera: Node) -> None:
    cameras = [Camera(camera, f'/camera_{number}') for number in range(8)]
    page = browser.new_page(viewer.url)
    page.wait_for('document.querySelectorAll(".tile").length === 8')
    columns = int(page.evaluate('document.getElementById("cameras").style.getPropertyValue('
                                '"--columns")'))
    assert columns > 1
    for key, place in (('ArrowDown', 0), ('ArrowDown', columns), ('ArrowRight', columns + 1),
                       ('ArrowUp', 1), ('ArrowUp', 0)):
        page.press(key)
        assert page.evaluate('document.activeElement.closest(".tile").dataset.topic'
                             ) == cameras[place].topic


def test_topic_that_nobody_publishes(viewer: Viewer, browser: Browser, camera: Node) -> None:
    for name in ('/left', '/right'):
        Camera(camera, name)
    page = browser.new_page(f'{viewer.url}?topic=/wrong')
    page.wait_for('document.querySelectorAll(".tile").length === 3')
    sentence = page.wait_for('tileOf("/wrong").querySelector(".reason").textContent')
    assert sentence.startswith('/wrong is not an image topic')
    page.press('s')
    notice = page.wait_for('document.getElementById("notice").textContent')
    assert notice.startswith('/wrong is not an image topic')
    for key, name in (('ArrowRight', '/left'), ('ArrowLeft', '/right'), ('ArrowLeft', '/left')):
        page.press(key)
        assert page.evaluate('document.title').startswith(name)
    assert page.evaluate('tileOf("/wrong") === undefined')
    assert [complaint for complaint in page.complaints() if '404' not in complaint] == []


def test_selected_topic_that_has_ended(
        viewer: Viewer, browser: Browser, camera: Node) -> None:
    left, page = Camera(camera, '/left'), browser.new_page(f'{viewer.url}?topic=/left')
    left.show(page, 1)
    page.press(' ')
    left.wait_for_no_viewer()
    camera.destroy_publisher(left.publisher)
    Camera(camera, '/right')
    page.wait_for('tileOf("/right") !== undefined')
    assert page.evaluate('numberOf("/left")') == 1
    page.press('ArrowRight')
    assert page.evaluate('document.title').startswith('/right')
    assert page.evaluate('tileOf("/left") === undefined')


def test_hidden_page_asks_for_nothing(viewer: Viewer, browser: Browser, camera: Node) -> None:
    front, page = Camera(camera, TOPIC), browser.new_page(viewer.url)
    front.show(page, 1)
    page.hide()
    front.wait_for_no_viewer()
    front.publish(2)
    page.show()
    front.show(page, 3)
    assert page.evaluate('[...new Set(drawn.map(({ number }) => number))]') == [1, 3]


def test_picture_outside_the_screen_is_not_asked_for(
        viewer: Viewer, browser: Browser, camera: Node) -> None:
    cameras = [Camera(camera, f'/camera_{number}') for number in range(8)]
    page = browser.new_page(viewer.url, width=390, height=844)
    cameras[0].show(page, 1)
    page.wait_for('document.querySelectorAll(".tile").length === 8')
    cameras[7].wait_for_no_viewer()
    page.evaluate('scrollTo(0, document.body.scrollHeight)')
    cameras[7].show(page, 2)
    cameras[0].wait_for_no_viewer()


def test_paused_page_keeps_its_picture(viewer: Viewer, browser: Browser, camera: Node) -> None:
    front, page = Camera(camera, TOPIC), browser.new_page(viewer.url)
    front.show(page, 1)
    page.press(' ')
    front.wait_for_no_viewer()
    assert page.evaluate('document.getElementById("pause").getAttribute("aria-pressed")') == 'true'
    assert page.evaluate('document.getElementById("state").textContent') == 'Paused'
    assert page.evaluate(f'numberOf({TOPIC!r})') == 1
    page.press(' ')
    front.show(page, 2)


def test_topic_that_ends_and_comes_back(
        viewer: Viewer, browser: Browser, camera: Node) -> None:
    front, page = Camera(camera, TOPIC), browser.new_page(viewer.url)
    front.show(page, 1)
    page.press(' ')
    front.wait_for_no_viewer()
    camera.destroy_publisher(front.publisher)
    page.wait_for('document.getElementById("empty").offsetWidth > 0')
    page.press(' ')
    front = Camera(camera, TOPIC)
    front.show(page, 2)
    assert page.complaints() == []


def test_reconnection_after_a_restart(
        start_viewer: Callable[..., Viewer], browser: Browser, camera: Node) -> None:
    front, viewer = Camera(camera, TOPIC), start_viewer()
    page = browser.new_page(viewer.url)
    front.show(page, 1)
    viewer.process.interrupt()
    assert viewer.process.finish() == 0
    page.wait_for(f'tileOf({TOPIC!r}).classList.contains("quiet")')
    assert page.evaluate('document.getElementById("state").textContent') == 'Reconnecting'
    assert page.evaluate(f'numberOf({TOPIC!r})') == 1
    start_viewer(port=viewer.port)
    front.show(page, 2)

    def is_live() -> bool:
        front.publish(2)
        return bool(page.evaluate(f'!tileOf({TOPIC!r}).classList.contains("quiet")'))

    wait_until(is_live, 'a tile that is not quiet')
    assert page.evaluate('document.getElementById("state").textContent') == 'Live'


def test_latched_picture(viewer: Viewer, browser: Browser, camera: Node) -> None:
    latched = Camera(camera, '/map', LATCHED)
    latched.publish(77)
    page = browser.new_page(viewer.url)
    page.wait_for('numberOf("/map") === 77')
    page.go(viewer.url)
    page.wait_for('numberOf("/map") === 77')


def test_sentence_of_a_stalled_camera(viewer: Viewer, browser: Browser, camera: Node) -> None:
    front, page = Camera(camera, TOPIC), browser.new_page(viewer.url)
    front.wait_for_viewer()
    sentence = page.wait_for(f'tileOf({TOPIC!r}).querySelector(".reason").textContent')
    assert TOPIC in sentence
    front.show(page, 1)
    page.wait_for(f'tileOf({TOPIC!r}).querySelector(".reason").hidden')
    camera.destroy_publisher(front.publisher)
    sentence = page.wait_for(f'tileOf({TOPIC!r}).querySelector(".reason").textContent')
    assert 'no publisher' in sentence
    assert page.evaluate(f'numberOf({TOPIC!r})') == 1
    assert 'grayscale' in page.evaluate(
        f'getComputedStyle(tileOf({TOPIC!r}).querySelector("canvas")).filter')


def test_range_of_depth(viewer: Viewer, browser: Browser, camera: Node) -> None:
    depth = Camera(camera, '/depth', LATCHED)
    image = np.repeat(np.array([[0, 1000, 2000, 3000]], np.uint16), 80, 1).repeat(240, 0)
    depth.publish_image(image, '16UC1')
    page = browser.new_page(f'{viewer.url}?topic=/depth&colors=gray')
    grays = ('[0.125, 0.375, 0.625, 0.875].map('
             '(x) => pixel(tileOf("/depth").querySelector("canvas"), x, 0.5)[0])')
    page.wait_for('numberOf("/depth") >= 0')
    assert page.evaluate(grays) == pytest.approx([0, 0, 128, 255], abs=3)  # 0 is unknown
    page.wait_for('document.getElementById("range").offsetWidth > 0')
    page.evaluate('document.getElementById("automatic").click()')
    for name, value in (('low', 1000), ('high', 2000)):
        page.evaluate(f'document.getElementById("{name}").value = {value}; '
                      f'document.getElementById("{name}").dispatchEvent('
                      'new Event("change", {bubbles: true}))')
    page.wait_for(f'Math.abs({grays}[2] - 255) < 4')
    assert page.evaluate(grays) == pytest.approx([0, 0, 255, 255], abs=3)
    assert page.evaluate('new URL(location).searchParams.get("range")') == '1000,2000'
    page.go(page.evaluate('location.href'))
    page.wait_for('numberOf("/depth") >= 0')
    assert page.evaluate(grays) == pytest.approx([0, 0, 255, 255], abs=3)


def test_colours_of_depth(viewer: Viewer, browser: Browser, camera: Node) -> None:
    depth = Camera(camera, '/depth', LATCHED)
    image = np.repeat(np.array([[0.0, 1, 2, 3]], np.float32), 80, 1).repeat(240, 0)
    depth.publish_image(image, '32FC1')
    page = browser.new_page(f'{viewer.url}?topic=/depth')
    page.wait_for('document.getElementById("bar").offsetWidth > 0')
    colors = ('[0.125, 0.375, 0.625, 0.875].map('
              '(x) => pixel(tileOf("/depth").querySelector("canvas"), x, 0.5))')
    turbo = cv2.applyColorMap(np.array([[0, 128, 255]], np.uint8), cv2.COLORMAP_TURBO)[0, :, ::-1]
    expected = np.vstack(([[128] * 3], turbo))
    assert np.abs(np.array(page.evaluate(colors)) - expected).max() < 12
    bar = 'document.getElementById("bar").innerText.split(/\\s*\\n\\s*/).join()'
    assert page.evaluate(bar) == '1 m,3 m,no data'
    page.evaluate('document.getElementById("colors").value = "gray"; document.getElementById('
                  '"colors").dispatchEvent(new Event("change", {bubbles: true}))')
    page.wait_for(f'{colors}[3].every((one) => one > 250)')
    assert page.evaluate('new URL(location).searchParams.get("colors")') == 'gray'
    dark = page.evaluate(f'{colors}[0]')
    assert np.abs(np.array(dark) - (0, 0, 110)).max() < 12
    check_all(page)
    page.go(page.evaluate('location.href'))
    page.wait_for('document.getElementById("colors").value === "gray"')
    page.wait_for('numberOf("/depth") >= 0')
    page.wait_for(f'{colors}[3].every((one) => one > 250)')
    assert page.complaints() == []


def test_compressed_depth(viewer: Viewer, browser: Browser, camera: Node) -> None:
    depth = np.full((480, 640), 1234, np.uint16)
    content = bytes(12) + cv2.imencode('.png', depth)[1].tobytes()
    camera.create_publisher(CompressedImage, '/depth/compressedDepth', LATCHED).publish(
        CompressedImage(format='16UC1; compressedDepth png', data=content))
    page = browser.new_page(f'{viewer.url}?topic=/depth/compressedDepth')
    page.wait_for('document.getElementById("bar-low").textContent === "1234 mm"')
    assert page.evaluate('factOf("/depth/compressedDepth", "size")') == '640 \u00d7 480'
    assert page.complaints() == []


def test_depth_of_a_publisher_that_has_topics_of_video(
        viewer: Viewer, browser: Browser, start: Callable[..., NodeProcess]) -> None:
    start('img_publisher', source='pattern:depth:64x48', encoding="''", publish_rate=10.0)
    page = browser.new_page(f'{viewer.url}?topic=/video_frames')
    page.wait_for('document.getElementById("bar-low").textContent.endsWith(" mm")')
    assert page.evaluate('factOf("/video_frames", "size")') == '64 \u00d7 48'
    assert page.complaints() == []


def test_disparity(viewer: Viewer, browser: Browser, camera: Node) -> None:
    numbers = np.full((480, 640), 12.5, np.float32)
    numbers[:, :160], numbers[:, 480:] = -1, 0  # -1 is below the smallest disparity
    image = Image(height=480, width=640, encoding='32FC1', step=2560)
    image.data = array.array('B', numbers.tobytes())
    publisher = camera.create_publisher(DisparityImage, '/disparity', LATCHED)
    publisher.publish(DisparityImage(image=image, min_disparity=0.0, max_disparity=64.0))
    page = browser.new_page(f'{viewer.url}?topic=/disparity')
    page.wait_for('document.getElementById("bar-high").textContent === "12.5 px"')
    assert page.evaluate('document.getElementById("bar-low").textContent') == '0 px'
    assert page.evaluate('factOf("/disparity", "encoding")') == 'disparity'
    colors = ('[0.1, 0.5, 0.9].map('
              '(x) => pixel(tileOf("/disparity").querySelector("canvas"), x, 0.5))')
    none, far, near = page.evaluate(colors)
    assert np.abs(np.array(none) - (128, 128, 128)).max() < 12
    assert np.abs(np.array(far) - (122, 4, 3)).max() < 16  # the last colour of Turbo
    assert np.abs(np.array(near) - (48, 18, 59)).max() < 16  # the first one
    assert page.complaints() == []


def test_equal_limits_are_not_used(viewer: Viewer, browser: Browser, camera: Node) -> None:
    Camera(camera, '/depth', LATCHED).publish_image(np.eye(48, 64, dtype=np.uint16), '16UC1')
    page = browser.new_page(f'{viewer.url}?topic=/depth&range=5,5')
    page.wait_for('document.getElementById("range").offsetWidth > 0')
    assert page.evaluate('document.getElementById("automatic").checked')
    page.go(f'{viewer.url}?topic=/depth&range=1,2')
    page.wait_for('document.getElementById("range").offsetWidth > 0')
    page.evaluate('document.getElementById("high").value = 1; document.getElementById("high")'
                  '.dispatchEvent(new Event("change", {bubbles: true}))')
    assert page.evaluate('document.getElementById("high").validationMessage')
    assert page.evaluate('new URL(location).searchParams.get("range")') == '1,2'


@pytest.mark.parametrize('limits', ['4000,300', '500,1e305', '5', '7,7'])
def test_range_of_the_address_that_is_refused(
        limits: str, viewer: Viewer, browser: Browser, camera: Node) -> None:
    Camera(camera, '/depth', LATCHED).publish_image(np.eye(48, 64, dtype=np.uint16), '16UC1')
    page = browser.new_page(f'{viewer.url}?topic=/depth&range={limits}')
    page.wait_for('numberOf("/depth") >= 0')  # with the automatic range
    page.wait_for('document.getElementById("automatic").checked')
    assert page.evaluate('document.getElementById("notice").textContent') == (
        f'The range {limits} is not used: give two numbers, the lower one first.')
    assert page.complaints() == []


def test_keys_in_a_field(viewer: Viewer, browser: Browser, camera: Node) -> None:
    Camera(camera, '/depth', LATCHED).publish_image(np.eye(48, 64, dtype=np.uint16), '16UC1')
    Camera(camera, '/other')
    page = browser.new_page(f'{viewer.url}?topic=/depth&range=1,2')
    page.wait_for('document.getElementById("range").offsetWidth > 0')
    page.evaluate('document.getElementById("low").focus()')
    for key in (' ', 'ArrowRight'):
        page.press(key)
    assert page.evaluate('document.getElementById("pause").getAttribute("aria-pressed")'
                         ) == 'false'
    assert page.evaluate('document.title').startswith('/depth')
    page.press('Escape')
    assert not page.evaluate('document.title').startswith('/depth')


@pytest.mark.parametrize(('width', 'rendering'), [(4, 'pixelated'), (1280, 'auto')])
def test_pixels_of_an_enlarged_picture(
        width: int, rendering: str, viewer: Viewer, browser: Browser, camera: Node) -> None:
    latched = Camera(camera, '/map', LATCHED)
    latched.publish_image(np.zeros((width, width, 3), np.uint8), 'bgr8')
    page = browser.new_page(f'{viewer.url}?topic=/map')
    page.wait_for('factOf("/map", "size")')
    assert page.evaluate(
        'getComputedStyle(tileOf("/map").querySelector("canvas")).imageRendering') == rendering


def test_picture_of_another_size(viewer: Viewer, browser: Browser, camera: Node) -> None:
    front, page = Camera(camera, TOPIC), browser.new_page(viewer.url)
    front.show(page, 1)
    front.publish_image(numbered_frame(2, 400, 600), 'bgr8')
    page.wait_for(f'numberOf({TOPIC!r}) === 2')
    page.wait_for(f'factOf({TOPIC!r}, "size") === "400 \u00d7 600"')


def test_saved_picture(
        viewer: Viewer, browser: Browser, camera: Node, tmp_path: Path) -> None:
    latched = Camera(camera, '/map', LATCHED)
    latched.publish(0xBEEF, 5 * NANO)
    # A page that asks for video first has a picture that the node forgets as it asks for images.
    page = browser.new_page(f'{viewer.url}?topic=/map', script='delete window.VideoDecoder;')
    browser.call('Browser.setDownloadBehavior', behavior='allow', downloadPath=str(tmp_path))
    page.wait_for('numberOf("/map") === 0xBEEF')
    page.press('s')
    page.wait_for('document.getElementById("notice").textContent')
    assert page.evaluate('document.getElementById("notice").textContent').startswith('Saved map_')
    saved, = wait_until(lambda: [*tmp_path.glob('*.png')])
    assert np.array_equal(cv2.imread(str(saved)), numbered_frame(0xBEEF))


HOSTILE = '<img src=x onerror="window.attacked = true">'


def test_hostile_texts(viewer: Viewer, browser: Browser, camera: Node) -> None:
    page = browser.new_page(viewer.url)
    page.wait_for('document.getElementById("state").dataset.state === "live"')
    names = [f'/{HOSTILE}', '/"><script>window.attacked = true</script>', '/constructor',
             '/__proto__', '/' + 'long_name_' * 20]
    for message in (
            {'topics': [{'id': number, 'name': name, 'transports': ['raw'], 'nodes': [HOSTILE],
                         'publishers': 1} for number, name in enumerate(names)]},
            {'status': [{'id': number, 'name': name, 'width': 64, 'height': 48, 'rate': 1.0,
                         'encoding': HOSTILE, 'frames': 1, 'lost': 0, 'broken': 0, 'sent': None,
                         'link': None, 'range': None, 'quiet': 1.0, 'reason': HOSTILE}
                        for number, name in enumerate(names)]},
            {'error': HOSTILE}):
        page.evaluate(f'sockets[0].onmessage({{data: {json.dumps(json.dumps(message))}}})')
    shown = page.evaluate('[...document.querySelectorAll(".name")].map((one) => one.title)')
    assert sorted(shown) == sorted(names)
    for place in ('[data-fact=encoding] dd', '#notice'):
        assert page.evaluate(f'document.querySelector({place!r}).textContent') == HOSTILE
    page.wait_for(f'[...document.querySelectorAll(".reason")].some('
                  f'(one) => one.textContent.includes({HOSTILE!r}))')
    assert page.evaluate('document.querySelectorAll("img, script:not([src])").length') == 0
    assert page.evaluate('document.documentElement.scrollWidth <= innerWidth')
    assert page.evaluate('window.attacked') is None
