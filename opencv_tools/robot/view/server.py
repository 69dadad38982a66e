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

"""A server on this machine for the page, which reads the robot again when a file changes."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Sequence
from contextlib import suppress
import os
from pathlib import Path
import re
import signal

from opencv_tools.base.sending import BoundedServer, SendingHandler
from opencv_tools.base.signals import END_SIGNALS
from opencv_tools.base.text import printable
from opencv_tools.robot.view.content import Content, read_content, to_json, ViewOptions
from opencv_tools.robot.view.single_file import INDEX, page_policy, read_page
from opencv_tools.robot.xml.document import DescriptionError
from opencv_tools.robot.xml.report import Report
from tornado.netutil import bind_sockets
from tornado.web import Application, HTTPError

_ADDRESS = '127.0.0.1'
_HOST = re.compile(r'(localhost|127\.0\.0\.1)(:[0-9]{1,5})?', re.IGNORECASE)
_POLICY = page_policy(own="'self'") + "; frame-ancestors 'none'"
_LOOK_SECONDS = 0.4
_ANSWER_SECONDS = 20.0  # time after which a page asks again whether there is a change
_MAX_WATCHED = 2000
_WATCHED = ('.sdf', '.urdf', '.xacro', '.xml', '.config', '.yaml', '.yml')
_HEADER_SECONDS, _MAX_BYTES = 5, 16_384
_Signature = frozenset[tuple[str, int, int]]


class RobotSite:
    """The newest robot, and its number."""

    def __init__(self, options: ViewOptions) -> None:
        self._options = options
        self._change = asyncio.Event()
        self.page = read_page()
        self.version = 0
        self.content: Content | None = None
        self.body = b''
        #: Why the newest robot is not shown; '' else.
        self.error = ''
        self._files: Sequence[str] = ()
        self._signature: _Signature = frozenset()
        self._update()

    async def watch(self) -> None:
        """Read the robot again whenever one of its files has changed."""
        loop = asyncio.get_running_loop()
        while True:
            await asyncio.sleep(_LOOK_SECONDS)
            found = await loop.run_in_executor(None, self._look)
            if found != self._signature:
                await loop.run_in_executor(None, self._update)
                self._change.set()
                self._change = asyncio.Event()

    async def wait_after(self, version: int) -> None:
        """Wait until there is another version than one, but not long."""
        if version == self.version:
            with suppress(asyncio.TimeoutError):
                await asyncio.wait_for(self._change.wait(), _ANSWER_SECONDS)

    def _update(self) -> None:
        before = self._look()
        self._read()
        after = self._look()
        # Another mesh is no change. A file that changes while it is read is read once more.
        self._signature = after if before <= after else before

    def _read(self) -> None:
        report, self.error = Report(), ''
        try:
            content = read_content(self._options, report)
            body = to_json({**content.document, 'version': self.version + 1})
        except DescriptionError as err:
            self.error = printable(str(err), 2000)
            body = to_json({'error': self.error, 'version': self.version + 1})
        else:
            self.content = content
        self._files = report.files
        self.body, self.version = body.encode(), self.version + 1

    def _look(self) -> _Signature:
        """Return names, times and sizes of the robot's files and of those beside it."""
        paths = [*map(Path, self._options.paths)]
        folders = {path if path.is_dir() else path.parent for path in paths}
        paths += map(Path, self._files)
        if self.content:
            meshes = self.content.meshes
            paths += [mesh.path for mesh in meshes.files if mesh.path] + meshes.missing
        for folder in folders:
            with suppress(OSError), os.scandir(folder) as entries:
                paths += [Path(entry.path) for entry, _ in zip(entries, range(_MAX_WATCHED))
                          if entry.name.endswith(_WATCHED)]
        found = []
        for path in [*dict.fromkeys(paths)][:_MAX_WATCHED]:
            with suppress(OSError):
                status = path.stat()
                found.append((str(path), status.st_mtime_ns, status.st_size))
        return frozenset(found)


class _Handler(SendingHandler):
    """A handler that refuses foreign names of this machine, and never caches."""

    text_policy = _POLICY

    def initialize(self, site: RobotSite) -> None:
        self.site = site

    def prepare(self) -> None:
        # A foreign name may be made to resolve to this machine.
        if not _HOST.fullmatch(self.request.headers.get('Host', '')):
            raise HTTPError(403)


class _UnknownHandler(_Handler):
    """All other addresses."""

    def prepare(self) -> None:
        super().prepare()
        raise HTTPError(404)


class _PageHandler(_Handler):
    """A file of the page."""

    async def get(self, name: str = INDEX) -> None:
        if name not in self.site.page:
            raise HTTPError(404)
        content, kind = self.site.page[name]
        self.set_header('Content-Type', kind)
        await self.send(content)


class _RobotHandler(_Handler):
    """The robot as JSON; with ``after``, once there is another version."""

    async def get(self) -> None:
        after = self.get_query_argument('after', '')
        if re.fullmatch('[0-9]{1,9}', after):
            await self.site.wait_after(int(after))
            if self.site.version == int(after):
                self.set_status(204)
                return
        self.set_header('Content-Type', 'application/json; charset=utf-8')
        await self.send(self.site.body)


class _MeshHandler(_Handler):
    """A mesh or a texture by its number; a request cannot name a file."""

    async def get(self, number: str) -> None:
        files = self.site.content.meshes.files if self.site.content else ()
        mesh = files[int(number)] if int(number) < len(files) else None
        if mesh is None or mesh.path is None:
            raise HTTPError(404)
        self.set_header('Content-Type', mesh.media_type)
        await self.send_file(mesh.path, mesh.size)


async def serve(options: ViewOptions, port: int, announce: Callable[[str], object]) -> None:
    """
    Serve the page until a signal cancels the task.

    :param port: port of 127.0.0.1; 0 for a free one.
    :param announce: called with sentences for the user.
    :raises DescriptionError: the port cannot be used, or a file does not exist.
    """
    loop, task = asyncio.get_running_loop(), asyncio.current_task()
    for number in END_SIGNALS:
        # An exception in the middle of asyncio would leave tasks that are never done.
        if task and signal.getsignal(number) is not signal.SIG_IGN:
            loop.add_signal_handler(number, task.cancel)
    site = await loop.run_in_executor(None, RobotSite, options)
    if site.error and not all(Path(path).exists() for path in options.paths):
        raise DescriptionError(site.error)  # later, the page shows the error
    keywords = {'site': site}
    application = Application([
        ('/', _PageHandler, keywords), ('/page/([a-z.]{1,40})', _PageHandler, keywords),
        ('/robot.json', _RobotHandler, keywords), ('/mesh/([0-9]{1,6})', _MeshHandler, keywords),
    ], default_handler_class=_UnknownHandler, default_handler_args=keywords,
        log_function=lambda _: None)
    try:
        sockets = bind_sockets(port, _ADDRESS)
    except OSError as err:
        raise DescriptionError(f'port {port} cannot be used: {err.strerror}; choose another with '
                               '--port') from err
    server = BoundedServer(
        application, max_header_size=_MAX_BYTES, max_body_size=_MAX_BYTES,
        idle_connection_timeout=_ANSWER_SECONDS * 2, body_timeout=_HEADER_SECONDS)
    server.add_sockets(sockets)
    announce(f'Open http://localhost:{sockets[0].getsockname()[1]}/ in a browser; Ctrl-C ends the '
             'page')
    if site.error:
        announce(f'robot_view: error: {site.error}')
    try:
        await site.watch()
    finally:
        await server.end()
