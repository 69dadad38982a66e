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

"""Depth in files, exact from bags of raw and of compressed images, and from videos."""

from __future__ import annotations

from pathlib import Path
import re
import struct
import sys
from typing import Any

from conftest import read_manifest, recorded_files
import cv2
import numpy as np
from opencv_tools.capture.frame import CapturedFrame
from opencv_tools.capture.source import open_source
from opencv_tools.convert.cli import main
from playback import frames_of
from played_bags import BEGAN_NS, compressed_entry, Entry, image_entry, read_all, write_mcap
import pytest

SIZES = [(1, 3), (23, 37), (480, 847)]
every_size = pytest.mark.parametrize(('height', 'width'), SIZES)


def convert(*words: object) -> int:
    return main([str(word) for word in words])


def frames(path: Path) -> list[CapturedFrame]:
    return list(frames_of(open_source(str(path))))


def millimetres(number: int, height: int, width: int) -> np.ndarray:
    image = np.random.default_rng(number).integers(0, 2**16, (height, width)).astype(np.uint16)
    image.flat[:3] = 0, 1, 65535
    return image


def metres(number: int, height: int, width: int) -> np.ndarray:
    image = np.random.default_rng(number).uniform(0.1, 9, (height, width)).astype(np.float32)
    image.flat[:3] = np.nan, np.inf, 1e-40
    return image


def raw_entry(number: int, image: np.ndarray, encoding: str) -> Entry:
    return image_entry(number, image, encoding)


def png_entry(number: int, image: np.ndarray, encoding: str) -> Entry:
    png = cv2.imencode('.png', image)[1].tobytes()
    return compressed_entry(number, png, f'{encoding}; png compressed ')


def depth_entry(number: int, image: np.ndarray, encoding: str) -> Entry:
    png = cv2.imencode('.png', image)[1].tobytes()
    return compressed_entry(
        number, struct.pack('<iff', 0, 0, 0) + png, f'{encoding}; compressedDepth png')


def read(path: Path) -> np.ndarray:
    return np.load(path) if path.suffix == '.npy' else cv2.imread(
        str(path), cv2.IMREAD_UNCHANGED)


@every_size
@pytest.mark.parametrize('encoding', ['16UC1', 'mono16'])
@pytest.mark.parametrize('entry', [raw_entry, png_entry, depth_entry])
@pytest.mark.parametrize('suffix', ['.png', '.tiff', '.npy'])
def test_pictures_of_16_bits(
        tmp_path: Path, height: int, width: int, encoding: str, entry: Any, suffix: str) -> None:
    images = [millimetres(number, height, width) for number in range(3)]
    bag = write_mcap(tmp_path / 'a.mcap', [
        entry(number, image, encoding) for number, image in enumerate(images)])
    assert convert(bag, tmp_path / 'out' / f'{{seq}}{suffix}') == 0
    for number, image in enumerate(images):
        np.testing.assert_array_equal(
            read(tmp_path / 'out' / f'{number}{suffix}'), image, strict=True)


@every_size
@pytest.mark.parametrize('suffix', ['.tiff', '.tif', '.npy'])
def test_pictures_of_floats(tmp_path: Path, height: int, width: int, suffix: str) -> None:
    images = [metres(number, height, width) for number in range(3)]
    bag = write_mcap(tmp_path / 'a.mcap', [
        image_entry(number, image, '32FC1') for number, image in enumerate(images)])
    assert convert(bag, tmp_path / 'out' / f'{{seq}}{suffix}') == 0
    for number, image in enumerate(images):
        found = read(tmp_path / 'out' / f'{number}{suffix}')
        assert found.tobytes() == image.tobytes() and found.dtype == np.float32


@pytest.mark.parametrize('suffix', ['.tiff', '.npy'])
def test_pictures_of_compressed_floats(tmp_path: Path, suffix: str) -> None:
    # The format stores a / depth + b. Here the stored 0 to 9 are none, 20 m, 10 m and nearer.
    stored = np.arange(10, dtype=np.uint16).reshape(2, 5)
    content = struct.pack('<iff', 0, 20.0, 0.0) + cv2.imencode('.png', stored)[1].tobytes()
    bag = write_mcap(tmp_path / 'a.mcap', [
        compressed_entry(1, content, '32FC1; compressedDepth png')])
    assert convert(bag, tmp_path / f'a{suffix}') == 0
    expected = np.array([np.nan, 20, 10, 20 / 3, 5, 4, 10 / 3, 20 / 7, 2.5, 20 / 9], np.float32)
    np.testing.assert_allclose(read(tmp_path / f'a{suffix}').ravel(), expected, rtol=1e-7)


