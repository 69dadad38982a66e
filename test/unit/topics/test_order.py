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

"""Order of frames that arrive in two ways, and the count of those that do not arrive."""

from __future__ import annotations

from collections import deque

from hypothesis import given, settings, strategies
from opencv_tools.image.errors import CdrError
from opencv_tools.topics.order import FrameOrder, Position, Way
import pytest

PUBLISHER, OTHER = bytes(range(16)), bytes(16)


def test_place_of_a_message() -> None:
    assert Position(3) == (3, 0, True)


def accepts(order: FrameOrder, *messages: int, publisher: bytes = PUBLISHER) -> list[int]:
    """Return the accepted ones of messages."""
    return [number for number in messages if order.accepts(publisher, Position(number))]


@pytest.mark.parametrize(('numbers', 'before', 'lost'), [
    ([1, 2, 5], 0, 2), ([1], 0, 0), ([3, 4], 2, 0), ([3, 6], 2, 2), ([111, 112, 140], 110, 27)])
@pytest.mark.parametrize('are_shared', [False, True])
def test_count_from_the_first_frame(
        numbers: list[int], before: int, lost: int, are_shared: bool) -> None:
    order = FrameOrder()
    if are_shared:
        order.change(PUBLISHER, Way.SHARED)
    for number in numbers:
        position = Position(0, number, False) if are_shared else Position(number)
        assert order.accepts(PUBLISHER, position)
    assert (order.before, order.count) == (before, lost)
    assert before + len(numbers) + lost == numbers[-1]


@pytest.mark.parametrize(('messages', 'frames', 'before'), [
    (3, 3, 3), (3, 8, 8), (3, 10**8, 10**8)])
def test_frames_before_the_first_message_that_are_learned_later(
        messages: int, frames: int, before: int) -> None:
    order = FrameOrder()
    assert accepts(order, 4, 5, 6) == [4, 5, 6]
    assert (order.before, order.count) == (3, 0)
    order.learn(PUBLISHER, messages, frames)
    assert (order.before, order.count) == (before, 0)
    assert accepts(order, 8) == [8]
    assert (order.before, order.count) == (before, 1)


def test_words_for_what_is_not_counted() -> None:
    order = FrameOrder()
    accepts(order, 1, 2, 4)
    assert order.uncounted('frame') == ''
    accepts(order, 3, publisher=OTHER)
    assert order.uncounted('frame') == ', 2 sent before the first received frame'
    accepts(order, 0, 0, publisher=b'third')
    accepts(order, 6, publisher=b'fourth')
    assert order.uncounted('message') == (
        ', 7 sent before the first received message, 2 without a number')


@pytest.mark.parametrize('is_shared', [False, True])
def test_greatest_step_of_the_numbers(is_shared: bool) -> None:
    order = FrameOrder()
    order.change(PUBLISHER, Way.SHARED if is_shared else Way.TOPIC)

    def position(number: int) -> Position:
        return Position(0, number, False) if is_shared else Position(number)

    assert order.accepts(PUBLISHER, position(5))
    with pytest.raises(CdrError, match=(
            fr'^the number of the frame is {2**32 + 6}, that of the last frame 5$')):
        order.accepts(PUBLISHER, position(5 + 2**32 + 1))
    assert order.accepts(PUBLISHER, position(5 + 2**32))
    assert order.count == 2**32 - 1


@pytest.mark.parametrize('is_shared', [False, True])
def test_greatest_first_number(is_shared: bool) -> None:
    order = FrameOrder()
    order.change(PUBLISHER, Way.SHARED if is_shared else Way.TOPIC)
    last = Position(2**48, 2**48 if is_shared else 0)
    with pytest.raises(CdrError, match=f'is {2**48 + 1}, that of the last frame 0$'):
        order.accepts(PUBLISHER, last._replace(message=2**48 + 1))
    assert order.accepts(PUBLISHER, last)
    assert (order.count, order.accepted) == (0, {PUBLISHER: 1})


