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

"""
The errors of recordings, and a log that repeats no line for every frame.

::

    RecordingError       an output folder cannot be used
    LimitReached         a recording has reached its limits
    ImageError           see opencv_tools.image.errors
    ├─ UnwritableError   a file format cannot hold a frame
    └─ VideoError        the error of opencv_tools.image.errors, which is importable here too
"""

from __future__ import annotations

from collections.abc import Callable
import re
from threading import Lock
import time
from typing import Literal

from opencv_tools.base.logs import Log, Throttle
from opencv_tools.base.text import printable
from opencv_tools.image.errors import ImageError, VideoError

__all__ = ['LimitReached', 'RecordingError', 'UnwritableError', 'Unwritten', 'VideoError',
           'error_text']

_MAX_REASON = 400  # characters
_BURST = 10  # lines without a delay; then there is one per second
# FFmpeg's errors have the form '[Errno 542398533] Generic error: 'detail'; last error log: ...'.
_LIBRARY_ERROR = re.compile(r"\[Errno -?[0-9]+\] ([^:'\"]+)(?:: '.*)?", re.DOTALL)
_FFMPEG_ERROR = re.compile(r'frame cannot be encoded as .*\[Errno -?[0-9]{5,}\]', re.DOTALL)
# A number or a size, but not a name such as bgr8 or 32FC1.
_NUMBER = re.compile(r'\b[0-9]+(?:x[0-9]+)?\b')
_NOT_LOGGED = '-'  # an outage whose reason was not logged
_FFMPEG_REMEDY = '; set the extension of file_name to .png or .npy, which hold any size'


class RecordingError(Exception):
    """An output folder cannot be used; the message includes the reason."""


class LimitReached(Exception):
    """A recording has reached its limits."""


class UnwritableError(ImageError):
    """A file format cannot hold a frame; the message names one that can."""


def error_text(err: Exception) -> str:
    """Return the text of an error, without a file name that differs for every frame."""
    return (err.strerror if isinstance(err, OSError) else str(err)) or type(err).__name__


class Unwritten(str):
    """The reason why a frame, or a part of a batch of messages, was not written."""

    #: The count that has it.
    kind: Literal['dropped', 'failed', 'not processed', 'skipped']

    def __new__(
        cls, reason: str, kind: Literal['dropped', 'failed', 'not processed', 'skipped'],
    ) -> Unwritten:
        """Create a reason."""
        created = super().__new__(cls, reason)
        created.kind = kind
        return created


class FailureLog:
    """
    Log the first of similar failures and the end of an outage; thread-safe.

    Reasons that differ only in numbers are the same reason. The rate of lines is limited: ten
    lines may follow each other at once, then one per second. The next line counts skipped lines.
    """

    def __init__(self, log: Log) -> None:
        self._log = log
        self._lock = Lock()
        self._reasons = Throttle()
        self._outage = ''
        self._failed_count = 0
        self._skipped = 0
        self._lines_end = 0.0  # each line takes a second from the end of the last one

    def bad_frame(self, reason: str) -> None:
        """
        Log a frame that cannot be read or encoded.

        :param reason: reason of the failure; logged once, and again after many other reasons.
        """
        key = _cause(reason)
        with self._lock:
            if self._reasons.passes(key) and not self._write(self._log.error, reason):
                self._skipped += 1
                self._reasons.forget(key)

    def write_failed(self, reason: str, frames: int = 1) -> None:
        """
        Log a frame that could not be written.

        :param reason: reason of the failure; it is logged again when it changes or recurs.
        :param frames: number of frames; 0 for messages of other topics.
        """
        key = _cause(reason)
        with self._lock:
            self._failed_count += frames
            if key != self._outage:
                if self._write(self._log.error, reason):
                    self._outage = key
                else:  # the reason is new when it recurs
                    self._skipped += 1
                    self._outage = self._outage or _NOT_LOGGED

    def write_succeeded(self) -> None:
        """Log the end of an outage, if there was one."""
        with self._lock:
            if not self._outage:
                return
            count = self._failed_count
            what = ('messages of topics were' if not count else '1 frame was' if count == 1
                    else f'{count} frames were')
            if self._write(self._log.info, f'Writing again; {what} not written'):
                self._failed_count, self._outage = 0, ''
            else:  # the next written frame logs it
                self._outage = _NOT_LOGGED

    def _write(self, write: Callable[[str], object], reason: str) -> bool:
        """Write a line, unless there were too many; the caller holds the lock."""
        now = time.monotonic()
        begin = max(self._lines_end, now)
        if begin - now > _BURST - 0.5:
            return False
        self._lines_end = begin + 1
        write(plain_reason(reason) + (f' (and {self._skipped} more)' if self._skipped else ''))
        self._skipped = 0
        return True


def plain_reason(reason: str) -> str:
    """
    Return a reason as one printable line without internal details of a library.

    :param reason: sentence that may end with an error of FFmpeg.
    :returns: the sentence with the text of the error, and a remedy for those of an encoder.
    """
    plain = _LIBRARY_ERROR.sub(lambda found: found[1].strip(), reason)
    if _FFMPEG_ERROR.search(reason):
        plain += _FFMPEG_REMEDY
    return printable(plain, _MAX_REASON)


def _cause(reason: str) -> str:
    """Return the part that reasons which differ only in numbers share."""
    return _NUMBER.sub('0', reason[:_MAX_REASON])
