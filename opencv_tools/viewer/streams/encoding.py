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

"""Pictures of any size for a browser from image messages."""

from __future__ import annotations

from dataclasses import dataclass, KW_ONLY, replace
from math import ceil, sqrt
from typing import Any

import numpy as np
from numpy.typing import NDArray
from opencv_tools.base.text import printable
from opencv_tools.cv_bridge import CvBridgeError, cvtColorForDisplay
from opencv_tools.image.cdr import WireCompressedImage, WireMessage
from opencv_tools.image.compressed import parse_format
from opencv_tools.image.compressed_depth import COMPRESSED_DEPTH, is_compressed_depth
from opencv_tools.image.encodings import find_encoding
from opencv_tools.image.errors import CodecError, ImageError
from opencv_tools.image.image_size import check_size, MAX_PIXELS
from opencv_tools.image.jpeg import jpeg_size, JPEG_SOI
from opencv_tools.image.orientation import (
    is_sideways, jpeg_orientation, reversed_axes, turn_upright)
from opencv_tools.image.picture_formats import MAX_SIDES
from opencv_tools.image_codecs import check_complete, convert_image
from opencv_tools.opencv import cv2
from opencv_tools.viewer.errors import MAX_MESSAGE
from opencv_tools.viewer.region import Region, region_within
from opencv_tools.viewer.streams.depth_colors import (
    color_numbers, is_number, measure_image, NO_LIMITS, Steady, UNITS)
from opencv_tools.viewer.streams.pixels import Pixels, read_pixels

# Factor above which a mean of all pixels is needed against false patterns.
_AREA_FACTOR = 2
# Pixels of a picture of depths or labels at most, a few more than 3840 x 2160.
_MAX_PICKED = 2**23


@dataclass(frozen=True, kw_only=True)
class Reduction:
    """
    How a JPEG was decoded at a reduced size.

    :param factor: pixels of the image for one that was decoded, along each axis. The last ones
        are for fewer pixels if the size is no multiple.
    :param is_reversed: whether the columns and the rows have been reversed since.
    """

    factor: int
    size: tuple[int, int]
    is_reversed: tuple[bool, bool]


def scale(image: NDArray[Any], width: int) -> NDArray[Any]:
    """Return an image of bytes with another width."""
    rows, columns = image.shape[:2]
    if width == columns:
        return image
    size = width, max(1, round(rows * width / columns))
    method = cv2.INTER_AREA if columns > _AREA_FACTOR * width else cv2.INTER_LINEAR
    return cv2.resize(np.ascontiguousarray(image), size, interpolation=method)


