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

"""The figures of benchmarks/transport.py: work that is left out, and impossible figures."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise
import json
from pathlib import Path
import sys
import time
from typing import Any

import pytest

_BENCHMARKS = Path(__file__).parents[2] / 'benchmarks'
_BUSY_SECONDS = 0.02


@pytest.fixture
def benchmarks(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    before = set(sys.modules)
    monkeypatch.syspath_prepend(_BENCHMARKS)
    yield
    for name in set(sys.modules) - before:
        if name.startswith('transport_'):
            del sys.modules[name]


def _load(**changes: Any) -> Any:
    from transport_parts import Load
    return Load(**dict({
        'width': 64, 'height': 48, 'rate': 30, 'frames': 4, 'qos': 'reliable', 'namespace': '/a',
        'topic': 'b', 'transport': 'shm', 'priority': 0}, **changes))


def _measured(cpu: float, age_ns: int = 1_000_000) -> dict[str, Any]:
    return {'cpu': cpu, 'left_out': 0.5, 'frames': 4, 'faults': 0, 'growth': 0,
            'numbers': [0, 1, 2, 3], 'ages': [age_ns] * 4}


def _work() -> None:
    end = time.thread_time() + _BUSY_SECONDS
    while time.thread_time() < end:
        pass


@pytest.mark.parametrize('uncounted', (0, 1, 7, 20))
@pytest.mark.usefixtures('benchmarks')
def test_left_out_work_of_counted_frames(
    uncounted: int, capsys: pytest.CaptureFixture[str],
) -> None:
    """Only what happens between the first and the last counted frame is left out."""
    from transport_parts import Meter
    meter = Meter()
    for _ in range(uncounted):
        with meter.leave_out():
            _work()
    for _ in range(3):
        meter.tick()
        with meter.leave_out():
            _work()
    for _ in range(uncounted):
        with meter.leave_out():
            _work()
    meter.report()
    measured = json.loads(capsys.readouterr().out)
    assert measured['left_out'] == pytest.approx(_BUSY_SECONDS * 1e3, rel=0.5)
    assert measured['cpu'] >= 0


@pytest.mark.parametrize('sent, received, age_ns', (
    (-0.16, 0.5, 1), (0.5, -1e-6, 1), (0.5, 0.5, -1), (-7.0, 0.5, 10**9)))
@pytest.mark.usefixtures('benchmarks')
def test_negative_figures(sent: float, received: float, age_ns: int) -> None:
    from transport_run import _result, ImpossibleFigureError
    with pytest.raises(ImpossibleFigureError, match='must be positive'):
        _result(_load(), [_measured(received, age_ns)], [], _measured(sent))


@pytest.mark.parametrize('cpu', (0.0, 0.3, 50.0))
@pytest.mark.usefixtures('benchmarks')
def test_sum_of_the_processes(cpu: float) -> None:
    from transport_run import _result
    result = _result(_load(), [_measured(0.25)], [_measured(1.0)], _measured(cpu))
    assert (result.cpu, result.publisher_cpu, result.filter_cpu) == (cpu + 1.25, cpu, 0.5)


@pytest.mark.parametrize('stall', (0.0, 0.3, 0.8))
@pytest.mark.usefixtures('benchmarks')
def test_rate_after_a_stall(stall: float, monkeypatch: pytest.MonkeyPatch) -> None:
    """Frames that waited are not sent all at once."""
    import transport_parts
    now = 100.0
    monkeypatch.setattr(transport_parts.time, 'monotonic', lambda: now)
    camera = transport_parts.Camera(_load())
    camera.read()
    now += stall
    times = []
    for _ in range(20):
        while not camera.wait(0.0):
            now += 0.001
        times.append(now)
        camera.read()
    gaps = [later - earlier for earlier, later in pairwise(times)]
    assert min(gaps) == pytest.approx(1 / 30, abs=0.002)


@pytest.mark.usefixtures('benchmarks')
def test_camera_is_a_source() -> None:
    from opencv_tools.capture.frame import LiveSource
    from transport_parts import Camera
    camera = Camera(_load())
    names = {name for known in LiveSource.__mro__
             for name in getattr(known, '__annotations__', ())}
    assert names and not [name for name in names if not hasattr(camera, name)]
