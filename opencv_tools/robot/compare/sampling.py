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

"""Positions that joints can be in, chosen at random."""

from __future__ import annotations

from collections.abc import Mapping
import math
import random

from opencv_tools.robot.kinematics import AXES, DOF
from opencv_tools.robot.model import Joint, JOINT_TYPES, Limit

# Where joints without limits are put: so far from zero, in radians or metres, by kind of joint.
_SPANS: Mapping[str, tuple[float, ...]] = {
    '': (), 'turn': (math.pi,), 'shift': (1.0,), 'two turns': (math.pi,) * 2,
    'ball': (math.pi,) * 3, 'plane': (1.0, 1.0, math.pi), 'free': (1.0,) * 3 + (math.pi,) * 3,
}
# Limits further away than this are none here: what is small would drown in what is far.
_FAR = 1000.0


def random_position(joint: Joint, generator: random.Random) -> list[float]:
    """Return a random position of a joint within its limits, for `joint_transform`."""
    return [generator.uniform(*reach) for reach in _reaches(joint)]


def _reaches(joint: Joint) -> list[tuple[float, float]]:
    kind = JOINT_TYPES[joint.type]
    limits = [axis.limit or Limit() for axis in joint.axes[:AXES[kind]]
              if joint.type != 'continuous' and kind != 'plane']
    limits += [Limit()] * (DOF[kind] - len(limits))
    return [_reach(limit, span) for limit, span in zip(limits, _SPANS[kind])]


def _reach(limit: Limit, span: float) -> tuple[float, float]:
    lower, upper = limit.lower, limit.upper
    if abs(lower) > _FAR:
        lower = -span if abs(upper) > _FAR else min(-span, upper - span)
    return lower, max(span, lower + span) if abs(upper) > _FAR else upper
