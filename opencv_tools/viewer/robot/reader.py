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

"""Reading of a robot description in a process of its own, with limits of memory and time."""

from __future__ import annotations

import asyncio
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
import json
from pathlib import Path
import sys
from typing import Any

from opencv_tools.base.text import printable
from opencv_tools.base.worker import begin_work, Worker, worker_command
from opencv_tools.robot.view.content import to_json
from opencv_tools.robot.view.untrusted import text_content
from opencv_tools.robot.xml.document import DescriptionError
from opencv_tools.robot.xml.report import Report
from opencv_tools.viewer.errors import MAX_MESSAGE, RequestError
from opencv_tools.viewer.robot.joints import joints_of, LiveJoint

_SECONDS, _PROCESSOR_SECONDS = 60.0, 15
_MEMORY = 1_500_000_000  # bytes of address space, including Python and its modules
_MAX_BODY = 30_000_000


@dataclass(frozen=True)
class LiveRobot:
    """
    A robot for the page.

    :param body: document of `robot.view.untrusted.text_content` as JSON.
    :param meshes: file, size and media type of each mesh, in the order of the document; None for
        no file.
    """

    body: bytes
    meshes: Sequence[tuple[Path, int, str] | None]
    joints: Sequence[LiveJoint]


async def read_description(data: bytes, topic: str) -> LiveRobot:
    """
    Read a robot description.

    :param topic: name of the topic, for messages.
    :raises RequestError: the text is not a robot, or it needs too much time or memory.
    """
    output = b''
    with suppress(asyncio.TimeoutError):
        output = await Worker().run(worker_command(__name__, topic), data, _SECONDS)
    try:
        return await asyncio.to_thread(_parse, output)
    except ValueError as err:  # the process ended before or while it wrote
        raise RequestError(
            f'{topic}: the robot is too large: reading it needs more than {_PROCESSOR_SECONDS} s '
            f'or {_MEMORY} bytes; publish a part of it') from err


def _parse(output: bytes) -> LiveRobot:
    head, _, body = output.partition(b'\n')
    found: Mapping[str, Any] = json.loads(head)
    if found['error']:
        raise RequestError(found['error'])
    return LiveRobot(body, [mesh and (Path(mesh[0]), *mesh[1:]) for mesh in found['meshes']],
                     joints_of(json.loads(body)['robots'][0]))


def answer(data: bytes, topic: str) -> bytes:
    """Return what the process writes: a line of JSON, and the document of a valid robot."""
    try:
        content = text_content(data, topic, Report())
        body = to_json(content.document)
        if len(body) > _MAX_BODY:
            raise DescriptionError(f'the robot needs {len(body)} bytes in a browser, but '
                                   f'{_MAX_BODY} are the limit; publish a part', source=topic)
    except DescriptionError as err:
        return json.dumps({'error': printable(str(err), MAX_MESSAGE)}).encode() + b'\n'
    meshes = [mesh.path and (str(mesh.path), mesh.size, mesh.media_type)
              for mesh in content.meshes.files]
    return f'{json.dumps({"error": "", "meshes": meshes})}\n{body}'.encode()


def main() -> None:
    """Read a description from standard input, and write the answer to standard output."""
    begin_work(_MEMORY, _PROCESSOR_SECONDS)
    sys.stdout.buffer.write(answer(sys.stdin.buffer.read(), sys.argv[1]))
