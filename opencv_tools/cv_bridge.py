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


"""
A pure-numpy cv_bridge: image messages to arrays and back.

It has the names, defaults and error texts of ROS 2 Jazzy's ``cv_bridge``, without its compiled
part, so it works with every numpy. Only compressed images and colormaps need OpenCV.
"""

from __future__ import annotations

from functools import partial
import sys
from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import NDArray
from opencv_tools.image.cdr import image_to_cdr, WireImage
from opencv_tools.image.color import convert_to
from opencv_tools.image.compressed import parse_format
from opencv_tools.image.display import Colormap, finite_limits, show
from opencv_tools.image.encodings import (
    DEPTHS, Encoding, find_encoding, generic_encoding, picture_encoding,
)
from opencv_tools.image.errors import EncodingError, ImageError
from opencv_tools.image.layout import is_bigendian, pack_pixels, view_pixels
from sensor_msgs.msg import CompressedImage, Image
from std_msgs.msg import Header

__all__ = ['CvBridge', 'CvBridgeError', 'cvtColorForDisplay', 'getCvType']


class CvBridgeError(TypeError):
    """An image that cannot be converted; the message says why."""


class CvBridge:
    """
    Convert between image messages and numpy arrays as OpenCV uses them.

    >>> bridge = CvBridge()
    >>> message = bridge.cv2_to_imgmsg(np.zeros((480, 640, 3), np.uint8), 'bgr8')
    >>> bridge.imgmsg_to_cv2(message, 'mono8').shape
    (480, 640)
    """

    def __init__(self) -> None:
        """Set up the tables that cv_bridge offers."""
        self.cvdepth_to_numpy_depth = dict(enumerate(DEPTHS.values()))
        self.numpy_type_to_cvtype = {
            **{dtype: depth for depth, dtype in DEPTHS.items()}, **DEPTHS}

    @property
    def cvtype_to_name(self) -> dict[int, str]:
        """Give the names of OpenCV's types of up to four channels, by the types' numbers."""
        names = [f'{depth}C{channels}' for depth in DEPTHS for channels in range(1, 5)]
        return {getCvType(name): name for name in names}

    def dtype_with_channels_to_cvtype2(self, dtype: np.dtype[Any], n_channels: int) -> str:
        """
        Name the OpenCV type of a numpy type with a number of channels.

        :param dtype: such as ``np.dtype('uint8')``.
        :param n_channels: channels of a pixel.
        :returns: such as ``'8UC3'``.
        :raises CvBridgeError: OpenCV has no such type.
        """
        try:
            return generic_encoding(np.empty((0, 0, n_channels), dtype)).name
        except ImageError as err:
            raise CvBridgeError(str(err)) from err

    def cvtype2_to_dtype_with_channels(self, cvtype: int) -> tuple[str, int]:
        """
        Give the numpy type and the number of channels of an OpenCV type.

        :param cvtype: number of the type, as ``cv2.CV_8UC3`` is.
        :returns: such as ``('uint8', 3)``.
        :raises CvBridgeError: there is no such type.
        """
        more_channels, depth = divmod(cvtype, _channel_step())
        if depth not in self.cvdepth_to_numpy_depth or more_channels < 0:
            raise CvBridgeError(f'{cvtype} is not the number of a type of OpenCV')
        return self.cvdepth_to_numpy_depth[depth], more_channels + 1

    def encoding_to_cvtype2(self, encoding: str) -> int:
        """
        Give the number of the OpenCV type of an encoding, as ``getCvType`` does.

        :raises CvBridgeError: the encoding is not known.
        """
        return getCvType(encoding)

    def encoding_to_dtype_with_channels(self, encoding: str) -> tuple[str, int]:
        """
        Give the numpy type and the number of channels of an encoding.

        :param encoding: such as ``'bgr8'`` or ``'32FC1'``.
        :returns: such as ``('uint8', 3)``.
        :raises CvBridgeError: the encoding is not known.
        """
        try:
            found = find_encoding(encoding)
        except ImageError as err:
            raise CvBridgeError(str(err)) from err
        return found.dtype, found.channels

    def imgmsg_to_cv2(
        self, img_msg: Image, desired_encoding: str = 'passthrough',
    ) -> NDArray[Any]:
        """
        Convert an image message to an array.

        :param img_msg: the message, or anything with its fields; its ``step`` and
            ``is_bigendian`` are honoured.
        :param desired_encoding: what the array should hold; ``'passthrough'`` for what the
            message holds, without a copy; ``''`` for the same with a copy.
        :returns: (h, w) for one channel, (h, w, c) otherwise, in native byte order; ``nv12``,
            ``nv21`` and ``nv24`` as OpenCV wants them, the rows of chroma below those of luma.
            With passthrough a view of the message's data that keeps the data alive, writable
            where they are; a copy only where the bytes had to be swapped. Otherwise a fresh,
            writable, contiguous array.
        :raises CvBridgeError: an unknown encoding, a conversion that makes no sense, or a size,
            step and data that contradict each other.
        """
        try:
            source = find_encoding(img_msg.encoding)
            view = view_pixels(
                img_msg.data, img_msg.height, img_msg.width, img_msg.step, source,
                bool(img_msg.is_bigendian))
            if desired_encoding == 'passthrough':
                return view.astype(source.dtype, copy=False)
            return convert_to(view, source, desired_encoding)
        except ImageError as err:
            raise CvBridgeError(str(err)) from err

    def cv2_to_imgmsg(
        self, cvim: NDArray[Any], encoding: str = 'passthrough',
        header: Header | None = None,
    ) -> Image:
        """
        Convert an array to an image message, copying its data once.

        :param cvim: array of shape (h, w) or (h, w, c); any strides, any byte order. Where chroma
            has rows of its own (``nv12``), they stand below those of the luma.
        :param encoding: what the array holds; ``'passthrough'`` names its type (``8UC3``).
        :param header: stamp and frame of the message, kept as it is.
        :returns: the message, with tight rows.
        :raises TypeError: ``cvim`` is not an array.
        :raises CvBridgeError: the encoding is not known or does not fit the array.
        """
        declared = _declared(cvim, encoding)
        rows, width = cvim.shape[:2]
        message = Image(
            height=declared.height(rows), width=width, encoding=declared.name,
            step=width * declared.pixel_bytes, is_bigendian=is_bigendian(cvim.dtype))
        if header is not None:
            message.header = header
        message.data.frombytes(pack_pixels(cvim))  # an assignment would copy once more
        return message

    def cv2_to_cdr(
        self, cvim: NDArray[Any], encoding: str = 'passthrough', header: Header | None = None,
    ) -> bytes:
        """
        Serialise an array as an image message, copying its data once; upstream has no such method.

        :param cvim: as for ``cv2_to_imgmsg``.
        :param encoding: what the array holds; ``'passthrough'`` names its type (``8UC3``).
        :param header: stamp and frame of the message.
        :returns: what a publisher of images takes in place of the message.
        :raises TypeError: ``cvim`` is not an array.
        :raises CvBridgeError: the encoding is not known or does not fit the array.
        """
        declared = _declared(cvim, encoding)
        rows, width = cvim.shape[:2]
        header = header or Header()
        try:
            return image_to_cdr(WireImage(
                header.stamp.sec, header.stamp.nanosec, header.frame_id, declared.height(rows),
                width, declared.name, is_bigendian(cvim.dtype), width * declared.pixel_bytes,
                pack_pixels(cvim)))
        except ImageError as err:
            raise CvBridgeError(str(err)) from err

    def compressed_imgmsg_to_cv2(
        self, cmprs_img_msg: CompressedImage, desired_encoding: str = 'passthrough',
    ) -> NDArray[Any]:
        """
        Decode a compressed image message.

        :param cmprs_img_msg: the message. What its ``format`` says of the picture's encoding, as
            compressed_image_transport writes it (``'16UC1; png compressed '``), is heeded where
            it fits the picture; otherwise the picture is gray, BGR or BGRA.
        :param desired_encoding: what the array should hold; ``'passthrough'`` for the picture as
            OpenCV decodes it.
        :returns: a fresh array, (h, w) for one channel, (h, w, c) otherwise.
        :raises CvBridgeError: the data are no picture, or the conversion makes no sense.
        """
        try:
            picture: NDArray[Any] = _pictures().decode_picture(cmprs_img_msg.data)
            if desired_encoding == 'passthrough':
                return picture
            source = _stored_encoding(picture, cmprs_img_msg.format)
            return convert_to(picture, source, desired_encoding)
        except ImageError as err:
            raise CvBridgeError(str(err)) from err

    def cv2_to_compressed_imgmsg(
        self, cvim: NDArray[Any], dst_format: str = 'jpg', *, quality: int | None = None,
        header: Header | None = None,
    ) -> CompressedImage:
        """
        Compress an array into a message.

        :param cvim: (h, w) gray, (h, w, 3) BGR or (h, w, 4) BGRA array.
        :param dst_format: the codec, such as ``'jpg'`` or ``'png'``, or what
            compressed_image_transport writes, such as ``'rgb8; jpeg compressed bgr8'``, where the
            array is RGB and the picture is to be BGR. It becomes the message's ``format``.
        :param quality: of JPEG and WebP, 1 to 100; None for OpenCV's own, 95 for JPEG.
        :param header: stamp and frame of the message, kept as it is.
        :returns: the message.
        :raises TypeError: ``cvim`` is not an array.
        :raises CvBridgeError: no such codec, or one that cannot hold the array unchanged.
        """
        wanted = parse_format(dst_format)
        declared = _declared(cvim, wanted.original or 'passthrough')
        try:
            picture = np.ascontiguousarray(cvim, declared.dtype)
            if wanted.stored:
                picture = convert_to(picture, declared, wanted.stored)
            content = _pictures().encode_picture(picture, f'.{wanted.codec}', quality)
        except ImageError as err:
            raise CvBridgeError(str(err)) from err
        message = CompressedImage(format=dst_format)
        if header is not None:
            message.header = header
        message.data.frombytes(content)
        return message


