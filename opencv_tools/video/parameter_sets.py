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

"""Key frames, parameter sets and sizes of video packets, without decoding."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
import struct

from opencv_tools.base.text import printable
from opencv_tools.image.errors import VideoError
from opencv_tools.video.bit_stream import BitReader, nal_units, obu, obus, START_CODE, unescaped
from opencv_tools.video.packet import CODECS

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


_SLICE_HEADER = 32  # bytes that contain the number of a picture

# Types of OBUs.
_SEQUENCE_HEADER = 1
#: Types of OBUs that begin a frame.
AV1_FRAMES = frozenset((3, 6))


@dataclass(frozen=True, kw_only=True)
class _NalTypes:
    """The types of NAL units of a codec."""

    shift: int  # of the type in the first byte
    mask: int
    sets: frozenset[int]  # parameter sets that a key frame needs
    sps: int
    keys: frozenset[int]  # slices of pictures at which decoding can begin
    slices: frozenset[int]
    read: Callable[[bytes], SequenceHeader]

    def of(self, unit: bytes) -> int:
        """Return the type of a NAL unit."""
        return unit[0] >> self.shift & self.mask


_NAL_TYPES = {
    'h264': _NalTypes(shift=0, mask=31, sets=frozenset((7, 8)), sps=7, keys=frozenset((5,)),
                      slices=frozenset(range(1, 6)), read=h264_header),
    'h265': _NalTypes(shift=1, mask=63, sets=frozenset((32, 33, 34)), sps=33,
                      keys=frozenset(range(16, 22)), slices=frozenset(range(32)),
                      read=h265_header),
}


def check_codec(codec: str) -> None:
    """
    Check the codec of a packet.

    :raises VideoError: the codec is unknown.
    """
    if codec not in CODECS:
        raise VideoError(f"codec '{printable(codec, 80)}' is unknown: give one of "
                         f'{", ".join(CODECS)}')


def is_key_frame(codec: str, data: bytes) -> bool:
    """
    Return whether decoding can begin with a packet.

    :param codec: one of ``CODECS``.
    :raises VideoError: the packet is damaged.
    """
    check_codec(codec)
    if codec != 'av1':
        types = _NAL_TYPES[codec]
        return any(types.of(unit) in types.keys for unit in _leading_units(types, data))
    is_still = False
    for kind, payload in obus(data):
        if kind == _SEQUENCE_HEADER:
            is_still = av1_header(payload).is_still
        elif kind in AV1_FRAMES:
            # show_existing_frame, and frame_type, which is 0 for a key frame
            return is_still or BitReader(payload).bits(3) == 0
    return False


def picture_size(codec: str, data: bytes) -> tuple[int, int] | None:
    """
    Return the width and height of the picture in pixels, after cropping.

    :param codec: one of ``CODECS``.
    :returns: the largest ones, if the packet contains several sizes; None if it contains none.
    :raises VideoError: the packet is damaged.
    """
    headers = [*sequence_headers(codec, data)]
    if not headers:
        return None
    return max(header.width for header in headers), max(header.height for header in headers)


def webcodecs_name(codec: str, data: bytes) -> str | None:
    """
    Return the codec string of WebCodecs, such as ``'avc1.42C01F'``.

    :param codec: one of ``CODECS``.
    :returns: the string, or None if the packet has no SPS or sequence header.
    :raises VideoError: the packet is damaged.
    """
    return next((header.webcodecs_name for header in sequence_headers(codec, data)), None)


def sequence_headers(codec: str, data: bytes) -> Iterator[SequenceHeader]:
    """
    Yield what each SPS or sequence header of a packet contains.

    :param codec: one of ``CODECS``.
    :raises VideoError: the packet is damaged.
    """
    check_codec(codec)
    if codec == 'av1':
        for kind, payload in obus(data):
            if kind == _SEQUENCE_HEADER:
                yield av1_header(payload)
        return
    types = _NAL_TYPES[codec]
    for unit in nal_units(data):  # a decoder also reads those after the picture
        if types.of(unit) == types.sps:
            yield types.read(unit)


def h264_frame_number(data: bytes, bits: int) -> tuple[int, bool] | None:
    """
    Return frame_num of a picture of H.264, and whether other pictures refer to this one.

    :param bits: ``frame_number_bits`` of the header of the sequence.
    :returns: None if the packet has no slice.
    :raises VideoError: the packet is damaged.
    """
    types = _NAL_TYPES['h264']
    for unit in _leading_units(types, data):
        if types.of(unit) in types.slices:
            reader = BitReader(unescaped(unit[:_SLICE_HEADER])[1:])
            reader.unsigned(), reader.unsigned(), reader.unsigned()
            return reader.bits(bits), bool(unit[0] & 0x60)
    return None


def has_parameter_sets(codec: str, data: bytes) -> bool:
    """
    Return whether a packet has all parameter sets, so that a decoder can begin with it.

    :raises VideoError: the packet is damaged.
    """
    check_codec(codec)
    if codec == 'av1':
        return any(kind == _SEQUENCE_HEADER for kind, _ in obus(data))
    types = _NAL_TYPES[codec]
    return types.sets <= {types.of(unit) for unit in _leading_units(types, data)}


def parameter_sets(codec: str, data: bytes) -> bytes:
    """
    Return the VPS, SPS and PPS of a packet with start codes, or its sequence header OBU.

    :param codec: one of ``CODECS``.
    :returns: the parameter sets; b'' if the packet has none.
    :raises VideoError: the packet is damaged.
    """
    check_codec(codec)
    if codec == 'av1':
        return b''.join(
            obu(kind, payload) for kind, payload in obus(data) if kind == _SEQUENCE_HEADER)
    types = _NAL_TYPES[codec]
    return b''.join(START_CODE + unit for unit in _leading_units(types, data)
                    if types.of(unit) in types.sets)


def newest_sets(codec: str, sets: bytes, newer: bytes) -> bytes:
    """
    Return parameter sets, and earlier ones of the types that are not among them.

    :param codec: one of ``CODECS``.
    :param sets: earlier parameter sets, as ``parameter_sets`` returns them.
    :raises VideoError: there are too many.
    """
    if codec == 'av1':
        return newer
    types, units = _NAL_TYPES[codec], [*nal_units(newer)]
    found = {types.of(unit) for unit in units}
    units += [unit for unit in nal_units(sets) if types.of(unit) not in found]
    return b''.join(START_CODE + unit for unit in sorted(units, key=types.of))


def _leading_units(types: _NalTypes, data: bytes) -> Iterator[bytes]:
    """Yield the NAL units up to the first slice. Parameter sets are before it."""
    for unit in nal_units(data):
        yield unit
        if types.of(unit) in types.slices:
            return


def length_prefixed_to_annexb(data: bytes, length_size: int) -> bytes:
    """
    Convert a packet of MP4 or Matroska to an Annex B byte stream.

    :param data: NAL units, each after its length.
    :param length_size: bytes of a length, as ``read_extradata`` returns it.
    :raises VideoError: the packet is damaged.
    """
    parts: list[bytes] = []
    position = 0
    if not 1 <= length_size <= 4:
        raise VideoError(f'NAL units have lengths of {length_size} bytes: give 1 to 4')
    while position < len(data):
        begin = position + length_size
        position = begin + int.from_bytes(data[position:begin], 'big')
        if position > len(data) or begin > len(data):
            raise VideoError(f'a NAL unit ends at byte {position} of {len(data)}: the packet is '
                             'damaged')
        parts += START_CODE, data[begin:position]
    return b''.join(parts)


def read_extradata(codec: str, extradata: bytes) -> tuple[bytes, int]:
    """
    Read the parameter sets of a stream in a container: avcC, hvcC, av1C or Annex B.

    :param codec: one of ``CODECS``.
    :returns: the parameter sets as ``parameter_sets`` returns them, and the bytes of a length in
        the packets of the stream; 0 if the packets have no lengths.
    :raises VideoError: the codec data are damaged.
    """
    check_codec(codec)
    if codec == 'av1':
        return parameter_sets(codec, extradata[4:] if extradata[:1] == b'\x81' else extradata), 0
    if extradata[:1] != b'\1':
        return parameter_sets(codec, extradata), 0
    try:
        units, size = _avcc(extradata) if codec == 'h264' else _hvcc(extradata)
    except (IndexError, struct.error) as err:
        raise VideoError(f'{len(extradata)} bytes of codec data for {codec} are damaged') from err
    return b''.join(START_CODE + unit for unit in units), size


def _avcc(data: bytes) -> tuple[list[bytes], int]:
    sps, position = _prefixed(data, 6, data[5] & 31)
    pps, _ = _prefixed(data, position + 1, data[position])
    return sps + pps, (data[4] & 3) + 1


def _hvcc(data: bytes) -> tuple[list[bytes], int]:
    units, position = [], 23
    for _ in range(data[22]):
        count = struct.unpack_from('>H', data, position + 1)[0]
        more, position = _prefixed(data, position + 3, count)
        units += [unit for unit in more if _NAL_TYPES['h265'].of(unit) in
                  _NAL_TYPES['h265'].sets]
    return units, (data[21] & 3) + 1


def _prefixed(data: bytes, position: int, count: int) -> tuple[list[bytes], int]:
    """Return units after their lengths of two bytes, and the offset after them."""
    units = []
    for _ in range(count):
        begin = position + 2
        position = begin + struct.unpack_from('>H', data, position)[0]
        if position > len(data):
            raise IndexError('a unit that is longer than the rest')
        units.append(data[begin:position])
    return units, position
