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

"""The page of a phone, by touch, and what a screen reader says."""

from __future__ import annotations

from collections.abc import Callable

from chromium import Browser, Page
from conftest import NodeProcess
import numpy as np
from pages import Camera, Viewer
import pytest
from rclpy.node import Node
from test_page_arrangement import SEARCH, TILES
from test_page_layout import check_all, LATCHED
from test_page_look import CHART, place_of, random_image, TOPIC, VALUE

pytest_plugins = ['pages']

PHONE = 390, 844
STATE = 'document.getElementById("state").textContent'
ZOOM = f'factOf({TOPIC!r}, "zoom")'
SAID = 'document.getElementById("said").textContent'
LEAST_TARGET = 24  # CSS pixels of WCAG 2.2, level AA

# What can be pressed, with its size; a label is a target for its input.
_TARGETS = """
[...document.querySelectorAll('a[href], button, input, select, summary')]
  .filter((one) => one.checkVisibility())
  .map((one) => one.closest('label') ?? one)
  .map((one) => {
    const { width, height } = one.getBoundingClientRect();
    return [one.outerHTML.slice(0, 120), width, height];
  })
"""


def open_phone(browser: Browser, url: str) -> Page:
    """Open a page on a phone."""
    page = browser.new_page('about:blank', *PHONE)
    page.call('Emulation.setTouchEmulationEnabled', enabled=True, maxTouchPoints=2)
    page.go(url)
    return page


def open_image(viewer: Viewer, browser: Browser, camera: Node, image: np.ndarray) -> Page:
    """Publish an image, and show it alone on a phone."""
    Camera(camera, TOPIC, LATCHED).publish_image(image, 'bgr8')
    page = open_phone(browser, f'{viewer.url}?topic={TOPIC}')
    page.wait_for(ZOOM)
    page.evaluate('new Promise((done) => setTimeout(done, 1200))')  # the tiles have their size
    return page


def tap(page: Page, place: dict[str, float], count: int = 1) -> None:
    """Tap with a finger."""
    for _ in range(count):
        for kind, points in (('touchStart', [place]), ('touchEnd', [])):
            page.call('Input.dispatchTouchEvent', type=kind, touchPoints=points)


def press(page: Page, element: str) -> None:
    """Tap an element that JavaScript returns, where a finger finds it."""
    has_landed = False
    while not has_landed:  # a page that moves under the finger is tapped again, with no effect
        # A finger finds what was drawn last: after the scrolling, in the next picture but one.
        x, y = page.evaluate(f"""(async () => {{
          const one = {element};
          one.scrollIntoView({{ block: 'center' }});
          for (let frame = 0; frame < 2; frame++) await new Promise(requestAnimationFrame);
          window.landed = null;
          document.addEventListener('touchstart', (event) => {{
            window.landed = one.contains(event.target);
            if (!window.landed) event.preventDefault();
          }}, {{ capture: true, once: true, passive: false }});
          const {{ left, top, width, height }} = one.getBoundingClientRect();
          return [left + width / 2, top + height / 2];
        }})()""")
        tap(page, {'x': x, 'y': y})
        page.wait_for('window.landed !== null')
        has_landed = page.evaluate('window.landed')


def swipe(page: Page, begin: dict[str, float], end: dict[str, float]) -> None:
    """Move a finger over the screen."""
    steps = [{name: begin[name] + (end[name] - begin[name]) * part / 8 for name in 'xy'}
             for part in range(9)]
    for place, point in enumerate(steps):
        page.call('Input.dispatchTouchEvent', type='touchMove' if place else 'touchStart',
                  touchPoints=[point])
    page.call('Input.dispatchTouchEvent', type='touchEnd', touchPoints=[])


def values(image: np.ndarray, x: int, y: int) -> str:
    """Return what the page says about a pixel."""
    return f'{x}, {y}: ' + ', '.join(
        f'{name} {value}' for name, value in zip('BGR', image[y, x], strict=True))


def check_targets(page: Page) -> None:
    """Check that a finger hits everything that can be pressed."""
    targets = page.evaluate(_TARGETS)
    assert len(targets) > 3
    assert [one for one in targets if min(one[1:]) < LEAST_TARGET] == []


