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

"""The error of data sets."""

from __future__ import annotations

from opencv_tools.base.text import MAX_PATH, printable


class DatasetError(ValueError):
    """A data set cannot be written or read. The message contains the reason and the remedy."""


class UnreadableError(DatasetError):
    """A bag cannot be opened, whatever the arguments are."""


def reason_of(err: Exception) -> str:
    """Return the printable reason of an error, without the number of FFmpeg or the system."""
    return printable(getattr(err, 'strerror', None) or err)


def os_reason(err: OSError) -> str:
    """Return the file and the reason of an error of the operating system; pyarrow sets neither."""
    reason = printable(err.strerror or err, MAX_PATH)
    return f'{printable(err.filename, MAX_PATH)}: {reason}' if err.filename else reason
