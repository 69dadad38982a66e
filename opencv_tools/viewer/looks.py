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

"""Answers to the questions of a page about the pixels of its pictures."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

from opencv_tools.cv_bridge import CvBridgeError
from opencv_tools.image.errors import ImageError
from opencv_tools.image.text import printable
from opencv_tools.viewer.channel import Channel
from opencv_tools.viewer.errors import MAX_MESSAGE, RequestError
from opencv_tools.viewer.pixel_values import describe_pixel, histogram, line_profile
from opencv_tools.viewer.pixels import Pixels
from opencv_tools.viewer.protocol import parse_point, parse_region, topic_of, valid_number

#: Topics of a page whose frames are kept for its questions.
MAX_LOOKS = 4

_Message = dict[str, Any]
_Answer = Callable[[Pixels], _Message]


def _pixel(message: _Message) -> _Answer:
    x, y = parse_point(message.get('at'), 'at')
    return lambda pixels: {'text': describe_pixel(pixels, x, y)
                           + (f' of the {pixels.codec}' if pixels.codec else '')}


def _profile(message: _Message) -> _Answer:
    begin, end = (parse_point(message.get(name), name) for name in ('from', 'to'))
    return lambda pixels: line_profile(pixels, begin, end)


def _histogram(message: _Message) -> _Answer:
    region = parse_region(message.get('region'))
    return lambda pixels: histogram(pixels, region)


# What answers each word of a page, given its message.
_ANSWERS: dict[str, Callable[[_Message], _Answer]] = {
    'pixel': _pixel, 'profile': _profile, 'histogram': _histogram}


@dataclass(frozen=True)
class _Question:
    """
    A question about a picture.

    :param picture: sequence number of the picture.
    :param channel: what sends the pictures of the topic; None for nothing.
    :param read: reads the pixels of the frame, which waits with the question; None if the frame
        is gone.
    :param answer: returns the answer, given the pixels.
    """

    picture: int
    channel: object
    read: Callable[[], Awaitable[Pixels]] | None
    answer: _Answer


class Looks:
    """
    Answer the questions of a page, one after another.

    A question replaces one of the same kind about the same topic that still waits. The frame waits
    with the question, because the page may draw the next picture meanwhile.
    """

    def __init__(self, channel_of: Callable[[str], object],
                 write: Callable[[_Message], Awaitable[None]]) -> None:
        """
        Create an object without questions.

        :param channel_of: returns what sends the pictures of a topic to the page.
        :param write: sends an answer, and waits until it is sent.
        """
        self._channel_of = channel_of
        self._write = write
        self._waiting: dict[tuple[str, str], _Question] = {}
        self._task: asyncio.Task[None] | None = None

    def ask(self, message: _Message) -> bool:
        """
        Answer a message soon, if it is a question.

        :returns: whether it is one.
        :raises RequestError: a value is invalid, or too many questions wait.
        """
        kind = next((word for word in _ANSWERS if word in message), None)
        if kind is None:
            return False
        topic = topic_of(message[kind])
        picture = int(valid_number(message.get('picture'), 'picture', 0, 2**53))
        channel = self._channel_of(topic)
        read = None
        if isinstance(channel, Channel) and (frame := channel.frame_of(picture)):
            read = partial(channel.stream.pixels, frame)
        self._waiting[kind, topic] = _Question(picture, channel, read, _ANSWERS[kind](message))
        if len(self._waiting) > len(_ANSWERS) * MAX_LOOKS:
            del self._waiting[kind, topic]
            raise RequestError(f'questions about {MAX_LOOKS} topics wait for an answer: wait')
        if self._task is None or self._task.done():
            self._task = asyncio.ensure_future(self._answer_all())
        return True

    def close(self) -> None:
        """Answer nothing any more."""
        self._waiting.clear()
        if self._task:
            self._task.cancel()

    async def _answer_all(self) -> None:
        while self._waiting:
            kind, topic = key = next(iter(self._waiting))
            question = self._waiting.pop(key)
            try:
                answer = await _answer(question)
            except (CvBridgeError, ImageError, RequestError) as err:
                answer = {'error': printable(err, MAX_MESSAGE)}
            await self._write({kind: {'topic': topic, 'picture': question.picture, **answer}})


async def _answer(question: _Question) -> _Message:
    """
    Return the answer to a question.

    :raises RequestError: the frame of the picture is not kept, or is video.
    """
    channel = question.channel
    if channel is not None and not isinstance(channel, Channel):
        raise RequestError('the browser decodes this video, so the node has no pixels of it: '
                           'add quality=90 to the address of the page to get images')
    if channel is None or question.read is None:
        raise RequestError(describe_gone(channel))
    return await channel.stream.in_pool(question.answer, await question.read())


def describe_gone(channel: object) -> str:
    """Return the sentence about a picture whose frame is not kept, and what to do."""
    is_live = isinstance(channel, Channel) and not channel.options.held
    return ('the node has the frame of this picture no more: '
            + ('wait for the next one' if is_live else 'resume the page'))
