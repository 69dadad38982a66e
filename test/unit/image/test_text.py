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

"""Safe printing of texts of unknown origin on a console."""

from __future__ import annotations

import json
from pathlib import Path
import time
from types import SimpleNamespace

from hypothesis import given, strategies as st
from opencv_tools.base.text import enumerated, printable, without_password
from opencv_tools.capture.errors import BrokenFrameError, CaptureError
from opencv_tools.capture.image_files import ImageFileSource
from opencv_tools.capture.source import open_source
from opencv_tools.capture.urls import describe_failure
from opencv_tools.cv_bridge import CvBridge
from opencv_tools.image.cdr import WireCompressedImage, WireHeader, WireImage
from opencv_tools.image.encodings import find_desired, find_encoding
from opencv_tools.image.errors import EncodingError, ImageError
from opencv_tools.nodes.command_line import check_ros_arguments
from opencv_tools.nodes.declaration import describe_unknown
from opencv_tools.nodes.publisher.parameters import PARAMETERS
from opencv_tools.recording.errors import RecordingError
from opencv_tools.recording.folder import Folder
from opencv_tools.recording.naming import FileNames
from opencv_tools.recording.numbering import Numbering
from opencv_tools.topics.errors import ParameterError
from opencv_tools.topics.topic_discovery import _describe_node, _NAME
import pytest
from sensor_msgs.msg import Image
from waiting import LONGEST_SECONDS

# This text sets the title of the terminal, clears the screen and starts a new line.
HOSTILE = '\x1b]0;owned\x07\x1b[2J\n[INFO] [1.0] [image_subscriber]: \x9b31m\u202edlrow'


@pytest.mark.parametrize(('text', 'shown'), [
    ('bgr8', 'bgr8'), ('', ''), ('Kamera Süd 東', 'Kamera Süd 東'), ("it's \\ \"", "it's \\ \""),
    ('a\nb\r\t\0', r'a\nb\r\t\x00'), ('\x1b[2J', r'\x1b[2J'), ('\x9b', r'\x9b'),
    ('\u202e', r'\u202e'), ('\u2028', r'\u2028'), ('\udcff', r'\udcff'),
    ('\U000e0001', r'\U000e0001'),
    ('a' * 200, 'a' * 200), ('a' * 201, 'a' * 197 + '...'), ('\n' * 200, r'\n' * 98 + '\\...')])
def test_text_is_printable_and_short(text: str, shown: str) -> None:
    assert printable(text) == shown
    assert printable(text).isprintable()


@pytest.mark.parametrize('longest', [1, 3, 4, 20])
def test_text_has_the_requested_length(longest: int) -> None:
    for text in ('a' * 10**6, '\n' * 10**6):
        assert len(printable(text, longest)) <= max(3, longest)


@pytest.mark.parametrize(('url', 'shown'), [
    ('rtsp://me:secret@host:554/a', 'rtsp://***@host:554/a'),
    ('rtsp://:s3@cret@host/a', 'rtsp://***@host/a'),
    ('rtsp://token@host/a', 'rtsp://***@host/a'), ('rtsp:/me:s3@cret@host/a', 'rtsp:/***@host/a'),
    ('file:/a:b@c', 'file:/a:b@c'), ('/home/a:/b@c', '/home/a:/b@c'), ('C:/x@y', 'C:/x@y'),
    ('http://host:8080/a@b', 'http://***@b'),  # a password may have a / too
    ('rtsp://:secret', 'rtsp://:secret'), ('udp://@239.0.0.1:1234', 'udp://@239.0.0.1:1234'),
    ('file:///a@b/c', 'file:///a@b/c'), ('package://a/b@c', 'package://a/b@c'),
    ('rtsp://a:s@x is not rtsp://b:t@y', 'rtsp://***@y'),
    ('rtsp://***@x is not rtsp://b:t@y', 'rtsp://***@x is not rtsp://***@y'),
    ('rtsp://a:s@x is not rtsp://***@y', 'rtsp://***@x is not rtsp://***@y'),
    ('rtsp://a:s\nt@x\nfailed', r'rtsp://***@x\nfailed'),
    ('rtsp://a:pass=s@x/y', 'rtsp://***'), ('http://x/a?pwd=s@t&b=1', 'http://***&b=1'),
    ('srt://x:9000?mode=caller&passphrase=s', 'srt://x:9000?mode=caller&passphrase=***'),
    ('http://x/a?access_token=s', 'http://x/a?access_token=***'),
    ('rtsp://x/user=me_password=s_channel=1', 'rtsp://x/user=me_password=***'),
    ('GET /ws?token=s (1.2.3.4)', 'GET /ws?token=***'), ('/key=3/a.png', '/key=3/a.png'),
    ('http://host/a?user=me&password=secret&x=1', 'http://host/a?user=me&password=***&x=1'),
    ('http://host/a?PWD=secret', 'http://host/a?PWD=***'),
    ('http://host/\x1b[2J', r'http://host/\x1b[2J'), ('/a:b@c', '/a:b@c'), ('0', '0')])
def test_url_is_printed_without_its_password(url: str, shown: str) -> None:
    assert without_password(url) == shown


