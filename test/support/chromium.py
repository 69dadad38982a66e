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

"""A Chromium without a window, driven through the pipe of its DevTools."""

from __future__ import annotations

from base64 import b64decode
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
import json
from pathlib import Path
import select
import subprocess
import tempfile
from typing import Any

from waiting import wait_until, work_of

BROWSER = 'chromium-headless-shell'
_READ_BYTES = 1 << 20
# The browser reads commands from file 3 and writes answers to file 4, so no port is needed.
_AS_FILES_3_AND_4 = 'exec "$@" 3<&0 4>&1 0</dev/null 1>&2'
_FLAGS = ('--remote-debugging-pipe', '--no-sandbox', '--disable-gpu', '--disable-dev-shm-usage',
          '--hide-scrollbars', '--no-first-run')
_COMPLAINTS = ('Runtime.exceptionThrown', 'Log.entryAdded')


class PageError(Exception):
    """The browser refused a command, or JavaScript of a test failed."""


class Browser:
    """The process of a browser."""

    def __init__(
        self, folder: Path, within: Sequence[str] = (), script: str = '',
        options: Sequence[str] = (),
    ) -> None:
        """
        Start the browser.

        :param folder: folder for the profile and the console.
        :param within: prefix of the command, which must replace itself by ``exec``.
        :param script: JavaScript that runs in each page before its own.
        :param options: further options of the command.
        """
        self._script = script
        self.events: list[dict[str, Any]] = []
        self._answers: dict[int, dict[str, Any]] = {}
        self._number = 0
        self._rest = b''
        self.log = folder / 'browser.log'
        with self.log.open('w') as console:
            self._process = subprocess.Popen(
                ['sh', '-c', _AS_FILES_3_AND_4, 'sh', *within, BROWSER, *_FLAGS, *options,
                 f'--user-data-dir={folder}'],
                stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=console, bufsize=0)

    def new_page(self, url: str, width: int = 1280, height: int = 800, script: str = '') -> Page:
        """
        Open a page in a tab of its own.

        :param url: address of the page.
        :param width: width of the viewport in pixels.
        :param height: height of the viewport in pixels.
        :param script: run before the scripts of the page.
        """
        target = self.call('Target.createTarget', url='about:blank')['targetId']
        session = self.call('Target.attachToTarget', targetId=target, flatten=True)['sessionId']
        page = Page(self, target, session)
        for domain in ('Page', 'Runtime', 'Log'):
            page.call(f'{domain}.enable')
        page.call('Page.addScriptToEvaluateOnNewDocument', source=f'{self._script}\n{script}')
        page.resize(width, height)
        page.go(url)
        return page

    def call(self, method: str, session: str = '', **parameters: Any) -> dict[str, Any]:
        """Send a command and return its result."""
        self._number += 1
        command = {'id': self._number, 'method': method, 'params': parameters}
        if session:
            command['sessionId'] = session
        assert self._process.stdin is not None
        self._process.stdin.write(json.dumps(command).encode() + b'\0')
        number = self._number
        wait_until(lambda: self._read() or number in self._answers, f'the answer to {method}',
                   work=lambda: work_of(self._process.pid))
        answer = self._answers.pop(number)
        if 'error' in answer:
            raise PageError(f'{method}: {answer["error"]["message"]}')
        return dict(answer['result'])

    def _read(self) -> None:
        """Read answers and events, if a part of one comes within a second."""
        output = self._process.stdout
        assert output is not None
        if not select.select([output], [], [], 1.0)[0]:
            return
        read = output.read(_READ_BYTES)
        assert read, f'the browser has ended:\n{self.log.read_text()}'
        *messages, self._rest = (self._rest + read).split(b'\0')
        for message in map(json.loads, messages):
            if 'id' in message:
                self._answers[message['id']] = message
            elif message['method'] in _COMPLAINTS:
                self.events.append(message)

    def close(self) -> None:
        """End the browser with all its processes."""
        self._process.communicate()  # the end of the pipe is the end of the browser


