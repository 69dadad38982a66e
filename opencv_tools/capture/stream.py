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

"""Network streams as a source."""

from __future__ import annotations

from threading import Condition, Thread
import time
from typing import Literal

import cv2
from opencv_tools.capture.errors import BrokenFrameError, UnavailableError
from opencv_tools.capture.frame import CapturedFrame
from opencv_tools.capture.video import describe_video, video_rate
from opencv_tools.image.text import without_password


class StreamSource:
    """
    A stream that is read continuously by a thread, which keeps the newest frame only.

    Frames therefore do not queue up when the publisher is slower than the stream.
    """

    live: Literal[True] = True

    def __init__(self, url: str, capture: cv2.VideoCapture) -> None:
        """
        Start the thread that reads an open stream.

        :param url: URL of the stream.
        :param capture: the open stream, as ``open_video`` returns it.
        """
        self.name = without_password(url)
        self.rate = video_rate(capture)
        self.description = describe_video(capture)
        self.missed = 0
        self._capture = capture
        self._changed = Condition()
        self._newest: CapturedFrame | None = None
        self._ended = False
        self._thread = Thread(target=self._read_all, name='stream', daemon=True)
        self._thread.start()

    def wait(self, seconds: float) -> bool:
        with self._changed:
            self._changed.wait_for(lambda: self._newest is not None or self._ended, seconds)
            if self._newest is None and self._ended:
                raise UnavailableError(f'{self.name} ended or is no longer reachable')
            return self._newest is not None

    def skip(self) -> None:
        with self._changed:
            self._newest = None

    def read(self) -> CapturedFrame:
        with self._changed:
            newest, self._newest = self._newest, None
        if newest is None:
            raise BrokenFrameError(f'{self.name} has no frame yet')
        return newest

    def close(self) -> None:
        with self._changed:
            self._ended = True
        self._thread.join()

    def _read_all(self) -> None:
        """Read frames and keep the newest one, until the stream ends or is closed."""
        while not self._ended:
            decoded, image = self._capture.read()
            with self._changed:
                if decoded:
                    self.missed += self._newest is not None
                    self._newest = CapturedFrame(image, 'bgr8', time.monotonic_ns())
                else:
                    self._ended = True
                self._changed.notify()
        self._capture.release()
