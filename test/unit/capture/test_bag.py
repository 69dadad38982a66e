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

"""Bags as a source: pixels, times, calibrations, and the choice of a topic."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import closing
from dataclasses import replace
from pathlib import Path
import sqlite3
import sys
from typing import Any

import cv2
from hypothesis import given, settings, strategies
from images import random_image
import numpy as np
from opencv_tools.bags.reading import MAX_BYTES
from opencv_tools.bags.schemas import CAMERA_INFO, IMAGE
from opencv_tools.bags.writing import BagChannel, BagWriter
from opencv_tools.capture.bag import BagSource
from opencv_tools.capture.errors import BrokenFrameError, CaptureError
from opencv_tools.capture.frame import CapturedFrame, JPEG
from opencv_tools.capture.output_image import OutputImage
from opencv_tools.capture.settings import CaptureSettings
from opencv_tools.capture.source import expected_size, names_bag, open_source
from opencv_tools.image.cdr import image_to_cdr, WireHeader, WireImage
from opencv_tools.image.encodings import ENCODINGS
from opencv_tools.image.errors import ImageError
from playback import frames_of, play
from played_bags import (
    BEGAN_NS, compressed_entry, Entry, image_entry, NANO, TOPIC, write_mcap, write_rosbag2)
import pytest
from stepped_clock import BEGAN, SteppedClock
import zstandard

JPEG_BYTES = cv2.imencode('.jpg', np.zeros((8, 16, 3), np.uint8))[1].tobytes()
NAMES = (*ENCODINGS, '8UC2', '16SC1', '32FC1', '32SC4', '64FC3')


def numbers(source: BagSource) -> list[int]:
    return [int(frame.image.flat[0]) for frame in frames_of(source)]


def info_entry(number: int, delay_ns: int = 0, topic: str = '/camera/camera_info') -> Entry:
    """Return a calibration with the stamp of a numbered image; only its stamp is valid."""
    image = image_entry(number)
    return Entry(image.log_ns + delay_ns, image.data[:12] + b'info %d' % number, topic,
                 CAMERA_INFO)


@pytest.mark.parametrize('encoding', NAMES)
@pytest.mark.parametrize('order', ['<', '>'])
def test_every_encoding_keeps_its_pixels(tmp_path: Path, encoding: str, order: str) -> None:
    image = random_image(encoding, 4, 6)
    stored = image.astype(image.dtype.newbyteorder(order))
    path = write_mcap(tmp_path / 'a.mcap', [image_entry(1, stored, encoding)])
    frame = open_source(str(path)).read()
    assert frame is not None and frame.encoding == encoding
    np.testing.assert_array_equal(frame.image, image)
    assert not frame.image.flags.writeable
    assert OutputImage(frame, CaptureSettings()).description == f'6x4 {encoding}'


def test_rows_with_padding(tmp_path: Path) -> None:
    rows = np.arange(4 * 12, dtype=np.uint8).reshape(4, 12)
    wire = WireImage(header=WireHeader(1, 2, ''), height=4, width=3, encoding='bgr8',
                     is_bigendian=False, step=12, data=rows.tobytes())
    path = write_mcap(tmp_path / 'a.mcap', [Entry(1, image_to_cdr(wire))])
    frame = BagSource(path).read()
    assert frame is not None
    np.testing.assert_array_equal(frame.image, rows[:, :9].reshape(4, 3, 3))


@pytest.mark.parametrize('encoding', ['mono16', '16UC1'])
def test_big_endian_pixels_are_converted(tmp_path: Path, encoding: str) -> None:
    image = random_image('mono16', 4, 6)
    path = write_mcap(tmp_path / 'a.mcap', [image_entry(1, image.astype('>u2'), 'mono16')])
    frame = BagSource(path).read()
    native = CapturedFrame(image, 'mono16')
    for output in (CaptureSettings(encoding='mono8'), CaptureSettings(encoding='bgr8', rotate=90)):
        np.testing.assert_array_equal(
            OutputImage(frame, output).image, OutputImage(native, output).image)
        np.testing.assert_array_equal(
            OutputImage(frame, output).compressed[0], OutputImage(native, output).compressed[0])


def test_metadata_of_a_frame(tmp_path: Path) -> None:
    source = BagSource(write_mcap(tmp_path / 'a.mcap', map(image_entry, range(1, 4))))
    assert (source.count, source.rate, source.warnings) == (3, 25.0, [])
    assert source.description == (
        f'3 frames of {TOPIC} (sensor_msgs/msg/Image) at 25 Hz')
    for number, frame in enumerate(frames_of(source)):
        recorded = frame.recorded
        assert recorded is not None
        assert recorded.message.header.frame_id == f'optical_{number + 1}'
        assert recorded.topic == TOPIC
        assert recorded.header_ns == recorded.time_ns == BEGAN_NS + (number + 1) * 40_000_000
        assert recorded.log_ns == recorded.header_ns + 7_000_000
        assert frame.position == pytest.approx(number * 0.04)
        unstamped = replace(recorded, message=replace(
            recorded.message, header=WireHeader(0, 0, '')))
        assert unstamped.time_ns == recorded.log_ns


@pytest.mark.parametrize(('data', 'format_text'), [
    (JPEG_BYTES, 'jpeg'), (JPEG_BYTES, 'rgb8; jpeg compressed bgr8'),
    (cv2.imencode('.png', np.zeros((8, 16), np.uint16))[1].tobytes(), '16UC1; png compressed '),
    (b'', 'jpeg'), (b'codec of the future', 'av2')])
def test_compressed_image_is_passed_on_byte_for_byte(
        tmp_path: Path, monkeypatch: pytest.MonkeyPatch, data: bytes, format_text: str) -> None:
    for name in ('decode_image', 'encode_compressed', 'convert_image'):
        monkeypatch.setattr(f'opencv_tools.capture.output_image.{name}', pytest.fail)
    path = write_mcap(tmp_path / 'a.mcap', [compressed_entry(1, data, format_text)])
    frame = BagSource(path).read()
    assert frame is not None and frame.encoding == JPEG
    for encoding in ('', 'bgr8'):
        passed, passed_format = OutputImage(frame, CaptureSettings(encoding=encoding)).compressed
        assert (passed.tobytes(), passed_format) == (data, format_text)
    expected = '16x8' if len(data) > 50 else f'{len(data)} bytes'
    assert OutputImage(frame, CaptureSettings()).description == f'{expected} {format_text}'


def test_compressed_image_is_decoded_with_the_encoding_of_its_format(tmp_path: Path) -> None:
    image = random_image('rgb16', 8, 16)
    data = cv2.imencode('.png', image)[1].tobytes()
    path = write_mcap(tmp_path / 'a.mcap', [compressed_entry(1, data, 'rgb16; png compressed ')])
    output = OutputImage(BagSource(path).read(), CaptureSettings())
    assert output.encoding == 'rgb16'
    np.testing.assert_array_equal(output.image, image)
    assert (output.is_decoded, output.description) == (True, '16x8 rgb16')


@pytest.mark.parametrize('suffix', ['.mcap', '.db3'])
def test_folder_of_rosbags(tmp_path: Path, suffix: str) -> None:
    folder = write_rosbag2(tmp_path / 'bag', suffix, map(image_entry, range(5)))
    source = open_source(str(folder))
    assert isinstance(source, BagSource)
    assert numbers(source) == [0, 1, 2, 3, 4]
    assert source.description == open_source(str(folder / f'bag{suffix}')).description


def test_files_of_a_folder_in_the_order_of_its_metadata(tmp_path: Path) -> None:
    folder = write_rosbag2(tmp_path / 'bag', '.mcap', [image_entry(1)])
    write_mcap(folder / 'a.mcap', [image_entry(2)])
    metadata = folder / 'metadata.yaml'
    text = metadata.read_text()
    metadata.write_text(text.replace(
        'relative_file_paths:\n  - bag.mcap', 'relative_file_paths:\n  - bag.mcap\n  - a.mcap'))
    source = BagSource(folder)
    assert (numbers(source), source.warnings) == ([1, 2], [])
    metadata.write_text('')
    source = BagSource(folder)
    assert numbers(source) == [2, 1]
    assert len(source.warnings) == 1 and 'metadata.yaml is not used' in source.warnings[0]


def test_files_of_a_folder_follow_each_other_in_natural_order(tmp_path: Path) -> None:
    (tmp_path / 'metadata.yaml').touch()
    for number in (10, 9, 2):
        write_mcap(tmp_path / f'a_{number}.mcap', [image_entry(number), image_entry(number + 50)])
    for name in (tmp_path, tmp_path / '*.mcap'):
        source = open_source(str(name))
        assert isinstance(source, BagSource)
        assert (source.count, numbers(source)) == (6, [2, 52, 9, 59, 10, 60])
        source.rewind()
        assert numbers(source)[:3] == [2, 52, 9]
        source.close()


def test_skipped_images_are_not_loaded(
        tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    source = BagSource(write_mcap(tmp_path / 'a.mcap', map(image_entry, range(5))))
    loads: list[object] = []
    load = source._next_image

    def count() -> Any:
        message = load()
        return message and replace(
            message, load=lambda: loads.append(message) or message.load())

    monkeypatch.setattr(source, '_next_image', count)
    assert [source.skip(), source.skip()] == [True, True]
    frame = source.read()
    assert frame is not None and frame.image[0, 0] == 2 and len(loads) == 1
    assert [source.skip(), source.skip(), source.skip()] == [True, True, False]
    assert source.read() is None


@pytest.mark.parametrize(('rate', 'gaps'), [(0.0, [0.04, 0.16, 0.04]), (8.0, [0.125] * 3)])
def test_frames_are_due_at_the_times_of_the_recording(
        tmp_path: Path, rate: float, gaps: list[float]) -> None:
    path = write_mcap(tmp_path / 'a.mcap', map(image_entry, (0, 1, 5, 6)))
    clock = SteppedClock()
    player = play(BagSource(path), clock=clock, publish_rate=rate)
    shown = [(frame.stamp_ns / 1e9, clock.now) for frame in player.frames()]
    for times in zip(*shown, strict=True):
        assert times == pytest.approx(BEGAN + np.cumsum([0.0, *gaps]))


def test_part_of_a_bag_is_played_twice(tmp_path: Path) -> None:
    path = write_mcap(tmp_path / 'a.mcap', map(image_entry, range(6)))
    player = play(BagSource(path), start_frame=2, stop_frame=4, loop=2)
    frames = list(player.frames())
    assert [frame.image[0, 0] for frame in frames] == [2, 3, 2, 3]
    assert [frame.recorded.play for frame in frames if frame.recorded] == [0, 0, 1, 1]


@pytest.mark.parametrize(('delay_ns', 'expected'), [
    (-1000, [0, 1, 2]), (1000, [0, 1, 2]), (39_000_000, [0, 1, 2]),
    (50_000_000, [None, 0, 2])])
def test_calibration_with_the_stamp_of_an_image(
        tmp_path: Path, delay_ns: int, expected: list[int | None]) -> None:
    entries = [*map(image_entry, range(3)), *(
        info_entry(number, delay_ns) for number in range(3))]
    entries.sort(key=lambda entry: entry.log_ns)
    source = BagSource(write_mcap(tmp_path / 'a.mcap', entries))
    infos = [frame.recorded.camera_info for frame in frames_of(source) if frame.recorded]
    assert [info and int(bytes(info)[-1:]) for info in infos] == expected


def test_calibration_of_a_rectified_topic(tmp_path: Path) -> None:
    topic = '/camera/image_rect'
    own = info_entry(0, -1, f'{topic}/camera_info')
    entries = [info_entry(0, -2), own._replace(data=own.data[:-1] + b'7'),
               *(image_entry(number, topic=topic) for number in range(3))]
    source = BagSource(write_mcap(tmp_path / 'a.mcap', entries))
    recorded = [frame.recorded for frame in frames_of(source) if frame.recorded]
    assert source.info_topic == f'{topic}/camera_info'
    assert {found.info_topic for found in recorded} == {f'{topic}/camera_info'}
    assert [bytes(found.camera_info)[-6:] for found in recorded] == [b'info 7'] * 3


def test_last_calibration_holds_for_later_images(tmp_path: Path) -> None:
    entries = [info_entry(0, -1), *map(image_entry, range(3)),
               info_entry(0, 1, '/other/camera_info')]
    source = BagSource(write_mcap(tmp_path / 'a.mcap', entries))
    infos = [frame.recorded.camera_info for frame in frames_of(source) if frame.recorded]
    assert [bytes(info)[-6:] for info in infos] == [b'info 0'] * 3
    assert source.count == 3


TWO = [image_entry(1), image_entry(2, topic='/depth'), compressed_entry(3, JPEG_BYTES),
       Entry(5, b'', '/chat', 'std_msgs/msg/String')]


@pytest.mark.parametrize('suffix', ['.mcap', '.db3'])
def test_two_topics_and_none_chosen(tmp_path: Path, suffix: str) -> None:
    entries = TWO[:3]
    folder = write_rosbag2(tmp_path / 'bag', suffix, entries)
    with pytest.raises(CaptureError) as failure:
        open_source(str(folder))
    assert str(failure.value) == (
        f'{folder} has 3 topics of images; set bag_topic, or --topic of the command, to one of '
        '/camera/image_raw (sensor_msgs/msg/Image, 1 messages), '
        '/camera/image_raw/compressed (sensor_msgs/msg/CompressedImage, 1 messages), '
        '/depth (sensor_msgs/msg/Image, 1 messages)')
    source = open_source(str(folder), bag_topic='/depth')
    assert isinstance(source, BagSource) and numbers(source) == [2]


def test_topic_without_messages_is_no_candidate(tmp_path: Path) -> None:
    path = tmp_path / 'a.db3'
    write_rosbag2(tmp_path / 'bag', '.db3', [image_entry(1), image_entry(2, topic='/never')])
    (file,) = (tmp_path / 'bag').glob('*.db3')
    with closing(sqlite3.connect(file)) as connection, connection:
        connection.execute('DELETE FROM messages WHERE topic_id = ('
                           'SELECT id FROM topics WHERE name = ?)', ('/never',))
    file.rename(path)
    source = open_source(str(path))
    assert isinstance(source, BagSource)
    assert (source.topic.name, numbers(source)) == (TOPIC, [1])
    assert open_source(str(path), bag_topic='/never').count == 0


def test_many_topics_are_a_number(tmp_path: Path) -> None:
    path = write_mcap(tmp_path / 'a.mcap', [
        image_entry(1, topic=f'/camera_{number:04d}') for number in range(3000)])
    with pytest.raises(CaptureError) as failure:
        open_source(str(path))
    text = str(failure.value)
    assert 'has 3000 topics of images; ' in text and text.endswith(' and 2990 more')
    assert text.count('/camera_') == 10 and '/camera_0009' in text


@pytest.mark.parametrize(('entries', 'topic', 'encoding', 'reason'), [
    (TWO, '/chat', 'cdr', r'has no topic /chat of images; set .* to one of /camera/image_raw \('),
    (TWO, '/none\n', 'cdr', r'has no topic /none\\n of images'),
    (TWO[3:], '', 'cdr', r'no topic of images; its topics are /chat \(std_msgs/msg/String, 1 '),
    ([], '', 'cdr', 'has no topic of images; it has no topic$'),
    (TWO[:1], '', 'ros1', r'no topic of images; .*\(sensor_msgs/msg/Image in ros1, 1 messages\)'),
])
def test_topic_that_cannot_be_chosen(
        tmp_path: Path, entries: list[Entry], topic: str, encoding: str, reason: str) -> None:
    path = write_mcap(tmp_path / 'a.mcap', entries, encoding)
    with pytest.raises(CaptureError, match=reason):
        BagSource(path, topic)


def broken(change: Callable[[bytes], bytes]) -> Entry:
    entry = image_entry(1)
    return entry._replace(data=change(entry.data))


@pytest.mark.parametrize('change', [
    lambda data: b'', lambda data: data[:30], lambda data: data[:-1],
    lambda data: b'\0\7' + data[2:],  # another CDR version
    lambda data: b'\x28\xb5\x2f\xfd' + data[4:],
    lambda data: zstandard.compress(data)[:-4],
    lambda data: zstandard.compress(bytes(MAX_BYTES + 1)),
    lambda data: data.replace(b'mono8', b'mono9'),
    lambda data: data.replace(b'\4\0\0\0\6\0\0\0', b'\xff\xff\xff\xff' * 2)])
@pytest.mark.parametrize('suffix', ['.mcap', '.db3'])
def test_broken_message_is_reported_and_the_next_one_is_read(
        tmp_path: Path, suffix: str, change: Callable[[bytes], bytes]) -> None:
    folder = write_rosbag2(
        tmp_path / 'bag', suffix, [image_entry(0), broken(change), image_entry(2)])
    reasons: list[BrokenFrameError] = []
    player = play(BagSource(folder), reasons.append)
    assert [frame.image[0, 0] for frame in player.frames()] == [0, 2]
    assert len(reasons) == 1 and f'a message of {TOPIC} cannot be read: ' in str(reasons[0])


any_changes = given(
    changes=strategies.lists(strategies.tuples(
        strategies.integers(0, 200), strategies.binary(min_size=1, max_size=5)), max_size=4),
    is_raw=strategies.booleans(),
    length=strategies.integers(0, 300))


def check_hostile_messages_raise_nothing_else_than_their_errors(
        tmp_path_factory: pytest.TempPathFactory, changes: list[tuple[int, bytes]],
        is_raw: bool, length: int) -> None:
    entry = image_entry(1, random_image('bgr8', 4, 6), 'bgr8') if is_raw else compressed_entry(
        1, JPEG_BYTES)
    data = bytearray(entry.data)
    for position, changed in changes:
        data[position:position + len(changed)] = changed
    path = tmp_path_factory.getbasetemp() / 'hostile.mcap'
    write_mcap(path, [entry._replace(data=bytes(data[:length] if length < 200 else data))])
    source = BagSource(path)
    try:
        frame = source.read()
        assert frame is not None
        output = OutputImage(frame, CaptureSettings(rotate=90))
        _ = output.description, output.compressed
    except (BrokenFrameError, ImageError) as err:
        assert '\n' not in str(err)
    finally:
        source.close()


@pytest.mark.quick_cases(1)
@pytest.mark.parametrize('examples', [50, 200])
def test_hostile_messages_raise_nothing_else_than_their_errors(
        examples: int, tmp_path_factory: pytest.TempPathFactory) -> None:
    check = any_changes(check_hostile_messages_raise_nothing_else_than_their_errors)
    settings(max_examples=examples)(check)(tmp_path_factory=tmp_path_factory)


@pytest.mark.parametrize('suffix', ['.mcap', '.db3'])
def test_messages_that_rosbag2_has_compressed(tmp_path: Path, suffix: str) -> None:
    entries = [entry._replace(data=zstandard.compress(entry.data))
               for number in range(3) for entry in (image_entry(number), info_entry(number, 1))]
    source = BagSource(write_rosbag2(tmp_path / 'bag', suffix, entries))
    shown = [(frame.image[0, 0], bytes(frame.recorded.camera_info)[-1:])
             for frame in frames_of(source) if frame.recorded]
    assert shown == [(0, b'0'), (1, b'1'), (2, b'2')]


def test_missing_decompressor_of_messages(
        tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    entry = broken(zstandard.compress)
    source = BagSource(write_mcap(tmp_path / 'a.mcap', [entry], use_chunking=False))
    monkeypatch.setitem(sys.modules, 'zstandard', None)
    with pytest.raises(BrokenFrameError, match=r"install it with 'pip install mcap' .see Install"):
        source.read()


def test_damaged_chunk_is_reported_once(tmp_path: Path) -> None:
    path = write_mcap(tmp_path / 'a.mcap', map(image_entry, range(6)), chunk_size=100)
    content = bytearray(path.read_bytes())
    position = content.index(b'zstd', content.index(b'zstd') + 4) + 20  # of the second chunk
    content[position:position + 20] = bytes(20)
    path.write_bytes(content)
    reasons: list[BrokenFrameError] = []
    player = play(BagSource(path), reasons.append)
    shown = [frame.image[0, 0] for frame in player.frames()]
    assert shown == sorted({*shown}) and 0 in shown and 5 in shown and len(shown) < 6
    assert len(reasons) == 1
    source = BagSource(path)
    assert [source.skip() for _ in shown] == [True] * len(shown)
    with pytest.raises(BrokenFrameError, match='cannot be decompressed'):
        source.read()


def test_cut_bag_is_played_with_one_warning(tmp_path: Path) -> None:
    path = write_mcap(tmp_path / 'a.mcap', map(image_entry, range(6)), use_chunking=False)
    content = path.read_bytes()
    path.write_bytes(content[:content.index(bytes([4]) * 24) + 10])
    source = BagSource(path)
    assert len(source.warnings) == 1 and 'a.mcap has no end' in source.warnings[0]
    assert numbers(source) == [0, 1, 2, 3]
    source.rewind()
    assert numbers(source) == [0, 1, 2, 3] and len(source.warnings) == 1


def test_bag_that_is_being_recorded_is_played_up_to_now(tmp_path: Path) -> None:
    writer = BagWriter(tmp_path / 'a.mcap')
    shown = []
    for number in range(3):
        entry = image_entry(number)
        writer.write(BagChannel(topic=TOPIC, type_name=IMAGE), [entry.data], log_ns=entry.log_ns,
                     publish_ns=entry.log_ns)
        source = BagSource(tmp_path / 'a.mcap')
        assert len(source.warnings) == 1 and 'is still being written' in source.warnings[0]
        shown.append(numbers(source))
    writer.close()
    source = BagSource(tmp_path / 'a.mcap')
    assert not source.warnings
    assert [*shown, numbers(source)] == [[0], [0, 1], [0, 1, 2], [0, 1, 2]]


@pytest.mark.parametrize('suffix', ['.mcap', '.db3'])
def test_bag_that_is_removed_between_two_plays(tmp_path: Path, suffix: str) -> None:
    folder = write_rosbag2(tmp_path / 'bag', suffix, map(image_entry, range(3)))
    source = BagSource(folder)
    assert numbers(source) == [0, 1, 2]
    (folder / f'bag{suffix}').unlink()
    source.rewind()
    with pytest.raises(CaptureError, match='bag cannot be played: No such file or directory'):
        source.read()


def test_bag_without_images_has_no_readable_frame(tmp_path: Path) -> None:
    path = write_mcap(tmp_path / 'a.mcap', [broken(lambda data: b'')])
    with pytest.raises(CaptureError, match='has no readable frame'):
        list(play(BagSource(path), lambda err: None).frames())


@pytest.mark.parametrize(('name', 'reason'), [
    ('a.mcap', 'a.mcap cannot be opened: No such file or directory'),
    ('a.bag', 'is a bag of ROS 1'), ('b.mcap', 'b.mcap is not an MCAP file'),
    ('b.db3', 'b.db3 cannot be read as a bag: file is not a database')])
def test_file_that_cannot_be_played(tmp_path: Path, name: str, reason: str) -> None:
    for existing in ('a.bag', 'b.mcap', 'b.db3'):
        (tmp_path / existing).write_bytes(b'no bag, but more than the header of a bag')
    with pytest.raises(CaptureError, match=reason):
        open_source(str(tmp_path / name))


def test_missing_library_is_named_with_its_remedy(
        tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = write_mcap(tmp_path / 'a.mcap', [image_entry(1)])
    monkeypatch.setitem(sys.modules, 'mcap.records', None)
    with pytest.raises(CaptureError, match=r"install it with 'pip install mcap' .see Install"):
        open_source(str(path))


def test_size_of_the_frames(tmp_path: Path) -> None:
    raw = write_mcap(tmp_path / 'a.mcap', [image_entry(1), image_entry(1, topic='/b')])
    jpeg = write_mcap(tmp_path / 'b.mcap', [compressed_entry(1, JPEG_BYTES)])
    assert expected_size(str(raw), bag_topic='/b') == (6, 4)
    assert expected_size(str(jpeg)) == (16, 8)


@pytest.mark.parametrize(('text', 'expected'), [
    ('a.mcap', True), ('file:///a.db3', True), ('rtsp://host/a.mcap', False), ('pattern', False),
    ('0', False), ('', False)])
def test_text_that_names_a_bag(text: str, expected: bool) -> None:
    assert names_bag(text) == expected


def test_pattern_names_a_bag_by_the_files_that_it_matches(tmp_path: Path) -> None:
    for name in ('d_0.mcap', 'd_1.mcap.zstd', 'e_0.mcap', 'e_0.png'):
        (tmp_path / name).touch()
    assert names_bag(f'{tmp_path}/d_*')
    assert not names_bag(f'{tmp_path}/e_*')
    assert not names_bag(f'{tmp_path}/f_*')


def test_times_near_zero_and_the_end_of_time(tmp_path: Path) -> None:
    entries = [image_entry(number)._replace(log_ns=log_ns)
               for number, log_ns in enumerate((0, 5, 2**63 - 1))]
    source = BagSource(write_mcap(tmp_path / 'a.mcap', entries))
    assert [frame.position for frame in frames_of(source)] == [
        0.0, 5 / NANO, pytest.approx((2**63 - 1) / NANO)]
