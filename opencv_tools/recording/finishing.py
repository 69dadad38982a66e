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

"""Files of recordings that were killed: bags get their index, frames are counted."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path

from opencv_tools.bags.errors import BagError
from opencv_tools.bags.finishing import finish_and_count, finish_bag, has_footer
from opencv_tools.bags.writing import BAG_SUFFIX
from opencv_tools.recording.folder import Finishers, Folder
from opencv_tools.recording.video.unfinished import count_frames
from opencv_tools.recording.video.writer import VIDEO_FORMATS

_BAG_HEADER_BYTES = 64  # a bag that was cut off in its header is not longer


def finish_bags(folder: Folder) -> None:
    """
    Finish the bags of a folder whose recorders were killed.

    :param folder: output folder; its manifest gets the new size and digest of these bags.
    """
    for path in folder.path.glob(f'*{BAG_SUFFIX}'):
        with suppress(BagError, OSError):  # damaged, or without permission: it is left alone
            if not has_footer(path):
                folder.update_line(path.name, finish_bag(path))


def _finish_bag(path: Path) -> int | None:
    """Finish a bag; return the number of its images, 0 for an empty bag."""
    try:
        counts = finish_and_count(path)
        if counts is None:
            return 0 if path.stat().st_size <= _BAG_HEADER_BYTES else None
        # A bag of other messages only has a line without frames.
        return counts.images or (None if counts.messages else 0)
    except BagError:  # damaged, or the library of bags is not installed
        return None


#: What finishes a file with many frames.
FINISHERS: Finishers = {**dict.fromkeys(VIDEO_FORMATS, count_frames), BAG_SUFFIX: _finish_bag}
