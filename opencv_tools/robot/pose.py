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

"""Poses with the numbers of a file, and rigid transforms."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
import math
import operator
from typing import NamedTuple

Vector = tuple[float, float, float]
Quaternion = tuple[float, float, float, float]  # w, x, y, z
# 3 x 3 matrix in row-major order.
Matrix = tuple[float, float, float, float, float, float, float, float, float]
Tensor = tuple[float, float, float, float, float, float]  # xx, xy, xz, yy, yz, zz

ZERO: Vector = (0.0, 0.0, 0.0)
_NO_ROTATION: Matrix = (1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0)


@dataclass(frozen=True)
class Pose:
    """
    A pose with the unchanged numbers of a file.

    :param xyz: position in metres.
    :param rpy: roll, pitch and yaw in radians about the fixed axes x, y and z, in this order.
    """

    xyz: Vector = ZERO
    rpy: Vector = ZERO

    @property
    def is_identity(self) -> bool:
        """Whether all numbers of the pose are zero."""
        return self.xyz == ZERO and self.rpy == ZERO

    def transform(self) -> Transform:
        """Return the rigid transform from the placed frame to the frame of reference."""
        return Transform(rotation_of_rpy(self.rpy), self.xyz)


class Transform(NamedTuple):
    """
    A rigid transform: the position and orientation of a frame in another frame.

    :param rotation: rotation matrix; its columns are the axes of the frame.
    :param translation: origin of the frame in metres.
    """

    rotation: Matrix = _NO_ROTATION
    translation: Vector = ZERO

    def __matmul__(self, other: Transform) -> Transform:
        """Return the composed transform, which applies the other transform first."""
        if self.rotation is _NO_ROTATION:
            return Transform(other.rotation, _sum(self.translation, other.translation))
        return Transform(_product(self.rotation, other.rotation), self.apply(other.translation))

    def inverse(self) -> Transform:
        """Return the inverse transform."""
        x, y, z = self.translation
        if self.rotation is _NO_ROTATION:
            return Transform(_NO_ROTATION, (0.0 - x, 0.0 - y, 0.0 - z))
        a, b, c, d, e, f, g, h, i = self.rotation
        return Transform((a, d, g, b, e, h, c, f, i), (
            -(a * x + d * y + g * z), -(b * x + e * y + h * z), -(c * x + f * y + i * z)))

    def rotate(self, vector: Vector) -> Vector:
        """Return a direction rotated."""
        a, b, c, d, e, f, g, h, i = self.rotation
        x, y, z = vector
        return (a * x + b * y + c * z, d * x + e * y + f * z, g * x + h * y + i * z)

    def apply(self, point: Vector) -> Vector:
        """Return a point rotated and translated."""
        return _sum(self.rotate(point), self.translation)

    def pose(self) -> Pose:
        """
        Return the pose of this transform, exact to the last bits at every pitch.

        Near a pitch of 90 degrees roll and yaw rotate about the same axis. Any yaw is then
        correct, because the roll is computed from the matrix after the yaw has been undone.
        """
        if self.rotation is _NO_ROTATION:
            return Pose(self.translation)
        a, b, c, d, e, f, g, _, _ = self.rotation
        cos_pitch = math.hypot(a, d)
        yaw = math.atan2(d, a) if cos_pitch > 1e-15 else 0.0
        sine, cosine = math.sin(yaw), math.cos(yaw)
        roll = math.atan2(sine * c - cosine * f, cosine * e - sine * b)
        return Pose(self.translation, (roll + 0.0, math.atan2(-g, cos_pitch) + 0.0, yaw + 0.0))

    def quaternion(self) -> Quaternion:
        """Return the rotation as a unit quaternion w, x, y, z with w >= 0."""
        a, b, c, d, e, f, g, h, i = self.rotation
        # The largest of the four squares avoids a division by a small number.
        squares = (1 + a + e + i, 1 + a - e - i, 1 - a + e - i, 1 - a - e + i)
        largest = max(range(4), key=squares.__getitem__)
        quaternion = (
            (squares[0], h - f, c - g, d - b), (h - f, squares[1], b + d, c + g),
            (c - g, b + d, squares[2], f + h), (d - b, c + g, f + h, squares[3]))[largest]
        w, x, y, z = normalised(quaternion)
        return (w, x, y, z) if w >= 0 else (-w, -x, -y, -z)


IDENTITY = Transform()


def rotation_of_rpy(rpy: Vector) -> Matrix:
    """Return R = Rz(yaw) Ry(pitch) Rx(roll), the convention of URDF and SDF."""
    if rpy == ZERO:
        return _NO_ROTATION
    roll, pitch, yaw = rpy
    sr, cr = math.sin(roll), math.cos(roll)
    sp, cp = math.sin(pitch), math.cos(pitch)
    sy, cy = math.sin(yaw), math.cos(yaw)
    return (cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr,
            sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr,
            -sp, cp * sr, cp * cr)


def rotation_of_quaternion(quaternion: Quaternion) -> Matrix:
    """Return the rotation of a quaternion w, x, y, z of any length except 0."""
    w, x, y, z = normalised(quaternion)
    return (1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y),
            2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x),
            2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y))


def rotation_about(axis: Vector, angle: float) -> Matrix:
    """Return the rotation by an angle in radians about an axis of any length except 0."""
    x, y, z = normalised(axis)
    sine = math.sin(angle / 2)
    return rotation_of_quaternion((math.cos(angle / 2), x * sine, y * sine, z * sine))


def normalised(vector: Sequence[float]) -> tuple[float, ...]:
    """Return a vector scaled to length 1; a vector of length 1 to the last bits is unchanged."""
    # Scaled by the largest value first, so that squares neither overflow nor underflow.
    largest = max(map(abs, vector))
    scaled = [value / largest for value in vector]
    length = math.hypot(*scaled)
    if abs(largest * length - 1) < 4e-16:
        return tuple(vector)
    return tuple(value / length for value in scaled)


def rotated_tensor(tensor: Tensor, rotation: Matrix) -> Tensor:
    """Return R T R', a symmetric tensor rotated by R."""
    xx, xy, xz, yy, yz, zz = tensor
    rows = [rotation[start:start + 3] for start in (0, 3, 6)]
    columns = [(row[0] * xx + row[1] * xy + row[2] * xz, row[0] * xy + row[1] * yy + row[2] * yz,
                row[0] * xz + row[1] * yz + row[2] * zz) for row in rows]
    ixx, ixy, ixz, iyy, iyz, izz = (
        sum(map(operator.mul, columns[i], rows[j]))
        for i, j in ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2)))
    return ixx, ixy, ixz, iyy, iyz, izz


def _sum(u: Vector, v: Vector) -> Vector:
    return (u[0] + v[0], u[1] + v[1], u[2] + v[2])


def _product(left: Matrix, right: Matrix) -> Matrix:
    a, b, c, d, e, f, g, h, i = left
    j, k, l, m, n, o, p, q, r = right  # noqa: E741
    return (a * j + b * m + c * p, a * k + b * n + c * q, a * l + b * o + c * r,
            d * j + e * m + f * p, d * k + e * n + f * q, d * l + e * o + f * r,
            g * j + h * m + i * p, g * k + h * n + i * q, g * l + h * o + i * r)
