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

"""Log of what happens to the source of ``img_publisher``."""

from __future__ import annotations

import math

from opencv_tools.capture.bag import BagSource
from opencv_tools.capture.errors import BrokenFrameError, UnavailableError
from opencv_tools.capture.frame import Source
from opencv_tools.capture.v4l2.camera import CameraSource
from opencv_tools.image.errors import ImageError
from opencv_tools.logs import Log
from opencv_tools.nodes.publisher.camera_controls import CameraControls


class SourceLog:
    """Log the events of a source, in the thread that reads it; see `SourceListener`."""

    def __init__(self, log: Log, topic: str, controls: CameraControls) -> None:
        """
        Wait for the first event.

        :param topic: topic of the frames after remapping.
        :param controls: controls of the camera, which become parameters when it is open.
        """
        #: Number of frames that could not be read or published.
        self.dropped = 0
        self._log = log
        self._topic = topic
        self._controls = controls

    def opened(self, source: Source, is_back: bool) -> None:
        """Log the opened source and any camera settings that could not be applied."""
        if not is_back:
            self._log.info(f'{source.name} opened: {source.description}, '
                           f'publishing to {self._topic}')
        if isinstance(source, (BagSource, CameraSource)):
            for warning in source.warnings:
                self._log.warning(warning)
        if isinstance(source, CameraSource):
            self._controls.camera_opened()

    def lost(self, reason: UnavailableError, longest: float) -> None:
        """Log that the source is unavailable."""
        limit = '' if longest == math.inf else f' for {longest:g} s'
        self._log.error(f'{reason}; waiting for it{limit}')
        self._controls.report_unused()

    def returned(self, source: Source, seconds: float) -> None:
        """Log that the source is available again."""
        self._log.info(f'{source.name} is back after {seconds:.1f} s: {source.description}')

    def broken(self, reason: BrokenFrameError | ImageError) -> None:
        """Count and log a frame that cannot be read or published."""
        self.dropped += 1
        # A camera may send the same broken frame repeatedly.
        self._log.warning(f'frame dropped: {reason}', every=1.0)

    def waiting(self, seconds: float) -> None:
        """Log that the next frame of a file is far away."""
        self._log.info(f'the next image is due in {seconds:.0f} s')
