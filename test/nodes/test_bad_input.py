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

"""Invalid arguments and parameters: one sentence with value and remedy, and an exit status."""

from __future__ import annotations

import ast
from collections.abc import Callable, Iterator
import os
from pathlib import Path
import signal

from conftest import NodeProcess
from opencv_tools import basic_image_publisher, basic_image_subscriber
from opencv_tools.nodes.command_line import check_params_file, check_ros_arguments, load_parameters
from opencv_tools.nodes.parameters import Parameter
from opencv_tools.topics.errors import ParameterError
import pytest
import yaml

Start = Callable[..., NodeProcess]

MAIN = {'img_publisher': basic_image_publisher.main, 'img_subscriber': basic_image_subscriber.main}

FAILED = 1
BAD_USAGE = 2

PUBLISHER = {
    'no such device number': (FAILED, {'source': 987, 'reconnect': 'never'},
                              'camera /dev/video987 does not exist'),
    'no such device': (FAILED, {'source': '/dev/video987', 'reconnect': 'never'},
                       'camera /dev/video987 does not exist'),
    'no camera': (FAILED, {'source': '/dev/null'}, '/dev/null is not a camera'),
    'no such file': (FAILED, {'source': 'none.mp4'},
                     'none.mp4 cannot be opened: No such file or directory'),
    'a file of nobody': (FAILED, {'source': '~nobody_at_all/a.mp4'},
                         '~nobody_at_all/a.mp4 cannot be opened: No such file or directory'),
    'a mistyped pattern': (FAILED, {'source': 'patern:64x48'},
                           'No such file or directory; did you mean pattern:64x48?'),
    'a text named mp4': (FAILED, {'source': 'text.mp4'},
                         'text.mp4 cannot be opened as a video: it is damaged or not a video'),
    'a text named png': (FAILED, {'source': 'text.png'},
                         'text.png cannot be read: 5 bytes are not a picture'),
    'a folder without pictures': (FAILED, {'source': 'empty'}, 'no image file in empty'),
    'a stream that is not there': (
        FAILED, {'source': 'rtsp://127.0.0.1:9/x', 'reconnect': 'never'},
        'rtsp://127.0.0.1:9/x is not reachable: 127.0.0.1 port 9: Connection refused'),
    'a password with #': (
        BAD_USAGE, {'source': 'rtsp://admin:PASS#12@127.0.0.1:9/x'},
        "parameter source is 'rtsp://***@127.0.0.1:9/x': the host and the port of this URL cannot "
        "be read: write '#' as %23 in the user name and the password"),
    'an empty list': (BAD_USAGE, {'topics': '[]'}, 'parameter topics is an empty list, which has '
                      'no type in ROS: leave it out'),
    'no source': (BAD_USAGE, {'source': "''"}, "parameter source is '': give a camera"),
    'a wrong pattern': (BAD_USAGE, {'source': 'pattern:big'}, 'for example pattern:640x480@30'),
    'unknown encoding': (BAD_USAGE, {'source': 'pattern', 'encoding': 'bgr9'},
                         "parameter encoding is 'bgr9': give one of 'rgb8'"),
    'negative rate': (BAD_USAGE, {'source': 'pattern', 'publish_rate': -1.0},
                      'parameter publish_rate is -1.0: give 0, or a number from 0.1 to 1000'),
    'no rate': (BAD_USAGE, {'source': 'pattern', 'publish_rate': 'fast'},
                "parameter publish_rate is 'fast': give 0, or a number"),
    'half a frame': (BAD_USAGE, {'source': 'pattern', 'max_frames': 1.5},
                     'parameter max_frames is 1.5: give a whole number'),
    'unknown end': (BAD_USAGE, {'source': 'pattern', 'on_end': 'explode'},
                    "parameter on_end is 'explode': give one of 'stop', 'loop', 'hold'"),
    'unknown pixel format': (BAD_USAGE, {'fourcc': 'HEVC'},
                             "parameter fourcc is 'HEVC': give a supported pixel format: BGR3"),
    'an encoder that FFmpeg lacks': (
        BAD_USAGE, {'source': 'pattern', 'video_codec': 'foo'},
        "parameter video_codec is 'foo': the installed PyAV has no such encoder; give"),
    'an encoder of pictures': (
        BAD_USAGE, {'source': 'pattern', 'video_codec': 'png'},
        "parameter video_codec is 'png', an encoder for other videos: give one for h264"),
    'a preset of another encoder': (
        BAD_USAGE, {'source': 'pattern', 'video_preset': 'p3'},
        "parameter video_preset is 'p3': give ultrafast or superfast"),
    'a start after the stop': (
        BAD_USAGE, {'source': 'pattern', 'start_frame': 5, 'stop_frame': 5},
        'parameter start_frame is 5, which is not before stop_frame 5: give a smaller'),
    'a first frame of a camera': (
        BAD_USAGE, {'source': '99', 'start_frame': 5},
        'parameter start_frame is 5, but the source 99 is a camera: give a file'),
    'repetitions of a camera': (
        BAD_USAGE, {'source': '/dev/video99', 'loop': 3},
        'parameter loop is 3, but the source /dev/video99 is a camera: give a file'),
    'repetitions of a pattern': (
        BAD_USAGE, {'source': 'pattern', 'loop': 3, 'start_frame': 5},
        'parameter loop is 3, but the source pattern has no end: give stop_frame'),
    'two numbers of repetitions': (
        BAD_USAGE, {'source': 'empty', 'loop': 2, 'on_end': 'loop'},
        'parameter loop is 2, but on_end is loop, which repeats the file forever: give only one'),
    'a name with a path': (BAD_USAGE, {'source': 'pattern', 'camera_name': '../x'},
                           "parameter camera_name is '../x': give up to 128 letters"),
    'unknown turn': (BAD_USAGE, {'rotate': 45}, 'parameter rotate is 45: give one of 0, 90'),
    'unknown wait': (BAD_USAGE, {'reconnect': 'soon'},
                     "parameter reconnect is 'soon': set it to forever, never or a number of"),
    'a list': (BAD_USAGE, {'source': '[1, 2]'}, 'parameter source is [1, 2]: give a text'),
    'unknown reliability': (BAD_USAGE, {
        'source': 'pattern', 'qos_overrides./video_frames.publisher.reliability': 'perfect'},
        'video_frames cannot be published: Unexpected QoS override'),
    **{f'a misspelt {meant}': (BAD_USAGE, {'source': 'pattern', wrong: 5},
                               f'there is no parameter {wrong}: did you mean {meant}?')
       for wrong, meant in (('max_frame', 'max_frames'), ('stop_fram', 'stop_frame'),
                            ('loops', 'loop'), ('onend', 'on_end'),
                            ('reconect', 'reconnect'))},
    'negative depth': (BAD_USAGE, {
        'source': 'pattern', 'qos_overrides./video_frames.publisher.depth': -3},
        'depth is -3: give a number from 0'),
}

