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

"""Frames that do not come: noticed, and told once with the reason."""

from __future__ import annotations

from collections.abc import Callable
import time

from opencv_tools.recording.trouble import Log

_LEAST_SECONDS = 3.0
_PERIODS = 3
# How much of the usual time between frames each frame makes.
_PERIOD_WEIGHT = 1 / 8


class Silence:
    """Say why no frame comes, three seconds or three periods after the last one."""

    def __init__(self, log: Log, describe: Callable[[], str]) -> None:
        """
        Begin to wait.

        :param log: where it is said.
        :param describe: gives the reason.
        """
        self._log = log
        self._describe = describe
        self._said = ''
        self.forget()

    def forget(self) -> None:
        """Wait for other publishers, of which nothing is known."""
        self._period = 0.0
        self.begin()

    def begin(self) -> None:
        """Wait anew, though the frames may come as often as before."""
        self._frame_at = self._waited = self._told_at = 0.0

    def end(self, topic: str) -> None:
        """Take note of a frame."""
        now = time.monotonic()
        if self._frame_at:
            interval = now - self._frame_at
            self._period += (interval - self._period) * (_PERIOD_WEIGHT if self._period else 1)
        self._frame_at = now
        self._waited = self._told_at = 0.0
        if self._said:
            self._said = ''
            self._log.info(f'Frames arrive on {topic}')

    def watch(self, elapsed: float, is_expected: bool) -> None:
        """
        Say why there are no frames, and say it again only when the reason is another.

        :param elapsed: seconds that none came.
        :param is_expected: that is as it should be.
        """
        self._waited += elapsed
        if self._waited - self._told_at < max(_LEAST_SECONDS, _PERIODS * self._period):
            return
        self._told_at = self._waited
        reason = '' if is_expected else self._describe()
        if reason and reason != self._said:
            self._said = reason
            self._log.warning(f'No frames: {reason}')
