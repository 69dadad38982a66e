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
"""Layout of the page: nothing overlaps, nothing is cut off, all texts can be read and named."""

from __future__ import annotations

from collections.abc import Callable
import json
from pathlib import Path

from chromium import Browser, Page
from conftest import NodeProcess
from live_robots import ROBOT, RobotNode
import numpy as np
from pages import Camera, Viewer
import pytest
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from shown_boards import write_former

pytest_plugins = ['pages']

SIZES = [(1280, 800), (390, 844)]
LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
LEAST_CONTRAST = 4.5  # of WCAG 2, level AA

# What a reader sees: pictures, lines of text and things to press. Texts for screen readers alone
# are clipped to nothing.
_BOXES = """
(() => {
  const boxes = [];
  const add = (name, element, rect) => {
    const clipped = element.closest('[class]')
      && getComputedStyle(element).clipPath !== 'none';
    if (rect.width > 0 && rect.height > 0 && !clipped && element.checkVisibility()) {
      boxes.push({name, left: rect.left, top: rect.top + scrollY, right: rect.right,
                  bottom: rect.bottom + scrollY,
                  pressed: element.closest('a, button, label')?.outerHTML.slice(0, 80) ?? ''});
    }
  };
  for (const element of document.querySelectorAll('canvas, button, .button, input, select')) {
    add(element.tagName + ' ' + (element.id || element.className), element,
        element.getBoundingClientRect());
  }
  const walker = document.createTreeWalker(document.body, NodeFilter.SHOW_TEXT);
  while (walker.nextNode()) {
    const text = walker.currentNode;
    const parent = text.parentElement;
    if (!text.data.trim() || parent.closest('script, noscript, template, option, svg')) continue;
    const range = document.createRange();
    range.selectNodeContents(text);
    const isCut = getComputedStyle(parent).overflow === 'hidden';
    for (const rect of isCut ? [parent.getBoundingClientRect()] : range.getClientRects()) {
      add(text.data.trim().slice(0, 40), parent, rect);
    }
  }
  return boxes;
})()
"""

# Texts with the colours of letters and background, as red, green and blue.
_TOO_WIDE = """
[...document.querySelectorAll('button, .button')].filter((one) => {
  const range = document.createRange();
  range.selectNodeContents(one);
  const [inner, outer] = [range.getBoundingClientRect(), one.getBoundingClientRect()];
  const isClipped = one.id === 'back'; // its word is for screen readers
  return outer.width && !isClipped && (inner.left < outer.left || inner.right > outer.right);
}).map((one) => one.textContent.trim())
"""

_COLORS = """
[...document.querySelectorAll('h1, h2, p, dt, dd, button, a.button, label, kbd, code, output, '
  + 'figcaption, input:not([type=checkbox], [type=range]), select, summary')]
  .filter((element) => element.offsetWidth > 0 && !element.disabled
    && (element.value || element.textContent).trim())
  .map((element) => {
    let around = element;
    while (getComputedStyle(around).backgroundColor === 'rgba(0, 0, 0, 0)') {
      around = around.parentElement;
    }
    const numbers = (text) => text.match(/[0-9.]+/g).slice(0, 3).map(Number);
    return [(element.value || element.textContent).trim().slice(0, 40),
            numbers(getComputedStyle(element).color),
            numbers(getComputedStyle(around).backgroundColor)];
  })
"""


def overlaps(one: dict[str, float], other: dict[str, float]) -> bool:
    """Return whether two boxes have more than a pixel in common."""
    return (min(one['right'], other['right']) - max(one['left'], other['left']) > 1
            and min(one['bottom'], other['bottom']) - max(one['top'], other['top']) > 1)


def check_layout(page: Page, width: int) -> None:
    """Check that no two boxes overlap, except a label within its button, and that all are seen."""
    boxes = page.evaluate(_BOXES)
    assert len(boxes) > 2
    for place, one in enumerate(boxes):
        assert one['left'] >= -0.5 and one['right'] <= width + 0.5, one
        for other in boxes[place + 1:]:
            within = one['pressed'] and one['pressed'] == other['pressed']
            assert within or not overlaps(one, other), (one, other)
    assert page.evaluate('document.documentElement.scrollWidth') <= width
    assert page.evaluate(_TOO_WIDE) == []


