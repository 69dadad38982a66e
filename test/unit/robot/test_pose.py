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

from __future__ import annotations

import math

from hypothesis import given, settings, strategies as st
import numpy as np
from opencv_tools.robot.pose import (IDENTITY, normalised, Pose, rotation_about,
                                     rotation_of_quaternion, rotation_of_rpy, Transform, Vector)
import pytest
from rows import each_row

ANGLES = st.one_of(
    st.floats(-7, 7),
    st.sampled_from([0.0, math.pi / 2, -math.pi / 2, math.pi, -math.pi, math.pi / 2 - 1e-9,
                     math.pi / 2 + 1e-12, 1e-300]))
VECTORS = st.tuples(*[st.floats(-100, 100)] * 3)
POSES = st.builds(Pose, VECTORS, st.tuples(*[ANGLES] * 3))
AXES = VECTORS.filter(lambda axis: math.hypot(*axis) > 1e-3)
some = settings(max_examples=100, deadline=None)


def matrix(transform: Transform) -> np.ndarray:
    result = np.eye(4)
    result[:3, :3] = np.reshape(transform.rotation, (3, 3))
    result[:3, 3] = transform.translation
    return result


def turn(axis: str, angle: float) -> np.ndarray:
    one, other = {'x': (1, 2), 'y': (2, 0), 'z': (0, 1)}[axis]
    result = np.eye(3)
    result[[one, other], [one, other]] = math.cos(angle)
    result[one, other], result[other, one] = -math.sin(angle), math.sin(angle)
    return result


@some
@given(ANGLES, ANGLES, ANGLES)
def test_order_of_roll_pitch_and_yaw_about_fixed_axes(
        roll: float, pitch: float, yaw: float) -> None:
    expected = turn('z', yaw) @ turn('y', pitch) @ turn('x', roll)
    found = np.reshape(rotation_of_rpy((roll, pitch, yaw)), (3, 3))
    assert np.abs(found - expected).max() < 4e-16


def test_yaw_from_x_to_y() -> None:
    turned = Pose(rpy=(0.0, 0.0, math.pi / 2)).transform().rotate((1.0, 0.0, 0.0))
    assert turned == pytest.approx((0.0, 1.0, 0.0), abs=1e-15)


@some
@given(POSES, POSES)
def test_transform_product_equals_matrix_product(one: Pose, other: Pose) -> None:
    both = one.transform() @ other.transform()
    assert np.allclose(matrix(both), matrix(one.transform()) @ matrix(other.transform()),
                       rtol=1e-14, atol=1e-12)


@some
@given(POSES)
def test_inverse_from_both_sides(pose: Pose) -> None:
    transform = pose.transform()
    for product in (transform @ transform.inverse(), transform.inverse() @ transform):
        assert np.allclose(matrix(product), np.eye(4), rtol=0, atol=2e-13)


@some
@given(POSES, VECTORS)
def test_points_and_directions(pose: Pose, point: Vector) -> None:
    transform = pose.transform()
    assert transform.apply(point) == pytest.approx(
        tuple(matrix(transform) @ [*point, 1])[:3], abs=1e-12)
    assert transform.rotate(point) == pytest.approx(
        tuple(matrix(transform)[:3, :3] @ point), abs=1e-12)


@some
@given(POSES)
def test_pose_round_trip(pose: Pose) -> None:
    transform = pose.transform()
    again = transform.pose().transform()
    assert again.translation == transform.translation
    assert again.rotation == pytest.approx(transform.rotation, abs=1e-15)


@each_row('pitch', [math.pi / 2, -math.pi / 2])
@each_row('off', [0.0, 1e-17, 1e-16, 1e-15, 1e-14, 1e-12, 1e-9, 1e-8, 1e-6])
def test_precision_near_gimbal_lock(pitch: float, off: float) -> None:
    for roll, yaw in ((0.0, 0.0), (0.3, -1.1), (3.0, 2.9), (-math.pi, math.pi / 2)):
        transform = Pose(rpy=(roll, pitch + off, yaw)).transform()
        pose = transform.pose()
        assert abs(pose.rpy[1]) <= math.pi / 2
        assert pose.transform().rotation == pytest.approx(transform.rotation, abs=1e-15)


