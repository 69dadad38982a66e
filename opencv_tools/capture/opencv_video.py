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

"""Video files as a source, decoded by the FFmpeg backend of OpenCV."""

from __future__ import annotations

from collections.abc import Iterator
import math
import time
from typing import Literal

import numpy as np
from opencv_tools.base.remedies import installation
from opencv_tools.base.text import MAX_PATH, printable, without_password
from opencv_tools.capture.declared_size import check_end
from opencv_tools.capture.errors import BrokenFrameError, CaptureError
from opencv_tools.capture.frame import CapturedFrame, MAX_RATE
from opencv_tools.capture.urls import describe_failure
from opencv_tools.opencv import cv2

# Tags of FFmpeg for common pixel formats of 8 bits, and that of gray.
_EIGHT_BITS = (b'I420', b'Y42B', b'444P', b'Y800', b'BGR\0', b'BGRA', b'RGBA', b'RGB\x18',
               b'BGR\x18', b'YUY2', b'NV12')
_GRAY_TAG = b'Y1\0'
# Since this version OpenCV does not convert interlaced pictures, and shows what its memory has.
_NO_INTERLACED, _FIRST_PICTURES = (4, 13), 8


class OpenCvVideo:
    """A video file where PyAV is missing. Each frame has its time in the file."""

    live: Literal[False] = False
    is_deep: Literal[False] = False

    def __init__(self, location: str, capture: cv2.VideoCapture, warning: str = '') -> None:
        """
        Wrap an open video.

        :param location: path of the file, or its URL on a web server.
        :param capture: the open video, as ``open_video`` returns it.
        :param warning: warning of ``check_pictures``.
        """
        self._location = location
        self.name = without_password(location)
        self._capture = capture
        self.rate = video_rate(capture)
        self.description = describe_video(capture)
        self.count = frame_count(capture)
        self.warnings = [warning] if warning else []
        if _tag(capture) not in _EIGHT_BITS:
            self.warnings.append(
                f'{self.name} may have more than 8 bits a channel, which are reduced to 8')
        self._number = 0
        self._is_checked = False

    def skip(self) -> bool:
        if self._capture.grab():
            self._number += 1
            return True
        if not self._is_checked:
            self._is_checked = True
            check_end(self._location, self._number)
        return False

    def read(self) -> CapturedFrame | None:
        if not self.skip():
            return None
        position = self._capture.get(cv2.CAP_PROP_POS_MSEC) / 1000
        # OpenCV also returns 0 for an unknown time: for the last frames of an AVI with reordered
        # frames (B-frames), and with OpenCV 4.6 for those of any file with reordered frames.
        known = math.isfinite(position) and (position or self._number == 1)
        decoded, image = self._capture.retrieve()
        if not decoded:
            raise BrokenFrameError(f'frame {self._number - 1} of {self.name} cannot be decoded')
        return CapturedFrame(image, 'bgr8', position=position if known else None)

    read_ahead = read

    def rewind(self) -> None:
        # Reopening is exact for every container; seeking to frame 0 is not.
        self._capture.release()
        self._capture = open_video(self._location)
        self._number = 0

    def close(self) -> None:
        self._capture.release()


class OpenCvStream:
    """A stream that OpenCV decodes."""

    needs_every = False
    missed = 0

    def __init__(self, capture: cv2.VideoCapture) -> None:
        """
        Wrap an open stream.

        :param capture: the stream, as ``open_video`` returns it.
        """
        self.rate = video_rate(capture)
        self.description = describe_video(capture)
        self._capture = capture

    def frames(self) -> Iterator[CapturedFrame]:
        """Yield the frames."""
        while True:
            is_decoded, image = self._capture.read()
            if not is_decoded:
                return
            yield CapturedFrame(image, 'bgr8', time.monotonic_ns())

    def lose(self) -> None:
        """Do nothing, because each frame is an image."""

    def close(self) -> None:
        """Close the connection."""
        self._capture.release()


def open_video(location: str, *options: int) -> cv2.VideoCapture:
    """
    Open a video file or a stream.

    :param location: path or URL.
    :param options: ``cv2.CAP_PROP_*`` properties for opening, each followed by its value.
    :returns: the open video.
    :raises CaptureError: the location cannot be opened as a video.
    """
    capture = cv2.VideoCapture(location, cv2.CAP_FFMPEG, options)
    if not capture.isOpened():
        raise CaptureError(describe_failure(location) if '://' in location else
                           f'{printable(location, MAX_PATH)} cannot be opened as a video: '
                           'it is damaged or not a video')
    return capture


def check_pictures(path: str) -> str:
    """
    Check that OpenCV decodes the first pictures of a file, and keeps their bits.

    :returns: a warning if they may be those of interlaced video, or of a still scene; or ''.
    :raises CaptureError: it does not; the message includes the remedy.
    """
    capture = open_video(path)
    tag = _tag(capture)
    images = [capture.read()[1] for _ in range(_FIRST_PICTURES)]
    capture.release()
    found = [image for image in images if image is not None]
    version = tuple(int(part) for part in cv2.__version__.split('.')[:2])
    shown, remedy = printable(path, MAX_PATH), installation('av')
    is_gray = _GRAY_TAG in (tag[:3], tag[:0:-1])
    if is_gray or not found:
        reason = ('it may have gray of more than 8 bits, which OpenCV reduces' if is_gray else
                  f'OpenCV {cv2.__version__} decodes none of its pictures')
        raise CaptureError(f'{shown} cannot be read without PyAV: {reason}; {remedy}')
    if version >= _NO_INTERLACED and len(found) > 1 and all(
            np.array_equal(found[0], image) for image in found[1:]):
        return (f'the first {len(found)} pictures of {shown} are the same: if it does not begin '
                f'with a still scene, it is interlaced, and OpenCV {cv2.__version__} cannot read '
                f'it; {remedy}')
    return ''


def video_rate(capture: cv2.VideoCapture) -> float:
    """Return the frames per second in the header of a video; 0.0 if the value is implausible."""
    rate = capture.get(cv2.CAP_PROP_FPS)
    return rate if math.isfinite(rate) and 0 < rate <= MAX_RATE else 0.0


def frame_count(capture: cv2.VideoCapture) -> int:
    """Return the number of frames of a video file; 0 for a stream."""
    return max(0, int(capture.get(cv2.CAP_PROP_FRAME_COUNT)))


def describe_video(capture: cv2.VideoCapture) -> str:
    """Return the size and rate of a video as text, such as ``640x480 at 30 Hz``."""
    width, height = (int(capture.get(prop)) for prop in (
        cv2.CAP_PROP_FRAME_WIDTH, cv2.CAP_PROP_FRAME_HEIGHT))
    return f'{width}x{height} at {video_rate(capture):g} Hz'


def _tag(capture: cv2.VideoCapture) -> bytes:
    tag = int(capture.get(cv2.CAP_PROP_CODEC_PIXEL_FORMAT)) & 0xffffffff
    return tag.to_bytes(4, 'little')
