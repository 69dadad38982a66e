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


"""A bag of frames that are in memory."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from opencv_tools.image.cdr import COMPRESSED_IMAGE, IMAGE
from opencv_tools.image.text import printable
from opencv_tools.logs import Log
from opencv_tools.nodes.bag_messages import bag_channel, frame_of, offers_of, type_of
from opencv_tools.recording.disk_reserve import SinkWithReserve
from opencv_tools.recording.message_frame import MessageFrame
from opencv_tools.recording.recorder import Recorder
from opencv_tools.topics.queue import ReceivedMessage
from rclpy.node import Node

#: Returns the received messages of a topic that are in memory, oldest first.
FramesOf = Callable[[str], Sequence[ReceivedMessage]]
# Possible ends of the names of topics, by the types of their messages.
_ENDS = {IMAGE: ('',), COMPRESSED_IMAGE: ('/compressed', '')}


@dataclass(frozen=True)
class SavedFrames:
    """
    What has become of the frames.

    :param written: number of frames in the bag.
    :param name: name of the bag; '' without one.
    :param problem: why frames are missing, as a sentence; '' if none is.
    """

    written: int
    name: str
    problem: str


def bag_frames(
    node: Node, received: Mapping[str, Sequence[ReceivedMessage]],
) -> list[MessageFrame]:
    """
    Return images for a bag, oldest first, in the executor.

    :param received: messages by the name of the topic without the end of its transport.
    """
    channels: dict[tuple[str, str], Any] = {}
    frames = []
    for name, messages in received.items():
        for one in messages:
            type_name = type_of(one)
            if type_name not in _ENDS:  # packets of video need those before them
                continue
            key = name, type_name
            if key not in channels:
                channels[key] = _channel(node, name, type_name)
            frames.append(frame_of(one, channels[key]))
    return sorted(frames, key=lambda frame: frame.receive_ns)


def _channel(node: Node, name: str, type_name: str) -> Any:
    """Return the topic of messages, which is the first one that has publishers of their type."""
    offers = {end: offers_of(node, name + end, type_name) for end in _ENDS[type_name]}
    end = next((end for end, found in offers.items() if found), _ENDS[type_name][0])
    return bag_channel(name + end, type_name, offers[end])


def write_frames(
    sink: SinkWithReserve, frames: Sequence[MessageFrame], log: Log,
) -> SavedFrames:
    """Write frames to a bag; takes the time of the disk."""
    recorder: Recorder[Any] = Recorder(sink, log, writers=1, block=True)
    outcomes: list[Path | str] = []
    for frame in frames:
        recorder.put(frame, outcomes.append)
    recorder.close()
    paths = [outcome for outcome in outcomes if isinstance(outcome, Path)]
    reasons = [outcome for outcome in outcomes if isinstance(outcome, str)]
    missing = len(frames) - recorder.counts.written
    reason = sink.refusal or [*reasons, sink.counts.reason][0]
    return SavedFrames(
        recorder.counts.written, paths[-1].name if paths else '',
        f'{missing} of {len(frames)} frames were not written: {printable(reason)}'
        if missing else '')
