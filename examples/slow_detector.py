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

"""Detect QR codes in the newest image; the detector is slower than the camera."""

from __future__ import annotations

import sys

import cv2
from opencv_tools.frames import Frame, FrameNode, main
from std_msgs.msg import String


class Detector(FrameNode):
    """
    Receive ``video_frames`` and publish ``detections``, the texts of QR codes.

    The detector has a thread of its own, so that parameters and services are not delayed.
    """

    def __init__(self) -> None:
        """Subscribe and create the publisher."""
        super().__init__('detector')
        self.count = 0
        self.detector = cv2.QRCodeDetector()
        self.detections = self.create_publisher(String, 'detections', 10)
        self.frames = self.receive_frames(
            'video_frames', self.on_frame, encoding='mono8', threaded=True)
        self.create_timer(1.0, self.on_timer)

    def on_frame(self, frame: Frame) -> None:
        """Publish the text of the QR code in a frame, '' without one."""
        text, _, _ = self.detector.detectAndDecode(frame.image)
        self.detections.publish(String(data=text))
        self.count += 1

    def on_timer(self) -> None:
        """Log the progress."""
        self.get_logger().info(f'{self.count} frames searched, {self.frames.skipped} skipped')


if __name__ == '__main__':
    sys.exit(main(Detector))
