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
"""Parameters of cameras, and the buttons of recorders, in the page."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
import signal

from chromium import Browser, Page
from conftest import call_service, NodeProcess, recorded_files, set_parameters, spin_until
from pages import Camera, Viewer
import pytest
from rcl_interfaces.srv import GetParameters
from rclpy.node import Node
from waiting import wait_until

pytest_plugins = ['pages']

TOKEN = 'a-secret-text'
TOPIC = '/video_frames'


def row_of(name: str) -> str:
    """Return JavaScript for the row of a parameter."""
    return (f'[...document.querySelectorAll("#controls label")].find('
            f'(one) => one.firstElementChild.textContent === "{name}")')


def change(page: Page, name: str, value: str, kind: str = 'input, select') -> None:
    """Change an input as a person does."""
    page.wait_for(f'{row_of(name)} !== undefined')
    page.evaluate(f'{{ const input = {row_of(name)}.querySelector("{kind}"); '
                  f'input.value = {value!r}; for (const name of ["input", "change"]) '
                  'input.dispatchEvent(new Event(name)); }')


@pytest.fixture
def camera_page(
        start: Callable[..., NodeProcess], start_viewer: Callable[..., Viewer],
        browser: Browser) -> Page:
    """Open the page of a camera, with its controls."""
    start('img_publisher', source='pattern:64x48', publish_rate=20.0)
    viewer = start_viewer(token=TOKEN, control=True)
    page = browser.new_page(f'{viewer.url}&topic={TOPIC}')
    page.wait_for(f'numberOf("{TOPIC}") >= 0')
    return page


def has_value(page: Page, name: str, value: float) -> None:
    """Wait until all inputs of a parameter show its value."""
    page.wait_for(f'[...{row_of(name)}.querySelectorAll("input")].every('
                  f'(one) => one.valueAsNumber === {value})')


def parameter(node: Node, name: str) -> float:
    """Return the value of a parameter of the publisher."""
    request = GetParameters.Request(names=[name])
    answer = call_service(node, GetParameters, '/image_publisher/get_parameters', request)
    return float(answer.values[0].integer_value or answer.values[0].double_value)


def test_value_that_the_camera_refuses(camera_page: Page, node: Node) -> None:
    used = parameter(node, 'jpeg_quality')
    change(camera_page, 'jpeg quality', '400', '[type=number]')
    assert camera_page.evaluate('sent.some(({ value }) => value === 400)')
    has_value(camera_page, 'jpeg quality', used)


@pytest.mark.parametrize('kind', ['[type=range]', '[type=number]'])
def test_number_sets_a_parameter(kind: str, camera_page: Page, node: Node) -> None:
    change(camera_page, 'jpeg quality', '40', kind)
    has_value(camera_page, 'jpeg quality', 40)
    wait_until(lambda: parameter(node, 'jpeg_quality') == 40)
    assert camera_page.complaints() == []


def test_node_without_settings(
        start_viewer: Callable[..., Viewer], browser: Browser, camera: Node) -> None:
    source = Camera(camera, TOPIC)
    page = browser.new_page(start_viewer(token=TOKEN, control=True).url)
    source.show(page, 1)
    page.evaluate('window.described = false; sockets[0].addEventListener("message", '
                  '({ data }) => { described ||= typeof data === "string" '
                  '&& "parameters" in JSON.parse(data); })')
    page.evaluate(f'tileOf("{TOPIC}").querySelector(".frame").click()')
    spin_until(camera, lambda: page.evaluate('described'))
    page.wait_for_paint()
    assert not page.evaluate('document.querySelector("#controls .node").checkVisibility()')
    assert page.complaints() == []


def test_camera_that_answers_late(
        start: Callable[..., NodeProcess], start_viewer: Callable[..., Viewer],
        browser: Browser) -> None:
    camera = start('img_publisher', source='pattern:64x48', publish_rate=20.0)
    viewer = start_viewer(token=TOKEN, control=True)
    page = browser.new_page(viewer.url)
    page.wait_for(f'numberOf("{TOPIC}") >= 0')
    camera.interrupt(signal.SIGSTOP)
    page.evaluate(f'tileOf("{TOPIC}").querySelector(".frame").click()')
    page.wait_for('document.getElementById("notice").textContent.includes("/image_publisher")')
    camera.interrupt(signal.SIGCONT)
    page.wait_for(f'{row_of("jpeg quality")} !== undefined')
    assert page.complaints() == []


def test_last_position_of_a_slider(camera_page: Page, node: Node) -> None:
    row = row_of('jpeg quality')
    camera_page.wait_for(f'{row} !== undefined')
    camera_page.evaluate(f'{{ const slider = {row}.querySelector("[type=range]"); '
                         'for (const value of [30, 40, 50]) { slider.value = value; '
                         'slider.dispatchEvent(new Event("input")); } }')
    wait_until(lambda: parameter(node, 'jpeg_quality') == 50)
    has_value(camera_page, 'jpeg quality', 50)


def test_number_is_kept_while_somebody_types(camera_page: Page, node: Node) -> None:
    camera_page.wait_for(f'{row_of("jpeg quality")} !== undefined')
    camera_page.evaluate(f'{{ const field = {row_of("jpeg quality")}.querySelector('
                         '"[type=number]"); field.focus(); field.value = 33; }')
    assert set_parameters(node, rotate=180) == ''
    change(camera_page, 'publish rate', '15')  # the page reads all values after a change
    camera_page.wait_for(f'{row_of("rotate")}.querySelector("select").value === "180"')
    assert camera_page.evaluate(
        f'{row_of("jpeg quality")}.querySelector("[type=number]").value') == '33'


def test_menu_sets_a_parameter(camera_page: Page) -> None:
    change(camera_page, 'rotate', '90')
    camera_page.wait_for(f'factOf("{TOPIC}", "size") === "48 \u00d7 64"')


def test_value_of_another_program(camera_page: Page, node: Node) -> None:
    change(camera_page, 'jpeg quality', '50')
    wait_until(lambda: parameter(node, 'jpeg_quality') == 50)
    assert set_parameters(node, jpeg_quality=60) == ''
    change(camera_page, 'publish rate', '15')  # the page reads all values after a change
    has_value(camera_page, 'jpeg quality', 60)


def test_stopped_camera(camera_page: Page) -> None:
    camera_page.wait_for('document.querySelector("#controls button")?.checkVisibility()')
    press = ('[...document.querySelectorAll("#controls button")].find('
             '(one) => one.textContent === "{}").click()')
    camera_page.evaluate(press.format('Stop camera'))
    camera_page.wait_for(f'tileOf("{TOPIC}").classList.contains("quiet")')
    camera_page.evaluate(press.format('Start camera'))
    camera_page.wait_for(f'!tileOf("{TOPIC}").classList.contains("quiet")')


def test_button_of_a_recorder(
        start: Callable[..., NodeProcess], camera_page: Page, tmp_path: Path) -> None:
    start('img_subscriber', mode='on_request', output_dir=tmp_path / 'out')
    camera_page.wait_for('[...document.querySelectorAll("#controls h2")].some('
                         '(one) => one.textContent === "/image_subscriber")')
    camera_page.evaluate('document.querySelector("#controls section:last-child button").click()')
    assert wait_until(lambda: recorded_files(tmp_path / 'out'))


def test_no_controls_by_default(
        start: Callable[..., NodeProcess], viewer: Viewer, browser: Browser) -> None:
    start('img_publisher', source='pattern:64x48', publish_rate=20.0)
    page = browser.new_page(f'{viewer.url}?topic={TOPIC}')
    page.wait_for(f'numberOf("{TOPIC}") >= 0')
    assert page.evaluate('document.getElementById("controls").childElementCount') == 0
    page.evaluate('sockets[0].send(JSON.stringify('
                  '{set: "/image_publisher", name: "jpeg_quality", value: 1}))')
    page.wait_for('document.getElementById("notice").textContent.startsWith("control is off")')
