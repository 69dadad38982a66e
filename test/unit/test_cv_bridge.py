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

"""The cv_bridge replacement: its interface, and the defects of the original."""

from __future__ import annotations

import gc
import subprocess
import sys
import tracemalloc
from types import SimpleNamespace
import warnings

import cv2
from hypothesis import given, settings, strategies as st
from images import random_image
import numpy as np
from opencv_tools.cv_bridge import CvBridge, CvBridgeError, getCvType
from opencv_tools.image.cdr import cdr_to_image, image_to_cdr
from opencv_tools.image.encodings import ENCODINGS, find_encoding
from opencv_tools.image.layout import array_to_wire
import pytest
from sensor_msgs.msg import Image
from std_msgs.msg import Header
from waiting import LONGEST_SECONDS

SIZES = ((1, 1), (2, 3), (7, 5), (48, 64))


@pytest.mark.parametrize('encoding', [*ENCODINGS, '8UC1', '8UC5', '8S', '16UC2', '16SC3', '32SC1',
                                      '32FC1', '32FC3', '64FC4'])
def test_round_trip_of_every_encoding(encoding: str) -> None:
    bridge = CvBridge()
    found = find_encoding(encoding)
    for height, width in SIZES:
        if found.row_factor == 1.5:
            height, width = 2 * height, 2 * width
        image = random_image(encoding, height, width)
        message = bridge.cv2_to_imgmsg(image, encoding)
        assert (message.encoding, message.height, message.width) == (encoding, height, width)
        assert message.step == width * image.itemsize * found.channels
        assert len(message.data) == image.nbytes == found.rows(height) * message.step
        np.testing.assert_array_equal(bridge.imgmsg_to_cv2(message), image)


VARIANTS = {
    'as it is': lambda image: image,
    'upside down': lambda image: image[::-1],
    'mirrored': lambda image: image[:, ::-1],
    'every second column': lambda image: image[:, ::2],
    'a part': lambda image: image[1:, 1:],
    'in Fortran order': np.asfortranarray,
    'big-endian': lambda image: image.astype(image.dtype.newbyteorder('>')),
    'turned': lambda image: np.swapaxes(image, 0, 1),
    'with a third dimension': lambda image: image if image.ndim == 3 else image[..., np.newaxis],
}


any_array = given(
    encoding=st.sampled_from([
        *(name for name, found in ENCODINGS.items() if found.row_factor == 1),
        '8UC1', '8SC2', '16SC3', '32SC4', '32FC1', '64FC5']),
    height=st.integers(0, 12),
    width=st.integers(0, 12),
    variants=st.lists(st.sampled_from(sorted(VARIANTS)), max_size=3),
    is_writeable=st.booleans(),
    padding=st.integers(0, 70))


def check_round_trip_of_any_array_by_message_and_wire(
        encoding: str, height: int, width: int, variants: list[str], is_writeable: bool,
        padding: int) -> None:
    bridge = CvBridge()
    image = random_image(encoding, height, width)
    for variant in variants:
        image = VARIANTS[variant](image)
    image.flags.writeable = is_writeable and image.flags.writeable
    expected = image.astype(image.dtype.newbyteorder('=')).reshape(
        image.shape[:2] if find_encoding(encoding).channels == 1 else image.shape)
    message = bridge.cv2_to_imgmsg(image, encoding)
    np.testing.assert_array_equal(bridge.imgmsg_to_cv2(message), expected)
    copied = bridge.imgmsg_to_cv2(message, encoding)
    np.testing.assert_array_equal(copied, expected)
    assert copied.dtype == expected.dtype and copied.shape == expected.shape
    wire = cdr_to_image(image_to_cdr(array_to_wire(image, find_encoding(encoding))))
    np.testing.assert_array_equal(bridge.imgmsg_to_cv2(wire), expected)
    rows = np.frombuffer(message.data, np.uint8).reshape(message.height, message.step)
    padded = SimpleNamespace(
        encoding=encoding, height=message.height, width=message.width,
        step=message.step + padding, is_bigendian=message.is_bigendian,
        data=np.pad(rows, ((0, 0), (0, padding))).tobytes())
    np.testing.assert_array_equal(bridge.imgmsg_to_cv2(padded), expected)


