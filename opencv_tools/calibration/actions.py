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

"""Actions of img_calibrate: files are written here only."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from opencv_tools.calibration.boards import Board, CalibrationError
from opencv_tools.calibration.camera_file import StoredCamera, write_camera
from opencv_tools.calibration.check import check_camera, GOOD, stored_camera
from opencv_tools.calibration.report import report_calibration, report_check, report_search
from opencv_tools.calibration.solve import solve
from opencv_tools.calibration.stereo import solve_stereo
from opencv_tools.calibration.verdict import BAD, judge
from opencv_tools.calibration.view_search import FoundViews


def check_found(camera: StoredCamera, found: FoundViews, board: Board) -> bool:
    """Check a calibration, print the result, and return whether it is good."""
    report_search(found, board)
    result = check_camera(camera, found.views[0])
    report_check(result)
    return result.word == GOOD


def calibrate_found(
    found: FoundViews, board: Board, model: str, name: str, paths: Sequence[Path],
) -> bool:
    """
    Calibrate one camera or two, print a report, and write the files if all are usable.

    :param found: views of each camera; those of two cameras are pairs.
    :param name: name of the camera in the file.
    :param paths: files, one for each camera; empty for none.
    :returns: whether the calibration is usable.
    :raises CalibrationError: the views determine no calibration.
    :raises CameraInfoError: a file cannot be written.
    """
    names = [''] if len(found.views) < 2 else ['left', 'right']
    try:
        lenses = [solve(one, model) for one in found.views]
        is_usable = all(judge(lens).word != BAD for lens in lenses)
        stereo = solve_stereo([*zip(*found.views)], *lenses) if is_usable and names[0] else None
        parts = (stereo.left, stereo.right) if stereo else (None,)
        for path, lens, part, suffix in zip(paths if is_usable else (), lenses, parts, names):
            camera = stored_camera(lens, part.r, part.p) if part else stored_camera(lens)
            write_camera(path, camera, f'{name}_{suffix}' if suffix else name)
    finally:  # the files come first, because nobody may read the report
        report_search(found, board)
    for lens, one in zip(lenses, names):
        report_calibration(lens, one)
    if not is_usable:
        raise CalibrationError('nothing was written, because the calibration is bad')
    if stereo:
        print(f'Baseline: {stereo.baseline:.6g} m from {stereo.pairs} pairs, '
              f'error {stereo.rms:.3f} pixels')
    for path in paths:
        print(f'Wrote {path}')
    return True
