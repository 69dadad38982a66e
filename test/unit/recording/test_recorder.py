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

"""Frames to files: formats, files that are whole, and a recorder that accounts for each."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import replace
import errno
import fcntl
import io
import json
import os
from pathlib import Path
import random
import subprocess
import sys
import threading
import time
import tracemalloc
from typing import Any

from conftest import DEADLINE, read_manifest, recorded_files
import cv2
import numpy as np
from opencv_tools.image.encodings import find_encoding
from opencv_tools.image.errors import ImageError
from opencv_tools.image_codecs import encode_picture
from opencv_tools.recording.errors import LimitReached, RecordingError, UnwritableError
from opencv_tools.recording.folder import Folder
from opencv_tools.recording.frames import CompressedFrame, RawFrame, ReceivedFrame
from opencv_tools.recording.image_encoder import (
    encode_frame, EncodedImage, EncoderSettings, IMAGE_FORMATS)
from opencv_tools.recording.image_sink import ImageSink
from opencv_tools.recording.manifest import Manifest
from opencv_tools.recording.naming import FileNames, FrameMetadata
from opencv_tools.recording.numbering import Numbering
from opencv_tools.recording.open_sink import open_sink
from opencv_tools.recording.recorder import Recorder, SinkCounts
from opencv_tools.recording.selection import Limits
import pytest
from switching import switching_in

ENCODINGS = ('mono8', 'mono16', 'bgr8', 'rgb8', 'bgra8', 'rgba8', 'bgr16', 'rgb16', 'rgba16',
             '8UC1', '8UC2', '8UC3', '8UC4', '16UC1', '16UC3', '16SC1', '32SC1', '32FC1', '32FC3',
             '64FC1')
NANO = 10**9
NO_LIMITS = Limits()


class Console:
    """Keep what is said."""

    def __init__(self) -> None:
        self.lines: list[str] = []

    def info(self, message: str) -> None:
        self.lines.append(f'info: {message}')

    def warning(self, message: str) -> None:
        self.lines.append(f'warning: {message}')

    def error(self, message: str) -> None:
        self.lines.append(f'error: {message}')


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


class ToldRecorder(Recorder):
    """A recorder that blocks, and keeps what it tells."""

    def __init__(self, files: Any) -> None:
        self.console, self.times_full = Console(), 0
        super().__init__(files, self.console, block=True, on_full=self._count)

    def _count(self) -> None:
        self.times_full += 1


def record(
    folder: Path, count: int, template: str = '{seq:03d}.png', on_exists: str = 'continue',
    limits: Limits = NO_LIMITS, first: int = 0,
) -> ToldRecorder:
    """Record gray frames, one a second, which have their number as their colour."""
    names = FileNames(template)
    recorder = ToldRecorder(
        open_sink(folder, names, EncoderSettings(names.suffix), on_exists, limits, sync=False))
    for number in range(first, first + count):
        recorder.put(gray_frame(number, number))
    recorder.close()
    return recorder


@pytest.mark.parametrize('suffix', IMAGE_FORMATS)
@pytest.mark.parametrize('encoding', ENCODINGS)
def test_a_format_keeps_a_frame_exactly_or_refuses_it(
        tmp_path: Path, encoding: str, suffix: str) -> None:
    image = random_image(encoding)
    path = tmp_path / f'file{suffix}'
    try:
        content = encode_frame(frame_of(image, encoding), EncoderSettings(suffix))
    except UnwritableError as err:
        assert f'a {encoding} frame cannot be stored as {suffix}' in str(err)
        assert str(err).endswith('.npy')
        assert suffix != '.npy'
        return
    assert (content.encoding, content.width, content.height) == (encoding, 8, 10)
    path.write_bytes(b''.join(content.parts()))
    if suffix == '.npy':
        np.testing.assert_array_equal(np.load(path), image)
        return
    kept = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
    expected = image[..., [2, 1, 0, 3][:image.shape[2]]] if encoding.startswith('rgb') else image
    assert kept.dtype == image.dtype and kept.shape == image.shape
    if suffix in ('.jpg', '.jpeg'):
        assert np.abs(kept.astype(int) - cv2.imdecode(cv2.imencode(suffix, expected)[1], -1)
                      ).max() == 0
    else:
        np.testing.assert_array_equal(kept, expected)


@pytest.mark.parametrize(('encoding', 'color'), [
    ('bayer_rggb8', cv2.COLOR_BayerRGGB2BGR), ('bayer_gbrg16', cv2.COLOR_BayerGBRG2BGR),
    ('uyvy', cv2.COLOR_YUV2BGR_UYVY), ('yuv422_yuy2', cv2.COLOR_YUV2BGR_YUYV),
    ('nv12', cv2.COLOR_YUV2BGR_NV12), ('nv21', cv2.COLOR_YUV2BGR_NV21)])
def test_frames_without_colours_of_their_own_become_pictures_or_stay_arrays(
        encoding: str, color: int) -> None:
    image = random_image(encoding)
    picture = encode_frame(frame_of(image, encoding), EncoderSettings('.png'))
    assert picture.encoding == ('bgr16' if encoding.endswith('16') else 'bgr8')
    assert (picture.width, picture.height) == (8, 10)
    np.testing.assert_array_equal(
        cv2.imdecode(np.frombuffer(picture.data, np.uint8), cv2.IMREAD_UNCHANGED),
        cv2.cvtColor(image, color))
    array = encode_frame(frame_of(image, encoding), EncoderSettings('.npy'))
    assert (array.encoding, array.width, array.height) == (encoding, 8, 10)
    assert b''.join(array.parts())[-image.nbytes:] == image.tobytes()


@pytest.mark.parametrize(('encoding', 'is_kept'), [
    ('bayer_rggb8', True), ('bayer_rggb16', True), ('uyvy', False), ('nv12', False)])
def test_nothing_is_converted_when_it_must_not_be(encoding: str, is_kept: bool) -> None:
    image = random_image(encoding)
    settings = EncoderSettings('.png', to_color=False)
    if not is_kept:
        with pytest.raises(UnwritableError, match=f'a {encoding} frame cannot .* to .npy$'):
            encode_frame(frame_of(image, encoding), settings)
        return
    content = encode_frame(frame_of(image, encoding), settings)
    assert content.encoding == encoding
    np.testing.assert_array_equal(
        cv2.imdecode(np.frombuffer(content.data, np.uint8), cv2.IMREAD_UNCHANGED), image)


def test_big_endian_frames_are_kept_by_value() -> None:
    image = random_image('mono16') + 1000
    content = encode_frame(frame_of(image.astype('>u2'), 'mono16'), EncoderSettings('.png'))
    kept = cv2.imdecode(np.frombuffer(content.data, np.uint8), cv2.IMREAD_UNCHANGED)
    np.testing.assert_array_equal(kept, image)


LARGE = np.random.default_rng(4).integers(0, 2**16, (1024, 4096, 2), np.uint16)  # 16 MiB


@pytest.mark.parametrize('image', [
    LARGE, LARGE[:, :-1], LARGE[..., 0], LARGE.astype('>u2'), LARGE[..., 0].T, LARGE[::-1],
    np.zeros((0, 5), np.uint8), np.zeros((5, 0, 3), np.float64), LARGE[:1, :1]],
    ids=['tight', 'rows', 'channel', 'big-endian', 'turned', 'upside down', 'no row', 'no column',
         'pixel'])
def test_an_array_is_written_without_another_one_in_memory(
        image: np.ndarray, tmp_path: Path) -> None:
    encoding = f'16UC{image.shape[2] if image.ndim == 3 else 1}'
    if image.dtype.itemsize != 2:
        encoding = '8UC1' if image.dtype == np.uint8 else '64FC3'
    whole = io.BytesIO()
    np.save(whole, image)
    files = open_sink(tmp_path, FileNames('{seq}.npy'), EncoderSettings('.npy'), 'continue',
                      Limits(), sync=False)
    frame = frame_of(image, encoding)
    tracemalloc.start()
    try:
        prepared = files.prepare(frame)
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    path = files.commit(frame, prepared)
    files.close()
    assert peak < 3 * 2**20
    assert path.read_bytes() == whole.getvalue()
    assert read_manifest(tmp_path)[0]['bytes'] == len(whole.getvalue())


def test_an_array_that_the_disk_has_no_room_for_leaves_nothing(
        tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    files = open_sink(tmp_path, FileNames('{seq}.npy'), EncoderSettings('.npy'), 'continue',
                      Limits(), sync=False)

    def refuse(*_: object) -> None:
        raise OSError(errno.ENOSPC, 'no room')

    monkeypatch.setattr('opencv_tools.regular_files.write_buffer', refuse)
    with pytest.raises(OSError, match='no room'):
        files.prepare(frame_of(random_image('bgr8'), 'bgr8'))
    assert not [*tmp_path.glob('.*.part')]
    files.close()


@pytest.mark.parametrize(('kind', 'sentence'), [
    ('file', 'it is a file or a broken link; set output_dir to a folder'),
    ('link', 'it is a file or a broken link; set output_dir to a folder'),
    ('loop', 'it is a file or a broken link; set output_dir to a folder'),
    ('below a loop', 'its path contains a loop of links; set output_dir to another folder'),
    ('long', 'it is too long for the file system; set output_dir to a shorter path')])
def test_a_folder_that_is_none_is_refused_with_what_helps(
        kind: str, sentence: str, tmp_path: Path) -> None:
    path = tmp_path / ('a' * 256 if kind == 'long' else 'out')
    if kind == 'file':
        path.touch()
    elif kind != 'long':
        path.symlink_to(path if 'loop' in kind else path.with_name('nowhere'))
    if kind == 'below a loop':
        path /= 'out'
    with pytest.raises(RecordingError) as raised:
        open_sink(path, FileNames('{seq}.png'), EncoderSettings('.png'), 'continue', Limits(),
                  sync=False)
    assert str(raised.value).startswith('output_dir ')
    assert str(raised.value).endswith(f' cannot be used: {sentence}')


@pytest.mark.parametrize('suffix', ['.png', '.mp4'])
def test_a_name_that_is_too_long_is_told_with_what_helps(suffix: str, tmp_path: Path) -> None:
    console = Console()
    names = FileNames('a' * 251 + '{seq}' + suffix)
    files = open_sink(tmp_path, names, EncoderSettings(suffix), 'continue', Limits(), sync=False)
    recorder = Recorder(files, console, writers=1)
    recorder.put(gray_frame(0))
    recorder.close()
    assert recorder.counts.failed == 1
    assert [line for line in console.lines if 'too long' in line] == [
        f'error: a frame was not written: the file name {"a" * 37}... has 256 bytes, too long for '
        'the file system (usually 255); shorten file_name']


def test_what_opencv_cannot_encode_is_refused() -> None:
    with pytest.raises(UnwritableError, match=r'^the mono8 frame was not encoded: '):
        encode_frame(frame_of(np.zeros((1, 70_000), np.uint8), 'mono8'), EncoderSettings('.jpg'))


def test_formats_as_they_are_unless_told() -> None:
    assert EncoderSettings('.png') == EncoderSettings(
        '.png', to_color=True, jpeg_quality=95, png_compression=1, crf=23)


def test_an_empty_frame_is_refused_with_its_size() -> None:
    with pytest.raises(UnwritableError, match=r'an empty frame \(0x5\) cannot be stored as \.png'):
        encode_frame(frame_of(np.zeros((5, 0, 3), np.uint8), 'bgr8'), EncoderSettings('.png'))


def test_quality_and_compression_make_smaller_files() -> None:
    image = cv2.GaussianBlur(np.random.default_rng(1).integers(0, 256, (200, 300, 3), np.uint8),
                             (9, 9), 0)
    frame = frame_of(image, 'bgr8')
    jpegs = [len(encode_frame(frame, EncoderSettings('.jpg', jpeg_quality=quality)).data)
             for quality in (100, 95, 50, 1)]
    pngs = [len(encode_frame(frame, EncoderSettings('.png', png_compression=level)).data)
            for level in (0, 1, 9)]
    assert jpegs == sorted(jpegs, reverse=True) and len(set(jpegs)) == 4
    assert pngs == sorted(pngs, reverse=True) and len(set(pngs)) == 3


def compressed(suffix: str, told: str, image: np.ndarray) -> CompressedFrame:
    data = memoryview(encode_picture(image, suffix))
    return CompressedFrame(
        metadata=FrameMetadata(NANO, 'camera', told, '/video_frames/compressed'),
        receive_ns=NANO, data=data)


@pytest.mark.parametrize(('suffix', 'told'), [
    ('.jpg', 'rgb8; jpeg compressed bgr8'), ('.jpeg', 'jpeg'), ('.png', '; png compressed ')])
def test_a_compressed_frame_is_kept_as_it_came(suffix: str, told: str) -> None:
    frame = compressed(suffix, told, random_image('bgr8'))
    content = encode_frame(frame, EncoderSettings(suffix))
    assert content.data is frame.data
    assert (content.encoding, content.width, content.height) == (told, 8, 10)


def test_a_compressed_frame_is_decoded_for_another_format() -> None:
    image = random_image('bgr8')
    content = encode_frame(compressed('.png', 'png', image), EncoderSettings('.npy'))
    assert content.encoding == 'bgr8'
    assert b''.join(content.parts())[-image.nbytes:] == image.tobytes()
    jpeg = encode_frame(compressed('.png', 'png', image), EncoderSettings('.jpg', jpeg_quality=30))
    assert jpeg.data.tobytes() == encode_picture(image, '.jpg', 30).tobytes()


@pytest.mark.parametrize('suffix', ['.jpg', '.png'])
def test_a_compressed_frame_that_is_not_whole_is_refused(suffix: str) -> None:
    whole = compressed(suffix, suffix[1:], np.zeros((300, 300, 3), np.uint8))
    for data in (whole.data[:-20], whole.data[:9], b'', b'text', bytes(whole.data[:2]) * 1000,
                 bytes(whole.data[:2]) + b'\xff' * 1000 + b'\xff\xd9'):
        broken = replace(whole, data=data)
        with pytest.raises(ImageError):
            encode_frame(broken, EncoderSettings(suffix))


def test_frames_are_numbered_in_the_order_they_came(tmp_path: Path) -> None:
    folder = tmp_path / 'a' / 'b'
    recorder = record(folder, 50)
    assert [path.name for path in recorded_files(folder)] == [
        f'{number:03d}.png' for number in range(50)]
    assert gray_numbers(folder) == list(range(50))
    assert vars(recorder.counts) == {'written': 50, 'dropped': 0, 'failed': 0, 'skipped': 0}


def test_the_manifest_tells_of_every_file(tmp_path: Path) -> None:
    record(tmp_path, 3)
    lines = read_manifest(tmp_path)
    assert [line['seq'] for line in lines] == [0, 1, 2]
    del lines[1]['bytes'], lines[1]['sha256']
    assert lines[1] == {
        'seq': 1, 'file': '001.png', 'stamp': {'sec': 1_700_000_001, 'nanosec': 0},
        'receive_time': {'sec': 1_700_000_001, 'nanosec': 5_000_000}, 'frame_id': 'camera',
        'encoding': 'mono8', 'stored_encoding': 'mono8', 'size': [20, 20], 'frames': 1}


def failing(number: int) -> Callable[..., None]:
    """Make a function that fails as the system does."""
    def fail(*_: object) -> None:
        raise OSError(number, os.strerror(number))

    return fail


def picture_files(
        path: Path, template: str, kind: type[ImageSink] = ImageSink) -> ImageSink:
    folder = Folder(path)
    numbering = Numbering(FileNames(template), folder, 'continue')
    return kind(folder, numbering, EncoderSettings('.png'), NO_LIMITS)


class SlowFiles(ImageSink):
    """Write nothing before it may."""

    def __init__(self, *args: object) -> None:
        super().__init__(*args)
        self.has_begun, self.may_write = threading.Event(), threading.Event()

    def prepare(self, frame: ReceivedFrame) -> object:
        self.has_begun.set()
        assert self.may_write.wait(DEADLINE)
        return super().prepare(frame)


@pytest.fixture
def slow_files(tmp_path: Path) -> SlowFiles:
    return picture_files(tmp_path, '{seq:03d}.png', SlowFiles)


def test_a_full_queue_drops_the_oldest(tmp_path: Path, slow_files: SlowFiles) -> None:
    console = Console()
    recorder = Recorder(slow_files, console, queue_size=3, writers=1)
    recorder.put(gray_frame(0))
    assert slow_files.has_begun.wait(DEADLINE)
    made_room = [recorder.put(gray_frame(number)) for number in range(1, 20)]
    slow_files.may_write.set()
    recorder.close()
    assert made_room == [True] * 3 + [False] * 16
    assert gray_numbers(tmp_path) == [0, 17, 18, 19]
    assert [path.name for path in recorded_files(tmp_path)] == [
        '000.png', '001.png', '002.png', '003.png']
    assert vars(recorder.counts) == {'written': 4, 'dropped': 16, 'failed': 0, 'skipped': 0}
    assert [line.partition(':')[0] for line in console.lines] == ['warning']


def test_a_full_queue_blocks_and_loses_nothing(tmp_path: Path, slow_files: SlowFiles) -> None:
    recorder = Recorder(slow_files, Console(), queue_size=3, writers=2, block=True)
    putting = threading.Thread(
        target=lambda: [recorder.put(gray_frame(number)) for number in range(40)])
    putting.start()
    putting.join(0.2)
    assert putting.is_alive()
    slow_files.may_write.set()
    putting.join(DEADLINE)
    recorder.close()
    assert gray_numbers(tmp_path) == list(range(40))
    assert recorder.counts.dropped == 0


def test_one_bad_frame_is_told_once_and_leaves_no_gap(tmp_path: Path) -> None:
    console = Console()
    names = FileNames('{seq}.png')
    sink = open_sink(tmp_path, names, EncoderSettings('.png'), 'continue', Limits(), False)
    recorder = Recorder(sink, console, writers=2)
    for _ in range(5):
        recorder.put(frame_of(np.zeros((2, 2), np.float32), '32FC1'))
        recorder.put(gray_frame(7))
    recorder.close()
    assert (recorder.counts.written, recorder.counts.failed) == (5, 5)
    assert [line['file'] for line in read_manifest(tmp_path)] == [
        f'{number}.png' for number in range(5)]
    assert console.lines == [
        'error: a frame was not written: a 32FC1 frame cannot be stored as .png; '
        'set the extension of file_name to .tif or .tiff or .npy']


def test_an_error_that_nobody_expects_holds_nothing_up(
        tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def stumble(frame: RawFrame, settings: EncoderSettings) -> EncodedImage:
        if frame.image[0, 0] % 3 == 0:
            raise ZeroDivisionError('oops')
        return encode_frame(frame, settings)

    monkeypatch.setattr('opencv_tools.recording.image_sink.encode_frame', stumble)
    recorder = record(tmp_path, 12)
    assert gray_numbers(tmp_path) == [1, 2, 4, 5, 7, 8, 10, 11]
    assert (recorder.counts.written, recorder.counts.failed) == (8, 4)


@pytest.mark.parametrize(('error', 'reason'), [
    (ZeroDivisionError('oops'), 'oops'), (ZeroDivisionError(), 'ZeroDivisionError'),
    (OSError(), 'OSError'), (OSError(errno.EIO, 'Input/output error', 'x'), 'Input/output error'),
    (FileNotFoundError(errno.ENOENT, '', 'x'), 'FileNotFoundError')])
def test_every_error_has_a_reason(
        tmp_path: Path, monkeypatch: pytest.MonkeyPatch, error: Exception, reason: str) -> None:
    def stumble(*_: object) -> None:
        raise error

    monkeypatch.setattr('opencv_tools.recording.image_sink.encode_frame', stumble)
    console, outcomes = Console(), []
    recorder = Recorder(picture_files(tmp_path, '{seq}.png'), console)
    recorder.put(gray_frame(0), outcomes.append)
    recorder.close()
    assert outcomes == [reason]
    assert console.lines == [f'error: a frame was not written: {reason}']


def test_a_folder_that_vanishes_is_made_again(tmp_path: Path) -> None:
    folder, console = tmp_path / 'mount' / 'out', Console()
    sink = open_sink(folder, FileNames('{seq}.png'), EncoderSettings('.png'), 'continue', Limits(),
                     False)
    recorder = Recorder(sink, console, writers=1)

    def put_and_wait(number: int) -> None:
        done = threading.Event()
        recorder.put(gray_frame(number), lambda _: done.set())
        assert done.wait(DEADLINE)

    put_and_wait(0)
    (tmp_path / 'mount').rename(tmp_path / 'away')
    put_and_wait(1)
    put_and_wait(2)
    assert console.lines == ['error: a frame was not written: No such file or directory']
    assert not (tmp_path / 'mount').exists()  # it may be where a disk was
    (tmp_path / 'mount').mkdir()
    put_and_wait(3)
    put_and_wait(4)
    recorder.close()
    assert gray_numbers(folder) == [3, 4]
    assert len(read_manifest(folder)) == 2
    assert console.lines[1:] == ['info: Writing again; 2 frames were not written']
    assert (recorder.counts.written, recorder.counts.failed) == (3, 2)


def test_a_folder_that_cannot_be_made(tmp_path: Path) -> None:
    (tmp_path / 'file').touch()
    with pytest.raises(RecordingError, match=r'output_dir .*/file/out cannot be used'):
        record(tmp_path / 'file' / 'out', 1)


@pytest.mark.parametrize('suffix', ['.png', '.mkv'])
def test_a_manifest_that_cannot_be_read(tmp_path: Path, suffix: str) -> None:
    (tmp_path / 'manifest.jsonl').mkdir()
    with pytest.raises(RecordingError, match=r'output_dir .* cannot be used: Is a directory$'):
        open_sink(tmp_path, FileNames(f'x{suffix}'), EncoderSettings(suffix), 'continue',
                  NO_LIMITS, False)
    assert not list(tmp_path.glob('.*'))


def test_a_file_without_its_line_is_no_file(
        tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def fill_the_disk(file: int, data: Any) -> int:
        return write(file, data[:10] if data[:1] == b'{' else data)

    record(tmp_path, 1)
    write = os.write
    monkeypatch.setattr(os, 'write', fill_the_disk)
    recorder = record(tmp_path, 3, first=1)
    assert recorder.counts.failed == 3
    assert gray_numbers(tmp_path) == [0]
    assert len(read_manifest(tmp_path)) == 1


@pytest.mark.parametrize(('template', 'names'), [
    ('{seq:03d}.png', ['000.png', '001.png', '002.png', '003.png']),
    ('x.png', ['x.png', 'x_1.png', 'x_2.png', 'x_3.png']),
    ('{frame_id}.png', ['camera.png', 'camera_1.png', 'camera_2.png', 'camera_3.png'])])
def test_a_second_recording_continues(tmp_path: Path, template: str, names: list[str]) -> None:
    record(tmp_path, 2, template)
    record(tmp_path, 2, template, first=2)
    assert gray_numbers(tmp_path) == [0, 1, 2, 3]
    lines = read_manifest(tmp_path)
    assert [line['file'] for line in lines] == names
    assert [line['seq'] for line in lines] == [0, 1, 2, 3]


@pytest.mark.parametrize('count', [1, 3])
def test_numbers_go_on_when_the_files_were_taken_away(tmp_path: Path, count: int) -> None:
    record(tmp_path, count)
    for path in recorded_files(tmp_path):
        path.unlink()
    record(tmp_path, 1)
    assert [path.name for path in recorded_files(tmp_path)] == [f'{count:03d}.png']


def test_each_name_has_copies_of_its_own(tmp_path: Path) -> None:
    files = picture_files(tmp_path, '{frame_id}.png')
    gray = gray_frame(0)
    frames = [replace(gray, metadata=replace(gray.metadata, frame_id=name))
              for name in ('a', 'a', 'a', 'b', 'b', 'a')]
    paths = [files.commit(frame, files.prepare(frame)) for frame in frames]
    files.close()
    assert [path.name for path in paths] == [
        'a.png', 'a_1.png', 'a_2.png', 'b.png', 'b_1.png', 'a_3.png']


def test_two_recordings_at_once_share_a_folder(tmp_path: Path) -> None:
    threads = [threading.Thread(target=record, args=(tmp_path, 40)) for _ in range(2)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(DEADLINE)
    assert sorted(gray_numbers(tmp_path)) == sorted([*range(40)] * 2)
    assert len(read_manifest(tmp_path)) == 80


def test_files_are_overwritten_when_that_is_asked(tmp_path: Path) -> None:
    record(tmp_path, 3)
    record(tmp_path, 2, on_exists='overwrite', first=10)
    assert gray_numbers(tmp_path) == [10, 11, 2]
    assert len(read_manifest(tmp_path)) == 3


def test_the_latest_frame_alone_is_kept_under_one_name(tmp_path: Path) -> None:
    record(tmp_path, 250, 'latest.png', on_exists='overwrite')
    assert gray_numbers(tmp_path) == [249]
    assert len(read_manifest(tmp_path)) == 1


def test_files_that_are_there_can_be_an_error(tmp_path: Path) -> None:
    (tmp_path / 'other.txt').touch()
    record(tmp_path, 2, on_exists='error')
    with pytest.raises(RecordingError, match=r'already contains 000\.png; set output_dir'):
        record(tmp_path, 2, on_exists='error')
    assert len([path for path in tmp_path.iterdir() if path.name.startswith('.')]) == 0


def test_a_file_that_comes_from_elsewhere_is_not_touched(tmp_path: Path) -> None:
    names = FileNames('{seq}.png')
    recorder = Recorder(
        open_sink(tmp_path, names, EncoderSettings('.png'), 'error', Limits(), False), Console())
    (tmp_path / '0.png').write_text('mine')
    recorder.put(gray_frame(1))
    recorder.close()
    assert recorder.counts.failed == 1
    assert (tmp_path / '0.png').read_text() == 'mine'


DIE_WITHIN = """
import os, pathlib, sys
from opencv_tools.recording.manifest import Manifest
from test_recorder import gray_frame, picture_files
owner, name = {'link': (os, 'link'), 'unlink': (pathlib.Path, 'unlink'),
               'append': (Manifest, 'append')}[sys.argv[2]]
