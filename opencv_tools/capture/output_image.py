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

"""The forms in which a captured frame is published: converted pixels and compressed."""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property, lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray
from opencv_tools.base.text import printable
from opencv_tools.capture.frame import CapturedFrame, JPEG, VIDEO
from opencv_tools.capture.settings import CaptureSettings
from opencv_tools.image import compressed_depth
from opencv_tools.image.cdr import WireCompressedImage
from opencv_tools.image.compressed import decoded_encoding
from opencv_tools.image.compressed_depth import (
    compressed_size, depth_encoding, is_compressed_depth, Quantisation, quantisation_loss)
from opencv_tools.image.encodings import Encoding, find_encoding
from opencv_tools.image.errors import JpegError, SizeError
from opencv_tools.image.jpeg import jpeg_components, JPEG_SOI
from opencv_tools.image.orientation import orient
from opencv_tools.image.picture_formats import jpeg_loss, reduction, why_not_compressed
from opencv_tools.image_codecs import (
    check_complete, convert_image, decode_compressed, decode_image,
    encode_compressed, encode_depth, turn_image)
from opencv_tools.video.packet import VideoPacket

# Output encodings for which a JPEG from the camera is published unchanged. A JPEG has no order of
# the colour channels, so it can be decoded to each of them.
_AS_JPEG = ('', 'bgr8', 'rgb8', 'bgra8', 'rgba8')
_MAX_CHANNELS = 4  # that OpenCV turns
_STARTS = {'jpeg': JPEG_SOI, 'png': b'\x89PNG'}
_DECODED = find_encoding('bgr8')  # colour JPEG

Lend = Callable[[int, int, Encoding], NDArray[Any] | None]


class OutputImage:
    """
    The forms of a frame that can be published, computed on first use and cached.

    All properties raise an ImageError if the frame cannot be decoded or converted.
    """

    def __init__(self, frame: CapturedFrame, settings: CaptureSettings) -> None:
        #: The captured frame.
        self.frame = frame
        #: How the frame is converted.
        self.settings = settings
        #: Lends an array of a height, a width and an encoding, to which the last conversion writes
        #: the pixels, or None. It may be set before the first use of ``image``.
        self.lend: Lend = _lend_nothing

    @property
    def image(self) -> NDArray[Any]:
        """Pixels after the conversion, (h, w) or (h, w, c) array."""
        return self._pixels[0]

    @property
    def encoding(self) -> str:
        """Name of the sensor_msgs/Image encoding of ``image``."""
        return self._pixels[1].name

    @property
    def size(self) -> tuple[int, int]:
        """Width and height of the image in pixels; a compressed image is not decoded."""
        if self.is_decoded:
            image, encoding = self._pixels
            return image.shape[1], encoding.height(image.shape[0])
        if self.frame.video:
            packet = self.frame.video.packet
            width, height = packet.width, packet.height
        else:
            content = self.frame.image.tobytes()
            width, height = compressed_size(content, self._format)
            if content.startswith(JPEG_SOI):
                check_complete(content)
        return (height, width) if self.settings.rotate % 180 else (width, height)

    @property
    def is_decoded(self) -> bool:
        """Whether the pixels are known: those of a raw frame, and those that were asked for."""
        return self.frame.encoding not in (JPEG, VIDEO) or '_pixels' in vars(self)

    @property
    def description(self) -> str:
        """Size and encoding of the image, or the number of bytes if its header has no size."""
        shown = self.encoding if self.is_decoded else printable(self._format)
        try:
            width, height = self.size
        except SizeError:  # a codec that is only passed on
            return f'{self.frame.image.size} bytes {shown}'
        return f'{width}x{height} {shown}'

    @cached_property
    def compressed(self) -> tuple[NDArray[Any], str]:
        """
        JPEG or PNG, (n,) uint8 array, and its format string as compressed_image_transport writes.

        The compressed image of a camera or bag is used unchanged when the settings allow it.
        """
        if _is_kept(self):
            if self.frame.recorded:
                return self.frame.image, self._format
            if self._is_gray_jpeg:
                return self.frame.image, 'mono8; jpeg compressed mono8'
            return self.frame.image, f'{self.settings.encoding or "bgr8"}; jpeg compressed bgr8'
        return encode_compressed(
            *self._pixels, self.settings.compressed_format, self.settings.jpeg_quality)

    @property
    def why_not_compressed(self) -> str:
        """Reason why the image has no compressed form; '' if it has one."""
        if _is_kept(self):
            return ''
        return why_not_compressed(self._pixels[1], *self.size, self.settings.compressed_format)

    @property
    def packet(self) -> VideoPacket | None:
        """Packet of a camera or stream, if the settings do not change its picture."""
        video = self.frame.video
        return video.packet if video and _keeps_pixels(self.settings, _DECODED.name) else None

    @property
    def _format(self) -> str:
        """Format string of a compressed image."""
        if self.frame.video:
            return self.frame.video.packet.codec
        message = self.frame.recorded and self.frame.recorded.message
        return message.format if isinstance(message, WireCompressedImage) else JPEG

    @cached_property
    def _is_gray_jpeg(self) -> bool:
        try:
            return jpeg_components(self.frame.image.tobytes()) == 1
        except JpegError:
            return False  # decoding raises the error

    @cached_property
    def _pixels(self) -> tuple[NDArray[Any], Encoding]:
        image = self.frame.image
        flip, degrees = self.settings.flip, self.settings.rotate
        is_turned = flip != 'none' or degrees
        if self.frame.encoding == JPEG and is_compressed_depth(self._format):
            image, encoding = decode_compressed(image, self._format)
        elif self.frame.encoding == JPEG:
            is_final = not is_turned and self.settings.encoding in ('', _DECODED.name)
            image = decode_image(image, lend=None if not is_final else (
                lambda height, width: self.lend(height, width, _DECODED)))
            encoding = decoded_encoding(image, self._format)
        elif self.frame.video:
            image, encoding = self.frame.video.decode(), _DECODED
        else:
            encoding = find_encoding(self.frame.encoding)
        target = find_encoding(self.settings.encoding) if self.settings.encoding else encoding
        if not target.has_layout_of(encoding):
            native = _native(image, encoding)
            image = convert_image(native, encoding, target, None if is_turned else self.lend(
                encoding.height(len(native)), native.shape[1], target))
        if not is_turned:
            return image, target
        turned, target = orient(image, target, flip, degrees)
        if target.channels > _MAX_CHANNELS or not image.size:
            return turned, target
        height, width = turned.shape[:2]
        out = self.lend(height, width, target)
        return turn_image(_native(image, target), flip, degrees, out), target


