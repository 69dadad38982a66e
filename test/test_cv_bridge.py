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

"""The conversions of the cv_bridge replacement, against OpenCV's own arithmetic."""

from __future__ import annotations

import itertools

import cv2
import numpy as np
from opencv_tools.cv_bridge import CvBridge, CvBridgeError
from opencv_tools.image.encodings import COLOR_ENCODINGS, ENCODINGS, find_encoding
import pytest
from sensor_msgs.msg import Image
from std_msgs.msg import Header

SIZES = ((1, 1), (2, 3), (7, 5), (48, 64))
RANDOM = np.random.default_rng(2)


def random_image(encoding: str, height: int, width: int) -> np.ndarray:
    """Make an image of random values over the whole range of its type."""
    dtype, channels = CvBridge().encoding_to_dtype_with_channels(encoding)
    shape = (height, width) if channels == 1 else (height, width, channels)
    if np.dtype(dtype).kind == 'f':
        return RANDOM.normal(0, 1e4, shape).astype(dtype)
    limits = np.iinfo(dtype)
    return RANDOM.integers(limits.min, limits.max, shape, dtype, endpoint=True)


def opencv_colors(image: np.ndarray, source: str, target: str) -> np.ndarray:
    """Convert colours with cv2, depth with float64 and numpy's own rounding."""
    names = {'y': 'GRAY', 'rgb': 'RGB', 'bgr': 'BGR', 'rgba': 'RGBA', 'bgra': 'BGRA'}
    left, right = find_encoding(source), find_encoding(target)
    if left.order != right.order:
        code = f'COLOR_{names[left.order]}2{names[right.order]}'
        image = cv2.cvtColor(image, getattr(cv2, code))
    if left.dtype == right.dtype:
        return image
    scale = 257.0 if right.dtype == 'uint16' else 1 / 257.0
    return np.floor(image.astype(np.float64) * scale + 0.5).astype(right.dtype)


@pytest.mark.parametrize(
    ('source', 'target'), list(itertools.product(COLOR_ENCODINGS, repeat=2)))
def test_colours_are_those_of_opencv(source: str, target: str) -> None:
    bridge = CvBridge()
    for height, width in SIZES:
        image = random_image(source, height, width)
        message = bridge.cv2_to_imgmsg(image, source)
        converted = bridge.imgmsg_to_cv2(message, target)
        expected = opencv_colors(image, source, target)
        assert converted.dtype == expected.dtype
        np.testing.assert_array_equal(converted, expected)
        assert converted.flags.c_contiguous and converted.flags.writeable
        assert not np.may_share_memory(converted, np.frombuffer(message.data, np.uint8))


@pytest.mark.parametrize('encoding', [*ENCODINGS, '8UC1', '8UC5', '8S', '16UC2', '16SC3', '32SC1',
                                      '32FC1', '32FC3', '64FC4'])
