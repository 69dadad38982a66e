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

"""Rectified pixels, compared with projected points; calibrations that cannot be used."""

from __future__ import annotations

from functools import cache
from typing import Any

from calibrations import ANY_MACHINE, camera_infos
import cv2
from hypothesis import given, settings, strategies as st
from images import random_image
import numpy as np
from opencv_tools.image.color import convert
from opencv_tools.image.encodings import ENCODINGS, find_encoding
from opencv_tools.image.errors import RectificationError
from opencv_tools.image.orientation import FLIPS, orient, ROTATIONS, turned_axes
from opencv_tools.nodes.publisher.camera_info import turn_camera_info
from opencv_tools.rectification import rectified_info, Rectifier
import pytest
from sensor_msgs.msg import CameraInfo, RegionOfInterest

WIDTH, HEIGHT = 320, 240
BARREL = ('plumb_bob', (-0.3, 0.1, 0.001, -0.002, 0.01))
RATIONAL = ('rational_polynomial', (0.2, -0.1, 0.001, -0.002, 0.01, 0.3, -0.05, 0.02))
FISHEYE = ('equidistant', (0.05, -0.02, 0.01, -0.003))
DISTORTIONS = (BARREL, RATIONAL, FISHEYE, ('plumb_bob', BARREL[1][:4]), ('equidistant', ()))
GRAY16, GRAY8 = find_encoding('mono16'), find_encoding('mono8')
DEPTH16, DEPTH32 = find_encoding('16UC1'), find_encoding('32FC1')


def make_info(model: str = BARREL[0], d: tuple[float, ...] = BARREL[1],
              **fields: Any) -> CameraInfo:
    return CameraInfo(**{
        'width': WIDTH, 'height': HEIGHT, 'distortion_model': model, 'd': d,
        'k': [250.5, 0, 150.25, 0, 255.5, 125.75, 0, 0, 1],
        'p': [220.5, 0, 155.25, -20.5, 0, 225.5, 118.75, 0, 0, 0, 1, 0],
        'r': np.eye(3).ravel()} | fields)


def turned_slightly() -> np.ndarray:
    return cv2.Rodrigues(np.array([0.02, -0.03, 0.01]))[0].ravel()


def ramps(width: int, height: int) -> tuple[np.ndarray, np.ndarray]:
    """Return images whose gray values are 64 times the column and the row."""
    rows, columns = np.mgrid[:height, :width]
    return (64 * columns).astype(np.uint16), (64 * rows).astype(np.uint16)


def projected(info: CameraInfo, columns: np.ndarray, rows: np.ndarray
              ) -> tuple[np.ndarray, np.ndarray]:
    """Return the columns and rows in the raw image for some of the rectified image."""
    roi, binning = info.roi, (max(1, info.binning_x), max(1, info.binning_y))
    u, v = columns * binning[0] + roi.x_offset, rows * binning[1] + roi.y_offset
    rays = np.stack([u, v, np.ones_like(u)], -1).reshape(-1, 3)
    rays = rays @ np.linalg.inv(info.p.reshape(3, 4)[:, :3] @ info.r.reshape(3, 3)).T
    k, d, zero = info.k.reshape(3, 3), np.array(info.d or [0.0] * 4), np.zeros(3)
    project = (cv2.fisheye.projectPoints if info.distortion_model == 'equidistant'
               else cv2.projectPoints)
    points = project(rays.reshape(-1, 1, 3), zero, zero, k, d)[0].reshape(*columns.shape, 2)
    return ((points[..., 0] - roi.x_offset) / binning[0],
            (points[..., 1] - roi.y_offset) / binning[1])


@cache
def all_projected() -> tuple[np.ndarray, np.ndarray]:
    """Return the columns and rows in the raw image of the usual calibration."""
    rows, columns = np.mgrid[:HEIGHT, :WIDTH]
    return projected(make_info(), columns, rows)


