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

"""The last frames of the topics that pages show alone, within a number of bytes."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
import itertools
import sys
from threading import Lock
import time

from opencv_tools.image.cdr import WireCompressedImage
from opencv_tools.topics.messages import AnyMessage
from opencv_tools.topics.queue import ReceivedMessage
from opencv_tools.viewer.streams.feed import FeedKey, is_own, NewFrame
from opencv_tools.viewer.watched import UNUSED_SECONDS

#: Time before the newest frame of a topic from which its frames are kept.
KEPT_SECONDS = 10.0
# Frames of the node, because small ones need more memory than their bytes.
_MAX_FRAMES = 10_000


@dataclass(eq=False, kw_only=True)
class KeptFrame:
    """
    A frame that can be shown again.

    :param number: number among the frames of the node, in the order of their arrival.
    :param received: the message as it was received.
    :param size: bytes of the message.
    :param arrived: time of arrival in seconds of the monotonic clock.
    :param is_start: whether it can be shown without earlier ones, unlike most packets of video.
    :param holds: number of paused pages that may show it.
    """

    number: int
    received: ReceivedMessage
    size: int
    arrived: float
    is_start: bool
    holds: int = 0

    @cached_property
    def frame(self) -> NewFrame:
        """
        Return the frame for a channel, whose number is negative, below all numbers of a feed.

        :raises TypeError: the message is video.
        """
        received = self.received
        return NewFrame(-self.number, received.image, received.receive_ns, received.number)

    @property
    def time_ns(self) -> int:
        """Stamp in nanoseconds, or time of reception without a stamp."""
        return self.received.stamp_ns or self.received.receive_ns


@dataclass(frozen=True)
class Hold:
    """
    The frames that a page may show while it is paused.

    :param too_large: bytes of the newest message if it is larger than all that may be kept.
    """

    key: FeedKey
    numbers: tuple[int, ...]
    too_large: int


@dataclass
class _Topic:
    """
    Frames of a topic.

    :param frames: frames by their number, oldest first.
    :param watchers: number of pages that look at live pictures.
    :param too_large: bytes of the newest message if it is larger than all that may be kept.
    """

    frames: dict[int, KeptFrame] = field(default_factory=dict)
    watchers: int = 0
    too_large: int = 0


class History:
    """
    Keep the frames of the topics that somebody watches.

    The executor calls ``add``; all other methods run in the loop of the server.
    """

    def __init__(self, limit: int, clock: Callable[[], float] = time.monotonic) -> None:
        """
        Create an empty history.

        :param limit: maximum number of bytes of all messages; 0 to keep none.
        :param clock: monotonic clock in seconds.
        """
        self.limit = limit
        self._clock = clock
        #: Bytes of all messages that are kept.
        self.size = 0
        self._held_size = 0  # of those that paused pages may show
        self._loop = asyncio.get_running_loop()
        self._lock = Lock()
        self._topics: dict[FeedKey, _Topic] = {}
        self._numbers = itertools.count(1)

    def frames(self, name: str) -> list[ReceivedMessage]:
        """Return the messages of a topic that are kept, oldest first; empty if nobody looks."""
        with self._lock:
            kept = [one for (topic, _), found in self._topics.items() if topic == name
                    for one in found.frames.values()]
        return [one.received for one in from_start(sorted(kept, key=lambda one: one.number))]

    def add(self, key: FeedKey, received: ReceivedMessage, is_start: bool) -> ReceivedMessage:
        """
        Keep a frame if somebody watches its topic.

        :param is_start: as for `KeptFrame`.
        :returns: the message, whose data are a copy if they were in the memory of a publisher.
        """
        topic = self._topics.get(key)
        if topic is None or not topic.watchers:
            return received
        size = message_size(received.message)
        topic.too_large = size if size > self.limit else 0
        if topic.too_large:
            return received
        received = _owned(received)
        with self._lock:
            if self._topics.get(key) is topic:  # nobody has left meanwhile
                kept = KeptFrame(
                    number=next(self._numbers), received=received, size=size,
                    arrived=self._clock(), is_start=is_start)
                self._make_room(topic, kept)
                topic.frames[kept.number] = kept
                self.size += kept.size
        return received

    def watch(self, key: FeedKey) -> None:
        """Keep the frames of a topic from now on."""
        if self.limit:
            with self._lock:
                self._topics.setdefault(key, _Topic()).watchers += 1

    def unwatch(self, key: FeedKey) -> None:
        """Keep no further frames for a caller of ``watch``, and forget them two seconds later."""
        if self.limit:
            self._topics[key].watchers -= 1
            self._loop.call_later(UNUSED_SECONDS, self._drop_unused, key)

    def hold(self, key: FeedKey) -> Hold:
        """Keep the present frames of a topic until ``release``, within the limit."""
        with self._lock:
            topic = self._topics.get(key, _Topic())
            for kept in topic.frames.values():
                self._held_size += 0 if kept.holds else kept.size
                kept.holds += 1
            return Hold(key, tuple(topic.frames), topic.too_large)

    def release(self, hold: Hold) -> None:
        """End a hold."""
        with self._lock:
            for kept in _frames_of(hold, self._topics):
                kept.holds -= 1
                self._held_size -= 0 if kept.holds else kept.size
        self._loop.call_later(UNUSED_SECONDS, self._drop_unused, hold.key)

    def held(self, hold: Hold) -> list[KeptFrame]:
        """Return the frames of a hold that the limit has left, oldest first."""
        with self._lock:
            return _frames_of(hold, self._topics)

    def explain(self, hold: Hold) -> str:
        """Return why a hold has lost frames, or has never had any, as the end of a sentence."""
        if not self.limit:
            return 'history_bytes is 0'
        if hold.numbers:
            return f'others needed the {self.limit} bytes of history_bytes'
        if hold.too_large:
            return f'a frame has {hold.too_large} bytes, and history_bytes is {self.limit}'
        return 'none has come while the page showed the topic alone'

    def _make_room(self, topic: _Topic, new: KeptFrame) -> None:
        """
        Forget old frames of a topic, then the oldest ones of all topics.

        Frames that paused pages may show leave last, unless they need more than half of the limit.
        """
        for kept in _expired(topic, new):
            self._forget(topic, kept)
        while (self.size + new.size > self.limit
               or sum(len(one.frames) for one in self._topics.values()) >= _MAX_FRAMES):
            can_all = self._held_size > self.limit / 2 or self._held_size == self.size
            self._forget(*min(_first_of_each(self._topics.values(), can_all),
                              key=lambda one: one[1].number))

    def _forget(self, topic: _Topic, kept: KeptFrame) -> None:
        del topic.frames[kept.number]
        self.size -= kept.size
        self._held_size -= kept.size if kept.holds else 0

    def _drop_unused(self, key: FeedKey) -> None:
        """Forget the frames of a topic that no page can show."""
        with self._lock:
            topic = self._topics.get(key)
            if topic is None or topic.watchers:
                return
            for kept in [*topic.frames.values()]:
                if not kept.holds:
                    self._forget(topic, kept)
            if not topic.frames:
                del self._topics[key]


def message_size(message: AnyMessage) -> int:
    """Return the bytes that a message keeps in memory: those of its data and of its texts."""
    text = message.format if isinstance(message, WireCompressedImage) else message.encoding
    data = memoryview(message.data)
    # The data of a message may be a part of the buffer that it arrived in.
    whole = memoryview(data.obj).nbytes
    return max(whole, data.nbytes) + sys.getsizeof(text) + sys.getsizeof(message.header.frame_id)


def _frames_of(hold: Hold, topics: Mapping[FeedKey, _Topic]) -> list[KeptFrame]:
    """Return the frames of a hold that are kept, oldest first."""
    frames = topics[hold.key].frames if hold.key in topics else {}
    return [frames[number] for number in hold.numbers if number in frames]


def _first_of_each(
    topics: Iterable[_Topic], has_held: bool,
) -> Iterator[tuple[_Topic, KeptFrame]]:
    """Yield the oldest frame of each topic, among those of paused pages or without them."""
    for topic in topics:
        kept = next((one for one in topic.frames.values() if has_held or not one.holds), None)
        if kept:
            yield topic, kept


def _expired(topic: _Topic, new: KeptFrame) -> list[KeptFrame]:
    """Return the frames that are too old, unless a newer one or a paused page needs them."""
    since = new.arrived - KEPT_SECONDS
    old = [*itertools.takewhile(lambda one: one.arrived < since, topic.frames.values())]
    oldest = next(itertools.islice(topic.frames.values(), len(old), None), new)
    if not oldest.is_start:
        starts = [place for place, one in enumerate(old) if one.is_start]
        old = old[:starts[-1]] if starts else old
    return [one for one in old if not one.holds]


def from_start(frames: Sequence[KeptFrame]) -> list[KeptFrame]:
    """Return frames without the first packets of video that need an earlier key frame."""
    return [*itertools.dropwhile(lambda one: not one.is_start, frames)]


def _owned(received: ReceivedMessage) -> ReceivedMessage:
    """Return a message whose data are not in the shared memory of its publisher."""
    message = received.message
    if is_own(message):
        return received
    data = message.data.copy()
    data.flags.writeable = False
    return replace(received, message=replace(message, data=data))
