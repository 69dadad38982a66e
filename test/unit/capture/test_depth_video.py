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

"""Videos with one channel of 16 bits: exact numbers, damage and hostile files."""

from __future__ import annotations

from pathlib import Path
import shutil
import subprocess
import sys

import av
import numpy as np
from opencv_tools.base.text import printable
from opencv_tools.capture.errors import BrokenFrameError, CaptureError
from opencv_tools.capture.frame import FileSource
from opencv_tools.capture.source import expected_size, open_source
from opencv_tools.capture.video import VideoSource
from opencv_tools.recording.video.writer import to_video_frame, VideoWriter
import pytest
from waiting import LONGEST_SECONDS

START_NS = 1_700_000_000_123_456_789
SIZES = [(4, 4), (4, 5), (5, 4), (288, 4), (4, 352), (37, 23), (288, 352), (289, 4), (5, 353),
         (1000, 4), (2000, 63), (480, 848)]


def depth(number: int, height: int = 70, width: int = 90) -> np.ndarray:
    """Return numbers of all 16 bits, with 0, 1 and 65535 among them."""
    image = np.random.default_rng(number).integers(0, 2**16, (height, width)).astype(np.uint16)
    image.flat[:3] = [65535, 0, 1][:image.size]
    return image


CHECKSUMS = {'level': '3', 'slicecrc': '1'}  # the defaults of FFmpeg since version 7


def write(path: Path, images: list[np.ndarray], encoding: str = '16UC1',
          step_ns: int = 40_000_000) -> Path:
    first = to_video_frame(images[0], encoding, '.mkv')
    video = VideoWriter(path, first, START_NS)
    for number, image in enumerate(images):
        frame = to_video_frame(image, encoding, '.mkv')
        assert video.fits(frame, START_NS + number * step_ns)
        assert video.write(frame, START_NS + number * step_ns)
    video.close()
    return path


def write_foreign(path: Path, images: list[np.ndarray], pixels: str = 'gray16le',
                  encoding: str = '', **options: str) -> Path:
    """Write a video as another program does, without our metadata."""
    height, width = images[0].shape[:2]
    with av.open(str(path), 'w') as container:
        stream = container.add_stream('ffv1', rate=25, options=options or CHECKSUMS)
        stream.width, stream.height, stream.pix_fmt = width, height, pixels
        if encoding:
            stream.metadata['encoding'] = encoding
        for image in images:
            frame = av.VideoFrame.from_ndarray(
                image, 'gray16le' if image.dtype == np.uint16 else 'gray')
            container.mux(stream.encode(frame.reformat(format=pixels)))
        container.mux(stream.encode(None))
    return path


def opened(path: Path) -> FileSource:
    source = open_source(str(path))
    assert not source.live
    return source


def read_all(source: FileSource) -> list[np.ndarray | None]:
    """Return the images of a source, with None for those that cannot be read."""
    images: list[np.ndarray | None] = []
    while len(images) < 100:
        try:
            frame = source.read()
        except BrokenFrameError:
            images.append(None)
            continue
        if frame is None:
            return images
        images.append(frame.image)
    raise AssertionError('the source does not end')


@pytest.mark.parametrize('encoding', ['16UC1', 'mono16'])
@pytest.mark.parametrize(('height', 'width'), SIZES)
def test_numbers_are_read_as_they_were_written(
        tmp_path: Path, height: int, width: int, encoding: str) -> None:
    images = [depth(number, height, width) for number in range(3)]
    path = write(tmp_path / 'a.mkv', images, encoding)
    source = opened(path)
    for _ in range(2):
        for number, image in enumerate(images):
            frame = source.read()
            assert frame and frame.encoding == encoding
            np.testing.assert_array_equal(frame.image, image, strict=True)
            assert frame.position == pytest.approx(0.04 * number)
        assert source.read() is None and source.read() is None
        source.rewind()
    source.close()
    source.close()
    assert expected_size(str(path)) == (width, height)


