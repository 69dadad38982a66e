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

"""Pictures: arrays encoded as JPEG, PNG and other formats and decoded again, by OpenCV."""

from __future__ import annotations

import itertools
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from opencv_tools.image.encodings import generic_encoding
from opencv_tools.image.errors import ImageError


class PictureError(ImageError):
    """A picture that cannot be encoded or decoded; the message says why."""


def _types(depths: str, channels: str) -> frozenset[str]:
    return frozenset(f'{depth}C{count}' for depth, count in
                     itertools.product(depths.split(), channels.split()))


_BYTES = _types('8U', '1 3')
_TIFF = _types('8U 16U', '1 3 4') | _types('32F 64F', '1 3')

#: What each format keeps without a loss (JPEG: but for its compression), as OpenCV names types.
FORMATS = {
    '.png': _types('8U 16U', '1 3 4'),
    '.jpg': _BYTES,
    '.jpeg': _BYTES,
    '.jpe': _BYTES,
    '.tif': _TIFF,
    '.tiff': _TIFF,
    '.bmp': _BYTES,
    '.dib': _BYTES,
    '.webp': _types('8U', '3 4'),
    '.sr': _BYTES,
    '.ras': _BYTES,
    '.pgm': _types('8U 16U', '1'),
    '.ppm': _types('8U 16U', '3'),
}

# Left alone, OpenCV 4 packs 32FC3 TIFF as LogLuv, which loses; 5 is lossless LZW.
_TIFF_OPTIONS = (cv2.IMWRITE_TIFF_COMPRESSION, 5)
_OPTIONS = {'.tif': _TIFF_OPTIONS, '.tiff': _TIFF_OPTIONS}
_QUALITY = {'.jpg': cv2.IMWRITE_JPEG_QUALITY, '.jpeg': cv2.IMWRITE_JPEG_QUALITY,
            '.jpe': cv2.IMWRITE_JPEG_QUALITY, '.webp': cv2.IMWRITE_WEBP_QUALITY}

_JPEG_BEGINS, _JPEG_ENDS = b'\xff\xd8', b'\xff\xd9'


def encode_picture(
    image: NDArray[Any], suffix: str, quality: int | None = None,
) -> NDArray[np.uint8]:
    """
    Make the content of a picture file.

    :param image: (h, w) gray, (h, w, 3) BGR or (h, w, 4) BGRA array in native byte order.
    :param suffix: the format, one of ``FORMATS``.
    :param quality: of JPEG and WebP, 1 to 100; None for OpenCV's own, 95 for JPEG.
    :returns: the bytes of the file.
    :raises PictureError: the format is not known or cannot hold the image without changing it.
    """
    type_name = generic_encoding(image).name
    described = f'a {image.shape[1]}x{image.shape[0]} {type_name} image'
    if suffix not in FORMATS:
        raise PictureError(
            f"'{suffix[1:80]}' is not a known picture format; the formats are "
            f'{", ".join(known[1:] for known in FORMATS)}')
    if type_name not in FORMATS[suffix]:
        able = [known[1:] for known, types in FORMATS.items() if type_name in types]
        raise PictureError(
            f'{described} cannot be kept as {suffix[1:]}'
            + (f'; {" or ".join(able)} can hold it' if able else ', nor as any other picture'))
    if not image.size:
        raise PictureError(f'{described} is empty')
    options = _OPTIONS.get(suffix, ())
    if quality is not None:
        if suffix not in _QUALITY or not 1 <= quality <= 100:
            raise PictureError(f'quality {quality} cannot be used for {suffix[1:]}: '
                               'jpg and webp have one, from 1 to 100')
        options = (_QUALITY[suffix], quality)
    try:
        encoded, content = cv2.imencode(suffix, image, options)
    except cv2.error as err:
        raise PictureError(f'{described} cannot be kept as {suffix[1:]}: {err.err}') from err
    if not encoded:
        raise PictureError(f'OpenCV made no {suffix[1:]} of {described}')
    data: NDArray[np.uint8] = content.reshape(-1)
    return data


def decode_picture(data: Any) -> NDArray[Any]:
    """
    Read the content of a picture file, with the depth and channels it has.

    :param data: a buffer with the bytes of the file.
    :returns: (h, w) gray, (h, w, 3) BGR or (h, w, 4) BGRA array, fresh.
    :raises PictureError: it is no picture, or not a whole one.
    """
    content = np.frombuffer(data, np.uint8)
    described = f'{content.size} bytes'
    if content[:2].tobytes() == _JPEG_BEGINS and _JPEG_ENDS not in content.tobytes():
        raise PictureError(f'{described} of a JPEG picture whose end is missing')  # 4.6 fills in
    try:
        image: NDArray[Any] | None = cv2.imdecode(
            content, cv2.IMREAD_UNCHANGED) if content.size else None
    except cv2.error as err:
        raise PictureError(f'{described} cannot be read as a picture: {err.err}') from err
    if image is None:
        raise PictureError(f'{described} are not a picture that OpenCV can read')
    return image


def apply_colormap(gray: NDArray[Any], colormap: int) -> NDArray[Any]:
    """
    Colour a gray image by one of OpenCV's colormaps.

    :param gray: (h, w) array.
    :param colormap: number of the colormap, such as ``cv2.COLORMAP_JET``.
    :returns: (h, w, 3) BGR array.
    :raises PictureError: there is no such colormap.
    """
    try:
        colored: NDArray[Any] = cv2.applyColorMap(gray, colormap)
    except cv2.error as err:
        raise PictureError(f'{colormap} is not the number of a colormap of OpenCV') from err
    return colored
