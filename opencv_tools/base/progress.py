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

from opencv_tools.base.logs import LineWriter, Log

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

    def tick(self, description: str, **lost: int) -> None:
        """
        Count a frame.

        :param description: description of the frame, such as ``640x480 bgr8``.
        :param lost: numbers of frames lost so far, named as in the summary of the node, such as
            ``dropped``. The first is always shown, the others only above 0.
        """
        self.count += 1
        now = self._last_at = time.monotonic()
        self._first_at = self._first_at or now
        if self._logged_at and now - self._logged_at < _SECONDS_BETWEEN_LINES:
            return
        since = now - self._logged_at
        rate = f'{(self.count - self._logged_count) / since:.1f} Hz, ' if self._logged_at else ''
        self._logged_at, self._logged_count = now, self.count
        counts = [f'{count} {name}' for number, (name, count) in enumerate(lost.items())
                  if number == 0 or count]
        self._show(f'{description}, {rate}{", ".join(counts)}')

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

    def __init__(self, writer: LineWriter, phrase: str, total: int) -> None:
        """
        Start counting.

        :param writer: destination of the lines that this object writes above the bar.
        :param phrase: activity, such as ``Receiving video frame``.
        :param total: expected number of frames; 0 if unknown.
        """
        from tqdm import tqdm  # imported here, as it is slow and only terminals need it
        super().__init__(writer.info, phrase)
        self._writer = writer
        size = shutil.get_terminal_size()  # terminals in containers may report a size of 0
        amount = '{n_fmt}/{total_fmt} |{bar}|' if total else '{n_fmt}'
        self._bar: Any = tqdm(
            total=total or None, desc=phrase, bar_format=f'{{desc}} {amount}{{postfix}}',
            file=sys.stderr, ncols=size.columns, nrows=size.lines)

    def debug(self, message: str, /) -> None:
        """Write a detail for developers above the bar."""
        self._bar.clear()
        self._writer.debug(message)

    def info(self, message: str, /) -> None:
        """Write normal progress above the bar."""
        self._bar.clear()
        self._writer.info(message)

    def warning(self, message: str, /) -> None:
        """Write a possible problem above the bar."""
        self._bar.clear()
        self._writer.warning(message)

    def error(self, message: str, /) -> None:
        """Write a failure above the bar."""
        self._bar.clear()
        self._writer.error(message)

    def close(self) -> None:
        """End the bar with the final count."""
        self._bar.n = self.count
        self._bar.close()

    def _show(self, state: str) -> None:
        self._bar.n = self.count
        self._bar.set_postfix_str(state)


def open_progress(writer: LineWriter, phrase: str, total: int) -> tuple[Log, Progress]:
    """
    Start showing progress: as a bar on a terminal, otherwise in the log.

    :param writer: destination of the lines, such as the logger of the node.
    :param phrase: activity, such as ``Receiving video frame``.
    :param total: expected number of frames; 0 if unknown.
    :returns: the log to use from now on, and the progress.
    """
    if not sys.stderr.isatty():
        log = Log(writer)
        return log, Progress(log.info, phrase)
    bar = ProgressBar(writer, phrase, total)
    return Log(bar), bar
