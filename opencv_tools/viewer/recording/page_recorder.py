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


"""Recordings that pages start and stop: one for all pages, with its folder and disk work."""

from __future__ import annotations

from collections.abc import Callable, Coroutine, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from threading import Thread
import time
from typing import Any, TypeVar

from opencv_tools.base.logs import Log
from opencv_tools.base.regular_files import user_path
from opencv_tools.base.text import enumerated, MAX_PATH, printable
from opencv_tools.image.cdr import COMPRESSED_IMAGE, IMAGE
from opencv_tools.nodes.conversion import bag_channel, frame_of, offers_of, type_of
from opencv_tools.recording.bag_sink import BagSink, MessageFrame
from opencv_tools.recording.errors import LimitReached, RecordingError
from opencv_tools.recording.naming import check_folder
from opencv_tools.recording.open_sink import open_bag_sink
from opencv_tools.recording.recorder import Recorder
from opencv_tools.topics.queue import ReceivedMessage
from opencv_tools.viewer.errors import MAX_MESSAGE, RequestError
from opencv_tools.viewer.recording.bag_recording import BagRecording, Topic
from rclpy.node import Node
from rclpy.task import Future

#: Returns the received messages of a topic that are in memory, oldest first.
FramesOf = Callable[[str], Sequence[ReceivedMessage]]
# Possible ends of the names of topics, by the types of their messages.
_ENDS = {IMAGE: ('',), COMPRESSED_IMAGE: ('/compressed', '')}


@dataclass(frozen=True)
class SavedFrames:
    """
    What has become of the frames.

    :param name: name of the bag; '' without one.
    :param problem: why frames are missing, as a sentence; '' if none is.
    """

    written: int
    name: str
    problem: str


def bag_frames(
    node: Node, received: Mapping[str, Sequence[ReceivedMessage]],
) -> list[MessageFrame]:
    """
    Return images for a bag, oldest first, in the executor.

    :param received: messages by the name of the topic without the end of its transport.
    """
    channels: dict[tuple[str, str], Any] = {}
    frames = []
    for name, messages in received.items():
        for one in messages:
            type_name = type_of(one)
            if type_name not in _ENDS:  # packets of video need those before them
                continue
            key = name, type_name
            if key not in channels:
                channels[key] = _channel(node, name, type_name)
            frames.append(frame_of(one, channels[key]))
    return sorted(frames, key=lambda frame: frame.receive_ns)


def _channel(node: Node, name: str, type_name: str) -> Any:
    """Return the topic of messages, which is the first one that has publishers of their type."""
    offers = {end: offers_of(node, name + end, type_name) for end in _ENDS[type_name]}
    end = next((end for end, found in offers.items() if found), _ENDS[type_name][0])
    return bag_channel(name + end, type_name, offers[end])


def write_frames(
    sink: BagSink, frames: Sequence[MessageFrame], log: Log,
) -> SavedFrames:
    """Write frames to a bag; takes the time of the disk."""
    recorder: Recorder[Any] = Recorder(sink, log, writers=1, block=True)
    outcomes: list[Path | str] = []
    for frame in frames:
        recorder.put(frame, outcomes.append)
    recorder.close()
    paths = [outcome for outcome in outcomes if isinstance(outcome, Path)]
    reasons = [outcome for outcome in outcomes if isinstance(outcome, str)]
    missing = len(frames) - recorder.counts.written
    reason = recorder.limit or [*reasons, sink.counts.reason][0]
    return SavedFrames(
        recorder.counts.written, paths[-1].name if paths else '',
        f'{missing} of {len(frames)} frames were not written: {printable(reason)}'
        if missing else '')


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

    def open(self, ending: str = '') -> BagSink:  # noqa: A003
        """
        Create the sink of a bag, which is named by the local time and begins with the first frame.

        :raises RecordingError: the folder cannot be used, or the disk has too little space.
        """
        sink = self._open(time.strftime('%Y-%m-%d_%H-%M-%S') + ending)
        try:
            sink.check_reserve()
        except LimitReached as err:
            sink.close()
            raise RecordingError(f'{err}: remove files from {self.path}') from err
        return sink

    def _open(self, name: str) -> BagSink:
        try:
            return open_bag_sink(self.path, name)
        except RecordingError as err:
            # The sentences of the recorder name its own parameter.
            raise RecordingError(str(err).replace('output_dir', 'record_dir')) from err


_T = TypeVar('_T')


async def in_thread(node: Node, log: Log, work: Callable[[], _T]) -> _T:
    """
    Return the result of work in a thread, in a coroutine of the executor.

    :raises RequestError: a folder cannot be used; the reason is logged as well.
    """
    future = Future(executor=node.executor)

    def run() -> None:
        try:
            future.set_result(work())
        except Exception as err:  # noqa: B902 (the coroutine raises it)
            future.set_exception(err)
        executor = node.executor
        if executor:
            executor.wake()

    Thread(target=run, name='recording', daemon=True).start()
    try:
        result: _T = await future
    except (OSError, RecordingError) as err:
        log.error(printable(err, MAX_PATH))
        raise RequestError(printable(err, MAX_MESSAGE)) from err
    return result


#: Maximum number of topics of a recording.
MAX_RECORDED = 64
# Least time between two starts of a kind, so that a page cannot fill the folder with bags.
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
        self._next_start_at = dict.fromkeys(('keep', 'record'), 0.0)
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

    async def keep(
        self, wanted: Any, paused: Mapping[str, Sequence[ReceivedMessage]],
    ) -> dict[str, Any]:
        """
        Write the frames that are in memory to a bag, as a page requests.

        :param wanted: numbers of the topics, from a page.
        :param paused: frames of the topics of a paused page, which are those before its pause.
        :returns: the answer for the page.
        :raises RequestError: the request is invalid, or the folder cannot be used.
        """
        names = [topic.name for topic in topics_of(wanted, self._topics)]
        if self.frames_of is None:
            raise RequestError('this node keeps no frames in memory')
        if self._is_saving:
            raise RequestError('frames are being written: wait')
        frames = bag_frames(self._node, {
            name: paused[name] if name in paused else self.frames_of(name) for name in names})
        if not frames:
            raise RequestError(f'no frames of {enumerated([*map(printable, names)])} are in '
                               'memory')
        self._check_pause('keep')
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
            self._recording.recorder.abandon()
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
        self._check_pause('record')
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

    def _check_pause(self, kind: str) -> None:
        """
        Note the beginning of a bag.

        :raises RequestError: the last one has just begun.
        """
        now = time.monotonic()
        if now < self._next_start_at[kind]:
            raise RequestError('the last recording began less than a second ago: try again')
        self._next_start_at[kind] = now + _PAUSE_SECONDS

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
                'folder': printable(self._folder.path, MAX_PATH),
                **(recording.account() if recording else {})}


def _count(number: int, noun: str) -> str:
    return f'{number} {noun}' + ('s' if number != 1 else '')
