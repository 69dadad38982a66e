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

"""Messages of the WebSocket between the server and the page."""

from __future__ import annotations

from dataclasses import dataclass
import json
import math
import struct
import time
from typing import Any

from opencv_tools.base.text import printable
from opencv_tools.video.packet import CODECS, VideoPacket
from opencv_tools.viewer.errors import RequestError
from opencv_tools.viewer.region import Region

#: Maximum size of a message of the page in bytes.
MAX_MESSAGE_BYTES = 4096
#: Largest number of a range, so that differences are finite.
LARGEST = 1e300

#: Widths in pixels that pictures are scaled to; few, so that viewers share encodings.
WIDTHS = (160, 240, 320, 480, 640, 960, 1280, 1920)

#: Maximum number of topics in the list, and of those that a page looks at.
MAX_TOPICS = 200

#: Colours of depth.
COLORS = ('turbo', 'gray')

#: Ends of the names of topics with compressed images and with video.
COMPRESSED, VIDEOS = '/compressed', ('/ffmpeg', '/foxglove')

_HEAD = struct.Struct('>IIdd')
_PLACE = struct.Struct('>6I')  # part of the image, and its width and height
_ORIGIN = struct.Struct('>QIH')  # stamp, number from the publisher, bytes of the frame_id
_VIDEO = 1 << 31  # in the number of the topic, before a packet of video
# Whether it is a key frame, bytes of the codec string, width, height, number of the packet.
_VIDEO_HEAD = struct.Struct('>BBHHI')
_MAX_CODECS, _MAX_CODEC, _MAX_NAME = 8, 16, 256
_MAX_WIDTH = 65_535
_MAX_SIDE = 2**31  # pixels of an image


@dataclass(frozen=True, kw_only=True)
class ViewRequest:
    """
    What a viewer of a topic requests.

    :param width: largest useful width in pixels; 0 for the full size.
    :param quality: highest JPEG quality, 1 to 100; 0 for that of the node.
    :param rate: highest rate in Hz; 0 for that of the node.
    :param fixed: whether width and quality stay as they are on a slow link.
    :param limits: numbers that become black and white; None for those of each picture.
    :param video: whether packets of video are better than JPEGs.
    :param slow: whether the link does not carry the video of the topic.
    :param region: the only part of the images that is shown; None for whole images.
    :param colors: colours of depth, one of ``COLORS``.
    :param looks: whether the viewer asks for values of the pixels.
    :param held: whether the last picture stays, and no newer one is sent.
    :param searched: whether pictures are those that a calibration has searched for its board.
    """

    width: int = 0
    quality: int = 0
    rate: float = 0.0
    fixed: bool = False
    limits: tuple[float, float] | None = None
    video: bool = False
    slow: bool = False
    region: Region | None = None
    colors: str = 'turbo'
    looks: bool = False
    held: bool = False
    searched: bool = False


def pack_frame(
    topic: int, sequence: int, origin: tuple[int, int, str], sent: float,
    place: tuple[int, ...], picture: bytes,
) -> bytes:
    """
    Return the binary message of a picture.

    :param sequence: number of the message, which the page answers.
    :param origin: stamp in nanoseconds, number from the publisher or 0, and ``frame_id``.
    :param sent: time of sending in seconds of the system clock.
    :param place: column, row, width and height of the part that is shown, and size of the image.
    """
    stamp_ns, number, frame_id = origin
    text = printable(frame_id).encode()
    return b''.join((
        _HEAD.pack(topic, sequence % 2**32, stamp_ns / 10**9, sent), _PLACE.pack(*place),
        _ORIGIN.pack(max(0, stamp_ns), number % 2**32, len(text)), text, picture))


def unpack_frame(message: bytes) -> tuple[int, int, float, float, tuple[int, ...], bytes]:
    """Return the arguments of ``pack_frame``, with the stamp in seconds alone as origin."""
    begin = _HEAD.size + _PLACE.size
    *_, length = _ORIGIN.unpack_from(message, begin)
    return (*_HEAD.unpack_from(message), _PLACE.unpack_from(message, _HEAD.size),
            message[begin + _ORIGIN.size + length:])


def pack_video(
    topic: int, sequence: int, stamp: float, sent: float, packet: VideoPacket, number: int,
    name: str,
) -> bytes:
    """
    Return the binary message of a packet of video.

    :param sequence: number of the message, which the page answers.
    :param stamp: stamp of the frame in seconds.
    :param sent: time of sending in seconds of the system clock.
    :param number: number of the packet; the page needs a key frame after a missing one.
    :param name: codec string of WebCodecs of a key frame; '' for other packets.
    """
    text = name.encode('ascii')
    return b''.join((
        _HEAD.pack(topic | _VIDEO, sequence % 2**32, stamp, sent),
        _VIDEO_HEAD.pack(packet.is_key, len(text), packet.width, packet.height, number % 2**32),
        text, packet.data))


def unpack_video(
    message: bytes,
) -> tuple[int, int, float, float, bool, tuple[int, int], int, str, bytes] | None:
    """
    Return what ``pack_video`` got; None for another message.

    :returns: topic, sequence, stamp, sent, whether it is a key frame, size, number, codec string
        and content.
    """
    topic, sequence, stamp, sent = _HEAD.unpack_from(message)
    if not topic & _VIDEO:
        return None
    is_key, length, width, height, number = _VIDEO_HEAD.unpack_from(message, _HEAD.size)
    begin = _HEAD.size + _VIDEO_HEAD.size
    return (topic & ~_VIDEO, sequence, stamp, sent, bool(is_key), (width, height), number,
            message[begin:begin + length].decode('ascii'), message[begin + length:])


