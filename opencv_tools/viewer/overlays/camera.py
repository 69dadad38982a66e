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
"""Principal point and undistorted view of a camera, from an untrusted camera_info."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from opencv_tools.camera_model import raw_view
from opencv_tools.image.errors import CdrError, ImageError
from opencv_tools.image.text import printable
from opencv_tools.viewer.errors import MAX_MESSAGE
from opencv_tools.viewer.overlays.boxes import LARGEST
from opencv_tools.viewer.overlays.sources import CameraSource
from rclpy.serialization import deserialize_message
from sensor_msgs.msg import CameraInfo

#: Largest size of a message in bytes; one of a camera has some hundreds.
MAX_INFO_BYTES = 4096
_RECTIFIED = 'image_rect'  # begin of the names of image_proc, as in rectified.js of the page
_STAMPED = 12  # bytes of a message up to the end of its stamp
_MIDDLE = 0.5  # of the first pixel, which spans 0 to 1 on the page and is 0 in a camera_info


class CameraOverlay:
    """Send the overlay of a camera to a page, whenever it has changed."""

    def __init__(
        self, source: CameraSource, topic: str, size: Callable[[], tuple[int, int] | None],
        post: Callable[[dict[str, Any]], object],
    ) -> None:
        """
        Create an overlay that was not sent yet.

        :param source: calibration of the camera.
        :param topic: name of the image topic.
        :param size: returns width and height of its images; None before the first one.
        :param post: sends a message to the page.
        """
        self.source = source
        self._topic = topic
        self._size = size
        self._post = post
        self._sent: tuple[object, ...] = ()
        self._problem = ''

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
        return '' if self._sent else f'no message on {printable(self.source.key[0])} yet'


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
