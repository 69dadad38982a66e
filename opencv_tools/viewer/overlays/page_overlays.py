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
"""Overlays of the pictures of one page: boxes, principal point and undistorted view."""

from __future__ import annotations

from collections.abc import Awaitable, Callable
from functools import partial
from typing import Any

from opencv_tools.base.text import printable
from opencv_tools.camera_model import raw_view
from opencv_tools.image.errors import CdrError, ImageError
from opencv_tools.viewer.errors import MAX_MESSAGE, RequestError
from opencv_tools.viewer.overlays.boxes import LARGEST
from opencv_tools.viewer.overlays.matching import MatchedFrames
from opencv_tools.viewer.overlays.sources import CameraInfoSource, OverlaySources
from opencv_tools.viewer.protocol import topic_of
from opencv_tools.viewer.streams.channel import Channel
from opencv_tools.viewer.streams.feed import Feed, NewFrame
from opencv_tools.viewer.streams.video_channel import VideoChannel
from rclpy.serialization import deserialize_message
from sensor_msgs.msg import CameraInfo

#: Largest size of a message in bytes; one of a camera has some hundreds.
MAX_INFO_BYTES = 4096
_RECTIFIED = 'image_rect'  # begin of the names of image_proc, as in tiles.js of the page
_STAMPED = 12  # bytes of a message up to the end of its stamp
_MIDDLE = 0.5  # of the first pixel, which spans 0 to 1 on the page and is 0 in a camera_info


class CameraOverlay:
    """Send the overlay of a camera to a page, whenever it has changed."""

    def __init__(
        self, source: CameraInfoSource, topic: str, size: Callable[[], tuple[int, int] | None],
        post: Callable[[dict[str, Any]], object],
    ) -> None:
        """
        Create an overlay that was not sent yet.

        :param size: returns width and height of its images; None before the first one.
        :param post: sends a message to the page.
        """
        self.source = source
        self._topic = topic
        self._size = size
        self._post = post
        self._sent: tuple[object, ...] = ()
        self._problem = ''
        source.join(self.look)

    def close(self) -> None:
        """Send nothing any more."""
        self.source.leave(self.look)

    def look(self) -> None:
        """Send the overlay, unless the page has it."""
        data, size = self.source.newest, self._size()
        content = data[_STAMPED:], size
        if not data or not size or content == self._sent:
            return
        self._sent = content
        overlay: dict[str, Any] = {'center': None, 'outline': []}
        self._problem = ''
        try:
            overlay = camera_json(data, self._topic, size)
        except ImageError as err:
            self._problem = printable(err, MAX_MESSAGE)
        if overlay['outline'] and not any(overlay['outline']):
            self._problem = ('no point of the undistorted view is near the image, because D, R or '
                             'P of the camera_info is wrong: calibrate the camera')
        self._post({'camera': {'topic': self._topic, **overlay}})

    def describe(self) -> str:
        """Return why nothing is drawn; '' if something is."""
        if self.source.refusal or self._problem:
            return self.source.refusal or self._problem
        return '' if self._sent else f'no camera_info of {printable(self._topic)} yet'


def camera_json(data: bytes, topic: str, size: tuple[int, int]) -> dict[str, Any]:
    """
    Return what the page draws for a camera.

    :param data: serialized message of ``sensor_msgs/msg/CameraInfo``.
    :param topic: name of the image topic. Rectified images have no undistorted view of their own.
    :param size: width and height of the images in pixels.
    :returns: ``center``, a point; and ``outline``, points with None for those that the camera
        model does not have.
    :raises ImageError: the message cannot be read, or has no calibration of such images.
    """
    view = raw_view(_read(data), *size)
    is_rectified = topic.rpartition('/')[2].startswith(_RECTIFIED)
    center = view.rectified_center if is_rectified else view.center
    border = view.border[:0] if is_rectified else view.border
    return {'center': _point(center), 'outline': [_point(point) for point in border.tolist()]}


def _point(values: tuple[float, float]) -> list[float] | None:
    """Return a point of the page; None for one that is far outside of any image."""
    if not all(abs(value) <= LARGEST for value in values):  # NaN is not either
        return None
    return [round(value + _MIDDLE, 2) for value in values]


def _read(data: bytes) -> CameraInfo:
    if len(data) > MAX_INFO_BYTES:
        raise CdrError(f'the camera_info has {len(data)} bytes: {MAX_INFO_BYTES} are the limit')
    try:
        info = deserialize_message(data, CameraInfo)
    except Exception as err:  # noqa: B902 (the node has sent what is no message)
        raise CdrError('the camera_info cannot be read') from err
    if not isinstance(info, CameraInfo):
        raise CdrError('the camera_info cannot be read')
    return info


_MAX_TOPICS = 4  # whose pictures have overlays, in a page
_MAX_NAME = 256
_Message = dict[str, Any]


