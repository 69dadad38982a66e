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

"""The calibration of a camera before another one is saved, read in the executor."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
import time

import numpy as np
from opencv_tools.image.text import enumerated, printable
from opencv_tools.topics.message_reader import MessageReader
from opencv_tools.viewer.control import Control
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


async def read_former(control: Control, name: str, nodes: Sequence[str]) -> Former:
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
