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

"""Every conversion of the cv_bridge replacement, compared with OpenCV and with cv_bridge."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence

import cv2
from images import ask_cv_bridge, random_image, recorded_outcomes
import numpy as np
from opencv_tools.cv_bridge import CvBridge, CvBridgeError
from opencv_tools.image.depth import change_depth
from opencv_tools.image.encodings import COLOR_ENCODINGS, Encoding, ENCODINGS, find_encoding
import pytest
from sensor_msgs.msg import Image

SIZES = ((1, 1), (1, 2), (2, 2), (3, 4), (5, 6), (7, 5), (6, 9), (34, 30))
OUTCOMES = recorded_outcomes()
SOURCES = [*dict.fromkeys(source for source, _ in OUTCOMES),
           'uyvy', 'yuyv', 'nv12', 'nv21', 'nv24']

COLORS = {'y': 'GRAY', 'rgb': 'RGB', 'bgr': 'BGR', 'rgba': 'RGBA', 'bgra': 'BGRA'}
# OpenCV names a mosaic by the second row, from its second pixel on.
MOSAICS = {'rggb': 'BG', 'bggr': 'RG', 'gbrg': 'GR', 'grbg': 'GB'}
YUV = {'uyvy': 'UYVY', 'yuyv': 'YUY2', 'nv12': 'NV12', 'nv21': 'NV21'}
DEPTHS = {'uint8': cv2.CV_8U, 'int8': cv2.CV_8S, 'uint16': cv2.CV_16U, 'int16': cv2.CV_16S,
          'int32': cv2.CV_32S, 'float32': cv2.CV_32F, 'float64': cv2.CV_64F}


def is_converted(source: str, desired: str) -> bool:
    """Return whether the conversion is supported by cv_bridge, or additionally by this package."""
    left, right = find_encoding(source), ENCODINGS.get(desired)
    if right and right.kind == 'color' and left.kind in ('bayer', 'yuv'):
        return True
    if (source, desired) in OUTCOMES:
        return OUTCOMES[source, desired] is None
    return source == desired or (
        left.channels == 2 and desired in ('8UC2', '8SC2', '16UC2', '16SC2', '32SC2', '32FC2',
                                           '64FC2'))


def opencv_colors(image: np.ndarray, source: Encoding, order: str) -> np.ndarray:
    """Convert colours with OpenCV."""
    if source.kind == 'bayer':
        return cv2.cvtColor(
            image, getattr(cv2, f'COLOR_Bayer{MOSAICS[source.order]}2{COLORS[order]}'))
    if source.name == 'nv24':  # unknown to OpenCV; each pixel becomes two equal pixels of UYVY
        luma, chroma = np.split(image, [len(image) // 3])
        pairs = np.dstack([chroma.reshape(len(luma), -1), np.repeat(luma, 2, axis=1)])
        return opencv_colors(pairs, ENCODINGS['uyvy'], order)[:, ::2]
    if source.order == 'uyvy' and order == 'y':
        return image[..., 1]
    if source.order == 'yuyv' and order == 'y':
        return image[..., 0]
    if source.kind == 'yuv':
        code = f'COLOR_YUV2{COLORS[order]}_{YUV[source.order]}'
    else:
        code = f'COLOR_{COLORS[source.order]}2{COLORS[order]}'
    return cv2.cvtColor(image, getattr(cv2, code))


def opencv_depth(image: np.ndarray, dtype: str) -> np.ndarray:
    """Convert the depth with OpenCV's arithmetic."""
    flat = np.ascontiguousarray(image).reshape(len(image), -1)
    sizes = (image.itemsize, np.dtype(dtype).itemsize)
    scale = {(1, 2): 257.0, (2, 1): 1 / 257.0}.get(sizes)
    if scale is None:
        changed = cv2.add(flat, np.zeros_like(flat), dtype=DEPTHS[dtype])
    else:
        changed = cv2.multiply(flat, np.ones_like(flat), scale=scale, dtype=DEPTHS[dtype])
    return changed.reshape(image.shape)


def opencv_conversion(image: np.ndarray, source: str, desired: str) -> np.ndarray:
    """Convert an image as cv_bridge does, with OpenCV's own functions."""
    left, right = find_encoding(source), find_encoding(desired or source)
    if left.name == right.name:
        return image
    if right.kind == 'color' and left.order != right.order:
        image = opencv_colors(image, left, right.order)
    return image if left.dtype == right.dtype else opencv_depth(image, right.dtype)


def tolerance(source: str, desired: str, version: str) -> int:
    """Return the error of OpenCV: 1 before 4.14 for 8-bit mosaics to gray, otherwise 0."""
    major, minor = (int(part) for part in version.split('.')[:2])
    if (major, minor) < (4, 14) and source.startswith('bayer') and source.endswith('8'):
        return {'mono8': 1, 'mono16': 257}.get(desired, 0)
    return 0


