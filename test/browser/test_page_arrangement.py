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
"""Arrangement of the tiles: search, order, hiding, sizes, two side by side, turned and flipped."""

from __future__ import annotations

from collections.abc import Callable
import json

from chromium import Browser, Page
import numpy as np
from pages import Camera, Viewer
import pytest
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from test_page_layout import check_all
from test_page_look import move, VALUE

pytest_plugins = ['pages']

LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
#: Visible tiles in their order.
TILES = ('[...document.querySelectorAll(".tile")].filter((one) => one.offsetParent !== null)'
         '.map((one) => one.dataset.topic).join()')
SEARCH = 'new URL(location).search'
KEPT = 'localStorage.getItem("opencv_tools.viewer")'
HOSTILE = '<img src=x onerror="window.attacked = true">'


@pytest.fixture
def page(viewer: Viewer, browser: Browser, camera: Node) -> Page:
    """Open the page of four cameras."""
    for name in 'abcd':
        Camera(camera, f'/{name}', LATCHED).publish(7)
    opened = browser.new_page(viewer.url)
    opened.wait_for(f'{TILES} === "/a,/b,/c,/d"')
    for name in 'abcd':
        opened.wait_for(f'numberOf("/{name}") === 7')
    return opened


def write(page: Page, field: str, text: str) -> None:
    """Write into a field, or choose in a menu."""
    page.evaluate(f'(() => {{ const field = document.getElementById({field!r}); '
                  f'field.value = {json.dumps(text)}; '
                  'for (const name of ["input", "change"]) '
                  'field.dispatchEvent(new Event(name, {bubbles: true})); })()')


def press_button(page: Page, topic: str, name: str) -> None:
    """Press the button of a tile."""
    page.evaluate(f'tileOf({topic!r}).querySelector("[data-arrange={name}]").click()')


def drag_of(topic: str) -> str:
    """Return the script that drags a topic."""
    return (f'tileOf({topic!r}).querySelector(".head").dispatchEvent('
            'new DragEvent("dragstart", options));')


def drop(page: Page, element: str, script: str) -> None:
    """Drop what a script has dragged onto an element."""
    page.evaluate('(() => { const dataTransfer = new DataTransfer(); '
                  'const options = { bubbles: true, cancelable: true, dataTransfer }; '
                  f'{script} {element}.dispatchEvent('
                  'new DragEvent("drop", options)); })()')


def test_pins_and_hidden_topics_are_kept(page: Page, viewer: Viewer) -> None:
    press_button(page, '/c', 'pin')
    assert page.evaluate(TILES) == '/c,/a,/b,/d'
    page.evaluate('tileOf("/d").querySelector(".frame").focus()')
    page.press('p')
    assert page.evaluate(TILES) == '/c,/d,/a,/b'
    assert page.evaluate('document.activeElement.closest(".tile").dataset.topic') == '/d'
    press_button(page, '/a', 'hide')
    assert page.evaluate(TILES) == '/c,/d,/b'
    page.wait_for('sent.some((message) => message.unsubscribe === "/a")')
    assert page.evaluate(SEARCH) == '?pin=%2Fc&pin=%2Fd&hide=%2Fa'
    check_all(page)
    page.go(viewer.url)  # the browser remembers it
    page.wait_for(f'{TILES} === "/c,/d,/b"')
    page.evaluate('tileOf("/d").querySelector(".frame").click()')
    page.press('ArrowRight')
    assert page.evaluate('document.title').startswith('/b')  # the hidden one is left out
    page.press('Escape')
    page.evaluate('document.getElementById("unhide").click()')
    assert page.evaluate(TILES) == '/c,/d,/a,/b'
    page.go(f'{viewer.url}?pin=/b')  # the address is stronger
    page.wait_for(f'{TILES} === "/b,/a,/c,/d"')
    assert page.complaints() == []


