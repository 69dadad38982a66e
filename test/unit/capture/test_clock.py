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

"""The clock of the machine."""

from __future__ import annotations

from threading import Event
import time

from opencv_tools.capture.clock import SYSTEM_CLOCK


def test_system_clock_waits_for_an_event_or_a_timeout() -> None:
    assert time.monotonic() <= SYSTEM_CLOCK.monotonic() <= time.monotonic()
    event = Event()
    assert not SYSTEM_CLOCK.wait(event, 0.01)
    event.set()
    assert SYSTEM_CLOCK.wait(event, 3600.0)
