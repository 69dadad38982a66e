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

"""Rows of image messages whose step is any number of bytes that holds a row."""

from __future__ import annotations

from pathlib import Path

import cv2
from images import random_image
import numpy as np
from opencv_tools.capture.source import open_source
from opencv_tools.capture.v4l2.pixel_formats import PIXEL_FORMATS
from opencv_tools.convert.cli import main as convert
from opencv_tools.cv_bridge import CvBridge
from opencv_tools.image.cdr import image_to_cdr, WireImage
from opencv_tools.image.encodings import ENCODINGS, find_encoding
from opencv_tools.image.errors import LayoutError
from opencv_tools.image.layout import array_to_wire, view_pixels
from opencv_tools.viewer.encoding import encode_picture, PictureOptions
from playback import frames_of
from played_bags import Entry, header, TOPIC, write_mcap
import pytest

PLAIN = [name for name, found in ENCODINGS.items() if found.row_factor == 1]
PADDINGS = [1, 7, 32, 100_001]


def padded(image: np.ndarray, encoding: str, padding: int, number: int = 1) -> WireImage:
    """Return a message whose rows end in bytes that are no pixels."""
    plain = array_to_wire(image, find_encoding(encoding), header(number))
    rows = np.frombuffer(plain.data, np.uint8).reshape(len(image), -1)
    return WireImage(
        header=plain.header, height=plain.height, width=plain.width, encoding=encoding,
        is_bigendian=plain.is_bigendian, step=plain.step + padding,
        data=np.pad(rows, ((0, 0), (0, padding)), constant_values=0xAB).reshape(-1).data)


@pytest.mark.parametrize('padding', PADDINGS)
@pytest.mark.parametrize('encoding', [*PLAIN, '16SC3', '32FC1', '32SC4', '64FC1', '64FC5'])
def test_pixels_of_padded_rows(encoding: str, padding: int) -> None:
    for order in '<>':
        image = random_image(encoding, 5, 8)
        message = padded(image.astype(image.dtype.newbyteorder(order)), encoding, padding)
        pixels = CvBridge().imgmsg_to_cv2(message)
        np.testing.assert_array_equal(pixels, image)
        if pixels.dtype in (np.uint8, np.uint16, np.float32) and pixels.ndim == 2:
            np.testing.assert_array_equal(cv2.flip(pixels, 1), image[:, ::-1])


def test_view_of_padded_rows_is_no_copy() -> None:
    data = np.zeros(4 * 2432, np.uint8)
    view = view_pixels(data, 4, 800, 2432, find_encoding('rgb8'))
    data[2432 + 3] = 7
    assert view[1, 1, 0] == 7


@pytest.mark.parametrize(('step', 'size', 'reason'), [
    (2399, 4 * 2432, ': a row needs 2400 bytes, more than the step'),
    (2432, 4 * 2432 - 1, ' needs 9728 bytes, but data has 9727'),
    (2**32 - 1, 4 * 2432, ' needs 17179869180 bytes, but data has 9728')])
def test_contradictions_are_refused(step: int, size: int, reason: str) -> None:
    with pytest.raises(LayoutError) as caught:
        view_pixels(bytes(size), 4, 800, step, find_encoding('rgb8'))
    assert str(caught.value) == f'800x4 rgb8 image with step {step}{reason}'


@pytest.mark.parametrize('encoding', ['rgb8', 'bgr8', 'mono16'])
def test_bag_of_padded_rows_at_every_end(tmp_path: Path, encoding: str) -> None:
    images = [random_image(encoding, 48, 50) for _ in range(3)]
    messages = [padded(image, encoding, 31, number) for number, image in enumerate(images)]
    bag = write_mcap(tmp_path / 'a.mcap', [
        Entry(number * 10**9, image_to_cdr(message), TOPIC)
        for number, message in enumerate(messages)])
    for image, frame in zip(images, frames_of(open_source(str(bag))), strict=True):
        np.testing.assert_array_equal(frame.image, image)
    assert convert([str(bag), str(tmp_path / 'copy.mcap')]) == 0
    assert convert([str(tmp_path / 'copy.mcap'), str(tmp_path / '{frame_id}.png')]) == 0
    for number, image in enumerate(images):
        stored = cv2.imread(str(tmp_path / f'optical_{number}.png'), cv2.IMREAD_UNCHANGED)
        np.testing.assert_array_equal(stored, image[..., ::-1] if encoding == 'rgb8' else image)
    options = PictureOptions(width=50, quality=95)
    assert encode_picture(messages[0], options) == encode_picture(
        array_to_wire(images[0], find_encoding(encoding)), options)


def test_padded_rows_of_a_camera() -> None:
    image = random_image('bgr8', 4, 1366)
    data = np.pad(image.reshape(4, -1), ((0, 0), (0, 2))).tobytes()
    found = next(one for one in PIXEL_FORMATS.values() if one.fourcc == 'BGR3')
    np.testing.assert_array_equal(found.read(data, 4, 1366, 4100), image)
