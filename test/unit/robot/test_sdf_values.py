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

"""Versions and poses of SDF."""

from __future__ import annotations

import math

from opencv_tools.robot.pose import Pose
from opencv_tools.robot.sdf.writer import write_sdf
from opencv_tools.robot.xml.document import DescriptionError
from opencv_tools.robot.xml.report import Report
import pytest
from rows import each_row
from sdf_models import HALF, near, read, urdf_robot


@each_row(('pose', 'expected'), [
    ('<pose/>', Pose()),
    ('<pose degrees="true">1 2 3 180 0 90</pose>', Pose((1, 2, 3), (math.pi, 0, HALF))),
    ('<pose rotation_format="euler_rpy">1 2 3 0.1 0 0</pose>', Pose((1, 2, 3), (0.1, 0, 0))),
    ('<pose rotation_format="quat_xyzw">1 2 3 0 0 0 2</pose>', Pose((1, 2, 3))),
    ('<pose rotation_format="quat_xyzw">1 2 3 0 0 1 1</pose>', Pose((1, 2, 3), (0, 0, HALF)))])
def test_pose_formats(pose: str, expected: Pose) -> None:
    placed = read(f'<link name="a">{pose}</link>').links[0].placement.pose
    assert placed.xyz == expected.xyz and near(placed.rpy, expected.rpy)


def test_newer_version_is_read_with_a_warning() -> None:
    report = Report()
    read('<link name="a"/>', '1.13', report)
    assert 'read as 1.12' in report.warnings[0].message


@each_row('version', ['1.6', '1.13', '2.0', 'x', '1'])
def test_unsupported_output_versions(version: str) -> None:
    with pytest.raises(DescriptionError, match=r'1[.]7 to 1[.]12'):
        write_sdf(urdf_robot(), Report(), version=version)
