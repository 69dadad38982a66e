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
Conversion between image messages and numpy arrays, as cv_bridge does, in pure Python.

The names, defaults and error texts are those of ``cv_bridge`` of ROS 2 Jazzy. There is no compiled
part, so this module works with every numpy version. Only compressed images and colormaps need
OpenCV.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial, wraps
import sys
from types import ModuleType
from typing import Any, ParamSpec, TypeVar

import numpy as np
from numpy.typing import NDArray
from opencv_tools.image.color import convert_to
from opencv_tools.image.compressed import parse_format
from opencv_tools.image.compressed_depth import (
    COMPRESSED_DEPTH, depth_codec, is_compressed_depth)
from opencv_tools.image.display import Colormap, finite_limits, to_display_image
from opencv_tools.image.encodings import (
    declared_encoding, DEPTHS, Encoding, find_encoding, generic_encoding)
from opencv_tools.image.errors import ImageError
from opencv_tools.image.layout import array_to_wire, view_pixels
from sensor_msgs.msg import CompressedImage, Image
from std_msgs.msg import Header

__all__ = ['CvBridge', 'CvBridgeError', 'cvtColorForDisplay', 'getCvType']


class CvBridgeError(TypeError):
    """An image cannot be converted. The message contains the reason."""


_P = ParamSpec('_P')
_T = TypeVar('_T')