def test_every_encoding_comes_back_as_it_was(encoding: str) -> None:
    bridge = CvBridge()
    for height, width in SIZES:
        image = random_image(encoding, height, width)
        message = bridge.cv2_to_imgmsg(image, encoding)
        assert message.encoding == encoding
        assert message.step == width * image.itemsize * (image.size // (height * width))
        assert len(message.data) == height * message.step
        np.testing.assert_array_equal(bridge.imgmsg_to_cv2(message), image)


def test_passthrough_is_a_view_that_keeps_the_data_alive() -> None:
    bridge = CvBridge()
    image = random_image('bgr8', 7, 5)
    message = bridge.cv2_to_imgmsg(image, 'bgr8')
    view = bridge.imgmsg_to_cv2(message)
    assert np.may_share_memory(view, np.frombuffer(message.data, np.uint8))
    del message
    np.testing.assert_array_equal(view, image)


def test_any_strides_and_byte_order() -> None:
    bridge = CvBridge()
    image = random_image('mono16', 6, 8)
    for variant in (image[::-1], image[:, ::2], np.asfortranarray(image), image.astype('>u2'),
                    image[..., np.newaxis]):
        message = bridge.cv2_to_imgmsg(variant, 'mono16')
        assert message.is_bigendian == (variant.dtype.byteorder == '>')
        np.testing.assert_array_equal(
            bridge.imgmsg_to_cv2(message, 'mono16'), variant.reshape(variant.shape[:2]))
        assert bridge.imgmsg_to_cv2(message, 'mono8').dtype == np.uint8


def test_padded_rows_are_honoured() -> None:
    image = random_image('bgr8', 4, 5)
    padded = np.zeros((4, 20), np.uint8)
    padded[:, :15] = image.reshape(4, 15)
    message = Image(height=4, width=5, encoding='bgr8', step=20)
    message.data.frombytes(padded.tobytes())
    np.testing.assert_array_equal(CvBridge().imgmsg_to_cv2(message), image)


def test_float_to_integer_rounds_and_saturates_as_opencv_does() -> None:
    bridge = CvBridge()
    values = np.array([[-1e30, -1.5, -0.5, 0.5, 1.5, 2.5, 254.5, 300, 70000, np.nan, np.inf]])
    message = bridge.cv2_to_imgmsg(values.astype(np.float32), '32FC1')
    assert bridge.imgmsg_to_cv2(message, '8UC1').tolist() == [
        [0, 0, 0, 0, 2, 2, 254, 255, 255, 0, 0]]
    assert bridge.imgmsg_to_cv2(message, '16SC1').tolist() == [
        [-32768, -2, 0, 0, 2, 2, 254, 300, 32767, -32768, -32768]]


def test_header_is_kept() -> None:
    header = Header(frame_id='camera')
    message = CvBridge().cv2_to_imgmsg(np.zeros((1, 1), np.uint8), 'mono8', header)
    assert message.header.frame_id == 'camera'


@pytest.mark.parametrize(('image', 'encoding', 'text'), [
    (np.zeros((2, 2, 3), np.uint8), 'mono8',
     'encoding specified as mono8, but image has incompatible type 8UC3'),
    (np.zeros((2, 2), np.uint8), 'foo', 'Unrecognized image encoding [foo]'),
    (np.zeros((2, 2), np.int64), 'passthrough', 'An image of dtype int64 has no encoding'),
    (np.zeros(2, np.uint8), 'passthrough', 'An image has 2 or 3 dimensions'),
])
def test_images_that_are_refused(image: np.ndarray, encoding: str, text: str) -> None:
    with pytest.raises(CvBridgeError) as caught:
        CvBridge().cv2_to_imgmsg(image, encoding)
    assert text in str(caught.value)


def test_no_array_is_refused() -> None:
    with pytest.raises(TypeError, match='Your input type is not a numpy array'):
        CvBridge().cv2_to_imgmsg([[0]])


@pytest.mark.parametrize(('fields', 'desired', 'text'), [
    ({'encoding': 'bgr9'}, 'passthrough', 'Unrecognized image encoding [bgr9]'),
    ({'encoding': '8UC0'}, 'passthrough', 'Unrecognized image encoding [8UC0]'),
    ({'step': 5}, 'passthrough', 'a row takes 6 bytes, more than the step'),
    ({'encoding': 'mono16', 'step': 5}, 'passthrough', 'not a multiple of 2 bytes'),
    ({'height': 3}, 'passthrough', 'takes 18 bytes, but data has 12'),
    ({'height': 2**32 - 1, 'width': 2**32 - 1, 'step': 2**32 - 1}, 'passthrough', 'a row takes'),
    ({'encoding': '8UC3'}, 'bgr8', '[8UC3] is not a color format. but [bgr8] is. '
                                   'The conversion does not make sense'),
    ({}, '8UC1', '[bgr8] is a color format but [8UC1] is not so they must have the same OpenCV '
                 'type, CV_8UC3, CV16UC1 ....'),
    ({'encoding': '8UC3'}, '8UC1', '[8UC3] and [8UC1] do not have the same number of channel'),
    ({}, 'yuv422', 'Unsupported conversion from [bgr8] to [yuv422]'),
])
def test_messages_that_are_refused(fields: dict[str, object], desired: str, text: str) -> None:
    message = Image(**{'height': 2, 'width': 2, 'encoding': 'bgr8', 'step': 6, **fields})
    message.data.frombytes(bytes(12))
    with pytest.raises(CvBridgeError) as caught:
        CvBridge().imgmsg_to_cv2(message, desired)
    assert text in str(caught.value)


@pytest.mark.parametrize(('height', 'width'), [(0, 0), (0, 5), (5, 0)])
def test_an_empty_image_is_an_empty_array(height: int, width: int) -> None:
    bridge = CvBridge()
    message = bridge.cv2_to_imgmsg(np.zeros((height, width, 3), np.uint8), 'bgr8')
    assert bridge.imgmsg_to_cv2(message).shape == (height, width, 3)
    assert bridge.imgmsg_to_cv2(message, 'mono8').shape == (height, width)
