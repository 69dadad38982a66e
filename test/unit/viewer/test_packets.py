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

"""Packets of a video topic, from right to hostile."""

from __future__ import annotations

from dataclasses import replace

from opencv_tools.image.cdr import NO_HEADER, WireHeader
from opencv_tools.image.errors import CdrError
from opencv_tools.topics.queue import ReceivedMessage
from opencv_tools.video.messages import COMPRESSED_VIDEO, FFMPEG_PACKET, WireVideo
from opencv_tools.video.packet import VideoPacket
from opencv_tools.video.parameter_sets import parameter_sets
from opencv_tools.viewer.streams import packets as packets_module
from opencv_tools.viewer.streams.packets import PacketFeed
import pytest
from video_packets import every_codec, packets


def wire(packet: VideoPacket, **changed: object) -> WireVideo:
    """Return the message of a packet."""
    return replace(WireVideo(
        type_name=FFMPEG_PACKET, header=WireHeader(5, 500_000_000, ''), encoding=packet.codec,
        width=packet.width, height=packet.height, data=memoryview(packet.data), serialized=b''),
        **changed)


@pytest.fixture
def feed() -> PacketFeed:
    """Create a feed that has received nothing."""
    return PacketFeed(lambda: None)


def put(feed: PacketFeed, message: WireVideo, number: int = 0) -> None:
    feed.put(ReceivedMessage(message, 0, 0, number))


@every_codec
def test_packets_are_unchanged_and_in_sequence(codec: str, feed: PacketFeed) -> None:
    sent = packets(codec)
    for number, packet in enumerate(sent, 40):
        put(feed, wire(packet), number)
    viewed = [*feed.waiting]
    assert [one.packet for one in viewed] == [*sent]
    assert [one.number - viewed[0].number for one in viewed] == [*range(len(sent))]
    assert [bool(one.name) for one in viewed] == [True] + [False] * (len(sent) - 1)
    assert viewed[0].name.startswith({'h264': 'avc1.', 'h265': 'hev1.', 'av1': 'av01.'}[codec])
    assert viewed[0].stamp_ns == 5_500_000_000
    assert (feed.frames, feed.broken, feed.error) == (len(sent), 0, '')


def test_missing_packet_is_a_gap(feed: PacketFeed) -> None:
    first, second, _, fourth, *_ = packets('h264')
    for number, packet in ((1, first), (2, second), (4, fourth)):
        put(feed, wire(packet), number)
    numbers = [one.number for one in feed.waiting]
    assert numbers[1] == numbers[0] + 1
    assert numbers[2] > numbers[1] + 1


def test_packets_without_numbers_have_no_gap(feed: PacketFeed) -> None:
    for packet in packets('h264'):
        put(feed, wire(packet))
    numbers = [one.number for one in feed.waiting]
    assert numbers == [*range(numbers[0], numbers[0] + len(numbers))]


def test_size_of_a_message_without_one(feed: PacketFeed) -> None:
    put(feed, wire(packets('h264')[0], type_name=COMPRESSED_VIDEO, width=0, height=0))
    packet = feed.waiting[0].packet
    assert (packet.width, packet.height) == (160, 120)


@pytest.mark.parametrize(('announced', 'shown'), [
    ((159, 119), (159, 119)), ((158, 120), (160, 120)), ((60_000, 60_000), (160, 120))])
def test_announced_size(
        announced: tuple[int, int], shown: tuple[int, int], feed: PacketFeed) -> None:
    put(feed, wire(packets('h264')[0], width=announced[0], height=announced[1]))
    packet = feed.waiting[0].packet
    assert (packet.width, packet.height) == shown


def test_parameter_sets_that_are_sent_once(feed: PacketFeed) -> None:
    key = packets('h264')[0]
    bare = key.data[len(parameter_sets('h264', key.data)):]
    put(feed, wire(key, data=bare))
    assert feed.broken == 1
    put(feed, wire(key))
    put(feed, wire(key, data=bare))
    *_, viewed = feed.waiting
    assert viewed.packet.is_key
    assert viewed.packet.data == parameter_sets('h264', key.data) + bare


@pytest.mark.parametrize('changed', [
    {'data': b''}, {'encoding': 'vp9'}, {'encoding': '\x1b[2J' * 99},
    {'data': b'\0\0\1\x67' + b'\xff' * 20 + b'\0\0\1\x68\xff\0\0\1\x65\xff'},
    {'data': b'\0\0\1\1' * 20_000}, {'encoding': 'av1', 'data': b'\x0a\xff\xff'}])
def test_damaged_packets_are_counted(changed: dict[str, object], feed: PacketFeed) -> None:
    key, delta, *_ = packets('h264')
    put(feed, wire(key), 1)
    put(feed, wire(delta, **changed), 2)
    accepted = len(feed.waiting)
    put(feed, wire(delta), 3)
    assert feed.waiting[-1].number > feed.waiting[0].number + 1
    assert (feed.broken, accepted) in ((1, 1), (0, 2))


def test_large_packets_are_refused(feed: PacketFeed, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(packets_module, '_MAX_BYTES', 100)
    put(feed, wire(packets('h264')[0]))
    assert (len(feed.waiting), feed.broken) == (0, 1)
    assert '1 to 100 are shown' in feed.error


def test_large_pictures_are_refused(feed: PacketFeed, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(packets_module, 'MAX_PIXELS', 160 * 120 - 1)
    put(feed, wire(packets('h264')[0]))
    assert (len(feed.waiting), feed.broken) == (0, 1)


def test_unreadable_message_is_a_gap(feed: PacketFeed) -> None:
    key, delta, *_ = packets('h264')
    put(feed, wire(key), 1)
    feed.count_broken(CdrError('not a message'))
    put(feed, wire(delta), 2)
    assert feed.waiting[-1].number > feed.waiting[0].number + 1


def test_waiting_packets_are_limited(feed: PacketFeed) -> None:
    for number in range(1, 1000):
        put(feed, wire(packets('h264')[number > 1], header=NO_HEADER), number)
    assert len(feed.waiting) == 120
    assert feed.waiting[-1].number == 999
