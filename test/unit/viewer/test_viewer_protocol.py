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

from dataclasses import asdict, FrozenInstanceError
import json
import math
from pathlib import Path

from opencv_tools.video.packet import VideoPacket
from opencv_tools.viewer.errors import RequestError
from opencv_tools.viewer.protocol import (
    base_name, finite, MAX_MESSAGE_BYTES, MAX_TOPICS, number_of, pack_frame, pack_video,
    parse_codecs, parse_message, parse_options, parse_point, parse_region, pong, step_width,
    topic_of, unpack_frame, unpack_video, valid_number, ViewRequest)
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
    assert unpack_video(pack_frame(7, 5, (9, 0, ''), 13.5, PLACE, b'JPEG')) is None


def test_codecs_of_a_page() -> None:
    assert parse_codecs(['h264', 'vp9', 'av1', 'h264']) == {'h264', 'av1'}
    assert parse_codecs([]) == frozenset()
    assert parse_codecs(['av1', *(f'{number}' for number in range(6)), 'h' * 16]) == {'av1'}


@pytest.mark.parametrize('names', [None, 'h264', {'h264': 1}, [1], ['h' * 17], ['h264'] * 9])
def test_invalid_codecs_are_refused(names: object) -> None:
    with pytest.raises(RequestError, match='codecs'):
        parse_codecs(names)


@pytest.mark.parametrize(('name', 'base'), [
    ('/a/compressed', '/a'), ('/a/ffmpeg', '/a'), ('a/foxglove', '/a'), ('/ffmpeg', '/ffmpeg'),
    ('/a/ffmpeg/foxglove', '/a/ffmpeg'), ('/a_ffmpeg', '/a_ffmpeg')])
def test_end_of_a_transport(name: str, base: str) -> None:
    assert topic_of(name) == base


def test_frame_has_a_head_of_48_bytes() -> None:
    message = pack_frame(7, 2**32 + 5, (12_250_000_000, 2**32 + 6, 'cam'), 13.5, PLACE, b'JPEG')
    assert message.hex() == '00000007' '00000005' '4028800000000000' '402b000000000000' + (
        '00000002' '00000004' '00000140' '000000f0' '00000280' '000001e0'
        f'{12_250_000_000:016x}' '00000006' '0003') + b'camJPEG'.hex()
    assert unpack_frame(message) == (7, 5, 12.25, 13.5, PLACE, b'JPEG')


@pytest.mark.parametrize('text', [
    b'{}', '', 'x', '[1]', '1', 'null', '"a"', '{"a": NaN}', '{"a": Infinity}', '[' * 4000,
    '{"a":' * 600, '9' * 4000])
def test_rubbish_is_refused(text: str | bytes) -> None:
    with pytest.raises(RequestError) as caught:
        parse_message(text)
    assert len(str(caught.value)) < 200


def test_options_of_a_subscription() -> None:
    assert parse_options(parse_message('{"subscribe": "/a"}')) == ViewRequest()
    assert parse_options(json.loads(
        '{"width": 640, "quality": 80, "rate": 10, "fixed": true, "range": [-1, 2.5]}')) == (
            ViewRequest(width=640, quality=80, rate=10, fixed=True, limits=(-1, 2.5)))
    assert parse_options({'region': [2, 4, 320, 240], 'looks': True, 'held': True}) == (
        ViewRequest(region=Region(x=2, y=4, width=320, height=240), looks=True, held=True))
    assert parse_options({'searched': True}) == ViewRequest(searched=True)
    assert parse_options({'range': None}).limits is None
    assert parse_options({'colors': 'gray', 'video': True}) == ViewRequest(
        colors='gray', video=True)
    assert parse_options({'fixed': 1, 'video': 'true', 'looks': [True], 'held': None}) == (
        ViewRequest())


