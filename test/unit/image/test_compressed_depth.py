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

"""Images of depth as messages: bytes of compressed_depth_image_transport, and the way back."""

from __future__ import annotations

import struct

import cv2
import numpy as np
from numpy.typing import NDArray
from opencv_tools.cv_bridge import CvBridge, CvBridgeError
from opencv_tools.image.compressed_depth import (
    compressed_size, DEPTH_CODECS, Quantisation, quantisation_loss)
from opencv_tools.image.errors import CodecError, SizeError
from opencv_tools.image_codecs import (
    decode_compressed, decode_depth, encode_depth)
import pytest
from sensor_msgs.msg import CompressedImage
from std_msgs.msg import Header


def depth_image(height: int = 23, width: int = 37) -> NDArray[np.uint16]:
    random = np.random.default_rng(height)
    image = random.integers(300, 4900, (height, width)).astype(np.uint16)
    image[3:9, 5:20] = 0
    return image


def plugin_message(stored: NDArray[np.uint16], numbers: tuple[float, float] = (0, 0)) -> bytes:
    """Return the content that the plugin writes: its header, and a PNG of OpenCV."""
    return struct.pack('<iff', 0, *numbers) + cv2.imencode('.png', stored)[1].tobytes()


def quantised_by_the_plugin(depth: NDArray[np.float32]) -> NDArray[np.uint16]:
    """Quantise pixel by pixel with floats of 32 bits, depth_max 10 and depth_quantization 100."""
    one = np.float32
    numerator = one(100) * (one(100) + one(1))
    offset = one(1) - numerator / one(10)
    return np.array([[int(numerator / pixel + offset) if pixel < one(10) else 0
                      for pixel in row] for row in depth], np.uint16)


@pytest.mark.parametrize('codec', DEPTH_CODECS)
@pytest.mark.parametrize('encoding', ['16UC1', 'mono16'])
def test_sixteen_bits_are_exact(codec: str, encoding: str) -> None:
    image = depth_image()
    content, format_text = encode_depth(image, encoding, codec)
    assert format_text == f'{encoding}; compressedDepth {codec}'
    assert compressed_size(content, format_text) == (37, 23)
    decoded, found = decode_compressed(content, format_text)
    assert found.name == encoding
    assert np.array_equal(decoded, image)


def test_rvl_message_of_the_plugin() -> None:
    # Header, width 5, height 1, and the bytes of [0, 0, 5, 6, 0] by hand, see test_rvl.py.
    content = struct.pack('<iffII', 0, 0, 0, 5, 1) + bytes.fromhex('0021a122')
    assert encode_depth(np.array([[0, 0, 5, 6, 0]], np.uint16), '16UC1', 'rvl')[0] == content


@pytest.mark.parametrize('format_text', [
    '16UC1; compressedDepth', '16UC1; compressedDepth png', '16UC1;compressedDepth png ',
    '16UC1; compressedDepth '])
def test_old_format_strings(format_text: str) -> None:
    image = depth_image(11, 13)
    decoded, encoding = decode_compressed(plugin_message(image), format_text)
    assert encoding.name == '16UC1' and np.array_equal(decoded, image)


@pytest.mark.parametrize('codec', DEPTH_CODECS)
def test_floats_are_quantised_as_by_the_plugin(codec: str) -> None:
    depth = np.random.default_rng(2).uniform(0.16, 12.0, (31, 17)).astype(np.float32)
    depth[0, :3] = np.nan, np.inf, 10.0
    content, format_text = encode_depth(depth, '32FC1', codec)
    stored, quantisation = decode_depth(content, format_text)
    expected = quantised_by_the_plugin(np.nan_to_num(depth, nan=99))
    assert np.array_equal(stored, expected)
    assert quantisation == Quantisation(10100.0, -1009.0)
    decoded, encoding = decode_compressed(content, format_text)
    assert encoding.name == '32FC1' and decoded.dtype == np.float32
    known = expected > 0
    assert np.isnan(decoded[~known]).all() and not np.isnan(decoded[known]).any()
    # A step of the stored number is depth**2 / numerator.
    assert (np.abs(decoded - depth)[known] <= 1.01 * depth[known] ** 2 / 10100).all()


def test_depths_without_a_number() -> None:
    depth = np.array([[np.nan, np.inf, -np.inf, 0, -1, 10, 11, 1e-3, 0.05, 9.99]], np.float32)
    stored = Quantisation.up_to().stored(depth)
    assert stored.tolist() == [[0, 0, 0, 0, 0, 0, 0, 65535, 65535, 2]]
    far = Quantisation.up_to(float('inf')).stored(np.float32([[50_000, 0.2]]))
    assert far.tolist() == [[1, 50501]]
    assert Quantisation.up_to(4.9, 37.0).stored(np.float32([[5, 4.8]])).tolist() == [[0, 6]]


