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
from collections.abc import Sequence

from hypothesis import given, settings, strategies
from opencv_tools.image.errors import CdrError
from opencv_tools.topics.order import FrameOrder, Position, Way
import pytest
from stepped_clock import SteppedClock

PUBLISHER, OTHER = bytes(range(16)), bytes(16)
SECOND = 10**9


def test_place_of_a_message() -> None:
    assert Position(3) == (3, 0, True)


@pytest.mark.parametrize(('discovered', 'messages', 'lost', 'is_complete'), [
    (10.0, [(1, 10.0), (2, 10.1), (5, 10.4)], 2, True),
    (0.1, [(1, 0.2), (2, 0.3)], 0, True),
    (10.0, [(3, 10.2), (4, 10.3)], 2, True),
    (10.0, [(3, 10.2), (6, 10.5)], 4, True),
    (10.0, [(3, 10.2)], 0, False),  # its rate is unknown
    (10.0, [(1000, 10.2), (1001, 10.2001), (1002, 10.3), (1003, 10.4)], 0, False),
    (10.0, [(1000, 10.2), (1001, 10.3), (1003, 10.5)], 1, False),  # it started before
    (0.1, [(3, 0.3), (4, 0.4)], 0, False),  # it may have started before
    (None, [(3, 0.3), (4, 0.4), (6, 0.6)], 1, False)])
@pytest.mark.parametrize('are_shared', [False, True])
def test_count_from_the_first_frame(
        discovered: float | None, messages: Sequence[tuple[int, float]], lost: int,
        is_complete: bool, are_shared: bool) -> None:
    now = 0.0
    order = FrameOrder(lambda: now)
    if discovered is not None:
        now = discovered
        order.discover([PUBLISHER])
    if are_shared:
        order.change(PUBLISHER, Way.SHARED)
    for number, now in messages:
        position = Position(0, number, False) if are_shared else Position(number)
        assert order.accepts(PUBLISHER, position, 5_000_000_000 + int(now * 1e9))
    assert (order.count, order.is_complete) == (lost, is_complete)


@pytest.mark.parametrize(('messages', 'frames', 'lost', 'is_complete'), [
    (3, 3, 3, True), (3, 8, 8, True), (3, 108_000, 0, False)])
def test_frames_before_the_first_message_that_are_learned_later(
        messages: int, frames: int, lost: int, is_complete: bool) -> None:
    now = 0.0
    order = FrameOrder(lambda: now)
    now = 2.7
    order.discover([PUBLISHER])
    for number, now in ((4, 3.0), (5, 3.1), (6, 3.2)):
        assert order.accepts(PUBLISHER, Position(number), int(now * 1e9))
    assert (order.count, order.is_complete) == (3, True)
    order.learn(PUBLISHER, messages, frames)
    assert (order.count, order.is_complete) == (lost, is_complete)
    assert order.accepts(PUBLISHER, Position(8), int(3.4e9))
    assert order.count == lost + 1


def accepts(order: FrameOrder, *messages: int, publisher: bytes = PUBLISHER) -> list[int]:
    """Return the accepted ones of messages that follow each other by a second."""
    return [number for number in messages
            if order.accepts(publisher, Position(number), (number + 1) * SECOND)]


@pytest.mark.parametrize(('seconds', 'is_new'), [(1.999, False), (2.0, True)])
def test_discovery_of_a_new_publisher(seconds: float, is_new: bool) -> None:
    clock = SteppedClock()
    order = FrameOrder(clock.monotonic)
    clock.now += seconds
    order.discover([OTHER, PUBLISHER])
    clock.now += 9
    order.discover([PUBLISHER])  # again, which changes nothing
    assert accepts(order, 3, 4) == [3, 4]
    assert (order.count, order.is_complete) == (2 * is_new, is_new)


