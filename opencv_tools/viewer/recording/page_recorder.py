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


"""Recordings that pages start and stop: one at a time for all pages."""

from __future__ import annotations

from collections.abc import Callable, Coroutine, Mapping
import time
from typing import Any

from opencv_tools.image.text import enumerated, MAX_PATH, printable
from opencv_tools.logs import Log
from opencv_tools.viewer.errors import RequestError
from opencv_tools.viewer.recording.bag_recording import BagRecording
from opencv_tools.viewer.recording.disk_work import in_thread
from opencv_tools.viewer.recording.folder import BagFolder
from opencv_tools.viewer.recording.images import Topic
from opencv_tools.viewer.recording.kept_frames import bag_frames, FramesOf, write_frames
from rclpy.node import Node

#: Maximum number of topics of a recording.
MAX_RECORDED = 64
# Least time between two starts, so that a page cannot fill the folder with bags.
_PAUSE_SECONDS = 1.0

Start = Callable[[Coroutine[Any, Any, object]], object]


def topics_of(numbers: Any, known: Mapping[int, Topic]) -> list[Topic]:
    """
    Return topics by their numbers, each once.

    :param numbers: numbers of topics, from a page.
    :param known: the listed topics by their numbers.
    :raises RequestError: there are none, or too many, or a number is that of no topic.
    """
    if not isinstance(numbers, list) or not numbers:
        raise RequestError('there is no topic to record')
    if len(numbers) > MAX_RECORDED:
        raise RequestError(f'{len(numbers)} topics are too many: a recording has '
                           f'{MAX_RECORDED} at most; hide others')
    for number in numbers:
        if type(number) is not int or number not in known:
            raise RequestError(f'{printable(number, 40)} is not the number of a topic')
    return [*dict.fromkeys(known[number] for number in numbers)]


