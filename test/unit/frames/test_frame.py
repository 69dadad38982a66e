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

"""Every conversion of a frame, compared with cv_bridge, which does not use OpenCV."""

from __future__ import annotations

import cv2
from images import random_image, recorded_outcomes
import numpy as np
from opencv_tools.cv_bridge import CvBridge, CvBridgeError
from opencv_tools.frames.frame import check_target, Frame
from opencv_tools.image.cdr import WireImage
from opencv_tools.image.encodings import ENCODINGS, find_encoding
from opencv_tools.image.errors import EncodingError, RectificationError
from opencv_tools.image.layout import array_to_wire
from opencv_tools.rectification import Rectifier
import pytest
from sensor_msgs.msg import CameraInfo

OUTCOMES = recorded_outcomes()
SOURCES = [*dict.fromkeys([*(source for source, _ in OUTCOMES), *ENCODINGS])]
TARGETS = [*dict.fromkeys([*(desired for _, desired in OUTCOMES), *ENCODINGS, 'passthrough'])]
SIZES = ((2, 2), (6, 10), (34, 30))
# OpenCV before 4.14 has errors of 1 in the conversion of Bayer mosaics to gray.
OLD_BAYER = tuple(map(int, cv2.__version__.split('.')[:2])) < (4, 14)


def tolerance(source: str, target: str) -> int:
    if OLD_BAYER and source.startswith('bayer') and source.endswith('8'):
        return {'mono8': 1, 'mono16': 257}.get(target, 0)
    return 0


def image_message(encoding: str, height: int, width: int) -> WireImage:
    return array_to_wire(random_image(encoding, height, width), find_encoding(encoding))


@pytest.mark.parametrize('source', SOURCES)
def test_conversions_and_refusals_equal_cv_bridge(source: str) -> None:
    refused = 0
    for height, width in SIZES:
        message = image_message(source, height, width)
        frame = Frame(message)
        for target in TARGETS:
            try:
                expected = CvBridge().imgmsg_to_cv2(message, target)
            except CvBridgeError as err:
                with pytest.raises(CvBridgeError) as caught:
                    frame.to(target)
                assert str(caught.value) == str(err)
                refused += 1
                continue
            converted = frame.to(target)
            assert (converted.dtype, converted.flags.writeable) == (expected.dtype, False)
            np.testing.assert_allclose(converted, expected, rtol=0, atol=tolerance(source, target))
    assert 0 < refused < len(TARGETS) * len(SIZES)


@pytest.mark.parametrize('target', ['', 'passthrough', 'yuyv'])
def test_unconverted_image_is_a_view(target: str) -> None:
    message = image_message('yuyv', 6, 10)
    frame = Frame(message, target)
    assert frame.image is frame.raw
    assert np.shares_memory(frame.raw, np.frombuffer(message.data, np.uint8))
    assert frame.encoding == 'yuyv'
    assert not frame.raw.flags.writeable


@pytest.mark.parametrize('name', ['', 'passthrough', 'bgr8', 'nv24', '32FC1', '8UC512'])
def test_names_of_targets(name: str) -> None:
    check_target(name)


@pytest.mark.parametrize('name', ['nope', 'BGR8', '8UC0', '64UC1', '8UC513'])
def test_unknown_names_of_targets(name: str) -> None:
    with pytest.raises(EncodingError, match=rf'Unrecognized image encoding \[{name}\]'):
        check_target(name)


def straight_camera(width: int, height: int) -> CameraInfo:
    """Return a calibration whose rectified images are shifted by one pixel to the left."""
    k = [10.0, 0, 3, 0, 10, 3, 0, 0, 1]
    return CameraInfo(width=width, height=height, k=k, r=np.eye(3).ravel(),
                      p=[10.0, 0, 2, 0, 0, 10, 3, 0, 0, 0, 1, 0])


@pytest.mark.parametrize(('encoding', 'target', 'expected'), [
    ('rgb8', 'bgr8', 'bgr8'), ('rgb8', '', 'rgb8'), ('rgb8', 'mono8', 'mono8'),
    ('16UC1', '', '16UC1'), ('bayer_rggb8', '', 'bgr8'), ('yuyv', 'passthrough', 'bgr8')])
def test_rectified_pixels(encoding: str, target: str, expected: str) -> None:
    frame = Frame(image_message(encoding, 6, 10), target, camera_info=straight_camera(10, 6))
    rectified = frame.rectified
    assert rectified is frame.rectified
    assert not rectified.flags.writeable
    assert np.array_equal(rectified[:, :-1], frame.to(expected)[:, 1:])
    assert not rectified[:, -1].any()


def test_maps_of_the_frames_of_a_subscription() -> None:
    rectifier = Rectifier()
    maps = set()
    for _ in range(3):
        frame = Frame(image_message('bgr8', 6, 10), camera_info=straight_camera(10, 6),
                      rectifier=rectifier)
        assert np.array_equal(frame.rectified[:, :-1], frame.image[:, 1:])
        maps.add(id(rectifier._maps))
    assert len(maps) == 1


def test_rectified_without_camera_info() -> None:
    frame = Frame(image_message('bgr8', 6, 10))
    for _ in range(2):
        with pytest.raises(RectificationError, match='without camera_info cannot be rectified: '
                                                     'give camera_info=True to receive_frames'):
            _ = frame.rectified


def test_rectified_without_a_calibration() -> None:
    frame = Frame(image_message('bgr8', 6, 10), camera_info=CameraInfo(width=10, height=6))
    with pytest.raises(ValueError, match='has no calibration, because its K is zero'):
        _ = frame.rectified


@pytest.mark.parametrize(('encoding', 'factor'), [('16UC1', 1000), ('mono16', 1000), ('32FC1', 1)])
def test_points_of_depth(encoding: str, factor: int) -> None:
    depth = np.random.default_rng(3).uniform(0.4, 8, (6, 10))
    image = (depth * factor).astype(find_encoding(encoding).dtype)
    image[2, 3:5] = 0
    if factor == 1:
        image[4, 4:7] = np.nan, np.inf, -1
    frame = Frame(array_to_wire(image, find_encoding(encoding)),
                  camera_info=straight_camera(10, 6))
    points = frame.points()
    assert points.shape == (6, 10, 3) and points.dtype == np.float32
    has_depth = np.isfinite(image) & (image > 0)
    assert np.array_equal(np.isfinite(points).all(axis=2), has_depth)
    assert np.isnan(points[~has_depth]).all()
    rows, columns = np.mgrid[:6, :10]
    z = image / factor
    expected = np.stack(((columns - 3) / 10 * z, (rows - 3) / 10 * z, z), axis=2)
    assert np.allclose(points[has_depth], expected[has_depth], rtol=1e-5)


def test_points_of_other_images() -> None:
    frame = Frame(image_message('bgr8', 6, 10), camera_info=straight_camera(10, 6))
    with pytest.raises(RectificationError, match='an image of bgr8 has no depth: 16UC1, mono16'):
        frame.points()
    with pytest.raises(RectificationError, match='without camera_info cannot have points: give '):
        Frame(image_message('16UC1', 6, 10)).points()