def test_frames_that_are_early() -> None:
    order = FrameOrder()
    assert not order.is_early(PUBLISHER, Position(2, 2))  # by the image topic
    order.change(PUBLISHER, Way.JOINING)
    assert accepts(order, 3) == [3]
    early, next_one = Position(5, 9), Position(4, 8)
    assert order.is_early(PUBLISHER, early) and not order.is_early(PUBLISHER, next_one)
    assert not order.is_early(PUBLISHER, Position(5, 9, False))
    assert not order.accepts(PUBLISHER, early)
    assert order.way(PUBLISHER) is Way.JOINING
    order.change(PUBLISHER, Way.JOINING, is_overdue=True)
    assert not order.is_early(PUBLISHER, early)
    order.change(PUBLISHER, Way.JOINING)
    assert order.is_early(PUBLISHER, early)
    order.change(PUBLISHER, Way.JOINING, is_overdue=True)
    assert order.accepts(PUBLISHER, early)
    assert order.way(PUBLISHER) is Way.SHARED


def test_shared_frames_of_the_last_message() -> None:
    order = FrameOrder()
    order.change(PUBLISHER, Way.JOINING)
    assert accepts(order, 3) == [3]
    assert not order.accepts(PUBLISHER, Position(2, 7))  # of an earlier message
    assert order.way(PUBLISHER) is Way.JOINING
    assert not order.accepts(PUBLISHER, Position(3, 8))  # the message that arrived
    assert order.way(PUBLISHER) is Way.SHARED
    assert order.accepts(PUBLISHER, Position(3, 9, False))
    assert order.accepts(PUBLISHER, Position(3, 12, False))
    assert (order.count, order.accepted) == (2, {PUBLISHER: 3})


def test_frames_that_arrive_in_the_other_way() -> None:
    order = FrameOrder()
    assert order.way(PUBLISHER) is Way.TOPIC
    assert not order.accepts(PUBLISHER, Position(1, 1))
    order.change(PUBLISHER, Way.SHARED)
    assert not order.accepts(PUBLISHER, Position(1))
    assert order.accepts(PUBLISHER, Position(1, 1))
    order.change(PUBLISHER, Way.LEAVING)
    assert order.accepts(PUBLISHER, Position(2, 2))
    assert order.way(PUBLISHER) is Way.LEAVING
    assert not order.accepts(PUBLISHER, Position(2))  # repeated, but the last by two ways
    assert order.way(PUBLISHER) is Way.TOPIC
    assert accepts(order, 3) == [3]
    assert (order.count, order.before, order.accepted) == (0, 0, {PUBLISHER: 3})


def test_numbers_of_a_liar_that_do_not_increase() -> None:
    order = FrameOrder()
    order.change(PUBLISHER, Way.SHARED)
    assert order.accepts(PUBLISHER, Position(100, 5, False))
    assert order.accepts(PUBLISHER, Position(100, 6, False))
    assert order.count == 0


def test_messages_without_numbers() -> None:
    order = FrameOrder()
    assert all(order.accepts(PUBLISHER, Position(0)) for _ in range(3))
    assert (order.count, order.before, order.accepted) == (0, 0, {b'': 3})
    assert order.accepts(PUBLISHER, Position(1))
    assert (order.before, order.accepted) == (0, {b'': 3, PUBLISHER: 1})


def test_messages_that_arrived_without_their_number() -> None:
    order = FrameOrder()
    for number, unnumbered, lost in ((1, 0, 0), (3, 1, 0), (4, 0, 0), (7, 1, 1), (9, 0, 2)):
        for _ in range(unnumbered):
            order.add_unnumbered()
        assert order.accepts(PUBLISHER, Position(number))
        assert order.count == lost


def test_message_without_a_number_before_a_later_gap() -> None:
    order = FrameOrder()
    accepts(order, 1, 3)
    order.add_unnumbered()
    for number in (4, 6):  # the gap is before 6
        accepts(order, number)
        assert order.count == 1
    accepts(order, 8)
    assert order.count == 2


def test_repeated_and_late_messages() -> None:
    order = FrameOrder()
    numbers = [1, 2, 2, 5, 3, 4, 5, 6]
    assert [number for number in numbers if order.accepts(
        PUBLISHER, Position(number))] == [1, 2, 5, 6]
    assert order.count == 2


