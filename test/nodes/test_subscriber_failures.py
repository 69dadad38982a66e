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

"""Failures of a recorder process: kills, full disks, lost folders and slow writers."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
import fcntl
import os
from pathlib import Path
import random
import re
import shutil
import signal

from conftest import NodeProcess, read_manifest, read_pictures, recorded_files
import cv2
from images import find_numbers
import numpy as np
from opencv_tools.recording.recorder import QUEUE_SIZE
import pytest
from rclpy.node import Node
from sending import create_publisher, NANO, send, stamped
from sensor_msgs.msg import Image
from waiting import pause, wait_until, work_of

Start = Callable[..., NodeProcess]
Tell = Callable[[str], None]
KILLS = 10
AT_ONCE = 4
# Root without the right to ignore the permissions of files.
OBEDIENT_ROOT = ('setpriv', '--bounding-set=-dac_override,-dac_read_search')
PROGRESS = re.compile(r'Receiving video frame (\d+): .* (\d+) dropped')
SUMMARY = re.compile(r'Received (\d+) frames .*: (\d+) written to .*, (\d+) dropped, '
                     r'(\d+) failed, (\d+) lost in transit')


def summary(process: NodeProcess) -> dict[str, int]:
    """Read the summary that a recorder logs at its end."""
    numbers = map(int, SUMMARY.search(process.output).groups())
    counts = dict(zip(('received', 'written', 'dropped', 'failed', 'lost'), numbers))
    assert counts['received'] == counts['written'] + counts['dropped'] + counts['failed']
    return counts


def wait_for_frames(process: NodeProcess) -> None:
    """Wait until a recorder has tried to write one more frame than its queue takes."""
    def taken() -> int:
        received, dropped = PROGRESS.findall(process.output)[-1]
        return int(received) - int(dropped)

    last = taken() + QUEUE_SIZE + 1
    process.wait_until(lambda _: taken() > last, 'more frames')


# Fast DDS may fail to take the port of a killed process from another one that writes to it just
# then. The new process receives nothing by shared memory; only a further one does.
NO_PORT = 'Failed init_port'


@pytest.mark.thorough
def test_whole_files_after_kills(
        start: Start, tmp_path: Path, tell: Tell) -> None:
    folder = tmp_path / 'out'
    start('img_publisher', source='pattern:80x60@60', publish_rate=0)
    parameters = {'output_dir': folder, 'file_name': 'f{seq:06d}.png', 'writers': 2}
    moments = random.Random(5)
    checked: set[Path] = set()
    temporaries = 0
    # Further recorders start while one is killed, to save time.
    recorders = deque(start('img_subscriber', **parameters) for _ in range(AT_ONCE))
    for kill in range(KILLS):
        recorder = recorders.popleft()
        recorder.wait_until(lambda text: 'Receiving video frame' in text or NO_PORT in text)
        if NO_PORT in recorder.output:
            recorder.interrupt(signal.SIGKILL)
            recorder = start('img_subscriber', **parameters)
            recorder.wait_for('Receiving video frame')
        wait_until(lambda: len(recorded_files(folder)) > 10 * kill)  # noqa: B023
        pause(moments.uniform(0, 0.1))
        recorder.interrupt(signal.SIGKILL)
        assert recorder.finish() == -signal.SIGKILL
        if kill < KILLS - AT_ONCE:
            recorders.append(start('img_subscriber', **parameters))
        temporaries += len(list(folder.glob('.*.part')))
        for path in set(recorded_files(folder)) - checked:
            picture = cv2.imread(str(path))
            assert picture is not None and picture.shape == (60, 80, 3), path
            checked.add(path)
    unlisted = len(recorded_files(folder)) - (folder / 'manifest.jsonl').read_text().count('\n')
    assert 0 <= unlisted <= AT_ONCE

    last = start('img_subscriber', **parameters, max_frames=3)
    assert last.finish() == 0, last.output
    lines = read_manifest(folder)
    numbers = sorted(line['seq'] for line in lines)
    assert numbers == list(range(len(lines)))
    assert [f'f{number:06d}.png' for number in numbers] == [
        path.name for path in recorded_files(folder)]
    assert not list(folder.glob('.*'))
    tell(f'{KILLS} kills: {len(lines)} files, 0 partial, {len(lines)} lines; {temporaries} '
         f'temporary files seen, {unlisted} lines added at the last start, none left')
    assert len(lines) > 10 * (KILLS - 1)


def grays(video: Path) -> list[float]:
    """Return the mean of each frame of a video that may still be written."""
    capture = cv2.VideoCapture(str(video))
    means = []
    while (read := capture.read())[0]:
        means.append(read[1].mean())
    return means


@pytest.mark.thorough
@pytest.mark.parametrize('suffix', ['mp4', 'mkv'])
def test_video_of_a_killed_recorder(
        start: Start, node: Node, tmp_path: Path, suffix: str) -> None:
    folder = tmp_path / 'out'
    parameters = {'output_dir': folder, 'file_name': f'clip.{suffix}', 'on_overflow': 'block'}
    publisher = create_publisher(node)
    frames = [stamped(np.full((48, 64), 20 + number, np.uint8), 'mono8',
                      NANO + number * NANO // 50) for number in range(150)]
    recorder = start('img_subscriber', **parameters)
    send(node, publisher, *frames)
    # The file holds all but the last second, and one frame, before it is finished.
    wait_until(lambda: len(grays(folder / f'clip.{suffix}')) >= 150 - 51)
    recorder.interrupt(signal.SIGKILL)
    assert recorder.finish() == -signal.SIGKILL
    played = grays(folder / f'clip.{suffix}')
    assert 150 - 51 <= len(played) <= 150
    np.testing.assert_allclose(played, 20 + np.arange(len(played)), atol=2)
    last = start('img_subscriber', **parameters, max_frames=5)
    start('img_publisher', source='pattern:64x48@50')
    assert last.finish() == 0, last.output
    assert [(line['file'], line['seq'], line['frames']) for line in read_manifest(folder)] == [
        (f'clip.{suffix}', 0, len(played)), (f'clip_1.{suffix}', 1, 5)]
    assert not list(folder.glob('.*'))


@pytest.fixture
def small_disk(tmp_path: Path, mount_namespace: tuple[str, ...]) -> tuple[Path, list[str]]:
    """Return a folder, and the prefix of a command for which it is a disk of 1 MB."""
    folder = tmp_path / 'disk'
    folder.mkdir()
    return folder, [*mount_namespace, 'sh', '-c',
                    f'mount -t tmpfs -o size=1m none {folder} && exec "$@"', 'sh']


def test_full_disk_that_gets_room_again(
        start: Start, small_disk: tuple[Path, list[str]], tell: Tell) -> None:
    folder, within = small_disk
    recorder = start('img_subscriber', within=within, output_dir=folder,
                     file_name='f{seq:04d}.png', png_compression=0, writers=1)
    start('img_publisher', source='pattern:160x120@50', publish_rate=0, wait_for_subscribers=1)
    recorder.wait_for('No space left on device')
    inside = Path(f'/proc/{recorder.pid}/root{folder}')
    full = recorded_files(inside)
    assert len(find_numbers(read_pictures(inside))) == len(full)
    wait_for_frames(recorder)  # no file of these frames may remain
    assert recorded_files(inside) == full
    for path in full[:10]:
        path.unlink()
    recorder.wait_for('Writing again')
    wait_until(lambda: len(recorded_files(inside)) == len(full))
    recorder.wait_for('Receiving video frame')
    wait_until(lambda: recorder.output.count('No space left on device') == 2)
    pictures = read_pictures(inside)
    assert len(pictures) >= len(full) and all(picture is not None for picture in pictures)
    temporaries = [path for path in inside.glob('.*') if path.suffix != '.journal']
    recorder.interrupt()
    assert recorder.finish() == 1, recorder.output
    counts = summary(recorder)
    assert counts['failed'] >= 2
    assert counts['written'] == len(pictures) + 10
    assert len(temporaries) <= 1  # the file that is being written
    tell(f'a disk of 1 MB, full twice: {counts}, {len(pictures)} whole files on it, '
         'of which ten were deleted in between')


@pytest.mark.thorough
def test_folder_that_is_read_only_for_a_while(
        start: Start, tmp_path: Path, tell: Tell) -> None:
    folder = tmp_path / 'out'
    within = OBEDIENT_ROOT if os.getuid() == 0 else ()
    recorder = start('img_subscriber', within=within, output_dir=folder)
    start('img_publisher', source='pattern:160x120@50', publish_rate=0)
    recorder.wait_for('Receiving video frame')
    folder.chmod(0o555)
    recorder.wait_for('Permission denied')
    wait_for_frames(recorder)  # the line must not repeat for every frame
    folder.chmod(0o755)
    recorder.wait_for('Writing again')
    assert recorder.output.count('Permission denied') == 1
    recorder.interrupt()
    assert recorder.finish() == 1, recorder.output
    counts = summary(recorder)
    assert counts['failed'] >= 1
    assert len(read_manifest(folder)) == counts['written']
    tell(f'a folder that was read-only for a while: {counts}')


def gray_frames(first: int, count: int) -> list[Image]:
    """Return small gray frames; their numbers are the seconds of their stamps."""
    return [stamped(np.full((12, 16), number % 256, np.uint8), 'mono8', number * NANO)
            for number in range(first, first + count)]


def test_removed_folder_is_created_again(
        start: Start, node: Node, tmp_path: Path) -> None:
    folder = tmp_path / 'out'
    publisher = create_publisher(node)
    recorder = start('img_subscriber', output_dir=folder, file_name='f{seq:04d}.png',
                     on_overflow='block', max_frames=30)
    send(node, publisher, *gray_frames(1, 10))
    manifest = folder / 'manifest.jsonl'
    wait_until(lambda: manifest.exists() and manifest.read_text().count('\n') == 10)
    folder.rename(tmp_path / 'away')
    send(node, publisher, *gray_frames(11, 20))
    assert recorder.finish() == 0, recorder.output
    assert summary(recorder)['written'] == 30
    lines = [*read_manifest(tmp_path / 'away'), *read_manifest(folder)]
    assert [(line['seq'], line['stamp']['sec']) for line in lines] == [
        (number, number + 1) for number in range(30)]
    assert len(recorded_files(folder)) == 20


@pytest.mark.thorough
@pytest.mark.parametrize('writers', [1, 2])
def test_every_frame_is_counted_with_slow_writers(
        start: Start, node: Node, tmp_path: Path, writers: int, tell: Tell) -> None:
    folder = tmp_path / 'out'
    publisher = create_publisher(node)
    recorder = start('img_subscriber', output_dir=folder, queue_size=3, writers=writers)
    send(node, publisher, *gray_frames(1, 1))
    recorder.wait_for('Receiving video frame 1:')
    wait_until(lambda: (folder / 'manifest.jsonl').exists())
    sent = 1
    with (folder / 'manifest.jsonl').open() as manifest:
        fcntl.flock(manifest, fcntl.LOCK_EX)  # blocks all writers

        def send_more() -> None:
            nonlocal sent
            send(node, publisher, *gray_frames(sent + 1, 5))
            sent += 5
            pause(0.05)

        wait_until(lambda: 'arrive faster than they are written' in recorder.output,
                   'the warning', send_more, work=lambda: work_of(recorder.pid))
    # All sent frames were received when a later frame of another size is. The progress shows
    # that frame if it showed none for a second.
    size = 0
    while f' {size}x1 mono8' not in recorder.output:
        sent, size = sent + 1, size + 1
        send(node, publisher, stamped(np.zeros((1, size), np.uint8), 'mono8', sent * NANO))
        for _ in range(12 * size):
            if f' {size}x1 mono8' not in recorder.output:
                pause(0.1)
    recorder.interrupt()
    assert recorder.finish() == 0, recorder.output
    counts = summary(recorder)
    assert counts['dropped'] >= 1 and counts['failed'] == 0
    assert counts['received'] + counts['lost'] == sent
    lines = read_manifest(folder)
    assert len(lines) == counts['written']
    numbers = [line['stamp']['sec'] for line in lines]
    assert numbers == sorted(set(numbers))
    assert (numbers[0], numbers[-1]) == (1, sent)  # the oldest in the queue are dropped
    tell(f'{writers} slow writers: {counts}')


@pytest.mark.thorough
def test_no_loss_in_ten_thousand_frames(
        start: Start, node: Node, tmp_path: Path, tell: Tell) -> None:
    folder = tmp_path / 'out'
    publisher = create_publisher(node, 10_000)
    recorder = start('img_subscriber', output_dir=folder, file_name='f{seq:05d}.png',
                     on_overflow='block', queue_size=8, max_frames=10_000)
    send(node, publisher, *gray_frames(0, 10_000))
    assert recorder.finish() == 0, recorder.output
    counts = summary(recorder)
    assert counts == {
        'received': 10_000, 'written': 10_000, 'dropped': 0, 'failed': 0, 'lost': 0}
    assert [(line['seq'], line['stamp']['sec']) for line in read_manifest(folder)] == [
        (number, number) for number in range(10_000)]
    for number in (0, 1, 4999, 9999):
        picture = cv2.imread(str(folder / f'f{number:05d}.png'), cv2.IMREAD_UNCHANGED)
        assert np.array_equal(picture, np.full((12, 16), number % 256, np.uint8))
    shutil.rmtree(folder)
    tell(f'10,000 frames with on_overflow:=block: {counts}')
