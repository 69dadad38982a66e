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

"""Moments of inertia that a body can have, nearest to impossible ones."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from opencv_tools.robot.cli import sdf_to_urdf, urdf_to_sdf
from opencv_tools.robot.load import read_robot
from opencv_tools.robot.model import FrameId, Inertial, Placement
from opencv_tools.robot.physical import is_physical, nearest_moments
from opencv_tools.robot.pose import Pose, Tensor
from opencv_tools.robot.xml.report import Report
import pytest

PLACE = Placement(Pose(), FrameId('link', 'a'))
URDF = """<robot name="r"><link name="a"><inertial><mass value="{mass}"/>
<inertia ixx="{ixx}" ixy="0" ixz="0" iyy="{ixx}" iyz="0" izz="{izz}"/></inertial></link></robot>"""


def matrix(moments: Tensor) -> Any:
    """Return the integral of x x^T over the mass, from which the moments of inertia follow."""
    xx, xy, xz, yy, yz, zz = moments
    tensor = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    return np.trace(tensor) / 2 * np.eye(3) - tensor


def test_nearest_moments_are_possible_and_no_others_are_nearer() -> None:
    random = np.random.default_rng(4)
    impossible = 0
    for _ in range(300):
        moments: Tensor = tuple(random.normal(1.0, 1.0, 6))
        nearest = nearest_moments(moments)
        if nearest is None:
            assert np.linalg.eigvalsh(matrix(moments))[-1] <= 0
            continue
        assert is_physical(Inertial(PLACE, 1.0, nearest))
        wanted, found = matrix(moments), matrix(nearest)
        if is_physical(Inertial(PLACE, 1.0, moments)):
            np.testing.assert_allclose(found, wanted, atol=1e-5)
            continue
        impossible += 1
        np.testing.assert_allclose(wanted @ found, found @ wanted, atol=1e-9)  # the same axes
        distance = np.linalg.norm(wanted - found)
        for _ in range(20):  # other bodies: sums of points around the found one
            points = random.normal(0.0, 0.1, (3, 3))
            other = found * random.uniform(0.5, 1.5) + points @ points.T
            assert np.linalg.norm(wanted - other) > distance - 1e-4
    assert impossible > 100


@pytest.mark.parametrize(('mass', 'izz', 'moments'), [
    ('2', '2.5', (1.25, 1.25, 2.5)), ('2', '1.5', (1, 1, 1.5)),
    ('0.001', '-1', (1.5, 1.5, 0))])  # a mass on the z axis
def test_option(tmp_path: Path, mass: str, izz: str, moments: tuple[float, ...],
                capsys: pytest.CaptureFixture[str]) -> None:
    urdf, sdf, back = (tmp_path / name for name in ('a.urdf', 'a.sdf', 'b.urdf'))
    urdf.write_text(URDF.format(mass=mass, ixx=1, izz=izz))
    assert urdf_to_sdf([str(urdf), '-o', str(sdf), '--inertial', 'physical']) == 0
    is_changed = izz != '1.5'
    told = capsys.readouterr().err
    assert (f'1 0 0 1 0 {izz} are physically impossible; they become' in told) is is_changed
    assert sdf_to_urdf([str(sdf), '-o', str(back), '--inertial', 'physical']) == 0
    assert capsys.readouterr().err == ''
    inertial = read_robot(str(back), Report())[0].links[0].inertial
    assert inertial and inertial.mass == float(mass)
    assert np.diag(matrix(inertial.inertia)).min() > 0
    assert inertial.inertia[0::3] + inertial.inertia[5:] == pytest.approx(moments, abs=5e-6)


@pytest.mark.parametrize(('mass', 'ixx', 'izz'), [
    ('-1', 1, 1), ('1', -2, -2), ('1', '1e308', '-1e308')])
def test_inertial_of_no_body(tmp_path: Path, mass: str, ixx: object, izz: object,
                             capsys: pytest.CaptureFixture[str]) -> None:
    urdf = tmp_path / 'a.urdf'
    urdf.write_text(URDF.format(mass=mass, ixx=ixx, izz=izz))
    assert urdf_to_sdf([str(urdf), '--inertial', 'physical']) == 2
    told = capsys.readouterr().err
    reason = 'the negative mass -1; correct it' if mass == '-1' else (
        f'the mass {mass} and the moments')
    assert told.count('\n') == 1 and f'has {reason}' in told
    sdf = tmp_path / 'a.sdf'
    for command, source, result in ((urdf_to_sdf, urdf, sdf), (sdf_to_urdf, sdf, urdf)):
        assert command([str(source), '-o', str(result)]) == 0
        subject = 'mass -1 is' if mass == '-1' else 'moments of inertia are'
        assert f'the {subject} physically impossible' in capsys.readouterr().err
