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

"""What is published of a frame: its pixels as they are wanted, and a JPEG of them."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray
from opencv_tools.capture.frame import Frame, JPEG
from opencv_tools.image.encodings import Encoding, find_encoding, picture_encoding
from opencv_tools.image.jpeg import jpeg_components, JpegError
from opencv_tools.image.orientation import orient
from opencv_tools.pictures import convert_picture, decode_picture, encode_picture

# What a JPEG from a camera stands for without a change: its colours have no order of their own.
_AS_JPEG = ('', 'bgr8', 'rgb8', 'bgra8', 'rgba8')


@dataclass(frozen=True)
class Look:
    """
    How frames are wanted.

    :param encoding: sensor_msgs/Image encoding; '' for the frame's own.
    :param flip: see ``orient``.
    :param rotate: degrees clockwise, see ``orient``.
    :param jpeg_quality: 1 to 100.
    """

    encoding: str = ''
    flip: str = 'none'
    rotate: int = 0
    jpeg_quality: int = 95

    @property
    def turns(self) -> bool:
        """Tell whether frames are flipped or rotated."""
        return self.flip != 'none' or self.rotate != 0


class Rendition:
    """A frame as it is published; what nobody asks for is not made, and nothing is made twice."""

    def __init__(self, frame: Frame, look: Look) -> None:
        """
        Take a frame.

        :param frame: as it was captured.
        :param look: how it is wanted.
        """
        self._frame = frame
        #: How the frame is wanted.
        self.look = look

    @property
    def image(self) -> NDArray[Any]:
        """
        Give the pixels, (h, w) or (h, w, c).

        :raises ImageError: the frame is no picture, or cannot be what is wanted.
        """
        return self._pixels[0]

    @property
    def encoding(self) -> str:
        """
        Name the encoding of the pixels.

        :raises ImageError: as for ``image``.
        """
        return self._pixels[1].name

    @property
    def size(self) -> tuple[int, int]:
        """
        Give width and height of the picture.

        :raises ImageError: as for ``image``.
        """
        image, encoding = self._pixels
        return image.shape[1], encoding.height(image.shape[0])

    @cached_property
    def jpeg(self) -> tuple[NDArray[Any], str]:
        """
        Make a JPEG, (n,) uint8, and its format string, as compressed_image_transport writes it.

        What the camera has compressed is passed on as it is.

        :raises ImageError: the frame is no picture, or cannot be what is wanted.
        """
        if self._is_ready():
            if self._is_gray_jpeg:
                return self._frame.image, 'mono8; jpeg compressed mono8'
            return self._frame.image, f'{self.look.encoding or "bgr8"}; jpeg compressed bgr8'
        image, actual = self._pixels
        stored = find_encoding('mono8' if actual.order == 'y' else 'bgr8')
        if actual != stored:
            image = convert_picture(image, actual, stored)
        data = encode_picture(np.ascontiguousarray(image), '.jpg', self.look.jpeg_quality)
        # Sixteen bits, and other things than colours, are told as what is left of them.
        told = actual.name if actual.name in _AS_JPEG else stored.name
        return data, f'{told}; jpeg compressed {stored.name}'

    def _is_ready(self) -> bool:
        """Tell whether the camera's own JPEG is what is wanted."""
        return (self._frame.encoding == JPEG and not self.look.turns
                and (self.look.encoding in _AS_JPEG
                     or (self.look.encoding == 'mono8' and self._is_gray_jpeg)))

    @cached_property
    def _is_gray_jpeg(self) -> bool:
        try:
            return jpeg_components(self._frame.image.tobytes()) == 1
        except JpegError:
            return False  # whoever decodes it will find out

    @cached_property
    def _pixels(self) -> tuple[NDArray[Any], Encoding]:
        image = self._frame.image
        if self._frame.encoding == JPEG:
            image = decode_picture(image)
            encoding = picture_encoding(image)
        else:
            encoding = find_encoding(self._frame.encoding)
        wanted = find_encoding(self.look.encoding) if self.look.encoding else encoding
        if not wanted.has_layout_of(encoding):
            image = convert_picture(image, encoding, wanted)
        return orient(image, wanted, self.look.flip, self.look.rotate)
