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

"""Whether the link to a page carries the video of a topic."""

from __future__ import annotations

from collections.abc import Callable

#: Bits per second of the video for a slow link.
SLOW_BIT_RATE = 1_000_000

# A page that falls behind twice within this time has a slow link.
_WINDOW_SECONDS = 10.0
# Seconds until the video of the topic is tried again, and their maximum after failures.
_FIRST_TRIAL, _LAST_TRIAL = 30.0, 600.0


class VideoLink:
    """The link of a page, which is slow while the page falls behind with the video of a topic."""

    def __init__(self, clock: Callable[[], float]) -> None:
        """
        Begin with a link that is not slow.

        :param clock: monotonic clock in seconds.
        """
        #: Monotonic clock in seconds.
        self.clock = clock
        self._behind_at: float | None = None
        self._trial_seconds = _FIRST_TRIAL
        self._slow_until: float | None = None  # None before the first failure

    @property
    def is_slow(self) -> bool:
        """Whether the page gets a video of ``SLOW_BIT_RATE``."""
        return self._slow_until is not None and self.clock() < self._slow_until

    def fell_behind(self) -> None:
        """Use that the page has not answered in time."""
        now, before = self.clock(), self._behind_at
        self._behind_at = now
        if self.is_slow or before is None or now - before > _WINDOW_SECONDS:
            return
        if self._slow_until is not None and now - self._slow_until < self._trial_seconds:
            self._trial_seconds = min(2 * self._trial_seconds, _LAST_TRIAL)
        else:
            self._trial_seconds = _FIRST_TRIAL
        self._slow_until = now + self._trial_seconds
        self._behind_at = None
