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

"""Recording of image files: memory, limits, and the ring of the newest files."""

from __future__ import annotations

import errno
import io
from pathlib import Path
import tracemalloc

from conftest import read_manifest
import numpy as np
from opencv_tools.recording.image_encoder import EncoderSettings
from opencv_tools.recording.manifest import Manifest
from opencv_tools.recording.naming import FileNames
from opencv_tools.recording.open_sink import open_sink
from opencv_tools.recording.selection import Limits
import pytest
from recordings import frame_of, gray_frame, gray_numbers, image_sink, random_image, record

LARGE = np.random.default_rng(4).integers(0, 2**16, (1024, 4096, 2), np.uint16)  # 16 MiB


@pytest.mark.parametrize('image', [
    LARGE, LARGE[:, :-1], LARGE[..., 0], LARGE.astype('>u2'), LARGE[..., 0].T, LARGE[::-1],
    np.zeros((0, 5), np.uint8), np.zeros((5, 0, 3), np.float64), LARGE[:1, :1]],
    ids=['tight', 'rows', 'channel', 'big-endian', 'turned', 'upside down', 'no row', 'no column',
         'pixel'])
def test_array_is_written_without_a_copy(image: np.ndarray, tmp_path: Path) -> None:
    encoding = f'16UC{image.shape[2] if image.ndim == 3 else 1}'
    if image.dtype.itemsize != 2:
        encoding = '8UC1' if image.dtype == np.uint8 else '64FC3'
    whole = io.BytesIO()
    np.save(whole, image)
    sink = open_sink(tmp_path, FileNames('{seq}.npy'), EncoderSettings('.npy'), 'continue',
                     Limits(), sync=False)
    frame = frame_of(image, encoding)
    tracemalloc.start()
    try:
        prepared = sink.prepare(frame)
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    path = sink.commit(frame, prepared)
    sink.close()
    assert peak < 3 * 2**20
    assert path.read_bytes() == whole.getvalue()
    assert read_manifest(tmp_path)[0]['bytes'] == len(whole.getvalue())


def test_array_on_a_full_disk_leaves_no_file(
        tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    sink = open_sink(tmp_path, FileNames('{seq}.npy'), EncoderSettings('.npy'), 'continue',
                     Limits(), sync=False)

    def refuse(*_: object) -> None:
        raise OSError(errno.ENOSPC, 'no room')

    monkeypatch.setattr('opencv_tools.base.regular_files.write_buffer', refuse)
    with pytest.raises(OSError, match='no room'):
        sink.prepare(frame_of(random_image('bgr8'), 'bgr8'))
    assert not [*tmp_path.glob('.*.part')]
    sink.close()


def test_overwritten_file_holds_the_latest_frame(tmp_path: Path) -> None:
    record(tmp_path, 250, 'latest.png', on_exists='overwrite')
    assert gray_numbers(tmp_path) == [249]
    assert len(read_manifest(tmp_path)) == 1


LIMITS = [Limits(max_frames=4, ring=True), Limits(max_seconds=3.5, ring=True)]


@pytest.mark.parametrize(('limits', 'kept'), [
    (LIMITS[0], [248, 249, 250, 251]), (LIMITS[1], [250, 251])])  # existing files are years old
def test_ring_keeps_the_newest_files(tmp_path: Path, limits: Limits, kept: list[int]) -> None:
    (tmp_path / '7.txt').write_text('not ours')
    recorder = record(tmp_path, 250, limits=limits)
    (tmp_path / '7.txt').unlink()
    assert recorder.counts.written == 250
    assert gray_numbers(tmp_path) == [246, 247, 248, 249]
    assert len(read_manifest(tmp_path)) == 4
    record(tmp_path, 2, limits=limits, first=250)  # existing files count
    assert gray_numbers(tmp_path) == [number % 256 for number in kept]
    assert [line['seq'] for line in read_manifest(tmp_path)] == kept


def test_ring_leaves_the_files_of_another_recording(tmp_path: Path) -> None:
    record(tmp_path, 3, 'other_{seq}.png')
    record(tmp_path, 10, limits=LIMITS[0])
    assert [line['file'] for line in read_manifest(tmp_path)] == [
        'other_0.png', 'other_1.png', 'other_2.png',
        *(f'{number:03d}.png' for number in range(6, 10))]


@pytest.mark.parametrize('ring', [False, True])
def test_files_stay_below_max_bytes(tmp_path: Path, ring: bool) -> None:
    record(tmp_path / 'one', 1, '{seq:03d}.bmp')
    size = (tmp_path / 'one' / '000.bmp').stat().st_size
    limits = Limits(max_bytes=5 * size, ring=ring)
    recorder = record(tmp_path / 'many', 20, '{seq:03d}.bmp', limits=limits)
    logged = [f'info: Recording limit reached: max_bytes is {5 * size}, the next file has {size} '
              'bytes']
    assert recorder.console.lines == ([] if ring else logged)
    assert recorder.times_full == (0 if ring else 1)
    assert gray_numbers(tmp_path / 'many') == (
        [15, 16, 17, 18, 19] if ring else [0, 1, 2, 3, 4])
    assert len(read_manifest(tmp_path / 'many')) == 5
    assert recorder.is_full is not ring
    assert recorder.counts.written == (20 if ring else 5)
    assert recorder.counts.skipped == (0 if ring else 15)
    assert recorder.counts.failed == 0


def test_manifest_lines_of_other_recordings_stay(tmp_path: Path) -> None:
    record(tmp_path, 1, 'other_{seq}.bmp')
    (tmp_path / 'other_0.bmp').unlink()
    record(tmp_path, 150, limits=LIMITS[0])
    assert [entry.name for entry in Manifest(tmp_path).entries()] == [
        'other_0.bmp', '146.png', '147.png', '148.png', '149.png']


def test_temporary_file_that_cannot_be_removed_is_left(tmp_path: Path) -> None:
    folder = tmp_path / 'out'
    sink = image_sink(folder, '{seq}.png')
    picture = sink.prepare(gray_frame(0))
    folder.rename(tmp_path / 'away')
    folder.touch()
    picture.discard()
    assert (tmp_path / 'away' / picture.temporary.name).exists()
    folder.unlink()
    (tmp_path / 'away').rename(folder)
    picture.discard()
    assert not picture.temporary.exists()
    sink.close()


def test_manifest_is_compacted_while_a_ring_records(tmp_path: Path) -> None:
    names = FileNames('{seq:03d}.png')
    sink = open_sink(tmp_path, names, EncoderSettings('.png'), 'continue', LIMITS[0], False)
    lengths = []
    for number in range(250):
        frame = gray_frame(number)
        sink.commit(frame, sink.prepare(frame))
        lengths.append((tmp_path / 'manifest.jsonl').read_bytes().count(b'\n'))
    assert lengths == [*range(1, 105), *[*range(4, 105)] * 2][:250]
    sink.close()
    assert len(read_manifest(tmp_path)) == 4
