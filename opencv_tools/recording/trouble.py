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

"""What goes wrong with a recording, said once each and not for every frame."""

from __future__ import annotations

from collections import OrderedDict
import re
from threading import Lock
import time
from typing import Protocol

from opencv_tools.image.text import printable

_MAX_REASONS = 20  # that are remembered
_MAX_REASON = 400  # characters
# Lines that may follow each other at once, and how many a second may follow for ever.
_BURST = 10
_LINES_A_SECOND = 1.0
# What FFmpeg's errors look like: '[Errno 542398533] Generic error: 'detail'; last error log: ...'.
_LIBRARY_ERROR = re.compile(r"\[Errno -?[0-9]+\] ([^:'\"]+)(?:: '.*)?", re.DOTALL)
_FFMPEG_ERROR = re.compile(r'\[Errno -?[0-9]{5,}\]')
# A number or a size; bgr8 and 32FC1 are names.
_NUMBER = re.compile(r'\b[0-9]+(?:x[0-9]+)?\b')
_NOT_LOGGED = '-'  # the outage of frames whose reason was left out
_FFMPEG_REMEDY = '; set the extension of file_name to .png or .npy, which hold any size'


class Log(Protocol):
    """Where a node says how it goes."""

    def info(self, message: str) -> object:
        """Say what is as it should be."""

    def warning(self, message: str) -> object:
        """Say what may not be wanted."""

    def error(self, message: str) -> object:
        """Say what failed."""


class Troubles:
    """
    Log what failed when it begins and when it is over; more than one thread may call.

    Reasons that differ in their numbers only are one. However many there are, a few lines may
    follow each other at once, and one a second. The next line counts those that were left out.
    """

    def __init__(self, log: Log) -> None:
        """Expect no trouble."""
        self._log = log
        self._lock = Lock()
        self._reasons: OrderedDict[str, None] = OrderedDict()
        self._outage = ''
        self._failed_since = 0
        self._left_out = 0
        self._allowed = float(_BURST)
        self._allowed_at = time.monotonic()

    def failed(self, reason: str) -> None:
        """
        Count a frame that nothing can be made of.

        :param reason: why; it is logged once, for the next such frame is no better, and again when
            many other reasons came in between.
        """
        key = _cause(reason)
        with self._lock:
            if key in self._reasons:
                self._reasons.move_to_end(key)
                return
            line = self._line(reason)
            if line:
                self._reasons[key] = None
                if len(self._reasons) > _MAX_REASONS:
                    self._reasons.popitem(last=False)
        if line:
            self._log.error(line)

    def outage(self, reason: str) -> None:
        """
        Count a frame that could not be written.

        :param reason: why; it is logged again when it changes, or when it comes back.
        """
        key = _cause(reason)
        line = ''
        with self._lock:
            self._failed_since += 1
            if key != self._outage:
                line = self._line(reason)
                # One that was left out is new when it comes again.
                self._outage = key if line else self._outage or _NOT_LOGGED
        if line:
            self._log.error(line)

    def written(self) -> None:
        """Log that a frame was written: what kept others from it is over."""
        if not self._outage:
            return
        with self._lock:
            if not self._outage:
                return
            count, self._failed_since, self._outage = self._failed_since, 0, ''
            line = self._line(f'Writing again; {count} frames were not written')
            if not line:  # the next frame tells
                self._failed_since, self._outage = count, _NOT_LOGGED
                self._left_out -= 1
        if line:
            self._log.info(line)

    def _line(self, reason: str) -> str:
        """Return a line to log, '' when there were too many; the caller has the lock."""
        now = time.monotonic()
        self._allowed = min(
            float(_BURST), self._allowed + (now - self._allowed_at) * _LINES_A_SECOND)
        self._allowed_at = now
        if self._allowed < 1:
            self._left_out += 1
            return ''
        self._allowed -= 1
        left_out, self._left_out = self._left_out, 0
        return plain_reason(reason) + (f' (and {left_out} more)' if left_out else '')


def plain_reason(reason: str) -> str:
    """
    Write a reason in one printable line, without what only programmers of a library understand.

    :param reason: a sentence that may end in an error of FFmpeg.
    :returns: the sentence with the words of the error, and what helps.
    """
    plain = _LIBRARY_ERROR.sub(lambda found: found[1].strip(), reason)
    if _FFMPEG_ERROR.search(reason):
        plain += _FFMPEG_REMEDY
    return printable(plain, _MAX_REASON)


def _cause(reason: str) -> str:
    """Return what reasons have in common that differ in their numbers."""
    return _NUMBER.sub('0', reason[:_MAX_REASON])


class Throttle:
    """Let something be said at most once a second."""

    def __init__(self, seconds: float = 1.0) -> None:
        """Let the first pass."""
        self._seconds = seconds
        self._passed_at = float('-inf')

    def passes(self) -> bool:
        """Tell whether it may be said now, and count on it that it is."""
        now = time.monotonic()
        if now - self._passed_at < self._seconds:
            return False
        self._passed_at = now
        return True
