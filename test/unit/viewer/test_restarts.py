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

"""Restarts of cameras, without a node."""

from __future__ import annotations

from opencv_tools.base.units import NANO
from opencv_tools.viewer.streams.feed import Restarts
import pytest

TOPIC = '/front'
BOTH = {b'old': TOPIC, b'new': TOPIC}


class Cameras:
    """Publishers that send a frame each tenth of a second, and a graph."""

    def __init__(self) -> None:
        self.now = 50.0
        self.restarts = Restarts(lambda: self.now)

    def send(self, seconds: float, *senders: bytes, graph: dict[bytes, str]) -> None:
        """Send for some time; the graph is read at its end."""
        for _ in range(round(seconds * 10)):
            self.now += 0.1
            for sender in senders:
                self.restarts.add(sender, round(self.now * NANO))
        self.restarts.check(graph)


def test_first_publisher_is_no_restart() -> None:
    cameras = Cameras()
    for _ in range(5):
        cameras.send(1, b'old', graph={b'old': TOPIC})
    assert cameras.restarts.seconds is None


def test_publisher_that_ended_before_the_new_one_began() -> None:
    cameras = Cameras()
    cameras.send(2, b'old', graph={b'old': TOPIC})
    cameras.send(50, graph={})
    cameras.send(1, b'new', graph={b'new': TOPIC})
    assert cameras.restarts.seconds == pytest.approx(0.9)
    cameras.send(90, b'new', graph={b'new': TOPIC})
    assert cameras.restarts.seconds == pytest.approx(90.9)


def test_killed_publisher_that_the_graph_still_has() -> None:
    cameras = Cameras()
    cameras.send(2, b'old', graph={b'old': TOPIC})
    cameras.send(1, b'new', graph=BOTH)
    assert cameras.restarts.seconds is None  # the other one may go on
    cameras.send(3, b'new', graph=BOTH)
    assert cameras.restarts.seconds == pytest.approx(3.9)
    cameras.send(1, b'new', graph={b'new': TOPIC})
    assert cameras.restarts.seconds == pytest.approx(4.9)


def test_publisher_that_joins_is_no_restart() -> None:
    cameras = Cameras()
    cameras.send(2, b'old', graph={b'old': TOPIC})
    for _ in range(5):
        cameras.send(1, b'old', b'new', graph=BOTH)
    for _ in range(5):  # the first one ends
        cameras.send(1, b'new', graph={b'new': TOPIC})
    assert cameras.restarts.seconds is None


def test_two_publishers_of_which_one_starts_again() -> None:
    cameras = Cameras()
    for _ in range(3):
        cameras.send(1, b'old', b'other', graph={b'old': TOPIC, b'other': TOPIC})
    for _ in range(3):
        cameras.send(1, b'new', b'other', graph={b'new': TOPIC, b'other': TOPIC})
    assert cameras.restarts.seconds == pytest.approx(2.9)


def test_another_transport_of_the_same_camera() -> None:
    cameras = Cameras()
    graph = {b'raw': TOPIC, b'jpeg': f'{TOPIC}/compressed'}
    cameras.send(2, b'raw', graph=graph)
    for _ in range(9):
        cameras.send(1, b'jpeg', graph=graph)
    assert cameras.restarts.seconds is None


def test_transport_that_the_same_camera_gives_up() -> None:
    cameras = Cameras()
    graph = {b'raw': TOPIC, b'jpeg': f'{TOPIC}/compressed'}
    for _ in range(2):
        cameras.send(1, b'jpeg', graph=graph)
    del graph[b'jpeg']
    for _ in range(9):
        cameras.send(1, b'raw', graph=graph)
    assert cameras.restarts.seconds is None


def test_slow_and_latched_publishers_that_another_one_joins() -> None:
    cameras = Cameras()
    cameras.restarts.add(b'old', 0)
    cameras.send(5, graph=BOTH)
    cameras.restarts.add(b'old', 5 * NANO)
    for _ in range(10):
        cameras.send(1, b'new', graph=BOTH)
    cameras.restarts.add(b'old', 15 * NANO)
    assert cameras.restarts.seconds is None
    cameras = Cameras()
    cameras.restarts.add(b'old', 0)
    for _ in range(9):
        cameras.send(1, b'new', graph=BOTH)
    assert cameras.restarts.seconds is None


def test_publisher_that_ends_long_after_another_one_joined() -> None:
    cameras = Cameras()
    cameras.restarts.add(b'old', 0)
    for _ in range(70):
        cameras.send(1, b'new', graph=BOTH)
    cameras.send(1, b'new', graph={b'new': TOPIC})
    assert cameras.restarts.seconds is None


@pytest.mark.parametrize('publisher', [b'', b'old'])
def test_stamps_that_begin_again(publisher: bytes) -> None:
    cameras = Cameras()
    for stamp in (100, 101, 109, 108.5, 300, 200):  # disorder, and a clock that was set
        cameras.restarts.add(publisher, round(stamp * NANO))
    assert cameras.restarts.seconds is None
    cameras.restarts.add(publisher, 100 * NANO)
    assert cameras.restarts.seconds == 0


def test_many_publishers_need_little_memory() -> None:
    cameras = Cameras()
    for number in range(1000):
        cameras.restarts.add(number.to_bytes(16, 'big'), 0)
        cameras.restarts.check({})
    assert cameras.restarts.seconds is None
    assert len(cameras.restarts._senders) <= 32
