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

"""Frames of a topic, and looks at a feed that is silent."""

from __future__ import annotations

from opencv_tools.image.cdr import WireCompressedImage, WireHeader
from opencv_tools.topics.queue import ReceivedMessage
from opencv_tools.viewer.errors import RequestError
from opencv_tools.viewer.streams.feed import Feed
import pytest

MESSAGE = WireCompressedImage(
    header=WireHeader(1, 2, 'camera'), format='jpeg', data=b'')


class Clock:
    """A clock that a test moves."""

    now = 100.0

    def __call__(self) -> float:
        return self.now


@pytest.fixture
def clock() -> Clock:
    """Return a clock."""
    return Clock()


@pytest.fixture
def feed(clock: Clock) -> Feed:
    """Create a feed that has received frames at 10 Hz."""
    feed = Feed(lambda: None, clock)
    for _ in range(20):
        clock.now += 0.1
        put(feed)
    return feed


def put(feed: Feed) -> None:
    feed.put(ReceivedMessage(MESSAGE, 0, 0))


def test_silent_camera(feed: Feed, clock: Clock) -> None:
    looks = []
    for _ in range(4):
        clock.now += 0.9
        looks.append(feed.look())
    assert looks == [False, False, True, True]
    put(feed)
    assert not feed.look()


def test_executor_that_stood_still(feed: Feed, clock: Clock) -> None:
    for _ in range(5):
        clock.now += 3
        assert not feed.look()  # before the frames that have waited
        put(feed)


def test_topic_without_a_frame(clock: Clock) -> None:
    feed = Feed(lambda: None, clock)
    assert not feed.look()
    clock.now += 0.6
    assert feed.look()


def test_error_of_the_newest_message(feed: Feed, clock: Clock) -> None:
    feed.count_broken(ValueError('cut\n' + 'x' * 1000))
    assert feed.error.startswith('cut\\nx')
    assert (len(feed.error), feed.broken, feed.frames) == (500, 1, 20)
    put(feed)
    assert feed.error == ''


def test_subscription_that_fails(clock: Clock) -> None:
    feed = Feed(lambda: None, clock)
    feed.opened(None)
    assert feed.error == ''
    feed.opened(RequestError('the request has failed'))
    assert feed.error == 'the request has failed'
