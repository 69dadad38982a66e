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

"""The report of img_calibrate on standard output."""

from __future__ import annotations

import numpy as np
from opencv_tools.calibration.boards import Board, CHARUCO
from opencv_tools.calibration.check import Check
from opencv_tools.calibration.least_squares import Floats
from opencv_tools.calibration.solve import Calibration
from opencv_tools.calibration.verdict import judge
from opencv_tools.calibration.view_search import FoundViews

_SHOWN_REASONS = 4


def report_search(found: FoundViews, board: Board) -> None:
    """Print how many views were taken, and why the others were not."""
    taken = len(found.views[0])
    print(f'Views: {taken} of {found.searched} images')
    for reason, count in found.reasons.most_common(_SHOWN_REASONS):
        print(f'  {count} not taken: {reason}')
    if found.is_variant:
        print(f'The board has the other layout of {board.kind}: '
              + ('that of OpenCV before 4.6' if board.kind == CHARUCO else
                 'black borders of one cell'))


def report_check(result: Check) -> None:
    """Print the result of a check."""
    print(f'Error: {result.rms:.3f} pixels, {result.best:.3f} for a new calibration')
    print(_cells_text(result.cell_errors))
    print(f'Verdict: {result.word}' + (f'\n  {result.reason}' if result.reason else ''))


def report_calibration(lens: Calibration, name: str) -> None:
    """Print a calibration."""
    verdict = judge(lens)
    names = ['fx', 'fy', 'cx', 'cy', *(f'd{number}' for number in range(1, len(lens.d) + 1))]
    values = [lens.k[0, 0], lens.k[1, 1], lens.k[0, 2], lens.k[1, 2], *lens.d]
    print(f'Calibration{name and " " + name} of {lens.size[0]}x{lens.size[1]} pixels, '
          f'{lens.model}:')
    for key, value, deviation in zip(names, values, lens.deviations):
        print(f'  {key} {value:.6g} +- {deviation:.2g}')
    print(f'Error: {lens.rms:.3f} pixels'
          + (f', {lens.held_out:.3f} in views that were left out' if lens.held_out > 0 else ''))
    print(_cells_text(lens.cell_errors))
    print(f'Verdict: {verdict.word}')
    for reason in verdict.reasons:
        print(f'  {reason}')


def _cells_text(cells: Floats) -> str:
    rows = ['  ' + ' '.join('   - ' if np.isnan(value) else f'{value:5.2f}' for value in row)
            for row in cells]
    return '\n'.join(('Error by part of the image in pixels:', *rows))
