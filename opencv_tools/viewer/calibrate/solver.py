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

"""Solution of a calibration in a process of its own, which the server can end."""

from __future__ import annotations

import asyncio
from asyncio.subprocess import DEVNULL, PIPE, Process
from collections.abc import Sequence
from contextlib import suppress
import os
import pickle
import sys
from typing import cast

from opencv_tools.calibration.boards import CalibrationError
from opencv_tools.calibration.detection import Detection
from opencv_tools.calibration.least_squares import MODELS
from opencv_tools.calibration.solve import Calibration, solve
from opencv_tools.calibration.verdict import judge, Verdict

_SECONDS = 120.0
_NICE = 5  # pictures are more urgent
# The working directory, which -m and -c add to the path, may have any modules.
_SCRIPT = 'import sys; sys.path[:] = {!r}; from {} import main; main()'


def check_model(model: object) -> None:
    """
    Check the name of a distortion model.

    :raises CalibrationError: there is no such model.
    """
    if not isinstance(model, str) or model not in MODELS:
        raise CalibrationError(f'the model is {model!r:.40}: give one of ' + ', '.join(MODELS))


class Solver:
    """A process that solves one calibration."""

    def __init__(self) -> None:
        self._process: Process | None = None

    async def solve(
        self, views: Sequence[Detection], model: str,
    ) -> tuple[Calibration, Verdict]:
        """
        Return the calibration and the verdict on it.

        :raises CalibrationError: the views determine no lens, or the process was ended.
        """
        # Both ends of the pipes are ours, so pickle is safe.
        self._process = await asyncio.create_subprocess_exec(
            sys.executable, '-c', _SCRIPT.format(sys.path, __name__), stdin=PIPE, stdout=PIPE,
            stderr=DEVNULL, start_new_session=True)
        try:
            output, _ = await asyncio.wait_for(
                self._process.communicate(pickle.dumps((list(views), model))), _SECONDS)
        except asyncio.TimeoutError as err:
            raise CalibrationError(
                f'there was no solution within {_SECONDS:g} s: delete some views') from err
        finally:
            self.close()
        if not output:
            raise CalibrationError('the solution was ended')
        found, problem = pickle.loads(output)
        if problem:
            raise CalibrationError(problem)
        return cast('tuple[Calibration, Verdict]', found)

    @property
    def is_running(self) -> bool:
        """Whether there is a process that has not ended."""
        return self._process is not None and self._process.returncode is None

    def close(self) -> None:
        """End the process."""
        if self._process and self.is_running:
            with suppress(ProcessLookupError):
                self._process.kill()


def main() -> None:
    """Read views from standard input, and write their calibration to standard output."""
    os.nice(_NICE)
    views, model = pickle.load(sys.stdin.buffer)
    found, problem = None, ''
    try:
        calibration = solve(views, model)
        found = calibration, judge(calibration)
    except CalibrationError as err:
        problem = str(err)
    pickle.dump((found, problem), sys.stdout.buffer)