setattr(owner, name, lambda *_: os._exit(9))
files = picture_files(pathlib.Path(sys.argv[1]), '{seq}.png')
frame = gray_frame(5)
files.commit(frame, files.prepare(frame))
"""


def leave_behind(folder: Path, kill_in: str) -> None:
    """Record a frame, and stop as a killed process does: at once, in the middle of a call."""
    died = subprocess.run([sys.executable, '-c', DIE_WITHIN, str(folder), kill_in], check=False,
                          env={**os.environ, 'PYTHONPATH': os.pathsep.join(sys.path)},
                          timeout=DEADLINE)
    assert died.returncode == 9


@pytest.mark.process
@pytest.mark.parametrize(('kill_in', 'is_there'), [
    ('link', False), ('unlink', True), ('append', True)])
def test_what_a_killed_recording_left_is_put_in_order(
        tmp_path: Path, kill_in: str, is_there: bool) -> None:
    record(tmp_path, 1, '{seq}.png')
    leave_behind(tmp_path, kill_in)
    assert list(tmp_path.glob('.recording-*'))
    assert gray_numbers(tmp_path) == ([0, 5] if is_there else [0])
    record(tmp_path, 1, '{seq}.png', first=9)
    assert gray_numbers(tmp_path) == ([0, 5, 9] if is_there else [0, 9])
    read_manifest(tmp_path)
    assert not list(tmp_path.glob('.*'))


RECORD_UNTIL_KILLED = """
import itertools, logging, pathlib, sys
import numpy as np
from opencv_tools.recording.open_sink import open_sink
from opencv_tools.recording.frames import RawFrame
from opencv_tools.recording.naming import FileNames, FrameMetadata
from opencv_tools.recording.recorder import Recorder
from opencv_tools.recording.selection import Limits
from opencv_tools.recording.image_encoder import EncoderSettings
files = open_sink(pathlib.Path(sys.argv[1]), FileNames('{seq:05d}.png'), EncoderSettings('.png'),
                  'continue', Limits(), False)
