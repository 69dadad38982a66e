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

"""Packets of video whose pictures show their number, and their messages."""

from __future__ import annotations

from collections.abc import Collection
from pathlib import Path
from typing import Any

import av
from conftest import spin_until
import numpy as np
from opencv_tools.image.cdr import WireHeader
from opencv_tools.image.errors import VideoError
from opencv_tools.transport.message_type import message_type
from opencv_tools.video.bit_stream import nal_units, obus
from opencv_tools.video.encoder import VideoEncoder
from opencv_tools.video.messages import video_to_cdr, VIDEO_TOPICS
from opencv_tools.video.packet import VideoPacket
from opencv_tools.video.parameter_sets import length_prefixed_to_annexb, read_extradata
from opencv_tools.video.settings import VideoSettings
import pytest
from rclpy.node import Node
from rclpy.qos import QoSProfile

NANO = 10**9
MS = 10**6
_NAMES = {'h264': 'h264', 'hevc': 'h265', 'av1': 'av1', 'libdav1d': 'av1'}
LEVELS = 50  # numbers that a gray picture can tell


def flat(number: int, width: int = 48, height: int = 32) -> np.ndarray:
    """Return a gray image that tells its number, after every codec."""
    return np.full((height, width, 3), number % LEVELS * 5, np.uint8)


def number_of(image: np.ndarray) -> int:
    return round(float(image.mean()) / 5)


def flat_packets(
    count: int, codec: str = 'h264', keys: Collection[int] = (0,), first: int = 0,
    size: tuple[int, int] = (48, 32), quality: int = 23,
) -> list[VideoPacket]:
    """Return packets of numbered pictures, with key frames at some numbers and at the first."""
    settings = VideoSettings(codec=codec, key_interval=3600.0, quality=quality)
    try:
        encoder = VideoEncoder(settings, *size, 30.0)
    except VideoError as err:  # PyAV 12
        pytest.skip(str(err))
    return [encoder.encode(flat(number, *size), 'bgr8', number * MS, number in keys)
            for number in range(first, first + count)]


def video_message(
        type_name: str, packet: VideoPacket, number: int, step_ns: int = MS) -> bytes:
    return video_to_cdr(
        type_name, WireHeader(*divmod(NANO + number * step_ns, NANO), 'eye'), packet, number)


def units(codec: str, data: bytes) -> list[Any]:
    """Return the content of a packet, without the temporal delimiters that no container keeps."""
    if codec == 'av1':
        return [unit for unit in obus(data) if unit[0] != 2]
    return [*nal_units(data)]


def read_packets(path: Path) -> list[tuple[float, bool, list[Any]]]:
    """Return time, key flag and content of each packet of a video."""
    with av.open(str(path)) as container:
        stream = container.streams.video[0]
        codec = _NAMES[stream.codec_context.name]
        _, size = read_extradata(codec, stream.codec_context.extradata)
        found = []
        for packet in container.demux(stream):
            if packet.size:
                data = bytes(packet)
                data = length_prefixed_to_annexb(data, size) if size else data
                found.append((float(packet.pts * packet.time_base), bool(packet.is_keyframe),
                              units(codec, data)))
    return found


def numbers(path: Path) -> list[int]:
    with av.open(str(path)) as container:
        return [number_of(frame.to_ndarray(format='bgr24')) for frame in container.decode(video=0)]


class VideoSender:
    """Publish messages of one type with video, as they are."""

    def __init__(self, node: Node, topic: str, type_name: str) -> None:
        self._node = node
        self._publisher = node.create_publisher(
            message_type(type_name), f'{topic}/{VIDEO_TOPICS[type_name]}', QoSProfile(depth=1000))

    def send(self, *messages: bytes) -> None:
        """Wait for a subscriber, then send messages."""
        spin_until(self._node, lambda: self._publisher.get_subscription_count() > 0)
        for message in messages:
            self._publisher.publish(message)
