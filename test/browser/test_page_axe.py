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
"""The rules of axe-core for people with disabilities, on all pages, light and dark."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from chromium import Browser, Page
from live_robots import RobotNode
from npm import installed
from pages import Camera, Viewer
import pytest
from rclpy.node import Node
from test_page_layout import LATCHED
from test_page_live_robot import browser, robot  # noqa: F401

pytest_plugins = ['pages']

VERSION = '4.14.1'
FOLDER = Path(__file__).parents[2] / 'build' / f'axe-core-{VERSION}'
TOPIC = '/front/image_raw'
#: Addresses below that of the server, and what is true as soon as the page shows everything.
PAGES = {
    'grid': ('', f'numberOf("{TOPIC}") === 1 && tileOf("/dead").querySelector(".reason")'
                 '.textContent'),
    'one': (f'?topic={TOPIC}', f'numberOf("{TOPIC}") === 1 && tileOf("{TOPIC}").querySelector('
                               '"[data-fact=stamp]")'),
    'beside': (f'?topic={TOPIC}&beside=/dead', f'numberOf("{TOPIC}") === 1'),
    'calibrate': (f'calibrate?topic={TOPIC}', f'numberOf("{TOPIC}") === 1'),
    'robot': ('robot/', 'window.robotView?.page'),
    'graph': ('graph', 'document.querySelectorAll("#topics .item").length > 1'),
}
RUN = """
axe.run(document, { iframes: false }).then(({ violations }) => violations.map(
  ({ id, nodes }) => `${id}: ${nodes.map(({ html }) => html).join(' ')}`))
"""


@pytest.fixture(scope='session')
def axe() -> str:
    """Return the source of axe-core, which npm installs at the first time."""
    file = FOLDER / 'node_modules' / 'axe-core' / 'axe.min.js'
    if not file.exists():
        installed(f'axe-core@{VERSION}', FOLDER)
    return file.read_text()


def check_rules(page: Page, axe: str) -> None:
    """Check all rules in both schemes of colours."""
    page.evaluate(f'{axe}; true')
    for scheme in ('light', 'dark'):
        page.prefer(scheme)
        page.wait_for_paint()
        assert page.evaluate(RUN) == [], scheme


@pytest.mark.parametrize('width', [390, 1280])
@pytest.mark.parametrize('name', PAGES)
def test_rules(name: str, width: int, axe: str, start_viewer: Callable[..., Viewer],
               browser: Browser, camera: Node, robot: RobotNode) -> None:  # noqa: F811
    Camera(camera, TOPIC, LATCHED).publish(1)
    Camera(camera, '/dead')
    viewer = start_viewer(control=True)
    path, shown = PAGES[name]
    base, _, token = viewer.url.partition('?')
    page = browser.new_page(f'{base}{path}{"&" if "?" in path else "?"}{token}', width, 844)
    page.wait_for(f'Boolean({shown})')
    check_rules(page, axe)


def test_rules_of_the_page_for_a_token(axe: str, start_viewer: Callable[..., Viewer],
                                       browser: Browser) -> None:  # noqa: F811
    viewer = start_viewer(token='a-secret-text')
    page = browser.new_page(viewer.url.partition('?')[0])
    page.wait_for('document.getElementById("token") !== null')
    check_rules(page, axe)


def test_violation_is_found(axe: str, viewer: Viewer, browser: Browser) -> None:  # noqa: F811
    page = browser.new_page(viewer.url)
    page.evaluate('document.body.append(document.createElement("button")); true')
    with pytest.raises(AssertionError, match='button-name'):
        check_rules(page, axe)