def test_publisher_that_is_discovered_with_its_frame() -> None:
    clock = SteppedClock()
    order = FrameOrder(clock.monotonic)
    clock.now += 1.999
    accepts(order, 3, 4)
    clock.now += 0.001
    accepts(order, 2, 3, publisher=OTHER)
    assert order.count == 1  # of the second publisher
    assert not order.is_complete


@pytest.mark.parametrize(('period', 'is_new'), [(2.0, True), (2.001, False)])
def test_longest_time_of_the_frames_before_the_first(period: float, is_new: bool) -> None:
    clock = SteppedClock()
    order = FrameOrder(clock.monotonic)
    clock.now += 4
    for number in (3, 4):  # the first one was published 2 periods before
        assert order.accepts(PUBLISHER, Position(number), SECOND + round(number * period * SECOND))
    assert (order.count, order.is_complete) == (2 * is_new, is_new)


def test_publisher_from_before_a_restart() -> None:
    clock = SteppedClock()
    order = FrameOrder(clock.monotonic)
    clock.now += 10
    order.discover([PUBLISHER])
    order.restart()
    clock.now += 10
    order.discover([OTHER])
    accepts(order, 2, 3)
    assert (order.count, order.is_complete) == (0, False)
    accepts(order, 12, 13, publisher=OTHER)
    assert order.count == 0  # began up to a second before the restart
    clock.now += 10
    accepts(order, 11, 12, publisher=b'third')
    assert order.count == 10


@pytest.mark.parametrize(('step', 'is_measured'), [(30, True), (31, False)])
def test_most_frames_that_measure_the_rate(step: int, is_measured: bool) -> None:
    clock = SteppedClock()
    order = FrameOrder(clock.monotonic)
    clock.now += 10
    order.accepts(PUBLISHER, Position(1000), SECOND)
    order.accepts(PUBLISHER, Position(1000 + step), SECOND + step)  # a nanosecond a frame
    assert order.is_complete is is_measured
    assert order.count == step - 1 + 999 * is_measured


@pytest.mark.parametrize('unknown', [1, 2])
def test_unknown_time_of_publication(unknown: int) -> None:
    clock = SteppedClock()
    order = FrameOrder(clock.monotonic)
    clock.now += 10
    for number in range(3):  # the others are a nanosecond apart
        order.accepts(PUBLISHER, Position(1000 + number),
                      0 if number == unknown else SECOND + number)
    assert (order.count, order.is_complete) == (999, True)


def test_time_of_publication_that_is_always_unknown() -> None:
    clock = SteppedClock()
    order = FrameOrder(clock.monotonic)
    clock.now += 10
    for number in (1000, 1001):
        order.accepts(PUBLISHER, Position(number), 0)
    assert (order.count, order.is_complete) == (0, False)


@pytest.mark.parametrize('is_shared', [False, True])
def test_greatest_step_of_the_numbers(is_shared: bool) -> None:
    order = FrameOrder()
    order.change(PUBLISHER, Way.SHARED if is_shared else Way.TOPIC)

    def position(number: int) -> Position:
        return Position(0, number, False) if is_shared else Position(number)

    assert order.accepts(PUBLISHER, position(5), 0)
    with pytest.raises(CdrError, match=(
            fr'^the number of the frame is {2**32 + 6}, that of the last frame 5$')):
        order.accepts(PUBLISHER, position(5 + 2**32 + 1), 0)
    assert order.accepts(PUBLISHER, position(5 + 2**32), 0)
    assert order.count == 2**32 - 1


@pytest.mark.parametrize('is_shared', [False, True])
def test_greatest_first_number(is_shared: bool) -> None:
    order = FrameOrder()
    order.change(PUBLISHER, Way.SHARED if is_shared else Way.TOPIC)
    last = Position(2**48, 2**48 if is_shared else 0)
    with pytest.raises(CdrError, match=f'is {2**48 + 1}, that of the last frame 0$'):
        order.accepts(PUBLISHER, last._replace(message=2**48 + 1), 0)
    assert order.accepts(PUBLISHER, last, 0)
    assert (order.count, order.accepted) == (0, {PUBLISHER: 1})


