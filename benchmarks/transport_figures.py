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

"""Figures of benchmarks/transport.py and their goals."""

from __future__ import annotations

from figures import Figure
from transport_parts import SETTLED_FRAMES
from transport_run import Result

_LIGHT, _FAST, _LARGE = '1920x1080@30', '1920x1080@60', '3840x2160@30'
# The node that a way is compared with; the tutorial's nodes for all others.
_REFERENCES = dict.fromkeys(('own node raw', 'own node shm', 'own node loan'), 'plain node')
_MEMORY = f'memory after frame {SETTLED_FRAMES}'
_WITHOUT_GOAL = ('delivered', 'age p50', 'age p99', 'CPU')
_EVERYWHERE = {'delivered': 100.0, _MEMORY: 10.0}  # of the ways below
_GOALS = {
    ('ours raw', f'{_LIGHT} x1'): {
        'age p50 to memcpy': 5.5, 'CPU': 4.2, "age p50, tutorial's to it": 4.5,
        "age p99, tutorial's to it": 6.0, "CPU, tutorial's to it": 2.5},
    ('ours raw', f'{_FAST} x1'): {'age p50 to memcpy': 10.0, "age p50, tutorial's to it": 8.0},
    ('ours raw', f'{_LARGE} x1'): {'age p50 to memcpy': 12.0, "age p50, tutorial's to it": 8.0},
    ('ours shm', f'{_LIGHT} x1'): {
        'age p50': 1.1, 'age p99 - p50': 2.0, 'CPU': 2.1, "age p50, tutorial's to it": 20.0},
    ('ours shm', f'{_FAST} x8'): {'age p99': 5.0},
    ('thread shm', f'{_LIGHT} x1'): {
        'age p50': 0.95, 'age p99 - p50': 2.0, 'CPU': 1.6, "age p50, tutorial's to it": 20.0},
    ('thread shm', f'{_FAST} x8'): {'age p99': 5.0},
    ('thread shm', f'{_LARGE} x1'): {'age p50 to memcpy': 1.5, 'CPU': 3.0},
    # A loan copies nothing, so its goals have the unit ms. They are those of C++ and iceoryx2.
    ('ours loan', f'{_LIGHT} x1'): {
        'age p50': 0.45, 'CPU': 0.9, "age p50, tutorial's to it": 40.0},
    ('thread loan', f'{_LIGHT} x1'): {
        'age p50': 0.3, 'CPU': 0.6, "age p50, tutorial's to it": 40.0},
    ('thread loan', f'{_LARGE} x1'): {'age p50': 0.3},
    ('own node loan', f'{_LIGHT} x1'): {
        "age without the flip, plain node's to it": 10.0,
        "CPU of the node, plain node's to it": 6.0},
    ('own node shm', f'{_LIGHT} x1'): {
        "age p50, plain node's to it": 8.0, "CPU of the node, plain node's to it": 3.0}}
_FURTHER_CPU = {('ours shm', _LIGHT): 0.6, ('thread shm', _LIGHT): 0.6}


def compare(
    size: str, qos: str, subscribers: int, medians: dict[str, Result], copy: float,
) -> list[Figure]:
    """
    Return the figures of a load.

    :param size: size and rate of the frames.
    :param qos: ``reliable`` or ``best_effort``.
    :param subscribers: number of subscribers.
    :param medians: result of each way.
    :param copy: ms of one memcpy.
    """
    case = f'{size} x{subscribers}'
    figures = []
    for name, result in medians.items():
        values = {
            'delivered': (result.delivered, '%'), 'age p50': (result.p50, 'ms'),
            'age p99': (result.p99, 'ms'), 'age p99 - p50': (result.p99 - result.p50, 'ms'),
            'age p50 to memcpy': (result.p50 / copy, 'x'), 'CPU': (result.cpu, 'ms/frame')}
        if result.growth:
            values[_MEMORY] = result.growth, 'MB'
        other = _REFERENCES.get(name, 'tutorial')
        # The few frames of the tutorial that arrive with best effort are the fast ones.
        if other in medians and other != name and qos == 'reliable':
            reference = medians[other]
            if result.node_cpu and reference.node_cpu:
                values[f"CPU of the node, {other}'s to it"] = (
                    reference.node_cpu / result.node_cpu, 'x')
                values[f"age without the flip, {other}'s to it"] = (
                    (reference.p50 - reference.filter_cpu) / (result.p50 - result.filter_cpu), 'x')
            values |= {
                f"age p50, {other}'s to it": (reference.p50 / result.p50, 'x'),
                f"age p99, {other}'s to it": (reference.p99 / result.p99, 'x'),
                f"CPU, {other}'s to it": (reference.cpu / result.cpu, 'x')}
        everywhere = _EVERYWHERE if name.startswith(('ours', 'thread')) else {}
        goals = everywhere | _GOALS.get((name, case), {})
        figures += [_figure(f'{case} {qos.replace("_", " ")}, {name}: {title}', value, unit,
                            goals.get(title)) for title, (value, unit) in values.items()
                    if title in goals or title in _WITHOUT_GOAL]
    return figures


def compare_counts(size: str, qos: str, medians: dict[int, dict[str, Result]]) -> list[Figure]:
    """Return the CPU time of a further subscriber for each way; medians by their number."""
    least, most = min(medians), max(medians)
    return [
        _figure(f'{size} {qos.replace("_", " ")}, {name}: CPU of a further subscriber',
                (medians[most][name].cpu - medians[least][name].cpu) / (most - least), 'ms/frame',
                _FURTHER_CPU.get((name, size)))
        for name in medians[least] if name in medians[most] and most > least]


def _figure(name: str, value: float, unit: str, limit: float | None) -> Figure:
    is_least = 'delivered' in name or "'s to it" in name
    if limit is None:
        return Figure('transport', name, value, unit)
    goal = f'at {"least" if is_least else "most"} {limit:g}'
    return Figure('transport', name, value, unit, goal,
                  value >= limit if is_least else value <= limit)
