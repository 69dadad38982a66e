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

"""All calibrations of the server, one for each topic, and those they replace."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial
import time
from typing import Any

import numpy as np
from opencv_tools.base.logs import Log
from opencv_tools.base.text import enumerated, printable
from opencv_tools.image.topic_names import camera_info_topic
from opencv_tools.topics.message_reader import MessageReader
from opencv_tools.viewer.calibrate.camera_info import camera_info_of, check_raw, set_camera_info
from opencv_tools.viewer.calibrate.live import LiveCalibration, Show
from opencv_tools.viewer.calibrate.session import Result
from opencv_tools.viewer.control import CameraControl
from opencv_tools.viewer.errors import NoAnswerError, RequestError
from opencv_tools.viewer.hub import Hub
from rclpy.node import Node
from rclpy.qos import HistoryPolicy, QoSProfile, ReliabilityPolicy
from rclpy.serialization import deserialize_message
from sensor_msgs.msg import CameraInfo

_SECONDS = 2.0
_MAX_COEFFICIENTS = 32
_MAX_BYTES = 4096
# Messages between two looks. Those of other nodes must not replace the one of the camera.
_QOS = QoSProfile(
    history=HistoryPolicy.KEEP_LAST, depth=100, reliability=ReliabilityPolicy.BEST_EFFORT)


@dataclass(frozen=True)
class Former:
    """
    A calibration to which a camera can return.

    :param info: the calibration; None if there is none.
    :param problem: reason why there is none, in words.
    """

    info: CameraInfo | None = None
    problem: str = ''


async def read_former(control: CameraControl, name: str, nodes: Sequence[str]) -> Former:
    """
    Return the present calibration of a camera.

    :param name: name of the topic of its ``camera_info``.
    :param nodes: full names of the nodes that publish its images; no other publisher is read.
    :returns: the next calibration of these nodes; none if there is no usable one within 2 s.
    """
    reader = MessageReader(control.node, CameraInfo, name, _QOS)
    found: list[CameraInfo] = []

    def has_arrived() -> bool:
        info = _take(reader, control.node, nodes)
        if info is not None:
            found.append(info)
        return bool(found)

    try:
        await control.wait(has_arrived, time.monotonic() + _SECONDS)
    finally:
        reader.destroy()
    if found:
        problem = _problem(found[0])
        return Former(None, problem) if problem else Former(found[0])
    _, others = _publishers(control.node, reader.topic_name, nodes)
    return Former(None, f'no {printable(reader.topic_name)} of the camera arrived' + (
        f', and other nodes publish it: {enumerated(others)}' if others else ''))


def _take(reader: MessageReader, node: Node, nodes: Sequence[str]) -> CameraInfo | None:
    """Return the oldest message of some nodes, None without one; discard all others."""
    own, others = _publishers(node, reader.topic_name, nodes)
    for _ in range(_QOS.depth):
        taken = reader.take_serialized()
        if taken is None:
            break
        data, metadata = taken
        sender = bytes(metadata.publisher)
        # Without rcl the sender is unknown.
        is_own = sender in own if any(sender) else bool(own) and not others
        if not is_own or data.nbytes > _MAX_BYTES:
            continue
        try:
            info = deserialize_message(data.tobytes(), CameraInfo)
        except Exception:  # noqa: B902 (the node has sent what is no message)
            continue
        if info is not None and len(info.d) <= _MAX_COEFFICIENTS:
            return info
    return None


def _publishers(
    node: Node, name: str, nodes: Sequence[str],
) -> tuple[set[bytes], list[str]]:
    """Return the publishers of a topic that some nodes have, and the names of other nodes."""
    own: set[bytes] = set()
    others: set[str] = set()
    for found in node.get_publishers_info_by_topic(name):
        full_name = printable(f'{found.node_namespace.rstrip("/")}/{found.node_name}')
        if full_name in nodes:
            own.add(bytes(found.endpoint_gid))
        else:
            others.add(full_name)
    return own, sorted(others)


def _problem(info: CameraInfo) -> str:
    """Return why a camera cannot return to a calibration, in words; '' if it can."""
    if not np.any(info.k):
        return 'there was no calibration before'
    if not all(np.isfinite(values).all() for values in (info.k, info.d, info.r, info.p)):
        return 'the calibration before has numbers that are not finite'
    if not (info.width and info.height):
        return f'the calibration before is for images of {info.width}x{info.height}'
    return ''


_MAX_SESSIONS = 4


class NodeCamera:
    """The node that publishes a topic. It implements ``Camera``."""

    def __init__(self, hub: Hub, topic: str) -> None:
        self._hub = hub
        self._topic = topic
        self._former: Former | None = None  # None before a calibration was saved

    @property
    def can_restore(self) -> bool:
        """Whether there is a former calibration."""
        return self._former is not None and self._former.info is not None

    async def save(self, result: Result) -> str:
        """Set the calibration, and keep the one before the first that was saved."""
        former = self._former or await self._read()
        try:
            answer = await self._set(camera_info_of(result.calibration))
        except NoAnswerError as err:
            self._former = former  # the calibration may be set late
            raise RequestError(f'{err}: the calibration may be saved later; save again, or undo '
                               'the saving') from err
        self._former = former
        undo = '' if former.info else f'; it has no undo: {former.problem}'
        return f'saved: {answer}{undo}'

    async def restore(self) -> str:
        """Set the former calibration."""
        if self._former is None:
            raise RequestError('there is no former calibration: it was not saved from here')
        if self._former.info is None:
            raise RequestError(f'there is no former calibration: {self._former.problem}')
        answer = await self._set(self._former.info)
        self._former = None
        return f'the former calibration is back: {answer}'

    async def _read(self) -> Former:
        nodes = await self._nodes()

        async def read(control: CameraControl) -> dict[str, Any]:
            name = camera_info_topic(self._topic, control.node.count_publishers)
            return {'former': await read_former(control, name, nodes)}

        found: Former = (await self._hub.control(read))['former']
        return found

    async def _set(self, info: CameraInfo) -> str:
        nodes = await self._nodes()
        answer = await self._hub.control(
            lambda control: set_camera_info(control, self._topic, nodes, info))
        return ': '.join(filter(None, (answer['service'], answer['message'])))

    async def _nodes(self) -> Sequence[str]:
        topic = (await self._hub.refresh()).topics.get(self._topic)
        return topic.nodes if topic else ()


class Calibrations:
    """
    Create a session for the first page of a topic, and end it after the last one.

    All methods run in the loop of the server.
    """

    def __init__(self, hub: Hub, log: Log) -> None:
        self._hub = hub
        self._log = log
        self._searcher = ThreadPoolExecutor(1, 'searcher')
        self._sessions: dict[str, LiveCalibration] = {}

    def close(self) -> None:
        """End all sessions."""
        for live in tuple(self._sessions.values()):
            self._end(live)
        self._searcher.shutdown(cancel_futures=True)

    def find(self, name: str) -> LiveCalibration:
        """
        Return the session of a topic.

        :raises RequestError: there is none.
        """
        if name not in self._sessions:
            raise RequestError('there is no calibration of this topic: open its page', 404)
        return self._sessions[name]

    async def join(self, name: str, show: Show) -> LiveCalibration:
        """
        Add a page to the session of a topic.

        :raises RequestError: there is no such topic, its images are rectified, or there are too
            many sessions.
        """
        check_raw(name)
        if name not in self._sessions:
            stream = await self._hub.stream(name, original=True)
            if name not in self._sessions and len(self._sessions) < _MAX_SESSIONS:
                live = self._sessions[name] = LiveCalibration(
                    stream, self._searcher, NodeCamera(self._hub, name), self._log)
                live.on_unused = partial(self._end, live)
        if name not in self._sessions:
            raise RequestError(f'{_MAX_SESSIONS} calibrations are open already: close their '
                               'pages, and wait half a minute', 503)
        live = self._sessions[name]
        live.join(show)
        return live

    def _end(self, live: LiveCalibration) -> None:
        del self._sessions[live.stream.name]
        live.close()
