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

"""The page on this machine: what it serves, to whom, and the new version after a change."""

from __future__ import annotations

from collections.abc import Iterator
from http.client import BadStatusLine, HTTPConnection, HTTPResponse
import json
from pathlib import Path
import re
import signal
import subprocess
import sys
from typing import Any

from opencv_tools.base.sending import BoundedServer
from opencv_tools.robot.cli import robot_view
import pytest
from waiting import communicate, LONGEST_SECONDS, wait_until

pytestmark = pytest.mark.process
LINK = '<robot name="{}"><link name="base"/></robot>'
VISUAL = '<visual><geometry><mesh filename="{}"/></geometry></visual>'
MESH = f'<robot name="r"><link name="base">{VISUAL}</link></robot>'
LARGE = 40_000_000


class Server:
    """A process of robot_view."""

    def __init__(self, *arguments: str) -> None:
        self.process = subprocess.Popen(
            [sys.executable, '-m', 'opencv_tools.robot.cli', 'robot_view', *arguments,
             '--port', '0'], stderr=subprocess.PIPE, text=True)
        assert self.process.stderr is not None
        self.line = self.process.stderr.readline()
        self.port = int(re.search(r'http://localhost:(\d+)/', self.line)[1])

    def get(self, path: str, host: str = 'localhost', method: str = 'GET'
            ) -> tuple[HTTPResponse, bytes]:
        connection = HTTPConnection('127.0.0.1', self.port, timeout=LONGEST_SECONDS)
        connection.request(method, path, headers={'Host': f'{host}:{self.port}'})
        answer = connection.getresponse()
        data = answer.read()
        connection.close()
        return answer, data

    def robot(self, after: int | None = None) -> Any:
        """Return the robot; with ``after``, once there is another version."""
        def read() -> Any:
            answer, data = self.get('/robot.json' + (f'?after={after}' if after else ''))
            return json.loads(data) if answer.status == 200 else None

        return wait_until(read, f'a version after {after}')

    def close(self) -> None:
        if self.process.poll() is not None:
            return
        self.process.send_signal(signal.SIGINT)
        communicate(self.process)


@pytest.fixture
def robot(tmp_path: Path) -> Path:
    """Write a robot."""
    path = tmp_path / 'robot.urdf'
    path.write_text(LINK.format('first'))
    return path


@pytest.fixture
def server(robot: Path) -> Iterator[Server]:
    """Start a server for the robot."""
    started = Server(str(robot))
    yield started
    started.close()


@pytest.fixture(scope='module')
def shared(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Server]:
    """Start a server for a robot that no test changes."""
    folder = tmp_path_factory.mktemp('shared')
    (folder / 'outside.png').write_bytes(b'secret')
    robot = folder / 'model' / 'urdf' / 'robot.urdf'
    robot.parent.mkdir(parents=True)
    (robot.parent / 'a.stl').write_bytes(b'triangles')
    (robot.parent / 'a.png').write_bytes(b'picture')
    names = '../../outside.png', 'a.png'
    (robot.parent / 'a.dae').write_text(''.join(
        f'<image><init_from>{name}</init_from></image>' for name in names))
    with (robot.parent / 'large.stl').open('wb') as file:
        file.truncate(LARGE)
    robot.write_text('<robot name="r"><link name="base">' + ''.join(
        VISUAL.format(name) for name in ('a.stl', 'a.dae', 'large.stl')) + '</link></robot>')
    started = Server(str(robot))
    yield started
    started.close()


def test_new_version_after_a_change(server: Server, robot: Path) -> None:
    first = server.robot()
    assert (first['version'], first['robots'][0]['name']) == (1, 'first')
    robot.write_text(LINK.format('second, longer'))
    second = server.robot(after=1)
    assert second['robots'][0]['name'] == 'second, longer'
    robot.write_text('<robot name="r"><link></robot>')
    third = server.robot(after=second['version'])
    assert 'robot.urdf' in third['error'] and 'robots' not in third
    robot.write_text(LINK.format('fourth'))
    assert server.robot(after=third['version'])['robots'][0]['name'] == 'fourth'


def test_one_version_of_a_robot_with_a_mesh(robot: Path) -> None:
    (robot.parent / 'a.stl').write_bytes(b'triangles')
    robot.write_text(MESH.format('a.stl'))
    server = Server(str(robot))
    try:
        (robot.parent / 'a.stl').write_bytes(b'more triangles')
        changed = server.robot(after=1)
        assert (changed['version'], changed['meshes'][0]['size']) == (2, len(b'more triangles'))
    finally:
        server.close()