SUBSCRIBER = {
    'a folder below a file': (FAILED, {'output_dir': 'text.mp4/out'},
                              'output_dir', 'cannot be used: Not a directory'),
    'a folder of nobody': (FAILED, {'output_dir': '~no_such_user/out'},
                           'output_dir ~no_such_user/out cannot be used', 'write ./~no_such_user'),
    'a folder in /proc': (FAILED, {'output_dir': '/proc/out'}, 'output_dir /proc/out'),
    'no folder': (BAD_USAGE, {'output_dir': "''"}, "output_dir is '': set it to a folder"),
    'a field in the folder': (BAD_USAGE, {'output_dir': 'out/{stamp:.3f}'},
                              "output_dir is 'out/{stamp:.3f}': a folder cannot have the field"),
    'no such field in the name': (BAD_USAGE, {'file_name': 'f{sequence}.png'},
                                  'the field {sequence} is unknown', '{seq}, {stamp}'),
    'a ring of no size': (BAD_USAGE, {'ring': 'true'}, 'set max_frames, max_duration or'),
    'a split of images': (BAD_USAGE, {'split_bytes': 100, 'file_name': 'a.png'},
                          'a .png file has one frame and cannot be split; remove'),
    'a parameter that is not known': (FAILED, {'timeout': 0.3, 'writer': 5},
                                      'writer is not used; did you mean writers?'),
    **{f'a misspelt {meant}': (BAD_USAGE, {wrong: 5},
                               f'there is no parameter {wrong}: did you mean {meant}?')
       for wrong, meant in (('max_frame', 'max_frames'), ('max_duratio', 'max_duration'),
                            ('max_byte', 'max_bytes'), ('timout', 'timeout'),
                            ('every', 'every_n'), ('max_rat', 'max_rate'), ('rings', 'ring'))},
    'files that are an error': (FAILED, {'on_exists': 'error', 'output_dir': '.',
                                         'file_name': 'text.png'},
                                'already contains text.png; set output_dir'),
    'unknown format': (BAD_USAGE, {'file_name': 'f{seq}.gif'},
                       "the extension '.gif' is unknown; use one of .png, .jpg"),
    'unquoted braces': (BAD_USAGE, {'file_name': '{seq}.png'}, 'in quotes within quotes'),
    'negative timeout': (BAD_USAGE, {'timeout': -1}, 'parameter timeout is -1: give a number'),
    'nobody publishes': (FAILED, {'timeout': 0.3}, 'no frame on /video_frames within 0.3 s'),
}


