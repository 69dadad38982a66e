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

"""Sizes of selected pictures of a topic of a bag, by their heads."""

from __future__ import annotations

from collections.abc import Container, Iterator
from contextlib import closing, suppress
from copy import copy

from opencv_tools.bags.compression import decompressed_message
from opencv_tools.bags.open_bag import Bag
from opencv_tools.bags.reading import BagMessage, BagTopic
from opencv_tools.capture.bag_video import BagVideo
from opencv_tools.image.cdr import cdr_to_image, IMAGE, WireCompressedImage
from opencv_tools.image.errors import ImageError
from opencv_tools.image.image_size import image_size


def picture_sizes(bag: Bag, topic: BagTopic, messages: Container[int],
                  ) -> Iterator[tuple[int, int]]:
    """
    Yield the width and height of pictures of a topic by their heads, which are not decoded.

    Those without a readable head, and those of video, are left out.

    :param messages: numbers of messages among those of the topic, from 0.
    :raises BagError: a file cannot be read as a bag.
    :raises OSError: a file cannot be read.
    """
    reader, video, place = copy(bag), BagVideo(topic.type_name), 0
    with closing(reader):
        for item in reader.messages([topic]):
            if not isinstance(item, BagMessage):
                continue
            place += 1
            if place - 1 in messages:
                with suppress(ImageError, OSError):
                    serialized = decompressed_message(item.load())
                    if topic.type_name == IMAGE:
                        raw = cdr_to_image(serialized)
                        yield raw.width, raw.height
                    elif isinstance(wire := video.read(serialized), WireCompressedImage):
                        yield image_size(bytes(wire.data))