def test_frames_that_are_early() -> None:
    order = FrameOrder()
    assert not order.is_early(PUBLISHER, Position(2, 2))  # by the image topic
    order.change(PUBLISHER, Way.JOINING)
    assert accepts(order, 3) == [3]
    early, next_one = Position(5, 9), Position(4, 8)
    assert order.is_early(PUBLISHER, early) and not order.is_early(PUBLISHER, next_one)
    assert not order.is_early(PUBLISHER, Position(5, 9, False))
    assert not order.accepts(PUBLISHER, early, 0)
    assert order.way(PUBLISHER) is Way.JOINING
    order.change(PUBLISHER, Way.JOINING, is_overdue=True)
    assert not order.is_early(PUBLISHER, early)
    order.change(PUBLISHER, Way.JOINING)
    assert order.is_early(PUBLISHER, early)
    order.change(PUBLISHER, Way.JOINING, is_overdue=True)
    assert order.accepts(PUBLISHER, early, 0)
    assert order.way(PUBLISHER) is Way.SHARED


def test_shared_frames_of_the_last_message() -> None:
    order = FrameOrder()
    order.change(PUBLISHER, Way.JOINING)
    assert accepts(order, 3) == [3]
    assert not order.accepts(PUBLISHER, Position(2, 7), 0)  # of an earlier message
    assert order.way(PUBLISHER) is Way.JOINING
    assert not order.accepts(PUBLISHER, Position(3, 8), 0)  # the message that arrived
    assert order.way(PUBLISHER) is Way.SHARED
    assert order.accepts(PUBLISHER, Position(3, 9, False), 0)
    assert order.accepts(PUBLISHER, Position(3, 12, False), 0)
    assert (order.count, order.accepted) == (2, {PUBLISHER: 3})


def test_frames_that_arrive_in_the_other_way() -> None:
    order = FrameOrder()
    assert order.way(PUBLISHER) is Way.TOPIC
    assert not order.accepts(PUBLISHER, Position(1, 1), 0)
    order.change(PUBLISHER, Way.SHARED)
    assert not order.accepts(PUBLISHER, Position(1), 0)
    assert order.accepts(PUBLISHER, Position(1, 1), 0)
    order.change(PUBLISHER, Way.LEAVING)
    assert order.accepts(PUBLISHER, Position(2, 2), 0)
    assert order.way(PUBLISHER) is Way.LEAVING
    assert not order.accepts(PUBLISHER, Position(2), 0)  # repeated, but the last by two ways
    assert order.way(PUBLISHER) is Way.TOPIC
    assert accepts(order, 3) == [3]
    assert (order.count, order.is_complete, order.accepted) == (0, True, {PUBLISHER: 3})


def test_numbers_of_a_liar_that_do_not_increase() -> None:
    order = FrameOrder()
    order.change(PUBLISHER, Way.SHARED)
    assert order.accepts(PUBLISHER, Position(100, 5, False), 5)
    assert order.accepts(PUBLISHER, Position(100, 6, False), 6)
    assert order.count == 0


def test_messages_without_numbers() -> None:
    order = FrameOrder()
    assert all(order.accepts(PUBLISHER, Position(0), 0) for _ in range(3))
    assert (order.count, order.is_complete, order.accepted) == (0, False, {b'': 3})
    assert order.accepts(PUBLISHER, Position(1), 0)
    assert (order.is_complete, order.accepted) == (False, {b'': 3, PUBLISHER: 1})


def test_messages_that_arrived_without_their_number() -> None:
    order = FrameOrder()
    for number, unnumbered, lost in ((1, 0, 0), (3, 1, 0), (4, 0, 0), (7, 1, 1), (9, 0, 2)):
        for _ in range(unnumbered):
            order.add_unnumbered()
        assert order.accepts(PUBLISHER, Position(number), number)
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
        PUBLISHER, Position(number), number)] == [1, 2, 5, 6]
    assert order.count == 2


