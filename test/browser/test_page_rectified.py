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

"""The switch between raw and rectified pictures of a camera."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from chromium import Browser, Page
from conftest import NodeProcess, set_parameters
from pages import Camera, Viewer
import pytest
from rclpy.node import Node
from shown_boards import write_former
from test_page_layout import check_all

pytest_plugins = ['pages']

RAW, RECTIFIED = '/video_frames', '/image_rect'
SWITCH = 'document.getElementById("rectified")'
#: Visible tiles.
TILES = '[...document.querySelectorAll(".tile")].filter((one) => one.offsetParent !== null).map(' \
        '(one) => one.dataset.topic).join()'
PRESSED = f'{SWITCH}.getAttribute("aria-pressed")'
SEARCH = 'new URL(location).searchParams.get("rectified")'


@pytest.fixture
def page(start: Callable[..., NodeProcess], start_viewer: Callable[..., Viewer],
         browser: Browser, tmp_path: Path) -> Page:
    """Open the page of a camera that publishes rectified images as well."""
    start('img_publisher', source='pattern:64x48', publish_rate=20.0, rectify='true',
          camera_info_url=write_former(tmp_path / 'camera.yaml', 60.0, (64, 48)))
    opened = browser.new_page(f'{start_viewer().url}?topic={RAW}')
    opened.wait_for(f'!{SWITCH}.hidden')
    return opened


def test_switch_to_rectified_pictures(page: Page) -> None:
    assert (page.evaluate(TILES), page.evaluate(PRESSED)) == (RAW, 'false')
    page.evaluate(f'{SWITCH}.focus()')
    page.press('Enter')
    page.wait_for(f'{TILES} === "{RECTIFIED}" && numberOf("{RECTIFIED}") >= 0')
    assert (page.evaluate(PRESSED), page.evaluate(SEARCH)) == ('true', 'true')
    page.wait_for(f'sent.some((message) => message.unsubscribe === "{RAW}")')
    page.press('r')
    page.wait_for(f'{TILES} === "{RAW}"')
    assert (page.evaluate(PRESSED), page.evaluate(SEARCH)) == ('false', None)
    assert page.complaints() == []


def test_switch_is_kept(page: Page, node: Node) -> None:
    page.press('r')
    page.press('Escape')
    page.wait_for(f'{TILES} === "{RECTIFIED},{RAW}"')
    page.evaluate(f'tileOf("{RAW}").querySelector(".frame").click()')
    page.wait_for(f'{TILES} === "{RECTIFIED}"')
    page.press('r')
    page.press('r')
    page.go(page.evaluate('location.href'))
    page.wait_for(f'{TILES} === "{RECTIFIED}" && numberOf("{RECTIFIED}") >= 0')
    assert page.evaluate('document.getElementById("title").textContent') == RAW
    assert set_parameters(node, rectify=False) == ''
    page.wait_for(f'{TILES} === "{RAW}" && {SWITCH}.hidden')
    assert page.complaints() == []


def test_keys_with_capital_letters(page: Page) -> None:
    page.press('R')  # as with Shift or Caps Lock
    page.wait_for(f'{TILES} === "{RECTIFIED}" && numberOf("{RECTIFIED}") >= 0')
    page.press('S')
    page.wait_for('document.getElementById("notice").textContent.startsWith("Saved ")')
    page.press('F')
    page.wait_for(f'document.fullscreenElement === tileOf("{RECTIFIED}")')
    page.press('r')  # a tile that is hidden does not fill the screen
    page.wait_for(f'document.fullscreenElement === null && {TILES} === "{RAW}"')
    assert page.complaints() == []


def test_no_switch(viewer: Viewer, browser: Browser, node: Node, camera: Node) -> None:
    front, other = Camera(camera, RAW), Camera(node, RECTIFIED)
    page = browser.new_page(f'{viewer.url}?topic={RAW}')
    for one in (front, other):
        page.wait_for(f'tileOf("{one.topic}") !== undefined')
    front.show(page, 3)
    assert page.evaluate(f'{SWITCH}.hidden')  # the rectified images are those of another node
    page.press('r')
    assert page.evaluate(TILES) == RAW
    page.evaluate('document.getElementById("previous").click()')
    assert page.evaluate(f'{SWITCH}.hidden')
    assert page.complaints() == []


def test_layout(page: Page) -> None:
    page.press('r')
    page.wait_for(f'numberOf("{RECTIFIED}") >= 0')
    check_all(page)
