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

"""Readers of serialized image messages."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from opencv_tools.image.cdr import (
    cdr_to_compressed_image, cdr_to_image, CdrError, EncapsulationError, WireCompressedImage,
    WireImage,
)
from rclpy.serialization import deserialize_message
from sensor_msgs.msg import CompressedImage, Image

FrameMessage = WireImage | Image | WireCompressedImage | CompressedImage


def read_image(serialized: Any) -> WireImage | Image:
    """
    Read a serialized image message.

    :param serialized: buffer with the message.
    :returns: the message; plain CDR becomes a view of the buffer, other formats are read by the
        middleware.
    :raises CdrError: the buffer does not hold an image message.
    """
    return _read(serialized, cdr_to_image, Image)


def read_compressed_image(serialized: Any) -> WireCompressedImage | CompressedImage:
    """
    Read a serialized compressed image message.

    :param serialized: buffer with the message.
    :returns: the message; plain CDR becomes a view of the buffer, other formats are read by the
        middleware.
    :raises CdrError: the buffer does not hold a compressed image message.
    """
    return _read(serialized, cdr_to_compressed_image, CompressedImage)


def _read(serialized: Any, read: Callable[[Any], Any], message_type: Any) -> Any:
    try:
        return read(serialized)
    except EncapsulationError:
        try:
            return deserialize_message(bytes(serialized), message_type)
        except RuntimeError as err:  # rclpy's RMWError is private
            raise CdrError(f'the middleware cannot read the message: {err}') from err
