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

"""Videos: every frame at its time and in its colours, however the file came to its end."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress
import errno
import os
from pathlib import Path
import shutil
import subprocess
import sys
import weakref

import av
from conftest import disk_of
import cv2
import numpy as np
from opencv_tools.image.encodings import ENCODINGS, find_encoding
from opencv_tools.recording.errors import VideoError
from opencv_tools.recording.video.frame import to_video_frame
from opencv_tools.recording.video.unfinished import count_frames
from opencv_tools.recording.video.writer import check_video, VIDEO_FORMATS, VideoWriter
import pytest

START_NS = 1_700_000_000_123_456_789
BLOCK = 8
BITS = 16
TOLERANCE_MS = {'.mp4': 0.02, '.mkv': 0.51, '.avi': 1.7}

every_format = pytest.mark.parametrize('suffix', VIDEO_FORMATS)


def draw(number: int, height: int = 2 * BLOCK) -> np.ndarray:
    """Draw a number in blocks that no compression makes unreadable, above noise."""
    bits = np.array([number >> bit & 1 for bit in range(BITS)], np.uint8) * 255
    noise = np.random.default_rng(number).integers(0, 256, (height, BITS * BLOCK), np.uint8)
    noise[:2 * BLOCK] = np.kron(bits, np.ones((2 * BLOCK, BLOCK), np.uint8))
    return noise


def read(image: np.ndarray) -> int:
    """Read the number that is drawn in an image."""
    blocks = image[:2 * BLOCK].reshape(2 * BLOCK, BITS, BLOCK, -1).mean(axis=(0, 2, 3)) > 127
    return sum(1 << bit for bit in range(BITS) if blocks[bit])


def record(path: Path, frames: dict[int, int], crf: int = 23) -> VideoWriter:
    """Write a video of numbers, each at its time."""
    pictures = {number: to_video_frame(draw(number), 'mono8', path.suffix) for number in frames}
    writer = VideoWriter(path, next(iter(pictures.values())), START_NS, crf)
    for number, time_ns in frames.items():
        writer.write(pictures[number], time_ns)
    writer.close()
    return writer


def play(path: Path) -> Iterator[tuple[float, np.ndarray]]:
    """Give the frames of a video and their times in ms, as OpenCV reads them."""
    capture = cv2.VideoCapture(str(path))
    assert capture.isOpened()
    while True:
        is_read, image = capture.read()
        if not is_read:
            return
        yield capture.get(cv2.CAP_PROP_POS_MSEC), image


def decode(path: Path) -> list[np.ndarray]:
    """Give the frames of a video as PyAV reads them, which raises for what is broken."""
    with av.open(str(path)) as container:
        return [frame.to_ndarray(format='bgr24') for frame in container.decode(video=0)]


def numbers(path: Path) -> list[int]:
    """Read the numbers in a video, by two programs that must agree."""
    found = [read(image) for _, image in play(path)]
    assert found == [read(image) for image in decode(path)]
    return found


@every_format
def test_every_frame_comes_back_at_its_time(tmp_path: Path, suffix: str) -> None:
    steps = np.random.default_rng(3).integers(4_000_000, 200_000_000, 600)
    times = [START_NS + int(step) for step in np.cumsum(steps) - steps[0]]
    assert times[-1] - START_NS > 55 * 10 ** 9
    path = tmp_path / f'video{suffix}'
    writer = record(path, dict(enumerate(times)))
    assert writer.frames == len(times)
    assert writer.bytes_written == path.stat().st_size
    played = [(time, read(image)) for time, image in play(path)]
    assert [number for _, number in played] == list(range(len(times)))
    errors = [time - (true - START_NS) / 1e6 for (time, _), true in zip(played, times)]
    assert np.abs(errors).max() < TOLERANCE_MS[suffix]
    if suffix != '.avi':  # from which FFmpeg does not tell the true times
        with av.open(str(path)) as container:
            decoded = [frame.time * 1e3 for frame in container.decode(video=0)]
        np.testing.assert_allclose(decoded, [time for time, _ in played], atol=0.01)


@every_format
def test_a_long_wait_and_times_that_stand_still(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f'video{suffix}'
    later = [START_NS + 195 * 10 ** 9 + number * 10 ** 8 for number in range(7)]
    record(path, dict(enumerate([START_NS, START_NS, START_NS - 10 ** 8, *later])))
    played = list(play(path))
    assert [read(image) for _, image in played] == list(range(10))
    times = [time for time, _ in played]
    assert times == sorted(set(times))
    assert times[2] < 10
    np.testing.assert_allclose(times[3:], np.arange(195_000, 195_700, 100),
                               atol=TOLERANCE_MS[suffix])


@every_format
def test_a_key_frame_comes_each_second_and_the_comment_tells_the_start(
        tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f'video{suffix}'
    record(path, {number: START_NS + number * 50_000_000 for number in range(100)})
    with av.open(str(path)) as container:
        comment = {key.lower(): value for key, value in container.metadata.items()}['comment']
        keys = [packet.dts * packet.time_base for packet in container.demux(video=0)
                if packet.size and packet.is_keyframe]
    assert comment == 'begins at 1700000000.123456789'
    # The second frame is one, too: with it the first frame is written.
    np.testing.assert_allclose([*map(float, keys)], [0, 0.05, 1, 2, 3, 4], atol=0.01)


@pytest.mark.parametrize('crf', [18, 40])
def test_crf_is_the_quality(tmp_path: Path, crf: int) -> None:
    path = tmp_path / 'video.mkv'
    picture = to_video_frame(draw(0, 128), 'mono8', '.mkv')
    writer = VideoWriter(path, picture, 0, crf)
    writer.write(picture, 0)
    writer.close()
    (image,) = decode(path)
    error = np.abs(image[..., 0].astype(int) - draw(0, 128)).mean()
    assert (error < 5) == (crf == 18)


COLORS = {'red': (0, 0, 255), 'green': (0, 255, 0), 'blue': (255, 0, 0), 'gray': (128, 128, 128),
          'black': (0, 0, 0), 'white': (255, 255, 255), 'brown': (30, 80, 140)}


@every_format
@pytest.mark.parametrize('size', [(64, 96), (63, 95), (64, 95)])
@pytest.mark.parametrize('encoding', ['bgr8', 'rgb8', '8UC3'])
def test_colors_are_true(
        tmp_path: Path, encoding: str, size: tuple[int, int], suffix: str) -> None:
    image = np.empty((*size, 3), np.uint8)
    edges = np.linspace(0, size[1], len(COLORS) + 1).astype(int)
    for color, begin, end in zip(COLORS.values(), edges, edges[1:]):
        image[:, begin:end] = color
    path = tmp_path / f'video{suffix}'
    picture = to_video_frame(image[..., ::-1] if encoding == 'rgb8' else image, encoding, suffix)
    writer = VideoWriter(path, picture, 0, 12)
    writer.write(picture, 0)
    writer.close()
    for kept in (decode(path)[0], next(play(path))[1]):
        assert kept.shape == image.shape
        for name, begin, end in zip(COLORS, edges, edges[1:]):
            patch = kept[4:-4, begin + 4:end - 4].reshape(-1, 3).mean(axis=0)
            assert np.abs(patch - COLORS[name]).max() < 4, (name, patch)
    with av.open(str(path)) as container:
        context = next(iter(container.decode(video=0))) and container.streams.video[0]
        if hasattr(context.codec_context, 'colorspace'):
            assert (context.codec_context.colorspace, context.codec_context.color_range) == (6, 1)


@every_format
def test_gray_stays_gray(tmp_path: Path, suffix: str) -> None:
    ramp = np.repeat(np.arange(256, dtype=np.uint8), 16).reshape(64, 64).repeat(2, axis=1)
    path = tmp_path / f'video{suffix}'
    picture = to_video_frame(ramp, 'mono8', suffix)
    writer = VideoWriter(path, picture, 0, 0)
    writer.write(picture, 0)
    writer.close()
    for kept in (decode(path)[0], next(play(path))[1]):
        assert np.abs(kept.astype(int) - ramp[..., np.newaxis]).max() <= 2


def planes(image: np.ndarray, encoding: str) -> list[np.ndarray]:
    """Give Y, Cb and Cr of a frame as the encoder gets them."""
    frame = to_video_frame(image, encoding, '.mkv').frame
    return [np.frombuffer(plane, np.uint8).reshape(plane.height, plane.line_size)[:, :plane.width]
            for plane in frame.planes]


@pytest.mark.parametrize('size', [(16, 16), (1, 256)])
def test_every_gray_has_the_luma_of_the_standard(size: tuple[int, int]) -> None:
    ramp = np.arange(256, dtype=np.uint8).reshape(size)
    luma, *chroma = planes(ramp, 'mono8')
    np.testing.assert_array_equal(luma, np.rint(16 + 219 / 255 * ramp))
    assert all((plane == 128).all() for plane in chroma)


# Y, Cb and Cr of B, G, R and 1, as tables of the standard have it.
BT_601 = np.array([[24.966, 128.553, 65.481, 16], [112, -74.203, -37.797, 128],
                   [-18.214, -93.786, 112, 128]])


@pytest.mark.parametrize('size', [(2, 4), (3, 5)])
@pytest.mark.parametrize('color', COLORS)
def test_colors_are_those_of_the_standard(color: str, size: tuple[int, int]) -> None:
    image = np.full((*size, 3), COLORS[color], np.uint8)
    expected = BT_601 @ [*np.divide(COLORS[color], 255), 1]
    for frame in (planes(image, 'bgr8'), planes(image[..., ::-1], 'rgb8')):
        for plane, value in zip(frame, expected):
            assert np.abs(plane - value).max() < 0.75


@every_format
@pytest.mark.parametrize('size', [(1, 1), (2, 2), (1, 2), (3, 200), (17, 16), (480, 641)])
def test_no_size_is_cropped_or_padded(
        tmp_path: Path, size: tuple[int, int], suffix: str) -> None:
    path = tmp_path / f'video{suffix}'
    picture = to_video_frame(np.full((*size, 3), (30, 80, 140), np.uint8), 'bgr8', suffix)
    writer = VideoWriter(path, picture, 0)
    for number in range(3):
        writer.write(picture, number * 10 ** 8)
    writer.close()
    for images in (decode(path), [image for _, image in play(path)]):
        assert [image.shape for image in images] == [(*size, 3)] * 3
        assert np.abs(images[-1].astype(int) - (30, 80, 140)).max() < 5


def test_a_size_that_the_encoder_refuses(tmp_path: Path) -> None:
    picture = to_video_frame(np.zeros((2, 40000), np.uint8), 'mono8', '.mp4')
    with pytest.raises(VideoError, match=r'a 40000x2 frame cannot be encoded as \.mp4: '):
        VideoWriter(tmp_path / 'video.mp4', picture, 0)
    assert not list(tmp_path.iterdir())


TAKEN = {'mono8', 'rgb8', 'bgr8', '8UC1', '8UC3', '8U'}
CONVERTED = {'bayer_rggb8', 'bayer_bggr8', 'bayer_gbrg8', 'bayer_grbg8', 'yuv422', 'uyvy',
             'yuv422_yuy2', 'yuyv', 'nv12', 'nv21', 'nv24'}


@pytest.mark.parametrize('to_color', [False, True])
@pytest.mark.parametrize('name', [
    *ENCODINGS, '8U', '8UC1', '8UC2', '8UC3', '8UC4', '8SC1', '16UC1', '16SC3', '32FC1', '64FC3'])
def test_a_frame_is_taken_or_refused(name: str, to_color: bool) -> None:
    encoding = find_encoding(name)
    shape = (encoding.rows(8), 6, encoding.channels)[:2 + (encoding.channels > 1)]
    image = np.full(shape, 100, encoding.dtype)
    if name in TAKEN or (to_color and name in CONVERTED):
        assert to_video_frame(image, name, '.mkv', to_color).stream_format == (6, 8, 'yuv420p')
    else:
        with pytest.raises(VideoError) as caught:
            to_video_frame(image, name, '.mkv', to_color)
        assert str(caught.value) == f'a {name} frame cannot be stored as .mkv'


@pytest.mark.parametrize(('name', 'image', 'color'), [
    ('bayer_rggb8', np.tile(np.uint8([[200, 90], [90, 40]]), (16, 16)), (40, 90, 200)),
    ('bayer_bggr8', np.tile(np.uint8([[40, 90], [90, 200]]), (16, 16)), (40, 90, 200)),
    ('uyvy', np.tile(np.uint8([[[90, 81], [240, 81]]]), (32, 16, 1)), (0, 0, 254)),
    ('nv12', np.vstack([np.full((32, 32), 81, np.uint8),
                        np.tile(np.uint8([90, 240]), (16, 16))]), (0, 0, 254)),
])
def test_raw_colors_are_converted(
        tmp_path: Path, name: str, image: np.ndarray, color: tuple[int, int, int]) -> None:
    path = tmp_path / 'video.mp4'
    picture = to_video_frame(image, name, '.mp4', to_color=True)
    writer = VideoWriter(path, picture, 0, 12)
    writer.write(picture, 0)
    writer.close()
    (kept,) = decode(path)
    assert kept.shape == (32, 32, 3)
    assert np.abs(kept[8:-8, 8:-8].reshape(-1, 3).mean(axis=0) - color).max() < 5


def test_an_empty_frame_is_refused_with_its_size() -> None:
    with pytest.raises(VideoError, match=r'an empty frame \(0x5\) cannot be stored as \.mp4$'):
        to_video_frame(np.zeros((5, 0, 3), np.uint8), 'bgr8', '.mp4')


@pytest.mark.parametrize('size', [(20, 30), (21, 31)])
def test_a_view_is_read_and_not_changed(size: tuple[int, int]) -> None:
    large = np.random.default_rng(1).integers(0, 256, (2 * size[0], 100, 4), np.uint8)
    large.flags.writeable = False
    view = large[::-2, 2:2 + size[1], 2::-1]
    before = large.copy()
    picture = to_video_frame(view, 'bgr8', '.mkv')
    other = to_video_frame(view.copy(), 'bgr8', '.mkv')
    kept = [picture.frame.to_ndarray(format='rgb24') for picture in (picture, other)]
    np.testing.assert_array_equal(*kept)
    np.testing.assert_array_equal(large, before)


@pytest.mark.parametrize(('suffix', 'longest'), [('.mp4', 3600), ('.mkv', 3600), ('.avi', 199)])
def test_what_fits_into_one_file(tmp_path: Path, suffix: str, longest: int) -> None:
    first = to_video_frame(np.zeros((16, 16), np.uint8), 'mono8', suffix)
    writer = VideoWriter(tmp_path / f'video{suffix}', first, START_NS)
    writer.write(first, START_NS)
    color = to_video_frame(np.zeros((16, 16, 3), np.uint8), 'bgr8', suffix)
    wider = to_video_frame(np.zeros((16, 18), np.uint8), 'mono8', suffix)
    second = 10 ** 9
    assert writer.fits(color, START_NS + second)
    assert not writer.fits(wider, START_NS + second)
    assert writer.fits(first, START_NS - second)
    assert not writer.fits(first, START_NS - second - 1)  # such as a bag that begins anew
    assert writer.fits(first, START_NS + longest * second)
    assert not writer.fits(first, START_NS + longest * second + 1)
    writer.close()


@every_format
def test_a_file_that_exists_is_not_touched(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f'video{suffix}'
    path.write_text('kept')
    with pytest.raises(FileExistsError):
        VideoWriter(path, to_video_frame(draw(0), 'mono8', suffix), 0)
    assert path.read_text() == 'kept'


@every_format
def test_a_file_without_a_frame_is_removed(tmp_path: Path, suffix: str) -> None:
    writer = VideoWriter(tmp_path / f'video{suffix}', to_video_frame(draw(0), 'mono8', suffix), 0)
    writer.close()
    writer.close()
    assert not list(tmp_path.iterdir())


@every_format
def test_a_file_that_is_forgotten_is_ended(tmp_path: Path, suffix: str) -> None:
    picture = to_video_frame(draw(7), 'mono8', suffix)
    writer = VideoWriter(tmp_path / f'video{suffix}', picture, 0)
    writer.write(picture, 0)
    del writer
    assert numbers(tmp_path / f'video{suffix}') == [7]


@every_format
@pytest.mark.parametrize('size', [100_000, 250_001])
def test_a_full_disk(tmp_path: Path, size: int, suffix: str) -> None:
    path = tmp_path / f'video{suffix}'
    pictures = [to_video_frame(draw(number, 64), 'mono8', suffix) for number in range(300)]
    with disk_of(size):
        writer = VideoWriter(path, pictures[0], 0)
        with pytest.raises(OSError) as caught:
            for number, picture in enumerate(pictures):
                writer.write(picture, number * 50_000_000)
        for _ in range(2):  # the second time it may not even try
            assert caught.value.errno == errno.EFBIG
            assert caught.value.filename == str(path)
            with pytest.raises(OSError) as caught:
                writer.write(pictures[0], 0)
        taken = writer.frames
        writer.close()
    assert path.stat().st_size == writer.bytes_written <= size
    kept = numbers(path)
    assert kept == list(range(len(kept)))
    assert len(kept) == writer.flushed > 10
    assert taken - 22 <= len(kept) <= taken


@every_format
def test_a_disk_that_is_full_at_the_end(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f'video{suffix}'
    pictures = [to_video_frame(draw(number), 'mono8', suffix) for number in range(25)]
    writer = VideoWriter(path, pictures[0], 0)
    for number, picture in enumerate(pictures):
        writer.write(picture, number * 50_000_000)
    with disk_of(writer.bytes_written + 10):
        with pytest.raises(OSError) as caught:
            writer.close()
        writer.close()
    assert caught.value.errno == errno.EFBIG
    kept = numbers(path)
    assert kept == list(range(writer.flushed))
    assert len(kept) >= (24 if suffix == '.avi' else 20)


@every_format
@pytest.mark.parametrize('room', [100, 300, 1000, 3000])
def test_an_end_that_fits_in_part_keeps_what_it_counts(
        tmp_path: Path, room: int, suffix: str) -> None:
    path = tmp_path / f'video{suffix}'
    pictures = [to_video_frame(draw(number), 'mono8', suffix) for number in range(25)]
    writer = VideoWriter(path, pictures[0], 0)
    for number, picture in enumerate(pictures):
        writer.write(picture, number * 50_000_000)
    with disk_of(writer.bytes_written + room), suppress(OSError):
        writer.close()
    assert count_frames(path) == writer.flushed


@every_format
@pytest.mark.parametrize('height', [16, 128])
def test_what_is_flushed_is_whole_in_the_file(tmp_path: Path, height: int, suffix: str) -> None:
    path, copy = tmp_path / f'video{suffix}', tmp_path / f'copy{suffix}'
    pictures = [to_video_frame(draw(number, height), 'mono8', suffix) for number in range(45)]
    writer = VideoWriter(path, pictures[0], 0)
    flushed = []
    for number, picture in enumerate(pictures):
        writer.write(picture, number * 50_000_000)
        flushed.append(writer.flushed)
        shutil.copy(path, copy)
        assert count_frames(copy) == writer.flushed
    assert flushed[2] >= 1 or (suffix, height) == ('.mkv', 16)  # which writes twice a second
    assert flushed[-1] >= 45 - 22
    writer.close()
    assert writer.flushed == count_frames(path) == 45


@every_format
@pytest.mark.parametrize('height', [16, 128])
def test_no_file_is_larger_than_it_may_be(tmp_path: Path, height: int, suffix: str) -> None:
    for max_bytes in (1, 1000, 6000, 20_001, 60_000, 10**6):
        pictures = [to_video_frame(draw(number, height), 'mono8', suffix) for number in range(60)]
        path = tmp_path / f'{max_bytes}{suffix}'
        writer = VideoWriter(path, pictures[0], 0, max_bytes=max_bytes)
        is_taken = [writer.write(picture, number * 50_000_000)
                    for number, picture in enumerate(pictures)]
        writer.close()
        assert writer.frames == sum(is_taken) == writer.flushed + writer.skipped
        assert is_taken == sorted(is_taken, reverse=True)
        size = path.stat().st_size if path.exists() else 0
        assert size <= max_bytes
        assert writer.flushed == (count_frames(path) if size else 0)
        assert writer.is_full == (writer.flushed < 60)
        if writer.flushed and writer.is_full and suffix != '.avi':  # reckons empty frames twice
            assert max_bytes - size < (10_000 if height > 16 else 600)  # a packet's


@every_format
def test_frames_are_counted_wherever_a_file_was_cut_off(tmp_path: Path, suffix: str) -> None:
    path, copy = tmp_path / f'video{suffix}', tmp_path / f'cut{suffix}'
    record(path, {number: START_NS + number * 50_000_000 for number in range(60)})
    data = path.read_bytes()
    for size in range(0, len(data), len(data) // 40):
        copy.write_bytes(data[:size])
        capture = cv2.VideoCapture(str(copy))
        played = 0
        while capture.read()[0]:
            played += 1
        assert (count_frames(copy) or 0) == played
    assert played >= 40


def test_what_may_be_something_else_is_not_called_empty(
        tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    text, large = tmp_path / 'notes.txt', tmp_path / 'video.mkv'
    text.write_text('precious')
    large.touch()
    os.truncate(large, 8193)  # an MP4 that was cut off at a bad moment cannot be opened, either
    assert count_frames(text) is count_frames(large) is None
    os.truncate(large, 8192)
    assert count_frames(large) == 0
    monkeypatch.setitem(sys.modules, 'av', None)
    assert count_frames(large) is None


def test_a_failure_does_not_keep_the_encoder(tmp_path: Path) -> None:
    picture = to_video_frame(draw(0), 'mono8', '.mkv')
    writer = VideoWriter(tmp_path / 'video.mkv', picture, 0)
    with disk_of(writer.bytes_written + 10), suppress(OSError):
        for number in range(100):
            writer.write(picture, number * 50_000_000)
    assert writer.frames < 99
    writer.close()
    reference = weakref.ref(writer)
    del writer
    assert reference() is None


@every_format
def test_a_disk_that_is_full_at_the_beginning(tmp_path: Path, suffix: str) -> None:
    picture = to_video_frame(draw(0), 'mono8', suffix)
    with disk_of(10), pytest.raises(OSError) as caught:
        VideoWriter(tmp_path / f'video{suffix}', picture, 0)
    assert caught.value.errno == errno.EFBIG
    assert not list(tmp_path.iterdir())


WRITE_UNTIL_KILLED = """
import itertools, pathlib, sys, time
from test_video import draw
from opencv_tools.recording.video.writer import VideoWriter
from opencv_tools.recording.video.frame import to_video_frame
path = pathlib.Path(sys.argv[1])
writer = None
for number in itertools.count():
    picture = to_video_frame(draw(number, 64), 'mono8', path.suffix)
    writer = writer or VideoWriter(path, picture, 0)
    writer.write(picture, number * 50_000_000)
    print(number, flush=True)
    time.sleep(0.002)
