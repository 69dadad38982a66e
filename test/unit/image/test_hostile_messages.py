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

"""Random and hostile messages: a correct result or a CvBridgeError, with little memory."""

from __future__ import annotations

import time
import tracemalloc
from types import SimpleNamespace

from hypothesis import example, given, HealthCheck, settings, strategies as st
import numpy as np
from opencv_tools.cv_bridge import CvBridge, CvBridgeError
from opencv_tools.image.encodings import ENCODINGS, find_encoding
from opencv_tools.image.errors import EncodingError
import pytest
from waiting import LONGEST_SECONDS

GENERIC = [f'{depth}C{channels}' for depth in ('8U', '8S', '16U', '16S', '32S', '32F', '64F')
           for channels in (1, 2, 3, 4, 5)]
NAMES = [*ENCODINGS, *GENERIC, '8U', '64F', 'foo', '', '8UC', '8UC0', '8UC513', '8UC999999999999',
         '64UC1', '32FC\n1', '\udcff', 'bgr8\0', 'B' * 10_000]
SIZES = st.one_of(st.integers(0, 9), st.sampled_from((2**16, 2**31, 2**32 - 1)))
MEGABYTE = 2**20


def answer(message: SimpleNamespace, desired: str) -> np.ndarray | None:
    """Convert a message; return None for a CvBridgeError."""
    try:
        return CvBridge().imgmsg_to_cv2(message, desired)
    except CvBridgeError as err:
        assert 0 < len(str(err)) < 400
        return None


random_messages = given(
    encoding=st.sampled_from(NAMES), desired=st.sampled_from(['passthrough', *NAMES]),
    height=SIZES, width=SIZES, step=st.one_of(SIZES, st.none()),
    missing=st.sampled_from((0, 0, 0, 1, 2, -1)), is_bigendian=st.sampled_from((0, 1, 255)))


def examples(count: int) -> settings:
    return settings(max_examples=count, deadline=None,
                    suppress_health_check=[HealthCheck.too_slow])


@examples(250)
@random_messages
@example('mono8', 'bgra16', 2**32 - 1, 0, 0, 0, 0)
@example('nv12', 'bgr8', 2**32 - 2, 0, 0, 0, 0)
@example('64FC1', 'passthrough', 2**32 - 1, 2**32 - 1, 2**32 - 1, 0, 1)
@example('bgr8', 'mono8', 2**32 - 1, 1, 3, 0, 0)
@example('bayer_rggb8', 'bgr8', 1, 2**32 - 1, 2**32 - 1, 0, 0)
def test_random_message_is_converted_correctly_or_refused(
        encoding: str, desired: str, height: int, width: int, step: int | None, missing: int,
        is_bigendian: int) -> None:
    check_answer(encoding, desired, height, width, step, missing, is_bigendian)


@pytest.mark.thorough
@examples(10_000)
@random_messages
def test_many_random_messages(
        encoding: str, desired: str, height: int, width: int, step: int | None, missing: int,
        is_bigendian: int) -> None:
    check_answer(encoding, desired, height, width, step, missing, is_bigendian)


def check_answer(
        encoding: str, desired: str, height: int, width: int, step: int | None, missing: int,
        is_bigendian: int) -> None:
    """Check that a message is converted correctly or refused, with little memory."""
    try:
        found = find_encoding(encoding)
    except EncodingError:
        found = find_encoding('mono8')
    fitting = width * found.pixel_bytes
    step = fitting if step is None else step
    size = max(0, min(found.rows(height) * step, 5000) - missing)
    data = np.random.default_rng(height + width).integers(0, 256, size, np.uint8).tobytes()
    message = SimpleNamespace(encoding=encoding, height=height, width=width, step=step,
                              is_bigendian=is_bigendian, data=data)
    tracemalloc.start()
    began = time.process_time()
    try:
        image = answer(message, desired)
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert time.process_time() - began < LONGEST_SECONDS  # independent of the size in the message
    assert peak < 2 * MEGABYTE
    valid = (step >= fitting and encoding != '8UC0' and size >= found.rows(height) * step
             and not (found.row_factor == 1.5 and (height % 2 or width % 2)))
    if image is None:
        assert not (valid and desired == 'passthrough' and encoding in ENCODINGS)
        return
    assert valid
    shown = ENCODINGS.get(desired)
    if shown and shown.kind == 'color':
        assert image.shape[:2] == (height, width)
        assert image.dtype == shown.dtype
        assert (image.shape[2] if image.ndim == 3 else 1) == shown.channels
    else:
        assert image.shape[:2] == (found.rows(height), width)
    if desired == 'passthrough' and image.size:
        row = image[0].astype(image.dtype.newbyteorder('>' if is_bigendian else '<'))
        assert row.tobytes() == data[:fitting]


@examples(100)
@given(st.binary(max_size=300), st.text(max_size=60),
       st.sampled_from(['passthrough', 'bgr8', 'mono16', '', 'foo']))
@example(b'\xff\xd8\xff', 'jpeg', 'bgr8')
@example(b'\x89PNG\r\n\x1a\n', '16UC1; png compressed ', '16UC1')
@example(b'', '', 'passthrough')
def test_random_compressed_message_is_an_image_or_refused(
        data: bytes, text: str, desired: str) -> None:
    try:
        image = CvBridge().compressed_imgmsg_to_cv2(
            SimpleNamespace(format=text, data=data), desired)
    except CvBridgeError as err:
        assert 0 < len(str(err)) < 400
    else:
        assert image.ndim in (2, 3)


@pytest.mark.parametrize('suffix', ['jpg', 'png', 'bmp', 'tiff', 'webp'])
def test_truncated_image_file_is_refused(suffix: str) -> None:
    bridge = CvBridge()
    image = np.random.default_rng(3).integers(0, 256, (40, 60, 3), np.uint8)
    whole = bridge.cv2_to_compressed_imgmsg(image, suffix).data.tobytes()
    for length in (0, 1, 10, len(whole) // 2, len(whole) - 20):
        message = SimpleNamespace(format=suffix, data=whole[:length])
        with pytest.raises(CvBridgeError):
            bridge.compressed_imgmsg_to_cv2(message)