def test_order_by_dragging(page: Page, viewer: Viewer) -> None:
    press_button(page, '/c', 'pin')
    for topic, before, order in (
            ('/d', '/c', '/d,/c,/a,/b'), ('/b', '/c', '/d,/b,/c,/a'), ('/d', '/a', '/b,/c,/d,/a'),
            ('/b', '/b', '/b,/c,/d,/a')):
        drop(page, f'tileOf({before!r})', drag_of(topic))
        assert page.evaluate(TILES) == order
    drop(page, 'document.getElementById("cameras")', drag_of('/b'))  # beside the tiles
    drop(page, 'tileOf("/a")', f'dataTransfer.setData("text/plain", {json.dumps(HOSTILE)});')
    assert page.evaluate(TILES) == '/b,/c,/d,/a'
    assert page.evaluate(SEARCH) == '?pin=%2Fb&pin=%2Fc&pin=%2Fd'


def test_order_by_dragging_without_pins(page: Page, viewer: Viewer) -> None:
    press_button(page, '/b', 'hide')
    write(page, 'search', '/')
    drop(page, 'tileOf("/c")', drag_of('/d'))
    assert page.evaluate(TILES) == '/a,/d,/c'
    page.evaluate('document.getElementById("unhide").click()')
    assert page.evaluate(TILES) == '/a,/b,/d,/c'
    page.go(viewer.url)
    page.wait_for(f'{TILES} === "/a,/b,/d,/c"')


def test_arrangement_of_a_link_is_not_kept(
        page: Page, viewer: Viewer, browser: Browser) -> None:
    press_button(page, '/c', 'pin')
    other = browser.new_page(f'{viewer.url}?turn=/a:1&search=/')
    other.wait_for(f'{TILES} === "/a,/b,/c,/d"')
    assert page.evaluate(KEPT) == 'pin=%2Fc'
    press_button(page, '/b', 'pin')
    other.go(other.evaluate('location.href'))
    other.wait_for(f'{TILES} === "/a,/b,/c,/d"')
    assert page.evaluate(KEPT) == 'pin=%2Fc&pin=%2Fb'
    press_button(other, '/d', 'hide')
    press_button(other, '/a', 'pin')
    assert other.evaluate(SEARCH) == '?search=%2F&pin=%2Fa&hide=%2Fd&turn=%2Fa%3A1'
    assert page.evaluate(KEPT) == 'hide=%2Fd&pin=%2Fc&pin=%2Fb&pin=%2Fa'
    page.go(viewer.url)
    page.wait_for(f'{TILES} === "/c,/b,/a"')


def test_long_arrangement_is_bounded(page: Page, viewer: Viewer) -> None:
    page.evaluate('localStorage.setItem("opencv_tools.viewer", new URLSearchParams(Array.from('
                  '{length: 300}, (_, place) => ["pin", "/" + "camera".repeat(7) + place])))')
    for url in (viewer.url, 'location.href'):
        page.go(page.evaluate(url) if url == 'location.href' else url)
        page.wait_for(f'{TILES} === "/a,/b,/c,/d"')
        assert 3900 < page.evaluate(f'{SEARCH}.length') <= 4001
    assert page.evaluate(SEARCH).endswith('camera299')
    press_button(page, '/c', 'pin')
    assert page.evaluate(f'{KEPT}.length') <= 4000
    assert page.evaluate(SEARCH).endswith('&pin=%2Fc')


def test_sentence_of_a_page_that_shows_no_topic(page: Page) -> None:
    none = 'document.getElementById("none").offsetHeight > 0'
    assert not page.evaluate(none)
    write(page, 'search', 'nothing')
    assert page.evaluate(none)
    check_all(page)
    write(page, 'search', '')
    assert not page.evaluate(none)
    for name in 'abcd':
        press_button(page, f'/{name}', 'hide')
    assert page.evaluate(none)


def test_names_of_small_tiles(viewer: Viewer, browser: Browser, camera: Node) -> None:
    topic = '/camera_front_left/image_raw'
    for name in (topic, *'abcde'):
        Camera(camera, name)
    page = browser.new_page(f'{viewer.url}?size=200')
    page.wait_for(f'{TILES}.split(",").length === 6')
    name = f'tileOf({topic!r}).querySelector(".name")'
    page.wait_for(f'tileOf({topic!r}).offsetWidth < 260')
    assert page.evaluate(f'{name}.textContent') == topic[1:]
    check_all(page)


