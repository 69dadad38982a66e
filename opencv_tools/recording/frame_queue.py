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

"""Bounded queue between the thread that receives frames and the threads that write them."""

from __future__ import annotations

from collections import deque
from threading import Condition
from typing import Generic, TypeVar

T = TypeVar('T')


class FrameQueue(Generic[T]):
    """A bounded queue that drops its oldest item or blocks ``put`` when it is full."""

    def __init__(self, size: int, block: bool) -> None:
        """
        Create an empty queue.

        :param size: maximum number of items.
        :param block: whether ``put`` waits for room; otherwise it drops the oldest item.
        """
        self._size = size
        self._block = block
        self._waiting: deque[T] = deque()
        self._removed = 0
        self._closed = False
        self._changed = Condition()

    @property
    def has_room(self) -> bool:
        """Whether another item would neither drop one nor wait."""
        return len(self._waiting) < self._size

    def put(self, item: T) -> T | None:
        """
        Add an item.

        :returns: the item that was dropped, or None.
        """
        dropped = None
        with self._changed:
            if not self.has_room:
                if self._block:
                    self._changed.wait_for(lambda: self.has_room)
                else:
                    dropped = self._waiting.popleft()
            self._waiting.append(item)
            self._changed.notify_all()
        return dropped

    def get(self) -> tuple[int, T] | None:
        """
        Remove the oldest item, after a wait if the queue is empty.

        :returns: sequence number among all removed items, from 0, and the item; None if the queue
            is closed and empty.
        """
        with self._changed:
            self._changed.wait_for(lambda: self._waiting or self._closed)
            if not self._waiting:
                return None
            sequence = self._removed
            self._removed += 1
            item = self._waiting.popleft()
            self._changed.notify_all()
            return sequence, item

    def close(self) -> None:
        """Close the queue; ``get`` returns the remaining items, then None."""
        with self._changed:
            self._closed = True
            self._changed.notify_all()

    def clear(self) -> list[T]:
        """Remove and return the waiting items."""
        with self._changed:
            items = [*self._waiting]
            self._waiting.clear()
            self._changed.notify_all()
            return items
