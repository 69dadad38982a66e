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

"""Addresses, tokens, hosts and origins of ``img_viewer``."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Iterator
from contextlib import ExitStack, suppress
import ipaddress
import itertools
import json
import os
from pathlib import Path
import re
import socket
import subprocess
from typing import Any
from urllib.parse import urlsplit

from conftest import call_service, executable, free_domain, NodeProcess
import cv2
from documentation import ROOT
import numpy as np
from opencv_tools.frames import FramePublisher
from opencv_tools.image_codecs import encode_image
from opencv_tools.viewer.graph import MAX_TOPICS
import pytest
from rcl_interfaces.srv import GetParameters
from rclpy.node import Node
from sensor_msgs.msg import Image
from tornado.httpclient import HTTPResponse
from viewing import address_of, Camera, fetch, Page, publishing, run_page, ShownPicture
from waiting import LONGEST_SECONDS, result_of, until

Start = Callable[..., NodeProcess]
TOKEN = 'open-sesame'
DEPTH = np.arange(48 * 64, dtype=np.uint16).reshape(48, 64)


@pytest.fixture
def viewer(start: Start) -> NodeProcess:
    """Start a viewer on any free port."""
    return start('img_viewer', port=0)


@pytest.fixture(scope='module')
def shared(tmp_path_factory: pytest.TempPathFactory) -> Iterator[NodeProcess]:
    """Start a viewer without topics, for all tests that only ask it."""
    folder = tmp_path_factory.mktemp('shared')
    with free_domain() as number:
        process = NodeProcess(
            [executable('img_viewer'), '--ros-args', '-p', 'port:=0'], folder / 'viewer.log',
            {**os.environ, 'ROS_DOMAIN_ID': str(number), 'ROS_HOME': str(folder),
             'ROS_AUTOMATIC_DISCOVERY_RANGE': 'LOCALHOST'})
        yield process
        process.kill()


@pytest.fixture
def guarded(start: Start) -> NodeProcess:
    """Start a viewer with a token."""
    return start('img_viewer', port=0, token=TOKEN)


def test_token_is_needed_everywhere(guarded: NodeProcess) -> None:
    async def ask() -> None:
        url = address_of(guarded)
        assert url.endswith(f'/?token={TOKEN}')
        requests = []
        wrong = itertools.cycle(('wrong-token', TOKEN[:-1], TOKEN + 'x'))  # a second for each
        for path in ('/topics', '/snapshot?topic=/a', '/stream?topic=/a',
                     '/stream_viewer?topic=/a', '/ws', '/unknown'):
            for given in ('', next(wrong)):
                joined = path + ('&' if '?' in path else '?') + f'token={given}'
                requests.append((given, fetch(url, joined)))
        for given, request in requests:
            answer = await request
            assert (given, answer.code) == (given, 403)
            assert answer.body == (
                b'the token is wrong: open the address that the node has printed\n' if given else
                b'a token is needed: open the address that the node has printed\n')
            assert 'Set-Cookie' not in answer.headers
        answer = await fetch(url, '/')
        assert answer.code == 403
        assert b'name="token"' in answer.body
        assert (await fetch(url, '/healthz')).code == 200
        with pytest.raises(Exception, match='403'):
            await Page.connect(url.replace(TOKEN, 'wrong-token'))

    run_page(ask())
    assert 'wrong-token' not in guarded.output
    assert 0 < guarded.output.count('127.0.0.1 has given a wrong token') < 5


def test_log_does_not_have_the_token(start: Start) -> None:
    viewer = start('img_viewer', port=0, token=TOKEN, nonsense=1)
    assert TOKEN in address_of(viewer)
    viewer.interrupt()
    assert viewer.finish() == 0
    text = ''.join(file.read_text() for file in Path(os.environ['ROS_HOME']).rglob('*.log'))
    assert 'unknown parameter nonsense' in text
    assert TOKEN not in text


def test_token_of_the_url_becomes_a_cookie(guarded: NodeProcess) -> None:
    async def ask() -> None:
        url = address_of(guarded)
        port = url.partition('/?')[0].rpartition(':')[2]
        answer = await fetch(url, f'/?token={TOKEN}')
        assert answer.code == 200
        cookie = answer.headers['Set-Cookie']
        assert cookie.startswith(f'img_viewer_{port}={TOKEN};')
        assert {part.strip() for part in cookie.split(';')[1:]} == {
            'HttpOnly', 'Path=/', 'SameSite=Strict'}
        given = {'Cookie': cookie.partition(';')[0]}
        assert (await fetch(url, '/', **given)).body == answer.body
        assert (await fetch(url, '/topics', **given)).code == 200
        assert (await fetch(url, '/topics', Authorization=f'Bearer {TOKEN}')).code == 200
        page = await Page.connect(url.partition('?')[0], **given)
        assert await page.text('hello')

    run_page(ask())


@pytest.mark.thorough
def test_token_of_a_file_is_kept(start: Start, tmp_path: Path) -> None:
    tokens = set()
    for _ in range(2):
        viewer = start('img_viewer', port=0, token_file=tmp_path / 'token')
        url = address_of(viewer)
        tokens.add(url.partition('?token=')[2])
        assert run_page(fetch(url, '/topics')).code == 403
        answer = run_page(fetch(url, '/?' + url.partition('?')[2]))
        assert '; Max-Age=7776000;' in answer.headers['Set-Cookie']
        viewer.interrupt()
        assert viewer.finish() == 0
    assert tokens == {(tmp_path / 'token').read_text().strip()}
    (tmp_path / 'token').chmod(0o644)
    viewer = start('img_viewer', port=0, token_file=tmp_path / 'token')
    assert viewer.finish() == 1
    assert 'others can read it (mode 644)' in viewer.output


def test_token_is_no_public_parameter(guarded: NodeProcess, node: Node) -> None:
    address_of(guarded)
    answer = call_service(node, GetParameters, '/image_viewer/get_parameters',
                          GetParameters.Request(names=['token', 'token_file']))
    assert [value.string_value for value in answer.values] == ['***', '']


def test_any_host_with_a_token(guarded: NodeProcess) -> None:
    async def ask() -> None:
        url = address_of(guarded)
        given = {'Host': 'robot.tailnet.ts.net', 'Authorization': f'Bearer {TOKEN}'}
        assert (await fetch(url, '/topics', **given)).code == 200
        assert (await fetch(url, '/topics', Host='robot.tailnet.ts.net')).code == 403

    run_page(ask())


def test_pages_that_may_show_pictures(start: Start, node: Node) -> None:
    viewer = start('img_viewer', port=0, allowed_origins='http://10.0.0.5:3000')
    camera = Camera(node, 'map', latched=True)
    camera.publish(DEPTH, 'mono16')

    async def policy(path: str, **headers: str) -> tuple[str, str]:
        answer = await fetch(address_of(viewer), path, 'HEAD', **headers)
        assert answer.code == 200
        return (answer.headers['Cross-Origin-Resource-Policy'],
                answer.headers.get('Access-Control-Allow-Origin', ''))

    async def ask() -> None:
        await until_listed(address_of(viewer), '/map')
        for path in ('/snapshot?topic=/map', '/stream?topic=/map'):
            for given in ({'Origin': 'http://10.0.0.5:3000'},
                          {'Referer': 'http://10.0.0.5:3000/page'}):
                assert await policy(path, **given) == ('cross-origin', 'http://10.0.0.5:3000')
            for given in ({'Origin': 'http://10.0.0.6:3000'}, {'Origin': 'null'}, {}):
                assert await policy(path, **given) == ('same-site', '')
        for path in ('/', '/topics', '/page/viewer.js'):
            assert await policy(path, Origin='http://10.0.0.5:3000') == ('same-site', '')

    run_page(ask())


def test_half_open_connections(viewer: NodeProcess) -> None:
    url = address_of(viewer)
    port = int(url.rstrip('/').rpartition(':')[2])
    with ExitStack() as stack:
        for _ in range(300):
            connection = stack.enter_context(
                socket.create_connection(('127.0.0.1', port), timeout=LONGEST_SECONDS))
            with suppress(OSError):  # the server may have closed it
                connection.sendall(b'GET / HTTP/1.1\r\n')
        with socket.create_connection(('127.0.0.1', port), timeout=LONGEST_SECONDS,
                                      source_address=('127.0.0.3', 0)) as other:
            other.sendall(b'GET /healthz HTTP/1.0\r\nHost: localhost\r\n\r\n')
            assert other.recv(100).startswith(b'HTTP/1.1 200')


def test_other_addresses_have_a_token(start: Start) -> None:
    viewers = [start('img_viewer', port=0, address='0.0.0.0') for _ in range(2)]
    found = [re.fullmatch(r'http://([^/]+):\d+/\?token=([\w-]{20,})', address_of(viewer))
             for viewer in viewers]
    assert found[0] and found[1]
    assert found[0][1] == socket.gethostname()
    assert found[0][2] != found[1][2]
    others = re.findall(rf', or http://([0-9.]+):\d+/\?token={found[0][2]}$', viewers[0].output,
                        re.MULTILINE)
    route = Path('/proc/net/route').read_text().splitlines()[1:]
    assert len(others) == any(line.split()[1] == '00000000' for line in route)
    assert others == [] or ipaddress.ip_address(others[0])


@pytest.mark.quick_cases(1)
@pytest.mark.parametrize('host', ['evil.example', 'evil.example:8080', 'localhost.evil.example'])
def test_foreign_host_is_refused(shared: NodeProcess, host: str) -> None:
    async def ask() -> None:
        url = address_of(shared)
        for path in ('/', '/page/viewer.js', '/topics', '/healthz', '/ws', '/unknown'):
            answer = await fetch(url, path, Host=host)
            assert (path, answer.code) == (path, 403)
            assert b'is not a name of this machine' in answer.body
        assert (await fetch(url, '/', Host='localhost')).code == 200

    run_page(ask())


def test_allowed_host(start: Start) -> None:
    viewer = start('img_viewer', port=0, allowed_hosts='robot.example.org')
    assert run_page(fetch(address_of(viewer), '/', Host='robot.example.org:80')).code == 200


@pytest.mark.parametrize('origin', [
    'http://evil.example', 'null', 'http://127.0.0.1:1', 'http://[::', 'http://a]', 'http://[x]'])
def test_foreign_origin_gets_no_websocket(shared: NodeProcess, origin: str) -> None:
    async def ask() -> None:
        url = address_of(shared)
        with pytest.raises(Exception, match='403'):
            await Page.connect(url, Origin=origin)
        page = await Page.connect(url, Origin=url.rstrip('/'))
        assert await page.text('hello')

    run_page(ask())
    assert 'ERROR' not in shared.output


def test_headers_of_every_answer(shared: NodeProcess) -> None:
    async def ask() -> None:
        url = address_of(shared)
        for path in ('/', '/page/viewer.js', '/topics', '/unknown', '/healthz'):
            headers = (await fetch(url, path)).headers
            policy = headers['Content-Security-Policy']
            assert policy.startswith("default-src 'none'; ")
            assert ("script-src 'self';" in policy) == (path != '/unknown')
            assert 'unsafe' not in policy
            assert "frame-ancestors 'none'" in policy
            assert headers['X-Content-Type-Options'] == 'nosniff'
            assert headers['Referrer-Policy'] == 'no-referrer'
            assert headers['Cross-Origin-Resource-Policy'] == 'same-site'
            assert 'Access-Control-Allow-Origin' not in headers
            assert 'Server' not in headers

    run_page(ask())


def test_files_of_the_page(shared: NodeProcess) -> None:
    async def ask() -> None:
        url = address_of(shared)
        answer = await fetch(url, '/page/viewer.js')
        assert (answer.code, answer.headers['Content-Type']) == (
            200, 'text/javascript; charset=utf-8')
        again = await fetch(url, '/page/viewer.js', **{'If-None-Match': answer.headers['ETag']})
        assert (again.code, again.body) == (304, b'')
        for path in ('/page/', '/page', '/page/nothing.js', '/page/index.html',
                     '/page/../server.py', '/page/%2e%2e/server.py', '/page/..%2fserver.py',
                     '/page//etc/passwd', '/../../etc/passwd', '/viewer.js', '/static/x'):
            answer = await fetch(url, path)
            assert (path, answer.code, answer.body) == (path, 404, b'there is no such page\n')

    run_page(ask())


def test_texts_are_sent_compressed(shared: NodeProcess) -> None:
    async def ask() -> None:
        pages = ROOT / 'opencv_tools'
        for path, file in (('/page/viewer.js', 'viewer/page/viewer.js'),
                           ('/page/viewer.css', 'viewer/page/viewer.css'),
                           ('/', 'viewer/page/index.html'),
                           ('/robot/page/three.js', 'robot/view/page/three.js')):
            answer = await fetch(address_of(shared), path)
            # The client has decoded it, and the header then has another name.
            assert answer.headers['X-Consumed-Content-Encoding'] == 'gzip', path
            assert answer.body == (pages / file).read_bytes()

    run_page(ask())


def test_head(shared: NodeProcess) -> None:
    async def ask() -> None:
        url = address_of(shared)
        for path in ('/', '/page/viewer.js', '/topics', '/healthz', '/nothing'):
            whole, head = await fetch(url, path), await fetch(url, path, 'HEAD')
            assert (path, head.code, head.body) == (path, whole.code, b'')
            assert head.headers['Content-Type'] == whole.headers['Content-Type']
        assert (await fetch(url, '/ws', 'HEAD')).code == 405

    run_page(ask())


@pytest.mark.parametrize('method', ['POST', 'PUT', 'DELETE', 'PATCH', 'OPTIONS'])
def test_only_get_is_allowed(shared: NodeProcess, method: str) -> None:
    async def ask() -> None:
        for path in ('/', '/topics', '/snapshot?topic=/a'):
            assert (await fetch(address_of(shared), path, method)).code == 405

    run_page(ask())


def test_hostile_requests(shared: NodeProcess) -> None:
    address_of(shared)
    port = int(address_of(shared).rstrip('/').rpartition(':')[2])
    for request in (b'\0' * 1000, b'GET / HTTP/1.1\r\n' + b'a: b\r\n' * 10_000,
                    b'GET /' + b'a' * 100_000 + b' HTTP/1.1\r\n\r\n',
                    b'POST / HTTP/1.1\r\nHost: localhost\r\nContent-Length: 99999999\r\n\r\n',
                    b'GET /%ff?topic=%ff HTTP/1.1\r\nHost: localhost\r\n\r\n',
                    b'GET / HTTP/1.1\r\n\r\n',
                    b'GET / HTTP/1.1\r\nHost: localhost\r\nHost: evil.example\r\n\r\n'):
        with socket.create_connection(('127.0.0.1', port), timeout=LONGEST_SECONDS) as connection:
            answer = b''
            with suppress(OSError):  # the server closes the connection early
                connection.sendall(request)
                connection.shutdown(socket.SHUT_WR)
                answer = connection.recv(1000)
            assert answer == b'' or answer.startswith(b'HTTP/1.1 4'), request[:40]
    assert run_page(fetch(address_of(shared), '/healthz')).body == b'ok\n'
    assert 'Traceback' not in shared.output


def test_topics_and_their_state(viewer: NodeProcess, node: Node) -> None:
    camera, _ = Camera(node, 'image'), Camera(node, 'image/compressed', compressed=True)

    async def ask() -> None:
        url = address_of(viewer)

        async def topics() -> list[dict[str, Any]]:
            answer = json.loads((await fetch(url, '/topics')).body)
            assert answer['node'] == '/image_viewer'
            return answer['topics']

        while [(topic['transports'], topic['nodes']) for topic in await topics()] != [
                (['raw', 'compressed'], ['/plain'])]:
            pass
        assert json.loads((await fetch(url, '/topics')).body)['more'] == 0
        (topic,) = await topics()
        assert topic == {'id': 1, 'name': '/image', 'transports': ['raw', 'compressed'],
                         'nodes': ['/plain'], 'publishers': 1}
        page = await Page.connect(url)
        await page.send(subscribe='/image')
        await page.text('status')
        (topic,) = await topics()
        assert topic['viewers'] == 1
        assert topic['status']['frames'] == 0
        assert camera.publisher.get_subscription_count() == 0

    run_page(ask())


@pytest.mark.thorough
def test_topic_beyond_the_list(viewer: NodeProcess, node: Node) -> None:
    for number in range(MAX_TOPICS + 5):
        node.create_publisher(Image, f'a/t{number}', 1)
    camera = Camera(node, 'zebra')

    async def ask() -> None:
        url = address_of(viewer)
        answer = {'more': 0}
        while answer['more'] < 6:
            answer = json.loads((await fetch(url, '/topics')).body)
        assert len(answer['topics']) == MAX_TOPICS
        answer = await publishing(lambda: camera.publish(DEPTH, 'mono16'),
                                  fetch(url, '/snapshot?topic=/zebra'))
        assert answer.code == 200
        answer = await fetch(url, '/snapshot?topic=/nothing')
        assert (answer.code, answer.body.split(b' is ')[0]) == (404, b'/nothing')
        assert answer.body.endswith(b' and 201 more\n')
        page = await Page.connect(url)
        assert await page.text('more') in (5, 6)  # the last topic was just looked at
        await page.send(subscribe='/zebra')
        state = await page.status(lambda state: state['reason'])
        assert state['reason'].startswith(
            'no frame arrives from the publisher of /zebra (node /plain)')

    run_page(ask())


async def jpeg_sizes(url: str, camera: Camera, paths: list[str]) -> list[tuple[int, ...]]:
    sizes = []
    for path in paths:
        answer = await publishing(lambda: camera.publish(DEPTH, 'mono16'), fetch(url, path))
        assert (answer.code, answer.headers['Content-Type']) == (200, 'image/jpeg')
        assert re.fullmatch(r'[1-9]\d*\.000000000', answer.headers['X-Timestamp'])
        sizes.append(cv2.imdecode(np.frombuffer(answer.body, np.uint8), -1).shape[1::-1])
    return sizes


def test_snapshots(viewer: NodeProcess, node: Node) -> None:
    camera = Camera(node, 'image')

    async def ask() -> None:
        url = address_of(viewer)
        await until_listed(url, '/image')
        assert await jpeg_sizes(url, camera, [
            '/snapshot?topic=/image', '/snapshot?topic=image&width=32',
            '/snapshot?topic=/image&height=12&quality=50', '/snapshot?topic=/image&width=1000',
        ]) == [(64, 48), (32, 24), (16, 12), (64, 48)]
        answer = await publishing(lambda: camera.publish(DEPTH, 'mono16'),
                                  fetch(url, '/snapshot?topic=/image&format=original'))
        name = re.fullmatch(r'attachment; filename="([\w.-]+)"',
                            answer.headers['Content-Disposition'])
        assert name
        assert re.fullmatch(r'image_\d+\.000000000\.png', name[1])
        stored = cv2.imdecode(np.frombuffer(answer.body, np.uint8), cv2.IMREAD_UNCHANGED)
        assert stored.dtype == np.uint16
        assert np.array_equal(stored, DEPTH)

    run_page(ask())


def test_original_of_a_camera_with_raw_and_compressed(viewer: NodeProcess, node: Node) -> None:
    raw, camera = Camera(node, 'image'), Camera(node, 'image/compressed', compressed=True)
    jpeg = encode_image(DEPTH.astype(np.uint8), '.jpg').tobytes()

    def publish() -> None:
        raw.publish(DEPTH, 'mono16')
        camera.publish_compressed(jpeg)

    async def ask() -> None:
        url = address_of(viewer)
        while b'"raw", "compressed"' not in (await fetch(url, '/topics')).body:
            pass
        answer = await publishing(publish, fetch(url, '/snapshot?topic=/image&format=original'))
        stored = cv2.imdecode(np.frombuffer(answer.body, np.uint8), cv2.IMREAD_UNCHANGED)
        assert np.array_equal(stored, DEPTH)
        answer = await publishing(publish, fetch(url, '/snapshot?topic=/image'))
        assert answer.body == jpeg
        await until(lambda: raw.publisher.get_subscription_count() == 0)

    run_page(ask())


@pytest.mark.quick_cases(1)
@pytest.mark.parametrize(('encoding', 'suffix'), [('32FC1', 'tiff'), ('64FC2', 'npy')])
def test_snapshot_in_the_first_lossless_format(
        viewer: NodeProcess, node: Node, encoding: str, suffix: str) -> None:
    camera = Camera(node, 'image')
    image = np.random.default_rng(3).normal(size=(6, 8, 2))
    image = image[..., 0].astype(np.float32) if encoding == '32FC1' else image

    async def ask() -> None:
        url = address_of(viewer)
        await until_listed(url, '/image')
        answer = await publishing(lambda: camera.publish(image, encoding),
                                  fetch(url, '/snapshot?topic=/image&format=original'))
        assert answer.headers['Content-Disposition'].endswith(f'.{suffix}"')

    run_page(ask())


def test_snapshots_of_a_publisher_of_floats(viewer: NodeProcess, node: Node) -> None:
    publisher = FramePublisher(node, 'depth')

    def publish() -> None:
        publisher.publish(np.linspace(1, 2, 48, dtype=np.float32).reshape(6, 8))

    async def ask() -> None:
        url = address_of(viewer)
        await until_listed(url, '/depth')  # also as a compressed topic, until the first frame
        for name in ('/depth', '/depth', '/depth/compressed'):
            answer = await publishing(publish, fetch(url, f'/snapshot?topic={name}'))
            picture = cv2.imdecode(np.frombuffer(answer.body, np.uint8), cv2.IMREAD_UNCHANGED)
            assert picture.shape[:2] == (6, 8)

    run_page(ask())
    publisher.destroy()


def test_snapshot_of_a_compressed_topic_is_unchanged(viewer: NodeProcess, node: Node) -> None:
    camera = Camera(node, 'image/compressed', compressed=True)
    for suffix in ('.png', '.jpg'):
        data = encode_image(DEPTH.astype(np.uint8), suffix).tobytes()

        async def ask(data: bytes = data, suffix: str = suffix) -> None:
            url = address_of(viewer)
            await until_listed(url, '/image')
            answer = await publishing(
                lambda: camera.publish_compressed(data, suffix[1:]),
                fetch(url, '/snapshot?topic=/image/compressed&format=original'))
            assert answer.body == data
            assert answer.headers['Content-Disposition'].endswith(f'{suffix}"')

        run_page(ask())


@pytest.mark.thorough
def test_unread_snapshot_is_a_viewer(start: Start, node: Node) -> None:
    viewer = start('img_viewer', port=0, viewers=1)
    camera = Camera(node, 'map', latched=True)
    camera.publish(np.random.default_rng(4).integers(0, 255, (2000, 3000, 3), np.uint8))

    async def ask() -> None:
        url = address_of(viewer)
        await until_listed(url, '/map')
        with socket.socket() as unread:
            unread.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 2048)
            unread.settimeout(LONGEST_SECONDS)
            unread.connect((urlsplit(url).hostname, urlsplit(url).port))
            unread.sendall(b'GET /snapshot?topic=/map&format=original HTTP/1.1\r\n'
                           b'Host: localhost\r\n\r\n')
            assert (await asyncio.to_thread(unread.recv, 12)) == b'HTTP/1.1 200'
            answer = await fetch(url, '/snapshot?topic=/map&width=32')
            assert (answer.code, answer.body[:18]) == (503, b'1 pages look alrea')
        while (await fetch(url, '/snapshot?topic=/map&width=32')).code != 200:
            pass

    run_page(ask())


def test_snapshot_without_frames_has_the_reason(viewer: NodeProcess, node: Node) -> None:
    camera = Camera(node, 'image')

    async def ask() -> None:
        url = address_of(viewer)
        await until_listed(url, '/image')
        answer = await fetch(url, '/snapshot?topic=/image')
        assert answer.code == 503
        assert answer.body.startswith(
            b'no frame arrives from the publisher of /image (node /plain)')
        answer = await publishing(lambda: camera.publish(DEPTH[:0], 'mono16'),
                                  fetch(url, '/snapshot?topic=/image'))
        assert answer.code == 503
        assert answer.body == b'the frame cannot be shown: the image is empty (64x0)\n'

    run_page(ask())


@pytest.mark.parametrize(('path', 'code', 'sentence'), [
    ('/snapshot', 400, 'the name of a topic is missing'),
    ('/snapshot?topic=/none', 404, '/none is not an image topic; no images are published'),
    ('/snapshot?topic=/a&width=x', 400, "width is 'x': give a number from 0 to 65535"),
    ('/snapshot?topic=/a&quality=101', 400, 'quality is'),
    ('/stream?topic=/none', 404, '/none is not an image topic'),
    ('/stream?topic=/a&type=vp8', 400, "type 'vp8' is not available: use mjpeg"),
    ('/stream?topic=/a&type=ros_compressed', 400, "type 'ros_compressed' is not available"),
    ('/stream_viewer', 400, 'the name of a topic is missing')])
def test_requests_that_cannot_be_fulfilled(
        shared: NodeProcess, path: str, code: int, sentence: str) -> None:
    answer = run_page(fetch(address_of(shared), path))
    assert answer.code == code
    assert answer.body.decode().startswith(sentence)
    assert answer.headers['Content-Type'] == 'text/plain; charset=utf-8'


async def until_listed(url: str, name: str) -> None:
    while f'"{name}"'.encode() not in (await fetch(url, '/topics')).body:
        pass


async def read_parts(url: str, path: str, count: int) -> list[bytes]:
    """Read parts of a stream as a browser does: the boundary ends a part."""
    address = urlsplit(url)
    reader, writer = await asyncio.open_connection(address.hostname, address.port)
    writer.write(f'GET {path} HTTP/1.0\r\nHost: localhost\r\n\r\n'.encode())
    head = (await reader.readuntil(b'\r\n\r\n')).decode()
    boundary = re.search('^Content-Type: multipart/x-mixed-replace;boundary=(.{20,})\r$', head,
                         re.MULTILINE)
    assert boundary, head
    begins = f'--{boundary[1]}\r\nContent-Type: image/jpeg\r\n'.encode()
    parts = []
    while len(parts) <= count:
        part = await result_of(reader.readuntil(begins))
        parts.append(part.removesuffix(begins).partition(b'\r\n\r\n')[2].removesuffix(b'\r\n'))
    writer.close()
    return parts[1:]


def test_stream_of_a_compressed_topic(viewer: NodeProcess, node: Node) -> None:
    camera = Camera(node, 'image/compressed', compressed=True)
    jpegs = [encode_image(np.full((8, 8), value, np.uint8), '.jpg').tobytes()
             for value in (0, 100, 200)]

    async def ask() -> None:
        url = address_of(viewer)
        await until_listed(url, '/image')
        parts = await publishing(
            lambda: camera.publish_compressed(jpegs[camera.number % 3]),
            read_parts(url, '/stream?topic=/image&type=mjpeg', 5))
        assert set(parts) <= set(jpegs)
        assert len(set(parts)) > 1
        await until(lambda: camera.publisher.get_subscription_count() == 0)

    run_page(ask())


def test_stream_with_a_lower_quality(viewer: NodeProcess, node: Node) -> None:
    camera = Camera(node, 'image/compressed', compressed=True)
    jpeg = encode_image(
        np.random.default_rng(5).integers(0, 255, (48, 64, 3), np.uint8), '.jpg').tobytes()

    async def ask() -> None:
        url = address_of(viewer)
        await until_listed(url, '/image')
        (part,) = await publishing(lambda: camera.publish_compressed(jpeg),
                                   read_parts(url, '/stream?topic=/image&quality=20', 1))
        assert len(part) < len(jpeg) / 2
        answer = await publishing(lambda: camera.publish_compressed(jpeg),
                                  fetch(url, '/snapshot?topic=/image&quality=20'))
        assert answer.body == part

    run_page(ask())


def test_last_picture_of_a_stream_is_repeated(viewer: NodeProcess, node: Node) -> None:
    camera = Camera(node, 'map', latched=True)
    camera.publish(np.zeros((48, 64), np.uint8), 'mono8')

    async def ask() -> None:
        url = address_of(viewer)
        await until_listed(url, '/map')
        # A browser shows a part when the next one begins.
        (part,) = await read_parts(url, '/stream?topic=/map&width=32', 1)
        assert cv2.imdecode(np.frombuffer(part, np.uint8), -1).shape == (24, 32)

    run_page(ask())


def test_open_requests_do_not_delay_the_end(viewer: NodeProcess, node: Node) -> None:
    cameras = [Camera(node, 'map', latched=True), Camera(node, 'silent')]
    cameras[0].publish(np.zeros((48, 64), np.uint8), 'mono8')

    async def ask() -> None:
        url = address_of(viewer)
        await until_listed(url, '/map')
        await until_listed(url, '/silent')
        requests = [asyncio.ensure_future(fetch(url, path)) for path in (
            '/stream?topic=/map', '/snapshot?topic=/silent')]
        for camera in cameras:
            await camera.seen()
        viewer.interrupt()
        await asyncio.wait(requests)

    run_page(ask())
    assert viewer.finish() == 0
    assert 'ERROR' not in viewer.output


def test_page_of_a_stream(shared: NodeProcess) -> None:
    answer = run_page(fetch(
        address_of(shared), '/stream_viewer?topic=/a&width=3&quality=%22%3E%3Cscript%3E'))
    text = answer.body.decode()
    assert 'src="/stream?topic=%2Fa&amp;width=3&amp;quality=%22%3E%3Cscript%3E"' in text
    assert '<script' not in text


@pytest.mark.thorough
def test_tls(start: Start, tmp_path: Path) -> None:
    certificate, key = tmp_path / 'certificate.pem', tmp_path / 'key.pem'
    subprocess.run(
        ['openssl', 'req', '-x509', '-newkey', 'ec', '-pkeyopt', 'ec_paramgen_curve:P-256',
         '-nodes', '-days', '2', '-subj', '/CN=localhost', '-keyout', str(key), '-out',
         str(certificate)], check=True, capture_output=True, timeout=LONGEST_SECONDS)
    viewer = start('img_viewer', port=0, token=TOKEN, certificate=certificate, key=key)

    async def ask() -> None:
        url = address_of(viewer)
        assert url.startswith('https://127.0.0.1:')
        answer = await fetch(url, f'/?token={TOKEN}')
        assert answer.code == 200
        assert 'Secure' in answer.headers['Set-Cookie']
        assert await (await Page.connect(url)).text('hello')

    run_page(ask())
    assert viewer.is_running()
    for given, reason in (
            ({'certificate': certificate}, f'{certificate} has no private key in PEM format; set'),
            ({'certificate': key}, f'{key} has no certificate in PEM format; set certificate')):
        refused = start('img_viewer', port=0, token=TOKEN, **given)
        assert refused.finish() == 1
        assert f'cannot be used: {reason}' in refused.output


def test_file_of_the_displayed_picture(guarded: NodeProcess, node: Node) -> None:
    front, rear = Camera(node, '/front'), Camera(node, '/rear')
    url = address_of(guarded)

    def gray(level: int) -> np.ndarray:
        return np.full((48, 64, 3), level, np.uint8)

    async def save(page: Page, topic: str, picture: int) -> HTTPResponse:
        await page.send(file=topic, picture=picture)
        return await fetch(url, f'{(await page.text("file"))["address"]}&token={TOKEN}')

    async def act() -> None:
        page = await Page.connect(url)
        while len(await page.text('topics')) < 2:
            pass
        for camera in (front, rear):
            await page.send(subscribe=camera.publisher.topic_name, looks=True)
            await camera.seen()
        shown: dict[str, ShownPicture] = {}
        for level in (50, 110, 170):
            for name, camera in (('/front', front), ('/rear', rear)):
                camera.publish(gray(level + (name == '/rear')))
                shown[name] = await page.picture()
        for name in shown:
            await page.send(subscribe=name, looks=True, held=True)
        await page.send(ping=1)
        await page.text('pong')  # the node has read what came before
        for camera in (front, rear):
            camera.publish(gray(240))  # while the page is paused
        await page.send(step='/front', by=-2)
        earlier = await page.picture()
        assert (await page.text('step'))['text'].startswith('frame 1 of 3')
        for name, picture, level, stamp in (
                ('/front', earlier, 50, '1.000000000'),
                ('/rear', shown['/rear'], 171, '3.000000000')):
            answer = await save(page, name, picture.sequence)
            assert answer.headers['X-Timestamp'] == stamp
            assert f'{name[1:]}_{stamp}.png' in answer.headers['Content-Disposition']
            assert np.unique(cv2.imdecode(np.frombuffer(answer.body, np.uint8), 1)) == [level]
        await page.send(file='/front', picture=shown['/front'].sequence)
        assert (await page.text('file'))['error'].endswith('no more: resume the page')
        answer = await fetch(url, f'/snapshot?picture={"0" * 24}&token={TOKEN}')
        assert (answer.code, answer.body) == (
            404, b'the frame of this picture is no longer kept: save it again\n')

    run_page(act())
