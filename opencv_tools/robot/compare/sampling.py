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

"""Random joint positions."""

from __future__ import annotations

import random

from opencv_tools.robot.model import Joint, Limit

# Limits farther from zero than this are ignored, because far poses hide small differences.
_FAR = 1000.0


def random_position(joint: Joint, generator: random.Random) -> list[float]:
    """Return a random position of a joint within its limits, for `joint_transform`."""
    return [generator.uniform(*limits) for limits in _limits(joint)]


def _limits(joint: Joint) -> list[tuple[float, float]]:
    kind = joint.kind
    limits = [axis.limit or Limit() for axis in joint.axes[:kind.axes]
              if joint.has_position_limits]
    limits += [Limit()] * (kind.dof - len(limits))
    return [_finite(limit, span) for limit, span in zip(limits, kind.random_span)]


def _finite(limit: Limit, span: float) -> tuple[float, float]:
    lower, upper = limit.lower, limit.upper
    if abs(lower) > _FAR:
        lower = -span if abs(upper) > _FAR else min(-span, upper - span)
    return lower, max(span, lower + span) if abs(upper) > _FAR else upper
