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

"""Frames of a source for a recording: the selected ones, with the times of the source."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from itertools import count
import time

from opencv_tools.bags.schemas import CAMERA_INFO, camera_info_topic, image_topic
from opencv_tools.bags.writing import BagChannel
from opencv_tools.capture.errors import BrokenFrameError, UnavailableError
from opencv_tools.capture.frame import CapturedFrame, JPEG, LiveSource, Recorded, Source, VIDEO
from opencv_tools.capture.player import IMAGE_RATE
from opencv_tools.image.cdr import COMPRESSED_IMAGE, IMAGE, WireCompressedImage
from opencv_tools.image.encodings import find_encoding
from opencv_tools.image.errors import ImageError
from opencv_tools.image.layout import array_to_wire
from opencv_tools.recording.bag_file import RecordedMessage
from opencv_tools.recording.frames import CompressedFrame, RawFrame, ReceivedFrame
from opencv_tools.recording.message_frame import MessageFrame
from opencv_tools.recording.naming import FrameMetadata
from opencv_tools.recording.packet_frame import packet_frame
from opencv_tools.units import NANO
from opencv_tools.video.messages import WireVideo

# Names of the publisher, for sources that have none.
_TOPIC = '/video_frames'
_FRAME_ID = 'camera'
_READ_SECONDS = 2.0

OnBroken = Callable[[BrokenFrameError], object]


def numbered_frames(
    source: Source, first: int, stop: int, every: int, on_broken: OnBroken,
    has_ended: Callable[[], bool],
) -> Iterator[tuple[int, CapturedFrame]]:
    """
    Yield frames with their numbers; the other frames are not decoded.

    :param source: open source.
    :param first: number of the first frame, from 0.
    :param stop: number of the first frame not to yield; 0 for the end of the source.
    :param every: yield the first of every n frames.
    :param on_broken: called for each frame that cannot be read, which is skipped.
    :param has_ended: called before each frame, returns whether to yield no more.
    :raises CaptureError: the source has failed.
    :raises ValueError: the source ends before the first frame.
    """
    number = 0
    for number in range(stop) if stop else count():
        if has_ended():
            return
        is_selected = number >= first and not (number - first) % every
        try:
            frame = _read_live(source) if source.live else source.read() if is_selected else None
            if frame is None and (source.live or is_selected or not source.skip()):
                break
            if frame is not None and is_selected:
                yield number, frame
        except BrokenFrameError as err:
            on_broken(err)
    else:
        return
    if 0 < number <= first:
        raise ValueError(f'--start is {first}, but {source.name} has only {number} frames, '
                         'numbered from 0')


def _read_live(source: LiveSource) -> CapturedFrame | None:
    """Return the next frame of a stream; None at its end."""
    try:
        frame = source.read() if source.wait(_READ_SECONDS) else None
        return replace(frame, image=frame.video.decode(), encoding='bgr8', video=None) if (
            frame and frame.video) else frame
    except UnavailableError:
        return None
    except ImageError as err:
        raise BrokenFrameError(f'{source.name}: {err}') from err


def received_frame(
    frame: CapturedFrame, number: int, rate: float, for_bag: bool = False,
) -> ReceivedFrame:
    """
    Return a frame for a recorder.

    :param frame: frame of a source.
    :param number: number of the frame, from 0.
    :param rate: frame rate of the source in Hz; 0.0 if it has none.
    :param for_bag: whether a frame of a bag is returned as its message.
    :returns: the frame with the time and header of its bag; else with the time in its file,
        counted from 0, or with the time of a stream.
    """
    recorded = frame.recorded
    topic, frame_id, encoding = _TOPIC, _FRAME_ID, frame.encoding
    if recorded:
        topic, frame_id = recorded.topic, recorded.message.header.frame_id
        stamp_ns, receive_ns = recorded.header_ns, recorded.log_ns
        if isinstance(recorded.message, WireCompressedImage):
            encoding = recorded.message.format
        elif isinstance(recorded.message, WireVideo) and frame.encoding == VIDEO:
            encoding = recorded.message.encoding
    elif frame.stamp_ns:
        stamp_ns = receive_ns = frame.stamp_ns + time.time_ns() - time.monotonic_ns()
    else:
        position = number / (rate or IMAGE_RATE) if frame.position is None else frame.position
        stamp_ns = receive_ns = round(position * NANO)
    metadata = FrameMetadata(stamp_ns, frame_id, encoding, topic)
    times = {'receive_ns': receive_ns, 'arrival_ns': receive_ns}
    if recorded and for_bag:
        return _message_frame(frame, recorded, metadata)
    if recorded and isinstance(recorded.message, WireVideo) and frame.encoding == VIDEO:
        return packet_frame(recorded.message, topic, receive_ns, receive_ns,
                            number=recorded.number)
    if frame.encoding == JPEG:
        return CompressedFrame(metadata=metadata, data=frame.image.data, **times)
    return RawFrame(metadata=metadata, image=frame.image, **times)


def _message_frame(
    frame: CapturedFrame, recorded: Recorded, metadata: FrameMetadata,
) -> MessageFrame:
    """Return a frame of a bag as its message, or as a raw image if it was decoded from video."""
    message, topic = recorded.message, recorded.topic
    kind = COMPRESSED_IMAGE if frame.encoding == JPEG else IMAGE
    if isinstance(message, WireVideo):
        kind = message.type_name
        if frame.encoding != VIDEO:
            kind, topic = IMAGE, image_topic(topic)
            message = array_to_wire(frame.image, find_encoding(frame.encoding), message.header)
    return MessageFrame(
        metadata=metadata, message=message, channel=BagChannel(topic=topic, type_name=kind),
        publish_ns=recorded.publish_ns, number=recorded.number, receive_ns=recorded.log_ns,
        arrival_ns=recorded.log_ns)


def camera_info_message(recorded: Recorded) -> RecordedMessage:
    """Return the calibration of a frame as a message for a bag."""
    channel = BagChannel(topic=camera_info_topic(recorded.topic), type_name=CAMERA_INFO)
    return RecordedMessage(channel=channel, parts=(recorded.camera_info,), log_ns=recorded.log_ns,
                           publish_ns=recorded.log_ns)
