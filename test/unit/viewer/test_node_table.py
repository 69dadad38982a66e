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

"""The graph that ``img_viewer --list`` prints."""

from typing import Any

from opencv_tools.viewer import node_table
import pytest

NODE: Any = None


def graph(*names: str) -> dict[str, Any]:
    return {'nodes': [*names], 'topics': [], 'more': 0}


def test_list_waits_until_the_graph_stays_the_same(monkeypatch: pytest.MonkeyPatch) -> None:
    found = [graph('/a'), graph('/a', '/b'), graph('/a', '/b', '/c'), graph('/a', '/b', '/c')]
    monkeypatch.setattr(node_table, 'read_graph', lambda node: found.pop(0))
    monkeypatch.setattr(node_table.time, 'sleep', lambda seconds: None)
    assert node_table.read_settled_graph(NODE) == graph('/a', '/b', '/c')
    assert not found


def test_list_of_a_graph_that_never_stays_the_same(monkeypatch: pytest.MonkeyPatch) -> None:
    waits: list[float] = []
    monkeypatch.setattr(node_table, 'read_graph', lambda node: graph(f'/node_{len(waits)}'))
    monkeypatch.setattr(node_table.time, 'sleep', waits.append)
    assert node_table.read_settled_graph(NODE) == graph('/node_9')
    assert sum(waits) < 12.0
