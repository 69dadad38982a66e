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
"""State of the page: what it says when pictures or messages do not come, or come in disorder."""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise
import signal
import time

from chromium import Browser
from conftest import NodeProcess
import numpy as np
from pages import Camera, Viewer
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from sending import NANO

pytest_plugins = ['pages']

TOPIC = '/video_frames'
LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
STATE = 'document.getElementById("state").textContent'
REASON = f'tileOf("{TOPIC}").querySelector(".reason")'
FILTER = f'getComputedStyle(tileOf("{TOPIC}").querySelector("canvas")).filter'


def test_viewer_that_stands_still(viewer: Viewer, browser: Browser, camera: Node) -> None:
    front, page = Camera(camera, TOPIC), browser.new_page(viewer.url)
    front.show(page, 1)
    viewer.process.interrupt(signal.SIGSTOP)
    page.wait_for(f'{STATE} === "Stalled"')
    assert page.evaluate(f'{REASON}.textContent').startswith('No new picture since ')
    assert page.evaluate(f'{REASON}.offsetHeight') > 0
    page.wait_for(f'{FILTER} === "grayscale(1)"')
    page.wait_for(f'{STATE} === "Reconnecting"')
    assert page.evaluate(f'tileOf("{TOPIC}").classList.contains("quiet")')
    viewer.process.interrupt(signal.SIGCONT)
    page.wait_for(f'{STATE} === "Live"')
    front.show(page, 2)
    page.wait_for(f'{REASON}.hidden')


def test_facts_of_a_node_that_stands_still(
        viewer: Viewer, browser: Browser, camera: Node) -> None:
    front = Camera(camera, TOPIC, LATCHED)
    front.publish_image(np.arange(3072, dtype=np.float32).reshape(48, 64), '32FC1')
    page = browser.new_page(f'{viewer.url}?topic={TOPIC}')
    page.wait_for(f'tileOf("{TOPIC}")?.querySelector("canvas").checkVisibility()')
    page.evaluate(f'tileOf("{TOPIC}").querySelector("[data-look=histogram]").click()')
    page.call('Input.dispatchKeyEvent', type='keyDown', key='ArrowLeft', modifiers=8)
    page.wait_for('[".pixel", ".chart .hint", "#bar-low"].every('
                  '(one) => document.querySelector(one).textContent)')
    colors = ('[".pixel", ".chart .hint", ".facts dd", ".reason", "#bar"].map('
              '(one) => getComputedStyle(document.querySelector(one)).color)')
    gray = ('["#bar", ".chart", ".values"].every((one) => getComputedStyle('
            'document.querySelector(one)).filter === "grayscale(1)")')
    muted = page.evaluate('getComputedStyle(document.getElementById("state")).color')
    assert page.evaluate(f'{colors}.filter((one) => one !== "{muted}").length') == 4
    viewer.process.interrupt(signal.SIGSTOP)
    for state in ('Stalled', 'Reconnecting'):
        page.wait_for(f'{STATE} === "{state}"')
        assert page.evaluate(colors) == [muted] * 5
        assert page.evaluate(gray)
    viewer.process.interrupt(signal.SIGCONT)
    page.wait_for(f'{STATE} === "Live" && {colors}[0] !== "{muted}"')


def test_pings_while_nobody_publishes(viewer: Viewer, browser: Browser) -> None:
    page = browser.new_page(viewer.url)
    page.wait_for('sent.filter((message) => message.ping).length > 8')
    pings = page.evaluate('sent.filter((message) => message.ping).map(({ ping }) => ping)')
    later = pings[5:]  # the first ones measure the clock
    assert min(after - before for before, after in pairwise(later)) < 2  # of "Stalled"


def test_picture_that_is_not_followed_by_another(
        start: Callable[..., NodeProcess], viewer: Viewer, browser: Browser) -> None:
    start('img_publisher', source='pattern:64x48', publish_rate=20.0)
    page = browser.new_page(viewer.url)
    page.wait_for(f'/, [1-9][.0-9]* Hz/.test(factOf("{TOPIC}", "shown"))')
    page.evaluate('drawn.length = 0')
    page.wait_for('drawn.length > 0')  # with the rate of the status
    page.evaluate('{ const { onmessage } = sockets[0]; sockets[0].onmessage = (event) => { '
                  'if (event.data instanceof ArrayBuffer) window.last = () => { '
                  'sockets[0].onmessage = onmessage; onmessage(event); }; else onmessage(event); '
                  '}; }')
    page.wait_for(f'{REASON}.textContent.startsWith("No new picture since ")')
    assert page.evaluate(f'tileOf("{TOPIC}").classList.contains("quiet")')
    page.wait_for('Boolean(window.last)')
    page.evaluate('last()')
    page.wait_for(f'{REASON}.hidden')


