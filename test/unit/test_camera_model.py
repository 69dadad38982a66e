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
"""Where rectified images lie in the raw ones, compared with the maps of the rectification."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from opencv_tools.camera_model import raw_view, read_camera_model
from opencv_tools.image.encodings import find_encoding
from opencv_tools.image.errors import RectificationError
from opencv_tools.rectification import Rectifier
import pytest
from sensor_msgs.msg import RegionOfInterest
from test_rectification import BARREL, DISTORTIONS, make_info, projected, turned_slightly

ROI = RegionOfInterest(x_offset=40, y_offset=20, width=240, height=200)
PARTS = [({}, (320, 240)), ({'binning_x': 2, 'binning_y': 2}, (160, 120)),
         ({'roi': ROI}, (240, 200)), ({'roi': ROI, 'binning_x': 2, 'binning_y': 4}, (120, 50))]


@pytest.mark.parametrize(('part', 'size'), PARTS)
@pytest.mark.parametrize(('model', 'd'), DISTORTIONS)
def test_border_is_that_of_the_projected_pixels(
        model: str, d: tuple[float, ...], part: dict[str, Any], size: tuple[int, int]) -> None:
    info = make_info(model, d, r=turned_slightly(), **part)
    border = raw_view(info, *size, steps=200).border
    # The middles of the outer pixels are half a pixel within the border.
    rows, columns = np.mgrid[:size[1], :size[0]]
    is_outer = (columns == 0) | (rows == 0) | (columns == size[0] - 1) | (rows == size[1] - 1)
    outer = np.stack(projected(info, columns[is_outer], rows[is_outer]), -1)
    distances = np.linalg.norm(outer[:, np.newaxis] - border, axis=2).min(1)
    assert distances.max() < 2.5
    assert border.shape == (800, 2)


def test_centers() -> None:
    view = raw_view(make_info(roi=ROI, binning_x=2, binning_y=4), 120, 50)
    assert view.center == ((150.25 - 40) / 2, (125.75 - 20) / 4)
    assert view.rectified_center == ((155.25 - 40) / 2, (118.75 - 20) / 4)


def test_no_border_without_distortion() -> None:
    info = make_info('plumb_bob', (), p=[250.5, 0, 150.25, 0, 0, 255.5, 125.75, 0, 0, 0, 1, 0])
    assert raw_view(info, 320, 240).border.shape == (0, 2)


def test_border_surrounds_what_is_rectified() -> None:
    info = make_info(*BARREL)
    image = np.full((240, 320), 255, np.uint8)
    left, top = raw_view(info, 320, 240).border.min(0)
    image[:, :max(0, int(left) - 2)] = 0
    rectified, _ = Rectifier().rectify(image, find_encoding('mono8'), info)
    other, _ = Rectifier().rectify(np.full_like(image, 255), find_encoding('mono8'), info)
    assert np.array_equal(rectified, other) and top < 240


@pytest.mark.parametrize(('part', 'size'), PARTS)
@pytest.mark.parametrize(('model', 'd'), DISTORTIONS)
def test_rays_are_projected_to_their_pixels(
        model: str, d: tuple[float, ...], part: dict[str, Any], size: tuple[int, int]) -> None:
    camera = read_camera_model(make_info(model, d, **part), *size)
    rays = camera.rays(*size)
    directions = np.dstack((rays, np.ones(rays.shape[:2]))).reshape(-1, 1, 3)
    project = cv2.fisheye.projectPoints if camera.is_fisheye else cv2.projectPoints
    pixels, _ = project(directions, np.zeros(3), np.zeros(3), camera.matrix,
                        camera.distortion if camera.distortion.size else np.zeros(4))
    columns, rows = np.meshgrid(np.arange(size[0]), np.arange(size[1]))
    expected = np.stack((columns, rows), axis=2)
    assert np.abs(pixels.reshape(size[1], size[0], 2) - expected).max() < 1e-3


@pytest.mark.parametrize(('fields', 'reason'), [
    ({'k': np.zeros(9)}, 'its K is zero'), ({'width': 640}, 'the image has 320x240 pixels'),
    ({'d': (float('nan'),) * 5}, 'D of the camera_info'), ({'p': np.zeros(12)}, 'focal lengths')])
def test_calibration_that_cannot_be_used(fields: dict[str, Any], reason: str) -> None:
    with pytest.raises(RectificationError, match=reason):
        raw_view(make_info(**fields), 320, 240)
