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

"""Video files and streams as a source, decoded by OpenCV's FFmpeg."""

from __future__ import annotations

import math
import time

import cv2
from opencv_tools.capture.frame import CaptureError, Frame, MAX_RATE


class VideoSource:
    """The frames of a video file, or of a stream that is read as it comes."""

    def __init__(self, location: str) -> None:
        """
        Open a video.

        :param location: a file's path or a stream's URL.
        :raises CaptureError: it cannot be opened as a video.
        """
        self.name = location
        self._capture = self._open()
        rate = self._capture.get(cv2.CAP_PROP_FPS)
        self.rate = rate if math.isfinite(rate) and 0 < rate <= MAX_RATE else 0.0
        # A stream has no number of frames; a file served over the network has one.
        self.live = '://' in location and self._capture.get(cv2.CAP_PROP_FRAME_COUNT) <= 0

    def skip(self) -> bool:
        grabbed: bool = self._capture.grab()
        return grabbed

    def read(self) -> Frame | None:
        decoded, image = self._capture.read()
        if not decoded:
            return None
        return Frame(image, 'bgr8', time.monotonic_ns() if self.live else None)

    def rewind(self) -> None:
        # Opening again is exact for every container; seeking to frame 0 is not.
        self._capture.release()
        self._capture = self._open()

    def close(self) -> None:
        self._capture.release()

    def _open(self) -> cv2.VideoCapture:
        capture = cv2.VideoCapture(self.name, cv2.CAP_FFMPEG)
        if not capture.isOpened():
            raise CaptureError(f'{self.name} cannot be opened as a video: it is damaged, '
                               'not a video, or not reachable')
        return capture
