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

"""What holds of every robot: there and back it is the same, with every element it had."""

from __future__ import annotations

from random import Random
import xml.etree.ElementTree as ElementTree

from hypothesis import given, HealthCheck, settings
from hypothesis import strategies as st
from opencv_tools.robot.compare import differences
from opencv_tools.robot.convert import convert_to_sdf, convert_to_urdf
from opencv_tools.robot.model import Robot
from opencv_tools.robot.names import with_own_names
from opencv_tools.robot.report import Report
from opencv_tools.robot.sdf_reader import read_sdf
from opencv_tools.robot.urdf_reader import read_urdf
from opencv_tools.robot.xml import parse, to_bytes
import pytest
import robots

TOLERANCE = 1e-12
PROPERTY = settings(max_examples=30, deadline=None, derandomize=True,
                    suppress_health_check=list(HealthCheck))
SEEDS = st.integers(0, 2**32)
SIZES = st.integers(1, 30)


def urdf_of(data: bytes) -> Robot:
    """Read URDF."""
    return read_urdf(parse(data, 'made_up.urdf', Report()), Report())


def sdf_of(data: bytes) -> Robot:
    """Read SDF."""
    return with_own_names(read_sdf(parse(data, 'made_up.sdf', Report()), Report()))


@pytest.mark.parametrize('relative', [False, True], ids=['model', 'relative'])
@given(seed=SEEDS, links=SIZES)
@PROPERTY
def test_urdf_to_sdf_and_back(relative: bool, seed: int, links: int) -> None:
    written = robots.urdf(Random(seed), links)
    robot = urdf_of(ElementTree.tostring(written))
    there = to_bytes(convert_to_sdf(robot, Report(), relative=relative))
    again = sdf_of(there)
    assert not differences(robot, again, samples=2, tolerance=TOLERANCE)
    back = to_bytes(convert_to_urdf(again, Report()))
    assert not differences(robot, urdf_of(back), samples=2, tolerance=TOLERANCE)
    result = ElementTree.fromstring(back)
    assert not robots.elements(written) - robots.elements(result)
    if relative:
        assert not robots.numbers(written) - robots.numbers(result)


@pytest.mark.parametrize('relative', [False, True], ids=['model', 'relative'])
@given(seed=SEEDS, links=SIZES)
@PROPERTY
def test_sdf_to_urdf_and_back(relative: bool, seed: int, links: int) -> None:
    written = robots.sdf(Random(seed), links)
    robot = sdf_of(ElementTree.tostring(written))
    there = to_bytes(convert_to_urdf(robot, Report()))
    again = urdf_of(there)
    assert not differences(robot, again, samples=2, tolerance=TOLERANCE)
    back = to_bytes(convert_to_sdf(again, Report(), relative=relative))
    assert not differences(robot, sdf_of(back), samples=2, tolerance=TOLERANCE)
    missing = robots.elements(written) - robots.elements(ElementTree.fromstring(back))
    # Where a thing is placed it need not say when that is where it would be anyway.
    assert {path for path in missing if not path.endswith('/pose')} == set()


@given(seed=SEEDS, links=SIZES)
@PROPERTY
def test_there_and_back_and_there_is_the_same_to_the_letter(seed: int, links: int) -> None:
    robot = urdf_of(ElementTree.tostring(robots.urdf(Random(seed), links)))
    first = to_bytes(convert_to_sdf(robot, Report(), relative=True))
    back = to_bytes(convert_to_urdf(sdf_of(first), Report()))
    assert to_bytes(convert_to_sdf(urdf_of(back), Report(), relative=True)) == first
