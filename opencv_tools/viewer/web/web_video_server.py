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

"""The addresses of web_video_server: snapshots, as the recorder writes them, and streams."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from dataclasses import replace
import re
import secrets
from urllib.parse import urlencode

import numpy as np
from opencv_tools.cv_bridge import CvBridge, CvBridgeError
from opencv_tools.image.cdr import WireMessage
from opencv_tools.image.encodings import find_encoding
from opencv_tools.image.errors import ImageError
from opencv_tools.image.orientation import jpeg_orientation, orient, turn_upright
from opencv_tools.nodes.conversion import FrameConverter
from opencv_tools.recording.errors import UnwritableError
from opencv_tools.recording.frames import CompressedFrame, RawFrame, ReceivedFrame
from opencv_tools.recording.image_encoder import encode_frame, EncoderSettings, read_image_header
from opencv_tools.recording.naming import FileNames
from opencv_tools.viewer.errors import RequestError
from opencv_tools.viewer.inspect.picture_files import PictureFiles
from opencv_tools.viewer.protocol import number_of, topic_of
from opencv_tools.viewer.streams.encoding import Picture, PictureOptions
from opencv_tools.viewer.streams.feed import NewFrame
from opencv_tools.viewer.streams.stream import Stream
from opencv_tools.viewer.web.web import SiteHandler
from tornado.escape import xhtml_escape

# Lossless formats, most common first; .npy stores every frame.
_SUFFIXES = ('.png', '.tiff', '.npy')


def encode_original(
    message: WireMessage, topic: str, receive_ns: int, degrees: int = 0, flip: str = 'none',
) -> tuple[str, bytes]:
    """
    Encode a frame without loss.

    :param message: raw or compressed image; a compressed one is not changed unless it is turned.
    :param topic: topic of the message, for the name.
    :param receive_ns: time of reception in nanoseconds of the system clock.
    :param degrees: clockwise rotation in degrees, a multiple of 90.
    :param flip: ``horizontal`` swaps left and right before the rotation; ``none`` does not.
    :returns: name of the file and its content.
    :raises ImageError: the message is not a valid image.
    :raises CvBridgeError: the message is not a valid image.
    """
    frame = FrameConverter(CvBridge()).convert(message, topic, receive_ns)
    suffixes: tuple[str, ...] = _SUFFIXES
    turned = ''
    if degrees or flip != 'none':
        frame, turned = _turned(frame, degrees, flip), '_turned'
    if isinstance(frame, CompressedFrame):
        suffixes = read_image_header(frame.data).suffixes[:1] or _SUFFIXES
    for suffix in suffixes:
        try:
            parts = encode_frame(frame, EncoderSettings(suffix)).parts()
            break
        except UnwritableError:
            if suffix == suffixes[-1]:
                raise
    name = FileNames(f'{{topic}}_{{stamp}}{turned}{suffix}').name(0, frame.metadata)
    return name, b''.join(parts)


def _turned(frame: ReceivedFrame, degrees: int, flip: str) -> RawFrame:
    """Return a frame as pixels that are flipped, then rotated, from the upright picture on."""
    raw = frame.decode()
    image = raw.image
    if isinstance(frame, CompressedFrame):
        image = turn_upright(image, jpeg_orientation(bytes(frame.data)))
    image, encoding = orient(image, find_encoding(raw.metadata.encoding), flip, degrees)
    return replace(raw, image=np.ascontiguousarray(image),
                   metadata=replace(raw.metadata, encoding=encoding.name))


_FRAME_SECONDS = 5.0
# Chromium shows a part of a stream when the next part begins, so the last one is repeated.
_REPEAT_SECONDS = 0.2
# Browsers search the pictures for the boundary, so it must not occur in them.
_BOUNDARY_BYTES = 15


class StreamingHandler(SiteHandler):
    """A handler that looks at a topic without the page."""

    async def prepare(self) -> None:
        """Allow other pages to show the pictures, if their origin is allowed."""
        headers = self.request.headers
        origin = self.site.access.embedding_origin(headers.get('Origin'), headers.get('Referer'))
        if origin:
            self.set_header('Cross-Origin-Resource-Policy', 'cross-origin')
            self.set_header('Access-Control-Allow-Origin', origin)
        await super().prepare()

    @asynccontextmanager
    async def stream(self, original: bool = False) -> AsyncIterator[Stream]:
        """
        Look at the topic of the URL.

        :param original: whether raw images are preferred to compressed ones.
        :raises RequestError: there is no such topic, or too many viewers.
        """
        hub = self.site.hub
        name = topic_of(self.get_query_argument('topic', None))
        hub.add_connection(self)
        try:
            stream = await hub.stream(name, original)
            stream.acquire()
            try:
                yield stream
            finally:
                stream.release()
        finally:
            hub.connections.discard(self)

    def picture_options(self) -> PictureOptions:
        """
        Return the size and quality of the URL.

        :raises RequestError: a number is invalid.
        """
        settings = self.site.hub.settings
        width, height, quality = (
            int(number_of(self.get_query_argument(name, '') or '0', name, 0, high))
            for name, high in (('width', 65_535), ('height', 65_535), ('quality', 100)))
        widths = [limit for limit in (width, settings.width) if limit]
        return PictureOptions(min(widths, default=0), quality or settings.quality, height=height,
                              keep=not quality)

    async def first_frame(self, stream: Stream) -> NewFrame:
        """
        Wait for the next frame; a latched topic need not send another one.

        :raises RequestError: no frame has arrived.
        """
        feed = stream.feed
        await self.site.hub.refresh()
        if feed.newest and feed.is_latched:
            return feed.newest
        frame = await stream.next_frame(feed.frames, _FRAME_SECONDS)
        if frame:
            return frame
        await self.site.hub.refresh()
        raise RequestError(feed.reason or stream.error or f'no frame on {stream.name} within '
                           f'{_FRAME_SECONDS:g} s', 503)


class SnapshotHandler(StreamingHandler):
    """One picture, as JPEG or as the recorder would write it."""

    async def get(self) -> None:
        """Write the frame of a picture, or the next one; who has not read it is still a viewer."""
        if key := self.get_query_argument('picture', ''):
            files: PictureFiles = self.settings['files']
            await self.finish(await self._original(*files.take(key)))
            return
        is_original = self.get_query_argument('format', 'jpg') == 'original'
        options = self.picture_options()
        async with self.stream(is_original) as stream:
            # Nothing but the connection keeps the content, which may be large.
            await self.finish(await self._content(stream, options, is_original))

    async def _content(
        self, stream: Stream, options: PictureOptions, is_original: bool,
    ) -> bytes:
        frame = await self.first_frame(stream)
        if is_original:
            return await self._original(stream, frame)
        self._set_stamp(frame)
        picture = await stream.picture(frame, options)
        if isinstance(picture, str):
            raise RequestError(f'the frame cannot be shown: {picture}', 503)
        self.set_header('Content-Type', 'image/jpeg')
        return picture.data

    def _set_stamp(self, frame: NewFrame) -> None:
        header = frame.message.header
        self.set_header('X-Timestamp', f'{header.sec}.{header.nanosec:09d}')

    async def _original(self, stream: Stream, frame: NewFrame) -> bytes:
        self._set_stamp(frame)
        turn = re.fullmatch('([0-3])(f?)', self.get_query_argument('turn', '') or '0')
        if turn is None:
            raise RequestError('turn is not a number of quarters from 0 to 3, with an f for a '
                               'flip before')
        try:
            name, content = await stream.in_pool(
                encode_original, frame.message, stream.name, frame.receive_ns,
                90 * int(turn[1]), 'horizontal' if turn[2] else 'none')
        except (CvBridgeError, ImageError) as err:
            raise RequestError(f'the frame cannot be saved: {err}', 503) from err
        self.set_header('Content-Type', 'application/octet-stream')
        self.set_header('Content-Disposition', f'attachment; filename="{name}"')
        return content


class StreamHandler(StreamingHandler):
    """Pictures as ``multipart/x-mixed-replace``."""

    _is_closed = False

    async def get(self) -> None:
        """Write pictures until the browser closes the connection."""
        kind = self.get_query_argument('type', '') or 'mjpeg'
        if kind != 'mjpeg':
            raise RequestError(f'type {kind[:40]!r} is not available: use mjpeg')
        options = self.picture_options()
        async with self.stream() as stream:
            frame = await self.first_frame(stream)
            boundary = secrets.token_hex(_BOUNDARY_BYTES)
            self.set_header('Content-Type', f'multipart/x-mixed-replace;boundary={boundary}')
            if self.request.method == 'HEAD':
                return
            await self._write_parts(stream, frame, options, boundary)

    def on_connection_close(self) -> None:
        """End the stream."""
        self._is_closed = True

    async def _write_parts(
        self, stream: Stream, frame: NewFrame, options: PictureOptions, boundary: str,
    ) -> None:
        loop = asyncio.get_running_loop()
        period = 1 / self.site.hub.settings.rate
        due = loop.time()
        part = b''
        is_repeated = True
        while not self._is_closed:
            picture = await stream.picture(frame, options)
            if isinstance(picture, Picture):
                part = (f'--{boundary}\r\nContent-Type: image/jpeg\r\n'
                        f'Content-Length: {len(picture.data)}\r\n\r\n').encode() + (
                            picture.data + b'\r\n')
                is_repeated = False
                if not await self._write_part(part):
                    return
            due = max(due, loop.time()) + period
            await asyncio.sleep(due - period / 2 - loop.time())
            newer = None
            while newer is None and not self._is_closed:
                newer = await stream.next_frame(frame.number, _REPEAT_SECONDS)
                if newer is None and not is_repeated:
                    is_repeated = True
                    if not await self._write_part(part):
                        return
            frame = newer or frame

    async def _write_part(self, part: bytes) -> bool:
        """Write a part; return False if the browser is gone or reads nothing."""
        self.write(part)
        return await self.is_taken(self.flush())


class StreamViewerHandler(SiteHandler):
    """A page with one stream."""

    def get(self) -> None:
        """Write the page."""
        name = topic_of(self.get_query_argument('topic', None))
        self.keep_token()
        given = {key: self.get_query_argument(key, '')
                 for key in ('type', 'width', 'height', 'quality')}
        address = '/stream?' + urlencode(
            {'topic': name, **{key: value for key, value in given.items() if value}})
        self.finish(f'<!doctype html>\n<html lang="en">\n<title>{xhtml_escape(name)}</title>\n'
                    f'<h1>{xhtml_escape(name)}</h1>\n'
                    f'<img src="{xhtml_escape(address)}" alt="{xhtml_escape(name)}">\n')
