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

"""Width and quality of the pictures that a link can carry at the wanted rate."""

from __future__ import annotations

from opencv_tools.viewer.protocol import WIDTHS

# Pictures below this width are worse than a lower quality.
_LEAST_WIDTH = 320
_QUALITIES = (60, 40, 25)
# Weight of each answer in the moving averages.
_WEIGHT = 1 / 4
# Number of answers before a change, so that the averages describe the present size.
_LEAST_ANSWERS = 6
# Part of the available time that a picture may need before it is made smaller or larger.
_TOO_SLOW, _QUICK = 1.15, 0.5
# Seconds without a delay before larger pictures are tried, and their maximum after failures.
_FIRST_TRIAL, _LAST_TRIAL = 3.0, 60.0
# A smaller picture that arrives hardly sooner shows that the link is far, not slow.
_FAR = 0.85
#: Maximum number of unanswered pictures of a topic.
MAX_WINDOW = 2


class LinkRate:
    """
    Choose the size of pictures from the times of their answers.

    Width goes down first, then quality. If smaller pictures do not arrive sooner, the round trip
    takes the time. Then two pictures may be on their way instead of one.
    """

    def __init__(self, width: int, quality: int, fixed: bool = False) -> None:
        """
        Start with the wanted size.

        :param width: wanted width in pixels.
        :param quality: wanted JPEG quality.
        :param fixed: whether the size never changes.
        """
        self._levels = [(width, quality)]
        if not fixed:
            widths = [step for step in reversed(WIDTHS) if _LEAST_WIDTH <= step < width]
            self._levels += [(step, quality) for step in widths]
            self._levels += [(self._levels[-1][0], lower) for lower in _QUALITIES
                             if lower < quality]
        self._level = 0
        self._before: float | None = None  # seconds that a picture needed at the larger size
        self._trial_seconds = _FIRST_TRIAL
        self._trial_at: float | None = None
        self._raised_at: float | None = None
        #: Number of pictures that may be unanswered.
        self.window = 1
        #: Rate of the link in bytes a second, at least; None before the first answer.
        self.bytes_per_second: float | None = None
        self._reset()

    @property
    def width(self) -> int:
        """Return the width of the next picture in pixels."""
        return self._levels[self._level][0]

    @property
    def quality(self) -> int:
        """Return the JPEG quality of the next picture."""
        return self._levels[self._level][1]

    @property
    def is_lowered(self) -> bool:
        """Return whether pictures are smaller than wanted."""
        return self._level > 0

    def answered(self, size: int, seconds: float, period: float, now: float) -> None:
        """
        Use the time of an answer.

        :param size: size of the picture in bytes.
        :param seconds: time from sending to the answer.
        :param period: wanted time between pictures in seconds.
        :param now: monotonic clock in seconds.
        """
        rate = size / max(seconds, 1e-6)
        self.bytes_per_second = (rate if self.bytes_per_second is None else
                                 self.bytes_per_second + (rate - self.bytes_per_second) * _WEIGHT)
        self._seconds += (seconds - self._seconds) * (_WEIGHT if self._answers else 1)
        self._answers += 1
        if self._answers < _LEAST_ANSWERS:
            return
        available = period * self.window
        if self._seconds > _TOO_SLOW * available:
            self._trial_at = None
            self._lower(now)
        elif self._level and self._seconds < _QUICK * available:
            self._trial_at = self._trial_at or now + self._trial_seconds
            if now >= self._trial_at:
                self._change(-1)
                self._raised_at = now
        else:
            self._trial_at = None

    def _lower(self, now: float) -> None:
        """Make the pictures smaller, or allow a second one if that has not helped."""
        if self._raised_at is not None and now - self._raised_at < self._trial_seconds:
            self._trial_seconds = min(2 * self._trial_seconds, _LAST_TRIAL)
        is_far = self._before is not None and self._seconds > _FAR * self._before
        if is_far and self.window < MAX_WINDOW:
            self.window = MAX_WINDOW
            self._change(-self._level)
        elif self._level + 1 < len(self._levels) and not is_far:
            before = self._seconds
            self._change(1)
            self._before = before

    def _change(self, steps: int) -> None:
        self._level += steps
        self._reset()

    def _reset(self) -> None:
        self._answers = 0
        self._seconds = 0.0
        self._before = None
        self._trial_at = None
