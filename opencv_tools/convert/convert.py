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

"""Conversion of the selected frames of a source to files, with the times of the source."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from contextlib import closing, suppress
from dataclasses import dataclass, replace
from itertools import chain, count
import os
from pathlib import Path
import time
from typing import Any

from opencv_tools.bags.account import has_account
from opencv_tools.bags.channels import channel_of
from opencv_tools.bags.errors import BagError
from opencv_tools.bags.writing import BAG_SUFFIX, BagChannel
from opencv_tools.base.arguments import COLORS
from opencv_tools.base.logs import ConsoleWriter, Log, log_if_slow
from opencv_tools.base.progress import open_progress
from opencv_tools.base.regular_files import user_path
from opencv_tools.base.signals import recorded_signals
from opencv_tools.base.text import printable, without_password
from opencv_tools.base.units import NANO
from opencv_tools.capture.bag import BagSource
from opencv_tools.capture.errors import (
    BrokenFrameError, CaptureError, TopicError, UnavailableError)
from opencv_tools.capture.frame import CapturedFrame, JPEG, LiveSource, Recorded, Source, VIDEO
from opencv_tools.capture.image_files import ImageFileSource
from opencv_tools.capture.pattern import PatternSource
from opencv_tools.capture.player import IMAGE_RATE
from opencv_tools.capture.source import describe_opening, is_camera, names_bag, open_source
from opencv_tools.capture.video import VideoSource
from opencv_tools.convert.other_topics import check_patterns, OtherTopics
from opencv_tools.image.cdr import IMAGE, WireCompressedImage
from opencv_tools.image.display import finite_limits
from opencv_tools.image.encodings import find_encoding
from opencv_tools.image.errors import ImageError
from opencv_tools.image.jpeg import JPEG_SOI
from opencv_tools.image.layout import array_to_wire
from opencv_tools.image.topic_names import image_topic
from opencv_tools.recording.bag_sink import BagSink, MessageFrame
from opencv_tools.recording.errors import FailureLog, RecordingError
from opencv_tools.recording.frames import CompressedFrame, packet_frame, RawFrame, ReceivedFrame
from opencv_tools.recording.image_encoder import (
    COMPRESSED_SUFFIXES, EncoderSettings, is_number, LOSSLESS_VIDEO)
from opencv_tools.recording.naming import check_folder, FileNames, FrameMetadata
from opencv_tools.recording.open_sink import check_format, KEEPS_PACKETS, open_sink
from opencv_tools.recording.recorder import Recorder, Sink
from opencv_tools.recording.selection import Limits
from opencv_tools.recording.video.writer import VIDEO_FORMATS
from opencv_tools.video.lossless import LOSSLESS_ENCODINGS
from opencv_tools.video.messages import WireVideo

# Names of the publisher, for sources that have none.
_TOPIC = '/video_frames'
_FRAME_ID = 'camera'
_READ_SECONDS = 2.0

OnBroken = Callable[[BrokenFrameError], object]


def numbered_frames(
    source: Source, first: int, stop: int, every: int, on_broken: OnBroken,
    has_ended: Callable[[], bool],
) -> Iterator[tuple[int, CapturedFrame]]:
    """
    Yield frames with their numbers; the other frames are not decoded.

    :param first: number of the first frame, from 0.
    :param stop: number of the first frame not to yield; 0 for the end of the source.
    :param every: yield the first of every n frames.
    :param on_broken: called for each frame that cannot be read, which is skipped.
    :param has_ended: called before each frame, returns whether to yield no more.
    :raises CaptureError: the source has failed.
    :raises ValueError: the source ends before the first frame.
    """
    number = 0
    for number in range(stop) if stop else count():
        if has_ended():
            return
        is_selected = number >= first and not (number - first) % every
        try:
            if not (is_selected or source.live) and source.skip():
                continue
            frame = _read_live(source) if source.live else source.read()
            if frame is None:
                break
            if is_selected:
                yield number, frame
        except BrokenFrameError as err:
            on_broken(err)
    else:
        return
    if 0 < number <= first:
        raise ValueError(f'--start is {first}, but {source.name} has only {number} frames, '
                         'numbered from 0')


def _read_live(source: LiveSource) -> CapturedFrame | None:
    """Return the next frame of a stream; None at its end."""
    try:
        frame = source.read() if source.wait(_READ_SECONDS) else None
        return replace(frame, pixels=frame.video.decode(), encoding='bgr8', video=None) if (
            frame and frame.video) else frame
    except UnavailableError:
        return None
    except ImageError as err:
        raise BrokenFrameError(f'{source.name}: {err}') from err


def received_frame(
    frame: CapturedFrame, number: int, rate: float, channel: BagChannel | None = None,
) -> ReceivedFrame:
    """
    Return a frame for a recorder.

    :param number: number of the frame, from 0.
    :param rate: frame rate of the source in Hz; 0.0 if it has none.
    :param channel: topic of a bag whose frame is returned as its message; else None.
    :returns: the frame with the time and header of its bag; else with the time in its file,
        counted from 0, or with the time of a stream.
    """
    recorded = frame.recorded
    topic, frame_id, encoding = _TOPIC, _FRAME_ID, frame.encoding
    if recorded:
        topic, frame_id = recorded.topic, recorded.message.header.frame_id
        stamp_ns, receive_ns = recorded.header_ns, recorded.log_ns
        if isinstance(recorded.message, WireCompressedImage):
            encoding = recorded.message.format
        elif isinstance(recorded.message, WireVideo) and frame.encoding == VIDEO:
            encoding = recorded.message.encoding
    elif frame.stamp_ns:
        stamp_ns = receive_ns = frame.stamp_ns + time.time_ns() - time.monotonic_ns()
    else:
        position = number / (rate or IMAGE_RATE) if frame.position is None else frame.position
        stamp_ns = receive_ns = round(position * NANO)
    metadata = FrameMetadata(stamp_ns, frame_id, encoding, topic)
    times = {'receive_ns': receive_ns, 'arrival_ns': receive_ns}
    if recorded and channel:
        return _message_frame(frame, recorded, metadata, channel)
    if recorded and isinstance(recorded.message, WireVideo) and frame.encoding == VIDEO:
        return packet_frame(recorded.message, topic, receive_ns, receive_ns,
                            number=recorded.number)
    if frame.encoding == JPEG:
        return CompressedFrame(metadata=metadata, data=frame.image.data, **times)
    return RawFrame(metadata=metadata, image=frame.image, **times)


def _message_frame(
    frame: CapturedFrame, recorded: Recorded, metadata: FrameMetadata, channel: BagChannel,
) -> MessageFrame:
    """Return a frame of a bag as its message, or as a raw image if it was decoded from video."""
    message, serialized = recorded.message, recorded.serialized
    if isinstance(message, WireVideo) and frame.encoding != VIDEO:
        channel = BagChannel(topic=image_topic(recorded.topic), type_name=IMAGE, qos=channel.qos)
        message, serialized = array_to_wire(
            frame.image, find_encoding(frame.encoding), message.header), None
    return MessageFrame(
        metadata=metadata, message=message, channel=channel, publish_ns=recorded.publish_ns,
        number=recorded.number, receive_ns=recorded.log_ns, arrival_ns=recorded.log_ns,
        serialized=serialized)


_EXIT_OK = 0
_EXIT_FAILURE = 1

_NO_FRAME = 'interrupted before the first frame'

_JPEGS = ('.jpg', '.jpeg', '.jpe')
_LOSSY_FORMATS = (*_JPEGS, *VIDEO_FORMATS)
# Formats that hold every encoding, also Bayer and YUV, without a conversion.
_LOSSLESS_FOR_ALL = ('.mcap', '.npy')
# Largest size of the frames that wait to be written, and of those that are being written.
_QUEUED_BYTES = 1 << 27


@dataclass(frozen=True, kw_only=True)
class ConvertRequest:
    """
    Arguments of a conversion.

    :param source: source of the frames, as for ``open_source``, but not a camera.
    :param topic: topic of the images of a bag; '' for the only one.
    :param every: convert the first of every n frames.
    :param start: number of the first frame, from 0.
    :param stop: number of the first frame not to convert; 0 for the end of the source.
    :param lossy: whether a lossless source may be converted to a lossy format.
    :param limits: numbers that become black and white, of images with one channel and more than 8
        bits; None to refuse them where the target has 8 bits.
    :param colors: colours of these numbers, one of ``COLORS``.
    :param topics: names of the other topics that another bag gets, with commas between them;
        ``*`` stands for any characters.
    :param compressed: codec of the raw images in a new bag, 'jpeg' or 'png'; '' to keep them.
    """

    source: str
    target: str
    topic: str = ''
    every: int = 1
    start: int = 0
    stop: int = 0
    lossy: bool = False
    limits: tuple[float, float] | None = None
    colors: str = COLORS[0]
    compressed: str = ''
    topics: str = '*'


def convert(request: ConvertRequest) -> int:
    """
    Convert the frames of a source to files.

    :param request: what is converted to what.
    :returns: the exit status.
    :raises ValueError: an argument is invalid.
    """
    names = _check(request)
    log = Log(ConsoleWriter('img_convert'))
    try:
        try:
            with log_if_slow(log, describe_opening(request.source)):
                # A copy of a bag has all of its frames, so no topic need be named.
                is_copy = names.suffix == BAG_SUFFIX and not (
                    request.start or request.stop or request.compressed) and request.every == 1
                opened = open_source(
                    request.source, bag_topic=request.topic or (None if is_copy else ''))
        except KeyboardInterrupt as err:
            raise CaptureError(_NO_FRAME) from err
        with recorded_signals() as is_interrupted, closing(opened) as source:
            return _Conversion(request, names, source, log, is_interrupted).run()
    except TopicError as err:
        raise ValueError(str(err)) from err
    except (CaptureError, RecordingError) as err:
        log.error(str(err))
    return _EXIT_FAILURE


def _check(request: ConvertRequest) -> FileNames:
    """
    Check the arguments that do not need the source.

    :returns: template of the file names.
    :raises ValueError: an argument is invalid.
    """
    if is_camera(request.source):
        raise ValueError(f'{request.source} is a camera: record it with img_publisher and '
                         'img_subscriber')
    if request.topic and not names_bag(request.source):
        raise ValueError(f'--topic is {printable(request.topic)}, but the source '
                         f'{without_password(request.source)} is not a bag')
    if 0 < request.stop <= request.start:
        raise ValueError(f'--start is {request.start}, which is not before --stop {request.stop}')
    if request.limits and not request.lossy:
        raise ValueError(f'--range is {request.limits[0]:g}:{request.limits[1]:g}, but has an '
                         'effect with --lossy only: give --lossy as well')
    check_folder(str(Path(request.target).parent))
    names = FileNames(Path(request.target).name)
    check_format(names.suffix)
    if request.limits and names.suffix in _LOSSLESS_FOR_ALL and not request.compressed:
        raise ValueError(f'--range is {request.limits[0]:g}:{request.limits[1]:g}, but '
                         f'{names.suffix} keeps all numbers: leave the range out, or give a '
                         'target with an extension such as .png or .mp4')
    if request.colors != COLORS[0] and not request.limits:
        raise ValueError(f'--colors is {request.colors}, but has an effect with --lossy and '
                         '--range in pictures and videos only: give --lossy, --range LOW:HIGH '
                         'and a target with an extension such as .png or .mp4')
    if request.compressed and names.suffix != BAG_SUFFIX:
        raise ValueError(f'--compressed is for bags: give a target with the extension '
                         f'{BAG_SUFFIX}, or {names.suffix} without --compressed')
    return names


class _Conversion:
    """A conversion whose source is open."""

    def __init__(
        self, request: ConvertRequest, names: FileNames, source: Source, log: Log,
        is_interrupted: Callable[[], bool],
    ) -> None:
        self._request = request
        self._names = names
        self._source = source
        self._is_interrupted = is_interrupted
        self._folder = user_path(request.target).absolute().parent
        self._log, self._progress = open_progress(log, 'Converting frame', self._total())
        self._failure_log = FailureLog(self._log)
        self._unreadable = 0
        self._others: OtherTopics | None = None
        self._written: Path | None = None  # the only written file, or the folder of several

    def run(self) -> int:
        """Convert the frames and log an account; return the exit status."""
        request, source = self._request, self._source
        for warning in source.warnings:
            self._log.warning(warning)
        if isinstance(source, PatternSource) and not request.stop:
            raise ValueError(f'{request.source} has no end: give --stop')
        if isinstance(source, ImageFileSource):
            source.keeps_jpegs = self._names.suffix in _JPEGS
        if isinstance(source, BagSource) and self._names.suffix == BAG_SUFFIX:
            check_patterns(source, request.topics.split(','))
        elif request.topics != '*':
            name = request.target if isinstance(source, BagSource) else request.source
            raise ValueError('--topics chooses what a bag gets from another beside its frames, '
                             f'but {name} is no bag: leave it out')
        if isinstance(source, BagSource):  # packets are copied from the first one on, or decoded
            source.video.decodes = (self._names.suffix not in KEEPS_PACKETS
                                    or request.every > 1 or request.start > 0)
        frames = numbered_frames(source, request.start, request.stop, request.every, self._skip,
                                 self._is_interrupted)
        with closing(self._progress):
            first = next(frames, None)
            if first is None:
                if self._is_interrupted():
                    raise CaptureError(_NO_FRAME)
                raise CaptureError(f'{source.name} has no readable frame')
            self._check_loss(first[1])
            sink = open_sink(
                self._folder, self._names,
                EncoderSettings(
                    self._names.suffix, compression=request.compressed, lossy=request.lossy,
                    limits=request.limits, colors=request.colors),
                'continue', Limits(), sync=False)
            threads = _threads(first[1])
            recorder = Recorder(
                sink, self._log, queue_size=threads, writers=threads, block=True)
            is_complete = self._record(recorder, sink, chain((first,), frames))
        counts = recorder.counts
        failed = counts.failed + self._unreadable
        count, rate = self._progress.count, self._progress.average_rate()
        self._log.info(
            f'Converted {count} frame{"s" * (count != 1)}{f" at {rate:.1f} Hz" if rate else ""}: '
            f'{counts.written} written to {self._written or self._folder}, {failed} failed'
            + (f', {counts.left_out} left out before a key frame' if counts.left_out else ''))
        for line in self._others.account if self._others else ():
            self._log.info(line)
        failed += self._others.failed if self._others else 0
        is_ok = is_complete and not (failed or counts.left_out or recorder.is_unfinished)
        return _EXIT_OK if is_ok else _EXIT_FAILURE

    def _record(
        self, recorder: Recorder[Any], sink: Sink[Any],
        frames: Iterable[tuple[int, CapturedFrame]],
    ) -> bool:
        """Record frames and finish the files; return False if the source did not end."""
        source, request, others = self._source, self._request, None
        channel: BagChannel | None = None
        if isinstance(source, BagSource) and isinstance(sink, BagSink):
            channel = channel_of(source.topic)
            others = self._others = OtherTopics(source, request.topics.split(','), recorder)
            is_whole = not (request.start or request.stop) and request.every == 1 and (
                request.topics == '*')
            # The account of a recording is not that of a part.
            sink.copy_metadata([one for one in source.metadata
                                if is_whole or not has_account([one])])
        begin_ns, end_ns, received = (-1 if request.start else 0), 0, None
        try:
            for number, frame in frames:
                try:
                    received = received_frame(frame, number, source.rate, channel)
                except ImageError as err:  # a packet of video is damaged
                    self._skip(err)
                    continue
                end_ns = received.receive_ns
                begin_ns = end_ns if begin_ns < 0 else begin_ns
                if others:
                    others.copy(received.metadata, begin_ns, end_ns)
                recorder.put(received, self._note_written)
                self._progress.tick(_description(frame), failed=self._unreadable)
            if not self._is_interrupted():
                if others and received and not request.stop:
                    others.copy(received.metadata, begin_ns, 1 << 64)
                return True
            self._log.error('interrupted')
        except (CaptureError, BagError, OSError) as err:
            self._log.error(str(err))
        finally:
            if others:
                others.close()
            recorder.close()
        return False

    def _note_written(self, outcome: Path | str) -> None:
        """Note the file of a frame; the recorder calls this in the order of the frames."""
        if isinstance(outcome, Path):
            self._written = outcome if self._written in (None, outcome) else self._folder

    def _check_loss(self, frame: CapturedFrame) -> None:
        """
        Check that the target is as lossless as the source, or that a loss is allowed.

        :raises ValueError: a loss is not allowed.
        """
        compressed = self._request.compressed
        frame = frame if compressed else _decoded(frame)
        suffix = COMPRESSED_SUFFIXES.get(compressed, self._names.suffix)
        has_exact_video = frame.encoding in LOSSLESS_ENCODINGS
        is_exact = has_exact_video and suffix == LOSSLESS_VIDEO
        self._check_range(frame, suffix, is_exact)
        if self._request.lossy or suffix in _LOSSLESS_FOR_ALL or is_exact or (
                frame.encoding == VIDEO):
            return
        if frame.encoding != JPEG and find_encoding(frame.encoding).kind in ('bayer', 'yuv'):
            raise ValueError(
                f'{frame.encoding} frames are converted to colour for {suffix}: give --lossy, or '
                f'a target with the extension {" or ".join(_LOSSLESS_FOR_ALL)}'
                + (' without --compressed' if compressed else ''))
        if suffix in _LOSSY_FORMATS and self._is_lossless(frame):
            other = LOSSLESS_VIDEO if has_exact_video else '.tiff' if _is_number(frame) else '.png'
            raise ValueError(
                f'{suffix} loses quality that {self._source.name} has: give --lossy, or a target '
                f'with an extension such as {other} or .mcap'
                + (', with --compressed png or without it' if compressed else ''))

    def _check_range(self, frame: CapturedFrame, suffix: str, is_exact: bool) -> None:
        """
        Check that numbers of more than 8 bits have a range where a format has 8 bits.

        :param is_exact: whether the format keeps all numbers without --lossy.
        :raises ValueError: they have none.
        """
        request, has_eight_bits = self._request, suffix in (*_LOSSY_FORMATS, '.bmp', '.webp')
        if not request.lossy or request.limits or not has_eight_bits or not _is_number(frame):
            return
        least, most = finite_limits(frame.image)
        raise ValueError(
            f'{frame.encoding} frames become 8 bits in {suffix}: give --range '
            'LOW:HIGH, the numbers that become black and white; those of the first frame are '
            f'{least:g} to {most:g}{"; leave out --lossy to keep all numbers" * is_exact}')

    def _is_lossless(self, frame: CapturedFrame) -> bool:
        """Return whether a frame was never compressed with a loss, as far as that is known."""
        if isinstance(self._source, BagSource):
            is_jpeg = frame.encoding == JPEG and frame.image[:2].tobytes() == JPEG_SOI
            return not (is_jpeg or frame.is_video)
        if isinstance(self._source, ImageFileSource):
            return not all(path.suffix.lower() in _JPEGS for path in self._source.paths)
        return isinstance(self._source, PatternSource) or (
            isinstance(self._source, VideoSource) and self._source.is_deep)

    def _total(self) -> int:
        """Return the number of frames to convert; 0 if it is unknown."""
        request = self._request
        end = 0 if self._source.live else self._source.count
        end = min(end or request.stop, request.stop or end)
        return max(0, -(-(end - request.start) // request.every))

    def _skip(self, err: BrokenFrameError | ImageError) -> None:
        """Count and log frames that cannot be read."""
        frames = err.frames if isinstance(err, BrokenFrameError) else 1
        self._unreadable += -(-frames // self._request.every)
        self._failure_log.bad_frame(f'a frame was not read: {err}')


def _decoded(frame: CapturedFrame) -> CapturedFrame:
    """Return a compressed frame of a bag that is no JPEG as pixels, if it can be decoded."""
    if frame.encoding == JPEG and frame.image[:2].tobytes() != JPEG_SOI:
        with suppress(ImageError):  # it counts as failed later
            raw = received_frame(frame, 0, 0.0).decode()
            return replace(frame, pixels=raw.image, encoding=raw.metadata.encoding)
    return frame


def _is_number(frame: CapturedFrame) -> bool:
    return frame.encoding not in (JPEG, VIDEO) and is_number(find_encoding(frame.encoding))


def _threads(first: CapturedFrame) -> int:
    """Return the number of threads: one a processor, as far as the size of a frame allows."""
    return max(1, min(len(os.sched_getaffinity(0)), _QUEUED_BYTES // (first.image.nbytes or 1)))


def _description(frame: CapturedFrame) -> str:
    """Return the size and encoding of a frame, which is not decoded."""
    if frame.encoding in (JPEG, VIDEO):
        return f'{frame.image.nbytes} compressed bytes'
    return f'{frame.image.shape[1]}x{frame.image.shape[0]} {frame.encoding}'
