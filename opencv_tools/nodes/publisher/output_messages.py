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

"""Messages of an image that is published."""

from __future__ import annotations

from typing import Any

from numpy.typing import NDArray
from opencv_tools.capture.output_image import OutputImage
from opencv_tools.image.cdr import (
    compressed_image_to_cdr, WireCompressedImage, WireHeader, WireImage)
from opencv_tools.image.encodings import declared_encoding, Encoding
from opencv_tools.image.layout import array_to_wire, view_image
from opencv_tools.topics.frame_topics import Lend
from opencv_tools.transport.shared_frames.writer import Slot


def raw_message(
    output: OutputImage, header: WireHeader, lend: Lend,
) -> tuple[WireImage, Slot | None]:
    """
    Return a message, and the lent memory that the last conversion has written to.

    :param output: image to publish.
    :param header: header of the message.
    :param lend: lends memory that subscribers read.
    :raises ImageError: the image cannot be decoded or converted.
    """
    slot: Slot | None = None

    def lend_image(height: int, width: int, encoding: Encoding) -> NDArray[Any] | None:
        nonlocal slot
        slot = lend(encoding.size(height, width))
        return view_image(slot.data, height, width, encoding) if slot else None

    output.lend = lend_image  # it keeps the slot as long as the pixels
    image = output.image
    return array_to_wire(image, declared_encoding(image, output.encoding), header), slot


def compressed_message(output: OutputImage, header: WireHeader) -> bytes:
    """
    Return the CDR of a message with the JPEG of an image.

    :param output: image to publish.
    :param header: header of the message.
    :raises ImageError: the image cannot be decoded or converted.
    """
    data, format_text = output.jpeg
    return compressed_image_to_cdr(WireCompressedImage(
        header=header, format=format_text, data=data.data))
