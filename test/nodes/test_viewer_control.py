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

"""Control of cameras and recorders through ``img_viewer``."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from threading import Event
from typing import Any

from conftest import destroy, NodeProcess, recorded_files, spinning
import numpy as np
import pytest
from rcl_interfaces.msg import ParameterDescriptor, ParameterValue, SetParametersResult
from rcl_interfaces.srv import (
    DescribeParameters, GetParameters, ListParameters, SetParameters)
import rclpy
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from viewing import address_of, Camera, Page, run_page, ShownPicture
from waiting import wait_until

Start = Callable[..., NodeProcess]
GRAY = np.full((48, 64, 3), 90, np.uint8)


@pytest.fixture
def camera(start: Start) -> NodeProcess:
    """Start a camera that can be controlled."""
    return start('img_publisher', source='pattern:160x120@10', publish_rate=0.0)


async def controlled(page: Page, **nodes: list[str]) -> None:
    """Wait until nodes can be controlled."""
    while True:
        found = await page.text('nodes')
        if all(set(names) <= set(found[kind]) for kind, names in nodes.items()):
            return


def test_parameters_of_a_camera(start: Start, camera: NodeProcess) -> None:
    viewer = start('img_viewer', port=0, control='true')

    async def act() -> None:
        url = address_of(viewer)
        assert '?token=' in url  # also on the loopback address
        page = await Page.connect(url)
        assert (await page.text('hello'))['control'] is True
        await controlled(page, cameras=['/image_publisher'])
        await page.send(parameters='/image_publisher')
        answer = await page.text('parameters')
        assert (answer['node'], answer['capture']) == ('/image_publisher', True)
        found: dict[str, Any] = {item['name']: item for item in answer['parameters']}
        rotate = found['rotate']
        assert (rotate['value'], [value for value, _ in rotate['choices']]) == (
            0, [0, 90, 180, 270])
        assert (found['jpeg_quality']['minimum'], found['jpeg_quality']['maximum']) == (1, 100)
        assert found['source']['read_only']

        async def set_value(name: Any, value: Any) -> dict[str, Any]:
            await page.send(set='/image_publisher', name=name, value=value)
            return await page.text('set')

        assert await set_value('rotate', 90) == {
            'node': '/image_publisher', 'name': 'rotate', 'value': 90, 'ok': True, 'message': ''}
        await page.send(subscribe='/video_frames')
        while (await page.picture()).pixels.shape != (160, 120, 3):
            pass
        refused = await set_value('rotate', 45)
        assert (refused['ok'], refused['value']) == (False, 90)
        assert refused['message'].startswith('parameter rotate is 45: give one of')
        for name, value in (('rotate', '90'), ('nothing', 5), (None, 5), ('rotate', None),
                            ('', 1), ('a' * 1000, 1), (['rotate'], 1), ('\ud800', 1),
                            ('\0', 1)):
            refused = await set_value(name, value)
            assert (refused['ok'], bool(refused['message'])) == (False, True)

    run_page(act())


class OddCamera:
    """A node that answers its parameter services as a test says."""

    def __init__(self, node: Node) -> None:
        self.values = [ParameterValue(type=4, string_value='a')]
        self.values_after = self.values
        self.results = [SetParametersResult(successful=True)]
        self.names = ['text']
        self.is_free = Event()
        self.is_free.set()
        self.camera = Camera(node, 'odd/image')
        for service_type, name, call in (
                (ListParameters, 'list_parameters', self._list),
                (DescribeParameters, 'describe_parameters', self._describe),
                (GetParameters, 'get_parameters', self._get),
                (SetParameters, 'set_parameters', self._set)):
            node.create_service(service_type, f'{node.get_name()}/{name}', call)

    def _list(self, _: Any, answer: Any) -> Any:
        wait_until(self.is_free.is_set)
        answer.result.names = self.names
        return answer

    def _describe(self, request: Any, answer: Any) -> Any:
        answer.descriptors = [ParameterDescriptor(name=name) for name in request.names]
        return answer

    def _get(self, _: Any, answer: Any) -> Any:
        answer.values = self.values
        return answer

    def _set(self, _: Any, answer: Any) -> Any:
        answer.results = self.results
        self.values = self.values_after
        return answer


@pytest.fixture
def odd_camera(domain: int) -> Iterator[OddCamera]:
    """Create a node that serves in a thread of its own."""
    context = Context()
    rclpy.init(context=context, domain_id=domain)
    node = Node('odd', context=context, start_parameter_services=False)
    camera = OddCamera(node)
    executor = SingleThreadedExecutor(context=context)
    executor.add_node(node)
    with spinning(executor):
        yield camera
    destroy(node)


TEXT, UNSET = ParameterValue(type=4, string_value='b'), ParameterValue()


@pytest.mark.quick_cases(2)
@pytest.mark.parametrize(('answers', 'sentence'), [
    ({'results': []}, '/odd has given 0 answers about one parameter'),
    ({'results': [SetParametersResult()] * 3}, '/odd has given 3 answers about one parameter'),
    ({'values_after': []}, '/odd has given 0 answers about one parameter'),
    ({'values_after': [TEXT] * 2}, '/odd has given 2 answers about one parameter'),
    ({'values_after': [UNSET]}, 'the parameter is not a number, a text or true or false'),
    ({'values_after': [ParameterValue(type=99)]}, 'the parameter is not a number'),
    ({'values': [UNSET]}, 'the parameter is not a number'),
    ({'values': []}, '/odd has no parameter text')])
def test_odd_answers_of_a_camera(
        start: Start, odd_camera: OddCamera, answers: dict[str, Any], sentence: str) -> None:
    viewer = start('img_viewer', port=0, control='true')
    for name, value in answers.items():
        setattr(odd_camera, name, value)

    async def act() -> None:
        page = await Page.connect(address_of(viewer))
        await controlled(page, cameras=['/odd'])
        await page.send(set='/odd', name='text', value='b')
        refused = await page.text('set')
        assert (refused['ok'], refused['message'][:len(sentence)]) == (False, sentence)
        odd_camera.values = [TEXT]
        await page.send(parameters='/odd')
        assert [item['value'] for item in (await page.text('parameters'))['parameters']] == ['b']

    run_page(act())
    assert viewer.is_running()


@pytest.mark.thorough
def test_pictures_while_a_camera_does_not_answer(
        start: Start, odd_camera: OddCamera) -> None:
    viewer = start('img_viewer', port=0, control='true')
    odd_camera.is_free.clear()

    async def act() -> None:
        page = await Page.connect(address_of(viewer))
        await controlled(page, cameras=['/odd'])
        await page.send(subscribe='/odd/image')
        await odd_camera.camera.seen()
        for _ in range(25):
            await page.send(parameters='/odd')
        message = await page.text('error')
        assert message == '20 requests wait for an answer: wait as well'
        for number in range(1, 21):
            odd_camera.camera.publish(GRAY)
            picture = await page.read()
            while not isinstance(picture, ShownPicture):
                assert 'parameters' not in picture
                picture = await page.read()
            await page.send(got=picture.sequence)
            assert picture.stamp == number
        answer = await page.text('parameters')
        assert answer['message'] == '/odd/list_parameters has not answered within 5 s'
        odd_camera.is_free.set()
        while not answer['ok']:
            answer = {'ok': True} | await page.text('parameters')

    try:
        run_page(act())
    finally:
        odd_camera.is_free.set()


def test_long_texts_of_a_camera(start: Start, odd_camera: OddCamera) -> None:
    viewer = start('img_viewer', port=0, control='true')
    odd_camera.values = [ParameterValue(type=4, string_value='x' * 2_000_000)] * 2

    async def act() -> None:
        page = await Page.connect(address_of(viewer))
        await controlled(page, cameras=['/odd'])
        await page.send(parameters='/odd')
        (item,) = (await page.text('parameters'))['parameters']
        assert (len(item['value']), item['read_only']) == (500, True)

    run_page(act())


def test_pause_of_a_camera(start: Start, camera: NodeProcess) -> None:
    viewer = start('img_viewer', port=0, control='true')

    async def act() -> None:
        page = await Page.connect(address_of(viewer))
        await controlled(page, cameras=['/image_publisher'])
        await page.send(subscribe='/video_frames')
        await page.picture()
        await page.send(capture='/image_publisher', on=False)
        assert await page.text('capture') == {
            'node': '/image_publisher', 'ok': True, 'message': 'paused'}
        state = await page.status(lambda state: state['reason'])
        assert 'may be paused' in state['reason']
        await page.send(capture='/image_publisher', on=True)
        assert (await page.text('capture'))['message'] == 'capturing'
        await page.status(lambda state: not state['reason'])

    run_page(act())


def test_one_of_two_cameras(start: Start, odd_camera: OddCamera) -> None:
    cameras = {name: start('img_publisher', '--ros-args', '-r', f'__node:={name}', '-r',
                           f'video_frames:=/{name}/image', '--', source='pattern:64x48@10')
               for name in ('left', 'right')}  # both have /set_capture
    viewer = start('img_viewer', port=0, control='true')

    async def act() -> None:
        page = await Page.connect(address_of(viewer))
        await controlled(page, cameras=['/left', '/right', '/odd'])
        await page.send(parameters='/odd')
        assert (await page.text('parameters'))['capture'] is False
        await page.send(capture='/odd', on=False)
        assert await page.text('capture') == {
            'node': '/odd', 'name': None, 'ok': False,
            'message': '/odd has no service /odd/set_capture: it cannot be stopped from here'}
        await page.send(set='/left', name='jpeg_quality', value=33)
        assert (await page.text('set'))['ok']
        qualities = []
        for name in ('/left', '/right'):
            await page.send(parameters=name)
            qualities += [item['value'] for item in (await page.text('parameters'))['parameters']
                          if item['name'] == 'jpeg_quality']
        assert qualities == [33, 95]
        await page.send(capture='/left', on=False)
        assert await page.text('capture') == {'node': '/left', 'ok': True, 'message': 'paused'}
        for topic in ('/left/image', '/right/image'):
            await page.send(subscribe=topic)
        silent = await page.status(lambda state: state['reason'])
        running = await page.status(lambda state: state['frames'] > 3)
        assert (silent['name'], running['name']) == ('/left/image', '/right/image')

    run_page(act())
    assert {name: camera.output.count('paused') for name, camera in cameras.items()} == {
        'left': 1, 'right': 0}


def test_saved_frame(start: Start, camera: NodeProcess, tmp_path: Path) -> None:
    viewer = start('img_viewer', port=0, control='true')
    start('img_subscriber', mode='on_request', output_dir=tmp_path / 'saved')
    start('img_subscriber', '--ros-args', '-r', '__node:=other', '--', mode='on_request',
          output_dir=tmp_path / 'other')

    async def act() -> None:
        page = await Page.connect(address_of(viewer))
        await controlled(page, recorders=['/image_subscriber', '/other'])
        await page.send(save='/image_subscriber')
        answer = await page.text('save')
        assert answer['ok'], answer
        assert Path(answer['message']) == tmp_path / 'saved' / '000000.png'
        assert Path(answer['message']).exists()
        assert recorded_files(tmp_path / 'other') == []

    run_page(act())


def test_only_cameras_and_recorders_are_controlled(start: Start) -> None:
    viewer = start('img_viewer', port=0, control='true')

    async def act() -> None:
        page = await Page.connect(address_of(viewer))
        await page.text('nodes')
        for message in ({'parameters': '/image_viewer'}, {'save': '/image_viewer'},
                        {'capture': '/image_viewer', 'on': True}, {'save': None},
                        {'set': '/image_viewer', 'name': 'port', 'value': 1},
                        {'parameters': ['/image_viewer']}, {'parameters': 'a' * 2000}):
            await page.send(**message)
            (kind, *_) = message
            answer = await page.text(kind)
            assert answer['ok'] is False
            assert answer['message'].endswith('cannot be controlled')

    run_page(act())


def test_control_is_off_by_default(start: Start, camera: NodeProcess) -> None:
    viewer = start('img_viewer', port=0, token='open-sesame')

    async def act() -> None:
        page = await Page.connect(address_of(viewer))
        assert (await page.text('hello'))['control'] is False
        for message in ({'parameters': '/image_publisher'}, {'save': '/image_subscriber'},
                        {'capture': '/image_publisher', 'on': False},
                        {'set': '/image_publisher', 'name': 'rotate', 'value': 90}):
            await page.send(**message)
            (kind, *_) = message
            assert (await page.text(kind))['message'] == (
                'control is off: start the node with control:=true')

    run_page(act())
    assert 'paused' not in camera.output
