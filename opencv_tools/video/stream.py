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

"""Video of frames whose size may change, with key frames on request."""

from __future__ import annotations

import time
from typing import Any

from numpy.typing import NDArray
from opencv_tools.image.encodings import find_encoding
from opencv_tools.image.errors import VideoError
from opencv_tools.video.encoder import VideoEncoder
from opencv_tools.video.packet import VideoPacket
from opencv_tools.video.settings import VideoSettings

# A receiver may miss the first key frame, because it is not ready yet. It gets another one.
_KEY_FRAMES = 2
_KEY_SECONDS = 1.0  # between two requested key frames
_ASSUMED_RATE = 30.0  # frames per second, by which a bit rate becomes a size of frames


class VideoStream:
    """Encode frames; used by one thread, except ``requests``."""

    def __init__(self, settings: VideoSettings) -> None:
        """
        Create a stream. The encoder is opened with the first frame.

        :param settings: codec, quality and so on.
        """
        #: Settings of the encoder. A change begins with a key frame.
        self.settings = settings
        #: Number of requests of key frames until now; another thread may increase it.
        self.requests = 0
        self._seen = self._key_frames = 0  # requests, and key frames that they still get
        self._keyed_at = 0.0
        self._encoder: VideoEncoder | None = None
        self._opened = settings, 0, 0  # settings, width and height of the encoder

    def encode(self, image: NDArray[Any], encoding: str, stamp_ns: int) -> VideoPacket:
        """
        Encode a frame.

        :param image: (h, w) or (h, w, c) array with 8 bits.
        :param encoding: sensor_msgs/Image encoding of the image.
        :param stamp_ns: time of the image in nanoseconds.
        :raises ImageError: the encoding has no video, or FFmpeg fails. The next frame is encoded
            by a new encoder.
        """
        needed = self.settings, image.shape[1], find_encoding(encoding).height(image.shape[0])
        if self._encoder is None or self._opened != needed:
            self._encoder = VideoEncoder(*needed, _ASSUMED_RATE)
            self._opened = needed
        if self._seen != self.requests:
            self._seen, self._key_frames = self.requests, _KEY_FRAMES
        now = time.monotonic()
        is_key = self._key_frames > 0 and now >= self._keyed_at + _KEY_SECONDS
        try:
            packet = self._encoder.encode(image, encoding, stamp_ns, key=is_key)
        except VideoError:
            self.end()
            raise
        if packet.is_key:
            self._keyed_at = now
            self._key_frames = max(0, self._key_frames - 1)
        return packet

    def end(self) -> None:
        """Close the encoder. The next frame is a key frame of another one."""
        self._encoder = None
