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

"""Format strings of compressed images."""

from __future__ import annotations

from opencv_tools.image.compressed import CompressedFormat, parse_format
import pytest


@pytest.mark.parametrize(('text', 'expected'), [
    ('jpeg', CompressedFormat('jpeg')),
    ('', CompressedFormat('')),
    ('bgr8; jpeg compressed bgr8', CompressedFormat('jpeg', 'bgr8', 'bgr8')),
    ('16UC1; png compressed ', CompressedFormat('png', '16UC1', '')),
    ('mono8;png compressed', CompressedFormat('png', 'mono8', '')),
    ('rgb8; tiff compressed rgb8', CompressedFormat('tiff', 'rgb8', 'rgb8')),
])
def test_format_strings(text: str, expected: CompressedFormat) -> None:
    assert parse_format(text) == expected
