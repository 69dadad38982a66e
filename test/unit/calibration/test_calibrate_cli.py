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

"""The command img_calibrate with image files, videos, bags, and hostile input."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
import signal
import subprocess
import sys

import cv2
import numpy as np
from opencv_tools.calibration.boards import parse_board
from opencv_tools.calibration.camera_file import read_camera
from opencv_tools.calibration.cli import main
from opencv_tools.calibration.source_images import Image
from opencv_tools.calibration.view_search import pair_images
from opencv_tools.convert.cli import main as convert
import pytest
from rendered_boards import facing, Pose, poses, small_camera
from waiting import communicate, LONGEST_SECONDS, status_of

TEXT = 'chessboard:9x6:25mm'
BOARD = parse_board(TEXT)
CAMERA = small_camera()
PLACE = np.array([-0.04, 0.0, 0.0])


def draw(folder: Path, place: np.ndarray) -> Path:
    """Draw pictures of a camera at a place into a folder."""
    for number, pose in enumerate(poses(BOARD, CAMERA, 9, 11, is_whole=True)):
        image = CAMERA.see(BOARD, Pose(pose.rotation, pose.translation + place), seed=number)
        cv2.imwrite(str(folder / f'{number}.png'), image)
    return folder


@pytest.fixture(scope='module')
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with pictures of a camera."""
    return draw(tmp_path_factory.mktemp('left'), np.zeros(3))


