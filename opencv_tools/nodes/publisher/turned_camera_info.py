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

"""Calibration of flipped or rotated images."""

from __future__ import annotations

from collections.abc import Sequence
import copy

import numpy as np
from numpy.typing import NDArray
from opencv_tools.nodes.publisher.calibration_file import CameraInfoError
from sensor_msgs.msg import CameraInfo, RegionOfInterest

# Models with the coefficients k1, k2, p1, p2, k3 ... k6, s1 ... s4, tau_x, tau_y of OpenCV.
_POLYNOMIALS = ('plumb_bob', 'rational_polynomial')
_POLYNOMIAL_LENGTHS = (4, 5, 8, 12, 14)
_TILT = 12
# Indices of pairs of coefficients that turn like x and y: (p2, p1), (s1, s3) and (s2, s4).
_VECTORS = ((3, 2), (8, 10), (9, 11))
# Models with rotational symmetry.
_SYMMETRIC = ('equidistant',)


def turn_camera_info(info: CameraInfo, axes: NDArray[np.float64]) -> CameraInfo:
    """
    Convert a calibration to flipped or rotated images.

    The optical frame turns with the image: x still points right, and y down.

    :param info: calibration to convert.
    :param axes: (2, 2) matrix of ``turned_axes``; its transpose is the inverse.
    :returns: a copy for the turned images.
    :raises CameraInfoError: CameraInfo cannot represent the turned camera.
    """
    turned = copy.deepcopy(info)
    if (axes == np.eye(2)).all():
        return turned
    order = np.abs(axes).argmax(1)
    is_reversed = axes.sum(1) < 0
    size = np.array([info.width, info.height])[order]
    space = np.eye(3)
    space[:2, :2] = axes
    pixels = space.copy()
    pixels[:2, 2] = np.where(is_reversed, size - 1, 0)
    k = pixels @ info.k.reshape(3, 3) @ space.T
    p = pixels @ info.p.reshape(3, 4)
    p[:, :3] = p[:, :3] @ space.T
    if k[1, 0] or p[1, 0]:
        raise CameraInfoError('a calibration with skewed pixel axes cannot be rotated: '
                              'set rotate to 0')
    r = space @ info.r.reshape(3, 3) @ space.T
    # Adding 0.0 converts -0.0 to 0.0.
    turned.k, turned.p, turned.r = ((matrix + 0.0).ravel() for matrix in (k, p, r))
    turned.d = _turn_distortion(info.distortion_model, info.d, axes)
    turned.width, turned.height = map(int, size)
    binning = [info.binning_x, info.binning_y]
    turned.binning_x, turned.binning_y = (binning[side] for side in order)
    if info.roi.width or info.roi.height:
        turned.roi = _turn_region(info, order, is_reversed)
    return turned


def _turn_distortion(
    model: str, coefficients: Sequence[float], axes: NDArray[np.float64],
) -> list[float]:
    """Turn the coefficients of a distortion model, if the model is supported."""
    turned = np.array(coefficients, np.float64)
    if not turned.any() or model in _SYMMETRIC:
        return turned.tolist()
    is_supported = model in _POLYNOMIALS and len(turned) in _POLYNOMIAL_LENGTHS
    if not is_supported or turned[_TILT:].any():
        raise CameraInfoError(
            f'a calibration with {len(turned)} coefficients of distortion model {model!r} can be '
            'neither flipped nor rotated: set flip to none and rotate to 0')
    for pair in _VECTORS:
        if max(pair) < len(turned):
            turned[[*pair]] = axes @ turned[[*pair]] + 0.0
    return turned.tolist()


def _turn_region(
    info: CameraInfo, order: NDArray[np.int_], is_reversed: NDArray[np.bool_],
) -> RegionOfInterest:
    roi = info.roi
    sizes = info.width, info.height
    starts, lengths = (roi.x_offset, roi.y_offset), (roi.width, roi.height)
    (x, width), (y, height) = (
        (max(0, sizes[side] - starts[side] - lengths[side]) if backwards else starts[side],
         lengths[side])
        for side, backwards in zip(order, is_reversed, strict=True))
    return RegionOfInterest(
        x_offset=x, y_offset=y, width=width, height=height, do_rectify=roi.do_rectify)
