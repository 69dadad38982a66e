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

"""Warning when no frames arrive, logged once with the reason."""

from __future__ import annotations

from collections.abc import Callable
import time

from opencv_tools.logs import Log

_MIN_SECONDS = 3.0
_PERIODS = 3
# Weight of each interval in the moving average of the period.
_PERIOD_WEIGHT = 1 / 8


class NoFramesWarning:
    """Log why no frame arrives, three seconds or three periods after the last frame."""

    def __init__(self, log: Log, describe: Callable[[], str]) -> None:
        """
        Start waiting for frames.

        :param log: log for the warning.
        :param describe: returns the reason.
        """
        self._log = log
        self._describe = describe
        self._logged_reason = ''
        self.reset_period()

    def reset_period(self) -> None:
        """Reset the wait and the period, after a change of the publishers' topic."""
        self._period = 0.0
        self.reset()

    def reset(self) -> None:
        """Reset the wait, but keep the period of the frames."""
        self._frame_at = self._waited = self._logged_at = 0.0

    def frame_received(self, topic: str) -> None:
        """Record a received frame."""
        now = time.monotonic()
        if self._frame_at:
            interval = now - self._frame_at
            self._period += (interval - self._period) * (_PERIOD_WEIGHT if self._period else 1)
        self._frame_at = now
        self._waited = self._logged_at = 0.0
        if self._logged_reason:
            self._logged_reason = ''
            self._log.info(f'Frames arrive on {topic}')

    def check(self, elapsed: float, is_expected: bool) -> None:
        """
        Log the reason if frames are missing and the reason is new.

        :param elapsed: seconds since the last check.
        :param is_expected: whether silence is normal here; suppresses the warning.
        """
        self._waited += elapsed
        if self._waited - self._logged_at < max(_MIN_SECONDS, _PERIODS * self._period):
            return
        self._logged_at = self._waited
        reason = '' if is_expected else self._describe()
        if reason and reason != self._logged_reason:
            self._logged_reason = reason
            self._log.warning(f'No frames: {reason}')