def test_metadata_of_the_stream(tmp_path: Path) -> None:
    for encoding, unit in (('16UC1', 'mm'), ('mono16', None)):
        with av.open(str(write(tmp_path / f'{encoding}.mkv', [depth(1)], encoding))) as container:
            stream = container.streams.video[0]
            tags = {name.lower(): value for name, value in stream.metadata.items()}
            assert (tags['encoding'], tags.get('depth_unit')) == (encoding, unit)
            assert (stream.codec_context.name, stream.codec_context.pix_fmt) == (
                'ffv1', 'gray16le')


@pytest.mark.parametrize('dtype', ['<u2', '>u2'])
def test_numbers_of_any_layout(tmp_path: Path, dtype: str) -> None:
    image = depth(3, 140, 99).astype(dtype)[::2, ::-3]
    for shown in (image, image[..., None]):
        path = write(tmp_path / f'{shown.ndim}.mkv', [shown])
        assert (read_all(opened(path))[0] == image).all()


@pytest.mark.parametrize('step_ns', [1_000_000, 33_000_000, 1_700_000_000])
def test_times_of_the_frames(tmp_path: Path, step_ns: int) -> None:
    source = opened(write(tmp_path / 'a.mkv', [depth(1)] * 5, step_ns=step_ns))
    positions = [frame.position for frame in iter(source.read, None)]
    assert positions == pytest.approx([number * step_ns / 1e9 for number in range(5)])


def test_skipped_frames(tmp_path: Path) -> None:
    source = opened(write(tmp_path / 'a.mkv', [depth(number) for number in range(4)]))
    assert source.skip() and source.skip()
    frame = source.read()
    assert frame and (frame.image == depth(2)).all()
    assert [source.skip(), source.skip()] == [True, False]
    assert source.description == 'gray16le 90x70 at 25 Hz'


@pytest.mark.parametrize('suffix', ['mkv', 'avi', 'nut'])
@pytest.mark.parametrize('options', [{}, {'g': '1'}, {'level': '1'}, {'slicecrc': '0'}])
def test_file_of_another_program(
        tmp_path: Path, suffix: str, options: dict[str, str]) -> None:
    images = [depth(number) for number in range(15)]
    path = write_foreign(tmp_path / f'a.{suffix}', images, **options)
    source = opened(path.rename(tmp_path / 'video'))
    frame = source.read()
    assert frame and frame.encoding == 'mono16'
    source.rewind()
    np.testing.assert_array_equal(read_all(source), images)


@pytest.mark.parametrize('options', [
    {'level': '1'}, {'level': '3', 'slicecrc': '0'}, {'level': '3', 'slicecrc': '1'},
    {'level': '3', 'slicecrc': '1', 'slices': '4'}])
def test_copy_of_another_program_with_metadata(
        tmp_path: Path, options: dict[str, str]) -> None:
    images = [depth(number) for number in range(3)]
    source = opened(write_foreign(tmp_path / 'a.mkv', images, encoding='16UC1', **options))
    np.testing.assert_array_equal(read_all(source), images)
    has_sums = options.get('slicecrc') == '1'
    assert [*source.warnings] == ([] if has_sums else [
        f'{tmp_path}/a.mkv has no checksums, so that damaged frames are not noticed; FFmpeg '
        'writes them with -c:v ffv1 -level 3 -slicecrc 1'])


@pytest.mark.process
@pytest.mark.skipif(not shutil.which('ffmpeg'), reason='needs the command ffmpeg')
def test_file_of_the_command_ffmpeg(tmp_path: Path) -> None:
    images = [depth(number, 23, 37) for number in range(15)]
    subprocess.run(
        ['ffmpeg', '-v', 'error', '-f', 'rawvideo', '-pix_fmt', 'gray16le', '-s', '37x23', '-i',
         '-', '-c:v', 'ffv1', tmp_path / 'a.mkv'], input=np.stack(images).tobytes(), check=True,
        timeout=LONGEST_SECONDS)
    np.testing.assert_array_equal(read_all(opened(tmp_path / 'a.mkv')), images)
    for step_ns in (33_333_333, 40_000_000, 143_000_000):
        path = write(tmp_path / f'{step_ns}.mkv', images, step_ns=step_ns)
        read = subprocess.run(
            ['ffmpeg', '-v', 'error', '-i', path, '-f', 'rawvideo', '-pix_fmt', 'gray16le', '-'],
            capture_output=True, check=True, timeout=LONGEST_SECONDS)
        assert read.stdout == np.stack(images).tobytes()
        pictures = tmp_path / f'{step_ns}'
        pictures.mkdir()
        subprocess.run(['ffmpeg', '-v', 'error', '-i', path, pictures / '%03d.png'], check=True,
                       timeout=LONGEST_SECONDS)
        assert len([*pictures.iterdir()]) == len(images)