@pytest.mark.quick_cases(1)
@pytest.mark.parametrize('examples', [125, 500])
def test_round_trip_of_any_array_by_message_and_wire(examples: int) -> None:
    settings(max_examples=examples)(any_array(check_round_trip_of_any_array_by_message_and_wire))()


def test_passthrough_is_a_view_that_keeps_the_data_alive() -> None:
    bridge = CvBridge()
    image = random_image('bgr8', 7, 5)
    message = bridge.cv2_to_imgmsg(image, 'bgr8')
    view = bridge.imgmsg_to_cv2(message)
    assert np.may_share_memory(view, np.frombuffer(message.data, np.uint8))
    del message
    np.testing.assert_array_equal(view, image)


def test_any_strides_and_byte_order_are_accepted() -> None:
    bridge = CvBridge()
    image = random_image('mono16', 6, 8)
    for variant in (image[::-1], image[:, ::2], np.asfortranarray(image), image.astype('>u2'),
                    image[..., np.newaxis]):
        message = bridge.cv2_to_imgmsg(variant, 'mono16')
        assert message.is_bigendian == (variant.dtype.byteorder == '>')
        np.testing.assert_array_equal(
            bridge.imgmsg_to_cv2(message, 'mono16'), variant.reshape(variant.shape[:2]))
        assert bridge.imgmsg_to_cv2(message, 'mono8').dtype == np.uint8


def test_padding_of_rows_is_skipped() -> None:
    image = random_image('bgr8', 4, 5)
    padded = np.zeros((4, 21), np.uint8)
    padded[:, :15] = image.reshape(4, 15)
    message = Image(height=4, width=5, encoding='bgr8', step=21)
    message.data.frombytes(padded.tobytes())
    np.testing.assert_array_equal(CvBridge().imgmsg_to_cv2(message), image)


def test_float_to_integer_rounds_and_saturates_like_opencv() -> None:
    bridge = CvBridge()
    values = np.array([[-1e30, -1.5, -0.5, 0.5, 1.5, 2.5, 254.5, 300, 70000, np.nan, np.inf]])
    message = bridge.cv2_to_imgmsg(values.astype(np.float32), '32FC1')
    assert bridge.imgmsg_to_cv2(message, '8UC1').tolist() == [
        [0, 0, 0, 0, 2, 2, 254, 255, 255, 0, 0]]
    assert bridge.imgmsg_to_cv2(message, '16SC1').tolist() == [
        [-32768, -2, 0, 0, 2, 2, 254, 300, 32767, -32768, -32768]]


def test_signalling_nan_is_converted_without_a_warning() -> None:
    bridge = CvBridge()
    image = np.array([[0x7fa00000, 0x3f800000]], np.uint32).view(np.float32)
    message = bridge.cv2_to_imgmsg(image, '32FC1')
    with warnings.catch_warnings():
        warnings.simplefilter('error')
        assert bridge.imgmsg_to_cv2(message, '8UC1').tolist() == [[0, 1]]
        assert np.isnan(bridge.imgmsg_to_cv2(message, '64FC1')).tolist() == [[True, False]]


@pytest.mark.parametrize(('image', 'encoding', 'text'), [
    (np.zeros((2, 2, 3), np.uint8), 'mono8',
     'encoding specified as mono8, but image has incompatible type 8UC3'),
    (np.zeros((2, 2), np.uint8), 'foo', 'Unrecognized image encoding [foo]'),
    (np.zeros((2, 2), np.int64), 'passthrough', 'An image of dtype int64 has no encoding'),
    (np.zeros(2, np.uint8), 'passthrough', 'An image must have 2 or 3 dimensions'),
])
def test_invalid_images_are_refused(image: np.ndarray, encoding: str, text: str) -> None:
    with pytest.raises(CvBridgeError) as caught:
        CvBridge().cv2_to_imgmsg(image, encoding)
    assert text in str(caught.value)


def test_objects_other_than_arrays_are_refused() -> None:
    with pytest.raises(TypeError, match='Your input type is not a numpy array'):
        CvBridge().cv2_to_imgmsg([[0]])