@pytest.mark.parametrize('position', [
    Position(2**64 - 1), Position(2, 2**64 - 1), Position(2, 2**33 + 1, False)])
def test_numbers_beyond_reason(position: Position) -> None:
    order = FrameOrder()
    order.change(PUBLISHER, Way.SHARED if position.number else Way.TOPIC)
    first = Position(1, 1) if position.number else Position(1)
    assert order.accepts(PUBLISHER, first)
    with pytest.raises(CdrError, match=f'is {max(position)}, that of the last frame 1'):
        order.accepts(PUBLISHER, position)
    assert order.accepts(PUBLISHER, first._replace(
        message=2, number=2 if position.number else 0))
    assert order.count == 0


@pytest.mark.parametrize('is_known_before', [False, True])
def test_frames_before_the_image_topic(is_known_before: bool) -> None:
    order = FrameOrder()
    order.change(PUBLISHER, Way.SHARED)
    for number in range(1, 6):
        assert order.accepts(PUBLISHER, Position(0, number, False))
    order.change(PUBLISHER, Way.TOPIC)  # the shared memory has failed, then 14 frames are lost
    if is_known_before:
        order.learn(PUBLISHER, 0, 19)
    for message in range(1, 4):
        assert order.accepts(PUBLISHER, Position(message))
    order.learn(PUBLISHER, 0, 19)
    assert order.count == 14


def test_subscription_beside_frames_that_others_share() -> None:
    order = FrameOrder()
    order.learn(PUBLISHER, 3, 200)  # an announcement of some time ago
    assert order.accepts(PUBLISHER, Position(4))
    order.learn(PUBLISHER, 3, 230)
    order.change(PUBLISHER, Way.JOINING)
    assert order.accepts(PUBLISHER, Position(5, 232))
    assert (order.count, order.before) == (0, 230)
    assert order.accepts(PUBLISHER, Position(5, 234, False))
    assert order.count == 1


def test_announcements_that_are_read_after_the_first_message() -> None:
    order = FrameOrder()
    assert order.accepts(PUBLISHER, Position(1))
    order.learn(PUBLISHER, 0, 13)  # of some time ago
    order.learn(PUBLISHER, 0, 14)  # right before the message
    order.change(PUBLISHER, Way.JOINING)
    assert order.accepts(PUBLISHER, Position(2, 16))
    assert order.accepts(PUBLISHER, Position(2, 17, False))
    assert (order.count, order.before) == (0, 14)


def test_announcement_that_is_read_before_earlier_frames() -> None:
    order = FrameOrder()
    order.change(PUBLISHER, Way.JOINING)
    order.learn(PUBLISHER, 0, 9)
    assert order.accepts(PUBLISHER, Position(0, 1, False))
    assert order.count == 0  # nothing is lost until the last frame that arrived
    assert order.accepts(PUBLISHER, Position(0, 3, False))
    assert order.count == 1
    order.change(PUBLISHER, Way.LEAVING)
    assert order.accepts(PUBLISHER, Position(1))  # the announcement numbers it 10
    assert order.count == 7


@pytest.mark.parametrize('first', [1, 2])
def test_announcements_that_are_read_before_the_first_message(first: int) -> None:
    order = FrameOrder()
    for announced in ((0, 13), (0, 14), (2, 16), (3, 20)):
        order.learn(PUBLISHER, *announced)
    assert order.accepts(PUBLISHER, Position(first))
    assert (order.count, order.before) == (0, 13 + first)
    assert order.accepts(PUBLISHER, Position(3))
    assert order.count == 2 - first
    assert order.accepts(PUBLISHER, Position(4))  # the last announcement numbers it 21
    assert order.count == 2 - first + 3


def test_first_message_whose_announcement_was_replaced() -> None:
    order = FrameOrder()
    order.learn(PUBLISHER, 0, 13)
    assert order.accepts(PUBLISHER, Position(1))
    order.change(PUBLISHER, Way.JOINING)
    assert order.accepts(PUBLISHER, Position(2, 16))
    assert (order.count, order.before) == (0, 14)


