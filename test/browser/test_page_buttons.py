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

"""Each button acts on the thing beside it: of two things, the other one does not change."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
import signal

from chromium import Browser, Page, wait_until
from conftest import NodeProcess, recorded_files, spin_until
import cv2
import numpy as np
from opencv_tools.image.encodings import find_encoding
from opencv_tools.image.orientation import orient
from pages import Camera, numbered_frame, Viewer
import pytest
from rclpy.node import Node
from test_page_arrangement import LATCHED, TILES
from test_page_record import images_in
from test_page_steps import open_alone, pause, RawCamera, show_all, TOPIC
from test_page_video import VideoCamera

pytest_plugins = ['pages']

NOTICE = 'document.getElementById("notice").textContent'


def test_picture_that_is_saved(
        viewer: Viewer, browser: Browser, camera: Node, tmp_path: Path) -> None:
    source = RawCamera(camera, TOPIC)
    page = open_alone(viewer, browser, '&turn=/front:2')
    browser.call('Browser.setDownloadBehavior', behavior='allow', downloadPath=str(tmp_path))
    show_all(page, source, 1, 5)
    pause(page)
    source.send(6)
    for key, number in ((',', 4), (',', 3), ('.', 4), (',', 3), (',', 2)):
        page.press(key)
        page.wait_for(f'numberOf({TOPIC!r}) === {number}')
    page.press('s')
    page.wait_for(f'{NOTICE}.startsWith("Saved front_")')
    assert page.evaluate(NOTICE).endswith(
        '_1700000000.200000000.png as the camera has sent it, neither turned nor flipped')
    saved, = wait_until(lambda: [*tmp_path.glob('*.png')])
    image = cv2.imread(str(saved))
    assert np.array_equal(image[:192], numbered_frame(2)[:192])
    assert page.complaints() == []


def test_picture_that_is_not_kept(viewer: Viewer, browser: Browser, camera: Node) -> None:
    source = Camera(camera, TOPIC, LATCHED)
    page = browser.new_page(viewer.url)
    source.show(page, 1)
    page.evaluate(f'tileOf({TOPIC!r}).querySelector(".frame").focus()')
    page.press(' ')
    page.wait_for(f'sent.at(-1).unsubscribe === {TOPIC!r}')
    source.publish(2)
    page.press('s')
    page.wait_for(f'{NOTICE} === "the node has the frame of this picture no more: '
                  'resume the page"')
    page.evaluate('sockets.at(-1).close()')
    page.press('s')
    page.wait_for(f'{NOTICE} === "Not saved, because the page has no connection to the node"')
    assert page.complaints() == []


def test_picture_without_an_answer(viewer: Viewer, browser: Browser, camera: Node) -> None:
    source = RawCamera(camera, TOPIC)
    page = open_alone(viewer, browser, '')
    show_all(page, source, 1, 2)
    pause(page)
    page.evaluate(f"""(notice => {{
      window.notices = [];
      new MutationObserver(() => {NOTICE} && notices.push({NOTICE}))
        .observe(notice, {{ childList: true, characterData: true, subtree: true }});
    }})(document.getElementById("notice"))""")
    viewer.process.interrupt(signal.SIGSTOP)
    page.press('s')
    page.wait_for('sent.some((one) => one.file)')
    page.wait_for('notices.length')
    viewer.process.interrupt(signal.SIGCONT)
    page.wait_for('document.getElementById("state").textContent === "Paused"')
    page.wait_for('document.getElementById("notice").hidden')
    assert page.evaluate('[...new Set(notices)]') == [
        'Not saved, because the page has no connection to the node']
    assert page.complaints() == []


def saved_file(page: Page, browser: Browser, folder: Path, press: str) -> tuple[str, np.ndarray]:
    """Run JavaScript that saves a picture; return the name of the file and its pixels."""
    browser.call('Browser.setDownloadBehavior', behavior='allow', downloadPath=str(folder))
    page.evaluate(press)
    page.wait_for(f'{NOTICE}.startsWith("Saved ")')
    saved, = wait_until(lambda: [*folder.glob('*.png')])
    return saved.name, cv2.imread(str(saved))


def test_picture_of_the_grid_that_is_saved(
        viewer: Viewer, browser: Browser, camera: Node, tmp_path: Path) -> None:
    front, rear = Camera(camera, TOPIC), Camera(camera, '/rear')
    page = browser.new_page(viewer.url)
    front.show(page, 1, 10**9)
    rear.show(page, 2)
    page.evaluate(f'tileOf({TOPIC!r}).querySelector(".frame").focus()')
    name, image = saved_file(page, browser, tmp_path, 'document.activeElement.dispatchEvent('
                             'new KeyboardEvent("keydown", {key: "s", bubbles: true}))')
    assert name == 'front_1.000000000.png'
    assert np.array_equal(image, numbered_frame(1))
    assert page.complaints() == []


@pytest.mark.parametrize(('turn', 'flip', 'degrees'), [
    ('1', 'none', 90), ('2f', 'horizontal', 180), ('3', 'none', 270), ('0f', 'horizontal', 0)])
def test_turned_picture_that_is_saved(
        viewer: Viewer, browser: Browser, camera: Node, tmp_path: Path, turn: str, flip: str,
        degrees: int) -> None:
    source = Camera(camera, TOPIC, LATCHED)
    source.publish(0xA5C3)
    page = browser.new_page(f'{viewer.url}?topic={TOPIC}&turn={TOPIC}:{turn}')
    page.wait_for(f'factOf({TOPIC!r}, "zoom")')
    assert page.evaluate('document.getElementById("save-turned").checkVisibility()')
    _, image = saved_file(page, browser, tmp_path,
                          'document.getElementById("save-turned").click()')
    turned, _ = orient(numbered_frame(0xA5C3), find_encoding('bgr8'), flip, degrees)
    assert np.array_equal(image, turned)
    assert page.evaluate(NOTICE).endswith('_turned.png as it is shown')
    assert page.complaints() == []


@pytest.mark.parametrize('button', ['save', 'save-turned'])
def test_picture_of_a_video_that_is_saved(
        button: str, viewer: Viewer, browser: Browser, camera: Node, tmp_path: Path) -> None:
    front = VideoCamera(camera, TOPIC)
    page = browser.new_page(f'{viewer.url}?topic={TOPIC}&turn={TOPIC}:1f')
    front.show(page, 5)
    name, image = saved_file(
        page, browser, tmp_path, f'document.getElementById({button!r}).click()')
    assert name.startswith('front_1') and page.evaluate(NOTICE).endswith('the decoded video')
    sent = image if button == 'save' else np.rot90(image)[:, ::-1]
    assert np.abs(sent[:192].astype(int) - numbered_frame(5)[:192]).max() < 40


def test_last_seconds_of_a_pause(
        start_viewer: Callable[..., Viewer], browser: Browser, camera: Node, tmp_path: Path,
) -> None:
    source = RawCamera(camera, TOPIC)
    page = open_alone(start_viewer(control=True, record_dir=tmp_path / 'bags'), browser)
    show_all(page, source, 1, 3)
    pause(page)
    other = browser.new_page(page.evaluate('location.href'))  # with the cookie
    show_all(other, source, 4, 6)
    page.wait_for('document.getElementById("keep").checkVisibility()')
    page.evaluate('document.getElementById("keep").click()')
    page.wait_for(f'{NOTICE} === "Recorded 3 frames from memory in " + '
                  f'{NOTICE}.split(" ").at(-1)')
    (bag,) = recorded_files(tmp_path / 'bags')
    for number, image in enumerate(images_in(bag)[TOPIC], 1):
        assert np.array_equal(image[:192], numbered_frame(number)[:192])


def test_camera_that_is_stopped(
        start: Callable[..., NodeProcess], start_viewer: Callable[..., Viewer], browser: Browser,
        camera: Node) -> None:
    cameras = {name: start('img_publisher', '--ros-args', '-r', f'__node:={name}', '-r',
                           f'video_frames:=/{name}', '--', source='pattern:64x48@10')
               for name in ('left', 'right')}
    camera.declare_parameter('gain', 1)
    Camera(camera, '/plain', LATCHED).publish(1)
    viewer = start_viewer(control=True)
    page = browser.new_page(f'{viewer.url}&topic=/left')
    buttons = '[...document.querySelectorAll("#controls button")]'
    page.wait_for(f'{buttons}.map((one) => one.textContent).join() === "Start camera,Stop camera"')
    assert page.evaluate('document.querySelector("#controls h2").textContent') == '/left'
    page.evaluate(f'{buttons}[1].click()')
    page.wait_for(f'{NOTICE} === "paused"')
    page.wait_for('Boolean(tileOf("/plain") && tileOf("/right"))')
    page.evaluate('document.getElementById("next").click()')
    page.wait_for('document.querySelector("#controls h2")?.textContent === "/front/camera"')
    spin_until(camera, lambda: page.evaluate(
        'document.querySelectorAll("#controls label").length') > 0)
    assert page.evaluate(f'{buttons}.length') == 0  # this node has no such service
    assert [one.output.count('paused') for one in cameras.values()] == [1, 0]


def state_of(topic: str) -> str:
    """Return JavaScript for all that the buttons of a tile change."""
    # A chart makes all pictures smaller, so that the scale of a whole picture does not count.
    return ('JSON.stringify([["a", "b", "c", "d"].map((name) => Math.sign(new DOMMatrix('
            f'tileOf({topic!r}).querySelector("canvas").style.transform)[name])), '
            f'tileOf({topic!r}).querySelector(".frame").classList.contains("zoomed"), '
            f'tileOf({topic!r}).querySelector(".chart").hidden, '
            f'[...tileOf({topic!r}).querySelectorAll("[aria-pressed]")]'
            '.map((one) => one.ariaPressed)])')


@pytest.mark.parametrize('way', ['in', 'one', 'turn', 'flip', 'profile', 'histogram', 'exposed'])
def test_tile_beside_another_one(
        way: str, viewer: Viewer, browser: Browser, camera: Node) -> None:
    for topic in (TOPIC, '/rear'):
        Camera(camera, topic, LATCHED).publish(7)
    page = browser.new_page(f'{viewer.url}?topic={TOPIC}&beside=/rear')
    page.wait_for(f'factOf({TOPIC!r}, "zoom") && factOf("/rear", "zoom")')
    for own, other in (('/rear', TOPIC), (TOPIC, '/rear')):
        page.wait_for_paint()
        before, others = page.evaluate(state_of(own)), page.evaluate(state_of(other))
        page.evaluate(f'tileOf({own!r}).querySelector("[data-look={way}]").click()')
        page.wait_for(f'{state_of(own)} !== {before!r}')
        assert page.evaluate(state_of(other)) == others
    assert page.complaints() == []


def test_one_of_three_tiles(viewer: Viewer, browser: Browser, camera: Node) -> None:
    for name in 'abc':
        Camera(camera, f'/{name}', LATCHED).publish(7)
    page = browser.new_page(viewer.url)
    page.wait_for(f'{TILES} === "/a,/b,/c"')
    for topic, name, order, pinned in (
            ('/b', 'pin', '/b,/a,/c', 'true,false,false'),
            ('/c', 'pin', '/b,/c,/a', 'true,true,false'),
            ('/c', 'earlier', '/c,/b,/a', 'true,true,false'),
            ('/c', 'later', '/b,/c,/a', 'true,true,false'),
            ('/b', 'hide', '/c,/a', 'true,false')):
        page.evaluate(f'tileOf({topic!r}).querySelector("[data-arrange={name}]").click()')
        assert page.evaluate(TILES) == order
        assert page.evaluate(
            '[...document.querySelectorAll(".tile:not([hidden]) [data-arrange=pin]")]'
            '.map((one) => one.ariaPressed).join()') == pinned