@pytest.mark.parametrize(('fields', 'desired', 'text'), [
    ({'encoding': 'bgr9'}, 'passthrough', 'Unrecognized image encoding [bgr9]'),
    ({'encoding': '8UC0'}, 'passthrough', 'Unrecognized image encoding [8UC0]'),
    ({'step': 5}, 'passthrough', 'a row needs 6 bytes, more than the step'),
    ({'encoding': 'mono16', 'step': 7}, 'passthrough', 'needs 14 bytes, but data has 12'),
    ({'height': 3}, 'passthrough', 'needs 18 bytes, but data has 12'),
    ({'height': 2**32 - 1, 'width': 2**32 - 1, 'step': 2**32 - 1}, 'passthrough', 'a row needs'),
    ({'encoding': '8UC3'}, 'bgr8', '[8UC3] is not a color format. but [bgr8] is. '
                                   'The conversion does not make sense'),
    ({}, '8UC1', '[bgr8] is a color format but [8UC1] is not so they must have the same OpenCV '
                 'type, CV_8UC3, CV16UC1 ....'),
    ({'encoding': '8UC3'}, '8UC1', '[8UC3] and [8UC1] do not have the same number of channel'),
    ({}, 'yuv422', 'Unsupported conversion from [bgr8] to [yuv422]'),
])
def test_invalid_messages_are_refused(fields: dict[str, object], desired: str, text: str) -> None:
    message = Image(**{'height': 2, 'width': 2, 'encoding': 'bgr8', 'step': 6, **fields})
    message.data.frombytes(bytes(12))
    with pytest.raises(CvBridgeError) as caught:
        CvBridge().imgmsg_to_cv2(message, desired)
    assert text in str(caught.value)


# Defects of the original cv_bridge, with a test for each.

def test_step_that_is_not_a_multiple_of_the_pixel() -> None:
    message = Image(height=2, width=2, encoding='bgr8', step=7, data=bytes(range(14)))
    image = CvBridge().imgmsg_to_cv2(message)
    assert image.reshape(2, 6).tolist() == [[0, 1, 2, 3, 4, 5], [7, 8, 9, 10, 11, 12]]


def test_step_that_is_too_small_is_refused() -> None:
    message = Image(height=2, width=3, encoding='mono8', step=2, data=bytes(6))
    with pytest.raises(CvBridgeError, match='a row needs 3 bytes, more than the step'):
        CvBridge().imgmsg_to_cv2(message)


def test_short_data_are_refused() -> None:
    message = Image(height=2, width=3, encoding='mono8', step=3, data=bytes(5))
    with pytest.raises(CvBridgeError, match='needs 6 bytes, but data has 5'):
        CvBridge().imgmsg_to_cv2(message)


@pytest.mark.parametrize('encoding', ['mono16', 'bgra16', '32SC2', '64FC1'])
@pytest.mark.parametrize('desired', ['passthrough', ''])
def test_big_endian_messages_become_native_arrays(encoding: str, desired: str) -> None:
    bridge = CvBridge()
    image = random_image(encoding, 4, 5)
    message = bridge.cv2_to_imgmsg(image.astype(image.dtype.newbyteorder('>')), encoding)
    assert message.is_bigendian
    converted = bridge.imgmsg_to_cv2(message, desired)
    assert converted.dtype.isnative
    np.testing.assert_array_equal(converted, image)


def test_view_outlives_the_message() -> None:
    bridge = CvBridge()
    image = random_image('bgr8', 300, 400)
    message = bridge.cv2_to_imgmsg(image, 'bgr8')
    view = bridge.imgmsg_to_cv2(message)
    with pytest.raises(BufferError):
        message.data.extend(bytes(10**7))  # would reallocate the bytes that the view refers to
    del message
    gc.collect()
    np.testing.assert_array_equal(view, image)


@pytest.mark.parametrize('dtype', ['int64', 'uint32', 'uint64', 'bool', 'float16', 'complex64'])
def test_unsupported_dtype_is_an_error_of_the_bridge(dtype: str) -> None:
    bridge = CvBridge()
    for use in (lambda: bridge.cv2_to_imgmsg(np.zeros((2, 2), dtype)),
                lambda: bridge.dtype_with_channels_to_cvtype2(np.dtype(dtype), 3)):
        with pytest.raises(CvBridgeError, match=f'An image of dtype {dtype} has no encoding'):
            use()