@pytest.mark.parametrize('rotation', [np.eye(3).ravel(), turned_slightly()], ids=['mono', 'pair'])
@pytest.mark.parametrize(('model', 'd'), DISTORTIONS)
@pytest.mark.parametrize('part', [
    {}, {'binning_x': 2, 'binning_y': 3},
    {'roi': RegionOfInterest(x_offset=31, y_offset=50, width=200, height=151)},
    {'binning_x': 2, 'binning_y': 2, 'roi': RegionOfInterest(
        x_offset=40, y_offset=20, width=240, height=200, do_rectify=True)},
], ids=['whole', 'binning', 'roi', 'binned roi'])
def test_each_pixel_comes_from_its_ray(
        model: str, d: tuple[float, ...], rotation: np.ndarray, part: dict[str, Any]) -> None:
    info = make_info(model, d, r=rotation, **part)
    width = (info.roi.width or WIDTH) // max(1, info.binning_x)
    height = (info.roi.height or HEIGHT) // max(1, info.binning_y)
    rows, columns = np.mgrid[:height:3, :width:3]
    truth = projected(info, columns, rows)
    inside = ((truth[0] > 0.1) & (truth[0] < width - 1.1)
              & (truth[1] > 0.1) & (truth[1] < height - 1.1))
    assert inside.mean() > 0.5
    rectifier = Rectifier()
    for ramp, expected in zip(ramps(width, height), truth, strict=True):
        rectified, encoding = rectifier.rectify(ramp, GRAY16, info)
        assert (rectified.shape, rectified.dtype, encoding) == (ramp.shape, ramp.dtype, GRAY16)
        # OpenCV interpolates at multiples of 1/32 pixel.
        np.testing.assert_allclose(rectified[::3, ::3][inside] / 64, expected[inside], atol=0.04)
        outside = ((truth[0] < -1.1) | (truth[0] > width + 0.1)
                   | (truth[1] < -1.1) | (truth[1] > height + 0.1))
        assert not rectified[::3, ::3][outside].any()


@pytest.mark.parametrize(('model', 'd'), [BARREL, RATIONAL, FISHEYE])
def test_straight_lines_become_straight(model: str, d: tuple[float, ...]) -> None:
    info = make_info(model, d)
    points = np.stack([np.linspace(-0.5, 0.5, 9), np.full(9, 0.35), np.ones(9)], -1)
    project = cv2.fisheye.projectPoints if info.distortion_model == 'equidistant' \
        else cv2.projectPoints
    raw = project(points.reshape(-1, 1, 3), np.zeros(3), np.zeros(3), info.k.reshape(3, 3),
                  np.array(d))[0].reshape(-1, 2)
    rows, columns = np.mgrid[:HEIGHT, :WIDTH]
    found = []
    for x, y in raw:
        spot = 200 * np.exp(-((columns - x) ** 2 + (rows - y) ** 2) / 18)
        rectified, _ = Rectifier().rectify(spot.astype(np.uint8), GRAY8, info)
        weights = rectified.astype(float)
        found.append([(weights * columns).sum(), (weights * rows).sum()] / weights.sum())
    p = info.p.reshape(3, 4)
    np.testing.assert_allclose(found, (points @ p[:, :3].T)[:, :2], atol=0.3)
    assert np.ptp([y for _, y in found]) < 0.3
    assert np.ptp(raw[:, 1]) > 2


def test_equal_to_undistort() -> None:
    info = make_info()
    image = random_image('bgr8', HEIGHT, WIDTH)
    expected = cv2.undistort(image, info.k.reshape(3, 3), np.array(info.d), None,
                             info.p.reshape(3, 4)[:, :3])
    rectified, _ = Rectifier().rectify(image, find_encoding('bgr8'), info)
    assert np.abs(rectified.astype(int) - expected).mean() < 0.1


@pytest.mark.parametrize('encoding', [DEPTH16, DEPTH32, find_encoding('64FC1')])
def test_depths_are_not_mixed(encoding: Any) -> None:
    info = make_info()
    invalid = 0 if encoding is DEPTH16 else np.nan
    numbers = np.arange(WIDTH * HEIGHT).reshape(HEIGHT, WIDTH) % 60_000 + 1
    depth = np.where(numbers % 3 == 0, invalid, numbers).astype(encoding.dtype)
    rectified, _ = Rectifier().rectify(depth, encoding, info)
    columns, rows = all_projected()
    nearest = np.rint(columns).astype(int), np.rint(rows).astype(int)
    inside = ((nearest[0] >= 0) & (nearest[0] < WIDTH) & (nearest[1] >= 0)
              & (nearest[1] < HEIGHT))
    expected = np.full_like(depth, invalid)
    expected[inside] = depth[nearest[1][inside], nearest[0][inside]]
    # Where a ray meets the border of two pixels, both are the nearest one.
    is_clear = np.maximum(abs(columns % 1 - 0.5), abs(rows % 1 - 0.5)) > 0
    is_clear &= (abs(columns % 1 - 0.5) > 1e-3) & (abs(rows % 1 - 0.5) > 1e-3)
    np.testing.assert_array_equal(rectified[is_clear], expected[is_clear])
    assert not inside.all() and is_clear.mean() > 0.9


