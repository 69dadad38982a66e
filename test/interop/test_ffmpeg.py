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

"""Video topics and recorded video, compared with the programs of FFmpeg and other libraries."""

from __future__ import annotations

from collections.abc import Callable, Sequence
import hashlib
import json
import os
from pathlib import Path
import subprocess
from typing import Any, NamedTuple

import av
from bag_readers import read_by_all
from conftest import NodeProcess, recorded_files
import cv2
from mcap.reader import SeekingReader
from mcap_ros2.writer import Writer
from numbered_video import flat, MS, number_of, numbers, video_message, VideoSender
from opencv_tools.bags.schemas import MESSAGE_DEFINITIONS
from opencv_tools.convert.cli import main
from opencv_tools.video.messages import cdr_to_video, COMPRESSED_VIDEO, FFMPEG_PACKET, VIDEO_TOPICS
import pytest
from rclpy.node import Node
from video_packets import every_codec, packets
from waiting import LONGEST_SECONDS

Start = Callable[..., NodeProcess]
SCHEMAS = Path(__file__).with_name('published_schema.mjs')
COUNT = 30
SIZE = 160, 120
MUXED = {'h264': 'h264', 'h265': 'hevc'}
every_type = pytest.mark.parametrize('type_name', [FFMPEG_PACKET, COMPRESSED_VIDEO])
# Published in ffmpeg_image_transport_msgs 1.0 to 3.0.
FFMPEG_FIELDS = """\
std_msgs/Header header
int32 width
int32 height
string encoding
uint64 pts
uint8 flags
bool is_bigendian
uint8[] data"""


class Encoded(NamedTuple):
    """A packet that FFmpeg has encoded."""

    data: bytes
    is_key: bool


def run(*command: object, given: bytes = b'') -> str:
    """Run a program that reports no error, and return its output."""
    finished = subprocess.run([str(word) for word in command], input=given, capture_output=True,
                              timeout=LONGEST_SECONDS, check=False)
    assert (finished.returncode, finished.stderr.decode()) == (0, '')
    return finished.stdout.decode()


def ffmpeg_digests(path: Path, *options: str) -> list[str]:
    """Return the MD5 of each picture that ffmpeg decodes."""
    lines = run('ffmpeg', '-v', 'error', *options, '-i', path, '-map', '0:v', '-fps_mode',
                'passthrough', '-pix_fmt', 'yuv420p', '-f', 'framemd5', '-').splitlines()
    return [line.split(',')[-1].strip() for line in lines if not line.startswith('#')]


def pyav_digests(path: Path, name: str | None = None) -> list[str]:
    """Return the MD5 of each picture that PyAV decodes."""
    with av.open(str(path), format=name) as container:
        return [hashlib.md5(frame.to_ndarray(format='yuv420p').tobytes()).hexdigest()
                for frame in container.decode(video=0)]


def probe(path: Path, entries: str, *options: str) -> Any:
    """Return what ffprobe finds in a file."""
    return json.loads(run(
        'ffprobe', '-v', 'error', *options, '-show_entries', entries, '-of', 'json', path))


def record(start: Start, node: Node, path: Path, sent: Sequence[bytes], type_name: str) -> None:
    """Record messages of a video topic by stream copy."""
    sender = VideoSender(node, '/video_frames', type_name)
    recorder = start('img_subscriber', transport='video', output_dir=path.parent,
                     file_name=path.name, max_frames=len(sent), timeout=60)
    sender.send(*sent)
    assert recorder.finish() == 0, recorder.output


def encode_numbers(path: Path, *options: str) -> Path:
    """Encode numbered pictures with ffmpeg, whose quick conversion of colours darkens them."""
    size = f'{SIZE[0]}x{SIZE[1]}'
    run('ffmpeg', '-v', 'error', '-f', 'rawvideo', '-pix_fmt', 'bgr24', '-s', size, '-r', '25',
        '-i', '-', '-vf', 'scale=flags=accurate_rnd+full_chroma_int', '-pix_fmt', 'yuv420p',
        '-c:v', 'libx264', '-g', '10', *options, path,
        given=b''.join(flat(number, *SIZE).tobytes() for number in range(COUNT)))
    return path


def annex_b(path: Path) -> list[Encoded]:
    """Return the packets of a byte stream, which ffprobe delimits."""
    content, found = path.read_bytes(), []
    for packet in probe(path, 'packet=pos,size,flags')['packets']:
        begin = int(packet['pos'])
        found.append(Encoded(content[begin:begin + int(packet['size'])],
                             packet['flags'].startswith('K')))
    return found


def write_bag(path: Path, type_name: str, encoded: Sequence[Encoded]) -> Path:
    """Write a bag with mcap-ros2-support, which serializes the messages itself."""
    with path.open('wb') as file, Writer(file) as writer:
        schema = writer.register_msgdef(type_name, MESSAGE_DEFINITIONS[type_name])
        for number, packet in enumerate(encoded):
            stamp = {'sec': 1, 'nanosec': number * 40 * MS}
            values = ({'timestamp': stamp, 'frame_id': 'eye', 'format': 'h264'}
                      if type_name == COMPRESSED_VIDEO else
                      {'header': {'stamp': stamp, 'frame_id': 'eye'}, 'width': SIZE[0],
                       'height': SIZE[1], 'encoding': 'libx264;yuv420p;bgr8;bgr8', 'pts': number,
                       'flags': int(packet.is_key), 'is_bigendian': False})
            writer.write_message(f'/front/image/{VIDEO_TOPICS[type_name]}', schema,
                                 {**values, 'data': packet.data}, (25 + number) * 40 * MS)
    return path