@pytest.mark.parametrize(('numerator', 'offset'), [
    (-10100, -1009), (10100, 5), (10100, 1), (10100, 70_000), (0, 0), (np.nan, 0), (np.inf, 0),
    (10100, np.nan), (10100, -np.inf), (-1e-40, 0)])
@pytest.mark.parametrize('codec', DEPTH_CODECS)
def test_hostile_quantisation(numerator: float, offset: float, codec: str) -> None:
    content, format_text = encode_depth(np.full((3, 4), 2, np.float32), '32FC1', codec)
    changed = struct.pack('<iff', 0, numerator, offset) + content[12:]
    with pytest.raises(CodecError, match='which gives no depths in metres'):
        decode_compressed(changed, format_text)
    image, _ = decode_compressed(changed, format_text.replace('32FC1', '16UC1'))
    assert image.dtype == np.uint16  # it has no quantisation


@pytest.mark.parametrize('codec', DEPTH_CODECS)
@pytest.mark.parametrize('dtype', ['uint16', '>u2', 'float32'])
def test_bridge_both_ways(codec: str, dtype: str) -> None:
    name = '32FC1' if dtype == 'float32' else '16UC1'
    image = np.full((7, 9), 2, dtype)
    header = Header(frame_id='depth')
    message = CvBridge().cv2_to_compressed_imgmsg(
        image, f'{name}; compressedDepth {codec}', header=header)
    assert message.format == f'{name}; compressedDepth {codec}'
    assert message.header.frame_id == 'depth'
    decoded = CvBridge().compressed_imgmsg_to_cv2(message)
    assert decoded.shape == (7, 9) and np.allclose(decoded, 2, rtol=1e-3)


@pytest.mark.parametrize(('image', 'format_text', 'reason'), [
    (np.zeros((4, 5), np.uint8), '8UC1; compressedDepth png', '5x4 image of 8UC1 cannot be'),
    (np.zeros((4, 5, 3), np.uint16), '16UC3; compressedDepth rvl', 'image of 16UC3'),
    (np.zeros((0, 5), np.uint16), '16UC1; compressedDepth rvl', '5x0 image of 16UC1'),
    (np.zeros((4, 5), np.uint16), '16UC1; compressedDepth jpeg', "with 'jpeg'"),
    (np.zeros((4, 5), np.uint16), '32FC1; compressedDepth png', '32FC1')])
def test_bridge_refuses(image: NDArray[np.generic], format_text: str, reason: str) -> None:
    with pytest.raises(CvBridgeError, match=reason):
        CvBridge().cv2_to_compressed_imgmsg(image, format_text)


@pytest.mark.parametrize('content', [b'', bytes(12), bytes(20), bytes(21), bytes(28)])
@pytest.mark.parametrize('codec', [*DEPTH_CODECS, 'zstd'])
def test_damaged_messages(content: bytes, codec: str) -> None:
    message = CompressedImage(format=f'16UC1; compressedDepth {codec}', data=[*content])
    with pytest.raises(CvBridgeError) as caught:
        CvBridge().compressed_imgmsg_to_cv2(message)
    assert ('use png or rvl' in str(caught.value)) == (codec == 'zstd')


@pytest.mark.parametrize('size', [(2**32 - 1, 2**32 - 1), (2**26, 1), (1, 2**31), (0, 7), (7, 0)])
def test_hostile_size_of_rvl(size: tuple[int, int]) -> None:
    content = struct.pack('<iffII', 0, 0, 0, *size) + bytes(8)
    with pytest.raises((CodecError, SizeError)):
        decode_depth(content, '16UC1; compressedDepth rvl')


@pytest.mark.parametrize(('depth', 'farthest', 'loss'), [
    ([0.2, 9.9], 10.0, ''), ([0.2, 10.0], 10.0, 'depths of 10 m and more are lost'),
    ([0.2, 3.5], 3.0, 'depths of 3 m and more are lost'),
    ([0.0, np.nan, -np.inf, np.inf, -5.0], 10.0, ''),
    ([0.14], 10.0, 'those below 0.15 m become 0.15 m'), ([0.155], 10.0, ''),
    ([0.01, 11.0], 10.0,
     'depths of 10 m and more are lost and those below 0.15 m become 0.15 m')])
def test_loss_by_quantisation(depth: list[float], farthest: float, loss: str) -> None:
    assert quantisation_loss(np.array([depth], np.float32), farthest) == loss
    assert quantisation_loss(np.array([[0, 1, 65535]], np.uint16), farthest) == ''
