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

"""The Exif orientation of JPEGs, also of damaged ones."""

from __future__ import annotations

import hypothesis
from hypothesis import strategies
from images import oriented_jpeg, UPRIGHT
import numpy as np
from opencv_tools.image.orientation import is_sideways, jpeg_orientation, turn_upright
import pytest

IMAGE = np.arange(6 * 4 * 3, dtype=np.uint8).reshape(6, 4, 3)
XMP = b'\xff\xe1\x00\x0dhttp://ns.a'


@pytest.mark.parametrize('orientation', UPRIGHT)
def test_upright_image(orientation: int) -> None:
    jpeg = oriented_jpeg(IMAGE, orientation)
    assert jpeg_orientation(jpeg) == jpeg_orientation(jpeg[:2] + XMP + jpeg[2:]) == orientation
    upright = turn_upright(IMAGE, orientation)
    np.testing.assert_array_equal(upright, UPRIGHT[orientation](IMAGE))
    assert is_sideways(orientation) == (upright.shape[:2] == (4, 6))


def test_unknown_orientation() -> None:
    plain = oriented_jpeg(IMAGE, 1)
    for content in (b'', b'\xff\xd8', plain[:40], plain[:2] + plain[plain.index(b'\xff\xe0'):],
                    oriented_jpeg(IMAGE, 0), oriented_jpeg(IMAGE, 9)):
        assert jpeg_orientation(content) == 1


@hypothesis.given(strategies.binary(max_size=80), strategies.sampled_from(['II*\0', 'MM\0*']))
def test_damaged_exif_data(data: bytes, order: str) -> None:
    content = b'Exif\0\0' + order.encode() + data
    jpeg = oriented_jpeg(IMAGE, 1)
    segment = b'\xff\xe1' + (len(content) + 2).to_bytes(2, 'big') + content
    assert 1 <= jpeg_orientation(jpeg[:2] + segment + jpeg[2:]) <= 8
