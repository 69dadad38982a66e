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
part, so it works with every numpy and needs no OpenCV.
"""

from __future__ import annotations

import array
import sys
from typing import Any

import numpy as np
from numpy.typing import NDArray
from opencv_tools.image.color import ConversionError, convert
from opencv_tools.image.encodings import EncodingError, find_encoding, generic_encoding
from opencv_tools.image.layout import LayoutError, view_pixels
from sensor_msgs.msg import Image
from std_msgs.msg import Header

__all__ = ['CvBridge', 'CvBridgeError']


class CvBridgeError(TypeError):
    """An image that cannot be converted; the message says why."""


class CvBridge:
    """Convert between sensor_msgs/Image messages and numpy arrays as OpenCV uses them."""

    def encoding_to_dtype_with_channels(self, encoding: str) -> tuple[str, int]:
        """
        Give the numpy type and the number of channels of an encoding.

        :param encoding: such as ``'bgr8'`` or ``'32FC1'``.
        :returns: such as ``('uint8', 3)``.
        :raises CvBridgeError: the encoding is not known.
        """
        try:
            found = find_encoding(encoding)
        except EncodingError as err:
            raise CvBridgeError(str(err)) from err
        return found.dtype, found.channels

    def imgmsg_to_cv2(
        self, img_msg: Image, desired_encoding: str = 'passthrough',
    ) -> NDArray[Any]:
        """
        Convert an image message to an array.

        :param img_msg: the message; its ``step`` and ``is_bigendian`` are honoured.
        :param desired_encoding: what the array should hold; ``'passthrough'`` or ``''`` for what
            the message holds.
        :returns: (h, w) for one channel, (h, w, c) otherwise. With passthrough a view of the
            message's data, in the message's byte order, that keeps the data alive; otherwise a
            fresh, writable, contiguous array in native byte order.
        :raises CvBridgeError: an unknown encoding, a conversion that makes no sense, or a size,
            step and data that contradict each other.
        """
        try:
            source = find_encoding(img_msg.encoding)
            view = view_pixels(
                img_msg.data, img_msg.height, img_msg.width, img_msg.step, source,
                bool(img_msg.is_bigendian))
            if desired_encoding in ('', 'passthrough'):
                return view
            return convert(view, source, find_encoding(desired_encoding))
        except (ConversionError, EncodingError, LayoutError) as err:
            raise CvBridgeError(str(err)) from err

    def cv2_to_imgmsg(
        self, cvim: NDArray[Any], encoding: str = 'passthrough',
        header: Header | None = None,
    ) -> Image:
        """
        Convert an array to an image message, copying its data once.

        :param cvim: array of shape (h, w) or (h, w, c); any strides, any byte order.
        :param encoding: what the array holds; ``'passthrough'`` names its type (``8UC3``).
        :param header: stamp and frame of the message.
        :returns: the message, with tight rows.
        :raises TypeError: ``cvim`` is not an array.
        :raises CvBridgeError: the encoding is not known or does not fit the array.
        """
        if not isinstance(cvim, (np.ndarray, np.generic)):
            raise TypeError('Your input type is not a numpy array')
        if cvim.ndim not in (2, 3):
            raise CvBridgeError(f'An image has 2 or 3 dimensions, not the shape {cvim.shape}')
        try:
            actual = generic_encoding(cvim)
            declared = actual if encoding == 'passthrough' else find_encoding(encoding)
        except EncodingError as err:
            raise CvBridgeError(str(err)) from err
        if (actual.dtype, actual.channels) != (declared.dtype, declared.channels):
            raise CvBridgeError(f'encoding specified as {encoding}, '
                                f'but image has incompatible type {actual.name}')
        message = Image(height=cvim.shape[0], width=cvim.shape[1], encoding=declared.name)
        if header is not None:
            message.header = header
        message.step = message.width * declared.pixel_bytes
        message.is_bigendian = _is_bigendian(cvim.dtype)
        data = array.array('B')
        data.frombytes(np.ascontiguousarray(cvim).reshape(-1).view(np.uint8))
        message.data = data
        return message


def _is_bigendian(dtype: np.dtype[Any]) -> bool:
    """Tell whether numbers of a type have their most significant byte first."""
    return dtype.byteorder == '>' or (dtype.byteorder == '=' and sys.byteorder == 'big')
