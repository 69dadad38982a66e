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

"""Rows of any length that holds their pixels, from a view to files, pictures and data sets."""

from __future__ import annotations

from pathlib import Path

from conftest import recorded_files
import cv2
from dataset_bags import Drive, numbered_picture
from dataset_sets import check_rows, convert as convert_to_set, JOINTS_STATE
from hypothesis import given, strategies as st
from images import padded_image, random_image
import numpy as np
from opencv_tools.capture.bag import BagSource
from opencv_tools.capture.output_image import OutputImage
from opencv_tools.capture.settings import CaptureSettings
from opencv_tools.capture.source import open_source
from opencv_tools.convert.cli import main
from opencv_tools.cv_bridge import CvBridge
from opencv_tools.image.cdr import image_to_cdr, WireHeader
from opencv_tools.image.encodings import ENCODINGS, find_encoding
from opencv_tools.image.errors import LayoutError
from opencv_tools.image.layout import array_to_wire, view_image, view_pixels
from opencv_tools.nodes.conversion import FrameConverter
from opencv_tools.viewer.streams.encoding import encode_picture, PictureOptions
from playback import frames_of
from played_bags import Entry, header, NANO, write_mcap
import pytest
from recordings import open_videos

NAMES = (*ENCODINGS, '8UC2', '8SC4', '16SC3', '16UC4', '32SC2', '32FC1', '32FC3', '64FC1', '64FC4')
PADDINGS = st.one_of(st.integers(0, 40), st.sampled_from((97, 2431, 100_003)))
SIZE = 6, 8


@given(name=st.sampled_from(NAMES), padding=PADDINGS, is_bigendian=st.booleans())
def test_step_of_any_length(name: str, padding: int, is_bigendian: bool) -> None:
    image = random_image(name, *SIZE)
    wire = padded_image(image, name, padding, is_bigendian)
    view = view_pixels(wire.data, *SIZE, wire.step, find_encoding(name), is_bigendian)
    np.testing.assert_array_equal(view, image)
    is_copy = (padding > 0 and name == 'nv24') or bool(wire.step % image.dtype.itemsize)
    assert np.shares_memory(view, np.frombuffer(wire.data, np.uint8)) != is_copy
    assert cv2.flip(view, 0).shape[:2] == view.shape[:2] or is_bigendian  # OpenCV 4 needs aligned
    read = CvBridge().imgmsg_to_cv2(wire)
    np.testing.assert_array_equal(read, image)
    assert read.dtype == image.dtype


@pytest.mark.parametrize(('step', 'removed', 'text'), [
    (23, 0, ': a row needs 24 bytes, more than the step'),
    (0, 0, ': a row needs 24 bytes, more than the step'),
    (25, 1, ' needs 150 bytes, but data has 149'),
    (2**32 - 1, 0, ' needs 25769803770 bytes, but data has 150')])
def test_contradictions_of_size_step_and_data(step: int, removed: int, text: str) -> None:
    data = bytes(6 * 25 - removed)
    with pytest.raises(LayoutError) as caught:
        view_pixels(data, *SIZE, step, find_encoding('rgb8'))
    assert str(caught.value) == f'8x6 rgb8 image with step {step}{text}'


@pytest.mark.parametrize(('name', 'step', 'size', 'text'), [
    ('mono16', 8, 16, ''), ('mono16', 7, 16, ': a row needs 8 bytes, more than the step'),
    ('mono16', 8, 15, ' needs 16 bytes, but data has 15'), ('nv12', 4, 12, ''),
    ('nv12', 4, 11, ' needs 12 bytes, but data has 11'), ('nv24', 5, 30, ''),
    ('nv24', 5, 29, ' needs 30 bytes, but data has 29')])
def test_least_step_and_data(name: str, step: int, size: int, text: str) -> None:
    def view() -> np.ndarray:
        return view_pixels(bytes(size), 2, 4, step, find_encoding(name))

    if text:
        with pytest.raises(LayoutError) as caught:
            view()
        assert str(caught.value) == f'4x2 {name} image with step {step}{text}'
    else:
        assert view().shape == (find_encoding(name).rows(2), 4)


