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

"""Network streams that PyAV reads, from a process that sends them."""

from __future__ import annotations

from collections.abc import Callable, Iterator
import socket
from threading import Thread

import av
import numpy as np
from opencv_tools.capture import source, stream as stream_module
from opencv_tools.capture.container import open_container
from opencv_tools.capture.errors import BrokenFrameError, CaptureError, UnavailableError
from opencv_tools.capture.frame import CapturedFrame, VIDEO
from opencv_tools.capture.stream import StreamSource
from opencv_tools.image.errors import VideoError
from opencv_tools.video.bit_stream import nal_units, START_CODE
from opencv_tools.video.parameter_sets import parameter_sets
from opencv_tools.video.settings import VideoSettings
import pytest
from video_packets import draw, encoded, PERIOD_NS
from video_servers import free_port, VideoServer
from waiting import join, LONGEST_SECONDS, wait_until

COUNT = 60
DELIMITER = START_CODE + b'\x09\xf0'  # MPEG-TS adds it where it is missing
Serve = Callable[..., VideoServer]

pytestmark = pytest.mark.process


@pytest.fixture
def serve() -> Iterator[Serve]:
    servers: list[VideoServer] = []

    def start(*arguments: object, **keywords: object) -> VideoServer:
        servers.append(VideoServer(*arguments, **keywords))
        return servers[-1]

    yield start
    for server in servers:
        server.close()


def groups(count: int, group: int) -> list[bytes]:
    """Return packets with a key frame in each group."""
    settings = VideoSettings(key_interval=(group - 0.5) * PERIOD_NS / 1e9)
    return [DELIMITER + packet.data for packet in encoded(settings, 160, 120, count)]


def connect(server: VideoServer) -> StreamSource:
    """Open the stream of a server, which may not listen yet."""
    wait_until(server.wait_until_it_listens, 'the server')
    opened = source.open_source(server.url, timeout=LONGEST_SECONDS)
    assert isinstance(opened, StreamSource)
    return opened


def read_all(opened: StreamSource) -> list[CapturedFrame]:
    """Return the frames until the end."""
    found = []
    with pytest.raises(UnavailableError, match='ended or is no longer reachable'):
        while opened.wait(LONGEST_SECONDS):
            found.append(opened.read())
    opened.close()
    return found


def contents(found: list[CapturedFrame]) -> list[bytes]:
    assert {frame.encoding for frame in found} == {VIDEO}
    return [frame.image.tobytes() for frame in found]


def assert_pictures(found: list[np.ndarray], numbers: list[int]) -> None:
    assert len(found) == len(numbers)
    for image, number in zip(found, numbers):
        assert np.abs(image.astype(int) - draw(160, 120, number)).mean() < 6


def test_packets_of_mpegts_are_unchanged(serve: Serve) -> None:
    sent = groups(COUNT, 30)
    opened = connect(serve(sent))
    assert (opened.live, opened.needs_every) == (True, True)
    assert opened.description == 'H264 160x120 at 30 Hz'
    found = read_all(opened)
    assert contents(found) == sent
    stamps = [frame.stamp_ns for frame in found]
    assert stamps == sorted(stamps) and stamps[0] > 0
    assert opened.missed == 0
    assert_pictures([frame.video.decode() for frame in found if frame.video], [*range(COUNT)])


def test_parameter_sets_before_later_key_frames(serve: Serve) -> None:
    sent = groups(COUNT, 30)
    sets = parameter_sets('h264', sent[0])
    bare = DELIMITER + b''.join(
        START_CODE + unit for unit in nal_units(sent[30]) if unit[0] & 31 not in (7, 8, 9))
    found = contents(read_all(connect(serve([*sent[:30], bare, *sent[31:]]))))
    assert found == [*sent[:30], DELIMITER + sets + bare[len(DELIMITER):], *sent[31:]]


@pytest.mark.parametrize(('scheme', 'form', 'option'), [
    ('rtsp', 'rtsp', 'rtsp_flags;listen|listen_timeout;30'),
    pytest.param('rtmp', 'flv', 'listen;1', marks=pytest.mark.skipif(
        int(av.__version__.partition('.')[0]) < 13,
        reason='FFmpeg 6 crashes while it waits for an RTMP client'))])