class Page:
    """A tab of the browser."""

    def __init__(self, browser: Browser, target: str, session: str) -> None:
        self._browser = browser
        self._target = target
        self._session = session

    def call(self, method: str, **parameters: Any) -> dict[str, Any]:
        """Send a command for this page and return its result."""
        return self._browser.call(method, self._session, **parameters)

    def go(self, url: str) -> None:
        """Load another page, and wait for its document."""
        answer = self.call('Page.navigate', url=url)
        if 'errorText' in answer:
            raise PageError(f'{url}: {answer["errorText"]}')
        self.wait_for('document.readyState === "complete"')

    def evaluate(self, expression: str) -> Any:
        """Return the value of an expression; a promise is awaited."""
        answer = self.call('Runtime.evaluate', expression=expression, awaitPromise=True,
                           returnByValue=True)
        if 'exceptionDetails' in answer:
            details = answer['exceptionDetails']
            raise PageError(details.get('exception', {}).get('description', details['text']))
        return answer['result'].get('value')

    def wait_for(self, expression: str) -> Any:
        """Wait until an expression is true, and return its value."""
        try:
            return wait_until(lambda: self.evaluate(expression), expression)
        except AssertionError as err:
            shown = self.evaluate('document.body.innerText')
            raise AssertionError(f'{err}: {self.complaints()} on the page\n{shown}') from err

    def wait_for_paint(self) -> None:
        """Wait until the page has arranged and painted what has changed."""
        self.evaluate('new Promise((done) => requestAnimationFrame('
                      '() => requestAnimationFrame(done)))')

    def resize(self, width: int, height: int, scale: float = 1.0) -> None:
        """Set the size of the viewport in pixels of the style sheet."""
        self.call('Emulation.setDeviceMetricsOverride', width=width, height=height,
                  deviceScaleFactor=scale, mobile=width < 600)

    def hide(self) -> None:
        """Hide the page, as another tab or a minimised window does."""
        self._set_window('minimized')

    def show(self) -> None:
        """Show the page again."""
        self._set_window('normal')

    def _set_window(self, state: str) -> None:
        window = self._browser.call('Browser.getWindowForTarget', targetId=self._target)
        self._browser.call('Browser.setWindowBounds', windowId=window['windowId'],
                           bounds={'windowState': state})

    def prefer(self, scheme: str) -> None:
        """Prefer ``light`` or ``dark`` colours."""
        self.call('Emulation.setEmulatedMedia',
                  features=[{'name': 'prefers-color-scheme', 'value': scheme}])

    def press(self, key: str) -> None:
        """Press a key by its name, such as ``Escape`` or ``s``."""
        text = {'text': key} if len(key) == 1 else {'text': '\r'} if key == 'Enter' else {}
        codes = {'Enter': 13, 'Escape': 27, ' ': 32, 'ArrowLeft': 37, 'ArrowUp': 38,
                 'ArrowRight': 39, 'ArrowDown': 40, 'Tab': 9}
        code = codes.get(key, ord(key[0].upper()))
        self.call('Input.dispatchKeyEvent', type='keyDown', key=key,
                  windowsVirtualKeyCode=code, **text)
        self.call('Input.dispatchKeyEvent', type='keyUp', key=key, windowsVirtualKeyCode=code)

    def screenshot(self, path: Path) -> None:
        """Write what the page shows to a file, in the format of its extension."""
        kind = {'.jpg': {'format': 'jpeg', 'quality': 85}}.get(path.suffix, {'format': 'png'})
        path.write_bytes(b64decode(self.call('Page.captureScreenshot', **kind)['data']))

    def complaints(self) -> list[str]:
        """Return the errors of the page so far: of scripts, of requests and of its policy."""
        texts = []
        for event in self._browser.events:
            if event.get('sessionId') == self._session:
                found = event['params']
                details = found.get('exceptionDetails') or found['entry']
                if details.get('level', 'error') != 'error':
                    continue
                texts.append(f'{details["text"]} {details.get("url", "")} '
                             f'{details.get("exception", {}).get("description", "")}'.strip())
        return texts

    def close(self) -> None:
        """Close the tab."""
        self._browser.call('Target.closeTarget', targetId=self._target)


@contextmanager
def new_browser(
    within: Sequence[str] = (), script: str = '', options: Sequence[str] = (),
) -> Iterator[Browser]:
    """Start a browser for the duration of the block; see ``Browser``."""
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as folder:
        browser = Browser(Path(folder), within, script, options)
        try:
            yield browser
        finally:
            browser.close()
