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

"""Count of lost messages by their numbers, and whether it is complete."""

from __future__ import annotations

from collections.abc import Sequence

from opencv_tools.ros.subscriber.lost_frames import LostFrames
from opencv_tools.ros.zero_copy import MessageInfo
import pytest


@pytest.mark.parametrize(('discovered', 'messages', 'lost', 'is_complete'), [
    (10.0, [(1, 10.0), (2, 10.1), (5, 10.4)], 2, True),
    (0.1, [(1, 0.2), (2, 0.3)], 0, True),
    (10.0, [(3, 10.2), (4, 10.3)], 2, True),
    (10.0, [(3, 10.2), (6, 10.5)], 4, True),
    (10.0, [(3, 10.2), (2, 10.3), (4, 10.4)], 2, True),
    (10.0, [(3, 10.2)], 0, False),  # its rate is unknown
    (10.0, [(1000, 10.2), (1001, 10.3), (1003, 10.5)], 1, False),  # it started before
    (0.1, [(3, 0.3), (4, 0.4)], 0, False),  # it may have started before
    (None, [(3, 0.3), (4, 0.4), (6, 0.6)], 1, False)])
def test_count_from_the_first_message(
        discovered: float | None, messages: Sequence[tuple[int, float]], lost: int,
        is_complete: bool) -> None:
    now = 0.0
    losses = LostFrames(lambda: now)
    publisher = bytes(range(16))
    if discovered is not None:
        now = discovered
        losses.discover([publisher])
    for number, now in messages:
        info = MessageInfo(publication_sequence_number=number,
                           source_timestamp=5_000_000_000 + int(now * 1e9))
        info.publisher[:] = publisher
        losses.add(info)
    assert (losses.count, losses.is_complete) == (lost, is_complete)


def test_messages_without_numbers() -> None:
    losses = LostFrames()
    for _ in range(3):
        losses.add(MessageInfo(publication_sequence_number=2**64 - 1))
    assert (losses.count, losses.is_complete) == (0, False)


def test_messages_that_arrived_without_their_number() -> None:
    losses = LostFrames()
    for number, unnumbered, lost in ((1, 0, 0), (3, 1, 0), (4, 0, 0), (7, 1, 1), (9, 0, 2)):
        for _ in range(unnumbered):
            losses.add_unnumbered()
        losses.add(MessageInfo(publication_sequence_number=number, source_timestamp=number))
        assert losses.count == lost
