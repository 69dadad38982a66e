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

"""Size and profile of a video, from the SPS of H.264 and H.265 or the sequence header of AV1."""

from __future__ import annotations

from dataclasses import dataclass, replace

from opencv_tools.image.errors import VideoError
from opencv_tools.video.bit_stream import BitReader, unescaped

# Profiles of H.264 whose SPS has the chroma format.
_HIGH_PROFILES = frozenset((44, 83, 86, 100, 110, 118, 122, 128, 134, 135, 138, 139, 244))
# Horizontal and vertical chroma subsampling, by chroma_format_idc.
_SUBSAMPLING = {0: (1, 1), 1: (2, 2), 2: (2, 1), 3: (1, 1)}
_MAX_POC_CYCLE = 255
_MAX_NUMBER_BITS = 16
_AV1_TIERED_LEVEL = 7  # higher levels have a tier
_AV1_PROFESSIONAL = 2  # the profile with 12 bits


@dataclass(frozen=True, kw_only=True)
class SequenceHeader:
    """
    Size and profile of a video.

    :param width: width of the cropped picture in pixels.
    :param height: height of the cropped picture in pixels.
    :param coded_width: width that a decoder allocates, in pixels.
    :param coded_height: height that a decoder allocates, in pixels.
    :param webcodecs_name: codec string of WebCodecs, such as ``'avc1.42C01F'``.
    :param frame_number_bits: bits of frame_num of H.264; 0 if its numbers may have gaps.
    :param is_still: whether each frame is a key frame without a type in its header (AV1).
    """

    width: int
    height: int
    coded_width: int
    coded_height: int
    webcodecs_name: str
    frame_number_bits: int = 0
    is_still: bool = False


def h264_header(unit: bytes) -> SequenceHeader:
    """
    Read an SPS of H.264 (7.3.2.1.1 of the standard).

    :param unit: NAL unit with its header.
    :raises VideoError: the SPS is damaged.
    """
    payload = unescaped(unit)[1:]
    reader = BitReader(payload)
    profile = reader.bits(8)
    reader.bits(16)
    reader.unsigned()
    chroma = 1
    if profile in _HIGH_PROFILES:
        chroma = reader.unsigned()
        if chroma == 3:
            reader.flag()
        reader.unsigned(), reader.unsigned(), reader.flag()
        if reader.flag():
            _skip_scaling_lists(reader, 12 if chroma == 3 else 8)
    number_bits = reader.unsigned() + 4
    _skip_picture_order(reader)
    reader.unsigned()
    has_gaps = reader.flag() or chroma == 3 or number_bits > _MAX_NUMBER_BITS
    across, down = reader.unsigned() + 1, reader.unsigned() + 1
    fields = 1
    if not reader.flag():
        fields = 2
        reader.flag()
    reader.flag()
    crop = [reader.unsigned() for _ in range(4)] if reader.flag() else [0] * 4
    name = f'avc1.{payload[:3].hex().upper()}'
    header = _cropped((16 * across, 16 * down * fields), chroma, fields, crop, name)
    return replace(header, frame_number_bits=0 if has_gaps else number_bits)


def _skip_scaling_lists(reader: BitReader, count: int) -> None:
    for index in range(count):
        if not reader.flag():
            continue
        last = following = 8
        for _ in range(16 if index < 6 else 64):
            if following:
                following = (last + reader.signed()) % 256
            last = following or last


def _skip_picture_order(reader: BitReader) -> None:
    kind = reader.unsigned()
    if kind == 0:
        reader.unsigned()
    elif kind == 1:
        reader.flag(), reader.signed(), reader.signed()
        count = reader.unsigned()
        if count > _MAX_POC_CYCLE:
            raise VideoError(f'an SPS has a cycle of {count} pictures: it is damaged')
        for _ in range(count):
            reader.signed()


