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

"""Calibration of a topic through ``img_viewer``, as its page does it."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any
from urllib.parse import quote

from conftest import executor_of, NodeProcess, spin_until
import numpy as np
from opencv_tools.calibration.boards import parse_board
from opencv_tools.calibration.camera_file import read_camera
from opencv_tools.transport import zero_copy
from opencv_tools.viewer.calibrate.camera_info import find_service
from opencv_tools.viewer.calibrate.sessions import Former, read_former
from opencv_tools.viewer.control import CameraControl, check_server
from opencv_tools.viewer.errors import RequestError
import pytest
from rclpy.node import Node, NodeNameNonExistentError
from rclpy.qos import qos_profile_sensor_data
from rendered_boards import needs_markers, poses, wide_camera
from sensor_msgs.msg import CameraInfo
from sensor_msgs.srv import SetCameraInfo
from shown_boards import BOARD, held_board, RATE, write_former
from tornado.websocket import WebSocketClosedError
from viewing import address_of, Camera, fetch, Page, publishing, run_page
from waiting import pause_loop, wait_until

pytestmark = needs_markers

Start = Callable[..., NodeProcess]
TOKEN = 'a-secret-text'
TOPIC = '/video_frames'
GRAY = np.full((48, 64, 3), 90, np.uint8)
TRY_AGAIN, POLICY_VIOLATION = 1013, 1008


@pytest.fixture
def url(start: Start) -> str:
    """Start a viewer with control, and return its address."""
    return address_of(start('img_viewer', port=0, control='true', token=TOKEN))


async def open_page(url: str, topic: str = TOPIC, **headers: str) -> Page:
    """Open the WebSocket of a page that calibrates a topic."""
    base = url.partition('/?')[0]
    return await Page.connect(
        f'{base}/calibrate/ws?token={TOKEN}&topic={quote(topic)}', **headers)


async def join(url: str, topic: str = TOPIC) -> Page:
    """Open such a page as soon as the viewer knows the topic."""
    while f'"{topic}"' not in (await fetch(url, f'/topics?token={TOKEN}')).body.decode():
        await pause_loop(0.05)
    return await open_page(url, topic)


async def state_of(page: Page, condition: Callable[[dict[str, Any]], Any]) -> dict[str, Any]:
    """Read until the state of the session has a property."""
    while True:
        state: dict[str, Any] = await page.text('state')
        if condition(state):
            return state


def camera_info(node: Node, condition: Callable[[CameraInfo], Any]) -> CameraInfo:
    """Wait for a message of ``camera_info`` with a property."""
    found: list[CameraInfo] = []
    subscription = node.create_subscription(
        CameraInfo, 'camera_info', found.append, qos_profile_sensor_data)
    spin_until(node, lambda: found and condition(found[-1]))
    node.destroy_subscription(subscription)
    return found[-1]


def former_info(fx: float = 123.0, **fields: Any) -> CameraInfo:
    """Return a calibration of a camera."""
    return CameraInfo(**{'width': 64, 'height': 48, 'k': [fx, 0, 9, 0, fx, 9, 0, 0, 1]} | fields)


def read(node: Node, publish: Callable[[], object]) -> Former:
    """Read the present calibration of ``/front/camera``."""
    with executor_of(node) as executor:
        reading = executor.create_task(
            read_former(CameraControl(node), '/front/camera_info', ['/front/camera']))
        wait_until(reading.done, 'the calibration', lambda: (
            publish(), executor.spin_once(timeout_sec=0.005)))
    found: Former = reading.result()
    return found


@pytest.mark.thorough
def test_whole_calibration(start: Start, url: str, node: Node, tmp_path: Path) -> None:
    truth = held_board(tmp_path / 'pictures', 12)
    start('img_publisher', source=tmp_path / 'pictures', publish_rate=RATE, loop=0, flip='both',
          camera_info_url=write_former(tmp_path / 'former.yaml', 123.0))
    neighbour = node.create_publisher(CameraInfo, 'camera_info', 10)

    async def calibrate() -> None:
        page = await join(url)
        assert (await page.text('hello'))['topic'] == TOPIC
        await page.send(board=BOARD)
        other = await open_page(url)
        assert (await state_of(other, lambda state: True))['board'] == BOARD
        state = await state_of(page, lambda state: len(state['views']) >= 8)
        assert state['size'] == [640, 360] and 0 < state['progress'] < 1
        await page.send(solve='plumb_bob')
        state = await state_of(other, lambda state: state['result'])
        assert state['result']['rms'] < 0.2
        number = state['result']['number']
        for wrong in (True, number + 1, None):
            await page.send(save=wrong)
            assert (await page.text('error')).startswith('another result has replaced the one')
        await page.send(save=number)
        state = await publishing(
            lambda: neighbour.publish(former_info(fx=777.0)),
            state_of(page, lambda state: state['restorable'] and not state['busy']))
        assert state['notice'].startswith('saved: /set_camera_info: ')

    async def restore() -> None:
        page = await join(url)
        assert (await state_of(page, lambda state: True))['restorable']
        await page.send(restore=True)
        state = await state_of(page, lambda state: not state['restorable'] and not state['busy'])
        assert state['notice'].startswith('the former calibration is back')

    former = camera_info(node, lambda info: True)
    assert former.k[0] == 123.0
    run_page(calibrate())
    node.destroy_publisher(neighbour)
    # The camera is turned by 180 degrees, so the principal point is not that of the truth.
    info = camera_info(node, lambda info: info.k[0] not in (123.0, 777.0))
    k = truth.k.copy()
    k[:2, 2] = (np.array(truth.size) - 1) - k[:2, 2]
    np.testing.assert_allclose(info.k.reshape(3, 3), k, atol=2.0)
    assert info.distortion_model == 'plumb_bob'
    path = f'/calibrate/camera.yaml?token={TOKEN}&topic={TOPIC}&result='
    for wrong in ('2', '', 'first'):
        assert run_page(fetch(url, path + wrong)).code == 404
    answer = run_page(fetch(url, f'{path}1'))
    assert answer.headers['Content-Disposition'] == 'attachment; filename="camera.yaml"'
    (tmp_path / 'camera.yaml').write_bytes(answer.body)
    assert read_camera(tmp_path / 'camera.yaml').k == pytest.approx(info.k)
    run_page(restore())
    restored = camera_info(node, lambda info: info.k[0] == 123.0)
    np.testing.assert_allclose(restored.k, former.k)


@pytest.mark.thorough
def test_camera_without_the_service(url: str, node: Node) -> None:
    truth, board = wide_camera(640, 360), parse_board(BOARD)
    camera = Camera(node, 'front/image')
    pictures = [truth.see(board, pose, seed=seed)
                for seed, pose in enumerate(poses(board, truth, 4, seed=4, is_whole=True))]

    async def act() -> None:
        page = await join(url, '/front/image')
        await page.send(board=BOARD)
        for count, picture in enumerate(pictures, 1):
            await publishing(
                lambda shown=picture: camera.publish(shown, 'mono8'),
                state_of(page, lambda state, wanted=count: len(state['views']) == wanted))
        await page.send(solve='plumb_bob')
        state = await state_of(page, lambda state: state['result'])
        await page.send(save=state['result']['number'])
        state = await state_of(page, lambda state: 'download' in state['notice'])
        assert state['notice'].startswith(
            'no node that publishes /front/image has the service set_camera_info')
        assert not state['restorable']
        await publishing(lambda: camera.publish(GRAY),
                         state_of(page, lambda state: state['size'] == [64, 48]))
        await page.send(delete=1)
        assert (await page.text('error')).startswith('there is no such view')

    run_page(act())


@pytest.mark.quick_cases(1)
@pytest.mark.parametrize('path', [
    '/calibrate?topic=/image', '/calibrate/ws?topic=/image', '/calibrate/board',
    '/calibrate/camera.yaml?topic=/image'])
def test_no_calibration_without_control(start: Start, path: str) -> None:
    address = address_of(start('img_viewer', port=0))
    answer = run_page(fetch(address, path))
    assert answer.code == 403
    assert answer.body.decode() == (
        'calibration needs control: start the node with control:=true\n')


def test_requests_without_the_token(url: str) -> None:
    async def act() -> None:
        for path in ('/calibrate/ws?topic=/image', '/calibrate/board?board=chessboard:9x6:25mm',
                     '/calibrate/camera.yaml?topic=/image'):
            assert (path, (await fetch(url, path)).code) == (path, 403)
        form = await fetch(url, '/calibrate?topic=/image')
        assert form.code == 403 and b'Token needed' in form.body
        page = await fetch(url, f'/calibrate?topic=/image&token={TOKEN}')
        assert page.code == 200 and b'Calibrate' in page.body
        assert "default-src 'none'" in page.headers['Content-Security-Policy']
        assert page.headers['Set-Cookie']
        assert (await fetch(url, '/page/calibrate.html')).code == 404
        with pytest.raises(Exception, match='403'):
            await open_page(url, '/image', Origin='http://other.example')

    run_page(act())


def test_boards_for_a_printer(url: str) -> None:
    async def board(text: str, kind: str = 'pdf') -> tuple[int, bytes]:
        answer = await fetch(
            url, f'/calibrate/board?token={TOKEN}&format={kind}&board={quote(text)}')
        return answer.code, answer.body

    async def act() -> None:
        assert (await board('charuco:11x8:30mm:22mm:5x5_250'))[1].startswith(b'%PDF')
        code, drawing = await board('chessboard:9x6:25mm', 'svg')
        assert code == 200 and b'<svg' in drawing
        for text, kind in (('', 'pdf'), ('chessboard', 'pdf'), ('chessboard:9x6:25mm', 'exe'),
                           ('charuco:99x99:30mm:22mm:5x5_250', 'pdf'), ('x' * 1000, 'svg')):
            code, sentence = await board(text, kind)
            assert (text, code) == (text, 400)
            assert 0 < len(sentence) < 600

    run_page(act())


def test_topic_that_does_not_exist(url: str) -> None:
    async def act() -> None:
        for topic in ('/nothing', '', 'x' * 300):
            page = await open_page(url, topic)
            assert await page.close_code() == TRY_AGAIN
        answer = await fetch(url, f'/calibrate/camera.yaml?token={TOKEN}&topic=/nothing')
        assert answer.code == 404

    run_page(act())


def test_rectified_images(url: str, node: Node) -> None:
    cameras = [Camera(node, f'front/{name}') for name in ('image', 'image_rect')]
    topic = '/front/image_rect'
    sentence = ('calibrate the raw images of the camera, because those of /front/image_rect are '
                'rectified already')

    async def act() -> None:
        raw = await join(url, '/front/image')
        await raw.text('state')
        page = await join(url, topic)
        assert await page.close_code() == TRY_AGAIN
        for name in (topic, f'{topic}/compressed'):
            answer = await fetch(url, f'/calibrate?token={TOKEN}&topic={name}')
            assert (answer.code, answer.body.decode()) == (400, f'{sentence}\n')

    run_page(act())
    assert len(cameras) == 2


def test_number_of_sessions(url: str, node: Node) -> None:
    cameras = [Camera(node, f'camera_{number}/image') for number in range(5)]

    async def act() -> None:
        pages = []
        for number in range(4):
            pages.append(await join(url, f'/camera_{number}/image'))
            await pages[-1].text('state')
        refused = await join(url, '/camera_4/image')
        assert await refused.close_code() == TRY_AGAIN
        another = await open_page(url, '/camera_0/image')  # of a session that is open
        await another.text('state')

    run_page(act())
    assert len(cameras) == 5


@pytest.mark.quick_cases(2)
@pytest.mark.parametrize('message', [
    '', '[]', '5', '{"a": 1}', '{"board": NaN}', '\0', '{' * 3000, b'\x00\x01'])
def test_message_without_a_known_word(url: str, node: Node, message: str | bytes) -> None:
    camera = Camera(node, 'image')

    async def act() -> None:
        page = await join(url, '/image')
        await page.text('state')
        for _ in range(20):
            await page.socket.write_message(message, isinstance(message, bytes))
        assert await page.close_code() == POLICY_VIOLATION

    run_page(act())
    camera.destroy()


@pytest.mark.thorough
def test_flood_of_refused_actions(url: str, node: Node) -> None:
    camera = Camera(node, 'image')

    async def act() -> None:
        page = await join(url, '/image')
        await page.text('state')
        with suppress(WebSocketClosedError):
            for _ in range(5000):
                await page.send(delete=999_999)
        assert await page.close_code() == POLICY_VIOLATION

    run_page(act())
    camera.destroy()


def test_values_that_are_wrong(url: str, node: Node) -> None:
    camera = Camera(node, 'image')
    values = [None, True, -1, 10**30, 1.5, '', 'x' * 1000, [], {}, [[]], '\ud800', '\0']

    async def act() -> None:
        page = await join(url, '/image')
        await page.text('state')
        for word in ('board', 'delete', 'solve', 'save', 'restore'):
            for value in values:
                await page.send(**{word: value})
                if word == 'restore':
                    state = await state_of(page, lambda state: not state['busy'])
                    assert state['notice'].startswith('there is no former calibration')
                else:
                    assert 0 < len(await page.text('error')) <= 500
        await page.send(board=BOARD)
        assert (await state_of(page, lambda state: state['board']))['views'] == []
        await page.send(ping=5)
        assert await page.text('pong') == 5

    run_page(act())
    camera.destroy()


def test_session_of_another_topic_does_not_change(url: str, node: Node) -> None:
    cameras = [Camera(node, f'{name}/image') for name in ('front', 'rear')]

    async def act() -> None:
        front, rear = [await join(url, f'/{name}/image') for name in ('front', 'rear')]
        await rear.send(board=BOARD)
        before = await state_of(rear, lambda state: state['board'])
        for message in ({'board': 'chessboard:9x6:25mm'}, {'take': True}, {'delete': 1},
                        {'solve': 'plumb_bob'}, {'save': 1}, {'resume': True}, {'discard': True},
                        {'restore': True}):
            await front.send(**message)
        await state_of(front, lambda state: 'no former calibration' in state['notice'])
        again = await open_page(url, '/rear/image')
        assert await state_of(again, lambda state: True) == before

    run_page(act())
    for camera in cameras:
        camera.destroy()


def test_message_that_is_too_long(url: str, node: Node) -> None:
    camera = Camera(node, 'image')

    async def act() -> None:
        page = await join(url, '/image')
        await page.text('state')
        await page.send(board='x' * 5000)
        assert await page.close_code() is not None

    run_page(act())
    camera.destroy()


def test_broken_images(url: str, node: Node) -> None:
    camera = Camera(node, 'image', compressed=True)

    async def act() -> None:
        page = await join(url, '/image')
        await page.send(board=BOARD)
        seen = await publishing(lambda: camera.publish_compressed(b'\xff\xd8' + bytes(100)),
                                page.text('seen'))
        assert seen['corners'] == [] and seen['capture']

    run_page(act())
    camera.destroy()


def test_service_of_a_camera(node: Node, camera: Node) -> None:
    def serve(name: str) -> None:
        camera.create_service(SetCameraInfo, name, lambda _, answer: answer)
        spin_until(node, lambda: is_known(name))

    def is_known(name: str) -> bool:
        with suppress(NodeNameNonExistentError):
            return name in dict(node.get_service_names_and_types_by_node('camera', '/front'))
        return False

    def found(topic: str, *nodes: str) -> str:
        return find_service(node, topic, ['/front/camera', *nodes])

    serve('/driver/set_camera_info')
    assert found('/left/image', '/gone') == '/driver/set_camera_info'
    serve('/left/set_camera_info')
    assert found('/left/image') == '/left/set_camera_info'
    with pytest.raises(RequestError, match='has several services'):
        found('/right/image')
    with pytest.raises(RequestError, match='has the service set_camera_info'):
        find_service(node, '/left/image', ['/plain'])
    node.create_service(SetCameraInfo, '/left/set_camera_info', lambda _, answer: answer)
    spin_until(node, lambda: node.count_services('/left/set_camera_info') == 2)
    with pytest.raises(RequestError, match=r'^/left/set_camera_info has 2 servers, in the nodes '
                                           r'/front/camera, /plain: start each with a namespace'):
        check_server(node, found('/left/image'))


def test_former_calibration_between_those_of_a_neighbour(node: Node, camera: Node) -> None:
    own, foreign = (owner.create_publisher(CameraInfo, '/front/camera_info', 10)
                    for owner in (camera, node))
    spin_until(node, lambda: node.count_publishers('/front/camera_info') == 2)

    def publish() -> None:
        for _ in range(5):
            foreign.publish(former_info(fx=777.0))
        own.publish(former_info())

    found = read(node, publish)
    assert (found.info.k[0], found.problem) == (123.0, '')


def test_calibration_of_a_neighbour_is_not_the_former_one(node: Node, camera: Node) -> None:
    foreign = node.create_publisher(CameraInfo, '/front/camera_info', 10)
    spin_until(node, lambda: node.count_publishers('/front/camera_info') == 1)
    assert read(node, lambda: foreign.publish(former_info(fx=777.0))) == Former(
        None, 'no /front/camera_info of the camera arrived, and other nodes publish it: /plain')


def test_former_calibration_without_known_senders(
        node: Node, camera: Node, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(zero_copy, '_rcl', None)
    own = camera.create_publisher(CameraInfo, '/front/camera_info', 10)
    spin_until(node, lambda: node.count_publishers('/front/camera_info') == 1)
    assert read(node, lambda: own.publish(former_info())).info.k[0] == 123.0
    node.create_publisher(CameraInfo, '/front/camera_info', 10)
    spin_until(node, lambda: node.count_publishers('/front/camera_info') == 2)
    assert read(node, lambda: own.publish(former_info())) == Former(
        None, 'no /front/camera_info of the camera arrived, and other nodes publish it: /plain')


@pytest.mark.quick_cases(2)
@pytest.mark.parametrize(('fields', 'problem'), [
    ({'k': [0.0] * 9}, 'there was no calibration before'),
    ({'fx': float('nan')}, 'the calibration before has numbers that are not finite'),
    ({'d': [float('inf')]}, 'the calibration before has numbers that are not finite'),
    ({'width': 0}, 'the calibration before is for images of 0x48'),
    ({'d': [0.0] * 33}, 'no /front/camera_info of the camera arrived'),
    ({'d': [0.0] * 10_000}, 'no /front/camera_info of the camera arrived')])
def test_unusable_former_calibration(
        node: Node, camera: Node, fields: dict[str, Any], problem: str) -> None:
    own = camera.create_publisher(CameraInfo, '/front/camera_info', 10)
    spin_until(node, lambda: node.count_publishers('/front/camera_info') == 1)
    assert read(node, lambda: own.publish(former_info(**fields))) == Former(None, problem)
