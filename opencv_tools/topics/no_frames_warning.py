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

from opencv_tools.logs import Log
from opencv_tools.topics.rate_meter import RateMeter

_MIN_SECONDS = 3.0
_PERIODS = 3
# Weight of each check in the moving average of the period.


class NoFramesWarning:
    """Log why no frame arrives, three seconds or three periods after the last frame."""

    def __init__(self, log: Log, describe: Callable[[], str]) -> None:
        """
        Start waiting for frames.

        :param describe: returns the reason.
        """
        self._log = log
        self._describe = describe
        self._logged_reason = ''
        self._count = 0
        self._now = 0.0  # without the silence before each reset
        self.reset_period()

    def reset_period(self) -> None:
        """Reset the wait and the period, after a change of the publishers' topic."""
        self._meter = RateMeter(lambda: self._now)
        self._begin = self._warned_at = self._now

    def reset(self) -> None:
        """Reset the wait, but keep the period of the frames."""
        self._now -= self._silent_seconds
        self._warned_at = self._now

    def check(self, elapsed: float, count: int, topic: str, *, is_expected: bool) -> None:
        """
        Log the reason if frames are missing and the reason is new.

        :param elapsed: seconds since the last check.
        :param count: number of frames received until now.
        :param is_expected: whether silence is normal here; suppresses the warning.
        """
        received, self._count = count - self._count, count
        self._now += elapsed
        if received:
            self._meter.add(received)
            if self._logged_reason:
                self._logged_reason = ''
                self._log.info(f'Frames arrive on {topic}')
            return
        waited = min(self._silent_seconds, self._now - self._warned_at)
        if waited < max(_MIN_SECONDS, _PERIODS * self._meter.period):
            return
        self._warned_at = self._now
        reason = '' if is_expected else self._describe()
        if reason and reason != self._logged_reason:
            self._logged_reason = reason
            self._log.warning(f'No frames: {reason}')

    @property
    def _silent_seconds(self) -> float:
        silent = self._meter.silent_seconds
        return self._now - self._begin if silent is None else silent
