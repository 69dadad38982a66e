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
The errors of images.

::

    ImageError
    ├─ EncodingError            an encoding is unknown, or does not fit an array
    ├─ LayoutError              the size, step and data of an image contradict each other
    ├─ ConversionError          a conversion between two encodings is not supported
    ├─ RectificationError       an image cannot be rectified by its camera_info
    ├─ CdrError                 bytes are not a message, or a message cannot be serialised
    │  └─ EncapsulationError    a message has another encapsulation than plain CDR
    ├─ CodecError               an image file cannot be encoded or decoded
    │  ├─ SizeError             the size of an image file is unknown or too large
    │  └─ JpegError             a JPEG is incomplete or damaged
    └─ VideoError               video cannot be encoded, decoded or read
       └─ KeyFrameNeeded        a packet needs earlier packets that are missing
"""

from __future__ import annotations


class ImageError(ValueError):
    """An image cannot be read or converted. The message contains the reason."""


class EncodingError(ImageError):
    """An encoding is unknown, or does not fit an array."""


class LayoutError(ImageError):
    """The size, step and data of an image contradict each other."""


class ConversionError(ImageError):
    """A conversion between two encodings is not supported."""


class RectificationError(ImageError):
    """An image cannot be rectified by its camera_info, or has none."""


class CdrError(ImageError):
    """Bytes that are not a message, or a message that cannot be serialised."""


class EncapsulationError(CdrError):
    """A message with another encapsulation than plain CDR. The middleware must read it."""


class CodecError(ImageError):
    """An image file cannot be encoded or decoded."""


class SizeError(CodecError):
    """The size of an image file is unknown or too large."""


class JpegError(CodecError):
    """A JPEG is incomplete or damaged."""


class VideoError(ImageError):
    """Video cannot be encoded, decoded or read, or this machine has no encoder for it."""


class KeyFrameNeeded(VideoError):
    """A packet needs earlier packets that are missing. Decoding continues at a key frame."""