@given(st.text(), st.text(), st.sampled_from(('rtsp', 'http', 'x')), st.booleans())
def test_no_part_of_a_password_is_printed(
        first: str, last: str, scheme: str, is_value: bool) -> None:
    password = f'{first}SECRET{last}'
    url = (f'{scheme}://host/a?user=me&password={password.replace("&", "")}' if is_value
           else f'{scheme}://me:{password}@host:554/a')
    shown = without_password(url)
    assert 'SECRET' not in shown
    assert without_password(f'{shown} failed: {shown}') == f'{shown} failed: {shown}'
    if not is_value and '=' not in password:
        assert shown == f'{scheme}://***@host:554/a'


@pytest.mark.parametrize('unit', ['://a', 'rtsp://@', '?key=', '&key=a', '://***@'])
def test_passwords_of_a_long_text_are_found_soon(unit: str) -> None:
    began = time.process_time()
    without_password(unit * 20_000)
    assert time.process_time() - began < LONGEST_SECONDS  # many minutes if it were quadratic


@pytest.mark.parametrize('find', [find_encoding, find_desired])
def test_unknown_encoding_is_printed_safely(find: object) -> None:
    with pytest.raises(EncodingError) as raised:
        find(HOSTILE)
    assert str(raised.value).isprintable()
    assert 'owned' in str(raised.value)


def test_unknown_format_is_printed_safely() -> None:
    image = CvBridge().imgmsg_to_cv2(Image(encoding='mono8', height=1, width=1, step=1, data=[0]))
    with pytest.raises(TypeError) as raised:
        CvBridge().cv2_to_compressed_imgmsg(image, HOSTILE)
    assert str(raised.value).isprintable()


@pytest.mark.parametrize('text', [HOSTILE, 'a' * 10**6], ids=['hostile', 'long'])
def test_description_of_a_message_is_printable(text: str) -> None:
    header = WireHeader(0, 0, '')
    for message in (
            WireImage(header=header, height=1, width=1, encoding=text, is_bigendian=False, step=1,
                      data=b'x'),
            WireCompressedImage(header=header, format=text, data=b'x')):
        assert message.description.isprintable()
        assert len(message.description) < 80


def test_names_of_the_ros_graph_are_printed_safely() -> None:
    node = SimpleNamespace(node_namespace=f'/{HOSTILE}', node_name=HOSTILE)
    shown = _describe_node(node)
    assert shown.isprintable()
    assert len(shown) < 300


@pytest.mark.parametrize(('texts', 'further', 'shown'), [
    ([], 0, ''), (['a'], 0, 'a'), (['a', 'b'], 0, 'a, b'), (['a', 'b', 'c'], 0, 'a, b and 1 more'),
    (['a', 'b'], 3, 'a, b and 3 more'), (['a', 'b', 'c'], 3, 'a, b and 4 more')])
def test_enumerated_texts(texts: list[str], further: int, shown: str) -> None:
    assert enumerated(texts, 2, further) == shown


@pytest.mark.parametrize(('topic', 'is_one'), [
    ('/video_frames', True), ('/a/b_1', True), ('/a b', False), ('/$(reboot)', False),
    ('/a\n', False), ('a', False), ('', False)])
def test_only_valid_topic_names_are_offered(topic: str, is_one: bool) -> None:
    assert bool(_NAME.fullmatch(topic)) is is_one


def test_names_of_parameters_are_printed_safely(tmp_path: Path) -> None:
    assert describe_unknown(HOSTILE, PARAMETERS).isprintable()
    path = tmp_path / 'params.yaml'
    path.write_text(json.dumps({HOSTILE: {'ros__parameters': {'a': 1}}}))
    with pytest.raises(ParameterError) as raised:
        check_ros_arguments(['x', '--ros-args', '--params-file', str(path)],
                            'img_publisher', 'image_publisher', PARAMETERS)
    assert str(raised.value).isprintable()


def test_source_is_printed_without_its_password() -> None:
    flip = next(parameter for parameter in PARAMETERS if parameter.name == 'flip')
    for message in (describe_failure('nonsense://me:secret@host'),
                    describe_failure('rtsp://me:secret@[host')):
        assert '://***@' in message
        assert 'secret' not in message
    with pytest.raises(ParameterError) as raised:
        flip.accept('rtsp://me:secret@host' + 'a' * 10**5)
    assert 'secret' not in str(raised.value)
    assert len(str(raised.value)) < 5000


def test_names_of_files_are_printed_safely(tmp_path: Path) -> None:
    picture = tmp_path / 'a\x1b[2J\n\udcff.png'
    with pytest.raises(CaptureError) as raised:
        open_source(str(picture))
    assert str(raised.value).isprintable()
    picture.write_bytes(b'nothing')
    with pytest.raises(BrokenFrameError) as raised:
        ImageFileSource([picture], str(picture)).read()
    assert str(raised.value).isprintable()
    (tmp_path / '\x1b[2J.png').touch()
    folder = Folder(tmp_path)
    with pytest.raises(RecordingError) as raised:
        Numbering(FileNames('{frame_id}.png'), folder, 'error')
    folder.close()
    assert str(raised.value).isprintable()


def test_image_error_has_a_bounded_length() -> None:
    with pytest.raises(ImageError) as raised:
        find_encoding('x' * 10**7)
    assert len(str(raised.value)) < 200