def _raises_bridge_errors(function: Callable[_P, _T]) -> Callable[_P, _T]:
    """Convert each ImageError of a function to a CvBridgeError."""
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
        self.cvdepth_to_numpy_depth = dict(enumerate(DEPTHS.values()))
        self.numpy_type_to_cvtype = {
            **{dtype: depth for depth, dtype in DEPTHS.items()}, **DEPTHS}

    @property
    def cvtype_to_name(self) -> dict[int, str]:
        """Names of OpenCV's types with up to four channels, by the numbers of the types."""
        names = [f'{depth}C{channels}' for depth in DEPTHS for channels in range(1, 5)]
        return {getCvType(name): name for name in names}

    @_raises_bridge_errors
    def dtype_with_channels_to_cvtype2(self, dtype: np.dtype[Any], n_channels: int) -> str:
        """
        Return the name of the OpenCV type of pixels: ``'8UC3'`` for uint8 and 3 channels.

        :raises CvBridgeError: OpenCV does not support the type.
        """
        return generic_encoding(np.empty((0, 0, n_channels), dtype)).name

    def cvtype2_to_dtype_with_channels(self, cvtype: int) -> tuple[str, int]:
        """
        Return the numpy type and the channels of an OpenCV type: ``('uint8', 3)`` of CV_8UC3.

        :raises CvBridgeError: the type is unknown.
        """
        more_channels, depth = divmod(cvtype, _channel_step())
        if depth not in self.cvdepth_to_numpy_depth or more_channels < 0:
            raise CvBridgeError(f'unknown OpenCV type {cvtype}; give one such as cv2.CV_8UC3')
        return self.cvdepth_to_numpy_depth[depth], more_channels + 1

    def encoding_to_cvtype2(self, encoding: str) -> int:
        """Return the number of the OpenCV type of an encoding, as ``getCvType`` does."""
        return getCvType(encoding)

    @_raises_bridge_errors
    def encoding_to_dtype_with_channels(self, encoding: str) -> tuple[str, int]:
        """
        Return the numpy type and the channels of an encoding: ``('uint8', 3)`` of bgr8.

        :raises CvBridgeError: the encoding is unknown.
        """
        found = find_encoding(encoding)
        return found.dtype, found.channels

    @_raises_bridge_errors
    def imgmsg_to_cv2(
            self, img_msg: Image, desired_encoding: str = 'passthrough') -> NDArray[Any]:
        """
        Convert an image message to an array.

        :param img_msg: the message, or an object with the same attributes; ``step`` and
            ``is_bigendian`` are taken into account.
        :param desired_encoding: encoding of the array; ``'passthrough'`` for that of the message,
            without a copy; ``''`` for that of the message, with a copy.
        :returns: array in native byte order: (h, w) for one channel, (h, w, c) otherwise. The
            chroma rows of ``nv12``, ``nv21`` and ``nv24`` follow the luma rows, as in OpenCV.
            With passthrough the array is a view, which keeps the data alive and is writable if
            they are; it is a copy only if bytes must be swapped. Otherwise the array is new,
            writable and contiguous.
        :raises CvBridgeError: the encoding is unknown, the conversion is not supported, or the
            size, step and data contradict each other.
        """
        source = find_encoding(img_msg.encoding)
        view = view_pixels(
            img_msg.data, img_msg.height, img_msg.width, img_msg.step, source,
            bool(img_msg.is_bigendian))
        if desired_encoding == 'passthrough':
            return view if view.dtype.isnative else view.astype(source.dtype)
        return convert_to(view, source, desired_encoding)

    @_raises_bridge_errors
    def cv2_to_imgmsg(
        self, cvim: NDArray[Any], encoding: str = 'passthrough', header: Header | None = None,
    ) -> Image:
        """
        Convert an array to an image message, copying its data once.

        :param cvim: (h, w) or (h, w, c) array of any strides and byte order; separate chroma rows
            (``nv12``) follow the luma rows.
        :param encoding: encoding of the array; ``'passthrough'`` for its generic type (``8UC3``).
        :param header: header of the message, which is not copied; None for an empty one.
        :returns: the message, without padding at the end of rows.
        :raises TypeError: ``cvim`` is not an array.
        :raises CvBridgeError: the encoding is unknown or does not fit the array.
        """
        wire = array_to_wire(cvim, _declared(cvim, encoding))
        message = Image(height=wire.height, width=wire.width, encoding=wire.encoding,
                        step=wire.step, is_bigendian=wire.is_bigendian)
        if header is not None:
            message.header = header
        message.data.frombytes(wire.data)  # assigning to data would copy a second time
        return message

    @_raises_bridge_errors
    def compressed_imgmsg_to_cv2(
        self, cmprs_img_msg: CompressedImage, desired_encoding: str = 'passthrough',
    ) -> NDArray[Any]:
        """
        Decode a compressed image message.

        :param cmprs_img_msg: the message. An encoding in its ``format``, as
            compressed_image_transport writes it (``'16UC1; png compressed '``), is used if it
            fits the decoded image; otherwise the image is gray, BGR or BGRA. Messages of
            compressed_depth_image_transport are decoded as well, with PNG and RVL.
        :param desired_encoding: encoding of the array; ``'passthrough'`` for the image as OpenCV
            decodes it.
        :returns: a new array: (h, w) for one channel, (h, w, c) otherwise.
        :raises CvBridgeError: the data cannot be decoded, or the conversion is not supported.
        """
        image, source = _codecs().decode_compressed(cmprs_img_msg.data, cmprs_img_msg.format)
        return image if desired_encoding == 'passthrough' else convert_to(
            image, source, desired_encoding)

    @_raises_bridge_errors
    def cv2_to_compressed_imgmsg(
        self, cvim: NDArray[Any], dst_format: str = 'jpg', *, quality: int | None = None,
        header: Header | None = None,
    ) -> CompressedImage:
        """
        Compress an array to a compressed image message.

        :param cvim: (h, w) gray, (h, w, 3) BGR or (h, w, 4) BGRA array.
        :param dst_format: codec, such as ``'jpg'`` or ``'png'``, or the form of
            compressed_image_transport: ``'rgb8; jpeg compressed bgr8'`` for an RGB array that is
            stored as BGR. It becomes the ``format`` of the message. Depth becomes a message of
            compressed_depth_image_transport with ``'16UC1; compressedDepth rvl'`` or ``png``;
            ``32FC1`` in metres is quantised as its defaults do, up to 10 m.
        :param quality: quality of JPEG and WebP, 1 to 100; None for OpenCV's default (95 for
            JPEG).
        :param header: header of the message, which is not copied; None for an empty one.
        :returns: the message.
        :raises TypeError: ``cvim`` is not an array.
        :raises CvBridgeError: the codec is unknown, or cannot store the array without a
            conversion.
        """
        if is_compressed_depth(dst_format):
            return _depth_message(cvim, dst_format, header)
        target = parse_format(dst_format)
        declared = _declared(cvim, target.original or 'passthrough')
        image = np.ascontiguousarray(cvim, declared.dtype)
        if target.stored:
            image = convert_to(image, declared, target.stored)
        content = _codecs().encode_image(image, f'.{target.codec}', quality)
        return _compressed_message(content, dst_format, header)


