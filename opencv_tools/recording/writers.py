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

"""File formats: which frames each can hold, and the bytes it makes of them."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
import io
from typing import Any

import numpy as np
from numpy.typing import NDArray
from opencv_tools.image.encodings import Encoding, find_encoding, generic_encoding
from opencv_tools.image.errors import ImageError
from opencv_tools.pictures import (
    CodecError, convert_picture, encode_picture, FORMATS as PICTURE_FORMATS,
)
from opencv_tools.recording.frames import CompressedFrame, Frame, RawFrame
from opencv_tools.recording.payload import read_payload


class UnwritableError(ImageError):
    """A frame that a file format cannot hold; the message names one that can."""


_ANYTHING = '.npy'
_PART_BYTES = 2**20

#: What each format keeps without a loss (JPEG: but for its compression), as OpenCV names types.
FORMATS = {
    **{suffix: PICTURE_FORMATS[suffix]
       for suffix in ('.png', '.jpg', '.jpeg', '.tif', '.tiff', '.bmp', '.webp')},
    _ANYTHING: frozenset[str](),
}

# OpenCV's encoders take colours in this order.
_FILE_ORDER = {'rgb': 'bgr', 'rgba': 'bgra'}

# What frames become whose pixels have their colours only together, by the type of the numbers.
_COLORS = {'uint8': 'bgr8', 'uint16': 'bgr16'}


@dataclass(frozen=True)
class Format:
    """
    How a frame becomes the content of a file.

    :param suffix: one of ``FORMATS``, or that of a video.
    :param to_color: convert bayer and yuv frames to colour where pictures are made; otherwise they
        are kept as they are, or refused.
    :param jpeg_quality: of JPEG, 1 to 100.
    :param png_compression: of PNG, 0 to 9.
    :param crf: of videos, x264's quality from 0 for the best to 51.
    """

    suffix: str
    to_color: bool = True
    jpeg_quality: int = 95
    png_compression: int = 1
    crf: int = 23


@dataclass(frozen=True)
class Content:
    """
    The content of a file.

    :param data: a buffer of its bytes, or of those that ``array`` follows.
    :param encoding: of what is in it: the frame's own, or what it was converted to.
    :param width: of the picture, in pixels.
    :param height: of the picture, in pixels.
    :param array: numbers that follow the data, row by row; not copied, for they are many.
    """

    data: Any
    encoding: str
    width: int
    height: int
    array: NDArray[Any] | None = None

    def parts(self) -> Iterator[memoryview]:
        """Yield buffers of all bytes; rows that are not tight are copied a few at a time."""
        yield memoryview(self.data).cast('B')
        if self.array is None or not self.array.size:
            return
        if self.array.flags.c_contiguous:
            yield self.array.reshape(-1).view(np.uint8).data
            return
        rows = max(1, _PART_BYTES * len(self.array) // self.array.nbytes)
        for begin in range(0, len(self.array), rows):
            part = np.ascontiguousarray(self.array[begin:begin + rows])
            yield part.reshape(-1).view(np.uint8).data


def able_formats(type_name: str) -> str:
    """Name the extensions of files that hold an image of a type, such as ``16UC1``."""
    able = [suffix for suffix, types in FORMATS.items() if type_name in types]
    return ' or '.join([*able, _ANYTHING])


def encode_frame(frame: Frame, wanted: Format) -> Content:
    """
    Make the content of a file of a frame.

    A compressed frame that is such a file already is kept as it is; another one is decoded.

    :param frame: the frame; it is not changed.
    :param wanted: what is to be made of it; ``.npy`` keeps the array as it is.
    :returns: the content, which may be the frame's own data.
    :raises ImageError: the format cannot hold the frame without changing it, or it is broken.
    """
    if isinstance(frame, CompressedFrame):
        payload = read_payload(frame.data)
        if wanted.suffix in payload.suffixes:
            return Content(frame.data, frame.encoding, payload.width, payload.height)
    return _encode_image(frame.decode(), wanted)


def _encode_image(frame: RawFrame, wanted: Format) -> Content:
    image, encoding = frame.image, find_encoding(frame.encoding)
    height, width = encoding.height(image.shape[0]), image.shape[1]
    if wanted.suffix == _ANYTHING:
        layout: Any = np.lib.format  # numpy 1.26 has no types for what is called of it
        header = layout.header_data_from_array_1_0(image)
        head = io.BytesIO()
        layout.write_array_header_1_0(head, header)
        return Content(head.getbuffer(), encoding.name, width, height,
                       image.T if header['fortran_order'] else image)
    if wanted.to_color and encoding.kind in ('bayer', 'yuv'):
        target = find_encoding(_COLORS[encoding.dtype])
        image, encoding = convert_picture(_native(image, encoding), encoding, target), target
    # An array of luma and chroma has the type of a gray picture, but is none.
    type_name = generic_encoding(image).name if encoding.row_factor == 1 else encoding.name
    if type_name not in FORMATS[wanted.suffix]:
        raise UnwritableError(f'a {encoding.name} frame cannot be kept as {wanted.suffix}; '
                              f'set the extension of file_name to {able_formats(type_name)}')
    if not image.size:
        raise UnwritableError(f'an empty frame, {width}x{height}, '
                              f'cannot be kept as {wanted.suffix}')
    quality = wanted.jpeg_quality if wanted.suffix in ('.jpg', '.jpeg') else None
    try:
        data = encode_picture(
            _file_order(image, encoding), wanted.suffix, quality, wanted.png_compression)
    except CodecError as err:
        raise UnwritableError(f'a {encoding.name} frame was not encoded: {err}') from err
    return Content(data, encoding.name, width, height)


def _file_order(image: NDArray[Any], encoding: Encoding) -> NDArray[Any]:
    """Put colours in the order of OpenCV's encoders, and numbers in native byte order."""
    order = _FILE_ORDER.get(encoding.order)
    if order:
        target = find_encoding(encoding.name.replace(encoding.order, order))
        return convert_picture(_native(image, encoding), encoding, target)
    return _native(image, encoding)


def _native(image: NDArray[Any], encoding: Encoding) -> NDArray[Any]:
    return np.ascontiguousarray(image, np.dtype(encoding.dtype))
