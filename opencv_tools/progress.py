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

"""Progress of a stream of frames, on the console."""

from __future__ import annotations

from collections.abc import Callable
import shutil
import sys
import time
from typing import Any

from opencv_tools.logs import Log

_SECONDS_BETWEEN_LINES = 1.0


class Progress:
    """Count frames and log the progress at most once a second."""

    def __init__(self, write_line: Callable[[str], object], phrase: str) -> None:
        """
        Start counting.

        :param write_line: writes a line.
        :param phrase: activity, such as ``Publishing video frame``.
        """
        self.count = 0
        self._write_line = write_line
        self._phrase = phrase
        self._first_at = self._last_at = self._logged_at = 0.0
        self._logged_count = 0

    def tick(self, description: str, dropped: int, missed: int = 0) -> None:
        """
        Count a frame.

        :param description: description of the frame, such as ``640x480 bgr8``.
        :param dropped: number of frames lost so far.
        :param missed: number of camera frames not read in time so far; 0 is not shown.
        """
        self.count += 1
        now = self._last_at = time.monotonic()
        self._first_at = self._first_at or now
        if self._logged_at and now - self._logged_at < _SECONDS_BETWEEN_LINES:
            return
        since = now - self._logged_at
        rate = f'{(self.count - self._logged_count) / since:.1f} Hz, ' if self._logged_at else ''
        self._logged_at, self._logged_count = now, self.count
        self._show(f'{description}, {rate}{dropped} dropped'
                   + (f', {missed} missed' if missed else ''))

    def average_rate(self) -> float:
        """Return the mean frame rate in Hz, 0.0 for fewer than two frames."""
        seconds = self._last_at - self._first_at
        return (self.count - 1) / seconds if seconds > 0 else 0.0

    def close(self) -> None:
        """End the output."""

    def _show(self, state: str) -> None:
        self._write_line(f'{self._phrase} {self.count}: {state}')


class ProgressBar(Progress):
    """Show the progress in the last line of a terminal, with a bar if the total is known."""

    def __init__(self, log: Log, phrase: str, total: int) -> None:
        """
        Start counting.

        :param log: log whose lines appear above the bar, if written by ``info``, ``warning`` and
            ``error`` of this object.
        :param phrase: activity, such as ``Receiving video frame``.
        :param total: expected number of frames; 0 if unknown.
        """
        from tqdm import tqdm  # imported here, as it is slow and only terminals need it
        super().__init__(log.info, phrase)
        self._log = log
        size = shutil.get_terminal_size()  # terminals in containers may report a size of 0
        amount = '{n_fmt}/{total_fmt} |{bar}|' if total else '{n_fmt}'
        self._bar: Any = tqdm(
            total=total or None, desc=phrase, bar_format=f'{{desc}} {amount}{{postfix}}',
            file=sys.stderr, ncols=size.columns, nrows=size.lines)

    def info(self, message: str) -> None:
        """Log normal progress above the bar."""
        self._bar.clear()
        self._log.info(message)

    def warning(self, message: str) -> None:
        """Log a possible problem above the bar."""
        self._bar.clear()
        self._log.warning(message)

    def error(self, message: str) -> None:
        """Log a failure above the bar."""
        self._bar.clear()
        self._log.error(message)

    def close(self) -> None:
        """End the bar with the final count."""
        self._bar.n = self.count
        self._bar.close()

    def _show(self, state: str) -> None:
        self._bar.n = self.count
        self._bar.set_postfix_str(state)


def open_progress(log: Log, phrase: str, total: int) -> tuple[Log, Progress]:
    """
    Start showing progress: as a bar on a terminal, otherwise in the log.

    :param log: log of the node.
    :param phrase: activity, such as ``Receiving video frame``.
    :param total: expected number of frames; 0 if unknown.
    :returns: the log to use from now on, and the progress.
    """
    if not sys.stderr.isatty():
        return log, Progress(log.info, phrase)
    bar = ProgressBar(log, phrase, total)
    return bar, bar