@pytest.fixture(scope='module')
def few(folder: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with as few pictures as a calibration takes, but one."""
    small = tmp_path_factory.mktemp('few')
    for number in range(5):
        (small / f'{number}.png').symlink_to(folder / f'{number}.png')
    return small


def calibrate(*words: object) -> int:
    return main([str(word) for word in words])


def test_folder_of_images(folder: Path, tmp_path: Path,
                          capsys: pytest.CaptureFixture[str]) -> None:
    target = tmp_path / 'camera.yaml'
    assert calibrate(folder, '--board', TEXT, '-o', target, '--name', 'front') == 0
    output = capsys.readouterr().out
    assert output.startswith('Views: 9 of 9 images\nCalibration of 480x360 pixels, plumb_bob:\n')
    assert '\nVerdict: usable\n  only 9 views were used: take 12 or more\n' in output
    assert output.endswith(f'Wrote {target}\n')
    stored = read_camera(target)
    assert (stored.width, stored.height, stored.distortion_model) == (480, 360, 'plumb_bob')
    np.testing.assert_allclose(stored.k, CAMERA.k.ravel(), atol=2)
    assert len(stored.d) == 5 and len(stored.p) == 12
    assert stored.r == (1, 0, 0, 0, 1, 0, 0, 0, 1)
    assert 'camera_name: front\n' in target.read_text()
    assert calibrate(folder, '--board', TEXT, '--check', target) == 0
    assert capsys.readouterr().out.endswith('\nVerdict: good\n')


@pytest.mark.thorough
def test_degraded_calibration_of_a_glob(folder: Path, tmp_path: Path,
                                        capsys: pytest.CaptureFixture[str]) -> None:
    target = tmp_path / 'camera.yaml'
    calibrate(folder / '*.png', '--board', TEXT, '-o', target)
    text = target.read_text()
    d1 = repr(read_camera(target).d[0])
    target.write_text(text.replace(d1, '0.1'))
    assert calibrate(folder, '--board', TEXT, '--check', target) == 1
    assert '\nVerdict: degraded\n  the error is ' in capsys.readouterr().out
    assert calibrate(folder, '--board', TEXT, '-o', target) == 0  # a calibration is replaced
    assert target.read_text() == text


@pytest.mark.thorough
def test_two_cameras(folder: Path, tmp_path: Path, tmp_path_factory: pytest.TempPathFactory,
                     capsys: pytest.CaptureFixture[str]) -> None:
    other = draw(tmp_path_factory.mktemp('right'), PLACE)
    targets = tmp_path / 'left.yaml', tmp_path / 'right.yaml'
    assert calibrate(folder, '--right', other, '--board', TEXT, '-o', targets[0],
                     '--right-output', targets[1]) == 0
    assert '\nBaseline: 0.0' in capsys.readouterr().out
    left, right = map(read_camera, targets)
    assert left.p[3] == 0
    assert -right.p[3] / right.p[0] == pytest.approx(0.04, rel=0.005)
    assert 'camera_name: camera_right\n' in targets[1].read_text()
    assert calibrate(other, '--right', folder, '--board', TEXT) == 1
    assert 'the left camera is at the right: swap the two' in capsys.readouterr().err


@pytest.mark.quick_cases(1)
@pytest.mark.parametrize('suffix', ['mp4', 'mcap'])
def test_video_and_bag_of_still_boards(folder: Path, tmp_path: Path, suffix: str,
                                       capsys: pytest.CaptureFixture[str]) -> None:
    frames = tmp_path / 'frames'
    frames.mkdir()
    for number in range(27):  # each picture three times
        image = (folder / f'{number // 3}.png').read_bytes()
        (frames / f'{number}.png').write_bytes(image)
    source = tmp_path / f'a.{suffix}'
    assert convert([str(frames), str(source), '--lossy']) == 0
    capsys.readouterr()
    assert calibrate(source, '--board', TEXT, '-o', tmp_path / 'camera.yaml') in (0, 1)
    found = capsys.readouterr().out
    assert ' not taken: the board moves: hold it still' in found
    views = int(found.split()[1])
    assert 5 <= views <= 9


@pytest.mark.parametrize(('words', 'reason'), [
    (('x',), '--board'), (('--board', TEXT), 'the source is missing: give image files'),
    (('x', '--board', 'circles:3x3:1mm'), "the board is 'circles:3x3:1mm': give charuco:"),
    (('--board', TEXT, '-o', 'a'), 'the source is missing'),
    (('0', '--board', TEXT), "source '0' has no end: give image files"),
    (('pattern', '--board', TEXT), "source 'pattern' has no end"),
    (('rtsp://me:a#b@h/x', '--board', TEXT), "write '#' as %23 in the user name"),
    (('rtsp://me:secret@h/x', '--topic', '/a', '--board', TEXT), "but 'rtsp://***@h/x' is none"),
    (('x', '--board', TEXT, '-o', 'a', '--check', 'b'), '--check writes nothing'),
    (('x', '--board', TEXT, '--right', 'y', '-o', 'a'), 'give -o and --right-output'),
    (('x', '--board', TEXT, '--right-output', 'a'), '--right-output needs --right'),
    (('x', '--board', TEXT, '--right-topic', '/a'), '--right-topic needs --right with a bag'),
    (('--board', TEXT, '--right-topic', '/a'), '--right-topic needs --right with a bag'),
    (('--board', TEXT, '--topic', '/a'), 'live topics are not supported here'),
    (('--board', TEXT, '--topic', '/a', '--right', 'y'), 'give it before --right'),
    (('--board', TEXT, '--topic', '/a', '--right-topic', '/b', '-o', 'a'), 'two files: give -o'),
    (('--board', TEXT, '--topic', '/a', '--right-topic', '/b', '--check', 'a'),
     'takes one camera'),
    (('--board', 'chessboard:8x6:1cm', '--topic', '/a', '--right-topic', '/b'), 'half a turn'),
    (('x', '--board', TEXT, '--right', 'y', '-o', 'a', '--right-output', 'a'), 'the same file'),
    (('--board', TEXT, '--topic', 'a', '--right-topic', '/a'), 'with --right-topic\n'),
    (('x', '--board', TEXT, '--right', './x'), 'the right camera are the same: give those of the'),
    (('x', '--board', TEXT, '--topic', 'a', '--right', 'x', '--right-topic', 'a'), 'the same: '),
    (('x', '--board', TEXT, '-o', ''), "-o/--output: '' is not a file: give the name of a file"),
    (('x', '--board', TEXT, '-o', '-'), "-o/--output: '-' is not a file: give the name"),
    (('x', '--board', TEXT, '--right', 'y', '-o', 'a', '--right-output', '-'), "'-' is not a"),
    (('x', '--board', TEXT, '--check', ''), "--check: '' is not a file"),
    (('--board', TEXT, '--board-pdf', ''), "--board-pdf: '' is not a file"),
    (('x', '--board', 'chessboard:8x6:1cm', '--right', 'y'), 'looks the same after half a turn'),
    (('x', '--board', TEXT, '--name', 'a/b'), "--name is 'a/b': give up to 128 letters"),
    (('a.png', 'b.png', '--board', TEXT), '2 sources are given: give a folder, or put the'),
    (('a.png', '--board', TEXT, '--topic', '/a'), "the topic '/a' is for a bag, but 'a.png' is"),
    (('x', '--board', TEXT, '--check', 'none.yaml'), 'none.yaml cannot be read: No such file'),
    (('--board', TEXT, '--board-pdf', 'a.png'), 'give a name that ends with .pdf or .svg'),
    (('--board', TEXT, '--board-pdf', 'no/a.pdf'), 'no/a.pdf cannot be written: No such file')])
def test_invalid_arguments(words: tuple[str, ...], reason: str,
                           capsys: pytest.CaptureFixture[str]) -> None:
    try:
        status = calibrate(*words)
    except SystemExit as end:
        status = int(end.code or 0)
    error = capsys.readouterr().err
    assert (status, reason in error) == (2, True), error


def test_board_for_a_printer(tmp_path: Path) -> None:
    for suffix, start in (('pdf', b'%PDF-1.4\n'), ('svg', b'<svg xmlns=')):
        path = tmp_path / f'board.{suffix}'
        assert calibrate('--board', TEXT, '--board-pdf', path) == 0
        assert path.read_bytes().startswith(start)
        assert calibrate('--board', 'chessboard:8x7:25mm', '--board-pdf', path) == 0
        path.write_text('notes')
        assert calibrate('--board', TEXT, '--board-pdf', path) == 2
        assert path.read_text() == 'notes'


@pytest.fixture
def hostile(tmp_path: Path) -> Path:
    """Return a folder with images that show no board, or are none."""
    (tmp_path / 'empty.png').write_bytes(b'')
    (tmp_path / 'text.jpg').write_text('not an image')
    cv2.imwrite(str(tmp_path / 'pixel.png'), np.zeros((1, 1, 3), np.uint8))
    cv2.imwrite(str(tmp_path / 'black.png'), np.zeros((48, 64), np.uint16))
    board = facing(BOARD, CAMERA, 0.4, x=-0.25), facing(BOARD, CAMERA, 0.4, x=0.25)
    cv2.imwrite(str(tmp_path / 'two.png'), CAMERA.mix([(BOARD, pose) for pose in board]))
    return tmp_path


def test_images_without_a_usable_board(
        hostile: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert calibrate(hostile, '--board', TEXT, '-o', hostile / 'a.yaml') == 1
    output, errors = capsys.readouterr()
    assert output.startswith('Views: 0 of 3 images\n  2 not taken: no board is in the image\n')
    assert '1 not taken: two boards are in the image: show only one' in output
    assert errors.count('warning: an image was not read: ') == 2
    assert 'views with the board: 0; give 4 to 100 images' in errors
    assert not (hostile / 'a.yaml').exists()


def test_images_of_another_size(folder: Path, tmp_path: Path,
                                capsys: pytest.CaptureFixture[str]) -> None:
    for number in range(6):
        image = cv2.imread(str(folder / f'{number}.png'))
        if number == 4:
            image = cv2.resize(image, (640, 480))
        cv2.imwrite(str(tmp_path / f'{number}.png'), image)
    assert calibrate(tmp_path, '--board', TEXT) == 0
    assert '1 not taken: the size of the image is 640x480, but ' in capsys.readouterr().out


@pytest.mark.parametrize('kind', ['none', 'empty'])
def test_missing_images(tmp_path: Path, kind: str, capsys: pytest.CaptureFixture[str]) -> None:
    source = tmp_path if kind == 'empty' else tmp_path / 'none'
    assert calibrate(source, '--board', TEXT) == 1
    assert capsys.readouterr().err.startswith('img_calibrate: error: ')


def test_other_file_is_not_replaced(folder: Path, tmp_path: Path,
                                    capsys: pytest.CaptureFixture[str]) -> None:
    target = tmp_path / 'notes.yaml'
    target.write_text('a: 1\n')
    assert calibrate(folder, '--board', TEXT, '-o', target) == 1
    captured = capsys.readouterr()
    assert 'the existing file is not a calibration; remove it' in captured.err
    assert 'Views' not in captured.out  # nothing was searched
    assert target.read_text() == 'a: 1\n'
    assert calibrate(folder, '--board', TEXT, '-o', tmp_path / 'no' / 'a.yaml') == 1
    captured = capsys.readouterr()
    assert 'there is no such folder; make the folder' in captured.err and not captured.out


def test_unequal_numbers_of_images(
        folder: Path, few: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert calibrate(folder, '--right', few, '--board', TEXT) == 2
    assert 'the left camera has 9 images, the right one 5: give' in capsys.readouterr().err


@pytest.mark.quick_cases(1)
@pytest.mark.process
@pytest.mark.parametrize('kind', ['full', 'pipe'])
def test_report_that_cannot_be_written(
        few: Path, tmp_path: Path, kind: str) -> None:
    target = tmp_path / 'camera.yaml'
    command = [sys.executable, '-m', 'opencv_tools.calibration.cli', str(few), '--board',
               TEXT, '-o', str(target)]
    with Path('/dev/full').open('w') as full:
        process = subprocess.Popen(command, stdout=full if kind == 'full' else subprocess.PIPE,
                                   stderr=subprocess.PIPE, text=True)
        if process.stdout:
            process.stdout.close()
        assert process.stderr
        error = process.stderr.read()
        assert status_of(process) == 1
    assert 'Traceback' not in error
    assert read_camera(target).width == 480


def images(*seconds: float | None) -> Iterator[Image]:
    return (Image(name=f'{number}', pixels=np.zeros((1, 1), np.uint8), seconds=one)
            for number, one in enumerate(seconds))


@pytest.mark.parametrize(('left', 'right', 'pairs'), [
    ((None, None, None), (None, None), ['00', '11']),
    ((0.0, 0.1, 0.2), (0.1, 0.2, 0.3), ['10', '21']),
    ((0.0, 0.1, 0.2), (0.001, 0.205), ['00', '21']), ((0.0,), (5.0,), []), ((), (1.0,), [])])
def test_pairs_by_number_or_time(
        left: tuple[float | None, ...], right: tuple[float | None, ...],
        pairs: list[str]) -> None:
    found = pair_images(images(*left), images(*right))
    assert [one.name + other.name for one, other in found] == pairs


@pytest.mark.process
def test_command_without_ros(few: Path, tmp_path: Path) -> None:
    script = ('import sys; sys.modules.update(dict.fromkeys(("rclpy", "sensor_msgs", "mcap")))\n'
              'from opencv_tools.calibration.cli import main\nsys.exit(main(sys.argv[1:]))')
    finished = subprocess.run(
        [sys.executable, '-c', script, few, '--board', TEXT, '-o', tmp_path / 'a.yaml'],
        capture_output=True, text=True, timeout=LONGEST_SECONDS, check=False)
    assert finished.returncode == 0, finished.stderr
    assert (tmp_path / 'a.yaml').exists()


@pytest.mark.process
def test_help_without_slow_imports() -> None:
    script = ('import sys; sys.modules.update(dict.fromkeys(("numpy", "cv2", "yaml")))\n'
              'from opencv_tools.calibration.cli import main\nmain(["--help"])')
    finished = subprocess.run([sys.executable, '-c', script], capture_output=True, text=True,
                              timeout=LONGEST_SECONDS, check=True)
    assert finished.stdout.startswith('usage: img_calibrate ')


@pytest.mark.process
def test_interrupt(few: Path, tmp_path: Path) -> None:
    for number in range(400):
        (tmp_path / f'{number}.png').symlink_to(few / f'{number % 5}.png')
    command = [sys.executable, '-m', 'opencv_tools.calibration.cli', str(tmp_path), '--board',
               'chessboard:12x9:25mm', '-o', str(tmp_path / 'a.yaml')]
    with subprocess.Popen(command, stderr=subprocess.PIPE, text=True) as process:
        assert process.stderr
        for _ in range(2):  # the first image imports modules, and a signal then has no message
            assert process.stderr.readline().startswith('img_calibrate: Searching image ')
        process.send_signal(signal.SIGINT)
        _, errors = communicate(process)
    assert process.returncode == 1 and errors.endswith('img_calibrate: error: interrupted\n')
    assert not (tmp_path / 'a.yaml').exists()
