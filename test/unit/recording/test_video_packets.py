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

"""Packets of video in files: unchanged, with their times, from key frame to key frame."""

from __future__ import annotations

import base64
from collections.abc import Iterable
from dataclasses import replace
import errno
import json
import os
from pathlib import Path
import shutil
from typing import Any

import av
from conftest import disk_of, read_manifest, recorded_files
from console import Console
from numbered_video import (
    flat, flat_packets, NANO, number_of, numbers, read_packets, units, video_message)
import numpy as np
from opencv_tools.bags.writing import BagChannel
from opencv_tools.capture.bag import BagSource
from opencv_tools.image.errors import KeyFrameNeeded, VideoError
from opencv_tools.recording.bag_sink import MessageFrame
from opencv_tools.recording.errors import LimitReached
from opencv_tools.recording.frames import PacketFrame, RawFrame
from opencv_tools.recording.naming import FrameMetadata
from opencv_tools.recording.recorder import Recorder, Sink
from opencv_tools.recording.selection import Limits
from opencv_tools.recording.video.container import VideoFile
from opencv_tools.recording.video.format import CopiedStream, prepare_packet
from opencv_tools.recording.video.writer import count_frames
from opencv_tools.video.messages import cdr_to_video, FFMPEG_PACKET
from opencv_tools.video.packet import VideoPacket
from opencv_tools.video.parameter_sets import is_key_frame, parameter_sets, read_extradata
from opencv_tools.video.settings import VideoSettings
from opencv_tools.video.stream import VideoStream
from playback import frames_of as frames_of_source
import pytest
from recordings import open_videos
from stepped_clock import SteppedClock
from videos import play

BEGIN_NS = 1_700_000_000 * NANO
CODECS = ('h264', 'h265')
AV1 = Path(__file__).parents[2] / 'data' / 'av1_160x120.json'
STEP_NS = 40_123_457
every_format = pytest.mark.parametrize('suffix', ['.mp4', '.mkv'])


def frame_of(packet: VideoPacket, number: int, publisher: bytes = b'a') -> PacketFrame:
    time_ns = BEGIN_NS + number * STEP_NS
    return PacketFrame(
        metadata=FrameMetadata(time_ns, 'eye', packet.codec, '/video/ffmpeg'), receive_ns=time_ns,
        arrival_ns=number * STEP_NS, packet=packet, publisher=publisher, number=number + 1)


def image_frame(number: int) -> RawFrame:
    time_ns = BEGIN_NS + number * STEP_NS
    return RawFrame(metadata=FrameMetadata(time_ns, 'eye', 'bgr8', '/video'), receive_ns=time_ns,
                    arrival_ns=number * STEP_NS, image=flat(number))


def put(videos: Sink[Any], *frames: PacketFrame | RawFrame) -> list[int]:
    """Put frames, and return the indices of those that are left out."""
    left_out = []
    for index, frame in enumerate(frames):
        try:
            videos.commit(frame, videos.prepare(frame))
        except KeyFrameNeeded:
            left_out.append(index)
    return left_out


def frames_of(packets: Iterable[VideoPacket], first: int = 0) -> list[PacketFrame]:
    return [frame_of(packet, number) for number, packet in enumerate(packets, first)]


@every_format
@pytest.mark.parametrize('has_delimiters', [True, False])
def test_av1_of_another_encoder(tmp_path: Path, suffix: str, has_delimiters: bool) -> None:
    # Containers and networks leave the temporal delimiters out.
    sent = [base64.b64decode(text) for text in json.loads(AV1.read_text())]
    sent = [data if has_delimiters else data.removeprefix(b'\x12\0') for data in sent]
    videos = open_videos(tmp_path, f'a{suffix}')
    put(videos, *(frame_of(VideoPacket(
        codec='av1', data=data, is_key=is_key_frame('av1', data), width=160, height=120), number)
        for number, data in enumerate(sent)))
    videos.close()
    with av.open(str(tmp_path / f'a{suffix}')) as container:
        assert len([*container.decode(video=0)]) == len(sent)


