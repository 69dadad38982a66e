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

"""The errors of this package; all have the base class ``ImageError``."""

from __future__ import annotations


class ImageError(ValueError):
    """An image cannot be read or converted. The message contains the reason."""


class EncodingError(ImageError):
    """An encoding is unknown."""


class LayoutError(ImageError):
    """The size, step and data of an image contradict each other."""


class ConversionError(ImageError):
    """A conversion between two encodings is not supported."""
