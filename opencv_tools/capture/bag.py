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

"""Bags as a source: the images of one topic, with the times and headers of the bag."""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from opencv_tools.bags.compression import decompressed_message
from opencv_tools.bags.errors import BagError
from opencv_tools.bags.open_bag import Bag
from opencv_tools.bags.reading import BagMessage, BagTopic, CDR, Damage
from opencv_tools.bags.schemas import CAMERA_INFO
from opencv_tools.base.text import enumerated, MAX_PATH, printable
from opencv_tools.base.units import NANO
from opencv_tools.capture.bag_video import BagVideo
from opencv_tools.capture.errors import BrokenFrameError, CaptureError, TopicError
from opencv_tools.capture.frame import CapturedFrame, JPEG, MAX_RATE, Recorded
from opencv_tools.image.cdr import cdr_to_image, IMAGE, WireMessage
from opencv_tools.image.encodings import find_encoding
from opencv_tools.image.errors import ImageError
from opencv_tools.image.layout import view_pixels
from opencv_tools.image.topic_names import camera_info_topic
from opencv_tools.video.messages import WireVideo

_REMEDY = 'set bag_topic, or --topic of the command, to one of'
_MAX_LISTED = 10  # topics in an error message
_MAX_INFO = 1 << 20  # bytes of a calibration


class BagSource:
    """
    The images of one topic of a bag, in the order of their times.

    Several files are read one after the other, in the order of ``metadata.yaml`` or else in
    natural order.
    """

    live: Literal[False] = False

    def __init__(self, path: Path, topic: str | None = '', files: Sequence[Path] = (),
                 ) -> None:
        """
        Open a bag and select a topic.

        :param path: path of a file, or of a folder of rosbag2.
        :param topic: topic of the images; '' for the only one, None for any.
        :param files: files of the bag; empty for those of the path.
        :raises CaptureError: the bag cannot be read, or the topic cannot be selected.
        """
        self.name = printable(path, MAX_PATH)
        self._play = 0
        try:
            self._bag = Bag(path, files)
        except (BagError, OSError) as err:
            raise _error(self.name, err) from err
        counts = self._bag.topics
        #: Files of the bag, in their order.
        self.paths = self._bag.paths
        #: Sentences about parts of the bag that are missing.
        self.warnings = self._bag.warnings
        #: Name and contents of each metadata record.
        self.metadata = self._bag.metadata
        #: Number of attachments of the bag.
        self.attachments = self._bag.attachments
        #: Topic of the images.
        self.topic = _select(self.name, topic, counts)
        #: Number of messages of each topic of the bag.
        self.topics = counts
        #: Decoder of a topic of video.
        self.video = BagVideo(self.topic.type_name)
        #: Topic of the calibration, which the bag may lack.
        self.info_topic = camera_info_topic(
            self.topic.name, lambda name: BagTopic(name, CAMERA_INFO) in counts)
        info = BagTopic(self.info_topic, CAMERA_INFO)
        self._wanted = [self.topic, *({info} & counts.keys())]
        self.count = counts[self.topic]
        seconds = (self._bag.last_ns - self._bag.first_ns) / NANO
        rate = (self.count - 1) / seconds if seconds > 0 else 0.0
        self.rate = rate if 0 < rate <= MAX_RATE else 0.0
        self.description = (
            f'{self.count} frames of {printable(self.topic.name)} ({self.topic.type_name}) at '
            f'{self.rate:.3g} Hz')
        self._messages = self._bag.messages(self._wanted)
        self._next: deque[BagMessage | Damage] = deque()
        self._missing = self.count  # images and damaged parts that were not found yet
        self._skipped_damage: list[BrokenFrameError] = []
        self._last_info: Any = None

    def skip(self) -> bool:
        while True:
            try:
                message = self._next_image()
                if message is not None and self.video.needs_skipped:
                    with suppress(BagError, ImageError, OSError):  # of a frame that nobody wants
                        self.video.skip(decompressed_message(message.load()), message.number)
                return message is not None
            except BrokenFrameError as err:
                self._skipped_damage.append(err)  # the next call of read reports it

    def read(self) -> CapturedFrame | None:
        if self._skipped_damage:
            raise self._skipped_damage.pop()
        message = self._next_image()
        if message is None:
            return None
        try:
            serialized = decompressed_message(message.load())
            return self._frame(message, serialized, self._find_camera_info(serialized))
        except (BagError, ImageError, OSError) as err:
            if isinstance(err, (BagError, OSError)):
                self.video.restart()
            raise BrokenFrameError(f'{self.name}: a message of {printable(self.topic.name)} '
                                   f'cannot be read: {err}') from err

    read_ahead = read

    def rewind(self) -> None:
        self.close()
        self._play += 1
        self._messages = self._bag.messages(self._wanted)
        self._next.clear()
        self._skipped_damage.clear()
        self._missing = self.count
        self.video.restart()
        self._last_info = None

    def close(self) -> None:
        self._bag.close()

    def _next_image(self) -> BagMessage | None:
        """
        Return the next image of the bag, which is not loaded; None at its end.

        :raises BrokenFrameError: a part of the bag is damaged, or images are missing at its end.
        """
        while self._next or self._look_ahead():
            item = self._next.popleft()
            if isinstance(item, Damage):
                self.video.restart()
                self._missing -= 1
                raise BrokenFrameError(item.reason)
            if item.topic == self.topic:
                self._missing -= 1
                return item
            self._use_camera_info(item)
        missing, self._missing = self._missing, 0
        if missing > 0:
            raise BrokenFrameError(f'{self.name}: {missing} more frames were in damaged parts',
                                   missing)
        return None

    def _look_ahead(self) -> bool:
        """Read the head of another message; return False at the end of the bag."""
        try:
            item = next(self._messages, None)
        except (BagError, OSError) as err:
            raise _error(self.name, err) from err
        if item is not None:
            self._next.append(item)
        return item is not None

    def _find_camera_info(self, image: Any) -> Any:
        """Return the calibration with the stamp of an image, else the last one before it."""
        while len(self._wanted) > 1 and (
                self._last_info is None or _stamp(self._last_info) != _stamp(image)):
            if not self._next and not self._look_ahead():
                break
            item = self._next[0]
            if isinstance(item, Damage) or item.topic == self.topic:
                break
            self._next.popleft()
            self._use_camera_info(item)
        return self._last_info

    def _use_camera_info(self, message: BagMessage) -> None:
        """Keep a calibration for the images that follow; skip one that cannot be read."""
        with suppress(BagError, OSError):
            serialized = decompressed_message(message.load())
            if len(serialized) <= _MAX_INFO:
                self._last_info = bytes(serialized)  # a view would keep its chunk in memory

    def _frame(self, message: BagMessage, serialized: Any, camera_info: Any) -> CapturedFrame:
        """Return the frame of a message, as a view of its data; video is decoded."""
        wire, image, encoding = read_picture(
            self.topic.type_name, serialized, self.video, message.number)
        return CapturedFrame(
            image, encoding, position=(message.log_ns - self._bag.first_ns) / NANO,
            recorded=Recorded(message=wire, topic=self.topic.name, log_ns=message.log_ns,
                              play=self._play, publish_ns=message.publish_ns,
                              number=message.number, camera_info=camera_info,
                              info_topic=self.info_topic, serialized=serialized))