def parse_codecs(names: Any) -> frozenset[str]:
    """
    Read which codecs a page decodes; unknown ones are left out.

    :raises RequestError: it is not a short list of short texts.
    """
    if (not isinstance(names, list) or len(names) > _MAX_CODECS
            or not all(isinstance(name, str) and len(name) <= _MAX_CODEC for name in names)):
        raise RequestError('codecs is not a list of names such as h264')
    return frozenset(names) & frozenset(CODECS)


def pong(ping: Any) -> dict[str, Any]:
    """Return the answer to a ping of a page, with the time of this machine."""
    return {'pong': ping, 'now': time.time()}


def parse_message(text: str | bytes) -> dict[str, Any]:
    """
    Read a text message of the page.

    :raises RequestError: the message is not an object of JSON.
    """
    if isinstance(text, bytes):
        raise RequestError('a binary message is not expected from a page')
    try:
        message = json.loads(text, parse_constant=_refuse_constant)
    except (ValueError, RecursionError) as err:
        raise RequestError(f'the message is not JSON: {str(err)[:80]}') from err
    if not isinstance(message, dict):
        raise RequestError('the message is not an object of JSON')
    return message


def topic_of(name: Any) -> str:
    """
    Return the name of a topic from a message or a URL, without the end of its transport.

    :raises RequestError: it is not a text, or too long.
    """
    if not isinstance(name, str) or not 0 < len(name) <= _MAX_NAME:
        raise RequestError('the name of a topic is missing or too long')
    name = name if name.startswith('/') else f'/{name}'
    return base_name(name)


def base_name(name: str, ends: tuple[str, ...] = (COMPRESSED, *VIDEOS)) -> str:
    """Return the name of a topic without one of some ends."""
    return next((name[:-len(end)] for end in ends if name.endswith(end) and name != end), name)


def parse_options(message: dict[str, Any]) -> ViewRequest:
    """
    Read what a viewer requests.

    :param message: values of a message or of the query of a URL.
    :raises RequestError: a value is invalid.
    """
    limits = message.get('range')
    if limits is not None:
        if not isinstance(limits, list) or len(limits) != 2:
            raise RequestError('range is not a list of two numbers')
        low, high = (valid_number(limit, 'range', -LARGEST, LARGEST) for limit in limits)
        if not low < high:
            raise RequestError(f'range is {low:g},{high:g}: give the lower number first')
        limits = low, high
    colors = message.get('colors', COLORS[0])
    if colors not in COLORS:
        raise RequestError(f'colors is {str(colors)[:40]!r}: give one of {", ".join(COLORS)}')
    return ViewRequest(
        width=int(valid_number(message.get('width', 0), 'width', 0, _MAX_WIDTH)),
        quality=int(valid_number(message.get('quality', 0), 'quality', 0, 100)),
        rate=valid_number(message.get('rate', 0), 'rate', 0, 1000),
        limits=limits, region=parse_region(message.get('region')), colors=colors,
        **{name: message.get(name) is True
           for name in ('fixed', 'video', 'looks', 'held', 'searched')})


def parse_region(values: Any) -> Region | None:
    """
    Read a part of an image; None is the whole image.

    :raises RequestError: it is not a list of four numbers, or a number is invalid.
    """
    if values is None:
        return None
    if not isinstance(values, list) or len(values) != 4:
        raise RequestError('region is not a list of four numbers')
    x, y, width, height = (int(valid_number(value, 'region', least, _MAX_SIDE))
                           for value, least in zip(values, (0, 0, 1, 1)))
    return Region(x=x, y=y, width=width, height=height)


def parse_point(values: Any, name: str) -> tuple[int, int]:
    """
    Read the column and the row of a pixel.

    :param name: name of the value, for the message.
    :raises RequestError: it is not such a list.
    """
    if not isinstance(values, list) or len(values) != 2:
        raise RequestError(f'{name} is not a list of two numbers')
    x, y = (int(valid_number(value, name, 0, _MAX_SIDE)) for value in values)
    return x, y


def valid_number(value: Any, name: str, low: float, high: float) -> float:
    """
    Return a number of a message.

    :param name: name of the value, for the message.
    :raises RequestError: the value is invalid.
    """
    is_number = isinstance(value, (int, float)) and not isinstance(value, bool)
    if not is_number or not low <= value <= high:
        raise RequestError(
            f'{name} is {str(value)[:40]!r}: give a number from {low:g} to {high:g}')
    return float(value)


def number_of(text: str, name: str, low: float, high: float) -> float:
    """
    Read a number in a URL.

    :param name: name of the value, for the message.
    :raises RequestError: the value is invalid.
    """
    try:
        return valid_number(float(text), name, low, high)
    except ValueError:
        return valid_number(text, name, low, high)


def step_width(width: int) -> int:
    """Return the smallest of ``WIDTHS`` that is not less than a width; 0 above all of them."""
    return next((step for step in WIDTHS if 0 < width <= step), 0)


def finite(value: float) -> float | None:
    """Return a number that JSON can hold, or None."""
    return value if math.isfinite(value) else None


def _refuse_constant(name: str) -> None:
    raise ValueError(f'{name} is not a number of JSON')