# One of each outcome, and those of which libraries might say more; the others run in here.
IN_A_PROCESS = (('img_publisher', 'no such device number'), ('img_publisher', 'unknown encoding'),
                ('img_publisher', 'a text named mp4'),
                ('img_publisher', 'a stream that is not there'),
                ('img_subscriber', 'nobody publishes'), ('img_subscriber', 'unknown format'))
CASES = {'img_publisher': PUBLISHER, 'img_subscriber': SUBSCRIBER}


@pytest.fixture
def files(tmp_path: Path) -> None:
    """Create the files of the cases."""
    (tmp_path / 'empty').mkdir()
    (tmp_path / 'text.mp4').write_text('hello')
    (tmp_path / 'text.png').write_text('hello')


Run = Callable[..., tuple[int, str]]


@pytest.fixture
def run(domain: int, files: None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
        capfd: pytest.CaptureFixture[str]) -> Iterator[Run]:
    """Run an executable in this process: its exit status, and what is on the console."""
    handlers = {number: signal.getsignal(number) for number in (
        signal.SIGINT, signal.SIGTERM, signal.SIGHUP)}
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv('OPENCV_TOOLS_TRANSPORT', 'default')  # this process's malloc is not theirs

    def _run(name: str, *words: str) -> tuple[int, str]:
        try:
            status = MAIN[name]([name, *words])
        except SystemExit as end:
            status = end.code
        captured = capfd.readouterr()
        return status, captured.out + captured.err

    yield _run
    for number, handler in handlers.items():
        signal.signal(number, handler)


def check_refusal(output: str, *texts: str) -> None:
    """Check that it is one sentence with what is wrong."""
    for text in texts:
        assert text in output
    errors = [line for line in output.splitlines() if '[ERROR]' in line]
    other = [line for line in output.splitlines()
             if not line.startswith(('[ERROR]', '[INFO]', '[WARN]'))]
    assert len(errors) == 1 and not other, output


def assignments(parameters: dict[str, object]) -> list[str]:
    return [word for key, value in parameters.items() for word in ('-p', f'{key}:={value}')]


@pytest.mark.parametrize(('name', 'case'), [
    (name, case) for name, cases in CASES.items() for case in cases
    if (name, case) not in IN_A_PROCESS])
def test_refused_arguments(run: Run, name: str, case: str) -> None:
    status, parameters, *texts = CASES[name][case]
    ended, output = run(name, '--ros-args', *assignments(parameters))
    assert ended == status, output
    check_refusal(output, *texts)


@pytest.mark.quick_cases(2)
@pytest.mark.fresh
@pytest.mark.parametrize(('name', 'case'), IN_A_PROCESS)
def test_exit_of_a_refusing_process(start: Start, files: None, name: str, case: str) -> None:
    status, parameters, *texts = CASES[name][case]
    process = start(name, **parameters)
    assert process.finish() == status, process.output
    check_refusal(process.output, *texts)