@pytest.mark.parametrize('name', [*ENCODINGS, '8UC1', '8SC1', '8UC2', '8UC3', '8UC5', '16UC3',
                                  '16SC1', '32SC1', '32FC2', '32FC3', '64FC1'])
def test_every_encoding(name: str) -> None:
    encoding, info = find_encoding(name), make_info()
    image = random_image(name, HEIGHT, WIDTH)
    before = image.copy()
    rectified, found = Rectifier().rectify(image, encoding, info)
    assert np.array_equal(image, before, equal_nan=image.dtype.kind == 'f')
    if encoding.kind in ('bayer', 'yuv'):
        assert found.name == ('bgr16' if '16' in name else 'bgr8')
        image = convert(image, encoding, found)
    else:
        assert found == encoding
    assert (rectified.shape, rectified.dtype) == (image.shape, image.dtype)
    rows, columns = np.mgrid[100:140, 100:200]
    source_columns, source_rows = all_projected()
    pixels = image[np.rint(source_rows[rows, columns]).astype(int),
                   np.rint(source_columns[rows, columns]).astype(int)]
    if found.is_generic:
        assert (rectified[rows, columns] == pixels).mean() > 0.95
    else:
        flat = np.full_like(image, 77)
        rectified, _ = Rectifier().rectify(flat, found, info)
        assert (rectified[rows, columns] == 77).all()


def test_other_byte_order_and_strides() -> None:
    info, image = make_info(), random_image('mono16', HEIGHT, WIDTH)
    expected, _ = Rectifier().rectify(image, GRAY16, info)
    for other in (image.astype('>u2'), image[::-1].copy()[::-1]):
        assert np.array_equal(Rectifier().rectify(other, GRAY16, info)[0], expected)


@pytest.mark.parametrize('rotate', ROTATIONS)
@pytest.mark.parametrize('flip', FLIPS)
@pytest.mark.parametrize(('model', 'd'), [BARREL, RATIONAL, FISHEYE])
def test_turned_images(model: str, d: tuple[float, ...], flip: str, rotate: int) -> None:
    info = make_info(model, d, r=turned_slightly())
    turned = turn_camera_info(info, turned_axes(flip, rotate))
    for ramp in ramps(WIDTH, HEIGHT):
        ramp += 64
        expected = orient(Rectifier().rectify(ramp, GRAY16, info)[0], GRAY16, flip, rotate)[0]
        image = orient(ramp, GRAY16, flip, rotate)[0]
        rectified, _ = Rectifier().rectify(image, GRAY16, turned)
        is_inside = (rectified >= 64) & (expected >= 64)
        assert is_inside.mean() > 0.5
        difference = np.abs(rectified.astype(int) - expected)[is_inside]
        assert np.quantile(difference, 0.99) <= 4  # 1/16 pixel


def test_maps_are_computed_once() -> None:
    rectifier, image = Rectifier(), random_image('mono8', HEIGHT, WIDTH)
    first, _ = rectifier.rectify(image, GRAY8, make_info())
    maps = rectifier._maps
    again = make_info()
    again.header.stamp.sec = 5
    for _ in range(3):
        assert np.array_equal(rectifier.rectify(image, GRAY8, again)[0], first)
        assert rectifier._maps is maps
    for change in ({'d': (-0.2, 0.1, 0.0, 0.0, 0.0)}, {'r': turned_slightly()},
                   {'k': [240.5, 0, 150.25, 0, 255.5, 125.75, 0, 0, 1]},
                   {'p': [230.5, 0, 155.25, 0, 0, 225.5, 118.75, 0, 0, 0, 1, 0]},
                   {'model': 'equidistant', 'd': FISHEYE[1]},
                   {'binning_x': 2, 'width': 2 * WIDTH}):
        changed, _ = rectifier.rectify(image, GRAY8, make_info(**change))
        assert rectifier._maps is not maps and not np.array_equal(changed, first)
    assert np.array_equal(rectifier.rectify(image, GRAY8, again)[0], first)


