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

from images import draw_pattern
import numpy as np
from opencv_tools.capture.pattern import parse_pattern, PatternSource, PatternSpec
import pytest


@pytest.mark.parametrize(('text', 'spec'), [
    ('pattern', PatternSpec(640, 480, 30.0)),
    ('pattern:320x240', PatternSpec(320, 240, 30.0)),
    ('pattern:1x1@12.5', PatternSpec(1, 1, 12.5)),
    ('pattern:depth', PatternSpec(640, 480, 30.0, is_depth=True)),
    ('pattern:depth:37x23@7.5', PatternSpec(37, 23, 7.5, is_depth=True)),
])
def test_pattern_is_parsed(text: str, spec: PatternSpec) -> None:
    assert parse_pattern(text) == spec


@pytest.mark.parametrize('is_depth', [False, True])
@pytest.mark.parametrize(('width', 'height'), [(640, 480), (1, 1), (3, 200), (200, 3), (1921, 7)])
def test_frames_of_any_size_repeat_exactly(width: int, height: int, is_depth: bool) -> None:
    source = PatternSource(PatternSpec(width, height, is_depth=is_depth))
    first, second = source.read().image, source.read().image
    assert first.shape == second.shape == (height, width, 3)[:2 if is_depth else 3]
    source.rewind()
    assert source.skip()
    assert np.array_equal(source.read().image, second)


@pytest.mark.parametrize('number', [0, 1, 63, 64])
def test_line_moves_from_left_to_right_in_64_frames(number: int) -> None:
    image = draw_pattern(number, 640, 480)
    white = np.flatnonzero((image[20:150] == 255).all(axis=(0, 2)))
    left = number % 64 * 10
    assert {*range(left, left + 10)} <= {*white}
    assert image[20, 200].tolist() != [255, 255, 255]  # a bar


def test_ramp_below_the_bars() -> None:
    image = draw_pattern(0, 512, 480)
    ramp = image[-1, 16:].astype(int)  # beside the line
    assert (ramp == ramp[:, :1]).all()
    assert ramp[-1, 0] == 255 and (np.diff(ramp[:, 0]) >= 0).all() and ramp[0, 0] < 16


def test_pattern_shows_its_number() -> None:
    images = {draw_pattern(number, 640, 480)[160:320, 200:440].tobytes()
              for number in range(0, 640, 64)}
    assert len(images) == 10  # the moving line has the same position, so only the digits differ


def test_depth_comes_nearer_beside_a_hole() -> None:
    source = PatternSource(PatternSpec(320, 240, is_depth=True))
    frames = [source.read() for _ in range(65)]
    first, later, last = (frames[number].image for number in (0, 63, 64))
    assert frames[0].encoding == '16UC1' and first.dtype == np.uint16
    assert first[-1, 0] == 1500 and first[-1, -1] == 4000
    assert np.array_equal(first[-1] - later[-1], np.full(320, 63 * 16))
    assert np.count_nonzero(first == 0) == 40 * 30 and (first[30:60, :40] == 0).all()
    assert np.array_equal(first[-1], last[-1])
    assert not np.array_equal(first, last)  # the numbers differ