def _depth_message(cvim: NDArray[Any], dst_format: str, header: Header | None) -> CompressedImage:
    """Compress an image of depth."""
    name = dst_format.partition(';')[0].strip()
    declared = _declared(cvim, name if name != COMPRESSED_DEPTH else 'passthrough')
    content, format_text = _codecs().encode_depth(
        np.ascontiguousarray(cvim, declared.dtype), declared.name, depth_codec(dst_format))
    return _compressed_message(content, format_text, header)


def _compressed_message(
    content: bytes, format_text: str, header: Header | None,
) -> CompressedImage:
    message = CompressedImage(format=format_text)
    if header is not None:
        message.header = header
    message.data.frombytes(content)
    return message


@_raises_bridge_errors
def getCvType(encoding: str) -> int:
    """
    Return the number of the OpenCV type of an encoding.

    OpenCV 4 and OpenCV 5 use different numbers for types with several channels. The numbers are
    those of the imported ``cv2``; if ``cv2`` is not imported, those of OpenCV 4.

    :param encoding: encoding, such as ``'bgr8'``.
    :returns: number of the type, such as ``cv2.CV_8UC3``.
    :raises CvBridgeError: the encoding is unknown.
    """
    found = find_encoding(encoding)
    return [*DEPTHS.values()].index(found.dtype) + (found.channels - 1) * _channel_step()


@_raises_bridge_errors
def cvtColorForDisplay(
    source: NDArray[Any], encoding_in: str, encoding_out: str, do_dynamic_scaling: bool = False,
    min_image_value: float = 0.0, max_image_value: float = 0.0, colormap: int = -1,
) -> NDArray[Any]:
    """
    Convert an image of any encoding to 8-bit colours or gray for display.

    - Labels (``32SC1``) become colours if ``encoding_out`` is ``'bgr8'``.
    - Floats without limits are scaled from their smallest and largest finite number.
    - Generic types such as ``8UC1`` or ``16UC3`` are read as gray, BGR or BGRA.

    :param source: (h, w) or (h, w, c) array, which is not changed.
    :param encoding_in: encoding of the array; ``'passthrough'`` for its generic type.
    :param encoding_out: encoding of the result: an 8-bit colour encoding or ``'mono8'``; ``''``
        for ``'bgr8'``.
    :param do_dynamic_scaling: whether the smallest and largest finite number are the limits.
    :param min_image_value: number that becomes black; without effect if equal to
        ``max_image_value``.
    :param max_image_value: number that becomes white.
    :param colormap: number of an OpenCV colormap for scaled numbers; -1 for gray.
    :returns: a new contiguous uint8 array: (h, w) for ``'mono8'``, (h, w, c) otherwise.
    :raises TypeError: ``source`` is not an array.
    :raises CvBridgeError: the encoding cannot be displayed, or the conversion is not supported.
    """
    if isinstance(source, np.ndarray) and source.dtype.kind in 'iu' and source.itemsize == 8:
        source = source.astype(np.int32)  # labels with numpy's default type int64
    declared = _declared(source, encoding_in)
    limits = None
    if do_dynamic_scaling:
        limits = finite_limits(source)
    elif min_image_value != max_image_value:
        limits = min_image_value, max_image_value
    image = source.reshape(source.shape[:2]) if declared.channels == 1 else source
    return to_display_image(image, declared, encoding_out, limits, _colormap(colormap))


def _colormap(number: int) -> Colormap | None:
    return None if number == -1 else partial(_codecs().apply_colormap, colormap=number)


def _codecs() -> ModuleType:
    """Return the module that needs OpenCV, imported on first use."""
    try:
        import opencv_tools.image_codecs as codecs
    except ImportError as err:
        raise CvBridgeError(f'compressed images and colormaps need OpenCV: {err}') from err
    return codecs


def _declared(image: NDArray[Any], encoding: str) -> Encoding:
    """Return the encoding of an image, and check that it fits the array."""
    if not isinstance(image, (np.ndarray, np.generic)):
        raise TypeError('Your input type is not a numpy array')
    return generic_encoding(image) if encoding == 'passthrough' else declared_encoding(
        image, encoding)


def _channel_step() -> int:
    """Return by how much the number of an OpenCV type increases with each channel."""
    return getattr(sys.modules.get('cv2'), 'CV_8UC2', 8)
