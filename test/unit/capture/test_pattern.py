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

"""The test pattern: its settings and its frames."""

from __future__ import annotations

import numpy as np
from opencv_tools.capture.pattern import draw_pattern, parse_pattern, PatternSource, PatternSpec
import pytest


@pytest.mark.parametrize(('text', 'spec'), [
    ('pattern', PatternSpec(640, 480, 30.0)),
    ('pattern:320x240', PatternSpec(320, 240, 30.0)),
    ('pattern:1x1@12.5', PatternSpec(1, 1, 12.5)),
])
def test_pattern_is_parsed(text: str, spec: PatternSpec) -> None:
    assert parse_pattern(text) == spec


@pytest.mark.parametrize(('width', 'height'), [(640, 480), (1, 1), (3, 200), (200, 3), (1921, 7)])
def test_pattern_frames_differ_and_repeat_exactly(width: int, height: int) -> None:
    source = PatternSource(PatternSpec(width, height))
    first, second = source.read().image, source.read().image
    assert first.shape == (height, width, 3)
    assert np.array_equal(second, draw_pattern(1, width, height))
    if width >= 200:
        assert not np.array_equal(first, second)
    source.rewind()
    assert source.skip()
    assert np.array_equal(source.read().image, second)


def test_pattern_shows_its_number() -> None:
    images = {draw_pattern(number, 640, 480)[160:320, 200:440].tobytes()
              for number in range(0, 640, 64)}
    assert len(images) == 10  # the moving line has the same position, so only the digits differ
