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

"""Topics and messages of a bag, and the interface of its readers."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator
from dataclasses import dataclass, field
from typing import Any, Protocol

from opencv_tools.image.cdr import COMPRESSED_IMAGE, IMAGE
from opencv_tools.video.messages import VIDEO_TOPICS

#: Largest chunk or message in bytes that is read. A reader holds at most four of them.
MAX_BYTES = 3 << 26

#: Most characters of the definition or the quality of service of a topic that are read.
MAX_TEXT = 1 << 18

_MAX_TEXTS = 1 << 23  # bytes of all these texts of a file

#: Serialization of messages that can be read.
CDR = 'cdr'

#: Encoding of the definitions that can be read.
ROS2MSG = 'ros2msg'


class Texts:
    """
    Definitions and qualities of service of the topics of a file, with a limit of their memory.

    A compressed file of some kilobytes may have thousands of topics with large texts.
    """

    def __init__(self) -> None:
        self._kept: dict[bytes, str] = {}
        self._bytes = 0

    def keep(self, data: bytes) -> str:
        """Return a text, one object for equal ones; '' if it or all together are too long."""
        text = self._kept.get(data)
        if text is None:
            if len(data) > MAX_TEXT or self._bytes + len(data) > _MAX_TEXTS:
                return ''
            self._bytes += len(data)
            text = self._kept[data] = data.decode(errors='replace')
        return text


@dataclass(frozen=True)
class BagTopic:
    """
    A topic of a bag.

    :param type_name: type of the messages, such as ``sensor_msgs/msg/Image``.
    :param serialization: serialization of the messages, such as ``cdr``.
    :param definition: text of the type, with those that it contains; '' if the bag has none, or
        too much text.
    :param qos: YAML text with the quality of service of its publishers; '' if unknown.
    :param type_hash: hash of the type, such as ``RIHS01_...``; '' if unknown.
    :param other_schema: encoding and text of a definition that is only copied, such as IDL.
    """

    name: str
    type_name: str
    serialization: str = CDR
    definition: str = field(default='', compare=False, repr=False)
    qos: str = field(default='', compare=False, repr=False)
    type_hash: str = field(default='', compare=False, repr=False)
    other_schema: tuple[str, ...] = field(default=(), compare=False, repr=False)

    def __post_init__(self) -> None:
        """Add ``/msg/`` to the name of the type, which bags of ROS 2 Dashing leave out."""
        package, slash, kind = self.type_name.partition('/')
        if self.serialization == CDR and slash and '/' not in kind:
            object.__setattr__(self, 'type_name', f'{package}/msg/{kind}')

    @property
    def has_images(self) -> bool:
        """Return whether the messages are images or video that can be read."""
        return (self.type_name in (IMAGE, COMPRESSED_IMAGE, *VIDEO_TOPICS)
                and self.serialization == CDR)


@dataclass(frozen=True)
class BagMessage:
    """
    A message of a bag.

    :param log_ns: time of the recording in nanoseconds.
    :param load: returns a buffer with the serialized message, while the bag is open; raises
        BagError or OSError if it cannot be read.
    :param publish_ns: time of publication in nanoseconds; 0 if unknown.
    :param number: number of the message from its publisher; 0 if unknown.
    :param place: number that is larger for messages that are later in the file.
    """

    topic: BagTopic
    log_ns: int
    load: Callable[[], Any]
    publish_ns: int = 0
    number: int = 0
    place: int = 0


@dataclass(frozen=True)
class Damage:
    """
    A part of a bag that cannot be read.

    :param reason: what is wrong, and where.
    """

    reason: str


class BagReader(Protocol):
    """
    A bag that is open for reading.

    ``topics`` has the number of messages of each topic. ``first_ns`` and ``last_ns`` are the
    times of the first and the last message. ``metadata`` has the name and the contents of each
    metadata record. ``attachments`` is the number of files in it. ``warning`` describes a bag
    that is cut off; '' for a complete bag.
    """

    topics: dict[BagTopic, int]
    first_ns: int
    last_ns: int
    metadata: list[tuple[str, dict[str, str]]]
    attachments: int
    warning: str

    def messages(self, topics: Collection[BagTopic]) -> Iterator[BagMessage | Damage]:
        """
        Yield the messages of some topics, in the order of their times.

        :param topics: topics to read.
        :raises BagError: the file cannot be read any more.
        """

    def close(self) -> None:
        """Close the file."""