def save(path: Path, text: str) -> None:
    """Write a file at once, so that no reader finds a part of it."""
    path.with_suffix('.new').write_text(text)
    path.with_suffix('.new').replace(path)


def test_file_of_another_folder(tmp_path: Path) -> None:
    robot, included = tmp_path / 'urdf' / 'robot.xacro', tmp_path / 'parts' / 'macros.xacro'
    for path in (robot, included):
        path.parent.mkdir()
    head = '<robot name="r" xmlns:xacro="http://www.ros.org/wiki/xacro">'
    robot.write_text(f'{head}<link name="base"/><xacro:include filename="{included}"/></robot>')
    server = Server(str(robot))
    try:
        first = server.robot()
        assert 'macros.xacro' in first['error']
        save(included, f'{head}<link name="wrong"></robot>')
        second = server.robot(after=first['version'])
        assert 'macros.xacro' in second['error']
        save(included, f'{head}<joint name="j" type="fixed"><parent link="base"/>'
             '<child link="tool"/></joint><link name="tool"/></robot>')
        third = server.robot(after=second['version'])
        assert [link['name'] for link in third['robots'][0]['links']] == ['base', 'tool']
        save(included, included.read_text().replace('tool', 'gripper'))
        fourth = server.robot(after=third['version'])
        assert [link['name'] for link in fourth['robots'][0]['links']] == ['base', 'gripper']
    finally:
        server.close()


def test_mesh_that_appears(robot: Path) -> None:
    robot.write_text(MESH.format('meshes/a.stl'))
    server = Server(str(robot))
    try:
        assert server.robot()['meshes'][0]['reason'].startswith('it is not found')
        (robot.parent / 'meshes').mkdir()
        (robot.parent / 'meshes' / 'a.stl').write_bytes(b'triangles')
        changed = server.robot(after=1)
        assert (changed['version'], changed['meshes'][0]['reason']) == (2, '')
    finally:
        server.close()


def test_page_that_is_closed_while_it_waits(server: Server, robot: Path) -> None:
    connection = HTTPConnection('127.0.0.1', server.port, timeout=LONGEST_SECONDS)
    connection.request('GET', '/robot.json?after=1', headers={'Host': 'localhost'})
    connection.close()
    robot.write_text(LINK.format('another'))
    assert server.robot(after=1)['robots'][0]['name'] == 'another'
    server.process.send_signal(signal.SIGINT)
    assert communicate(server.process)[1] == ''


def test_robot_that_is_wrong_at_the_start(robot: Path) -> None:
    robot.write_text('<robot>')
    server = Server(str(robot))
    try:
        error = server.robot()['error']
        assert 'robot.urdf' in error
        assert server.process.stderr.readline() == f'robot_view: error: {error}\n'
        assert server.get('/mesh/0')[0].status == 404
    finally:
        server.close()


def test_texture_by_its_number(shared: Server) -> None:
    numbers = {mesh['uri']: number for number, mesh in enumerate(shared.robot()['meshes'])}
    answer, data = shared.get(f'/mesh/{numbers["a.png"]}')
    assert (answer.getheader('Content-Type'), data) == ('image/png', b'picture')
    assert shared.get(f'/mesh/{numbers["../../outside.png"]}')[0].status == 404
    mesh, _ = shared.get(f'/mesh/{numbers["a.dae"]}')
    assert mesh.getheader('Content-Type') == 'application/octet-stream'


def test_mesh_by_its_number(shared: Server) -> None:
    meshes = shared.robot()['meshes']
    assert meshes[0]['uri'] == 'a.stl'
    assert shared.get('/mesh/0')[1] == b'triangles'
    answer, data = shared.get('/mesh/0', method='HEAD')
    assert (answer.status, answer.getheader('Content-Length'), data) == (200, '9', b'')
    for path in (f'/mesh/{len(meshes)}', '/mesh/-1', '/mesh/../robot.urdf', '/mesh/0/../../a.stl',
                 '/a.stl', '/page/../view.py', '/page/%2e%2e%2fserver.py', '/page/server.py'):
        assert shared.get(path)[0].status == 404, path


def test_mesh_that_is_replaced_by_a_link(robot: Path) -> None:
    mesh = robot.parent / 'a.stl'
    mesh.write_bytes(b'triangles')
    (robot.parent / 'secret').write_bytes(b'secret')
    robot.write_text(MESH.format('a.stl'))
    server = Server(str(robot))
    try:
        (robot.parent / 'link').symlink_to('secret')
        (robot.parent / 'link').replace(mesh)
        assert server.get('/mesh/0')[0].status == 404
    finally:
        server.close()