def test_failed_encoding_is_an_error_of_the_bridge() -> None:
    for image in (np.zeros((2, 2, 2), np.uint8), np.zeros((0, 0), np.uint8)):
        with pytest.raises(CvBridgeError):
            CvBridge().cv2_to_compressed_imgmsg(image, 'png')


@pytest.mark.parametrize(('height', 'width'), [(0, 0), (0, 5), (5, 0)])
@pytest.mark.parametrize('encoding', ['bgr8', 'mono16', 'bayer_rggb8', 'uyvy', 'nv24', '32FC1'])
def test_empty_image(encoding: str, height: int, width: int) -> None:
    bridge = CvBridge()
    width += encoding == 'uyvy' and width  # an even width
    message = bridge.cv2_to_imgmsg(random_image(encoding, height, width), encoding)
    assert (message.height, message.width, len(message.data)) == (height, width, 0)
    assert bridge.imgmsg_to_cv2(message).size == 0


@pytest.mark.parametrize(('height', 'width'), [(0, 0), (0, 5), (5, 0)])
@pytest.mark.parametrize('encoding', ['bgr8', 'mono16', 'bayer_rggb8', 'uyvy', 'nv24'])
def test_empty_image_in_another_encoding(encoding: str, height: int, width: int) -> None:
    bridge = CvBridge()
    width += encoding == 'uyvy' and width  # an even width
    message = bridge.cv2_to_imgmsg(random_image(encoding, height, width), encoding)
    assert bridge.imgmsg_to_cv2(message, 'mono8').shape == (height, width)
    assert bridge.imgmsg_to_cv2(message, 'bgra16').shape == (height, width, 4)


@pytest.mark.parametrize('encoding', ['yuv422', 'yuv422_yuy2', 'uyvy', 'yuyv'])
def test_yuv_422_with_an_odd_width_has_gray_but_no_colours(encoding: str) -> None:
    bridge = CvBridge()
    image = random_image(encoding, 3, 5)
    message = bridge.cv2_to_imgmsg(image, encoding)
    luma = image[..., 1 if encoding in ('yuv422', 'uyvy') else 0]
    np.testing.assert_array_equal(bridge.imgmsg_to_cv2(message, 'mono8'), luma)
    with pytest.raises(CvBridgeError, match=r'must have an even width .* a row has 5 pixels'):
        bridge.imgmsg_to_cv2(message, 'bgr8')


@pytest.mark.parametrize(('height', 'width'), [(2, 3), (3, 2)])
def test_yuv_420_with_an_odd_size_is_refused(height: int, width: int) -> None:
    message = Image(height=height, width=width, encoding='nv12', step=width, data=bytes(64))
    with pytest.raises(CvBridgeError, match='width and height must be even'):
        CvBridge().imgmsg_to_cv2(message)
    with pytest.raises(CvBridgeError, match='encoding specified as nv21, but image has 4 rows'):
        CvBridge().cv2_to_imgmsg(np.zeros((4, 2), np.uint8), 'nv21')


def test_array_is_copied_once_and_a_message_never() -> None:
    bridge = CvBridge()
    image = random_image('bgr8', 1080, 1920)
    tracemalloc.start()
    try:
        message = bridge.cv2_to_imgmsg(image, 'bgr8')
        _, one_copy = tracemalloc.get_traced_memory()
        tracemalloc.reset_peak()
        before, _ = tracemalloc.get_traced_memory()
        bridge.imgmsg_to_cv2(message)
        _, none = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert one_copy < 1.1 * image.nbytes
    assert none - before < 10_000


def test_header_is_kept() -> None:
    header = Header(frame_id='camera')
    header.stamp.sec, header.stamp.nanosec = 12, 34
    bridge = CvBridge()
    message = bridge.cv2_to_imgmsg(np.zeros((1, 1), np.uint8), 'mono8', header)
    compressed = bridge.cv2_to_compressed_imgmsg(np.zeros((1, 1), np.uint8), header=header)
    assert message.header == compressed.header == header


