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

"""Images for display, with the results of cv_bridge."""

from __future__ import annotations

import cv2
from images import random_image
import numpy as np
from opencv_tools.cv_bridge import CvBridge, CvBridgeError, cvtColorForDisplay
import pytest


def test_labels_become_colours() -> None:
    labels = np.arange(-3, 147, dtype=np.int32).reshape(10, 15)
    shown = cvtColorForDisplay(labels, '32SC1', 'bgr8')
    assert shown.dtype == np.uint8 and shown.shape == (10, 15, 3)
    assert (shown.reshape(-1, 3)[:3] == 0).all()
    aliceblue, antiquewhite, aqua = shown.reshape(-1, 3)[3:6].tolist()
    assert (aliceblue, antiquewhite, aqua) == ([255, 248, 239], [214, 235, 249], [255, 255, 0])
    assert shown.reshape(-1, 3)[149].tolist() == aliceblue  # the 146 colours repeat
    np.testing.assert_array_equal(
        cvtColorForDisplay(labels.astype(np.int64), '32SC1', 'bgr8'), shown)


@pytest.mark.parametrize('options', [
    {'do_dynamic_scaling': True}, {'min_image_value': 50.0, 'max_image_value': 150.0}, {}])
def test_floats_are_scaled_between_their_limits(options: dict[str, object]) -> None:
    image = np.array([[50, 100, 150, -np.inf, np.inf, np.nan]], np.float32)
    shown = cvtColorForDisplay(image, '32FC1', 'mono8', **options)
    assert shown.tolist() == [[0, 128, 255, 0, 0, 0]]
    in_color = cvtColorForDisplay(image.astype(np.float64), '64FC1', '', **options)
    np.testing.assert_array_equal(in_color, np.repeat(shown[..., np.newaxis], 3, axis=2))


@pytest.mark.parametrize(('image', 'shown'), [
    (np.array([3e38, -3e38, 0.0], np.float32), [0, 0, 128]),  # a range that exceeds float32
    (np.array([np.inf, -np.inf, np.nan, 0.0, 1.0], np.float32), [0, 0, 0, 0, 255]),
    (np.array([0x7fa00000, 0, 0x3f800000], np.uint32).view(np.float32), [0, 0, 255])])
def test_nan_and_infinity_are_displayed_without_a_warning(
        image: np.ndarray, shown: list[int]) -> None:
    with np.errstate(all='raise'):
        assert cvtColorForDisplay(image[np.newaxis], '32FC1', 'mono8').tolist() == [shown]


def test_float_colours_are_scaled() -> None:
    image = np.array([[[0, 0.5, 1], [1, 0.25, 0]]], np.float32)
    assert cvtColorForDisplay(image, '32FC3', 'rgb8').tolist() == [
        [[255, 128, 0], [0, 64, 255]]]


def test_equal_numbers_become_middle_gray() -> None:
    image = np.full((2, 3), 7, np.uint16)
    shown = cvtColorForDisplay(image, '16UC1', 'mono8', do_dynamic_scaling=True)
    assert shown.tolist() == [[128] * 3] * 2
    nothing = np.full((2, 3), np.nan, np.float32)
    assert cvtColorForDisplay(nothing, '32FC1', 'bgr8').tolist() == [[[128] * 3] * 3] * 2


def test_colormap_applies_to_scaled_numbers() -> None:
    image = np.array([[0, 5, 10, np.nan]], np.float32)
    shown = cvtColorForDisplay(
        image, '32FC1', 'rgb8', do_dynamic_scaling=True, colormap=cv2.COLORMAP_JET)
    expected = cv2.applyColorMap(np.array([[0, 128, 255]], np.uint8), cv2.COLORMAP_JET)
    assert shown[0, :3].tolist() == expected[0, :, ::-1].tolist()
    assert shown[0, 3].tolist() == [0, 0, 0]
    with pytest.raises(CvBridgeError, match='unknown colormap 999; give one of'):
        cvtColorForDisplay(image, '32FC1', 'rgb8', True, colormap=999)


@pytest.mark.parametrize(('source', 'taken_for'), [
    ('8UC1', 'mono8'), ('8UC3', 'bgr8'), ('8UC4', 'bgra8'), ('16UC1', 'mono16'),
    ('16UC3', 'bgr16'), ('16UC4', 'bgra16'), ('bayer_grbg8', 'bayer_grbg8'), ('uyvy', 'uyvy'),
    ('rgb16', 'rgb16'), ('mono8', 'mono8'),
])
def test_other_encodings_are_converted_for_display(source: str, taken_for: str) -> None:
    bridge = CvBridge()
    image = random_image(source, 6, 8)
    message = bridge.cv2_to_imgmsg(image, taken_for)
    for settings in ('bgr8', 'rgb8', 'mono8', 'rgba8'):
        np.testing.assert_array_equal(
            cvtColorForDisplay(image, source, settings), bridge.imgmsg_to_cv2(message, settings))
    np.testing.assert_array_equal(
        cvtColorForDisplay(image, source, ''), bridge.imgmsg_to_cv2(message, 'bgr8'))


@pytest.mark.parametrize(('source', 'settings', 'options', 'reason'), [
    ('bgr8', 'bgr16', {}, 'does not have an output encoding that is color or mono'),
    ('bgr8', '8UC3', {}, 'does not have an output encoding that is color or mono'),
    ('bgr8', 'foo', {}, 'does not have an output encoding that is color or mono'),
    ('bgr8', 'mono8', {'do_dynamic_scaling': True}, 'scaling for images with more than one'),
    ('16SC1', 'bgr8', {}, "cvtColorForDisplay() while trying to convert image from '16SC1' to "
     "'bgr8' an exception was thrown ([16SC1] is not a color format."),
    ('8UC2', 'bgr8', {}, 'The conversion does not make sense'),
])
def test_encodings_without_a_display_form_are_refused(
        source: str, settings: str, options: dict[str, object], reason: str) -> None:
    with pytest.raises(CvBridgeError) as caught:
        cvtColorForDisplay(random_image(source, 4, 4), source, settings, **options)
    assert reason in str(caught.value)
    with pytest.raises(CvBridgeError, match='encoding specified as mono16, but image has'):
        cvtColorForDisplay(np.zeros((2, 2), np.uint8), 'mono16', 'bgr8')
