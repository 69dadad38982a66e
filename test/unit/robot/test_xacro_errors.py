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

"""Errors of xacro as one line."""

from __future__ import annotations

from opencv_tools.robot.xacro.errors import to_description_error


def test_error_without_a_message() -> None:
    error = to_description_error(KeyError(), 'a.xacro')
    assert str(error) == 'a.xacro: cannot be expanded: KeyError'