def same(left: np.ndarray, right: np.ndarray, within: int = 0) -> bool:
    """Return whether two images are equal in type, shape and values; NaN equals NaN."""
    if (left.shape, left.dtype) != (right.shape, right.dtype):
        return False
    if left.dtype.kind == 'f':
        return np.array_equal(left, right, equal_nan=True)
    return not left.size or np.abs(left.astype(np.int64) - right).max() <= within


def messages_of(image: np.ndarray, encoding: str) -> Iterator[Image]:
    """Yield an image as messages: without padding, with padded rows, in both byte orders."""
    bridge = CvBridge()
    yield bridge.cv2_to_imgmsg(image, encoding)
    yield bridge.cv2_to_imgmsg(image.astype(image.dtype.newbyteorder('>')), encoding)
    message = bridge.cv2_to_imgmsg(image, encoding)
    padding = 3 * find_encoding(encoding).pixel_bytes
    rows = np.frombuffer(message.data, np.uint8)
    if encoding == 'nv24':  # its chroma lines and their padding have twice the length
        luma, chroma = np.split(rows, [message.height * message.step])
        parts = [np.pad(luma.reshape(message.height, -1), ((0, 0), (0, padding)),
                        constant_values=77),
                 np.pad(chroma.reshape(message.height, -1), ((0, 0), (0, 2 * padding)),
                        constant_values=77)]
        padded = b''.join(part.tobytes() for part in parts)
    else:
        padded = np.pad(rows.reshape(len(image), -1), ((0, 0), (0, padding)),
                        constant_values=77).tobytes()
    message.data = padded
    message.step += padding
    yield message


def sizes_of(encoding: str, sizes: Sequence[tuple[int, int]]) -> list[tuple[int, int]]:
    """Return those of some sizes that an encoding can have."""
    found = find_encoding(encoding)
    columns, rows = 2 if found.kind == 'yuv' else 1, 2 if found.row_factor == 1.5 else 1
    return [(height, width) for height, width in sizes
            if not width % columns and not height % rows]


@pytest.mark.quick_cases(1)
@pytest.mark.parametrize('sizes', [SIZES[::3] + SIZES[-1:], SIZES], ids=['few', 'all'])
def test_every_conversion_equals_opencv(
        tell: Callable[[str], None], sizes: Sequence[tuple[int, int]]) -> None:
    bridge = CvBridge()
    names = [*dict.fromkeys(desired for _, desired in OUTCOMES)]
    pairs = [(source, desired) for source in SOURCES for desired in names
             if is_converted(source, desired)]
    images = 0
    wrong = []
    for source, desired in pairs:
        for height, width in sizes_of(source, sizes):
            image = random_image(source, height, width)
            expected = opencv_conversion(image, source, desired)
            for message in messages_of(image, source):
                images += 1
                converted = bridge.imgmsg_to_cv2(message, desired)
                assert converted.flags.c_contiguous and converted.flags.writeable
                assert not np.may_share_memory(converted, np.frombuffer(message.data, np.uint8))
                within = tolerance(source, desired, cv2.__version__)
                if not same(converted, expected, within):
                    wrong.append((source, desired, height, width))
    unequal = {pair[:2] for pair in wrong}
    tell(f'conversions equal to OpenCV {cv2.__version__}: '
         f'{len(pairs) - len(unequal)} of {len(pairs)} pairs, in {images} images')
    assert not wrong
    assert len(pairs) > 600


def test_every_refusal_has_the_text_of_cv_bridge(tell: Callable[[str], None]) -> None:
    bridge = CvBridge()
    refused = [(pair, text) for pair, text in OUTCOMES.items()
               if text is not None and not is_converted(*pair)]
    wrong = []
    for (source, desired), text in refused:
        message = bridge.cv2_to_imgmsg(random_image(source, 4, 6), source)
        with pytest.raises(CvBridgeError) as caught:
            bridge.imgmsg_to_cv2(message, desired)
        if str(caught.value) != text:
            wrong.append((source, desired, str(caught.value)))
    tell(f'error texts equal to those of cv_bridge: '
         f'{len(refused) - len(wrong)} of {len(refused)}')
    assert not wrong
    assert len(refused) > 2000