def getCvType(encoding: str) -> int:
    """
    Give the number of the OpenCV type of an encoding.

    OpenCV 5 numbers types with several channels otherwise than OpenCV 4. The numbers are those of
    the ``cv2`` that the process has imported, and of OpenCV 4 as long as it has not.

    :param encoding: such as ``'bgr8'``.
    :returns: such as ``cv2.CV_8UC3``.
    :raises CvBridgeError: the encoding is not known.
    """
    dtype, channels = CvBridge().encoding_to_dtype_with_channels(encoding)
    return [*DEPTHS.values()].index(dtype) + (channels - 1) * _channel_step()


def cvtColorForDisplay(
    source: NDArray[Any], encoding_in: str, encoding_out: str, do_dynamic_scaling: bool = False,
    min_image_value: float = 0.0, max_image_value: float = 0.0, colormap: int = -1,
) -> NDArray[Any]:
    """
    Make an image of 8-bit colours or gray, to be looked at, of any image.

    Labels (``32SC1``) get a colour each where ``'bgr8'`` is asked for. Floats are spread between
    their least and their greatest finite number where no limits are given. ``8UC1``, ``16UC3``
    and their like are taken for gray, BGR and BGRA.

    :param source: array of shape (h, w) or (h, w, c); it is not changed.
    :param encoding_in: its encoding.
    :param encoding_out: an 8-bit colour encoding or ``'mono8'``; ``''`` for ``'bgr8'``.
    :param do_dynamic_scaling: spread between the least and the greatest finite number.
    :param min_image_value: the number that becomes black, unless both limits are the same.
    :param max_image_value: the number that becomes white.
    :param colormap: number of one of OpenCV's colormaps for what is spread; -1 for gray.
    :returns: a fresh contiguous uint8 array, (h, w) for ``'mono8'``, (h, w, c) otherwise.
    :raises TypeError: ``source`` is not an array.
    :raises CvBridgeError: there is no such encoding to display, or no sense in the conversion.
    """
    if isinstance(source, np.ndarray) and source.dtype.kind in 'iu' and source.itemsize == 8:
        source = source.astype(np.int32)  # the labels of whoever left numpy the choice
    declared = _declared(source, encoding_in)
    limits = None
    if do_dynamic_scaling:
        limits = finite_limits(source)
    elif min_image_value != max_image_value:
        limits = min_image_value, max_image_value
    try:
        return show(source.reshape(source.shape[:2]) if declared.channels == 1 else source,
                    declared, encoding_out, limits, _colormap(colormap))
    except ImageError as err:
        raise CvBridgeError(str(err)) from err


