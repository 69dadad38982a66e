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


"""The folder of the recordings of a page."""

from __future__ import annotations

import time

from opencv_tools.image.text import MAX_PATH, printable
from opencv_tools.recording.disk_reserve import SinkWithReserve
from opencv_tools.recording.errors import LimitReached, RecordingError
from opencv_tools.recording.naming import check_folder
from opencv_tools.recording.open_sink import open_bag_sink
from opencv_tools.regular_files import user_path


class BagFolder:
    """The folder that pages record in. A page chooses neither a path nor a name."""

    def __init__(self, path: str) -> None:
        """
        Create the folder, and finish the bags of killed recordings.

        :param path: value of the parameter ``record_dir``.
        :raises RecordingError: the folder cannot be used.
        """
        try:
            check_folder(path)
            self.path = user_path(path).absolute()
        except (FileNotFoundError, ValueError) as err:
            reason = 'the working directory was removed' if isinstance(err, OSError) else err
            raise RecordingError(
                f'record_dir {printable(path, MAX_PATH)} cannot be used: {reason}; set it to an '
                'absolute path') from err
        self._open('check').close()

    def open(self, ending: str = '') -> SinkWithReserve:  # noqa: A003
        """
        Create the sink of a bag, which is named by the local time and begins with the first frame.

        :param ending: end of the name.
        :raises RecordingError: the folder cannot be used, or the disk has too little space.
        """
        sink = self._open(time.strftime('%Y-%m-%d_%H-%M-%S') + ending)
        try:
            sink.check()
        except LimitReached as err:
            sink.close()
            raise RecordingError(f'{err}: remove files from {self.path}') from err
        return sink

    def _open(self, name: str) -> SinkWithReserve:
        try:
            return SinkWithReserve(open_bag_sink(self.path, name), self.path)
        except RecordingError as err:
            # The sentences of the recorder name its own parameter.
            raise RecordingError(str(err).replace('output_dir', 'record_dir')) from err
