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

"""Joint types of URDF and SDF, and how they move."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
import math


@dataclass(frozen=True, kw_only=True)
class JointKind:
    """
    Motion that all joint types of one kind have in common.

    :param axes: number of axes along or about which the joint moves.
    :param max_axes: largest number of axes that the joint may have in a file.
    :param random_span: for each number of a position, the distance from zero in radians or metres
        within which a random position of an unlimited joint lies.
    """

    name: str
    axes: int = 0
    max_axes: int = 0
    random_span: tuple[float, ...] = ()

    @property
    def dof(self) -> int:
        """Degrees of freedom: the number of values of a position."""
        return len(self.random_span)


_REVOLUTE = JointKind(name='revolute', axes=1, max_axes=1, random_span=(math.pi,))
_UNIVERSAL = JointKind(name='universal', axes=2, max_axes=2, random_span=(math.pi,) * 2)
# The kind of each joint type of URDF and SDF. The pitch of a screw joint is not modelled.
JOINT_KINDS: Mapping[str, JointKind] = {
    'fixed': JointKind(name='fixed'),
    'revolute': _REVOLUTE, 'continuous': _REVOLUTE, 'screw': _REVOLUTE,
    'prismatic': JointKind(name='prismatic', axes=1, max_axes=1, random_span=(1.0,)),
    'floating': JointKind(name='floating', max_axes=1,
                          random_span=(1.0, 1.0, 1.0, math.pi, math.pi, math.pi)),
    'planar': JointKind(name='planar', axes=1, max_axes=1, random_span=(1.0, 1.0, math.pi)),
    'ball': JointKind(name='ball', random_span=(math.pi,) * 3),
    'universal': _UNIVERSAL, 'revolute2': _UNIVERSAL, 'gearbox': _UNIVERSAL,
}
URDF_TYPES = ('fixed', 'revolute', 'continuous', 'prismatic', 'floating', 'planar')
WITHOUT_AXIS = ('fixed', 'floating')  # among ``URDF_TYPES``
SDF_TYPES = ('fixed', 'revolute', 'continuous', 'prismatic', 'screw', 'ball', 'universal',
             'revolute2', 'gearbox')
