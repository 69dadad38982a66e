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

"""Time of reading and writing messages of any type, against the library rosbags."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator, Mapping
import sys
import time
from typing import Any

from figures import add_json_option, Figure, print_figures
import numpy as np
from opencv_tools.message_types.codec import MessageCodec
from opencv_tools.message_types.definition import read_definition
from rosbags.typesys import get_typestore, Stores

RATIO = 1.5  # goal
MESSAGES = 1000
HEADER = {'stamp': {'sec': 1, 'nanosec': 2}, 'frame_id': 'base_link'}
CASES: dict[str, dict[str, Any]] = {
    'sensor_msgs/msg/JointState': {
        'header': HEADER, 'name': [f'joint_{number}' for number in range(7)],
        'position': np.arange(7.0), 'velocity': np.arange(7.0), 'effort': np.arange(7.0)},
    'sensor_msgs/msg/Imu': {'header': HEADER},
    'tf2_msgs/msg/TFMessage': {
        'transforms': 5 * [{'header': HEADER, 'child_frame_id': 'camera'}]}}


def compare(name: str, message: Mapping[str, Any], rounds: int) -> Iterator[Figure]:
    """Yield the time of ours divided by that of rosbags, for a type."""
    store = get_typestore(Stores.ROS2_JAZZY)
    codec = MessageCodec(read_definition(name))
    data = codec.write(message)
    ours, theirs = codec.read(data), store.deserialize_cdr(data, name)
    if codec.write(ours) != data or bytes(store.serialize_cdr(theirs, name)) != data:
        raise SystemExit(f'{name}: other bytes were written')
    yield ratio(f'{name} read', rounds, {
        'ours': lambda: codec.read(data),
        'rosbags': lambda: store.deserialize_cdr(data, name)})
    yield ratio(f'{name} written', rounds, {
        'ours': lambda: codec.write(ours),
        'rosbags': lambda: store.serialize_cdr(theirs, name)})


def ratio(name: str, rounds: int, ways: Mapping[str, Callable[[], object]]) -> Figure:
    """Return the ratio of the shortest times of two ways, which are measured in turns."""
    best = dict.fromkeys(ways, float('inf'))
    for _ in range(rounds):
        for way, convert in ways.items():
            began = time.process_time()
            for _ in range(MESSAGES):
                convert()
            best[way] = min(best[way], time.process_time() - began)
    value = best['ours'] / best['rosbags']
    has_goal = 'JointState' in name
    return Figure('messages', f'{name}: against rosbags', value, 'x',
                  f'at most {RATIO}' if has_goal else '', value <= RATIO if has_goal else None)


def main() -> int:
    """Print the figures; the exit status is 1 when a goal was missed."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--rounds', type=int, default=20, help='number of turns [%(default)s]')
    add_json_option(parser)
    options = parser.parse_args()
    figures = print_figures((figure for name, message in CASES.items()
                             for figure in compare(name, message, options.rounds)), options.json)
    return 1 if any(figure.met is False for figure in figures) else 0


if __name__ == '__main__':
    sys.exit(main())
