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

"""
Hostile input for the running nodes: tables of messages, pictures, parameters and services.

A row is a name and what is sent; to test one more, add it. Each row of messages and of pictures
says whether its frame is to be written. The rows of a table go to one process, each between good
frames, which must all be written. The process must not end, must stay below ``MEGABYTES`` by its
own account in /proc, must print nothing that is not printable, and its sums must be exact.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
import json
from pathlib import Path
import re
import struct
import zlib

from conftest import call_service, NodeProcess, read_manifest, spin_until
import cv2
import numpy as np
from opencv_tools.image.cdr import (
    compressed_image_to_cdr, image_to_cdr, WireCompressedImage, WireHeader, WireImage,
)
import pytest
from rcl_interfaces.srv import SetParameters
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.qos import DurabilityPolicy, QoSProfile
from sensor_msgs.msg import CameraInfo, CompressedImage, Image
from sensor_msgs.srv import SetCameraInfo
from sharing import Camera
from std_msgs.msg import String
from std_srvs.srv import SetBool

Start = Callable[..., NodeProcess]

MEGABYTES = 400
LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
ESCAPES = '\x1b]0;owned\x07\x1b[2J\n[INFO] [1.0] [image_subscriber]: \x9b31m\u202edlrow'
WRITTEN, FAILED = True, False


# Messages of images, as bytes

def image(encoding: str = 'mono8', width: int = 4, height: int = 3, step: int = 4,
          data: bytes = bytes(12), frame_id: str = 'camera') -> bytes:
    return image_to_cdr(WireImage(
        header=WireHeader(1, 2, frame_id), height=height, width=width, encoding=encoding,
        is_bigendian=False, step=step, data=data))


WHOLE = image()
IMAGES: dict[str, tuple[bytes, bool]] = {
    'encoding unknown': (image('foo'), FAILED),
    'encoding empty': (image(''), FAILED),
    'encoding of escapes': (image(ESCAPES), FAILED),
    'encoding of a megabyte': (image('B' * 10**6), FAILED),
    'encoding of 512 channels': (image('8UC512'), FAILED),
    'frame_id of escapes': (image(frame_id=ESCAPES), WRITTEN),
    'frame_id of a path': (image(frame_id='../../../etc/passwd'), WRITTEN),
    'frame_id of a megabyte': (image(frame_id='a' * 10**6), WRITTEN),
    'step too small': (image(step=3), FAILED),
    'step of nothing': (image(step=0), FAILED),
    'step too large': (image(step=2**32 - 1), FAILED),
    'data missing': (image(data=b''), FAILED),
    'data cut off': (image(data=bytes(11)), FAILED),
    'data more than needed': (image(data=bytes(1000)), WRITTEN),
    'no size': (image(width=0, height=0, step=0, data=b''), FAILED),
    'no width': (image(width=0), FAILED),
    'no height': (image(height=0), FAILED),
    'width of 2**32 - 1': (image(width=2**32 - 1), FAILED),
    'height of 2**32 - 1': (image(height=2**32 - 1), FAILED),
    'size of 2**64': (image(width=2**32 - 1, height=2**32 - 1, step=2**32 - 1), FAILED),
    'size without rows': (image(width=0, height=2**32 - 1, step=0), FAILED),
    'size just above the limit': (image(width=2**20 + 1, height=2**7, step=2**20 + 1), FAILED),
    'size above 2 GB': (image('64FC4', 2**26, 2, 2**31), FAILED),
    'odd yuv': (image('nv12', 3, 3, 3), FAILED),
    'cut off in the stamp': (WHOLE[:6], FAILED),
    'cut off in the frame': (WHOLE[:18], FAILED),
    'cut off in the size': (WHOLE[:30], FAILED),
    'cut off in the data': (WHOLE[:-5], FAILED),  # a few bytes less are filled on the way
    'string longer than the rest': (WHOLE[:12] + b'\xff\xff\xff\xff' + WHOLE[16:], FAILED),
    'data longer than the rest': (WHOLE[:-16] + b'\xff\xff\xff\x7f' + WHOLE[-12:], FAILED),
    'zeros': (bytes(100), FAILED),
    'ones': (b'\0\1\0\0' + b'\xff' * 96, FAILED),
}


# Messages of compressed images

def picture(suffix: str = '.jpg', size: int = 64) -> bytes:
    noise = np.random.default_rng(1).integers(0, 256, (size, size, 3), np.uint8)
    done, data = cv2.imencode(suffix, noise)
    assert done
    return data.tobytes()


def jpeg_of_size(width: int, height: int) -> bytes:
    jpeg = picture(size=16)
    place = jpeg.find(b'\xff\xc0') + 5
    return jpeg[:place] + struct.pack('>HH', height, width) + jpeg[place + 4:]


def png_of(width: int, height: int, pixels: bytes) -> bytes:
    chunks = ((b'IHDR', struct.pack('>II5B', width, height, 8, 0, 0, 0, 0)),
              (b'IDAT', zlib.compress(pixels, 1)), (b'IEND', b''))
    return b'\x89PNG\r\n\x1a\n' + b''.join(
        struct.pack('>I', len(content)) + kind + content
        + struct.pack('>I', zlib.crc32(kind + content)) for kind, content in chunks)


JPEG, PNG = picture(), picture('.png')
SCAN = JPEG.find(b'\xff\xda') + 14
PICTURES: dict[str, tuple[bytes, bool]] = {
    'nothing': (b'', FAILED),
    'text': (b'no picture', FAILED),
    'ones': (b'\xff' * 1000, FAILED),
    'jpeg': (JPEG, WRITTEN),
    'png': (PNG, WRITTEN),
    'tiff': (picture('.tif'), WRITTEN),
    'jpeg of 631 bytes and 2**30 pixels': (jpeg_of_size(32767, 32767), FAILED),
    'jpeg of 2**32 pixels': (jpeg_of_size(65535, 65535), FAILED),
    'jpeg of a long row': (jpeg_of_size(65500, 2000), FAILED),
    'jpeg without a size': (jpeg_of_size(0, 0), FAILED),
    'jpeg of 16x16 with 4096x4096 pixels': (jpeg_of_size(4096, 4096), FAILED),
    'png of 2**30 pixels': (png_of(32767, 32767, bytes(10**6)), FAILED),
    'png of 2**62 pixels': (png_of(2**31 - 1, 2**31 - 1, bytes(100)), FAILED),
    'png of less than it says': (png_of(64, 64, bytes(100)), FAILED),
    'png that unpacks to 50 MB': (png_of(1, 1, bytes(50 * 10**6)), WRITTEN),
    'png with a wrong sum': (PNG[:60] + b'\0\0\0\0' + PNG[64:], FAILED),
    'bmp of 2**30 pixels': (b'BM' + bytes(12) + struct.pack(
        '<IiiHH', 40, 32767, 32767, 1, 24) + bytes(100), FAILED),
    'webp of 2**48 pixels': (b'RIFF\x20\0\0\0WEBPVP8X' + bytes(8) + b'\xff' * 30, FAILED),
    'tiff of 2**30 pixels': (b'II*\0\x08\0\0\0\2\0' + b''.join(struct.pack(
        '<HHII', tag, 4, 1, 32767) for tag in (256, 257)) + bytes(100), FAILED),
    'pgm of 2**30 pixels': (b'P5\n32767 32767\n255\n' + bytes(100), FAILED),
    'jpeg without an end': (JPEG[:-2], FAILED),
    'jpeg of a third': (JPEG[:SCAN + (len(JPEG) - SCAN) // 3] + b'\xff\xd9', FAILED),
    'jpeg of rubbish': (JPEG[:20] + bytes(1000) + b'\xff\xd9', FAILED),
    'jpeg of its ends': (b'\xff\xd8\xff\xd9', FAILED),
}
FORMATS = ('jpeg', '', ESCAPES, 'bgr8; jpeg compressed ' + ESCAPES, 'a' * 10**5)


def stamped(message: bytes, sec: int) -> bytes:
    """Set the stamp that identifies a message in the manifest."""
    if len(message) < 8 or message[:2] != b'\0\1':
        return message
    return message[:4] + struct.pack('<i', sec) + message[8:]


def check_memory_and_output(process: NodeProcess) -> None:
    """
    Assert what must hold for a running node that has received all messages of its table.

    Its memory was less than MEGABYTES at its peak, and each line of its output is printable.
    """
    found = re.search(r'VmHWM:\s+([0-9]+) kB', Path(f'/proc/{process.pid}/status').read_text())
    assert found
    assert int(found[1]) / 1024 < MEGABYTES, process.output
    for line in process.output.splitlines():
        assert line.isprintable(), repr(line)


def numbers(output: str) -> dict[str, int]:
    """Read the sums of a recorder's last line."""
    line = next(line for line in output.splitlines() if 'Received ' in line)
    found = {name: int(number) for number, name in re.findall(
        r'\b([0-9]+) (frames|written|dropped|failed|lost|skipped)\b', line)}
    return {'skipped': 0, **found}