recorder = Recorder(files, logging, writers=2, block=True)
for number in itertools.count():
    image = np.full((20, 20), number % 256, np.uint8)
    recorder.put(RawFrame(
        metadata=FrameMetadata(1, '', 'mono8', ''), receive_ns=1, image=image))
"""


@pytest.mark.process
def test_killed_at_any_moment_a_recording_leaves_whole_files(tmp_path: Path) -> None:
    moments = random.Random(5)
    checked: set[Path] = set()
    for _ in range(12):
        with subprocess.Popen(
                [sys.executable, '-c', RECORD_UNTIL_KILLED, str(tmp_path)]) as process:
            try:
                deadline = time.monotonic() + DEADLINE
                while len(recorded_files(tmp_path)) <= len(checked):
                    assert time.monotonic() < deadline
                    assert process.poll() is None
                time.sleep(moments.uniform(0, 0.02))
            finally:
                process.kill()
        for path in set(recorded_files(tmp_path)) - checked:
            picture = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
            assert picture is not None and picture.shape == (20, 20) and np.ptp(picture) == 0, path
            checked.add(path)
    record(tmp_path, 1, '{seq:05d}.png')
    assert [line['seq'] for line in sorted(read_manifest(tmp_path), key=lambda line: line['seq'])
            ] == list(range(len(checked) + 1))
    assert not list(tmp_path.glob('.*'))


def test_a_line_that_was_cut_off_is_dropped(tmp_path: Path) -> None:
    record(tmp_path, 2)
    manifest = tmp_path / 'manifest.jsonl'
    manifest.write_bytes(manifest.read_bytes() + b'{"seq": 2, "fi' + b'x' * 5000)
    record(tmp_path, 1, first=2)
    assert len(read_manifest(tmp_path)) == 3


def test_temporary_files_of_others_stay(tmp_path: Path) -> None:
    other = Folder(tmp_path)
    temporary = other.write((b'content',))
    record(tmp_path, 1)
    assert temporary.exists()
    other.close()


LIMITS = [Limits(max_frames=4, ring=True), Limits(max_seconds=3.5, ring=True)]


@pytest.mark.parametrize(('limits', 'kept'), [
    (LIMITS[0], [248, 249, 250, 251]), (LIMITS[1], [250, 251])])  # what is there is years old
def test_a_ring_keeps_the_newest(tmp_path: Path, limits: Limits, kept: list[int]) -> None:
    (tmp_path / '7.txt').write_text('not ours')
    recorder = record(tmp_path, 250, limits=limits)
    (tmp_path / '7.txt').unlink()
    assert recorder.counts.written == 250
    assert gray_numbers(tmp_path) == [246, 247, 248, 249]
    assert len(read_manifest(tmp_path)) == 4
    record(tmp_path, 2, limits=limits, first=250)  # what is there already counts
    assert gray_numbers(tmp_path) == [number % 256 for number in kept]
    assert [line['seq'] for line in read_manifest(tmp_path)] == kept


@pytest.mark.parametrize('ring', [False, True])
def test_files_take_no_more_bytes_than_they_may(tmp_path: Path, ring: bool) -> None:
    record(tmp_path / 'one', 1, '{seq:03d}.bmp')
    size = (tmp_path / 'one' / '000.bmp').stat().st_size
    limits = Limits(max_bytes=5 * size, ring=ring)
    recorder = record(tmp_path / 'many', 20, '{seq:03d}.bmp', limits=limits)
    told = [f'info: Recording limit reached: max_bytes is {5 * size}, the next file has {size} '
            'bytes']
    assert recorder.console.lines == ([] if ring else told)
    assert recorder.times_full == (0 if ring else 1)
    assert gray_numbers(tmp_path / 'many') == (
        [15, 16, 17, 18, 19] if ring else [0, 1, 2, 3, 4])
    assert len(read_manifest(tmp_path / 'many')) == 5
    assert recorder.is_full is not ring
    assert recorder.counts.written == (20 if ring else 5)
    assert recorder.counts.skipped == (0 if ring else 15)
    assert recorder.counts.failed == 0


@pytest.mark.parametrize('suffix', ['.png', '.npy'])
def test_what_is_on_the_disk_is_asked_for_before_the_name(
        suffix: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    done: list[str] = []

    def note(name: str, call: Callable[..., object]) -> Callable[..., object]:
        return lambda *args: (done.append(name), call(*args))[1]

    monkeypatch.setattr(os, 'fsync', note('fsync', os.fsync))
    monkeypatch.setattr(os, 'link', note('link', os.link))
    Folder(tmp_path).write((b'content',))
    for sync in (True, False):
        files = open_sink(
            tmp_path, FileNames(f'{{seq}}{suffix}'), EncoderSettings(suffix), 'continue', Limits(),
            sync)
        recorder = Recorder(files, Console(), writers=1)
        recorder.put(gray_frame(0))
        recorder.close()
    assert done == ['fsync', 'link', 'link']


@pytest.mark.parametrize('number', [
    errno.EPERM, errno.EOPNOTSUPP, errno.ENOSYS, errno.EMLINK])
def test_a_disk_without_hard_links_overwrites_nothing_either(
        tmp_path: Path, monkeypatch: pytest.MonkeyPatch, number: int) -> None:
    monkeypatch.setattr(os, 'link', failing(number))
    record(tmp_path, 2)
    (tmp_path / '002.png').write_text('mine')
    files = picture_files(tmp_path, '{seq:03d}.png')
    (tmp_path / '003.png').write_text('mine too')
    frame = gray_frame(4)
    assert files.commit(frame, files.prepare(frame)).name == '004.png'
    files.close()
    assert (tmp_path / '003.png').read_text() == 'mine too'
    lines = (tmp_path / 'manifest.jsonl').read_text().splitlines()
    assert [json.loads(line)['seq'] for line in lines] == [0, 1, 4]


def test_a_link_that_fails_otherwise_is_told(
        tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os, 'link', failing(errno.EIO))
    assert record(tmp_path, 2).counts.failed == 2
    assert not list(tmp_path.glob('*.png')) and not list(tmp_path.glob('.*'))


def test_a_file_system_without_locks(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(fcntl, 'flock', failing(errno.ENOLCK))
    record(tmp_path, 2)
    record(tmp_path, 1, first=2)
    assert gray_numbers(tmp_path) == [0, 1, 2]
    assert len(read_manifest(tmp_path)) == 3
    assert not list(tmp_path.glob('.*'))


def test_a_line_is_not_lost_while_another_drops_lines(tmp_path: Path) -> None:
    record(tmp_path, 2)
    manifest = Manifest(tmp_path)
    first, second = manifest.entries()
    threads = []

    def write(lines: Iterable[bytes]) -> Path:
        threads.append(threading.Thread(target=manifest.append, args=[first]))
        threads[0].start()
        threads[0].join(0.3)  # it is over only where nothing keeps it from the file
        path = tmp_path / 'new'
        path.write_bytes(b''.join(lines))
        return path

    manifest.compact(lambda entry: entry == second, write)
    threads[0].join()
    assert manifest.entries() == [second, first]


def test_the_last_lines_of_a_long_manifest(tmp_path: Path) -> None:
    record(tmp_path, 1)
    manifest = Manifest(tmp_path)
    [entry] = manifest.entries()
    lines = [replace(entry, seq=seq).line() for seq in range(6000)]
    (tmp_path / 'manifest.jsonl').write_bytes(b''.join(lines))
    tail = [entry.seq for entry in manifest.tail()]
    assert tail == list(range(tail[0], 6000))
    whole = len(b''.join(lines[tail[0]:]))
    assert whole <= 2 ** 20 < whole + len(lines[tail[0] - 1])


def test_lines_that_are_owed_are_added_by_the_next_recording(tmp_path: Path) -> None:
    record(tmp_path, 3)
    entries = Manifest(tmp_path).entries()
    (tmp_path / 'manifest.jsonl').unlink()
    folder = Folder(tmp_path)
    for entry in entries[:2]:
        folder.defer_line(entry)
    folder.write_journal(entries[2])
    folder.write_journal(replace(entries[2], frame_id=''))  # shorter than what stands there
    os.close(folder._journal)  # as a process that ends
    Folder(tmp_path).close()
    assert [line['seq'] for line in read_manifest(tmp_path)] == [0, 1, 2]
    assert not list(tmp_path.glob('.*'))


def test_what_a_shorter_journal_leaves_of_a_longer_one_is_not_added(tmp_path: Path) -> None:
    record(tmp_path, 3)
    entries = Manifest(tmp_path).entries()
    (tmp_path / 'manifest.jsonl').unlink()
    folder = Folder(tmp_path)
    folder.defer_line(entries[0])
    folder.write_journal(entries[1])
    folder.write_deferred()
    folder.write_journal(entries[0])
    os.close(folder._journal)
    Folder(tmp_path).close()
    assert [entry.seq for entry in Manifest(tmp_path).entries()] == [0]


def test_a_line_of_a_file_that_is_no_more_is_not_added(tmp_path: Path) -> None:
    record(tmp_path, 2)
    entries = Manifest(tmp_path).entries()
    folder = Folder(tmp_path)
    for name in ('manifest.jsonl', '000.png'):
        (tmp_path / name).unlink()
    for entry in entries:
        folder.defer_line(entry)
    folder.write_deferred()
    folder.close()
    assert [line['seq'] for line in read_manifest(tmp_path)] == [1]


def test_lines_of_other_recordings_stay(tmp_path: Path) -> None:
    record(tmp_path, 1, 'other_{seq}.bmp')
    (tmp_path / 'other_0.bmp').unlink()
    record(tmp_path, 150, limits=LIMITS[0])
    assert [entry.name for entry in Manifest(tmp_path).entries()] == [
        'other_0.bmp', '146.png', '147.png', '148.png', '149.png']


def test_a_file_that_cannot_be_discarded_is_left(tmp_path: Path) -> None:
    folder = tmp_path / 'out'
    files = picture_files(folder, '{seq}.png')
    picture = files.prepare(gray_frame(0))
    folder.rename(tmp_path / 'away')
    folder.touch()
    picture.discard()
    assert (tmp_path / 'away' / picture.temporary.name).exists()
    folder.unlink()
    (tmp_path / 'away').rename(folder)
    picture.discard()
    assert not picture.temporary.exists()
    files.close()


def test_lines_of_files_that_are_no_more_are_dropped_meanwhile(tmp_path: Path) -> None:
    names = FileNames('{seq:03d}.png')
    files = open_sink(tmp_path, names, EncoderSettings('.png'), 'continue', LIMITS[0], False)
    lengths = []
    for number in range(250):
        frame = gray_frame(number)
        files.commit(frame, files.prepare(frame))
        lengths.append((tmp_path / 'manifest.jsonl').read_bytes().count(b'\n'))
    assert lengths == [*range(1, 105), *[*range(4, 105)] * 2][:250]
    files.close()
    assert len(read_manifest(tmp_path)) == 4


def test_no_file_stays_open(tmp_path: Path) -> None:
    before = len(list(Path('/proc/self/fd').iterdir()))
    (tmp_path / '.recording-abandoned-.journal').touch()
    (tmp_path / '.recording-abandoned-0.part').touch()
    record(tmp_path, 3)
    assert not list(tmp_path.glob('.*'))
    assert len(list(Path('/proc/self/fd').iterdir())) == before


def test_files_are_for_whom_the_mask_leaves_them_to(tmp_path: Path) -> None:
    before = os.umask(0o026)
    try:
        files = picture_files(tmp_path, '{seq}.png')
        frame = gray_frame(0)
        files.commit(frame, files.prepare(frame))
        modes = {path.suffix: path.stat().st_mode & 0o777 for path in tmp_path.iterdir()}
        files.close()
    finally:
        os.umask(before)
    assert modes == {'.png': 0o640, '.jsonl': 0o640, '.journal': 0o640}


def test_a_folder_that_cannot_be_cleaned_up_is_left_as_it_was(
        tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def open_some(path: Path, *args: Any) -> int:
        if 'abandoned' in path.name:
            raise PermissionError(errno.EACCES, 'Permission denied')
        return open_file(path, *args)

    open_file = os.open
    abandoned = tmp_path / '.recording-abandoned-.journal'
    abandoned.touch()
    monkeypatch.setattr(os, 'open', open_some)
    with pytest.raises(PermissionError):
        Folder(tmp_path)
    assert list(tmp_path.iterdir()) == [abandoned]


def test_one_that_cleaned_up_just_before_leaves_nothing_to_do(
        tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def clean_up_and_lock(file: int, how: int) -> None:
        locked.append(file)
        for path in listed[2 * (len(locked) < 2):]:  # the first lock is that of its own journal
            path.unlink()
        lock(file, how)

    lock, locked = fcntl.flock, []
    for name in ('.journal', '0.part'):
        (tmp_path / f'.recording-abandoned-{name}').touch()
    real_glob = Path.glob
    listed = [*tmp_path.glob('.recording-abandoned*')]
    monkeypatch.setattr(Path, 'glob', lambda path, pattern: iter(
        listed if pattern == '.recording-*' else real_glob(path, pattern)))
    monkeypatch.setattr(fcntl, 'flock', clean_up_and_lock)
    Folder(tmp_path).close()
    assert not list(real_glob(tmp_path, '.recording-*'))


def test_two_that_begin_at_once_clean_up(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def open_after_another(path: Path, *args: Any) -> int:
        if 'abandoned' in path.name:
            path.unlink()
        return open_file(path, *args)

    open_file = os.open
    abandoned = tmp_path / '.recording-abandoned-.journal'
    abandoned.touch()
    monkeypatch.setattr(os, 'open', open_after_another)
    record(tmp_path, 1)
    assert not list(tmp_path.glob('.*'))


@pytest.mark.parametrize('name', ['.journal', 'manifest.jsonl'])
def test_a_file_that_is_removed_as_soon_as_it_is_there_is_made_again(
        tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str) -> None:
    def open_and_remove(path: Path, *args: Any) -> int:
        file = open_file(path, *args)
        if path.name.endswith(name) and not removed:
            removed.append(path)
            path.unlink()
        return file

    open_file, removed = os.open, []
    monkeypatch.setattr(os, 'open', open_and_remove)
    files = picture_files(tmp_path, '{seq}.png')
    assert len(list(tmp_path.glob('.*.journal'))) == 1
    frame = gray_frame(0)
    files.commit(frame, files.prepare(frame))
    files.close()
    assert removed
    assert len(read_manifest(tmp_path)) == 1
    assert not list(tmp_path.glob('.*'))


def test_writers_keep_nobody_from_ending(slow_files: SlowFiles) -> None:
    before = set(threading.enumerate())
    recorder = Recorder(slow_files, Console(), writers=3)
    writers = set(threading.enumerate()) - before
    assert len(writers) == 3 and all(thread.daemon for thread in writers)
    recorder.close()
    assert not any(thread.is_alive() for thread in writers)


class Numbers:
    """Keep the numbers of frames in the order in which they are put in their place."""

    def __init__(self) -> None:
        self.placed: list[int] = []
        self.counts = SinkCounts()

    def prepare(self, frame: RawFrame) -> Numbers:
        return self

    def commit(self, frame: RawFrame, _: Numbers) -> Path:
        self.placed.append(int(frame.image[0, 0]))
        self.counts.kept += 1
        return Path()

    def discard(self) -> None:
        pass

    def close(self) -> None:
        pass


class Unfinished(Numbers):
    """Fail at the end."""

    def close(self) -> None:
        raise OSError(errno.EIO, 'Input/output error', 'x')


def test_an_end_that_fails_is_told_once() -> None:
    console = Console()
    recorder = Recorder(Unfinished(), console)
    recorder.put(gray_frame(0))
    recorder.close()
    recorder.close()
    assert vars(recorder.counts) == {'written': 1, 'dropped': 0, 'failed': 0, 'skipped': 0}
    assert recorder.is_unfinished
    assert console.lines == ['error: the recording was not finished: Input/output error']


class Waiting(Numbers):
    """Keep the frames in memory until there are three, and lose what is there at the end."""

    def commit(self, frame: RawFrame, _: Numbers) -> Path:
        path = super().commit(frame, self)
        self.counts.kept = len(self.placed) // 3 * 3
        return path

    def close(self) -> None:
        self.counts.lost = len(self.placed) - self.counts.kept
        self.counts.reason = 'the disk is full'


def test_a_frame_counts_when_it_is_known_what_became_of_it() -> None:
    console, files = Console(), Waiting()
    recorder = Recorder(files, console, block=True)
    for number in range(5):
        recorder.put(gray_frame(number))
    recorder.close()
    assert vars(recorder.counts) == {'written': 3, 'dropped': 0, 'failed': 2, 'skipped': 0}
    assert console.lines == ['error: a frame was not written: the disk is full']


class Full(Numbers):
    """Be full at the first frame, when the second one is prepared as well."""

    def __init__(self) -> None:
        super().__init__()
        self.discarded = 0
        self._both = threading.Barrier(2)

    def prepare(self, frame: RawFrame) -> Numbers:
        self._both.wait()
        return self

    def commit(self, frame: RawFrame, _: Numbers) -> Path:
        super().commit(frame, self)
        raise LimitReached('no more')

    def discard(self) -> None:
        self.discarded += 1


def test_what_was_prepared_before_the_end_is_left_out() -> None:
    files = Full()
    outcomes: list[object] = []
    recorder = Recorder(files, Console(), writers=2)
    for number in range(2):
        recorder.put(gray_frame(number), outcomes.append)
    recorder.close()
    assert files.placed == [0]
    assert outcomes == ['no more', 'the recording has reached its limits']
    assert (recorder.counts.skipped, files.discarded) == (2, 2)


@pytest.mark.filterwarnings('error::pytest.PytestUnhandledThreadExceptionWarning')
def test_the_order_is_kept_wherever_threads_are_stopped() -> None:
    files = Numbers()
    with switching_in(Recorder._write_all):
        recorder = Recorder(files, Console(), writers=4, block=True)
        for number in range(40):
            recorder.put(gray_frame(number))
        recorder.close()
    assert files.placed == list(range(40))
    assert recorder.counts.written == 40
