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

"""The array of an image message, and its encoding."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from opencv_tools.cv_bridge import CvBridge
from opencv_tools.image.cdr import WireDisparity, WireImage, WireMessage
from opencv_tools.image.compressed import decoded_encoding, lossy_codec
from opencv_tools.image.compressed_depth import (
    depth_encoding, is_compressed_depth, Quantisation)
from opencv_tools.image.encodings import Encoding, find_encoding
from opencv_tools.image.image_size import check_size, image_size, MAX_PIXELS
from opencv_tools.image.orientation import jpeg_orientation, turn_upright
from opencv_tools.image_codecs import decode_depth, decode_image

_BRIDGE = CvBridge()
#: Encoding of the numbers of a disparity image: as 32FC1, but in pixels, with NaN for none.
DISPARITY = replace(find_encoding('32FC1'), name='disparity')


@dataclass(frozen=True)
class Pixels:
    """
    The pixels of a message, as they are in the message.

    :param image: (h, w) or (h, w, c) array; chroma rows follow the luma rows.
    :param codec: name of the codec that has changed the values; '' for none.
    :param quantisation: how the array stores depth; None if it has the numbers of the encoding.
    """

    image: NDArray[Any]
    encoding: Encoding
    codec: str = ''
    quantisation: Quantisation | None = None

    def numbers(self, part: NDArray[Any]) -> NDArray[Any]:
        """Return the numbers of some pixels of the array, of any shape."""
        return self.quantisation.depth_of(part) if self.quantisation else part

    @property
    def size(self) -> tuple[int, int]:
        """Width and height in pixels."""
        return self.image.shape[1], self.encoding.height(self.image.shape[0])


def read_pixels(message: WireMessage, upright: bool = False, codec: str = '') -> Pixels:
    """
    Read the pixels of a message.

    :param message: raw or compressed image.
    :param upright: whether to rotate a JPEG by its Exif orientation, as browsers do.
    :param codec: name of the codec that a raw image was decoded from.
    :returns: a view of a raw image, or a decoded array.
    :raises ImageError: the message is not a valid image.
    :raises CvBridgeError: the message is not a valid image.
    """
    if isinstance(message, WireImage):
        check_size(message.width, message.height, MAX_PIXELS)
        image, encoding = _BRIDGE.imgmsg_to_cv2(message), find_encoding(message.encoding)
        if isinstance(message, WireDisparity) and encoding.name == '32FC1':
            # A copy, because the array is a view of the message.
            image = np.where(image >= message.min_disparity, image, np.float32(np.nan))
            encoding = DISPARITY
        return Pixels(image, encoding, codec)
    content = bytes(message.data)
    if is_compressed_depth(message.format):
        image, quantisation = decode_depth(content, message.format)
        return Pixels(image, find_encoding(depth_encoding(message.format)),
                      quantisation=quantisation)
    check_size(*image_size(content), MAX_PIXELS)
    image = decode_image(content)
    if upright:
        image = turn_upright(image, jpeg_orientation(content))
    return Pixels(image, decoded_encoding(image, message.format), lossy_codec(content))