def _colormap(number: int) -> Colormap | None:
    if number == -1:
        return None
    return partial(_pictures().apply_colormap, colormap=number)


def _pictures() -> ModuleType:
    """Import the part that needs OpenCV, for those who use it."""
    try:
        import opencv_tools.pictures as pictures
    except ImportError as err:
        raise CvBridgeError(f'compressed images and colormaps need OpenCV: {err}') from err
    return pictures


def _declared(image: NDArray[Any], encoding: str) -> Encoding:
    """
    Look up the encoding that an array is said to have, and check that it can have it.

    :param image: what should be an array of shape (h, w) or (h, w, c).
    :param encoding: its encoding, or ``'passthrough'`` for the generic one of its type.
    :raises TypeError: it is not an array.
    :raises CvBridgeError: the encoding is not known or does not fit.
    """
    if not isinstance(image, (np.ndarray, np.generic)):
        raise TypeError('Your input type is not a numpy array')
    if image.ndim not in (2, 3):
        raise CvBridgeError(f'An image has 2 or 3 dimensions, not the shape {image.shape}')
    try:
        actual = generic_encoding(image)
        declared = actual if encoding == 'passthrough' else find_encoding(encoding)
    except ImageError as err:
        raise CvBridgeError(str(err)) from err
    if (actual.dtype, actual.channels) != (declared.dtype, declared.channels):
        raise CvBridgeError(f'encoding specified as {encoding}, '
                            f'but image has incompatible type {actual.name}')
    rows, width = image.shape[:2]
    if declared.rows(declared.height(rows)) != rows or (declared.planes == 1.5 and width % 2):
        raise CvBridgeError(f'encoding specified as {encoding}, '
                            f'but image has {rows} rows of {width}, which it cannot have')
    return declared


def _stored_encoding(picture: NDArray[Any], format_text: str) -> Encoding:
    """Find out what the channels of a decoded picture are."""
    told = parse_format(format_text)
    actual = generic_encoding(picture)
    for name in (told.stored, told.original):
        try:
            found = find_encoding(name)
        except EncodingError:
            continue
        if (found.dtype, found.channels, found.planes) == (actual.dtype, actual.channels, 1):
            return found
    return picture_encoding(picture)


def _channel_step() -> int:
    """Give the difference that one more channel makes to the number of an OpenCV type."""
    step: int = getattr(sys.modules.get('cv2'), 'CV_8UC2', 8)
    return step
