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

from opencv_tools.image.cdr import (
    cdr_to_compressed_image, cdr_to_disparity, cdr_to_image, COMPRESSED_IMAGE, DISPARITY_IMAGE,
    IMAGE, WireMessage)
from opencv_tools.image.errors import CdrError, EncapsulationError
from opencv_tools.transport.message_type import message_type
from opencv_tools.video.messages import cdr_to_video, VIDEO_TOPICS, WireVideo
from rclpy.serialization import deserialize_message, serialize_message

#: Reader of plain CDR, by message type.
MESSAGE_TYPES: dict[str, Callable[[Any], WireMessage]] = {
    IMAGE: cdr_to_image,
    COMPRESSED_IMAGE: cdr_to_compressed_image,
    DISPARITY_IMAGE: cdr_to_disparity,
}

#: A message with an image, or with a picture of video.
AnyMessage = WireMessage | WireVideo


def message_class(type_name: str) -> Any:
    """
    Return the class of messages with images or video for a subscription.

    :param type_name: one of ``MESSAGE_TYPES`` or ``VIDEO_TOPICS``.
    """
    return message_type(type_name)


def read_message(serialized: Any, type_name: str) -> AnyMessage:
    """
    Read a serialized message.

    :param serialized: buffer with the message.
    :param type_name: type of the message, one of ``MESSAGE_TYPES`` or ``VIDEO_TOPICS``.
    :returns: the message, a view of the buffer; a message in another format than plain CDR is
        converted by the middleware.
    :raises CdrError: the buffer does not hold a message of this type.
    """
    if type_name in VIDEO_TOPICS:
        return cdr_to_video(type_name, serialized)
    read = MESSAGE_TYPES[type_name]
    try:
        return read(serialized)
    except EncapsulationError:
        try:
            return read(serialize_message(deserialize_message(
                bytes(serialized), message_class(type_name))))
        except RuntimeError as err:  # rclpy's RMWError is private
            raise CdrError(f'the middleware cannot read the message: {err}') from err
