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

"""What a visual or a collision is made of, and what it looks like; where it is says the model."""

from __future__ import annotations

from dataclasses import dataclass

from opencv_tools.robot.pose import Vector

Color = tuple[float, float, float, float]  # red, green, blue, alpha from 0 to 1


@dataclass(frozen=True)
class Box:
    """A box with its centre in the origin; its lengths along x, y and z in metres."""

    size: Vector


@dataclass(frozen=True)
class Sphere:
    """A sphere with its centre in the origin; metres."""

    radius: float


@dataclass(frozen=True)
class Cylinder:
    """A cylinder along z with its centre in the origin; metres."""

    radius: float
    length: float


@dataclass(frozen=True)
class Capsule:
    """A cylinder along z with half a sphere on either end, which ``length`` leaves out; metres."""

    radius: float
    length: float


@dataclass(frozen=True)
class Mesh:
    """A mesh, scaled along x, y and z; None where no scale is written."""

    uri: str
    scale: Vector | None = None


Geometry = Box | Sphere | Cylinder | Capsule | Mesh


# What SDF takes a light of a material for that is not written: none.
DARK: Color = (0.0, 0.0, 0.0, 1.0)
# The colours of SDF that URDF has no word for.
LIGHT_COLORS = ('ambient', 'specular', 'emissive')


@dataclass(frozen=True)
class Material:
    """
    What a surface looks like.

    URDF has ``name``, ``color`` and ``texture`` only. A colour of URDF is SDF's diffuse and
    ambient one, without any specular or emissive light.
    """

    name: str = ''
    color: Color | None = None
    ambient: Color | None = None
    specular: Color | None = None
    emissive: Color | None = None
    texture: str = ''
