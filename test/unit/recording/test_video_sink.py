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

"""Recording of videos: new files, limits, full disks and removed files."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import replace
import errno
import os
from pathlib import Path
import re
import shutil
import subprocess
import sys
import threading
from typing import Any

import av
from conftest import disk_of, read_manifest, recorded_files
from console import Console
import cv2
import numpy as np
from opencv_tools.recording.errors import LimitReached, UnwritableError, VideoError
from opencv_tools.recording.frames import RawFrame
from opencv_tools.recording.manifest import Manifest
from opencv_tools.recording.naming import FrameMetadata
from opencv_tools.recording.recorder import Recorder, Sink
from opencv_tools.recording.selection import Limits
from opencv_tools.recording.video.writer import count_frames
import pytest
from recordings import NANO, open_videos
from stepped_clock import SteppedClock
from waiting import wait_until

SMALL, WIDE = (16, 16), (16, 32)


def noise(number: int, size: tuple[int, int] = SMALL) -> RawFrame:
    image = np.random.default_rng(number).integers(0, 256, size, np.uint8)
    stamp_ns = NANO + number * NANO // 20
    return RawFrame(metadata=FrameMetadata(stamp_ns, 'camera', 'mono8', '/video_frames'),
                    receive_ns=7, image=image)


def put(videos: Sink[Any], frame: RawFrame) -> str:
    return videos.commit(frame, videos.prepare(frame)).name


def put_all(videos: Sink[Any], numbers: Iterable[int], error: str = '') -> int:
    """Put frames and return the number of refused ones, whose error must contain a text."""
    failed = 0
    for number in numbers:
        try:
            put(videos, noise(number))
        except OSError as err:
            assert err.strerror == error
            failed += 1
    return failed


def lines(folder: Path) -> list[tuple[str, int, int, list[int]]]:
    return [(line['file'], line['seq'], line['frames'], line['size'])
            for line in read_manifest(folder)]


def play(path: Path) -> int:
    video = cv2.VideoCapture(str(path))
    count = 0
    while video.read()[0]:
        count += 1
    return count


@pytest.mark.parametrize('on_exists', ['continue', 'overwrite'])
def test_frame_of_another_size_begins_a_file(tmp_path: Path, on_exists: str) -> None:
    videos = open_videos(tmp_path, on_exists=on_exists)
    sizes = [SMALL] * 3 + [WIDE] * 2 + [SMALL]
    names = [put(videos, noise(number, size)) for number, size in enumerate(sizes)]
    assert names == ['clip.mkv'] * 3 + ['clip_1.mkv'] * 2 + ['clip_2.mkv']
    assert [entry.name for entry in Manifest(tmp_path).entries()] == ['clip.mkv', 'clip_1.mkv']
    videos.close()
    assert lines(tmp_path) == [('clip.mkv', 0, 3, [16, 16]), ('clip_1.mkv', 1, 2, [32, 16]),
                               ('clip_2.mkv', 2, 1, [16, 16])]
    assert [play(path) for path in recorded_files(tmp_path)] == [3, 2, 1]
    assert not list(tmp_path.glob('.*'))


@pytest.mark.parametrize(('on_exists', 'expected'), [
    ('continue', [('clip.mkv', 0, 2), ('clip_1.mkv', 1, 1)]), ('overwrite', [('clip.mkv', 0, 1)])])
def test_second_recording_in_the_same_folder(
        tmp_path: Path, on_exists: str, expected: list[tuple[str, int, int]]) -> None:
    for count in (2, 1):
        videos = open_videos(tmp_path, on_exists=on_exists)
        for number in range(count):
            put(videos, noise(number))
        videos.close()
    assert [line[:3] for line in lines(tmp_path)] == expected
    assert [play(path) for path in recorded_files(tmp_path)] == [line[2] for line in expected]


@pytest.mark.parametrize('name', ['clip.mp4', 'clip.mkv'])
def test_videos_stay_below_max_bytes(tmp_path: Path, name: str) -> None:
    videos = open_videos(tmp_path, name, limits=Limits(max_bytes=30_000))
    taken = 0
    with pytest.raises(LimitReached, match=r'^max_bytes is 30000$'):
        for taken in range(1000):
            put(videos, noise(taken, SMALL if taken < 60 else WIDE))
    with pytest.raises(LimitReached):
        put(videos, noise(1000, SMALL))
    videos.close()
    found = lines(tmp_path)
    counts = videos.counts
    assert counts.kept + counts.skipped == taken and counts.skipped < 2
    assert sum(line[2] for line in found) == counts.kept and len(found) == 2
    size = sum(path.stat().st_size for path in recorded_files(tmp_path))
    assert 30_000 - 1500 < size <= 30_000  # a packet and its container data


@pytest.mark.parametrize(('more', 'count'), [(1, 1), (2200, 2)])
def test_no_video_begins_without_room_for_a_frame(tmp_path: Path, more: int, count: int) -> None:
    put(videos := open_videos(tmp_path / 'one'), noise(0))
    videos.close()
    size = (tmp_path / 'one' / 'clip.mkv').stat().st_size
    videos = open_videos(tmp_path / 'two', limits=Limits(max_bytes=size + 200 + more))
    with pytest.raises(LimitReached):
        for number, image_size in enumerate((SMALL, WIDE, (32, 32), (16, 64), (64, 16))):
            put(videos, noise(number, image_size))
    videos.close()
    assert [line[2] for line in lines(tmp_path / 'two')] == [1] * count
    total = sum(path.stat().st_size for path in recorded_files(tmp_path / 'two'))
    assert total <= size + 200 + more


def test_recording_without_frames_leaves_no_file(tmp_path: Path) -> None:
    open_videos(tmp_path).close()
    assert not list(tmp_path.iterdir())


def test_removed_folder_is_created_again(tmp_path: Path) -> None:
    videos = open_videos(tmp_path / 'out')
    (tmp_path / 'out').rename(tmp_path / 'away')
    put(videos, noise(0))
    videos.close()
    assert lines(tmp_path / 'out') == [('clip.mkv', 0, 1, [16, 16])]


RECORD_AND_DIE = """
import os, pathlib, sys
import numpy as np
from opencv_tools.recording.open_sink import open_sink
from opencv_tools.recording.frames import RawFrame
from opencv_tools.recording.naming import FileNames, FrameMetadata
from opencv_tools.recording.selection import Limits
from opencv_tools.recording.image_encoder import EncoderSettings

