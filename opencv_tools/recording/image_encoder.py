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

"""Encoding of frames as image files, and the types that each file format can hold."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, KW_ONLY
import io
import struct
from typing import Any
import zlib

import numpy as np
from numpy.typing import NDArray
from opencv_tools.image.display import to_display_image
from opencv_tools.image.encodings import (
    Encoding, find_encoding, generic_encoding, opencv_encoding)
from opencv_tools.image.errors import CodecError
from opencv_tools.image.image_size import PNG_SIGNATURE
from opencv_tools.image.jpeg import jpeg_size, JPEG_SOI
from opencv_tools.image.picture_formats import CODEC_TYPES
from opencv_tools.image_codecs import (
    apply_colormap, check_complete, convert_image, encode_image)
from opencv_tools.recording.errors import UnwritableError
from opencv_tools.recording.frames import CompressedFrame, RawFrame, ReceivedFrame
from opencv_tools.video.lossless import LOSSLESS_ENCODINGS

_NPY = '.npy'
_PART_BYTES = 2**20
_PNG_ENDS = b'\0\0\0\0IEND\xaeB`\x82'
_CHUNK_BYTES = 12  # length, type and checksum of a chunk

#: OpenCV types that each format stores without loss (JPEG: apart from its compression).
IMAGE_FORMATS = {
    **{suffix: CODEC_TYPES[suffix]
       for suffix in ('.png', '.jpg', '.jpeg', '.tif', '.tiff', '.bmp', '.webp')},
    _NPY: frozenset[str](),
}

#: Format of videos that holds ``LOSSLESS_ENCODINGS`` without loss.
LOSSLESS_VIDEO = '.mkv'

#: Extensions of the codecs that compress the images of a bag, by the name in the format string.
COMPRESSED_SUFFIXES = {'jpeg': '.jpg', 'png': '.png'}

# Channel orders that OpenCV's encoders do not accept, and their replacements.
_FILE_ORDER = {'rgb': 'bgr', 'rgba': 'bgra'}

# Target encodings of Bayer and YUV frames, by dtype.
_COLORS = {'uint8': 'bgr8', 'uint16': 'bgr16'}


@dataclass(frozen=True)
class EncoderSettings:
    """
    Format and encoder settings of recorded files.

    :param suffix: file name extension, one of ``IMAGE_FORMATS`` or of a video format.
    :param to_color: whether Bayer and YUV frames are converted to colour in images and videos;
        otherwise they are stored unchanged or refused.
    :param jpeg_quality: JPEG quality, from 1 to 100.
    :param png_compression: PNG compression level, from 0 to 9.
    :param crf: constant rate factor of videos, from 0 (best) to 51.
    :param compression: codec of the raw images of a bag, one of ``COMPRESSED_SUFFIXES``; '' to
        keep them.
    :param lossy: whether images that a format cannot hold lose alpha, and all but 8 bits.
    :param limits: numbers that become black and white, of lossy images with one channel and more
        than 8 bits; None if they are refused.
    :param colors: ``gray``, or a colormap of OpenCV for these numbers, which formats that can
        hold the numbers have too.
    """

    suffix: str
    _: KW_ONLY
    to_color: bool = True
    jpeg_quality: int = 95
    png_compression: int = 1
    crf: int = 23
    compression: str = ''
    lossy: bool = False
    limits: tuple[float, float] | None = None
    colors: str = 'gray'

    @property
    def has_colors(self) -> bool:
        """Whether numbers become colours, not gray."""
        return self.colors != 'gray'


@dataclass(frozen=True, kw_only=True)
class EncodedImage:
    """
    Content of an image file.

    :param data: buffer with the file, or with the part before ``array``.
    :param encoding: encoding of the image in the file, after conversion.
    :param width: width in pixels.
    :param height: height in pixels.
    :param array: pixels that follow ``data`` row by row; a view, because a copy is expensive.
    """

    data: Any
    encoding: str
    width: int
    height: int
    array: NDArray[Any] | None = None

    def parts(self) -> Iterator[memoryview]:
        """Yield buffers with all bytes; non-contiguous rows are copied in small groups."""
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


def formats_for(type_name: str, encoding: str = '') -> str:
    """
    Return the extensions of formats that can hold an image.

    :param type_name: OpenCV type of the image, such as ``16UC1``.
    :param encoding: name of its encoding, if a video may hold it.
    """
    suffixes = [suffix for suffix, types in IMAGE_FORMATS.items() if type_name in types]
    suffixes += [LOSSLESS_VIDEO] * (encoding in LOSSLESS_ENCODINGS)
    return ' or '.join([*suffixes, _NPY])


def encode_frame(frame: ReceivedFrame, settings: EncoderSettings) -> EncodedImage:
    """
    Encode a frame as an image file.

    A compressed frame that already has the requested format is kept; others are decoded.

    :param frame: frame to encode; not modified.
    :param settings: format and encoder settings; ``.npy`` stores the array unchanged.
    :returns: the content of the file; for a kept frame a view of its data.
    :raises ImageError: the format cannot hold the frame without loss, or the frame is damaged.
    """
    if isinstance(frame, CompressedFrame):
        found = read_image_header(frame.data)
        may_change = settings.suffix == '.png' and settings.limits
        if settings.suffix in found.suffixes and not may_change:
            return EncodedImage(data=frame.data, encoding=frame.metadata.encoding,
                                width=found.width, height=found.height)
    return _encode_image(frame.decode(), settings)


def _encode_image(frame: RawFrame, settings: EncoderSettings) -> EncodedImage:
    image, encoding = frame.image, find_encoding(frame.metadata.encoding)
    height, width = encoding.height(image.shape[0]), image.shape[1]
    if settings.suffix == _NPY:
        npy: Any = np.lib.format  # numpy 1.26 has no types for these functions
        header = npy.header_data_from_array_1_0(image)
        head = io.BytesIO()
        npy.write_array_header_1_0(head, header)
        return EncodedImage(data=head.getvalue(), encoding=encoding.name, width=width,
                            height=height, array=image.T if header['fortran_order'] else image)
    if settings.to_color and encoding.kind in ('bayer', 'yuv'):
        target = find_encoding(_COLORS[encoding.dtype])
        image, encoding = convert_image(_native(image, encoding), encoding, target), target
    # Planar luma and chroma look like a gray image, but are not one.
    type_name = generic_encoding(image).name if encoding.row_factor == 1 else encoding.name
    is_shown = is_number(encoding) and settings.limits
    if settings.lossy and (is_shown or type_name not in IMAGE_FORMATS[settings.suffix]):
        image, encoding = to_eight_bits(image, encoding, settings)
        type_name = encoding.type_name
    if type_name not in IMAGE_FORMATS[settings.suffix]:
        others = formats_for(type_name, encoding.name)
        raise UnwritableError(f'a {encoding.name} frame cannot be stored as {settings.suffix}; '
                              f'set the extension of file_name to {others}'
                              + without_loss(encoding, settings))
    if not image.size:
        raise UnwritableError(f'an empty frame ({width}x{height}) cannot be stored as '
                              f'{settings.suffix}')
    quality = settings.jpeg_quality if settings.suffix in ('.jpg', '.jpeg') else None
    try:
        data = encode_image(
            _file_order(image, encoding), settings.suffix, quality, settings.png_compression)
    except CodecError as err:
        raise UnwritableError(f'the {encoding.name} frame was not encoded: {err}') from err
    return EncodedImage(data=data, encoding=encoding.name, width=width, height=height)


def to_eight_bits(
    image: NDArray[Any], encoding: Encoding, settings: EncoderSettings,
) -> tuple[NDArray[Any], Encoding]:
    """
    Reduce an image to 8 bits without alpha.

    Colours of 16 bits are divided by 257. Numbers of one channel, such as depth, become gray or
    colours between the limits of the settings. NaN becomes black, and so does 0 if no limit is
    negative, because it means no depth. Generic types are read as gray, BGR or BGRA.

    :returns: the image, and its encoding; both unchanged if they cannot be reduced.
    """
    if is_number(encoding) and settings.limits:
        image, encoding = _color_numbers(
            image.reshape(image.shape[:2]), encoding, settings.limits, settings)
    kept = ('8UC3',) if settings.suffix == '.webp' else ('8UC1', '8UC3')
    meaning, kinds = _meaning(encoding), ('color', 'bayer') if settings.to_color else ('color',)
    if meaning.kind not in kinds or encoding.type_name in kept or is_number(encoding):
        return image, encoding
    target = find_encoding('bgr8')
    return convert_image(_native(image, encoding), meaning, target), target


def _color_numbers(
    numbers: NDArray[Any], encoding: Encoding, limits: tuple[float, float],
    settings: EncoderSettings,
) -> tuple[NDArray[Any], Encoding]:
    gray = to_display_image(numbers, encoding, 'mono8', limits)
    if not settings.has_colors:
        return gray, find_encoding('mono8')
    shown = apply_colormap(gray, f'COLORMAP_{settings.colors.upper()}')
    shown[np.isnan(numbers) | ((numbers == 0) & (limits[0] >= 0))] = 0
    return shown, find_encoding('bgr8')


def without_loss(encoding: Encoding, settings: EncoderSettings) -> str:
    """Return the end of the sentence about a frame that a format cannot hold."""
    if is_number(encoding):
        return '' if settings.limits else ', or allow a loss and give the range of the numbers'
    has_colors = _meaning(encoding).kind == 'color'
    return ', or allow a loss' if has_colors and not settings.lossy else ''


def _meaning(encoding: Encoding) -> Encoding:
    """Return the encoding of gray, BGR or BGRA that OpenCV reads a generic one as."""
    return opencv_encoding(np.empty((0, 0, encoding.channels), encoding.dtype)) if (
        encoding.is_generic) else encoding


def is_number(encoding: Encoding) -> bool:
    """Return whether a pixel is one number of more than 8 bits, as that of depth."""
    return encoding.channels == 1 and encoding.kind != 'bayer' and (
        np.dtype(encoding.dtype).itemsize > 1)


def file_order(encoding: Encoding) -> Encoding:
    """Return an encoding with OpenCV's channel order, which an image file has."""
    order = _FILE_ORDER.get(encoding.order)
    return find_encoding(encoding.name.replace(encoding.order, order)) if order else encoding