@pytest.mark.parametrize('step_ns', [33_333_333, 40_000_000, 143_000_000])
def test_rate_is_that_of_the_times(tmp_path: Path, step_ns: int) -> None:
    source = opened(write(tmp_path / 'a.mkv', [depth(1)] * 9, step_ns=step_ns))
    assert source.rate == pytest.approx(1e9 / step_ns, rel=0.02)


def write_frames(path: Path, codec: str, images: list[np.ndarray], pixels: str) -> Path:
    """Write numbers into the first plane, as they are."""
    height, width = images[0].shape
    with av.open(str(path), 'w') as container:
        try:
            stream = container.add_stream(codec, rate=25)
        except (ValueError, av.error.FFmpegError):
            pytest.skip(f'this FFmpeg does not encode {codec}')
        stream.width, stream.height, stream.pix_fmt = width, height, pixels
        stream.options = CHECKSUMS if codec == 'ffv1' else {}
        if codec == 'libx265':
            stream.options = {'x265-params': 'lossless=1:log-level=none'}
        for number, image in enumerate(images):
            frame = av.VideoFrame(width, height, pixels)
            numbers = np.frombuffer(frame.planes[0], '>u2' if pixels.endswith('be') else '<u2')
            numbers.reshape(height, -1)[:, :width] = image
            frame.pts = number
            container.mux(stream.encode(frame))
        container.mux(stream.encode(None))
    return path


@pytest.mark.parametrize(('codec', 'pixels', 'suffix'), [
    ('ffv1', 'gray10le', 'mkv'), ('ffv1', 'gray12le', 'mkv'), ('png', 'gray16be', 'avi'),
    ('ffvhuff', 'gray16le', 'avi'), ('rawvideo', 'gray16le', 'nut'),
    ('rawvideo', 'gray10le', 'nut'), ('rawvideo', 'gray16be', 'nut'),
    ('jpeg2000', 'gray16le', 'mkv'), ('libx265', 'gray12le', 'mkv'),
    ('libx265', 'gray10le', 'mp4')])
def test_gray_of_any_codec_keeps_its_numbers(
        tmp_path: Path, codec: str, pixels: str, suffix: str) -> None:
    bits = int(pixels[4:6])
    images = [depth(number, 50, 77) >> (16 - bits) for number in range(12)]
    source = opened(write_frames(tmp_path / f'a.{suffix}', codec, images, pixels))
    assert source.description == f'{pixels} 77x50 at 25 Hz' and not source.warnings
    for _ in range(2):
        found = read_all(source)
        if codec != 'jpeg2000':  # with a loss, but not that of 8 bits
            np.testing.assert_array_equal(found, images)
        assert len(found) == 12 and all(one is not None and one.max() > 255 for one in found)
        source.rewind()
    assert source.skip()
    frame = source.read()
    assert frame and frame.encoding == 'mono16'


def test_unit_of_all_16_bits_only(tmp_path: Path) -> None:
    path = write_foreign(tmp_path / 'a.mkv', [depth(1)], 'gray12le', '16UC1')
    frame = opened(path).read()
    assert frame and frame.encoding == 'mono16'


@pytest.mark.parametrize(('codec', 'pixels'), [
    ('ffv1', 'gbrp16le'), ('ffv1', 'yuv420p10le'), ('png', 'ya16be'),
    ('ffv1', 'gray'), ('ffv1', 'bgr0'), ('ffv1', 'yuv410p'), ('ffv1', 'ya8'),
    ('mjpeg', 'yuvj420p'), ('png', 'rgb24')])
