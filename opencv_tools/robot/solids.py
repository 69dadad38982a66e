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

"""Volumes and moments of inertia of the shapes that SDF and URDF have, except meshes."""

from __future__ import annotations

from collections.abc import Callable, Mapping
import math
from typing import NamedTuple

from opencv_tools.robot.geometry import Geometry
from opencv_tools.robot.pose import Tensor, Vector


class NoSolidError(ValueError):
    """The volume of a shape cannot be computed."""


class Solid(NamedTuple):
    """
    A body of constant density.

    :param volume: in m3.
    :param moments: ixx, ixy, ixz, iyy, iyz, izz about the centre for a mass of 1 kg, in m2.
    :param centre: centre of mass in the frame of the shape, in m.
    """

    volume: float
    moments: Tensor
    centre: Vector = (0.0, 0.0, 0.0)


def solid_of(geometry: Geometry) -> Solid:
    """Return the solid of a box, sphere, cylinder or capsule."""
    return _SOLIDS[type(geometry).__name__.lower()](*vars(geometry).values())


def ellipsoid(x: float, y: float, z: float) -> Solid:
    """Return the solid of an ellipsoid with three radii."""
    moments = (y * y + z * z) / 5, 0.0, 0.0, (x * x + z * z) / 5, 0.0, (x * x + y * y) / 5
    return Solid(4 / 3 * math.pi * x * y * z, moments)


def cone(radius: float, length: float) -> Solid:
    """Return the solid of a cone whose tip points along z and whose origin is halfway up."""
    across = 0.0375 * (4 * radius * radius + length * length)
    return Solid(math.pi * radius * radius * length / 3, _round(across, 0.3 * radius * radius),
                 (0.0, 0.0, -length / 4))


def _round(across: float, around: float) -> Tensor:
    return across, 0.0, 0.0, across, 0.0, around


def _box(size: Vector) -> Solid:
    x, y, z = size
    return Solid(x * y * z, ((y * y + z * z) / 12, 0.0, 0.0, (x * x + z * z) / 12, 0.0,
                             (x * x + y * y) / 12))


def _sphere(radius: float) -> Solid:
    return ellipsoid(radius, radius, radius)


def _cylinder(radius: float, length: float) -> Solid:
    across = (3 * radius * radius + length * length) / 12
    return Solid(math.pi * radius * radius * length, _round(across, radius * radius / 2))


def _capsule(radius: float, length: float) -> Solid:
    """Return a cylinder with two hemispheres, whose centres are 3/8 radius from its ends."""
    cylinder = _cylinder(radius, length)
    sphere = _sphere(radius).volume
    volume = cylinder.volume + sphere
    share = sphere / volume if volume else 0.0
    ends = 0.4 * radius * radius + length * length / 4 + 0.375 * radius * length
    across = (1 - share) * cylinder.moments[0] + share * ends
    around = (1 - share) * cylinder.moments[5] + share * 0.4 * radius * radius
    return Solid(volume, _round(across, around))


_SOLIDS: Mapping[str, Callable[..., Solid]] = {
    'box': _box, 'sphere': _sphere, 'cylinder': _cylinder, 'capsule': _capsule}