class PageOverlays:
    """
    Match boxes and calibrations with the pictures of a page, and send them.

    All methods run in the loop of the server.
    """

    def __init__(self, sources: OverlaySources, channel_of: Callable[[str], object],
                 write: Callable[[_Message], Awaitable[None]],
                 post: Callable[[_Message], object]) -> None:
        """
        Create an object without overlays.

        :param sources: topics of all pages.
        :param channel_of: returns what sends the pictures of a topic to the page.
        :param write: sends a message, and waits until it is sent.
        :param post: sends a message without waiting.
        """
        self._sources = sources
        self._channel_of = channel_of
        self._write = write
        self._post = post
        # Numbers of the frame and of the picture that were sent last, by topic.
        self._sent: dict[str, tuple[int, int]] = {}
        self._boxes: dict[str, MatchedFrames] = {}
        self._cameras: dict[str, CameraOverlay] = {}

    def ask(self, message: _Message) -> bool:
        """
        Use other overlays of a topic, if a message asks for them.

        :returns: whether it does.
        :raises RequestError: a value is invalid, or there are too many topics.
        """
        if 'overlays' not in message:
            return False
        topic, name = topic_of(message['overlays']), message.get('boxes', '')
        if not isinstance(name, str) or len(name) > _MAX_NAME:
            raise RequestError('boxes is not the name of a topic')
        if self._channel_of(topic) is None:  # it has ended, or was refused
            self.forget(topic)
            return True
        has_camera = message.get('camera', False) is True
        others = (self._boxes.keys() | self._cameras.keys()) - {topic}
        if (name or has_camera) and len(others) >= _MAX_TOPICS:
            raise RequestError(f'a page can have overlays of {_MAX_TOPICS} topics at most')
        self._set_boxes(topic, name)
        self._set_camera(topic, has_camera)
        return True

    def forget(self, topic: str) -> None:
        """Use no overlays of a topic any more."""
        self._set_boxes(topic, '')
        self._set_camera(topic, False)
        self._sent.pop(topic, None)

    def close(self) -> None:
        """Use no overlays any more."""
        for topic in {*self._boxes, *self._cameras}:
            self.forget(topic)

    def newest(self, topic: str, feed: Feed) -> NewFrame | None:
        """Return the frame of a feed that is sent next; None before the first one."""
        return self._boxes[topic].choose(feed) if topic in self._boxes else feed.newest

    def send(self, topic: str, frame: NewFrame, sequence: int) -> int:
        """Send the boxes of a picture, which follows, and return its sequence number."""
        self._sent[topic] = frame.number, sequence
        drawn = self._boxes.get(topic)
        boxes = drawn.boxes.of(frame) if drawn else None
        if boxes is not None:
            self._post(_message(topic, sequence, boxes.as_json()))
        return sequence

    def status(self, topic: str) -> _Message:
        """Return what is drawn, or why nothing is; look for the topics once more."""
        notes = []
        drawn, camera = self._boxes.get(topic), self._cameras.get(topic)
        channel = self._channel_of(topic)
        if drawn:
            drawn.boxes.hold(isinstance(channel, Channel) and channel.options.held)
            number, _ = self._sent.get(topic, (0, 0))
            notes.append(drawn.describe(number) if isinstance(channel, Channel)
                         else drawn.source.refusal or 'boxes need pictures, and this is video')
            self._sources.open(drawn.source)  # it may have ended, or come again
        if camera:
            camera.look()
            notes.append(camera.describe())
            if camera.source.refusal:
                self._sources.open(camera.source)
        return {'overlay': '; '.join(filter(None, notes))}

    def _set_boxes(self, topic: str, name: str) -> None:
        drawn = self._boxes.get(topic)
        if name == (drawn.source.key[0] if drawn else ''):
            return
        if drawn:
            del self._boxes[topic]
            drawn.close()
        if name:
            self._boxes[topic] = MatchedFrames(
                self._sources.boxes(name), partial(self._matched, topic),
                partial(self._show_again, topic))
        self._show_again(topic)

    def _set_camera(self, topic: str, has_camera: bool) -> None:
        if has_camera == (topic in self._cameras):
            return
        if not has_camera:
            self._cameras.pop(topic).close()
            return
        self._cameras[topic] = CameraOverlay(
            self._sources.camera(topic), topic, partial(self._size, topic), self._post)
        self._cameras[topic].look()

    def _size(self, topic: str) -> tuple[int, int] | None:
        """Return width and height of the images of a topic; None before the first one."""
        channel = self._channel_of(topic)
        picture = channel.stream.last_picture if isinstance(
            channel, (Channel, VideoChannel)) else None
        return picture.source_size if picture else None

    def _show_again(self, topic: str) -> None:
        """Have the channel choose a frame again."""
        channel = self._channel_of(topic)
        if isinstance(channel, Channel):
            channel.frame_arrived()

    async def _matched(self, topic: str, frame: NewFrame) -> None:
        """Send a frame whose boxes have arrived, or the boxes alone if the page has the frame."""
        drawn = self._boxes.get(topic)
        boxes = drawn.boxes.of(frame) if drawn else None
        number, sequence = self._sent.get(topic, (0, 0))
        if boxes is not None and number == frame.number:
            await self._write(_message(topic, sequence, boxes.as_json()))
        else:
            self._show_again(topic)


def _message(topic: str, picture: int, shown: list[Any]) -> _Message:
    return {'boxes': {'topic': topic, 'picture': picture, 'list': shown}}
