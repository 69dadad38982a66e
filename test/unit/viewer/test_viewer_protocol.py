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

"""Messages of the page, from right to hostile."""

from __future__ import annotations

import json

from opencv_tools.video.packet import VideoPacket
from opencv_tools.viewer.errors import RequestError
from opencv_tools.viewer.protocol import (
    number_of, pack_frame, pack_video, parse_codecs, parse_message, parse_options, step_width,
    topic_of, unpack_frame, unpack_video, ViewOptions)
from opencv_tools.viewer.region import Region
import pytest

#: Part of an image, and the size of the image.
PLACE = (2, 4, 320, 240, 640, 480)


def test_head_of_video() -> None:
    packet = VideoPacket(codec='h264', data=b'DATA', is_key=True, width=640, height=479)
    message = pack_video(7, 2**32 + 5, 12.25, 13.5, packet, 2**32 + 9, 'avc1.42C01F')
    assert message.hex() == '80000007' '00000005' '4028800000000000' '402b000000000000' + (
        '01' '0b' '0280' '01df' '00000009') + b'avc1.42C01FDATA'.hex()
    assert unpack_video(message) == (
        7, 5, 12.25, 13.5, True, (640, 479), 9, 'avc1.42C01F', b'DATA')
    assert unpack_video(pack_frame(7, 5, 12.25, 13.5, PLACE, b'JPEG')) is None


def test_codecs_of_a_page() -> None:
    assert parse_codecs(['h264', 'vp9', 'av1', 'h264']) == {'h264', 'av1'}
    assert parse_codecs([]) == frozenset()


@pytest.mark.parametrize('names', [None, 'h264', {'h264': 1}, [1], ['h' * 17], ['h264'] * 9, [[]]])
def test_invalid_codecs_are_refused(names: object) -> None:
    with pytest.raises(RequestError, match='codecs'):
        parse_codecs(names)


@pytest.mark.parametrize(('name', 'base'), [
    ('/a/compressed', '/a'), ('/a/ffmpeg', '/a'), ('a/foxglove', '/a'), ('/ffmpeg', '/ffmpeg'),
    ('/a/ffmpeg/foxglove', '/a/ffmpeg'), ('/a_ffmpeg', '/a_ffmpeg')])
def test_end_of_a_transport(name: str, base: str) -> None:
    assert topic_of(name) == base


def test_frame_has_a_head_of_48_bytes() -> None:
    message = pack_frame(7, 2**32 + 5, 12.25, 13.5, PLACE, b'JPEG')
    assert message.hex() == '00000007' '00000005' '4028800000000000' '402b000000000000' + (
        '00000002' '00000004' '00000140' '000000f0' '00000280' '000001e0') + b'JPEG'.hex()
    assert unpack_frame(message) == (7, 5, 12.25, 13.5, PLACE, b'JPEG')


@pytest.mark.parametrize('text', [
    b'{}', '', 'x', '[1]', '1', 'null', '"a"', '{"a": NaN}', '{"a": Infinity}', '[' * 4000,
    '{"a":' * 600, '9' * 4000])
def test_rubbish_is_refused(text: str | bytes) -> None:
    with pytest.raises(RequestError) as caught:
        parse_message(text)
    assert len(str(caught.value)) < 200


def test_options_of_a_subscription() -> None:
    assert parse_options(parse_message('{"subscribe": "/a"}')) == ViewOptions()
    assert parse_options(json.loads(
        '{"width": 640, "quality": 80, "rate": 10, "fixed": true, "range": [-1, 2.5]}')) == (
            ViewOptions(width=640, quality=80, rate=10, fixed=True, limits=(-1, 2.5)))
    assert parse_options({'region': [2, 4, 320, 240], 'looks': True, 'held': True}) == (
        ViewOptions(region=Region(x=2, y=4, width=320, height=240), looks=True, held=True))
    assert parse_options({'range': None}).limits is None


@pytest.mark.parametrize('message', [
    {'width': -1}, {'width': 65_536}, {'width': '640'}, {'width': True}, {'width': None},
    {'width': [1]}, {'quality': 101}, {'rate': 1001}, {'rate': -1}, {'rate': 10**400},
    {'range': [1]}, {'range': 5}, {'range': [1, 'a']}, {'range': [1, 10**400]},
    {'range': [0, 1e308]}, {'range': [-1e301, 0]}, {'range': [4000, 300]}, {'range': [5, 5]},
    {'region': 5}, {'region': [0, 0, 1]}, {'region': [0, 0, 1, 1, 1]},
    {'region': [-1, 0, 1, 1]}, {'region': [0, 0, 0, 1]}, {'region': [0, 0, 1, 2**32]},
    {'region': [0, 0, 1, '1']}, {'region': [0, 0, 1, None]}, {'region': [0, 0, 1, 10**400]}])
def test_invalid_options_are_refused(message: dict[str, object]) -> None:
    with pytest.raises(RequestError, match=next(iter(message))) as caught:
        parse_options(message)
    assert len(str(caught.value)) < 200


def test_names_of_topics() -> None:
    assert topic_of('/a/b') == topic_of('a/b') == topic_of('/a/b/compressed') == '/a/b'
    assert topic_of('/compressed') == '/compressed'
    for wrong in (None, '', 5, ['/a'], 'a' * 257):
        with pytest.raises(RequestError):
            topic_of(wrong)


@pytest.mark.parametrize(('width', 'expected'), [
    (0, 0), (1, 160), (160, 160), (161, 240), (700, 960), (1920, 1920), (1921, 0)])
def test_widths_are_shared(width: int, expected: int) -> None:
    assert step_width(width) == expected


def test_numbers_in_urls() -> None:
    assert number_of('80', 'quality', 0, 100) == 80
    for wrong in ('', 'a', 'nan', 'inf', '101', '-1', '1e999'):
        with pytest.raises(RequestError, match='quality'):
            number_of(wrong, 'quality', 0, 100)
