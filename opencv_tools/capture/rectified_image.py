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

"""The rectified forms in which a captured frame is published."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray
from opencv_tools.capture.frame import CapturedFrame
from opencv_tools.capture.output_image import expected_encoding, OutputImage
from opencv_tools.image.encodings import Encoding, find_encoding
from opencv_tools.rectification import Rectifier

_NO_PIXELS = np.empty((0, 0), np.uint8)  # they come from another image


class RectifiedImage(OutputImage):
    """An image without the distortion of the lens, computed on first use and cached."""

    def __init__(
        self, source: OutputImage, camera_info: Callable[[], Any], rectifier: Rectifier,
    ) -> None:
        """
        Keep an image; nothing is computed yet.

        :param source: the image, as it is published.
        :param camera_info: returns the sensor_msgs/CameraInfo of the image.
        """
        super().__init__(
            CapturedFrame(_NO_PIXELS, expected_encoding(source)),
            replace(source.settings, encoding='', flip='none', rotate=0))
        self._source = source
        self._camera_info = camera_info
        self._rectifier = rectifier

    @cached_property
    def _pixels(self) -> tuple[NDArray[Any], Encoding]:
        return self._rectifier.rectify(
            self._source.image, find_encoding(self._source.encoding), self._camera_info(),
            self.lend)
