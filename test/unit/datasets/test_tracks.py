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

"""Bags with faults through the whole command: the right rows and pictures, or a clear error."""

from __future__ import annotations

from collections.abc import Callable, Generator, Iterator
from itertools import count, pairwise, takewhile
import json
from pathlib import Path
import re
from typing import Any

import cv2
from dataset_bags import (
    BEGAN, Drive, joint_values, joints_entry, jpeg_entry, NANO, numbered_picture, plain_entry,
    with_definitions)
from dataset_sets import (
    CAMERA, check_rows, convert, frames_of, info_of, JOINTS_STATE, numbers_of, rows_of, stamps_of,
    USUAL)
import numpy as np
from opencv_tools.capture.bag_pictures import bag_pictures
from opencv_tools.convert.cli import main
from opencv_tools.datasets import pictures
from opencv_tools.image.cdr import image_to_cdr, WireHeader
from opencv_tools.image.encodings import find_encoding
from opencv_tools.image.layout import array_to_wire
from opencv_tools.video.encoder import VideoEncoder
from opencv_tools.video.messages import FFMPEG_PACKET, video_to_cdr
from opencv_tools.video.settings import VideoSettings
from played_bags import Entry, write_mcap, write_rosbag2
import pytest

S = NANO
TOPIC = '/cam0/image_raw/compressed'
Errors = pytest.CaptureFixture[str]


