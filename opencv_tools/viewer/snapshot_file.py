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

"""A frame as the recorder would write it."""

from __future__ import annotations

from opencv_tools.cv_bridge import CvBridge
from opencv_tools.image.cdr import WireMessage
from opencv_tools.nodes.conversion import FrameConverter
from opencv_tools.recording.errors import UnwritableError
from opencv_tools.recording.frames import CompressedFrame
from opencv_tools.recording.image_encoder import (
    encode_frame, EncoderSettings, read_image_header)
from opencv_tools.recording.naming import FileNames

# Lossless formats, most common first; .npy stores every frame.
_SUFFIXES = ('.png', '.tiff', '.npy')


def encode_original(message: WireMessage, topic: str, receive_ns: int) -> tuple[str, bytes]:
    """
    Encode a frame without loss.

    :param message: raw or compressed image; a compressed image is not changed.
    :param topic: topic of the message, for the name.
    :param receive_ns: time of reception in nanoseconds of the system clock.
    :returns: name of the file and its content.
    :raises ImageError: the message is not a valid image.
    :raises CvBridgeError: the message is not a valid image.
    """
    frame = FrameConverter(CvBridge()).convert(message, topic, receive_ns)
    suffixes: tuple[str, ...] = _SUFFIXES
    if isinstance(frame, CompressedFrame):
        suffixes = read_image_header(frame.data).suffixes[:1] or _SUFFIXES
    for suffix in suffixes:
        try:
            parts = encode_frame(frame, EncoderSettings(suffix)).parts()
            break
        except UnwritableError:
            if suffix == suffixes[-1]:
                raise
    return FileNames(f'{{topic}}_{{stamp}}{suffix}').name(0, frame.metadata), b''.join(parts)
