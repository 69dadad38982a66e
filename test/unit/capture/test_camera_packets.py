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

"""Cameras that encode H.264: which packets are read, and their pictures."""

from __future__ import annotations

from pathlib import Path

from h264_camera import connect, DEVICE, H264Device
import numpy as np
from opencv_tools.capture.frame import CapturedFrame, VIDEO
from opencv_tools.capture.output_image import OutputImage
from opencv_tools.capture.settings import CaptureSettings
from opencv_tools.capture.v4l2.camera import CameraSource
from opencv_tools.capture.v4l2.modes import CameraRequest
from opencv_tools.image.errors import KeyFrameNeeded
from opencv_tools.video.bit_stream import nal_units, START_CODE
from opencv_tools.video.encoder import VideoEncoder
from opencv_tools.video.parameter_sets import parameter_sets
from opencv_tools.video.settings import VideoSettings
import pytest
from video_packets import draw, packets

GROUP = 3  # packets from a key frame to the next one
SECOND = 10 ** 9


def groups(count: int) -> list[bytes]:
    """Return packets with a key frame in each group."""
    encoder = VideoEncoder(VideoSettings(key_interval=GROUP - 0.5), 160, 120, 1)
    return [encoder.encode(draw(160, 120, number), 'bgr8', number * SECOND).data
            for number in range(count)]


@pytest.fixture
def device(monkeypatch: pytest.MonkeyPatch) -> H264Device:
    return connect(H264Device(), monkeypatch)


@pytest.fixture
def source(device: H264Device) -> CameraSource:
    return CameraSource(Path(DEVICE), CameraRequest())


def read_all(source: CameraSource) -> list[CapturedFrame]:
    """Read what is there."""
    frames = []
    for _ in range(100):
        if source.wait(0):
            frames.append(source.read())
    return frames


def contents(frames: list[CapturedFrame]) -> list[bytes]:
    assert {frame.encoding for frame in frames} <= {VIDEO}
    return [frame.image.tobytes() for frame in frames]


def test_all_packets_in_order(device: H264Device, source: CameraSource) -> None:
    sent = groups(2 * GROUP)
    for data in sent:
        device.send(data)
    frames = read_all(source)
    assert contents(frames) == sent and source.missed == 0
    keys = [number for number, frame in enumerate(frames) if frame.video.packet.is_key]
    assert keys == [0, GROUP] and source.needs_every
    assert source.description == 'H264 160x120 at 30 Hz'


def test_first_packet_is_a_key_frame(device: H264Device, source: CameraSource) -> None:
    sent = groups(2 * GROUP)
    for data in sent[1:]:
        device.send(data)
    assert contents(read_all(source)) == sent[GROUP:]
    assert (source.missed, device.requested_keys) == (0, 1)


@pytest.mark.parametrize('kind', ['lost', 'broken', 'damaged'])
def test_lost_packet_costs_those_until_the_next_key_frame(
        device: H264Device, source: CameraSource, kind: str) -> None:
    sent = groups(3 * GROUP)
    for number, data in enumerate(sent):
        if number == GROUP and kind == 'lost':
            device.lose()
        else:
            is_bad = number == GROUP
            device.send(bytes(len(data)) if is_bad and kind == 'damaged' else data,
                        broken=is_bad and kind == 'broken')
    frames = read_all(source)
    assert contents(frames) == sent[:GROUP] + sent[2 * GROUP:]
    assert source.missed == GROUP
    for frame, number in zip(frames, [*range(GROUP), *range(2 * GROUP, 3 * GROUP)]):
        assert np.abs(frame.video.decode().astype(int) - draw(160, 120, number)).mean() < 4


def test_skipped_packets_are_not_missed(device: H264Device, source: CameraSource) -> None:
    sent = groups(2 * GROUP)
    device.send(sent[0])
    assert source.wait(0)
    source.skip()
    for data in sent[1:]:
        device.send(data)
    assert contents(read_all(source)) == sent[GROUP:]
    assert source.missed == 0


