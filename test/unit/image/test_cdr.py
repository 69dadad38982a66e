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

"""CDR messages, compared with those of rclpy."""

from __future__ import annotations

import array
from dataclasses import replace
from functools import partial
import struct

from hypothesis import given, settings, strategies as st
from images import random_image
import numpy as np
from opencv_tools.cv_bridge import CvBridge
from opencv_tools.image.cdr import (
    cdr_to_compressed_image, cdr_to_image, compressed_image_to_cdr, DISPARITY_IMAGE, image_to_cdr,
    WireCompressedImage, WireDisparity, WireHeader, WireImage)
from opencv_tools.image.encodings import declared_encoding, find_encoding
from opencv_tools.image.errors import CdrError, EncapsulationError, EncodingError
from opencv_tools.image.layout import array_to_wire
from opencv_tools.topics.messages import IMAGE, read_message
import pytest
from rclpy.serialization import deserialize_message, serialize_message
from sensor_msgs.msg import CompressedImage, Image
from std_msgs.msg import Header
from stereo_msgs.msg import DisparityImage

UINT32 = st.integers(0, 2**32 - 1)
TEXTS = st.text(st.characters(exclude_characters='\0', exclude_categories=['Cs']), max_size=40)
HEADERS = st.builds(WireHeader, st.integers(-2**31, 2**31 - 1), UINT32, TEXTS)
IMAGES = st.builds(
    WireImage, header=HEADERS, height=UINT32, width=UINT32, encoding=TEXTS,
    is_bigendian=st.booleans(), step=UINT32, data=st.binary(max_size=100))
COMPRESSED_IMAGES = st.builds(
    WireCompressedImage, header=HEADERS, format=TEXTS, data=st.binary(max_size=100))


def message_of(image: WireImage | WireCompressedImage) -> Image | CompressedImage:
    """Return the ROS message with the same fields."""
    if isinstance(image, WireImage):
        message = Image(height=image.height, width=image.width, encoding=image.encoding,
                        is_bigendian=image.is_bigendian, step=image.step)
    else:
        message = CompressedImage(format=image.format)
    message.header.frame_id = image.header.frame_id
    message.header.stamp.sec = image.header.sec
    message.header.stamp.nanosec = image.header.nanosec
    message.data = array.array('B', bytes(image.data))
    return message