@every_format
@pytest.mark.parametrize('codec', CODECS)
def test_one_file_while_the_frame_rate_changes(
        tmp_path: Path, codec: str, suffix: str) -> None:
    clock, packets, encoders = 0.0, [], set()
    stream = VideoStream(VideoSettings(codec=codec, bit_rate=1_500_000), lambda: clock)
    for rate, count in ((3, 15), (90, 200), (3, 30)):
        for _ in range(count):
            clock += 1 / rate
            packets.append(stream.encode(flat(len(packets)), 'bgr8', round(clock * NANO)))
            encoders.add(stream._encoder)
    assert len(encoders) > 2
    videos = open_videos(tmp_path, f'a{suffix}')
    assert put(videos, *frames_of(packets)) == []
    videos.close()
    assert recorded_files(tmp_path) == [tmp_path / f'a{suffix}']
    with av.open(str(tmp_path / f'a{suffix}')) as container:
        assert len([*container.decode(video=0)]) == len(packets)


@every_format
@pytest.mark.parametrize('codec', CODECS)
def test_packets_keep_their_bytes_and_times(tmp_path: Path, codec: str, suffix: str) -> None:
    packets = flat_packets(30, codec, keys=(0, 12))
    videos = open_videos(tmp_path, f'a{suffix}')
    assert put(videos, *frames_of(packets)) == []
    videos.close()
    path = tmp_path / f'a{suffix}'
    found = read_packets(path)
    assert [content for *_, content in found] == [units(codec, one.data) for one in packets]
    assert [is_key for _, is_key, _ in found] == [number in (0, 12) for number in range(30)]
    for number, (seconds, *_) in enumerate(found):
        assert abs(seconds - number * STEP_NS / NANO) < 0.001
    assert numbers(path) == [*range(30)]
    if codec != 'av1':  # which OpenCV may not decode
        assert [number_of(image) for _, image in play(path)] == [*range(30)]
    with av.open(str(path)) as container:
        stream = container.streams.video[0]
        sets, _ = read_extradata(codec, stream.codec_context.extradata)
        assert (stream.width, stream.height) == (48, 32)
    assert sets == parameter_sets(codec, packets[0].data)
    line, = read_manifest(tmp_path)
    assert (line['stored_encoding'], line['size'], line['frames']) == (codec, [48, 32], 30)
    assert count_frames(path) == 30


@every_format
def test_video_begins_with_a_key_frame(tmp_path: Path, suffix: str) -> None:
    frames = frames_of(flat_packets(20, keys=(7,)))[3:]
    videos = open_videos(tmp_path, f'a{suffix}')
    assert put(videos, *frames) == [0, 1, 2, 3]
    videos.close()
    assert numbers(tmp_path / f'a{suffix}') == [*range(7, 20)]
    assert videos.counts.kept == 13


@every_format
@pytest.mark.parametrize('codec', CODECS)
def test_gap_lasts_until_the_next_key_frame(tmp_path: Path, codec: str, suffix: str) -> None:
    frames = frames_of(flat_packets(20, codec, keys=(12,)))
    del frames[5:7]
    videos = open_videos(tmp_path, f'a{suffix}')
    assert put(videos, *frames) == [5, 6, 7, 8, 9]
    videos.close()
    assert numbers(tmp_path / f'a{suffix}') == [*range(5), *range(12, 20)]
    assert len(recorded_files(tmp_path)) == 1


@every_format
def test_video_goes_on_with_the_first_key_frame_after_a_full_disk(
        tmp_path: Path, suffix: str) -> None:
    clock = SteppedClock()
    videos = open_videos(tmp_path, f'a{suffix}', monotonic=clock.monotonic)
    frames = frames_of(flat_packets(50, keys=(0, 40)))
    with disk_of(100), pytest.raises(OSError, match=os.strerror(errno.EFBIG)):
        put(videos, *frames[:20])
    clock.step_to(clock.now + 2)
    assert put(videos, *frames[20:]) == [*range(20)]
    videos.close()
    assert [numbers(path) for path in recorded_files(tmp_path)][-1] == [*range(40, 50)]


@every_format
def test_publisher_that_changes_its_size_again_and_again(tmp_path: Path, suffix: str) -> None:
    small, large = flat_packets(1)[0], flat_packets(1, size=(64, 48))[0]
    videos = open_videos(tmp_path, f'a{suffix}')
    frames = frames_of([small, large] * 100)  # of 8 seconds
    left_out = put(videos, *frames)
    videos.close()
    assert 4 <= len(recorded_files(tmp_path)) <= 13
    assert len(left_out) < 110 and videos.counts.kept == 200 - len(left_out)


def test_account_of_a_recorder_is_complete(tmp_path: Path) -> None:
    frames = frames_of(flat_packets(20, keys=(12,)))
    del frames[5]
    console = Console()
    recorder = Recorder(open_videos(tmp_path), console, block=True)
    for frame in frames:
        recorder.put(frame)
    recorder.close()
    counts = recorder.counts
    assert (counts.written, counts.left_out, counts.failed, counts.skipped) == (13, 6, 0, 0)
    assert [line for line in console.lines if 'left out' in line] == [
        'warning: a frame was left out until the next key frame: a packet of h264 needs earlier '
        'packets, which are missing in the video']


