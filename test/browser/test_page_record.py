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


"""The button of the page that records, in a browser."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import closing
from pathlib import Path
import signal
from urllib.parse import parse_qs, urlsplit

from chromium import Browser, Page
from conftest import recorded_files
import numpy as np
from opencv_tools.bags.open_bag import Bag
from opencv_tools.bags.reading import BagMessage
from opencv_tools.image.cdr import cdr_to_image
from pages import Camera, numbered_frame, Viewer
import pytest
from rclpy.node import Node
from test_page_layout import check_all
from waiting import wait_until

pytest_plugins = ['pages']

#: Bytes of a frame, as the account has them.
SIZE = f'{numbered_frame(0).nbytes / 1000:g} kB'
RECORD = 'document.getElementById("record")'
ACCOUNT = 'document.getElementById("recording").textContent'
NOTICE = 'document.getElementById("notice").textContent'
#: Whether the page shows that the node records: in the button, its colour, and the title.
IS_ON = (f'{RECORD}.ariaPressed === "true" && document.title.startsWith("● ") && '
         f'getComputedStyle({RECORD}.querySelector("circle")).fill === '
         'getComputedStyle(document.getElementById("record")).color')
#: Notes what a page says to screen readers.
LISTEN = ('window.spoken = []; new MutationObserver(() => spoken.push('
          'document.getElementById("said").textContent)).observe('
          'document.getElementById("said"), {childList: true}); true')
IS_OFF = f'{RECORD}.ariaPressed === "false" && !document.title.startsWith("● ")'


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    return tmp_path / 'bags'


@pytest.fixture
def recorder(start_viewer: Callable[..., Viewer], folder: Path) -> Viewer:
    """Start a viewer that records."""
    return start_viewer(control=True, record_dir=folder)


def click(page: Page, element: str) -> None:
    """Click with the mouse in the middle of an element."""
    place = page.evaluate(
        f'(({{left, top, width, height}}) => ({{x: left + width / 2, y: top + height / 2}}))('
        f'{element}.getBoundingClientRect())')
    for kind in ('mousePressed', 'mouseReleased'):
        page.call('Input.dispatchMouseEvent', type=kind, button='left', clickCount=1, **place)


def tap(page: Page, element: str) -> None:
    """Touch the middle of an element."""
    place = page.evaluate(
        f'(({{left, top, width, height}}) => ({{x: left + width / 2, y: top + height / 2}}))('
        f'{element}.getBoundingClientRect())')
    page.call('Input.dispatchTouchEvent', type='touchStart', touchPoints=[place])
    page.call('Input.dispatchTouchEvent', type='touchEnd', touchPoints=[])


def images_in(bag: Path) -> dict[str, list[np.ndarray]]:
    """Return the images of each topic of a bag."""
    found: dict[str, list[np.ndarray]] = {}
    with closing(Bag(bag)) as opened:
        for message in opened.messages([*opened.topics]):
            assert isinstance(message, BagMessage)
            image = cdr_to_image(message.load())
            found.setdefault(message.topic.name, []).append(np.frombuffer(
                bytes(image.data), np.uint8).reshape(image.height, image.width, 3))
    return found


def publish_recorded(camera: Camera, *numbers: int) -> None:
    """Publish frames as soon as the page and the recording receive the topic."""
    wait_until(lambda: camera.publisher.get_subscription_count() == 2)
    for number in numbers:
        camera.publish(number)


def test_grid_by_pointer_and_second_page(
        recorder: Viewer, browser: Browser, node: Node, folder: Path) -> None:
    front, rear, hidden = (Camera(node, name) for name in ('/front', '/rear', '/side'))
    page = browser.new_page(f'{recorder.url}&hide=/side')
    page.wait_for('Boolean(tileOf("/front") && tileOf("/rear"))')
    page.wait_for('document.getElementById("unhide").textContent === "Show 1 hidden"')
    page.wait_for(f'{RECORD}.checkVisibility() && {IS_OFF}')
    assert page.evaluate('document.getElementById("said").textContent') == ''
    page.evaluate(LISTEN)
    click(page, RECORD)
    page.wait_for(IS_ON)
    assert page.evaluate('spoken') == ['The recording has begun']
    assert page.evaluate(f'{RECORD}.textContent.trim()') == 'Stop'
    other = browser.new_page(f'{recorder.url}&topic=/rear')
    other.wait_for(IS_ON)
    page.wait_for(f'{ACCOUNT}.includes(", 0 frames, 0 lost, 0 dropped, 0 kB, ")')
    publish_recorded(front, 1)
    page.wait_for(f'{ACCOUNT}.includes(", {SIZE}, ")')
    publish_recorded(front, 2, 3)
    publish_recorded(rear, 4, 5)
    hidden.publish(6)
    for shown in (page, other):
        shown.wait_for(f'/^Recording 2 topics, \\d.* s, 5 frames, 0 lost, 0 dropped, .* GB left, '
                       f'.*\\.mcap$/.test({ACCOUNT})')
    click(other, RECORD)
    for shown in (page, other):
        shown.wait_for(f'{IS_OFF} && {ACCOUNT}.startsWith("Recorded 2 topics")')
    (bag,) = recorded_files(folder)
    other.wait_for(f'{NOTICE} === "Recorded 5 frames in {bag.name}"')
    page.wait_for('spoken.length === 2')
    assert page.evaluate('spoken') == ['The recording has begun', 'The recording has ended']
    assert other.evaluate('document.getElementById("said").textContent') == ''  # in the notice
    found = images_in(bag)
    assert {name: len(images) for name, images in found.items()} == {'/front': 3, '/rear': 2}
    for name, numbers in (('/front', (1, 2, 3)), ('/rear', (4, 5))):
        assert all(np.array_equal(image, numbered_frame(number))
                   for image, number in zip(found[name], numbers, strict=True))
    assert page.complaints() == other.complaints() == []


@pytest.mark.parametrize('query', ['', '&topic=/front'])
def test_key(recorder: Viewer, browser: Browser, node: Node, folder: Path, query: str) -> None:
    camera, _ = Camera(node, '/front'), Camera(node, '/rear')
    page = browser.new_page(f'{recorder.url}{query}')
    page.wait_for('Boolean(tileOf("/front") && tileOf("/rear"))')
    page.wait_for(f'{RECORD}.checkVisibility()')
    page.press('c')
    page.wait_for(IS_ON)
    publish_recorded(camera, 7)
    count = '1 topic' if query else '2 topics'
    page.wait_for(f'{ACCOUNT}.startsWith("Recording {count}, ") && '
                  f'{ACCOUNT}.includes(", 1 frames, ")')
    page.press('c')
    page.wait_for(IS_OFF)
    (bag,) = recorded_files(folder)
    assert np.array_equal(images_in(bag)['/front'], [numbered_frame(7)])
    assert page.complaints() == []


def test_phone(recorder: Viewer, browser: Browser, node: Node, folder: Path) -> None:
    camera = Camera(node, '/front')
    page = browser.new_page(recorder.url, width=390, height=844)
    page.wait_for(f'tileOf("/front") && {RECORD}.checkVisibility()')
    tap(page, RECORD)
    page.wait_for(IS_ON)
    publish_recorded(camera, 8, 9)
    page.wait_for(f'{ACCOUNT}.includes(", 2 frames, ")')
    assert page.evaluate('document.documentElement.scrollWidth') <= 390
    tap(page, RECORD)
    page.wait_for(IS_OFF)
    (bag,) = recorded_files(folder)
    assert len(images_in(bag)['/front']) == 2
    assert page.complaints() == []


def test_recording_without_its_page(
        recorder: Viewer, browser: Browser, node: Node, folder: Path) -> None:
    camera = Camera(node, '/front')
    page = browser.new_page(recorder.url)
    page.wait_for(f'tileOf("/front") && {RECORD}.checkVisibility()')
    click(page, RECORD)
    page.wait_for(IS_ON)
    page.close()
    wait_until(lambda: camera.publisher.get_subscription_count() == 1)
    camera.publish(1)
    again = browser.new_page(recorder.url)
    again.wait_for(f'{IS_ON} && {ACCOUNT}.includes(", 1 frames, ")')
    click(again, RECORD)
    again.wait_for(IS_OFF)
    (bag,) = recorded_files(folder)
    assert np.array_equal(images_in(bag)['/front'], [numbered_frame(1)])


def test_sentence_about_a_silent_topic(
        recorder: Viewer, browser: Browser, node: Node) -> None:
    Camera(node, '/front')
    page = browser.new_page(recorder.url)
    page.wait_for(f'tileOf("/front") && {RECORD}.checkVisibility()')
    click(page, RECORD)
    page.wait_for(f'{ACCOUNT}.includes(": no frames of /front: ")')
    assert page.complaints() == []


def test_last_seconds(recorder: Viewer, browser: Browser, node: Node, folder: Path) -> None:
    camera = Camera(node, '/front')
    page = browser.new_page(f'{recorder.url}&topic=/front')
    for number in range(1, 6):
        camera.show(page, number)
    keep = 'document.getElementById("keep")'
    page.wait_for(f'{keep}.checkVisibility()')
    click(page, keep)
    page.wait_for(f'/^Recorded \\d+ frames from memory in .*_kept.mcap$/.test({NOTICE})')
    (bag,) = recorded_files(folder)
    assert np.array_equal(images_in(bag)['/front'][-1], numbered_frame(5))
    click(page, RECORD)
    page.wait_for(IS_ON)
    check_all(page)
    page.evaluate(f'{RECORD}.click()')
    page.wait_for(IS_OFF)
    check_all(page)


def test_node_that_is_killed(
        start_viewer: Callable[..., Viewer], browser: Browser, node: Node, folder: Path) -> None:
    Camera(node, '/front')
    viewer = start_viewer(control=True, record_dir=folder)
    page = browser.new_page(viewer.url)
    page.wait_for(f'tileOf("/front") && {RECORD}.checkVisibility()')
    click(page, RECORD)
    page.wait_for(IS_ON)
    page.evaluate(LISTEN.replace('said', 'notice'))  # the notice leaves after some seconds
    sentence = 'spoken.includes("The recording has ended with the node")'
    page.evaluate('sockets.at(-1).close()')  # the node goes on
    page.wait_for('sockets.length > 1 && sockets.at(-1).readyState === 1')
    page.wait_for(f'document.getElementById("state").textContent === "Live" && {IS_ON}')
    assert not page.evaluate(sentence)
    viewer.process.kill()
    page.wait_for(f'{RECORD}.disabled && {ACCOUNT}.startsWith("No answer: ")')
    page.wait_for('document.getElementById("controls").inert')
    muted, shown = page.evaluate('["state", "recording"].map('
                                 '(id) => getComputedStyle(document.getElementById(id)).color)')
    assert shown == muted
    token = parse_qs(urlsplit(viewer.url).query)['token'][0]
    start_viewer(control=True, record_dir=folder, port=viewer.port, token=token)
    page.wait_for(f'{IS_OFF} && !{RECORD}.disabled && {sentence}')
    assert page.evaluate('document.getElementById("recording").hidden')
    assert page.evaluate(f'{RECORD}.checkVisibility()')


def test_node_that_stands_still(
        recorder: Viewer, browser: Browser, node: Node) -> None:
    Camera(node, '/front')
    page = browser.new_page(f'{recorder.url}&topic=/front')
    buttons = '["record", "keep"].map((id) => document.getElementById(id))'
    page.wait_for(f'{buttons}.every((one) => one.checkVisibility())')
    click(page, RECORD)
    page.wait_for(IS_ON)
    recorder.process.interrupt(signal.SIGSTOP)
    page.wait_for('document.getElementById("state").textContent === "Stalled"')
    assert page.evaluate(ACCOUNT) == 'No answer: nobody knows whether it records'
    assert not page.evaluate('document.title.startsWith("● ")')
    assert page.evaluate(f'{buttons}.map((one) => one.disabled)') == [True, True]
    assert page.evaluate(f'{buttons}.map((one) => getComputedStyle(one).opacity)') == ['0.5'] * 2
    recorder.process.interrupt(signal.SIGCONT)
    page.wait_for(f'{ACCOUNT}.startsWith("Recording 1 topic") && '
                  f'{buttons}.every((one) => !one.disabled)')
    assert page.complaints() == []


def test_chosen_topics_and_download(
        recorder: Viewer, browser: Browser, node: Node, folder: Path, tmp_path: Path) -> None:
    cameras = {name: Camera(node, name) for name in ('/a', '/b', '/c')}
    page = browser.new_page(recorder.url)
    page.wait_for(f'tileOf("/c") && {RECORD}.checkVisibility()')
    assert page.evaluate(f'{RECORD}.textContent.trim()') == 'Record'
    page.evaluate('document.getElementById("choose").click()')
    boxes = '[...document.querySelectorAll("#choices input")]'
    assert page.evaluate(f'{boxes}.map((one) => one.checked)') == [True] * 3
    page.resize(390, 120)  # the list is longer than the screen, as that of many topics
    above, below = page.evaluate('(({ top, bottom }) => [top, innerHeight - bottom])('
                                 'document.getElementById("choice").getBoundingClientRect())')
    assert above > 0 and below > 0, 'a tap beside the list closes it'
    page.evaluate('document.getElementById("record-chosen").scrollIntoView()')
    assert page.evaluate('document.getElementById("record-chosen").getBoundingClientRect().bottom'
                         ' < innerHeight')
    page.resize(1280, 800)
    page.evaluate(f'{boxes}[1].click()')
    page.evaluate('document.getElementById("record-chosen").click()')
    page.wait_for(IS_ON)
    for name in ('/a', '/c'):
        publish_recorded(cameras[name], 5)
    page.wait_for(f'{ACCOUNT}.includes("Recording 2 topics, ") && '
                  f'{ACCOUNT}.includes(", 2 frames, ")')
    click(page, RECORD)
    page.wait_for(IS_OFF)
    (bag,) = recorded_files(folder)
    page.wait_for(f'{ACCOUNT}.endsWith({str(bag)!r})')
    browser.call('Browser.setDownloadBehavior', behavior='allow', downloadPath=str(tmp_path))
    page.evaluate('document.getElementById("bag").click()')
    wait_until(lambda: (tmp_path / bag.name).is_file())
    assert (tmp_path / bag.name).read_bytes() == bag.read_bytes()
    assert {*images_in(tmp_path / bag.name)} == {'/a', '/c'}
    for name in ('../secret', 'other.mcap'):
        assert page.evaluate(f'fetch("/bag?name={name}").then((one) => one.status)') == 404
    check_all(page)
    page.evaluate('document.getElementById("forget").click()')
    assert not page.evaluate('document.getElementById("recorded").innerText.trim()')


def test_download_that_is_not_allowed(
        start_viewer: Callable[..., Viewer], browser: Browser, node: Node, folder: Path) -> None:
    camera = Camera(node, '/front')
    page = browser.new_page(start_viewer(
        control=True, record_dir=folder, record_download=False).url)
    page.wait_for(f'tileOf("/front") && {RECORD}.checkVisibility()')
    click(page, RECORD)
    page.wait_for(IS_ON)
    publish_recorded(camera, 5)
    click(page, RECORD)
    page.wait_for(f'{IS_OFF} && {ACCOUNT}.startsWith("Recorded ")')
    (bag,) = recorded_files(folder)
    assert page.evaluate('document.getElementById("bag").hidden')
    assert page.evaluate(f'fetch("/bag?name={bag.name}").then((one) => one.status)') == 403


def test_no_button_by_default(viewer: Viewer, browser: Browser, node: Node) -> None:
    Camera(node, '/front')
    page = browser.new_page(viewer.url)
    page.wait_for('Boolean(tileOf("/front"))')
    page.press('c')
    assert not page.evaluate(f'{RECORD}.checkVisibility()')
    assert page.evaluate('sent.filter((one) => "record" in one).length') == 0
