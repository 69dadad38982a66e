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

"""Frames for recordings, and recorders that write them."""

from __future__ import annotations

from collections.abc import Callable
import json
import os
from pathlib import Path
import time
from typing import Any

from conftest import recorded_files
from console import Console
import cv2
import numpy as np
from opencv_tools.image.encodings import find_encoding
from opencv_tools.recording.folder import Folder
from opencv_tools.recording.frames import RawFrame
from opencv_tools.recording.image_encoder import EncoderSettings
from opencv_tools.recording.image_sink import ImageSink
from opencv_tools.recording.naming import FileNames, FrameMetadata
from opencv_tools.recording.numbering import Numbering
from opencv_tools.recording.open_sink import open_sink
from opencv_tools.recording.recorder import Recorder, Sink
from opencv_tools.recording.selection import Limits

NANO = 10**9
NO_LIMITS = Limits()


def random_image(encoding: str) -> np.ndarray:
    found = find_encoding(encoding)
    rows = found.rows(10)
    shape = (rows, 8) if found.channels == 1 else (rows, 8, found.channels)
    return np.random.default_rng(4).integers(0, 127, shape).astype(found.dtype)


def frame_of(image: np.ndarray, encoding: str, seconds: float = 0.0) -> RawFrame:
    time_ns = 1_700_000_000 * NANO + round(seconds * NANO)
    return RawFrame(
        metadata=FrameMetadata(time_ns, 'camera', encoding, '/video_frames'), image=image,
        receive_ns=time_ns + 5_000_000, arrival_ns=round(seconds * NANO))


def gray_frame(number: int, seconds: float = 0.0) -> RawFrame:
    return frame_of(np.full((20, 20), number, np.uint8), 'mono8', seconds)


def gray_numbers(folder: Path) -> list[int]:
    return [cv2.imread(str(path), cv2.IMREAD_UNCHANGED)[0, 0] for path in recorded_files(folder)]


class LoggedRecorder(Recorder):
    """A blocking recorder that keeps its log and counts the calls of on_full."""

    def __init__(self, sink: Any) -> None:
        self.console, self.times_full = Console(), 0
        super().__init__(sink, self.console, block=True, on_full=self._count)

    def _count(self) -> None:
        self.times_full += 1


def record(
    folder: Path, count: int, template: str = '{seq:03d}.png', on_exists: str = 'continue',
    limits: Limits = NO_LIMITS, first: int = 0,
) -> LoggedRecorder:
    """Record gray frames, one per second, whose gray is their number."""
    names = FileNames(template)
    recorder = LoggedRecorder(
        open_sink(folder, names, EncoderSettings(names.suffix), on_exists, limits, sync=False))
    for number in range(first, first + count):
        recorder.put(gray_frame(number, number))
    recorder.close()
    return recorder


def failing(number: int) -> Callable[..., None]:
    """Return a function that raises an error of the operating system."""
    def fail(*_: object) -> None:
        raise OSError(number, os.strerror(number))

    return fail


def image_sink(
        path: Path, template: str, kind: type[ImageSink] = ImageSink) -> ImageSink:
    folder = Folder(path)
    numbering = Numbering(FileNames(template), folder, 'continue')
    return kind(folder, numbering, EncoderSettings('.png'), NO_LIMITS)


FIELDS = {
    'seq': 0, 'file': 'a.png', 'stamp': {'sec': 1, 'nanosec': 0},
    'receive_time': {'sec': 1, 'nanosec': 0}, 'frame_id': 'a', 'encoding': 'bgr8',
    'stored_encoding': 'bgr8', 'size': [1, 1], 'bytes': 9, 'sha256': '00', 'frames': 1}
RING = Limits(max_frames=1, ring=True)


def manifest_line(**fields: object) -> bytes:
    return json.dumps(FIELDS | fields).encode() + b'\n'


def record_ring(folder: Path, suffix: str = '.png', count: int = 2) -> None:
    sink = open_sink(folder, FileNames(f'{{frame_id}}{{stamp}}{suffix}'), EncoderSettings(suffix),
                     'continue', RING if suffix == '.png' else Limits(), False)
    try:
        for second in range(count):
            time_ns = (1_700_000_000 + second) * NANO
            metadata = FrameMetadata(time_ns, 'camera', 'mono8', '/video_frames')
            frame = RawFrame(
                metadata=metadata, receive_ns=time_ns, image=np.zeros((20, 20), np.uint8))
            sink.commit(frame, sink.prepare(frame))
    finally:
        sink.close()


def open_videos(
    folder: Path, name: str = 'clip.mkv', on_exists: str = 'continue', limits: Limits = NO_LIMITS,
    monotonic: Callable[[], float] = time.monotonic,
) -> Sink[Any]:
    names = FileNames(name)
    return open_sink(folder, names, EncoderSettings(names.suffix), on_exists, limits, sync=False,
                     monotonic=monotonic)
