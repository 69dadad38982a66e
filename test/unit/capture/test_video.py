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

"""Video files as a source, and the diagnosis of a stream that cannot be opened."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from fractions import Fraction
from http.server import BaseHTTPRequestHandler, HTTPServer
from pathlib import Path
import socket
import struct
import sys
from threading import Thread
import wave

import av
from av.container.streams import StreamContainer
from conftest import CLIP, decode_clip
import cv2
import numpy as np
from opencv_tools.base.remedies import installation
from opencv_tools.capture.errors import BrokenFrameError, CaptureError, UnavailableError
from opencv_tools.capture.source import check_source, open_source
from opencv_tools.capture.urls import check_url, describe_failure
from playback import frames_of
import pytest


def test_video_yields_every_frame_and_its_rate() -> None:
    source = open_source(str(CLIP))
    assert source.rate == 25.0 and not source.live
    for expected, frame in zip(decode_clip(), frames_of(source), strict=True):
        assert frame.encoding == 'bgr8'
        assert np.array_equal(frame.image, expected)
    source.rewind()
    assert np.array_equal(source.read().image, decode_clip(1)[0])
    source.close()


COUNT, SIDES = 30, (96, 64)
# The display matrix: what a step to the right and one down become.
TURNS = {(1, 0, 0, 1): 0, (-1, 0, 0, 1): 1, (1, 0, 0, -1): 2, (-1, 0, 0, -1): 3, (0, 1, -1, 0): 4,
         (0, -1, 1, 0): 5, (0, 1, 1, 0): 6, (0, -1, -1, 0): 7}
TURNED = (lambda image: image, np.fliplr, np.flipud, lambda image: np.rot90(image, 2),
          lambda image: np.rot90(image, -1), np.rot90, lambda image: image.swapaxes(0, 1),
          lambda image: np.rot90(image, 2).swapaxes(0, 1))


def write_numbers(path: Path, codec: str = 'libx264', first: int = 0, **options: str) -> Path:
    """
    Write pictures that grow brighter, and the index of an MP4 file before them.

    :param first: number of the pictures before the begin of the file; below 0 it begins later.
    """
    width, height = SIDES
    shown = np.linspace(30, 90, width, dtype=np.uint8)[None].repeat(height, 0)
    with av.open(str(path), 'w', options={'movflags': 'faststart'}) as container:
        try:
            stream = container.add_stream(codec, rate=25, options=options)
        except (ValueError, av.error.FFmpegError):
            pytest.skip(f'this FFmpeg does not encode {codec}')
        stream.width, stream.height, stream.pix_fmt = width, height, 'yuv420p'
        for number in [*range(COUNT), None]:
            frame = None
            if number is not None:
                noise = np.random.default_rng(number).integers(0, 16, shown.shape, np.uint8)
                frame = av.VideoFrame.from_ndarray(
                    shown + noise + np.uint8(3 * number), 'gray').reformat(format='yuv420p')
                frame.pts, frame.time_base = number, Fraction(1, 25)
            for packet in stream.encode(frame):
                if first:
                    packet.pts, packet.dts = packet.pts - first, packet.dts - first
                container.mux(packet)
    return path


def brightness(images: Iterable[np.ndarray]) -> list[float]:
    return [float(image.mean()) for image in images]


@pytest.mark.parametrize(('name', 'codec', 'options'), [
    ('a.mp4', 'libx264', {'flags': '+ildct+ilme', 'x264opts': 'tff=1'}),
    ('a.mkv', 'libx264', {'flags': '+ildct+ilme', 'x264opts': 'bff=1'}),
    ('a.ts', 'libx264', {'flags': '+ildct+ilme', 'x264opts': 'tff=1', 'bf': '2'}),
    ('c.mp4', 'libx264', {'bf': '3'})])
def test_frames_of_any_codec(
        tmp_path: Path, name: str, codec: str, options: dict[str, str]) -> None:
    source = open_source(str(write_numbers(tmp_path / name, codec, **options)))
    found = brightness(frame.image for frame in frames_of(source))
    assert len(found) == COUNT and not source.skip() and source.read() is None
    assert np.diff(found) == pytest.approx(3.0, abs=1.5)


@pytest.mark.parametrize('first', [1, 7, 20])
def test_frames_before_the_begin_of_a_file(tmp_path: Path, first: int) -> None:
    source = open_source(str(write_numbers(tmp_path / 'a.mp4', first=first)))
    positions = [frame.position for frame in frames_of(source)]  # nothing is called damaged
    assert len(positions) in (COUNT - first, COUNT)
    assert np.diff(positions) == pytest.approx(0.04)


@pytest.mark.parametrize('seconds', [(0, 0), (300, 0), (0, 300)])
def test_times_where_the_clock_of_a_file_steps(tmp_path: Path, seconds: tuple[int, ...]) -> None:
    parts = [write_numbers(tmp_path / f'{index}.ts', first=-25 * begin, bf='2').read_bytes()
             for index, begin in enumerate(seconds)]
    path = tmp_path / 'both.ts'
    path.write_bytes(b''.join(parts))
    source = open_source(str(path))
    for _ in range(2):
        positions = [frame.position for frame in frames_of(source)]
        assert len(positions) == 2 * COUNT
        assert np.diff(positions) == pytest.approx(0.04)
        source.rewind()


def test_time_without_frames_in_a_file_is_kept(tmp_path: Path) -> None:
    path = tmp_path / 'pause.mkv'
    with av.open(str(path), 'w') as container:
        stream = container.add_stream('mpeg4', rate=25)
        for seconds in (0, 1, 61):
            frame = av.VideoFrame(stream.width, stream.height)
            frame.pts, frame.time_base = 25 * seconds, Fraction(1, 25)
            container.mux(stream.encode(frame))
        container.mux(stream.encode(None))
    source = open_source(str(path))
    assert [frame.position for frame in frames_of(source)] == [0.0, 1.0, 61.0]


@pytest.mark.parametrize(('name', 'codec', 'pixels', 'is_said'), [
    ('a.mkv', 'ffv1', 'bgra', True), ('a.webm', 'libvpx', 'yuva420p', True),
    ('a.mkv', 'ffv1', 'yuv420p', False), ('a.webm', 'libvpx', 'yuv420p', False)])
def test_alpha_that_is_dropped(
        tmp_path: Path, name: str, codec: str, pixels: str, is_said: bool) -> None:
    path = tmp_path / name
    with av.open(str(path), 'w') as container:
        stream = container.add_stream(
            codec, rate=25, options={'auto-alt-ref': '0'} if codec == 'libvpx' else {})
        stream.width, stream.height, stream.pix_fmt = *SIDES, pixels
        container.mux(stream.encode(av.VideoFrame(*SIDES, pixels)))
        container.mux(stream.encode(None))
    assert open_source(str(path)).warnings == is_said * [
        f'{path} has an alpha channel, which is dropped']


def test_file_with_sound_alone(tmp_path: Path) -> None:
    path = tmp_path / 'sound.wav'
    with wave.open(str(path), 'wb') as sound:
        sound.setnchannels(1)
        sound.setsampwidth(2)
        sound.setframerate(8000)
        sound.writeframes(bytes(8000))
    with pytest.raises(CaptureError, match=r'sound\.wav has no video stream$'):
        open_source(str(path))


@pytest.mark.parametrize('codec', ['libx264', 'mpeg4'])
@pytest.mark.parametrize('reordered', [0, 1, 3])
def test_times_of_an_avi_with_reordered_frames(
        tmp_path: Path, codec: str, reordered: int) -> None:
    source = open_source(str(write_numbers(tmp_path / 'a.avi', codec, bf=str(reordered))))
    positions = [frame.position for frame in frames_of(source)]
    assert len(positions) == COUNT
    assert np.diff(positions) == pytest.approx(0.04)


@pytest.mark.parametrize(('name', 'codec', 'options'), [
    ('a.mp4', 'libx264', {'bf': '3', 'g': '7'}),
    ('a.mkv', 'libx264', {'x264opts': 'open-gop=1:bframes=5:keyint=9'}),
    ('a.mkv', 'libx265', {'x265-params': 'log-level=none:keyint=11'}),
    ('a.mp4', 'mpeg4', {'bf': '2'}), ('a.webm', 'libvpx-vp9', {'lag-in-frames': '9'}),
    ('a.ts', 'libx264', {'bf': '2'}), ('a.avi', 'mpeg4', {'bf': '2'})])
@pytest.mark.parametrize('is_used', [
    lambda number: False, lambda number: number == 13, lambda number: number % 4 in (1, 2),
    lambda number: True], ids=['never', 'once', 'often', 'always'])
@pytest.mark.parametrize('ahead', [1, 3, 25], ids='one of {} ahead'.format)
def test_frames_ahead(tmp_path: Path, name: str, codec: str, options: dict[str, str],
                      is_used: Callable[[int], bool], ahead: int) -> None:
    path = str(write_numbers(tmp_path / name, codec, **options))
    frames = frames_of(open_source(path))
    source = open_source(path)
    for number, expected in enumerate(frames):
        frame = source.read() if number % ahead else source.read_ahead()
        assert frame.position == expected.position
        if is_used(number):
            assert np.array_equal(frame.image, expected.image)
    assert source.read_ahead() is None


def test_frame_ahead_is_decoded_only_if_it_is_used(tmp_path: Path) -> None:
    path = write_numbers(tmp_path / 'a.mp4', bf='0', g='10')
    with av.open(str(path)) as container:
        packets = [packet for packet in container.demux(video=0) if packet.size]
        damaged = [packets[number].pos for number in (5, 14)]
    content = bytearray(path.read_bytes())
    for at in damaged:
        content[at:at + 8] = bytes(8)
    path.write_bytes(content)
    source = open_source(str(path))
    frames = [source.read_ahead() for _ in range(14)]
    assert len({frame.position for frame in frames}) == 14
    with pytest.raises(BrokenFrameError, match='frame 14 of'):
        source.read()
    source.rewind()
    frames = [source.read_ahead() for _ in range(6)]
    with pytest.raises(BrokenFrameError, match='frame 5 of'):
        _ = frames[-1].image


@pytest.mark.skipif(not hasattr(StreamContainer, 'best'), reason='PyAV 12 knows no default')
def test_default_one_of_several_videos(tmp_path: Path) -> None:
    from av.stream import Disposition
    path = tmp_path / 'two.mkv'
    with av.open(str(path), 'w') as container:
        streams = [container.add_stream('mpeg4', rate=25) for _ in range(3)]
        for number, stream in enumerate(streams):
            stream.width = stream.height = 32 * (number + 1)
            stream.pix_fmt = 'yuv420p'
            stream.disposition = Disposition.default if number == 1 else Disposition(0)
        for stream in streams:
            for _ in range(4):
                container.mux(stream.encode(av.VideoFrame(stream.width, stream.height)))
            container.mux(stream.encode(None))
    source = open_source(str(path))
    assert source.read().image.shape == (64, 64, 3)
    assert source.warnings == [f'{path} has 3 videos; that of 64x64 is read']


@pytest.mark.parametrize('matrix', TURNS)
def test_turned_and_mirrored_video(tmp_path: Path, matrix: tuple[int, ...]) -> None:
    path = write_numbers(tmp_path / 'a.mp4')
    upright = open_source(str(path)).read().image
    content = bytearray(path.read_bytes())
    a, b, c, d = (65536 * number for number in matrix)
    struct.pack_into('>9i', content, content.index(b'tkhd') + 44, a, b, 0, c, d, 0, 0, 0, 1 << 30)
    path.write_bytes(content)
    np.testing.assert_array_equal(
        open_source(str(path)).read().image, TURNED[TURNS[matrix]](upright))


@pytest.mark.parametrize('suffix', ['.mp4', '.mkv', '.avi'])
@pytest.mark.parametrize('part', [0.3, 0.66, 0.95])
def test_file_that_is_cut_off(tmp_path: Path, suffix: str, part: float) -> None:
    path = write_numbers(tmp_path / f'a{suffix}')
    content = path.read_bytes()
    begin = content.index(b'mdat' if suffix == '.mp4' else b'movi') if suffix != '.mkv' else 999
    cut = begin + int((len(content) - begin) * part)
    path.write_bytes(content[:cut])
    source, errors, count = open_source(str(path)), [], 0
    while True:
        try:
            frame = source.read()
        except BrokenFrameError as err:
            errors.append(str(err))
            continue
        if frame is None:
            break
        count += 1
    assert count <= COUNT
    assert f'with {cut} of its {len(content)} bytes' in errors[-1]


@pytest.mark.parametrize('is_interlaced', [False, True])
def test_interlaced_video_without_pyav(
        tmp_path: Path, monkeypatch: pytest.MonkeyPatch, is_interlaced: bool) -> None:
    options = {'flags': '+ildct+ilme', 'x264opts': 'tff=1'} if is_interlaced else {}
    path = write_numbers(tmp_path / 'a.mp4', **options)
    monkeypatch.setitem(sys.modules, 'av', None)
    source = open_source(str(path))
    version = tuple(int(part) for part in cv2.__version__.split('.')[:2])
    assert source.warnings == ([
        f'the first 8 pictures of {path} are the same: if it does not begin with a still scene, '
        f'it is interlaced, and OpenCV {cv2.__version__} cannot read it; {installation("av")}'
    ] if is_interlaced and version >= (4, 13) else [])
    assert len([*frames_of(source)]) == COUNT


def test_still_video_without_pyav(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / 'still.avi'
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*'MJPG'), 25, SIDES)
    for _ in range(COUNT):
        writer.write(np.full((*SIDES[::-1], 3), 90, np.uint8))
    writer.release()
    monkeypatch.setitem(sys.modules, 'av', None)
    assert [frame.image.mean() for frame in frames_of(open_source(str(path)))] == (
        pytest.approx([90] * COUNT, abs=2))


@pytest.fixture
def bound() -> Iterator[socket.socket]:
    """Bind a port of this machine without listening on it."""
    with socket.socket() as held:
        held.bind(('127.0.0.1', 0))
        yield held


@pytest.fixture
def server() -> Iterator[str]:
    """Start a web server that answers every request with an error."""
    class Handler(BaseHTTPRequestHandler):

        def do_GET(self) -> None:
            self.send_error(404)

        def log_message(self, *_: object) -> None:
            pass

    with HTTPServer(('127.0.0.1', 0), Handler) as running:
        Thread(target=running.serve_forever, args=(0.01,), daemon=True).start()
        yield f'http://127.0.0.1:{running.server_port}/x'
        running.shutdown()


@pytest.mark.parametrize('scheme', ['rtsp', 'http', 'https', 'rtmp', 'tcp'])
def test_closed_port_is_named(bound: socket.socket, scheme: str) -> None:
    port = bound.getsockname()[1]
    url = f'{scheme}://user@127.0.0.1:{port}/x'
    shown = f'{scheme}://***@127.0.0.1:{port}/x'
    expected = f'{shown} is not reachable: 127.0.0.1 port {port}: Connection refused'
    assert describe_failure(url) == expected
    bound.listen()
    assert describe_failure(url) == (
        f'{shown} cannot be opened as a video: 127.0.0.1 port {port} is reachable, '
        'but sends no readable video')


@pytest.mark.parametrize(('err', 'reason'), [
    (TimeoutError('timed out'), 'no answer in 2 s'),
    (socket.gaierror(socket.EAI_NONAME, 'Name or service not known'), 'Name or service not known'),
    (OSError('of another kind'), 'of another kind')])
@pytest.mark.parametrize(('scheme', 'port'), [('rtsp', 554), ('http', 80), ('https', 443)])
def test_unreachable_server_is_named_with_its_default_port(
        monkeypatch: pytest.MonkeyPatch, err: OSError, reason: str, scheme: str,
        port: int) -> None:
    def refuse(address: tuple[str, int], seconds: float) -> socket.socket:
        assert (address, seconds) == (('camera.example', port), 2.0)
        raise err

    monkeypatch.setattr(socket, 'create_connection', refuse)
    url = f'{scheme}://camera.example/x'
    assert describe_failure(url) == f'{url} is not reachable: camera.example port {port}: {reason}'


@pytest.mark.parametrize('url', [
    'udp://239.0.0.1:5000', 'rtp://127.0.0.1:5000', 'tcp://127.0.0.1'])
def test_urls_without_a_tcp_server_are_not_contacted(
        monkeypatch: pytest.MonkeyPatch, url: str) -> None:
    monkeypatch.setattr(socket, 'create_connection', lambda *_: pytest.fail('called'))
    assert describe_failure(url) == (
        f'{url} cannot be opened as a video: it is unreachable or sends no video')


@pytest.mark.parametrize('url', [
    'rtsp://127.0.0.1:99999/x', 'rtsp://[::1/x', f'http://{"a" * 70}.example/x'])
def test_invalid_url_is_reported_as_such(url: str) -> None:
    assert describe_failure(url).startswith(f'{url} is not a URL: ')


@pytest.mark.parametrize(('user', 'remedy'), [
    ('me:SECRET#12', "write '#' as %23 in the user name and the password"),
    ('me:SECRET/1?2#3', "write '#' as %23, '/' as %2F, '?' as %3F in the user name and the "
                        'password'),
    ('me:[SECRET', "write '[' as %5B in the user name and the password"),
    ('me:SECRET /%23%', "write ' ' as %20, '%' as %25, '/' as %2F in the user name and the "
                        'password')])
def test_remedy_of_a_password_that_makes_no_url(user: str, remedy: str) -> None:
    url = f'rtsp://{user}@127.0.0.1:554/x'
    text = f'the host and the port of this URL cannot be read: {remedy}'
    with pytest.raises(ValueError, match='this URL cannot be read') as raised:
        check_source(url)
    assert str(raised.value) == text
    assert raised.value.__context__ is None  # it quotes a part of the password
    assert describe_failure(url) == f'rtsp://***@127.0.0.1:554/x is not a URL: {text}'


@pytest.mark.parametrize('user', ['me:1234/SECRET', 'me:?SECRET', 'SECRET#1', 'SECRET/1:2'])
def test_part_of_a_password_is_not_taken_for_the_host(
        user: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(socket, 'create_connection', lambda *_: pytest.fail('called'))
    assert describe_failure(f'rtsp://{user}@127.0.0.1/x') == (
        'rtsp://***@127.0.0.1/x cannot be opened as a video: it is unreachable or sends no video; '
        'write / ? # of a user name or password as %2F %3F %23')


@pytest.mark.parametrize('user', [
    'me:SE@CRET', 'me:SE:CRET', 'me:SE%CRET', 'me:SE&CRET=', 'me:SE CRET', 'me:SÉCRET'])
def test_password_that_makes_a_url(user: str) -> None:
    check_source(f'rtsp://{user}@127.0.0.1:554/x')


def test_closed_port_is_a_temporary_failure(bound: socket.socket) -> None:
    url = f'rtsp://127.0.0.1:{bound.getsockname()[1]}/x'
    with pytest.raises(UnavailableError, match=r'is not reachable: .*: Connection refused'):
        open_source(url)


def test_server_without_a_video_differs_from_a_closed_port(server: str) -> None:
    with pytest.raises(CaptureError, match='is reachable, but sends no readable video'):
        open_source(server)


@pytest.mark.parametrize(('url', 'is_valid'), [
    ('rtsp://', False), ('rtsp:///x', False), ('http://:80/x', False), ('rtsp://a b/x', False),
    ('rtsp://u:p@/x', False), ('rtsp://h/x', True), ('udp://@:5000', True), ('srt://:9', True),
    ('http://[::1]:8080/x', True)])
def test_url_without_a_host(url: str, is_valid: bool) -> None:
    if is_valid:
        check_url(url)
    else:
        with pytest.raises(ValueError, match='this URL cannot be read: write HOST:PORT'):
            check_url(url)
