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

"""Calibrations of flipped and rotated images."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from calibrations import ANY_MACHINE
import cv2
from hypothesis import given, strategies as st
import numpy as np
from opencv_tools.image.encodings import find_encoding
from opencv_tools.image.orientation import FLIPS, orient, ROTATIONS, turned_axes
from opencv_tools.nodes.publisher.calibration_file import (
    CameraInfoError, read_camera_info, write_camera_info)
from opencv_tools.nodes.publisher.camera_info import PublishedCalibration, turn_camera_info
import pytest
from sensor_msgs.msg import CameraInfo, RegionOfInterest
from std_msgs.msg import Header

ORIENTATIONS = [(flip, rotate) for flip in FLIPS for rotate in ROTATIONS]
ANY_ORIENTATION = st.sampled_from(ORIENTATIONS)
WIDTH, HEIGHT = 640, 360
SMALL = st.floats(-0.05, 0.05)


def moved(u: Any, v: Any, width: int, height: int, flip: str, rotate: int) -> tuple[Any, Any]:
    """Return the coordinates of a pixel after flip and rotate."""
    if flip in ('horizontal', 'both'):
        u = width - 1 - u
    if flip in ('vertical', 'both'):
        v = height - 1 - v
    return {0: (u, v), 90: (height - 1 - v, u), 180: (width - 1 - u, height - 1 - v),
            270: (v, width - 1 - u)}[rotate]


def make_info(model: str = 'plumb_bob', d: tuple[float, ...] = (), **fields: Any) -> CameraInfo:
    k = [500.5, 0, 300.25, 0, 510.5, 190.75, 0, 0, 1]
    p = [480.5, 0, 310.25, -45.5, 0, 490.5, 170.75, 7.5, 0, 0, 1, 0]
    return CameraInfo(**{
        'width': WIDTH, 'height': HEIGHT, 'distortion_model': model, 'd': d,
        'k': np.array(k, float), 'p': np.array(p, float), 'r': np.eye(3).ravel()} | fields)


@st.composite
def distortions(draw: st.DrawFn) -> tuple[str, tuple[float, ...]]:
    model, counts = draw(st.sampled_from([
        ('plumb_bob', (0, 4, 5)), ('rational_polynomial', (8, 12)), ('equidistant', (4,))]))
    count = draw(st.sampled_from(counts))
    return model, tuple(draw(st.lists(SMALL, min_size=count, max_size=count)))


def project(info: CameraInfo, point: np.ndarray) -> np.ndarray:
    """Return the pixel of a point of the optical frame in the raw image, by OpenCV."""
    k, d = info.k.reshape(3, 3), np.array(info.d)
    if info.distortion_model == 'equidistant':
        return cv2.fisheye.projectPoints(
            point.reshape(1, 1, 3), np.zeros(3), np.zeros(3), k, d)[0].ravel()
    return cv2.projectPoints(
        point.reshape(1, 1, 3), np.zeros(3), np.zeros(3), k, d if d.size else None)[0].ravel()


def project_rectified(info: CameraInfo, point: np.ndarray) -> np.ndarray:
    u, v, w = info.p.reshape(3, 4) @ [*info.r.reshape(3, 3) @ point, 1.0]
    return np.array([u / w, v / w])


@pytest.mark.parametrize('size', [(3, 2), (4, 7)])
@pytest.mark.parametrize(('flip', 'rotate'), ORIENTATIONS)
def test_axes_of_turned_images(flip: str, rotate: int, size: tuple[int, int]) -> None:
    width, height = size
    numbers = np.arange(width * height, dtype=np.uint8).reshape(height, width)
    oriented, _ = orient(numbers, find_encoding('mono8'), flip, rotate)
    axes = turned_axes(flip, rotate)
    origin = np.array(moved(0, 0, width, height, flip, rotate))
    for v, u in np.ndindex(height, width):
        x, y = moved(u, v, width, height, flip, rotate)
        assert oriented[y, x] == numbers[v, u]
        np.testing.assert_array_equal(axes @ [u, v] + origin, [x, y])


@ANY_MACHINE
@given(orientation=ANY_ORIENTATION, distortion=distortions(),
       x=st.floats(-0.6, 0.6), y=st.floats(-0.6, 0.6), z=st.floats(0.5, 20),
       angles=st.tuples(SMALL, SMALL, SMALL))
def test_projections_of_turned_cameras(
        orientation: tuple[str, int], distortion: tuple[str, tuple[float, ...]], x: float,
        y: float, z: float, angles: tuple[float, float, float]) -> None:
    info = make_info(*distortion, r=cv2.Rodrigues(np.array(angles))[0].ravel())
    turned = turn_camera_info(info, turned_axes(*orientation))
    point = np.array([x, y, 1.0]) * z
    turned_point = np.array([*moved(point[0], point[1], 1, 1, *orientation), z])
    for project_point in (project, project_rectified):
        np.testing.assert_allclose(
            project_point(turned, turned_point),
            moved(*project_point(info, point), WIDTH, HEIGHT, *orientation),
            rtol=1e-9, atol=1e-6)
    assert (turned.width, turned.height) == (
        (HEIGHT, WIDTH) if orientation[1] % 180 else (WIDTH, HEIGHT))
    rotation = turned.r.reshape(3, 3)
    np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(rotation) == pytest.approx(1.0)


@pytest.mark.parametrize(('flip', 'rotate'), ORIENTATIONS)
@pytest.mark.parametrize('roi', [
    RegionOfInterest(), RegionOfInterest(x_offset=10, y_offset=21, width=33, height=300),
    RegionOfInterest(x_offset=607, y_offset=0, width=33, height=1, do_rectify=True)])
def test_turned_regions_of_interest(flip: str, rotate: int, roi: RegionOfInterest) -> None:
    info = make_info('rational_polynomial', tuple(np.arange(1.0, 13.0)), roi=roi, binning_x=2,
                     binning_y=3)
    axes = turned_axes(flip, rotate)
    turned = turn_camera_info(info, axes)
    assert (turned.binning_x, turned.binning_y) == ((3, 2) if rotate % 180 else (2, 3))
    inside = np.zeros((HEIGHT, WIDTH), np.uint8)
    inside[roi.y_offset:roi.y_offset + roi.height, roi.x_offset:roi.x_offset + roi.width] = 1
    left, top, width, height = (getattr(turned.roi, name) for name in (
        'x_offset', 'y_offset', 'width', 'height'))
    expected, _ = orient(inside, find_encoding('mono8'), flip, rotate)
    drawn = np.zeros_like(expected)
    drawn[top:top + height, left:left + width] = 1
    np.testing.assert_array_equal(drawn, expected)
    assert turned.roi.do_rectify == roi.do_rectify
    assert turn_camera_info(turned, axes.T) == info


@pytest.mark.parametrize(('model', 'd'), [
    ('thin_prism', (0.1,)), ('', (0.1, 0.0, 0.0, 0.0)), ('plumb_bob', (0.1,) * 6),
    ('rational_polynomial', (*[0.1] * 12, 0.01, 0.0))])
def test_one_warning_about_an_unsupported_model(
        tmp_path: Path, model: str, d: tuple[float, ...]) -> None:
    write_camera_info(tmp_path / 'a.yaml', make_info(model, d), 'left')
    for flip, rotate in ORIENTATIONS:
        if (flip, rotate) in (('none', 0), ('both', 180)):
            continue
        warnings: list[str] = []
        calibration = PublishedCalibration(str(tmp_path / 'a.yaml'), 'left', warnings.append)
        size = (HEIGHT, WIDTH) if rotate % 180 else (WIDTH, HEIGHT)
        for _ in range(3):
            message = calibration.message(Header(), *size, flip, rotate)
            assert message == CameraInfo(width=size[0], height=size[1])
        assert warnings == [
            f'a calibration with {len(d)} coefficients of distortion model {model!r} can be '
            'neither flipped nor rotated: set flip to none and rotate to 0; '
            'camera_info is published uncalibrated'], (flip, rotate)
        assert calibration.message(Header(), WIDTH, HEIGHT).k[0] == 500.5
        with pytest.raises(CameraInfoError, match=r'can be neither flipped nor rotated|: give '):
            calibration.save(make_info(model, d, width=size[0], height=size[1]), flip, rotate)


def test_turned_skew() -> None:
    k = np.array([500.5, 2.5, 300.25, 0, 510.5, 190.75, 0, 0, 1])
    info = make_info(k=k)
    assert turn_camera_info(info, turned_axes('vertical', 0)).k[1] == -2.5
    assert turn_camera_info(info, turned_axes('none', 180)).k[1] == 2.5
    with pytest.raises(CameraInfoError, match='skewed pixel axes cannot be rotated'):
        turn_camera_info(info, turned_axes('none', 90))
    k[3] = 1.0
    assert turn_camera_info(make_info(k=k), turned_axes('none', 0)) == make_info(k=k)


def test_saved_calibration_of_the_unturned_camera(tmp_path: Path) -> None:
    calibration = PublishedCalibration(str(tmp_path / 'a.yaml'), 'left', lambda _: None)
    unturned = make_info(d=(0.1, 0.2, 0.003, 0.004, 0.05))
    for flip, rotate in ORIENTATIONS:
        size = (HEIGHT, WIDTH) if rotate % 180 else (WIDTH, HEIGHT)
        sent = turn_camera_info(unturned, turned_axes(flip, rotate))
        calibration.save(sent, flip, rotate)
        assert read_camera_info(tmp_path / 'a.yaml') == unturned
        assert calibration.message(Header(), *size, flip, rotate) == sent
        half = calibration.message(Header(), size[0] // 2, size[1] // 2, flip, rotate)
        assert sorted((half.k[0], half.k[4])) == [250.25, 255.25]
    assert calibration.message(Header(), WIDTH, HEIGHT) == unturned
