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

"""Frames of a video whose recording was killed before it counted them."""

from __future__ import annotations

import errno
from pathlib import Path

from opencv_tools.recording.video.writer import VIDEO_FORMATS

# A file up to this size may be only the header that FFmpeg wrote. A larger MP4 that ends inside
# the header of a fragment cannot be opened either, but its frames can be rescued.
_HEADER_BYTES = 8192


def count_frames(path: Path) -> int | None:
    """
    Count the complete frames of a video.

    :param path: path of a readable video, which may be truncated anywhere.
    :returns: number of frames; 0 if the file is only a header; None if the number is unknown.
    :raises OSError: the file cannot be read.
    """
    if path.suffix.lower() not in VIDEO_FORMATS:
        return None
    try:
        import av
    except ImportError:
        return None
    count, is_read = 0, True
    try:
        with av.open(str(path)) as container:
            for packet in container.demux(video=0):
                count += bool(packet.size) and not packet.is_corrupt
    except (av.error.InvalidDataError, EOFError, IndexError):
        pass  # truncated; IndexError means that there is no stream
    except av.error.FFmpegError as err:
        is_read = err.errno == errno.EIO  # Matroska reports a truncated file by EIO
    is_empty = is_read and path.stat().st_size <= _HEADER_BYTES
    return count or (0 if is_empty else None)
