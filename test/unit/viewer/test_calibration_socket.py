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

"""Limit of the messages of a page."""

from __future__ import annotations

from opencv_tools.viewer.calibrate.routes import MessageBudget


def test_limit_of_messages() -> None:
    budget = MessageBudget()
    assert sum(budget.spend(1000.0) for _ in range(900)) == 100
    assert not budget.spend(1000.0625)
    assert budget.spend(1000.125)
    assert sum(budget.spend(1002.125) for _ in range(900)) == 20
    assert sum(budget.spend(5000.0) for _ in range(900)) == 100


def test_slow_page_is_never_limited() -> None:
    budget = MessageBudget()
    assert all(budget.spend(1000.0 + number / 8) for number in range(1000))