@pytest.mark.parametrize(('height', 'width'), [(3, 4), (4, 3)])
def test_odd_size_of_subsampled_chroma(height: int, width: int) -> None:
    data = bytes(100)
    with pytest.raises(LayoutError) as caught:
        view_pixels(data, height, width, 8, find_encoding('nv21'))
    assert str(caught.value) == (
        f'{width}x{height} nv21 image with step 8: width and height must be even, because the '
        'chroma is subsampled 2x2')
    assert view_pixels(data, height, width, 8, find_encoding('nv24')).shape == (3 * height, width)


def test_views_of_given_bytes() -> None:
    data = bytearray(range(1, 25))
    mono16, padded = find_encoding('mono16'), [[0x0201, 0x0403], [0x0807, 0x0a09]]
    tight = view_pixels(data, 2, 2, 4, mono16)
    np.testing.assert_array_equal(tight, [[0x0201, 0x0403], [0x0605, 0x0807]])
    view = view_pixels(data, 2, 2, 6, mono16)
    np.testing.assert_array_equal(view, padded)
    np.testing.assert_array_equal(view_pixels([*data], 2, 2, 6, mono16), padded)
    swapped = view_pixels(data, 2, 2, 6, mono16, is_bigendian=True)
    np.testing.assert_array_equal(swapped, [[0x0102, 0x0304], [0x0708, 0x090a]])
    copy = view_pixels(data, 2, 2, 5, mono16)
    np.testing.assert_array_equal(copy, [[0x0201, 0x0403], [0x0706, 0x0908]])
    color = view_pixels(data, 2, 2, 9, find_encoding('rgb8'))
    np.testing.assert_array_equal(color, [[[1, 2, 3], [4, 5, 6]], [[10, 11, 12], [13, 14, 15]]])
    data[0] = 0x55
    assert (tight[0, 0], view[0, 0], color[0, 0, 0]) == (0x0255, 0x0255, 0x55)
    assert swapped[0, 0] == 0x5502
    assert copy[0, 0] == 0x0201
    assert copy.flags.aligned and copy.flags.c_contiguous


def test_chroma_with_padding() -> None:
    nv12, nv24 = find_encoding('nv12'), find_encoding('nv24')
    data = bytearray(range(3 * 2 * 3))
    tight, copy = (view_pixels(data, 2, 2, step, nv24) for step in (2, 3))
    np.testing.assert_array_equal(
        view_pixels(data, 2, 2, 3, nv24), [[0, 1], [3, 4], [6, 7], [8, 9], [12, 13], [14, 15]])
    np.testing.assert_array_equal(view_pixels(data, 2, 2, 3, nv12), [[0, 1], [3, 4], [6, 7]])
    np.testing.assert_array_equal(view_pixels(data, 2, 2, 2, nv12), [[0, 1], [2, 3], [4, 5]])
    data[0] = 99
    assert (tight[0, 0], copy[0, 0]) == (99, 0)


@pytest.mark.parametrize(('name', 'size', 'shape'), [
    ('rgb8', (2, 0), (2, 0, 3)), ('mono16', (0, 5), (0, 5)), ('nv24', (1, 0), (3, 0)),
    ('mono8', (0, 0), (0, 0))])
def test_image_without_pixels(name: str, size: tuple[int, int], shape: tuple[int, ...]) -> None:
    for step in (size[1] * find_encoding(name).pixel_bytes, 12):
        assert view_pixels(bytes(36), *size, step, find_encoding(name)).shape == shape


@pytest.mark.parametrize(('data', 'text'), [
    ('text', "str: a bytes-like object is required, not 'str'"),
    ([1, 256], 'list: bytes must be in range(0, 256)')])
def test_data_that_are_no_bytes(data: object, text: str) -> None:
    with pytest.raises(LayoutError) as caught:
        view_pixels(data, 1, 2, 2, find_encoding('mono8'))
    assert str(caught.value) == f'data must be bytes, but its type is {text}'


