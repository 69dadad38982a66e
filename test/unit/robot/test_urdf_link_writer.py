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

"""Writer of URDF links: geometries, origins and numbers."""

from __future__ import annotations

from opencv_tools.robot.geometry import Box, Capsule, Cylinder, Mesh, Sphere
from opencv_tools.robot.model import FrameId, Placement
from opencv_tools.robot.pose import Pose
import pytest
from urdf_models import joint, read, round_trip, visual, written


@pytest.mark.parametrize(('written_geometry', 'geometry'), [
    ('<box size="1 2 3"/>', Box((1.0, 2.0, 3.0))),
    ('<sphere radius="0.1"/>', Sphere(0.1)),
    ('<cylinder radius="1" length="2"/>', Cylinder(1.0, 2.0)),
    ('<capsule radius="1" length="2"/>', Capsule(1.0, 2.0)),
    ('<mesh filename="package://p/a b.stl"/>', Mesh('package://p/a b.stl')),
    ('<mesh filename="a" scale="1 1 0.123456789012345"/>', Mesh('a', (1.0, 1.0,
                                                                      0.123456789012345))),
])
@pytest.mark.parametrize('tag', ['visual', 'collision'])
def test_geometry_in_a_round_trip(written_geometry: str, geometry: object, tag: str) -> None:
    model = read(visual(f'<origin xyz="0.1 0 0"/><geometry>{written_geometry}</geometry>', tag))
    shape = (model.links[0].visuals + model.links[0].collisions)[0]
    assert shape.geometry == geometry
    assert shape.placement == Placement(Pose((0.1, 0.0, 0.0)), FrameId('link', 'a'))
    assert round_trip(model) == model


def test_subnormal_numbers_are_zero() -> None:
    model = read(joint('<origin xyz="1e-320 0 2.3e-308"/>', 'fixed'))
    origin = written(model).find('joint/origin')
    assert origin is not None
    assert origin.get('xyz') == '0 0 2.3e-308'


def test_identity_origin_is_not_written() -> None:
    model = read(joint('<origin xyz="0 0 0" rpy="0 0 0"/>', 'fixed'))
    assert not [*written(model).iter('origin')]
