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

"""Options of a subscription."""

from __future__ import annotations

from dataclasses import dataclass

from opencv_tools.image.image_size import MAX_PIXELS
from opencv_tools.transport.shared_frames.memory import MAX_DEPTH
from opencv_tools.transport.shared_frames.reader import MAX_VIEWS


@dataclass(frozen=True, kw_only=True)
class SubscriptionOptions:
    """
    Options of a subscription.

    :param transport: one of ``TRANSPORTS``.
    :param depth: number of frames that may wait, 1 for the newest one; None to keep every frame,
        up to the limit of the middleware.
    :param threaded: whether a thread of the subscription calls the callbacks, not the executor.
    :param camera_info: whether a frame waits for the calibration with the same stamp.
    :param prefers_compressed: whether ``auto`` prefers compressed images.
    :param decodes_video: whether the frames of video topics are decoded; else they are messages
        with video.
    :param max_pixels: maximum number of pixels of a picture of video.
    :param max_views: number of frames that may stay in the shared memory; more are copied.
    """

    transport: str = 'auto'
    depth: int | None = 1
    threaded: bool = False
    camera_info: bool = False
    prefers_compressed: bool = False
    decodes_video: bool = True
    max_pixels: int = MAX_PIXELS
    max_views: int = MAX_VIEWS

    @property
    def capacity(self) -> int:
        """Largest number of frames that may wait in the queue."""
        return self.depth or MAX_DEPTH

    @property
    def has_image_topic(self) -> bool:
        """Whether frames may arrive by an image topic."""
        return self.transport != 'shm'
