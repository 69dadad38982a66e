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

"""A packet of compressed video: one picture."""

from __future__ import annotations

from dataclasses import dataclass

#: Codecs of packets, and those that are also encoded. SVT-AV1, the only encoder of AV1 of PyAV,
#: waits for ever at times, and makes the threads of its process real-time threads.
CODECS = ('h264', 'h265', 'av1')
ENCODED = CODECS[:2]


@dataclass(frozen=True, kw_only=True)
class VideoPacket:
    """
    One picture of compressed video.

    :param codec: one of ``CODECS``.
    :param data: Annex B byte stream of H.264 and H.265, or OBUs of AV1 in the low-overhead format.
    :param is_key: whether decoding can begin with this packet.
    :param width: width of the picture in pixels, without padding.
    :param height: height of the picture in pixels, without padding.
    """

    codec: str
    data: bytes
    is_key: bool
    width: int
    height: int
