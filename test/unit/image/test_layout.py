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
from opencv_tools.capture.output_image import OutputImage, OutputSettings
from opencv_tools.capture.source import open_source
from opencv_tools.convert.cli import main
from opencv_tools.cv_bridge import CvBridge
from opencv_tools.image.cdr import image_to_cdr, WireHeader
from opencv_tools.image.encodings import ENCODINGS, find_encoding
from opencv_tools.image.errors import LayoutError
from opencv_tools.image.layout import view_pixels
from opencv_tools.nodes.conversion import FrameConverter
from opencv_tools.viewer.encoding import encode_picture, PictureOptions
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


#: Encodings whose pixel is 1, 3, 4 and 6 bytes, and bytes at the end of each row.
ENDS = pytest.mark.parametrize(('encoding', 'padding'), [
    ('rgb8', 32), ('rgb8', 1), ('bgr8', 1000), ('mono8', 7), ('bgra8', 3), ('mono16', 5),
    ('rgb16', 32), ('bayer_rggb8', 1), ('yuv422', 13), ('nv12', 11), ('nv24', 2)])


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
            OutputImage(frame, OutputSettings()).image, image, strict=True)
    assert main([str(bag), str(tmp_path / 'b.mcap')]) == 0
    assert main([str(tmp_path / 'b.mcap'), str(tmp_path / '{frame_id}.npy')]) == 0
    for number, image in enumerate(images):
        np.testing.assert_array_equal(
            np.load(tmp_path / f'optical_{number}.npy'), image, strict=True)


@pytest.mark.parametrize('padding', [1, 32, 1001])
def test_pictures_of_a_data_set(padding: int, tmp_path: Path) -> None:
    drive = Drive(seconds=0.5, topics=())
    for number in range(15):
        time_ns = drive.picture_ns(number)
        drive.others.append(Entry(time_ns, image_to_cdr(padded_image(
            numbered_picture(number), 'bgr8', padding,
            header=WireHeader(*divmod(time_ns, NANO), 'cam'))), '/raw'))
    assert convert_to_set(drive.write(tmp_path / 'bag.mcap'), tmp_path / 'set', '--image',
                          'front=/raw', *JOINTS_STATE) == 0
    assert check_rows(tmp_path / 'set', drive.picture_ns) == [*range(15)]
