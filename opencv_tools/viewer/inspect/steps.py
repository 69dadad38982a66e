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

"""Steps of a paused page through the frames that the node has kept."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

from opencv_tools.base.units import NANO
from opencv_tools.topics.queue import ReceivedMessage
from opencv_tools.viewer.errors import RequestError
from opencv_tools.viewer.inspect.held_video import HeldVideo
from opencv_tools.viewer.inspect.history import from_start, History, Hold, KeptFrame
from opencv_tools.viewer.protocol import topic_of, valid_number
from opencv_tools.viewer.streams.channel import Channel
from opencv_tools.viewer.streams.feed import FeedKey, NewFrame
from opencv_tools.viewer.streams.video_channel import VideoChannel

_MAX_STEP = 10_000  # frames

_NO_KEY_FRAME = 'earlier packets of the video need a key frame from before this page looked'
_Message = dict[str, Any]


@dataclass(frozen=True)
class _Request:
    """
    A step.

    :param by: number of frames, negative for earlier ones.
    :param beside: name of a topic that shows the frame with the nearest stamp; '' for none.
    """

    topic: str
    by: int
    beside: str


class Steps:
    """
    Let the history keep the frames that a page can step to, and show them.

    A step waits until the page has drawn the one before. Of those that wait, the newest counts.
    """

    def __init__(self, history: History, channels: Mapping[str, Channel | VideoChannel],
                 write: Callable[[_Message], Awaitable[None]]) -> None:
        """
        Create an object for a page.

        :param history: frames that the node has kept.
        :param channels: what sends the pictures of each topic to the page.
        :param write: sends an answer, and waits until it is sent.
        """
        self._history = history
        self._channels = channels
        self._write = write
        self._watched: dict[str, FeedKey] = {}
        self._holds: dict[str, Hold] = {}
        self._pictures: dict[str, HeldVideo] = {}
        self._waiting: _Request | None = None
        self._task: asyncio.Task[None] | None = None

    def follow(self, name: str) -> None:
        """Use the options of a topic, which have changed."""
        channel = self._channels.get(name)
        looks = channel is not None and channel.options.looks
        if channel and looks and channel.options.held:
            if name not in self._holds:
                self._holds[name] = self._history.hold(channel.stream.key)
                self._pictures[name] = HeldVideo()
            looks = False
        elif name in self._holds:
            self._history.release(self._holds.pop(name))
            del self._pictures[name]
        if channel and looks and name not in self._watched:
            self._watched[name] = channel.stream.key
            self._history.watch(channel.stream.key)
        elif not looks and name in self._watched:
            self._history.unwatch(self._watched.pop(name))

    async def show(self, name: str, message: object) -> None:
        """
        Show the kept frame of a message, because the page has paused while it showed video.

        :param message: the message, as it was received.
        """
        self.follow(name)
        channel, frames = self._channel(name), self._frames(name)
        place = next((place for place, one in enumerate(frames)
                      if one.received.message is message), None)
        if channel and place is not None:
            # Without it the page keeps its picture, and a step has the reason.
            with suppress(RequestError):
                _show(channel, await self._picture(channel, frames, place))

    def ask(self, message: _Message) -> bool:
        """
        Step soon, if a message is a step.

        :returns: whether it is one.
        :raises RequestError: a value is invalid.
        """
        if 'step' not in message:
            return False
        beside = message.get('beside')
        self._waiting = _Request(
            topic_of(message['step']),
            int(valid_number(message.get('by'), 'by', -_MAX_STEP, _MAX_STEP)),
            topic_of(beside) if beside else '')
        if self._task is None or self._task.done():
            self._task = asyncio.ensure_future(self._answer_all())
        return True

    def kept(self) -> dict[str, list[ReceivedMessage]]:
        """Return the messages that a paused page can step through, oldest first, by topic."""
        return {name: [one.received for one in self._frames(name)] for name in self._holds}

    def close(self) -> None:
        """Step no more."""
        self._waiting = None
        if self._task:
            self._task.cancel()

    async def _answer_all(self) -> None:
        while self._waiting:
            request, self._waiting = self._waiting, None
            try:
                answer = {'text': await self._step(request)}
            except RequestError as err:
                answer = {'error': str(err)}
            await self._write({'step': {'topic': request.topic, **answer}})

    async def _step(self, request: _Request) -> str:
        """
        Show another frame of a topic, and that of the topic beside it.

        :returns: the sentence about the place of the frame.
        :raises RequestError: there is no frame to step to.
        """
        channel, hold = self._channel(request.topic), self._holds.get(request.topic)
        if channel is None or hold is None:
            raise RequestError('nothing to step to: no frames are kept here for this pause: '
                               'resume, then pause again')
        kept, frames = self._history.held(hold), self._frames(request.topic)
        if not frames:
            raise RequestError('the node has kept no frame: ' + (
                _NO_KEY_FRAME if kept else self._history.explain(hold)))
        place = _place(frames, channel.shown.held, request.by)
        place = min(max(place, 0), len(frames) - 1)
        shown = [_show(channel, await self._picture(channel, frames, place))]
        other, others = self._channel(request.beside), self._frames(request.beside)
        if other and other is not channel and others:
            nearest = min(range(len(others)), key=lambda one: abs(
                others[one].time_ns - frames[place].time_ns))
            shown.append(_show(other, await self._picture(other, others, nearest)))
        reason = ''.join(await asyncio.gather(*shown))
        text = _describe(frames, place)
        if not place:
            text += (f', earlier ones are gone: {self._history.explain(hold)}'
                     if len(kept) < len(hold.numbers) else f', {_NO_KEY_FRAME}'
                     if len(frames) < len(kept) else ', the first one')
        elif place == len(frames) - 1:
            text += ', the last one'
        return f'{text}: {reason}' if reason else text

    def _frames(self, name: str) -> list[KeptFrame]:
        """Return the frames that a paused page can step through, oldest first."""
        hold = self._holds.get(name)
        return from_start(self._history.held(hold)) if hold else []

    async def _picture(self, channel: Channel, frames: list[KeptFrame], place: int) -> NewFrame:
        """
        Return the frame at a place, of which a channel sends a picture.

        :raises RequestError: it is video, and damaged, or the page goes on.
        """
        name = channel.stream.name
        if (video := self._pictures.get(name)) is not None:
            picture = video.found(frames[place])
            if picture is None:
                picture = await channel.stream.in_pool(video.decode, frames, place)
            if self._channel(name) is channel:
                return picture
        raise RequestError('the page is no longer paused')

    def _channel(self, name: str) -> Channel | None:
        channel = self._channels.get(name)
        return channel if isinstance(channel, Channel) else None


def _show(channel: Channel, frame: NewFrame) -> asyncio.Future[str]:
    """Show a frame; see ``ShownFrame.step``."""
    future = channel.shown.step(frame)
    channel.frame_arrived()
    return future


def _place(frames: list[KeptFrame], present: NewFrame | None, by: int) -> int:
    """Return the place of the frame that follows some steps after that which is shown."""
    if present is None:
        return len(frames) + by
    for place, kept in enumerate(frames):
        if kept.number == -present.number or kept.received.message is present.message:
            return place + by
    # It is not kept, as it came before the others or was too large.
    earlier = sum(kept.received.receive_ns <= present.receive_ns for kept in frames)
    return earlier + by - (by > 0)


def _describe(frames: list[KeptFrame], place: int) -> str:
    """Return the place of a frame among others, and its time before the last one."""
    frame, last = frames[place], frames[-1]
    seconds = (last.time_ns - frame.time_ns) / NANO
    if seconds < 0:  # the publisher has set its clock
        seconds = max(0.0, (last.received.receive_ns - frame.received.receive_ns) / NANO)
    return f'frame {place + 1} of {len(frames)}, {seconds:.1f} s before'