@pytest.mark.parametrize(('name', 'words', 'status', 'text'), [
    ('img_publisher', ['--help'], 0, 'Frame rate of the published images in Hz; 0 for the'),
    ('img_publisher', ['--help'], 0, '  double: 0 or 0.1 to 1000 [10.0]; at run time\n'),
    ('img_publisher', ['--help'], 0, 'img_publisher --ros-args -p source:=clip.mp4'),
    ('img_publisher', ['--help'], 0, 'OPENCV_TOOLS_TRANSPORT=default  do not configure Fast DDS'),
    ('img_subscriber', ['--help'], 0, 'OPENCV_TOOLS_TRANSPORT=default  do not configure Fast DDS'),
    ('img_publisher', ['--help'], 0, 'to compare'),
    ('img_subscriber', ['--help'], 0, 'Folder of the recorded files; created if'),
    ('img_subscriber', ['--help'], 0, 'with {seq}, {stamp}, {sec}, {nanosec}, '),
    ('img_publisher', ['0'], BAD_USAGE, 'arguments: 0; write --ros-args -p source:=0\n'),
    ('img_publisher', ['a', 'b'], BAD_USAGE, 'arguments: a b; parameters are written --ros-args'),
    ('img_publisher', ['--source', '0'], BAD_USAGE, '; write --ros-args -p source:=0\n'),
    ('img_publisher', ['--max-frames=7'], BAD_USAGE, '; write --ros-args -p max_frames:=7\n'),
    ('img_publisher', ['--loop', '--x'], BAD_USAGE, '; write --ros-args -p loop:=VALUE\n'),
    ('img_subscriber', ['--source', '0'], BAD_USAGE,
     '--source 0; parameters are written --ros-args -p NAME:=VALUE\n'),
    ('img_subscriber', ['0'], BAD_USAGE,
     'arguments: 0; parameters are written --ros-args -p NAME:=VALUE\n'),
    ('img_publisher', ['source:=pattern'], BAD_USAGE, 'write --ros-args -p source:=pattern\n'),
    ('img_publisher', ['--ros-args', '-r', 'source:=pattern'], BAD_USAGE,
     'write --ros-args -p source:=pattern\n'),
    ('img_subscriber', ['--ros-args', '--remap', 'image_subscriber:timeout:=3'], BAD_USAGE,
     'timeout is a parameter: write --ros-args -p image_subscriber:timeout:=3\n'),
    ('img_publisher', ['--ros-args', '--nonsense', '--'], BAD_USAGE, '--nonsense'),
    ('img_publisher', ['--ros-args', '-p', 'source', '--'], BAD_USAGE, 'write -p NAME:=VALUE'),
    ('img_publisher', ['--ros-args', '--params-file', '/none.yaml', '--'], BAD_USAGE,
     "Couldn't parse params file: '--params-file /none.yaml'"),
])
def test_command_line(run: Run, name: str, words: list[str], status: int, text: str) -> None:
    ended, output = run(name, *words)
    assert ended == status, output
    assert text in output


def remarks_about_sections(folder: Path, sections: str, words: str) -> list[str]:
    """Return what `check_ros_arguments` says about a file that has a source in each section."""
    file = folder / 'p.yaml'
    file.write_text(yaml.safe_dump(
        {name: {'ros__parameters': {'source': 'pattern'}} for name in sections.split()}))
    # ROS takes a rule outside of its arguments too.
    rule = words.split() if words.startswith('-r') else ['--', *words.split(), '--ros-args']
    args = ['img_publisher', '--ros-args', *rule, '--params-file', str(file)]
    table = (Parameter('source', '0', 'a source'),)
    return check_ros_arguments(args, 'img_publisher', 'image_publisher', table)


@pytest.mark.parametrize(('sections', 'words', 'count'), [
    ('image_publisher', '', 0), ('/**', '', 0), ('/**/image_publisher', '', 0),
    ('/front/image_publisher', '', 0), ('img_publisher image_publisher', '', 1),
    ('eye', '-r __node:=eye', 0), ('eye', '__node:=eye', 0),
    ('img_publisher', '-r image_publisher:__name:=img_publisher', 0), ('', '', 0)])
def test_accepted_sections_of_a_parameter_file(
        tmp_path: Path, sections: str, words: str, count: int) -> None:
    remarks = remarks_about_sections(tmp_path, sections, words)
    assert len(remarks) == count
    assert all('write image_publisher: instead of img_publisher:' in text for text in remarks)


@pytest.mark.parametrize(('sections', 'words', 'reason'), [
    ('img_publisher', '', 'p.yaml has parameters for img_publisher, but img_publisher is the '
     'executable and image_publisher is the node: write image_publisher: instead'),
    ('/a/img_publisher', '', 'write /a/image_publisher: instead of /a/img_publisher:'),
    ('camera viewer', '', 'for camera, viewer, but none for this node: write image_publisher:, '),
    ('image_publisher', '-r __node:=eye', 'none for this node: write eye:')])
