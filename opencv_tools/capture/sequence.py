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

"""Pictures as a source: one file, a folder of them, or those that a pattern matches."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
import re
from typing import Any, Literal

import cv2
import numpy as np
from numpy.typing import NDArray
from opencv_tools.capture.frame import BrokenFrameError, CaptureError, Frame
from opencv_tools.image.encodings import picture_encoding
from opencv_tools.image.errors import EncodingError

PICTURE_SUFFIXES = frozenset((
    '.png', '.jpg', '.jpeg', '.jpe', '.jp2', '.bmp', '.dib', '.tif', '.tiff', '.webp', '.pbm',
    '.pgm', '.ppm', '.pnm', '.pxm', '.exr', '.hdr', '.pic', '.sr', '.ras'))

# A JPEG may say which way is up, which OpenCV follows only without IMREAD_UNCHANGED.
_ORIENTED_SUFFIXES = frozenset(('.jpg', '.jpeg', '.jpe'))

_JPEG_BEGINS, _SCAN_BEGINS, _JPEG_ENDS = b'\xff\xd8', b'\xff\xda', b'\xff\xd9'


def natural_order(path: Path) -> list[tuple[bool, int, str]]:
    """Sort key that puts ``frame2`` before ``frame10``."""
    parts = re.split(r'([0-9]+)', path.name)
    return [(not part.isdecimal(), int(part) if part.isdecimal() else 0, part) for part in parts]


class PictureSequence:
    """Picture files, one after the other, in their own depth and channels."""

    rate = 0.0
    live: Literal[False] = False

    def __init__(self, paths: Sequence[Path], name: str) -> None:
        """
        Keep the files, which are read one at a time.

        :param paths: the files in order.
        :param name: what to call the whole.
        :raises CaptureError: there is no file.
        """
        if not paths:
            raise CaptureError(f'there is no picture in {name}; '
                               f'pictures end in {", ".join(sorted(PICTURE_SUFFIXES))}')
        self.name = name
        self.description = f'{len(paths)} pictures' if len(paths) > 1 else '1 picture'
        self._paths = tuple(paths)
        self._next = 0

    def skip(self) -> bool:
        self._next += 1
        return self._next <= len(self._paths)

    def read(self) -> Frame | None:
        if self._next >= len(self._paths):
            return None
        path = self._paths[self._next]
        self._next += 1
        image = _read_picture(path)
        try:
            return Frame(image, picture_encoding(image).name)
        except EncodingError as err:
            raise BrokenFrameError(f'{path}: {err}') from err

    def rewind(self) -> None:
        self._next = 0

    def close(self) -> None:
        pass


def _read_picture(path: Path) -> NDArray[Any]:
    """
    Read a picture file with the depth and channels it has.

    :returns: (h, w), (h, w, 3) BGR or (h, w, 4) BGRA.
    :raises BrokenFrameError: the file cannot be read, or is no picture.
    """
    oriented = path.suffix.lower() in _ORIENTED_SUFFIXES
    flags = cv2.IMREAD_ANYCOLOR | cv2.IMREAD_ANYDEPTH if oriented else cv2.IMREAD_UNCHANGED
    try:
        content = path.read_bytes()
        image: NDArray[Any] | None = cv2.imdecode(
            np.frombuffer(content, np.uint8), flags) if content else None
    except OSError as err:
        raise BrokenFrameError(f'{path} cannot be read: {err.strerror}') from err
    except cv2.error as err:
        raise BrokenFrameError(f'{path} cannot be decoded: {err.err}') from err
    if _is_cut_off(content):
        raise BrokenFrameError(f'{path} is damaged: its end is missing')
    if image is None:
        raise BrokenFrameError(f'{path} is not a picture that OpenCV can read')
    return image


def _is_cut_off(content: bytes) -> bool:
    """
    Tell whether the end of a JPEG is missing, which OpenCV 4.6 fills with gray.

    A thumbnail before the picture has an end of its own.
    """
    return (content.startswith(_JPEG_BEGINS)
            and content.rfind(_JPEG_ENDS) < content.rfind(_SCAN_BEGINS))
