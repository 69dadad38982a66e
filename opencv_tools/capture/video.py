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

"""Video files as a source, decoded by OpenCV's FFmpeg."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Literal

import cv2
from opencv_tools.capture.frame import BrokenFrameError, CaptureError, Frame, MAX_RATE
from opencv_tools.capture.reachability import describe_failure
from opencv_tools.image.text import MAX_PATH, printable, without_password

# Files of these kinds have a list of their frames; of others OpenCV guesses how many there are.
_LISTED_SUFFIXES = frozenset(('.mp4', '.m4v', '.mov', '.avi'))


class VideoSource:
    """The frames of a video file, each with its own time."""

    live: Literal[False] = False

    def __init__(self, location: str, capture: cv2.VideoCapture) -> None:
        """
        Take an opened video.

        :param location: a file's path, or the URL of one on a web server.
        :param capture: the same from ``open_video``.
        """
        self._location = location
        self.name = without_password(location)
        self._capture = capture
        self.rate = video_rate(capture)
        self.description = describe_video(capture)
        listed = Path(location).suffix.lower() in _LISTED_SUFFIXES
        self._listed = frame_count(capture) if listed else 0
        self._number = 0

    def skip(self) -> bool:
        if self._capture.grab():
            self._number += 1
            return True
        self._check_end()
        return False

    def read(self) -> Frame | None:
        if not self.skip():
            return None
        position = self._capture.get(cv2.CAP_PROP_POS_MSEC) / 1000
        # 0 also stands for a time that OpenCV does not know: the last frames of an AVI that are
        # not coded in their order, and of any such file for OpenCV 4.6.
        known = math.isfinite(position) and (position or self._number == 1)
        decoded, image = self._capture.retrieve()
        if not decoded:
            raise BrokenFrameError(f'frame {self._number - 1} of {self.name} cannot be decoded')
        return Frame(image, 'bgr8', position=position if known else None)

    def rewind(self) -> None:
        # Opening again is exact for every container; seeking to frame 0 is not.
        self._capture.release()
        self._capture = open_video(self._location)
        self._number = 0

    def close(self) -> None:
        self._capture.release()

    def _check_end(self) -> None:
        """
        Tell, once, when the video ends before its time.

        :raises BrokenFrameError: frames are missing.
        """
        number, listed = self._number, self._listed
        self._listed = 0
        if number < listed:
            raise BrokenFrameError(f'{self.name} is damaged: it ends after {number} of its '
                                   f'{listed} frames')


def open_video(location: str, *options: int) -> cv2.VideoCapture:
    """
    Open a video file or a stream.

    :param location: a path or a URL.
    :param options: properties to open it with, each followed by its value.
    :returns: the opened capture.
    :raises CaptureError: it cannot be opened as a video.
    """
    capture = cv2.VideoCapture(location, cv2.CAP_FFMPEG, options)
    if not capture.isOpened():
        raise CaptureError(describe_failure(location) if '://' in location else
                           f'{printable(location, MAX_PATH)} cannot be opened as a video: '
                           'it is damaged or not a video')
    return capture


def video_rate(capture: cv2.VideoCapture) -> float:
    """Give the frames per second that a video says it has, 0.0 when that cannot be."""
    rate: float = capture.get(cv2.CAP_PROP_FPS)
    return rate if math.isfinite(rate) and 0 < rate <= MAX_RATE else 0.0


def frame_count(capture: cv2.VideoCapture) -> int:
    """Give the number of frames of a video; a stream has none."""
    return max(0, int(capture.get(cv2.CAP_PROP_FRAME_COUNT)))


def describe_video(capture: cv2.VideoCapture) -> str:
    """Write size and rate of a video."""
    width, height = (int(capture.get(prop)) for prop in (
        cv2.CAP_PROP_FRAME_WIDTH, cv2.CAP_PROP_FRAME_HEIGHT))
    return f'{width}x{height} at {video_rate(capture):g} Hz'
