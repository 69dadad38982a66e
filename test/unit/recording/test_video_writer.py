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

"""Video files: times, colours, sizes, full disks and killed writers."""

from __future__ import annotations

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
import numpy as np
from opencv_tools.recording.errors import VideoError
from opencv_tools.recording.video.writer import (
    check_video, count_frames, to_video_frame, VideoWriter)
import pytest
from videos import (
    COLORS, decode, draw, every_format, numbers, play, read, record, START_NS, TOLERANCE_MS)


@every_format
def test_every_frame_is_played_at_its_time(tmp_path: Path, suffix: str) -> None:
    steps = np.random.default_rng(3).integers(4_000_000, 600_000_000, 200)
    times = [START_NS + int(step) for step in np.cumsum(steps) - steps[0]]
    assert times[-1] - START_NS > 55 * 10 ** 9
    path = tmp_path / f'video{suffix}'
    writer = record(path, dict(enumerate(times)))
    assert writer.frames == len(times)
    assert writer.file.size == path.stat().st_size
    played = [(time, read(image)) for time, image in play(path)]
    assert [number for _, number in played] == list(range(len(times)))
    errors = [time - (true - START_NS) / 1e6 for (time, _), true in zip(played, times)]
    assert np.abs(errors).max() < TOLERANCE_MS[suffix]
    if suffix != '.avi':  # FFmpeg does not read the true times of an AVI
        with av.open(str(path)) as container:
            decoded = [frame.time * 1e3 for frame in container.decode(video=0)]
        np.testing.assert_allclose(decoded, [time for time, _ in played], atol=0.01)


