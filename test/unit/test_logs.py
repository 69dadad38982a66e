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

"""Limits on the rate of log lines."""

from __future__ import annotations

import time

from opencv_tools.logs import Throttle
import pytest


def test_one_action_a_second(monkeypatch: pytest.MonkeyPatch) -> None:
    times = iter([0.0, 0.5, 0.75, 1.0, 1.5, 2.0, 9.0, 9.5])
    monkeypatch.setattr(time, 'monotonic', lambda: next(times))
    throttle = Throttle()
    assert [throttle.passes() for _ in range(8)] == [
        True, False, False, True, False, True, True, False]
