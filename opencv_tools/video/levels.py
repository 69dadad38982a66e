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

"""Levels of H.264 and H.265 by size and bit rate, whatever the rate of the frames."""

from __future__ import annotations

from opencv_tools.video.bit_stream import nal_units, START_CODE, unescaped
from opencv_tools.video.parameter_sets import parameter_sets

_RATE = 60  # frames per second that a level has room for
_BLOCK = 16  # pixels, to which a side is rounded up
# Level in a stream, luma samples of a picture and of a second, and bits of a second: tables A-1 of
# H.264 and A.8 and A.9 of H.265 in the main tier.
_LEVELS = {
    'h264': ((31, 921_600, 27_648_000, 14_000_000), (42, 2_228_224, 133_693_440, 50_000_000),
             (52, 9_437_184, 530_841_600, 240_000_000),
             (62, 35_651_584, 4_278_190_080, 800_000_000)),
    'h265': ((93, 983_040, 33_177_600, 10_000_000), (123, 2_228_224, 133_693_440, 20_000_000),
             (153, 8_912_896, 534_773_760, 40_000_000),
             (186, 35_651_584, 4_278_190_080, 240_000_000)),
}
# Bytes of the level and of the tier by the first byte of a NAL unit, without its upper bits.
_PLACES = {'h264': (31, {7: (3, 0)}), 'h265': (126, {64: (17, 6), 66: (14, 3)})}
_HIGH_TIER = 32


def find_level(codec: str, width: int, height: int, bit_rate: int) -> int:
    """
    Return the level of a video at 60 Hz; the highest one if no level has room for it.

    :param codec: ``'h264'`` or ``'h265'``; others have the level 0.
    :param width: width of the pictures in pixels.
    :param height: height of the pictures in pixels.
    :param bit_rate: bits per second; 0 if they are unknown.
    """
    across, down = (-(-side // _BLOCK) * _BLOCK for side in (width, height))
    rows = _LEVELS.get(codec, ((0, 0, 0, 0),))
    return next((level for level, picture, second, bits in rows
                 if across * down <= min(picture, second / _RATE)
                 and max(across, down) ** 2 <= 8 * picture and bit_rate <= bits), rows[-1][0])


def with_level(codec: str, data: bytes, level: int) -> bytes:
    """
    Return a packet whose parameter sets have this level, in the main tier.

    An encoder derives a level from the bit rate that it is told, which depends on the rate of the
    frames.

    :param codec: ``'h264'`` or ``'h265'``.
    :raises VideoError: the packet is damaged.
    """
    mask, places = _PLACES[codec]
    for unit in nal_units(parameter_sets(codec, data)):
        if unit[0] & mask in places:
            at, tier = (_escaped(unit, place) for place in places[unit[0] & mask])
            changed = bytearray(unit)
            changed[at] = level
            if codec == 'h265':
                changed[tier] &= ~_HIGH_TIER
            data = data.replace(START_CODE[1:] + unit, START_CODE[1:] + changed, 1)
    return data


def _escaped(unit: bytes, place: int) -> int:
    """Return the place of a byte of a NAL unit with its emulation prevention bytes."""
    return next(end for end in range(len(unit)) if len(unescaped(unit[:end + 1])) > place)
