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

"""OpenCV, which is imported when it is used first: that takes as long as the rest of a node."""

from __future__ import annotations

from importlib import import_module
from importlib.util import find_spec
from typing import Any, TYPE_CHECKING

if TYPE_CHECKING or find_spec('cv2') is None:
    import cv2 as cv2  # or raise the error now, and not with the first image
else:
    class _Later:

        def __getattr__(self, name: str) -> Any:
            return getattr(import_module('cv2'), name)

    cv2 = _Later()
