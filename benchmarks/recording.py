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

"""Recording speed of 1080p frames, against cv2.imwrite in one run."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from fractions import Fraction
from itertools import cycle, islice
import logging
import os
from pathlib import Path
import re
import signal
import statistics
import sys
import tempfile
import time

import av
import cv2
from figures import add_json_option, Figure, write_figures
from node_process import enter_domain, NodeProcess, START_SECONDS
import numpy as np
from opencv_tools.cv_bridge import CvBridge
from opencv_tools.image.cdr import (
    compressed_image_to_cdr, image_to_cdr, WireCompressedImage, WireHeader)
from opencv_tools.image.encodings import find_encoding
from opencv_tools.image.layout import array_to_wire
from opencv_tools.image_codecs import encode_image
from opencv_tools.nodes.conversion import FrameConverter
from opencv_tools.recording.image_encoder import EncoderSettings
from opencv_tools.recording.naming import FileNames
from opencv_tools.recording.open_sink import open_sink
from opencv_tools.recording.recorder import Recorder
from opencv_tools.recording.selection import Limits
from opencv_tools.topics.messages import COMPRESSED_IMAGE, IMAGE, read_message

CLIP = Path(__file__).resolve().parent.parent / 'test/data/big_buck_bunny_720p.mp4'
SIZE = (1920, 1080)
RATE = 30
PICTURES = 18  # of the clip, as far apart as it has them
TOPIC = '/video_frames'

SPEEDUP = 1.8  # goals
SAVING = 10.0

ROUNDS = 5
RUN_SECONDS = 3.0
POLL_SECONDS = 0.02

_PUBLISHED = re.compile(r'Published ([0-9]+) frames at ([0-9.]+) Hz')
_RECEIVED = re.compile(
    r'Received ([0-9]+) frames at ([0-9.]+) Hz: ([0-9]+) written to .*, '
    r'([0-9]+) dropped, ([0-9]+) failed, ([0-9]+) lost in transit')

# Writes messages to a folder as files of a format; the seconds it took.
Way = Callable[[Sequence[bytes], Path, str], float]


@dataclass(frozen=True, kw_only=True)
class Race:
    """
    Images written in the callback, and by the recorder.

    :param suffix: extension of the files.
    :param frames: number of frames in each run.
    :param theirs: frames per second of each run of cv2.imwrite.
    :param ours: frames per second of each run of the recorder.
    :param their_size: bytes per frame of cv2.imwrite.
    :param our_size: bytes per frame of the recorder.
    """

    suffix: str
    frames: int
    theirs: list[float]
    ours: list[float]
    their_size: float
    our_size: float

    @property
    def ratios(self) -> list[float]:
        """Return the speed ratio of each pair of runs."""
        return [ours / theirs for ours, theirs in zip(self.ours, self.theirs)]

    @property
    def ratio(self) -> float:
        """Median of the ratios."""
        return statistics.median(self.ratios)


@dataclass(frozen=True)
class Load:
    """
    CPU load of a node, without its start.

    :param share: per cent of a core while frames were sent.
    :param per_frame: CPU milliseconds, user and system, of all threads and to its end.
    """

    share: float
    per_frame: float


@dataclass(frozen=True, kw_only=True)
class Recording:
    """
    Counts of the frames of a publisher.

    :param suffix: extension of the files.
    :param sent: frames that were published.
    :param rate: published frames per second.
    :param received: frames that the subscriber received.
    :param kept: frames in files.
    :param dropped: frames that did not fit into the queue.
    :param lost: frames that the subscriber knows it missed.
    :param publisher: its load, per frame sent.
    :param subscriber: its load, per frame kept.
    :param size: bytes of the files for each frame.
    """

    suffix: str
    sent: int
    rate: float
    received: int
    kept: int
    dropped: int
    lost: int
    publisher: Load
    subscriber: Load
    size: float


@dataclass(frozen=True, kw_only=True)
class Passthrough:
    """
    JPEG messages to JPEG files, medians of milliseconds per frame.

    :param kept_cpu: CPU time of writing them unchanged.
    :param encoded_cpu: CPU time of decoding and encoding them.
    :param kept_wall: wall time of writing them unchanged.
    :param encoded_wall: wall time of decoding and encoding them.
    :param ratios: ratio of the CPU times in each pair of runs.
    """

    kept_cpu: float
    encoded_cpu: float
    kept_wall: float
    encoded_wall: float
    ratios: list[float]

    @property
    def ratio(self) -> float:
        """Median of the ratios."""
        return statistics.median(self.ratios)


def clip_frames() -> Iterator[av.VideoFrame]:
    """Yield the frames of the clip."""
    with av.open(str(CLIP)) as container:
        yield from container.decode(video=0)


def clip_pictures() -> list[np.ndarray]:
    """Return 1080p BGR images from the whole clip."""
    frames = list(clip_frames())
    return [frame.reformat(*SIZE, 'bgr24').to_ndarray()
            for frame in frames[::len(frames) // PICTURES][:PICTURES]]


def make_video(path: Path) -> None:
    """Create a 1080p30 video of the clip."""
    with av.open(str(path), 'w') as container:
        stream = container.add_stream('libx264', rate=RATE, options={'preset': 'veryfast'})
        stream.width, stream.height = SIZE
        stream.pix_fmt = 'yuv420p'
        for number, frame in enumerate(clip_frames()):
            scaled = frame.reformat(*SIZE, 'yuv420p')
            scaled.pts, scaled.time_base = number, Fraction(1, RATE)
            scaled.pict_type = 0  # left to the encoder, not that of the clip
            container.mux(stream.encode(scaled))
        container.mux(stream.encode(None))


def folder_here() -> tempfile.TemporaryDirectory[str]:
    """Create a folder on the disk of the project, because /tmp may be in memory."""
    return tempfile.TemporaryDirectory(prefix='.benchmark_', dir='.')


def file_bytes(folder: Path, suffix: str) -> int:
    """Count the bytes of the files of a format."""
    return sum(path.stat().st_size for path in folder.glob(f'*{suffix}'))


def write_in_callback(messages: Sequence[bytes], folder: Path, suffix: str) -> float:
    """Write as the tutorials do, in the callback."""
    bridge = CvBridge()
    began = time.perf_counter()
    for number, serialized in enumerate(messages):
        image = bridge.imgmsg_to_cv2(read_message(serialized, IMAGE))
        if not cv2.imwrite(str(folder / f'{number:06d}{suffix}'), image):
            raise SystemExit('OpenCV wrote no picture')
    return time.perf_counter() - began


def record(messages: Sequence[bytes], folder: Path, suffix: str) -> float:
    """Write as the subscriber does, until all are on the disk and in the manifest."""
    sink = open_sink(folder, FileNames(f'{{seq:06d}}{suffix}'), EncoderSettings(suffix),
                     'continue', Limits(), sync=False)
    converter = FrameConverter(CvBridge())
    recorder = Recorder(sink, logging.getLogger(), block=True)
    began = time.perf_counter()
    for serialized in messages:
        recorder.put(converter.convert(read_message(serialized, IMAGE), TOPIC, time.time_ns()))
    recorder.close()
    seconds = time.perf_counter() - began
    if recorder.counts.written != len(messages):
        raise SystemExit(f'not every frame was written: {recorder.counts}')
    return seconds


def run(way: Way, messages: Sequence[bytes], suffix: str) -> tuple[float, float]:
    """Write messages and return the frames per second and the bytes per frame."""
    with folder_here() as folder:
        seconds = way(messages, Path(folder), suffix)
        size = file_bytes(Path(folder), suffix)
    return len(messages) / seconds, size / len(messages)


def race(messages: Sequence[bytes], suffix: str) -> Race:
    """Write in both ways in turn, so that a disturbance affects both."""
    run(record, messages, suffix)
    rate, _ = run(write_in_callback, messages, suffix)
    many = list(islice(cycle(messages), max(len(messages), round(rate * RUN_SECONDS))))
    theirs, ours = zip(*[(run(write_in_callback, many, suffix), run(record, many, suffix))
                         for _ in range(ROUNDS)])
    return Race(suffix=suffix, frames=len(many), theirs=[rate for rate, _ in theirs],
                ours=[rate for rate, _ in ours], their_size=theirs[0][1], our_size=ours[0][1])


class CountedNode(NodeProcess):
    """A node process with its CPU time and the counts in its last log line."""

    def start(self, phrase: str) -> None:
        """Wait until the node is ready; earlier CPU time is not counted."""
        self.wait_for(phrase)
        self._start_cpu, self._cpu = self.cpu(), 0.0

    def cpu_since_start(self) -> float:
        """Return the CPU time in s since the start of the measurement."""
        return (self._cpu if self._has_ended() else self.cpu()) - self._start_cpu

    def wait(self, seconds: float) -> None:
        """Wait until the node has ended."""
        deadline = time.monotonic() + seconds
        while not self._has_ended() and time.monotonic() < deadline:
            time.sleep(POLL_SECONDS)

    def finish(self) -> None:
        """End the node if it is still running."""
        for number in (signal.SIGINT, signal.SIGKILL):
            if not self._has_ended():
                self.process.send_signal(number)
                self.wait(START_SECONDS)

    def counts(self, summary: re.Pattern[str]) -> list[float]:
        """Return the numbers of the summary."""
        said = summary.search(self.console())
        if self.process.returncode != 0 or not said or said[1] == '0':
            raise SystemExit(f'the {self.name} ended with {self.process.returncode}:\n'
                             f'{self.console()}')
        return [float(number) if '.' in number else int(number) for number in said.groups()]

    def _has_ended(self) -> bool:
        if self.process.returncode is None:
            pid, status, usage = os.wait4(self.process.pid, os.WNOHANG)
            if pid:
                self.process.returncode = os.waitstatus_to_exitcode(status)
                self._cpu = usage.ru_utime + usage.ru_stime
        return self.process.returncode is not None


def record_publisher(
    source: Path | str, suffix: str, seconds: float, rate: float = RATE,
) -> Recording:
    """Publish a source with our publisher and record it with our subscriber."""
    frames = round(seconds * rate)
    nodes: list[CountedNode] = []
    with folder_here() as folder:
        files = Path(folder) / 'frames'
        try:
            nodes.append(CountedNode('subscriber', Path(folder), output_dir=files,
                                     file_name=f'"{{seq:06d}}{suffix}"', png_compression=1))
            nodes[0].start('Waiting for ')
            nodes.append(CountedNode('publisher', Path(folder), source=source, publish_rate=0.0,
                                     loop=0, max_frames=frames, wait_for_subscribers=1))
            subscriber, publisher = nodes
            publisher.start(' opened: ')
            publisher.wait(START_SECONDS + 2 * seconds)
            cpu = subscriber.cpu_since_start()
            time.sleep(1)  # for frames that are in transit
        finally:
            for node in reversed(nodes):
                node.finish()
        sent, rate = publisher.counts(_PUBLISHED)
        received, _, kept, dropped, failed, lost = subscriber.counts(_RECEIVED)
        if failed or not kept:
            raise SystemExit(f'{failed} frames failed, {kept} were kept')
        percent, milliseconds = 100 * rate / sent, 1000
        publishing, writing = publisher.cpu_since_start(), subscriber.cpu_since_start()
        return Recording(
            suffix=suffix, sent=sent, rate=rate, received=received, kept=kept, dropped=dropped,
            lost=lost, publisher=Load(publishing * percent, publishing / sent * milliseconds),
            subscriber=Load(cpu * percent, writing / kept * milliseconds),
            size=file_bytes(files, suffix) / kept)


def write_compressed(messages: Sequence[bytes], encode: bool) -> tuple[float, float]:
    """Write JPEG messages on this thread; CPU and wall milliseconds per frame."""
    converter = FrameConverter(CvBridge())
    with folder_here() as folder:
        files = open_sink(Path(folder), FileNames('{seq:06d}.jpg'), EncoderSettings('.jpg'),
                          'continue', Limits(), sync=False)
        began, cpu = time.perf_counter(), time.process_time()
        for serialized in messages:
            frame = converter.convert(
                read_message(serialized, COMPRESSED_IMAGE), TOPIC, time.time_ns())
            frame = frame.decode() if encode else frame
            files.commit(frame, files.prepare(frame))
        cpu, wall = time.process_time() - cpu, time.perf_counter() - began
        files.close()
    return cpu / len(messages) * 1e3, wall / len(messages) * 1e3


def pass_through(pictures: Sequence[np.ndarray]) -> Passthrough:
    """Compare writing JPEG messages unchanged with decoding and encoding them."""
    messages = 20 * [compressed_image_to_cdr(WireCompressedImage(
        header=WireHeader(0, 0, 'camera'), format='bgr8; jpeg compressed bgr8',
        data=encode_image(picture, '.jpg')))
        for picture in pictures]
    write_compressed(messages, False)
    pairs = [(write_compressed(messages, False), write_compressed(messages, True))
             for _ in range(ROUNDS)]
    kept, encoded = np.median(pairs, axis=0).tolist()
    return Passthrough(
        kept_cpu=kept[0], encoded_cpu=encoded[0], kept_wall=kept[1], encoded_wall=encoded[1],
        ratios=[encoded_pair[0] / kept_pair[0] for kept_pair, encoded_pair in pairs])


def verdict(ratio: float, goal: float) -> str:
    """Return whether a ratio reaches its goal."""
    return f'goal {goal:g} {"met" if ratio >= goal else "missed"}'


def listed(ratios: Sequence[float]) -> str:
    """Return the single ratios as text."""
    return ' '.join(f'{ratio:.2f}' for ratio in ratios)


def print_race(result: Race) -> None:
    """Print a line of the first table."""
    print(f'{result.suffix:6}{result.frames:8}{statistics.median(result.theirs):12.1f}'
          f'{statistics.median(result.ours):10.1f}{result.their_size:12.0f}'
          f'{result.our_size:10.0f}{result.ratio:8.2f}  {verdict(result.ratio, SPEEDUP)} '
          f'({listed(result.ratios)})', flush=True)


def print_heading(title: str, publisher: str, seconds: float) -> None:
    """Print the head of the table of recordings."""
    print(f'{title} for {seconds:g} s; CPU in % of a core and in ms, without the start of the '
          'nodes\n'
          f'{"":50}{publisher:>19}{"subscriber":>19}\n'
          f'{"":6}{"sent":>6}{"Hz":>7}{"received":>10}{"kept":>6}{"dropped":>9}{"lost":>6}'
          f'{"CPU %":>9}{"ms/sent":>10}{"CPU %":>9}{"ms/kept":>10}{"bytes/kept":>13}')


def print_recording(result: Recording) -> None:
    """Print a line of the second table."""
    print(f'{result.suffix:6}{result.sent:6}{result.rate:7.1f}{result.received:10}'
          f'{result.kept:6}{result.dropped:9}{result.lost:6}'
          + ''.join(f'{load.share:9.1f}{load.per_frame:10.2f}'
                    for load in (result.publisher, result.subscriber))
          + f'{result.size:13.0f}', flush=True)


def print_passthrough(result: Passthrough) -> None:
    """Print the third table."""
    print(f'{"":20}{"CPU ms/frame":>13}{"wall ms/frame":>15}\n'
          f'{"as they came":20}{result.kept_cpu:13.3f}{result.kept_wall:15.3f}\n'
          f'{"decoded, encoded":20}{result.encoded_cpu:13.3f}{result.encoded_wall:15.3f}\n'
          f'ratio of the CPU {result.ratio:.1f}, {verdict(result.ratio, SAVING)} '
          f'({listed(result.ratios)})', flush=True)


def ratio_figure(name: str, ratio: float, goal: float) -> Figure:
    """Return a ratio with its goal as a figure."""
    return Figure('recording', name, ratio, 'x', f'at least {goal:g}', ratio >= goal)


def recording_figures(result: Recording) -> list[Figure]:
    """Return the counts of frames and the CPU loads as text."""
    kind = f'1080p{RATE} to {result.suffix}'
    return [Figure('recording', f'{kind}, frames kept', result.kept / result.sent * 100, '%'),
            Figure('recording', f'{kind}, CPU of the publisher', result.publisher.per_frame,
                   'ms/frame'),
            Figure('recording', f'{kind}, CPU of the subscriber', result.subscriber.per_frame,
                   'ms/frame')]


def measure(seconds: float) -> list[Figure]:
    """Measure and print each section, and return the figures."""
    pictures = clip_pictures()
    encoding = find_encoding('bgr8')
    messages = [image_to_cdr(array_to_wire(picture, encoding)) for picture in pictures]
    print(f'{len(os.sched_getaffinity(0))} cores, OpenCV {cv2.__version__} with '
          f'{cv2.getNumThreads()} threads, PyAV {av.__version__}, medians of {ROUNDS}\n')

    print('1080p PNG and JPEG: frames per second against one cv2.imwrite per callback\n'
          f'{"":14}{"frames per second":>22}{"bytes per frame":>22}\n'
          f'{"":6}{"frames":>8}' + f'{"imwrite":>12}{"recorder":>10}' * 2 + f'{"ratio":>8}')
    figures = []
    for suffix in ('.png', '.jpg'):
        raced = race(messages, suffix)
        print_race(raced)
        figures.append(ratio_figure(f'1080p to {suffix} against cv2.imwrite', raced.ratio,
                                    SPEEDUP))

    print_heading(f'\n1080p{RATE} from our publisher', 'publisher, decodes', seconds)
    with folder_here() as folder:
        video = Path(folder) / 'video.mp4'
        make_video(video)
        for suffix in ('.png', '.jpg', '.mp4'):
            recording = record_publisher(video, suffix, seconds)
            print_recording(recording)
            figures += recording_figures(recording)

    print('\nCompressed passthrough against decode + encode, 1080p JPEG on one thread')
    passthrough = pass_through(pictures)
    print_passthrough(passthrough)
    figures.append(ratio_figure('CPU of decode + encode against passthrough, 1080p JPEG',
                                passthrough.ratio, SAVING))
    return figures


def main(description: str | None, measure: Callable[[float], list[Figure]]) -> int:
    """
    Print the figures; the exit status is 1 when a goal is missed.

    :param description: description of the command.
    :param measure: prints and returns the figures for a number of seconds.
    """
    parser = argparse.ArgumentParser(description=description)
    parser.add_argument('--seconds', type=float, default=20, help='to record each format for')
    add_json_option(parser)
    options = parser.parse_args()
    if options.seconds < 1:
        parser.error('give a second or more')
    enter_domain()
    figures = measure(options.seconds)
    if options.json:
        write_figures(options.json, figures)
    return 1 if any(figure.met is False for figure in figures) else 0


if __name__ == '__main__':
    sys.exit(main(__doc__, measure))