def test_pixels_in_lent_memory() -> None:
    image, out = random_image('bgr8', HEIGHT, WIDTH), np.zeros((HEIGHT, WIDTH, 3), np.uint8)
    asked: list[tuple[int, int, str]] = []

    def lend(height: int, width: int, encoding: Any) -> np.ndarray:
        asked.append((height, width, encoding.name))
        return out

    rectified, _ = Rectifier().rectify(image, find_encoding('bgr8'), make_info(), lend)
    assert rectified is out and asked == [(HEIGHT, WIDTH, 'bgr8')]
    assert np.array_equal(out, Rectifier().rectify(image, find_encoding('bgr8'), make_info())[0])


def test_camera_info_of_rectified_images() -> None:
    info = make_info(r=turned_slightly(), roi=RegionOfInterest(
        x_offset=8, y_offset=4, width=200, height=100, do_rectify=True), binning_x=2)
    rectified = rectified_info(info, 100, 100)
    assert (rectified.distortion_model, [*rectified.d]) == ('plumb_bob', [0.0] * 5)
    assert np.array_equal(rectified.k.reshape(3, 3), info.p.reshape(3, 4)[:, :3])
    assert np.array_equal(rectified.p, info.p)
    assert np.array_equal(rectified.r.reshape(3, 3), np.eye(3))
    assert (rectified.width, rectified.binning_x, rectified.roi.width) == (WIDTH, 2, 200)
    assert not rectified.roi.do_rectify and info.roi.do_rectify and any(info.d)
    image = random_image('mono8', 100, 100)
    assert Rectifier().rectify(image, GRAY8, rectified)[0] is image


@pytest.mark.parametrize(('fields', 'reason'), [
    ({'k': [0.0] * 9}, 'the camera_info has no calibration, because its K is zero: calibrate'),
    ({'p': [0.0] * 12}, 'P of the camera_info has the focal lengths 0 and 0: give numbers above'),
    ({'k': [1.0, 0, 0, 0, -2, 0, 0, 0, 1]}, 'K of the camera_info has the focal lengths 1 and -2'),
    ({'r': [0.0] * 8 + [1.0]}, 'P and R of the camera_info cannot be inverted: give a rotation'),
    ({'p': [1.0, 0, 0, 0, 0, 1, 0, 0, 0, 0, 0, 0]}, 'P and R of the camera_info cannot be'),
    ({'p': [1e308, 1e308, 1e308, 0, 0, 1e308, 0, 0, 0, 0, 1, 0], 'r': [1e308] * 9},
     'P and R of the camera_info cannot be inverted'),
    ({'k': [np.nan, 0, 0, 0, 1, 0, 0, 0, 1]}, 'K of the camera_info has the value nan: give'),
    ({'r': [np.inf] * 9}, 'R of the camera_info has the value inf: give finite numbers'),
    ({'p': [1.0, 0, 0, 0, 0, np.nan, 0, 0, 0, 0, 1, 0]}, 'P of the camera_info has the value nan'),
    ({'d': (0.1, np.nan, 0, 0, 0)}, 'D of the camera_info has the value nan'),
    ({'d': (0.1,) * 3}, 'D of the camera_info has 3 coefficients: give 0, 4, 5, 8, 12, 14 for pl'),
    ({'d': (0.1,) * 100_000}, 'D of the camera_info has 100000 coefficients'),
    ({'model': 'equidistant'}, 'D of the camera_info has 5 coefficients: give 0, 4 for equidi'),
    ({'model': 'thin\nprism'}, r"distortion model 'thin\\nprism' of the camera_info is unknown"),
    ({'width': 640}, 'the image has 320x240 pixels, but its camera_info is for 640x240 pixels: '),
    ({'width': 0, 'height': 0}, 'but its camera_info is for 0x0 pixels: publish the calibration'),
    ({'width': 2**32 - 1, 'height': 2**32 - 1}, 'is for 4294967295x4294967295 pixels'),
    ({'binning_x': 2**32 - 1}, 'is for 0x240 pixels, with a binning of 4294967295x1: publish'),
    ({'roi': RegionOfInterest(x_offset=2**32 - 1, width=9, height=8)},
     'is for 9x8 pixels, its ROI in 320x240: publish the calibration of this size')])
def test_unusable_calibrations(fields: dict[str, Any], reason: str) -> None:
    info = make_info(**fields)
    image = random_image('mono8', HEIGHT, WIDTH)
    with pytest.raises(RectificationError, match=reason):
        Rectifier().rectify(image, GRAY8, info)
    with pytest.raises(RectificationError, match=reason):
        rectified_info(info, WIDTH, HEIGHT)


