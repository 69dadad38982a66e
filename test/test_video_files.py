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

"""Videos of a recording: which frames go into which file, and the line that each file has."""

from __future__ import annotations

from pathlib import Path
import resource
import subprocess
import sys
from typing import Any

from conftest import read_manifest, recorded_files
import cv2
import numpy as np
from opencv_tools.recording.files import check_format, open_files
from opencv_tools.recording.folder import RecordingError
from opencv_tools.recording.frames import RawFrame
from opencv_tools.recording.manifest import Manifest
from opencv_tools.recording.naming import FileNames
from opencv_tools.recording.recorder import Files
from opencv_tools.recording.selection import FullError, Limits
from opencv_tools.recording.video_picture import VideoError
from opencv_tools.recording.writers import Format, UnwritableError
import pytest

NANO = 10**9
NO_LIMITS = Limits()
SMALL, WIDE = (16, 16), (16, 32)


def open_videos(
    folder: Path, name: str = 'clip.mkv', on_exists: str = 'continue', limits: Limits = NO_LIMITS,
) -> Files[Any]:
    names = FileNames(name)
    return open_files(folder, names, Format(names.suffix), on_exists, limits, sync=False)


def noise(number: int, size: tuple[int, int] = SMALL) -> RawFrame:
    image = np.random.default_rng(number).integers(0, 256, size, np.uint8)
    return RawFrame(NANO + number * NANO // 20, 'camera', 'mono8', '/video_frames', 7, image)


def put(videos: Files[Any], frame: RawFrame) -> str:
    return videos.commit(frame, videos.prepare(frame)).name


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
def test_another_size_is_another_file(tmp_path: Path, on_exists: str) -> None:
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
def test_a_second_recording(
        tmp_path: Path, on_exists: str, expected: list[tuple[str, int, int]]) -> None:
    for count in (2, 1):
        videos = open_videos(tmp_path, on_exists=on_exists)
        for number in range(count):
            put(videos, noise(number))
        videos.close()
    last = {entry.name: entry for entry in Manifest(tmp_path).entries()}
    assert [(entry.name, entry.seq, entry.frames) for entry in last.values()] == expected
    assert [play(path) for path in recorded_files(tmp_path)] == [line[2] for line in expected]


def test_videos_take_no_more_bytes_than_they_may_by_much(tmp_path: Path) -> None:
    videos = open_videos(tmp_path, limits=Limits(max_bytes=30_000))
    taken = 0
    with pytest.raises(FullError, match=r'^max_bytes is 30000$'):
        for taken in range(1000):
            put(videos, noise(taken, SMALL if taken < 60 else WIDE))
    with pytest.raises(FullError):
        put(videos, noise(1000, SMALL))
    videos.close()
    found = lines(tmp_path)
    assert sum(line[2] for line in found) == taken and len(found) == 2
    assert sum(path.stat().st_size for path in recorded_files(tmp_path)) >= 30_000


def test_not_a_byte_more_is_begun_than_may_be(tmp_path: Path) -> None:
    videos = open_videos(tmp_path / 'one')
    put(videos, noise(0))
    videos.close()
    size = (tmp_path / 'one' / 'clip.mkv').stat().st_size
    for more in (0, 1):
        folder = tmp_path / f'two{more}'
        videos = open_videos(folder, limits=Limits(max_bytes=size + more))
        put(videos, noise(0))
        if more:
            put(videos, noise(1, WIDE))
        with pytest.raises(FullError):
            put(videos, noise(2, (32, 32)))
        videos.close()
        assert [line[2] for line in lines(folder)] == [1] * (1 + more)


def test_a_recording_without_frames_leaves_nothing(tmp_path: Path) -> None:
    open_videos(tmp_path).close()
    assert not list(tmp_path.iterdir())


def test_a_folder_that_was_removed_is_made_again(tmp_path: Path) -> None:
    videos = open_videos(tmp_path / 'out')
    (tmp_path / 'out').rename(tmp_path / 'away')
    put(videos, noise(0))
    videos.close()
    assert lines(tmp_path / 'out') == [('clip.mkv', 0, 1, [16, 16])]


RECORD_AND_DIE = """
import os, pathlib, sys
import numpy as np
from opencv_tools.recording.files import open_files
from opencv_tools.recording.frames import RawFrame
from opencv_tools.recording.naming import FileNames
from opencv_tools.recording.selection import Limits
from opencv_tools.recording.writers import Format
videos = open_files(pathlib.Path(sys.argv[1]), FileNames('clip.mkv'), Format('.mkv'), 'continue',
                    Limits(), False)
for number in range(50):
    image = np.full((16, 16), number, np.uint8)
    frame = RawFrame(10**9 + number * 10**9 // 20, 'camera', 'mono8', '', 7, image)
    videos.commit(frame, videos.prepare(frame))
os._exit(0)
"""


@pytest.mark.process
def test_a_killed_recording_has_its_line(tmp_path: Path) -> None:
    subprocess.run([sys.executable, '-c', RECORD_AND_DIE, str(tmp_path)], check=True)
    assert play(tmp_path / 'clip.mkv') >= 50 - 21
    open_videos(tmp_path).close()
    assert lines(tmp_path) == [('clip.mkv', 0, 0, [16, 16])]
    assert not list(tmp_path.glob('.*'))


def test_a_disk_that_is_full_ends_the_file_and_the_next_frame_begins_another(
        tmp_path: Path) -> None:
    videos = open_videos(tmp_path)
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (20_000, hard))
    try:
        with pytest.raises(OSError, match='File too large'):
            for number in range(1000):
                put(videos, noise(number))
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    assert put(videos, noise(1000)) == 'clip_1.mkv'
    videos.close()
    assert [line[0] for line in lines(tmp_path)] == ['clip.mkv', 'clip_1.mkv']
    assert play(tmp_path / 'clip.mkv') > 1 and play(tmp_path / 'clip_1.mkv') == 1


