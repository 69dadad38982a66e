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

"""A frame in shared memory: the structure of its header, and the received frame."""

from __future__ import annotations

import ctypes
import hashlib
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Pixels = NDArray[np.uint8]
IDENTITY_SIZE = 16


class FrameHeader(ctypes.Structure):
    """
    Fields of a frame beside its pixels. Both texts follow the pixels, in UTF-8.

    ``number`` counts the frames of a publisher from 1. ``data_size`` and both ``..._size`` are
    bytes. ``message`` is the sequence number of the last message on the image topic; if
    ``is_message``, it has the same frame. ``publish_ns`` is the time of publication in nanoseconds
    of the system clock. ``identity`` is that of the publisher, see `publisher_identity`.
    """

    _fields_ = (
        ('number', ctypes.c_uint64), ('message', ctypes.c_uint64), ('publish_ns', ctypes.c_int64),
        ('identity', ctypes.c_uint8 * IDENTITY_SIZE), ('data_size', ctypes.c_uint64),
        ('sec', ctypes.c_int32), ('nanosec', ctypes.c_uint32), ('height', ctypes.c_uint32),
        ('width', ctypes.c_uint32), ('step', ctypes.c_uint32), ('frame_id_size', ctypes.c_uint32),
        ('encoding_size', ctypes.c_uint32), ('is_bigendian', ctypes.c_uint8),
        ('is_message', ctypes.c_uint8))

    @staticmethod
    def type_name() -> str:
        """Return the name that writers and readers compare."""
        return 'opencv_tools_frame_header_2'


class SharedFrame(NamedTuple):
    """
    A received frame.

    :param header: fields as the writer set them, unchecked but for the sizes.
    :param data: the pixels, (n,) uint8 and read-only, in the shared memory until the last view of
        them is gone, or a copy if too many frames are held.
    """

    header: FrameHeader
    frame_id: str
    encoding: str
    data: Pixels


def publisher_identity(publisher: bytes, topic: str) -> bytes:
    """
    Return what each shared frame repeats of its publisher and topic.

    :param topic: name of the image topic after remapping.
    """
    return hashlib.blake2b(publisher + topic.encode(), digest_size=IDENTITY_SIZE).digest()