@pytest.mark.parametrize(('height', 'width'), [(4, 5), *SIZES[1:]])
@pytest.mark.parametrize('encoding', ['16UC1', 'mono16'])
@pytest.mark.parametrize('entry', [raw_entry, png_entry, depth_entry])
def test_video_and_back(
        tmp_path: Path, height: int, width: int, encoding: str, entry: Any) -> None:
    images = [millimetres(number, height, width) for number in range(4)]
    bag = write_mcap(tmp_path / 'a.mcap', [
        entry(number, image, encoding) for number, image in enumerate(images)])
    clip = tmp_path / 'out' / 'clip.mkv'
    assert convert(bag, clip) == 0
    line, = read_manifest(tmp_path / 'out')
    assert (line['stored_encoding'], line['size'], line['frames']) == ('ffv1', [width, height], 4)
    assert convert(clip, tmp_path / 'frames' / '{seq}.png') == 0
    assert convert(clip, tmp_path / 'again.mcap', '--start', 1) == 0
    assert convert(tmp_path / 'frames', tmp_path / 'again.mkv') == 0
    for number, image in enumerate(images):
        np.testing.assert_array_equal(
            read(tmp_path / 'frames' / f'{number}.png'), image, strict=True)
    again = frames(tmp_path / 'again.mcap')
    assert {frame.encoding for frame in again} == {encoding}
    assert [frame.recorded.header_ns for frame in again if frame.recorded] == [
        number * 40_000_000 for number in (1, 2, 3)]
    for frame, image in zip(again, images[1:], strict=True):
        np.testing.assert_array_equal(frame.image, image, strict=True)
    for frame, image in zip(frames(tmp_path / 'again.mkv'), images, strict=True):
        np.testing.assert_array_equal(frame.image, image, strict=True)
        assert frame.encoding == 'mono16'  # a picture has no unit


@pytest.mark.parametrize('step_ms', [1, 33, 2500])
def test_times_of_a_video_of_depth(tmp_path: Path, step_ms: int) -> None:
    entries = [image_entry(number, millimetres(number, 4, 6), '16UC1') for number in range(5)]
    bag = write_mcap(tmp_path / 'a.mcap', [
        entry._replace(data=_with_stamp(entry.data, BEGAN_NS + number * step_ms * 10**6),
                       log_ns=BEGAN_NS + number * step_ms * 10**6)
        for number, entry in enumerate(entries)])
    assert convert(bag, tmp_path / 'a.mkv') == 0
    assert [frame.position for frame in frames(tmp_path / 'a.mkv')] == pytest.approx(
        [number * step_ms / 1000 for number in range(5)])


def _with_stamp(cdr: bytes, stamp_ns: int) -> bytes:
    return cdr[:4] + struct.pack('<iI', *divmod(stamp_ns, 10**9)) + cdr[12:]


@pytest.mark.parametrize(('encoding', 'target', 'remedy'), [
    ('32FC1', 'a.mkv', 'such as .tiff or .mcap'), ('32FC1', 'a.mp4', 'such as .tiff or .mcap'),
    ('16UC1', 'a.mp4', 'such as .mkv or .mcap'), ('mono16', 'a.jpg', 'such as .mkv or .mcap'),
    ('bgr8', 'a.mkv', 'such as .png or .mcap')])
def test_videos_that_lose_numbers(
        tmp_path: Path, capsys: pytest.CaptureFixture[str], encoding: str, target: str,
        remedy: str) -> None:
    image = np.ones((4, 6, 3), np.uint8) if encoding == 'bgr8' else np.ones(
        (4, 6), np.float32 if encoding == '32FC1' else np.uint16)
    bag = write_mcap(tmp_path / 'a.mcap', [image_entry(1, image, encoding)])
    assert convert(bag, tmp_path / target) == 2
    assert (f'loses quality that {bag} has: give --lossy, or a target with an extension '
            f'{remedy}\n') in capsys.readouterr().err


@pytest.mark.parametrize('entry', [raw_entry, png_entry, depth_entry])
def test_lossy_needs_a_range_or_is_left_out(
        tmp_path: Path, capsys: pytest.CaptureFixture[str], entry: Any) -> None:
    bag = write_mcap(tmp_path / 'a.mcap', [entry(1, millimetres(1, 4, 6), '16UC1')])
    for target, is_exact in (('a.mkv', True), ('a.mp4', False), ('a.jpg', False)):
        assert convert(bag, tmp_path / target, '--lossy') == 2
        error = capsys.readouterr().err
        assert '16UC1 frames become 8 bits' in error and '0 to 65535' in error
        assert ('; leave out --lossy to keep all numbers' in error) == is_exact
    assert convert(bag, tmp_path / 'a.mkv', '--lossy', '--range', '0:9000') == 0
    assert {frame.encoding for frame in frames(tmp_path / 'a.mkv')} == {'bgr8'}


