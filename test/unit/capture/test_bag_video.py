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

"""Video in bags as a source: pictures, times, skipped and missing packets."""

from __future__ import annotations

from pathlib import Path

from mcap.writer import CompressionType
from numbered_video import flat_packets, MS, NANO, number_of, video_message
from opencv_tools.bags.schemas import COMPRESSED_IMAGE
from opencv_tools.capture.bag import BagSource
from opencv_tools.capture.errors import BrokenFrameError
from opencv_tools.capture.source import expected_size, open_source
from opencv_tools.image.cdr import compressed_image_to_cdr, WireCompressedImage, WireHeader
from opencv_tools.video.messages import COMPRESSED_VIDEO, FFMPEG_PACKET
from opencv_tools.video.packet import VideoPacket
from playback import frames_of, play
from played_bags import BEGAN_NS, Entry, write_mcap, write_rosbag2
import pytest

TYPES = (FFMPEG_PACKET, COMPRESSED_VIDEO, COMPRESSED_IMAGE)
TOPIC = '/front/image/video'


def entry(packet: VideoPacket, number: int, type_name: str = FFMPEG_PACKET) -> Entry:
    """Return a message with video, recorded 7 ms after its stamp."""
    if type_name == COMPRESSED_IMAGE:
        data = compressed_image_to_cdr(WireCompressedImage(
            header=WireHeader(1, number * MS, 'eye'), format=packet.codec, data=packet.data))
    else:
        data = video_message(type_name, packet, number)
    return Entry(BEGAN_NS + number * 40 * MS, data, TOPIC, type_name)


def entries(packets: list[VideoPacket], type_name: str = FFMPEG_PACKET) -> list[Entry]:
    return [entry(packet, number, type_name) for number, packet in enumerate(packets)]


def read_numbers(source: BagSource) -> list[int | None]:
    """Return the number in each picture; None for one that cannot be read."""
    found: list[int | None] = []
    while True:
        try:
            frame = source.read()
        except BrokenFrameError:
            found.append(None)
        else:
            if frame is None:
                return found
            assert frame.encoding == 'bgr8'
            found.append(number_of(frame.image))


@pytest.mark.parametrize('codec', ['h264', 'h265'])
@pytest.mark.parametrize('type_name', TYPES)
def test_pictures_and_headers(tmp_path: Path, type_name: str, codec: str) -> None:
    path = write_mcap(tmp_path / 'a.mcap', entries(flat_packets(12, codec), type_name))
    source = open_source(str(path))
    assert isinstance(source, BagSource)
    assert source.description == f'12 frames of {TOPIC} ({type_name}) at 25 Hz'
    for number, frame in enumerate(frames_of(source)):
        assert number_of(frame.image) == number and frame.image.shape == (32, 48, 3)
        assert frame.position == pytest.approx(number * 0.04)
        assert frame.recorded is not None
        assert frame.recorded.header_ns == NANO + number * MS
        assert frame.recorded.message.header.frame_id == 'eye'
    assert number == 11
    assert expected_size(str(path)) == (48, 32)


@pytest.mark.parametrize('suffix', ['.mcap', '.db3'])
def test_folder_of_rosbag2(tmp_path: Path, suffix: str) -> None:
    sent = entries(flat_packets(12), COMPRESSED_IMAGE)
    assert read_numbers(BagSource(write_rosbag2(tmp_path / 'a', suffix, sent))) == [*range(12)]


@pytest.mark.parametrize('type_name', TYPES)
@pytest.mark.parametrize('first', [0, 1, 7, 8, 9, 19])
def test_pictures_after_skipped_ones(tmp_path: Path, first: int, type_name: str) -> None:
    packets = flat_packets(20, keys=(8,))
    source = BagSource(write_mcap(tmp_path / 'a.mcap', entries(packets, type_name)))
    for _ in range(2):
        for _ in range(first):
            assert source.skip()
        assert read_numbers(source) == [*range(first, 20)]
        source.rewind()


def test_only_packets_since_the_key_frame_are_decoded(
        tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    source = BagSource(write_mcap(tmp_path / 'a.mcap', entries(flat_packets(20, keys=(8, 16)))))
    decoded: list[int] = []
    decode = source.video._decode
    monkeypatch.setattr(source.video, '_decode', lambda video, number: (
        decoded.append(number), decode(video, number))[1])
    for _ in range(18):
        source.skip()
    assert source.read() is not None
    assert decoded == [16, 17, 18]


def test_many_skipped_packets(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr('opencv_tools.capture.bag_video._MAX_SKIPPED', 4)
    source = BagSource(write_mcap(tmp_path / 'a.mcap', entries(flat_packets(20))))
    for _ in range(17):
        assert source.skip()
        assert len(source.video._skipped) <= 4
    assert read_numbers(source) == [17, 18, 19]


@pytest.mark.parametrize('codec', ['h264', 'h265'])
def test_missing_packets_are_found_by_their_numbers(tmp_path: Path, codec: str) -> None:
    packets = flat_packets(12, codec, keys=(8,))
    sent = entries(packets)
    sent[3] = sent[3]._replace(topic='/elsewhere', type_name='a/msg/B')
    source = BagSource(write_mcap(tmp_path / 'a.mcap', sent))
    assert read_numbers(source) == [0, 1, 2, None, None, None, None, 8, 9, 10, 11]


def test_bag_that_begins_in_the_middle(tmp_path: Path) -> None:
    sent = entries(flat_packets(12, keys=(8,)))[5:]
    source = BagSource(write_mcap(tmp_path / 'a.mcap', sent))
    assert read_numbers(source) == [None, None, None, 8, 9, 10, 11]


def test_damaged_packet_costs_those_until_the_key_frame(tmp_path: Path) -> None:
    packets = flat_packets(12, keys=(8,))
    packets[4] = VideoPacket(**{**vars(packets[4]), 'data': b''})
    source = BagSource(write_mcap(tmp_path / 'a.mcap', entries(packets)))
    assert read_numbers(source) == [*range(4), None, None, None, None, *range(8, 12)]


def test_damaged_chunk_costs_those_until_the_key_frame(tmp_path: Path) -> None:
    path = write_mcap(tmp_path / 'a.mcap', entries(flat_packets(30, 'h265', keys=(24,))),
                      chunk_size=400, compression=CompressionType.ZSTD)
    content = bytearray(path.read_bytes())
    place = content.index(b'zstd', len(content) // 3)
    content[place + 20:place + 40] = bytes(20)
    path.write_bytes(content)
    found = read_numbers(BagSource(path))
    begin = found.index(None)
    end = found.index(24)
    assert found[:begin] == [*range(begin)]
    assert found[end:] == [*range(24, 30), None]  # the other frames of the chunk
    assert set(found[begin:end]) == {None}


def test_player_begins_at_any_frame(tmp_path: Path) -> None:
    path = write_mcap(tmp_path / 'a.mcap', entries(flat_packets(20, keys=(8,))))
    frames = play(BagSource(path), start_frame=13, stop_frame=16).frames()
    assert [number_of(frame.image) for frame in frames] == [13, 14, 15]
