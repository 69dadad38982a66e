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

"""Check of an existing calibration with new views of a board."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from opencv_tools.calibration.boards import CalibrationError
from opencv_tools.calibration.camera_file import StoredCamera
from opencv_tools.calibration.detection import Detection
from opencv_tools.calibration.least_squares import (
    first_pose, Floats, Lens, MODELS, Points, residuals, solve_all)
from opencv_tools.calibration.solve import (
    Calibration, check_views, errors_by_cell, points_of, rms_of)
from opencv_tools.calibration.views import place_in_words

GOOD, DEGRADED = 'good', 'degraded'

# A calibration is degraded if its error exceeds that of a new one with the same views by this
# factor and this number of pixels, or if it exceeds the limit.
_RATIO, _MORE_PIXELS, _LIMIT_PIXELS = 1.5, 0.2, 1.5


@dataclass(frozen=True, kw_only=True)
class Check:
    """
    The result of a check.

    :param word: ``good`` or ``degraded``.
    :param reason: by how much and where the calibration is degraded; '' if it is good.
    :param rms: root mean square of the errors of all corners in pixels.
    :param best: the same for a new calibration with these views.
    :param view_errors: error of each view in pixels.
    :param cell_errors: error in each cell of the image, (rows, columns); nan without corners.
    """

    word: str
    reason: str
    rms: float
    best: float
    view_errors: Floats
    cell_errors: Floats


def check_camera(camera: StoredCamera, views: Sequence[Detection]) -> Check:
    """
    Check a calibration.

    :param views: boards in new images of the same size.
    :returns: the errors of the calibration.
    :raises CalibrationError: the views do not suit the calibration.
    """
    size = check_views(views, least=1)
    if size != (camera.width, camera.height):
        raise CalibrationError(f'the images have {size[0]}x{size[1]} pixels, but the calibration '
                               f'is for {camera.width}x{camera.height}: give images of that size')
    lens = stored_lens(camera)
    points = [points_of(view) for view in views]
    try:
        poses = [first_pose(lens, view) for view in points]
    except (cv2.error, np.linalg.LinAlgError) as err:
        raise CalibrationError('the calibration fits no view: calibrate the camera again') from err
    errors = residuals(lens, points, poses)
    rms, best = rms_of(errors), _best(lens, points, poses)
    cells = errors_by_cell(size, points, errors)
    limit = min(max(_RATIO * best, best + _MORE_PIXELS), max(best, _LIMIT_PIXELS))
    reason = ''
    if not rms <= limit:
        row, column = np.unravel_index(np.nanargmax(cells), cells.shape)
        place = place_in_words(row, column, cells.shape)
        reason = (f'the error is {rms:.2f} pixels, that of a new calibration would be '
                  f'{best:.2f}; it is largest in the {place} of the image with '
                  f'{np.nanmax(cells):.2f} pixels: calibrate the camera again')
    return Check(word=DEGRADED if reason else GOOD, reason=reason, rms=rms, best=best,
                 view_errors=np.array([rms_of([error]) for error in errors]), cell_errors=cells)


def stored_camera(
    lens: Calibration, r: Floats | None = None, p: Floats | None = None,
) -> StoredCamera:
    """
    Return the content of the calibration file of a lens.

    :param r: rotation to the rectified camera, (3, 3); None for no rotation.
    :param p: projection matrix of the rectified image, (3, 4); None for that of the lens.
    """
    rows = [tuple(map(float, np.ravel(matrix))) for matrix in (
        lens.k, lens.d, np.eye(3) if r is None else r, lens.p if p is None else p)]
    return StoredCamera(width=lens.size[0], height=lens.size[1], distortion_model=lens.model,
                        k=rows[0], d=rows[1], r=rows[2], p=rows[3])


def stored_lens(camera: StoredCamera) -> Lens:
    """
    Return the lens of a calibration.

    :raises CalibrationError: its model is unknown.
    """
    count = MODELS.get(camera.distortion_model, 0)
    if not count or len(camera.d) > count or camera.k[0] <= 0 or camera.k[4] <= 0:
        raise CalibrationError(
            f'the calibration has the model {camera.distortion_model!r:.70} with {len(camera.d)} '
            'coefficients: give ' + ', '.join(f'{name} with {most}'
                                              for name, most in MODELS.items()))
    values = np.zeros(4 + count)
    values[:4] = camera.k[0], camera.k[4], camera.k[2], camera.k[5]
    values[4:4 + len(camera.d)] = camera.d
    return Lens(model=camera.distortion_model, values=values, bend=np.zeros(3))


def _best(lens: Lens, views: list[Points], poses: list[Floats]) -> float:
    """Return the error of the best lens of the same model."""
    better, poses = solve_all(lens, views, poses)
    return rms_of(residuals(better, views, poses))