names = FileNames(sys.argv[2])
videos = open_sink(pathlib.Path(sys.argv[1]), names, EncoderSettings(names.suffix), 'continue',
                   Limits(), False)
for number in range(int(sys.argv[3])):
    image = np.full((16, 16), number, np.uint8)
    metadata = FrameMetadata(10**9 + number * 10**9 // 20, 'camera', 'mono8', '')
    frame = RawFrame(metadata=metadata, receive_ns=7, image=image)
    videos.commit(frame, videos.prepare(frame))
os._exit(0)
"""


def record_and_die(folder: Path, name: str, count: int) -> int:
    """Record frames in a process that ends at once; return the number of frames that play."""
    subprocess.run(
        [sys.executable, '-c', RECORD_AND_DIE, str(folder), name, str(count)], check=True)
    return play(folder / name)


@pytest.mark.process
@pytest.mark.parametrize(('name', 'count', 'least'), [
    ('clip.mkv', 50, 50 - 22), ('clip.mp4', 3, 1)])
def test_line_of_a_killed_recording(tmp_path: Path, name: str, count: int, least: int) -> None:
    played = record_and_die(tmp_path, name, count)
    assert least <= played < count
    open_videos(tmp_path).close()
    assert lines(tmp_path) == [(name, 0, played, [16, 16])]
    assert not list(tmp_path.glob('.*'))


@pytest.mark.process
@pytest.mark.parametrize('name', ['clip.mp4', 'clip.mkv'])
def test_killed_recording_without_a_whole_frame(tmp_path: Path, name: str) -> None:
    assert record_and_die(tmp_path, name, 2) == 0
    open_videos(tmp_path).close()
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize('suffix', ['.mp4', '.mkv', '.avi'])
def test_new_video_begins_when_a_full_disk_has_room_again(tmp_path: Path, suffix: str) -> None:
    clock = SteppedClock()
    videos = open_videos(tmp_path, f'clip{suffix}', monotonic=clock.monotonic)
    first, second = tmp_path / f'clip{suffix}', tmp_path / f'clip_1{suffix}'
    too_large = os.strerror(errno.EFBIG)
    with disk_of(20_000):
        failed = put_all(videos, range(150), too_large)
    assert first.stat().st_size <= 20_000
    assert videos.counts.kept == play(first) > 1
    assert videos.counts.kept + videos.counts.lost + failed == 150
    with disk_of(100):  # too small for the manifest line too
        for number in range(150, 250, 25):
            assert put_all(videos, range(number, number + 25), too_large) >= 24
            assert recorded_files(tmp_path) == [first]
            clock.step_to(clock.now + 2)
    assert videos.counts.kept == play(first)
    put_all(videos, range(250, 300))
    videos.close()
    assert play(second) == 50
    assert lines(tmp_path) == [(first.name, 0, play(first), [16, 16]),
                               (second.name, lines(tmp_path)[1][1], 50, [16, 16])]
    assert videos.counts.kept == play(first) + 50
    assert not list(tmp_path.glob('.*'))


def test_outage_ends_with_the_first_frame_on_the_disk(tmp_path: Path) -> None:
    clock = SteppedClock()
    videos = open_videos(tmp_path, monotonic=clock.monotonic)
    with disk_of(20_000):
        assert put_all(videos, range(150), os.strerror(errno.EFBIG))
    clock.step_to(clock.now + 3)
    put(videos, noise(150))  # in memory
    with pytest.raises(VideoError):
        put(videos, noise(0, (2, 40000)))
    with pytest.raises(OSError, match=os.strerror(errno.EFBIG)):
        put(videos, noise(151))
    clock.step_to(clock.now + 3)
    assert put_all(videos, range(152, 202)) == 0
    with pytest.raises(VideoError):
        put(videos, noise(0, (2, 40000)))
    put(videos, noise(202))
    videos.close()
    assert sorted(play(path) for path in recorded_files(tmp_path)[1:]) == [1, 1, 50]


def test_free_space_is_checked_before_a_new_video(
        tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    clock = SteppedClock()
    videos = open_videos(tmp_path, monotonic=clock.monotonic)
    with disk_of(20_000):
        put_all(videos, range(150), os.strerror(errno.EFBIG))
    disk = os.statvfs(tmp_path)
    full = os.statvfs_result([2000, 1, *disk[2:4], 1, *disk[5:]])
    monkeypatch.setattr(os, 'statvfs', lambda _: full)
    for number in range(150, 200, 10):
        clock.step_to(clock.now + 3)
        assert put_all(videos, range(number, number + 10), os.strerror(errno.EFBIG)) == 10
    monkeypatch.setattr(os, 'statvfs', lambda _: disk)
    clock.step_to(clock.now + 3)
    assert put_all(videos, range(200, 210)) == 0
    videos.close()


@pytest.mark.parametrize('suffix', ['.mp4', '.mkv', '.avi'])
def test_every_frame_is_counted_on_a_full_disk(tmp_path: Path, suffix: str) -> None:
    clock, console = SteppedClock(), Console()
    recorder = Recorder(open_videos(tmp_path, f'clip{suffix}', monotonic=clock.monotonic), console,
                        block=True)
    with disk_of(20_000):
        for number in range(200):
            recorder.put(noise(number))
            clock.step_to(clock.now + 0.05)
        recorder.close()
    counts = recorder.counts
    assert counts.written + counts.failed == 200
    files = recorded_files(tmp_path)
    assert counts.written == sum(map(play, files)) == sum(line[2] for line in lines(tmp_path))
    assert all(play(path) for path in files) and len(files) < 10
    assert console.lines[0] == f'error: a frame was not written: {os.strerror(errno.EFBIG)}'


@contextmanager
def no_room_for_a_line(folder: Path) -> Iterator[Sink[Any]]:
    """Yield a recording that ended clip.mkv of three frames; assert that it has no manifest."""
    def fail(*_: object) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    videos = open_videos(folder)
    for number in range(3):
        put(videos, noise(number))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Manifest, 'append', fail)
        videos._end(videos._file)
        yield videos
        assert not (folder / 'manifest.jsonl').exists()


def check_lines(folder: Path) -> None:
    """Assert that each file has a line, clip.mkv the first, and that no file is unfinished."""
    assert lines(folder)[0] == ('clip.mkv', 0, 3, [16, 16])
    assert len(lines(folder)) == len(recorded_files(folder))
    assert not list(folder.glob('.*'))


def test_late_manifest_line_before_the_next_one(tmp_path: Path) -> None:
    with no_room_for_a_line(tmp_path) as videos:
        pass
    put(videos, noise(3))
    assert [entry.frames for entry in Manifest(tmp_path).entries()] == [3]
    videos.close()
    check_lines(tmp_path)


def test_late_manifest_line_at_the_end(tmp_path: Path) -> None:
    with no_room_for_a_line(tmp_path) as videos:
        pass
    videos.close()
    check_lines(tmp_path)


def test_late_manifest_line_by_the_next_recording(tmp_path: Path) -> None:
    with no_room_for_a_line(tmp_path) as videos, pytest.raises(OSError, match='No space left'):
        videos.close()
    open_videos(tmp_path).close()
    check_lines(tmp_path)


def remove(folder: Path) -> None:
    shutil.rmtree(folder)


def move(folder: Path) -> None:
    folder.rename(folder.with_name('away'))


def remove_file(folder: Path) -> None:
    (folder / 'clip.mkv').unlink()


def replace_file(folder: Path) -> None:
    (folder / 'other').write_text('mine')
    (folder / 'other').replace(folder / 'clip.mkv')


@pytest.mark.parametrize('action', [remove, move, remove_file])
def test_removed_video_is_noticed_and_a_new_one_begins(
        tmp_path: Path, action: Callable[[Path], None]) -> None:
    clock, console, folder = SteppedClock(), Console(), tmp_path / 'out'
    recorder = Recorder(open_videos(folder, monotonic=clock.monotonic), console, block=True)

    def put_and_wait(numbers: Iterable[int]) -> None:
        for number in numbers:
            done = threading.Event()
            recorder.put(noise(number), lambda _, done=done: done.set())
            wait_until(done.is_set)

    put_and_wait(range(30))
    assert recorder.counts.written > 0
    action(folder)
    clock.step_to(clock.now + 1)
    put_and_wait(range(30, 60))
    recorder.close()
    assert (recorder.counts.written, recorder.counts.failed) == (30, 30)
    assert console.lines == [
        'error: a frame was not written: clip.mkv was removed or moved while it was written',
        'info: Writing again; 30 frames were not written']
    assert [(line[0], line[2]) for line in lines(folder)] == [('clip.mkv', 30)]
    assert play(folder / 'clip.mkv') == 30


@pytest.mark.parametrize('action', [remove, remove_file, replace_file])
def test_video_removed_before_the_end_has_no_line(
        tmp_path: Path, action: Callable[[Path], None]) -> None:
    console, folder = Console(), tmp_path / 'out'
    videos = open_videos(folder, monotonic=SteppedClock().monotonic)
    recorder = Recorder(videos, console, block=True)
    for number in range(30):
        recorder.put(noise(number))
    wait_until(lambda: videos.counts.kept, 'the video')
    action(folder)
    recorder.close()
    assert (recorder.counts.written, recorder.counts.failed) == (0, 30)
    assert not (folder / 'manifest.jsonl').exists()
    assert action is not replace_file or (folder / 'clip.mkv').read_text() == 'mine'


def test_two_overwriting_recordings_have_correct_lines(tmp_path: Path) -> None:
    first, second = (open_videos(tmp_path, on_exists='overwrite') for _ in range(2))
    put_all(first, range(30))
    put_all(second, range(20))
    first.close()
    second.close()
    assert (first.counts.kept, first.counts.lost) == (0, 30)
    assert second.counts.kept == play(tmp_path / 'clip.mkv') == 20
    assert lines(tmp_path) == [('clip.mkv', 0, 20, [16, 16])]


@pytest.mark.parametrize('jump', [-3600, -0.5, 0.5, 3600])
@pytest.mark.parametrize('name', ['clip.mp4', 'clip.mkv'])
def test_clock_change_makes_no_gap_between_unstamped_frames(
        tmp_path: Path, name: str, jump: float) -> None:
    videos = open_videos(tmp_path, name)
    for number in range(20):
        time_ns = number * NANO // 20
        received = 1_700_000_000 * NANO + time_ns + (number >= 10) * round(jump * NANO)
        frame = noise(number)
        put(videos, replace(frame, metadata=replace(frame.metadata, stamp_ns=0),
                            receive_ns=received, arrival_ns=time_ns))
    videos.close()
    assert [line[2] for line in lines(tmp_path)] == [20]
    video, times = cv2.VideoCapture(str(tmp_path / name)), []
    while video.read()[0]:
        times.append(video.get(cv2.CAP_PROP_POS_MSEC))
    np.testing.assert_allclose(times, np.arange(20) * 50, atol=1)
    with av.open(str(tmp_path / name)) as container:
        comment = {key.lower(): value for key, value in container.metadata.items()}['comment']
    assert comment == 'begins at 1700000000.000000000'


def test_first_of_two_errors_is_reported(tmp_path: Path) -> None:
    videos = open_videos(tmp_path, monotonic=SteppedClock().monotonic)
    put_all(videos, range(2))
    (tmp_path / 'clip.mkv').unlink()
    with disk_of(20_000), pytest.raises(OSError, match='File too large'):
        for number in range(2, 1000):
            put(videos, noise(number))
    videos.close()
    assert not list(tmp_path.iterdir())


def test_warning_of_sizes_that_change_again_and_again(tmp_path: Path) -> None:
    console = Console()
    recorder = Recorder(open_videos(tmp_path), console, block=True)
    for number in range(6):
        recorder.put(noise(number, (SMALL, WIDE)[number % 2]))
    recorder.close()
    changed = 'the size of the frames changed from'
    assert console.lines == [
        f'warning: another video, clip_1.mkv, begins: {changed} 16x16 to 32x16',
        f'warning: another video, clip_2.mkv, begins: {changed} 32x16 to 16x16',
        f'warning: {changed} 16x16 to 32x16, which is change 3, and each of them begins another '
        'video; record images, or one publisher with one size and constant settings']


def test_frame_that_fails_to_encode_uses_no_number(tmp_path: Path) -> None:
    videos = open_videos(tmp_path)
    with pytest.raises(VideoError, match='a 40000x2 frame cannot be encoded'):
        put(videos, noise(0, (2, 40000)))
    assert not recorded_files(tmp_path)
    assert put(videos, noise(1)) == 'clip.mkv'
    videos.close()
    assert lines(tmp_path) == [('clip.mkv', 0, 1, [16, 16])]


@pytest.mark.parametrize(('encoding', 'dtype', 'suffix', 'suffixes'), [
    ('mono16', 'uint16', '.mp4', '.png or .tif or .tiff or .mkv or .npy'),
    ('16UC1', 'uint16', '.avi', '.png or .tif or .tiff or .mkv or .npy'),
    ('32FC1', 'float32', '.mkv', '.tif or .tiff or .npy'),
    ('bayer_rggb16', 'uint16', '.mkv', '.npy'), ('16SC1', 'int16', '.mkv', '.npy')])
def test_error_of_a_refused_frame_names_other_formats(
        tmp_path: Path, encoding: str, dtype: str, suffix: str, suffixes: str) -> None:
    videos = open_videos(tmp_path, f'a{suffix}')
    frame = RawFrame(metadata=FrameMetadata(1, '', encoding, ''), receive_ns=1,
                     image=np.zeros((4, 4), dtype))
    with pytest.raises(UnwritableError) as caught:
        videos.prepare(frame)
    remedy = ('' if encoding == 'bayer_rggb16' else
              ', or allow a loss and give the range of the numbers')
    assert str(caught.value) == (f'a {encoding} frame cannot be stored as {suffix}; '
                                 f'set the extension of file_name to {suffixes}{remedy}')
    videos.close()


def depth(number: int, size: tuple[int, int] = SMALL, encoding: str = '16UC1') -> RawFrame:
    image = np.random.default_rng(number).integers(0, 2**16, size).astype(np.uint16)
    image.flat[:3] = 0, 65535, 1
    stamp_ns = NANO + number * NANO // 20
    return RawFrame(metadata=FrameMetadata(stamp_ns, 'camera', encoding, '/depth'),
                    receive_ns=7, image=image)


def read_depth(path: Path) -> list[np.ndarray]:
    with av.open(str(path)) as container:
        assert container.streams.video[0].codec_context.pix_fmt == 'gray16le'
        return [frame.to_ndarray() for frame in container.decode(video=0)]


def test_depth_of_another_size_or_encoding_begins_a_file(tmp_path: Path) -> None:
    videos = open_videos(tmp_path)
    frames = [depth(0), depth(1), depth(2, (5, 4)), depth(3, (480, 847)), depth(4),
              depth(5, encoding='mono16'), noise(6), noise(7), depth(8)]
    names = [put(videos, frame) for frame in frames]
    videos.close()
    assert names == ['clip.mkv', 'clip.mkv', 'clip_1.mkv', 'clip_2.mkv', 'clip_3.mkv',
                     'clip_4.mkv', 'clip_5.mkv', 'clip_5.mkv', 'clip_6.mkv']
    entries = read_manifest(tmp_path)
    assert [(line['encoding'], line['stored_encoding'], line['frames']) for line in entries] == [
        ('16UC1', 'ffv1', 2), *[('16UC1', 'ffv1', 1)] * 3, ('mono16', 'ffv1', 1),
        ('mono8', 'h264', 2), ('16UC1', 'ffv1', 1)]
    for line in entries:
        if line['stored_encoding'] == 'ffv1':
            expected = [frame.image for frame, name in zip(frames, names) if name == line['file']]
            np.testing.assert_array_equal(read_depth(tmp_path / line['file']), expected)


@pytest.mark.parametrize(('size', 'most'), [
    ((4, 6), 3000), ((16, 16), 30_000), ((480, 640), 3_000_000)])
def test_videos_of_depth_stay_below_max_bytes(
        tmp_path: Path, size: tuple[int, int], most: int) -> None:
    videos = open_videos(tmp_path, limits=Limits(max_bytes=most))
    taken = 0
    with pytest.raises(LimitReached):
        for taken in range(1000):
            put(videos, depth(taken, size))
    videos.close()
    (_, _, count, _), = lines(tmp_path)
    written = (tmp_path / 'clip.mkv').stat().st_size
    assert 0.75 * most < written <= most
    assert videos.counts.kept + videos.counts.skipped == taken
    assert len(read_depth(tmp_path / 'clip.mkv')) == count == videos.counts.kept > 3


def test_ring_of_depth(tmp_path: Path) -> None:
    videos = open_videos(tmp_path, 'd{seq}.mkv', limits=Limits(max_frames=20, ring=True))
    for number in range(57):
        put(videos, depth(number))
    videos.close()
    kept = [image for line in read_manifest(tmp_path)
            for image in read_depth(tmp_path / line['file'])]
    assert 18 <= len(kept) <= 20
    np.testing.assert_array_equal(
        kept, [depth(number).image for number in range(57 - len(kept), 57)])


@pytest.mark.parametrize('part', [0.3, 0.7, 0.999])
def test_frames_of_a_cut_video_of_depth(tmp_path: Path, part: float) -> None:
    videos = open_videos(tmp_path)
    for number in range(20):
        put(videos, depth(number, (48, 64)))
    videos.close()
    path = tmp_path / 'clip.mkv'
    assert count_frames(path) == 20
    os.truncate(path, int(part * path.stat().st_size))
    found = read_depth(path)
    assert count_frames(path) == len(found) == pytest.approx(20 * part, abs=1)
    np.testing.assert_array_equal(
        found, [depth(number, (48, 64)).image for number in range(len(found))])


def kept_numbers(folder: Path) -> list[int]:
    """Return the numbers of the frames in the videos of the manifest; check that all can play."""
    numbers: list[int] = []
    for line in read_manifest(folder):
        video = folder / line['file']
        assert play(video) == line['frames'] and video.stat().st_size == line['bytes']
        stamp = line['stamp']
        first = (stamp['sec'] * NANO + stamp['nanosec'] - NANO) * 20 // NANO
        numbers += range(first, first + line['frames'])
    assert {line['file'] for line in read_manifest(folder)} == {
        path.name for path in recorded_files(folder)}
    return numbers


@pytest.mark.quick_cases(3)
@pytest.mark.parametrize('suffix', ['.mp4', '.mkv', '.avi'])
@pytest.mark.parametrize(('limits', 'least'), [
    (Limits(max_bytes=150_000, ring=True), 25),
    (Limits(max_bytes=150_000, split_bytes=20_000, ring=True), 25),
    (Limits(max_frames=60, ring=True), 54),
    (Limits(max_seconds=2.5, ring=True), 45)])
def test_ring_keeps_the_newest_videos(
        tmp_path: Path, suffix: str, limits: Limits, least: int) -> None:
    videos = open_videos(tmp_path, f'{{seq:03d}}{suffix}', limits=limits)
    for number in range(150):
        frame = noise(number, (48, 48))
        put(videos, replace(frame, arrival_ns=frame.metadata.stamp_ns))
        assert not limits.max_bytes or limits.max_bytes >= sum(
            path.stat().st_size for path in recorded_files(tmp_path))
    videos.close()
    kept = kept_numbers(tmp_path)
    assert kept == [*range(kept[0], 150)]
    assert least <= len(kept) < 125
    assert (videos.counts.lost, videos.counts.skipped) == (0, 0)


def test_ring_deletes_videos_of_earlier_recordings_only(tmp_path: Path) -> None:
    other = tmp_path / 'other.mp4'
    other.write_bytes(b'of another program')
    for begin in (0, 30):
        videos = open_videos(
            tmp_path, '{seq:03d}.mp4', limits=Limits(max_frames=40, ring=True))
        assert put_all(videos, range(begin, begin + 30)) == 0
        videos.close()
    assert other.read_bytes() == b'of another program'
    other.unlink()
    kept = kept_numbers(tmp_path)
    assert kept == [*range(kept[0], 60)] and 36 <= len(kept) <= 40


@pytest.mark.quick_cases(3)
@pytest.mark.parametrize('suffix', ['.mp4', '.mkv', '.avi'])
@pytest.mark.parametrize('frames', [4, 6, 15, 25])
def test_frames_that_are_large_for_a_ring(tmp_path: Path, suffix: str, frames: int) -> None:
    reference = open_videos(tmp_path / 'reference', f'video{suffix}')
    for number in range(3):
        put(reference, noise(number, (128, 128)))
    reference.close()
    size = (tmp_path / 'reference' / f'video{suffix}').stat().st_size // 3
    folder = tmp_path / 'ring'
    videos = open_videos(
        folder, f'{{seq:03d}}{suffix}', limits=Limits(max_bytes=frames * size, ring=True))
    for number in range(30):
        put(videos, noise(number, (128, 128)))
        assert sum(path.stat().st_size for path in recorded_files(folder)) <= frames * size
    videos.close()
    kept = kept_numbers(folder)
    assert kept == [*range(kept[0], 30)]
    # A frame of the reference has a part of the head of its file, so one more may have room.
    assert frames // 2 <= len(kept) <= frames + 1
    assert (videos.counts.lost, videos.counts.skipped) == (0, 0)


def test_frame_that_is_larger_than_the_ring(tmp_path: Path) -> None:
    videos = open_videos(tmp_path, '{seq:03d}.mkv', limits=Limits(max_bytes=20_000, ring=True))
    small = [replace(noise(number), image=np.zeros((64, 64), np.uint8)) for number in range(10)]
    for frame in small[:5]:
        put(videos, frame)
    refused = 0
    for number in range(5, 9):
        try:
            put(videos, noise(number, (400, 400)))
        except UnwritableError as err:
            assert re.fullmatch('a file of [0-9]{5,} bytes does not fit in the ring, whose '
                                'max_bytes is 20000: give a larger max_bytes', str(err))
            refused += 1
    put(videos, small[9])
    videos.close()
    assert sum(path.stat().st_size for path in recorded_files(tmp_path)) <= 20_000
    counts = videos.counts
    assert (counts.kept, counts.lost + refused, counts.skipped) == (6, 4, 0)
    assert 'does not fit in the ring' in counts.reason


def test_ring_continues_after_a_video_whose_last_frame_has_no_room(tmp_path: Path) -> None:
    videos = open_videos(tmp_path, '{seq:03d}.mkv', limits=Limits(max_bytes=3000, ring=True))
    for _ in range(3):
        for number in range(3):
            put(videos, replace(noise(number), image=np.zeros((64, 64), np.uint8)))
        put(videos, noise(3, (64, 64)))  # waits in the encoder until the video ends
        put(videos, replace(noise(4), image=np.zeros((48, 48), np.uint8)))
    videos.close()
    counts = videos.counts
    assert (counts.kept, counts.lost, counts.skipped) == (12, 3, 0)
    assert play(recorded_files(tmp_path)[-1]) == 1


def test_ring_after_a_killed_recording(tmp_path: Path) -> None:
    limits = Limits(max_frames=40, ring=True)
    if not os.fork():
        videos = open_videos(tmp_path, '{seq:03d}.mkv', limits=limits)
        put_all(videos, range(60))
        os._exit(0)
    os.wait()
    videos = open_videos(tmp_path, '{seq:03d}.mkv', limits=limits)
    assert put_all(videos, range(60, 80)) == 0
    videos.close()
    kept = kept_numbers(tmp_path)
    assert kept[-20:] == [*range(60, 80)] and len(kept) <= 40


def times_of(path: Path) -> list[float]:
    """Return the times of the frames of a video in seconds."""
    with av.open(str(path)) as container:
        return [float(frame.pts * frame.time_base) for frame in container.decode(video=0)]


def record_stamps(folder: Path, stamps: list[float], rate: float) -> tuple[list[Path], list[str]]:
    """Record frames with stamps that arrive at a rate; return the videos and the warnings."""
    videos = open_videos(folder)
    warnings = []
    for number, stamp in enumerate(stamps):
        frame = RawFrame(
            metadata=FrameMetadata(round(stamp * NANO), '', 'mono8', ''), receive_ns=1,
            arrival_ns=NANO + round(number / rate * NANO), image=np.zeros((16, 16), np.uint8))
        videos.commit(frame, videos.prepare(frame))
        if videos.counts.warning not in warnings:
            warnings.append(videos.counts.warning)
    videos.close()
    return recorded_files(folder), [text for text in warnings if text]


@pytest.mark.parametrize('rate', [5, 30, 113])
@pytest.mark.parametrize('back', [0.3, 0.97])
def test_stamps_that_step_back_go_on_by_arrival(
        tmp_path: Path, rate: float, back: float) -> None:
    count = 2 * rate
    stamps = [1000 + number / rate - back * (number >= rate) for number in range(count)]
    (path,), warnings = record_stamps(tmp_path, stamps, rate)
    times = times_of(path)
    assert np.abs(np.array(times) - np.arange(count) / rate).max() < 0.002
    late = back - 1 / rate  # since the last stamp
    assert warnings == [
        f'the stamps of the frames step back by {late:.3g} s; the video goes on with the times '
        'of arrival']


@pytest.mark.parametrize('back', [1.5, 7.3, 100.0])
def test_stamps_that_step_back_further_begin_a_file(tmp_path: Path, back: float) -> None:
    stamps = [1000 + number / 30 - back * (number >= 20) for number in range(40)]
    paths, warnings = record_stamps(tmp_path, stamps, 30)
    assert [len(times_of(path)) for path in paths] == [20, 20]
    assert len(warnings) == 1 and warnings[0].endswith('; another video begins')


@pytest.mark.parametrize('step', [0.0, 1e-9, 2e-6])
def test_stamps_of_a_clock_that_stands_still(tmp_path: Path, step: float) -> None:
    stamps = [1e-9 + number * step for number in range(37)]
    (path,), warnings = record_stamps(tmp_path, stamps, 12.5)
    assert np.abs(np.array(times_of(path)) - np.arange(37) / 12.5).max() < 0.002
    assert warnings == ['the stamps of the frames stand still; the video goes on with the times '
                        'of arrival']


@pytest.mark.parametrize('speed', [0.05, 0.4, 3.0])
def test_stamps_of_simulated_time_at_any_speed(tmp_path: Path, speed: float) -> None:
    stamps = [5 + number / 30 * speed for number in range(30)]
    (path,), warnings = record_stamps(tmp_path, stamps, 30)
    assert np.abs(np.array(times_of(path)) - np.arange(30) / 30 * speed).max() < 0.002
    assert not warnings


def test_stamps_with_jitter_and_a_pause(tmp_path: Path) -> None:
    random = np.random.default_rng(6)
    stamps = [*(5 + np.arange(20) / 30 + random.uniform(-0.01, 0.01, 20)), *range(60, 70)]
    (path,), warnings = record_stamps(tmp_path, stamps, 30)
    assert np.abs(np.array(times_of(path)) - (np.array(stamps) - stamps[0])).max() < 0.002
    assert warnings == [
        'the stamps of the frames step forward by 54.3 s; the video has this gap']


@pytest.mark.parametrize('back', [1.7, 5.0, 7200.0])
@pytest.mark.parametrize('rate', [4, 20, 90])
def test_stamps_of_two_clocks_begin_one_video(tmp_path: Path, rate: int, back: float) -> None:
    stamps = [10_000 + number / rate - back * (number % 2) for number in range(40)]
    paths, warnings = record_stamps(tmp_path, stamps, rate)
    assert len(paths) == 2
    assert len(warnings) == 2
    assert 'another video begins' in warnings[0]
    assert warnings[1].endswith('the video goes on with the times of arrival')
    first, times = map(times_of, paths)
    assert len(first) + len(times) == 40
    assert np.abs(np.diff(times) - 1 / rate).max() < 0.002


@pytest.mark.parametrize('step', [1e-7, 1e-4, 6e-4])
def test_stamps_that_advance_less_than_a_tick(tmp_path: Path, step: float) -> None:
    stamps = [1000 + number * step for number in range(37)]
    (path,), warnings = record_stamps(tmp_path, stamps, 12.5)
    assert np.abs(np.array(times_of(path)) - np.arange(37) / 12.5).max() < 0.002
    assert warnings == ['the stamps of the frames stand still; the video goes on with the times '
                        'of arrival']
