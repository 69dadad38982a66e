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

"""Types of image messages, and readers of their serialized form."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar

from opencv_tools.image.cdr import (
    cdr_to_compressed_image, cdr_to_image, WireCompressedImage, WireImage, WireMessage)
from opencv_tools.image.errors import CdrError, EncapsulationError
from rclpy.serialization import deserialize_message, serialize_message
from sensor_msgs.msg import CompressedImage, Image

IMAGE = 'sensor_msgs/msg/Image'
COMPRESSED_IMAGE = 'sensor_msgs/msg/CompressedImage'

_M = TypeVar('_M', WireImage, WireCompressedImage)


def read_image(serialized: Any) -> WireImage:
    """
    Read a serialized image message.

    :param serialized: buffer with the message.
    :returns: the message, a view of the buffer; a message in another format than plain CDR is
        converted by the middleware.
    :raises CdrError: the buffer does not hold an image message.
    """
    return _read(serialized, cdr_to_image, Image)


def read_compressed_image(serialized: Any) -> WireCompressedImage:
    """
    Read a serialized compressed image message.

    :param serialized: buffer with the message.
    :returns: the message, as for ``read_image``.
    :raises CdrError: the buffer does not hold a compressed image message.
    """
    return _read(serialized, cdr_to_compressed_image, CompressedImage)


#: Class of the messages and reader of their serialized form, by message type.
MESSAGE_TYPES: dict[str, tuple[Any, Callable[[Any], WireMessage]]] = {
    IMAGE: (Image, read_image),
    COMPRESSED_IMAGE: (CompressedImage, read_compressed_image),
}


def _read(serialized: Any, read: Callable[[Any], _M], message_type: Any) -> _M:
    try:
        return read(serialized)
    except EncapsulationError:
        try:
            return read(serialize_message(deserialize_message(bytes(serialized), message_type)))
        except RuntimeError as err:  # rclpy's RMWError is private
            raise CdrError(f'the middleware cannot read the message: {err}') from err
