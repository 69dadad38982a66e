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

"""Outlines of shapes."""

from __future__ import annotations

from collections.abc import Callable
import math

from opencv_tools.robot.drawing.primitives import outline
from opencv_tools.robot.geometry import Box, Capsule, Cylinder, Geometry, Sphere
import pytest
from rows import each_row


@pytest.mark.parametrize(('geometry', 'distance', 'lines'), [
    (Sphere(0.5), lambda x, y, z: math.hypot(x, y, z), 3),
    (Cylinder(0.5, 1.0), lambda x, y, z: math.hypot(x, y), 6),
    (Capsule(0.5, 1.0), lambda x, y, z: math.hypot(x, y, max(abs(z) - 0.5, 0.0)), 8)])
def test_outlines_on_the_surface_of_shapes(
        geometry: Geometry, distance: Callable[[float, float, float], float], lines: int) -> None:
    found = outline(geometry)
    assert len(found) == lines
    for line in found:
        assert [distance(*point) for point in line] == pytest.approx([0.5] * len(line))
    assert len({point for line in found for point in line}) > 40


@each_row(('geometry', 'size'), [
    (Box((1.0, 2.0, 3.0)), (1.0, 2.0, 3.0)), (Sphere(1.0), (2.0, 2.0, 2.0)),
    (Cylinder(0.5, 1.0), (1.0, 1.0, 1.0)), (Capsule(0.5, 1.0), (1.0, 1.0, 2.0))])
def test_size_of_outlines(geometry: Geometry, size: tuple[float, ...]) -> None:
    columns = zip(*(point for line in outline(geometry) for point in line))
    assert tuple(max(column) - min(column) for column in columns) == pytest.approx(size)
