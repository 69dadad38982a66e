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

"""Errors of parameters and arguments, and those of rclpy with their reasons."""

from __future__ import annotations

import re

from rclpy.exceptions import NameValidationException

#: What rclpy raises for a name or a quality of service that cannot be used; its RCLError, a
#: RuntimeError, is private.
ROS_ERRORS = (RuntimeError, ValueError, NameValidationException)
# What rcl and rmw add to their errors: the failed step, and the lines of their sources.
_PLACE = re.compile(r'^failed to resolve name: |, at \S+:\d+')


def ros_reason(err: Exception) -> str:
    """Return the reason of an error of rclpy as one line, without places in C and C++."""
    return _PLACE.sub('', ' '.join(str(err).split()))


class ParameterError(ValueError):
    """The value of a parameter cannot be used; the message quotes it and names valid values."""
