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

"""Verdict on a calibration, with its reasons in plain words."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from opencv_tools.calibration.solve import Calibration
from opencv_tools.calibration.views import most_common_place

GOOD, USABLE, BAD = 'good', 'usable', 'bad'

# Limits of a usable and of a good calibration.
_ERROR = (2.0, 0.8)  # pixels in images of 1280 pixels width; larger images have larger errors
_DEVIATION = (0.02, 0.003)  # of the focal length, as a part of it
_HELD_OUT = (3.0, 1.5)  # times the error of the other views
_HELD_OUT_PIXELS = 0.2
_VIEWS = (5, 12)
_CELLS = 0.7
_TILT = (8.0, 18.0)  # degrees of the most tilted view
_MIDDLE = (0.2, 0.35)  # of the image, in which the principal point must not be, on each side
_DROPPED = 0.2
_DROPPED_CORNERS = (0.4, 0.05)
_WIDTH = 1280


@dataclass(frozen=True)
class Verdict:
    """
    A verdict on a calibration.

    :param word: ``good``, ``usable`` or ``bad``.
    :param reasons: what is not good, and the remedy; empty for a good calibration.
    """

    word: str
    reasons: tuple[str, ...] = ()


def judge(calibration: Calibration) -> Verdict:
    """Return the verdict on a calibration."""
    width, height = calibration.size
    unit = max(1.0, width / _WIDTH)
    kept = int(np.isfinite(calibration.view_errors).sum())
    dropped = len(calibration.view_errors) - kept
    tilt = float(np.nanmax(calibration.view_tilts))
    uncertain = float(calibration.deviations[0] / calibration.k[0, 0])
    away = max(abs(calibration.k[0, 2] / width - 0.5), abs(calibration.k[1, 2] / height - 0.5))
    ratio = (calibration.held_out / calibration.rms
             if calibration.held_out > _HELD_OUT_PIXELS else 0.0)
    # Level: 0 bad, 1 usable, 2 good. Each reason has the word of its level.
    found = [
        (_level(calibration.rms / unit, _ERROR), f'the error is {calibration.rms:.2f} pixels: '
         'check the size and the flatness of the board, and take sharp views'),
        (_level(-kept, (-_VIEWS[0], -_VIEWS[1])), f'only {kept} views were used: take '
         f'{_VIEWS[1]} or more'),
        (_level(-tilt, (-_TILT[0], -_TILT[1])), 'all views are alike: tilt the board by 20 to 40 '
         'degrees to all sides'),
        (_level(uncertain, _DEVIATION), f'the focal length is uncertain by {uncertain:.1%}: take '
         'more views with a tilted and near board'),
        (_level(ratio, _HELD_OUT), f'views that were left out have an error of '
         f'{calibration.held_out:.2f} pixels, the others of {calibration.rms:.2f}: take more '
         'views at different places'),
        (_level(away, (0.5 - _MIDDLE[0], 0.5 - _MIDDLE[1])), 'the optical axis is far from the '
         'middle of the image: give uncropped images, or take more views'),
        (_coverage(calibration)),
        (1 if calibration.bend else 2, 'the board is not flat: it is bent by '
         f'{calibration.bend * 1000:.1f} mm, which was taken into account; glue it to a plate'),
        (_level(calibration.dropped, _DROPPED_CORNERS), f'{calibration.dropped:.0%} of the '
         'corners do not fit the lens and were dropped: choose another model of the lens, and '
         'remove blurred images'),
        (1 if dropped > _DROPPED * len(calibration.view_errors) else 2,
         f'views that did not fit and were dropped: {dropped}; remove blurred and moved images')]
    level = min(level for level, _ in found)
    return Verdict((BAD, USABLE, GOOD)[level], tuple(
        reason for level, reason in sorted(found, key=lambda one: one[0]) if level < 2))


def _level(value: float, limits: tuple[float, float]) -> int:
    """Return 0 above both limits, 1 above the second one, else 2."""
    return 2 - sum(value > limit for limit in limits)


def _coverage(calibration: Calibration) -> tuple[int, str]:
    empty = np.isnan(calibration.cell_errors)
    return (1 if 1 - empty.mean() < _CELLS else 2,
            f'no view has corners in {empty.mean():.0%} of the image, most in the '
            f'{most_common_place(empty)}: '
            'take views with the board there')