def pick(image: NDArray[Any], width: int) -> NDArray[Any]:
    """
    Return every n-th pixel, because a mean of depths or labels has no meaning.

    :param width: largest width; a large image has an even smaller one, for its memory.
    """
    rows, columns = image.shape[:2]
    step = max(-(-columns // width), ceil(sqrt(rows * columns / _MAX_PICKED)))
    return image[::step, ::step]


def scale_reduced(
    decoded: NDArray[Any], region: Region, width: int, reduction: Reduction,
) -> NDArray[Any]:
    """
    Return a part of an image that was decoded at a reduced size, with another width.

    :param decoded: (h, w, 3) uint8 array.
    :param region: part of the image in its own pixels.
    :param width: width of the result, at most that of the decoded part.
    """
    factor, sides = reduction.factor, (region.width, region.height)
    counts = decoded.shape[1::-1]
    # Pixel of the image at which the decoded ones begin; before the first one if reversed.
    begins = [size - count * factor if is_reversed else 0 for size, count, is_reversed in zip(
        reduction.size, counts, reduction.is_reversed, strict=True)]
    edges = [(low - begin, low + side - begin) for low, side, begin in zip(
        (region.x, region.y), sides, begins, strict=True)]
    (left, right), (top, bottom) = (
        (low // factor, -(-high // factor)) for low, high in edges)
    part = decoded[top:bottom, left:right]
    if not any(edge % factor for axis in edges for edge in axis):
        return scale(part, width)
    size = width, max(1, round(region.height * width / region.width))
    steps = [max(1, int(side / factor / length))
             for side, length in zip(sides, size, strict=True)]
    part = _mean(part, *steps)
    matrix = np.zeros((2, 3))
    for axis, (edge, side, length, step) in enumerate(zip(
            edges, sides, size, steps, strict=True)):
        ratio = side / length / factor / step
        matrix[axis, axis] = ratio
        matrix[axis, 2] = (edge[0] % factor) / factor / step + ratio / 2 - 0.5
    return cv2.warpAffine(part, matrix, size, flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP,
                          borderMode=cv2.BORDER_REPLICATE)


def _mean(image: NDArray[Any], across: int, down: int) -> NDArray[Any]:
    """Return the mean of blocks of pixels; edges are repeated for the last blocks."""
    rows, columns = image.shape[:2]
    if across == down == 1:
        return np.ascontiguousarray(image)
    filled = cv2.copyMakeBorder(
        np.ascontiguousarray(image), 0, -rows % down, 0, -columns % across, cv2.BORDER_REPLICATE)
    return cv2.resize(filled, (filled.shape[1] // across, filled.shape[0] // down),
                      interpolation=cv2.INTER_AREA)


_BGR = find_encoding('bgr8')
# Number of pixels up to which a picture keeps the colour of each pixel, because pages enlarge it.
_SMALL = 200_000
_SAMPLING_444 = 0x111111  # IMWRITE_JPEG_SAMPLING_FACTOR_444, which old versions of OpenCV lack
_SAMPLING_FACTOR = 7  # IMWRITE_JPEG_SAMPLING_FACTOR, which they leave out
# OpenCV decodes a JPEG at a half, a quarter or an eighth of its size in less time.
_REDUCED = {1: 'IMREAD_COLOR', 2: 'IMREAD_REDUCED_COLOR_2', 4: 'IMREAD_REDUCED_COLOR_4',
            8: 'IMREAD_REDUCED_COLOR_8'}


@dataclass(frozen=True)
class PictureOptions:
    """
    Size and quality of a picture.

    :param width: largest width in pixels; 0 for the full size.
    :param quality: JPEG quality, 1 to 100.
    :param limits: numbers that become black and white; None for those of the image.
    :param height: largest height in pixels; 0 for no limit.
    :param keep: whether a JPEG that need not be scaled is kept byte for byte.
    :param region: the only part of the image that is shown; None for the whole image.
    :param colors: colours of depth, ``gray`` or ``turbo``.
    """

    width: int
    quality: int
    _: KW_ONLY
    limits: tuple[float, float] | None = None
    height: int = 0
    keep: bool = True
    region: Region | None = None
    colors: str = 'gray'

    def width_for(self, width: int, height: int) -> int:
        """Return the width of the picture of an image with some size."""
        limits = [self.width or width, width]
        if self.height and height:
            limits.append(max(1, width * self.height // height))
        return min(limits)


@dataclass(frozen=True, kw_only=True)
class Picture:
    """
    A JPEG for a browser.

    :param width: width in pixels.
    :param height: height in pixels.
    :param source_size: width and height of the image in pixels.
    :param encoding: encoding or format of the image.
    :param limits: numbers that became black and white; None for ordinary colours.
    :param measured: limits of most numbers of the image; None if nobody needs them.
    :param unit: unit of the numbers of depth; '' for other images.
    :param region: part of the image that is shown.
    :param is_kept: whether the data are those of the message.
    """

    data: bytes
    width: int
    height: int
    source_size: tuple[int, int]
    encoding: str
    region: Region
    limits: tuple[float, float] | None = None
    measured: tuple[float, float] | None = None
    unit: str = ''
    is_kept: bool = False


def encode_picture(
    message: WireMessage, options: PictureOptions, steady: Steady = NO_LIMITS,
) -> Picture:
    """
    Convert an image message to a JPEG.

    :param message: raw or compressed image.
    :param steady: limits that the image changes, if the options have none.
    :returns: the picture, which is never larger than the image.
    :raises ImageError: the message is not a valid image.
    :raises CvBridgeError: the message is not a valid image, or its encoding cannot be shown.
    """
    if isinstance(message, WireCompressedImage):
        return _encode_compressed(message, options, steady)
    return _encode_pixels(read_pixels(message), options, steady)


def picture_or_reason(
    message: WireMessage, options: PictureOptions, steady: Steady,
) -> Picture | str:
    """Return the picture of a message, or the reason why it has none."""
    try:
        return encode_picture(message, options, steady)
    except (CvBridgeError, ImageError) as err:
        return printable(err, MAX_MESSAGE)


def _encode_compressed(
    message: WireCompressedImage, options: PictureOptions, steady: Steady,
) -> Picture:
    content = bytes(message.data)
    described = parse_format(message.format).codec[:20]
    if not content.startswith(JPEG_SOI):
        picture = _encode_pixels(read_pixels(message), options, steady)
        return replace(picture, encoding=f'{picture.encoding} {COMPRESSED_DEPTH}' if (
            is_compressed_depth(message.format)) else described)
    orientation = jpeg_orientation(content)
    width, height = jpeg_size(content)
    check_size(width, height, MAX_PIXELS)
    check_complete(content)
    if is_sideways(orientation):
        width, height = height, width
    region = region_within(options.region, width, height)
    wanted = options.width_for(region.width, region.height)
    if options.keep and options.region is None and wanted == width:
        return Picture(data=content, width=width, height=height, source_size=(width, height),
                       encoding=described, region=region, is_kept=True)
    most = region.width // wanted
    factor = max(step for step in _REDUCED if step <= max(1, most))
    try:
        decoded = cv2.imdecode(
            np.frombuffer(content, np.uint8),
            getattr(cv2, _REDUCED[factor]) | cv2.IMREAD_IGNORE_ORIENTATION)
    except cv2.error as err:
        raise CodecError(f'{len(content)} bytes cannot be decoded as JPEG: {err.err}') from err
    if decoded is None:
        raise CodecError(f'{len(content)} bytes are not a JPEG that OpenCV can read')
    shown = scale_reduced(turn_upright(decoded, orientation), region, wanted, Reduction(
        factor=factor, size=(width, height), is_reversed=reversed_axes(orientation)))
    return Picture(data=_encode_jpeg(shown, options.quality),
                   width=shown.shape[1], height=shown.shape[0], source_size=(width, height),
                   encoding=described, region=region)


def _encode_pixels(
    pixels: Pixels, options: PictureOptions, steady: Steady,
) -> Picture:
    """Crop, scale, convert and encode an array."""
    image, encoding = pixels.image, pixels.encoding
    if not image.size:
        raise CodecError('the image is empty ({}x{})'.format(*pixels.size))
    limits, measured = None, None
    region = region_within(options.region, *pixels.size)
    if encoding.row_factor != 1:  # the chroma rows follow
        image, encoding = convert_image(image, encoding, _BGR), _BGR
    image = region.crop(image)
    if encoding.kind in ('bayer', 'yuv'):
        target = _BGR if np.dtype(encoding.dtype).itemsize == 1 else find_encoding('bgr16')
        image, encoding = convert_image(image, encoding, target), target
    width = options.width_for(image.shape[1], image.shape[0])
    if is_number(encoding):
        measured = measure_image(pixels)
        limits = options.limits or steady.after(measured)
        shown = color_numbers(
            pixels.numbers(pick(image, width)), encoding, limits, options.colors)
    else:
        is_small = np.dtype(encoding.dtype) == np.uint8
        name = 'mono8' if encoding.channels == 1 and is_small else 'bgr8'
        shown = cvtColorForDisplay(scale(image, width) if is_small else pick(image, width),
                                   encoding.name, name)
    return Picture(data=_encode_jpeg(shown, options.quality),
                   width=shown.shape[1], height=shown.shape[0], source_size=pixels.size,
                   encoding=pixels.encoding.name, region=region, limits=limits,
                   measured=measured, unit=UNITS.get(encoding.name, ''))


def _encode_jpeg(image: NDArray[Any], quality: int) -> bytes:
    """Return a JPEG; a small one keeps the colour of each pixel."""
    if max(image.shape[:2]) > MAX_SIDES['.jpg']:
        raise CodecError(f'a {image.shape[1]}x{image.shape[0]} picture is too long for JPEG: '
                         f'the limit is {MAX_SIDES[".jpg"]} pixels a side')
    flags = [cv2.IMWRITE_JPEG_QUALITY, quality]
    if image.shape[0] * image.shape[1] <= _SMALL:
        flags += [_SAMPLING_FACTOR, _SAMPLING_444]
    is_encoded, content = cv2.imencode('.jpg', image, flags)
    if not is_encoded:
        raise CodecError(f'a {image.shape[1]}x{image.shape[0]} picture cannot be encoded as JPEG')
    return content.tobytes()
