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

"""Publisher of arrays."""

from __future__ import annotations

from threading import Lock
from typing import Any

import numpy as np
from numpy.typing import NDArray
from opencv_tools.base.logs import Log
from opencv_tools.base.units import NANO
from opencv_tools.frames.frame import Frame, wire_header
from opencv_tools.frames.loan import LoanedFrame
from opencv_tools.image.cdr import WireHeader
from opencv_tools.image.compressed_depth import (
    DEFAULT_DEPTH, DepthSettings, Quantisation, quantisation_loss, why_no_depth)
from opencv_tools.image.encodings import (
    declared_encoding, Encoding, find_encoding, generic_encoding)
from opencv_tools.image.errors import EncodingError, VideoError
from opencv_tools.image.layout import array_to_wire
from opencv_tools.image.picture_formats import (
    COMPRESSED_FORMATS, jpeg_loss, why_not_compressed)
from opencv_tools.image_codecs import encode_compressed, encode_depth
from opencv_tools.topics.errors import ParameterError
from opencv_tools.topics.frame_topics import FrameTopics
from opencv_tools.transport.shared_frames.writer import Slot
from opencv_tools.video.settings import VideoSettings
from rclpy.node import Node
from std_msgs.msg import Header

_ENCODINGS = {('uint8', 1): 'mono8', ('uint8', 3): 'bgr8', ('uint8', 4): 'bgra8'}