def test_largest_and_smallest_options() -> None:
    assert parse_options({'width': 65_535, 'quality': 100, 'rate': 1000}) == ViewRequest(
        width=65_535, quality=100, rate=1000.0)
    assert parse_options({'width': 1, 'quality': 1, 'rate': 0.001}) == ViewRequest(
        width=1, quality=1, rate=0.001)
    assert parse_options({'width': 0, 'quality': 0, 'rate': 0}) == ViewRequest()
    assert parse_options({'range': [-1e300, 1e300]}).limits == (-1e300, 1e300)
    assert parse_region([0, 0, 1, 1]) == Region(x=0, y=0, width=1, height=1)
    assert parse_region([2**31] * 4) == Region(x=2**31, y=2**31, width=2**31, height=2**31)
    assert parse_region(None) is None


def test_view_without_requests() -> None:
    options = ViewRequest()
    assert {name: value for name, value in asdict(options).items() if value is not None} == {
        'width': 0, 'quality': 0, 'rate': 0.0, 'colors': 'turbo',
        **dict.fromkeys(('fixed', 'video', 'slow', 'looks', 'held', 'searched'), False)}
    assert options.limits is options.region is None
    with pytest.raises(FrozenInstanceError):
        options.width = 5  # type: ignore[misc]
    with pytest.raises(TypeError):
        ViewRequest(640)  # type: ignore[misc]


@pytest.mark.parametrize(('message', 'text'), [
    ({'width': -1}, "width is '-1': give a number from 0 to 65535"),
    ({'width': 65_536}, "width is '65536': give a number from 0 to 65535"),
    ({'width': '640'}, "width is '640': give a number from 0 to 65535"),
    ({'width': True}, "width is 'True': give a number from 0 to 65535"),
    ({'width': None}, "width is 'None': give a number from 0 to 65535"),
    ({'quality': -0.5}, "quality is '-0.5': give a number from 0 to 100"),
    ({'quality': 100.5}, "quality is '100.5': give a number from 0 to 100"),
    ({'rate': 1001}, "rate is '1001': give a number from 0 to 1000"),
    ({'rate': -1}, "rate is '-1': give a number from 0 to 1000"),
    ({'rate': 10**400}, f"rate is '1{'0' * 39}': give a number from 0 to 1000"),
    ({'range': [1]}, 'range is not a list of two numbers'),
    ({'range': [1, 2, 3]}, 'range is not a list of two numbers'),
    ({'range': '12'}, 'range is not a list of two numbers'),
    ({'range': [1, 'a']}, "range is 'a': give a number from -1e+300 to 1e+300"),
    ({'range': [0, 1.1e300]}, "range is '1.1e+300': give a number from -1e+300 to 1e+300"),
    ({'range': [-1.1e300, 0]}, "range is '-1.1e+300': give a number from -1e+300 to 1e+300"),
    ({'range': [4000, 300]}, 'range is 4000,300: give the lower number first'),
    ({'range': [5, 5]}, 'range is 5,5: give the lower number first'),
    ({'colors': 'g' * 41}, f"colors is '{'g' * 40}': give one of turbo, gray"),
    ({'colors': None}, "colors is 'None': give one of turbo, gray"),
    ({'region': '1111'}, 'region is not a list of four numbers'),
    ({'region': [0, 0, 1]}, 'region is not a list of four numbers'),
    ({'region': [0, 0, 1, 1, 1]}, 'region is not a list of four numbers'),
    ({'region': [-1, 0, 1, 1]}, "region is '-1': give a number from 0 to 2.14748e+09"),
    ({'region': [0, -1, 1, 1]}, "region is '-1': give a number from 0 to 2.14748e+09"),
    ({'region': [0, 0, 0, 1]}, "region is '0': give a number from 1 to 2.14748e+09"),
    ({'region': [0, 0, 1, 0]}, "region is '0': give a number from 1 to 2.14748e+09"),
    ({'region': [0, 0, 1, 2**31 + 1]},
     "region is '2147483649': give a number from 1 to 2.14748e+09")])
def test_invalid_options_are_refused(message: dict[str, object], text: str) -> None:
    with pytest.raises(RequestError) as caught:
        parse_options(message)
    assert str(caught.value) == text