class PageRecorder:
    """
    Record the image topics that a page names by their numbers.

    All methods but ``abandon`` run in the executor, or after it. Slow work on the disk has threads
    of its own.
    """

    def __init__(self, node: Node, record_dir: str, start: Start, log: Log) -> None:
        """
        Open the folder.

        :param record_dir: folder of the bags.
        :param start: runs a coroutine in the executor; thread-safe.
        :raises RecordingError: the folder cannot be used.
        """
        self._folder = BagFolder(record_dir)
        self._node = node
        self._run = start
        self._log = log
        self._topics: Mapping[int, Topic] = {}
        #: What happens now: '' for nothing, ``starting``, ``recording`` or ``ending``.
        self._phase = ''
        self._recording: BagRecording | None = None  # the last one is kept for its account
        self._next_start_at = 0.0
        self._is_saving = False
        #: Returns the frames of a topic that are in memory, oldest first; None without a memory.
        self.frames_of: FramesOf | None = None

    def state(self, topics: Mapping[int, Topic]) -> dict[str, Any]:
        """
        Return the account for the pages.

        :param topics: the listed topics by their numbers. No others are recorded.
        """
        self._topics = topics
        return self._account()

    async def request(self, wanted: Any, since: Any = None) -> dict[str, Any]:
        """
        Start or end a recording, as a page requests.

        :param wanted: numbers of the topics to record; False ends the recording.
        :param since: the time in the account of the recording that ends.
        :returns: the answer for the page.
        :raises RequestError: the request is invalid, or the folder cannot be used.
        """
        if wanted is False:
            if self._phase == 'recording' and self._recording and since != self._recording.since:
                raise RequestError('another recording has begun since: look at it, then stop it')
            sentence = await self._stop()
        else:
            sentence = await self._start(topics_of(wanted, self._topics))
        return {'record': {'ok': True, 'message': sentence}, 'recording': self._account()}

    async def keep(self, wanted: Any) -> dict[str, Any]:
        """
        Write the frames that are in memory to a bag, as a page requests.

        :param wanted: numbers of the topics.
        :returns: the answer for the page.
        :raises RequestError: the request is invalid, or the folder cannot be used.
        """
        names = [topic.name for topic in topics_of(wanted, self._topics)]
        if self.frames_of is None:
            raise RequestError('this node keeps no frames in memory')
        if self._is_saving:
            raise RequestError('frames are being written: wait')
        frames = bag_frames(self._node, {name: self.frames_of(name) for name in names})
        if not frames:
            raise RequestError(f'no frames of {enumerated([*map(printable, names)])} are in '
                               'memory')
        self._check_pause()
        self._is_saving = True
        try:
            saved = await in_thread(self._node, self._log, lambda: write_frames(
                self._folder.open('_kept'), frames, self._log))
        finally:
            self._is_saving = False
        sentence = f'Recorded {_count(saved.written, "frame")} from memory in {saved.name}'
        self._log.info(f'{sentence}: {saved.problem or "all of them"}')
        return {'keep': {'ok': not saved.problem, 'message': saved.problem or sentence}}

    def abandon(self) -> bool:
        """
        Leave the frames that wait for the disk; a handler of signals may call this.

        :returns: whether there is a recording.
        """
        if self._recording and self._phase:
            self._recording.abandon()
            return True
        return False

    def close(self) -> None:
        """Finish the recording, after the executor has ended."""
        if self._recording and self._phase:
            self._recording.stop()
            self._recording.finish()
            self._report(self._recording, 'the node has ended')

    async def _start(self, topics: list[Topic]) -> str:
        recording = self._recording
        if self._phase == 'recording' and recording:
            since = time.strftime('%H:%M:%S', time.localtime(recording.since))
            raise RequestError(f'already recording {_count(len(recording.names), "topic")} since '
                               f'{since}')
        if self._phase:
            raise RequestError(f'a recording is {self._phase}: wait')
        self._check_pause()
        self._phase = 'starting'
        try:
            sink = await in_thread(self._node, self._log, self._folder.open)
            recording = BagRecording(sink, self._log, self._end_full)
            try:
                recording.receive(self._node, topics)
            except Exception:
                await in_thread(self._node, self._log, recording.finish)
                raise
        except BaseException:
            self._phase = ''
            raise
        self._recording, self._phase = recording, 'recording'
        sentence = f'Recording {_count(len(topics), "topic")}'
        self._log.info(f'{sentence} in {self._folder.path}, as a page has requested')
        return sentence

    async def _stop(self, reason: str = 'a page has stopped it') -> str:
        recording = self._recording
        if self._phase != 'recording' or recording is None:
            raise RequestError(f'a recording is {self._phase}: wait' if self._phase
                               else 'nothing is being recorded')
        self._phase = 'ending'
        try:
            recording.stop()
            await in_thread(self._node, self._log, recording.finish)
        finally:
            self._phase = ''
        return self._report(recording, reason)

    def _check_pause(self) -> None:
        """
        Note the beginning of a bag.

        :raises RequestError: the last one has just begun.
        """
        now = time.monotonic()
        if now < self._next_start_at:
            raise RequestError('the last recording began less than a second ago: try again')
        self._next_start_at = now + _PAUSE_SECONDS

    def _end_full(self) -> None:
        """End the recording, because the disk has too little space; called in a thread."""
        self._run(self._stop('the disk has too little space'))

    def _report(self, recording: BagRecording, reason: str) -> str:
        """Log the account of a recording that has ended, and return it for a page."""
        account = recording.account()
        where = recording.path or f'{self._folder.path}, because no frame has arrived'
        done = f'Recorded {_count(account["frames"], "frame")}'
        self._log.info(
            f'{done} of {_count(len(recording.names), "topic")} in {account["seconds"]} s to '
            f'{printable(where, MAX_PATH)}: {account["dropped"]} dropped, {account["failed"]} '
            f'failed, {account["lost"]} lost in transit; {reason}')
        return f'{done} in {account["name"]}' if account['name'] else f'{done}: none has arrived'

    def _account(self) -> dict[str, Any]:
        recording = self._recording if self._phase != 'starting' else None
        return {'phase': self._phase, 'keeps': self.frames_of is not None,
                **(recording.account() if recording else {})}


def _count(number: int, noun: str) -> str:
    return f'{number} {noun}' + ('s' if number != 1 else '')
