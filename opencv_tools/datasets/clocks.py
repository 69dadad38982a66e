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

"""Steps of the clocks of a topic: that of the stamps, and that of the recording."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from opencv_tools.base.units import NANO, STANDING
from opencv_tools.datasets.errors import DatasetError

#: A stamp that is further from the one before than the times of the recording is a jump.
JUMP_NS = NANO // 2
LOG_REMEDY = 'use --clock log for the times of the recording'
# By so much messages of a topic may be out of order in a file without a step of its clock.
_BACK_NS = NANO // 10
_STAY = 10  # messages on each side of a step of the clock


class Clocks:
    """
    Times of the messages of a topic by two clocks, in the order of the files.

    A reader sorts messages by the times of the recording, so that only the order in the files
    shows where a clock has stepped back.
    """

    def __init__(self, logs: NDArray[np.int64], stamps: NDArray[np.int64]) -> None:
        """
        Keep the times in nanoseconds.

        :param logs: (n,) times of the recording.
        :param stamps: (n,) stamps, 0 without one.
        """
        self._logs, self._stamps = logs, stamps

    @property
    def speed(self) -> float:
        """
        Seconds by the stamps in a second of the recording; 1.0 for one message.

        The longest time between two messages is left out, since a clock may step there.
        """
        steps, log_steps = np.diff(self._stamps), np.diff(self._logs)
        if len(steps) > 1:
            longest = int(np.argmax(log_steps))
            steps, log_steps = np.delete(steps, longest), np.delete(log_steps, longest)
        length = int(log_steps.sum())
        return int(steps.sum()) / length if length > 0 and self.log_jump >= 0 else 1.0

    @property
    def log_jump(self) -> int:
        """Largest jump in nanoseconds of the times of the recording alone; 0 for none."""
        logs, stamps = self._logs, self._stamps
        if len(logs) < 2 or not stamps.all():
            return 0
        back = int(np.diff(logs).min())
        if (_doubled(logs).any() and not _doubled(stamps).any()
                and stamps[-1] - stamps[0] > -back):
            return back
        longest = int(np.diff(np.sort(logs)).max())
        as_read = stamps[np.argsort(logs, kind='stable')]
        return longest if longest > int(np.diff(np.sort(stamps)).max()) + JUMP_NS and (
            np.diff(as_read) < -JUMP_NS).any() else 0

    @property
    def log_is_doubled(self) -> bool:
        """Whether a time of the recording is there twice."""
        return bool(_doubled(self._logs).any())

    def doubled(self, clock: str, *, is_video: bool) -> tuple[NDArray[np.bool_], str]:
        """
        Return which messages are in a time that is there twice, because a clock stepped back.

        :param clock: 'stamp' or 'log', which gives the times of the samples.
        :param is_video: whether the messages after a step cannot be decoded in another order.
        :returns: (n,) array, and a sentence about the step, '' if there is none.
        """
        found, in_stamps = _doubled(self._logs), _doubled(self._stamps)
        if self.log_jump and not (is_video and found.any()):
            return np.zeros_like(found), (
                f'the times of the recording jump by {self.log_jump / NANO:.3f} s, but not the '
                'stamps, whose order the rows have')
        if not found.any():
            step = self._stamp_step() if clock == 'stamp' else ''
            return in_stamps & bool(step), step
        both = bool((found & in_stamps).any())
        steps = np.diff(self._stamps if both and clock == 'stamp' else self._logs)
        if clock == 'stamp' and not is_video:
            found = in_stamps & both
        return found, (
            f'the clock steps back by {-steps.min() / NANO:.3f} s after message {steps.argmin()}, '
            f'in the {"stamps and the " * both}times of the recording')

    def _stamp_step(self) -> str:
        """Return a sentence about stamps that step back and stay behind; '' if they do not."""
        logs, stamps = self._logs, self._stamps
        if len(logs) < 2 * _STAY:
            return ''
        late, steps = np.lib.stride_tricks.sliding_window_view(logs - stamps, _STAY), np.diff(
            stamps)
        places = np.flatnonzero(steps[_STAY - 1:len(steps) - _STAY + 1] < 0)
        before = np.quantile(late[places], 0.75, axis=1)
        after = np.quantile(late[places + _STAY], 0.25, axis=1)
        found = places[after - before > -steps[places + _STAY - 1]] + _STAY - 1
        return '' if not len(found) else (
            f'the stamps step back by {-steps[found[0]] / NANO:.3f} s after message {found[0]} '
            'and stay behind, as after a change of the clock')

    def check_logs(self, shown: str) -> None:
        """
        Check that the times of the recording can be used; an error has the name that is shown.

        :raises DatasetError: they jump, but the stamps do not.
        """
        if self.log_jump:
            raise DatasetError(
                f'the times of the recording of {shown} jump by {self.log_jump / NANO:.3f} s, but '
                'its stamps do not; use --clock stamp')

    def check_stamps(self, shown: str) -> None:
        """
        Check that the stamps can be used; an error has the name that is shown.

        :raises DatasetError: some are zero, or they stand still or jump.
        """
        stamps = self._stamps
        if not stamps.all():
            raise DatasetError(f'{np.count_nonzero(stamps == 0)} stamps of {shown} are zero; '
                               f'{LOG_REMEDY}')
        if 0 <= self.speed * STANDING < 1:
            raise DatasetError(f'the stamps of {shown} stand still; {LOG_REMEDY}')
        steps, log_steps = np.diff(stamps), np.diff(self._logs)
        jumps = (steps < np.minimum(log_steps, 0) - JUMP_NS) | (
            steps > np.maximum(log_steps, 0) + JUMP_NS)
        if jumps.any() and not self.log_jump and not self.doubled(
                'stamp', is_video=False)[0].any():
            at = int(np.argmax(jumps))
            raise DatasetError(f'the stamps of {shown} jump by {steps[at] / NANO:.3f} s after '
                               f'message {at}; {LOG_REMEDY}')


def _doubled(times: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Return which times, in the order of the files, are in a time that is there twice."""
    back = np.flatnonzero(np.diff(times) < -_BACK_NS)
    low, high = (call.accumulate(times)[back] for call in (np.minimum, np.maximum))
    least, most = (call.accumulate(times[::-1])[::-1][back + 1]
                   for call in (np.minimum, np.maximum))
    starts, ends = np.maximum(low, least), np.minimum(high, most)
    are_twice = starts <= ends
    starts, ends = np.sort(starts[are_twice]), np.sort(ends[are_twice])
    found: NDArray[np.bool_] = (np.searchsorted(starts, times, side='right')
                                > np.searchsorted(ends, times))
    return found