def test_points_of_a_page() -> None:
    assert parse_point([0, 2**31], 'look') == (0, 2**31)
    assert parse_point([7.9, 8], 'look') == (7, 8)
    for wrong in (None, '12', (1, 2), [1], [1, 2, 3]):
        with pytest.raises(RequestError, match=r'^look is not a list of two numbers$'):
            parse_point(wrong, 'look')
    for number in (-1, 2**31 + 1, None):
        for values in ([number, 0], [0, number]):
            with pytest.raises(RequestError) as caught:
                parse_point(values, 'look')
            assert str(caught.value) == (
                f"look is '{number}': give a number from 0 to 2.14748e+09")


def test_numbers_of_messages() -> None:
    found = valid_number(3, 'rate', 3, 4)
    assert (found, type(found)) == (3.0, float)
    assert valid_number(4.0, 'rate', 3, 4) == 4
    for wrong in (2.99, 4.01, math.nan, True, '3'):
        with pytest.raises(RequestError, match=r': give a number from 3 to 4$'):
            valid_number(wrong, 'rate', 3, 4)


def test_answer_to_a_ping(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr('time.time', lambda: 12.25)
    assert pong([1]) == {'pong': [1], 'now': 12.25}


def test_errors_of_messages() -> None:
    for text, error in ((b'{}', 'a binary message is not expected from a page'),
                        ('[1]', 'the message is not an object of JSON'),
                        ('{"a": NaN}', 'the message is not JSON: NaN is not a number of JSON')):
        with pytest.raises(RequestError) as caught:
            parse_message(text)
        assert str(caught.value) == error
    with pytest.raises(RequestError) as caught:
        parse_message('9' * 5000)  # the reason of Python is longer
    assert len(str(caught.value)) == len('the message is not JSON: ') + 80


def test_limits_of_a_page() -> None:
    assert MAX_MESSAGE_BYTES == 4096
    manual = Path(__file__).parents[3] / 'docs' / 'limits.md'
    assert f'| topics in the list | {MAX_TOPICS} topics |' in manual.read_text()


def test_numbers_that_json_can_hold() -> None:
    assert finite(-1.5) == -1.5
    for number in (math.nan, math.inf, -math.inf):
        assert finite(number) is None


def test_base_names_of_given_ends() -> None:
    assert base_name('/a/points', ('/x', '/points')) == '/a'
    assert base_name('/a/compressed', ('/points',)) == '/a/compressed'
    assert base_name('/points', ('/points',)) == '/points'


def test_names_of_topics() -> None:
    assert topic_of('/a/b') == topic_of('a/b') == topic_of('/a/b/compressed') == '/a/b'
    assert topic_of('/compressed') == '/compressed'
    assert topic_of('a') == '/a'
    assert topic_of('/' + 'a' * 255) == '/' + 'a' * 255
    for wrong in (None, '', 5, ['/a'], 'a' * 257):
        with pytest.raises(
                RequestError, match=r'^the name of a topic is missing or too long$'):
            topic_of(wrong)


@pytest.mark.parametrize(('width', 'expected'), [
    (0, 0), (1, 160), (160, 160), (161, 240), (240, 240), (241, 320), (320, 320), (321, 480),
    (480, 480), (481, 640), (640, 640), (641, 960), (960, 960), (961, 1280), (1280, 1280),
    (1281, 1920), (1920, 1920), (1921, 0), (-1, 0)])
def test_widths_are_shared(width: int, expected: int) -> None:
    assert step_width(width) == expected


def test_numbers_in_urls() -> None:
    for text, number in (('80', 80), ('0', 0), (' 100', 100), ('0.5', 0.5)):
        assert number_of(text, 'quality', 0, 100) == number
    for wrong, quoted in (('', ''), ('a', 'a'), ('nan', 'nan'), ('1e999', 'inf'), ('101', '101.0'),
                          ('-1', '-1.0')):
        with pytest.raises(RequestError) as caught:
            number_of(wrong, 'quality', 0, 100)
        assert str(caught.value) == f"quality is '{quoted}': give a number from 0 to 100"