def record(start: Start, node: Node, folder: Path, message_type: type, topic: str,
           rows: Mapping[str, tuple[bytes, bool]], good: bytes, **parameters: object) -> None:
    """Send a table to a recorder, a good frame before and behind each row."""
    recorder = start('img_subscriber', output_dir=folder, on_overflow='block', **parameters)
    publisher = node.create_publisher(message_type, topic, QoSProfile(depth=1000))
    spin_until(node, lambda: publisher.get_subscription_count() > 0)
    for index, (message, _) in enumerate(rows.values()):
        publisher.publish(stamped(good, 2 * index))
        publisher.publish(stamped(message, 2 * index + 1))
    published = 2 * len(rows) + 1
    publisher.publish(stamped(good, published - 1))
    manifest = folder / 'manifest.jsonl'
    last = f'"stamp": {{"sec": {published - 1},'
    recorder.wait_until(lambda _: manifest.exists() and last in manifest.read_text(), last)
    check_memory_and_output(recorder)
    recorder.interrupt()
    assert recorder.finish() == 1, recorder.output
    sums = numbers(recorder.output)
    stamps = [line['stamp']['sec'] for line in read_manifest(folder)]
    names = list(rows)
    assert [stamp for stamp in stamps if not stamp % 2] == [*range(0, published, 2)]
    assert [names[stamp // 2] for stamp in stamps if stamp % 2] == [
        name for name, (_, is_written) in rows.items() if is_written], recorder.output
    assert sums['written'] == len(stamps), recorder.output
    assert sums['frames'] == sum(
        sums[name] for name in ('written', 'dropped', 'failed', 'skipped')), recorder.output
    assert sums['frames'] + sums['lost'] == published, recorder.output
    assert sums['failed'] == published - len(stamps), recorder.output


@pytest.mark.quick_cases(1)
@pytest.mark.parametrize('name', ['{seq}.png', '{frame_id}_{encoding}.npy'])
def test_hostile_images(
        name: str, start: Start, node: Node, tmp_path: Path) -> None:
    # .npy keeps arrays without pixels.
    rows = {key: row for key, row in IMAGES.items()
            if name.endswith('.png') or key not in (
                'no size', 'no width', 'no height', 'size without rows')}
    record(start, node, tmp_path / 'out', Image, 'video_frames', rows, WHOLE, transport='raw',
           file_name=f'"{name}"')


@pytest.mark.quick_cases(1)
@pytest.mark.parametrize('suffix', ['.png', '.jpg', '.npy'])
def test_hostile_compressed_images(
        suffix: str, start: Start, node: Node, tmp_path: Path) -> None:
    def message(data: bytes, told: str) -> bytes:
        return compressed_image_to_cdr(WireCompressedImage(
            header=WireHeader(1, 2, 'camera'), format=told, data=data))

    rows = {key: (message(data, FORMATS[index % len(FORMATS)]), is_written)
            for index, (key, (data, is_written)) in enumerate(PICTURES.items())}
    # Kept as they are, by their markers and sums, which are whole.
    rows.pop({'.jpg': 'jpeg of a third', '.png': 'png of less than it says'}.get(suffix, ''), None)
    record(start, node, tmp_path / 'out', CompressedImage, 'video_frames/compressed', rows,
           message(JPEG, 'jpeg'), transport='compressed', file_name=f'f{{seq}}{suffix}')


@pytest.mark.thorough
def test_folder_of_hostile_images(start: Start, tmp_path: Path) -> None:
    folder = tmp_path / 'in'
    folder.mkdir()
    for index, (name, (data, _)) in enumerate(PICTURES.items()):
        (folder / f'{index:03d} {name} \x1b[2J\n\udcff.png').write_bytes(data)
    good = sum(is_good for _, is_good in PICTURES.values())
    recorder = start('img_subscriber', output_dir=tmp_path / 'out', max_frames=good,
                     file_name='f{seq}.npy')
    publisher = start('img_publisher', source=folder, publish_rate=30.0, wait_for_subscribers=1,
                      on_end='hold')
    assert recorder.finish() == 0, recorder.output
    assert numbers(recorder.output)['written'] == good
    check_memory_and_output(publisher)
    publisher.interrupt()
    assert publisher.finish() == 0, publisher.output
    assert f'{len(PICTURES) - good} dropped' in publisher.output


PARAMETERS: dict[str, Parameter] = {
    'unknown name': Parameter(ESCAPES, value=1),
    'choice of escapes': Parameter('flip', value=ESCAPES),
    'choice of a megabyte': Parameter('flip', value='a' * 10**6),
    'type': Parameter('rotate', value=[1.0] * 10**5),
    'rate of no number': Parameter('publish_rate', value=float('nan')),
    'rate without end': Parameter('publish_rate', value=float('inf')),
    'quality': Parameter('jpeg_quality', value=2**62),
    'source': Parameter('source', value='/etc/passwd'),
}


def test_hostile_parameters_and_services(start: Start, node: Node) -> None:
    publisher = start('img_publisher', source='pattern:64x48')
    publisher.wait_for('Publishing video frame')
    for name, parameter in PARAMETERS.items():
        answer = call_service(
            node, SetParameters, '/image_publisher/set_parameters',
            SetParameters.Request(parameters=[parameter.to_parameter_msg()]))
        (result,) = answer.results
        assert not result.successful, name
        assert len(result.reason) < 10_000, name
    call_service(node, SetCameraInfo, '/set_camera_info', SetCameraInfo.Request(
        camera_info=CameraInfo(width=64, height=48, distortion_model=ESCAPES, d=[0.0] * 10**5)))
    for data in (False, True):
        assert call_service(node, SetBool, '/set_capture', SetBool.Request(data=data)).success
    check_memory_and_output(publisher)
    publisher.interrupt()
    assert publisher.finish() == 0, publisher.output


@pytest.mark.thorough
def test_announcement_with_the_service_of_another_camera(
        start: Start, camera: Node, node: Node, tmp_path: Path) -> None:
    folder = tmp_path / 'out'
    recorder = start('img_subscriber', '--ros-args', '-r', 'video_frames:=/a/frames',
                     output_dir=folder, file_name='f{seq:06d}.npy', on_overflow='block')
    announced: dict[str, str] = {}
    ours = Camera(camera, 'a', topic='/a/frames')
    other = Camera(camera, 'b', topic='/b/frames')
    cameras = [ours, other]
    for name in ('/a/frames', '/b/frames'):
        node.create_subscription(String, f'{name}/shm', lambda message, name=name: (
            announced.setdefault(name, message.data)), LATCHED)
    hostile = node.create_publisher(String, '/a/frames/shm', LATCHED)

    def send_until(condition: Callable[[], bool]) -> None:
        """Send from all cameras and announce a wrong service, until a condition holds."""
        def step() -> bool:
            for each in cameras:
                each.send()
            if len(announced) == 2:
                service = json.loads(announced['/b/frames'])['service']
                hostile.publish(String(data=json.dumps(
                    {**json.loads(announced['/a/frames']), 'service': service})))
            return condition()

        spin_until(node, step)

    spin_until(node, lambda: ours.subscribers > 0)
    manifest = folder / 'manifest.jsonl'
    send_until(lambda: (
        len(announced) == 2 and hostile.get_subscription_count() == 2 and manifest.exists()))
    until = ours.sent + 100
    send_until(lambda: ours.sent >= until)
    other.destroy()
    cameras.remove(other)
    until = ours.sent + 100
    send_until(lambda: ours.sent >= until)
    last = f'"stamp": {{"sec": {ours.sent},'
    recorder.wait_until(lambda _: last in manifest.read_text(), last)
    recorder.interrupt()
    assert recorder.finish() == 0, recorder.output
    lines = read_manifest(folder)
    assert {line['frame_id'] for line in lines} == {'a'}
    stamps = [line['stamp']['sec'] for line in lines]
    assert stamps == sorted(set(stamps))
    sums = numbers(recorder.output)
    assert sums['written'] == len(lines)
    assert sums['frames'] + sums['lost'] == ours.sent - stamps[0] + 1, recorder.output
