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

"""Conversions between bags, videos and image files by the command, without ROS."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
import os
from pathlib import Path
import re
import signal
import subprocess
import sys

from bag_readers import read_by_all
from conftest import CLIP, decode_clip, disk_of, read_manifest
import cv2
from images import oriented_jpeg, random_image
from mcap.reader import make_reader
import numpy as np
from opencv_tools.bags.schemas import CAMERA_INFO
from opencv_tools.base.logs import LineWriter, Log
from opencv_tools.base.progress import open_progress, Progress
from opencv_tools.capture.frame import CapturedFrame
from opencv_tools.capture.output_image import OutputImage
from opencv_tools.capture.settings import CaptureSettings
from opencv_tools.capture.source import open_source
from opencv_tools.convert.cli import main
from opencv_tools.image.encodings import ENCODINGS, find_encoding
from opencv_tools.image_codecs import convert_image
from playback import frames_of
from played_bags import (
    compressed_entry, Entry, image_entry, read_all, TOPIC, write_mcap, write_rosbag2, written)
import pytest
from waiting import communicate, LONGEST_SECONDS, pause, wait_until, work_of

PICTURE = np.random.default_rng(1).integers(0, 256, (16, 24, 3), np.uint8)
JPEG_BYTES = cv2.imencode('.jpg', PICTURE)[1].tobytes()


def convert(*words: object) -> int:
    return main([str(word) for word in words])


def frames(path: Path) -> list[CapturedFrame]:
    return list(frames_of(open_source(str(path))))


def test_clip_becomes_a_bag_and_the_bag_becomes_images(
        tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert convert(CLIP, tmp_path / 'clip.mcap', '--start', 22, '--stop', 28) == 0
    assert 'Converted 6 frames at ' in capsys.readouterr().err.splitlines()[-1]
    assert convert(tmp_path / 'clip.mcap', tmp_path / 'out' / '{stamp}.png') == 0
    paths = sorted((tmp_path / 'out').glob('*.png'), key=lambda path: float(path.stem))
    assert [path.stem for path in paths] == [
        f'{number // 25}.{number % 25 * 40:03d}000000' for number in range(22, 28)]
    for path, expected in zip(paths, decode_clip(28)[22:], strict=True):
        np.testing.assert_array_equal(cv2.imread(str(path)), expected)
    assert len(read_manifest(tmp_path / 'out')) == 6


@pytest.mark.parametrize('user', ['me:CANARY', 'me:CANARY#1', 'CAN@CANARY/1', 'me:[CANARY'])
@pytest.mark.parametrize('words', [
    ('out/{seq}.png',), ('out/{seq}.png', '--topic', '/a'), ('out/{seq}.png', 'http://CANARY@h'),
    ('out', '--format', 'lerobot', '--fps', '30', '--state', '/a.b')])
def test_password_of_a_source_is_not_printed(
        user: str, words: tuple[str, ...], tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
        capfd: pytest.CaptureFixture[str]) -> None:
    monkeypatch.chdir(tmp_path)
    with suppress(SystemExit):  # of argparse
        assert convert(f'http://{user}@127.0.0.1:9/x?token=CANARY', *words) in (1, 2)
    shown = capfd.readouterr()
    assert 'error' in shown.err
    assert 'CANARY' not in shown.out + shown.err
    assert not [path for path in tmp_path.rglob('*') if path.is_file()]


def test_source_that_is_no_url_is_an_invalid_argument(
        tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert convert('rtsp://me:SECRET?12@127.0.0.1/x', tmp_path / '{seq}.png') == 2
    assert capsys.readouterr().err == (
        'img_convert: error: the host and the port of this URL cannot be read: '
        "write '?' as %3F in the user name and the password\n")


def heads(path: Path) -> list[tuple[int, int, int]]:
    """Return the numbers and times of messages, as the library mcap reads them."""
    with path.open('rb') as file:
        return [(message.sequence, message.log_time, message.publish_time)
                for _, _, message in make_reader(file).iter_messages()]


@pytest.mark.parametrize('encoding', [*ENCODINGS, '32FC1', '16SC1', '64FC3'])
def test_every_encoding_goes_through_bags_and_arrays(tmp_path: Path, encoding: str) -> None:
    images = [random_image(encoding, 4, 6) for _ in range(3)]
    source = write_mcap(tmp_path / 'a.mcap', [
        image_entry(number, image, encoding) for number, image in enumerate(images)])
    assert convert(source, tmp_path / 'b.mcap') == 0
    assert convert(tmp_path / 'b.mcap', tmp_path / '{frame_id}.npy') == 0
    assert read_all(tmp_path / 'b.mcap') == read_all(source)
    assert len(read_by_all(tmp_path / 'b.mcap')) == 3
    assert heads(tmp_path / 'b.mcap') == heads(source)
    for number, image in enumerate(images):
        np.testing.assert_array_equal(
            np.load(tmp_path / f'optical_{number}.npy'), image, strict=True)


@pytest.mark.parametrize('suffix', ['.mcap', '.db3'])
def test_folder_of_rosbag2_with_two_topics(
        tmp_path: Path, suffix: str, capsys: pytest.CaptureFixture[str]) -> None:
    entries = [image_entry(1), image_entry(2, topic='/depth'), image_entry(3, topic='/depth')]
    folder = write_rosbag2(tmp_path / 'bag', suffix, entries)
    target = tmp_path / '{topic}_{sec}_{nanosec}.png'
    assert convert(folder, target) == 2
    assert convert(folder, target, '--topic', '/wrong') == 2
    assert 'has no topic /wrong' in capsys.readouterr().err
    assert convert(folder, target) == 2
    assert 'or --topic of the command, to one of /camera/image_raw (' in capsys.readouterr().err
    assert convert(folder, target, '--topic', '/depth') == 0
    assert sorted(path.name for path in tmp_path.glob('*.png')) == [
        f'depth_1700000000_{nanosec}.png' for nanosec in ('080000000', '120000000')]


@pytest.mark.parametrize(('encoding', 'shown', 'codec', 'format_text', 'difference'), [
    ('bgr8', 'bgr8', 'jpeg', 'bgr8; jpeg compressed bgr8', 31),
    ('rgb8', 'rgb8', 'jpeg', 'rgb8; jpeg compressed bgr8', 31),
    ('mono8', 'mono8', 'jpeg', 'mono8; jpeg compressed mono8', 31),
    ('bayer_rggb8', 'bgr8', 'jpeg', 'bayer_rggb8; jpeg compressed bgr8', 31),
    ('rgb8', 'rgb8', 'png', 'rgb8; png compressed bgr8', 0),
    ('rgba8', 'rgba8', 'png', 'rgba8; png compressed bgra8', 0),
    ('16UC1', '16UC1', 'png', '16UC1; png compressed 16UC1', 0)])
def test_bag_of_compressed_images(tmp_path: Path, encoding: str, shown: str, codec: str,
                                  format_text: str, difference: int) -> None:
    image = cv2.GaussianBlur(random_image(encoding, 16, 32), (0, 0), 5)
    target = tmp_path / 'out' / 'b.mcap'
    source = write_mcap(tmp_path / 'a.mcap', [
        image_entry(number, image, encoding) for number in range(3)])
    assert convert(source, target, '--compressed', codec, '--lossy') == 0
    found = frames(target)
    assert len(found) == 3 and heads(target) == heads(source)
    for frame, original in zip(found, frames(source), strict=True):
        assert frame.recorded and original.recorded
        assert frame.recorded.topic == f'{TOPIC}/compressed'
        assert frame.recorded.message.format == format_text
        assert frame.recorded.message.header == original.recorded.message.header
    expected = convert_image(image, find_encoding(encoding), find_encoding(shown))
    output = OutputImage(found[0], CaptureSettings(encoding=shown))
    np.testing.assert_allclose(output.image.astype(int), expected, rtol=0, atol=difference)
    line, = read_manifest(tmp_path / 'out')
    assert (line['encoding'], line['stored_encoding']) == (encoding, format_text)
    assert line['size'] == [32, 16]


def test_compressed_images_stay_as_they_are(tmp_path: Path) -> None:
    source = write_mcap(tmp_path / 'a.mcap', [compressed_entry(1, JPEG_BYTES)])
    assert convert(source, tmp_path / 'b.mcap', '--compressed', 'png') == 0
    assert read_all(tmp_path / 'b.mcap') == read_all(source)


def test_loss_of_compression_has_to_be_allowed(
        tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    source = write_mcap(tmp_path / 'a.mcap', [image_entry(1)])
    assert convert(source, tmp_path / 'b.mcap', '--compressed', 'jpeg') == 2
    assert 'give --lossy' in capsys.readouterr().err
    assert convert(source, tmp_path / 'b.mcap', '--compressed', 'png') == 0
    assert convert(CLIP, tmp_path / 'c.mcap', '--compressed', 'jpeg', '--stop', '2') == 0
    topics = {frame.recorded.topic for frame in frames(tmp_path / 'c.mcap') if frame.recorded}
    assert topics == {'/video_frames/compressed'}


def test_codec_that_cannot_store_the_frames(
        tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    source = write_mcap(tmp_path / 'a.mcap', [
        image_entry(1, random_image('32FC3', 4, 6), '32FC3')])
    assert convert(source, tmp_path / 'b.mcap', '--compressed', 'jpeg', '--lossy') == 1
    assert 'a 32FC3 frame cannot be compressed as jpeg' in capsys.readouterr().err


@pytest.mark.parametrize('encoding', ['mono16', '16UC1', '32FC1'])
def test_compressed_numbers_need_a_range(
        tmp_path: Path, capsys: pytest.CaptureFixture[str], encoding: str) -> None:
    image = np.array([[0, 1000, 3000, 5000]]).repeat(8, axis=0).astype(
        find_encoding(encoding).dtype)
    source = write_mcap(tmp_path / 'a.mcap', [image_entry(1, image, encoding)])
    words = source, tmp_path / 'b.mcap', '--compressed', 'jpeg', '--lossy'
    assert convert(*words) == 2
    assert f'{encoding} frames become 8 bits in .jpg: give --range' in capsys.readouterr().err
    assert convert(*words, '--range', '0:5000') == 0
    frame, = frames(tmp_path / 'b.mcap')
    output = OutputImage(frame, CaptureSettings(encoding=''))
    assert output.encoding == 'mono8'
    np.testing.assert_allclose(output.image[0], [0, 51, 153, 255], atol=20)
    assert frame.recorded and frame.recorded.message.format == 'mono8; jpeg compressed mono8'


def test_jpegs_of_a_bag_become_files_byte_for_byte(tmp_path: Path) -> None:
    source = write_mcap(tmp_path / 'a.mcap', [
        compressed_entry(number, JPEG_BYTES) for number in range(3)])
    assert convert(source, tmp_path / '{seq}.jpg') == 0
    assert convert(source, tmp_path / 'b.mcap') == 0
    assert [path.read_bytes() for path in tmp_path.glob('*.jpg')] == [JPEG_BYTES] * 3
    assert read_all(tmp_path / 'b.mcap') == read_all(source)


def test_jpeg_files_stay_jpeg_files_byte_for_byte(tmp_path: Path) -> None:
    turned = oriented_jpeg(PICTURE, 6)
    for name, content in (('a.jpg', JPEG_BYTES), ('b.JPG', turned), ('c.jpg', JPEG_BYTES[:-50])):
        (tmp_path / name).write_bytes(content)
    cv2.imwrite(str(tmp_path / 'd.png'), PICTURE)
    assert convert(tmp_path, tmp_path / 'out' / '{seq}.jpg', '--lossy') == 1
    assert [path.read_bytes() for path in sorted((tmp_path / 'out').glob('*.jpg'))] == [
        JPEG_BYTES, turned, cv2.imencode('.jpg', PICTURE)[1].tobytes()]
    assert convert(tmp_path / 'b.JPG', tmp_path / 'b.mcap') == 0
    frame, = frames(tmp_path / 'b.mcap')
    assert frame.image.shape == (24, 16, 3)


def test_calibration_goes_with_its_images(
        tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    infos = [Entry(image_entry(number).log_ns, image_entry(number).data[:12] + b'calibration',
                   '/camera/camera_info', CAMERA_INFO) for number in range(2)]
    source = write_mcap(tmp_path / 'a.mcap', [
        *infos, *map(image_entry, range(3)), image_entry(4, topic='/other')])
    assert convert(source, tmp_path / 'b.mcap', '--topic', TOPIC, '--topics', '/camera*') == 0
    assert 'left out, with numbers of messages: /other (1 of 1)' in capsys.readouterr().err
    messages, _ = read_all(tmp_path / 'b.mcap')
    assert sorted(messages) == sorted(written([*infos, *map(image_entry, range(3))]))


def write_bag(folder: Path) -> Path:
    """Write frames 0 to 5, each with its number as its pixels."""
    return write_mcap(folder / 'a.mcap', map(image_entry, range(6)))


def write_images(folder: Path) -> Path:
    """Write frames 0 to 5 as PNG files; assert that the bag is converted to them."""
    assert convert(write_bag(folder), folder / 'in' / '{seq}.png') == 0
    return folder / 'in'


@pytest.mark.parametrize(('options', 'expected'), [
    ((), range(6)), (('--every', '4'), [0, 4]), (('--start', '2'), [2, 3, 4, 5]),
    (('--stop', '2'), [0, 1]), (('--start', '1', '--stop', '5', '--every', '2'), [1, 3]),
    (('--stop', '99'), range(6))])
@pytest.mark.parametrize('write', [write_bag, write_images])
def test_part_of_a_source(tmp_path: Path, options: tuple[str, ...], expected: list[int],
                          write: Callable[[Path], Path]) -> None:
    assert convert(write(tmp_path), tmp_path / 'out' / '{seq}.png', *options) == 0
    shown = [int(frame.image[0, 0]) for frame in frames(tmp_path / 'out')]
    assert shown == [*expected]


@pytest.mark.parametrize(('options', 'total'), [
    ((), 6), (('--stop', '4'), 4), (('--stop', '9'), 6), (('--every', '4'), 2),
    (('--start', '1', '--every', '2'), 3)])
def test_number_of_frames_in_the_progress(
        tmp_path: Path, monkeypatch: pytest.MonkeyPatch, options: tuple[str, ...],
        total: int) -> None:
    totals: list[int] = []
    monkeypatch.setattr('opencv_tools.convert.convert.open_progress', lambda log, phrase, number: (
        totals.append(number) or open_progress(log, phrase, number)))
    source = write_mcap(tmp_path / 'a.mcap', map(image_entry, range(6)))
    assert convert(source, tmp_path / 'out' / '{seq}.png', *options) == 0
    assert convert('pattern:64x48', tmp_path / '{seq}.png', '--stop', '7', '--every', '3') == 0
    assert totals == [total, 3]


@pytest.mark.parametrize('encoding', ['bgr8', 'mono8'])
def test_description_of_a_frame(
        tmp_path: Path, encoding: str, capsys: pytest.CaptureFixture[str]) -> None:
    source = write_mcap(tmp_path / 'a.mcap', [
        image_entry(1, random_image(encoding, 4, 6), encoding)])
    assert convert(source, tmp_path / 'a.png') == 0
    assert f'Converting frame 1: 6x4 {encoding}, 0 failed' in capsys.readouterr().err
    jpeg = write_mcap(tmp_path / 'b.mcap', [compressed_entry(1, JPEG_BYTES)])
    assert convert(jpeg, tmp_path / 'a.jpg') == 0
    assert f'frame 1: {len(JPEG_BYTES)} compressed bytes,' in capsys.readouterr().err


def test_progress_that_is_closed_after_an_error(
        tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    closed: list[bool] = []
    totals: list[int] = []

    def open_counted(writer: LineWriter, phrase: str, total: int) -> tuple[Log, Progress]:
        log, progress = open_progress(writer, phrase, total)
        monkeypatch.setattr(progress, 'close', lambda: closed.append(True))
        totals.append(total)
        return log, progress

    monkeypatch.setattr('opencv_tools.convert.convert.open_progress', open_counted)
    source = write_mcap(tmp_path / 'a.mcap', map(image_entry, range(2)))
    assert convert(source, tmp_path / 'a.png', '--start', 9) == 2
    assert convert(source, tmp_path / 'a.png') == 0
    assert (closed, totals) == ([True, True], [0, 2])


def test_source_without_frames(
        tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    source = write_mcap(tmp_path / 'a.mcap', [image_entry(1)._replace(data=b'')])
    assert convert(source, tmp_path / 'a.png') == 1
    assert capsys.readouterr().err.endswith('a.mcap has no readable frame\n')


def test_times_of_frames_without_a_header(tmp_path: Path) -> None:
    for number in range(3):
        cv2.imwrite(str(tmp_path / f'{number}.png'), PICTURE)
    assert convert(tmp_path / '*.png', tmp_path / 'a.mcap') == 0
    recorded = [frame.recorded for frame in frames(tmp_path / 'a.mcap')]
    assert [(found.log_ns, found.header_ns, found.topic, found.message.header.frame_id)
            for found in recorded if found] == [
        (number * 100_000_000, number * 100_000_000, '/video_frames', 'camera')
        for number in range(3)]


@pytest.mark.parametrize(('encoding', 'target', 'reason'), [
    ('bgr8', 'a.mp4', r'\.mp4 loses quality'), ('bgr8', '{seq}.jpg', r'\.jpg loses quality'),
    ('bayer_rggb8', '{seq}.png', 'bayer_rggb8 frames are converted to colour'),
    ('yuv422', '{seq}.png', 'yuv422 frames are converted to colour'),
    ('nv12', 'a.mkv', 'nv12 frames are converted to colour')])
def test_loss_has_to_be_allowed(
        tmp_path: Path, capsys: pytest.CaptureFixture[str], encoding: str, target: str,
        reason: str) -> None:
    source = write_mcap(tmp_path / 'a.mcap', [
        image_entry(1, random_image(encoding, 8, 16), encoding)])
    assert convert(source, tmp_path / 'out' / target) == 2
    assert re.search(f'error: {reason}.*give --lossy', capsys.readouterr().err)
    assert not (tmp_path / 'out').exists()
    assert convert(source, tmp_path / 'out' / target, '--lossy') == 0
    assert len(frames(next((tmp_path / 'out').glob('[!m]*')))) == 1


@pytest.mark.parametrize('target', ['{seq}.jpg', '{seq}.webp', 'a.mp4', 'a.mkv'])
@pytest.mark.parametrize(('encoding', 'limits'), [
    ('bgra8', ()), ('rgba8', ()), ('bgr16', ()), ('bayer_rggb16', ()), ('bayer_gbrg16', ()),
    ('8UC1', ()), ('8UC4', ()), ('16UC3', ()), ('16UC1', ('--range=370:4900',)),
    ('mono16', ('--range=0:3071',)), ('32FC1', ('--range', '-0.37:0.9'))])
def test_lossy_means_alpha_and_bits(
        tmp_path: Path, capsys: pytest.CaptureFixture[str], encoding: str,
        limits: tuple[str, ...], target: str) -> None:
    source = write_mcap(tmp_path / 'a.mcap', [
        image_entry(number, random_image(encoding, 23, 37), encoding) for number in range(1, 4)])
    out = tmp_path / 'out' / target
    assert convert(source, out, '--lossy', *limits) == 0
    read = [frame for path in sorted((tmp_path / 'out').glob('[!m]*')) for frame in frames(path)]
    assert [frame.image.shape[:2] for frame in read] == [(23, 37)] * 3
    assert {frame.image.dtype.name for frame in read} == {'uint8'}
    if limits:
        capsys.readouterr()
        assert convert(source, tmp_path / 'no' / target, '--lossy') == 2
        assert re.search(f'{encoding} frames become 8 bits in .*: give --range LOW:HIGH, the '
                         'numbers that become black and white; those of the first frame are',
                         capsys.readouterr().err)
        assert not (tmp_path / 'no').exists()


@pytest.mark.parametrize(('arguments', 'reason'), [
    (('--colors', 'turbo'), '--colors is turbo, but has an effect with --lossy and --range in '
     'pictures and videos only: give --lossy, --range LOW:HIGH and a target with an extension'),
    (('--colors', 'jet', '--lossy'), '--colors is jet, but has an effect with'),
    (('--colors', 'turbo', '--range', '0:9'), '--range is 0:9, but has an effect with --lossy'),
    (('--colors', 'no'), "invalid choice: 'no'"),
    (('--range', '1:5'), r'--range is 1:5, but has an effect with --lossy only'),
    (('--lossy', '--range', '5:1'), "'5:1' is not LOW:HIGH"),
    (('--lossy', '--range', '-1:-5'), "'-1:-5' is not LOW:HIGH"),
    (('--lossy', '--range', '--start'), "'--start' is not LOW:HIGH"),
    (('--lossy', '--range'), 'argument --range: expected one argument'),
    (('--lossy', '--range', '5'), "'5' is not LOW:HIGH"),
    (('--lossy', '--range', 'nan:1'), "'nan:1' is not LOW:HIGH"),
    (('--lossy', '--range', '0:inf'), "'0:inf' is not LOW:HIGH")])
def test_ranges_that_cannot_be_used(
        tmp_path: Path, capsys: pytest.CaptureFixture[str], arguments: tuple[str, ...],
        reason: str) -> None:
    try:
        status = convert('pattern', tmp_path / '{seq}.jpg', '--stop', '1', *arguments)
    except SystemExit as err:
        status = err.code
    assert status == 2
    assert reason in capsys.readouterr().err


@pytest.mark.parametrize('target', ['a.npy', 'a.mcap'])
def test_range_of_a_target_that_keeps_numbers(
        tmp_path: Path, capsys: pytest.CaptureFixture[str], target: str) -> None:
    words = 'pattern:depth:64x48', tmp_path / target, '--stop', 1, '--lossy', '--range', '0:9'
    for more in ((), ('--colors', 'turbo')):
        assert convert(*words, *more) == 2
        assert f'--range is 0:9, but {target[1:]} keeps all numbers' in capsys.readouterr().err
    assert convert(*words[:4]) == 0


# Depth in millimetres, and its colours of turbo from 300 to 5000 as they are published, in BGR.
DEPTHS = {0: (0, 0, 0), 300: (59, 18, 48), 2650: (60, 252, 164), 5000: (3, 4, 122)}


@pytest.mark.parametrize('unit', [1, 0.001])
@pytest.mark.parametrize('target', ['a.mp4', 'a.mkv', 'a.jpg', 'a.png', 'a.webp'])
def test_depth_in_colours(tmp_path: Path, target: str, unit: float) -> None:
    image = np.kron([[*DEPTHS]], np.ones((32, 32))) * unit
    encoding = '16UC1' if unit == 1 else '32FC1'
    source = write_mcap(tmp_path / 'a.mcap', [image_entry(
        1, image.astype(find_encoding(encoding).dtype), encoding)])
    assert convert(source, tmp_path / 'out' / target, '--lossy', '--range',
                   f'{300 * unit:g}:{5000 * unit:g}', '--colors', 'turbo') == 0
    frame, = frames(tmp_path / 'out' / target)
    assert frame.image.shape == (32, 128, 3)
    np.testing.assert_allclose(
        frame.image[16, 16::32].astype(int), [*DEPTHS.values()],
        atol=2 if target in ('a.png', 'a.webp') else 12)


@pytest.mark.parametrize('target', ['{seq}.jpg', 'a.mp4'])
def test_source_that_has_lost_quality_needs_no_permission(tmp_path: Path, target: str) -> None:
    bag = write_mcap(tmp_path / 'a.mcap', [compressed_entry(1, JPEG_BYTES)])
    (tmp_path / 'in.jpg').write_bytes(JPEG_BYTES)
    for number, source in enumerate((bag, tmp_path / 'in.jpg', CLIP)):
        assert convert(source, tmp_path / f'{number}' / target, '--stop', 2) == 0


def test_lossless_compressed_images_need_permission(tmp_path: Path) -> None:
    png = cv2.imencode('.png', PICTURE)[1].tobytes()
    source = write_mcap(tmp_path / 'a.mcap', [compressed_entry(1, png, 'png')])
    assert convert(source, tmp_path / 'a.jpg') == 2
    assert convert(source, tmp_path / 'a.png') == 0
    assert (tmp_path / 'a.png').read_bytes() == png


@pytest.mark.parametrize(('words', 'reason'), [
    (('0', 'a.png'), '0 is a camera'), (('/dev/video7', 'a.png'), '/dev/video7 is a camera'),
    (('', 'a.png'), 'give a camera, a file'), (('pattern:1', 'a.png'), 'write a pattern as'),
    (('pattern', 'a.png'), 'pattern has no end: give --stop'),
    (('a.mp4', 'a'), "the extension '' is unknown"), (('a.mp4', 'out/'), 'is unknown'),
    (('a.mp4', 'a.db3'), r'bags are written as \.mcap, not as \.db3'),
    (('a.mp4', 'a.png', '--compressed', 'jpeg'), '--compressed is for bags'),
    (('a.mp4', 'out/{topic}/{seq}.png'), r'a folder cannot have the field \{topic\}; use it in'),
    (('a.mp4', '{bad}.png'), r'the field \{bad\} is unknown'),
    (('a.mp4', 'a.png', '--topic', '/a'), '--topic is /a, but the source a.mp4 is not a bag'),
    (('a.mp4', 'a.png', '--start', '5', '--stop', '5'), 'which is not before --stop 5')])
def test_invalid_arguments(
        words: tuple[str, ...], reason: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(words) == 2
    assert re.fullmatch(f'img_convert: error: .*{reason}.*\n', capsys.readouterr().err)


@pytest.mark.parametrize(('words', 'reason'), [
    (('a.png', '--every', '0'), "'0' is not an integer of 1 or more"),
    (('a.png', '--every', '-1'), "'-1' is not an integer of 1 or more"),
    (('a.png', '--stop', 'x'), "'x' is not an integer of 1 or more"),
    (('a.png', '--start', '-1'), "'-1' is not an integer of 0 or more"),
    ((), 'the following arguments are required: TARGET')])
def test_options_that_are_no_numbers(
        words: tuple[str, ...], reason: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        main(['a.mp4', *words])
    assert ended.value.code == 2
    assert reason in capsys.readouterr().err


def test_failures_are_counted_and_change_the_exit_status(
        tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    entries = [image_entry(0), image_entry(1)._replace(data=b''), image_entry(
        2, random_image('32FC1', 4, 6), '32FC1'), image_entry(3)]
    source = write_mcap(tmp_path / 'a.mcap', entries)
    assert convert(source, tmp_path / 'out' / '{nanosec}.png') == 1
    lines = capsys.readouterr().err.splitlines()
    assert re.search(r'Converted 3 frames at .* Hz: 2 written to .*/out, 2 failed$', lines[-1])
    assert sum('error: a frame was not read' in line for line in lines) == 1
    assert sum('error: a frame was not written: a 32FC1 frame' in line for line in lines) == 1
    assert sorted(path.stem for path in (tmp_path / 'out').glob('*.png')) == [
        '000000000', '120000000']


def test_cut_bag_is_converted_with_one_warning(
        tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    source = write_mcap(tmp_path / 'a.mcap', map(image_entry, range(6)), use_chunking=False)
    os.truncate(source, source.read_bytes().index(bytes([4]) * 24))
    assert convert(source, tmp_path / '{seq}.png') == 0
    assert capsys.readouterr().err.count('warning: a.mcap has no end') == 1
    assert len(list(tmp_path.glob('*.png'))) == 4


def test_nothing_is_overwritten(tmp_path: Path) -> None:
    source = write_mcap(tmp_path / 'a.mcap', map(image_entry, range(2)))
    before = source.read_bytes()
    for _ in range(2):
        assert convert(source, tmp_path / 'a.mcap') == 0
        assert convert(source, tmp_path / '{seq}.png') == 0
    assert source.read_bytes() == before
    assert sorted(path.name for path in tmp_path.iterdir()) == [
        '0.png', '1.png', '2.png', '3.png', 'a.mcap', 'a_1.mcap', 'a_2.mcap', 'manifest.jsonl']


@pytest.mark.parametrize(('target', 'shown'), [
    ('a.mcap', ['a.mcap', 'a_1.mcap']), ('a.mkv', ['a.mkv', 'a_1.mkv']), ('{seq}.png', ['', '']),
    ('a.npy', ['', ''])])
def test_written_file_in_the_account(
        tmp_path: Path, capsys: pytest.CaptureFixture[str], target: str, shown: list[str]) -> None:
    for name in shown:
        source = CLIP if target == 'a.mkv' else 'pattern:64x48'
        assert convert(source, tmp_path / target, '--stop', 3) == 0
        account = capsys.readouterr().err.splitlines()[-1]
        assert f': 3 written to {tmp_path / name}, 0 failed' in account


@pytest.mark.parametrize(('count', 'shown'), [
    (1, 'Converted 1 frame: 1 written'), (2, r'Converted 2 frames at [0-9.]+ Hz: 2 written'),
    (7, r'Converted 7 frames at [0-9.]+ Hz: 7 written')])
def test_account_of_few_frames(
        tmp_path: Path, capsys: pytest.CaptureFixture[str], count: int, shown: str) -> None:
    assert convert('pattern:64x48', tmp_path / '{seq}.png', '--stop', count) == 0
    assert re.search(f'^img_convert: {shown} to ', capsys.readouterr().err.splitlines()[-1])


def test_full_disk_is_a_count(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with disk_of(100_000):
        assert convert(CLIP, tmp_path / '{seq}.npy', '--stop', 3) == 1
    assert 'Converted 3 frames' in capsys.readouterr().err
    assert [path.name for path in tmp_path.iterdir()] in ([], ['manifest.jsonl'])


@pytest.mark.parametrize('start', ['2', '9'])
def test_start_after_the_end(
        tmp_path: Path, capsys: pytest.CaptureFixture[str], start: str) -> None:
    source = write_mcap(tmp_path / 'a.mcap', map(image_entry, range(2)))
    assert convert(source, tmp_path / 'a.png', '--start', start) == 2
    assert f'--start is {start}, but' in capsys.readouterr().err


def test_missing_library_is_named_with_its_remedy(
        tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
        capsys: pytest.CaptureFixture[str]) -> None:
    source = write_mcap(tmp_path / 'a.mcap', [image_entry(1)])
    monkeypatch.setitem(sys.modules, 'mcap.records', None)
    assert convert(source, tmp_path / 'a.png') == 1
    assert convert(CLIP, tmp_path / 'a.mcap') == 2
    assert capsys.readouterr().err.count("install it with 'pip install mcap'") == 2


@pytest.mark.thorough
@pytest.mark.process
@pytest.mark.parametrize('name', ['clip.mkv', 'clip.mcap', '{seq}.png'])
def test_account_of_an_interrupted_conversion(tmp_path: Path, name: str) -> None:
    # Two signals at another moment of each conversion: each frame that was taken is written.
    for moment in (0, 1, 3, 7):
        folder = tmp_path / str(moment)
        folder.mkdir()
        with subprocess.Popen(
                [sys.executable, '-m', 'opencv_tools.convert.cli', 'pattern:320x240',
                 folder / name, '--stop', '100', '--lossy'],
                stderr=subprocess.PIPE, text=True) as process:
            wait_until(lambda: process.poll() is not None
                       or [*folder.glob('manifest.jsonl')], 'the manifest')  # noqa: B023
            for _ in range(2):
                pause(0.01 * moment)
                process.send_signal(signal.SIGINT)
            lines = communicate(process)[1].splitlines()
        found = re.search(r'Converted ([0-9]+) frames at .*: ([0-9]+) written to .*, 0 failed$',
                          lines[-1])
        assert found and found[1] == found[2], lines
        is_interrupted = 'img_convert: error: interrupted' in lines
        # A signal after the account changes the status only.
        assert found[1] == '100' or (is_interrupted and process.returncode == 1), lines
        manifest = read_manifest(folder)
        assert sum(line.get('frames', 1) for line in manifest) == int(found[1]), lines


@pytest.mark.process
def test_interrupted_conversion_keeps_whole_files(tmp_path: Path) -> None:
    with subprocess.Popen(
            [sys.executable, '-m', 'opencv_tools.convert.cli', 'pattern:640x480',
             tmp_path / '{seq}.png', '--stop', '1000000'],
            stderr=subprocess.PIPE, text=True) as process:
        wait_until(lambda: len(list(tmp_path.glob('[0-9]*'))) >= 3, '3 files',
                   work=lambda: work_of(process.pid))
        process.send_signal(signal.SIGTERM)
        lines = communicate(process)[1].splitlines()
    assert process.returncode == 1
    assert lines[-2] == 'img_convert: error: interrupted'
    assert f': {len(read_manifest(tmp_path))} written to ' in lines[-1]


@pytest.mark.process
def test_help_imports_nothing_slow() -> None:
    script = ('import sys; from opencv_tools.convert.cli import main\n'
              'try: main(["--help"])\n'
              'except SystemExit: pass\n'
              'print(sorted({"numpy", "cv2", "rclpy", "mcap", "av", "tqdm"} & {*sys.modules}))')
    finished = subprocess.run([sys.executable, '-c', script], capture_output=True, text=True,
                              timeout=LONGEST_SECONDS, check=True)
    assert finished.stdout.startswith('usage: img_convert ')
    assert finished.stdout.splitlines()[-1] == '[]'