@pytest.mark.parametrize('has_delimiter', [False, True])
def test_missing_parameter_sets_are_inserted(
        device: H264Device, source: CameraSource, has_delimiter: bool) -> None:
    first, second = groups(GROUP + 1)[0], groups(GROUP + 1)[GROUP]
    sets = parameter_sets('h264', first)
    delimiter = START_CODE + b'\x09\xf0' if has_delimiter else b''
    units = [unit for unit in nal_units(second) if unit[0] & 31 not in (7, 8)]
    bare = b''.join(START_CODE + unit for unit in units)
    device.send(first)
    device.send(delimiter + bare)
    assert contents(read_all(source)) == [first, delimiter + sets + bare]


def test_parameter_sets_in_packets_of_their_own(
        device: H264Device, source: CameraSource) -> None:
    first, *others = groups(GROUP)
    sets = [START_CODE + unit for unit in nal_units(first) if unit[0] & 31 in (7, 8)]
    bare = b''.join(START_CODE + unit for unit in nal_units(first) if unit[0] & 31 not in (7, 8))
    for data in (*sets, bare, *others):
        device.send(data)
    assert contents(read_all(source)) == [b''.join(sets) + bare, *others]
    assert source.missed == 0


def test_packets_after_a_loss_and_sets_are_missed(
        device: H264Device, source: CameraSource) -> None:
    sent = groups(2 * GROUP)
    device.send(sent[0])
    device.lose()
    device.send(parameter_sets('h264', sent[0]))
    for data in sent[2:]:
        device.send(data)
    assert contents(read_all(source)) == [sent[0], *sent[GROUP:]]
    assert source.missed == 1 + GROUP - 2


def test_size_of_the_camera_changes(device: H264Device, source: CameraSource) -> None:
    for packet in (packets('h264')[0], packets('h264', 96, 64)[0]):
        device.send(packet.data)
    assert [(frame.video.packet.width, frame.video.packet.height)
            for frame in read_all(source) if frame.video] == [(160, 120), (96, 64)]


def test_key_frame_without_any_parameter_sets(device: H264Device, source: CameraSource) -> None:
    units = [unit for unit in nal_units(groups(1)[0]) if unit[0] & 31 not in (7, 8)]
    device.send(b''.join(START_CODE + unit for unit in units))
    assert not read_all(source)


def test_pictures_are_decoded_from_a_key_frame_on(
        device: H264Device, source: CameraSource) -> None:
    for data in groups(2 * GROUP):
        device.send(data)
    frames = read_all(source)
    for number, frame in enumerate(frames):
        if number == 1:
            continue  # nobody wants it
        if number == 2:
            with pytest.raises(KeyFrameNeeded):
                frame.video.decode()
        else:
            assert np.abs(frame.video.decode().astype(int) - draw(160, 120, number)).mean() < 4


def test_requests_of_key_frames_are_limited(device: H264Device, source: CameraSource) -> None:
    for _ in range(5):
        source.request_key_frame()
    assert device.requested_keys == 1


@pytest.mark.parametrize(('fourccs', 'requested', 'chosen'), [
    (('H264', 'YUYV'), '', 'YUYV'), (('H264', 'MJPG'), '', 'MJPG'), (('H264',), '', 'H264'),
    (('YUYV', 'H264'), 'H264', 'H264'), (('H264', 'YUYV'), 'MJPG', 'YUYV')])
def test_choice_of_h264(monkeypatch: pytest.MonkeyPatch, fourccs: tuple[str, ...],
                        requested: str, chosen: str) -> None:
    connect(H264Device(fourccs), monkeypatch)
    source = CameraSource(Path(DEVICE), CameraRequest(fourcc=requested))
    assert source.description.startswith(chosen)
    assert source.needs_every is (chosen == 'H264')


@pytest.mark.parametrize(('values', 'is_unchanged'), [
    ({}, True), ({'encoding': 'bgr8'}, True), ({'encoding': 'mono8'}, False),
    ({'flip': 'both'}, False), ({'rotate': 90}, False)])
def test_settings_that_leave_the_packet_unchanged(
        device: H264Device, source: CameraSource, values: dict, is_unchanged: bool) -> None:
    data = packets('h264')[0].data
    device.send(data)
    frame, = read_all(source)
    output = OutputImage(frame, CaptureSettings(**values))
    assert (output.packet is not None) is is_unchanged
    assert output.size == ((120, 160) if values.get('rotate') else (160, 120))
    assert output.description == f'{output.size[0]}x{output.size[1]} h264'
    assert not output.is_decoded
    assert output.image.shape[:2] == output.size[::-1]
    assert output.encoding == values.get('encoding', 'bgr8')