@pytest.mark.parametrize('order', ['little', 'big'])
def test_native_order_of_memory(order: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr('sys.byteorder', order)
    image = view_image(bytes((1, 2, 3, 4, 5)), 1, 2, find_encoding('mono16'))
    expected = [0x0201, 0x0403] if order == 'little' else [0x0102, 0x0304]
    np.testing.assert_array_equal(image, [expected])
    for dtype, is_big in (('=u2', order == 'big'), ('>u2', True),
                          ('u1', False)):
        wire = array_to_wire(np.zeros((1, 1), dtype), find_encoding('mono16'))
        assert wire.is_bigendian == is_big


def test_message_of_an_array() -> None:
    image = np.arange(24, dtype=np.uint8).reshape(2, 4, 3)
    wire = array_to_wire(image, find_encoding('bgr8'), WireHeader(1, 2, 'camera'))
    assert (wire.header, wire.height, wire.width, wire.step, wire.encoding) == (
        WireHeader(1, 2, 'camera'), 2, 4, 12, 'bgr8')
    assert bytes(wire.data) == bytes(range(24))
    image[0, 0, 0] = 99
    assert wire.data[0] == 99
    assert bytes(array_to_wire(image[:, ::-2], find_encoding('bgr8')).data) == bytes((
        9, 10, 11, 3, 4, 5, 21, 22, 23, 15, 16, 17))
    wire = array_to_wire(np.zeros((6, 4), np.uint8), find_encoding('nv12'))
    assert (wire.height, wire.width, wire.step, wire.header.frame_id) == (4, 4, 4, '')
    wire = array_to_wire(np.array([[1, 2]], '>u2'), find_encoding('mono16'))
    assert (wire.step, bytes(wire.data)) == (4, b'\0\1\0\2')


#: Encodings whose pixel is 1, 2, 3 and 4 bytes, and bytes at the end of each row.
ENDS = pytest.mark.parametrize(('encoding', 'padding'), [
    ('rgb8', 1), ('bgra8', 3), ('mono16', 5), ('nv12', 11), ('nv24', 2)])


@ENDS
def test_files_of_a_recording(encoding: str, padding: int, tmp_path: Path) -> None:
    image = random_image(encoding, 48, 64)
    is_video = find_encoding(encoding).dtype == 'uint8' and encoding != 'bgra8'
    suffixes = ['.png', '.mp4'] if is_video else ['.png']
    found: list[list[np.ndarray]] = []
    for added in (0, padding):
        frame = FrameConverter(CvBridge()).convert(
            padded_image(image, encoding, added, header=WireHeader(7, 8, '')), '/a', 7 * NANO)
        for suffix in suffixes:
            sink = open_videos(tmp_path / f'{added}', f'a{suffix}')
            sink.commit(frame, sink.prepare(frame))
            sink.close()
        found.append([one.image for path in recorded_files(tmp_path / f'{added}')
                      for one in frames_of(open_source(str(path)))])
    assert len(found[0]) == len(suffixes)
    for tight, padded in zip(*found, strict=True):
        np.testing.assert_array_equal(padded, tight, strict=True)


@ENDS
def test_pictures_of_the_viewer(encoding: str, padding: int) -> None:
    image = random_image(encoding, 48, 64)
    tight, padded = (encode_picture(padded_image(image, encoding, added), PictureOptions(0, 95))
                     for added in (0, padding))
    assert padded.data == tight.data


@ENDS
def test_bags_are_played_and_converted(encoding: str, padding: int, tmp_path: Path) -> None:
    images = [random_image(encoding, 48, 64) for _ in range(3)]
    bag = write_mcap(tmp_path / 'a.mcap', [
        Entry(number, image_to_cdr(padded_image(image, encoding, padding, header=header(number))))
        for number, image in enumerate(images)])
    frames = list(frames_of(BagSource(bag)))
    assert len(frames) == 3
    for frame, image in zip(frames, images):
        np.testing.assert_array_equal(
            OutputImage(frame, CaptureSettings()).image, image, strict=True)
    assert main([str(bag), str(tmp_path / 'b.mcap')]) == 0
    assert main([str(tmp_path / 'b.mcap'), str(tmp_path / '{frame_id}.npy')]) == 0
    for number, image in enumerate(images):
        np.testing.assert_array_equal(
            np.load(tmp_path / f'optical_{number}.npy'), image, strict=True)


def test_pictures_of_a_data_set(tmp_path: Path) -> None:
    drive = Drive(seconds=0.5, topics=())
    for number in range(15):
        time_ns = drive.picture_ns(number)
        drive.others.append(Entry(time_ns, image_to_cdr(padded_image(
            numbered_picture(number), 'bgr8', 1001,
            header=WireHeader(*divmod(time_ns, NANO), 'cam'))), '/raw'))
    assert convert_to_set(drive.write(tmp_path / 'bag.mcap'), tmp_path / 'set', '--image',
                          'front=/raw', *JOINTS_STATE) == 0
    assert check_rows(tmp_path / 'set', drive.picture_ns) == [*range(15)]