# The rest of the interface.

def test_types_have_the_numbers_of_the_imported_opencv() -> None:
    bridge = CvBridge()
    for depth in ('8U', '8S', '16U', '16S', '32S', '32F', '64F'):
        assert getCvType(depth) == getattr(cv2, f'CV_{depth}')
        for channels in range(1, 5):
            name = f'{depth}C{channels}'
            number = getattr(cv2, f'CV_{name}')
            assert getCvType(name) == bridge.encoding_to_cvtype2(name) == number
            assert bridge.cvtype_to_name[number] == name
            dtype, count = bridge.cvtype2_to_dtype_with_channels(number)
            assert (dtype, count) == bridge.encoding_to_dtype_with_channels(name)
            assert bridge.dtype_with_channels_to_cvtype2(np.dtype(dtype), count) == name
            assert bridge.cvdepth_to_numpy_depth[getattr(cv2, f'CV_{depth}')] == dtype
            assert bridge.numpy_type_to_cvtype[dtype] == depth
            assert bridge.numpy_type_to_cvtype[depth] == dtype
    assert getCvType('bgr8') == cv2.CV_8UC3
    assert getCvType('bayer_grbg16') == cv2.CV_16UC1
    assert getCvType('yuv422') == cv2.CV_8UC2
    with pytest.raises(CvBridgeError, match=r'Unrecognized image encoding \[foo\]'):
        getCvType('foo')
    for number in (-1, getattr(cv2, 'CV_16F', 7)):  # OpenCV 4.6 has no constant for this type
        with pytest.raises(CvBridgeError, match=f'^unknown OpenCV type {number};'):
            bridge.cvtype2_to_dtype_with_channels(number)


@pytest.mark.process
def test_types_have_the_numbers_of_opencv_4_without_opencv() -> None:
    script = ('import sys; sys.modules["cv2"] = None; del sys.modules["cv2"]; '
              'from opencv_tools.cv_bridge import getCvType; '
              'print(getCvType("8UC3"), getCvType("64FC1"))')
    finished = subprocess.run([sys.executable, '-c', script], capture_output=True, text=True,
                              timeout=LONGEST_SECONDS, check=True)
    assert finished.stdout.split() == ['16', '6']


@pytest.mark.process
@pytest.mark.parametrize('use', [
    'CvBridge().cv2_to_compressed_imgmsg(image)',
    'CvBridge().compressed_imgmsg_to_cv2(CompressedImage(data=b"x"))',
    'cvtColorForDisplay(image, "mono8", "bgr8", True, colormap=2)'])
def test_missing_opencv_is_an_error_of_the_bridge(use: str) -> None:
    script = ('import sys; sys.modules["cv2"] = None\n'
              'import numpy as np\n'
              'from opencv_tools.cv_bridge import CvBridge, CvBridgeError, cvtColorForDisplay\n'
              'from sensor_msgs.msg import CompressedImage\n'
              'image = np.zeros((2, 2), np.uint8)\n'
              f'try:\n    {use}\nexcept CvBridgeError as err:\n    print(err)')
    finished = subprocess.run([sys.executable, '-c', script], capture_output=True, text=True,
                              timeout=LONGEST_SECONDS, check=True)
    assert finished.stdout.startswith('compressed images and colormaps need OpenCV: ')


def test_any_object_with_the_fields_of_a_message_is_read() -> None:
    image = random_image('bgr8', 4, 5)
    for data in (image.tobytes(), bytearray(image.tobytes()), memoryview(image).cast('B'),
                 image.reshape(-1).tolist()):
        message = SimpleNamespace(height=4, width=5, encoding='bgr8', step=15, is_bigendian=0,
                                  data=data)
        np.testing.assert_array_equal(CvBridge().imgmsg_to_cv2(message), image)


def test_images_with_more_than_four_channels() -> None:
    bridge = CvBridge()
    image = random_image('8UC5', 3, 4)
    message = bridge.cv2_to_imgmsg(image)
    assert message.encoding == '8UC5'
    np.testing.assert_array_equal(bridge.imgmsg_to_cv2(message), image)
    np.testing.assert_array_equal(bridge.imgmsg_to_cv2(message, '32FC5'), image)
