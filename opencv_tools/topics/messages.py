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

"""Types of image messages, and the reader of their serialized form."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from opencv_tools.image.cdr import cdr_to_compressed_image, cdr_to_image, WireMessage
from opencv_tools.image.errors import CdrError, EncapsulationError
from opencv_tools.image.types import COMPRESSED_IMAGE, IMAGE
from rclpy.serialization import deserialize_message, serialize_message
from sensor_msgs.msg import CompressedImage, Image

__all__ = ['COMPRESSED_IMAGE', 'IMAGE', 'MESSAGE_TYPES', 'read_message']

#: Class of the messages and reader of plain CDR, by message type.
MESSAGE_TYPES: dict[str, tuple[Any, Callable[[Any], WireMessage]]] = {
    IMAGE: (Image, cdr_to_image),
    COMPRESSED_IMAGE: (CompressedImage, cdr_to_compressed_image),
}


def read_message(serialized: Any, type_name: str) -> WireMessage:
    """
    Read a serialized message.

    :param serialized: buffer with the message.
    :param type_name: type of the message, one of ``MESSAGE_TYPES``.
    :returns: the message, a view of the buffer; a message in another format than plain CDR is
        converted by the middleware.
    :raises CdrError: the buffer does not hold a message of this type.
    """
    message_class, read = MESSAGE_TYPES[type_name]
    try:
        return read(serialized)
    except EncapsulationError:
        try:
            return read(serialize_message(deserialize_message(bytes(serialized), message_class)))
        except RuntimeError as err:  # rclpy's RMWError is private
            raise CdrError(f'the middleware cannot read the message: {err}') from err
