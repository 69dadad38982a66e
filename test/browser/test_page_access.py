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
"""Access to the page in a browser: tokens, cookies, hosts, origins and the policy of the page."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from http.server import BaseHTTPRequestHandler, HTTPServer
from threading import Thread

from chromium import Browser, new_browser, Page
from pages import Camera, Viewer
import pytest
from rclpy.node import Node

pytest_plugins = ['pages']

TOKEN = 'a-secret-text'
LIVE = 'document.getElementById("state")?.dataset.state === "live"'
_OPEN_SOCKET = ('new Promise((done) => {{ const socket = new WebSocket("ws://{0}/ws"); '
                'socket.onmessage = () => done("open"); socket.onclose = () => done("closed"); '
                '}})')


class EmptyPage(BaseHTTPRequestHandler):
    """Answer each request with an empty page."""

    def do_GET(self) -> None:
        """Send an empty page."""
        self.send_response(200)
        self.end_headers()

    def log_message(self, *_: object) -> None:
        """Print nothing."""


def type_token(page: Page, token: str) -> None:
    """Type a token into the form and send it."""
    page.evaluate(f'document.getElementById("secret").value = "{token}"; '
                  'setTimeout(() => document.getElementById("token").requestSubmit())')


@pytest.fixture
def other_site() -> Iterator[str]:
    """Serve an empty page of another origin."""
    with HTTPServer(('127.0.0.1', 0), EmptyPage) as server:
        thread = Thread(target=server.serve_forever)
        thread.start()
        yield f'http://127.0.0.1:{server.server_port}/'
        server.shutdown()
        thread.join()


def test_token_of_the_printed_address(
        start_viewer: Callable[..., Viewer], browser: Browser, camera: Node) -> None:
    viewer = start_viewer(token=TOKEN)
    front, page = Camera(camera, '/front'), browser.new_page(viewer.url)
    assert viewer.url.endswith(f'/?token={TOKEN}')
    front.show(page, 1)
    assert TOKEN not in page.evaluate('location.href')
    cookie, = page.call('Network.getCookies')['cookies']
    assert (cookie['value'], cookie['httpOnly'], cookie['sameSite']) == (TOKEN, True, 'Strict')
    assert page.evaluate('document.cookie') == ''
    page.go(viewer.url.partition('?')[0])
    front.show(page, 2)


def test_token_that_is_typed(
        start_viewer: Callable[..., Viewer], browser: Browser, camera: Node) -> None:
    viewer = start_viewer(token=TOKEN)
    address = viewer.url.partition('?')[0]
    front, page = Camera(camera, '/front'), browser.new_page(address)
    assert page.evaluate('document.title') == 'Token needed'
    assert page.evaluate('document.getElementById("wrong").offsetHeight') == 0
    type_token(page, 'not-the-token')
    page.wait_for('document.getElementById("wrong")?.offsetHeight')
    assert page.evaluate('location.href') == address
    type_token(page, TOKEN)
    front.show(page, 1)


def test_margins_of_the_token_form_on_a_phone(
        start_viewer: Callable[..., Viewer], browser: Browser) -> None:
    page = browser.new_page(start_viewer(token=TOKEN).url.partition('?')[0], 390, 844)
    form = 'document.getElementById("token").getBoundingClientRect()'
    assert page.evaluate(f'Math.min({form}.left, innerWidth - {form}.right)') >= 8


@pytest.mark.parametrize('token', [TOKEN, 'auto'])
def test_copied_link(token: str, start_viewer: Callable[..., Viewer], browser: Browser) -> None:
    viewer = start_viewer(token=token)
    page = browser.new_page(viewer.url)
    page.wait_for(LIVE)
    browser.call('Browser.grantPermissions', permissions=['clipboardReadWrite'])
    page.evaluate('document.getElementById("link").focus()')
    page.press('Enter')
    page.wait_for('document.getElementById("notice").textContent.startsWith("Copied the link")')
    assert page.evaluate('navigator.clipboard.readText()') == viewer.url
    assert page.evaluate('document.activeElement.id') == 'link'


def test_page_after_the_token_has_changed(
        start_viewer: Callable[..., Viewer], browser: Browser) -> None:
    viewer = start_viewer(token=TOKEN)
    page = browser.new_page(viewer.url)
    page.wait_for(LIVE)
    viewer.process.interrupt()
    viewer.process.finish()
    start_viewer(token='another-secret', port=viewer.port)
    page.wait_for(
        'document.getElementById("notice").textContent.startsWith("the token is wrong")')


def test_foreign_host_is_refused(viewer: Viewer) -> None:
    rules = 'MAP evil.example 127.0.0.1, MAP localhost 127.0.0.1'
    with new_browser(options=[f'--host-resolver-rules={rules}']) as browser:
        page = browser.new_page(f'http://evil.example:{viewer.port}/')
        assert 'allowed_hosts' in page.evaluate('document.body.textContent')
        assert page.evaluate(
            'performance.getEntriesByType("navigation")[0].responseStatus') == 403
        page.go(f'http://localhost:{viewer.port}/')
        page.wait_for(LIVE)


def test_foreign_page_opens_no_socket(viewer: Viewer, browser: Browser, other_site: str) -> None:
    own, foreign = browser.new_page(viewer.url), browser.new_page(other_site)
    open_socket = _OPEN_SOCKET.format(f'127.0.0.1:{viewer.port}')
    assert own.evaluate(open_socket) == 'open'
    assert foreign.evaluate(open_socket) == 'closed'
    assert foreign.evaluate(f'fetch("{viewer.url}topics").then(() => "read", () => "refused")'
                            ) == 'refused'


def test_foreign_page_shows_no_frame(viewer: Viewer, browser: Browser, other_site: str) -> None:
    page = browser.new_page(other_site)
    page.evaluate(f'const frame = document.createElement("iframe"); frame.src = "{viewer.url}"; '
                  'document.body.append(frame)')
    page.wait_for('true')
    page.wait_for('performance.getEntriesByType("resource").length > 0')
    assert any('frame-ancestors' in text for text in page.complaints())


def test_policy_allows_no_inline_script(viewer: Viewer, browser: Browser) -> None:
    page = browser.new_page(viewer.url)
    page.wait_for(LIVE)
    page.evaluate('const script = document.createElement("script"); '
                  'script.textContent = "window.attacked = true"; document.body.append(script)')
    assert page.evaluate('window.attacked') is None
    complaint, = page.complaints()
    assert 'Content Security Policy' in complaint
