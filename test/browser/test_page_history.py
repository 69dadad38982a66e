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

"""Curves of the last minutes, and restarts of cameras, in the page."""

from __future__ import annotations

from collections.abc import Callable
import signal

from chromium import Browser
from conftest import NodeProcess
from pages import Viewer
from test_page_layout import check_all

pytest_plugins = ['pages']

TOPIC = '/video_frames'
HISTORY = f'tileOf("{TOPIC}").querySelector(".history")'
RESTARTED = f'factOf("{TOPIC}", "restarted")'
#: A history whose clock the test moves, and the points of its curves.
_HISTORY = """
(async () => {
  const { History } = await import('/page/chart.js');
  const element = tileOf('/video_frames').querySelector('.history').cloneNode(true);
  tileOf('/video_frames').append(element);
  const history = new History(element);
  const { now } = performance;
  for (let second = 1000; second < 1700; second += 1) {
    performance.now = () => 1000 * second + 7;
    if (second < 1650 || second > 1659) {
      for (let repeated = 0; repeated < 3; repeated += 1) {
        history.add({ rate: second % 10, lost: second > 1680 ? 8 : 5,
                      restarted: second > 1600 ? second - 1600 : null }, -0.002);
      }
    }
  }
  performance.now = now;
  element.classList.add('tested');
})()
"""


def camera(start: Callable[..., NodeProcess]) -> NodeProcess:
    return start('img_publisher', source='pattern:64x48', publish_rate=20.0)


def test_curves_and_a_camera_that_was_killed(
        start: Callable[..., NodeProcess], viewer: Viewer, browser: Browser) -> None:
    front = camera(start)
    page = browser.new_page(viewer.url)
    page.wait_for(f'numberOf("{TOPIC}") >= 0')
    # The grid asks this once for each second that it collects.
    page.evaluate(f'{HISTORY}.checkVisibility = () => {{ collected += 1; return false; }}; '
                  'globalThis.collected = 0')
    page.wait_for('sent.length && collected > 2')
    page.evaluate(f'delete {HISTORY}.checkVisibility')
    page.evaluate(f'tileOf("{TOPIC}").querySelector(".frame").click()')
    # What the grid has collected is there at once.
    span = page.wait_for(f'/^Last [0-9.]+ s$/.test({HISTORY}.querySelector(".hint").textContent)'
                         f' && {HISTORY}.querySelector(".hint").textContent')
    assert float(span.split()[1]) > 2
    page.wait_for(f'/^Rate [0-9.]+ Hz to [0-9.]+ Hz$/.test('
                  f'{HISTORY}.querySelector("[data-curve=rate]").textContent)')
    page.wait_for(f'/^Age -?[0-9.]+ m?s to [0-9.]+ m?s$/.test('
                  f'{HISTORY}.querySelector("[data-curve=age]").textContent)')
    page.wait_for(f'/^Lost 0 to [0-9]+$/.test('
                  f'{HISTORY}.querySelector("[data-curve=lost]").textContent)')
    check_all(page)
    assert page.evaluate(RESTARTED) is None
    front.interrupt(signal.SIGKILL)
    front.finish()
    camera(start)
    page.wait_for(f'/^[0-9.]+ s ago$/.test({RESTARTED})')
    page.wait_for(f'{HISTORY}.querySelector(".hint").textContent.endsWith(", 1 restart")')
    marks = page.evaluate(f'[...{HISTORY}.querySelectorAll(".restart")]'
                          '.map((one) => one.getAttribute("d"))')
    assert len(marks) == 3 and all(mark.endswith(' 0V100') for mark in marks)
    check_all(page)
    assert page.complaints() == []


def test_curves_are_bounded_and_have_gaps(
        start: Callable[..., NodeProcess], viewer: Viewer, browser: Browser) -> None:
    camera(start)
    page = browser.new_page(f'{viewer.url}?topic={TOPIC}')
    page.wait_for(f'numberOf("{TOPIC}") >= 0')
    page.evaluate(_HISTORY)
    shown = page.evaluate('document.querySelector(".tested").innerText')
    assert ' '.join(shown.split()) == (
        'Rate 0.0 Hz to 9.0 Hz Age -2 ms to -2 ms Lost 0 to 3 Last 5 min, 1 restart')
    rate, restart = page.evaluate('[...document.querySelectorAll(".tested figure:first-child path'
                                  '")].map((one) => one.getAttribute("d"))')
    assert rate.count('M') == 2 and rate.count('L') == 300 - 10 - 2
    assert rate.startswith('M0 100')  # 1400 is the first second that is kept
    assert float(restart[1:].split()[0]) == 256 * 200 / 299
