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

"""Messages of the live robot that wait for the server."""

from __future__ import annotations

from opencv_tools.viewer.robot_topics import (
    DESCRIPTION, Inbox, MAX_BYTES, missing_publishers, RobotState, STATES)


def test_newest_messages_within_the_limit() -> None:
    announced: list[int] = []
    inbox = Inbox(lambda: announced.append(1))
    half = MAX_BYTES[STATES] // 2
    for number in range(4):
        inbox.put(STATES, bytes([number]) * half)
    assert [message[0] for message in inbox.take(STATES)] == [2, 3]
    assert inbox.take(STATES) == []
    assert announced == [1]
    inbox.begin()
    for number in range(1000):
        inbox.put(STATES, bytes([number % 256]))
    assert [message[0] for message in inbox.take(STATES)] == [
        number % 256 for number in range(1000 - 64, 1000)]
    assert announced == [1, 1]


def test_only_the_newest_description_is_kept() -> None:
    inbox = Inbox(lambda: None)
    for text in (b'a', b'b', bytes(MAX_BYTES[DESCRIPTION] + 1)):
        inbox.put(DESCRIPTION, text)
    assert inbox.take(DESCRIPTION) == [b'b']
    assert inbox.refusals() == ['A message of robot_description has 4000001 bytes and is left '
                                'out: 4000000 are the limit.']
    inbox.put(DESCRIPTION, b'c')
    assert inbox.refusals() == []


def test_sentences_about_publishers() -> None:
    def notes(*publishers: int, is_read: bool = True, is_moving: bool = True) -> list[str]:
        return missing_publishers(
            RobotState(publishers=(publishers[0], publishers[1])), is_read, is_moving)

    assert notes(1, 1) == notes(1, 0) == []
    assert notes(0, 0) == ['No publisher on /robot_description.']
    assert notes(1, 0, is_moving=False) == ['No publisher on /joint_states.']
    assert notes(2, 1)[0].startswith('2 publishers on /robot_description: ')
    assert notes(1, 1, is_read=False) == ['No text on /robot_description yet.']
    for is_read in (False, True):
        assert missing_publishers(RobotState(publishers=(1, 1), is_kept=False), is_read, True) == [
            'No new text on /robot_description: its publisher needs the durability '
            'transient_local.']
