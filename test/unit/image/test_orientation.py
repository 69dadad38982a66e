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

from __future__ import annotations

import itertools

import cv2
import numpy as np
from opencv_tools.image.bayer import bayer_to_color
from opencv_tools.image.encodings import ENCODINGS, find_encoding
from opencv_tools.image.errors import ConversionError
from opencv_tools.image.orientation import FLIPS, orient, ROTATIONS
import pytest

FLIP_CODES = {'horizontal': 1, 'vertical': 0, 'both': -1}
ROTATE_CODES = {90: cv2.ROTATE_90_CLOCKWISE, 180: cv2.ROTATE_180,
                270: cv2.ROTATE_90_COUNTERCLOCKWISE}
WAYS = list(itertools.product(FLIPS, ROTATIONS))


def turned_by_opencv(image: np.ndarray, flip: str, degrees: int) -> np.ndarray:
    flipped = image if flip == 'none' else cv2.flip(image, FLIP_CODES[flip])
    return cv2.rotate(flipped, ROTATE_CODES[degrees]) if degrees else flipped


@pytest.mark.parametrize(('flip', 'degrees'), WAYS)
@pytest.mark.parametrize('name', ['mono8', 'bgr8', 'rgba16', '32FC1', '8UC2'])
def test_orientation_equals_opencv(name: str, flip: str, degrees: int) -> None:
    encoding = find_encoding(name)
    shape = (5, 8) if encoding.channels == 1 else (5, 8, encoding.channels)
    image = np.random.default_rng(7).integers(0, 255, shape).astype(encoding.dtype)
    before = image.copy()
    oriented, found = orient(image, encoding, flip, degrees)
    assert np.array_equal(oriented, turned_by_opencv(image, flip, degrees))
    assert found == encoding
    assert np.array_equal(image, before)


@pytest.mark.parametrize(('height', 'width'), [(6, 8), (5, 8), (6, 7), (5, 7)])
@pytest.mark.parametrize('name', ['bayer_rggb8', 'bayer_gbrg16'])
def test_turned_bayer_image_has_the_turned_colours(name: str, height: int, width: int) -> None:
    encoding = find_encoding(name)
    full = np.random.default_rng(7).integers(0, 200, (1, 1, 3)).astype(encoding.dtype)
    scene = np.tile(full, (height, width, 1))  # one colour, which any demosaicing reproduces
    colours = np.tile(np.array(list(encoding.order)).reshape(2, 2), (4, 4))[:height, :width]
    mosaic = np.choose(np.vectorize('bgr'.index)(colours), np.moveaxis(scene, 2, 0))
    wrong = []
    for flip, degrees in WAYS:
        oriented, found = orient(mosaic, encoding, flip, degrees)
        shown = bayer_to_color(np.ascontiguousarray(oriented), found.order, 'bgr')
        if not np.array_equal(shown, turned_by_opencv(scene, flip, degrees)):
            wrong.append((flip, degrees))
    assert not wrong


@pytest.mark.parametrize('name', [
    name for name, encoding in ENCODINGS.items() if encoding.kind == 'yuv'])
def test_encodings_with_shared_chroma_are_not_turned(name: str) -> None:
    image = np.zeros((6, 4, 2) if ENCODINGS[name].channels == 2 else (6, 4), np.uint8)
    assert orient(image, ENCODINGS[name], 'none', 0)[0] is image
    for flip, degrees in (('both', 0), ('none', 90)):
        with pytest.raises(ConversionError, match='set encoding to bgr8 or mono8'):
            orient(image, ENCODINGS[name], flip, degrees)
