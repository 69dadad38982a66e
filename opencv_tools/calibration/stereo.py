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

"""Calibration of two cameras that see the same board at the same time."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from opencv_tools.calibration.boards import CalibrationError
from opencv_tools.calibration.detection import Detection
from opencv_tools.calibration.least_squares import EQUIDISTANT, Floats
from opencv_tools.calibration.solve import Calibration, LEAST_VIEWS

_LEAST_CORNERS = 6
_WIDEST = 3.0  # tangent of the largest angle of a corner from the axis
_OUTLIER_MEDIANS = 4.0
# Errors above this, in pixels and as a multiple of that of the lenses, show wrong pairs.
_MOST_PIXELS, _MOST_TIMES = 1.0, 5.0
_LEAST_BASELINE = 0.005  # as a part of the board
_CORRECTIONS = 20  # OpenCV stops after 5, which is not enough at the edge of wide lenses


@dataclass(frozen=True, kw_only=True)
class Rectification:
    """
    The rectification of one camera.

    :param r: rotation to the rectified camera, (3, 3).
    :param p: projection matrix of the rectified image, (3, 4); ``p[0, 3]`` of the right camera is
        -fx times the baseline.
    """

    r: Floats
    p: Floats


@dataclass(frozen=True, kw_only=True)
class StereoCalibration:
    """
    Two calibrated cameras.

    :param rotation: rotation from the left to the right camera, (3, 3).
    :param translation: place of the left camera in the right one in metres, (3,).
    :param baseline: distance of the cameras in metres.
    :param rms: error of all corners in pixels.
    :param pairs: number of pairs of views that were used.
    """

    rotation: Floats
    translation: Floats
    baseline: float
    rms: float
    pairs: int
    left: Rectification
    right: Rectification


def solve_stereo(
    pairs: Sequence[tuple[Detection, Detection]], left: Calibration, right: Calibration,
) -> StereoCalibration:
    """
    Calibrate the pose of two cameras, whose lenses are calibrated.

    :param pairs: the same board at the same time in the left and the right image.
    :param right: lens of the right camera, of the same model and size.
    :returns: pose and rectification.
    :raises CalibrationError: the pairs determine no pose or do not fit each other, or the cameras
        are swapped.
    """
    if (left.model, left.size) != (right.model, right.size):
        raise CalibrationError(
            f'the left camera is {left.model} with {left.size[0]}x{left.size[1]} pixels, the '
            f'right one {right.model} with {right.size[0]}x{right.size[1]}: give images of the '
            'same size, and one model')
    common = [one for one in (_common(*pair, left, right) for pair in pairs) if one is not None]
    if len(common) < LEAST_VIEWS:
        raise CalibrationError(f'{len(common)} pairs of images show the same corners of the board '
                               f'to both cameras: give {LEAST_VIEWS} or more')
    rms, rotation, translation, errors = _pose(common, left)
    keep = errors <= _OUTLIER_MEDIANS * np.median(errors)
    if not keep.all() and keep.sum() >= LEAST_VIEWS:
        common = [one for one, good in zip(common, keep) if good]
        rms, rotation, translation, _ = _pose(common, left)
    baseline = float(np.linalg.norm(translation))
    if rms > max(_MOST_PIXELS, _MOST_TIMES * max(left.rms, right.rms)):
        raise CalibrationError(
            f'the pairs do not fit each other, with an error of {rms:.1f} pixels: give images '
            'that both cameras took at the same time, in the same order')
    if baseline < _LEAST_BASELINE * float(np.ptp(common[0][0], axis=0).max()):
        raise CalibrationError(f'the cameras are {baseline * 1000:.1g} mm apart: give the images '
                               'of two cameras at two places')
    if abs(translation[0]) < abs(translation[1]):
        raise CalibrationError('one camera is above the other one: turn the images of both '
                               'cameras by 90 degrees')
    if translation[0] > 0:
        raise CalibrationError('the left camera is at the right: swap the two sources')
    first, second = _rectify(left, right, rotation, translation)
    return StereoCalibration(
        rotation=rotation, translation=translation, baseline=baseline,
        rms=rms, pairs=len(common), left=first, right=second)


def _common(
    first: Detection, second: Detection, left: Calibration, right: Calibration,
) -> tuple[Floats, Floats, Floats] | None:
    """Return the corners that both cameras see: on the board, and as rays of each camera."""
    _, ours, theirs = np.intersect1d(first.ids, second.ids, return_indices=True)
    if len(ours) < _LEAST_CORNERS:
        return None
    rays = [_rays(one.corners[indices].astype(float), lens) for one, indices, lens in (
        (first, ours, left), (second, theirs, right))]
    keep = (np.abs(np.hstack(rays)) < _WIDEST).all(axis=1)
    if keep.sum() < _LEAST_CORNERS:
        return None
    return first.points[ours][keep].astype(float), rays[0][keep], rays[1][keep]


def _rays(corners: Floats, lens: Calibration) -> Floats:
    """Return the directions of corners: x and y at the depth 1."""
    rays: Any
    if lens.model == EQUIDISTANT:
        rays = cv2.fisheye.undistortPoints(corners[:, None], lens.k, lens.d)
        return rays.reshape(-1, 2)
    rays = cv2.undistortPoints(corners[:, None], lens.k, lens.d).reshape(-1, 2)
    focal = np.diag(lens.k)[:2]
    for _ in range(_CORRECTIONS):
        image: Any = cv2.projectPoints(np.insert(rays, 2, 1.0, axis=1), np.zeros(3), np.zeros(3),
                                       lens.k, lens.d)[0]
        rays = rays - (image.reshape(-1, 2) - corners) / focal
    return rays


def _pose(
    common: Sequence[tuple[Floats, Floats, Floats]], lens: Calibration,
) -> tuple[float, Floats, Floats, Floats]:
    """Return the error, the pose, and the error of each pair, for cameras without distortion."""
    focal = float(lens.k[0, 0])
    board, first, second = ([np.asarray(one, np.float32) for one in part]
                            for part in zip(*common))
    plain = np.diag((focal, focal, 1.0))
    found: Any = cv2.stereoCalibrateExtended(
        board, [one * focal for one in first], [one * focal for one in second], plain,
        np.zeros(5), plain.copy(), np.zeros(5), lens.size, np.eye(3), np.zeros((3, 1)),
        flags=cv2.CALIB_FIX_INTRINSIC)
    rms, rotation, translation, errors = found[0], found[5], found[6], found[-1]
    return float(rms), rotation, translation.reshape(3), np.asarray(errors).max(axis=1)


def _rectify(
    left: Calibration, right: Calibration, rotation: Floats, translation: Floats,
) -> tuple[Rectification, Rectification]:
    arguments = (left.k, left.d, right.k, right.d, left.size, rotation,
                 translation.reshape(3, 1))
    found: Any
    if left.model == EQUIDISTANT:
        found = cv2.fisheye.stereoRectify(
            *arguments, flags=cv2.CALIB_ZERO_DISPARITY, newImageSize=left.size, balance=0.0)
    else:
        found = cv2.stereoRectify(
            *arguments, flags=cv2.CALIB_ZERO_DISPARITY, alpha=0)
    return Rectification(r=found[0], p=found[2]), Rectification(r=found[1], p=found[3])