def test_search_and_size(page: Page, camera: Node) -> None:
    write(page, 'search', 'B')
    assert page.evaluate(TILES) == '/b'
    for name in 'acd':
        page.wait_for(f'sent.some((message) => message.unsubscribe === "/{name}")')
    page.evaluate('document.getElementById("search").focus()')
    page.press('p')  # a letter of the search
    assert page.evaluate(SEARCH) == '?search=Bp'
    assert page.evaluate(KEPT) in (None, '')
    write(page, 'search', '')
    assert page.evaluate(TILES) == '/a,/b,/c,/d'
    widths = []
    for size in ('200', '400', '800'):
        write(page, 'size', size)
        page.evaluate('new Promise((done) => requestAnimationFrame(done))')
        widths.append(page.evaluate('tileOf("/a").offsetWidth'))
    assert widths == sorted(set(widths)) and widths[0] >= 200 and widths[2] >= 800
    assert page.evaluate(SEARCH) == '?size=800'
    check_all(page)


def test_many_topics_and_the_visible_ones(
        viewer: Viewer, browser: Browser, camera: Node) -> None:
    for number in range(120):
        Camera(camera, f'/camera_{number:03}', LATCHED)
    page = browser.new_page(viewer.url)
    page.wait_for(f'{TILES}.split(",").length === 120')
    write(page, 'size', '800')
    asked = ('[...new Set(sent.filter((one) => one.subscribe).map((one) => one.subscribe))]'
             '.filter((name) => sent.findLast('
             '(one) => (one.subscribe ?? one.unsubscribe) === name).subscribe)')
    page.wait_for(f'{asked}.length > 0 && {asked}.length <= 6')
    write(page, 'search', '_11')
    page.wait_for(f'{TILES}.split(",").length === 10')
    page.wait_for(f'{asked}.every((name) => name.includes("_11"))')


@pytest.mark.parametrize('turns', range(4))
@pytest.mark.parametrize(('width', 'height'), [(300, 60), (60, 300), (96, 90)])
def test_turned_picture_fills_its_frame(turns: int, width: int, height: int, viewer: Viewer,
                                        browser: Browser, camera: Node) -> None:
    Camera(camera, '/front', LATCHED).publish_image(
        np.zeros((height, width, 3), np.uint8), 'bgr8')
    page = browser.new_page(f'{viewer.url}?topic=/front&turn=/front:{turns}', 1000, 700)
    page.wait_for('document.querySelector(".tile canvas")?.hidden === false')
    page.wait_for("""(() => {
      const canvas = document.querySelector('.tile canvas');
      const [one, frame] = [canvas, canvas.closest('.frame')].map(
        (each) => each.getBoundingClientRect());
      const share = Math.max(one.width / frame.width, one.height / frame.height);
      return Math.abs(share - 1) < 0.01;
    })()""")


def test_turned_and_flipped_picture(viewer: Viewer, browser: Browser, camera: Node) -> None:
    image = np.random.default_rng(2).integers(0, 256, (48, 64, 3), np.uint8)
    Camera(camera, '/front', LATCHED).publish_image(image, 'bgr8')
    page = browser.new_page(f'{viewer.url}?topic=/front')
    page.wait_for('factOf("/front", "zoom")')
    for key, turned in (('t', np.rot90(image, -1)), ('m', np.rot90(image, -1)[:, ::-1]),
                        ('t', np.rot90(np.rot90(image, -1)[:, ::-1], -1))):
        page.press(key)
        page.evaluate('new Promise((done) => setTimeout(done, 1200))')
        left, top, width, height = page.evaluate(
            '(({left, top, width, height}) => [left, top, width, height])('
            'tileOf("/front").querySelector("canvas").getBoundingClientRect())')
        rows, columns = turned.shape[:2]
        assert width / height == pytest.approx(columns / rows, rel=0.01)
        for x, y in ((0, 0), (5, 30)):
            move(page, {'x': left + (x + 0.5) * width / columns,
                        'y': top + (y + 0.5) * height / rows})
            text = ', '.join(f'{name} {value}'
                             for name, value in zip('BGR', turned[y, x], strict=True))
            page.wait_for(f'{VALUE}.endsWith(": {text}")')
    assert page.evaluate('new URL(location).searchParams.get("turn")') == '/front:0f'
    page.press('+')
    page.wait_for('sent.at(-1).region || sent.some((one) => one.region)')
    page.go(page.evaluate('location.href'))
    page.wait_for('tileOf("/front").querySelector("canvas").style.transform'
                  '.startsWith("matrix(-")')
    assert page.complaints() == []