def test_other_pixels_have_8_bits(tmp_path: Path, codec: str, pixels: str) -> None:
    path = tmp_path / 'a.avi'
    with av.open(str(path), 'w') as container:
        stream = container.add_stream(codec, rate=25)
        stream.width, stream.height, stream.pix_fmt = 64, 48, pixels
        for _ in range(3):
            frame = av.VideoFrame.from_ndarray(np.full((48, 64), 2, np.uint8), 'gray')
            container.mux(stream.encode(frame.reformat(format=pixels)))
        container.mux(stream.encode(None))
    source = opened(path)
    assert isinstance(source, VideoSource)
    assert [shown.dtype.name for shown in read_all(source) if shown is not None] == ['uint8'] * 3
    assert [*source.warnings] == [
        f'{path} has an alpha channel, which is dropped'] * pixels.startswith('ya') + [
        f'{path} has pixels of {pixels}, which are reduced to 8 bits a channel; only gray videos '
        'keep more'] * pixels.endswith(('0le', '6le', '6be'))


def packets(path: Path) -> list[bytes]:
    with av.open(str(path)) as container:
        return [bytes(packet) for packet in container.demux(video=0) if packet.size]


@pytest.mark.parametrize('size', [(23, 37), (70, 90)])
@pytest.mark.parametrize('place', [0, 0.3, 0.999])
def test_damaged_frame_is_reported(
        tmp_path: Path, size: tuple[int, int], place: float) -> None:
    images = [depth(number, *size) for number in range(5)]
    path = write(tmp_path / 'a.mkv', images)
    damaged = packets(path)[2]
    content = bytearray(path.read_bytes())
    content[content.index(damaged) + int(place * len(damaged))] ^= 0x10
    path.write_bytes(content)
    found = read_all(opened(path))
    assert found[2] is None
    for number in (0, 1, 3, 4):
        np.testing.assert_array_equal(found[number], images[number])
    source = opened(path)
    assert [source.skip() for _ in range(6)] == [True] * 5 + [False]


def test_damaged_frame_costs_those_until_the_next_key_frame(tmp_path: Path) -> None:
    images = [depth(number) for number in range(12)]
    path = write_foreign(tmp_path / 'a.mkv', images, g='4', level='3', slicecrc='1')
    content = bytearray(path.read_bytes())
    content[content.index(packets(path)[5]) + 999] ^= 0x10
    path.write_bytes(content)
    found = read_all(opened(path))
    assert [number for number, image in enumerate(found) if image is None] == [5, 6, 7]
    for number in (0, 4, 8, 11):
        np.testing.assert_array_equal(found[number], images[number])


@pytest.mark.parametrize('part', [0.2, 0.5, 0.99])
def test_cut_file_has_its_first_frames(tmp_path: Path, part: float) -> None:
    images = [depth(number) for number in range(10)]
    path = write(tmp_path / 'a.mkv', images)
    content = path.read_bytes()
    path.write_bytes(content[:int(len(content) * part)])
    found = [image for image in read_all(opened(path)) if image is not None]
    assert len(found) in (int(10 * part), int(10 * part) - 1, int(10 * part) + 1)
    np.testing.assert_array_equal(found, images[:len(found)])