def row_times(start: int, end: int, fps: int) -> Iterator[int]:
    return takewhile(lambda one: one <= end, (start + row * S // fps for row in count()))


def expected(times: dict[int, int], first_ns: int = BEGAN, last_ns: int = 1 << 62, fps: int = 30,
             nearest: bool = False) -> tuple[int, list[int]]:
    """Return the time of the first row, and the number of the picture of each by a search."""
    last = {time_ns: number for number, time_ns in times.items()}  # in the order of the bag
    newest = {number: time_ns for time_ns, number in last.items()}
    start, end = max(first_ns, min(newest.values())), min(last_ns, max(newest.values()))
    if not nearest:  # rows begin later, until 99 of 100 nearest pictures are before them
        late = []
        for time_ns in row_times(start, end, fps):
            distance = min((one - time_ns for one in newest.values()), key=abs)
            late += [distance] if abs(distance) <= S // fps // 2 else []
        delay = sorted(late)[-1 - len(late) // 100] if late else 0
        start += delay if delay > 1000 else 0
    found = []
    for time_ns in row_times(start, end, fps):
        found.append(
            min(newest, key=lambda one: abs(newest[one] - time_ns)) if nearest else
            max((one for one in newest if newest[one] <= time_ns + 1000),
                key=newest.__getitem__))
    return start, found


def converted(folder: Path, drive: Drive, *words: object, fps: int = 30, suffix: str = '.mcap',
              status: int = 0) -> Path:
    assert convert(drive.write(folder / f'bag{suffix}'), folder / 'set', *words, fps=fps) == status
    return folder / 'set'


def refused(folder: Path, drive: Drive, errors: Errors, *words: object) -> str:
    """Return the error of a bag of which nothing may be written."""
    bag = drive.write(folder / 'bad.mcap')
    assert convert(bag, folder / 'set', *words) in (1, 2)
    text = errors.readouterr().err
    assert 'Traceback' not in text and not (folder / 'set').exists()
    return text


@pytest.mark.quick_cases(3)
@pytest.mark.parametrize(('drive', 'words', 'fps', 'suffix'), [
    (Drive(seconds=1.0), (), 30, '.mcap'),
    (Drive(seconds=1.0), (), 30, ''),  # SQLite
    (Drive(seconds=1.0, lost=frozenset({7, 8, 9, 15, 16, 28})), (), 30, '.mcap'),
    (Drive(jitter_ns=12_000_000), (), 30, '.mcap'),
    (Drive(jitter_ns=12_000_000, lost=frozenset({5})), ('--align-images', 'nearest'), 30, '.mcap'),
    (Drive(first=21), (), 30, '.mcap'),
    (Drive(), (), 10, '.mcap'),
    (Drive(), (), 77, '.mcap'),
    (Drive(seconds=0.3), (), 1000, '.mcap')],
    ids=('right', 'sqlite', 'lost', 'jitter', 'nearest', 'late', 'slow', 'uneven',
         'fast'))
def test_every_row_has_its_picture_and_joints(
        drive: Drive, words: tuple[str, ...], fps: int, suffix: str, tmp_path: Path) -> None:
    folder = converted(tmp_path, drive, *USUAL, *words, fps=fps, suffix=suffix)
    times = {number: drive.picture_ns(number) for number in range(drive.first, int(
        30 * drive.seconds)) if number not in drive.lost}
    last_ns = BEGAN + round(drive.seconds * S)
    numbers = check_rows(folder, drive.picture_ns)
    start, pictures = expected(times, BEGAN, last_ns, fps, 'nearest' in words)
    assert numbers == pictures
    row_ns = [start + row * S // fps for row in range(len(numbers))]
    assert stamps_of(folder, '/joint_states.position') == [
        one - (one - BEGAN) % (S // 100) for one in row_ns]
    for number, (_, image) in zip(numbers, frames_of(folder), strict=True):  # also the colours
        assert np.abs(image.astype(int) - numbered_picture(number)).mean() < 15
    rows = rows_of(folder)
    assert np.allclose(rows['action'], 10 * rows['observation.state'], rtol=1e-5)


@pytest.mark.parametrize('jitter_ms', [40, 60, 137])
def test_pictures_recorded_in_another_order_than_stamped(
        jitter_ms: int, tmp_path: Path, capsys: Errors) -> None:
    drive = Drive(topics=(), jitter_ns=jitter_ms * 1_000_000)
    drive.others = moved(Drive(), lambda time_ns: drive.picture_ns(
        round((time_ns - BEGAN) * 30 / S)))
    folder = converted(tmp_path, drive, *USUAL)
    numbers = check_rows(folder, drive.picture_ns)
    times = {number: drive.picture_ns(number) for number in range(60)}
    assert sorted(times.values()) != [*times.values()]
    assert numbers == expected(times, BEGAN, BEGAN + 2 * S)[1]
    late = 60 - len({*times.values()})
    assert ('messages are left out' in capsys.readouterr().err) == bool(late)


def test_swapped_messages_and_one_from_the_future_cost_nothing(
        tmp_path: Path, capsys: Errors) -> None:
    drive = Drive()
    entries = drive.entries()
    places = [place for place, entry in enumerate(entries) if entry.topic == TOPIC][5:50:3]
    following = [next(one for one in range(place + 1, len(entries))
                      if entries[one].topic == TOPIC) for place in places]
    for one, two in zip(places, following):
        entries[one], entries[two] = (
            entries[two]._replace(log_ns=entries[one].log_ns),
            entries[one]._replace(log_ns=entries[two].log_ns))
    ahead = next(place for place, entry in enumerate(entries) if entry.topic == '/joint_states'
                 and entry.log_ns > BEGAN + S)
    time_ns = BEGAN + S + 430_000_000
    entries[ahead] = joints_entry(time_ns, joint_values(time_ns), log_ns=entries[ahead].log_ns)
    drive.entries = lambda: entries  # type: ignore[method-assign]
    folder = converted(tmp_path, drive, *USUAL)
    assert check_rows(folder, drive.picture_ns) == [*range(60)]
    joint_ns = np.array(stamps_of(folder, '/joint_states.position'))
    assert np.abs(joint_ns - np.array(stamps_of(folder, 'front'))).max() <= 20_000_000
    assert '1 messages are left out' in capsys.readouterr().err  # two of one time


def test_linear_numbers_are_those_of_the_times_of_the_rows(tmp_path: Path) -> None:
    folder = converted(tmp_path, Drive(), *USUAL, '--align-vectors', 'linear')
    rows = rows_of(folder)
    assert np.allclose(rows['observation.state'], [
        joint_values(BEGAN + row * S // 30) for row in rows['frame_index'].tolist()], atol=1e-6)


def moved(drive: Drive, stamp_of: Callable[[int], int]) -> list[Entry]:
    """Return numbered pictures that are recorded in time, but whose stamps are others."""
    return [jpeg_entry(number, stamp_of(drive.picture_ns(number)), log_ns=drive.picture_ns(number))
            for number in range(round(30 * drive.seconds))]


@pytest.mark.parametrize(('stamp_of', 'reason'), [
    (lambda time_ns: 0, r'30 stamps of front \(.*\) are zero'),
    (lambda time_ns: 0 if time_ns > BEGAN + S // 2 else time_ns,
     r'14 stamps of front .* are zero'),
    (lambda time_ns: time_ns - 2 * S, r'the stamps of \S+ are 1\.999 s ahead .* two clocks'),
    (lambda time_ns: time_ns - 300 * S * (time_ns > BEGAN + S // 2),
     r'stamps of front .* jump by -299\.967 s after message 15'),
    (lambda time_ns: time_ns + 9 * S * (time_ns > BEGAN + S // 2),
     r'jump by 9\.033 s after message'),
])
def test_wrong_stamps_are_refused_and_the_log_is_right(
        stamp_of: Callable[[int], int], reason: str, tmp_path: Path, capsys: Errors) -> None:
    drive = Drive(seconds=1.0, topics=())
    drive.others = moved(drive, stamp_of)
    error = refused(tmp_path, drive, capsys, *USUAL)
    assert re.search(f'1 of 1, bad.mcap: .*{reason}.*; use --clock log', error), error
    folder = converted(tmp_path, drive, *USUAL, '--clock', 'log')
    assert stamps_of(folder, 'front') == [drive.picture_ns(one) for one in numbers_of(folder)]
    # The joints have the times of the log, too, 1 ms after those of their values.
    joint_ns = stamps_of(folder, '/joint_states.position')
    assert np.allclose(rows_of(folder)['observation.state'],
                       [joint_values(one - 1_000_000) for one in joint_ns], atol=1e-5)


def test_small_difference_of_clocks_is_a_warning(tmp_path: Path, capsys: Errors) -> None:
    drive = Drive(topics=())
    drive.others = moved(drive, lambda time_ns: time_ns + S // 5)
    converted(tmp_path, drive, *USUAL)
    assert 'warning: bag.mcap: the stamps of front are 0.201 s ahead' in capsys.readouterr().err


def permuted(names: tuple[str, ...], step: int) -> Entry:
    """Return a message of the joints in the order of some names."""
    time_ns = BEGAN + step * S // 50
    values = {**dict(zip(('shoulder', 'elbow', 'wrist'), joint_values(time_ns))), 'grip': 7.0}
    return joints_entry(time_ns, [values[name] for name in names], names, '/arm')


def test_joints_are_found_by_their_names(tmp_path: Path) -> None:
    orders = [('wrist', 'shoulder', 'elbow'), ('elbow', 'grip', 'wrist', 'shoulder'),
              ('shoulder', 'elbow', 'wrist')]
    drive = Drive(others=[permuted(orders[step % 3], step) for step in range(100)])
    folder = converted(tmp_path, drive, *CAMERA, '--state', '/arm.position',
                       '--joints', 'shoulder,elbow,wrist')
    expected_state = [joint_values(one) for one in stamps_of(folder, '/arm.position')]
    assert np.allclose(rows_of(folder)['observation.state'], expected_state, atol=1e-5)
    assert convert(tmp_path / 'bag.mcap', tmp_path / 'b', *CAMERA, '--state', '/arm.position') == 0
    assert info_of(tmp_path / 'b')['features']['observation.state']['names'] == [*orders[0]]
    assert np.allclose(rows_of(tmp_path / 'b')['observation.state'],
                       np.array(expected_state)[:, [2, 0, 1]], atol=1e-5)


def test_double_and_missing_joints_are_an_error(tmp_path: Path, capsys: Errors) -> None:
    drive = Drive(others=[permuted(('wrist', 'elbow', 'grip'), step) for step in range(100)])
    drive.others[40] = permuted(('wrist', 'elbow', 'grip', 'elbow'), 40)
    words = (*CAMERA, '--state', '/arm.position')
    assert "message 41 of /arm: 'elbow' is there twice" in refused(
        tmp_path, drive, capsys, *words)
    # After 0.5 s the last message with grip is too old.
    drive.others = [permuted(('wrist', 'elbow', 'grip')[:3 if step < 25 else 2], step)
                    for step in range(100)]
    error = refused(tmp_path, drive, capsys, *words, '--max-gap', '0.5')
    assert '/arm.position.grip has no sample for the last 1.500 s' in error


@pytest.mark.parametrize(('names', 'joints'), [
    ((), ['shoulder', 'elbow', 'wrist', 'grip']),
    (('--joints', 'grip'), ['grip']), (('--joints', 'grip,wrist'), ['grip', 'wrist'])])
@pytest.mark.parametrize('period', [2, 7])
def test_two_publishers_of_joints(
        period: int, names: tuple[str, ...], joints: list[str], tmp_path: Path,
        capsys: Errors) -> None:
    arm = [permuted(('shoulder', 'elbow', 'wrist'), step) for step in range(100)]
    grips = {BEGAN + step * S // 50 + 3_000_000: float(step) for step in range(0, 100, period)}
    drive = Drive(others=[*arm, *(joints_entry(time_ns, [value], ['grip'], '/arm')
                                  for time_ns, value in grips.items())])
    folder = converted(tmp_path, drive, *CAMERA, '--state', '/arm.position', *names)
    assert info_of(folder)['features']['observation.state']['names'] == joints
    states = rows_of(folder)['observation.state'].reshape(-1, len(joints))
    for row, state in enumerate(states):
        now = BEGAN + 3_000_000 + row * S // 30 + 1000
        expected_values = dict(zip(('shoulder', 'elbow', 'wrist'), joint_values(
            BEGAN + (now - BEGAN) * 50 // S * S // 50)))
        expected_values['grip'] = grips[max(one for one in grips if one <= now)]
        assert np.allclose(state, [expected_values[name] for name in joints], atol=1e-5)
    errors = capsys.readouterr().err
    assert ('99 messages are left out, because they have none' in errors) == (joints == ['grip'])


@pytest.mark.parametrize('joints', ['shoulder,elbow,wrist', 'grip', 'grip,wrist', 'elbow'])
@pytest.mark.parametrize('period', [1, 2, 25])
def test_two_publishers_of_joints_with_the_same_stamps(
        period: int, joints: str, tmp_path: Path, capsys: Errors) -> None:
    arm = [permuted(('shoulder', 'elbow', 'wrist'), step) for step in range(100)]
    grips = [joints_entry(BEGAN + step * S // 50, [float(step)], ['grip'], '/arm')
             for step in range(0, 100, period)]
    drive = Drive(others=[*arm, *(entry._replace(log_ns=entry.log_ns + S // 1000)
                                  for entry in grips)])
    folder = converted(tmp_path, drive, *CAMERA, '--state', '/arm.position', '--joints', joints)
    names = joints.split(',')
    states = rows_of(folder)['observation.state'].reshape(-1, len(names))
    assert len(states) > 55 - period * 30 // 50
    for now, state in zip(stamps_of(folder, '/arm.position'), states):
        values = dict(zip(('shoulder', 'elbow', 'wrist'), joint_values(now)))
        values['grip'] = (now - BEGAN) * 50 // S // period * period
        assert np.allclose(state, [values[name] for name in names], atol=1e-5)
    # The first one of the arm has no number of the gripper yet.
    later = f'{len(grips) - 1} messages are left out, because later ones have the same times; num'
    errors = capsys.readouterr().err
    assert (later in errors) == (joints == 'grip,wrist'), errors
    assert ', of 200 messages' in errors or period > 1


@pytest.mark.parametrize('every', [1, 3, 10])
def test_the_last_picture_of_one_stamp_is_shown(
        every: int, tmp_path: Path, capsys: Errors) -> None:
    drive = Drive()
    twice = range(0, 60, every)
    drive.others = [jpeg_entry(100 + number, time_ns, log_ns=time_ns + S // 100)
                    for number in twice for time_ns in [drive.picture_ns(number)]]
    folder = converted(tmp_path, drive, *USUAL)
    shown = [*range(60)]
    shown[::every] = [100 + number for number in twice]
    assert check_rows(folder, lambda number: drive.picture_ns(number % 100)) == shown
    errors = capsys.readouterr().err
    assert f'front: {len(twice)} messages are left out, because later ones have the s' in errors
    assert f'{len(twice)} dropped, 0 before' in errors


@pytest.mark.parametrize(('factor', 'begin', 'late'), [
    (0.4, 1000 * S, 1.2), (0.4, 0, 0.0), (3.3, 77 * S, 0.5)])
def test_simulation_has_one_clock(
        factor: float, begin: int, late: float, tmp_path: Path, capsys: Errors) -> None:
    def log_ns(stamp: int) -> int:
        return BEGAN + round((stamp - begin) / factor)

    drive = Drive(topics=())
    pictures = [begin + number * S // 30 for number in range(120) if number / 30 >= late]
    entries = [jpeg_entry(number, stamp, log_ns=log_ns(stamp) + 2_000_000)
               for number, stamp in enumerate(pictures)]
    entries += [joints_entry(stamp, [float(step)], ['a'], log_ns=log_ns(stamp))
                for step in range(401) for stamp in [begin + step * S // 100]]
    entries += [plain_entry(log_ns(begin + round(one * S)), one == 1.5, '/run')
                for one in (1.5, 3.0)]
    drive.entries = lambda: sorted(  # type: ignore[method-assign]
        entries, key=lambda entry: entry.log_ns)
    words = (*CAMERA, *JOINTS_STATE, '--ends', 'shorten')
    folder = converted(tmp_path, drive, *words)
    stamps = stamps_of(folder, 'front')
    assert stamps == pictures[len(pictures) - len(stamps):] and len(stamps) > 80
    assert [round((one - begin) / S * 100) for one in stamps_of(
        folder, '/joint_states.position')] == rows_of(folder)['observation.state'].ravel().tolist()
    errors = capsys.readouterr().err
    assert f'the stamps advance {factor:.3g} times as fast' in errors and '--clock' not in errors
    assert ('the first message is left out, because its stamp is 0' in errors) == (not begin)
    folder = converted(tmp_path / 'b', drive, *words, '--episodes', '/run')
    stamps = stamps_of(folder, 'front')
    assert abs(stamps[0] - begin - 1.5 * S) < S // 20 and abs(len(stamps) - 45) <= 1


@pytest.mark.parametrize('bad', [2, 11])
def test_damaged_pictures_at_the_begin_cost_those_pictures(
        bad: int, tmp_path: Path, capsys: Errors) -> None:
    drive = Drive()
    pictures = [entry for entry in drive.entries() if entry.topic == TOPIC]
    damaged = {entry.log_ns for entry in pictures[:bad]}
    entries = [entry._replace(data=entry.data.replace(b'\xff\xd8', b'\xff\0')) if (
        entry.topic == TOPIC and entry.log_ns in damaged) else entry for entry in drive.entries()]
    drive.entries = lambda: entries  # type: ignore[method-assign]
    folder = converted(tmp_path, drive, *USUAL, status=1)
    assert check_rows(folder, drive.picture_ns) == [*range(bad, 60)]
    errors = capsys.readouterr().err
    assert f'warning: bag.mcap: front: the first {bad} pictures cannot be decoded: ' in errors
    assert f'0 after the last, {bad} failed, of 60 messages' in errors


@pytest.mark.parametrize('form', ['lerobot', 'webdataset', 'parquet'])
@pytest.mark.parametrize('cameras', [1, 2, 4])
def test_pictures_of_a_camera_are_read_once(
        cameras: int, form: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    read: list[int] = []

    def counted(*words: Any, **more: Any) -> Generator[Any, None, None]:
        for picture in bag_pictures(*words, **more):
            read.append(len(read))
            yield picture

    monkeypatch.setattr(pictures, 'bag_pictures', counted)
    bag = Drive(seconds=0.5).write(tmp_path / 'bag.mcap')
    words = [word for number in range(cameras) for word in ('--image', f'c{number}={TOPIC}')]
    assert convert(bag, tmp_path / 'set', *words, *JOINTS_STATE, '--jobs', 1, form=form) == 0
    assert len(read) == 15 * cameras


@pytest.mark.parametrize('encoding', ['16UC1', '32FC1', 'mono16', '32FC2'])
def test_dry_run_refuses_what_the_conversion_refuses(
        encoding: str, tmp_path: Path, capsys: Errors) -> None:
    drive = Drive(seconds=0.5, topics=())
    shape = (8, 8, 2) if encoding == '32FC2' else (8, 8)
    kind = np.float32 if encoding[0] == '3' else np.uint16
    drive.others = [Entry(time_ns, image_to_cdr(array_to_wire(
        np.ones(shape, kind), find_encoding(encoding), WireHeader(*divmod(time_ns, NANO), 'cam'))),
        '/deep') for time_ns in map(drive.picture_ns, range(15))]
    words = ('--image', 'front=/deep', *JOINTS_STATE)
    error = refused(tmp_path, drive, capsys, *words)
    dry = refused(tmp_path, drive, capsys, *words, '--dry-run')
    assert dry.partition('bad.mcap: ')[2] in error


@pytest.mark.parametrize(('words', 'reason'), [
    (('--image', 'front=/cam1/x'),
     'there is no topic of images /cam1/x; there is /cam0/image_raw/compressed (sensor_msgs'),
    (('--state', '/joints.position'), 'there is no topic /joints; there is /arm/command '),
    (('--state', '/joint_states.positions'),
     "there is no field 'positions'; there is header, name, position, velocity, effort"),
    (('--state', '/joint_states.position.3'), "there is no field '3'; there is 0 to 2"),
    (('--state', '/joint_states.name'), "'name' is a list of messages or texts, not a number"),
    (('--state', '/joint_states.velocity'), 'has 0 numbers; 1 to 4096 can be a feature'),
    (('--state', '/joint_states.position', '--joints', 'hip'),
     "joint 'hip' is missing; the topics have elbow, shoulder, wrist"),
])
def test_missing_topics_and_fields_are_an_error_that_lists_what_there_is(
        words: tuple[str, ...], reason: str, tmp_path: Path, capsys: Errors) -> None:
    assert reason in refused(tmp_path, Drive(seconds=0.5), capsys, *words)


@pytest.mark.parametrize(('align', 'value'), [
    ('last', np.nan), ('linear', np.inf), ('linear', 1e308)])
def test_numbers_that_are_not_finite_are_an_error(
        align: str, value: float, tmp_path: Path, capsys: Errors) -> None:
    drive = Drive(others=[joints_entry(BEGAN + step * S // 50, [
        value * (-1 if step % 2 else 1) if 39 < step < 42 else 1.0], ['a'], '/arm')
        for step in range(100)])
    error = refused(tmp_path, drive, capsys, *CAMERA, '--state', '/arm.position',
                    '--align-vectors', align)
    assert '/arm.position is not finite 0.802 s after the begin, in 2 rows' in error


def test_source_without_a_header_needs_the_clock_of_the_log(
        tmp_path: Path, capsys: Errors) -> None:
    drive = Drive(others=[plain_entry(BEGAN + step * S // 7, step / 7, '/level', 'Float64')
                          for step in range(15)])
    words = (*CAMERA, '--state', '/level')
    assert re.search(r'messages of /level \(/level\) have no stamp; use --clock log',
                     refused(tmp_path, drive, capsys, *words))
    folder = converted(tmp_path, drive, *words, '--clock', 'log')
    stamps = np.array(stamps_of(folder, '/level'))
    assert np.allclose(rows_of(folder)['observation.state'], (stamps - BEGAN) / S, atol=1e-6)
    row_ns = [BEGAN + 5_000_000 + row * S // 30 for row in range(len(stamps))]
    assert stamps.tolist() == [BEGAN + ((one - BEGAN) * 7 // S) * S // 7 for one in row_ns]


@pytest.mark.parametrize('suffix', ['.mcap', ''])
def test_cut_file_has_right_rows_up_to_the_cut(
        suffix: str, tmp_path: Path, capsys: Errors) -> None:
    drive = Drive()
    bag = tmp_path / f'bag{suffix}'
    if suffix:
        write_mcap(bag, with_definitions(drive.entries()), chunk_size=20_000)
        bag.write_bytes(bag.read_bytes()[:bag.stat().st_size // 2])
    else:
        (drive.write(bag) / 'metadata.yaml').unlink()
    assert convert(bag, tmp_path / 'set', *USUAL, '--max-gap', '0.1') == 0
    numbers = check_rows(tmp_path / 'set', drive.picture_ns)
    assert numbers == [*range(len(numbers))]
    assert 20 < len(numbers) < 60 if suffix else len(numbers) == 60
    assert ('warning: bag.mcap: ' in capsys.readouterr().err) == bool(suffix)


def test_pictures_that_cannot_be_decoded_are_replaced_and_counted(
        tmp_path: Path, capsys: Errors) -> None:
    drive = Drive()
    entries = [entry if entry.topic != TOPIC else entry._replace(
        data=entry.data[:-60].replace(b'\xff\xd8', b'\xff\x00') if number in (20, 21, 40) else
        entry.data) for number, entry in enumerate(sorted(
            drive.entries(), key=lambda entry: (entry.topic != TOPIC, entry.log_ns)))]
    entries.sort(key=lambda entry: entry.log_ns)
    drive.entries = lambda: entries  # type: ignore[method-assign]
    folder = converted(tmp_path, drive, *USUAL, status=1)
    assert check_rows(folder, drive.picture_ns) == [
        {20: 19, 21: 19, 40: 39}.get(number, number) for number in range(60)]
    errors = capsys.readouterr().err
    assert 'warning: bag.mcap: front: 3 pictures cannot be decoded' in errors
    assert ('front: 57 samples used, 3 rows repeat one, 0 dropped, 0 before the first row, '
            '0 after the last, 3 failed, of 60 messages; ') in errors
    assert '66.7 ms at most' in errors
    assert 'front has no picture that can be decoded for 0.067 s; at most 0.05 s' in refused(
        tmp_path / 'b', drive, capsys, *USUAL, '--max-gap', '0.05')


def test_first_picture_that_cannot_be_decoded_is_an_error(
        tmp_path: Path, capsys: Errors) -> None:
    drive = Drive(first=1, others=[jpeg_entry(0, BEGAN)._replace(data=b'\0\1\0\0\1\1\1\1'[:size])
                                   for size in (0, 1, 4, 8)])
    drive.others.append(joints_entry(BEGAN, [1])._replace(data=b'\0\1\0\0\1\1\1\1\1\1\1\1'))
    folder = converted(tmp_path, drive, *USUAL, status=1)  # what cannot be read counts as lost
    assert check_rows(folder, drive.picture_ns) == [*range(1, 60)]
    errors = capsys.readouterr().err
    assert 'bag.mcap: front: 4 messages cannot be read' in errors
    assert 'bag.mcap: /joint_states.position: 1 messages cannot be read' in errors
    drive.topics = ()
    drive.others = [jpeg_entry(number, drive.picture_ns(number)) for number in range(60)]
    drive.others = [one._replace(data=one.data.replace(b'\xff\xd8', b'\xff\x00'))
                    for one in drive.others]
    assert 'front has no picture for the first row: message 0 of ' in refused(
        tmp_path / 'b', drive, capsys, *USUAL)


def test_pictures_of_different_sizes_are_an_error(tmp_path: Path, capsys: Errors) -> None:
    drive = Drive(lost=frozenset({30}))
    drive.others = [jpeg_entry(30, drive.picture_ns(30), width=176)]
    assert 'front changes its size from (160, 120) to (176, 120); all pictures of a camera' in (
        refused(tmp_path, drive, capsys, *USUAL))


def test_pictures_that_cannot_be_converted_are_an_error(
        tmp_path: Path, capsys: Errors) -> None:
    drive = Drive(seconds=0.5, topics=())
    wire = array_to_wire(np.zeros((8, 8, 2), np.float32), find_encoding('32FC2'), WireHeader(
        *divmod(BEGAN, NANO), 'cam'))
    drive.others.append(Entry(BEGAN, image_to_cdr(wire), '/flow'))
    assert 'message 0 of /flow cannot be decoded: [32FC2] ' in refused(
        tmp_path, drive, capsys, '--image', 'front=/flow', *JOINTS_STATE)


@pytest.mark.parametrize('encoding', ['bgr8', 'rgb8', 'mono8', 'bayer_rggb8', 'bgra8'])
def test_raw_pictures(encoding: str, tmp_path: Path) -> None:
    drive = Drive(seconds=0.5, topics=())
    for number in range(15):
        image = numbered_picture(number)
        if encoding in ('mono8', 'bayer_rggb8'):
            image = cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)
        if encoding == 'bgra8':
            image = cv2.cvtColor(image, cv2.COLOR_BGR2BGRA)
        time_ns = drive.picture_ns(number)
        cdr = image_to_cdr(array_to_wire(image, find_encoding(encoding), WireHeader(
            *divmod(time_ns, NANO), 'cam')))
        drive.others.append(Entry(time_ns, cdr, '/raw'))
    folder = converted(tmp_path, drive, '--image', 'front=/raw', *JOINTS_STATE)
    assert check_rows(folder, drive.picture_ns) == [*range(15)]


def test_odd_size_and_one_row(tmp_path: Path) -> None:
    drive = Drive(seconds=0.02, others=[jpeg_entry(0, BEGAN, '/odd', width=161, height=121)])
    folder = converted(tmp_path, drive, *CAMERA, '--image', 'odd=/odd', *JOINTS_STATE)
    assert check_rows(folder, drive.picture_ns) == [0]
    assert info_of(folder)['features']['observation.images.odd']['shape'] == [121, 161, 3]


@pytest.mark.parametrize(('lost', 'warning'), [
    ((), ''), ((16, 17), 'pictures cannot be decoded'),
    ((0,), 'front: 9 messages before the first key frame are left out')])
def test_video_topic_is_decoded_from_its_key_frames(
        lost: tuple[int, ...], warning: str, tmp_path: Path, capsys: Errors) -> None:
    drive = Drive(seconds=1.0, topics=())
    encoder = VideoEncoder(VideoSettings(key_interval=3600.0), 160, 120, 30.0)
    for number in range(30):
        time_ns = drive.picture_ns(number)
        packet = encoder.encode(numbered_picture(number), 'bgr8', time_ns, number in (0, 10, 20))
        header = WireHeader(*divmod(time_ns, NANO), 'cam')
        cdr = video_to_cdr(FFMPEG_PACKET, header, packet, number)
        topic = '/lost' if number in lost else '/cam0/ffmpeg'
        drive.others.append(Entry(time_ns, cdr, topic, FFMPEG_PACKET))
    joints = with_definitions(Drive(seconds=1.0, topics=()).entries())
    bag = write_mcap(tmp_path / 'bag.mcap', [*drive.others, *joints])  # numbered in this order
    for fps, step in ((30, 1), (10, 3)):
        target = tmp_path / f'set{fps}'
        assert convert(bag, target, '--image', 'front=/cam0/ffmpeg', *JOINTS_STATE, fps=fps) == (
            'decoded' in warning)
        # After a loss the pictures cannot be decoded up to the next key frame.
        assert check_rows(target, drive.picture_ns) == [
            15 if 16 in lost and 15 < number < 20 else number
            for number in range(10 if 0 in lost else 0, 30, step)]
    errors = capsys.readouterr().err
    assert warning in errors if warning else 'warning' not in errors


def test_joints_of_two_topics(tmp_path: Path) -> None:
    drive = Drive(seconds=0.3)
    drive.others = [joints_entry(BEGAN + step * S // 100, [step], ['grip'], '/gripper')
                    for step in range(31)]
    folder = converted(tmp_path, drive, *CAMERA, *JOINTS_STATE, '--state', '/gripper.position',
                       '--joints', 'elbow,grip,wrist')
    assert info_of(folder)['features']['observation.state']['names'] == [
        '/joint_states.position.elbow', '/joint_states.position.wrist', '/gripper.position.grip']


def test_names_that_do_not_fit_the_numbers_are_an_error(tmp_path: Path, capsys: Errors) -> None:
    drive = Drive(seconds=0.3, others=[joints_entry(BEGAN, [1, 2, 3], ['a', 'b'], '/odd')])
    assert "'name' has 2 names for 3 numbers" in refused(
        tmp_path, drive, capsys, *CAMERA, '--state', '/odd.position')


def test_image_without_pixels_is_an_error(tmp_path: Path, capsys: Errors) -> None:
    drive = Drive(seconds=0.3, topics=())
    cdr = image_to_cdr(array_to_wire(np.zeros((0, 0, 3), np.uint8), find_encoding('bgr8'),
                                     WireHeader(*divmod(BEGAN, NANO), 'cam')))
    drive.others.append(Entry(BEGAN, cdr, '/empty'))
    assert 'cannot be decoded: it has no pixels' in refused(
        tmp_path, drive, capsys, '--image', 'front=/empty', *JOINTS_STATE)


def stepped(step_ns: int, begin: int = 30, end: int = 1 << 30) -> Drive:
    """Return a drive whose stamps are behind the times of the recording, for some pictures."""
    drive, fast = Drive(topics=(), seconds=3.0), Drive(seconds=3.0)
    drive.others = [jpeg_entry(number, fast.picture_ns(number) - step_ns * (
        begin <= number < end))._replace(log_ns=fast.picture_ns(number)) for number in range(90)]
    return drive


@pytest.mark.parametrize('step_ms', [50, 313, 480, 121])
def test_small_step_of_the_stamps_alone(
        step_ms: int, tmp_path: Path, capsys: Errors) -> None:
    drive = stepped(step_ms * S // 1000, 45)
    text = (f'the stamps step back by {step_ms / 1000 - 1 / 30:.3f} s after message 44 and stay '
            'behind, as after a change of the clock')
    if step_ms > 133:  # 0.1 s more than a period
        assert f'{text}, so rows from' in refused(tmp_path, drive, capsys, *CAMERA)
    folder = converted(tmp_path, drive, *CAMERA, '--on-gap', 'split', '--overwrite')
    assert text in capsys.readouterr().err
    numbers = numbers_of(folder)
    assert numbers == sorted(numbers) and len(numbers) >= 90 - 2 * step_ms * 30 / 1000 - 2
    # One late picture, and pictures in pairs that were exchanged, are no step of the clock.
    for drive in (stepped(step_ms * S // 1000, 45, 46), stepped(step_ms * S // 1000, 45, 48)):
        assert convert(drive.write(tmp_path / 'late.mcap'), tmp_path / 'late', *CAMERA,
                       '--overwrite') == 0
    assert 'the stamps step back' not in capsys.readouterr().err


@pytest.mark.parametrize(('seconds', 'count'), [(0.9, 20), (1.5, 26), (2.4, 30), (5.0, 7)])
def test_jumps_of_the_recording_alone(
        seconds: float, count: int, tmp_path: Path, capsys: Errors) -> None:
    drive = Drive(seconds=3.0, topics=())
    drive.others = [
        jpeg_entry(number, Drive().picture_ns(number))._replace(log_ns=round(
            Drive().picture_ns(number) - seconds * S * (40 <= number < 40 + count)))
        for number in range(90)]
    error = refused(tmp_path, drive, capsys, *CAMERA, '--clock', 'log')
    assert re.search(r'times of the recording of front .* jump by .* use --clock stamp', error)
    folder = converted(tmp_path, drive, *CAMERA, '--overwrite')
    assert 'the times of the recording jump by' in capsys.readouterr().err
    assert numbers_of(folder) == [*range(90)]


@pytest.mark.parametrize('seconds', [0.9, 7.0, 1800.0, 86400.0])
def test_jump_of_the_recording_forward(seconds: float, tmp_path: Path, capsys: Errors) -> None:
    drive = Drive(seconds=3.0, topics=())
    drive.others = [
        jpeg_entry(number, Drive().picture_ns(number))._replace(log_ns=round(
            Drive().picture_ns(number) + seconds * S * (number >= 40))) for number in range(90)]
    assert numbers_of(converted(tmp_path, drive, *CAMERA)) == [*range(90)]
    assert 'stand still' not in capsys.readouterr().err


@pytest.mark.parametrize('seconds', [60.0, 7200.0, 86400.0])
def test_remedy_of_a_recording_that_jumps_far_back(
        seconds: float, tmp_path: Path, capsys: Errors) -> None:
    drive = Drive(seconds=10.0, topics=())
    drive.others = [
        jpeg_entry(number, Drive().picture_ns(number))._replace(log_ns=round(
            Drive().picture_ns(number) - seconds * S * (number >= 150))) for number in range(300)]
    error = refused(tmp_path, drive, capsys, *CAMERA)
    assert 'at most 100 are possible' in error and '--clock log' not in error


@pytest.mark.parametrize(('gap', 'missing'), [(3.5, 2.0), (10.0, 1.1), (2.0, 1.6), (4.5, 2.9)])
@pytest.mark.parametrize('ends', ['fail', 'shorten'])
def test_camera_that_ends_within_the_largest_gap_is_said(
        ends: str, gap: float, missing: float, tmp_path: Path, capsys: Errors) -> None:
    drive = Drive(seconds=3.0)
    drive.others = [jpeg_entry(number, Drive().picture_ns(number), '/cam1')
                    for number in range(round((3.0 - missing) * 30))]
    folder = converted(tmp_path, drive, *CAMERA, '--image', 'rear=/cam1', *JOINTS_STATE,
                       '--max-gap', gap, '--ends', ends)
    text = f'rear has no sample for the last {missing + 1 / 30:.3f} s of the other topics'
    assert text in capsys.readouterr().err
    assert text in (folder / 'meta/opencv_tools/bags.json').read_text()


@pytest.mark.parametrize('at', [1, 29, 59, 40])
@pytest.mark.parametrize('kind', ['number', 'jpeg', 'raw'])
def test_dry_run_reads_all_numbers_and_sizes(
        kind: str, at: int, tmp_path: Path, capsys: Errors) -> None:
    drive = Drive(topics=())
    for number in range(60):
        time_ns = drive.picture_ns(number)
        image = numbered_picture(number, 160 if number != at or kind == 'number' else 200)
        if kind == 'raw':
            data = image_to_cdr(array_to_wire(
                image, find_encoding('bgr8'), WireHeader(*divmod(time_ns, S), '')))
            drive.others.append(Entry(time_ns, data, TOPIC, 'sensor_msgs/msg/Image'))
        else:
            drive.others.append(jpeg_entry(number, time_ns, width=image.shape[1]))
    drive.others += [joints_entry(
        drive.picture_ns(number), [float('nan') if number == at and kind == 'number' else 1.0],
        ['grip'], '/grip') for number in range(60)]
    words = *CAMERA, '--state', '/grip.position'
    dry = refused(tmp_path, drive, capsys, *words, '--dry-run')
    assert ('/grip.position is not finite' if kind == 'number' else
            'front changes its size from (160, 120) to (200, 120)') in dry
    assert dry.removeprefix('img_convert: error: bad.mcap: ').splitlines()[0] in refused(
        tmp_path, drive, capsys, *words)


def of_two_clocks(step_ms: int, log_step_ms: int, at: int = 2400) -> list[Entry]:
    """
    Return a drive of 4 s in the order of the file, whose clocks step back after some time.

    :param step_ms: step of the stamps.
    :param log_step_ms: step of the times of the recording.
    :param at: real time of the steps, in ms after the begin.
    """
    entries = []
    for one in range(4000):
        real = BEGAN + one * S // 1000
        stamp = real - step_ms * S // 1000 * (one >= at)
        log = real - log_step_ms * S // 1000 * (one >= at)
        if one % 40 == 0:  # 25 pictures a second, recorded in the order of their reception
            entries.append((real, jpeg_entry(one // 40, stamp, log_ns=log + S // 500)))
        if one % 10 == 3:
            entries.append((real, joints_entry(stamp, joint_values(real), log_ns=log + S // 700)))
    return [entry for _, entry in sorted(entries, key=lambda pair: pair[0])]


def check_real_times(folder: Path) -> int:
    """Check that picture and joints of each row are of one real time; return the rows."""
    numbers, states = numbers_of(folder), rows_of(folder)['observation.state']
    assert len(numbers) == len(states)
    for number, state in zip(numbers, states):
        assert abs(number * 0.04 - state[0]) < 0.05
    return len(numbers)


@pytest.mark.parametrize('kind', ['.mcap', '', 'split'])
@pytest.mark.parametrize(('step_ms', 'clock'), [
    (2017, 'stamp'), (300, 'log'), (500, 'stamp'), (1000, 'log'), (170, 'stamp'), (1333, 'log')])
def test_clock_that_steps_back_in_stamps_and_recording(
        step_ms: int, kind: str, clock: str, tmp_path: Path, capsys: Errors) -> None:
    entries = with_definitions(of_two_clocks(step_ms, step_ms))
    bag = tmp_path / f'bag{kind}'
    if kind == 'split':
        bag.mkdir()
        border = next(place for place, (one, two) in enumerate(pairwise(entries))
                      if two.log_ns < one.log_ns) + 1
        write_mcap(bag / 'drive_0.mcap', entries[:border])
        write_mcap(bag / 'drive_1.mcap', entries[border:])
    elif kind:
        write_mcap(bag, entries, chunk_size=20_000)
    else:
        write_rosbag2(bag, '.db3', entries)
    words = (*CAMERA, *JOINTS_STATE, '--clock', clock)
    status = convert(bag, tmp_path / 'set', *words)
    error = capsys.readouterr().err
    if kind == 'split' and 'are one recording' not in error:  # a bag with one clock each
        assert abs(check_real_times(tmp_path / 'set') - 120) < 8
        return
    assert status == 1
    found = re.search(
        fr'front: the clock steps back by {step_ms / 1000 - 0.04:.3f} s after message 59, in the '
        r'stamps and the times of the recording, so rows from (\S+) s to (\S+) s after the begin '
        'mix the samples of before and after: leave them out with --on-gap split', error)
    assert found and not (tmp_path / 'set').exists(), error
    begin, end = map(float, found.groups())
    real_end = 4 - step_ms / 1000  # by the clock after the step
    assert abs(begin - real_end + 1.6) < 0.09 and abs(end - min(2.4, real_end)) < 0.09
    assert convert(bag, tmp_path / 'split', *words, '--on-gap', 'split') == 0
    rows = check_real_times(tmp_path / 'split')
    assert abs(rows - 30 * (max(2.4, real_end) - (end - begin))) < 8
    assert 'warning: ' in capsys.readouterr().err
    table = tmp_path / 'episodes.csv'
    table.write_text(f'start,end\n0,{begin}\n{end},9\n')
    assert convert(bag, tmp_path / 'table', *words, '--episodes', table) == 0
    assert abs(check_real_times(tmp_path / 'table') - rows) < 8


@pytest.mark.parametrize('step_ms', [1500, 300, 900, 2100, 163])
def test_clock_of_the_recording_that_steps_back_alone(
        step_ms: int, tmp_path: Path, capsys: Errors) -> None:
    bag = write_mcap(tmp_path / 'bag.mcap', with_definitions(of_two_clocks(0, step_ms)))
    words = *CAMERA, *JOINTS_STATE
    assert convert(bag, tmp_path / 'set', *words, '--clock', 'log') == 1
    text = f'jump by -{step_ms / 1000 - 0.04:.3f} s, but its stamps do not; use --clock stamp'
    assert f'times of the recording of front ({TOPIC}) {text}' in capsys.readouterr().err
    status = convert(bag, tmp_path / 'set', *words)
    error = capsys.readouterr().err
    assert 'use --clock log' not in error
    if status:  # too many pictures would wait for those before them
        begin, end = re.findall(r'leave the time from (\S+) s to (\S+) s out', error)[0]
        table = tmp_path / 'episodes.csv'
        table.write_text(f'start,end\n0,{begin}\n{float(end) + 0.04},9\n')
        assert convert(bag, tmp_path / 'set', *words, '--episodes', table) == 0
    missing = min(step_ms / 1000, 1.6) if status else 0
    assert abs(check_real_times(tmp_path / 'set') - 30 * (4 - missing)) < 8


@pytest.mark.parametrize('late_ms', [9, 40, 80])
def test_messages_a_little_out_of_order_are_no_step_of_the_clock(
        late_ms: int, tmp_path: Path, capsys: Errors) -> None:
    entries = [entry._replace(log_ns=entry.log_ns + late_ms * S // 1000 * (place % 7 == 3))
               for place, entry in enumerate(of_two_clocks(0, 0))]
    bag = write_mcap(tmp_path / 'bag.mcap', with_definitions(entries))
    for clock in ('stamp', 'log'):
        assert convert(bag, tmp_path / clock, *CAMERA, *JOINTS_STATE, '--clock', clock) == 0
    assert 'steps back' not in capsys.readouterr().err


@pytest.mark.parametrize('dead', ['wrist', 'shoulder'])
@pytest.mark.parametrize(('stop', 'gap'), [(4.0, 1.0), (8.5, 1.0), (6.3, 2.0), (5.0, 0.5)])
def test_joint_that_dies_ends_the_rows(
        stop: float, gap: float, dead: str, tmp_path: Path, capsys: Errors) -> None:
    drive = Drive(seconds=10.0, topics=())
    alive = [one for one in ('shoulder', 'elbow', 'wrist') if one != dead]
    for step in range(1000):
        time_ns = BEGAN + step * S // 100
        values = {'shoulder': step / 100, 'elbow': -step / 100, 'wrist': step / 10}
        if step % 5 == 0:
            drive.others.append(jpeg_entry(step // 5, time_ns))
        drive.others.append(joints_entry(time_ns, [values[one] for one in alive], alive, '/arm'))
        if step < stop * 100 and step % 2 == 0:
            drive.others.append(joints_entry(time_ns + S // 5000, [values[dead]], [dead], '/arm'))
    words = *CAMERA, '--state', '/arm.position', '--max-gap', gap
    error = refused(tmp_path, drive, capsys, *words)
    found = re.search(r'/arm.position.(\w+) has no sample for the last (\S+) s of', error)
    assert found and found[1] == dead and abs(float(found[2]) - 10 + stop) < 0.05, error
    folder = converted(tmp_path, drive, *words, '--ends', 'shorten')
    names = info_of(folder)['features']['observation.state']['names']
    states = rows_of(folder)['observation.state']
    assert abs(len(states) - 30 * stop) < 4
    values_of = dict(zip(names, np.array(states).T))
    assert np.allclose(values_of['shoulder'] * 10, values_of['wrist'], atol=0.31)
    split = converted(tmp_path / 'split', drive, *words, '--on-gap', 'split')
    assert abs(len(rows_of(split)['index']) - 30 * (stop + gap)) < 4


@pytest.mark.parametrize('gap', [0.5, 1.0, 1.4])
def test_age_of_the_oldest_joint_is_that_of_the_row(
        gap: float, tmp_path: Path, capsys: Errors) -> None:
    drive = Drive(seconds=4.0, others=[
        joints_entry(BEGAN + step * S // 50, [float(step)], ['grip'], '/joint_states')
        for step in range(200) if not 50 <= step < 130])
    words = *CAMERA, *JOINTS_STATE, '--max-gap', gap
    assert '/joint_states.position.grip has no sample for 1.587 s' in refused(
        tmp_path, drive, capsys, *words)
    folder = converted(tmp_path, drive, *words, '--on-gap', 'split')
    part, = json.loads((folder / 'meta/opencv_tools/bags.json').read_text())
    assert gap - 0.04 < part['topics']['/joint_states.position']['largest_error'] <= gap
    assert abs(len(rows_of(folder)['index']) - 30 * (4 - 1.6 + gap)) < 4


@pytest.mark.parametrize('form', ['lerobot', 'webdataset', 'parquet'])
@pytest.mark.parametrize('name', ['observation.gripper', 'a.b.c', '_0.9'])
def test_names_of_features_have_points(name: str, form: str, tmp_path: Path) -> None:
    bag = Drive(seconds=0.5).write(tmp_path / 'bag.mcap')
    words = *CAMERA, '--vector', f'{name}=/joint_states.position'
    assert convert(bag, tmp_path / 'set', *words, form=form) == 0
    if form == 'lerobot':
        assert len(rows_of(tmp_path / 'set')[name]) == 15
        assert main(['--check', str(tmp_path / 'set')]) == 0


@pytest.mark.parametrize('name', [
    'a.', '.a', 'a..b', '../a', 'a/b', 'a' * 65, 'observation.images.front', 'stamp_ns.front',
    'index', 'a b', 'a.b\n'])
def test_names_that_no_feature_can_have(name: str, tmp_path: Path, capsys: Errors) -> None:
    error = refused(tmp_path, Drive(seconds=0.3), capsys, *CAMERA, '--vector',
                    f'{name}=/joint_states.position')
    assert 'does not name a feature' in error or 'cannot have the name' in error


def test_late_joint_and_pause_of_all_joints_are_named(tmp_path: Path, capsys: Errors) -> None:
    drive = Drive(seconds=4.0, others=[
        joints_entry(BEGAN + step * S // 50, [float(step)], ['grip'], '/joint_states')
        for step in range(101, 200)])
    words = *CAMERA, *JOINTS_STATE
    assert '/joint_states.position.grip has no sample for the first 2.020 s of' in refused(
        tmp_path, drive, capsys, *words)
    drive.others = [joints_entry(BEGAN + step * S // 50, [0.0] * 3, topic='/arm')
                    for step in range(200) if not 50 <= step < 130]
    assert '/arm.position has no sample for 1.587 s' in refused(
        tmp_path, drive, capsys, *CAMERA, '--state', '/arm.position')
