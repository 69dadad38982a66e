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

"""The live robot of ``img_viewer`` as a page gets it."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Mapping
from functools import partial
import itertools
import json
import math
import os
from pathlib import Path
from typing import Any

from conftest import NodeProcess
from live_robots import ROBOT, RobotClient, RobotNode, subscribed
import pytest
from rclpy.node import Node
from rclpy.qos import QoSProfile
from sensor_msgs.msg import JointState
from viewing import address_of, fetch, Page, publishing, run_page
from waiting import until

Start = Callable[..., NodeProcess]


@pytest.fixture
def viewer(start: Start) -> NodeProcess:
    """Start a viewer on any free port."""
    return start('img_viewer', port=0)


@pytest.fixture
def robot(node: Node) -> RobotNode:
    """Create publishers of a robot without a description."""
    return RobotNode(node)


async def document(url: str) -> dict[str, Any]:
    return dict(json.loads((await fetch(url, '/robot/robot.json')).body))


def test_robot_with_its_positions(viewer: NodeProcess, robot: RobotNode) -> None:
    async def look() -> None:
        url = address_of(viewer)
        cameras = await Page.connect(url)
        assert await cameras.text('robot') is False
        assert await document(url) == {'live': True, 'version': 0}
        robot.describe(ROBOT)
        assert await cameras.text('robot') is True
        assert robot.watched() == [0, 0, 0]
        page = await RobotClient.watch(url)
        state = await page.state(lambda state: state['version'])
        assert (state['version'], state['error'], state['late']) == (1, '', True)
        shown = await document(url)
        assert [joint['name'] for joint in shown['robots'][0]['joints']] == [
            'elbow', 'wrist', 'flight']
        await subscribed(robot)
        move = publishing(lambda: robot.move(['elbow', 'other'], [0.5, 1]), page.moved())
        assert await move == {0: [0.5]}
        state = await publishing(lambda: robot.move(['elbow'], [0.5]), page.state(
            lambda state: not state['late'] and state['rate']))
        assert state['notes'] == []
        state = await page.state(lambda state: state['late'])  # nothing comes any more
        assert state['age'] > 1
        second = await RobotClient.watch(url)
        assert await second.moved() == {0: [0.5]}
        for one in (page, second):
            one.socket.close()
        await until(lambda: not any(robot.watched()))

    run_page(look())


@pytest.mark.thorough
def test_floating_joint_by_a_transform(viewer: NodeProcess, robot: RobotNode) -> None:
    async def look() -> None:
        robot.describe(ROBOT)
        robot.place('base', 'drone', (3, 2, 1), (math.sqrt(0.5), 0, 0, math.sqrt(0.5)))
        page = await RobotClient.watch(address_of(viewer))
        assert (await page.moved())[2] == pytest.approx([2, 2, 1, 0, 0, math.pi / 2])

    run_page(look())


BAD_DESCRIPTIONS = {
    '<robot': '/robot_description:1: not well-formed XML',
    '<sdf version="1.7"/>': 'is not URDF; its root is <sdf>',
    '<robot name="r" xmlns:x="http://www.ros.org/wiki/xacro"><x:include filename="/etc/passwd"/>'
    '</robot>': '<include>: is not expanded here: publish the output of xacro',
    '<!DOCTYPE robot [<!ENTITY a SYSTEM "file:///etc/passwd">]><robot name="r"/>':
    'entity declarations are not supported',
    '<robot name="r"/>': 'has no <link>', '': 'not well-formed XML'}


def has_error(reason: str, state: Mapping[str, Any]) -> bool:
    return reason in state['error']


@pytest.mark.thorough
def test_bad_descriptions_keep_the_robot(viewer: NodeProcess, robot: RobotNode) -> None:
    async def look() -> None:
        url = address_of(viewer)
        robot.describe(ROBOT)
        page = await RobotClient.watch(url)
        await page.state(lambda state: state['version'] == 1)
        for text, reason in BAD_DESCRIPTIONS.items():
            robot.describe(text)
            await page.state(partial(has_error, reason))
        assert (await document(url))['robots'][0]['name'] == 'live'
        note = '7 publishers on /robot_description: the text that arrived last is shown.'
        await page.state(lambda state: note in state['notes'])
        robot.describe(ROBOT.replace('"live"', '"other"'))
        assert (await page.state(lambda state: not state['error']))['version'] == 2

    run_page(look())


@pytest.mark.thorough
def test_large_description(viewer: NodeProcess, robot: RobotNode) -> None:
    async def look() -> None:
        robot.describe(f'<robot name="{"r" * 5_000_000}"/>')
        page = await RobotClient.watch(address_of(viewer))
        state = await page.state(lambda state: 'bytes' in ''.join(state['notes']))
        assert 'robot_description has 50000' in ''.join(state['notes'])
        robot.describe('<robot name="r">' + '<link name="a"/>' * 200_000 + '</robot>')
        assert 'a' in (await page.state(lambda state: state['error']))['error']

    run_page(look())


def test_description_that_is_not_kept(viewer: NodeProcess, robot: RobotNode) -> None:
    async def look() -> None:
        robot.describe(ROBOT, QoSProfile(depth=1))
        page = await RobotClient.watch(address_of(viewer))
        state = await page.state(lambda state: 'transient_local' in ''.join(state['notes']))
        assert state['version'] == 0

    run_page(look())


@pytest.mark.thorough
def test_publisher_that_is_replaced(
    viewer: NodeProcess, robot: RobotNode,
) -> None:
    async def look() -> None:
        first = robot.describe(ROBOT)
        page = await RobotClient.watch(address_of(viewer))
        await page.state(partial(has_note, 'A new description is being read.'))
        await page.state(lambda state: state['version'] and not has_note('description', state))
        robot.remove(first)
        await page.state(partial(has_note, 'No publisher on /robot_description.'))
        robot.describe(ROBOT.replace('"live"', '"other"'), QoSProfile(depth=1))
        state = await page.state(partial(has_note, 'No new text on /robot_description'))
        assert state['version'] == 1

    run_page(look())


BAD_STATES: list[tuple[list[str], list[float], str]] = [
    (['elbow'], [math.nan], '1 positions are not numbers within 1e+06.'),
    (['elbow'], [-math.inf], '1 positions are not numbers within 1e+06.'),
    (['<img src=x>', 'elbow'], [1, 1e9], '1 positions are not numbers'),
    (['<img src=x>', 'flight'], [1, 1], '2 of 2 names are not movable joints of the robot.'),
    (['elbow', 'wrist'], [1], 'a message has 2 names, but 1 positions.'),
    ([f'joint {number}' for number in range(100_000)], [1] * 100_000,
     'A message of joint_states has ')]


def has_note(note: str, state: Mapping[str, Any]) -> bool:
    return note in ''.join(state['notes'])


@pytest.mark.thorough
def test_bad_joint_states(viewer: NodeProcess, robot: RobotNode) -> None:
    async def look() -> None:
        robot.describe(ROBOT)
        page = await RobotClient.watch(address_of(viewer))
        await page.state(lambda state: state['version'])
        await subscribed(robot)
        for number, (names, positions, note) in enumerate(BAD_STATES):
            state = await publishing(partial(robot.move, names, positions), page.state(
                partial(has_note, note)))
            assert 'img' not in ''.join(state['notes'])
            assert number or (state['late'] and state['age'] is None)
            move = partial(robot.move, ['elbow'], [number])
            assert await publishing(move, page.moved()) == {0: [number]}

    run_page(look())


@pytest.mark.thorough
def test_page_that_does_not_answer(viewer: NodeProcess, robot: RobotNode) -> None:
    async def look() -> None:
        robot.describe(ROBOT)
        page = await RobotClient.watch(address_of(viewer))
        await page.state(lambda state: state['version'])
        await subscribed(robot)
        numbers = itertools.count()

        def move() -> None:
            robot.move(['elbow'], [next(numbers)])

        async def read() -> list[Any]:
            """Return the positions that come before the next two states."""
            messages: list[Any] = []
            while sum('state' in message for message in messages) < 2:
                messages.append(await page.read())
            return [message['positions'] for message in messages if 'positions' in message]

        for _ in range(3):
            ((_, (shown,)),) = await publishing(move, page.text('positions'))
        assert await publishing(move, read()) == []
        await page.send(got=True)
        assert 'give a number' in await page.text('error')
        await page.send(got=1)  # only the newest positions follow
        ((_, (newest,)),) = await page.text('positions')
        assert shown < newest < next(numbers)
        assert await publishing(move, read()) == []

    run_page(look())


def test_only_meshes_of_packages(start: Start, robot: RobotNode, tmp_path: Path,
                                 monkeypatch: pytest.MonkeyPatch) -> None:
    package = tmp_path / 'install' / 'share' / 'arm_description'
    package.mkdir(parents=True)
    (package / 'a.stl').write_bytes(b'x' * 600_000)
    for name, text in (('b.obj', 'mtllib b.mtl'), ('b.mtl', 'map_Kd b.png'), ('b.png', '')):
        (package / name).write_text(text)
    (tmp_path / 'secret.stl').write_bytes(b'secret')
    (package / 'link.stl').symlink_to(tmp_path / 'secret.stl')
    others = os.environ['AMENT_PREFIX_PATH']
    monkeypatch.setenv('AMENT_PREFIX_PATH', f'{tmp_path / "install"}:{others}')
    viewer = start('img_viewer', port=0)
    uris = ['package://arm_description/a.stl', 'package://arm_description/link.stl',
            'package://arm_description/../../../secret.stl', f'file://{tmp_path}/secret.stl',
            f'{tmp_path}/secret.stl', 'model://arm_description/a.stl', 'https://localhost/a.stl',
            f'package://arm_description/{tmp_path}/secret.stl', 'package://arm_description/b.obj']
    shapes = ''.join(f'<visual><geometry><mesh filename="{uri}"/></geometry></visual>'
                     for uri in uris)

    async def look() -> None:
        url = address_of(viewer)
        robot.describe(f'<robot name="r"><link name="l">{shapes}</link></robot>')
        page = await RobotClient.watch(url)
        await page.state(lambda state: state['version'])
        meshes = (await document(url))['meshes']
        assert [bool(mesh['reason']) for mesh in meshes] == [False] + [True] * 7 + [False] * 3
        assert (await fetch(url, '/robot/mesh/0')).body == b'x' * 600_000
        assert [(await fetch(url, f'/robot/mesh/{number}')).headers['Content-Type']
                for number in (0, 8)] == ['application/octet-stream', 'image/png']
        (package / 'link.stl').replace(package / 'a.stl')
        for number in (*range(8), 11):
            answer = await fetch(url, f'/robot/mesh/{number}')
            assert (answer.code, b'secret' in answer.body) == (404, False)

    run_page(look())


def test_page_needs_the_token(start: Start, robot: RobotNode) -> None:
    viewer = start('img_viewer', port=0, token='open-sesame', viewers=2)
    paths = ('/robot/', '/robot/robot.json', '/robot/mesh/0', '/robot/ws')

    async def look() -> None:
        viewer.wait_for('in a browser')
        url = address_of(viewer).partition('?')[0]
        answers = await asyncio.gather(*(fetch(url, path) for path in paths))
        assert [answer.code for answer in answers] == [403] * 4
        answer = await fetch(url, '/robot/?token=open-sesame')
        assert (answer.code, b'view.js' in answer.body) == (200, True)
        policy = answer.headers['Content-Security-Policy']
        assert "frame-ancestors 'self'" in policy and "script-src 'self';" in policy
        assert "frame-ancestors 'none'" in (await fetch(
            url, '/?token=open-sesame')).headers['Content-Security-Policy']
        for path in ('/robot/page/index.html', '/robot/page/robot', '/robot/page/none.js'):
            assert (await fetch(url, path)).code == 404
        assert (await fetch(url, '/robot/page/live.js')).code == 200
        with pytest.raises(Exception, match='403'):
            await RobotClient.watch(url)

    run_page(look())


def test_limit_of_pages_and_topics(start: Start, robot: RobotNode) -> None:
    viewer = start('img_viewer', port=0, viewers=1, topics='/front/*')

    async def look() -> None:
        url = address_of(viewer)
        robot.describe(ROBOT)
        page = await RobotClient.watch(url)
        state = await page.state(lambda state: state['error'])
        assert state['error'].startswith('/robot_description is not in the parameter topics')
        assert robot.watched() == [0, 0, 0]
        with pytest.raises(Exception, match='503'):
            await RobotClient.watch(url)
        await page.socket.write_message('{}')
        assert await page.text('error')
        for _ in range(9):
            await page.socket.write_message('x')
        assert await page.close_code() == 1008

    run_page(look())


@pytest.mark.thorough
def test_remapped_topic(start: Start, robot: RobotNode, node: Node) -> None:
    viewer = start('img_viewer', '--ros-args', '-r', 'joint_states:=/left/states', '--',
                   port=0)
    states = node.create_publisher(JointState, '/left/states', 10)

    async def look() -> None:
        robot.describe(ROBOT)
        page = await RobotClient.watch(address_of(viewer))
        move = publishing(lambda: states.publish(JointState(name=['elbow'], position=[1.0])),
                          page.moved())
        assert await move == {0: [1]}
        assert robot.states.get_subscription_count() == 0

    run_page(look())
