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

"""Interface of a log, and a limit on the rate of its lines."""

from __future__ import annotations

import time
from typing import Protocol


class Log(Protocol):
    """Logging methods of a node."""

    def info(self, message: str) -> object:
        """Log normal progress."""

    def warning(self, message: str) -> object:
        """Log a possible problem."""

    def error(self, message: str) -> object:
        """Log a failure."""


class Throttle:
    """Limit an action to once per period."""

    def __init__(self, seconds: float = 1.0) -> None:
        """
        Allow the first action.

        :param seconds: period in seconds.
        """
        self._seconds = seconds
        self._passed_at = float('-inf')

    def passes(self) -> bool:
        """Return whether the action may happen now; if so, a new period begins."""
        now = time.monotonic()
        if now - self._passed_at < self._seconds:
            return False
        self._passed_at = now
        return True
