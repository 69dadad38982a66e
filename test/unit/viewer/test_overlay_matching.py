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
"""Frames of a feed that are matched with boxes, without a node."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from dataclasses import replace
from typing import cast

from detections import serialized
import numpy as np
from opencv_tools.image.cdr import WireHeader
from opencv_tools.image.encodings import find_encoding
from opencv_tools.image.layout import array_to_wire
from opencv_tools.topics.queue import ReceivedMessage
from opencv_tools.viewer import watched
from opencv_tools.viewer.overlays.boxes import DETECTIONS, MAX_BYTES
from opencv_tools.viewer.overlays.matching import MatchedFrames
from opencv_tools.viewer.overlays.sources import BoxSource
from opencv_tools.viewer.streams.feed import Feed, NewFrame
import pytest
from waiting import until

BOX = (10, 20, 30, 40, 0, 'cup', 0.5)


class Match:
    """A feed of frames, boxes, and what was matched."""

    def __init__(self) -> None:
        self.feed = Feed(lambda: None)
        self.source = BoxSource(('/boxes', DETECTIONS))
        self.matched: list[int] = []
        self.expired = 0
        self.frames = MatchedFrames(self.source, self._add, self._expire)

    async def _add(self, frame: NewFrame) -> None:
        self.matched.append(frame.stamp_ns)

    def _expire(self) -> None:
        self.expired += 1

    def frame(self, stamp: int, frame_id: str = '', width: int = 4) -> None:
        """Put a frame into the feed, as the executor does, and choose."""
        image = array_to_wire(np.zeros((4, width, 3), np.uint8), find_encoding('bgr8'),
                              WireHeader(0, stamp, frame_id))
        self.feed.put(ReceivedMessage(image, 0))
        self.frames.choose(self.feed)

    def boxes(self, stamp: int, frame_id: str = '', name: str = 'cup') -> None:
        self.source.receive([serialized([(10, 20, 30, 40, 0, name, 0.5)], stamp, frame_id)])

    def chosen(self) -> int:
        """Return the stamp of the frame to show."""
        return cast(NewFrame, self.frames.choose(self.feed)).stamp_ns

    def describe(self) -> str:
        return self.frames.describe(cast(NewFrame, self.frames.choose(self.feed)).number)


def run(work: Callable[[Match], Awaitable[None]]) -> None:
    async def begin() -> None:
        match = Match()
        try:
            await work(match)
        finally:
            match.frames.close()

    asyncio.run(begin())


def test_newest_frame_with_boxes_is_chosen() -> None:
    async def work(match: Match) -> None:
        assert match.frames.choose(match.feed) is None
        for stamp in range(1, 6):
            match.frame(stamp)
        assert match.chosen() == 5
        assert match.describe() == 'no message on /boxes yet'
        match.boxes(2)
        await until(lambda: match.matched == [2])
        assert match.chosen() == 2
        assert match.describe() == '1 box'
        match.boxes(4)
        match.boxes(3)  # later, but of an older frame
        await until(lambda: match.matched[-1] == 4)
        match.frame(6)
        assert match.chosen() == 4
        assert match.frames.boxes.of(cast(NewFrame, match.feed.newest)) is None

    run(work)


def test_boxes_before_their_frame() -> None:
    async def work(match: Match) -> None:
        match.boxes(7)
        match.frame(6)
        assert match.describe() == 'no message of /boxes has the stamp of a picture'
        match.frame(7)
        await until(lambda: match.matched == [7])
        assert match.chosen() == 7

    run(work)


def test_frames_without_boxes_follow_after_a_while(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(watched, '_QUIET_SECONDS', 0.05)

    async def work(match: Match) -> None:
        match.frame(1)
        match.boxes(1)
        await until(lambda: match.matched == [1])
        match.frame(2)
        await until(lambda: match.expired > 0 and match.chosen() == 2)
        assert match.describe() == 'no message of /boxes has the stamp of this picture'
        match.boxes(2)
        await until(lambda: match.matched == [1, 2])
        assert match.describe() == '1 box'

    run(work)


def test_newest_of_two_messages_with_one_stamp() -> None:
    async def work(match: Match) -> None:
        match.frame(1)
        for name in 'ab':
            match.boxes(1, name=name)
        await until(lambda: bool(match.matched))
        shown = match.frames.boxes.of(cast(NewFrame, match.feed.newest))
        assert shown and [box.label for box in shown.shown] == ['b 0.50']
        match.boxes(1, name='c')
        await until(lambda: len(match.matched) == 2)
        shown = match.frames.boxes.of(cast(NewFrame, match.feed.newest))
        assert shown and [box.label for box in shown.shown] == ['c 0.50']

    run(work)


@pytest.mark.parametrize(('frames', 'is_match'), [
    (('left', 'left'), True), (('left', ''), True), (('', 'left'), True),
    (('left', 'right'), False)])
def test_boxes_of_another_camera(frames: tuple[str, str], is_match: bool) -> None:
    async def work(match: Match) -> None:
        match.frame(1, frames[0])
        match.boxes(1, frames[1])
        match.frame(2)
        match.boxes(2)
        await until(lambda: bool(match.matched))
        match.frames.choose(match.feed)
        match.boxes(1, frames[1])
        assert (match.frames.describe(99) == (
            '/boxes has the frame_id right, but the pictures have left')) != is_match

    run(work)


def test_no_stamp_matches_nothing() -> None:
    async def work(match: Match) -> None:
        match.frame(0)
        match.boxes(0)
        assert match.describe() == 'the messages of /boxes have no stamp, which boxes need'
        match.frame(1)
        match.boxes(1)
        await until(lambda: match.matched == [1])

    run(work)


def test_what_is_kept_is_bounded() -> None:
    async def work(match: Match) -> None:
        for stamp in range(1, 1001):
            match.boxes(stamp)
        assert [stamp for stamp in range(1, 1001) if match.source.find(stamp)] == [
            *range(489, 1001)]
        large = bytes(serialized([], 2000)) + bytes(MAX_BYTES - 200)
        match.source.receive([serialized([], 5000 + number) + large for number in range(5)])
        assert [number for number in range(5) if match.source.find(5000 + number)] == [3, 4]
        for stamp in range(10_000, 10_100):
            match.frame(stamp)
        match.boxes(10_001)
        assert match.describe() == (
            'the messages of /boxes come too late: the node keeps 32 pictures')
        for stamp in range(20_000, 20_010):
            match.frame(stamp, width=1 << 20)  # 12 MiB
        match.boxes(20_001)
        assert match.describe().endswith('the node keeps 5 pictures')
        assert match.matched == []

    run(work)


def test_messages_that_cannot_be_read() -> None:
    async def work(match: Match) -> None:
        match.frame(1)
        match.source.receive([b'none'])
        assert match.describe() == ('a message of /boxes is left out: 4 bytes that are not plain '
                                    'CDR')
        match.source.receive([serialized([BOX], 1)[:-40]])
        await until(lambda: 'belong to the message' in match.describe())
        assert match.matched == []
        match.boxes(1)
        await until(lambda: match.matched == [1])
        assert match.describe() == '1 box'

    run(work)


def test_numbers_of_another_feed_begin_again() -> None:
    async def work(match: Match) -> None:
        match.frame(1)
        match.boxes(1)
        await until(lambda: match.matched == [1])
        match.feed = Feed(lambda: None)
        assert match.frames.choose(match.feed) is None
        match.frame(5)
        assert match.chosen() == 5
        match.boxes(5)
        await until(lambda: match.matched == [1, 5])

    run(work)


def test_boxes_of_earlier_frames_of_a_paused_page() -> None:
    async def work(match: Match) -> None:
        for stamp in range(1, 100):
            match.frame(stamp)
            match.boxes(stamp, name=str(stamp))
        await until(lambda: bool(match.matched) and match.matched[-1] == 99)
        match.frames.boxes.hold(True)
        for stamp in range(1000, 1600):  # would replace all of them
            match.boxes(stamp)
        image = array_to_wire(np.zeros((4, 4, 3), np.uint8), find_encoding('bgr8'),
                              WireHeader(0, 5, ''))
        earlier = NewFrame(-5, image, 0)
        match.frames.boxes.of(earlier)
        await until(lambda: match.matched[-1] == 5)
        shown = match.frames.boxes.of(earlier)
        assert shown and [box.label for box in shown.shown] == ['5 0.50']
        assert match.frames.describe(-5) == '1 box'
        match.frames.boxes.hold(False)
        other = NewFrame(-6, replace(image, header=WireHeader(0, 6, '')), 0)
        assert match.frames.boxes.of(other) is None

    run(work)


def test_many_messages_that_cannot_be_read_are_read_once() -> None:
    async def work(match: Match) -> None:
        for stamp in range(1, 33):
            match.frame(stamp)
            match.source.receive([serialized([BOX], stamp)[:-40]])
        await until(lambda: all(found.is_read for found in match.source.copy().values()))
        await until(lambda: len(asyncio.all_tasks()) == 1)  # nothing is read any more
        assert match.matched == []

    run(work)
