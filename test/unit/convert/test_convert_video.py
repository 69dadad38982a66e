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

"""Conversion of bags with video by img_convert: pictures, copied packets, and parts."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from bag_readers import decode, read_by_all, read_indexed
from conftest import recorded_files
import cv2
from numbered_video import (
    flat_packets, MS, number_of, numbers, read_packets, units, video_message)
from opencv_tools.bags.schemas import COMPRESSED_IMAGE
from opencv_tools.convert.cli import main
from opencv_tools.image.cdr import compressed_image_to_cdr, WireCompressedImage, WireHeader
from opencv_tools.video.messages import COMPRESSED_VIDEO, FFMPEG_PACKET
from opencv_tools.video.packet import VideoPacket
from played_bags import BEGAN_NS, Entry, write_mcap
import pytest

TOPIC = '/front/image/ffmpeg'
every_type = pytest.mark.parametrize(
    'type_name', [FFMPEG_PACKET, COMPRESSED_VIDEO, COMPRESSED_IMAGE])


def write_bag(path: Path, packets: list[VideoPacket], type_name: str = FFMPEG_PACKET) -> Path:
    """Write a bag whose packets are 40 ms apart."""
    def data(packet: VideoPacket, number: int) -> bytes:
        if type_name != COMPRESSED_IMAGE:
            return video_message(type_name, packet, number, 40 * MS)
        return compressed_image_to_cdr(WireCompressedImage(
            header=WireHeader(1, number * 40 * MS, 'eye'), format=packet.codec, data=packet.data))
    return write_mcap(path, [
        Entry(BEGAN_NS + number * 40 * MS, data(packet, number), TOPIC, type_name)
        for number, packet in enumerate(packets)])


@every_type
@pytest.mark.parametrize(('arguments', 'expected'), [
    ((), [*range(20)]), (('--start', '13', '--stop', '16'), [13, 14, 15]),
    (('--every', '3'), [*range(0, 20, 3)])])
def test_pictures_have_their_numbers(
        tmp_path: Path, type_name: str, arguments: tuple[str, ...], expected: list[int]) -> None:
    bag = write_bag(tmp_path / 'a.mcap', flat_packets(20, keys=(8,)), type_name)
    out = tmp_path / 'out'
    assert main([str(bag), str(out / '{seq:03d}.png'), *arguments]) == 0
    assert [number_of(cv2.imread(str(path))) for path in recorded_files(out)] == expected


@every_type
@pytest.mark.parametrize('suffix', ['.mkv', '.mp4'])
@pytest.mark.parametrize('codec', ['h264', 'h265'])
def test_video_is_a_copy(tmp_path: Path, type_name: str, suffix: str, codec: str) -> None:
    packets = flat_packets(20, codec, keys=(8,))
    bag = write_bag(tmp_path / 'a.mcap', packets, type_name)
    path = tmp_path / 'out' / f'a{suffix}'
    assert main([str(bag), str(path)]) == 0
    found = read_packets(path)
    assert [content for *_, content in found] == [units(codec, one.data) for one in packets]
    assert [time for time, *_ in found] == pytest.approx([0.04 * number for number in range(20)])


@pytest.mark.parametrize('suffix', ['.mkv', '.mp4', '.avi'])
@pytest.mark.parametrize('option', ['--start', '--every'])
def test_part_of_a_video_is_encoded(tmp_path: Path, suffix: str, option: str) -> None:
    bag = write_bag(tmp_path / 'a.mcap', flat_packets(20, keys=(8,)))
    path = tmp_path / 'out' / f'a{suffix}'
    assert main([str(bag), str(path), option, '5']) == 0
    assert numbers(path) == [*range(5, 20)] if option == '--start' else [0, 5, 10, 15]


@every_type
def test_bag_keeps_its_messages(tmp_path: Path, type_name: str) -> None:
    bag = write_bag(tmp_path / 'a.mcap', flat_packets(10), type_name)
    out = tmp_path / 'out' / 'b.mcap'
    assert main([str(bag), str(out)]) == 0
    assert read_by_all(out) == read_indexed(bag)


@every_type
def test_part_of_a_bag_has_images(tmp_path: Path, type_name: str) -> None:
    bag = write_bag(tmp_path / 'a.mcap', flat_packets(10), type_name)
    out = tmp_path / 'out' / 'b.mcap'
    assert main([str(bag), str(out), '--every', '4']) == 0
    assert {stored.topic for stored in read_by_all(out)} == {'/front/image'}
    assert [round(sum(one.data) / len(one.data) / 5) for one in decode(out)] == [0, 4, 8]


@every_type
@pytest.mark.parametrize('suffix', ['.mkv', '.mp4'])
def test_damaged_parameter_sets_cost_their_frames(
        tmp_path: Path, capsys: pytest.CaptureFixture[str], type_name: str, suffix: str) -> None:
    packets = flat_packets(20, keys=(8,))
    damaged = bytes(byte ^ 0x5a if 5 <= index < 14 else byte
                    for index, byte in enumerate(packets[8].data))
    packets[8] = replace(packets[8], data=damaged)
    path = tmp_path / 'out' / f'a{suffix}'
    assert main([str(write_bag(tmp_path / 'a.mcap', packets, type_name)), str(path)]) == 1
    assert ', 1 failed' in (text := capsys.readouterr().err)
    assert 'it is damaged' in text and 'file_name' not in text


@every_type
def test_damaged_picture_has_no_remedy(
        tmp_path: Path, capsys: pytest.CaptureFixture[str], type_name: str) -> None:
    packets = flat_packets(4, 'h265')
    packets[2] = replace(packets[2], data=packets[2].data[:-12] + b'\xff' * 12)
    bag = write_bag(tmp_path / 'a.mcap', packets, type_name)
    assert main([str(bag), str(tmp_path / 'out' / '{seq}.png')]) == 1
    text = capsys.readouterr().err
    assert 'of h265 cannot be decoded: Invalid data' in text and 'file_name' not in text


def test_packets_before_the_first_key_frame(
        tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    bag = write_bag(tmp_path / 'a.mcap', flat_packets(20, keys=(8,))[5:])
    assert main([str(bag), str(tmp_path / 'out' / 'a.mkv')]) == 1
    assert ' 12 written to ' in (text := capsys.readouterr().err)
    assert ', 0 failed, 3 left out before a key frame' in text
    assert main([str(bag), str(tmp_path / 'out' / '{seq}.png')]) == 1
    assert ' 12 written to ' in (text := capsys.readouterr().err)
    assert ', 3 failed' in text
