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

"""Parts of images, within them and outside."""

from __future__ import annotations

import numpy as np
from opencv_tools.viewer.region import Region, region_within
import pytest


@pytest.mark.parametrize(('wanted', 'found'), [
    ((0, 0, 64, 48), (0, 0, 64, 48)), ((1, 3, 4, 4), (0, 2, 6, 6)),
    ((62, 47, 9, 9), (62, 46, 2, 2)),
    ((10, 10, 2**31, 2**31), (10, 10, 54, 38)), ((64, 0, 1, 1), (0, 0, 64, 48)),
    ((0, 48, 1, 1), (0, 0, 64, 48)), ((63, 0, 1, 1), (62, 0, 2, 2))])
def test_region_within_an_image(
        wanted: tuple[int, int, int, int], found: tuple[int, int, int, int]) -> None:
    x, y, width, height = wanted
    region = Region(x=x, y=y, width=width, height=height)
    assert region_within(region, 64, 48).values == found


def test_whole_image() -> None:
    assert region_within(None, 63, 47).values == (0, 0, 63, 47)
    assert region_within(Region(x=60, y=40, width=9, height=9), 63, 47).values == (60, 40, 3, 7)


def test_part_of_an_array() -> None:
    image = np.arange(12 * 16).reshape(12, 16)
    assert np.array_equal(Region(x=4, y=2, width=6, height=4).crop(image), image[2:6, 4:10])
