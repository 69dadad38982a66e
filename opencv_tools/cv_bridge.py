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

from collections.abc import Callable
from functools import partial, wraps
import sys
from types import ModuleType
from typing import Any, ParamSpec, TypeVar

import numpy as np
from numpy.typing import NDArray
from opencv_tools.image.cdr import image_to_cdr, WireImage
from opencv_tools.image.color import convert_to
from opencv_tools.image.compressed import parse_format, stored_encoding
from opencv_tools.image.display import Colormap, finite_limits, show
from opencv_tools.image.encodings import (
    declared_encoding, DEPTHS, Encoding, find_encoding, generic_encoding,
)
from opencv_tools.image.errors import ImageError
from opencv_tools.image.layout import is_bigendian, pack_pixels, view_pixels
from sensor_msgs.msg import CompressedImage, Image
from std_msgs.msg import Header

__all__ = ['CvBridge', 'CvBridgeError', 'cvtColorForDisplay', 'getCvType']


class CvBridgeError(TypeError):
    """An image that cannot be converted; the message says why."""


_P = ParamSpec('_P')
_T = TypeVar('_T')


def _raises_bridge_errors(function: Callable[_P, _T]) -> Callable[_P, _T]:
    """Turn whatever the image room refuses into a CvBridgeError."""
    @wraps(function)
    def wrapped(*args: _P.args, **kwargs: _P.kwargs) -> _T:
        try:
            return function(*args, **kwargs)
        except ImageError as err:
            raise CvBridgeError(str(err)) from err
    return wrapped


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

    @_raises_bridge_errors
    def dtype_with_channels_to_cvtype2(self, dtype: np.dtype[Any], n_channels: int) -> str:
        """
        Name the OpenCV type of a numpy type with a number of channels.

        :param dtype: such as ``np.dtype('uint8')``.
        :param n_channels: channels of a pixel.
        :returns: such as ``'8UC3'``.
        :raises CvBridgeError: OpenCV has no such type.
        """
        return generic_encoding(np.empty((0, 0, n_channels), dtype)).name

    def cvtype2_to_dtype_with_channels(self, cvtype: int) -> tuple[str, int]:
        """
        Give the numpy type and the number of channels of an OpenCV type.

        :param cvtype: number of the type, as ``cv2.CV_8UC3`` is.
        :returns: such as ``('uint8', 3)``.
        :raises CvBridgeError: there is no such type.
        """
        more_channels, depth = divmod(cvtype, _channel_step())
        if depth not in self.cvdepth_to_numpy_depth or more_channels < 0:
            raise CvBridgeError(f'unknown OpenCV type {cvtype}; give one such as cv2.CV_8UC3')
        return self.cvdepth_to_numpy_depth[depth], more_channels + 1

    def encoding_to_cvtype2(self, encoding: str) -> int:
        """
        Give the number of the OpenCV type of an encoding, as ``getCvType`` does.

        :raises CvBridgeError: the encoding is not known.
        """
        return getCvType(encoding)

    @_raises_bridge_errors
    def encoding_to_dtype_with_channels(self, encoding: str) -> tuple[str, int]:
        """
        Give the numpy type and the number of channels of an encoding.

        :param encoding: such as ``'bgr8'`` or ``'32FC1'``.
        :returns: such as ``('uint8', 3)``.
        :raises CvBridgeError: the encoding is not known.
        """
        found = find_encoding(encoding)
        return found.dtype, found.channels

    @_raises_bridge_errors
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
        source = find_encoding(img_msg.encoding)
        view = view_pixels(
            img_msg.data, img_msg.height, img_msg.width, img_msg.step, source,
            bool(img_msg.is_bigendian))
        if desired_encoding == 'passthrough':
            return view.astype(source.dtype, copy=False)
        return convert_to(view, source, desired_encoding)

    @_raises_bridge_errors
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

    @_raises_bridge_errors
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
        return image_to_cdr(self.cv2_to_wire(cvim, encoding, header))

    @_raises_bridge_errors
    def cv2_to_wire(
        self, cvim: NDArray[Any], encoding: str = 'passthrough', header: Header | None = None,
    ) -> WireImage:
        """
        Tell an array as the fields of an image message, without a copy; upstream has no such way.

        :param cvim: as for ``cv2_to_imgmsg``; copied only when its rows are not tight.
        :param encoding: what the array holds; ``'passthrough'`` names its type (``8UC3``).
        :param header: stamp and frame of the message.
        :returns: the fields, the data a view of the array.
        :raises TypeError: ``cvim`` is not an array.
        :raises CvBridgeError: the encoding is not known or does not fit the array.
        """
        declared = _declared(cvim, encoding)
        rows, width = cvim.shape[:2]
        header = header or Header()
        return WireImage(
            header.stamp.sec, header.stamp.nanosec, header.frame_id, declared.height(rows),
            width, declared.name, is_bigendian(cvim.dtype), width * declared.pixel_bytes,
            pack_pixels(cvim))

    @_raises_bridge_errors
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
        picture: NDArray[Any] = _pictures().decode_picture(cmprs_img_msg.data)
        if desired_encoding == 'passthrough':
            return picture
        source = stored_encoding(picture, cmprs_img_msg.format)
        return convert_to(picture, source, desired_encoding)

    @_raises_bridge_errors
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
        picture = np.ascontiguousarray(cvim, declared.dtype)
        if wanted.stored:
            picture = convert_to(picture, declared, wanted.stored)
        content = _pictures().encode_picture(picture, f'.{wanted.codec}', quality)
        message = CompressedImage(format=dst_format)
        if header is not None:
            message.header = header
        message.data.frombytes(content)
        return message


@_raises_bridge_errors
def getCvType(encoding: str) -> int:
    """
    Give the number of the OpenCV type of an encoding.

    OpenCV 5 numbers types with several channels otherwise than OpenCV 4. The numbers are those of
    the ``cv2`` that the process has imported, and of OpenCV 4 as long as it has not.

    :param encoding: such as ``'bgr8'``.
    :returns: such as ``cv2.CV_8UC3``.
    :raises CvBridgeError: the encoding is not known.
    """
    found = find_encoding(encoding)
    return [*DEPTHS.values()].index(found.dtype) + (found.channels - 1) * _channel_step()


@_raises_bridge_errors
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
    return show(source.reshape(source.shape[:2]) if declared.channels == 1 else source,
                declared, encoding_out, limits, _colormap(colormap))


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
    """Find the encoding that an image is said to have; refuse what is no array."""
    if not isinstance(image, (np.ndarray, np.generic)):
        raise TypeError('Your input type is not a numpy array')
    return generic_encoding(image) if encoding == 'passthrough' else declared_encoding(
        image, encoding)


def _channel_step() -> int:
    """Give the difference that one more channel makes to the number of an OpenCV type."""
    step: int = getattr(sys.modules.get('cv2'), 'CV_8UC2', 8)
    return step