def test_shared_frame_after_the_first_message() -> None:
    order = FrameOrder()
    assert accepts(order, 1) == [1]
    order.change(PUBLISHER, Way.JOINING)
    assert order.accepts(PUBLISHER, Position(1, 14, False))
    assert (order.count, order.before) == (0, 12)


def test_number_of_a_message_that_is_repeated_as_a_shared_one() -> None:
    order = FrameOrder()
    assert accepts(order, 5, 6) == [5, 6]
    assert (order.count, order.before) == (0, 4)
    order.change(PUBLISHER, Way.JOINING)
    assert not order.accepts(PUBLISHER, Position(6, 10))
    assert (order.count, order.before) == (0, 8)  # of 10 frames


def test_repeated_and_late_shared_frames() -> None:
    order = FrameOrder()
    order.change(PUBLISHER, Way.SHARED)
    places = [Position(0, 1, False), Position(0, 2, False), Position(0, 2, False),
              Position(0, 1, False), Position(1, 3), Position(0, 4, False), Position(1, 5, False)]
    assert [place for place in places if order.accepts(PUBLISHER, place)] == [
        places[number] for number in (0, 1, 4, 6)]
    assert order.count == 1


def test_many_announcements_without_frames() -> None:
    order = FrameOrder()
    assert order.accepts(PUBLISHER, Position(1))
    for messages in range(1, 1000):
        order.learn(PUBLISHER, messages, 2 * messages - 1)
    assert len(order._publishers[PUBLISHER]._only_shared._later) == 64
    assert order.accepts(PUBLISHER, Position(1000))
    assert order.count == 1000 + 998 - 2


@pytest.mark.parametrize('first', [1, 2])
def test_most_publishers_that_are_remembered(first: int) -> None:
    order = FrameOrder()
    publishers = [number.to_bytes(16, 'big') for number in range(129)]
    for publisher in publishers[:128]:
        assert accepts(order, first, 3, publisher=publisher) == [first, 3]
        first = 1
    order.change(publishers[0], Way.SHARED)
    order.change(publishers[1], Way.SHARED)
    before = order.count, order.before
    assert accepts(order, 1, publisher=publishers[128]) == [1]
    assert (order.count, order.before) == before  # with the frames of the first publisher
    assert [*order.accepted] == publishers[1:]
    assert [order.way(publisher) for publisher in publishers[:2]] == [Way.TOPIC, Way.SHARED]