def check_names(page: Page) -> None:
    """Check that everything that can have the focus has a name, and the landmarks."""
    page.call('Accessibility.enable')
    nodes = [node for node in page.call('Accessibility.getFullAXTree')['nodes']
             if not node['ignored']]
    focusable = [node for node in nodes if any(
        one['name'] == 'focusable' and one['value']['value'] for one in node['properties'])]
    assert len(focusable) > 3
    for node in focusable:
        if node['role']['value'] not in ('RootWebArea', 'Iframe'):
            assert node['name']['value'].strip(), node
    roles = [node['role']['value'] for node in nodes]
    assert [roles.count(role) for role in ('main', 'banner')] == [1, 1]
    assert 'status' in roles and 'heading' in roles


def test_value_zoom_and_pan_by_touch(viewer: Viewer, browser: Browser, camera: Node) -> None:
    image = random_image()
    page = open_image(viewer, browser, camera, image)
    place = place_of(page, 400.5, 300.5)
    tap(page, place)
    shown = page.wait_for(f'{VALUE} !== "" && {VALUE}')
    x, y = (int(one.rstrip(':,')) for one in shown.split()[:2])
    assert (x, y) == (pytest.approx(400, abs=1), pytest.approx(300, abs=1))
    assert shown == values(image, x, y)
    whole = page.evaluate(ZOOM)
    tap(page, place, 2)
    page.wait_for(f'{ZOOM} === "100 %"')
    swipe(page, place, {'x': place['x'] - 80, 'y': place['y'] + 40})
    page.wait_for('sent.some((one) => one.region)')
    tap(page, place)
    # The pixel was under the finger before, and has moved with it.
    page.wait_for(f'{VALUE}.startsWith("{x + 80}, {y - 40}: ")')
    assert page.evaluate(VALUE) == values(image, x + 80, y - 40)
    press(page, 'document.querySelector("[data-look=in]")')
    page.wait_for(f'{ZOOM} === "150 %"')
    tap(page, place, 2)
    page.wait_for(f'{ZOOM} === {whole!r}')
    assert page.evaluate('visualViewport.scale') == 1
    assert page.complaints() == []


def test_line_by_touch(viewer: Viewer, browser: Browser, camera: Node) -> None:
    image = np.zeros((480, 640, 3), np.uint8)
    image[:, 320:] = 250
    page = open_image(viewer, browser, camera, image)
    press(page, 'document.querySelector("[data-look=profile]")')
    page.wait_for(f'{CHART} === "Draw a line in the picture."')
    page.evaluate('new Promise((done) => { scrollTo(0, 0); setTimeout(done, 1200); })')
    swipe(page, place_of(page, 100.5, 240.5), place_of(page, 600.5, 240.5))
    page.wait_for(f'{CHART} === "0 to 250"')
    assert page.evaluate('scrollY') == 0


def test_order_by_touch_and_keys(viewer: Viewer, browser: Browser, camera: Node) -> None:
    for name in 'abc':
        Camera(camera, f'/{name}', LATCHED).publish(7)
    page = open_phone(browser, viewer.url)
    page.wait_for(f'{TILES} === "/a,/b,/c"')

    def button(topic: str, name: str) -> str:
        return f'tileOf({topic!r}).querySelector("[data-arrange={name}]")'

    assert not page.evaluate(f'{button("/a", "earlier")}.checkVisibility()')
    for topic in ('/c', '/b'):
        press(page, button(topic, 'pin'))
    page.wait_for(f'{TILES} === "/c,/b,/a"')
    check_targets(page)
    check_names(page)
    press(page, button('/b', 'earlier'))
    page.wait_for(f'{TILES} === "/b,/c,/a"')
    press(page, button('/b', 'earlier'))  # it is the first one
    press(page, button('/b', 'later'))
    page.wait_for(f'{TILES} === "/c,/b,/a"')
    page.evaluate(f'{button("/c", "later")}.focus()')
    page.press('Enter')
    page.wait_for(f'{TILES} === "/b,/c,/a"')
    assert page.evaluate(f'document.activeElement === {button("/c", "later")}')
    page.press('Enter')  # an unpinned one follows
    assert page.evaluate(TILES) == '/b,/c,/a'
    assert page.evaluate(SEARCH) == '?pin=%2Fb&pin=%2Fc'
    check_all(page)
    assert page.complaints() == []


