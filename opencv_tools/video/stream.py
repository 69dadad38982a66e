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

from collections import deque
from collections.abc import Callable
from itertools import takewhile
import time
from typing import Any

from numpy.typing import NDArray
from opencv_tools.image.encodings import find_encoding
from opencv_tools.image.errors import KeyFrameNeeded, VideoError
from opencv_tools.video.encoder import VideoEncoder
from opencv_tools.video.packet import VideoPacket
from opencv_tools.video.settings import NOMINAL_RATE, VideoSettings

# A receiver may miss the first key frame, because it is not ready yet. It gets another one.
_KEY_FRAMES = 2
_KEY_SECONDS = 1.0  # between two requested key frames
# A first measurement, later ones, the frames that each needs and keeps, and their tolerance.
_FIRST_SECONDS, _SECONDS, _MIN_FRAMES, _FRAMES, _TOLERANCE = 0.1, 2.0, 4, 16, 0.1
# A rate that is twice as high is certain earlier, a lower one later: an encoder that is told too
# few frames exceeds its bit rate, and each new one begins with a key frame.
_RISE_FRAMES, _RISE_SECONDS, _RISE, _FALL_SECONDS = 6, 0.25, 2.0, 4.0
# A rate that rises is told as it will be, so that few encoders follow a slow rise.
_AHEAD_SECONDS = 2.0
_PAUSE = 4.0  # periods without a frame that are no part of the rate

Picture = tuple[NDArray[Any], str] | VideoPacket


class VideoStream:
    """Encode frames; used by one thread, except ``requests``."""

    def __init__(self, settings: VideoSettings,
                 clock: Callable[[], float] = time.monotonic) -> None:
        """
        Create a stream. The encoder is opened with the first frame.

        :param settings: codec, quality and so on.
        :param clock: function that returns seconds, by which the rate of the frames is measured.
        """
        #: Settings of the encoder. A change begins with a key frame.
        self.settings = settings
        #: Number of requests of key frames until now; another thread may increase it.
        self.requests = 0
        #: Expected frames per second until another rate is measured; 0 if they are unknown.
        self.expected_rate = 0.0
        self._seen = self._key_frames = 0  # requests, and key frames that they still get
        self._keyed_at = 0.0
        self._passes = False  # whether the last packet came from a camera
        self._encoder: VideoEncoder | None = None
        self._opened = settings, 0, 0, 0.0  # settings, width, height and rate of the encoder
        self._clock = clock
        self._rate = 0.0  # frames per second; 0 before the first measurement
        self._times: deque[float] = deque()  # of the last frames
        self._expected = self.expected_rate  # before which the rate was measured
        self._fell_at = self._highest = 0.0  # of rates that are lower

    def encode(self, image: NDArray[Any], encoding: str, stamp_ns: int) -> VideoPacket:
        """
        Encode a frame.

        :param image: (h, w) or (h, w, c) array with 8 bits.
        :param encoding: sensor_msgs/Image encoding of the image.
        :param stamp_ns: time of the image in nanoseconds.
        :raises ImageError: the encoding has no video, or FFmpeg fails. The next frame is encoded
            by a new encoder.
        """
        now = self.measure()
        needed = (self.settings, image.shape[1], find_encoding(encoding).height(image.shape[0]),
                  self._rate or self.expected_rate or NOMINAL_RATE)
        is_same = self._opened[:3] == needed[:3] and (
            self._opened == needed or not self.settings.bit_rate)
        if self._encoder is None or not is_same:
            self._encoder = VideoEncoder(*needed)
            self._opened = needed
            self._times.clear()  # this frame took longer
        if self._seen != self.requests:
            self._seen, self._key_frames = self.requests, _KEY_FRAMES
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

    def measure(self) -> float:
        """
        Measure the rate by the time of a frame, and keep it until another one is certain.

        It is the highest of the last seconds, or that of 2 s later if it rises. ``encode`` calls
        this; frames that are not encoded can be measured, too.

        :returns: the time of the frame.
        """
        if self._expected != self.expected_rate:
            self._expected, self._rate = self.expected_rate, 0.0
            self._times.clear()
        now, times, known = self._clock(), self._times, self._rate or self.expected_rate
        if len(times) > 1 and now - times[-1] > _PAUSE * (times[-1] - times[0]) / (len(times) - 1):
            times.clear()
        times.append(now)
        while len(times) > _FRAMES and now - times[0] > _SECONDS:
            times.popleft()
        seconds, count = now - times[0], len(times) - 1
        enough = (_SECONDS / 2, _FRAMES / 2) if known else (_FIRST_SECONDS, _MIN_FRAMES - 1)
        rate = count / seconds if seconds >= enough[0] and count >= enough[1] else 0.0
        slope = _slope(times) if known and rate > known * (1 + _TOLERANCE) else 0.0
        if known and seconds >= _RISE_SECONDS:
            latest = sum(1 for _ in takewhile(lambda at: now - at < _RISE_SECONDS,
                                              reversed(times)))
            if latest >= max(_RISE_FRAMES, _RISE * known * _RISE_SECONDS):
                rate, slope = latest / _RISE_SECONDS, 0.0
        self._highest = max(self._highest, rate)
        if rate >= known * (1 - _TOLERANCE) or not rate:
            self._fell_at, self._highest = now, rate
        if rate > known * (1 + _TOLERANCE) or now > self._fell_at + _FALL_SECONDS:
            ahead = min(slope * _AHEAD_SECONDS, rate)
            self._rate, self._fell_at, self._highest = self._highest + ahead, now, 0.0
            times.clear()
            times.append(now)
        return now

    def packet(self, picture: Picture, stamp_ns: int) -> VideoPacket:
        """
        Return the packet of a picture, which a camera may have encoded.

        :param picture: image and encoding, as for ``encode``, or the packet of a camera.
        :param stamp_ns: time of the picture in nanoseconds.
        :raises KeyFrameNeeded: the packet of a camera needs a key frame that was not passed on.
        :raises ImageError: as ``encode``.
        """
        if not isinstance(picture, VideoPacket):
            self._passes = False
            return self.encode(*picture, stamp_ns)
        self._encoder = None
        if picture.is_key:
            self._passes, self._seen = True, self.requests
        if not self._passes:
            raise KeyFrameNeeded('the video of the camera begins with its next key frame')
        return picture

    @property
    def size(self) -> tuple[int, int] | None:
        """Width and height of the last encoder in pixels; None before the first frame."""
        return self._opened[1:3] if self._opened[1] else None

    @property
    def needs_key_frame(self) -> bool:
        """Whether a new receiver waits for a key frame of a camera."""
        return self._passes and self._seen != self.requests

    def end(self) -> None:
        """Close the encoder. The next packet is a key frame."""
        self._encoder = None
        self._passes = False


def _slope(times: deque[float]) -> float:
    """Return how much the rate of frames rises, in Hz per second; 0 if it falls."""
    half = len(times) // 2
    older, newer = times[half] - times[0], times[-1] - times[half]
    if not older or not newer:
        return 0.0
    return max(0.0, (len(times) - 1 - half) / newer - half / older) * 2 / (older + newer)