def test_two_topics_with_one_cursor(viewer: Viewer, browser: Browser, camera: Node) -> None:
    front, rear = (np.random.default_rng(seed).integers(0, 256, (480, 640, 3), np.uint8)
                   for seed in (3, 4))
    Camera(camera, '/front', LATCHED).publish_image(front, 'bgr8')
    Camera(camera, '/rear', LATCHED).publish_image(rear, 'bgr8')
    page = browser.new_page(f'{viewer.url}?topic=/front')
    page.wait_for('factOf("/front", "zoom")')
    write(page, 'beside', '/rear')
    page.wait_for(f'{TILES} === "/front,/rear" && factOf("/rear", "zoom")')
    page.evaluate('new Promise((done) => setTimeout(done, 1200))')
    left, top, width, height = page.evaluate(
        '(({left, top, width, height}) => [left, top, width, height])('
        'tileOf("/front").querySelector("canvas").getBoundingClientRect())')
    move(page, {'x': left + 320.5 * width / 640, 'y': top + 100.5 * height / 480})
    for name, image in (('/front', front), ('/rear', rear)):
        text = ', '.join(f'{channel} {value}'
                         for channel, value in zip('BGR', image[100, 320], strict=True))
        shown = f'tileOf({name!r}).querySelector(".pixel").textContent'
        page.wait_for(f'{shown} === "320, 100: {text}"')
    assert page.evaluate('tileOf("/rear").querySelector(".line").getAttribute("d")') != ''
    check_all(page)
    beside = 'new URL(location).searchParams.get("beside")'
    assert page.evaluate(beside) == '/rear'
    page.press('Escape')
    assert page.evaluate(beside) is None
    page.press('Enter')  # of the link to the same picture
    page.wait_for(f'{beside} === "/rear"')
    write(page, 'beside', '')
    page.wait_for(f'{TILES} === "/front"')
    assert page.complaints() == []


def test_link_with_and_without_the_token(
        start_viewer: Callable[..., Viewer], browser: Browser) -> None:
    page = browser.new_page(start_viewer(token='a-secret-text').url)
    page.wait_for('!document.getElementById("plain-link").hidden')
    browser.call('Browser.grantPermissions', permissions=['clipboardReadWrite'])
    plain = page.evaluate('location.origin + "/"')
    for button, notice, copied in (
            ('plain-link', 'Copied the link', plain),
            ('link', 'Copied the link with its token', f'{plain}?token=a-secret-text')):
        page.evaluate(f'document.getElementById({button!r}).focus()')
        page.press('Enter')
        page.wait_for(f'document.getElementById("notice").textContent === {notice!r}')
        assert page.evaluate('navigator.clipboard.readText()') == copied


def test_hostile_arrangement(viewer: Viewer, browser: Browser, camera: Node) -> None:
    Camera(camera, '/front', LATCHED).publish(7)
    words = '&'.join(f'{name}={HOSTILE}' for name in (
        'search', 'size', 'pin', 'hide', 'turn', 'beside')) + '&turn=/front:9f&size=1e9'
    page = browser.new_page(f'{viewer.url}?{words}')
    page.wait_for('document.getElementById("state").dataset.state === "live"')
    page.wait_for('document.getElementById("unhide").hidden === true')
    write(page, 'search', '')
    page.wait_for(f'{TILES} === "/front"')
    assert page.evaluate('document.querySelectorAll("img, script:not([src])").length') == 0
    assert page.evaluate('window.attacked') is None
    page.evaluate(f'localStorage.setItem("opencv_tools.viewer", "size=-5&turn=%00&pin={HOSTILE}")'
                  .replace('"window.attacked = true"', 'x'))
    page.go(viewer.url)
    page.wait_for(f'{TILES} === "/front" && numberOf("/front") === 7')
    assert page.complaints() == []
