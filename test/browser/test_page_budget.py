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

STAGE = 'document.querySelector(".robot iframe")?.contentWindow?.robotView?.stage'
HELD = 'document.querySelector(".robot iframe").dataset.held'
REASON = 'document.querySelector(".robot .reason")'
#: Keeps the delays of this machine, so that only those of a test reach the tile of the robot.
TAKE_DELAYS = """
window.delays = [];
if (window === top) import('/page/tiles.js').then(({ Robot }) => {
  const { rest } = Robot.prototype;
  Robot.prototype.rest = function (seconds) {
    delays.push(seconds);
    window.delay = (given) => {
      document.querySelector('.robot iframe').contentWindow.robotView.stage.draws += 1;
      rest.call(this, given);
    };
  };
})
"""


@pytest.fixture
def page(viewer: Viewer, browser: Browser, camera: Node,  # noqa: F811
         robot: RobotNode) -> Page:  # noqa: F811
    """Show the pages of a camera and of a robot, without the delays of this machine."""
    Camera(camera, '/front', LATCHED).publish(1)
    page = browser.new_page(viewer.url, script=TAKE_DELAYS)
    page.wait_for(f'numberOf("/front") === 1 && Boolean({STAGE})')
    block(page, 0.2)
    page.wait_for('Boolean(window.delay)')
    page.wait_for(f'{HELD} === "false"')
    return page


def block(page: Page, seconds: float) -> None:
    """Keep the page busy, as a robot does that is drawn."""
    page.evaluate('new Promise((done) => setTimeout(() => { const end = performance.now() + '
                  f'{1000 * seconds}; while (performance.now() < end); done(); }}, 0))')


@pytest.mark.parametrize('seconds', [0.2, 0.7, 3.1])
def test_delay_of_a_busy_page(page: Page, seconds: float) -> None:
    page.evaluate('delays.length = 0')
    block(page, seconds)
    page.wait_for(f'delays.some((one) => one > {seconds - 0.11})')


@pytest.mark.parametrize(('seconds', 'is_stopped'), [
    (0.1, False), (0.2, False), (0.6, True), (1.5, True)])
def test_robot_that_takes_too_long(page: Page, seconds: float, is_stopped: bool) -> None:
    for place in range(5):  # the second and the fourth are short
        page.wait_for(f'{HELD} === "false"')
        assert page.evaluate(f'{REASON}.hidden')
        page.evaluate(f'delay({0.05 if place % 2 else seconds})')
        assert page.evaluate(HELD) == 'true'
    if is_stopped:
        page.evaluate(f'new Promise((done) => setTimeout(done, {4000 * seconds + 1000}))')
        assert page.evaluate(HELD) == 'true'
        assert page.evaluate(f'{REASON}.checkVisibility()')
        assert page.evaluate(f'{REASON}.textContent').endswith('open Robot')
    else:
        page.wait_for(f'{HELD} === "false"')
        assert page.evaluate(f'{REASON}.hidden')


@pytest.mark.parametrize(('gap', 'pause', 'ratio'), [
    (16, 64, 2), (24, 96, 2), (57, 228, 1), (920, 3680, 1), (3600000, 4000, 1)])
def test_robot_beside_cameras_rests_after_each_drawing(
        page: Page, gap: int, pause: int, ratio: int) -> None:
    page.evaluate(f'window.stage = {STAGE}; stage.draw = () => undefined; stage.wanted = false;'
                  'window.waits = []; window.frame = document.querySelector(".robot iframe");'
                  'frame.contentWindow.setTimeout = (_, wait) => waits.push(wait);'
                  'stage.renderer.setPixelRatio(2); stage.draws = 10; stage.cost = 0;'
                  f'stage.usual = {min(gap, 1000)}; stage.slow({gap}); stage.request()')
    assert page.evaluate('waits[0]') == pause
    assert page.evaluate('stage.renderer.getPixelRatio()') == ratio
    assert page.evaluate('stage.renderer.getContext().getContextAttributes().antialias') is False


def test_robot_alone_draws_at_once(viewer: Viewer, browser: Browser,  # noqa: F811
                                   robot: RobotNode) -> None:  # noqa: F811
    page = browser.new_page(f'{viewer.url}robot/')
    page.wait_for('Boolean(window.robotView?.stage)')
    page.evaluate('window.waits = []; robotView.stage.wanted = false; robotView.stage.cost = 49;'
                  'window.setTimeout = (_, wait) => waits.push(wait); robotView.stage.request()')
    assert page.evaluate('waits[0]') == 0
    assert page.evaluate('robotView.stage.renderer.getContext().getContextAttributes().antialias')
