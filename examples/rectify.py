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

"""Publish each image without the distortion of the lens, by the calibration of its camera."""

from __future__ import annotations

import sys

from opencv_tools.frames import Frame, FrameNode, main, RectificationError


class Rectifier(FrameNode):
    """Receive ``video_frames`` with ``camera_info``, and publish ``rectified``."""

    def __init__(self) -> None:
        """Subscribe and create the publisher."""
        super().__init__('rectifier')
        self.rectified = self.publish_frames('rectified')
        self.receive_frames('video_frames', self.on_frame, camera_info=True)

    def on_frame(self, frame: Frame) -> None:
        """Publish a rectified frame with its stamp."""
        if not self.rectified.has_subscribers:
            return
        try:
            self.rectified.publish(frame.rectified, frame)
        except RectificationError as err:
            self.get_logger().warning(str(err), once=True)


if __name__ == '__main__':
    sys.exit(main(Rectifier))