def luminance(color: list[float]) -> float:
    """Return the relative luminance of a colour, as defined by WCAG 2."""
    parts = np.array(color) / 255
    linear = np.where(parts <= 0.04045, parts / 12.92, ((parts + 0.055) / 1.055) ** 2.4)
    return float(linear @ (0.2126, 0.7152, 0.0722))


def check_contrast(page: Page) -> None:
    """Check that all texts can be read."""
    texts = page.evaluate(_COLORS)
    assert texts
    for text, color, background in texts:
        dark, bright = sorted((luminance(color), luminance(background)))
        contrast = (bright + 0.05) / (dark + 0.05)
        assert contrast >= LEAST_CONTRAST, (text, color, background, contrast)


def check_names(page: Page) -> None:
    """Check that a screen reader has a name for everything that can be pressed or looked at."""
    page.call('Accessibility.enable')
    nodes = page.call('Accessibility.getFullAXTree')['nodes']
    named = {'button', 'link', 'img', 'switch', 'slider', 'spinbutton', 'combobox', 'textbox'}
    roles = [node['role']['value'] for node in nodes if not node['ignored']]
    assert named & set(roles)
    for node in nodes:
        if not node['ignored'] and node['role']['value'] in named:
            assert node['name']['value'].strip(), node


def check_all(page: Page) -> None:
    """Check the page at both sizes, light and dark."""
    for width, height in SIZES:
        page.resize(width, height)
        page.wait_for(f'innerWidth === {width}')
        page.wait_for_paint()
        check_layout(page, width)
        for scheme in ('light', 'dark'):
            page.prefer(scheme)
            check_contrast(page)
    check_names(page)


#: Visible text of each name that is shown; '' for one that is not whole.
_NAMES = """
[...document.querySelectorAll('.tile:not([hidden]) .name')].map((one) => {
  const range = document.createRange();
  range.selectNodeContents(one);
  const [text, room] = [range, one].map((place) => place.getBoundingClientRect());
  const isWhole = text.left >= room.left - 0.5 && text.right <= room.right + 0.5
    && text.bottom <= room.bottom + 0.5 && room.width > 0;
  return isWhole ? one.textContent : '';
})
"""


@pytest.mark.parametrize('count', [0, 1, 8])
def test_grid(count: int, viewer: Viewer, browser: Browser, camera: Node) -> None:
    cameras = [Camera(camera, f'/camera_{number}/image_raw', LATCHED) for number in range(count)]
    for number, one in enumerate(cameras):
        one.publish(number)
    page = browser.new_page(viewer.url)
    page.wait_for('document.getElementById("state").dataset.state === "live"')
    for number, one in enumerate(cameras):
        page.wait_for(f'numberOf({one.topic!r}) === {number}')
    page.wait_for(f'document.querySelectorAll(".facts div").length >= {count}')
    assert page.evaluate('document.getElementById("empty").hidden') == (count > 0)
    assert page.evaluate('document.querySelector("#empty pre").textContent') == (
        'img_publisher --ros-args -p source:=pattern')  # there is no ros2 in a .venv
    check_all(page)


def test_stalled_camera_and_long_texts(viewer: Viewer, browser: Browser, camera: Node) -> None:
    name = '/' + 'a_camera_with_a_very_long_name/' * 5 + 'image'
    front, rear = Camera(camera, name), Camera(camera, '/rear')
    page = browser.new_page(viewer.url)
    front.show(page, 1)
    rear.show(page, 2)
    camera.destroy_publisher(front.publisher)
    page.wait_for(f'tileOf({name!r}).querySelector(".reason").offsetWidth > 0')
    check_all(page)
    page.evaluate(f'tileOf({name!r}).querySelector(".frame").click()')
    check_all(page)


def test_number_of_unlisted_topics(viewer: Viewer, browser: Browser, camera: Node) -> None:
    Camera(camera, '/front')
    page = browser.new_page(viewer.url)
    page.wait_for('tileOf("/front") !== undefined')
    assert page.evaluate('document.getElementById("more").offsetHeight') == 0
    page.evaluate('sockets[0].onmessage({data: JSON.stringify({more: 801})})')
    assert page.evaluate('document.getElementById("more").textContent').startswith('801 more')
    check_all(page)
    page.evaluate('sockets[0].onmessage({data: JSON.stringify({more: 0})})')
    assert page.evaluate('document.getElementById("more").offsetHeight') == 0