class Topic:
    """A publisher and a subscription, with frames on their way by both ways."""

    def __init__(self) -> None:
        self.order = FrameOrder()
        self.order.change(PUBLISHER, Way.TOPIC)
        self.passed: list[int] = []
        self.frames = self._messages = 0
        self._is_matched = False  # the publisher has found the subscription to the image topic
        self._is_found = False  # the subscription has found the publisher
        self._has_others = False
        self._is_open = False
        self._memory: deque[tuple[Position, int]] = deque()
        self._topic: deque[tuple[Position, int]] = deque()
        self._announced = 0  # frames that were only shared
        self._announcements: deque[tuple[int, int]] = deque()
        self._unlearned: tuple[int, int] | None = None

    def publish(self) -> None:
        """Publish a frame in the ways that have subscribers, by shared memory first."""
        is_message = self._is_matched or self._has_others
        self.frames += 1
        if self._is_open:
            self._memory.append((
                Position(self._messages + is_message, self.frames, is_message), self.frames))
        if is_message and self.frames - 1 - self._messages != self._announced:
            self._announce(self.frames - 1)
        self._messages += is_message
        if self._is_matched and self._is_subscribed:
            self._topic.append((Position(self._messages), self.frames))

    def announce(self) -> None:
        """Announce the number of frames until now, as without room in the shared memory."""
        self._announce(self.frames)

    def learn(self) -> None:
        """Read an announcement; the last one is learned when the publisher is found."""
        if self._announcements:
            self._unlearned = self._announcements.popleft()
            if self._is_found:
                self.find()

    def match(self) -> None:
        """Have the publisher find or lose the subscription to the image topic."""
        self._is_matched = self._is_subscribed

    def find(self) -> None:
        """Find the publisher."""
        self._is_found = True
        if self._unlearned:
            self.order.learn(PUBLISHER, *self._unlearned)
            self._unlearned = None

    def lose(self) -> None:
        """Publish a frame that finds no room in the shared memory."""
        is_open, self._is_open = self._is_open, False
        self.publish()
        self._is_open = is_open

    def receive_message(self) -> None:
        """Take a message of the image topic, after the shared frames that may precede it."""
        if self._topic:
            if self._way is Way.LEAVING:
                while self._memory:
                    self.receive_shared()
            self._receive(*self._topic.popleft())
        self._adapt()

    def receive_shared(self) -> None:
        """Receive a shared frame."""
        if self._memory:
            self._receive(*self._memory.popleft())

    def join(self) -> None:
        """Open the shared memory."""
        if self._is_found and not self._is_open and self._way is Way.TOPIC:
            self._is_open = True
            self._memory.clear()
            self.order.change(PUBLISHER, Way.JOINING)

    def stop_joining(self) -> None:
        """Give up the messages that are missing, as nothing waits on the image topic."""
        if self._way is Way.JOINING and not self._topic:
            self.order.change(PUBLISHER, Way.JOINING, is_overdue=True)

    def leave(self) -> None:
        """Return to the image topic."""
        if self._way is Way.SHARED:
            self.order.change(PUBLISHER, Way.LEAVING)
        self._adapt()

    def fail(self) -> None:
        """Lose the shared memory."""
        self._is_open = False
        self._memory.clear()
        self.order.change(PUBLISHER, Way.TOPIC)
        self._adapt()

    def others(self) -> None:
        """Let other subscriptions to the image topic come or go."""
        self._has_others = not self._has_others

    def end(self) -> None:
        """Receive all."""
        self.find()
        while self._announcements:
            self.learn()
        while self._memory or self._topic:
            self.receive_shared()
            self.receive_message()

    @property
    def _way(self) -> Way:
        return self.order.way(PUBLISHER)

    @property
    def _is_subscribed(self) -> bool:
        return self._way is not Way.SHARED

    def _announce(self, frames: int) -> None:
        self._announced = frames - self._messages
        self._announcements.append((self._messages, frames))

    def _adapt(self) -> None:
        if not self._is_subscribed:
            self._topic.clear()  # all of them are repeated
        if self._way is Way.TOPIC:
            self._is_open = False
            self._memory.clear()

    def _receive(self, position: Position, number: int) -> None:
        if self.order.accepts(PUBLISHER, position):
            self.passed.append(number)


ACTIONS = ('publish', 'receive_message', 'receive_shared', 'find', 'join', 'match', 'lose',
           'stop_joining', 'leave', 'fail', 'others', 'announce', 'learn')
OFTEN = ('publish', 'publish', 'find', 'join', 'lose', 'announce')
#: Sequences of a part of the actions, because each action prevents what others would reach.
SEQUENCES = strategies.lists(strategies.sampled_from(ACTIONS), min_size=3, max_size=20).flatmap(
    lambda some: strategies.lists(
        strategies.sampled_from([*OFTEN, *some]), min_size=10, max_size=40))


def check_changes_between_topic_and_memory(actions: list[str]) -> None:
    topic = Topic()
    for action in actions:
        getattr(topic, action)()
    topic.end()
    assert topic.passed == sorted(set(topic.passed))  # in order, none twice
    if topic.passed:
        first, last = topic.passed[0], topic.passed[-1]
        assert topic.order.count == last - first + 1 - len(topic.passed)
        assert topic.order.before == first - 1


@pytest.mark.quick_cases(1)
@pytest.mark.parametrize('examples', [150, 600])
def test_changes_between_topic_and_memory(examples: int) -> None:
    settings(max_examples=examples)(given(SEQUENCES)(check_changes_between_topic_and_memory))()
