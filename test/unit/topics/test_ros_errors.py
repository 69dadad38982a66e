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

"""Reasons of errors of rclpy."""

from __future__ import annotations

from opencv_tools.topics.errors import ros_reason
import pytest


@pytest.mark.parametrize(('text', 'reason'), [
    ('Failed to create publisher: the type differs, at /project/src/publisher.cpp:145, at '
     './src/rcl/publisher.c:116', 'Failed to create publisher: the type differs'),
    ('failed to resolve name: too long, at ./src/node.c:1', 'too long'),
    ("Invalid topic name:\n  '/a-b'\n    ^", "Invalid topic name: '/a-b' ^"),
    ('no such topic, at night', 'no such topic, at night'),
])
def test_reason(text: str, reason: str) -> None:
    assert ros_reason(RuntimeError(text)) == reason
