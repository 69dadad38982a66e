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

"""Volumes and moments of inertia: shapes of the formats, and triangle meshes in files."""

from __future__ import annotations

from array import array
from collections.abc import Callable, Mapping, Sequence
from itertools import pairwise
import math
from pathlib import Path
import re
from typing import NamedTuple, TYPE_CHECKING

from opencv_tools.base.regular_files import read_regular
from opencv_tools.robot.geometry import Geometry, Mesh
from opencv_tools.robot.packages import own_files
from opencv_tools.robot.pose import Tensor, Vector

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray
    _Array = NDArray[np.float64]

MAX_BYTES = 50_000_000
#: First bytes of what git has in place of a file, until it gets the file from a store.
LFS_POINTER = b'version https://git-lfs.github.com/spec/v1\n'
LFS_REASON = 'is a Git LFS pointer; run `git lfs pull`'
_VERTEX = re.compile(rb'^\s*vertex\s+(\S+)\s+(\S+)\s+(\S+)\s*$', re.MULTILINE)
_ROUNDING = 1e-12
_HEADER, _TRIANGLE = 84, 50  # bytes of a binary STL


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


def mesh_solid(mesh: Mesh, folders: Sequence[Path]) -> Solid:
    """
    Return the solid that a closed mesh encloses.

    The integrals over a mesh are the sums of those over the tetrahedra of its triangles and one
    point, with signs (B. Mirtich, Fast and accurate computation of polyhedral mass properties,
    1996). The formula for a tetrahedron is that of F. Tonon (Explicit exact formulas for the 3-D
    tetrahedron inertia tensor, 2004).

    :param folders: folders in which the file is searched.
    :raises NoSolidError: the file is missing, is no closed mesh, or has another format than STL
        and OBJ.
    """
    import numpy as np
    with np.errstate(all='ignore'):  # results that are not finite are found later
        triangles = _read(mesh.uri, folders) * (mesh.scale or (1.0, 1.0, 1.0))
        _check_closed(triangles)
        origin = triangles.mean(axis=(0, 1))
        corners = triangles - origin
        a, b, c = corners.transpose(1, 0, 2)
        volumes = np.einsum('ni,ni->n', a, np.cross(b, c)) / 6
        volume = volumes.sum()
        if abs(volume) <= _ROUNDING * np.abs(volumes).sum():
            raise NoSolidError('it encloses no volume')
        shares = volumes / volume  # also right if all triangles are seen from inside
        sums = corners.sum(axis=1)
        centre = shares @ sums / 4
        points = np.concatenate([sums[:, None], corners], axis=1)
        second = np.einsum('n,npi,npj->ij', shares, points, points) / 20 - np.outer(centre, centre)
        xx, xy, xz, yy, yz, zz = (np.trace(second) * np.eye(3) - second)[
            np.triu_indices(3)].tolist()
    x, y, z = (centre + origin).tolist()
    return Solid(abs(float(volume)), (xx, xy, xz, yy, yz, zz), (x, y, z))


def _read(uri: str, folders: Sequence[Path]) -> _Array:
    """Return the corners of the triangles of a file, of shape (n, 3, 3)."""
    import numpy as np
    readers = {'.stl': _stl, '.obj': _obj}
    reader = readers.get(Path(uri).suffix.lower())
    if reader is None:
        raise NoSolidError(f'only {" and ".join(readers)} are read')
    try:
        data = read_regular(_find(uri, folders), MAX_BYTES)
    except OSError as err:
        raise NoSolidError(f'{uri} cannot be read: {err.strerror}') from err
    if data.startswith(LFS_POINTER):
        raise NoSolidError(f'{uri} {LFS_REASON}')
    try:
        triangles = reader(data)
    except ValueError as err:
        raise NoSolidError(f'{uri} is damaged') from err
    if not (len(triangles) and np.isfinite(triangles).all()):
        raise NoSolidError(f'{uri} has no triangles, or numbers that are not finite')
    return triangles


def _find(uri: str, folders: Sequence[Path]) -> Path:
    scheme, separator, path = uri.rpartition('://')
    if separator and scheme not in ('file', 'model', 'package'):
        raise NoSolidError(f'{uri} is not on this computer')
    if scheme != 'file':
        path = path.lstrip('/') if separator else path
    own = own_files(path, folders[0] / '-') if separator and folders else ()
    for candidate in (*(folder / path for folder in folders), *own):
        if candidate.exists():
            return candidate
    raise NoSolidError(f'{uri} is not found; add its folder to GZ_SIM_RESOURCE_PATH')


def _stl(data: bytes) -> _Array:
    import numpy as np
    count = int.from_bytes(data[_HEADER - 4:_HEADER], 'little')
    if len(data) == _HEADER + _TRIANGLE * count:
        # Each triangle has a normal, three corners, and two more bytes.
        rows = np.frombuffer(data, np.uint8, offset=_HEADER).reshape(count, _TRIANGLE)
        return rows[:, 12:48].copy().view('<f4').reshape(count, 3, 3).astype(np.float64)
    words = _VERTEX.findall(data)
    return np.array(words, np.bytes_).astype(np.float64).reshape(-1, 3, 3)


def _obj(data: bytes) -> _Array:
    import numpy as np
    points, corners = array('d'), array('q')
    for line in data.splitlines():
        tag, *words = line.split() or [b'']
        if tag == b'v':
            points.extend(map(float, words[:3]))
        elif tag == b'f':
            known = len(points) // 3
            numbers = [int(word.partition(b'/')[0]) for word in words]
            face = [number - 1 if number > 0 else known + number for number in numbers]
            if not all(0 <= corner < known for corner in face):
                raise ValueError
            for second, third in pairwise(face[1:]):  # polygons are convex
                corners.extend((face[0], second, third))
    return np.array(points).reshape(-1, 3)[np.array(corners, np.int64)].reshape(-1, 3, 3)


def _check_closed(triangles: _Array) -> None:
    """Check that each edge is passed as often in one direction as in the other."""
    import numpy as np
    points, corners = np.unique(triangles.reshape(-1, 3), axis=0, return_inverse=True)
    begins = corners.reshape(-1, 3)
    ends = np.roll(begins, -1, axis=1)
    forth, back = (np.sort((one * len(points) + other).ravel())
                   for one, other in ((begins, ends), (ends, begins)))
    if not np.array_equal(forth, back):
        raise NoSolidError('it is not closed')