@pytest.mark.parametrize(('many', 'first', 'last'), [
    (['/robot_{0}/camera_{1}/image_rect_color'], 'robot_0/camera_0', 'robot_9/camera_5'),
    (['/fleet/{0}/{1}/image', '/fleet/{0}/depth_{1}/image'], '0/0', '9/depth_2')])
def test_names_of_sixty_tiles(
        viewer: Viewer, browser: Browser, many: list[str], first: str, last: str) -> None:
    names = [name.format(robot, one) for robot in range(10) for name in many
             for one in range(6 // len(many))]
    page = browser.new_page(viewer.url)
    page.wait_for('Boolean(sockets[0]?.onmessage)')
    topics = [{'id': number, 'name': name, 'transports': ['raw'], 'nodes': [], 'publishers': 1}
              for number, name in enumerate(names)]
    page.wait_for('document.getElementById("state").dataset.state === "live"')
    page.evaluate(f'sockets[0].onmessage({{data: {json.dumps(json.dumps({"topics": topics}))}}})')
    page.wait_for('document.querySelectorAll(".tile").length === 60')
    for width, height in (*SIZES, (1920, 1080), (700, 500)):
        page.resize(width, height)
        page.wait_for(f'innerWidth === {width}')
        for size in ('', '200', '400', '800'):
            page.evaluate(f'document.getElementById("size").value = {size!r}; '
                          'document.getElementById("size").dispatchEvent(new Event("input", '
                          '{bubbles: true}))')
            page.wait_for_paint()
            shown = page.evaluate(_NAMES)
            assert len({*shown}) == 60 and '' not in shown, (width, size)
            assert (shown[0], shown[-1]) == (first, last)
    assert page.evaluate(f'tileOf({names[7]!r}).querySelector(".name").title') == names[7]


def test_long_names_without_what_they_have_in_common(
        viewer: Viewer, browser: Browser, camera: Node) -> None:
    folder = '/' + 'a_camera_with_a_very_long_name/' * 5
    for name in ('image_raw', 'image_rectified'):
        Camera(camera, folder + name)
    page = browser.new_page(viewer.url)
    page.wait_for('document.querySelectorAll(".tile").length === 2')
    assert page.evaluate(_NAMES) == ['image_raw', 'image_rectified']
    page.evaluate(f'tileOf({folder + "image_rectified"!r}).querySelector(".frame").click()')
    for width, height in SIZES:
        page.resize(width, height)
        page.wait_for(f'innerWidth === {width}')
        assert page.evaluate('document.getElementById("title").textContent') == 'image_rectified'
        check_layout(page, width)
    page.resize(800, 600)
    page.wait_for('innerWidth === 800')
    assert page.evaluate('document.getElementById("back").offsetHeight'
                         ' === document.getElementById("pause").offsetHeight')  # one line


@pytest.mark.parametrize('width', [390, 720, 1000, 1440])
@pytest.mark.parametrize('path', ['', '?topic=/robot_front/camera_left/image_rect_color'])
def test_lines_of_a_name_end_after_a_word(
        path: str, width: int, viewer: Viewer, browser: Browser, camera: Node) -> None:
    for side in ('left', 'right_and_rear'):
        Camera(camera, f'/robot_front/camera_{side}/image_rect_color', LATCHED).publish(1)
    page = browser.new_page(f'{viewer.url}{path}', width, 800)
    page.wait_for('document.querySelectorAll(".tile:not([hidden]) canvas:not([hidden])").length')
    words = page.evaluate("""[...document.querySelectorAll('#title, .name')]
      .filter((one) => one.checkVisibility()).flatMap((one) => [...one.childNodes])
      .filter((one) => one.data).map((one) => {
        const range = document.createRange();
        range.selectNodeContents(one);
        return [one.data, new Set([...range.getClientRects()].map((rect) => rect.top)).size];
      })""")
    assert len(words) > 1
    assert [word for word, lines in words if lines > 1] == []


def test_long_reason_begins_with_the_cause(viewer: Viewer, browser: Browser, camera: Node) -> None:
    name = '/' + 'a_camera_with_a_very_long_name/' * 5 + 'image'
    front, rear = Camera(camera, name), Camera(camera, '/rear')
    page = browser.new_page(viewer.url)
    front.show(page, 1)
    rear.show(page, 2)
    camera.destroy_publisher(front.publisher)
    reason = f'tileOf({name!r}).querySelector(".reason")'
    page.wait_for(f'{reason}.textContent.includes("no publisher")')
    assert page.evaluate(f'{reason}.textContent').startswith('no publisher on ')
    assert page.evaluate(f'{reason}.scrollWidth <= {reason}.clientWidth')
    assert page.evaluate(f'{reason}.clientHeight > 2 * parseFloat(getComputedStyle({reason})'
                         '.lineHeight)')
    assert page.evaluate(f'{reason}.closest("a").ariaLabel.includes({reason}.textContent)')
    assert page.evaluate(f'tileOf({name!r}).querySelector(".frame").title'
                         f' === {reason}.textContent')
    page.evaluate(f'tileOf({name!r}).querySelector(".frame").click()')
    assert page.evaluate(f'{reason}.scrollWidth <= {reason}.clientWidth')
    assert page.evaluate(f'{reason}.scrollHeight <= {reason}.clientHeight')


def test_one_camera_with_range(viewer: Viewer, browser: Browser, camera: Node) -> None:
    depth = Camera(camera, '/depth', LATCHED)
    depth.publish_image(np.arange(320 * 240, dtype=np.uint16).reshape(240, 320), '16UC1')
    Camera(camera, '/other')
    page = browser.new_page(f'{viewer.url}?topic=/depth')
    page.wait_for('document.getElementById("range").offsetWidth > 0')
    check_all(page)


def test_one_camera_with_controls(
        start: Callable[..., NodeProcess], start_viewer: Callable[..., Viewer],
        browser: Browser) -> None:
    start('img_publisher', source='pattern:64x48', publish_rate=10.0)
    viewer = start_viewer(control=True)
    page = browser.new_page(f'{viewer.url}&topic=/video_frames')
    page.wait_for('document.querySelectorAll("#controls [type=range]").length > 0')
    check_all(page)
    page.evaluate('document.querySelector("details").open = true')
    check_all(page)


def test_all_buttons_of_a_camera(
        start: Callable[..., NodeProcess], start_viewer: Callable[..., Viewer],
        browser: Browser, tmp_path: Path) -> None:
    start('img_publisher', source='pattern:64x48', publish_rate=10.0, rectify='true',
          camera_info_url=write_former(tmp_path / 'camera.yaml', 60.0, (64, 48)))
    viewer = start_viewer(control=True)
    page = browser.new_page(f'{viewer.url}&topic=/video_frames')
    page.wait_for('document.querySelectorAll(":is(#tools, #more-tools) > :not([hidden], .all)")'
                  '.length === 12')
    page.wait_for('document.querySelectorAll("#controls [type=range]").length > 0')
    check_all(page)
    tops = page.evaluate('[...document.querySelectorAll("#tools > :not([hidden], .all)")].map('
                         '(one) => one.getBoundingClientRect().top)')
    assert max(tops.count(top) for top in tops) <= 4


@pytest.mark.parametrize(('width', 'height', 'size', 'least'), [
    (1280, 800, (1280, 720), 0.6), (1280, 800, (640, 480), 0.6), (1920, 1080, (1280, 720), 0.7),
    (2560, 1440, (1920, 1080), 0.7)])
def test_part_of_the_window_with_the_picture(
        viewer: Viewer, browser: Browser, camera: Node, width: int, height: int,
        size: tuple[int, int], least: float) -> None:
    front = Camera(camera, '/front', LATCHED)
    front.publish_image(np.zeros((*size[::-1], 3), np.uint8), 'bgr8')
    Camera(camera, '/rear')
    page = browser.new_page(f'{viewer.url}?topic=/front', width=width, height=height)
    frame = 'tileOf("/front").querySelector(".frame").getBoundingClientRect()'
    page.wait_for(f'(({{width, height}}) => width * height)({frame}) '
                  f'>= {least} * {width * height}')
    page.press('i')
    page.wait_for('!tileOf("/front").querySelector(".facts").checkVisibility()')
    page.press('i')
    page.wait_for('tileOf("/front").querySelector(".facts").checkVisibility()')
    page.press('?')
    page.wait_for('document.getElementById("keys").checkVisibility()')
    check_contrast(page)
    page.press('Escape')  # closes the keys, and stays with the camera
    page.wait_for('!document.getElementById("keys").checkVisibility()')
    assert page.evaluate('document.title').startswith('/front')


def test_page_that_asks_for_the_token(
        start_viewer: Callable[..., Viewer], browser: Browser) -> None:
    viewer = start_viewer(token='a-secret-text')
    page = browser.new_page(viewer.url.partition('?')[0])
    assert page.evaluate('document.title') == 'Token needed'
    check_all(page)


def test_all_of_a_picture_is_on_the_screen(viewer: Viewer, browser: Browser, camera: Node) -> None:
    front = Camera(camera, '/portrait', LATCHED)
    front.publish_image(np.zeros((1200, 300, 3), np.uint8), 'bgr8')
    page = browser.new_page(f'{viewer.url}?topic=/portrait')
    page.wait_for('factOf("/portrait", "size") === "300 \u00d7 1200"')
    for width, height in SIZES:
        page.resize(width, height)
        page.wait_for(f'innerWidth === {width} && tileOf("/portrait").getBoundingClientRect()'
                      f'.bottom <= {height} '
                      '&& tileOf("/portrait").querySelector("canvas").offsetWidth > 100')


def test_picture_of_a_phone(start_viewer: Callable[..., Viewer], browser: Browser, camera: Node,
                            tmp_path: Path) -> None:
    Camera(camera, '/front', LATCHED).publish(1)
    viewer = start_viewer(control=True, record_dir=tmp_path)
    page = browser.new_page(f'{viewer.url}&topic=/front', 390, 844)
    page.wait_for('numberOf("/front") === 1')
    wide = ('tileOf("/front").querySelector(".frame").offsetWidth'
            ' === document.getElementById("cameras").clientWidth')
    page.press('h')
    page.press('c')
    page.wait_for(f'document.title.startsWith("●") && {wide}')
    page.press(' ')
    page.wait_for('sent.some((message) => message.held)')
    page.press(',')
    page.wait_for('tileOf("/front").querySelector("output.step").textContent !== ""')
    page.wait_for(f'innerWidth === 390 && {wide}')
    check_layout(page, 390)


def test_large_screen(viewer: Viewer, browser: Browser, camera: Node) -> None:
    for number in range(8):
        image = np.full((720, 1280), 1000 + number, np.uint16)
        Camera(camera, f'/depth_{number}', LATCHED).publish_image(image, '16UC1')
    page = browser.new_page(viewer.url, 1920, 1080)
    page.wait_for('[...document.querySelectorAll(".tile canvas")].filter('
                  '(one) => !one.hidden && one.offsetWidth > 400).length === 8')
    check_layout(page, 1920)
    assert page.evaluate('document.documentElement.scrollHeight') <= 1080  # all are seen
    page.evaluate('tileOf("/depth_3").querySelector(".frame").click()')
    page.wait_for('document.getElementById("range").offsetWidth > 0')
    page.wait_for('tileOf("/depth_3").querySelector(".history").checkVisibility()')
    page.wait_for('tileOf("/depth_3").querySelector("canvas").getBoundingClientRect().width'
                  ' > 1100')
    check_layout(page, 1920)
    assert page.evaluate('tileOf("/depth_3").getBoundingClientRect().bottom') <= 1080


@pytest.mark.parametrize('width', [720, 1000, 1280, 1920])
@pytest.mark.parametrize('path', ['?', '?topic=/front', '?topic=/front&beside=/rear'])
def test_head_with_all_buttons(path: str, width: int, start_viewer: Callable[..., Viewer],
                               browser: Browser, node: Node, tmp_path: Path) -> None:
    for name in ('/front', '/rear'):
        Camera(node, name, LATCHED).publish(1)
    RobotNode(node).describe(ROBOT)
    viewer = start_viewer(control=True, record_dir=tmp_path)
    base, _, token = viewer.url.partition('?')
    page = browser.new_page(f'{base}{path}&{token}', width, 800)
    page.wait_for('numberOf("/front") === 1 && !document.getElementById("record").hidden'
                  ' && !document.getElementById("plain-link").hidden')
    if path == '?':
        page.wait_for('!document.getElementById("show-robot").hidden')
    page.wait_for(f'document.documentElement.scrollWidth <= {width}')
    check_layout(page, width)
    words = page.evaluate('document.querySelector("header").dataset.words')
    assert words == 'all' or width < 1920
    if path == '?topic=/front' and width >= 1280:
        assert page.evaluate('document.querySelector("#previous span").offsetWidth') > 0
    page.resize(1920, 800)
    page.wait_for('document.querySelector("header").dataset.words === "all"')