@pytest.mark.thorough
@pytest.mark.process
def test_every_conversion_equals_the_installed_cv_bridge(tell: Callable[[str], None]) -> None:
    bridge = CvBridge()
    # Debian's cv_bridge is of ROS 1, whose tables do not contain these.
    unknown = {'uyvy', 'yuyv', 'yuv422_yuy2', 'nv21', 'nv24', '64UC1', '64UC3', '8FC1', '16FC3'}
    jobs = [(source, random_image(source, height, width), desired)
            for source, desired in OUTCOMES if not {source, desired} & unknown
            for height, width in sizes_of(source, SIZES)
            if is_converted(source, desired) == (OUTCOMES[source, desired] is None)]
    answered = ask_cv_bridge(jobs)
    if answered is None:
        pytest.skip('no cv_bridge here: sudo apt install python3-cv-bridge')
    version, answers = answered
    wrong = []
    for (source, image, desired), answer in zip(jobs, answers):
        message = bridge.cv2_to_imgmsg(image, source)
        try:
            converted = bridge.imgmsg_to_cv2(message, desired)
        except CvBridgeError as err:
            equal = str(err) == answer
        else:
            within = tolerance(source, desired, version)
            equal = not isinstance(answer, str) and same(converted, answer, within)
        if not equal:
            wrong.append((source, desired, image.shape))
    tell(f'answers equal to those of python3-cv-bridge on OpenCV {version}: '
         f'{len(jobs) - len(wrong)} of {len(jobs)}')
    assert not wrong


@pytest.mark.thorough
def test_blocks_of_large_images_have_no_seam() -> None:
    bridge = CvBridge()
    for source in ('bgr8', 'rgba8', 'mono8', 'mono16', 'bgr16', 'bayer_grbg8', 'bayer_bggr16',
                   'uyvy', 'yuyv', 'nv12', 'nv24'):
        image = random_image(source, 510, 714)
        message = bridge.cv2_to_imgmsg(image, source)
        for desired in COLOR_ENCODINGS:
            expected = opencv_conversion(image, source, desired)
            converted = bridge.imgmsg_to_cv2(message, desired)
            assert same(converted, expected, tolerance(source, desired, cv2.__version__))


def test_floats_without_a_number_of_the_type_and_no_warning() -> None:
    image = np.array([[1e300, -1e300, np.nan, np.inf]])
    np.testing.assert_array_equal(change_depth(image, 'float32'),
                                  np.array([[np.inf, -np.inf, np.nan, np.inf]], np.float32))
    np.testing.assert_array_equal(change_depth(image, 'int32'), np.full((1, 4), -2**31, np.int32))


def test_every_16_bit_number_becomes_the_nearest_8_bit_number() -> None:
    numbers = np.arange(2**16, dtype=np.uint16).reshape(256, 256)
    message = CvBridge().cv2_to_imgmsg(numbers, 'mono16')
    expected = np.round(numbers.astype(np.float64) / 257).astype(np.uint8)
    np.testing.assert_array_equal(CvBridge().imgmsg_to_cv2(message, 'mono8'), expected)


def test_every_luma_with_every_chroma_equals_opencv() -> None:
    luma, u, v = (np.arange(256, dtype=np.uint8)[None],
                  *np.meshgrid(*[np.arange(0, 256, dtype=np.uint8)] * 2))
    for first in range(0, 256, 15):
        pairs = np.empty((256, 512, 2), np.uint8)
        pairs[:, ::2, 0], pairs[:, 1::2, 0] = u, v
        pairs[:, ::2, 1] = first
        pairs[:, 1::2, 1] = luma
        message = CvBridge().cv2_to_imgmsg(pairs, 'uyvy')
        np.testing.assert_array_equal(
            CvBridge().imgmsg_to_cv2(message, 'bgr8'), cv2.cvtColor(pairs, cv2.COLOR_YUV2BGR_UYVY))


@pytest.mark.parametrize('source', [name for name in ENCODINGS if name.startswith('bayer_')])
@pytest.mark.parametrize(('height', 'width'), [(5, 1), (5, 2), (3, 2), (1, 5), (2, 5)])
def test_mosaic_without_inner_pixels_is_black(source: str, height: int, width: int) -> None:
    image = np.full((height, width), 200, find_encoding(source).dtype)
    message = CvBridge().cv2_to_imgmsg(image, source)
    for desired in COLOR_ENCODINGS:
        converted = CvBridge().imgmsg_to_cv2(message, desired)
        assert converted.shape[:2] == (height, width)
        assert not converted.any()


@pytest.mark.parametrize(('height', 'width'), [(1, 1), (3, 5), (2, 7)])
def test_nv24_with_an_odd_width_has_colours(height: int, width: int) -> None:
    image = random_image('nv24', height, width)
    message = CvBridge().cv2_to_imgmsg(image, 'nv24')
    for desired in COLOR_ENCODINGS:
        assert same(CvBridge().imgmsg_to_cv2(message, desired),
                    opencv_conversion(image, 'nv24', desired))
