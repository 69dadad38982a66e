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

"""Diagnostics of the source, computed for one period."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

from conftest import spin_until
from diagnostic_msgs.msg import DiagnosticArray
from opencv_tools.nodes.publisher.diagnostics import Diagnostics, SourceStatus
import pytest
from rclpy.node import Node


def test_diagnostics_of_one_period(node: Node, monkeypatch: pytest.MonkeyPatch) -> None:
    now = 100.0
    monkeypatch.setattr('opencv_tools.nodes.publisher.diagnostics.time',
                        SimpleNamespace(monotonic=lambda: now))
    messages: list[DiagnosticArray] = []
    node.create_subscription(DiagnosticArray, '/diagnostics', messages.append, 10)
    source_status = SourceStatus(
        source='eye', description='bgr8 4x3', unavailable_reason='', paused=False, missed=0,
        dropped=0, reconnects=0)
    diagnostics = Diagnostics(node, lambda: source_status)
    spin_until(node, lambda: node.count_publishers('/diagnostics') == 1)
    for age in (0.01, 0.025, 0.02):
        diagnostics.count(age)
    now += 2.0
    source_status = replace(source_status, missed=2, dropped=1)
    spin_until(node, lambda: bool(messages))
    (status,) = messages[0].status
    values = {value.key: value.value for value in status.values}
    assert (values['rate'], values['age']) == ('1.5 Hz', '25.0 ms at most')
    assert (status.level, status.message) == (b'\1', '3 frames lost in the last second')
    assert (values['dropped'], values['missed']) == ('1', '2')
