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

"""Publish the images of two cameras side by side, for stamps that are close together."""

from __future__ import annotations

import sys

import numpy as np
from opencv_tools.frames import Frame, FrameNode, main

MAX_DIFFERENCE_NS = 50_000_000


class SideBySide(FrameNode):
    """Receive ``left/video_frames`` and ``right/video_frames``, publish ``both``."""

    def __init__(self) -> None:
        """Subscribe to both cameras and create the publisher."""
        super().__init__('side_by_side')
        self.both = self.publish_frames('both')
        self.newest: dict[str, Frame] = {}
        for side in ('left', 'right'):
            self.receive_frames(
                f'{side}/video_frames', lambda frame, side=side: self.on_frame(side, frame))

    def on_frame(self, side: str, frame: Frame) -> None:
        """Publish both images when their stamps are close together."""
        self.newest[side] = frame
        if len(self.newest) < 2 or not self.both.has_subscribers:
            return
        left, right = self.newest['left'], self.newest['right']
        if (abs(left.stamp_ns - right.stamp_ns) < MAX_DIFFERENCE_NS
                and left.image.shape == right.image.shape):
            self.both.publish(np.hstack((left.image, right.image)), left)
            self.newest.clear()


if __name__ == '__main__':
    sys.exit(main(SideBySide, frame_size=(2 * 1920, 1080)))