@pytest.mark.parametrize('position', [
    Position(2**64 - 1), Position(2, 2**64 - 1), Position(2, 2**33 + 1, False)])
def test_numbers_beyond_reason(position: Position) -> None:
    order = FrameOrder()
    order.change(PUBLISHER, Way.SHARED if position.number else Way.TOPIC)
    first = Position(1, 1) if position.number else Position(1)
    assert order.accepts(PUBLISHER, first, 0)
    with pytest.raises(CdrError, match=f'is {max(position)}, that of the last frame 1'):
        order.accepts(PUBLISHER, position, 0)
    assert order.accepts(PUBLISHER, first._replace(
        message=2, number=2 if position.number else 0), 0)
    assert order.count == 0


@pytest.mark.parametrize('is_known_before', [False, True])
def test_frames_before_the_image_topic(is_known_before: bool) -> None:
    order = FrameOrder()
    order.change(PUBLISHER, Way.SHARED)
    for number in range(1, 6):
        assert order.accepts(PUBLISHER, Position(0, number, False), 0)
    order.change(PUBLISHER, Way.TOPIC)  # the shared memory has failed, then 14 frames are lost
    if is_known_before:
        order.learn(PUBLISHER, 0, 19)
    for message in range(1, 4):
        assert order.accepts(PUBLISHER, Position(message), 0)
    order.learn(PUBLISHER, 0, 19)
    assert order.count == 14


@pytest.mark.parametrize(('period', 'is_complete'), [(1.0, True), (2.0, False)])
def test_start_of_a_publisher_that_only_shared_before(period: float, is_complete: bool) -> None:
    now = 0.0
    order = FrameOrder(lambda: now)
    now = 10.0
    order.discover([PUBLISHER])
    assert order.accepts(PUBLISHER, Position(3), 0)
    order.learn(PUBLISHER, 0, 5)  # so that its number is 8
    now += period
    assert order.accepts(PUBLISHER, Position(4), int(period * 1e9))
    assert (order.count, order.is_complete) == (7 if is_complete else 0, is_complete)


def test_subscription_beside_frames_that_others_share() -> None:
    order = FrameOrder()
    order.learn(PUBLISHER, 3, 200)  # an announcement of some time ago
    assert order.accepts(PUBLISHER, Position(4), 0)
    order.learn(PUBLISHER, 3, 230)
    order.change(PUBLISHER, Way.JOINING)
    assert order.accepts(PUBLISHER, Position(5, 232), 0)
    assert (order.count, order.is_complete) == (0, False)
    assert order.accepts(PUBLISHER, Position(5, 234, False), 0)
    assert order.count == 1


def test_announcements_that_are_read_after_the_first_message() -> None:
    order = FrameOrder()
    assert order.accepts(PUBLISHER, Position(1), 0)
    order.learn(PUBLISHER, 0, 13)  # of some time ago
    order.learn(PUBLISHER, 0, 14)  # right before the message
    order.change(PUBLISHER, Way.JOINING)
    assert order.accepts(PUBLISHER, Position(2, 16), 0)
    assert order.accepts(PUBLISHER, Position(2, 17, False), 0)
    assert (order.count, order.is_complete) == (0, False)


def test_announcement_that_is_read_before_earlier_frames() -> None:
    order = FrameOrder()
    order.change(PUBLISHER, Way.JOINING)
    order.learn(PUBLISHER, 0, 9)
    assert order.accepts(PUBLISHER, Position(0, 1, False), 0)
    assert order.count == 0  # nothing is lost until the last frame that arrived
    assert order.accepts(PUBLISHER, Position(0, 3, False), 0)
    assert order.count == 1
    order.change(PUBLISHER, Way.LEAVING)
    assert order.accepts(PUBLISHER, Position(1), 0)  # the announcement numbers it 10
    assert order.count == 7