def compressed_loss(output: OutputImage) -> str:
    """Return what the compressed form of an image loses, see `jpeg_loss`."""
    return '' if _is_kept(output) else jpeg_loss(
        find_encoding(output.encoding), output.settings.compressed_format)


def why_no_depth(output: OutputImage) -> str:
    """Return why an image is none of depth; '' if it is one. It is not decoded."""
    return compressed_depth.why_no_depth(expected_encoding(output))


def expected_encoding(output: OutputImage) -> str:
    """Return the encoding of an image, not decoded; ``bgr8`` for a picture and video."""
    frame, settings = output.frame, output.settings
    if frame.encoding == JPEG and is_compressed_depth(output._format) and not settings.encoding:
        return depth_encoding(output._format)
    return settings.encoding or (
        _DECODED.name if frame.encoding in (JPEG, VIDEO) else frame.encoding)


def depth_loss(output: OutputImage) -> str:
    """Return what the form of `depth_form` loses, see `quantisation_loss`."""
    return '' if _is_kept(output, as_depth=True) else quantisation_loss(
        output.image, output.settings.depth_max)


def depth_form(output: OutputImage) -> tuple[bytes | NDArray[Any], str]:
    """
    Return an image of depth as compressed_depth_image_transport stores it, and its format string.

    :raises ImageError: the image cannot be decoded or converted.
    """
    if _is_kept(output, as_depth=True):
        return output.frame.image, output._format
    image, encoding = output._pixels
    return encode_depth(_native(image, encoding), encoding.name, output.settings.depth_format,
                        Quantisation.up_to(output.settings.depth_max))


@lru_cache  # called for each frame
def describe_reduction(captured: str, published: str) -> str:
    """
    Return a sentence such as ``mono16 images lose 8 bits in bgr8``; '' for images that lose none.

    :param captured: encoding of a captured frame, also ``JPEG`` or ``VIDEO``.
    :param published: value of the parameter ``encoding``.
    """
    if captured in (JPEG, VIDEO) or not published:
        return ''
    return reduction(find_encoding(captured), find_encoding(published))


def check_conversion(captured: str, published: str) -> None:
    """
    Check that frames can be converted.

    :param captured: encoding of a captured frame, also ``JPEG`` or ``VIDEO``.
    :param published: value of the parameter ``encoding``.
    :raises ConversionError: the conversion is not supported.
    """
    before = _DECODED if captured in (JPEG, VIDEO) else find_encoding(captured)
    image = np.zeros((before.rows(2), 2, before.channels)[:2 + (before.channels > 1)],
                     before.dtype)
    _ = OutputImage(CapturedFrame(image, before.name), CaptureSettings(encoding=published)).image


def _is_kept(output: OutputImage, *, as_depth: bool = False) -> bool:
    """
    Return whether the compressed image of a camera or bag is used unchanged.

    :param as_depth: whether in the form of compressed_depth_image_transport, or else as a picture.
    """
    frame, settings = output.frame, output.settings
    if frame.encoding != JPEG or is_compressed_depth(output._format) != as_depth:
        return False
    if as_depth:
        return _keeps_pixels(settings)
    codec = next((name for name, start in _STARTS.items()
                  if frame.image[:len(start)].tobytes() == start), '')
    if settings.compressed_format not in ('auto', codec):
        return False
    if not frame.recorded and codec != 'jpeg':  # a data set has pictures without their messages
        return False
    return _keeps_pixels(settings, *_AS_JPEG) or (
        _keeps_pixels(settings, 'mono8') and output._is_gray_jpeg)


def _keeps_pixels(settings: CaptureSettings, *encodings: str) -> bool:
    """Return whether images of some encodings are published as they are."""
    return (settings.flip == 'none' and not settings.rotate
            and settings.encoding in ('', *encodings))


def _lend_nothing(_height: int, _width: int, _encoding: Encoding) -> None:
    return None


def _native(image: NDArray[Any], encoding: Encoding) -> NDArray[Any]:
    """Return an image in native byte order; a copy only of one in the other byte order."""
    return np.asarray(image, np.dtype(encoding.dtype))