def h265_header(unit: bytes) -> SequenceHeader:
    """
    Read an SPS of H.265 (7.3.2.2 of the standard; E.3 of ISO 14496-15 has the codec string).

    :param unit: NAL unit with its header.
    :raises VideoError: the SPS is damaged.
    """
    reader = BitReader(unescaped(unit)[2:])
    reader.bits(4)
    layers = reader.bits(3)
    reader.flag()
    space, tier, profile = reader.bits(2), reader.bits(1), reader.bits(5)
    compatible = int(f'{reader.bits(32):032b}'[::-1], 2)
    constraints = reader.bits(48).to_bytes(6, 'big').rstrip(b'\0')
    level = reader.bits(8)
    if layers:
        present = [(reader.flag(), reader.flag()) for _ in range(8)]
        for has_profile, has_level in present[:layers]:
            reader.bits(88 * has_profile + 8 * has_level)
    reader.unsigned()
    chroma = reader.unsigned()
    if chroma == 3:
        reader.flag()
    size = reader.unsigned(), reader.unsigned()
    crop = [reader.unsigned() for _ in range(4)] if reader.flag() else [0] * 4
    name = '.'.join((f'hev1.{("", "A", "B", "C")[space]}{profile}', f'{compatible:X}',
                     f'{"LH"[tier]}{level}', *(f'{byte:X}' for byte in constraints)))
    return _cropped(size, chroma, 1, crop, name)


def _cropped(size: tuple[int, int], chroma: int, fields: int, crop: list[int], name: str,
             ) -> SequenceHeader:
    """Return the header of a picture; ``crop`` is left, right, top, bottom in chroma units."""
    across, down = _SUBSAMPLING.get(chroma, (0, 0))
    width = size[0] - across * (crop[0] + crop[1])
    height = size[1] - down * fields * (crop[2] + crop[3])
    if not across or width < 1 or height < 1:
        raise VideoError(f'an SPS has a picture of {width}x{height} pixels in chroma format '
                         f'{chroma}: it is damaged')
    return SequenceHeader(width=width, height=height, coded_width=size[0], coded_height=size[1],
                          webcodecs_name=name)


def av1_header(payload: bytes) -> SequenceHeader:
    """
    Read a sequence header of AV1 (5.5 of the specification; its codec string is in AV1-ISOBMFF).

    :param payload: payload of the OBU.
    :raises VideoError: the sequence header is damaged.
    """
    reader = BitReader(payload)
    profile = reader.bits(3)
    reader.flag()
    is_still = reader.flag()
    level, tier = (reader.bits(5), 0) if is_still else _av1_level(reader)
    width_bits, height_bits = reader.bits(4) + 1, reader.bits(4) + 1
    width, height = reader.bits(width_bits) + 1, reader.bits(height_bits) + 1
    has_order = False
    if not is_still and reader.flag():
        reader.bits(7)
    reader.bits(3)
    if not is_still:
        reader.bits(4)
        has_order = reader.flag()
        reader.bits(2 * has_order)
        forces_tools = 1 if reader.flag() else reader.bits(1)
        if forces_tools and not reader.flag():
            reader.flag()
        reader.bits(3 * has_order)
    reader.bits(3)
    depth = 8
    if reader.flag():
        depth = 12 if profile == _AV1_PROFESSIONAL and reader.flag() else 10
    name = f'av01.{profile}.{level:02}{"MH"[tier]}.{depth:02}'
    return SequenceHeader(width=width, height=height, coded_width=width, coded_height=height,
                          webcodecs_name=name, is_still=is_still)


def _av1_level(reader: BitReader) -> tuple[int, int]:
    """Return the level and tier of the first operating point."""
    delay_bits = 0
    if reader.flag():  # timing
        reader.bits(64)
        if reader.flag():
            reader.unsigned()
        if reader.flag():  # decoder model
            delay_bits = reader.bits(5) + 1
            reader.bits(42)
    has_display_delay = reader.flag()
    points = []
    for _ in range(reader.bits(5) + 1):
        reader.bits(12)
        level = reader.bits(5)
        points.append((level, reader.bits(1) if level > _AV1_TIERED_LEVEL else 0))
        if delay_bits and reader.flag():
            reader.bits(2 * delay_bits + 1)
        if has_display_delay and reader.flag():
            reader.bits(4)
    return points[0]