def read_picture(type_name: str, serialized: Any, video: BagVideo, number: int,
                 ) -> tuple[WireMessage | WireVideo, NDArray[Any], str]:
    """
    Read a message with an image or with video.

    :param number: number of the message from its publisher; 0 if unknown.
    :returns: the message, its image and its encoding as in ``CapturedFrame``; a view of the buffer
        unless video is decoded.
    :raises ImageError: the message cannot be read.
    """
    if type_name == IMAGE:
        raw = cdr_to_image(serialized)
        return raw, view_pixels(raw.data, raw.height, raw.width, raw.step,
                                find_encoding(raw.encoding), raw.is_bigendian), raw.encoding
    wire = video.read(serialized)
    if isinstance(wire, WireVideo):
        return wire, *video.picture(wire, number)
    return wire, np.frombuffer(wire.data, np.uint8), JPEG


def _select(bag: str, name: str | None, counts: Counter[BagTopic]) -> BagTopic:
    """Return the topic with a name, or the only topic of images of a bag."""
    images = [topic for topic in counts if topic.has_images]
    named = [topic for topic in images if name == topic.name] if name else images
    # A topic without messages, as record --all leaves it, is no candidate beside others.
    found = [topic for topic in named if counts[topic]] or named
    if len(found) == 1 or (found and name is None):
        return min(found, key=lambda topic: topic.name)
    if not images:
        others = _listed(counts, list(counts))
        raise CaptureError(f'{bag} has no topic of images; '
                           + (f'its topics are {others}' if others else 'it has no topic'))
    if not found:
        raise TopicError(f'{bag} has no topic {printable(name or "")} of images; '
                         f'{_REMEDY} {_listed(counts, images)}')
    raise TopicError(f'{bag} has {len(found)} topics of images; {_REMEDY} '
                     f'{_listed(counts, found)}')


def _error(bag: str, err: Exception) -> CaptureError:
    reason = err.strerror if isinstance(err, OSError) else err
    return CaptureError(f'{bag} cannot be played: {reason}')


def _listed(counts: Counter[BagTopic], topics: list[BagTopic]) -> str:
    """Return a list of topics with their types and numbers of messages."""
    texts = [f'{printable(topic.name)} ({printable(topic.type_name)}'
             + ('' if topic.serialization == CDR else f' in {printable(topic.serialization)}')
             + f', {counts[topic]} messages)' for topic in sorted(
                 topics, key=lambda topic: topic.name)]
    return enumerated(texts, _MAX_LISTED)


def _stamp(serialized: Any) -> bytes:
    """Return the bytes of the stamp of a message, with its byte order."""
    return bytes(serialized[:2]) + bytes(serialized[4:12])