def test_refused_sections_of_a_parameter_file(
        tmp_path: Path, sections: str, words: str, reason: str) -> None:
    with pytest.raises(ParameterError) as caught:
        remarks_about_sections(tmp_path, sections, words)
    assert reason in str(caught.value)


def test_parameter_file_for_another_node(run: Run, tmp_path: Path) -> None:
    (tmp_path / 'p.yaml').write_text('img_subscriber:\n  ros__parameters:\n    timeout: 0.1\n')
    ended, output = run('img_subscriber', '--ros-args', '--params-file', 'p.yaml')
    assert ended == BAD_USAGE
    check_refusal(output, 'p.yaml', 'write image_subscriber: instead of img_subscriber:')
    with (tmp_path / 'p.yaml').open('a') as file:
        file.write('/**:\n  ros__parameters:\n    source: none.mp4\n')
    ended, output = run('img_publisher', '--ros-args', '--params-file', 'p.yaml')
    assert ended == FAILED
    assert 'none.mp4 cannot be opened' in output


@pytest.mark.parametrize('name', ['', '.', 'none.yaml'])
def test_launch_with_a_missing_params_file(
        tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / 'p.yaml').touch()
    check_params_file('p.yaml')
    with pytest.raises(ParameterError, match=f'params_file is {name!r}: give a file that exists'):
        check_params_file(name)
    for launch_file in (Path(__file__).parents[2] / 'launch').glob('*.launch.py'):
        calls = [call for call in ast.walk(ast.parse(launch_file.read_text()))
                 if isinstance(call, ast.Call) and ast.unparse(call.func) == 'check_params_file']
        assert len(calls) == 1, launch_file.name


def test_parameter_files_left_to_rcl(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / 'pipe')  # whoever opens it waits for a writer
    for name, content in {
            'large': 'a: b\n' * 250_000, 'deep': '[' * 5000, 'alias': 'a: &a [1]\nb: *a\n',
            'text': 'a: [\n', 'bytes': '\ud800'}.items():
        (tmp_path / name).write_bytes(content.encode('utf-8', 'surrogatepass'))
    for name in ('pipe', 'large', 'deep', 'alias', 'text', 'bytes', 'none', '/dev/zero', '.'):
        with pytest.raises((OSError, ValueError, yaml.YAMLError)):
            load_parameters(tmp_path / name)
        assert check_ros_arguments(
            ['x', '--ros-args', '--params-file', str(tmp_path / name)], 'x', 'y', ()) == []


def test_unknown_parameter(run: Run) -> None:
    ended, output = run('img_publisher', '--ros-args', '-p', 'fram_id:=0', '-p',
                        'source:=pattern', '-p', 'max_frames:=1')
    assert ended == 0
    assert 'unknown parameter fram_id is not used; did you mean frame_id?' in output


@pytest.mark.parametrize('name', ['sorce', 'video_device'])
def test_other_name_of_the_source(run: Run, name: str) -> None:
    ended, output = run('img_publisher', '--ros-args', '-p', f'{name}:=/dev/video9')
    assert ended == BAD_USAGE
    assert f'there is no parameter {name}: did you mean source?' in output


@pytest.mark.parametrize(('reconnect', 'later'), [
    ('never', 'Published 0 frames'), ('0.2', 'gave up after')])
def test_unknown_parameter_without_a_camera(run: Run, reconnect: str, later: str) -> None:
    ended, output = run('img_publisher', '--ros-args', '-p', 'fram_id:=eye', '-p', 'gain:=7',
                        '-p', 'source:=987', '-p', f'reconnect:={reconnect}')
    assert ended == FAILED
    assert output.count(' is not used yet') == 2
    # It is said while the camera is waited for.
    assert output.rindex(' is not used yet') < output.index(later)
    assert 'gain is not used yet; it is not a parameter of the node, and no camera is' in output
    assert 'fram_id is not used yet (did you mean frame_id?); it is not a parameter of' in output


def test_numbers_for_texts_and_fractions(run: Run) -> None:
    ended, output = run('img_publisher', '--ros-args', '-p', 'source:=pattern', '-p',
                        'publish_rate:=50', '-p', 'max_frames:=2', '-p', 'frame_id:=7')
    assert ended == 0, output
