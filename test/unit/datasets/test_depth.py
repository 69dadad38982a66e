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

"""Depth in data sets: codes of LeRobot, PNG in millimetres, account, and the check in metres."""

from __future__ import annotations

from collections.abc import Callable
import json
from pathlib import Path
import re
import tarfile
from typing import Any

import av
import cv2
from dataset_bags import BEGAN, Drive, NANO, with_definitions
from dataset_sets import CAMERA, convert, info_of, rows_of
import numpy as np
from opencv_tools.bags.schemas import COMPRESSED_IMAGE
from opencv_tools.convert.cli import main
from opencv_tools.datasets.depth import depth_points, DepthCodes, millimetres
from opencv_tools.datasets.errors import DatasetError
from opencv_tools.datasets.merge import FILES
from opencv_tools.image.cdr import (
    compressed_image_to_cdr, image_to_cdr, WireCompressedImage, WireHeader)
from opencv_tools.image.encodings import find_encoding
from opencv_tools.image.layout import array_to_wire
from opencv_tools.image_codecs import encode_depth
from played_bags import Entry, write_mcap
import pyarrow.parquet as pq
import pytest

TOPIC = '/camera/depth/image_rect_raw'
KEY = 'observation.images.wrist_depth'
DEPTH = ('--depth', f'wrist={TOPIC}')
VIDEO = f'videos/{KEY}/chunk-000/file-000.mp4'
Output = pytest.CaptureFixture[str]
Image = np.ndarray[Any, Any]


def picture(number: int, height: int = 48, width: int = 64) -> Image:
    """Return depths from 400 to 3700 mm that differ in each picture; a corner has none."""
    rows, columns = np.mgrid[:height, :width]
    image = 400 + 11 * rows * 48 // height + 40 * columns * 64 // width + 7 * (number % 40)
    image[:3, :4] = 0
    return image.astype(np.uint16)


