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

"""Names of the topics beside an image topic, as in image_transport and image_proc."""

from __future__ import annotations

from collections.abc import Callable

#: Last parts of the names of topics with the same images.
IMAGE_SUFFIXES = ('compressed', 'compressedDepth', 'ffmpeg', 'foxglove')

_MAX_NAME = 247  # characters that rmw allows


def image_topic(topic: str) -> str:
    """Return the image topic beside a topic of compressed images or video."""
    base, _, suffix = topic.rpartition('/')
    return base if base and suffix in IMAGE_SUFFIXES else topic


def camera_info_topics(topic: str) -> tuple[str, ...]:
    """
    Return the topics of camera_info that may belong to a topic of images or video, best first.

    :returns: ``<image topic>/camera_info`` as beside rectified images, if the name is not too
        long, and the one in the folder of the image topic.
    """
    images = image_topic(topic)
    own, beside = f'{images}/camera_info', f'{images.rpartition("/")[0]}/camera_info'
    return (own, beside) if len(own) <= _MAX_NAME else (beside,)


def camera_info_topic(topic: str, exists: Callable[[str], object] = lambda _: False) -> str:
    """
    Return the topic of the camera_info that belongs to a topic of images or video.

    :param exists: returns whether somebody publishes a topic, or a bag has it.
    :returns: the best one of `camera_info_topics` that exists, or the last one.
    """
    *others, last = camera_info_topics(topic)
    return next(filter(exists, others), last)
