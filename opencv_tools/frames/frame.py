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

"""A received image as arrays."""

from __future__ import annotations

from functools import cached_property
from typing import Any

from builtin_interfaces.msg import Time
import numpy as np
from numpy.typing import NDArray
from opencv_tools.base.text import enumerated
from opencv_tools.cv_bridge import CvBridge, CvBridgeError
from opencv_tools.image.cdr import WireCompressedImage, WireHeader, WireMessage
from opencv_tools.image.compressed_depth import DEPTH_ENCODINGS
from opencv_tools.image.encodings import encodings_between, find_encoding
from opencv_tools.image.errors import ImageError, RectificationError, SizeError
from opencv_tools.image_codecs import convert_image, decode_compressed
from opencv_tools.rectification import Rectifier
from sensor_msgs.msg import CameraInfo
from std_msgs.msg import Header

# Names of targets that mean the encoding of the message.
_UNCHANGED = ('', 'passthrough')
_BRIDGE = CvBridge()


class Frame:
    """
    A received image. All arrays are read-only; draw on ``frame.image.copy()``.

    An array without a conversion is a view of the message, which stays in memory as long as any
    view of it.
    """

    def __init__(
        self, message: WireMessage, target: str = '', receive_ns: int = 0,
        camera_info: CameraInfo | None = None, rectifier: Rectifier | None = None,
    ) -> None:
        """
        Decode and convert a message.

        :param message: raw or compressed image as plain values.
        :param target: as for ``to``.
        :param receive_ns: time of reception in nanoseconds of the system clock.
        :param camera_info: calibration with the same stamp.
        :param rectifier: maps of the camera; None to compute them for this frame alone.
        :raises CvBridgeError: the message is not a valid image, or cannot be converted.
        :raises CodecError: an image has no pixel, or a compressed image cannot be decoded.
        """
        self._message = message
        #: Time of reception in nanoseconds of the system clock.
        self.receive_ns = receive_ns
        #: Calibration with the same stamp, if it was requested; otherwise None.
        self.camera_info = camera_info
        self._rectifier = rectifier
        #: Encoding of ``raw``.
        self.raw_encoding: str
        if isinstance(message, WireCompressedImage):
            self._raw, encoding = decode_compressed(message.data, message.format)
            self.raw_encoding = encoding.name
        else:
            if not message.width or not message.height:
                raise SizeError(f'the image has {message.width}x{message.height} pixels')
            self._raw = _BRIDGE.imgmsg_to_cv2(message)
            self.raw_encoding = message.encoding
        self._raw.setflags(write=False)
        #: The image in the requested encoding: (h, w) for one channel, (h, w, c) otherwise.
        self.image = self.to(target)
        self._target = self.raw_encoding if target in _UNCHANGED else target

    @property
    def raw(self) -> NDArray[Any]:
        """Return the image in the encoding of the message, (h, w) or (h, w, c)."""
        return self._raw

    @property
    def encoding(self) -> str:
        """Return the encoding of ``image``."""
        return self._target

    @cached_property
    def gray(self) -> NDArray[Any]:
        """
        Return the image as ``mono8``, (h, w) uint8, computed once.

        :raises CvBridgeError: the image cannot be converted.
        """
        return self.to('mono8')

    @cached_property
    def rectified(self) -> NDArray[Any]:
        """
        Return ``image`` without the distortion of the lens, computed once.

        It has the encoding of ``image``; Bayer and YUV images become ``bgr8``, or ``bgr16`` with
        16 bits. Generic types, such as ``32FC1``, get the nearest pixels.

        :raises RectificationError: the frame has no camera_info, or it has no calibration of this
            image.
        """
        rectified, _ = (self._rectifier or Rectifier()).rectify(
            self.image, find_encoding(self._target), _required(self.camera_info, 'be rectified'))
        rectified.flags.writeable = False
        return rectified

    def points(self) -> NDArray[np.float32]:
        """
        Return the points in space that an image of depth shows.

        The encoding of the message is ``16UC1`` or ``mono16`` in millimetres, with 0 for no depth,
        or ``32FC1`` in metres, as REP 118 has it. The lens distortion of the camera_info is taken
        off.

        :returns: (h, w, 3) array in metres, in the optical frame of the camera: x to the right, y
            down and z forward; NaN where there is no depth.
        :raises RectificationError: the image is not one of depth, or the camera_info is missing or
            not that of this image.
        """
        if self.raw_encoding not in DEPTH_ENCODINGS:
            raise RectificationError(f'an image of {self.raw_encoding} has no depth: '
                                     f'{enumerated(DEPTH_ENCODINGS)} have')
        rays = (self._rectifier or Rectifier()).rays(
            _required(self.camera_info, 'have points'), self._raw.shape[1], self._raw.shape[0])
        depth = self._raw.astype(np.float32)
        if self.raw_encoding != '32FC1':
            depth *= np.float32(0.001)
        depth[~((depth > 0) & np.isfinite(depth))] = np.nan
        return np.dstack((rays * depth[..., np.newaxis], depth))

    def to(self, encoding: str) -> NDArray[Any]:
        """
        Convert the image.

        :param encoding: name of an encoding; '' or 'passthrough' for that of the message.
        :returns: (h, w) or (h, w, c) array, a view if the encoding is that of the message.
        :raises CvBridgeError: the encoding is unknown, or the conversion is not supported.
        """
        if encoding in _UNCHANGED or encoding == self.raw_encoding:
            return self._raw
        source = find_encoding(self.raw_encoding)
        try:
            converted = convert_image(self._raw, *encodings_between(source, encoding))
        except ImageError as err:
            raise CvBridgeError(str(err)) from err
        converted.flags.writeable = False
        return converted

    @property
    def stamp(self) -> Time:
        """Stamp of the image."""
        return Time(sec=self._message.header.sec, nanosec=self._message.header.nanosec)

    @property
    def stamp_ns(self) -> int:
        """Stamp of the image in nanoseconds."""
        return self._message.header.stamp_ns

    @property
    def frame_id(self) -> str:
        """Coordinate frame of the camera."""
        return self._message.header.frame_id

    @property
    def header(self) -> Header:
        """Stamp and coordinate frame as a message."""
        return Header(stamp=self.stamp, frame_id=self.frame_id)

    @property
    def description(self) -> str:
        """Size and encoding as text, such as ``640x480 bgr8``."""
        return self._message.description


def wire_header(frame: Frame) -> WireHeader:
    """Return the stamp and the coordinate frame of a frame as plain values."""
    return frame._message.header


def check_target(encoding: str) -> None:
    """
    Check the name of an encoding to which frames will be converted.

    :param encoding: as for ``Frame.to``.
    :raises EncodingError: the name is unknown.
    """
    if encoding not in _UNCHANGED:
        find_encoding(encoding)


def _required(info: CameraInfo | None, use: str) -> CameraInfo:
    if info is None:
        raise RectificationError(f'a frame without camera_info cannot {use}: give '
                                 'camera_info=True to receive_frames')
    return info