def test_streams_with_headers(serve: Serve, monkeypatch: pytest.MonkeyPatch, scheme: str,
                              form: str, option: str) -> None:
    monkeypatch.setenv('OPENCV_FFMPEG_CAPTURE_OPTIONS', option)
    server = serve([draw(160, 120, number) for number in range(45)], codec='libx264',
                   scheme=scheme, form=form, pause=0.01,
                   options={'tune': 'zerolatency', 'g': '20', 'sc_threshold': '0',
                            'rtsp_transport': 'tcp'})
    opened = source.open_source(server.url, timeout=LONGEST_SECONDS)
    found = read_all(opened)
    assert opened.needs_every and opened.missed == 0
    numbers = [*range(45)]
    if scheme == 'rtsp':  # it ends without the last packets
        numbers = numbers[:len(found)]
        assert len(numbers) > 40
    assert [frame.video.packet.is_key for frame in found if frame.video] == [
        number % 20 == 0 for number in numbers]
    assert all(parameter_sets('h264', frame.image.tobytes()) for frame in found[::20])
    assert_pictures([frame.video.decode() for frame in found if frame.video], numbers)


@pytest.mark.parametrize(('codec', 'options'), [
    ('mpeg4', {}), ('libx264', {'bf': '2', 'b_strategy': '0', 'sc_threshold': '0'})],
    ids=['codec', 'B frames'])
def test_other_video_is_decoded(
        serve: Serve, monkeypatch: pytest.MonkeyPatch, codec: str, options: dict[str, str],
) -> None:
    images = [draw(160, 120, number) for number in range(COUNT)]
    server = serve(images, codec=codec, options={**options, 'b': '4000000'}, pause=0.01)
    opened = connect(server)
    assert not opened.needs_every
    found = read_all(opened)
    assert {frame.encoding for frame in found} == {'bgr8'}
    assert len(found) + opened.missed == COUNT
    assert_pictures([found[-1].image], [COUNT - 1])


def test_packets_without_room_cost_those_until_a_key_frame(
        serve: Serve, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(stream_module, '_MAX_WAITING', 10)
    sent = groups(COUNT, 55)
    opened = connect(serve(sent))
    join(opened._thread)
    assert contents(read_all(opened)) == sent[55:]
    assert opened.missed == 55


def test_skipped_packets_are_not_missed(serve: Serve) -> None:
    sent = groups(COUNT, 30)
    opened = connect(serve(sent))
    for _ in range(20):
        assert opened.wait(LONGEST_SECONDS)
        opened.skip()
    assert contents(read_all(opened)) == sent[20:]
    assert opened.missed == 0
    with pytest.raises(BrokenFrameError, match='has no frame yet'):
        opened.read()


def test_damaged_packet_costs_those_until_a_key_frame(serve: Serve) -> None:
    sent = groups(COUNT, 30)
    sent[2] = DELIMITER + START_CODE + b'\x41\x80'  # a header without its end
    opened = connect(serve(sent))
    assert contents(read_all(opened)) == [*sent[:2], *sent[30:]]
    assert opened.missed == 28


def test_noise_is_no_video() -> None:
    with socket.create_server(('127.0.0.1', 0)) as server:
        def send() -> None:
            for _ in range(2):  # the second one looks for the reason
                connection, _ = server.accept()
                with connection:
                    connection.sendall(bytes(range(256)) * 400)

        sending = Thread(target=send, daemon=True)
        sending.start()
        url = f'tcp://127.0.0.1:{server.getsockname()[1]}'
        with pytest.raises(CaptureError, match='is reachable, but sends no readable video'):
            open_container(url, LONGEST_SECONDS)
        join(sending)


def test_silent_server_is_left() -> None:
    with socket.create_server(('127.0.0.1', 0)) as server, pytest.raises(CaptureError):
        open_container(f'tcp://127.0.0.1:{server.getsockname()[1]}', 0.1)


def test_opencv_decodes_without_pyav(
        serve: Serve, monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(*_: object) -> None:
        raise VideoError('videos need PyAV')

    monkeypatch.setattr(source, 'open_container', fail)
    opened = connect(serve(groups(COUNT, 30), pause=0.01))
    assert not opened.needs_every
    found = read_all(opened)
    assert {frame.encoding for frame in found} == {'bgr8'}


@pytest.mark.parametrize('scheme', ['rtsp', 'RTSP', 'tcp', 'rtmp'])
def test_closed_port(scheme: str) -> None:
    url = f'{scheme}://127.0.0.1:{free_port()}/a'
    with pytest.raises(UnavailableError, match='Connection refused'):
        source.open_source(url, timeout=1.0)


def test_options_of_the_environment(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv('OPENCV_FFMPEG_CAPTURE_OPTIONS', 'a;b;c|d|')
    opened: list[tuple[str, dict[str, object]]] = []

    def refuse(url: str, **keywords: object) -> None:
        opened.append((url, keywords))
        raise OSError('refused')

    monkeypatch.setattr(av, 'open', refuse)
    url = f'tcp://127.0.0.1:{free_port()}'
    with pytest.raises(CaptureError):
        open_container(url, 3.0)
    (found, keywords), = opened
    assert found == url and keywords['timeout'] == 3.0
    assert keywords['options'] == {'a': 'b;c', 'd': ''}
