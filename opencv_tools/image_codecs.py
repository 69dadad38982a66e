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

"""Encoding and decoding of image files (JPEG, PNG and others) with OpenCV."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray
from opencv_tools.base.text import printable
from opencv_tools.image.color import convert
from opencv_tools.image.compressed import decoded_encoding
from opencv_tools.image.compressed_depth import (
    depth_encoding, is_compressed_depth, Quantisation, read_depth, write_depth)
from opencv_tools.image.encodings import Encoding, find_encoding, generic_encoding
from opencv_tools.image.errors import CodecError, JpegError
from opencv_tools.image.image_size import check_size, image_size, MAX_PIXELS
from opencv_tools.image.jpeg import (
    check_jpeg, jpeg_components, JPEG_EOI, jpeg_size, JPEG_SOI, JPEG_SOS, with_extra_data)
from opencv_tools.image.picture_formats import (
    CODEC_TYPES, compressed_form, why_not_stored)
from opencv_tools.opencv import cv2

# Names of constants of OpenCV, which is not imported until it is used.
_QUALITY = {'.jpg': 'IMWRITE_JPEG_QUALITY', '.jpeg': 'IMWRITE_JPEG_QUALITY',
            '.jpe': 'IMWRITE_JPEG_QUALITY', '.webp': 'IMWRITE_WEBP_QUALITY'}

# Names of the encodings in OpenCV's names of conversions, such as COLOR_BGR2RGB.
_COLORS = {'bgr8': 'BGR', 'rgb8': 'RGB', 'bgra8': 'BGRA', 'rgba8': 'RGBA', 'mono8': 'GRAY'}

_FLIPS = {'horizontal': 1, 'vertical': 0, 'both': -1}
_ROTATIONS = {90: 'ROTATE_90_CLOCKWISE', 180: 'ROTATE_180', 270: 'ROTATE_90_COUNTERCLOCKWISE'}

_BGR_CHANNELS = 3
_MAX_DEPTH_PIXELS = 2**25
_MAX_NAME = 80  # characters of an unknown format in an error message
_FILL_GRAY = 128  # of libjpeg, in all channels


def encode_image(
    image: NDArray[Any], suffix: str, quality: int | None = None, compression: int = 1,
) -> NDArray[np.uint8]:
    """
    Encode an image as the content of an image file.

    :param image: (h, w) gray, (h, w, 3) BGR or (h, w, 4) BGRA array in native byte order.
    :param suffix: extension of the format, one of ``CODEC_TYPES``.
    :param quality: quality of JPEG and WebP, 1 to 100; None for OpenCV's default (95 for JPEG).
    :param compression: compression level of PNG, 0 (none) to 9; 1 is the fastest that compresses.
    :returns: content of the file, (n,) uint8.
    :raises CodecError: the format is unknown, or cannot store the image without a conversion.
    """
    stored = generic_encoding(image)
    described = f'a {image.shape[1]}x{image.shape[0]} {stored.name} image'
    if suffix not in CODEC_TYPES:
        raise CodecError(
            f"unknown picture format '{printable(suffix[1:], _MAX_NAME)}'; give one of "
            f'{", ".join(known[1:] for known in CODEC_TYPES)}')
    if reason := why_not_stored(stored, image.shape, suffix):
        able = [known[1:] for known, types in CODEC_TYPES.items() if stored.name in types]
        remedy = f'; use {" or ".join(able)}' if able else '; no picture format can store it'
        raise CodecError(f'{described} {reason}{"" if suffix[1:] in able else remedy}')
    options: tuple[int, ...] = ()
    if suffix == '.png':
        options = _png_options(compression)
    elif suffix in ('.tif', '.tiff'):
        # The default of OpenCV 4 for 32FC3 is LogLuv, which is lossy. 5 is LZW, without loss.
        options = cv2.IMWRITE_TIFF_COMPRESSION, 5
    if quality is not None:
        if suffix not in _QUALITY or not 1 <= quality <= 100:
            raise CodecError(f'quality {quality} is invalid for {suffix[1:]}; only jpg and webp '
                             'have a quality, from 1 to 100')
        options = getattr(cv2, _QUALITY[suffix]), quality
    try:
        encoded, content = cv2.imencode(suffix, image, options)
    except cv2.error as err:
        raise CodecError(f'{described} cannot be stored as {suffix[1:]}: {err.err}') from err
    if not encoded:
        raise CodecError(f'OpenCV cannot encode {described} as {suffix[1:]}')
    return content.reshape(-1)


def _png_options(compression: int) -> tuple[int, ...]:
    if compression != 1:
        return cv2.IMWRITE_PNG_COMPRESSION, compression
    if not hasattr(cv2, 'IMWRITE_PNG_FILTER'):
        return ()  # OpenCV 4 is fastest without a compression level
    # OpenCV 5 also has filters; with UP it is faster and writes smaller files.
    return (cv2.IMWRITE_PNG_COMPRESSION, 1, cv2.IMWRITE_PNG_STRATEGY,
            cv2.IMWRITE_PNG_STRATEGY_RLE, cv2.IMWRITE_PNG_FILTER, cv2.IMWRITE_PNG_FILTER_UP)


def encode_compressed(
    image: NDArray[Any], encoding: Encoding, wanted: str, quality: int,
) -> tuple[NDArray[np.uint8], str]:
    """
    Encode an image for a topic of compressed images.

    :param image: (h, w) or (h, w, c) array of any strides and byte order.
    :param wanted: see ``opencv_tools.image.picture_formats.compressed_form``.
    :param quality: quality of JPEG, 1 to 100.
    :returns: content, (n,) uint8, and format string as compressed_image_transport writes it.
    :raises CodecError: the codec cannot store the image.
    :raises ConversionError: the image cannot be converted.
    """
    codec, stored = compressed_form(encoding, wanted)
    native = np.ascontiguousarray(image, np.dtype(encoding.dtype))
    if stored != encoding:
        native = convert_image(native, encoding, stored)
    # The format string has the encoding of the image only if it can be converted back to it.
    kept = encoding.kind == stored.kind and encoding.dtype == stored.dtype
    return encode_image(native, f'.{codec}', quality if codec == 'jpeg' else None), (
        f'{(encoding if kept else stored).name}; {codec} compressed {stored.name}')


def decode_image(
    data: Any, upright: bool = False, max_pixels: int = MAX_PIXELS,
    lend: Callable[[int, int], NDArray[Any] | None] | None = None,
) -> NDArray[Any]:
    """
    Decode the content of an image file, with its own depth and channels.

    :param data: buffer with the content of the file.
    :param upright: whether to rotate a JPEG by its Exif orientation.
    :param max_pixels: largest allowed number of pixels; the header is checked before decoding.
    :param lend: lends a (height, width, 3) uint8 array or None, if simplejpeg is installed. A
        colour JPEG is decoded into this array.
    :returns: a new or lent array: (h, w) gray, (h, w, 3) BGR or (h, w, 4) BGRA.
    :raises CodecError: the content is not an image file, is incomplete, or has too many pixels.
    """
    content = bytes(data)
    described = f'{len(content)} bytes'
    width, height = image_size(content)
    check_size(width, height, max_pixels)
    is_jpeg = content.startswith(JPEG_SOI)
    scan_end = check_complete(content) if is_jpeg else 0
    # With IMREAD_UNCHANGED OpenCV ignores the Exif orientation. The other flags can change the
    # channels, but not those of a JPEG.
    flags = (cv2.IMREAD_ANYCOLOR | cv2.IMREAD_ANYDEPTH if is_jpeg and upright
             else cv2.IMREAD_UNCHANGED)
    out = (lend(height, width) if lend and is_jpeg and _simplejpeg()
           and jpeg_components(content) == _BGR_CHANNELS else None)
    try:
        image = _decode(content, flags, out)
        extended = (_decode(with_extra_data(content, scan_end), flags)
                    if is_jpeg and image is not None and _has_fill_gray(image) else image)
    except cv2.error as err:
        raise CodecError(f'{described} cannot be decoded as a picture: {err.err}') from err
    if image is None:
        raise CodecError(f'{described} are not a picture that OpenCV can read')
    if extended is not image and (extended is None or not np.array_equal(image, extended)):
        raise CodecError(f'{described} of a JPEG picture whose end is missing')
    return image


def decode_compressed(
    data: Any, format_text: str, max_pixels: int = MAX_PIXELS,
) -> tuple[NDArray[Any], Encoding]:
    """
    Decode a compressed image, also one of depth.

    :param max_pixels: as for ``decode_image``.
    :returns: a new array as of ``decode_image``, and its encoding. Floats that were quantised are
        float32 in metres, with NaN for no depth.
    :raises CodecError: the content is not an image, is incomplete, or has too many pixels.
    """
    if not is_compressed_depth(format_text):
        image = decode_image(data, max_pixels=max_pixels)
        return image, decoded_encoding(image, format_text)
    image, quantisation = decode_depth(bytes(data), format_text, max_pixels)
    return (quantisation.depth_of(image) if quantisation else image,
            find_encoding(depth_encoding(format_text)))


def decode_depth(
    content: bytes, format_text: str, max_pixels: int = _MAX_DEPTH_PIXELS,
) -> tuple[NDArray[np.uint16], Quantisation | None]:
    """Decode an image of depth, see ``opencv_tools.image.compressed_depth.read_depth``."""
    return read_depth(content, format_text, min(max_pixels, _MAX_DEPTH_PIXELS), decode_image)


def encode_depth(
    image: NDArray[Any], encoding: str, codec: str, quantisation: Quantisation | None = None,
) -> tuple[bytes, str]:
    """Encode an image of depth, see ``opencv_tools.image.compressed_depth.write_depth``."""
    return write_depth(image, encoding, codec, lambda stored: encode_image(
        stored, '.png').tobytes(), quantisation)


def check_complete(jpeg: bytes) -> int:
    """
    Check that a JPEG is complete, as far as that is possible without decoding.

    :returns: offset after the data of the last scan.
    :raises CodecError: the JPEG is incomplete or damaged.
    """
    end = jpeg.rfind(JPEG_EOI)  # the last one, because a thumbnail has its own end marker
    if end < 0 or jpeg.find(JPEG_SOS, end) >= 0:
        raise CodecError(f'{len(jpeg)} bytes of a JPEG picture whose end is missing')
    try:
        jpeg_size(jpeg)
        return check_jpeg(jpeg)
    except JpegError as err:
        raise CodecError(f'{len(jpeg)} bytes of {err}') from err


def _decode(
    content: bytes, flags: int, out: NDArray[Any] | None = None,
) -> NDArray[Any] | None:
    """Decode an image, a colour JPEG into an array of its size if there is one."""
    if out is not None:
        with suppress(ValueError):  # a warning of libjpeg, which OpenCV does not refuse
            _simplejpeg().decode_jpeg(content, 'BGR', buffer=out)
            return out
    image = cv2.imdecode(np.frombuffer(content, np.uint8), flags)
    if out is None or image is None:
        return image
    np.copyto(out, image)
    return out


@lru_cache
def _simplejpeg() -> Any:
    """Return the module, which is optional; None if it cannot be imported."""
    try:
        import simplejpeg
    except ImportError:
        return None
    return simplejpeg


def _has_fill_gray(image: NDArray[Any]) -> bool:
    """Return whether a corner pixel has the gray that libjpeg writes for missing pixels."""
    return any((image[row, column] == _FILL_GRAY).all() for row in (0, -1) for column in (0, -1))


def convert_image(
    image: NDArray[Any], source: Encoding, target: Encoding, out: NDArray[Any] | None = None,
) -> NDArray[Any]:
    """
    Convert an image between encodings, with OpenCV where OpenCV is faster.

    :param image: array as for ``opencv_tools.image.color.convert``, in native byte order.
    :param out: array with the shape and type of the result, to write it to; None for a new one.
    :returns: ``out`` or a new array, equal to that of ``opencv_tools.image.color.convert``.
    :raises ConversionError: the conversion is not supported.
    """
    code = _conversion_code(source, target)
    # OpenCV returns arbitrary pixels for YUV with an odd width.
    has_odd_width = source.kind == 'yuv' and image.shape[1] % 2
    if code is None or has_odd_width or not image.size:
        converted = convert(image, source, target)
        if out is None:
            return converted
        np.copyto(out, converted)
        return out
    return cv2.cvtColor(np.ascontiguousarray(image), code, dst=out)


def turn_image(
    image: NDArray[Any], flip: str, degrees: int, out: NDArray[Any] | None = None,
) -> NDArray[Any]:
    """
    Mirror an image, then rotate it.

    :param image: (h, w) or (h, w, c) array in native byte order with at most four channels.
    :param flip: one of ``opencv_tools.image.orientation.FLIPS``.
    :param degrees: clockwise rotation in degrees: 0, 90, 180 or 270.
    :param out: array with the shape and type of the result, to write it to; None for a new one.
    :returns: ``out`` or a new array, equal to that of ``opencv_tools.image.orientation.orient``.
    """
    if degrees == 0:
        return cv2.flip(image, _FLIPS[flip], dst=out)
    if flip != 'none':
        image = cv2.flip(image, _FLIPS[flip])
    return cv2.rotate(image, getattr(cv2, _ROTATIONS[degrees]), dst=out)


@lru_cache  # called for each frame
def _conversion_code(source: Encoding, target: Encoding) -> int | None:
    """Return OpenCV's code of a conversion from 8 bits to 8 bits; None if it has none."""
    into = _COLORS.get(target.name)
    if into is None or source.dtype != 'uint8' or source == target:
        return None
    name = {'yuv': f'YUV2{into}_{source.order.upper()}',
            'bayer': f'Bayer{source.order.upper()}2{into}',
            'color': f'{_COLORS.get(source.name)}2{into}'}.get(source.kind)
    return getattr(cv2, f'COLOR_{name}', None)


def apply_colormap(gray: NDArray[Any], colormap: int | str) -> NDArray[Any]:
    """
    Convert a gray image to colours with a colormap of OpenCV.

    :param gray: (h, w) uint8 array.
    :param colormap: number of the colormap, such as ``cv2.COLORMAP_JET``, or its name.
    :returns: (h, w, 3) uint8 array in BGR.
    :raises CodecError: the colormap is unknown.
    """
    try:
        number = getattr(cv2, colormap) if isinstance(colormap, str) else colormap
        return cv2.applyColorMap(gray, number)
    except cv2.error as err:
        raise CodecError(f'unknown colormap {colormap}; give one of cv2.COLORMAP_*') from err
