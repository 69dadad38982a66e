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

"""The manifest of a recording: ``manifest.jsonl``, one line of JSON for each file."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
import errno
import fcntl
import hashlib
import json
import os
from pathlib import Path
from typing import Any, BinaryIO

from opencv_tools.base.regular_files import is_same_file, open_regular, RefusedFileError
from opencv_tools.base.units import NANO
from opencv_tools.recording.frames import ReceivedFrame

FILE_NAME = 'manifest.jsonl'

_BLOCK = 4096
_CHUNK = 1 << 20
_TAIL = 1 << 20
_LINE = 1 << 24
# Enough for four days at 30 frames a second.
_MAX_BYTES = 1 << 32
_MAX_NUMBER = 2**63 - 1


@dataclass(frozen=True, kw_only=True)
class ManifestEntry:
    """
    The manifest entry of one file.

    :param stamp_ns: stamp of the frame in nanoseconds; for a video, of its first frame.
    :param receive_ns: time of reception of the frame, in nanoseconds of the system clock.
    :param encoding: encoding of the message, or format string of a compressed message.
    :param width: width in pixels; 0 if unknown.
    :param height: height in pixels; 0 if unknown.
    :param size: size of the file in bytes.
    :param sha256: SHA-256 digest of the file, in hexadecimal digits.
    :param frames: number of frames in the file; 0 for a truncated video that cannot be read.
    """

    seq: int
    name: str
    stamp_ns: int
    receive_ns: int
    frame_id: str
    encoding: str
    stored_encoding: str
    width: int
    height: int
    size: int
    sha256: str
    frames: int

    def line(self) -> bytes:
        """Return the line of the entry in the manifest."""
        fields = {
            'seq': self.seq, 'file': self.name, 'stamp': _time(self.stamp_ns),
            'receive_time': _time(self.receive_ns), 'frame_id': self.frame_id,
            'encoding': self.encoding, 'stored_encoding': self.stored_encoding,
            'size': [self.width, self.height],
            'bytes': self.size, 'sha256': self.sha256, 'frames': self.frames}
        return json.dumps(fields).encode() + b'\n'

    def measured(self, folder: Path) -> ManifestEntry:
        """
        Return the entry with the size and the digest of its file.

        :raises OSError: the file is missing, not a regular file, or cannot be read.
        """
        digest, size = hashlib.sha256(), 0
        with os.fdopen(open_regular(folder / self.name, follow=False), 'rb') as file:
            while chunk := file.read(_CHUNK):
                digest.update(chunk)
                size += len(chunk)
        return replace(self, size=size, sha256=digest.hexdigest())


def file_entry(
    seq: int, name: str, frame: ReceivedFrame, stored_encoding: str, image_size: tuple[int, int],
) -> ManifestEntry:
    """Return the entry of a file that begins with a frame, without its size and digest."""
    metadata = frame.metadata
    return ManifestEntry(
        seq=seq, name=name, stamp_ns=metadata.stamp_ns, receive_ns=frame.receive_ns,
        frame_id=metadata.frame_id, encoding=metadata.encoding, stored_encoding=stored_encoding,
        width=image_size[0], height=image_size[1], size=0, sha256='', frames=0)


def parse_line(line: bytes) -> ManifestEntry:
    """
    Read a line of a manifest.

    :raises ValueError: the line is not a manifest entry, or names a file in another folder.
    """
    try:
        fields = json.loads(line)
        width, height = map(_count, fields['size'])
        return ManifestEntry(
            seq=_count(fields['seq']), name=_file_name(fields['file']),
            stamp_ns=_nanoseconds(fields['stamp']),
            receive_ns=_nanoseconds(fields['receive_time']), frame_id=str(fields['frame_id']),
            encoding=str(fields['encoding']), stored_encoding=str(fields['stored_encoding']),
            width=width, height=height, size=_count(fields['bytes']),
            sha256=str(fields['sha256']), frames=_count(fields['frames']))
    except (LookupError, OverflowError, RecursionError, TypeError, UnicodeError) as err:
        raise ValueError(f'{line[:80]!r} is not a line of a manifest') from err


class Manifest:
    """The manifest of a folder; several recordings may write to it at the same time."""

    def __init__(self, folder: Path) -> None:
        self._path = folder / FILE_NAME

    def append(self, entry: ManifestEntry) -> None:
        """
        Write a line atomically at the end of the manifest.

        :raises OSError: the manifest cannot be written.
        """
        with self._locked() as file:
            end = _truncate_partial_line(file)
            line = entry.line()
            try:
                if os.write(file, line) < len(line):
                    raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
            except OSError:
                os.ftruncate(file, end)
                raise

    def entries(self) -> list[ManifestEntry]:
        """
        Read all entries; skip lines that are not manifest entries.

        :raises OSError: the manifest cannot be read, or is not a regular file.
        """
        return self._read(_MAX_BYTES)

    def tail(self) -> list[ManifestEntry]:
        """Read the last entries, which include the highest numbers; see ``entries``."""
        return self._read(_TAIL)

    def compact(
        self, is_kept: Callable[[ManifestEntry], bool], write: Callable[[Iterable[bytes]], Path],
    ) -> None:
        """
        Remove lines that a later line of the same file replaces, and unwanted lines.

        :param is_kept: returns whether to keep an entry.
        :raises OSError: the manifest cannot be rewritten.
        """
        with self._locked() as file:
            with os.fdopen(os.dup(file), 'rb') as reading:
                last = {entry.name: entry for entry in _parse(reading)}
                lines = [entry.line() for entry in last.values() if is_kept(entry)]
                reading.seek(0)
                is_same = all(reading.read(len(line)) == line for line in lines)
                is_same = is_same and not reading.read(1)
            if not is_same:
                write((b''.join(lines),)).replace(self._path)

    def replace(
        self, entry: ManifestEntry, write: Callable[[Iterable[bytes]], Path],
    ) -> None:
        """
        Write a line at the end of the manifest, and remove the earlier ones of its file.

        :param write: as for `compact`.
        :raises OSError: the manifest cannot be written.
        """
        self.append(entry)
        self.compact(lambda _: True, write)

    def _read(self, size: int) -> list[ManifestEntry]:
        """Read the entries in the last bytes; return none if the manifest does not exist."""
        try:
            with os.fdopen(self._open(os.O_RDONLY), 'rb') as file:
                file.seek(max(0, os.fstat(file.fileno()).st_size - size))
                return list(_parse(file))
        except FileNotFoundError:
            return []

    def _open(self, flags: int) -> int:
        """Open the manifest, unless it is too large or not a regular file."""
        file = open_regular(self._path, flags, follow=False)
        if os.fstat(file).st_size > _MAX_BYTES:
            os.close(file)
            raise RefusedFileError(
                self._path, f'{FILE_NAME} is larger than {_MAX_BYTES} bytes', errno.EFBIG)
        return file

    @contextmanager
    def _locked(self) -> Iterator[int]:
        """Open the manifest with an exclusive lock."""
        while True:
            file = self._open(os.O_RDWR | os.O_APPEND | os.O_CREAT)
            try:
                with suppress(OSError):  # a file system without locks
                    fcntl.flock(file, fcntl.LOCK_EX)
                if is_same_file(file, self._path):
                    yield file
                    return
            finally:
                os.close(file)


def _time(nanoseconds: int) -> dict[str, int]:
    """Return a time as seconds and nanoseconds; a JSON number may lose the last digits."""
    sec, nanosec = divmod(nanoseconds, NANO)
    return {'sec': sec, 'nanosec': nanosec}


def _nanoseconds(time: dict[str, int]) -> int:
    return _number(time['sec']) * NANO + _number(time['nanosec'])


def _number(value: Any) -> int:
    number = int(value)
    if abs(number) > _MAX_NUMBER:
        raise ValueError(f'{number:.3e} is out of range for a manifest')
    return number


def _count(value: Any) -> int:
    number = _number(value)
    if number < 0:
        raise ValueError(f'{number} is negative')
    return number


def _file_name(value: Any) -> str:
    """Check that a value is a file name without a folder, and return it."""
    if not isinstance(value, str) or value in ('', '.', '..') or {'/', '\0'} & set(value):
        raise ValueError(f'{value!r:.80} is not a file name')
    os.fsencode(value)
    return value


def _parse(file: BinaryIO) -> Iterator[ManifestEntry]:
    while line := file.readline(_LINE):
        try:
            yield parse_line(line)
        except ValueError:
            continue


def _truncate_partial_line(file: int) -> int:
    """Truncate an incomplete last line and return the offset for the next one."""
    end = size = os.fstat(file).st_size
    while end and os.pread(file, 1, end - 1) != b'\n':
        begin = max(0, end - _BLOCK)
        end = begin + os.pread(file, end - begin, begin).rfind(b'\n') + 1
    if end < size:
        os.ftruncate(file, end)
    return end
