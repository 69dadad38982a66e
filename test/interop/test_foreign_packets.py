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

"""Packets of the encoders and containers of FFmpeg on video topics and in bags."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import av
from av.bitstream import BitStreamFilterContext
from bag_readers import read_by_all
from conftest import NodeProcess, recorded_files
import cv2
from mcap_ros2.writer import Writer
from numbered_video import MS, VideoSender
import numpy as np
from opencv_tools.bags.schemas import MESSAGE_DEFINITIONS
from opencv_tools.convert.cli import main
from opencv_tools.message_types.codec import MessageCodec
from opencv_tools.message_types.definition import read_definition
from opencv_tools.video.messages import COMPRESSED_VIDEO, FFMPEG_PACKET, VIDEO_TOPICS
from opencv_tools.video.packet import CODECS
import pytest
from rclpy.node import Node
from test_foreign_files import ERROR, judged, run, SOFT

Start = Callable[..., NodeProcess]
COMPRESSED_IMAGE = 'sensor_msgs/msg/CompressedImage'
COUNT, STEP = 30, 0.04  # frames, and seconds between two
H264 = '-c:v libx264 -bf 0 -preset veryfast -pix_fmt yuv420p -g 12'
H265 = '-c:v libx265 -bf 0 -preset ultrafast -pix_fmt yuv420p -g 12 -x265-params log-level=none'
SVT, AOM = ('-c:v libsvtav1 -preset 12 -g 12 -pix_fmt yuv420p -svtav1-params pred-struct=1',
            '-c:v libaom-av1 -cpu-used 8 -g 12 -b:v 300k -pix_fmt yuv420p -lag-in-frames 0')
RAV1E = '-c:v librav1e -speed 10 -g 12 -pix_fmt yuv420p -rav1e-params low_latency=true'
# The codec, and of each file: options of ffmpeg for its encoder.
FILES = {
    'h264': {
        'plain.mp4': H264, 'plain.mkv': H264, 'plain.ts': H264, 'plain.flv': H264, 'plain.h264':
        H264, 'fast.mov': f'{H264} -tune zerolatency', 'aud.mkv': f'{H264} -aud 1',
        'slices.ts': f'{H264} -slices 4', 'baseline.mp4': f'{H264} -profile:v baseline',
        'tff.mkv': f'{H264} -flags +ildct+ilme -x264opts tff=1', 'intra.avi': f'{H264} -g 1',
        'high10.mkv': f'{H264} -pix_fmt yuv420p10le', 'high422.ts': f'{H264} -pix_fmt yuv422p',
        'high444.mp4': f'{H264} -pix_fmt yuv444p', 'full.mp4': f'{H264} -pix_fmt yuvj420p',
        'cropped.mp4': f'{H264} -vf crop=170:138:0:0', 'fragments.mp4':
        f'{H264} -movflags frag_keyframe+empty_moov', 'bits.ts': f'{H264} -b:v 200k -nal-hrd vbr '
        '-maxrate 200k -bufsize 100k', 'bt709.mkv': f'{H264} -colorspace bt709',
        'left.mkv': f'{H264} -bsf:v h264_metadata=crop_left=10:crop_top=6:crop_right=4'},
    'h265': {
        'plain.mp4': H265, 'plain.mkv': H265, 'plain.ts': H265, 'plain.hevc': H265,
        'repeated.mkv': f'{H265}:repeat-headers=1', 'aud.ts': f'{H265}:aud=1',
        'tagged.mov': f'{H265} -tag:v hvc1', 'main10.mkv': f'{H265} -pix_fmt yuv420p10le',
        'main422.mp4': f'{H265} -pix_fmt yuv422p10le', 'main444.mkv': f'{H265} -pix_fmt yuv444p',
        'slices.ts': f'{H265}:slices=2', 'intra.mp4': f'{H265} -g 1',
        'cropped.mkv': f'{H265} -vf crop=170:138:0:0',
        'left.mkv': f'{H265} -bsf:v hevc_metadata=crop_left=10:crop_top=6:crop_right=4'},
    'av1': {
        'svt.mp4': SVT, 'svt.mkv': SVT, 'svt.ivf': SVT, 'svt.obu': SVT, 'aom.mp4': AOM,
        'aom.mkv': AOM, 'aom.webm': AOM, 'aom.ivf': AOM, 'aom.obu': AOM, 'tiles.mkv':
        f'{AOM} -tiles 2x2', 'ten.mkv': f'{AOM} -pix_fmt yuv420p10le', 'high.mp4':
        f'{AOM} -pix_fmt yuv444p', 'gray.mkv': f'{AOM} -pix_fmt gray', 'cropped.mp4':
        f'{AOM} -vf crop=170:138:0:0', 'rav1e.mp4': RAV1E, 'rav1e.ivf': RAV1E}}
ROWS = [pytest.param(codec, name, id=f'{codec}-{name}')
        for codec, files in FILES.items() for name in files]
FILTERS = {'h264': 'h264_mp4toannexb', 'h265': 'hevc_mp4toannexb', 'av1': 'null'}


class Packet(NamedTuple):
    """A packet of FFmpeg."""

    data: bytes
    is_key: bool
    size: tuple[int, int]
    encoder: str


def encode(codec: str, path: Path) -> Path:
    """Write the file of a row."""
    run('ffmpeg', '-v', 'error', '-y', '-f', 'lavfi', '-i',
        f'testsrc2=size=176x144:rate=25,{SOFT}', '-frames:v', COUNT,
        *FILES[codec][path.name].split(), path)
    return path


def packets_of(codec: str, path: Path) -> list[Packet]:
    """Return the packets of a file, H.264 and H.265 as a byte stream."""
    with av.open(str(path)) as container:
        stream = container.streams.video[0]
        convert = BitStreamFilterContext(FILTERS[codec], stream)
        encoder = FILES[codec][path.name].split()[1]
        return [Packet(bytes(packet), packet.is_keyframe, (stream.width, stream.height), encoder)
                for given in container.demux(stream) if given.size
                for packet in convert.filter(given)]


def values(type_name: str, codec: str, packet: Packet, number: int) -> dict[str, object]:
    """Return the message of a packet."""
    stamp = {'sec': 1 + number // 25, 'nanosec': number % 25 * 40 * MS}
    header = {'stamp': stamp, 'frame_id': 'eye'}
    if type_name == COMPRESSED_VIDEO:
        return {'timestamp': stamp, 'frame_id': 'eye', 'format': codec, 'data': packet.data}
    if type_name == COMPRESSED_IMAGE:
        return {'header': header, 'format': codec, 'data': packet.data}
    return {'header': header, 'width': packet.size[0], 'height': packet.size[1], 'encoding':
            f'{packet.encoder};yuv420p;bgr8;bgr8', 'pts': number, 'flags': int(packet.is_key),
            'is_bigendian': False, 'data': packet.data}


def check(path: Path, encoded: Path) -> None:
    """Compare a video with the file of its packets; FFmpeg shows both."""
    (pixels, times), (expected, _) = judged(path), judged(encoded)
    assert np.array_equal(pixels, expected)
    assert np.diff(times) == pytest.approx(np.full(COUNT - 1, STEP), abs=1.1e-3)


def check_pictures(folder: Path, encoded: Path) -> None:
    """Compare pictures with those that FFmpeg shows of their packets."""
    images = [cv2.imread(str(path)) for path in recorded_files(folder)]
    assert len(images) == COUNT
    # Without the flag, FFmpeg shows columns at the left that are cropped.
    expected = judged(encoded, '-flags', 'unaligned')[0].reshape(COUNT, *images[0].shape)
    assert max(cv2.absdiff(*pair).mean() for pair in zip(images, expected)) < ERROR


@pytest.mark.parametrize(('codec', 'name'), ROWS)
def test_packets_of_ffmpeg_in_bags(tmp_path: Path, codec: str, name: str) -> None:
    encoded = encode(codec, tmp_path / name)
    packets = packets_of(codec, encoded)
    assert len(packets) == COUNT
    for type_name in (FFMPEG_PACKET, COMPRESSED_VIDEO, COMPRESSED_IMAGE):
        last = VIDEO_TOPICS.get(type_name, 'compressed')
        bag, out = tmp_path / f'{last}.mcap', tmp_path / last
        with bag.open('wb') as file, Writer(file) as writer:
            schema = writer.register_msgdef(type_name, MESSAGE_DEFINITIONS[type_name])
            for number, packet in enumerate(packets):
                writer.write_message(
                    f'/image/{last}', schema, values(type_name, codec, packet, number),
                    (25 + number) * 40 * MS)
        for made in ('a.mkv', 'a.mp4', 'pictures/{seq:03d}.png'):
            assert main([str(bag), str(out / made)]) == 0
        check(out / 'a.mkv', encoded)
        check(out / 'a.mp4', encoded)
        check_pictures(out / 'pictures', encoded)


@pytest.mark.parametrize('made', ['a.mkv', 'a.mp4', 'a.mcap', '{seq:03d}.png'])
@pytest.mark.parametrize('codec', CODECS)
def test_packets_of_ffmpeg_on_topics(
        start: Start, node: Node, tmp_path: Path, codec: str, made: str) -> None:
    type_name = COMPRESSED_VIDEO if made == 'a.mp4' else FFMPEG_PACKET
    encoded = encode(codec, tmp_path / next(iter(FILES[codec])))
    packets = packets_of(codec, encoded)
    message = MessageCodec(read_definition(type_name))
    sender = VideoSender(node, '/video_frames', type_name)
    recorder = start('img_subscriber', transport='video', output_dir=tmp_path / 'out',
                     file_name=f'"{made}"', max_frames=COUNT, timeout=60, on_overflow='block')
    sender.send(*(message.write(values(type_name, codec, packet, number))
                  for number, packet in enumerate(packets)))
    assert recorder.finish() == 0, recorder.output
    if made == '{seq:03d}.png':
        check_pictures(tmp_path / 'out', encoded)
    elif made == 'a.mcap':
        stored = read_by_all(tmp_path / 'out' / made)
        assert [bytes(message.read(one.data)['data']) for one in stored] == [
            packet.data for packet in packets]
    else:
        check(tmp_path / 'out' / made, encoded)
