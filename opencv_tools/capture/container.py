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

"""Video files and streams that PyAV opens."""

from __future__ import annotations

import math
import os
from typing import Any

from opencv_tools.base.text import MAX_PATH, printable, without_password
from opencv_tools.capture.errors import CaptureError
from opencv_tools.capture.frame import MAX_RATE
from opencv_tools.capture.urls import describe_failure
from opencv_tools.image.errors import SizeError
from opencv_tools.image.image_size import check_size, MAX_PIXELS
from opencv_tools.video.settings import import_av, major_version

# Options of FFmpeg for URLs as 'name;value|name;value', which OpenCV reads too, and its default.
_VARIABLE = 'OPENCV_FFMPEG_CAPTURE_OPTIONS'
_DEFAULT = 'rtsp_transport;tcp'
_COVER = 0x400  # AV_DISPOSITION_ATTACHED_PIC


def open_container(location: str, timeout: float | None = None) -> Any:
    """
    Open a video file or a stream with PyAV.

    :param location: path or URL.
    :param timeout: timeout in seconds for opening it and for each read; None to wait.
    :returns: the ``av.container.InputContainer``, which has a video.
    :raises VideoError: PyAV cannot be imported.
    :raises CaptureError: the location cannot be opened as a video, or its pictures are too large.
    """
    av = import_av()
    is_url, options = '://' in location, {}
    shown = printable(without_password(location), MAX_PATH)
    if is_url:
        pairs = (pair.partition(';') for pair in os.environ.get(_VARIABLE, _DEFAULT).split('|'))
        options = {name: value for name, _, value in pairs if name}
    try:
        # PyAV 19 reads metadata that is not UTF-8 without being asked.
        metadata = {'metadata_errors': 'replace'} if major_version(av) < 19 else {}
        container = av.open(location if is_url else f'file:{location}', options=options,
                            timeout=timeout, **metadata)
        if not container.streams.video:
            raise CaptureError(f'{shown} has no video stream')
        context = video_stream(container).codec_context
        if context:
            check_size(context.width, context.height, MAX_PIXELS)
            context.options = {'max_pixels': str(MAX_PIXELS)}
            return container
    except SizeError as err:
        raise CaptureError(f'{shown} cannot be read: {err}') from err
    except (av.error.FFmpegError, OSError, ValueError):
        pass  # the reason is the same
    raise CaptureError(describe_failure(location) if is_url else
                       f'{shown} cannot be opened as a video: it is damaged or not a video')


def video_stream(container: Any) -> Any:
    """Return the video that players show, such as the default one; with PyAV 12 the first one."""
    streams = container.streams
    return streams.best('video') if hasattr(streams, 'best') else streams.video[0]


def count_videos(container: Any) -> int:
    """Return the number of videos, without pictures of a cover."""
    return sum(not getattr(stream, 'disposition', 0) & _COVER
               for stream in container.streams.video)


def stream_rate(stream: Any) -> float:
    """Return the frames per second of a stream of PyAV; 0.0 if the value is implausible."""
    rate = float(stream.average_rate or stream.guessed_rate or 0)
    return rate if math.isfinite(rate) and 0 < rate <= MAX_RATE else 0.0


def known_count(container: Any) -> int:
    """Return the number of frames by the header of a container; 0 if it is unknown."""
    stream, length = video_stream(container), container.duration or 0
    return int(stream.frames or max(0, round(length / 1e6 * stream_rate(stream))))
