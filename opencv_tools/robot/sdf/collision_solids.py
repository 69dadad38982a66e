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

"""Solids of collisions, with those that only SDF has and with meshes."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from opencv_tools.robot.geometry import Mesh
from opencv_tools.robot.meshes import mesh_solid
from opencv_tools.robot.model import Shape
from opencv_tools.robot.sdf.values import number_of
from opencv_tools.robot.solids import cone, ellipsoid, NoSolidError, Solid, solid_of
from opencv_tools.robot.xml.numbers import vector


def solid_of_collision(shape: Shape, folders: Sequence[Path]) -> Solid:
    """
    Return the solid of a collision.

    :param folders: folders in which meshes are searched.
    :raises NoSolidError: it is not known, or the shape has no volume.
    """
    geometry, find_sdf = shape.geometry, shape.extension.find_sdf
    if isinstance(geometry, Mesh):
        if find_sdf('geometry/mesh/submesh') is not None:
            raise NoSolidError('it is a part of a mesh')
        return mesh_solid(geometry, folders)
    if geometry is not None:
        return solid_of(geometry)
    ellipse, peak = find_sdf('geometry/ellipsoid'), find_sdf('geometry/cone')
    if ellipse is not None:
        return ellipsoid(*vector(ellipse.findtext('radii', '1 1 1'), ellipse))
    if peak is not None:
        return cone(number_of(peak, 'radius', 0.5), number_of(peak, 'length', 1.0))
    raise NoSolidError('it is no solid')