@every_format
def test_long_gap_and_equal_times_between_frames(tmp_path: Path, suffix: str) -> None:
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
def test_key_frame_each_second_and_start_time_in_the_comment(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f'video{suffix}'
    record(path, {number: START_NS + number * 50_000_000 for number in range(100)})
    with av.open(str(path)) as container:
        comment = {key.lower(): value for key, value in container.metadata.items()}['comment']
        keys = [packet.dts * packet.time_base for packet in container.demux(video=0)
                if packet.size and packet.is_keyframe]
    assert comment == 'begins at 1700000000.123456789'
    # The second frame is a key frame too, so that the first frame is written.
    np.testing.assert_allclose([*map(float, keys)], [0, 0.05, 1, 2, 3, 4], atol=0.01)


@pytest.mark.parametrize('crf', [18, 40])
def test_crf_determines_the_quality(tmp_path: Path, crf: int) -> None:
    path = tmp_path / 'video.mkv'
    picture = to_video_frame(draw(0, 128), 'mono8', '.mkv')
    writer = VideoWriter(path, picture, 0, crf)
    writer.write(picture, 0)
    writer.close()
    (image,) = decode(path)
    error = np.abs(image[..., 0].astype(int) - draw(0, 128)).mean()
    assert (error < 5) == (crf == 18)


@every_format
@pytest.mark.parametrize('size', [(64, 96), (63, 95), (64, 95)])
@pytest.mark.parametrize('encoding', ['bgr8', 'rgb8', '8UC3'])
def test_colors_survive_encoding(
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
def test_gray_survives_encoding(tmp_path: Path, suffix: str) -> None:
    ramp = np.repeat(np.arange(256, dtype=np.uint8), 16).reshape(64, 64).repeat(2, axis=1)
    path = tmp_path / f'video{suffix}'
    picture = to_video_frame(ramp, 'mono8', suffix)
    writer = VideoWriter(path, picture, 0, 0)
    writer.write(picture, 0)
    writer.close()
    for kept in (decode(path)[0], next(play(path))[1]):
        assert np.abs(kept.astype(int) - ramp[..., np.newaxis]).max() <= 2


@every_format
@pytest.mark.parametrize('size', [(1, 1), (2, 2), (1, 2), (3, 200), (17, 16), (480, 641)])
def test_no_size_is_cropped_or_padded(tmp_path: Path, size: tuple[int, int], suffix: str) -> None:
    path = tmp_path / f'video{suffix}'
    picture = to_video_frame(np.full((*size, 3), (30, 80, 140), np.uint8), 'bgr8', suffix)
    writer = VideoWriter(path, picture, 0)
    for number in range(3):
        writer.write(picture, number * 10 ** 8)
    writer.close()
    for images in (decode(path), [image for _, image in play(path)]):
        assert [image.shape for image in images] == [(*size, 3)] * 3
        assert np.abs(images[-1].astype(int) - (30, 80, 140)).max() < 5


def test_size_that_the_encoder_refuses(tmp_path: Path) -> None:
    picture = to_video_frame(np.zeros((2, 40000), np.uint8), 'mono8', '.mp4')
    with pytest.raises(VideoError, match=r'a 40000x2 frame cannot be encoded as \.mp4: '):
        VideoWriter(tmp_path / 'video.mp4', picture, 0)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(('suffix', 'longest'), [('.mp4', 3600), ('.mkv', 3600), ('.avi', 199)])
def test_frames_that_fit_into_one_file(tmp_path: Path, suffix: str, longest: int) -> None:
    first = to_video_frame(np.zeros((16, 16), np.uint8), 'mono8', suffix)
    writer = VideoWriter(tmp_path / f'video{suffix}', first, START_NS)
    writer.write(first, START_NS)
    color = to_video_frame(np.zeros((16, 16, 3), np.uint8), 'bgr8', suffix)
    wider = to_video_frame(np.zeros((16, 18), np.uint8), 'mono8', suffix)
    second = 10 ** 9
    assert writer.fits(color, START_NS + second)
    assert not writer.fits(wider, START_NS + second)
    assert writer.fits(first, START_NS - second)
    assert not writer.fits(first, START_NS - second - 1)  # for example a bag that starts again
    assert writer.fits(first, START_NS + longest * second)
    assert not writer.fits(first, START_NS + longest * second + 1)
    writer.close()


@every_format
def test_existing_file_is_not_changed(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f'video{suffix}'
    path.write_text('kept')
    with pytest.raises(FileExistsError):
        VideoWriter(path, to_video_frame(draw(0), 'mono8', suffix), 0)
    assert path.read_text() == 'kept'


@every_format
def test_file_without_a_frame_is_removed(tmp_path: Path, suffix: str) -> None:
    writer = VideoWriter(tmp_path / f'video{suffix}', to_video_frame(draw(0), 'mono8', suffix), 0)
    writer.close()
    writer.close()
    assert not list(tmp_path.iterdir())


@every_format
def test_file_of_another_program_is_not_removed(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f'video{suffix}'
    writer = VideoWriter(path, to_video_frame(draw(0), 'mono8', suffix), 0)
    path.unlink()
    path.write_text('kept')
    writer.close()
    assert path.read_text() == 'kept'


@every_format
def test_file_of_a_forgotten_writer_is_finished(tmp_path: Path, suffix: str) -> None:
    picture = to_video_frame(draw(7), 'mono8', suffix)
    writer = VideoWriter(tmp_path / f'video{suffix}', picture, 0)
    writer.write(picture, 0)
    del writer
    assert numbers(tmp_path / f'video{suffix}') == [7]


@pytest.mark.quick_cases(3)
@every_format
@pytest.mark.parametrize('size', [100_000, 250_001])
def test_full_disk_keeps_the_complete_frames(tmp_path: Path, size: int, suffix: str) -> None:
    path = tmp_path / f'video{suffix}'
    pictures = [to_video_frame(draw(number, 64), 'mono8', suffix) for number in range(300)]
    with disk_of(size):
        writer = VideoWriter(path, pictures[0], 0)
        with pytest.raises(OSError) as caught:
            for number, picture in enumerate(pictures):
                writer.write(picture, number * 50_000_000)
        for _ in range(2):  # the second call must not try again
            assert caught.value.errno == errno.EFBIG
            assert caught.value.filename == str(path)
            with pytest.raises(OSError) as caught:
                writer.write(pictures[0], 0)
        taken = writer.frames
        writer.close()
    assert path.stat().st_size == writer.file.size <= size
    kept = numbers(path)
    assert kept == list(range(len(kept)))
    assert len(kept) == writer.flushed > 10
    assert taken - 22 <= len(kept) <= taken


@every_format
def test_disk_that_is_full_at_the_end(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f'video{suffix}'
    pictures = [to_video_frame(draw(number), 'mono8', suffix) for number in range(25)]
    writer = VideoWriter(path, pictures[0], 0)
    for number, picture in enumerate(pictures):
        writer.write(picture, number * 50_000_000)
    with disk_of(writer.file.size + 10):
        with pytest.raises(OSError) as caught:
            writer.close()
        writer.close()
    assert caught.value.errno == errno.EFBIG
    kept = numbers(path)
    assert kept == list(range(writer.flushed))
    assert len(kept) >= (24 if suffix == '.avi' else 20)


@every_format
@pytest.mark.parametrize('room', [100, 300, 1000, 3000])
def test_partly_written_end_keeps_the_counted_frames(
        tmp_path: Path, room: int, suffix: str) -> None:
    path = tmp_path / f'video{suffix}'
    pictures = [to_video_frame(draw(number), 'mono8', suffix) for number in range(25)]
    writer = VideoWriter(path, pictures[0], 0)
    for number, picture in enumerate(pictures):
        writer.write(picture, number * 50_000_000)
    with disk_of(writer.file.size + room), suppress(OSError):
        writer.close()
    assert count_frames(path) == writer.flushed


@pytest.mark.quick_cases(3)
@every_format
@pytest.mark.parametrize('height', [16, 128])
def test_flushed_frames_are_complete_in_the_file(tmp_path: Path, height: int, suffix: str) -> None:
    path, copy = tmp_path / f'video{suffix}', tmp_path / f'copy{suffix}'
    pictures = [to_video_frame(draw(number, height), 'mono8', suffix) for number in range(45)]
    writer = VideoWriter(path, pictures[0], 0)
    flushed = []
    for number, picture in enumerate(pictures):
        writer.write(picture, number * 50_000_000)
        flushed.append(writer.flushed)
        shutil.copy(path, copy)
        assert count_frames(copy) == writer.flushed
    assert flushed[2] >= 1 or (suffix, height) == ('.mkv', 16)  # Matroska writes twice a second
    assert flushed[-1] >= 45 - 22
    writer.close()
    assert writer.flushed == count_frames(path) == 45


@pytest.mark.quick_cases(3)
@every_format
@pytest.mark.parametrize('height', [16, 128])
def test_no_file_is_larger_than_max_bytes(tmp_path: Path, height: int, suffix: str) -> None:
    pictures = [to_video_frame(draw(number, height), 'mono8', suffix) for number in range(60)]
    for max_bytes in (1, 1000, 6000, 20_001, 60_000, 10**6):
        path = tmp_path / f'{max_bytes}{suffix}'
        writer = VideoWriter(path, pictures[0], 0, room=max_bytes.__ge__)
        is_taken = [writer.write(picture, number * 50_000_000)
                    for number, picture in enumerate(pictures)]
        writer.close()
        assert writer.frames == sum(is_taken) == writer.flushed + writer.skipped
        assert is_taken == sorted(is_taken, reverse=True)
        size = path.stat().st_size if path.exists() else 0
        assert size <= max_bytes
        assert writer.flushed == (count_frames(path) if size else 0)
        assert writer.is_full == (writer.flushed < 60)
        if writer.flushed and writer.is_full and suffix != '.avi':  # AVI counts empty frames twice
            assert max_bytes - size < (10_000 if height > 16 else 600)  # a packet's


def test_failure_releases_the_encoder(tmp_path: Path) -> None:
    picture = to_video_frame(draw(0), 'mono8', '.mkv')
    writer = VideoWriter(tmp_path / 'video.mkv', picture, 0)
    with disk_of(writer.file.size + 10), suppress(OSError):
        for number in range(100):
            writer.write(picture, number * 50_000_000)
    assert writer.frames < 99
    writer.close()
    reference = weakref.ref(writer)
    del writer
    assert reference() is None


@every_format
def test_disk_that_is_full_at_the_beginning(tmp_path: Path, suffix: str) -> None:
    picture = to_video_frame(draw(0), 'mono8', suffix)
    with disk_of(10), pytest.raises(OSError) as caught:
        VideoWriter(tmp_path / f'video{suffix}', picture, 0)
    assert caught.value.errno == errno.EFBIG
    assert not list(tmp_path.iterdir())


WRITE_UNTIL_KILLED = """
import itertools, pathlib, sys, time
from videos import draw
from opencv_tools.recording.video.writer import VideoWriter
from opencv_tools.recording.video.writer import to_video_frame
path = pathlib.Path(sys.argv[1])
writer = None
for number in itertools.count():
    picture = to_video_frame(draw(number, 64), 'mono8', path.suffix)
    writer = writer or VideoWriter(path, picture, 0)
    writer.write(picture, number * 50_000_000)
    print(number, flush=True)
    time.sleep(0.002)
"""


@pytest.mark.thorough
@pytest.mark.process
@every_format
@pytest.mark.parametrize('moment', [30, 97, 234])
def test_killed_writer_leaves_a_video(tmp_path: Path, moment: int, suffix: str) -> None:
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
    assert len(kept) >= written - 22  # a second, a frame, and the frame in the encoder


@pytest.mark.process
def test_pyav_is_not_imported_before_it_is_used() -> None:
    code = 'import opencv_tools.recording.video.writer, sys; sys.exit("av" in sys.modules)'
    assert subprocess.run([sys.executable, '-c', code]).returncode == 0


def test_missing_encoder_is_reported_with_a_remedy(monkeypatch: pytest.MonkeyPatch) -> None:
    check_video()

    def find_nothing(*args: object) -> None:
        raise ValueError('libx264')

    monkeypatch.setattr('av.codec.codec.Codec', find_nothing)
    with pytest.raises(VideoError, match=r'libx264.*pip install'):
        check_video()
    monkeypatch.setitem(sys.modules, 'av.codec.codec', None)
    with pytest.raises(VideoError, match=r'PyAV.*pip install av'):
        check_video()
