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

"""Publish the edges of each image: the newest one, and only while somebody subscribes."""

from __future__ import annotations

import sys

import cv2
from opencv_tools.frames import Frame, FrameNode, main


class Edges(FrameNode):
    """Receive ``video_frames`` and publish ``edges``."""

    def __init__(self) -> None:
        """Subscribe and create the publisher."""
        super().__init__('edges')
        self.edges = self.publish_frames('edges')
        self.receive_frames('video_frames', self.on_frame)

    def on_frame(self, frame: Frame) -> None:
        """Publish the edges of a frame with its stamp."""
        if self.edges.has_subscribers:
            self.edges.publish(cv2.Canny(frame.gray, 50, 150), frame)


if __name__ == '__main__':
    sys.exit(main(Edges))
