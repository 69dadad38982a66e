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

"""Recording of frames as image files."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass, replace
import hashlib
from itertools import chain
from pathlib import Path

from opencv_tools.recording.folder import Folder
from opencv_tools.recording.frames import ReceivedFrame
from opencv_tools.recording.image_encoder import encode_frame, EncodedImage, EncoderSettings
from opencv_tools.recording.manifest import file_entry, ManifestEntry
from opencv_tools.recording.numbering import Numbering, StoredFiles
from opencv_tools.recording.recorder import SinkCounts
from opencv_tools.recording.selection import Limits

# The manifest is compacted when more lines, and more than half of them, have no file.
_MAX_STALE_LINES = 100


@dataclass(frozen=True)
class PreparedImage:
    """
    A temporary file that is ready to be renamed.

    :param content: content of the file, without its data.
    :param size: size of the file in bytes.
    :param sha256: SHA-256 digest of the file, in hexadecimal digits.
    """

    temporary: Path
    content: EncodedImage
    size: int
    sha256: str

    def discard(self) -> None:
        """Remove the temporary file."""
        with suppress(OSError):  # the next recording removes it
            self.temporary.unlink(missing_ok=True)


class ImageSink:
    """Write each frame to an image file."""

    def __init__(
        self, folder: Folder, numbering: Numbering, settings: EncoderSettings, limits: Limits,
    ) -> None:
        """
        Read the manifest of the existing files.

        :param folder: output folder, closed together with this sink.
        :raises OSError: the manifest cannot be read.
        """
        self.counts = SinkCounts()
        self._folder = folder
        self._numbering = numbering
        self._settings = settings
        self._files = StoredFiles(folder, numbering, limits, _MAX_STALE_LINES)

    def prepare(self, frame: ReceivedFrame) -> PreparedImage:
        """
        Encode a frame and write it to a temporary file; thread-safe.

        :returns: the temporary file.
        :raises ImageError: the format cannot hold the frame.
        :raises OSError: the file cannot be written.
        """
        content = encode_frame(frame, self._settings)
        parts = content.parts()
        first = next(parts)
        digest, size = hashlib.sha256(first), first.nbytes  # while the data are in the cache

        def hashed() -> Iterator[memoryview]:
            nonlocal size
            for part in parts:
                digest.update(part)
                size += part.nbytes
                yield part

        temporary = self._folder.write(chain((first,), hashed()))
        return PreparedImage(
            temporary, replace(content, data=b'', array=None), size, digest.hexdigest())

    def commit(self, frame: ReceivedFrame, image: PreparedImage) -> Path:
        """
        Rename a temporary file; one thread at a time, in the order of the frames.

        :returns: final path.
        :raises LimitReached: the recording has reached its limits.
        :raises OSError: the file cannot be renamed or added to the manifest.
        """
        content = image.content
        path = self._numbering.claim(frame.metadata, lambda seq, name: self._publish(
            image.temporary, replace(
                file_entry(seq, name, frame, content.encoding, (content.width, content.height)),
                size=image.size, sha256=image.sha256, frames=1), frame.arrival_ns))
        self.counts.kept += 1
        return path

    def close(self) -> None:
        """
        Write the deferred lines of the manifest, remove those of deleted files, close the folder.

        :raises OSError: the manifest cannot be written.
        """
        try:
            self._folder.write_deferred()
            self._files.close()
        finally:
            self._folder.close()

    def _publish(self, temporary: Path, entry: ManifestEntry, arrival_ns: int) -> Path:
        self._files.make_room(entry, arrival_ns)
        path = self._folder.publish(temporary, entry, self._numbering.replaces)
        self._files.add(entry, arrival_ns)
        if self._numbering.replaces:
            self._files.remove_lines(1)
        return path
