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

"""Gray videos of more than 8 bits, such as depth. OpenCV would reduce them to 8 bits."""

from __future__ import annotations

from collections import deque
from itertools import chain
from pathlib import Path
import re
from typing import Any, Literal

import numpy as np
from opencv_tools.base.text import MAX_PATH, printable
from opencv_tools.capture.errors import BrokenFrameError, CaptureError
from opencv_tools.capture.frame import CapturedFrame
from opencv_tools.capture.video import check_end, describe_video, frame_count, video_rate
from opencv_tools.image.errors import SizeError, VideoError
from opencv_tools.image.image_size import check_size, MAX_PIXELS
from opencv_tools.opencv import cv2
from opencv_tools.video.lossless import (
    describe_tags, has_no_sums, has_valid_sums, LOSSLESS_PIXELS, tagged_encoding)
from opencv_tools.video.settings import import_av

# Tags of FFmpeg for common pixel formats of 8 bits, which need no PyAV, and that of gray.
_EIGHT_BITS = (b'I420', b'Y42B', b'444P', b'Y800', b'BGR\0', b'BGRA', b'RGBA', b'RGB\x18',
               b'BGR\x18', b'YUY2', b'NV12')
_GRAY_TAG, _GRAY = b'Y1\0', re.compile('gray[0-9]+[bl]e')


def deep_pixels(path: Path, capture: cv2.VideoCapture) -> str:
    """
    Return the pixel format of an open video with more than 8 bits a channel; '' for others.

    :returns: name of FFmpeg; without PyAV ``'gray16le'`` for any gray, or a description.
    :raises CaptureError: its pictures are too large.
    """
    tag = int(capture.get(cv2.CAP_PROP_CODEC_PIXEL_FORMAT)) & 0xffffffff
    text = tag.to_bytes(4, 'little')
    if text in _EIGHT_BITS:
        return ''
    try:
        check_size(int(capture.get(cv2.CAP_PROP_FRAME_WIDTH)),
                   int(capture.get(cv2.CAP_PROP_FRAME_HEIGHT)), MAX_PIXELS)
        av = import_av()
        with av.open(f'file:{path}', metadata_errors='replace') as container:
            pixels = container.streams.video[0].codec_context.format
    except SizeError as err:
        raise CaptureError(f'{printable(path, MAX_PATH)} cannot be read: {err}') from err
    except VideoError:
        return LOSSLESS_PIXELS if _GRAY_TAG in (text[:3], text[:0:-1]) else 'an unknown format'
    except (av.error.FFmpegError, OSError, LookupError):
        return ''  # reading it reports this
    deepest = max((one.bits for one in pixels.components), default=0) if pixels else 0
    return pixels.name if deepest > 8 else ''


def is_gray(pixels: str) -> bool:
    """Return whether a pixel format is one channel of integers with more than 8 bits."""
    return _GRAY.fullmatch(pixels) is not None


class DepthVideoSource:
    """A gray video file of more than 8 bits, whose numbers are read as they are."""

    live: Literal[False] = False

    def __init__(self, path: Path, capture: cv2.VideoCapture, pixels: str) -> None:
        """
        Open the file with PyAV.

        :param capture: the file as OpenCV has opened it; it is closed.
        :param pixels: its format by ``deep_pixels``, for which ``is_gray`` is true.
        :raises CaptureError: PyAV is not installed.
        """
        self.name = printable(path, MAX_PATH)
        self.rate, self.count = video_rate(capture), frame_count(capture)
        self.description = f'{pixels} {describe_video(capture)}'
        capture.release()
        self._path, self._pixels = path, pixels
        self._container: Any = None
        try:
            self._av = import_av()
        except VideoError as err:
            raise CaptureError(f'{self.name} cannot be read: {err}') from err
        self.rewind()

    def skip(self) -> bool:
        try:
            return self._next() is not None
        except BrokenFrameError:
            if self._is_checked:
                raise
            return True

    def read(self) -> CapturedFrame | None:
        frame = self._next()
        if frame is None:
            return None
        numbers = np.frombuffer(frame.planes[0], '>u2' if self._pixels.endswith('be') else '<u2')
        image = numbers.reshape(frame.height, -1)[:, :frame.width]
        return CapturedFrame(image, self._encoding, position=frame.time)

    def rewind(self) -> None:
        self.close()
        try:
            self._container = self._av.open(
                f'file:{self._path}', metadata_errors='replace')
            stream = self._container.streams.video[0]
            packets = self._container.demux(stream)
            first = next(packets)
        except (self._av.error.FFmpegError, OSError, LookupError) as err:
            raise CaptureError(f'{self.name} cannot be opened again: {err}') from err
        context = stream.codec_context
        context.options = {'max_pixels': str(MAX_PIXELS)}
        # FFmpeg scales numbers for other formats, whose copied metadata are wrong.
        tags = stream.metadata if self._pixels.startswith('gray16') else {}
        self._encoding, wrong = tagged_encoding(tags) or 'mono16', describe_tags(tags)
        self._is_ffv1 = context.name == 'ffv1'
        # FFV1 before version 3 has no such data and no checksums.
        self._may_have_sums = self._is_ffv1 and bool(context.extradata)
        has_sums = self._may_have_sums and not has_no_sums(bytes(first))
        self.warnings = [
            f'{self.name} has no checksums, so that damaged frames are not noticed; FFmpeg writes '
            'them with -c:v ffv1 -level 3 -slicecrc 1'] if self._is_ffv1 and not has_sums else []
        self.warnings += [f'{self.name} has {wrong}'] if wrong else []
        self._size = context.width, context.height
        self._needs_key = self._is_checked = False
        self._packets, self._decoded = chain((first,), packets), deque[Any]()
        self._number = 0

    def close(self) -> None:
        if self._container is not None:
            self._container.close()

    def _next(self) -> Any:
        """
        Return the next picture; None at the end.

        :raises BrokenFrameError: it cannot be decoded, or the file ends early, once.
        """
        while not self._decoded:
            try:
                packet = next(self._packets, None)
            except (self._av.error.FFmpegError, OSError) as err:
                self._is_checked = True
                raise BrokenFrameError(f'{self.name} cannot be read: {err}') from err
            if packet is not None:
                self._number += bool(packet.size)
                self._decoded.extend(self._decode(packet))
            elif self._is_checked:
                return None
            else:
                self._is_checked = True
                check_end(str(self._path), self._number, self.count)
        return self._decoded.popleft()

    def _decode(self, packet: Any) -> list[Any]:
        """
        Return the pictures of a packet; the one without data at the end has the last ones.

        :raises BrokenFrameError: it is damaged, or needs one that is.
        """
        reason = ''
        try:
            is_damaged = self._may_have_sums and packet.size and not (
                has_valid_sums(bytes(packet)) or has_no_sums(bytes(packet)))
            self._needs_key = is_damaged or (self._needs_key and not packet.is_keyframe)
            frames = [] if self._needs_key else packet.decode() or []
            if all((frame.width, frame.height, frame.format.name) == (*self._size, self._pixels)
                   for frame in frames) and (frames or not (self._is_ffv1 and packet.size)):
                return list(frames)
        except (self._av.error.FFmpegError, OSError, ValueError) as err:
            reason = f': {err}'
        raise BrokenFrameError(
            f'frame {self._number - 1} of {self.name} cannot be decoded{reason}')
