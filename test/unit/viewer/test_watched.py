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

"""Sources that end after their last user, and calls from other threads."""

from __future__ import annotations

import asyncio
from collections.abc import Callable

from opencv_tools.viewer.watched import in_loop, Watched
import pytest
from waiting import due

Watcher = Callable[[], object]


class Source(Watched[Watcher]):
    """A source that counts its ends."""

    def __init__(self) -> None:
        super().__init__()
        self.ends = 0
        self.on_unused = self._end_all

    def _end_all(self) -> None:
        self.ends += 1


def test_source_ends_after_its_last_user(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Watched, 'unused_seconds', 0.0)

    async def work() -> None:
        source = Source()
        source.acquire()
        source.join(print)
        assert source.watchers == {print}
        for _ in range(2):
            source.leave(print)
        await due()
        assert (source.watchers, source.users, source.ends) == (set(), 1, 0)
        source.release()
        source.acquire()  # a page was loaded again
        await due()
        assert source.ends == 0
        source.release()
        await due()
        assert source.ends == 1

    asyncio.run(work())


def test_calls_from_another_thread() -> None:
    numbers: list[int] = []

    async def work() -> Callable[..., None]:
        call = in_loop(numbers.append)
        await asyncio.to_thread(call, 1)
        await due()
        return call

    asyncio.run(work())(2)  # the loop is closed
    assert numbers == [1]
