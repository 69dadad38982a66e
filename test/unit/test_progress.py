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

"""Lines about the progress of a stream of frames."""

from __future__ import annotations

import re

from opencv_tools.base.progress import Progress
import pytest


def test_one_line_a_second(monkeypatch: pytest.MonkeyPatch) -> None:
    now = 100.0
    monkeypatch.setattr('time.monotonic', lambda: now)
    lines: list[str] = []
    progress = Progress(lines.append, 'Doing')
    for _ in range(50):
        progress.tick('4x3 bgr8', dropped=2, missed=0)
        now += 0.05
    assert progress.count == 50
    assert progress.average_rate() == pytest.approx(20.0)
    assert lines[0] == 'Doing 1: 4x3 bgr8, 2 dropped'
    assert [bool(re.fullmatch(r'Doing \d+: 4x3 bgr8, 20\.0 Hz, 2 dropped', line))
            for line in lines[1:]] == [True, True]
    now += 1.0
    progress.tick('4x3 bgr8', dropped=2, missed=7)
    assert lines[-1].endswith(' 2 dropped, 7 missed')