def padding_of(image: WireImage | WireCompressedImage) -> list[int]:
    """Return the positions of the padding, which the middleware does not initialise."""
    if isinstance(image, WireImage):  # two numbers, a string and a byte follow frame_id
        unaligned = [image.header.frame_id, f'{image.encoding}{"x" * 9}']
    else:
        unaligned = [image.header.frame_id, image.format]
    positions = []
    end = 12
    for text in unaligned:
        end += 4 + len(text.encode()) + 1
        aligned = -(-end // 4) * 4
        positions += range(end, aligned)
        end = aligned
    return positions


def without(data: bytes, positions: list[int]) -> bytes:
    return bytes(byte for index, byte in enumerate(data) if index not in positions)


def check_image_to_cdr_equals_rclpy(image: WireImage) -> None:
    ours, theirs = image_to_cdr(image), serialize_message(message_of(image))
    assert len(ours) == len(theirs)
    assert without(ours, padding_of(image)) == without(theirs, padding_of(image))
    assert deserialize_message(ours, Image) == message_of(image)
    assert cdr_to_image(theirs) == image
    assert cdr_to_image(ours) == image


@pytest.mark.quick_cases(1)
@pytest.mark.parametrize('examples', [75, 300])
def test_image_to_cdr_equals_rclpy(examples: int) -> None:
    settings(max_examples=examples)(given(IMAGES)(check_image_to_cdr_equals_rclpy))()


any_compressed_image = given(COMPRESSED_IMAGES)


def check_compressed_image_to_cdr_equals_rclpy(image: WireCompressedImage) -> None:
    ours, theirs = compressed_image_to_cdr(image), serialize_message(message_of(image))
    assert len(ours) == len(theirs)
    assert without(ours, padding_of(image)) == without(theirs, padding_of(image))
    assert deserialize_message(ours, CompressedImage) == message_of(image)
    assert cdr_to_compressed_image(theirs) == image
    assert cdr_to_compressed_image(ours) == image


@pytest.mark.quick_cases(1)
@pytest.mark.parametrize('examples', [50, 200])
def test_compressed_image_to_cdr_equals_rclpy(examples: int) -> None:
    check = any_compressed_image(check_compressed_image_to_cdr_equals_rclpy)
    settings(max_examples=examples)(check)()


def check_truncated_message_is_refused(image: WireImage, data: st.DataObject) -> None:
    whole = image_to_cdr(image)
    cut = whole[:data.draw(st.integers(0, len(whole) - 1))]
    with pytest.raises(CdrError):
        cdr_to_image(cut)
    with pytest.raises(CdrError):
        read_message(cut, IMAGE)


@pytest.mark.quick_cases(1)
@pytest.mark.parametrize('examples', [75, 300])
def test_truncated_message_is_refused(examples: int) -> None:
    settings(max_examples=examples)(given(IMAGES, st.data())(check_truncated_message_is_refused))()


any_bytes = given(st.binary(max_size=200))


def check_random_bytes_are_read_or_refused(data: bytes) -> None:
    for head in (b'', b'\0\0\0\0', b'\0\1\0\0', b'\0\3\0\0'):
        for read in (
                cdr_to_image, cdr_to_compressed_image, partial(read_message, type_name=IMAGE)):
            try:
                image = read(head + data)
            except CdrError as err:
                assert str(err)
            else:
                assert len(image.data) <= len(data)


@pytest.mark.quick_cases(1)
@pytest.mark.parametrize('examples', [75, 300])
def test_random_bytes_are_read_or_refused(examples: int) -> None:
    settings(max_examples=examples)(any_bytes(check_random_bytes_are_read_or_refused))()


def big_endian(image: WireImage) -> bytes:
    """Return a big-endian message, serialised without the package."""
    def text(value: str, position: int) -> bytes:
        encoded = value.encode() + b'\0'
        return bytes(-position % 4) + struct.pack('>I', len(encoded)) + encoded
    data = b'\0\0\0\0' + struct.pack('>iI', image.header.sec, image.header.nanosec)
    data += text(image.header.frame_id, len(data))
    data += bytes(-len(data) % 4) + struct.pack('>II', image.height, image.width)
    data += text(image.encoding, len(data)) + bytes([image.is_bigendian])
    data += bytes(-len(data) % 4) + struct.pack('>II', image.step, len(image.data))
    return data + bytes(image.data)


@settings(max_examples=100, deadline=None)
@given(IMAGES)
def test_big_endian_messages_are_read(image: WireImage) -> None:
    assert cdr_to_image(big_endian(image)) == image


def test_other_encapsulations_are_left_to_the_middleware() -> None:
    serialized = serialize_message(Image(height=1, width=1, encoding='mono8', step=1))
    parameter_list = b'\0\3' + serialized[2:]
    with pytest.raises(EncapsulationError, match='0003 is not plain CDR'):
        cdr_to_image(parameter_list)
    try:
        assert read_message(parameter_list, IMAGE) == read_message(serialized, IMAGE)
    except CdrError as err:
        assert 'the middleware cannot read the message' in str(err)


@pytest.mark.parametrize('encoding', ['bgr8', 'mono16', '32FC3', 'nv12'])
def test_round_trip_of_an_array_reads_without_a_copy(encoding: str) -> None:
    image = random_image(encoding, 6, 8)
    header = Header(frame_id='camera')
    header.stamp.sec, header.stamp.nanosec = 1, 2
    serialized = image_to_cdr(array_to_wire(
        image, find_encoding(encoding), WireHeader(1, 2, 'camera')))
    assert deserialize_message(serialized, Image) == CvBridge().cv2_to_imgmsg(
        image, encoding, header)
    view = CvBridge().imgmsg_to_cv2(cdr_to_image(serialized))
    np.testing.assert_array_equal(view, image)
    assert np.may_share_memory(view, np.frombuffer(serialized, np.uint8))
    assert not view.flags.writeable


@pytest.mark.parametrize(('field', 'value', 'text'), [
    ('height', 2**32, 'out of the range'), ('step', -1, 'out of the range'),
    ('header', WireHeader(2**31, 0, ''), 'out of the range'),
    ('header', WireHeader(0, 0, 'a\0b'), 'has a NUL'),
], ids=['height', 'step', 'sec', 'frame_id'])
def test_values_out_of_range_are_refused(field: str, value: object, text: str) -> None:
    image = WireImage(header=WireHeader(0, 0, ''), height=0, width=0, encoding='',
                      is_bigendian=False, step=0, data=b'')
    with pytest.raises(CdrError, match=text):
        image_to_cdr(replace(image, **{field: value}))


def test_array_of_another_type_is_refused() -> None:
    with pytest.raises(EncodingError, match='image has incompatible type 8UC1'):
        declared_encoding(np.zeros((1, 1), np.uint8), 'bgr8')


def test_text_that_is_not_utf_8_is_read() -> None:
    serialized = bytearray(image_to_cdr(WireImage(
        header=WireHeader(0, 0, 'abc'), height=1, width=1, encoding='mono8', is_bigendian=False,
        step=1, data=b'x')))
    serialized[16:19] = b'\xff\xfe\xfd'
    assert cdr_to_image(serialized).header.frame_id == '\ufffd' * 3
    serialized[12:16] = struct.pack('<I', 2**32 - 1)
    with pytest.raises(CdrError, match='needs 4294967295 bytes from offset 16'):
        cdr_to_image(serialized)


@given(HEADERS, IMAGES, st.floats(width=32, allow_nan=False))
def test_image_of_a_disparity_image(
        header: WireHeader, image: WireImage, least: float) -> None:
    message = DisparityImage(image=message_of(image), f=1.5, t=2.5, min_disparity=least,
                             max_disparity=3.5, delta_d=4.5)
    message.header.frame_id = header.frame_id
    message.header.stamp.sec, message.header.stamp.nanosec = header.sec, header.nanosec
    message.valid_window.do_rectify = True
    serialized = serialize_message(message)
    found = read_message(serialized, DISPARITY_IMAGE)
    assert found == WireDisparity(
        header=header, height=image.height, width=image.width, encoding=image.encoding,
        is_bigendian=image.is_bigendian, step=image.step, data=memoryview(image.data),
        min_disparity=least)
    for size in (0, 4, len(serialized) // 2):
        with pytest.raises(CdrError):
            read_message(serialized[:size], DISPARITY_IMAGE)