def test_packets_without_numbers_follow_each_other(tmp_path: Path) -> None:
    videos = open_videos(tmp_path)
    frames = [PacketFrame(**{**vars(frame), 'number': 0}) for frame in frames_of(flat_packets(5))]
    assert put(videos, *frames) == []
    videos.close()


def test_publishers_without_numbers_are_not_mixed(tmp_path: Path) -> None:
    first, second = flat_packets(4), flat_packets(4, keys=(0, 2))
    frames = [replace(frame_of(packet, number, publisher), number=0)
              for number, (packet, publisher) in enumerate(
                  [*((packet, b'a') for packet in first[:2]),
                   *((packet, b'b') for packet in second[1:]), (first[2], b'a')])]
    videos = open_videos(tmp_path, 'a.mkv')
    assert put(videos, *frames) == [2, 5]
    videos.close()


def test_publisher_goes_on_after_a_packet_of_another(tmp_path: Path) -> None:
    first, second = flat_packets(4), flat_packets(4)
    videos = open_videos(tmp_path)
    assert put(videos, *frames_of(first[:2]), frame_of(second[2], 2, b'b'),
               *frames_of(first[2:], 2)) == [2]
    videos.close()
    assert numbers(tmp_path / 'clip.mkv') == [0, 1, 2, 3]


def test_another_publisher_begins_with_a_key_frame(tmp_path: Path) -> None:
    first, second = flat_packets(3), flat_packets(6, first=3, keys=(5,))
    videos = open_videos(tmp_path)
    put(videos, *frames_of(first))
    assert put(videos, *(frame_of(packet, number, b'b')
                         for number, packet in enumerate(second[1:], 4))) == [0]
    videos.close()
    assert numbers(tmp_path / 'clip.mkv') == [0, 1, 2, *range(5, 9)]


@every_format
def test_change_of_the_stream_begins_a_file(tmp_path: Path, suffix: str) -> None:
    parts = [flat_packets(3), flat_packets(3, 'h265', first=3), flat_packets(
        3, first=6, size=(64, 32)), flat_packets(3, first=9, size=(64, 32), quality=40)]
    videos = open_videos(tmp_path, f'{{seq}}{suffix}')
    assert put(videos, *frames_of(packet for part in parts for packet in part)) == []
    videos.close()
    assert [numbers(path) for path in recorded_files(tmp_path)] == [
        [*range(first, first + 3)] for first in (0, 3, 6, 9)]
    assert [(line['stored_encoding'], line['size']) for line in read_manifest(tmp_path)] == [
        ('h264', [48, 32]), ('h265', [48, 32]), ('h264', [64, 32]), ('h264', [64, 32])]


@every_format
def test_change_between_images_and_packets_begins_a_file(tmp_path: Path, suffix: str) -> None:
    packets = frames_of(flat_packets(12, keys=(0, 8)))
    videos = open_videos(tmp_path, f'{{seq}}{suffix}')
    frames = [*packets[:3], *map(image_frame, range(3, 5)), *packets[5:]]
    assert put(videos, *frames) == [5, 6, 7]
    videos.close()
    assert [numbers(path) for path in recorded_files(tmp_path)] == [
        [0, 1, 2], [3, 4], [8, 9, 10, 11]]


@every_format
@pytest.mark.parametrize('limits', [Limits(split_bytes=900), Limits(split_seconds=0.3)])
def test_split_waits_for_a_key_frame(tmp_path: Path, suffix: str, limits: Limits) -> None:
    keys = (0, 10, 20, 30)
    videos = open_videos(tmp_path, f'{{seq}}{suffix}', limits=limits)
    assert put(videos, *frames_of(flat_packets(40, keys=keys))) == []
    videos.close()
    assert [numbers(path) for path in recorded_files(tmp_path)] == [
        [*range(first, first + 10)] for first in keys]


def test_ring_deletes_whole_files(tmp_path: Path) -> None:
    videos = open_videos(tmp_path, '{seq:03d}.mkv', limits=Limits(max_frames=30, ring=True))
    put(videos, *frames_of(flat_packets(100, keys=range(0, 100, 5))))
    videos.close()
    found = [number for path in recorded_files(tmp_path) for number in numbers(path)]
    assert found == [number % 50 for number in range(100 - len(found), 100)]
    assert 20 < len(found) <= 30


