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

"""Picture formats: the types of images that each one stores, and its largest size."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
import itertools

import numpy as np
from opencv_tools.image.encodings import Encoding, find_encoding


def _types(depths: str, channels: str) -> frozenset[str]:
    return frozenset(f'{depth}C{count}' for depth, count in
                     itertools.product(depths.split(), channels.split()))


_BYTES = _types('8U', '1 3')
# OpenCV 4.6 cannot read the 64FC3 TIFF that it writes.
_TIFF = _types('8U 16U', '1 3 4') | _types('32F', '1 3') | _types('64F', '1')

#: OpenCV types that each format stores without conversion. All formats are lossless, except JPEG,
#: and WebP with a quality.
CODEC_TYPES = {
    '.png': _types('8U 16U', '1 3 4'),
    '.jpg': _BYTES,
    '.jpeg': _BYTES,
    '.jpe': _BYTES,
    '.tif': _TIFF,
    '.tiff': _TIFF,
    '.bmp': _BYTES,
    '.dib': _BYTES,
    '.webp': _types('8U', '3'),  # with alpha it loses the colours of transparent pixels
    '.sr': _BYTES,
    '.ras': _BYTES,
    '.pgm': _types('8U 16U', '1'),
    '.ppm': _types('8U 16U', '3'),
}

#: Longest side in pixels that OpenCV writes, of the formats with a limit; it logs what is longer.
MAX_SIDES = {**dict.fromkeys(('.jpg', '.jpeg', '.jpe'), 65_500), '.png': 1_000_000,
             '.webp': 16_383}


#: Formats of the topics of compressed images.
COMPRESSED_FORMATS = ('auto', 'jpeg', 'png')


def compressed_form(encoding: Encoding, wanted: str) -> tuple[str, Encoding]:
    """
    Return the codec of an image on a topic of compressed images, and the encoding that it stores.

    :param wanted: one of ``COMPRESSED_FORMATS``. ``auto`` is JPEG for gray and colours with 8
        bits, and PNG for what JPEG would reduce: more bits, alpha and generic types. ``jpeg``
        reduces them to 8 bits without alpha.
    """
    if encoding.is_generic:
        return ('png' if wanted == 'auto' else wanted), encoding
    has_alpha, is_small = encoding.channels == 4, encoding.dtype == 'uint8'
    codec = wanted if wanted != 'auto' else 'jpeg' if is_small and not has_alpha else 'png'
    order = 'mono' if encoding.order == 'y' else 'bgra' if has_alpha and codec == 'png' else 'bgr'
    return codec, find_encoding(f'{order}{8 if is_small or codec == "jpeg" else 16}')


def reduction(before: Encoding, after: Encoding) -> str:
    """
    Return what a conversion loses, as in ``mono16 images lose 8 bits in bgr8``.

    :returns: the sentence; '' if all bits and alpha are kept.
    """
    lost = 8 * (np.dtype(before.dtype).itemsize - np.dtype(after.dtype).itemsize)
    has_lost_alpha = before.channels == 4 and after.channels < 4
    what = ' and '.join(filter(None, (
        f'{lost} bits' if lost > 0 else '', 'alpha' if has_lost_alpha else '')))
    return what and f'{before.name} images lose {what} in {after.name}'


def jpeg_loss(encoding: Encoding, wanted: str) -> str:
    """Return what an image loses on a topic of compressed images, with its reason."""
    lost = reduction(encoding, compressed_form(encoding, wanted)[1])
    return lost and f'{lost}, as compressed_format {wanted} has it'


@lru_cache(64)  # the same for most images of a topic
def why_not_compressed(encoding: Encoding, width: int, height: int, wanted: str) -> str:
    """Return why a topic of compressed images has no image of an encoding; '' if it has."""
    codec, stored = compressed_form(encoding, wanted)
    reason = why_not_stored(stored, (height, width), f'.{codec}')
    remedy = ', but with compressed_format auto' if (
        wanted == 'jpeg' and not why_not_stored(stored, (height, width), '.png')) else ''
    return reason and f'an image of {encoding.name} {reason}{remedy}'


def why_not_stored(encoding: Encoding, shape: Sequence[int], suffix: str) -> str:
    """
    Return why a format cannot store an image; '' if it can.

    :param suffix: one of ``CODEC_TYPES``.
    """
    if encoding.type_name not in CODEC_TYPES[suffix]:
        return f'cannot be stored as {suffix[1:]}'
    if 0 in shape:
        return 'is empty and cannot be encoded'
    limit = MAX_SIDES.get(suffix, max(shape))
    return (f'is too long for {suffix[1:]}: the limit is {limit} pixels a side'
            if max(shape[:2]) > limit else '')
