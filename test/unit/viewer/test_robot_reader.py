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

"""Reading of a robot description in a process of its own."""

from __future__ import annotations

import asyncio
import json
import sys

from live_robots import ROBOT
from opencv_tools.viewer.errors import RequestError
from opencv_tools.viewer.robot import live, reader
from opencv_tools.viewer.robot.live import Descriptions
from opencv_tools.viewer.robot.reader import answer, LiveRobot, read_description
from opencv_tools.viewer.robot_topics import DESCRIPTION, Inbox
import pytest
from rclpy.serialization import serialize_message
from std_msgs.msg import String


@pytest.mark.process
def test_robot_from_a_process() -> None:
    robot = asyncio.run(read_description(ROBOT.encode(), '/robot_description'))
    document = json.loads(robot.body)
    assert document['robots'][0]['files']['urdf'] == {
        'name': '/robot_description', 'text': ROBOT, 'reason': '',
        'poses': document['robots'][0]['files']['urdf']['poses']}
    assert [(joint.name, joint.kind, joint.links) for joint in robot.joints] == [
        ('elbow', 'revolute', ('base', 'arm')), ('wrist', 'prismatic', ('arm', 'hand')),
        ('flight', 'floating', ('base', 'drone'))]


@pytest.mark.quick_cases(3)
@pytest.mark.process
@pytest.mark.parametrize('output', [
    """bytes(2 * 10**9) and b'{"error": "no limit of memory"}'""",
    """b'{"error": "", "meshes": []}'""",
    r"""b'{"error": "", "meshes": []}\n{"robots": [{"links": ['""",
    'sys.exit()', """b'{"err'"""])
def test_process_without_a_whole_answer(output: str, monkeypatch: pytest.MonkeyPatch) -> None:
    script = (f'import sys; sys.path[:] = {sys.path!r}; import {reader.__name__} as reader; '
              f'reader.answer = lambda *_: {output}; reader.main()')
    monkeypatch.setattr(
        reader, 'worker_command', lambda _, *words: [sys.executable, '-c', script, *words])
    with pytest.raises(RequestError, match='the robot is too large: reading it needs more than'):
        asyncio.run(read_description(ROBOT.encode(), '/r'))


@pytest.mark.process
def test_reading_after_an_error(monkeypatch: pytest.MonkeyPatch) -> None:
    async def read(data: bytes, topic: str) -> LiveRobot:
        if b'bad' in data:
            raise KeyError(data)
        return await read_description(data, topic)

    async def look() -> None:
        inbox, found = Inbox(lambda: None), Descriptions(lambda _: None)
        for text in ('bad', ROBOT):
            inbox.put(DESCRIPTION, bytes(serialize_message(String(data=text))))
            found.read(inbox, '/r')
            await asyncio.wait([found._task])
            assert found._task is None
        assert found.version == 1

    monkeypatch.setattr(live, 'read_description', read)
    monkeypatch.setattr(live, '_READ_SECONDS', 0.0)
    asyncio.run(look())


def test_robot_with_a_large_document(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(reader, '_MAX_BODY', 1000)
    assert 'but 1000 are the limit' in json.loads(answer(ROBOT.encode(), '/r'))['error']


def test_markup_in_an_error_is_one_short_line() -> None:
    name = '&lt;b>' * 2000 + '&#10;'
    text = f'<robot name="r"><link name="{name}"/><link name="{name}"/></robot>'
    error = json.loads(answer(text.encode(), '/r'))['error']
    assert len(error) <= 500 and error.isprintable()