def test_pictures_that_come_late(
        start: Callable[..., NodeProcess], viewer: Viewer, browser: Browser) -> None:
    start('img_publisher', source='pattern:64x48', publish_rate=20.0)
    page = browser.new_page(viewer.url)
    page.wait_for(f'/, [1-9][.0-9]* Hz/.test(factOf("{TOPIC}", "shown"))')
    page.evaluate('{ const { onmessage } = sockets[0]; window.late = 3; '
                  'sockets[0].onmessage = (event) => { if (event.data instanceof ArrayBuffer) { '
                  'const head = new DataView(event.data); '
                  'head.setFloat64(16, head.getFloat64(16) - late); } onmessage(event); }; }')
    page.wait_for(f'{REASON}.textContent.startsWith("No new picture since ")')
    page.evaluate('late = 0')
    page.wait_for(f'{REASON}.hidden')


def test_latched_picture_stays_in_colour(viewer: Viewer, browser: Browser, camera: Node) -> None:
    latched = Camera(camera, TOPIC, LATCHED)
    latched.publish(1)
    page = browser.new_page(viewer.url)
    page.wait_for(f'parseFloat(factOf("{TOPIC}", "age")) > 4'
                  f' && factOf("{TOPIC}", "age").endsWith(" s") && {STATE} === "Live"')
    page.wait_for(f'{REASON}.hidden')
    page.wait_for(f'{FILTER} === "none"')


def test_age_by_the_quickest_ping(viewer: Viewer, browser: Browser, camera: Node) -> None:
    front, page = Camera(camera, TOPIC), browser.new_page(viewer.url)
    front.show(page, 1)
    page.evaluate('{ const now = (performance.timeOrigin + performance.now()) / 1000; '
                  'sockets[0].onmessage({data: JSON.stringify({pong: now - 7200, now})}); }')
    front.show(page, 2, time.time_ns() - 3 * 3600 * NANO)
    assert page.wait_for(f'/ h$/.test(factOf("{TOPIC}", "age")) && factOf("{TOPIC}", "age")'
                         ) == '3 h'


def test_older_picture_is_not_drawn(viewer: Viewer, browser: Browser, camera: Node) -> None:
    front, page = Camera(camera, TOPIC), browser.new_page(viewer.url)
    for number in (1, 2):
        front.show(page, number)
    page.evaluate('sent.length = 0; sockets[0].onmessage({data: received[0]})')
    page.wait_for('sent.some((message) => message.got === 1)')
    assert page.evaluate(f'numberOf("{TOPIC}")') == 2


def test_picture_of_a_topic_that_has_ended(
        viewer: Viewer, browser: Browser, camera: Node) -> None:
    front, page = Camera(camera, TOPIC), browser.new_page(viewer.url)
    front.show(page, 1)
    page.evaluate('sent.length = 0; { const data = received[0].slice(0); '
                  'new DataView(data).setUint32(0, 4000000000); sockets[0].onmessage({data}); }')
    page.wait_for('sent.some((message) => message.got === 1)')
    assert page.complaints() == []


def test_picture_of_an_earlier_connection_is_not_drawn(
        start_viewer: Callable[..., Viewer], browser: Browser, camera: Node) -> None:
    viewer = start_viewer()
    front, page = Camera(camera, TOPIC), browser.new_page(viewer.url)
    front.show(page, 1)
    page.evaluate('window.decoding = []; window.decode = createImageBitmap; '
                  'window.createImageBitmap = (...words) => new Promise('
                  '(done) => decoding.push(() => done(decode(...words))));')
    front.publish(2)
    page.wait_for('decoding.length === 1')
    viewer.process.interrupt()
    assert viewer.process.finish() == 0
    page.wait_for(f'{STATE} === "Reconnecting"')
    start_viewer(port=viewer.port)
    page.wait_for(f'{STATE} === "Live"')
    page.evaluate('sent.length = drawn.length = 0; window.createImageBitmap = decode; '
                  'decoding[0]()')
    front.show(page, 3)
    assert page.evaluate('drawn.every(({ number }) => number === 3)')
    assert 'got' not in page.evaluate('document.getElementById("notice").textContent')
