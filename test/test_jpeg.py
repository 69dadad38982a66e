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

"""The header of a JPEG."""

from __future__ import annotations

import cv2
import numpy as np
from opencv_tools.image.errors import EncodingError
from opencv_tools.image.jpeg import JpegHeader, read_jpeg_header
import pytest


@pytest.mark.parametrize('progressive', [0, 1])
@pytest.mark.parametrize(('shape', 'components'), [((5, 263), 1), ((5, 263, 3), 3)])
def test_the_header_that_opencv_writes(
        shape: tuple[int, ...], components: int, progressive: int) -> None:
    data = cv2.imencode('.jpg', np.zeros(shape, np.uint8),
                        (cv2.IMWRITE_JPEG_PROGRESSIVE, progressive))[1].reshape(-1)
    for jpeg in (data, data.tobytes(), memoryview(data)):
        assert read_jpeg_header(jpeg) == JpegHeader(263, 5, components)
    assert read_jpeg_header(data[:-5]) == JpegHeader(263, 5, components)


@pytest.mark.parametrize('data', [b'', b'\xff\xd8', b'\xff\xd8\xff\xc0\0\x0b\x08\0\5\1\7'])
def test_a_header_that_is_not_there(data: bytes) -> None:
    with pytest.raises(EncodingError, match=r'^a JPEG without a size$'):
        read_jpeg_header(data)
