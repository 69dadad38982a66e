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

"""Files of the pictures that pages show, kept until the pages have fetched them."""

from __future__ import annotations

import asyncio
from collections.abc import Mapping
import secrets
from typing import Any
from urllib.parse import urlencode

from opencv_tools.viewer.errors import RequestError
from opencv_tools.viewer.inspect.looks import describe_gone
from opencv_tools.viewer.protocol import topic_of, valid_number
from opencv_tools.viewer.streams.channel import Channel
from opencv_tools.viewer.streams.feed import NewFrame
from opencv_tools.viewer.streams.stream import Stream

_KEY_BYTES = 12
# A page fetches its file at once. Frames may be large, so few of them wait.
_SECONDS, _MOST = 10.0, 8


class PictureFiles:
    """Keep the frame that a page shows, because the page may draw the next one meanwhile."""

    def __init__(self) -> None:
        self._kept: dict[str, tuple[Stream, NewFrame]] = {}

    def answer(self, message: dict[str, Any], channels: Mapping[str, object]) -> dict[str, Any]:
        """
        Return the address of the file of a picture, or why there is none.

        :param message: topic of the picture and the sequence number that it was sent with.
        :param channels: what sends the pictures of each topic to the page.
        :raises RequestError: a value is invalid.
        """
        topic = topic_of(message['file'])
        picture = int(valid_number(message.get('picture'), 'picture', 0, 2**53))
        channel = channels.get(topic)
        if isinstance(channel, Channel) and (frame := channel.shown.of(picture)):
            values = {'topic': topic, 'picture': self._keep(channel.stream, frame)}
            return {'file': {'topic': topic, 'address': f'/snapshot?{urlencode(values)}'}}
        if isinstance(channel, Channel) and not channel.options.looks:
            error = ('the frame of this picture is in the memory of its publisher: show the '
                     'topic alone, then save')
        else:
            error = describe_gone(channel)
        return {'file': {'topic': topic, 'error': error}}

    def take(self, key: str) -> tuple[Stream, NewFrame]:
        """
        Return the stream and the frame of an address, once.

        :raises RequestError: the frame is no longer kept.
        """
        if key not in self._kept:
            raise RequestError('the frame of this picture is no longer kept: save it again', 404)
        return self._kept.pop(key)

    def _keep(self, stream: Stream, frame: NewFrame) -> str:
        """Keep a frame for a short time, and return the key to it."""
        while len(self._kept) >= _MOST:
            del self._kept[next(iter(self._kept))]
        key = secrets.token_hex(_KEY_BYTES)
        self._kept[key] = stream, frame
        asyncio.get_running_loop().call_later(_SECONDS, self._kept.pop, key, None)
        return key