def test_end_of_a_cut_file_is_reported_once_a_pass(tmp_path: Path) -> None:
    path = write(tmp_path / 'a.mkv', [depth(number) for number in range(10)])
    content = path.read_bytes()
    path.write_bytes(content[:len(content) // 2])
    source = opened(path)
    for _ in range(4):
        assert source.skip()
    with pytest.raises(BrokenFrameError, match=(
            rf'a\.mkv is damaged: it ends after 4 frames, with {len(content) // 2} of its '
            f'{len(content)} bytes$')):
        source.skip()
    assert not source.skip() and source.read() is None
    source.rewind()
    assert len(read_all(source)) == 5


def test_file_that_is_cut_in_its_header(tmp_path: Path) -> None:
    path = write(tmp_path / 'a.mkv', [depth(1)])
    for length in (0, 3, 100, 300):
        (tmp_path / 'b.mkv').write_bytes(path.read_bytes()[:length])
        with pytest.raises(CaptureError, match=r'b\.mkv cannot be opened as a video'):
            opened(tmp_path / 'b.mkv')


@pytest.mark.parametrize('encoding', ['', 'bgr8', '32FC1', '16UC1 ', '\x1b[2J'])
def test_tag_of_another_encoding(tmp_path: Path, encoding: str) -> None:
    path = write_foreign(tmp_path / 'a.mkv', [depth(1)], encoding=encoding)
    source = opened(path)
    frame = source.read()
    assert frame and frame.encoding == 'mono16'
    assert [one.partition(' has ')[2] for one in source.warnings] == [
        f'the encoding {printable(encoding)}, but is read as mono16'] * bool(encoding)


def test_random_bytes_in_a_file(tmp_path: Path) -> None:
    whole = write(tmp_path / 'a.mkv', [depth(number, 16, 16) for number in range(3)]).read_bytes()
    random = np.random.default_rng(5)
    expected = [depth(number, 16, 16) for number in range(3)]
    for _ in range(60):
        content = np.frombuffer(whole, np.uint8).copy()
        places = random.integers(0, len(content), 8)
        content[places] = random.integers(0, 256, 8)
        (tmp_path / 'b.mkv').write_bytes(content.tobytes())
        try:
            source = opened(tmp_path / 'b.mkv')
        except CaptureError:
            continue
        if isinstance(source, VideoSource) and source.is_deep:
            for image in read_all(source):
                assert image is None or image.dtype == np.uint16
                if image is not None and source._encoding == '16UC1':
                    assert any(np.array_equal(image, one) for one in expected)
        source.close()


def test_missing_library_is_named_with_its_remedy(
        tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = write(tmp_path / 'a.mkv', [depth(1)])
    monkeypatch.setitem(sys.modules, 'av', None)
    with pytest.raises(CaptureError, match=r'a\.mkv cannot be read without PyAV: it may have gray '
                       r"of more than 8 bits, which OpenCV reduces; install it with .* av'"):
        opened(path)
    path = write_foreign(tmp_path / 'b.mkv', [depth(1)], 'yuv420p10le')
    assert ['may have more than 8 bits' in one for one in opened(path).warnings] == [True]
    path = write_foreign(tmp_path / 'c.mkv', [depth(1)], 'yuv420p')
    assert not opened(path).warnings


@pytest.mark.parametrize(('height', 'width'), [(4, 501), (77, 13), (501, 5)])
def test_picture_with_too_many_pixels(
        tmp_path: Path, monkeypatch: pytest.MonkeyPatch, height: int, width: int) -> None:
    path = write(tmp_path / 'a.mkv', [depth(1, height, width)])
    monkeypatch.setattr('opencv_tools.capture.container.MAX_PIXELS', 1000)
    with pytest.raises(CaptureError, match=(
            rf'a\.mkv cannot be read: {width}x{height} pixels are more than max_pixels=1000')):
        opened(path)


READ_HUGE = """
import resource, sys
from opencv_tools.capture.errors import CaptureError
from opencv_tools.capture.source import open_source
before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
try:
    open_source(sys.argv[1]).read()
except CaptureError as err:
    print(err)
print((resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before) // 1024)
"""


@pytest.mark.process
@pytest.mark.parametrize('size', [(65535, 65535), (20_000, 30_000), (65535, 2049)])
def test_file_that_claims_a_huge_picture(tmp_path: Path, size: tuple[int, int]) -> None:
    path = write(tmp_path / 'a.mkv', [depth(1, 300, 301)])
    content = path.read_bytes()
    sides = [b'\xb0\x82%c%c\xba\x82%c%c' % (*divmod(width, 256), *divmod(height, 256))
             for width, height in ((301, 300), size)]
    assert content.count(sides[0]) == 1
    path.write_bytes(content.replace(*sides))
    finished = subprocess.run(
        [sys.executable, '-c', READ_HUGE, path], capture_output=True, text=True, check=True,
        timeout=LONGEST_SECONDS)
    error, megabytes = finished.stdout.splitlines()
    assert 'a.mkv cannot be' in error
    assert int(megabytes) < 100, finished.stderr
