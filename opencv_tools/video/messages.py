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

"""
The messages that carry video: one picture in each.

``ffmpeg_image_transport_msgs/msg/FFMPEGPacket`` has a header and the size of the picture.
``foxglove_msgs/msg/CompressedVideo`` has neither.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from opencv_tools.base.text import printable
from opencv_tools.image.cdr import WireHeader
from opencv_tools.image.errors import CdrError
from opencv_tools.message_types.codec import MessageCodec
from opencv_tools.message_types.definition import read_definition
from opencv_tools.video.packet import VideoPacket

#: Names of the message types.
FFMPEG_PACKET = 'ffmpeg_image_transport_msgs/msg/FFMPEGPacket'
COMPRESSED_VIDEO = 'foxglove_msgs/msg/CompressedVideo'

_CODECS = {name: MessageCodec(read_definition(name))
           for name in (FFMPEG_PACKET, COMPRESSED_VIDEO)}
#: Last part of the name of the topic of each type, as in image_transport.
VIDEO_TOPICS = {FFMPEG_PACKET: 'ffmpeg', COMPRESSED_VIDEO: 'foxglove'}

# Begins of names of codecs and encoders in messages.
_NAMES = {'h264': 'h264', 'libx264': 'h264', 'avc': 'h264', 'h265': 'h265', 'hevc': 'h265',
          'libx265': 'h265', 'av1': 'av1', 'libsvtav1': 'av1', 'libaom': 'av1', 'librav1e': 'av1'}
_KEY_FRAME = 1  # AV_PKT_FLAG_KEY of FFmpeg
_MAX_TEXT = 40  # characters of a text in a description
_MAX_SIDE = 1 << 16  # pixels


@dataclass(frozen=True, kw_only=True)
class WireVideo:
    """
    A message with one picture of video, as plain values.

    :param encoding: codec, or codec and pixel formats with a semicolon between them.
    :param width: width of the picture in pixels; 0 if the message has none.
    :param height: height of the picture in pixels; 0 if the message has none.
    :param data: buffer of bytes.
    """

    type_name: str
    header: WireHeader
    encoding: str
    width: int = 0
    height: int = 0
    data: Any
    serialized: Any

    @property
    def codec(self) -> str:
        """
        One of ``CODECS`` of `opencv_tools.video.packet`.

        :raises CdrError: the codec is unknown.
        """
        name = self.encoding.partition(';')[0].strip().lower()
        for begin, codec in _NAMES.items():
            if name.startswith(begin):
                return codec
        raise CdrError(f'the video has the codec {printable(name, _MAX_TEXT)!r}; h264, h265 and '
                       'av1 are decoded')

    @property
    def size(self) -> tuple[int, int] | None:
        """Width and height of the picture in pixels; None if the message has none."""
        return (self.width, self.height) if self.width and self.height else None

    @property
    def description(self) -> str:
        """Size in bytes and codec, in printable characters."""
        return f'{len(self.data)} bytes {printable(self.encoding, _MAX_TEXT)}'


def video_to_cdr(type_name: str, header: WireHeader, packet: VideoPacket, number: int) -> bytes:
    """
    Convert a picture of video to a message.

    :param number: number of the picture, in a stream of one rate.
    :returns: little-endian CDR.
    :raises CdrError: a string cannot be part of a message.
    """
    stamp = {'sec': header.sec, 'nanosec': header.nanosec}
    if type_name == COMPRESSED_VIDEO:
        values: dict[str, Any] = {
            'timestamp': stamp, 'frame_id': header.frame_id, 'format': packet.codec}
    else:
        values = {
            'header': {'stamp': stamp, 'frame_id': header.frame_id}, 'width': packet.width,
            'height': packet.height, 'encoding': packet.codec, 'pts': number,
            'flags': _KEY_FRAME if packet.is_key else 0}
    return _CODECS[type_name].write({**values, 'data': packet.data})


def cdr_to_video(type_name: str, serialized: Any) -> WireVideo:
    """
    Read a message with a picture of video.

    :returns: the message; its data are a view of the buffer.
    :raises CdrError: the bytes are no message of this type, or its size is impossible.
    """
    values = _CODECS[type_name].read(serialized)
    if type_name == COMPRESSED_VIDEO:
        stamp, frame_id, encoding = values['timestamp'], values['frame_id'], values['format']
        width = height = 0
    else:
        stamp, frame_id = values['header']['stamp'], values['header']['frame_id']
        encoding, width, height = values['encoding'], values['width'], values['height']
        if not (0 <= width < _MAX_SIDE and 0 <= height < _MAX_SIDE):
            raise CdrError(f'the video has pictures of {width}x{height} pixels')
    return WireVideo(
        type_name=type_name, header=WireHeader(stamp['sec'], stamp['nanosec'], frame_id),
        encoding=encoding, width=width, height=height, data=memoryview(values['data']),
        serialized=serialized)
