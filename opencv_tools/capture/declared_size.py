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

"""Size of a video file by its own header, which a file that was cut off does not have."""

from __future__ import annotations

from pathlib import Path
from typing import BinaryIO

from opencv_tools.base.text import MAX_PATH, printable
from opencv_tools.capture.errors import BrokenFrameError

# A Matroska file begins with the first element. The second one has the size of all that follows.
_EBML, _SEGMENT, _HEAD_BYTES = b'\x1a\x45\xdf\xa3', b'\x18\x53\x80\x67', 256
# Parts of an MP4 or MOV file. What follows others is not known.
_BOXES = (b'ftyp', b'moov', b'mdat', b'moof', b'free', b'skip', b'wide', b'uuid', b'mfra', b'sidx',
          b'styp', b'udta', b'meta')
_UNKNOWN = 0xffffffff  # of a stream that was not finished; sizes of 64 bits are smaller, too


def check_end(location: str, number: int) -> None:
    """
    Check that a video has as many bytes as its header declares, if it declares them.

    :param location: path of the file, or a URL, which is not checked.
    :param number: number of frames until its end.
    :raises BrokenFrameError: it has fewer bytes.
    """
    path = Path(location)
    if not path.is_file():
        return
    size, declared = path.stat().st_size, _declared_bytes(path)
    if size < declared:
        raise BrokenFrameError(f'{printable(path, MAX_PATH)} is damaged: it ends after {number} '
                               f'frames, with {size} of its {declared} bytes')


def _declared_bytes(path: Path) -> int:
    """Return the size of a Matroska, MP4, MOV or AVI file by its header; 0 if it is unknown."""
    with path.open('rb') as file:
        head = file.read(_HEAD_BYTES)
        if not head.startswith(_EBML):
            return _end_of_parts(file, path.stat().st_size, head.startswith(b'RIFF'))
    begin = head.find(_SEGMENT) + len(_SEGMENT)
    if begin < len(_SEGMENT) or begin + 8 > len(head):
        return 0
    # The zeros at the begin of a number are its bytes after the first; ones only mean unknown.
    length = 9 - head[begin].bit_length()
    number, unknown = int.from_bytes(head[begin:begin + length], 'big'), (1 << 7 * length) - 1
    return 0 if number & unknown == unknown else begin + length + (number & unknown)


def _end_of_parts(file: BinaryIO, file_size: int, is_riff: bool) -> int:
    """Return where the last part of a file ends by its header."""
    end = 0
    while end < file_size:
        file.seek(end)
        head = file.read(16)
        if is_riff:
            name, size = head[:4], int.from_bytes(head[4:8], 'little') + 8
        else:
            name, size = head[4:8], int.from_bytes(head[:4], 'big')
            size = int.from_bytes(head[8:], 'big') if size == 1 else size  # 0: to the end
        if name not in ((b'RIFF',) if is_riff else _BOXES) or not 8 <= size < _UNKNOWN:
            break
        end += size
    return end