def peak_memory(process: int) -> int:
    """Return the largest memory that a process has had in bytes."""
    status = Path(f'/proc/{process}/status').read_text()
    return int(re.search(r'VmHWM:\s*(\d+) kB', status)[1]) * 1024


def test_connections_that_read_nothing(shared: Server) -> None:
    number, = (number for number, mesh in enumerate(shared.robot()['meshes'])
               if mesh['uri'] == 'large.stl')
    connections = []
    try:
        before = peak_memory(shared.process.pid)
        for _ in range(8):
            connection = HTTPConnection('127.0.0.1', shared.port, timeout=LONGEST_SECONDS)
            connection.request('GET', f'/mesh/{number}', headers={'Host': 'localhost'})
            connections.append(connection)
            assert connection.getresponse().read(1) == b'\0'
        assert peak_memory(shared.process.pid) - before < LARGE
    finally:
        for connection in connections:
            connection.close()


def test_limit_of_connections(server: Server) -> None:
    connections = []
    try:
        with pytest.raises((ConnectionError, BadStatusLine)):
            for _ in range(BoundedServer.most_of_address + 1):
                connection = HTTPConnection('127.0.0.1', server.port, timeout=LONGEST_SECONDS)
                connections.append(connection)
                connection.request('GET', '/', headers={'Host': 'localhost'})
                assert connection.getresponse().read()
    finally:
        for connection in connections:
            connection.close()
    assert len(connections) == BoundedServer.most_of_address + 1


def test_foreign_hosts_are_refused(shared: Server) -> None:
    for path in ('/', '/robot.json', '/page/view.js'):
        assert {host: shared.get(path, host)[0].status for host in (
            'localhost', '127.0.0.1', 'example.org', 'localhost.example.org', '192.168.1.5')} == {
            'localhost': 200, '127.0.0.1': 200, 'example.org': 403, 'localhost.example.org': 403,
            '192.168.1.5': 403}, path


def test_headers_of_the_page(shared: Server) -> None:
    for path in ('/', '/robot.json', '/page/three.js', '/unknown'):
        answer, _ = shared.get(path)
        assert answer.getheader('Content-Security-Policy').startswith("default-src 'none'; ")
        assert 'unsafe' not in answer.getheader('Content-Security-Policy')
        assert answer.getheader('X-Content-Type-Options') == 'nosniff'
        assert answer.getheader('Access-Control-Allow-Origin') is None
        assert answer.getheader('Cross-Origin-Resource-Policy') == 'same-origin'
    assert shared.get('/', method='POST')[0].status == 405


@pytest.mark.parametrize('waiting', [0, 3, 40])
def test_end_at_ctrl_c(robot: Path, waiting: int) -> None:
    server = Server(str(robot))
    assert server.line == (f'Open http://localhost:{server.port}/ in a browser; Ctrl-C ends the '
                           'page\n')
    connections = [HTTPConnection('127.0.0.1', server.port) for _ in range(waiting)]
    for connection in connections:
        connection.request('GET', '/robot.json?after=1', headers={'Host': 'localhost'})
    server.get('/')  # the other requests have been read
    server.process.send_signal(signal.SIGINT)
    _, errors = communicate(server.process)
    assert (server.process.returncode, errors) == (0, '')
    for connection in connections:
        connection.close()


def test_port_in_use(shared: Server, robot: Path) -> None:
    finished = subprocess.run(
        [sys.executable, '-m', 'opencv_tools.robot.cli', 'robot_view', str(robot), '--port',
         str(shared.port)], capture_output=True, text=True, timeout=LONGEST_SECONDS, check=False)
    assert finished.returncode == 2
    assert finished.stderr == (
        f'robot_view: error: port {shared.port} cannot be used: Address already in use; choose '
        'another with --port\n')


@pytest.mark.parametrize(('arguments', 'error'), [
    (['none.urdf'], 'none.urdf: cannot be read: No such file or directory'),
    ([''], "FILE is '': give the name of a file"),
    (['a.urdf', ''], "FILE2 is '': give the name of a file"),
    (['a.urdf', '--html', ''], "--html is '': give the name of a file"),
    (['a.urdf', '--html', 'a.html', '--port', '0'],
     '--port is for the page on this machine, and --html writes a file: leave out one of them'),
])
def test_arguments_that_are_wrong(
    arguments: list[str], error: str, capsys: pytest.CaptureFixture[str],
) -> None:
    assert robot_view(arguments) == 2
    assert capsys.readouterr().err == f'robot_view: error: {error}\n'
