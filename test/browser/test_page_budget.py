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
"""Time that a robot may take from the pictures beside it."""

from __future__ import annotations

from chromium import Browser, Page
from live_robots import RobotNode
from pages import Camera, Viewer
import pytest
from rclpy.node import Node
from test_page_layout import LATCHED
from test_page_live_robot import browser, robot  # noqa: F401

pytest_plugins = ['pages']

DRAWN = 'document.querySelector(".robot iframe").contentWindow.robotView.stage.draws += 1; '
HELD = 'document.querySelector(".robot iframe").dataset.held'
REASON = 'document.querySelector(".robot .reason")'


def block(page: Page, seconds: float) -> None:
    """Keep the page busy, as a robot does that is drawn."""
    page.evaluate('new Promise((done) => setTimeout(() => { const end = performance.now() + '
                  f'{1000 * seconds}; while (performance.now() < end); {DRAWN} done(); }}, 0))')


@pytest.mark.parametrize(('seconds', 'is_stopped'), [(0.2, False), (0.7, True), (1.5, True)])
def test_robot_that_takes_too_long(
        viewer: Viewer, browser: Browser, camera: Node, robot: RobotNode,  # noqa: F811
        seconds: float, is_stopped: bool) -> None:
    Camera(camera, '/front', LATCHED).publish(1)
    page = browser.new_page(viewer.url)
    page.wait_for(f'numberOf("/front") === 1 && {HELD} === "false"')
    page.wait_for(f'Boolean({DRAWN.partition(".stage")[0]}?.stage)')
    for _ in range(3):
        page.wait_for(f'{HELD} === "false"')
        assert page.evaluate(f'{REASON}.hidden')
        block(page, seconds)
        page.wait_for(f'{HELD} === "true"')
    if is_stopped:
        page.wait_for(f'!{REASON}.hidden && {REASON}.checkVisibility()')
        page.evaluate('new Promise((done) => setTimeout(done, 7000))')
        assert page.evaluate(HELD) == 'true'
        assert page.evaluate(f'{REASON}.textContent').endswith('open Robot')
    else:
        page.wait_for(f'{HELD} === "false"')
        assert page.evaluate(f'{REASON}.hidden')