"""


@pytest.mark.process
@every_format
@pytest.mark.parametrize('moment', [30, 97, 234])
def test_a_writer_that_is_killed_leaves_a_video(
        tmp_path: Path, moment: int, suffix: str) -> None:
    path = tmp_path / f'video{suffix}'
    with subprocess.Popen(
            [sys.executable, '-c', WRITE_UNTIL_KILLED, str(path)],
            env={**os.environ, 'PYTHONPATH': os.pathsep.join(sys.path)},
            stdout=subprocess.PIPE, text=True) as process:
        for line in process.stdout:
            if int(line) == moment:
                process.kill()
                break
        written = moment + 1 + len(process.stdout.readlines())
    kept = numbers(path)
    assert kept == list(range(len(kept)))
    assert len(kept) >= written - 22  # a second, a frame, and that in the encoder


@pytest.mark.process
def test_pyav_is_not_imported_before_it_is_used() -> None:
    code = 'import opencv_tools.recording.video.writer, sys; sys.exit("av" in sys.modules)'
    assert subprocess.run([sys.executable, '-c', code]).returncode == 0


def test_a_machine_without_the_encoder(monkeypatch: pytest.MonkeyPatch) -> None:
    check_video()

    def find_nothing(*args: object) -> None:
        raise ValueError('libx264')

    monkeypatch.setattr('av.codec.codec.Codec', find_nothing)
    with pytest.raises(VideoError, match=r'libx264.*pip install'):
        check_video()
    monkeypatch.setitem(sys.modules, 'av.codec.codec', None)
    with pytest.raises(VideoError, match=r'PyAV.*pip install av.*apt install python3-av'):
        check_video()
