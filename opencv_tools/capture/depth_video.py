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

"""Videos with one channel of 16 bits, such as depth. OpenCV would reduce them to 8 bits."""

from __future__ import annotations

from contextlib import suppress
from itertools import chain
from pathlib import Path
from typing import Any, Literal

import cv2
from opencv_tools.base.text import MAX_PATH, printable
from opencv_tools.capture.errors import BrokenFrameError, CaptureError
from opencv_tools.capture.frame import CapturedFrame
from opencv_tools.capture.video import check_end, describe_video, frame_count, video_rate
from opencv_tools.image.errors import SizeError, VideoError
from opencv_tools.image.image_size import check_size, MAX_PIXELS
from opencv_tools.video.lossless import (
    has_no_sums, has_valid_sums, LOSSLESS_PIXELS, tagged_encoding)
from opencv_tools.video.settings import import_av

_FFV1 = b'FFV1'
_GRAY16 = 0x10003159  # tag of FFmpeg for its pixel format


def is_depth_video(capture: cv2.VideoCapture) -> bool:
    """Return whether an open video is FFV1 with one channel of 16 bits."""
    codec = int(capture.get(cv2.CAP_PROP_FOURCC)) & 0xffffffff
    return (codec.to_bytes(4, 'little').upper() == _FFV1
            and int(capture.get(cv2.CAP_PROP_CODEC_PIXEL_FORMAT)) == _GRAY16)


class DepthVideoSource:
    """A video file with one channel of 16 bits, which are read as they are."""

    live: Literal[False] = False

    def __init__(self, path: Path, capture: cv2.VideoCapture) -> None:
        """
        Open the file with PyAV.

        :param capture: the file as OpenCV has opened it; it is closed.
        :raises CaptureError: PyAV is not installed, or the pictures are too large.
        """
        self.name = printable(path, MAX_PATH)
        self.rate, self.count = video_rate(capture), frame_count(capture)
        self.description = f'16 bits {describe_video(capture)}'
        self._size = (int(capture.get(cv2.CAP_PROP_FRAME_WIDTH)),
                      int(capture.get(cv2.CAP_PROP_FRAME_HEIGHT)))
        capture.release()
        self._path = path
        self._container: Any = None
        self._is_checked = False
        try:
            check_size(*self._size, MAX_PIXELS)
            self._av = import_av()
        except (SizeError, VideoError) as err:
            raise CaptureError(f'{self.name} cannot be read: {err}') from err
        self.rewind()

    def skip(self) -> bool:
        packet = self._next_packet()
        if packet is None:
            return False
        with suppress(BrokenFrameError):
            self._decode(packet)
        return True

    def read(self) -> CapturedFrame | None:
        packet = self._next_packet()
        if packet is None:
            return None
        frame = self._decode(packet)
        return CapturedFrame(frame.to_ndarray(), self._encoding, position=frame.time)

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
        stream.codec_context.options = {'max_pixels': str(MAX_PIXELS)}
        self._encoding = tagged_encoding(stream.metadata) or 'mono16'
        # FFV1 before version 3 has no such data and no checksums.
        self._may_have_sums = bool(stream.codec_context.extradata)
        self.warnings = [] if self._may_have_sums and not has_no_sums(bytes(first)) else [
            f'{self.name} has no checksums, so that damaged frames are not noticed; FFmpeg writes '
            'them with -c:v ffv1 -level 3 -slicecrc 1']
        self._needs_key = False
        self._packets = chain((first,), packets)
        self._number = 0

    def close(self) -> None:
        if self._container is not None:
            self._container.close()

    def _next_packet(self) -> Any:
        """
        Return the next packet; None at the end.

        :raises BrokenFrameError: the file is damaged; once, also at an early end.
        """
        try:
            packet = next(self._packets, None)
        except (self._av.error.FFmpegError, OSError) as err:
            raise BrokenFrameError(f'{self.name} cannot be read: {err}') from err
        if packet is not None and packet.size:
            self._number += 1
            return packet
        if not self._is_checked:
            self._is_checked = True
            check_end(str(self._path), self._number, self.count)
        return None

    def _decode(self, packet: Any) -> Any:
        """
        Return the picture of a packet.

        :raises BrokenFrameError: it is damaged, or needs one that is.
        """
        reason = ''
        try:
            is_damaged = self._may_have_sums and not (
                has_valid_sums(bytes(packet)) or has_no_sums(bytes(packet)))
            self._needs_key = is_damaged or (self._needs_key and not packet.is_keyframe)
            for frame in () if self._needs_key else packet.decode():
                if (frame.width, frame.height, frame.format.name) == (
                        *self._size, LOSSLESS_PIXELS):
                    return frame
        except (self._av.error.FFmpegError, OSError, ValueError) as err:
            reason = f': {err}'
        raise BrokenFrameError(
            f'frame {self._number - 1} of {self.name} cannot be decoded{reason}')
