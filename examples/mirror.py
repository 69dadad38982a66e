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

"""Mirror every image of ``video_frames`` into the memory where subscribers read the result."""

from __future__ import annotations

import sys
from typing import Any

import cv2
from numpy.typing import NDArray
from opencv_tools.frames import run_filter


def mirror(image: NDArray[Any], out: NDArray[Any]) -> None:
    """Fill ``out``, which has the shape of the image."""
    cv2.flip(image, 1, dst=out)


if __name__ == '__main__':
    sys.exit(run_filter(mirror, 'video_frames', 'mirrored'))
