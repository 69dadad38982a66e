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

"""
The errors of sources.

::

    CaptureError          the source cannot be opened, or has failed permanently
    ├─ TopicError         the topic of a bag has to be selected, or is not in it
    ├─ UnavailableError   the camera or stream is unavailable now, but may come back
    └─ BrokenFrameError   one frame is unreadable; the next one may be readable
"""

from __future__ import annotations


class CaptureError(Exception):
    """A source cannot be used. The message names the source and the remedy."""


class TopicError(CaptureError):
    """A bag has several topics of images, or not the selected one."""


class UnavailableError(CaptureError):
    """A camera or stream is disconnected, busy or not permitted now, and may come back."""


class BrokenFrameError(CaptureError):
    """
    One frame, or the rest of a file, cannot be read. The source can still be used.

    ``frames`` is the number of frames that are lost.
    """

    def __init__(self, reason: str, frames: int = 1) -> None:
        super().__init__(reason)
        self.frames = frames