@pytest.mark.quick_cases(2)
@every_format
@pytest.mark.parametrize('max_bytes', [3000, 3333, 5000, 9000])
def test_video_stays_below_max_bytes(tmp_path: Path, suffix: str, max_bytes: int) -> None:
    videos = open_videos(tmp_path, f'a{suffix}', limits=Limits(max_bytes=max_bytes))
    with pytest.raises(LimitReached):
        put(videos, *frames_of(flat_packets(1000, keys=range(0, 1000, 37))))
    videos.close()
    size = (tmp_path / f'a{suffix}').stat().st_size
    assert max_bytes - 700 < size <= max_bytes
    assert len(numbers(tmp_path / f'a{suffix}')) == videos.counts.kept


def test_ring_that_is_full_goes_on_with_a_key_frame(tmp_path: Path) -> None:
    videos = open_videos(
        tmp_path, '{seq:03d}.mkv', limits=Limits(max_bytes=4000, ring=True))
    left_out = put(videos, *frames_of(flat_packets(300, keys=(0, 200))))
    videos.close()
    found = [numbers(path) for path in recorded_files(tmp_path)]
    assert found[-1][0] == 0 and 199 in left_out and 200 not in left_out
    assert sum(path.stat().st_size for path in recorded_files(tmp_path)) <= 4000


@pytest.mark.quick_cases(1)
@every_format
@pytest.mark.parametrize('codec', CODECS)
def test_file_plays_whenever_it_is_cut_off(tmp_path: Path, codec: str, suffix: str) -> None:
    packets = [prepare_packet(packet) for packet in flat_packets(100, codec)]
    file = VideoFile(tmp_path / f'a{suffix}', CopiedStream(packets[0]), 0)
    least = 0
    for number, packet in enumerate(packets):
        file.write(packet, number * STEP_NS)
        cut = tmp_path / f'cut{suffix}'
        shutil.copy(tmp_path / f'a{suffix}', cut)
        least = max(least, file.flushed)
        if number % 10 == 0:
            assert (count_frames(cut) or 0) >= file.flushed
            found = numbers(cut) if file.flushed else []
            assert found == [index % 50 for index in range(len(found))]
    file.close()
    assert least > 100 - 30  # little more than a second waits in memory, without key frames


def test_packets_that_no_video_can_hold(tmp_path: Path) -> None:
    videos = open_videos(tmp_path)
    first, *_ = flat_packets(1)
    for data in (b'', b'\0\0\0\1\x65' + bytes(40)):
        packet = VideoPacket(codec='h264', data=data, is_key=True, width=48, height=32)
        with pytest.raises((VideoError, KeyFrameNeeded)):
            videos.commit(frame_of(packet, 0), videos.prepare(frame_of(packet, 0)))
    damaged = VideoPacket(codec='h264', data=first.data[:8] + bytes(10) + first.data[30:],
                          is_key=True, width=48, height=32)
    frame = frame_of(damaged, 0)
    try:
        put(videos, frame)
    except VideoError as err:
        assert 'cannot be stored as .mkv' in str(err)
    put(videos, frame_of(first, 1))
    videos.close()
    assert len(recorded_files(tmp_path)) <= 2
    assert np.array_equal(numbers(recorded_files(tmp_path)[-1]), [0])


@pytest.mark.parametrize('limits', [Limits(split_bytes=3000), Limits(max_frames=40, ring=True)])
def test_bags_of_a_split_begin_with_key_frames(tmp_path: Path, limits: Limits) -> None:
    bags = open_videos(tmp_path, '{seq:03d}.mcap', limits=limits)
    for number, packet in enumerate(flat_packets(100, keys=range(0, 100, 10))):
        message = cdr_to_video(FFMPEG_PACKET, video_message(FFMPEG_PACKET, packet, number))
        frame = MessageFrame(
            metadata=FrameMetadata(number, 'eye', 'h264', '/video/ffmpeg'), receive_ns=number,
            arrival_ns=number, message=message, number=number + 1,
            channel=BagChannel(topic='/video/ffmpeg', type_name=FFMPEG_PACKET))
        bags.commit(frame, bags.prepare(frame))
    bags.close()
    found = [[number_of(frame.image) for frame in frames_of_source(BagSource(path))]
             for path in recorded_files(tmp_path)]
    assert len(found) > 2 and all(one[0] % 10 == 0 for one in found)
    shown = [number for one in found for number in one]
    assert shown == [number % 50 for number in range(100 - len(shown), 100)]