def test_no_negative_zeros() -> None:
    for rpy in ((0.0, 0.0, 0.0), (0.0, 0.0, 1.0), (-0.0, 0.5, -0.0)):
        found = Transform(rotation_of_rpy(rpy)).pose().rpy
        assert not any(value == 0 and math.copysign(1, value) < 0 for value in found)


def test_identity_pose() -> None:
    assert Pose((0.0, -0.0, 0.0), (-0.0, 0.0, 0.0)).is_identity
    assert not Pose((0.0, 0.0, 1e-300)).is_identity
    assert not Pose(rpy=(0.0, 0.0, 2 * math.pi)).is_identity
    assert IDENTITY.pose() == Pose()


def test_exact_numbers_without_rotation() -> None:
    pose = Pose((0.1, 0.2, 0.30000000000000004))
    assert (IDENTITY @ pose.transform()).pose() == pose
    assert pose.transform().inverse().inverse().pose() == pose


@some
@given(POSES)
def test_quaternion_round_trip(pose: Pose) -> None:
    rotation = pose.transform().rotation
    quaternion = Transform(rotation).quaternion()
    assert quaternion[0] >= 0
    assert math.hypot(*quaternion) == pytest.approx(1, abs=1e-15)
    assert rotation_of_quaternion(quaternion) == pytest.approx(rotation, abs=2e-15)


@each_row(('rpy', 'quaternion'), [
    ((0.0, 0.0, 0.0), (1, 0, 0, 0)),
    ((math.pi, 0.0, 0.0), (0, 1, 0, 0)),
    ((0.0, math.pi, 0.0), (0, 0, 1, 0)),
    ((0.0, 0.0, math.pi), (0, 0, 0, 1)),
    ((math.pi / 2, 0.0, math.pi / 2), (0.5, 0.5, 0.5, 0.5)),
])
def test_known_quaternions(rpy: Vector, quaternion: tuple[float, ...]) -> None:
    assert Pose(rpy=rpy).transform().quaternion() == pytest.approx(quaternion, abs=1e-15)


def test_quaternions_of_any_length() -> None:
    expected = pytest.approx(rotation_of_rpy((0.0, 0.0, math.pi / 2)), abs=1e-15)
    for size in (1e-200, 1.0, 1e200):
        assert rotation_of_quaternion((size, 0.0, 0.0, size)) == expected
        assert rotation_of_quaternion((-size, 0.0, 0.0, -size)) == expected


@some
@given(AXES, ANGLES)
def test_rotation_about_an_axis(
        axis: Vector, angle: float) -> None:
    rotation = Transform(rotation_about(axis, angle))
    unit = normalised(axis)
    assert rotation.rotate((unit[0], unit[1], unit[2])) == pytest.approx(unit, abs=1e-14)
    x, y, z = unit
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    expected = np.eye(3) + math.sin(angle) * cross + (1 - math.cos(angle)) * cross @ cross
    assert np.abs(matrix(rotation)[:3, :3] - expected).max() < 1e-14


@each_row('size', [5e-324, 1e-310, 1e-200, 1e-9, 1.0, 1e9, 1e200, 1.7e308])
def test_normalised_vectors_of_any_length(size: float) -> None:
    assert normalised((size, 0.0, 0.0)) == (1.0, 0.0, 0.0)
    assert normalised((0.0, -size, size)) == pytest.approx((0, -math.sqrt(0.5), math.sqrt(0.5)))


def test_unchanged_unit_vectors() -> None:
    for vector in ((0.6, 0.0, 0.8), (math.sqrt(0.5), math.sqrt(0.5), 0.0), (0.0, 0.0, -1.0)):
        assert normalised(vector) == vector
