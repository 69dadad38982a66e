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
The errors of recordings.

::

    RecordingError       an output folder cannot be used
    LimitReached         a recording has reached its limits
    ImageError           see opencv_tools.image.errors
    ├─ UnwritableError   a file format cannot hold a frame
    └─ VideoError        the error of opencv_tools.image.errors, which is importable here too
"""

from __future__ import annotations

from typing import Literal

from opencv_tools.image.errors import ImageError, VideoError

__all__ = ['LimitReached', 'RecordingError', 'UnwritableError', 'Unwritten', 'VideoError',
           'error_text']


class RecordingError(Exception):
    """An output folder cannot be used; the message includes the reason."""


class LimitReached(Exception):
    """A recording has reached its limits."""


class UnwritableError(ImageError):
    """A file format cannot hold a frame; the message names one that can."""


def error_text(err: Exception) -> str:
    """Return the text of an error, without a file name that differs for every frame."""
    return (err.strerror if isinstance(err, OSError) else str(err)) or type(err).__name__


class Unwritten(str):
    """The reason why a frame, or a part of a batch of messages, was not written."""

    #: The count that has it.
    kind: Literal['dropped', 'failed', 'not processed', 'skipped']

    def __new__(
        cls, reason: str, kind: Literal['dropped', 'failed', 'not processed', 'skipped'],
    ) -> Unwritten:
        """Create a reason."""
        created = super().__new__(cls, reason)
        created.kind = kind
        return created
