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

"""The live robot in a browser: beside the cameras, and on a page of its own."""

from __future__ import annotations

from collections.abc import Iterator
import signal
from typing import Any

from chromium import Browser, new_browser, Page
from live_robots import ROBOT, RobotNode
from opencv_tools.robot.kinematics import Kinematics, with_mimics
from opencv_tools.robot.model import FrameId
from opencv_tools.robot.renaming import with_original_names
from opencv_tools.robot.urdf.reader import read_urdf
from opencv_tools.robot.xml.document import parse
from opencv_tools.robot.xml.report import Report
from pages import Camera, SCRIPT, Viewer
import pytest
from rclpy.node import Node
from test_page_layout import check_contrast
from test_page_robot import numbers, OPTIONS, rows, TOLERANCE
from waiting import wait_until

pytest_plugins = ['pages']

SHAPES = ROBOT.replace('<link name="arm"/>', """<link name="arm"><visual><origin xyz="0 0 0.25"/>
<geometry><box size="0.1 0.1 0.5"/></geometry></visual></link>""")
IN_PAGE = 'window.robotView'
IN_TILE = "document.querySelector('.robot iframe')?.contentWindow.robotView"
_POSES = """({view}?.page?.views[0].links ?? []).map(
  ({{ group }}) => [...group.matrixWorld.elements])"""


@pytest.fixture(scope='module')
def browser() -> Iterator[Browser]:
    """Start a browser that draws without a graphics processor."""
    with new_browser(script=SCRIPT, options=OPTIONS) as started:
        yield started


@pytest.fixture
def robot(node: Node) -> RobotNode:
    """Publish a robot."""
    robot = RobotNode(node)
    robot.describe(SHAPES)
    return robot


def expected(position: float) -> list[Any]:
    """Return the poses of the links at a position of the elbow."""
    robot = with_original_names(read_urdf(parse(SHAPES.encode(), '', Report()), Report()))
    positions = {'elbow': [position], 'wrist': [0.0], 'flight': [2.0, 2.0, 1.0, 0.0, 0.0, 0.0]}
    poses = Kinematics(robot).forward(with_mimics(robot, positions))
    return [pytest.approx(numbers(poses[FrameId('link', link.name)]), abs=TOLERANCE)
            for link in robot.links]


def check_poses(page: Page, robot: RobotNode, position: float, view: str = IN_PAGE) -> None:
    """Publish a position until the page draws the links where the kinematics place them."""
    robot.place('base', 'drone', (3, 2, 1), (1, 0, 0, 0))
    wanted = expected(position)

    def is_drawn() -> bool:
        robot.move(['elbow'], [position])
        found = page.evaluate(_POSES.format(view=view))
        return bool(found) and [*map(rows, found)] == wanted

    wait_until(is_drawn, f'the poses at {position}')


def words(page: Page) -> str:
    return str(page.evaluate("document.getElementById('live').textContent"))


@pytest.mark.parametrize('width', [390, 1280])
def test_way_back_to_the_cameras(width: int, browser: Browser, viewer: Viewer,
                                 robot: RobotNode) -> None:
    page = browser.new_page(f'{viewer.url}robot/', width, 844)
    page.wait_for('document.getElementById("back")?.checkVisibility()')
    page.evaluate('document.getElementById("back").click()')
    page.wait_for('Boolean(document.querySelector("#cameras .robot iframe"))')
    page.wait_for(f'Boolean({IN_TILE}?.live)')
    assert not page.evaluate('document.querySelector(".robot iframe").contentDocument'
                             '.getElementById("back").checkVisibility()')


def test_robot_beside_its_cameras(browser: Browser, viewer: Viewer, robot: RobotNode,
                                  node: Node) -> None:
    camera = Camera(node, '/image')
    page = browser.new_page(viewer.url)
    camera.show(page, 7)
    for position in (0.5, -1.25):
        check_poses(page, robot, position, IN_TILE)
    assert page.evaluate(f'{IN_TILE}.page.views[0].motion.positions[1]') == [0.625 + 0.25]
    # The same positions again: nothing is drawn.
    wait_until(lambda: (robot.move(['elbow'], [-1.25]), page.evaluate(
        f'{IN_TILE}.live.state.late === false && !{IN_TILE}.stage.wanted'))[1])
    draws = page.evaluate(f'{IN_TILE}.stage.draws')
    page.evaluate(f'void (window.before = {IN_TILE}.live.state)')
    for _ in range(40):
        robot.move(['elbow'], [-1.25])
        page.evaluate('new Promise((done) => requestAnimationFrame(done))')
    page.wait_for(f'{IN_TILE}.live.state !== window.before')
    assert page.evaluate(f'{IN_TILE}.stage.draws') == draws
    page.evaluate("tileOf('/image').querySelector('a').click()")
    wait_until(lambda: not any(robot.watched()))
    page.press('Escape')
    wait_until(lambda: any(robot.watched()))
    page.press(' ')
    page.wait_for(f'{IN_TILE}.live.isHeld')
    wait_until(lambda: not any(robot.watched()))
    page.press(' ')
    check_poses(page, robot, 1.0, IN_TILE)
    page.evaluate("document.getElementById('show-robot').click()")
    assert page.evaluate("[...document.querySelectorAll('.robot')].length") == 0
    assert 'robot=hidden' in page.evaluate('location.search')
    wait_until(lambda: not any(robot.watched()))
    assert page.complaints() == []