def test_targets_and_names_of_a_camera(
        start: Callable[..., NodeProcess], start_viewer: Callable[..., Viewer],
        browser: Browser) -> None:
    start('img_publisher', source='pattern:64x48', publish_rate=10.0)
    viewer = start_viewer(control=True)
    page = open_phone(browser, f'{viewer.url}&topic=/video_frames')
    page.wait_for('document.querySelectorAll("#controls [type=range]").length > 0')
    page.evaluate('document.querySelector("details").open = true')
    check_targets(page)
    check_names(page)


def test_targets_of_depth_and_of_the_token(
        start_viewer: Callable[..., Viewer], browser: Browser, camera: Node) -> None:
    depth = np.arange(320 * 240, dtype=np.uint16).reshape(240, 320)
    Camera(camera, TOPIC, LATCHED).publish_image(depth, '16UC1')
    viewer = start_viewer(token='a-secret-text')
    page = open_phone(browser, viewer.url.partition('?')[0])
    assert page.evaluate('document.title') == 'Token needed'
    assert min(page.evaluate(_TARGETS), key=lambda one: min(one[1:]))[2] >= LEAST_TARGET
    page.go(f'{viewer.url}&topic={TOPIC}')
    page.wait_for('document.getElementById("range").offsetWidth > 0')
    check_targets(page)
    check_names(page)


def test_announcements_of_one_camera(
        start: Callable[..., NodeProcess], viewer: Viewer, browser: Browser) -> None:
    topic = '/video_frames'
    camera = start('img_publisher', source='pattern:64x48', publish_rate=20.0)
    page = open_phone(browser, f'{viewer.url}?topic={topic}')
    page.wait_for('drawn.length > 20')
    assert page.evaluate(SAID) == ''
    page.evaluate('window.said = []; for (const name of ["said", "state"]) new MutationObserver('
                  '() => said.push(document.getElementById(name).textContent)).observe('
                  'document.getElementById(name), {childList: true, characterData: true, '
                  'subtree: true})')
    camera.interrupt()
    assert camera.finish() == 0
    reason = page.wait_for(f'{SAID} !== "" && {SAID}')
    assert reason.startswith((f'no publisher on {topic}', 'No new picture since '))
    page.wait_for(f'tileOf({topic!r}).querySelector(".reason").textContent.startsWith("no pub")')
    start('img_publisher', source='pattern:64x48', publish_rate=20.0)
    page.wait_for(f'{SAID} === "Pictures arrive again"')
    press(page, 'document.getElementById("pause")')
    page.wait_for(f'{STATE} === "Paused"')
    said = page.evaluate('said')
    assert len(said) <= 4 and said[-1] == 'Paused'  # a topic that stops again is said again
    press(page, 'document.getElementById("back")')
    page.wait_for('document.body.dataset.view === "all"')
    page.evaluate('said.length = 0; new Promise((done) => setTimeout(done, 3000))')
    assert page.evaluate('said') == []
    for name in ('said', 'state', 'notice'):
        role = page.evaluate(f'document.getElementById({name!r}).role')
        assert role == ('alert' if name == 'notice' else 'status')


def test_targets_of_steps_and_overlays(viewer: Viewer, browser: Browser, camera: Node) -> None:
    front = Camera(camera, TOPIC)
    page = open_phone(browser, f'{viewer.url}?topic={TOPIC}')
    for number in range(3):
        front.show(page, number)
    press(page, 'document.querySelector("[data-look=overlays]")')
    page.wait_for('document.getElementById("overlays").checkVisibility()')
    press(page, 'document.getElementById("pause")')
    page.wait_for('document.getElementById("earlier").checkVisibility()')
    press(page, 'document.getElementById("earlier")')
    page.wait_for(f'numberOf({TOPIC!r}) === 1')
    check_targets(page)
    check_names(page)
    check_all(page)