def entry(number: int, image: Image, encoding: str = '16UC1', codec: str = '') -> Entry:
    """Return an image of depth at 30 Hz, 2 ms after that of the camera with colours."""
    time_ns = BEGAN + number * NANO // 30 + 2_000_000
    header = WireHeader(time_ns // NANO, time_ns % NANO, 'depth')
    if not codec:
        wire = array_to_wire(image, find_encoding(encoding), header)
        return Entry(time_ns + 5_000_000, image_to_cdr(wire), TOPIC)
    data, text = encode_depth(image, encoding, codec)
    return Entry(time_ns + 5_000_000, compressed_image_to_cdr(WireCompressedImage(
        header=header, format=text, data=data)), TOPIC, COMPRESSED_IMAGE)


def made(folder: Path, images: list[Image], *words: object, form: str = 'lerobot',
         encoding: str = '16UC1', codec: str = '') -> Path:
    """Make a set of one bag with depth alone."""
    (folder / 'bags').mkdir()
    write_mcap(folder / 'bags/a.mcap', with_definitions(
        [entry(number, image, encoding, codec) for number, image in enumerate(images)]))
    assert convert(folder / 'bags', folder / 'set', *DEPTH, *words, form=form) == 0
    return folder / 'set'


def plane_of(frame: Any) -> Image:
    """Return a view of the codes of a frame, as PyAV 12 has no arrays of them."""
    plane = frame.planes[0]
    return np.frombuffer(plane, '<u2').reshape(
        -1, plane.line_size // 2)[:frame.height, :frame.width]


def codes_of(folder: Path, video: str = VIDEO) -> list[Image]:
    """Return the codes of the frames of a video as LeRobot decodes them."""
    with av.open(str(folder / video)) as container:
        assert container.streams.video[0].codec_context.pix_fmt == 'gray12le'
        return [plane_of(frame).copy() for frame in container.decode(video=0)]


def in_metres(codes: Image, feature: dict[str, Any]) -> Image:
    """Return what LeRobot's formula makes of codes, in numbers of 64 bits."""
    low, high, shift = (feature['info'][f'video.{name}']
                        for name in ('depth_min', 'depth_max', 'shift'))
    if not feature['info']['video.use_log']:
        return low + codes / 4095 * (high - low)
    return (low + shift) * ((high + shift) / (low + shift)) ** (codes / 4095) - shift


@pytest.mark.parametrize(('words', 'least', 'most', 'allowed'), [
    ((), 0.01, 10, 2.23e-3), (('--depth-range', '0:4', '--depth-scale', 'linear'), 0, 4, 0.98e-3),
    (('--depth-range', '0.3:65.535'), 0.3, 65.535, 26e-3)])
@pytest.mark.parametrize('size', [(48, 64), (33, 47), (240, 424)])
def test_metres_of_lerobot(tmp_path: Path, size: tuple[int, int], words: tuple[str, ...],
                           least: float, most: float, allowed: float) -> None:
    images = [picture(number, *size) for number in range(6)]
    folder = made(tmp_path, images, *words)
    feature = info_of(folder)['features'][KEY]
    assert feature['shape'] == [*size, 1] and feature['dtype'] == 'video'
    info = feature['info']
    assert (info['is_depth_map'], info['depth_unit']) == (True, 'm')
    assert (info['video.depth_min'], info['video.depth_max']) == (least, most)
    assert (info['video.codec'], info['video.pix_fmt'], info['video.channels']) == (
        'hevc', 'gray12le', 1)
    for codes, image in zip(codes_of(folder), images, strict=True):
        assert ((codes == 0) == (image == 0)).all()
        errors = np.abs(in_metres(codes, feature) - image / 1000)[image > 0]
        assert errors.max() <= allowed


@pytest.mark.parametrize('size', [(16, 16), (33, 32), (40, 16), (16, 63), (16, 64)])
def test_noise_of_narrow_pictures_has_no_losses(
        tmp_path: Path, capsys: Output, size: tuple[int, int]) -> None:
    random = np.random.default_rng(size)
    images = [np.where(random.random(size) < 0.5, 9000, random.integers(50, 9000, size)).astype(
        np.uint16) for _ in range(40)]
    folder = made(tmp_path, images)
    feature = info_of(folder)['features'][KEY]
    for codes, image in zip(codes_of(folder), images, strict=True):
        assert np.abs(in_metres(codes, feature) - image / 1000).max() < 2.3e-3
    assert main(['--check', str(folder)]) == 0, capsys.readouterr()


@pytest.mark.parametrize('size', [(1, 1), (15, 64), (64, 8)])
def test_depth_too_small_for_hevc(tmp_path: Path, capsys: Output, size: tuple[int, int]) -> None:
    write_mcap(tmp_path / 'a.mcap', with_definitions(
        [entry(number, np.full(size, 900, np.uint16)) for number in range(3)]))
    for words in ((), ('--dry-run',)):
        assert convert(tmp_path / 'a.mcap', tmp_path / 'set', *DEPTH, *words) == 1
        assert (f'depth of {size[1]}x{size[0]} is too small for HEVC, which needs 16 pixels a '
                'side: use --format parquet or webdataset') in capsys.readouterr().err
    assert convert(tmp_path / 'a.mcap', tmp_path / 'table', *DEPTH, '--dry-run',
                   form='parquet') == 0
    assert convert(tmp_path / 'a.mcap', tmp_path / 'table', *DEPTH, form='parquet') == 0


@pytest.mark.parametrize('changed', [7.02, 7.5, 20.0])
def test_check_of_another_range(tmp_path: Path, capsys: Output, changed: float) -> None:
    folder = made(tmp_path, [picture(number) for number in range(4)], '--depth-range', '0:7')
    path = folder / 'meta/info.json'
    assert main(['--check', str(folder)]) == 0
    info = json.loads(path.read_text())
    info['features'][KEY]['info']['video.depth_max'] = changed
    path.write_text(json.dumps(info))
    capsys.readouterr()
    assert main(['--check', str(folder)]) == 1
    assert re.search(r'differ from (those|the pictures) of the bag', capsys.readouterr().err)


@pytest.mark.parametrize(('encoding', 'codec', 'allowed'), [
    ('16UC1', '', 2.3e-3), ('mono16', '', 2.3e-3), ('32FC1', '', 2.3e-3), ('16UC1', 'png', 2.3e-3),
    ('16UC1', 'rvl', 2.3e-3), ('32FC1', 'png', 4e-3)])
def test_kinds_of_messages(tmp_path: Path, encoding: str, codec: str, allowed: float) -> None:
    images = [picture(number) for number in range(4)]
    stored = [image / np.float32(1000) if encoding == '32FC1' else image for image in images]
    folder = made(tmp_path, stored, encoding=encoding, codec=codec)
    for codes, image in zip(codes_of(folder), images, strict=True):
        errors = np.abs(in_metres(codes, info_of(folder)['features'][KEY]) - image / 1000)
        assert errors[image > 0].max() <= allowed and not codes[image == 0].any()


def test_big_endian_depth(tmp_path: Path) -> None:
    folder = made(tmp_path, [picture(number).astype('>u2') for number in range(2)])
    metres = in_metres(codes_of(folder)[1], info_of(folder)['features'][KEY])
    assert abs(metres - picture(1) / 1000)[picture(1) > 0].max() < 2.3e-3


SPECIAL = [0, -1, np.nan, -np.inf, 0.005, 0.01, 10, 10.5, np.inf, 1]


def test_account_of_special_depths(tmp_path: Path, capsys: Output) -> None:
    image = np.full((16, 20), 1.0, np.float32)
    image[3, :10] = SPECIAL
    folder = made(tmp_path, [image, image, image], encoding='32FC1')
    codes = codes_of(folder)[2][3, :10].tolist()
    assert codes[:4] == [0] * 4 and codes[4:6] == [1, 1] and codes[6:9] == [4095] * 3
    printed = capsys.readouterr().err
    assert '3 of 960 pixels are nearer than 0.01 m' in printed
    assert '6 of 960 pixels are farther than 10 m' in printed
    assert 'wrist_depth: 12 of 960 pixels have no depth, 3 are nearer and 6 farther' in printed
    described = json.loads((folder / 'meta/opencv_tools/bags.json').read_text())
    account = described[0]['depth']['wrist_depth']
    assert {name: account[name] for name in ('pixels', 'none', 'nearer', 'farther')} == {
        'pixels': 960, 'none': 12, 'nearer': 3, 'farther': 6}
    assert 1.1e-3 < account['largest_error'] < 1.2e-3  # 0.01 m is stored as the code 1


def test_repeated_depth_counts_once(tmp_path: Path, capsys: Output) -> None:
    made(tmp_path, [picture(0)] * 3, '--fps', 90)
    assert f'{3 * 12} of {3 * 48 * 64} pixels' in capsys.readouterr().err


def test_depth_beside_colours_by_stamp(tmp_path: Path) -> None:
    depths = [entry(number, picture(number)) for number in range(30) if number not in (7, 8)]
    Drive(seconds=1, others=depths).write(tmp_path / 'bags/a.mcap')
    assert convert(tmp_path / 'bags', tmp_path / 'set', *CAMERA, '--depth', f'front={TOPIC}',
                   '--state', '/joint_states.position') == 0
    info = info_of(tmp_path / 'set')['features']
    assert info['stamp_ns']['names'] == ['front', 'front_depth', '/joint_states.position']
    stamps = rows_of(tmp_path / 'set')['stamp_ns'][:, 1]
    numbers = [round((stamp - BEGAN - 2e6) * 30 / NANO) for stamp in stamps]
    assert 6 in numbers and 7 not in numbers and numbers.count(6) == 3
    key = 'observation.images.front_depth'
    frames = codes_of(tmp_path / 'set', f'videos/{key}/chunk-000/file-000.mp4')
    for number, codes in zip(numbers, frames, strict=True):
        metres = in_metres(codes, info[key])
        assert abs(metres - picture(number) / 1000)[picture(number) > 0].max() < 2.3e-3
    assert main(['--check', str(tmp_path / 'set')]) == 0


def read_pngs(folder: Path, form: str) -> list[Image]:
    """Return the images of depth in a set of single samples."""
    if form == 'parquet':
        table = pq.read_table(next(folder.glob('*.parquet'))).to_pydict()
        contents = table[KEY]
    else:
        with tarfile.open(next(folder.glob('*.tar'))) as archive:
            opened = [archive.extractfile(one) for one in archive if one.name.endswith(
                '.wrist_depth.png')]
            contents = [one.read() for one in opened if one]
    found: list[Any] = [cv2.imdecode(np.frombuffer(one, np.uint8), cv2.IMREAD_UNCHANGED)
                        for one in contents]
    return found


@pytest.mark.parametrize('form', ['webdataset', 'parquet'])
def test_png_in_millimetres(tmp_path: Path, form: str, capsys: Output) -> None:
    images = [picture(number) for number in range(3)]
    images[1][5, :4] = (1, 9999, 40_000, 65_535)
    pngs = read_pngs(made(tmp_path, images, form=form), form)
    assert [png.dtype for png in pngs] == [np.uint16] * 3
    assert all((png == image).all() for png, image in zip(pngs, images, strict=True))
    printed = capsys.readouterr().err
    assert 'largest error of the others is 0.00 mm' in printed and 'nearest depth' not in printed


def test_png_of_metres(tmp_path: Path, capsys: Output) -> None:
    image = np.full((8, 9), 1.2344, np.float32)
    image[0, :6] = (0, np.nan, 0.0002, 65.5, 70, np.inf)
    png = read_pngs(made(tmp_path, [image], form='parquet', encoding='32FC1'), 'parquet')[0]
    assert png[0, :6].tolist() == [0, 0, 1, 65_500, 65_535, 65_535] and (png[1:] == 1234).all()
    printed = capsys.readouterr().err
    assert '2 of 72 pixels are farther than 65.535 m' in printed
    assert '1 of 72 pixels are nearer than 0.001 m, and become the nearest depth' in printed
    assert '1 are nearer and 2 farther' in printed
    assert 'largest error of the others is 0.40 mm' in printed


@pytest.mark.parametrize(('metres', 'text'), [
    (0, '0.00 mm'), (2.2236e-3, '2.22 mm'), (2.2e-6, '0.0022 mm'), (1.2, '1200.00 mm'),
    (1e-9, '1e-06 mm'), (9.99e-5, '0.1 mm'), (1e-4, '0.10 mm')])
def test_text_of_a_small_error(metres: float, text: str) -> None:
    assert millimetres(metres) == text


def check(folder: Path, capsys: Output) -> tuple[int, str]:
    capsys.readouterr()
    status = main(['--check', str(folder)])
    return status, capsys.readouterr().err


@pytest.mark.parametrize(('words', 'allowed'), [
    ((), '2.22'), (('--depth-scale', 'linear'), '2.44'), (('--depth-range', '0.2:4'), '0.65')])
def test_check_in_metres(tmp_path: Path, capsys: Output, words: tuple[str, ...], allowed: str,
                         ) -> None:
    folder = made(tmp_path, [picture(number) for number in range(20)], *words)
    status, printed = check(folder, capsys)
    found = re.search(r'wrist_depth: depth of 0\.(\d+) to 3\.(\d+) m, 240 of 61440 pixels without;'
                      r' the largest error of quantisation is (\S+) mm at 64 points of each row, '
                      r'and the steps allow (\S+) mm', printed)
    assert status == 0 and found, printed
    assert found[4] == allowed and 0.3 < float(found[3]) <= float(allowed)
    assert abs(int(found[1]) - 433) <= 2 and abs(float(f'0.{found[2]}') - 0.57) < 0.003


def rewrite(folder: Path, change: Callable[[list[Image]], list[Image]], pixels: str = 'gray12le',
            crf: int | None = None) -> None:
    """Write the frames of the video again, changed."""
    frames = change(codes_of(folder))
    options = {'x265-params': 'log-level=error' + (':lossless=1' if crf is None else '')}
    with av.open(str(folder / VIDEO), 'w') as container:
        stream = container.add_stream('libx265', rate=30, options={
            **options, **({} if crf is None else {'crf': str(crf)})})
        stream.height, stream.width = frames[0].shape
        stream.pix_fmt = pixels
        for codes in frames:
            frame = av.VideoFrame(*reversed(codes.shape), 'gray12le')
            plane_of(frame)[:] = codes
            container.mux(stream.encode(frame.reformat(format=pixels)))
        container.mux(stream.encode(None))


@pytest.mark.parametrize(('change', 'sentence'), [
    (lambda frames: [*frames[1:], frames[-1]], 'frames show the picture of the row after'),
    (lambda frames: [frames[0], *frames[:-1]], 'frames show the picture of the row before'),
    (lambda frames: [*frames[:5], frames[5] // 2, *frames[6:]], '1 frames differ .* first is 5'),
    (lambda frames: frames[:-1], 'it has 19 frames, but its episodes have 20 rows')])
def test_check_of_other_frames(tmp_path: Path, capsys: Output, sentence: str,
                               change: Callable[[list[Image]], list[Image]]) -> None:
    folder = made(tmp_path, [picture(number) for number in range(20)])
    (folder / 'meta/opencv_tools/files.json').unlink()  # the video gets another checksum
    rewrite(folder, list)
    assert check(folder, capsys)[0] == 0
    rewrite(folder, change)
    status, printed = check(folder, capsys)
    assert status == 1 and re.search(sentence, printed), printed


def test_check_of_lossy_depth(tmp_path: Path, capsys: Output) -> None:
    folder = made(tmp_path, [picture(number) for number in range(20)])
    rewrite(folder, list, crf=40)
    status, printed = check(folder, capsys)
    assert status == 1 and 'frames differ from the pictures of the bag' in printed


@pytest.mark.parametrize('pixels', ['gray12le', 'yuv420p12le'])
def test_check_of_unknown_origin(tmp_path: Path, capsys: Output, pixels: str) -> None:
    folder = made(tmp_path, [picture(number) for number in range(4)])
    rewrite(folder, list, pixels)
    for path in (folder / 'meta/opencv_tools').iterdir():
        path.unlink()
    info = info_of(folder)
    for name in ('video.depth_min', 'video.depth_max', 'video.shift', 'video.use_log'):
        del info['features'][KEY]['info'][name]  # LeRobot takes its defaults
    info['features'][KEY]['info']['video.pix_fmt'] = pixels
    (folder / 'meta/info.json').write_text(json.dumps(info))
    status, printed = check(folder, capsys)
    assert status == 0 and 'pixels without; its steps allow errors of 2.22 mm' in printed


@pytest.mark.parametrize('changed', [
    {'video.depth_min': 10}, {'video.depth_min': 'x'}, {'video.depth_max': float('nan')},
    {'video.depth_max': 1e300}, {'video.shift': -5}, {'video.shift': None},
    {'video.use_log': 'yes'}, {'video.depth_min': 9.999999999999998}, {'video.depth_min': True},
    {'video.depth_max': [1]}])
def test_hostile_settings(tmp_path: Path, capsys: Output, changed: dict[str, Any]) -> None:
    folder = made(tmp_path, [picture(0)])
    info = info_of(folder)
    info['features'][KEY]['info'].update(changed)
    (folder / 'meta/info.json').write_text(json.dumps(info))
    status, printed = check(folder, capsys)
    assert status == 1 and 'which give no range' in printed
    with pytest.raises(DatasetError, match='no range'):
        DepthCodes.of_feature(info['features'][KEY])


@pytest.mark.parametrize(('changed', 'sentence'), [
    ({'depth_unit': 'cm'}, 'it has depth_unit cm, not m or mm'),
    ({'depth_unit': ['m']}, r"it has depth_unit \['m'\], not m or mm"),
    ({'depth_unit': 'mm'}, 'it has depth_unit mm, but statistics in m'),
    ({'video.pix_fmt': 'gray'}, r'meta/info\.json has video\.pix_fmt gray, but it is gray12le'),
    ({'video.codec': 'h264'}, r'meta/info\.json has video\.codec h264, but it is hevc'),
    ({'video.codec': 7}, r'meta/info\.json has video\.codec 7, but it is hevc'),
    ({'video.channels': 3}, r'it has video\.channels 3, but the shape \[48, 64, 1\]'),
    ({'video.width': '64'}, r'it has video\.width 64, but the shape \[48, 64, 1\]'),
    ({'is_depth_map': 'yes'}, r"it has is_depth_map \['yes', None\], not true or false"),
    ({'is_depth_map': 'no'}, r"it has is_depth_map \['no', None\], not true or false"),
    ({'is_depth_map': 1}, r'it has is_depth_map \[1, None\], not true or false'),
    ({'is_depth_map': False}, 'it has 1 channels, but is_depth_map false'),
    ({'is_depth_map': None}, 'it has 1 channels, but is_depth_map false')])
def test_check_of_wrong_facts(
        tmp_path: Path, capsys: Output, changed: dict[str, Any], sentence: str) -> None:
    folder = made(tmp_path, [picture(0)])
    info = info_of(folder)
    info['features'][KEY]['info'].update(changed)
    (folder / 'meta/info.json').write_text(json.dumps(info))
    (folder / FILES).unlink()  # checksums, which would find any change
    status, printed = check(folder, capsys)
    assert status == 1 and 'set has 1 errors' in printed, printed
    assert re.search(rf'{KEY}(: |/\S+: ){sentence}', printed), printed


@pytest.mark.parametrize('shape', [[48, 64, 3], [48, 64, 2], [64, 48, 1]])
def test_check_of_another_shape(tmp_path: Path, capsys: Output, shape: list[int]) -> None:
    folder = made(tmp_path, [picture(0)])
    info = info_of(folder)
    info['features'][KEY]['shape'] = shape
    (folder / 'meta/info.json').write_text(json.dumps(info))
    status, printed = check(folder, capsys)
    assert status == 1 and f'but the shape {shape}' in printed and 'bags' not in printed


@pytest.mark.parametrize('name', ['hevc', 'libx265'])
def test_check_knows_codecs_by_their_encoders(tmp_path: Path, capsys: Output, name: str) -> None:
    folder = made(tmp_path, [picture(0)])
    info = info_of(folder)
    info['features'][KEY]['info']['video.codec'] = name
    (folder / 'meta/info.json').write_text(json.dumps(info))
    (folder / FILES).unlink()
    assert check(folder, capsys)[0] == 0


@pytest.mark.parametrize('info', [None, [], 'x', {}, {'is_depth_map': False}])
def test_feature_without_depth(info: Any) -> None:
    assert DepthCodes.of_feature({'dtype': 'video', 'info': info}) is None


def test_statistics_in_metres(tmp_path: Path) -> None:
    images = [picture(number) for number in range(5)]
    folder = made(tmp_path, images)
    found = json.loads((folder / 'meta/stats.json').read_text())[KEY]
    metres = np.maximum(np.array(images) / 1000, 0.01)  # no depth is read back as the least one
    assert found['min'] == [[[pytest.approx(0.01)]]] and found['count'] == [5]
    for name, value in (('max', metres.max()), ('mean', metres.mean()), ('std', metres.std()),
                        ('q50', np.median(metres))):
        assert found[name] == [[[pytest.approx(value, abs=3e-3)]]]


@pytest.mark.parametrize(('words', 'sentence'), [
    (('--depth', 'wrist'), 'does not name a camera'),
    (('--depth', f'w={TOPIC}', '--depth', f'w={TOPIC}'), 'given twice'),
    (('--depth', f'w={TOPIC}', '--image', f'w_depth={TOPIC}'), 'given twice'),
    ((*DEPTH, '--depth-range', '4'), 'is not LOW:HIGH'),
    ((*DEPTH, '--depth-range', '4:4'), 'is not LOW:HIGH'),
    ((*DEPTH, '--depth-range', '0:nan'), 'is not LOW:HIGH'),
    ((*DEPTH, '--depth-range=-1:4'), 'within 0:65.535'),
    ((*DEPTH, '--depth-range', '-1:10'), "'-1:10' is no range of 1 mm or more within 0:65.535"),
    ((*DEPTH, '--depth-range'), 'expected one argument'),
    (('--image', f'w={TOPIC}', '--depth-range', '0:4'), 'have an effect with --depth only: give '),
    (('--image', f'w={TOPIC}', '--depth-scale', 'linear'), 'with --depth only: give --depth NAME'),
    ((*DEPTH, '--depth-range', '0:66'), 'within 0:65.535'),
    ((*DEPTH, '--depth-range', '1:1.0000000000000003'), 'no range of 1 mm or more'),
    ((*DEPTH, '--depth-scale', 'cubic'), 'invalid choice'),
    ((*DEPTH, '--format', 'parquet', '--depth-range', '0:1'), 'PNG have millimetres')])
def test_invalid_options(tmp_path: Path, capsys: Output, words: tuple[str, ...], sentence: str,
                         ) -> None:
    write_mcap(tmp_path / 'a.mcap', [entry(0, picture(0))])
    try:
        status = convert(tmp_path / 'a.mcap', tmp_path / 'set', *words)
    except SystemExit as err:
        status = int(str(err.code))
    assert status == 2 and sentence in capsys.readouterr().err
    assert not (tmp_path / 'set').exists()


@pytest.mark.parametrize(('option', 'encoding', 'sentence'), [
    ('--depth', 'bgr8', 'image of bgr8 is no depth'),
    ('--depth', 'mono8', 'image of mono8 is no depth'),
    ('--image', '16UC1', 'use --depth'), ('--image', '32FC1', 'use --depth')])
def test_images_of_the_other_kind(tmp_path: Path, capsys: Output, option: str, encoding: str,
                                  sentence: str) -> None:
    kind = find_encoding(encoding)
    image = np.zeros((16, 16, 3)[:2 + (kind.channels > 1)], kind.dtype)
    write_mcap(tmp_path / 'a.mcap', with_definitions([entry(0, image, encoding)]))
    for form, *words in (('lerobot',), ('parquet',), ('lerobot', '--dry-run')):
        assert convert(tmp_path / 'a.mcap', tmp_path / 'set', option, f'wrist={TOPIC}', *words,
                       form=form) == 1
        assert sentence in capsys.readouterr().err


@pytest.mark.parametrize('form', ['lerobot', 'webdataset'])
def test_topic_that_changes_to_depth(tmp_path: Path, capsys: Output, form: str) -> None:
    colours = np.full((48, 64, 3), 90, np.uint8)
    write_mcap(tmp_path / 'a.mcap', with_definitions(
        [entry(number, colours, 'bgr8') for number in range(3)]
        + [entry(number, picture(number)) for number in range(3, 6)]))
    assert convert(tmp_path / 'a.mcap', tmp_path / 'set', '--image', f'wrist={TOPIC}',
                   form=form) == 1
    printed = capsys.readouterr().err
    assert printed.count('wrist: message 3 cannot be decoded: 16UC1 has more than 8 bits a pixel; '
                         'if it is depth, use --depth') == 1
    assert 'wrist: 3 pictures cannot be decoded, so rows repeat those before them' in printed


@pytest.mark.parametrize('encoding', ['16UC3', '16SC1', '64FC1', '8UC2', '32FC3'])
@pytest.mark.parametrize('option', ['--depth', '--image'])
def test_images_without_a_place(
        tmp_path: Path, capsys: Output, option: str, encoding: str) -> None:
    kind = find_encoding(encoding)
    image = np.zeros((16, 16, kind.channels)[:2 + (kind.channels > 1)], kind.dtype)
    write_mcap(tmp_path / 'a.mcap', with_definitions([entry(0, image, encoding)]))
    assert convert(tmp_path / 'a.mcap', tmp_path / 'set', option, f'wrist={TOPIC}') == 1
    printed = capsys.readouterr().err
    assert encoding in printed and 'use --image' not in printed
    assert ('--image takes colours and mono8, --depth takes 16UC1, mono16 and 32FC1; publish '
            'other images as one of these, or leave the topic out') in printed


@pytest.mark.parametrize('option', ['--depth', '--image'])
def test_unknown_encoding_has_a_remedy(tmp_path: Path, capsys: Output, option: str) -> None:
    message = entry(0, np.zeros((16, 16), np.uint8), 'mono8')
    message = message._replace(data=message.data.replace(b'mono8', b'mono9'))
    write_mcap(tmp_path / 'a.mcap', with_definitions([message]))
    assert convert(tmp_path / 'a.mcap', tmp_path / 'set', option, f'wrist={TOPIC}') == 1
    assert 'Unrecognized image encoding [mono9]; --image takes colours' in capsys.readouterr().err


def png_entry(number: int, image: Image, format_text: str) -> Entry:
    """Return a compressed image without the header of depth, a JPEG for 8 bits."""
    suffix = '.png' if image.dtype == np.uint16 else '.jpg'
    data = cv2.imencode(suffix, image)[1].tobytes()
    time_ns = BEGAN + number * NANO // 30
    header = WireHeader(time_ns // NANO, time_ns % NANO, 'depth')
    return Entry(time_ns, compressed_image_to_cdr(WireCompressedImage(
        header=header, format=format_text, data=data)), TOPIC, COMPRESSED_IMAGE)


@pytest.mark.parametrize('text', [
    '16UC1; png compressed ', 'mono16; png compressed mono16', 'png'])
def test_plain_png_of_16_bits(tmp_path: Path, text: str) -> None:
    write_mcap(tmp_path / 'a.mcap', with_definitions(
        [png_entry(number, picture(number), text) for number in range(3)]))
    assert convert(tmp_path / 'a.mcap', tmp_path / 'set', *DEPTH, form='webdataset') == 0
    assert (read_pngs(tmp_path / 'set', 'webdataset')[2] == picture(2)).all()


def test_jpeg_is_no_depth(tmp_path: Path, capsys: Output) -> None:
    write_mcap(tmp_path / 'a.mcap', with_definitions(
        [png_entry(0, np.zeros((16, 16, 3), np.uint8), 'jpeg')]))
    assert convert(tmp_path / 'a.mcap', tmp_path / 'set', *DEPTH) == 1
    assert 'wrist_depth: an image of bgr8 is no depth' in capsys.readouterr().err


def test_dry_run_names_depth(tmp_path: Path, capsys: Output) -> None:
    write_mcap(tmp_path / 'a.mcap', with_definitions([entry(0, picture(0))]))
    assert convert(tmp_path / 'a.mcap', tmp_path / 'set', *DEPTH, '--dry-run') == 0
    assert f'{TOPIC} (sensor_msgs/msg/Image, 1): {KEY}' in capsys.readouterr().out


def test_missing_encoder_of_depth(tmp_path: Path, capsys: Output,
                                  monkeypatch: pytest.MonkeyPatch) -> None:
    real = av.container.OutputContainer.add_stream

    class Container:

        def __init__(self, *words: Any, **options: Any) -> None:
            self.opened = real_open(*words, **options)

        def add_stream(self, codec: str, **options: Any) -> Any:
            return real(self.opened, 'libnone' if codec == 'libx265' else codec, **options)

        def close(self) -> None:
            self.opened.close()

    real_open = av.open
    monkeypatch.setattr(av, 'open', Container)
    write_mcap(tmp_path / 'a.mcap', with_definitions([entry(0, picture(0))]))
    assert convert(tmp_path / 'a.mcap', tmp_path / 'set', *DEPTH) == 1
    assert 'depth needs libx265' in capsys.readouterr().err


def test_depth_that_changes_its_size(tmp_path: Path, capsys: Output) -> None:
    write_mcap(tmp_path / 'a.mcap', with_definitions(
        [entry(0, picture(0)), entry(1, picture(1, 24, 32))]))
    assert convert(tmp_path / 'a.mcap', tmp_path / 'set', *DEPTH) == 1
    assert ('wrist_depth changes its size from (64, 48) to (32, 24); all pictures of a camera '
            'must have one size: make one set for each size, by the times in --episodes TABLE.csv'
            ) in capsys.readouterr().err


def test_damaged_compressed_depth_repeats_the_last(tmp_path: Path, capsys: Output) -> None:
    entries = [entry(number, picture(number), codec='png') for number in range(4)]
    entries[2] = entries[2]._replace(data=entries[2].data[:-40])
    write_mcap(tmp_path / 'a.mcap', with_definitions(entries))
    assert convert(tmp_path / 'a.mcap', tmp_path / 'set', *DEPTH) == 1
    codes = codes_of(tmp_path / 'set')
    assert (codes[2] == codes[1]).all() and (codes[3] != codes[1]).any()
    assert 'wrist_depth: 1 pictures cannot be decoded' in capsys.readouterr().err


@pytest.mark.parametrize('size', [(1, 1), (3, 200), (480, 640)])
def test_points_of_any_size(size: tuple[int, int]) -> None:
    image = np.arange(size[0] * size[1]).reshape(size)
    assert depth_points(image).shape == (64,)
    if size == (480, 640):
        assert depth_points(image)[[0, 63]].tolist() == [30 * 640 + 40, 450 * 640 + 600]


def test_codes_near_their_limits() -> None:
    codes = DepthCodes(0.5, 2.0)
    depth = np.array([0.4999, 0.5, 2.0, 2.1, 0, np.nan], np.float32)
    assert codes.codes(depth).tolist() == [1, 1, 4095, 4095, 0, 0]
    assert codes.metres[[0, 4095]].tolist() == [0.5, 2.0]
    assert codes.errors(depth, codes.codes(depth)).tolist()[3:] == [0, 0, 0]
    assert (np.diff(codes.metres) > 0).all()
    every = np.linspace(0.5, 2, 100_001).astype(np.float32)
    assert codes.errors(every, codes.codes(every)).max() <= codes.largest_error * 1.001


def test_depth_in_two_shards(tmp_path: Path, capsys: Output) -> None:
    (tmp_path / 'bags').mkdir()
    for name, first in (('a', 0), ('b', 20)):
        write_mcap(tmp_path / f'bags/{name}.mcap', with_definitions(
            [entry(number, picture(first + number)) for number in range(5)]))
    for shard in ('1', '2'):
        assert convert(tmp_path / 'bags', tmp_path / shard, *DEPTH, '--shard', f'{shard}/2') == 0
    capsys.readouterr()
    assert main(['--merge', str(tmp_path / '1'), str(tmp_path / '2'), str(tmp_path / 'set')]) == 0
    assert f'{10 * 12} of {10 * 48 * 64} pixels have no depth' in capsys.readouterr().err
    metres = in_metres(codes_of(tmp_path / 'set')[7], info_of(tmp_path / 'set')['features'][KEY])
    assert abs(metres - picture(22) / 1000)[picture(22) > 0].max() < 2.3e-3
    assert main(['--check', str(tmp_path / 'set')]) == 0