def _file_order(image: NDArray[Any], encoding: Encoding) -> NDArray[Any]:
    """Return an image with OpenCV's channel order and native byte order."""
    target = file_order(encoding)
    image = _native(image, encoding)
    return image if target == encoding else convert_image(image, encoding, target)


def _native(image: NDArray[Any], encoding: Encoding) -> NDArray[Any]:
    return np.ascontiguousarray(image, np.dtype(encoding.dtype))


@dataclass(frozen=True)
class ImageHeader:
    """
    Format and size of a compressed image.

    :param suffixes: file name extensions of the format; empty for an unknown format.
    :param width: width in pixels.
    :param height: height in pixels.
    """

    suffixes: tuple[str, ...]
    width: int = 0
    height: int = 0


def read_image_header(data: Any) -> ImageHeader:
    """
    Read the header of a compressed image and check that the image is complete.

    A PNG is checked by its checksums. A JPEG is checked by its markers, without decoding.

    :param data: buffer with the compressed image.
    :returns: format and size of a PNG or JPEG.
    :raises CodecError: the PNG or JPEG is damaged or incomplete.
    """
    content = bytes(data)
    if content.startswith(PNG_SIGNATURE):
        return ImageHeader(('.png',), *_check_png(content))
    if content.startswith(JPEG_SOI):
        check_complete(content)
        return ImageHeader(('.jpg', '.jpeg'), *jpeg_size(content))
    return ImageHeader(())


def _check_png(png: bytes) -> tuple[int, int]:
    """Check the chunks of a PNG and return its width and height."""
    if not png.endswith(_PNG_ENDS):
        raise CodecError(f'{len(png)} bytes of a PNG picture whose end is missing')
    view = memoryview(png)
    position, kinds = len(PNG_SIGNATURE), set()
    try:
        while position < len(png):
            length, kind = struct.unpack_from('>I4s', png, position)
            ends = position + _CHUNK_BYTES + length
            if struct.unpack_from('>I', png, ends - 4)[0] != zlib.crc32(
                    view[position + 4:ends - 4]):
                raise CodecError(f'{len(png)} bytes of a PNG picture that is damaged')
            kinds.add(kind)
            position = ends
        if not {b'IHDR', b'IDAT', b'IEND'} <= kinds or png[12:16] != b'IHDR':
            raise struct.error('chunks are missing')
        width, height = struct.unpack_from('>II', png, 16)
    except struct.error as err:
        raise CodecError(f'{len(png)} bytes of a PNG picture that is damaged') from err
    return width, height
