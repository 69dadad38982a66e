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

"""What users get wrong: one sentence with the value and the remedy, and an exit status."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from conftest import NodeProcess
import pytest

Start = Callable[..., NodeProcess]

FAILED = 1
BAD_USAGE = 2

PUBLISHER = {
    'no such device number': (FAILED, {'source': 987, 'reconnect': 'never'},
                              'there is no camera /dev/video987'),
    'no such device': (FAILED, {'source': '/dev/video987', 'reconnect': 'never'},
                       'there is no camera /dev/video987'),
    'no camera': (FAILED, {'source': '/dev/null'}, '/dev/null is not a camera'),
    'no such file': (FAILED, {'source': 'none.mp4'},
                     'none.mp4 cannot be opened: No such file or directory'),
    'a mistyped pattern': (FAILED, {'source': 'patern:64x48'},
                           'No such file or directory; did you mean pattern:64x48?'),
    'a text named mp4': (FAILED, {'source': 'text.mp4'},
                         'text.mp4 cannot be opened as a video: it is damaged or not a video'),
    'a text named png': (FAILED, {'source': 'text.png'},
                         'text.png cannot be read: 5 bytes are not a picture'),
    'a folder without pictures': (FAILED, {'source': 'empty'}, 'there is no picture in empty'),
    'a stream that is not there': (
        FAILED, {'source': 'rtsp://127.0.0.1:9/x', 'reconnect': 'never'},
        'rtsp://127.0.0.1:9/x is not reachable: 127.0.0.1 port 9: Connection refused'),
    'no source': (BAD_USAGE, {'source': "''"}, "parameter source is '': name a camera"),
    'a wrong pattern': (BAD_USAGE, {'source': 'pattern:big'}, 'as in pattern:640x480@30'),
    'unknown encoding': (BAD_USAGE, {'source': 'pattern', 'encoding': 'bgr9'},
                         "parameter encoding is 'bgr9': give one of 'rgb8'"),
    'negative rate': (BAD_USAGE, {'source': 'pattern', 'publish_rate': -1.0},
                      'parameter publish_rate is -1.0: give a number from 0 to 1000'),
    'no rate': (BAD_USAGE, {'source': 'pattern', 'publish_rate': 'fast'},
                "parameter publish_rate is 'fast': give a number"),
    'half a frame': (BAD_USAGE, {'source': 'pattern', 'max_frames': 1.5},
                     'parameter max_frames is 1.5: give a whole number'),
    'unknown end': (BAD_USAGE, {'source': 'pattern', 'on_end': 'explode'},
                    "parameter on_end is 'explode': give one of 'stop', 'loop', 'hold'"),
    'unknown pixel format': (BAD_USAGE, {'fourcc': 'H264'},
                             "parameter fourcc is 'H264': the known pixel formats are BGR3"),
    'unknown turn': (BAD_USAGE, {'rotate': 45}, 'parameter rotate is 45: give one of 0, 90'),
    'unknown wait': (BAD_USAGE, {'reconnect': 'soon'},
                     "parameter reconnect is 'soon': give forever, never or a number of seconds"),
    'a list': (BAD_USAGE, {'source': '[1, 2]'}, 'parameter source is [1, 2]: give a text'),
    'unknown reliability': (BAD_USAGE, {
        'source': 'pattern', 'qos_overrides./video_frames.publisher.reliability': 'perfect'},
        'video_frames cannot be published: Unexpected QoS override'),
    'negative depth': (BAD_USAGE, {
        'source': 'pattern', 'qos_overrides./video_frames.publisher.depth': -3},
        'depth is -3: give a number from 0'),
}

SUBSCRIBER = {
    'a folder below a file': (FAILED, {'output_dir': 'text.mp4/out'},
                              'output_dir', 'cannot be used: Not a directory'),
    'a folder in /proc': (FAILED, {'output_dir': '/proc/out'}, 'output_dir /proc/out'),
    'no folder': (BAD_USAGE, {'output_dir': "''"}, "parameter output_dir is '': name a folder"),
    'no such field in the name': (BAD_USAGE, {'file_name': 'f{sequence}.png'},
                                  'there is no field {sequence}', '{seq}, {stamp}'),
    'a ring of no size': (BAD_USAGE, {'ring': 'true'}, 'give max_frames, max_duration or'),
    'a ring of videos': (FAILED, {'ring': 'true', 'max_frames': 9, 'file_name': 'clip.mp4'},
                         'a ring deletes the oldest files, and a .mp4 is one file'),
    'a parameter that is not known': (FAILED, {'timeout': 0.3, 'max_frame': 5},
                                      'max_frame is not used; did you mean max_frames?'),
    'files that are an error': (FAILED, {'on_exists': 'error', 'output_dir': '.',
                                         'file_name': 'text.png'},
                                'has text.png already; name another folder'),
    'unknown format': (BAD_USAGE, {'file_name': 'f{seq}.gif'},
                       'the extension is one of .png, .jpg'),
    'unquoted braces': (BAD_USAGE, {'file_name': '{seq}.png'}, 'in quotes within quotes'),
    'negative timeout': (BAD_USAGE, {'timeout': -1}, 'parameter timeout is -1: give a number'),
    'nobody publishes': (FAILED, {'timeout': 0.3}, 'no frame on /video_frames within 0.3 s'),
}


def refuse(start: Start, tmp_path: Path, name: str, status: int, parameters: dict[str, object],
           *texts: str) -> None:
    (tmp_path / 'empty').mkdir()
    (tmp_path / 'text.mp4').write_text('hello')
    (tmp_path / 'text.png').write_text('hello')
    process = start(name, **parameters)
    assert process.finish() == status, process.output
    for text in texts:
        assert text in process.output
    errors = [line for line in process.output.splitlines() if '[ERROR]' in line]
    other = [line for line in process.output.splitlines()
             if not line.startswith(('[ERROR]', '[INFO]', '[WARN]'))]
    assert len(errors) == 1 and not other, process.output


@pytest.mark.parametrize('case', PUBLISHER)
def test_publisher_refuses(start: Start, tmp_path: Path, case: str) -> None:
    refuse(start, tmp_path, 'img_publisher', *PUBLISHER[case])


@pytest.mark.parametrize('case', SUBSCRIBER)
def test_subscriber_refuses(start: Start, tmp_path: Path, case: str) -> None:
    refuse(start, tmp_path, 'img_subscriber', *SUBSCRIBER[case])


@pytest.mark.parametrize(('name', 'words', 'status', 'text'), [
    ('img_publisher', ['--help'], 0, 'frames per second; 0 for the source'),
    ('img_subscriber', ['--help'], 0, 'folder to write to, made when missing'),
    ('img_publisher', ['0'], BAD_USAGE, 'img_publisher: error: unrecognized arguments: 0'),
    ('img_publisher', ['--ros-args', '--nonsense', '--'], BAD_USAGE, '--nonsense'),
    ('img_publisher', ['--ros-args', '-p', 'source', '--'], BAD_USAGE, 'write -p NAME:=VALUE'),
    ('img_publisher', ['--ros-args', '--params-file', '/none.yaml', '--'], BAD_USAGE,
     "Couldn't parse params file: '--params-file /none.yaml'"),
])
def test_command_line(start: Start, name: str, words: list[str], status: int, text: str) -> None:
    process = start(name, *words)
    assert process.finish() == status, process.output
    assert text in process.output


def test_an_unknown_parameter_is_said(start: Start) -> None:
    process = start('img_publisher', sorce=0, source='pattern', max_frames=1)
    assert process.finish() == 0
    assert 'unknown parameter sorce is not used; did you mean source?' in process.output


def test_a_number_where_a_text_or_a_fraction_is_wanted_is_taken(start: Start) -> None:
    process = start('img_publisher', source='pattern', publish_rate=50, max_frames=2, frame_id=7)
    assert process.finish() == 0, process.output