def test_zero_distortion_of_an_unknown_model() -> None:
    info = make_info('', (0.0,) * 7, p=[250.5, 0, 150.25, 0, 0, 255.5, 125.75, 0, 0, 0, 1, 0])
    image = random_image('mono8', HEIGHT, WIDTH)
    assert Rectifier().rectify(image, GRAY8, info)[0] is image


def test_rotation_that_is_not_set_is_none() -> None:
    image = random_image('mono8', HEIGHT, WIDTH)
    expected, _ = Rectifier().rectify(image, GRAY8, make_info())
    rectified, _ = Rectifier().rectify(image, GRAY8, make_info(r=[0.0] * 9))
    assert np.array_equal(rectified, expected)


@pytest.mark.parametrize('d', [(), (0.0,) * 5, (0.0,) * 8])
@pytest.mark.parametrize('model', ['plumb_bob', 'rational_polynomial', ''])
def test_calibration_of_a_simulator_passes_the_image_through(
        model: str, d: tuple[float, ...]) -> None:
    info = make_info(model, d, r=[0.0] * 9, p=[0.0] * 12)
    image = random_image('mono8', HEIGHT, WIDTH)
    assert Rectifier().rectify(image, GRAY8, info)[0] is image
    rectified = rectified_info(info, WIDTH, HEIGHT)
    assert rectified.k.tolist() == info.k.tolist()
    assert rectified.p.tolist() == [250.5, 0, 150.25, 0, 0, 255.5, 125.75, 0, 0, 0, 1, 0]


@pytest.mark.parametrize(('model', 'd', 'zeros'), [
    ('equidistant', (0.05, -0.01, 0.002, -0.001), 1), ('equidistant', (0.05, 0, 0, 0), 9),
    ('plumb_bob', (-0.3, 0.1, 0.0, 0.0, 0.02), 2), ('plumb_bob', (-0.3, 0.1, 0.001, 0.0), 3)])
def test_trailing_zeros_of_the_distortion(
        model: str, d: tuple[float, ...], zeros: int) -> None:
    image = random_image('mono8', HEIGHT, WIDTH)
    expected, _ = Rectifier().rectify(image, GRAY8, make_info(model, d))
    rectified, _ = Rectifier().rectify(image, GRAY8, make_info(model, (*d, *zeros * (0.0,))))
    assert np.array_equal(rectified, expected)


@pytest.mark.parametrize(('width', 'height'), [(32_767, 2), (2, 40_000), (0, 0), (0, 5)])
def test_sizes_that_cannot_be_rectified(width: int, height: int) -> None:
    info = make_info(width=width, height=height)
    with pytest.raises(RectificationError, match='with 1 to 32766 pixels a side can be'):
        Rectifier().rectify(np.zeros((height, width), np.uint8), GRAY8, info)


any_calibration = given(
    info=camera_infos(st.floats()),
    name=st.sampled_from(['mono8', 'bgr16', '32FC1']),
    is_fitting=st.booleans(),
    model=st.sampled_from(['plumb_bob', 'equidistant', '']),
    d=st.sampled_from([0, 4, 5, 8, 14]).flatmap(
        lambda count: st.lists(st.floats(), min_size=count, max_size=count)),
    focal=st.floats(1e-300, 1e300))


def check_any_calibration_gives_an_image_or_an_error(
        info: CameraInfo, name: str, is_fitting: bool, model: str, d: list[float],
        focal: float) -> None:
    if is_fitting:
        info.width, info.height, info.binning_x, info.binning_y = 8, 6, 0, 0
        info.roi = RegionOfInterest()
        info.distortion_model, info.d = model, d
        info.k[0] = info.k[4] = info.p[0] = info.p[5] = info.p[10] = focal
        info.r = np.eye(3).ravel()
    image = random_image(name, 6, 8)
    try:
        rectified, _ = Rectifier().rectify(image, find_encoding(name), info)
    except RectificationError as err:
        assert len(str(err)) < 300 and str(err).isprintable()
    else:
        assert rectified.shape == image.shape


@pytest.mark.quick_cases(1)
@pytest.mark.parametrize('examples', [30, 100])
def test_any_calibration_gives_an_image_or_an_error(examples: int) -> None:
    check = any_calibration(check_any_calibration_gives_an_image_or_an_error)
    settings(ANY_MACHINE, max_examples=examples)(check)()
