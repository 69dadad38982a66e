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

"""
Least squares over a lens, the poses of the board, and the bend of the board.

OpenCV has one function for each lens, with different standard deviations and failures. This
module has the same steps for all models. The poses are eliminated from the normal equations, as
in the Schur complement of OpenCV 5.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

PLUMB_BOB, RATIONAL, EQUIDISTANT = 'plumb_bob', 'rational_polynomial', 'equidistant'
#: Number of distortion coefficients by name of the model in CameraInfo.
MODELS = {PLUMB_BOB: 5, RATIONAL: 8, EQUIDISTANT: 4}

_POSE = 6
_BEND = 3
_ROUNDS = 40
_TRIES = 8  # of a step with more damping
_CONVERGED = 1e-7  # relative change of the sum of squares
_WIDEST = 1.35  # radians from the axis for the first pose with a fisheye lens


@dataclass(frozen=True)
class Points:
    """
    Corners of one view.

    :param board: (n, 3) places on the board in metres.
    :param image: (n, 2) positions in pixels.
    """

    board: Floats
    image: Floats


@dataclass(frozen=True, kw_only=True)
class Lens:
    """
    A model of a lens and the bend of the board, as one vector of parameters.

    :param model: key of ``MODELS``.
    :param values: fx, fy, cx, cy and the distortion coefficients.
    :param bend: factors of x², x y and y² of the height of the board, in 1 / metre.
    :param is_bent: whether the bend is estimated.
    """

    model: str
    values: Floats
    bend: Floats
    is_bent: bool = False

    @property
    def k(self) -> Floats:
        """Camera matrix, a (3, 3) array."""
        fx, fy, cx, cy = self.values[:4]
        return np.array([(fx, 0, cx), (0, fy, cy), (0, 0, 1)])

    @property
    def d(self) -> Floats:
        """Distortion coefficients."""
        return self.values[4:]

    def moved(self, step: Floats) -> Lens:
        """Return the lens after a step of all estimated parameters."""
        count = len(self.values)
        return replace(self, values=self.values + step[:count],
                       bend=self.bend + step[count:] if self.is_bent else self.bend)


def start_lens(model: str, focal: float, size: tuple[int, int]) -> Lens:
    """Return a lens without distortion, whose axis is in the middle of the image."""
    width, height = size
    values = np.array([focal, focal, (width - 1) / 2, (height - 1) / 2, *[0.0] * MODELS[model]])
    return Lens(model=model, values=values, bend=np.zeros(_BEND))


def project(lens: Lens, board: Floats, pose: Floats) -> tuple[Floats, Floats, Floats]:
    """
    Project points of the board.

    :param board: (n, 3) places on the board in metres.
    :param pose: rotation vector and translation, (6,).
    :returns: (n, 2) positions, and their derivatives by the lens (2n, m) and the pose (2n, 6).
    """
    x, y = board[:, 0], board[:, 1]
    curves = np.stack((x * x, x * y, y * y), axis=1)
    lifted = board.copy()
    lifted[:, 2] += curves @ lens.bend
    arguments = lifted[:, None], pose[:3], pose[3:], lens.k, lens.d
    image: Any
    all_by: Any
    if lens.model == EQUIDISTANT:
        image, all_by = cv2.fisheye.projectPoints(*arguments)
        by_lens, by_pose = all_by[:, :8], all_by[:, 8:14]
    else:
        image, all_by = cv2.projectPoints(*arguments)
        by_lens, by_pose = all_by[:, 6:10 + len(lens.d)], all_by[:, :6]
    if lens.is_bent:
        normal = cv2.Rodrigues(pose[:3])[0][:, 2]
        by_height = (by_pose[:, 3:] @ normal)[:, None]
        by_lens = np.hstack((by_lens, by_height * np.repeat(curves, 2, axis=0)))
    return image.reshape(-1, 2), by_lens, by_pose


def residuals(lens: Lens, views: Sequence[Points], poses: Sequence[Floats]) -> list[Floats]:
    """Return the errors of all corners in pixels, an (n, 2) array for each view."""
    return [view.image - project(lens, view.board, pose)[0] for view, pose in zip(views, poses)]


def first_pose(lens: Lens, view: Points) -> Floats:
    """
    Return the pose of a board for a known lens.

    :raises cv2.error: the corners determine no pose.
    """
    undistort = cv2.fisheye.undistortPoints if lens.model == EQUIDISTANT else cv2.undistortPoints
    rays: Any = undistort(view.image[:, None], lens.k, lens.d)
    rays = rays.reshape(-1, 2)
    usable = (np.abs(rays) < np.tan(_WIDEST)).all(axis=1)
    _, rotation, place = cv2.solvePnP(view.board[usable], rays[usable], np.eye(3), None,
                                      flags=cv2.SOLVEPNP_IPPE)
    pose = np.concatenate((rotation, place)).reshape(-1)
    return fit_pose(lens, view, pose.astype(float))


def fit_pose(lens: Lens, view: Points, pose: Floats) -> Floats:
    """Return the pose of one view after a few steps with a fixed lens."""
    return solve_all(lens, [view], [pose], is_fixed=True)[1][0]


def solve_all(
    lens: Lens, views: Sequence[Points], poses: Sequence[Floats], rounds: int = _ROUNDS,
    is_fixed: bool = False,
) -> tuple[Lens, list[Floats]]:
    """
    Fit lens and poses by the method of Levenberg and Marquardt.

    :param poses: first estimates.
    :param is_fixed: whether the lens stays as it is.
    :returns: lens and poses with the least sum of squares that was found.
    """
    poses, damping = list(poses), 1e-3
    best = _sum(lens, views, poses)
    for _ in range(rounds):
        equations = _Equations(lens, views, poses)
        for _ in range(_TRIES):
            step, steps = equations.step(damping, is_fixed)
            new_lens = lens if is_fixed else lens.moved(step)
            new_poses = [pose + change for pose, change in zip(poses, steps)]
            new = _sum(new_lens, views, new_poses)
            if new <= best:
                break
            damping *= 8
        else:
            break
        gain, lens, poses, best = best - new, new_lens, new_poses, new
        damping = max(damping / 10, 1e-12)
        if gain <= _CONVERGED * best:
            break
    return lens, poses


def standard_deviations(lens: Lens, views: Sequence[Points], poses: Sequence[Floats]) -> Floats:
    """
    Return the standard deviations of the values and the bend of a lens.

    The errors of the corners of a view may depend on each other, as those of blur do. The sums of
    each view then vary more than independent errors would (Liang and Zeger, 1986). The larger
    deviation of both is returned.
    """
    equations = _Equations(lens, views, poses)
    freedom = 2 * sum(len(view.image) for view in views) - len(equations.reduced) \
        - _POSE * len(views)
    variance = _sum(lens, views, poses) / max(freedom, 1)
    scale = np.sqrt(np.maximum(np.diag(equations.lens), 1e-300))
    inverse = np.linalg.pinv(equations.reduced / np.outer(scale, scale), hermitian=True)
    sums = equations.sums / scale
    by_view = inverse @ (sums.T @ sums) @ inverse * (len(views) / max(len(views) - 1, 1))
    largest = np.maximum(np.diag(inverse) * variance, np.diag(by_view))
    return np.sqrt(np.maximum(largest, 0)) / scale


def _sum(lens: Lens, views: Sequence[Points], poses: Sequence[Floats]) -> float:
    total = float(sum((errors ** 2).sum() for errors in residuals(lens, views, poses)))
    return total if np.isfinite(total) else float('inf')


class _Equations:
    """Normal equations at some parameters; the poses are eliminated."""

    def __init__(
        self, lens: Lens, views: Sequence[Points], poses: Sequence[Floats],
    ) -> None:
        parts = []
        for view, pose in zip(views, poses):
            image, by_lens, by_pose = project(lens, view.board, pose)
            errors = (view.image - image).reshape(-1)
            parts.append((by_lens.T @ by_lens, by_lens.T @ by_pose, by_pose.T @ by_pose,
                          by_lens.T @ errors, by_pose.T @ errors))
        lenses, mixed, inner, right, inner_right = (np.array(part) for part in zip(*parts))
        self.lens, self._right, self._rights = lenses.sum(axis=0), right.sum(axis=0), right
        self._mixed, self._inner, self._inner_right = mixed, inner, inner_right

    @property
    def reduced(self) -> Floats:
        """Matrix of the lens without the poses."""
        return self.lens - (self._mixed @ np.linalg.solve(
            _damped(self._inner, 1e-12), self._mixed.transpose(0, 2, 1))).sum(axis=0)

    @property
    def sums(self) -> Floats:
        """Right side of the reduced equations for each view, (views, lens)."""
        return self._rights - (self._mixed @ np.linalg.solve(
            _damped(self._inner, 1e-12), self._inner_right[..., None]))[..., 0]

    def step(self, damping: float, is_fixed: bool) -> tuple[Floats, Floats]:
        """Return the steps of the lens and of each pose."""
        inner = _damped(self._inner, damping)
        if is_fixed:
            return np.zeros(len(self.lens)), np.linalg.solve(
                inner, self._inner_right[..., None])[..., 0]
        solved = np.linalg.solve(inner, np.concatenate(
            (self._mixed.transpose(0, 2, 1), self._inner_right[..., None]), axis=2))
        reduced = _damped(self.lens, damping) - (self._mixed @ solved[..., :-1]).sum(axis=0)
        right = self._right - (self._mixed @ solved[..., -1:]).sum(axis=0)[:, 0]
        step = np.linalg.lstsq(reduced, right, rcond=None)[0]
        return step, solved[..., -1] - solved[..., :-1] @ step


def _damped(matrix: Floats, damping: float) -> Floats:
    diagonal = np.diagonal(matrix, axis1=-2, axis2=-1)[..., None] * np.eye(matrix.shape[-1])
    return matrix + damping * diagonal + 1e-15 * np.eye(matrix.shape[-1])
