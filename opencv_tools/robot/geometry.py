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

"""Geometries and materials of visuals and collisions."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

from opencv_tools.robot.pose import Vector

Color = tuple[float, float, float, float]  # red, green, blue, alpha from 0 to 1


@dataclass(frozen=True)
class Box:
    """A box with its centre at the origin; lengths along x, y and z in metres."""

    size: Vector


@dataclass(frozen=True)
class Sphere:
    """A sphere with its centre at the origin; metres."""

    radius: float


@dataclass(frozen=True)
class Cylinder:
    """A cylinder along z with its centre at the origin; metres."""

    radius: float
    length: float


@dataclass(frozen=True)
class Capsule:
    """A cylinder along z with a hemisphere at both ends; ``length`` is without them; metres."""

    radius: float
    length: float

    @property
    def cylinder(self) -> Cylinder:
        """Cylinder of the same length, for versions of formats without capsules."""
        return Cylinder(self.radius, self.length + 2 * self.radius)


@dataclass(frozen=True)
class Mesh:
    """A mesh and its scale along x, y and z; None if the file has no scale."""

    uri: str
    scale: Vector | None = None


Geometry = Box | Sphere | Cylinder | Capsule | Mesh
# The solids of both formats by tag, and their sizes with the defaults of SDF.
SOLIDS: Mapping[str, tuple[Callable[..., Geometry], Mapping[str, str]]] = {
    'box': (Box, {'size': '1 1 1'}), 'sphere': (Sphere, {'radius': '1'}),
    'cylinder': (Cylinder, {'radius': '1', 'length': '1'}),
    'capsule': (Capsule, {'radius': '0.5', 'length': '1'})}
GEOMETRIES = (*SOLIDS, 'mesh')
BLACK: Color = (0.0, 0.0, 0.0, 1.0)  # SDF's default for each of ``LIGHT_COLORS``
# Colours of SDF that URDF does not support.
LIGHT_COLORS = ('ambient', 'specular', 'emissive')


@dataclass(frozen=True, kw_only=True)
class Material:
    """
    Appearance of a surface.

    URDF has only ``name``, ``color`` and ``texture``. A colour of URDF corresponds to the same
    diffuse and ambient colours in SDF and to no specular or emissive light.
    """

    name: str = ''
    color: Color | None = None
    ambient: Color | None = None
    specular: Color | None = None
    emissive: Color | None = None
    texture: str = ''
