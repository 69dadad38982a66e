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
Estimate of the frame size from the command line, before the node exists.

The profile of Fast DDS depends on the frame size, and is read when the first participant of the
process is created. The parameters of the node are not known by then.
"""

from __future__ import annotations

from collections.abc import Sequence

from opencv_tools.capture.errors import CaptureError
from opencv_tools.capture.source import expected_size
from opencv_tools.image.encodings import find_encoding
from opencv_tools.image.errors import ImageError
from opencv_tools.ros.command_line import given_parameters
from opencv_tools.ros.publisher.parameters import PARAMETERS, PublisherSettings
import yaml

_UNKNOWN_SIZE = (1920, 1080)
_COLOUR = 'bgr8'


def expected_frame_bytes(args: Sequence[str]) -> int:
    """
    Estimate the size of the frames that ``img_publisher`` will publish.

    Patterns and cameras report their size. A file is opened to read its first frame. The size of
    streams, and of arguments that the node will refuse, is assumed to be 1920x1080 in colour.

    :param args: command line.
    :returns: bytes per frame, at least 1.
    """
    try:
        given = given_parameters(args, 'image_publisher')
        settings = PublisherSettings(**{
            parameter.name: parameter.accept(given[parameter.name])
            for parameter in PARAMETERS if parameter.name in given})
        size = expected_size(settings.source, settings.camera_request())
        return max(1, _frame_bytes(size or _UNKNOWN_SIZE, settings.encoding or _COLOUR))
    except (CaptureError, ImageError, OSError, OverflowError, RecursionError, TypeError,
            ValueError, yaml.YAMLError):
        return _frame_bytes(_UNKNOWN_SIZE, _COLOUR)


def _frame_bytes(size: tuple[int, int], encoding: str) -> int:
    width, height = size
    found = find_encoding(encoding)
    return int(found.rows(height) * width * found.pixel_bytes)
