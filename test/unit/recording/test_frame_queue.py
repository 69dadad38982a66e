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

"""The bounded queue of a recorder."""

from __future__ import annotations

from threading import Thread

from opencv_tools.recording.recorder import WriteQueue
from waiting import join


def test_items_are_numbered_in_their_order() -> None:
    queue: WriteQueue[str] = WriteQueue(2, block=False)
    assert queue.put('a') is None
    assert queue.put('b') is None
    assert queue.get() == (0, 'a')
    assert queue.put('c') is None
    queue.close()
    assert [queue.get(), queue.get(), queue.get()] == [(1, 'b'), (2, 'c'), None]


def test_full_queue_returns_the_dropped_item() -> None:
    queue: WriteQueue[str] = WriteQueue(2, block=False)
    assert [queue.put(item) for item in 'abcd'] == [None, None, 'a', 'b']
    assert [queue.get(), queue.get()] == [(0, 'c'), (1, 'd')]


def test_blocked_put_continues_after_a_get() -> None:
    queue: WriteQueue[str] = WriteQueue(1, block=True)
    queue.put('a')
    putting = Thread(target=queue.put, args=['b'], daemon=True)
    putting.start()
    assert queue.get() == (0, 'a')
    join(putting)
    assert not putting.is_alive()
    assert queue.get() == (1, 'b')


def test_close_ends_a_waiting_get() -> None:
    queue: WriteQueue[str] = WriteQueue(1, block=True)
    results: list[tuple[int, str] | None] = []
    getting = Thread(target=lambda: results.append(queue.get()), daemon=True)
    getting.start()
    queue.close()
    join(getting)
    assert results == [None]
