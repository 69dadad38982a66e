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

"""Write the stamp and the mean brightness of every image to a file: brightness.csv."""

from __future__ import annotations

from pathlib import Path
import sys

from opencv_tools.frames import Frame, FrameNode, main


class Brightness(FrameNode):
    """Receive every frame of ``video_frames`` and write a line for it."""

    def __init__(self) -> None:
        """Open the file and subscribe."""
        super().__init__('brightness')
        self.file = Path('brightness.csv').open('w', encoding='utf-8')  # noqa: SIM115
        self.receive_frames('video_frames', self.on_frame, encoding='mono8', every=True,
                            depth=100, threaded=True)

    def on_frame(self, frame: Frame) -> None:
        """Write a line for a frame."""
        self.file.write(f'{frame.stamp_ns},{frame.image.mean():.3f}\n')
        self.file.flush()

    def close(self) -> int:
        """Unsubscribe, then close the file."""
        status = super().close()
        self.file.close()
        return status


if __name__ == '__main__':
    sys.exit(main(Brightness))