def test_slider_pauses_the_live_robot(browser: Browser, viewer: Viewer, robot: RobotNode) -> None:
    page = browser.new_page(f'{viewer.url}robot/')
    check_poses(page, robot, 0.5)
    page.wait_for("document.getElementById('live').dataset.status === 'live'")
    assert words(page).startswith('Live, ')
    assert page.evaluate("document.getElementById('title').textContent") == 'live'
    page.evaluate("""(() => {
      const [slider] = document.querySelectorAll('.joint input');
      slider.value = 1.5;
      slider.dispatchEvent(new Event('input'));
    })()""")
    assert words(page) == 'Paused'
    robot.move(['elbow'], [0.75])
    page.wait_for('robotView.live.newest.get(0)?.[0] === 0.75')
    assert page.evaluate('robotView.page.views[0].motion.positions[0]') == [1.5]
    page.evaluate("document.getElementById('resume').click()")
    page.wait_for('robotView.page.views[0].motion.positions[0][0] === 0.75')
    page.wait_for("document.getElementById('live').textContent.startsWith('No positions for')")
    assert page.complaints() == []


@pytest.mark.parametrize('messages', [1, 3, 40])
def test_robot_moves_once_for_each_drawing(
        browser: Browser, viewer: Viewer, robot: RobotNode, messages: int) -> None:
    page = browser.new_page(f'{viewer.url}robot/')
    check_poses(page, robot, 0.5)
    page.wait_for('!robotView.stage.wanted')
    assert page.evaluate("""(() => {
      const { page: { views: [one] }, stage, live: { listener } } = robotView;
      let requests = 0;
      stage.request = () => { requests += 1; }; // it is drawn below
      const { update } = one;
      let updates = 0;
      one.update = () => { updates += 1; update.call(one); };
      for (let message = 1; message <= COUNT; message += 1) {
        listener.onMove([[0, [message / 100]]]);
      }
      stage.draw();
      stage.draw();
      requests = 0;
      listener.onMove([[0, [COUNT / 100]]]); // as it is shown
      return [updates, requests, one.motion.positions[0]];
    })()""".replace('COUNT', str(messages))) == [1, 0, [messages / 100]]


def test_positions_of_a_former_robot(browser: Browser, viewer: Viewer, robot: RobotNode) -> None:
    page = browser.new_page(f'{viewer.url}robot/')
    check_poses(page, robot, 0.5)
    assert page.evaluate("""(() => {
      robotView.live.receive({ version: 8, positions: [[1, [0.5]], [2, [1, 0, 0, 0, 0, 0]]] });
      robotView.live.receive({ version: 9, positions: [[0, [0.25]]] });
      return [...robotView.live.newest];
    })()""") == [[0, [0.25]]]


def test_hostile_description(browser: Browser, viewer: Viewer, robot: RobotNode) -> None:
    page = browser.new_page(f'{viewer.url}robot/', width=390, height=844)
    check_poses(page, robot, 0.5)
    markup = '&lt;img src=x onerror="window.ran = 1">'.replace('"', '&quot;')
    robot.describe(f'<robot name="r"><link name="{markup}"></robot>')
    page.wait_for("document.getElementById('notice').textContent.includes('not well-formed')")
    assert page.evaluate('robotView.page.document.robots[0].name') == 'live'
    for scheme in ('light', 'dark'):
        page.prefer(scheme)
        check_contrast(page)
    assert page.evaluate('document.documentElement.scrollWidth') <= 390
    assert page.evaluate('document.documentElement.scrollHeight') <= 844
    robot.describe(f'<robot name="{markup}"><link name="{markup}"/></robot>')
    page.wait_for("document.title.startsWith('<img')")
    robot.move(['<img src=x onerror="window.ran = 1">'], [1])
    page.wait_for("document.getElementById('notice').hidden")
    assert page.evaluate('window.ran') is None
    assert page.evaluate('document.querySelectorAll("img").length') == 0
    assert page.complaints() == []


@pytest.mark.parametrize(('path', 'document'), [
    ('robot/', 'document'),
    ('', 'document.querySelector(".robot iframe").contentDocument')])
def test_viewer_that_stands_still(path: str, document: str, browser: Browser, viewer: Viewer,
                                  robot: RobotNode) -> None:
    page = browser.new_page(f'{viewer.url}{path}')
    check_poses(page, robot, 0.5, IN_TILE if document != 'document' else IN_PAGE)
    live = f'{document}.getElementById("live")'
    color = f'getComputedStyle({document}.querySelector("#stage canvas")).filter'
    wait_until(lambda: (robot.move(['elbow'], [0.5]),
                        page.evaluate(f'{live}.dataset.status === "live"'))[1])
    assert page.evaluate(color) == 'none'
    viewer.process.interrupt(signal.SIGSTOP)
    page.wait_for(f'{live}.textContent === "img_viewer does not answer"')
    assert page.evaluate(f'{live}.dataset.status') == 'silent'
    assert page.evaluate(color) == 'grayscale(1)'
    page.wait_for(f'{live}.textContent === "No connection to img_viewer"')
    assert page.evaluate(color) == 'grayscale(1)'
    viewer.process.interrupt(signal.SIGCONT)
    page.wait_for(f'{live}.textContent.startsWith("No positions")')
    assert page.evaluate(color) == 'none'


def test_end_of_the_viewer(browser: Browser, viewer: Viewer, robot: RobotNode) -> None:
    page = browser.new_page(f'{viewer.url}robot/')
    check_poses(page, robot, 0.5)
    viewer.process.interrupt()
    page.wait_for("document.getElementById('live').textContent === 'No connection to img_viewer'")