@pytest.mark.parametrize('first', [1, 2])
def test_announcements_that_are_read_before_the_first_message(first: int) -> None:
    order = FrameOrder()
    for announced in ((0, 13), (0, 14), (2, 16), (3, 20)):
        order.learn(PUBLISHER, *announced)
    assert order.accepts(PUBLISHER, Position(first), 0)
    assert (order.count, order.is_complete) == (0, False)
    assert order.accepts(PUBLISHER, Position(3), 0)
    assert order.count == 2 - first
    assert order.accepts(PUBLISHER, Position(4), 0)  # the last announcement numbers it 21
    assert order.count == 2 - first + 3


def test_first_message_whose_announcement_was_replaced() -> None:
    order = FrameOrder()
    order.learn(PUBLISHER, 0, 13)
    assert order.accepts(PUBLISHER, Position(1), 0)
    order.change(PUBLISHER, Way.JOINING)
    assert order.accepts(PUBLISHER, Position(2, 16), 0)
    assert (order.count, order.is_complete) == (0, False)


def test_shared_frame_after_the_first_message() -> None:
    order = FrameOrder()
    assert accepts(order, 1) == [1]
    order.change(PUBLISHER, Way.JOINING)
    assert order.accepts(PUBLISHER, Position(1, 14, False), 0)
    assert (order.count, order.is_complete) == (0, False)  # up to 12 frames were shared before


def test_number_of_a_message_that_is_repeated_as_a_shared_one() -> None:
    clock = SteppedClock()
    order = FrameOrder(clock.monotonic)
    clock.now += 10
    assert accepts(order, 5, 6) == [5, 6]
    assert (order.count, order.is_complete) == (4, True)
    order.change(PUBLISHER, Way.JOINING)
    assert not order.accepts(PUBLISHER, Position(6, 10), 0)
    assert (order.count, order.is_complete) == (8, True)  # of 10 frames


def test_repeated_and_late_shared_frames() -> None:
    order = FrameOrder()
    order.change(PUBLISHER, Way.SHARED)
    places = [Position(0, 1, False), Position(0, 2, False), Position(0, 2, False),
              Position(0, 1, False), Position(1, 3), Position(0, 4, False), Position(1, 5, False)]
    assert [place for place in places if order.accepts(PUBLISHER, place, 0)] == [
        places[number] for number in (0, 1, 4, 6)]
    assert order.count == 1


def test_many_announcements_without_frames() -> None:
    order = FrameOrder()
    assert order.accepts(PUBLISHER, Position(1), 0)
    for messages in range(1, 1000):
        order.learn(PUBLISHER, messages, 2 * messages - 1)
    assert len(order._publishers[PUBLISHER]._only_shared._later) == 64
    assert order.accepts(PUBLISHER, Position(1000), 0)
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
    before = order.count, order.is_complete
    assert accepts(order, 1, publisher=publishers[128]) == [1]
    assert (order.count, order.is_complete) == before  # with the frames of the first publisher
    assert [*order.accepted] == publishers[1:]
    assert [order.way(publisher) for publisher in publishers[:2]] == [Way.TOPIC, Way.SHARED]


@pytest.mark.parametrize(('others', 'is_complete'), [(127, False), (128, True)])
def test_most_discoveries_that_are_remembered(others: int, is_complete: bool) -> None:
    clock = SteppedClock()
    order = FrameOrder(clock.monotonic)
    order.discover([PUBLISHER])
    order.discover(number.to_bytes(16, 'big') for number in range(others))
    clock.now += 9
    accepts(order, 3, 4)
    assert order.is_complete is is_complete  # it counts as discovered now


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
        if self.order.accepts(PUBLISHER, position, 0):
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
        assert topic.order.is_complete == (first == 1)


@pytest.mark.quick_cases(1)
@pytest.mark.parametrize('examples', [150, 600])
def test_changes_between_topic_and_memory(examples: int) -> None:
    settings(max_examples=examples)(given(SEQUENCES)(check_changes_between_topic_and_memory))()
