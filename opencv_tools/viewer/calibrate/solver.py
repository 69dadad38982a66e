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
from collections.abc import Sequence
import pickle
import sys
from typing import cast

from opencv_tools.base.worker import begin_work, Worker, worker_command
from opencv_tools.calibration.boards import CalibrationError
from opencv_tools.calibration.detection import Detection
from opencv_tools.calibration.least_squares import MODELS
from opencv_tools.calibration.solve import Calibration, solve
from opencv_tools.calibration.verdict import judge, Verdict

_SECONDS = 120.0


def check_model(model: object) -> None:
    """
    Check the name of a distortion model.

    :raises CalibrationError: there is no such model.
    """
    if not isinstance(model, str) or model not in MODELS:
        raise CalibrationError(f'the model is {model!r:.40}: give one of ' + ', '.join(MODELS))


class Solver(Worker):
    """A process that solves one calibration."""

    async def solve(
        self, views: Sequence[Detection], model: str,
    ) -> tuple[Calibration, Verdict]:
        """
        Return the calibration and the verdict on it.

        :raises CalibrationError: the views determine no lens, or the process was ended.
        """
        # Both ends of the pipes are ours, so pickle is safe.
        try:
            output = await self.run(
                worker_command(__name__), pickle.dumps((list(views), model)), _SECONDS)
        except asyncio.TimeoutError as err:
            raise CalibrationError(
                f'there was no solution within {_SECONDS:g} s: delete some views') from err
        if not output:
            raise CalibrationError('the solution was ended')
        found, problem = pickle.loads(output)
        if problem:
            raise CalibrationError(problem)
        return cast('tuple[Calibration, Verdict]', found)


def main() -> None:
    """Read views from standard input, and write their calibration to standard output."""
    begin_work()
    views, model = pickle.load(sys.stdin.buffer)
    found, problem = None, ''
    try:
        calibration = solve(views, model)
        found = calibration, judge(calibration)
    except CalibrationError as err:
        problem = str(err)
    pickle.dump((found, problem), sys.stdout.buffer)
