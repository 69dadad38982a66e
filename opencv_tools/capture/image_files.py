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

"""Image files as a source: one file, a folder, or the matches of a glob pattern."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Literal

import numpy as np
from opencv_tools.base.regular_files import read_regular
from opencv_tools.base.text import MAX_PATH, printable
from opencv_tools.capture.errors import BrokenFrameError, CaptureError
from opencv_tools.capture.frame import CapturedFrame, JPEG
from opencv_tools.image.encodings import opencv_encoding
from opencv_tools.image.errors import ImageError
from opencv_tools.image.jpeg import JPEG_SOI
from opencv_tools.image_codecs import decode_image

IMAGE_SUFFIXES = frozenset((
    '.png', '.jpg', '.jpeg', '.jpe', '.jp2', '.bmp', '.dib', '.tif', '.tiff', '.webp', '.pbm',
    '.pgm', '.ppm', '.pnm', '.pxm', '.exr', '.hdr', '.pic', '.sr', '.ras'))

_FILE_BYTES = 1 << 30


class ImageFileSource:
    """A sequence of image files, each with its own depth and channels."""

    rate = 0.0
    live: Literal[False] = False
    warnings = ()

    def __init__(self, paths: Sequence[Path], name: str) -> None:
        """
        Keep the paths; each file is read when its turn comes.

        :param paths: paths of the files in playback order.
        :param name: name of the sequence in messages, such as the folder.
        :raises CaptureError: ``paths`` is empty.
        """
        if not paths:
            raise CaptureError(f'no image file in {printable(name, MAX_PATH)}; supported '
                               f'extensions: {", ".join(sorted(IMAGE_SUFFIXES))}')
        self.name = printable(name, MAX_PATH)
        self.count = len(paths)
        self.description = f'{len(paths)} pictures' if len(paths) > 1 else '1 picture'
        self.paths = tuple(paths)
        #: Whether JPEG files are not decoded.
        self.keeps_jpegs = False
        self._next = 0

    def skip(self) -> bool:
        self._next += 1
        return self._next <= len(self.paths)

    def read(self) -> CapturedFrame | None:
        if self._next >= len(self.paths):
            return None
        path = self.paths[self._next]
        shown = printable(path, MAX_PATH)
        self._next += 1
        try:
            content = read_regular(path, _FILE_BYTES)
            if self.keeps_jpegs and content.startswith(JPEG_SOI):
                return CapturedFrame(np.frombuffer(content, np.uint8), JPEG)
            image = decode_image(content, upright=True)
            return CapturedFrame(image, opencv_encoding(image).name)
        except OSError as err:
            raise BrokenFrameError(f'{shown} cannot be read: {err.strerror}') from err
        except ImageError as err:
            raise BrokenFrameError(f'{shown} cannot be read: {err}') from err

    read_ahead = read

    def rewind(self) -> None:
        self._next = 0

    def close(self) -> None:
        pass
