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

"""Calibration of one camera from views of a board."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray
from opencv_tools.calibration.boards import CalibrationError
from opencv_tools.calibration.corners import LEAST_CORNERS
from opencv_tools.calibration.detection import Detection
from opencv_tools.calibration.least_squares import (
    EQUIDISTANT, first_pose, fit_pose, Floats, Lens, MODELS, PLUMB_BOB, Points, residuals,
    solve_all, standard_deviations, start_lens)
from opencv_tools.calibration.views import cell_grid, cells_of, MOST_VIEWS

#: Least and largest number of views of a calibration.
LEAST_VIEWS = 4

# First focal lengths as parts of the width of the image.
_FOCAL_LENGTHS = (0.4, 0.7, 1.0, 1.6, 3.0)
_FIRST_ROUNDS = 12
_OUTLIER_MEDIANS, _OUTLIER_PIXELS, _OUTLIER_ROUNDS = 6.0, 0.5, 12
_HELD_OUT = 5  # every fifth view
_LEAST_BEND_SIGMAS, _LEAST_BEND_PART = 8.0, 0.002


@dataclass(frozen=True, kw_only=True)
class Calibration:
    """
    A calibrated lens, with the errors of the views that determined it.

    :param size: width and height of the images in pixels.
    :param model: distortion model of CameraInfo: ``plumb_bob``, ``rational_polynomial`` or
        ``equidistant``.
    :param k: camera matrix, (3, 3).
    :param d: distortion coefficients, (n,).
    :param p: projection matrix of the rectified image without black borders, (3, 4).
    :param rms: root mean square of the errors of all corners in pixels.
    :param view_errors: the same for each view; nan for one that was dropped.
    :param view_tilts: angle between each board and the image in degrees; nan as well.
    :param cell_errors: the same for each cell of the image, (rows, columns); nan without corners.
    :param deviations: standard deviations of fx, fy, cx, cy and ``d``.
    :param held_out: error of every fifth view for the lens of the other views; nan for fewer than
        10 views.
    :param dropped: part of the corners that do not fit the lens and were dropped.
    :param bend: largest height of a corner above the plane of the board in metres; 0.0 if the
        board is flat within the precision.
    """

    size: tuple[int, int]
    model: str
    k: Floats
    d: Floats
    p: Floats
    rms: float
    view_errors: Floats
    view_tilts: Floats
    cell_errors: Floats
    deviations: Floats
    held_out: float
    dropped: float
    bend: float


@dataclass(frozen=True)
class _Fit:
    """A lens, and the views with their poses by their number."""

    lens: Lens
    views: dict[int, Points]
    poses: dict[int, Floats]

    def errors(self) -> dict[int, Floats]:
        return dict(zip(self.views, residuals(
            self.lens, [*self.views.values()], [*self.poses.values()])))

    def solve(self, lens: Lens | None = None) -> _Fit:
        """Return the fit after the method of least squares, from another lens if one is given."""
        lens, poses = solve_all(lens or self.lens, [*self.views.values()], [*self.poses.values()])
        return _Fit(lens, self.views, dict(zip(self.views, poses)))


def solve(views: Sequence[Detection], model: str = PLUMB_BOB) -> Calibration:
    """
    Calibrate a camera.

    It takes at most a few seconds. Arguments and result can be sent to another process.

    :param views: boards in images of one size, ``LEAST_VIEWS`` to ``MOST_VIEWS``.
    :param model: one of ``MODELS``.
    :returns: the calibration.
    :raises CalibrationError: the views determine no lens.
    """
    size = check_views(views)
    if model not in MODELS:
        raise CalibrationError(f'the model is {model!r:.40}: give one of ' + ', '.join(MODELS))
    middle = np.concatenate([view.points for view in views]).mean(axis=0).astype(float)
    points = {number: Points(view.points - middle, view.corners.astype(float))
              for number, view in enumerate(views)}  # the bend is that around the middle
    first = _first_fit(model, size, points)
    fit = _without_outliers(first)
    bent = fit.solve(replace(fit.lens, is_bent=True))
    bend, is_bent = _bend(bent)
    if is_bent:  # corners of a bent board are no outliers
        fit = _without_outliers(first.solve(bent.lens))
    lens, held_out = fit.lens, _held_out(fit)
    deviations = standard_deviations(lens, [*fit.views.values()], [*fit.poses.values()])
    errors = fit.errors()
    view_errors, tilts = np.full(len(views), np.nan), np.full(len(views), np.nan)
    for number, error in errors.items():
        view_errors[number] = rms_of([error])
        tilts[number] = np.degrees(np.arccos(min(1.0, abs(
            cv2.Rodrigues(fit.poses[number][:3])[0][2, 2]))))
    return Calibration(
        size=size, model=model, k=lens.k, d=lens.d, p=projection(lens.k, lens.d, model, size),
        rms=rms_of(errors.values()), view_errors=view_errors, view_tilts=tilts,
        cell_errors=errors_by_cell(size, fit.views.values(), errors.values()),
        deviations=deviations[:len(lens.values)], held_out=held_out,
        dropped=1 - sum(map(len, errors.values())) / sum(len(view.ids) for view in views),
        bend=bend if is_bent else 0.0)


def check_views(views: Sequence[Detection], least: int = LEAST_VIEWS) -> tuple[int, int]:
    """
    Return the size of the images of views.

    :raises CalibrationError: the views are too few or too many, or their sizes differ.
    """
    if not least <= len(views) <= MOST_VIEWS:
        raise CalibrationError(f'views with the board: {len(views)}; give {least} to {MOST_VIEWS} '
                               'images in which the board is sharp and has different tilts')
    sizes = sorted({view.size for view in views})
    if len(sizes) > 1:
        raise CalibrationError('the images have different sizes: ' + ', '.join(
            f'{width}x{height}' for width, height in sizes[:4]) + '; give images of one size')
    return sizes[0]


def points_of(view: Detection) -> Points:
    """Return the corners of a view."""
    return Points(view.points.astype(float), view.corners.astype(float))


def rms_of(errors: Iterable[Floats]) -> float:
    """Return the root mean square of the lengths of errors, (n, 2) arrays; nan without one."""
    squares = [(error ** 2).sum(axis=1) for error in errors]
    return float(np.sqrt(np.concatenate(squares).mean())) if squares else float('nan')


def errors_by_cell(
    size: tuple[int, int], views: Iterable[Points], errors: Iterable[Floats],
) -> Floats:
    """Return the root mean square of the errors in each cell of the image, nan without corners."""
    total, count = np.zeros(cell_grid(size)), np.zeros(cell_grid(size))
    for view, error in zip(views, errors):
        rows, columns = cells_of(view.image, size)
        np.add.at(total, (rows, columns), (error ** 2).sum(axis=1))
        np.add.at(count, (rows, columns), 1)
    return np.where(count > 0, np.sqrt(total / np.maximum(count, 1)), np.nan)


def projection(k: Floats, d: Floats, model: str, size: tuple[int, int]) -> Floats:
    """Return P of CameraInfo for a rectified image of the same size without black borders."""
    if model == EQUIDISTANT:
        matrix = cv2.fisheye.estimateNewCameraMatrixForUndistortRectify(
            k, d, size, np.eye(3), balance=0.0)
    else:
        matrix = cv2.getOptimalNewCameraMatrix(k, d, size, 0)[0]
    return np.hstack((matrix, np.zeros((3, 1))))


def _first_fit(model: str, size: tuple[int, int], views: dict[int, Points]) -> _Fit:
    """Return the best fit from several first focal lengths."""
    fits = []
    for part in _FOCAL_LENGTHS:
        lens = start_lens(model, part * size[0], size)
        found = {}
        for number, view in views.items():
            try:
                found[number] = first_pose(lens, view)
            except (cv2.error, np.linalg.LinAlgError):
                continue  # the view is dropped if no other focal length fits it
        kept = {number: views[number] for number in found}
        if len(kept) >= LEAST_VIEWS:
            lens, poses = solve_all(lens, [*kept.values()], [*found.values()], _FIRST_ROUNDS)
            fits.append(_Fit(lens, kept, dict(zip(kept, poses))))
    usable = [one for one in fits if _is_lens(one.lens, size)]
    if not usable:
        raise CalibrationError(f'the views determine no lens of the model {model}: give views '
                               'with tilted boards, up to the edges of the image')
    most = max(len(one.views) for one in usable)
    best = min((one for one in usable if len(one.views) == most),
               key=lambda one: rms_of(one.errors().values()))
    return best.solve()


def _is_lens(lens: Lens, size: tuple[int, int]) -> bool:
    fx, fy, cx, cy = lens.values[:4]
    return bool(np.isfinite(lens.values).all() and 0.1 * size[0] < fx < 100 * size[0]
                and 0.5 < fx / fy < 2 and abs(cx) < 2 * size[0] and abs(cy) < 2 * size[1])


def _without_outliers(fit: _Fit) -> _Fit:
    """
    Return the fit without the corners and views whose errors are far above the others.

    A wrong corner moves all others, so that only the worst ones are removed at once.
    """
    counts = {number: len(view.image) for number, view in fit.views.items()}
    for _ in range(_OUTLIER_ROUNDS):
        errors = {number: np.linalg.norm(error, axis=1) for number, error in fit.errors().items()}
        median = float(np.median(np.concatenate([*errors.values()])))
        worst = max(float(error.max()) for error in errors.values())
        limit = max(_OUTLIER_MEDIANS * median, _OUTLIER_PIXELS, worst / 2)
        keeps = {number: error <= limit for number, error in errors.items()}
        views = {number: Points(view.board[keeps[number]], view.image[keeps[number]])
                 for number, view in fit.views.items()
                 if keeps[number].sum() >= max(LEAST_CORNERS, counts[number] / 2)}
        if len(views) < LEAST_VIEWS or all(keep.all() for keep in keeps.values()):
            break
        fit = _Fit(fit.lens, views, {number: _better_pose(fit.lens, view, fit.poses[number])
                                     for number, view in views.items()}).solve()
    return fit


def _better_pose(lens: Lens, view: Points, pose: Floats) -> Floats:
    """Return a new pose if it is better; the first one was mirrored if the lens was far off."""
    try:
        new = first_pose(lens, view)
    except (cv2.error, np.linalg.LinAlgError):
        return pose
    errors = [rms_of(residuals(lens, [view], [one])) for one in (pose, new)]
    return new if errors[1] < errors[0] else pose


def _held_out(fit: _Fit) -> float:
    """Return the error of every fifth view for the lens of the others."""
    numbers = [*fit.views]
    held = numbers[_HELD_OUT // 2::_HELD_OUT]
    if len(numbers) < 2 * _HELD_OUT:
        return float('nan')
    others = [number for number in numbers if number not in held]
    rest = _Fit(fit.lens, {number: fit.views[number] for number in others},
                {number: fit.poses[number] for number in others}).solve()
    views = [fit.views[number] for number in held]
    poses = [fit_pose(rest.lens, fit.views[number], fit.poses[number]) for number in held]
    return rms_of(residuals(rest.lens, views, poses))


def _bend(fit: _Fit) -> tuple[float, bool]:
    """Return the largest height of a corner in metres, and whether it is not by chance."""
    deviations = standard_deviations(fit.lens, [*fit.views.values()], [*fit.poses.values()])
    bend, sigmas = fit.lens.bend, deviations[-3:]
    places: NDArray[np.float64] = np.unique(
        np.concatenate([view.board[:, :2] for view in fit.views.values()]), axis=0)
    x, y = places.T
    heights = np.stack((x * x, x * y, y * y), axis=1) @ bend
    plane = np.column_stack((places, np.ones(len(places))))
    heights -= plane @ np.linalg.lstsq(plane, heights, rcond=None)[0]
    height, length = float(np.abs(heights).max()), float(np.ptp(places, axis=0).max())
    is_certain = bool((np.abs(bend) > _LEAST_BEND_SIGMAS * sigmas).any())
    return height, is_certain and height > _LEAST_BEND_PART * length