class FramePublisher:
    """
    Publish arrays as raw and compressed images, and compute nothing without subscribers.

    The topics have the names of image_transport. The profile is reliable with depth 10; the
    ``qos_overrides`` parameters of the node change it. Several threads may publish.
    """

    def __init__(
        self, node: Node, topic: str, *, quality: int = 80, video: VideoSettings | None = None,
        compressed_format: str = 'auto', depth: DepthSettings = DEFAULT_DEPTH,
    ) -> None:
        """
        Create the publishers.

        :param topic: name of the topic of the raw images; compressed images are on
            ``<topic>/compressed``.
        :param quality: quality of JPEG, 1 to 100.
        :param video: settings of the video on ``<topic>/ffmpeg`` and ``<topic>/foxglove``; None
            for no such topics.
        :param compressed_format: ``'auto'``: JPEG, or PNG for images that JPEG would reduce to 8
            bits without alpha. ``'jpeg'`` reduces them, ``'png'`` is lossless.
        :param depth: codec and largest depth of ``<topic>/compressedDepth``.
        :raises ParameterError: the name of the topic, the quality, the format, the video or the
            depth is invalid, or the ``qos_overrides`` parameters of the topic cannot be used.
        """
        if type(quality) is not int or not 1 <= quality <= 100:
            raise ParameterError(f'quality is {quality!r}: give a number from 1 to 100')
        if not isinstance(video, VideoSettings | None):
            raise ParameterError(f'video is {video!r}: give VideoSettings(), or None for no video')
        if not isinstance(depth, DepthSettings):
            raise ParameterError(f'depth is {depth!r}: give DepthSettings(), such as '
                                 "DepthSettings('rvl', 20.0)")
        try:
            if video:
                # It needs OpenCV, which publishers without video do not need.
                from opencv_tools.video.encoder import check_encoder
                check_encoder(video)
        except VideoError as err:
            raise ParameterError(f'video: {err}') from err
        if compressed_format not in COMPRESSED_FORMATS:
            raise ParameterError(f'compressed_format is {compressed_format!r}: give one of '
                                 f'{", ".join(COMPRESSED_FORMATS)}')
        self._node = node
        self._quality = quality
        self._format = compressed_format
        self._depth_settings = depth
        self._unseen = self._unfit = 0
        self._lock = Lock()
        self._log = Log(node.get_logger())
        self._topics = FrameTopics(node, topic, video)
        #: Encoded video, whose settings may be changed; None without video.
        self.video = self._topics.video.stream if self._topics.video else None

    @property
    def topic_name(self) -> str:
        """Name of the topic of the raw images after remapping."""
        return str(self._topics.images.topic_name)

    @property
    def has_subscribers(self) -> bool:
        """Whether a raw or compressed image would be received, or is asked for."""
        return self._topics.has_subscribers

    @property
    def without_subscribers(self) -> int:
        """Return the number of images that were not sent, because nobody had subscribed."""
        return self._unseen

    @property
    def without_form(self) -> int:
        """Return the number of images that were sent in no form that had subscribers."""
        return self._unfit

    @property
    def sent(self) -> dict[str, int]:
        """Return the number of images by topic, see `FrameTopics.sent`."""
        return self._topics.sent

    def publish(
        self, image: NDArray[np.generic], source: Frame | Header | None = None, *,
        encoding: str = '',
    ) -> None:
        """
        Publish an array on the topics that have subscribers.

        :param image: (h, w) or (h, w, c) array of any strides; it must not change during the
            call.
        :param source: frame or header whose stamp and coordinate frame the message gets; None for
            the time of the node and no coordinate frame.
        :param encoding: encoding of the array; '' for ``mono8``, ``bgr8`` or ``bgra8`` if it has
            8 bits, otherwise its generic type, such as ``16UC1``.
        :raises EncodingError: the encoding is unknown or does not fit the array.
        :raises TypeError: ``image`` is not an array, or ``source`` neither a frame nor a header.
        """
        self._publish(image, _encoding_of(image, encoding), source)

    def loan(
        self, height: int, width: int, encoding: str = 'bgr8',
        source: Frame | Header | None = None,
    ) -> LoanedFrame:
        """
        Lend an image to fill, which is published without a copy for subscribers on this machine.

        ::

            with publisher.loan(480, 640, 'bgr8', frame) as loan:
                cv2.flip(frame.image, 1, dst=loan.image)

        :param height: height in pixels.
        :param width: width in pixels.
        :param source: as for ``publish``; the block may set it, too.
        :returns: the frame, for one ``with`` block; several blocks may be open at once.
        :raises EncodingError: the encoding is unknown.
        :raises LayoutError: the encoding has no image of this size, or no message has so much.
        """
        if not isinstance(encoding, str):
            raise EncodingError(f"encoding is {encoding!r}: give a name, such as 'bgr8'")
        found = find_encoding(encoding)
        return LoanedFrame(
            height, width, found, source=source, lend=self._topics.shared.lend, log=self._log,
            publish=lambda image, source, slot: self._publish(image, found, source, slot))

    def _publish(
        self, image: NDArray[Any], encoding: Encoding, source: Frame | Header | None,
        slot: Slot | None = None,
    ) -> None:
        header = self._header_of(source)
        video = self._topics.video
        compressed, depth = self._topics.compressed, self._topics.depth
        if slot and self._topics.has_other_subscribers:
            slot = None  # another thread may get the memory before the image is compressed
        is_sent = self._topics.publish_raw(
            lambda _: (array_to_wire(image, encoding, header, slot.data if slot else None), slot),
        ) is not None
        # The image is on its way. A lent one is not read any more.
        if compressed.is_due(why_not_compressed(
                encoding, image.shape[1], encoding.height(image.shape[0]),
                self._format)) and slot is None:
            is_sent |= compressed.publish(
                lambda: encode_compressed(image, encoding, self._format, self._quality), header,
                jpeg_loss(encoding, self._format))
        if depth.is_due(why_no_depth(encoding.name)) and slot is None:
            is_sent |= depth.publish(
                lambda: self._depth(image, encoding), header,
                quantisation_loss(image, self._depth_settings.farthest))
        if video and slot is None:
            is_sent |= bool(video.publish(lambda: (image, encoding.name), header))
        if not is_sent:
            is_wanted = self._topics.has_subscribers
            with self._lock:
                self._unfit += is_wanted
                self._unseen += not is_wanted

    def _header_of(self, source: Frame | Header | None) -> WireHeader:
        """Return the header of a frame, or one with the time of the node."""
        if isinstance(source, Frame):
            return wire_header(source)
        if source is None:
            return WireHeader(*divmod(self._node.get_clock().now().nanoseconds, NANO), '')
        if not isinstance(source, Header):
            raise TypeError(f'the source of a frame is {source!r}: give a Frame, a Header or None')
        return WireHeader(source.stamp.sec, source.stamp.nanosec, source.frame_id)

    def _depth(self, image: NDArray[np.generic], encoding: Encoding) -> tuple[bytes, str]:
        native = np.ascontiguousarray(image, np.dtype(encoding.dtype).newbyteorder('='))
        return encode_depth(
            native, encoding.name, self._depth_settings.codec,
            Quantisation.up_to(self._depth_settings.farthest))

    def destroy(self) -> None:
        """Remove the publishers."""
        self._topics.destroy()


def _encoding_of(image: NDArray[np.generic], name: str) -> Encoding:
    """
    Return the encoding with a name, or the usual encoding of an array without a name.

    :raises EncodingError: the encoding does not fit the array.
    :raises TypeError: ``image`` is not an array.
    """
    if not isinstance(image, np.ndarray):
        raise TypeError(f'an array is needed, not {type(image).__name__}')
    if not name:
        channels = image.shape[2] if image.ndim == 3 else 1
        name = _ENCODINGS.get((image.dtype.name, channels), '')
    return declared_encoding(image, name) if name else generic_encoding(image)