def test_the_first_of_two_errors_is_told(tmp_path: Path) -> None:
    videos = open_videos(tmp_path)
    put(videos, noise(0))
    (tmp_path / 'clip.mkv').unlink()
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (20_000, hard))
    try:
        with pytest.raises(OSError, match='File too large'):
            for number in range(1, 1000):
                put(videos, noise(number))
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    videos.close()
    assert not list(tmp_path.iterdir())


def test_a_frame_that_is_not_encoded_leaves_nothing_and_takes_no_number(tmp_path: Path) -> None:
    videos = open_videos(tmp_path)
    with pytest.raises(VideoError, match='a 40000x2 frame cannot be encoded'):
        put(videos, noise(0, (2, 40000)))
    assert not recorded_files(tmp_path)
    assert put(videos, noise(1)) == 'clip.mkv'
    videos.close()
    assert lines(tmp_path) == [('clip.mkv', 0, 1, [16, 16])]


@pytest.mark.parametrize(('encoding', 'dtype', 'able'), [
    ('mono16', 'uint16', '.png or .tif or .tiff or .npy'),
    ('32FC1', 'float32', '.tif or .tiff or .npy'), ('bayer_rggb16', 'uint16', '.npy'),
    ('16SC1', 'int16', '.npy')])
def test_a_frame_that_is_refused_is_told_where_it_fits(
        tmp_path: Path, encoding: str, dtype: str, able: str) -> None:
    videos = open_videos(tmp_path)
    frame = RawFrame(1, '', encoding, '', 1, np.zeros((4, 4), dtype))
    with pytest.raises(UnwritableError) as caught:
        videos.prepare(frame)
    assert str(caught.value) == (f'a {encoding} frame cannot be kept as .mkv; '
                                 f'set the extension of file_name to {able}')
    videos.close()


def test_a_ring_of_videos_is_refused(tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match=r'^a ring deletes the oldest .* a \.mp4 is one file'):
        open_videos(tmp_path / 'out', 'x.mp4', limits=Limits(max_frames=2, ring=True))
    assert not (tmp_path / 'out').exists()


def test_without_pyav_videos_alone_are_refused(
        tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def find_nothing() -> None:
        raise VideoError('install it')

    monkeypatch.setattr('opencv_tools.recording.files.check_video', find_nothing)
    with pytest.raises(VideoError, match=r'^install it$'):
        check_format('.mkv')
    with pytest.raises(RecordingError, match=r'^install it$'):
        open_videos(tmp_path / 'out')
    assert not (tmp_path / 'out').exists()
    check_format('.png')
    open_videos(tmp_path / 'out', 'x.png').close()
    with pytest.raises(ValueError, match=r'^the extension is one of \.png, .*\.npy, \.mp4, '):
        check_format('.gif')
