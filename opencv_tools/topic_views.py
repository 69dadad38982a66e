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

"""Views of a calibration board in the images of live topics, of one camera or of two."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from contextlib import closing
from functools import partial

from opencv_tools.base.logs import Log
from opencv_tools.base.progress import open_progress, Progress
from opencv_tools.base.signals import recorded_signals
from opencv_tools.calibration.boards import Board
from opencv_tools.calibration.source_images import Image
from opencv_tools.calibration.view_search import FoundViews, PAIR_SECONDS, ViewSearch
from opencv_tools.frames.frame import Frame
from opencv_tools.frames.node import FrameNode, main

_CLOSED = 1  # status; also that of the process if Fast DDS never ends, so that nothing is written
_WAITING = 10  # frames of each camera that may wait for one of the other camera


def search_topics(board: Board, topics: Sequence[str], log: Log) -> FoundViews:
    """
    Search live images until all views are there, or until Ctrl-C, and show the progress.

    :param topics: topic of each camera.
    :raises CalibrationError: this OpenCV finds no board of this kind.
    :raises SystemExit: a topic cannot be received; the log has the reason.
    """
    search = ViewSearch(board)
    log, progress = open_progress(log, 'Image', 0)

    def img_calibrate() -> FrameNode:
        return _Receiver(search, topics, log, progress)

    log.info('views are taken from the topics: press Ctrl-C to calibrate with those until then')
    with closing(progress), recorded_signals():
        status = main(img_calibrate, ['img_calibrate'])
    if not status:  # a signal before the node was there
        raise KeyboardInterrupt
    if status != _CLOSED:
        raise SystemExit(status)
    return search.found


class FramePairs:
    """Frames of each camera that wait for those of the others, at most 10 of each."""

    def __init__(self, cameras: int) -> None:
        self._waiting = [deque[Frame](maxlen=_WAITING) for _ in range(cameras)]

    @property
    def apart(self) -> float:
        """Difference of the newest stamps in seconds if no frames fit, otherwise 0.0."""
        if any(len(frames) < _WAITING for frames in self._waiting):
            return 0.0
        return _apart([frames[-1] for frames in self._waiting])

    def add(self, camera: int, frame: Frame) -> tuple[Frame, ...]:
        """Add a frame; return the frames of all cameras at its time, () if one is missing."""
        self._waiting[camera].append(frame)
        if not all(self._waiting):
            return ()
        found = tuple(min(frames, key=lambda one: abs(one.stamp_ns - frame.stamp_ns))
                      for frames in self._waiting)
        if _apart(found) > PAIR_SECONDS:
            return ()
        for frames, last in zip(self._waiting, found):
            while frames.popleft() is not last:
                pass
        return found


def _apart(frames: Sequence[Frame]) -> float:
    stamps = [frame.stamp_ns for frame in frames]
    return (max(stamps) - min(stamps)) / 1e9


class _Receiver(FrameNode):
    """Node that searches the images of topics."""

    def __init__(
        self, search: ViewSearch, topics: Sequence[str], log: Log, progress: Progress,
    ) -> None:
        super().__init__('img_calibrate')
        self._search, self._log, self._progress = search, log, progress
        self._topics = ' and '.join(topics)
        self._pairs = FramePairs(len(topics))
        for camera, topic in enumerate(topics):
            self.receive_frames(topic, partial(self._receive, camera), encoding='mono8',
                                every=len(topics) > 1)

    def close(self) -> int:
        super().close()
        return _CLOSED

    def _receive(self, camera: int, frame: Frame) -> None:
        if self.done.done():
            return
        if not frame.stamp_ns:
            self._log.warning(f'the images of {self._topics} have no stamps: set header.stamp to '
                              'the time of each image', every=10.0, key='stamps')
            return
        frames = self._pairs.add(camera, frame)
        if self._pairs.apart > PAIR_SECONDS:
            self._log.warning(
                f'the stamps of {self._topics} differ by {self._pairs.apart:.3g} s: let both '
                f'cameras take their images at the same time, {PAIR_SECONDS:g} s apart at most',
                every=10.0, key='apart')
        if frames:
            self._add([Image(name='', pixels=one.image, seconds=one.stamp_ns / 1e9)
                       for one in frames])

    def _add(self, images: Sequence[Image]) -> None:
        reason, selection = self._search.add(images), self._search.selection
        hint = selection.hint
        # The words come first, because a narrow terminal cuts the end of the line.
        self._progress.tick(f'{reason or hint or "all are there"}, views: {len(selection.views)}',
                            **{'left out': self._search.reasons.total()})
        if not hint or selection.is_full:
            self.done.set_result(0)