def test_video_of_depth_is_not_reduced_in_silence(
        tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    bag = write_mcap(tmp_path / 'a.mcap', [image_entry(1, millimetres(1, 16, 16), '16UC1')])
    assert convert(bag, tmp_path / 'a.mkv') == 0
    assert convert(tmp_path / 'a.mkv', tmp_path / 'a.mp4') == 2
    assert 'loses quality' in capsys.readouterr().err
    assert convert(tmp_path / 'a.mkv', tmp_path / 'a.mp4', '--lossy', '--range', '0:9000',
                   '--colors', 'turbo') == 0
    assert len(frames(tmp_path / 'a.mp4')) == 1


@pytest.mark.parametrize('source', ['pattern:depth:64x48', 'pattern:64x48'])
@pytest.mark.parametrize('options', [(), ('--every', '2')])
def test_cut_video_is_reported(
        tmp_path: Path, capsys: pytest.CaptureFixture[str], source: str,
        options: tuple[str, ...]) -> None:
    video = tmp_path / 'a.mkv'
    assert convert(source, video, '--stop', '20', *['--lossy'] * ('depth' not in source)) == 0
    assert convert(video, tmp_path / 'whole' / '{seq}.png', *options) == 0
    content = video.read_bytes()
    size = len(content) * 6 // 10
    video.write_bytes(content[:size])
    capsys.readouterr()
    assert convert(video, tmp_path / 'cut' / '{seq}.png', *options) == 1
    written = len(recorded_files(tmp_path / 'cut'))
    error = capsys.readouterr().err
    found = re.search(rf'error: a frame was not read: {video} is damaged: it ends after (\d+) '
                      rf'frames, with {size} of its {len(content)} bytes\n', error)
    assert found and 5 < int(found[1]) < 19
    assert written == (int(found[1]) + 1) // 2 if options else int(found[1])
    assert f'{written} written' in error and ', 1 failed' in error
    # The header of a video whose recorder was killed does not know the size.
    known = content.index(b'\x18\x53\x80\x67') + 4
    video.write_bytes(content[:known] + b'\1' + bytes([255] * 7) + content[known + 8:size])
    assert convert(video, tmp_path / 'killed' / '{seq}.png', *options) == 0


def test_frames_that_no_video_holds_fail_beside_others(
        tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    bag = write_mcap(tmp_path / 'a.mcap', [
        image_entry(0, millimetres(0, 4, 6), '16UC1'), image_entry(1, metres(1, 4, 6), '32FC1'),
        image_entry(2, millimetres(2, 4, 6), '16UC1')])
    assert convert(bag, tmp_path / 'out' / 'a.mkv') == 1
    error = capsys.readouterr().err
    assert ('a 32FC1 frame cannot be stored as .mkv; set the extension of file_name to .tif or '
            '.tiff or .npy, or allow a loss and give the range of the numbers') in error
    assert 'Converted 3 frames' in error and '2 written' in error and '1 failed' in error
    path, = recorded_files(tmp_path / 'out')
    assert [(frame.image == millimetres(number, 4, 6)).all()
            for frame, number in zip(frames(path), (0, 2), strict=True)] == [True, True]


@pytest.mark.parametrize(('height', 'width'), [(1, 640), (3, 3), (480, 1)])
def test_narrow_depth_has_no_video(
        tmp_path: Path, capsys: pytest.CaptureFixture[str], height: int, width: int) -> None:
    bag = write_mcap(tmp_path / 'a.mcap', [
        image_entry(1, millimetres(1, height, width), '16UC1')])
    assert convert(bag, tmp_path / 'a.mkv') == 1
    assert (f'a {width}x{height} 16UC1 frame cannot be stored as .mkv, which needs 4 pixels a '
            'side; set the extension of file_name to .png or .tif or .tiff or .npy, or allow a '
            'loss and give the range of the numbers') in capsys.readouterr().err
    assert convert(bag, tmp_path / 'a.mkv', '--lossy', '--range', '0:9000') == 0


def test_missing_library_is_named_with_its_remedy(
        tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
        capsys: pytest.CaptureFixture[str]) -> None:
    bag = write_mcap(tmp_path / 'a.mcap', [image_entry(1, millimetres(1, 4, 6), '16UC1')])
    assert convert(bag, tmp_path / 'a.mkv') == 0
    monkeypatch.setitem(sys.modules, 'av', None)
    capsys.readouterr()
    assert convert(tmp_path / 'a.mkv', tmp_path / 'a.png') == 1
    line, = capsys.readouterr().err.splitlines()
    assert line.startswith('img_convert: error: ') and "'pip install av'" in line


def test_bag_of_depth_stays_as_it_is(tmp_path: Path) -> None:
    bag = write_mcap(tmp_path / 'a.mcap', [
        depth_entry(number, millimetres(number, 4, 6), '16UC1') for number in range(3)])
    assert convert(bag, tmp_path / 'b.mcap') == 0
    assert read_all(tmp_path / 'b.mcap') == read_all(bag)