def fields(text: str) -> list[str]:
    """Return the fields of the first type of a definition, without comments."""
    text = text.partition(80 * '=')[0]
    lines = (' '.join(line.partition('#')[0].split()) for line in text.splitlines())
    return [line for line in lines if line]


@every_codec
@pytest.mark.parametrize('suffix', ['.mkv', '.mp4'])
def test_recorded_video_in_ffmpeg(
        start: Start, node: Node, tmp_path: Path, suffix: str, codec: str) -> None:
    path = tmp_path / 'out' / f'a{suffix}'
    record(start, node, path, [
        video_message(FFMPEG_PACKET, packet, number, 40 * MS)
        for number, packet in enumerate(packets(codec, *SIZE, COUNT))], FFMPEG_PACKET)
    found = ffmpeg_digests(path)
    assert len(found) == COUNT
    assert found == pyav_digests(path)
    stream, = probe(path, 'stream=codec_name,width,height,nb_read_frames,nb_read_packets',
                    '-count_frames', '-count_packets')['streams']
    assert stream == {'codec_name': MUXED[codec], 'width': SIZE[0], 'height': SIZE[1],
                      'nb_read_frames': str(COUNT), 'nb_read_packets': str(COUNT)}


@every_codec
@every_type
def test_joined_packets_in_ffmpeg(
        start: Start, node: Node, tmp_path: Path, type_name: str, codec: str) -> None:
    bag, path = tmp_path / 'out' / 'a.mcap', tmp_path / 'joined'
    record(start, node, bag, [
        video_message(type_name, packet, number)
        for number, packet in enumerate(packets(codec, *SIZE, COUNT))], type_name)
    path.write_bytes(b''.join(bytes(cdr_to_video(type_name, stored.data).data)
                              for stored in read_by_all(bag)))
    found = ffmpeg_digests(path, '-f', MUXED[codec])
    assert len(found) == COUNT
    assert found == pyav_digests(path, MUXED[codec])


@every_type
def test_packets_of_ffmpeg_as_pictures(tmp_path: Path, type_name: str) -> None:
    encoded = annex_b(encode_numbers(tmp_path / 'a.h264', '-bf', '0'))
    assert [packet.is_key for packet in encoded] == [n % 10 == 0 for n in range(COUNT)]
    bag, out = write_bag(tmp_path / 'a.mcap', type_name, encoded), tmp_path / 'out'
    assert main([str(bag), str(out / '{seq:03d}.png')]) == 0
    assert [number_of(cv2.imread(str(path))) for path in recorded_files(out)] == [*range(COUNT)]
    assert main([str(bag), str(out / 'a.mkv')]) == 0
    assert numbers(out / 'a.mkv') == [*range(COUNT)]
    assert len(ffmpeg_digests(out / 'a.mkv')) == COUNT


@every_type
def test_packets_of_ffmpeg_played(start: Start, tmp_path: Path, type_name: str) -> None:
    bag = write_bag(tmp_path / 'a.mcap', type_name,
                    annex_b(encode_numbers(tmp_path / 'a.h264', '-bf', '0')))
    subscriber = start('img_subscriber', output_dir=tmp_path / 'out', transport='raw',
                       max_frames=COUNT, timeout=60, on_overflow='block')
    player = start('img_publisher', source=bag, publish_rate=0, wait_for_subscribers=1)
    assert player.finish() == 0, player.output
    assert subscriber.finish() == 0, subscriber.output
    assert [number_of(cv2.imread(str(path)))
            for path in recorded_files(tmp_path / 'out')] == [*range(COUNT)]


@pytest.mark.parametrize('between', ['0', '2'], ids=['no_b_frames', 'b_frames'])
@pytest.mark.parametrize('suffix', ['.mkv', '.mp4'])
def test_videos_of_ffmpeg(tmp_path: Path, suffix: str, between: str) -> None:
    video = encode_numbers(tmp_path / f'a{suffix}', '-bf', between)
    assert main([str(video), str(tmp_path / 'out' / '{seq:03d}.png')]) == 0
    assert [number_of(cv2.imread(str(path)))
            for path in recorded_files(tmp_path / 'out')] == [*range(COUNT)]


@every_type
def test_schemas_as_published(
        start: Start, node: Node, tmp_path: Path, type_name: str) -> None:
    bag = tmp_path / 'out' / 'a.mcap'
    record(start, node, bag, [
        video_message(type_name, packet, number)
        for number, packet in enumerate(packets('h264'))], type_name)
    with bag.open('rb') as file:
        schema, = SeekingReader(file, validate_crcs=True).get_summary().schemas.values()
    assert (schema.name, schema.encoding) == (type_name, 'ros2msg')
    published = FFMPEG_FIELDS
    if type_name == COMPRESSED_VIDEO:
        modules = os.environ.get('OPENCV_TOOLS_NODE_MODULES')
        if not modules:
            pytest.skip('npm is missing: sudo apt install npm')
        published = run('node', SCHEMAS, modules, 'CompressedVideo')
    assert fields(schema.data.decode()) == fields(published)
